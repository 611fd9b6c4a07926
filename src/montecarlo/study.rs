//! The part of a campaign that its table is read by, and that fixes it.

use calibrig_campaign::design::Design;
use serde::{Deserialize, Serialize};

use super::{Campaign, TrialColumns};
use crate::scenario::Factor;
use calibrig_estimation::identification::Mode;
use calibrig_model::ParameterId;

/// What a campaign studies: a part of its manifest. Its table is summarised by this alone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Study {
    /// Model of the machine.
    pub plant: String,
    /// Which point a trial is.
    pub design: Design,
    /// What varies.
    pub factors: Vec<Factor>,
    /// Whether every trial draws its own machine from a distribution.
    pub machines_are_drawn: bool,
    /// Error up to which a calibrated robot counts as a success, as the scenario states, m.
    pub tolerance: Option<f64>,
    /// The rows of the tables.
    pub modes: Vec<StudyMode>,
}

/// A mode of a study.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StudyMode {
    /// Its key.
    pub mode: String,
    /// Parameters that have columns.
    pub parameters: Vec<String>,
}

impl Study {
    /// Of a campaign and the columns of its table.
    pub fn of(campaign: &Campaign<'_>, columns: &TrialColumns) -> Self {
        let plan = campaign.scenario.campaign.as_ref();
        let mode = |(mode, parameters): &(Mode, Vec<ParameterId>)| StudyMode {
            mode: mode.key().to_owned(),
            parameters: parameters.iter().map(ToString::to_string).collect(),
        };
        Self {
            plant: campaign.plant.key().to_owned(),
            design: campaign.design.clone(),
            factors: plan.map_or_else(Vec::new, |plan| plan.factors.clone()),
            machines_are_drawn: campaign.scenario.drawn.is_some(),
            tolerance: plan.and_then(|plan| plan.tolerance),
            modes: columns.modes.iter().map(mode).collect(),
        }
    }

    /// The modes, and the parameters, that this program knows.
    pub fn known_modes(&self) -> Vec<(Mode, Vec<ParameterId>)> {
        let known = |mode: &StudyMode| {
            let parameters = mode.parameters.iter().filter_map(|name| ParameterId::parse(name)).collect();
            Some((Mode::ALL.into_iter().find(|known| known.key() == mode.mode)?, parameters))
        };
        self.modes.iter().filter_map(known).collect()
    }
}
