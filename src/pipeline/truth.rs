//! The true values of the identified parameters, if a simulation knows them.

use nalgebra::{Rotation3, UnitQuaternion, Vector3, Vector6};

use calibrig_estimation::identification::Estimate;
use calibrig_model::geometry::{Transform, rotation_vector, small_displacement};
use calibrig_model::measurement::{InstrumentTerm, Target};
use calibrig_model::{
    CalibrationModel, Compliance, JointKind, LinkTerm, ParameterId, PoseQuery, StaticProperties, TermId,
    TermPlace,
};
use calibrig_plant::effects::{Rail, RailProfile};
use calibrig_plant::{AsBuilt, SettledPose};

/// The truth, with what was known beforehand.
#[derive(Debug, Clone, Copy)]
pub struct KnownTruth<'a> {
    /// The machine.
    pub as_built: &'a AsBuilt,
    /// What identification knew.
    pub nominal: &'a CalibrationModel,
    /// `tracker_from_base` of every station.
    pub stations: &'a [Transform],
    /// Errors of the readings of the one instrument that all stations have, m, rad or 1; empty if unknown.
    pub instrument: &'a [(InstrumentTerm, f64)],
    /// Real offsets of the targets besides the machine's own, in the flange frame, m.
    pub further_targets: &'a [Vector3<f64>],
    /// `flange_from_target` of the first target, if it has axes.
    pub orientation: Option<Rotation3<f64>>,
    /// As stated to identification.
    pub targets: &'a [Target],
    /// The machine at rest in the poses of the identification set, whose loads determine the equivalent stiffness of a stiffening drive.
    pub settled: &'a [SettledPose],
}

impl KnownTruth<'_> {
    /// The true value of the parameter, SI; `None` if the truth is unknown or has no counterpart.
    ///
    /// - link, four-bar: as-built minus nominal; for an actuator's own theta or d, plus its encoder's offset and, if the estimate has the term of its
    ///   ratio, that error in the middle of the travel; compliance, mass: as-built over nominal, minus one. The compliance of a stiffening drive is
    ///   that of its secant at the mean size of its load over the identification set, `None` if no pose shows it;
    /// - term: the amplitude of the machine's effect of that shape; zero if it has none;
    /// - frame: the estimate holds `station = prior · exp(value)` for the station's six components (absent ones are zero), so the prior
    ///   is recovered exactly and the truth is the `xi` of `prior · exp(xi) = tracker_from_base`;
    /// - target: as-built minus stated offset; of the first, what turns the stated orientation to the real one;
    /// - instrument: its error to first order. A tracker's motion is not steady, so a drift has no truth.
    pub fn of(&self, estimate: &Estimate, id: ParameterId) -> Option<f64> {
        let value = match id {
            ParameterId::Link { link, term } => Some(self.link(id)? + self.zero_error(estimate, link, term)),
            ParameterId::Frame { station, component } => {
                self.frame(estimate, station)?.get(component).copied()
            }
            ParameterId::Target { target, axis } => {
                let real = match target.checked_sub(1) {
                    None => &self.as_built.target,
                    Some(further) => self.further_targets.get(further)?,
                };
                Some(real.get(axis)? - self.targets.get(target)?.in_flange.get(axis)?)
            }
            ParameterId::Orientation { target: 0, axis } => {
                let [stated] = self.targets else { return None };
                let stated = stated.orientation.as_ref()?.flange_from_target;
                // By a quaternion: without a known orientation, the two may be half a turn apart.
                let off = UnitQuaternion::from_rotation_matrix(&(stated.inverse() * self.orientation?));
                off.scaled_axis().get(axis).copied()
            }
            ParameterId::Compliance(compliance) => {
                let stated = self.nominal.statics.as_ref()?.stiffness(compliance)?;
                let real = match compliance {
                    Compliance::Drive { joint } => self.as_built.secant_stiffness(joint, self.settled)?,
                    _ => self.as_built.statics.stiffness(compliance)?,
                };
                Some(stated / real - 1.0)
            }
            ParameterId::Mass { link } => {
                let mass = |statics: &StaticProperties| Some(statics.bodies.get(link)?.mass);
                Some(mass(&self.as_built.statics)? / mass(self.nominal.statics.as_ref()?)? - 1.0)
            }
            ParameterId::Centre { link, axis } => {
                let centre =
                    |statics: &StaticProperties| statics.bodies.get(link)?.centre_of_mass.get(axis).copied();
                Some(centre(&self.as_built.statics)? - centre(self.nominal.statics.as_ref()?)?)
            }
            ParameterId::Linkage(term) => Some(
                self.as_built.actuators.linkage_term(term)? - self.nominal.actuators.linkage_term(term)?,
            ),
            ParameterId::Term(term) => self.term(term),
            ParameterId::Instrument { instrument: 0, term } => {
                self.instrument.iter().find(|(own, _)| *own == term).map(|(_, amplitude)| *amplitude)
            }
            ParameterId::Orientation { .. } | ParameterId::Instrument { .. } | ParameterId::Drift { .. } => {
                None
            }
        };
        value.filter(|v| v.is_finite())
    }

    /// As-built minus nominal link parameter, m or rad.
    pub fn link(&self, id: ParameterId) -> Option<f64> {
        let ParameterId::Link { link, term } = id else { return None };
        let as_built = self.as_built.kinematics.links.get(link)?;
        let nominal = self.nominal.kinematics.links.get(link)?;
        Some(as_built.term(term) - nominal.term(term))
    }

    /// The truth of all parameters of an estimate in their order, SI; `None` if that of one is unknown.
    pub fn values(&self, estimate: &Estimate) -> Option<Vec<f64>> {
        estimate.parameters.iter().map(|p| self.of(estimate, p.id)).collect()
    }

    /// The machine's effects on the zero of an actuator that has this link parameter as its own variable, m or rad.
    fn zero_error(&self, estimate: &Estimate, link: usize, term: LinkTerm) -> f64 {
        let own = match self.nominal.kinematics.links.get(link).map(|link| link.kind) {
            Some(JointKind::Revolute) => LinkTerm::Theta,
            Some(JointKind::Prismatic) => LinkTerm::D,
            None => return 0.0,
        };
        if term != own {
            return 0.0;
        }
        // The elbow's motor is on the waist: an error of the shoulder is undone at the elbow by the parallelogram, but the shoulder's own theta
        // turns both.
        let zero = |actuator: usize| -> f64 {
            let commands = 0..self.nominal.kinematics.joint_count();
            commands
                .map(|command| (self.nominal.actuators.rate(actuator, command), command))
                .filter(|(rate, _)| *rate != 0.0)
                .map(|(rate, command)| rate * self.actuator_zero(estimate, command))
                .sum()
        };
        let shoulder = match self.nominal.actuators.elbow() {
            Some(drive) if drive.elbow == link => zero(drive.shoulder),
            _ => 0.0,
        };
        zero(link) - shoulder
    }

    /// The constant error of an actuator.
    fn actuator_zero(&self, estimate: &Estimate, actuator: usize) -> f64 {
        let effects = &self.as_built.effects;
        let ratio = effects.ratio.as_ref().and_then(|ratio| {
            let is_its_own = |term: &TermId| term.family().key() == "ratio" && term.joint() == actuator;
            let term = estimate.robot.terms.iter().map(|(term, _)| *term).find(is_its_own)?;
            let [low, high] = travel_of(term, self.nominal)?;
            Some(ratio.relative.get(actuator)? * 0.5 * (low + high))
        });
        self.encoder_offset(actuator) + ratio.unwrap_or(0.0)
    }

    fn encoder_offset(&self, actuator: usize) -> f64 {
        let encoder = self.as_built.effects.encoder.as_ref();
        encoder.and_then(|encoder| encoder.offset.get(actuator).copied()).unwrap_or(0.0)
    }

    /// The amplitude of the term with the shape of the machine's effect, m or rad; `None` if its effect of that kind has another shape.
    fn term(&self, term: TermId) -> Option<f64> {
        let effects = &self.as_built.effects;
        effects.check(self.nominal.kinematics.joint_count(), true).ok()?;
        match (term.family().key(), term.place()) {
            ("hysteresis", TermPlace::Actuator(actuator)) => {
                // A flank decided by the load is not a multiple of the approach's sign, nor is friction behind a stiffening spring.
                let has = |values: &[f64]| values.get(actuator).is_some_and(|value| *value > 0.0);
                if effects.lost_motion.as_ref().is_some_and(|lost| has(&lost.gap)) {
                    return None;
                }
                let stiffens = effects.stiffening.as_ref().is_some_and(|s| s.actuators[actuator].is_some());
                if stiffens && effects.friction.as_ref().is_some_and(|friction| has(&friction.constant)) {
                    return None;
                }
                let stiffness = *self.as_built.statics.drive_stiffness.get(actuator)?;
                let lag = effects
                    .friction
                    .as_ref()
                    .map_or(Some(0.0), |friction| friction.lag(actuator, stiffness))?;
                let gap =
                    effects.backlash.as_ref().map_or(Some(&0.0), |backlash| backlash.gap.get(actuator))?;
                Some(0.0 - 0.5 * gap - lag)
            }
            ("harmonic", TermPlace::Actuator(actuator)) => {
                let harmonic =
                    effects.harmonics.as_ref().and_then(|harmonics| *harmonics.actuators.get(actuator)?);
                let Some(harmonic) = harmonic else { return Some(0.0) };
                let turns = self.nominal.motor_turns.get(actuator).copied().flatten()?;
                if harmonic.amplitude != [0.0; 2] && (harmonic.turns / turns - 1.0).abs() > 1e-9 {
                    return None;
                }
                // Equidistant points of one turn are orthogonal for all waves used here.
                let points = (0..16).map(|k| (f64::from(k) / 16.0 / turns, 1.0));
                let offset = self.encoder_offset(actuator);
                projection(term, self.nominal, points, |command| harmonic.error(command + offset))
            }
            ("ratio", TermPlace::Actuator(actuator)) => {
                let Some(ratio) = &effects.ratio else { return Some(0.0) };
                let [low, high] = travel_of(term, self.nominal)?;
                Some(ratio.relative.get(actuator)? * 0.5 * (high - low))
            }
            ("rail", TermPlace::Frame { joint, component }) => {
                let Some(rail) = effects.rail.as_ref().filter(|rail| rail.joint == joint) else {
                    return Some(0.0);
                };
                let limits = self.nominal.kinematics.links.get(joint)?.limits;
                let length = limits[1] - limits[0];
                if rail.range.iter().zip(limits).any(|(a, b)| !((a - b).abs() <= 1e-9 * length)) {
                    return None;
                }
                // The wave is left out: no polynomial of low order contains it.
                let smooth = without_wave(rail);
                let points =
                    gauss_legendre().map(|(x, weight)| (0.5 * (limits[0] + limits[1] + x * length), weight));
                projection(term, self.nominal, points, |position| smooth.displacement(position)[component])
            }
            _ => None,
        }
    }

    fn frame(&self, estimate: &Estimate, index: usize) -> Option<Vector6<f64>> {
        let (station, real) = (estimate.robot.stations.get(index)?, self.stations.get(index)?);
        let xi = Vector6::from_iterator((0..6).map(|component| {
            estimate.value(ParameterId::Frame { station: index, component }).unwrap_or(0.0)
        }));
        let prior = station * small_displacement(&xi).inverse();
        let displacement = prior.inverse() * real;
        let (along, about) = (displacement.translation.vector, rotation_vector(&displacement.rotation));
        Some(Vector6::new(along.x, along.y, along.z, about.x, about.y, about.z))
    }
}

/// The coefficient of the term in `effect`, a function of its actuator's command, by least squares over weighted `points`.
fn projection(
    term: TermId,
    model: &CalibrationModel,
    points: impl Iterator<Item = (f64, f64)>,
    effect: impl Fn(f64) -> f64,
) -> Option<f64> {
    let (mut product, mut square) = (0.0, 0.0);
    for (command, weight) in points {
        let basis = basis_at(term, model, command);
        product += weight * basis * effect(command);
        square += weight * basis * basis;
    }
    (square > 0.0).then_some(product / square)
}

/// The term's displacement per unit of amplitude with its own actuator at `command`.
fn basis_at(term: TermId, model: &CalibrationModel, command: f64) -> f64 {
    let mut commands = vec![0.0; model.kinematics.joint_count()];
    if let Some(own) = commands.get_mut(term.joint()) {
        *own = command;
    }
    term.basis(model, &PoseQuery::at(&commands))
}

/// The commands at which a term that is linear in the command of its actuator is -1 and 1.
fn travel_of(term: TermId, model: &CalibrationModel) -> Option<[f64; 2]> {
    let at_zero = basis_at(term, model, 0.0);
    let slope = basis_at(term, model, 1.0) - at_zero;
    (slope > 0.0).then(|| [-1.0, 1.0].map(|end| (end - at_zero) / slope))
}

fn without_wave(rail: &Rail) -> Rail {
    let smooth = |profile: &RailProfile| RailProfile { wave: 0.0, ..profile.clone() };
    Rail {
        horizontal_error: smooth(&rail.horizontal_error),
        vertical_error: smooth(&rail.vertical_error),
        roll: smooth(&rail.roll),
        pitch: smooth(&rail.pitch),
        yaw: smooth(&rail.yaw),
        ..rail.clone()
    }
}

/// Points and weights of the Gauss-Legendre quadrature of five points, exact to order nine.
///
/// Source: M. Abramowitz, I. A. Stegun, "Handbook of Mathematical Functions" (1964), equation 25.4.29.
fn gauss_legendre() -> impl Iterator<Item = (f64, f64)> {
    let root = 2.0 * (10.0_f64 / 7.0).sqrt();
    let (near, far) = ((5.0 - root).sqrt() / 3.0, (5.0 + root).sqrt() / 3.0);
    let share = 13.0 * 70.0_f64.sqrt();
    let (inner, outer) = ((322.0 + share) / 900.0, (322.0 - share) / 900.0);
    [(-far, outer), (-near, inner), (0.0, 128.0 / 225.0), (near, inner), (far, outer)].into_iter()
}
