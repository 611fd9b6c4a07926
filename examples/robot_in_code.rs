//! A robot stated in code, measured and identified: what was found, how sure it is, and where the robot goes.
//! `cargo run --release --no-default-features --example robot_in_code`

use std::error::Error;
use std::f64::consts::FRAC_PI_2;

use calibrig::identification::{IdentificationOptions, identify};
use calibrig::kinematics::target_in_base;
use calibrig::measurement::MeasurementSet;
use calibrig::model::{CalibrationModel, CraigLink, Unit};
use calibrig::nalgebra::Vector3;

fn main() -> Result<(), Box<dyn Error>> {
    // Rows of Craig's table: a (m), alpha (rad), d (m), theta (rad); limits in rad.
    let robot = CalibrationModel::new(vec![
        CraigLink::revolute("waist").row(0.0, 0.0, 0.8, 0.0).limits(-3.0, 3.0),
        CraigLink::revolute("shoulder").row(0.3, -FRAC_PI_2, 0.0, 0.0).limits(-2.0, 2.0),
        CraigLink::revolute("elbow").row(1.1, 0.0, 0.0, 0.0).limits(-2.0, 2.0),
        CraigLink::revolute("wrist").row(0.2, -FRAC_PI_2, 1.2, 0.0).limits(-3.0, 3.0),
    ])?;

    // In place of a real machine: its upper arm is 1.5 mm longer than drawn, its elbow's zero is off by 2 mrad.
    let mut machine = robot.kinematics.clone();
    machine.links[2].a += 1.5e-3;
    machine.links[2].theta -= 2e-3;
    let mut points = Vec::new();
    for k in 0..50 {
        let command = [0.7, 1.1, 1.9, 2.3].map(|pace| 1.8 * (pace * f64::from(k)).sin());
        let target = target_in_base(&machine, &command, &Vector3::new(0.10, 0.05, 0.20))?;
        let error = [5.3, 6.1, 7.7].map(|pace| 20e-6 * (pace * f64::from(k)).sin());
        points.push((command.to_vec(), target + Vector3::from(error)));
    }
    let set = MeasurementSet::of_points(points).with_sigma(15e-6);

    let estimate = identify(&robot, &set, &IdentificationOptions::default())?;
    println!("{} poses, {} parameters:", set.observations.len(), estimate.parameters.len());
    for p in &estimate.parameters {
        let (scale, unit) = match p.id.unit() {
            Unit::Metre => (1e3, "mm"),
            Unit::Radian => (1e3, "mrad"),
            Unit::One => (1.0, ""),
        };
        let sigma = scale * p.sigma.unwrap_or(f64::NAN);
        println!("  {:14} {:9.4} +- {sigma:.4} {unit}", p.id, scale * p.value);
    }
    println!("taken to be so:");
    estimate.assumptions.iter().for_each(|assumption| println!("  {assumption}"));

    let command = [0.5, -0.4, 0.9, 0.0];
    let there = estimate.predict(&command)?;
    let nominal = target_in_base(&robot.kinematics, &command, &Vector3::new(0.10, 0.05, 0.20))?;
    println!("at {command:?} rad:");
    println!("  predicted {:9.3?} mm", (1e3 * there.position).as_slice());
    println!("  nominal   {:9.3?} mm", (1e3 * nominal).as_slice());
    if let Some(sigma) = there.sigma() {
        println!("  sigma     {:9.3?} mm", (1e3 * sigma).as_slice());
    }
    Ok(())
}
