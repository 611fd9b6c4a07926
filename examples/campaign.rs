//! A small Monte Carlo campaign: is an estimate as certain as it says? Machines are drawn from the identification's own priors.
//!
//! `cargo run --release --no-default-features --example campaign`

use std::error::Error;
use std::path::Path;

use calibrig::model::Unit;
use calibrig::montecarlo::{Campaign, summarise_trials};
use calibrig::pipeline::PlantKind;
use calibrig::scenario::load_scenario;

const TRIALS: u32 = 24;

fn main() -> Result<(), Box<dyn Error>> {
    let scenario = load_scenario(Path::new("scenarios/matched.toml"))?;
    // Any trial is the same alone or among others: `calibrig run scenarios/matched.toml --trial 7` opens one of them.
    let campaign = Campaign::of_draws(&scenario, scenario.seed, PlantKind::Analytic);
    let trials = campaign.trials(0..TRIALS)?;
    let summary = summarise_trials(&campaign, &trials)?;
    for reason in &summary.reasons {
        println!("{} failed, first trial {}: {}", reason.count, reason.trial, reason.text);
    }
    for mode in summary.modes() {
        println!("{}, {} machines, {} doubtful", mode.mode.title(), trials.len(), mode.doubtful);
        for set in &mode.sets {
            let rms = &set.rms_3d;
            println!("  {}: RMS of the 3-D error {:.4} mm", set.kind.key(), 1e3 * rms.mean);
        }
        println!("  {:22} {:>10} {:>10}  inside the 95 % intervals", "parameter", "RMSE", "stated");
        for p in &mode.parameters {
            let (scale, unit) = match p.id.unit() {
                Unit::Metre => (1e3, "mm"),
                Unit::Radian => (1e3, "mrad"),
                Unit::One => (1e2, "%"),
            };
            let (rmse, stated) = (scale * p.rmse.value, scale * p.stated);
            let share = 1e2 * p.coverage.fraction();
            println!("  {:22} {rmse:10.4} {stated:10.4} {unit:5} {share:5.1} %", p.id);
        }
        if let Some(predictions) = &mode.predictions {
            let share = 1e2 * predictions.coverage.fraction();
            println!("  predicted coordinates inside their 95 % intervals: {share:.1} %");
        }
    }
    Ok(())
}
