//! The models that can be fitted.

use calibrig_model::ParameterId;
use serde::{Deserialize, Serialize};

/// Which model is fitted: the rows of the published comparison, and two beyond it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// The nominal robot after registration of the tracker.
    WithoutCalibration,
    /// Geometric parameters.
    OnlyCalibration,
    /// Geometric parameters on top of the predicted deflection under gravity.
    WithGravity,
    /// Geometric parameters and compliances, at the equilibrium of the identified robot itself.
    ElastoGeometric,
    /// A complete set of geometric parameters, compliances, the linkage and the terms that are switched on.
    Extended,
}

impl Mode {
    /// All modes, in the order of the tables.
    pub const ALL: [Self; 5] = [
        Self::WithoutCalibration,
        Self::OnlyCalibration,
        Self::WithGravity,
        Self::ElastoGeometric,
        Self::Extended,
    ];

    /// The key in JSON, in topic names and on the command line.
    pub fn key(self) -> &'static str {
        match self {
            Self::WithoutCalibration => "without_calibration",
            Self::OnlyCalibration => "only_calibration",
            Self::WithGravity => "with_gravity",
            Self::ElastoGeometric => "elasto_geometric",
            Self::Extended => "extended",
        }
    }

    /// The title of the mode's row, as published if it was.
    pub fn title(self) -> &'static str {
        match self {
            Self::WithoutCalibration => "without calibration",
            Self::OnlyCalibration => "only calibration",
            Self::WithGravity => "calibration considering gravity",
            Self::ElastoGeometric => "geometry and stiffness",
            Self::Extended => "extended",
        }
    }

    /// The mode of a [`key`](Self::key).
    pub fn parse(key: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|mode| mode.key() == key)
    }

    /// Whether the mode can fit a parameter of this kind.
    pub fn can_fit(self, id: ParameterId) -> bool {
        match id {
            _ if self == Self::WithoutCalibration => false,
            ParameterId::Link { .. }
            | ParameterId::Frame { .. }
            | ParameterId::Target { .. }
            | ParameterId::Orientation { .. }
            | ParameterId::Instrument { .. }
            | ParameterId::Drift { .. } => true,
            ParameterId::Compliance(_) | ParameterId::Mass { .. } | ParameterId::Centre { .. } => {
                self.is_coupled()
            }
            ParameterId::Linkage(_) | ParameterId::Term(_) => self == Self::Extended,
        }
    }

    /// Whether the mode needs masses and stiffnesses.
    pub fn needs_statics(self) -> bool {
        matches!(self, Self::WithGravity | Self::ElastoGeometric)
    }

    /// Whether the robot is predicted at its own equilibrium with its linkage closed, rather than by an ideal map of the commands.
    pub fn is_coupled(self) -> bool {
        matches!(self, Self::ElastoGeometric | Self::Extended)
    }
}
