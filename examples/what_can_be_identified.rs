//! Before anything is measured: which parameters the planned poses and target can tell, which they cannot, and what would help.
//!
//! `cargo run --release --no-default-features --example what_can_be_identified`

use std::error::Error;
use std::path::Path;

use calibrig::files::load_robot;
use calibrig::identification::{
    IdentificationOptions, Mode, explain, identifiability, prospect, structural_poses,
};
use calibrig::nalgebra::Vector3;
use calibrig::pipeline::planned_at;

fn main() -> Result<(), Box<dyn Error>> {
    let robot = load_robot(Path::new("models/ur5/robot.toml"))?;
    let chain = &robot.model.kinematics;
    let poses = structural_poses(chain, 40);

    // Neither the tracker's place nor the target's offset is known: both are identified with the links.
    for (what, target) in [
        ("a target on the last axis", Vector3::new(0.0, 0.0, 0.1)),
        ("a target beside it", Vector3::new(0.08, 0.05, 0.1)),
    ] {
        let report = identifiability(chain, &poses, &target, true, true)?;
        let spectrum = &report.spectrum;
        println!("{what} at {:?} mm, {} poses:", (1e3 * target).as_slice(), poses.len());
        println!(
            "  rank {} of {} parameters, condition {:.0}, {} left out as redundant by structure",
            spectrum.rank,
            report.selected.len(),
            spectrum.condition,
            report.dependent.len()
        );
        for finding in explain(&report, chain, &poses, &target)?.iter().skip(report.dependent.len()) {
            println!("  {finding}");
        }
    }

    // The whole problem, priors and all, as the fit of geometry and stiffness together would meet it.
    let target = Vector3::new(0.08, 0.05, 0.1);
    let planned = planned_at(&robot.model, &poses, target)?.with_sigma(20e-6);
    let options = IdentificationOptions { mode: Mode::ElastoGeometric, ..IdentificationOptions::default() };
    let prospect = prospect(&robot.model, &planned, &options)?;
    println!("{}: {} parameters", options.mode.title(), prospect.parameters.len());
    println!("  rank {}, by the measurements alone {}", prospect.spectrum.rank, prospect.measured_rank);
    println!("  weak directions: {}", prospect.spectrum.weak.len());
    for direction in &prospect.spectrum.weak {
        println!("    {:.1e} of the best: {direction}", direction.singular_value);
    }
    prospect.unloaded.iter().for_each(|id| println!("  gravity hardly loads {id}: left out"));
    prospect.held.iter().for_each(|group| println!("  held by its prior: {group}"));
    Ok(())
}
