//! A simulated robot that sags, measured by a simulated laser tracker: identified without and with its stiffness.
//!
//! `cargo run --release --no-default-features --example measure_a_simulated_robot`

use std::error::Error;
use std::path::Path;

use calibrig::evaluation::accuracy;
use calibrig::files::load_robot;
use calibrig::identification::{IdentificationOptions, Mode, Predictor, identify, structural_poses};
use calibrig::measurement::{MeasurementSet, Reading};
use calibrig::nalgebra::Vector3;
use calibrig::plant::{AsBuilt, Plant, SettleOptions, effects::Effects};
use calibrig::random::{Source, stream};
use calibrig::tracker::{ErrorLine, Instrument, LaserTracker};

fn main() -> Result<(), Box<dyn Error>> {
    let robot = load_robot(Path::new("models/ur5/robot.toml"))?.model;
    let mut machine = AsBuilt {
        kinematics: robot.kinematics.clone(),
        actuators: robot.actuators,
        statics: robot.statics.clone().ok_or("the robot's files give no masses")?,
        target: Vector3::new(0.05, 0.03, 0.10),
        effects: Effects::default(),
    };
    // As built: an upper arm that is 0.4 mm too long, and a shoulder's drive at a third of the stated stiffness.
    machine.kinematics.links[2].a += 0.4e-3;
    machine.statics.drive_stiffness[1] /= 3.0;
    let mut plant = Plant::new(&machine, SettleOptions::default())?;

    let instrument = Instrument {
        transverse: ErrorLine { offset: 15e-6, per_metre: 6e-6 },
        range: ErrorLine { offset: 10e-6, per_metre: 0.3e-6 },
        random_fraction: 0.125,
        noise: true,
    };
    let tracker = LaserTracker::levelled(instrument, Vector3::new(2.5, 0.5, 0.4), 0.0, &Vector3::z());
    let mut noise = stream(1, 0, Source::IdentificationNoise);
    let mut set = MeasurementSet::default();
    for command in structural_poses(&robot.kinematics, 80) {
        let pose = plant.settle(&command)?;
        let reading = tracker.measure(&pose.target, &mut noise)?;
        let mut one = MeasurementSet::of_points([(command, reading.position())]);
        one.observations[0].reading = Reading::Spherical(reading);
        (set.stations, set.targets) = (one.stations, one.targets);
        set.observations.append(&mut one.observations);
    }
    for mode in [Mode::OnlyCalibration, Mode::ElastoGeometric] {
        // The stiffnesses in the robot's file are guesses, known to about their own size.
        let options = IdentificationOptions { mode, compliance_sigma: 1.0, ..Default::default() };
        let estimate = identify(&robot, &set, &options)?;
        let errors = Predictor::new(&estimate.robot)?.errors(&set)?;
        let rms = accuracy(&errors).map_or(f64::NAN, |row| 1e3 * row.rms_3d);
        println!("{}: RMS {rms:.4} mm, {:?} chi-square a degree of freedom", mode.title(), estimate.chi2_per_dof());
        for p in estimate.parameters.iter().filter(|p| ["delta_a3", "compliance_drive2"].contains(&&*p.id.to_string())) {
            println!("  {:18} {:9.5} +- {:.5} {}", p.id, p.value, p.sigma.unwrap_or(f64::NAN), p.id.unit());
        }
    }
    Ok(())
}
