//! Which parameters `identify` fits, with the keys of a scenario; and their list.

use std::fmt::Write;

use clap::error::ErrorKind;
use clap::{CommandFactory, ValueEnum};
use serde::Serialize;

use super::Cli;
use crate::pipeline::CalibrateError;
use calibrig_estimation::identification::{
    FrameChoice, IdentificationOptions, InstrumentChoice, ListedParameter, Mode, ParameterChoice,
    ParameterState, TargetChoice, check_named, list_parameters,
};
use calibrig_files::Robot;
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::{CalibrationModel, ParameterId, Unit};

/// Which parameters are fitted.
#[derive(Debug, clap::Args)]
pub(super) struct ByNameArgs {
    /// Which link parameters: complete (an independent set, by rank), `neighbour_axis_rules` (those that the published rules keep; short:
    /// rules), or names such as `delta_a2,delta_theta4`
    #[arg(long, value_name = "WHICH,..", value_delimiter = ',', default_value = "complete", value_parser = which)]
    parameters: Vec<String>,
    /// Parameters that stay at their nominal, stated or predicted values, such as `delta_a3`, `target_z` or `compliance_drive2`
    #[arg(long, value_name = "NAME,..", value_delimiter = ',', value_parser = id)]
    fix: Vec<ParameterId>,
    /// Parameters that are fitted even if another choice leaves them out; of link parameters that cannot be told apart, these are kept.
    /// Example: `delta_d3`
    #[arg(long, value_name = "NAME,..", value_delimiter = ',', value_parser = id)]
    free: Vec<ParameterId>,
    /// How the tracker is placed [default: nests if three are stated, else free]
    #[arg(long, value_enum, value_name = "CHOICE")]
    frame: Option<FrameArg>,
    /// How the errors that an instrument's readings share are treated [default: identified if they are stated, with the stated values as a prior]
    #[arg(long, value_enum, value_name = "CHOICE")]
    instrument: Option<InstrumentArg>,
    /// How the targets' offsets are treated [default: measured if their uncertainty is stated, else identified]
    #[arg(long, value_enum, value_name = "CHOICE")]
    target: Option<TargetArg>,
    /// List the parameters and how each is treated; fit nothing
    #[arg(long)]
    pub list_parameters: bool,
}

/// A choice of link parameters, or the name of one.
fn which(text: &str) -> Result<String, String> {
    let is_link = || matches!(ParameterId::parse(text), Some(ParameterId::Link { .. }));
    if matches!(text, "complete" | "rules" | "neighbour_axis_rules") || is_link() {
        return Ok(text.to_owned());
    }
    Err("expected complete, neighbour_axis_rules, or names of link parameters, such as delta_a2,delta_theta4"
        .to_owned())
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum FrameArg {
    /// The base nests place it, with their uncertainty as a prior
    Nests,
    /// Sweeps of two axes (--sweeps) tie it to the first links
    Sweeps,
    /// Nothing
    Free,
    /// The base nests place it, taken as exact
    Fixed,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum InstrumentArg {
    /// Identified, with the stated values as a prior
    AsStated,
    /// Ignored: every reading has only its own error
    Ignored,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum TargetArg {
    /// Measured, with the stated uncertainty as a prior
    Measured,
    /// Nothing
    Identified,
    /// The stated values are exact
    Fixed,
}

fn id(name: &str) -> Result<ParameterId, String> {
    let expected = || {
        if name.starts_with("frame") {
            return "expected --frame fixed, which holds the tracker's place as a whole".to_owned();
        }
        format!("expected {}", ParameterId::EXAMPLES.replace("frame_x, ", ""))
    };
    ParameterId::parse(name).ok_or_else(expected)
}

fn refuse(message: String) -> ! {
    Cli::command().error(ErrorKind::ValueValidation, message).exit()
}

impl ByNameArgs {
    /// Puts the choices into `options`. An invalid one is an error of usage.
    pub(super) fn apply(&self, model: &CalibrationModel, options: &mut IdentificationOptions) {
        options.parameters = self.links(model.kinematics.joint_count());
        options.fix.clone_from(&self.fix);
        options.free.clone_from(&self.free);
        if let Some(frame) = self.frame {
            options.frame = match frame {
                FrameArg::Nests => FrameChoice::Nests,
                FrameArg::Sweeps => FrameChoice::Sweeps,
                FrameArg::Free => FrameChoice::Free,
                FrameArg::Fixed => FrameChoice::Fixed,
            };
        }
        if let Some(instrument) = self.instrument {
            options.instrument = match instrument {
                InstrumentArg::AsStated => InstrumentChoice::AsStated,
                InstrumentArg::Ignored => InstrumentChoice::Ignored,
            };
        }
        if let Some(target) = self.target {
            options.target = match target {
                TargetArg::Measured => TargetChoice::Measured,
                TargetArg::Identified => TargetChoice::Identified,
                TargetArg::Fixed => TargetChoice::Fixed,
            };
        }
    }

    fn links(&self, joints: usize) -> ParameterChoice {
        match self.parameters.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
            ["complete"] => return ParameterChoice::Complete,
            ["rules" | "neighbour_axis_rules"] => return ParameterChoice::NeighbourAxisRules,
            _ => {}
        }
        let listed = self.parameters.iter().map(|name| match ParameterId::parse(name) {
            Some(id @ ParameterId::Link { link, .. }) if link < joints => id,
            _ => refuse(format!(
                "--parameters {name}: expected complete, neighbour_axis_rules, or link parameters with a joint number from 1 to {joints}, \
                 such as delta_a2,delta_theta4"
            )),
        });
        ParameterChoice::Listed(listed.collect())
    }

    /// Refuses names that cannot be fixed or freed.
    pub(super) fn check(
        &self,
        model: &CalibrationModel,
        modes: &[Mode],
        options: &IdentificationOptions,
        set: &MeasurementSet,
    ) {
        if let Err(error) = check_named(model, modes, options, &set.stations, &set.targets) {
            let flag = if self.fix.contains(&error.id()) { "--fix" } else { "--free" };
            refuse(format!("{flag} {}: {error}: {}", error.id(), error.help()));
        }
    }
}

/// The document of `--list-parameters --json`.
#[derive(Serialize)]
struct JsonList<'a> {
    schema: &'static str,
    name: &'a str,
    modes: Vec<JsonMode>,
}

#[derive(Serialize)]
struct JsonMode {
    mode: &'static str,
    parameters: Vec<JsonListed>,
}

#[derive(Serialize)]
struct JsonListed {
    name: String,
    unit: String,
    /// `fitted`, `left_out` or `not_chosen`.
    state: &'static str,
    has_prior: bool,
    prior_sigma: Option<f64>,
    reason: Option<&'static str>,
}

impl JsonListed {
    fn of(listed: &ListedParameter) -> Self {
        let (state, has_prior, prior_sigma, reason) = match listed.state {
            ParameterState::Fitted { prior, has_prior } => ("fitted", has_prior, prior, None),
            ParameterState::LeftOut(reason) => ("left_out", false, None, Some(reason.key())),
            ParameterState::NotChosen => ("not_chosen", false, None, None),
        };
        let (name, unit) = (listed.id.to_string(), listed.id.unit().to_string());
        Self { name, unit, state, has_prior, prior_sigma, reason }
    }
}

/// The parameters of every mode, as text or JSON.
pub(super) fn list(
    robot: &Robot,
    set: &MeasurementSet,
    modes: &[Mode],
    options: &IdentificationOptions,
    json: bool,
) -> Result<String, CalibrateError> {
    let mut lists = Vec::new();
    for &mode in modes.iter().filter(|mode| **mode != Mode::WithoutCalibration) {
        let options = IdentificationOptions { mode, ..options.clone() };
        let listed = list_parameters(&robot.model, set, &options)
            .map_err(|source| CalibrateError::Identify { mode, source })?;
        lists.push((mode, listed));
    }
    if json {
        let modes = lists.iter().map(|(mode, listed)| JsonMode {
            mode: mode.key(),
            parameters: listed.iter().map(JsonListed::of).collect(),
        });
        let list = JsonList { schema: "calibrig.parameters/1", name: &robot.name, modes: modes.collect() };
        // Only strings and numbers: this cannot fail.
        return Ok(serde_json::to_string_pretty(&list).unwrap_or_default() + "\n");
    }
    Ok(lists.iter().map(|(mode, listed)| text_of(*mode, listed)).collect::<Vec<_>>().join("\n"))
}

fn text_of(mode: Mode, listed: &[ListedParameter]) -> String {
    let fitted = listed.iter().filter(|p| matches!(p.state, ParameterState::Fitted { .. })).count();
    let mut text = format!("{} ({}): {fitted} of {} are fitted\n", mode.title(), mode.key(), listed.len());
    let width = listed.iter().map(|p| p.id.to_string().len()).max().unwrap_or(0);
    for parameter in listed {
        let words = match parameter.state {
            ParameterState::Fitted { prior: Some(sigma), .. } => {
                format!("fitted; prior 0 +- {}", shown(parameter.id.unit(), sigma))
            }
            ParameterState::Fitted { has_prior: true, .. } => {
                "fitted; the stated value is a prior".to_owned()
            }
            ParameterState::Fitted { .. } => "fitted".to_owned(),
            ParameterState::LeftOut(reason) => format!("left out: {}", reason.words()),
            ParameterState::NotChosen => "not chosen: fit it with --free".to_owned(),
        };
        // Writing to a String cannot fail.
        let _ = writeln!(text, "  {:<width$}  {words}", parameter.id.to_string());
    }
    text
}

fn shown(unit: Unit, value: f64) -> String {
    match unit {
        Unit::Metre => format!("{} mm", 1e3 * value),
        Unit::Radian => format!("{} mrad", 1e3 * value),
        Unit::One => format!("{} %", 1e2 * value),
    }
}
