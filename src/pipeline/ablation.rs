//! What each part of the machine contributes to the remaining errors of the modes: the same poses and random numbers with one part
//! removed at a time.

use super::{ModeOutcome, Outcome, PipelineError, PlantKind, SetKind, calibrate, simulate};
use crate::scenario::Scenario;
use calibrig_estimation::evaluation::AccuracyRow;
use calibrig_estimation::identification::Mode;
use calibrig_model::{Bearing, LinkTerm, ParameterId, Section, StaticProperties};
use calibrig_plant::effects::EffectKind;
use calibrig_plant::tracker::Conditions;

/// A part of the machine and of its measurement that can be removed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MachinePart {
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
    /// Loads, hoses and forces that the model does not know, and differences of payloads from the stated ones.
    Loads,
    /// The errors of the tracker, its air and its stand, of the nests and of the target's offset.
    Instrument,
}

impl MachinePart {
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
            Self::Instrument,
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
            Self::Instrument => "instrument",
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
            Self::Instrument => "instrument",
        }
    }

    /// What removing it means.
    pub fn removal(self) -> &'static str {
        match self {
            Self::Effect(_) => "the machine without this effect",
            Self::Linkage => "the four-bar has the lengths of the model",
            Self::Geometry => "link parameters that are not identified have the values of the model",
            Self::Drives => {
                "drives rigid in the machine, so that they have no load on which lost motion, friction or stiffening could \
                 depend; nothing predicted for them"
            }
            Self::Bearings => "bearings rigid in the machine, and nothing predicted for them",
            Self::Links => "links and rod rigid in the machine, and nothing predicted for them",
            Self::Statics => "stiffnesses and masses of the machine as in the model",
            Self::Tilt => "gravity has the direction of the model",
            Self::Loads => "only the loads of the model",
            Self::Instrument => {
                "the tracker reads exactly, and nests and target are exactly where they are stated to be"
            }
        }
    }

    /// The scenario without the part. Compliant parts become rigid in the machine and in the model alike, because a model that still
    /// predicted them would add its own error; everything else changes only in the machine.
    fn removed(self, scenario: &Scenario, identified: &[ParameterId]) -> Scenario {
        let mut changed = scenario.clone();
        let (machine, model) = (&mut changed.as_built, &mut changed.robot.model);
        let predicted = &mut model.statics;
        match self {
            Self::Effect(kind) => machine.effects = machine.effects.without(kind),
            Self::Linkage => machine.actuators = model.actuators.clone(),
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
                stiffen(&mut machine.statics, predicted, |s| s.drive_stiffness.fill(f64::INFINITY));
            }
            Self::Bearings => {
                stiffen(&mut machine.statics, predicted, |s| s.bearings.fill(Bearing::default()));
            }
            Self::Links => stiffen(&mut machine.statics, predicted, stiffen_links),
            Self::Statics => {
                if let Some(nominal) = predicted {
                    let real = &mut machine.statics;
                    let (gravity, loads) = (real.gravity, std::mem::take(&mut real.loads));
                    *real = StaticProperties { loads, gravity, ..nominal.clone() };
                }
            }
            Self::Tilt => {
                machine.statics.gravity = predicted.as_ref().map_or(machine.statics.gravity, |s| s.gravity);
            }
            Self::Loads => {
                machine.statics.loads = predicted.as_ref().map_or_else(Vec::new, |s| s.loads.clone());
                changed.plan.payloads.make_as_stated();
            }
            Self::Instrument => {
                changed.tracker.instrument.noise = false;
                changed.tracker.conditions = Conditions::default();
                changed.outliers = None;
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
    pub part: MachinePart,
    /// Its rows, or why there are none.
    pub rows: Result<AblationRows, String>,
    /// The modes whose estimate is not sound ([`Estimate::is_sound`](calibrig_estimation::identification::Estimate::is_sound)): their rows need a second look.
    pub doubtful: Vec<Mode>,
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
    /// One entry per part of the machine.
    pub parts: Vec<AblatedPart>,
}

impl Ablation {
    /// The rows without a part and with everything on, for a mode and a set by index.
    pub fn pair(&self, part: &AblatedPart, mode: usize, set: usize) -> Option<(AccuracyRow, AccuracyRow)> {
        let row = |rows: &AblationRows| rows.get(mode)?.get(set).copied().flatten();
        Some((row(part.rows.as_ref().ok()?)?, row(&self.complete)?))
    }
}

/// Repeats the run of `complete`, simulated from `scenario` with `seed`, without one part of the machine at a time.
///
/// Parts that the machine does not have are left out. A run that fails is an entry with the reason. `progress` receives the number of
/// runs done, of all runs, and the part that is removed next.
pub fn ablate(
    scenario: &Scenario,
    seed: u64,
    complete: &Outcome,
    mut progress: impl FnMut(usize, usize, MachinePart),
) -> Ablation {
    let scenario = &*scenario.of_trial(seed, 0);
    let identified: Vec<_> = complete
        .modes
        .iter()
        .find_map(|mode| mode.estimate.as_ref())
        .map(|estimate| estimate.parameters.iter().map(|p| p.id).collect())
        .unwrap_or_default();
    let runs: Vec<_> = MachinePart::all()
        .into_iter()
        .map(|part| (part, part.removed(scenario, &identified)))
        .filter(|(_, changed)| {
            changed.as_built != scenario.as_built || changed.tracker.instrument != scenario.tracker.instrument
        })
        .collect();
    let all = runs.len();
    let parts = runs.into_iter().enumerate().map(|(done, (part, changed))| {
        progress(done, all, part);
        match modes_of(&changed, seed) {
            Ok(modes) => {
                let unsound = |mode: &&ModeOutcome| mode.estimate.as_ref().is_some_and(|e| !e.is_sound());
                let doubtful = modes.iter().filter(unsound).map(|mode| mode.mode).collect();
                AblatedPart { part, rows: Ok(modes.into_iter().map(|mode| mode.rows).collect()), doubtful }
            }
            Err(error) => AblatedPart { part, rows: Err(error.to_string()), doubtful: Vec::new() },
        }
    });
    Ablation {
        modes: complete.modes.iter().map(|mode| mode.mode).collect(),
        sets: complete.sets.iter().map(|set| set.kind).collect(),
        parts: parts.collect(),
        complete: complete.modes.iter().map(|mode| mode.rows.clone()).collect(),
    }
}

fn modes_of(scenario: &Scenario, seed: u64) -> Result<Vec<ModeOutcome>, PipelineError> {
    let simulation = simulate(scenario, seed, 0, PlantKind::Rapier, |_, _| {})?;
    let model = &scenario.robot.model;
    let sets = super::without_drift(simulation.sets)?.sets;
    let (_, modes) = calibrate(model, &sets, &scenario.modes, &scenario.options)?;
    Ok(modes)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::pipeline::run;
    use crate::scenario::load_scenario;
    use calibrig_model::{ActuatorMap, PointLoad};
    use calibrig_plant::effects::{Backlash, Effects, Ratio};
    use nalgebra::Vector3;

    /// The shipped machine, with every part that can be removed but for the other effects.
    fn machine() -> Scenario {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/paper.toml");
        let mut scenario = load_scenario(&path).expect("the shipped scenario");
        (scenario.identification_poses, scenario.verification_poses) = (20, 5);
        let machine = &mut scenario.as_built;
        machine.effects = Effects {
            backlash: Some(Backlash { gap: vec![2e-4; 7] }),
            ratio: Some(Ratio { relative: vec![1e-4; 7] }),
            ..Effects::default()
        };
        machine.kinematics.links[1].beta += 1e-3;
        machine.statics.gravity.x += 0.05;
        let hose = PointLoad {
            name: "hose".to_owned(),
            link: 5,
            at: Vector3::zeros(),
            mass: 3.0,
            force: Vector3::zeros(),
        };
        machine.statics.loads.push(hose);
        if let ActuatorMap::Parallelogram { linkage: Some(linkage), .. } = &mut machine.actuators {
            linkage.rod += 1e-3;
        }
        scenario
    }

    fn identified() -> Vec<ParameterId> {
        vec![ParameterId::link(3, LinkTerm::Theta)]
    }

    #[test]
    fn removing_a_part_changes_what_it_says_and_nothing_else() {
        let full = machine();
        let nominal = full.robot.model.statics.clone().expect("statics");
        for part in MachinePart::all() {
            let without = part.removed(&full, &identified());
            assert_eq!(part.removed(&without, &identified()), without, "{part:?} twice");
            let (mut real, mut model) = (without.as_built.clone(), without.robot.model.clone());
            match part {
                MachinePart::Effect(kind) => {
                    assert!(!real.effects.has(kind));
                    real.effects = full.as_built.effects.clone();
                }
                MachinePart::Linkage => {
                    assert_eq!(real.actuators, model.actuators);
                    assert_ne!(real.actuators, full.as_built.actuators);
                    real.actuators = full.as_built.actuators.clone();
                }
                MachinePart::Geometry => {
                    assert_eq!(real.kinematics.links[1].beta, 0.0);
                    assert_eq!(real.kinematics.links[3].theta, full.as_built.kinematics.links[3].theta);
                    assert_ne!(real.kinematics.links[3].theta, model.kinematics.links[3].theta);
                    real.kinematics = full.as_built.kinematics.clone();
                }
                MachinePart::Drives | MachinePart::Bearings | MachinePart::Links => {
                    let statics = model.statics.take().expect("statics");
                    assert_eq!(statics.drive_stiffness[2].is_infinite(), part == MachinePart::Drives);
                    assert_eq!(statics.bearings[2].stiffness[3].is_infinite(), part == MachinePart::Bearings);
                    let beam = real.statics.beams[2].as_ref().expect("the upper arm's");
                    assert_eq!(beam.segments[0].section.torsion.is_infinite(), part == MachinePart::Links);
                    assert!(beam.segments[0].section.mass_per_length > 0.0);
                    assert_eq!(real.statics.bodies, full.as_built.statics.bodies);
                    real.statics = full.as_built.statics.clone();
                    model.statics = Some(nominal.clone());
                }
                MachinePart::Statics => {
                    assert_eq!(real.statics.drive_stiffness, nominal.drive_stiffness);
                    assert_eq!(real.statics.bodies, nominal.bodies);
                    assert_eq!(real.statics.loads, full.as_built.statics.loads);
                    assert_eq!(real.statics.gravity, full.as_built.statics.gravity);
                    real.statics = full.as_built.statics.clone();
                }
                MachinePart::Tilt => {
                    assert_eq!(real.statics.gravity, nominal.gravity);
                    real.statics.gravity = full.as_built.statics.gravity;
                }
                MachinePart::Loads => {
                    assert_eq!(real.statics.loads, nominal.loads);
                    real.statics.loads.clone_from(&full.as_built.statics.loads);
                }
                MachinePart::Instrument => {
                    assert!(!without.tracker.instrument.noise && full.tracker.instrument.noise);
                }
            }
            assert_eq!(without.tracker == full.tracker, part != MachinePart::Instrument, "{part:?}");
            assert_eq!((real, model), (full.as_built.clone(), full.robot.model.clone()), "{part:?}");
        }
    }

    #[test]
    fn the_rows_without_an_effect_are_those_of_a_machine_that_never_had_it() {
        let mut scenario = machine();
        let outcome = run(&scenario, 3, |_, _| {}).expect("a run");
        let mut told = Vec::new();
        let ablation = ablate(&scenario, 3, &outcome, |done, all, part| told.push((done, all, part)));
        let removed: Vec<_> = ablation.parts.iter().map(|part| part.part).collect();
        assert!(!removed.contains(&MachinePart::Effect(EffectKind::Thermal)), "it has none");
        assert_eq!(told.iter().map(|t| t.2).collect::<Vec<_>>(), removed);
        assert_eq!(told[1].0, 1);
        for (rows, mode) in ablation.complete.iter().zip(&outcome.modes) {
            assert_eq!(*rows, mode.rows);
        }
        scenario.as_built.effects.backlash = None;
        let never = run(&scenario, 3, |_, _| {}).expect("a run");
        let part = ablation.parts.iter().find(|part| part.part == MachinePart::Effect(EffectKind::Backlash));
        let part = part.expect("it has backlash");
        let rows = part.rows.clone().expect("rows");
        for mode in &never.modes {
            let sound =
                mode.estimate.as_ref().is_none_or(calibrig_estimation::identification::Estimate::is_sound);
            assert_eq!(part.doubtful.contains(&mode.mode), !sound);
        }
        for (mode, rows) in rows.iter().enumerate() {
            assert_eq!(*rows, never.modes[mode].rows);
            assert_ne!(*rows, outcome.modes[mode].rows);
        }
    }

    #[test]
    fn a_run_that_fails_is_told_with_its_reason() {
        let scenario = machine();
        let mut outcome = run(&scenario, 3, |_, _| {}).expect("a run");
        outcome.modes.truncate(1);
        let mut few = scenario.clone();
        few.identification_poses = 2;
        let ablation = ablate(&few, 3, &outcome, |_, _, _| {});
        assert!(ablation.parts.iter().all(|part| part.rows.as_ref().is_err_and(|why| !why.is_empty())));
        assert!(ablation.pair(&ablation.parts[0], 0, 0).is_none());
    }
}
