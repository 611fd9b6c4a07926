//! The shipped spray painter under gravity, against what its file states.

use std::path::Path;

use rand::RngExt;

use crate::elastostatics::{Deflection, ElasticChain};
use calibrig_files::{Robot, load_robot};
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::{Bearing, Section, StaticProperties};

const CENTRE: [f64; 7] = [2.0, 0.19, -1.71, 0.12, 2.0, -0.16, -0.77];
const HALF_WIDTH: [f64; 7] = [1.92, 0.39, 0.31, 0.20, 0.30, 1.18, 0.57];

/// How far gravity lowers the target at the joint variables `q`, m, after `change`.
fn lowered(robot: &Robot, q: &[f64], change: impl Fn(&mut StaticProperties)) -> f64 {
    let mut model = robot.model.clone();
    model.statics.as_mut().map(change).expect("masses, stiffnesses and gravity");
    let command = model.actuators.command_from_joints(q);
    let target = robot.target().expect("stated");
    let mut chain = ElasticChain::of(&model);
    let mut height = |deflection| {
        chain.settle(&command, &[], deflection).expect("a pose at rest");
        chain.target(&target).y
    };
    height(Deflection::None) - height(Deflection::Equilibrium)
}

#[test]
fn gravity_lowers_the_spray_painters_target_as_its_file_says() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/spray_painter/robot.toml");
    let robot = load_robot(&path).expect("the shipped robot");
    let all = lowered(&robot, &CENTRE, |_| {});
    let drive =
        |joint: usize| move |statics: &mut StaticProperties| statics.drive_stiffness[joint] = f64::INFINITY;
    let share_of = |rigid: &dyn Fn(&mut StaticProperties)| all - lowered(&robot, &CENTRE, rigid);
    // From robot.toml, which has it from the minimum of the potential energy, written down apart from this program.
    for (what, found, stated) in [
        ("all", all, 14.85e-3),
        ("drive of the elbow", share_of(&drive(3)), 13.22e-3),
        ("bearings", share_of(&|statics| statics.bearings.fill(Bearing::default())), 0.70e-3),
        ("rod", share_of(&|s| s.linkage.as_mut().unwrap().rod_stiffness = f64::INFINITY), 0.50e-3),
        ("drive of the shoulder", share_of(&drive(2)), 0.21e-3),
        ("beams", share_of(&make_beams_rigid), 0.18e-3),
    ] {
        eprintln!("{what}: {:.4} mm", found * 1e3);
        assert!((found - stated).abs() < 6e-6, "{what}: {found} m");
    }
    for joint in [0, 1, 4, 5, 6] {
        assert!(share_of(&drive(joint)).abs() < 0.1e-3, "{joint}");
    }
    let mut rng = stream(2, 0, StreamSource::AsBuilt);
    let poses = 100;
    let sum: f64 = (0..poses)
        .map(|_| {
            let q: Vec<f64> =
                (0..7).map(|i| CENTRE[i] + HALF_WIDTH[i] * rng.random_range(-1.0..1.0)).collect();
            lowered(&robot, &q, |_| {})
        })
        .sum();
    let mean = sum / f64::from(poses);
    eprintln!("mean droop over the working region {:.2} mm", mean * 1e3);
    assert!((12e-3..18e-3).contains(&mean), "{mean}");
}

/// A compliance without a drop in weight.
fn make_beams_rigid(statics: &mut StaticProperties) {
    for segment in statics.beams.iter_mut().flatten().flat_map(|beam| &mut beam.segments) {
        segment.section = Section { mass_per_length: segment.section.mass_per_length, ..Section::RIGID };
    }
}
