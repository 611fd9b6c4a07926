//! What each part of the machine contributes to what the modes leave behind: the same poses and random numbers with one part removed at
//! a time.

use super::{Outcome, PipelineError, SetKind, calibrate, simulate};
use crate::evaluation::AccuracyRow;
use crate::identification::Mode;
use crate::model::{Bearing, LinkTerm, ParameterId, Section, StaticProperties};
use crate::plant::effects::EffectKind;
use crate::scenario::Scenario;

/// A part of the machine that can be removed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// A non-geometric error.
    Effect(EffectKind),
    /// The errors of the elbow's four-bar.
    Linkage,
    /// The errors of link parameters that are not identified.
    Geometry,
    /// The compliance of the drives.
    Drives,
    /// The compliance of the bearings.
    Bearings,
    /// The compliance of links and rod.
    Links,
    /// The errors of the model's stiffnesses and masses.
    Statics,
    /// The tilt of the base against gravity.
    Tilt,
    /// Payload, hoses and forces that the model does not know.
    Loads,
}

impl Part {
    /// All parts, those of the structure first.
    pub fn all() -> Vec<Self> {
        let structure = [
            Self::Linkage,
            Self::Geometry,
            Self::Drives,
            Self::Bearings,
            Self::Links,
            Self::Statics,
            Self::Tilt,
            Self::Loads,
        ];
        structure.into_iter().chain(EffectKind::ALL.map(Self::Effect)).collect()
    }

    /// The key in JSON.
    pub fn key(self) -> &'static str {
        match self {
            Self::Effect(kind) => kind.key(),
            Self::Linkage => "linkage_errors",
            Self::Geometry => "unidentified_geometry",
            Self::Drives => "drive_compliance",
            Self::Bearings => "bearing_compliance",
            Self::Links => "link_compliance",
            Self::Statics => "statics_errors",
            Self::Tilt => "base_tilt",
            Self::Loads => "extra_loads",
        }
    }

    /// Name for people.
    pub fn title(self) -> &'static str {
        match self {
            Self::Effect(kind) => kind.title(),
            Self::Linkage => "four-bar errors",
            Self::Geometry => "geometry not identified",
            Self::Drives => "drive compliance",
            Self::Bearings => "bearing compliance",
            Self::Links => "link flexibility",
            Self::Statics => "stiffness and mass errors",
            Self::Tilt => "base tilt",
            Self::Loads => "extra loads",
        }
    }

    /// What removing it means.
    pub fn removal(self) -> &'static str {
        match self {
            Self::Effect(_) => "the machine without this effect",
            Self::Linkage => "the four-bar has the lengths of the model",
            Self::Geometry => "link parameters that are not identified have the values of the model",
            Self::Drives => "drives rigid in the machine, and nothing predicted for them",
            Self::Bearings => "bearings rigid in the machine, and nothing predicted for them",
            Self::Links => "links and rod rigid in the machine, and nothing predicted for them",
            Self::Statics => "stiffnesses and masses of the machine as in the model",
            Self::Tilt => "gravity has the direction of the model",
            Self::Loads => "only the loads of the model",
        }
    }

    /// The scenario without the part. What is compliant becomes rigid in the machine and in the model alike, since a model that predicts
    /// what is not there would show its own error; everything else changes in the machine alone.
    fn removed(self, scenario: &Scenario, identified: &[ParameterId]) -> Scenario {
        let mut changed = scenario.clone();
        let (machine, model) = (&mut changed.as_built, &mut changed.robot.model);
        let predicted = &mut model.statics;
        match self {
            Self::Effect(kind) => machine.effects = machine.effects.without(kind),
            Self::Linkage => machine.actuators = model.actuators,
            Self::Geometry => {
                let links = machine.kinematics.links.iter_mut().zip(&model.kinematics.links);
                for (link, (real, nominal)) in links.enumerate() {
                    for term in LinkTerm::ALL {
                        if !identified.contains(&ParameterId::link(link, term)) {
                            *real.term_mut(term) = nominal.term(term);
                        }
                    }
                }
            }
            Self::Drives => {
                stiffen(&mut machine.statics, predicted, |s| s.drive_stiffness.fill(f64::INFINITY))
            }
            Self::Bearings => {
                stiffen(&mut machine.statics, predicted, |s| s.bearings.fill(Bearing::default()))
            }
            Self::Links => stiffen(&mut machine.statics, predicted, stiffen_links),
            Self::Statics => {
                if let Some(nominal) = predicted {
                    let real = &mut machine.statics;
                    let (gravity, loads) = (real.gravity, std::mem::take(&mut real.loads));
                    *real = StaticProperties { gravity, loads, ..nominal.clone() };
                }
            }
            Self::Tilt => {
                machine.statics.gravity = predicted.as_ref().map_or(machine.statics.gravity, |s| s.gravity)
            }
            Self::Loads => {
                machine.statics.loads = predicted.as_ref().map_or_else(Vec::new, |s| s.loads.clone());
            }
        }
        changed
    }
}

fn stiffen(
    real: &mut StaticProperties,
    predicted: &mut Option<StaticProperties>,
    rigid: impl Fn(&mut StaticProperties),
) {
    rigid(real);
    predicted.iter_mut().for_each(rigid);
}

fn stiffen_links(statics: &mut StaticProperties) {
    for segment in statics.beams.iter_mut().flatten().flat_map(|beam| &mut beam.segments) {
        // Its weight stays.
        let mass_per_length = segment.section.mass_per_length;
        segment.section = Section { mass_per_length, ..Section::RIGID };
    }
    if let Some(linkage) = &mut statics.linkage {
        linkage.rod_stiffness = f64::INFINITY;
    }
}

/// Rows by mode and set, in the order of [`Ablation::modes`] and [`Ablation::sets`]; `None` for a set without observations.
pub type AblationRows = Vec<Vec<Option<AccuracyRow>>>;

/// A run without one part.
#[derive(Debug, Clone, PartialEq)]
pub struct AblatedPart {
    /// Which.
    pub part: Part,
    /// Its rows, or why there are none.
    pub rows: Result<AblationRows, String>,
}

/// What the parts of a machine contribute.
#[derive(Debug, Clone, PartialEq)]
pub struct Ablation {
    /// In table order.
    pub modes: Vec<Mode>,
    /// Identification first.
    pub sets: Vec<SetKind>,
    /// With everything on.
    pub complete: AblationRows,
    /// One entry a part that the machine has.
    pub parts: Vec<AblatedPart>,
}

impl Ablation {
    /// The rows without a part and with everything on, of a mode and a set by their places.
    pub fn pair(&self, part: &AblatedPart, mode: usize, set: usize) -> Option<(AccuracyRow, AccuracyRow)> {
        let row = |rows: &AblationRows| rows.get(mode)?.get(set).copied().flatten();
        Some((row(part.rows.as_ref().ok()?)?, row(&self.complete)?))
    }
}

/// Repeats the run of `complete`, simulated from `scenario` with `seed`, without one part of the machine at a time.
///
/// Parts that the machine does not have are left out. A run without a part that fails is an entry with the reason. `progress` is told the
/// number of runs done, of all runs, and the part that is removed next.
pub fn ablate(
    scenario: &Scenario,
    seed: u64,
    complete: &Outcome,
    mut progress: impl FnMut(usize, usize, Part),
) -> Ablation {
    let identified: Vec<_> = complete
        .modes
        .iter()
        .find_map(|mode| mode.estimate.as_ref())
        .map(|estimate| estimate.parameters.iter().map(|p| p.id).collect())
        .unwrap_or_default();
    let runs: Vec<_> = Part::all()
        .into_iter()
        .map(|part| (part, part.removed(scenario, &identified)))
        .filter(|(_, changed)| changed.as_built != scenario.as_built)
        .collect();
    let all = runs.len();
    let parts = runs.into_iter().enumerate().map(|(done, (part, changed))| {
        progress(done, all, part);
        AblatedPart { part, rows: rows_of(&changed, seed).map_err(|error| error.to_string()) }
    });
    Ablation {
        modes: complete.modes.iter().map(|mode| mode.mode).collect(),
        sets: complete.sets.iter().map(|set| set.kind).collect(),
        parts: parts.collect(),
        complete: complete.modes.iter().map(|mode| mode.rows.clone()).collect(),
    }
}

fn rows_of(scenario: &Scenario, seed: u64) -> Result<AblationRows, PipelineError> {
    let simulation = simulate(scenario, seed, 0, |_, _| {})?;
    let model = &scenario.robot.model;
    let (_, modes) = calibrate(model, &simulation.sets, &scenario.modes, &scenario.options)?;
    Ok(modes.into_iter().map(|mode| mode.rows).collect())
}
