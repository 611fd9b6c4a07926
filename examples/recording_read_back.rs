//! A recording read back: what is in it, and the same estimates from its measurements, bit for bit.
//!
//! `cargo run --release --no-default-features --example recording_read_back`

use std::error::Error;
use std::path::Path;

use calibrig::model::measurement::Reading;
use calibrig::recording::read_recording;
use calibrig::replay::{ReplayOptions, replay};

fn main() -> Result<(), Box<dyn Error>> {
    let path = Path::new("recordings/paper.mcap");
    let recording = read_recording(path)?;
    for set in &recording.sets {
        let observations = &set.measurements.observations;
        println!("{}: {} observations", set.kind.key(), observations.len());
        let Some(first) = observations.first() else { continue };
        println!("  pose {}, command {:.4?} m or rad", first.pose, first.command);
        if let Reading::Spherical(seen) = &first.reading {
            let sigma = seen.covariance.unwrap_or_default().diagonal().map(f64::sqrt);
            println!("  range     {:9.5} m   +- {:.1} um", seen.range, 1e6 * sigma[0]);
            println!("  azimuth   {:9.5} rad +- {:.1} urad", seen.azimuth, 1e6 * sigma[1]);
            println!("  elevation {:9.5} rad +- {:.1} urad", seen.elevation, 1e6 * sigma[2]);
        }
    }
    for estimate in &recording.estimates {
        println!("recorded estimate {}: {} parameters", estimate.mode, estimate.parameters.len());
    }

    let replayed = replay(path, &ReplayOptions::default())?;
    for change in &replayed.changes {
        let mm = |rms: Option<f64>| rms.map_or("-".to_owned(), |rms| format!("{:.4} mm", 1e3 * rms));
        println!(
            "{:28} {:15} recorded {:>11}, replayed {:>11}",
            change.mode.title(),
            change.kind.key(),
            mm(change.recorded),
            mm(change.replayed)
        );
    }
    println!("{} estimates compared, {} differences", replayed.compared, replayed.differences.len());
    match replayed.differences.first() {
        None => println!("every parameter, standard deviation and chi-square has the recorded bits"),
        Some(difference) => println!("the first: {difference:?}"),
    }
    Ok(())
}
