//! Every robot of `models/` is found again from exact measurements, and every command that a user has works on it.

use std::path::Path;

use calibrig::identification::{
    ComplianceChoice, FrameChoice, IdentificationOptions, InstrumentChoice, Mode, ParameterChoice,
    Redundancy, TargetChoice, complete_set_of, identify,
};
use calibrig::model::{KinematicModel, LinkTerm, ParameterId};
use calibrig::pipeline::{PlantKind, simulate};
use calibrig::plant::{AsBuiltDistribution, Spread};
use calibrig::scenario::{Scenario, load_scenario};
use nalgebra::Matrix4;

use crate::sandbox::{Sandbox, assert_refused};

/// The folders of `models/`, each with a scenario of its name in `scenarios/zoo/`.
const ZOO: [&str; 10] = [
    "cobra600",
    "iiwa14",
    "irb120",
    "irb460",
    "irb4600_track",
    "spray_painter",
    "tx2_60l",
    "ur5",
    "wam",
    "youbot",
];

fn scenario(name: &str) -> Scenario {
    load_scenario(Path::new(&format!("scenarios/zoo/{name}.toml"))).expect("a scenario of the zoo")
}

#[test]
fn every_model_has_a_source_and_a_scenario() {
    let names = |folder: &str| {
        let entries =
            std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
        let mut names: Vec<_> = entries
            .filter(|path| path.is_dir() || path.extension().is_some_and(|ext| ext == "toml"))
            .map(|path| path.file_stem().expect("a name").to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    };
    assert_eq!(names("models"), ZOO);
    assert_eq!(names("scenarios/zoo"), ZOO);
    let table = std::fs::read_to_string("models/README.md").expect("the table of the zoo");
    for name in ZOO {
        let about = std::fs::read_to_string(format!("models/{name}/README.md")).expect("a page");
        assert_eq!(about.lines().count(), 3, "{name}");
        assert!(about.contains("Licence of ") || about.contains("Licences of "), "{name}");
        assert!(table.contains(&format!("[{name}]({name}/README.md)")), "{name}");
    }
}

/// Machines that are off in their complete set alone, measured without an error: nothing but the solver stands between the truth and what is found.
/// Springs, loads and four-bars are those of the file, known to both sides, and it is rapier that makes the measurements.
#[test]
fn exact_measurements_give_every_robot_its_complete_set() {
    for name in ZOO {
        for (frame, target) in
            [(FrameChoice::Fixed, TargetChoice::Fixed), (FrameChoice::Free, TargetChoice::Identified)]
        {
            let free = frame == FrameChoice::Free;
            let mut scenario = scenario(name);
            let model = scenario.robot.model.clone();
            let set = complete_set_of(&model, free, free).expect("a chain").selected;
            let links: Vec<(usize, LinkTerm)> = set.iter().filter_map(link_term).collect();
            scenario.drawn = Some(errors_of(links.clone()));
            scenario.verification_poses = 0;
            scenario.identification_poses = 60;
            scenario.tracker.instrument.noise = false;
            let options = IdentificationOptions {
                mode: Mode::ElastoGeometric,
                parameters: ParameterChoice::Complete,
                compliances: ComplianceChoice::Listed(Vec::new()),
                redundant: Redundancy::Keep,
                instrument: InstrumentChoice::Ignored,
                tolerance: None,
                frame,
                target,
                ..scenario.options.clone()
            };
            let session = simulate(&scenario, SEED, 0, PlantKind::Rapier, |_, _| {}).expect("a simulation");
            let estimate = identify(&model, &session.sets[0].measurements, &options).expect("an estimate");
            let found: Vec<ParameterId> = estimate.parameters.iter().map(|p| p.id).collect();
            let found_links: Vec<_> = found.iter().filter_map(link_term).collect();
            assert_eq!(found_links, links, "{name}");
            assert_eq!(found.len(), set.len(), "{name}: {found:?}");
            assert_eq!(estimate.spectrum.rank, found.len(), "{name}");

            let machine = scenario.as_built_for(SEED, 0).kinematics;
            let off = |(link, term): &(usize, LinkTerm), of: &KinematicModel| {
                machine.links[*link].term(*term) - of.links[*link].term(*term)
            };
            let before = links.iter().map(|at| off(at, &model.kinematics).abs()).fold(0.0, f64::max);
            let robot = &estimate.robot;
            let after = links.iter().map(|at| off(at, &robot.model.kinematics).abs()).fold(0.0, f64::max);
            let station = (robot.stations[0].inverse() * scenario.tracker.tracker_from_base).to_homogeneous();
            let ends = (station - Matrix4::identity()).amax();
            let ends = ends.max((robot.targets[0] - scenario.as_built.target).amax());
            println!(
                "{name}, ends {}: {} link parameters off by up to {before:.1e}, found within {after:.1e}, the ends within {ends:.1e}; condition {:.0}",
                if free { "free" } else { "known" },
                links.len(),
                estimate.spectrum.condition
            );
            assert!(after < EXACT && ends < EXACT, "{name}: {after:e}, {ends:e}");
        }
    }
}

/// m and rad: what is left is below 2e-12, whichever robot.
const EXACT: f64 = 1e-10;
const SEED: u64 = 7;

fn link_term(id: &ParameterId) -> Option<(usize, LinkTerm)> {
    match *id {
        ParameterId::Link { link, term } => Some((link, term)),
        _ => None,
    }
}

/// Half a millimetre and a milliradian, all independent.
fn errors_of(link_parameters: Vec<(usize, LinkTerm)>) -> AsBuiltDistribution {
    AsBuiltDistribution {
        spread: Spread::Normal,
        link_parameters,
        length: 5e-4,
        angle: 1e-3,
        compliances: Vec::new(),
        compliance: 0.0,
        mass: 0.0,
        linkage_length: 0.0,
        linkage_angle: 0.0,
        crank_axis: 0.0,
        crank_tilt: 0.0,
        tilt: 0.0,
        target: 0.0,
    }
}

#[test]
fn every_command_works_on_every_robot() {
    let sandbox = Sandbox::new();
    for name in ZOO {
        let file = format!("scenarios/zoo/{name}.toml");
        let out = format!("out/{name}");
        let recording = format!("{out}/recording.mcap");
        let campaign = format!("{out}/campaign");
        let report = format!("{out}/report");
        let commands: [&[&str]; 6] = [
            &["check", &file],
            &["run", &file, "--out", &out],
            &["replay", &recording],
            &["report", &recording, "--out", &report],
            &["identifiability", &file],
            &["montecarlo", &file, "--trials", "4", "--out", &campaign],
        ];
        for command in commands {
            let ended = sandbox.run(command);
            println!("{name}: {} ended with {:?}", command[0], ended.code);
            assert_eq!(ended.code, Some(0), "{command:?}: {}{}", ended.stdout, ended.stderr);
        }
    }
}

#[test]
fn a_region_of_a_joint_that_follows_another_is_refused() {
    let sandbox = Sandbox::new();
    let file = "scenarios/zoo/irb460.toml";
    let region = "[[poses.region]]\njoint = \"level\"\ncentre_rad = 0\nhalf_width_rad = 0.1\n\n[tracker]";
    sandbox.write(file, sandbox.read(file).replacen("[tracker]", region, 1));
    let line = 1 + sandbox.read(file).lines().position(|line| line == "joint = \"level\"").expect("there");
    let place = format!("{file}:{line}:");
    assert_refused(&sandbox, &["check", file], &place, "follows another joint", "no [[poses.region]] for it");
}
