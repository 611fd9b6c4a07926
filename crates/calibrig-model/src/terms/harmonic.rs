//! Errors that repeat with every turn of a motor: eccentric pulleys and gears, the two lobes of a strain wave gear.

use std::f64::consts::TAU;

use super::{TermFamily, TermPlace, is_linear, joint_variable, parse_joint_variable};
use crate::{CalibrationModel, PoseQuery};

/// Sine and cosine once and twice per motor turn, for every actuator whose turns are known.
pub(super) struct HarmonicTerms;

/// By index.
const WAVES: [(&str, f64, Wave); 4] = [
    ("sin1", 1.0, f64::sin as Wave),
    ("cos1", 1.0, f64::cos as Wave),
    ("sin2", 2.0, f64::sin as Wave),
    ("cos2", 2.0, f64::cos as Wave),
];

type Wave = fn(f64) -> f64;

impl TermFamily for HarmonicTerms {
    fn key(&self) -> &'static str {
        "harmonic"
    }

    fn about(&self) -> &'static str {
        "a transmission error at once and twice per motor turn"
    }

    fn terms(&self, model: &CalibrationModel) -> Vec<(usize, usize, bool)> {
        let turning = model.motor_turns.iter().enumerate().filter(|(_, turns)| turns.is_some());
        turning
            .flat_map(|(joint, _)| (0..WAVES.len()).map(move |wave| (joint, wave)))
            .map(|(joint, wave)| (joint, wave, is_linear(model, joint)))
            .collect()
    }

    fn place(&self, joint: usize, _: usize) -> TermPlace {
        TermPlace::Actuator(joint)
    }

    fn basis(&self, model: &CalibrationModel, joint: usize, index: usize, input: &PoseQuery<'_>) -> f64 {
        let turns = model.motor_turns.get(joint).copied().flatten();
        let (Some(turns), Some(command), Some((_, order, wave))) =
            (turns, input.command.get(joint), WAVES.get(index))
        else {
            return 0.0;
        };
        wave(order * TAU * turns * command)
    }

    fn prior_sigma(&self, _: bool) -> f64 {
        // 0.2 mm or 0.2 mrad (0.7 arcmin): a precision gear's data sheet allows one arcmin.
        2e-4
    }

    fn suffix(&self, joint: usize, index: usize, linear: bool) -> String {
        let wave = WAVES.get(index).map_or("", |wave| wave.0);
        format!("{}_{wave}", joint_variable(joint, linear))
    }

    fn parse(&self, suffix: &str) -> Option<(usize, usize, bool)> {
        let (variable, wave) = suffix.split_once('_')?;
        let (joint, linear) = parse_joint_variable(variable)?;
        Some((joint, WAVES.iter().position(|known| known.0 == wave)?, linear))
    }
}
