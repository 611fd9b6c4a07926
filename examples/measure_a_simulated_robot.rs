//! A simulated robot that sags, measured by a simulated laser tracker: identified without and with its stiffness.
//! `cargo run --release --no-default-features --example measure_a_simulated_robot`

use std::error::Error;
use std::path::Path;

use calibrig::evaluation::accuracy;
use calibrig::files::load_robot;
use calibrig::identification::{IdentificationOptions, Mode, Predictor, identify, structural_poses};
use calibrig::measurement::{MeasurementSet, Reading};
use calibrig::model::ParameterId;
use calibrig::nalgebra::Vector3;
use calibrig::plant::{AsBuilt, Plant, SettleOptions, effects::Effects};
use calibrig::random::{StreamSource, stream};
use calibrig::tracker::{ErrorLine, Instrument, LaserTracker, Shot};

fn main() -> Result<(), Box<dyn Error>> {
    let robot = load_robot(Path::new("models/ur5/robot.toml"))?.model;
    let mut machine = AsBuilt {
        kinematics: robot.kinematics.clone(),
        actuators: robot.actuators.clone(),
        statics: robot.statics.clone().ok_or("the robot's files give no masses")?,
        target: Vector3::new(0.05, 0.03, 0.10),
        effects: Effects::default(),
    };
    // As built: an upper arm that is 0.4 mm too long, and a shoulder's drive at a third of the stated stiffness.
    machine.kinematics.links[2].a += 0.4e-3;
    machine.statics.drive_stiffness[1] /= 3.0;
    let mut plant = Plant::new(&machine, SettleOptions::default())?;
    // Maximum permissible errors of a data sheet; an eighth of them is random from one reading to the next.
    let line = |offset, per_metre| ErrorLine { offset, per_metre };
    let (transverse, range) = (line(15e-6, 6e-6), line(10e-6, 0.3e-6));
    let instrument = Instrument::of_noise(transverse, range, 0.125);
    let tracker = LaserTracker::levelled(instrument, Vector3::new(2.5, 0.5, 0.4), 0.0, &Vector3::z());
    let mut noise = stream(1, 0, StreamSource::IdentificationNoise);
    let (mut points, mut readings) = (Vec::new(), Vec::new());
    for command in structural_poses(&robot.kinematics, 80) {
        let reading = tracker.measure(&plant.settle(&command)?.target, &Shot::default(), &mut noise)?;
        points.push((command, reading.position()));
        readings.push(Reading::Spherical(reading));
    }
    let mut set = MeasurementSet::of_points(points);
    set.observations.iter_mut().zip(readings).for_each(|(seen, reading)| seen.reading = reading);
    for mode in [Mode::OnlyCalibration, Mode::ElastoGeometric] {
        // The stiffnesses in the robot's file are guesses, known to about their own size.
        let options = IdentificationOptions { mode, compliance_sigma: 1.0, ..Default::default() };
        let estimate = identify(&robot, &set, &options)?;
        let errors = Predictor::new(&estimate.robot)?.errors(&set)?;
        let rms = accuracy(&errors).map_or(f64::NAN, |row| 1e3 * row.rms_3d);
        let chi2 = estimate.chi2_per_dof().unwrap_or(f64::NAN);
        println!("{}: RMS {rms:.4} mm, chi-square {chi2:.1} a degree of freedom", mode.title());
        let asked = ["delta_a3", "compliance_drive2"].map(ParameterId::parse);
        for p in estimate.parameters.iter().filter(|p| asked.contains(&Some(p.id))) {
            let sigma = p.sigma.unwrap_or(f64::NAN);
            println!("  {:18} {:+.6} +- {sigma:.0e} {}", p.id, p.value, p.id.unit());
        }
    }
    Ok(())
}
