//! A robot and its measurements from files: identified on one set of poses, verified on another.
//!
//! `cargo run --release --no-default-features --example robot_from_files`
//!
//! The measurements are those of the shipped recording, written as the text that a tracker's program might have left behind.

use std::error::Error;
use std::path::Path;

use calibrig::evaluation::accuracy;
use calibrig::files::{ColumnMap, load_robot, read_measurements, write_measurements};
use calibrig::identification::{IdentificationOptions, Loss, Mode, Predictor, identify, without_calibration};
use calibrig::recording::read_recording;

fn main() -> Result<(), Box<dyn Error>> {
    let robot = load_robot(Path::new("models/spray_painter/robot.toml"))?;
    let kinds: Vec<_> = robot.model.kinematics.links.iter().map(|link| link.kind).collect();

    let folder = tempfile::tempdir()?;
    let mut sets = Vec::new();
    for recorded in read_recording(Path::new("recordings/paper.mcap"))?.sets {
        let path = folder.path().join(format!("{}.csv", recorded.kind.key()));
        write_measurements(&path, &recorded.measurements, &kinds)?;
        // From here on as with a file of one's own; another program's columns are named by `load_column_map`.
        sets.push(read_measurements(&path, &ColumnMap::default(), &kinds)?.set);
    }
    let [identification, verification] = &sets[..] else { return Err("expected two sets".into()) };

    println!("{}: RMS of the 3-D error over poses that were not fitted", robot.name);
    let rms = |predictor: &mut Predictor<'_>| -> Result<f64, Box<dyn Error>> {
        let row = accuracy(&predictor.errors(verification)?).ok_or("no poses")?;
        Ok(1e3 * row.rms_3d)
    };
    let nominal = without_calibration(&robot.model, identification, Loss::Squared)?;
    println!("  {:32} {:7.3} mm", Mode::WithoutCalibration.title(), rms(&mut Predictor::new(&nominal)?)?);
    for mode in [Mode::OnlyCalibration, Mode::WithGravity, Mode::Extended] {
        // The tracker's noise is a few micrometres; what the machine does beside every model is about 0.1 mm.
        let options = IdentificationOptions { mode, unmodelled_sigma: 1e-4, ..Default::default() };
        let estimate = identify(&robot.model, identification, &options)?;
        let rms = rms(&mut Predictor::new(&estimate.robot)?)?;
        println!("  {:32} {rms:7.3} mm, {} parameters", mode.title(), estimate.parameters.len());
        if mode == Mode::Extended {
            estimate.assumptions.iter().for_each(|assumption| println!("  {assumption}"));
            estimate.warnings.iter().for_each(|warning| println!("  warning: {warning}"));
        }
    }
    Ok(())
}
