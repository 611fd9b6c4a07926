//! The forward model behind a prediction: the chain of a mode, placed at one observation after the other.

use nalgebra::{Rotation3, Vector3};

use super::Mode;
use crate::elastostatics::{Carried, Deflection, ElasticChain, ElasticError};
use crate::kinematics::{ElbowLinkage, KinematicChain, frames, is_parallelogram, nominal_joints};
use calibrig_model::geometry::Transform;
use calibrig_model::{
    CalibrationModel, CraigLink, FourBar, KinematicModel, ModelError, ParameterId, PoseQuery, TermId,
    TermPlace,
};

/// The robot of a mode: it is given a [model](Self::set_model), [placed](Self::place) at the command of an observation, then asked for the
/// target and, after [`differentiate`](Self::differentiate), for columns of the Jacobian.
#[derive(Debug, Clone)]
pub(super) struct ForwardModel {
    nominal: CalibrationModel,
    kind: Kind,
    terms: Terms,
}

#[derive(Debug, Clone)]
#[allow(clippy::large_enum_variant, reason = "one per fit: another pointer would be followed at every pose")]
enum Kind {
    /// Joints that follow the ideal map of the commands, with the predicted deflection of their drives if there is one.
    Joints { chain: KinematicChain, predicted: Option<ElasticChain>, joints: Vec<f64> },
    /// Joints that follow the `ideal` map, with the `predicted` deflections, which are not in the drives alone.
    Frozen { chain: KinematicChain, ideal: ElasticChain, predicted: ElasticChain },
    /// The robot's own equilibrium, with the linkage closed.
    Elastic { chain: ElasticChain },
}

/// An observation in the form that the forward model needs.
#[derive(Debug, Clone, Default)]
pub(super) struct Prepared {
    /// Joint variables, or commands in the coupled modes.
    command: Vec<f64>,
    /// Motion behind the fixed part of every link, where the deflections do not depend on the parameters.
    motions: Vec<Transform>,
    /// What the flange carries.
    payload: Carried,
    /// Displacement per unit of each term's amplitude.
    basis: Vec<f64>,
}

impl Prepared {
    /// Whether the observation contains what a term acts on; `term` is its position in the order of the terms.
    pub fn tells(&self, term: usize) -> bool {
        self.basis.get(term).is_some_and(|basis| *basis != 0.0)
    }
}

/// Terms, and the places that they displace.
#[derive(Debug, Clone, Default)]
struct Terms {
    ids: Vec<TermId>,
    amplitudes: Vec<f64>,
    /// Index of the place of every term.
    place: Vec<usize>,
    /// Displacement of every place.
    corrections: Vec<(TermPlace, f64)>,
    /// Change of the target per unit of displacement of every place, and per unit of amplitude of every term.
    place_columns: Vec<Vector3<f64>>,
    columns: Vec<Vector3<f64>>,
}

impl ForwardModel {
    /// The forward model of `mode` at the nominal robot, which must be valid, without terms.
    pub fn new(mode: Mode, nominal: &CalibrationModel) -> Self {
        let kind = if mode.is_coupled() {
            Kind::Elastic { chain: ElasticChain::of(nominal) }
        } else {
            let predicted =
                (mode == Mode::WithGravity && nominal.statics.is_some()).then(|| ElasticChain::of(nominal));
            match predicted {
                Some(predicted) if !is_elastic_in_drives_alone(nominal) => {
                    let ideal = ElasticChain::of(&with_ideal_map(nominal));
                    Kind::Frozen { chain: KinematicChain::new(&nominal.kinematics), ideal, predicted }
                }
                predicted => Kind::Joints {
                    chain: KinematicChain::new(&nominal.kinematics),
                    predicted,
                    joints: vec![0.0; nominal.kinematics.joint_count()],
                },
            }
        };
        Self { nominal: nominal.clone(), kind, terms: Terms::default() }
    }

    /// Sets the terms; amplitudes and basis functions are given in their order from now on. Only the coupled modes have terms.
    pub fn set_terms(&mut self, ids: impl Iterator<Item = TermId>) {
        let mut terms = Terms { ids: ids.collect(), ..Terms::default() };
        for id in &terms.ids {
            let known = terms.corrections.iter().position(|(place, _)| *place == id.place());
            terms.place.push(known.unwrap_or(terms.corrections.len()));
            if known.is_none() {
                terms.corrections.push((id.place(), 0.0));
            }
        }
        terms.amplitudes = vec![0.0; terms.ids.len()];
        terms.columns = vec![Vector3::zeros(); terms.ids.len()];
        terms.place_columns = vec![Vector3::zeros(); terms.corrections.len()];
        self.terms = terms;
    }

    /// Checks that a model can replace the nominal one.
    pub fn fits(&self, model: &CalibrationModel) -> Result<(), ModelError> {
        model.check()?;
        if model.kinematics.joint_count() != self.nominal.kinematics.joint_count() {
            return Err(ModelError::Structure { field: "links" });
        }
        match &self.kind {
            Kind::Joints { .. } | Kind::Frozen { .. } => Ok(()),
            Kind::Elastic { chain } => chain.fits(model),
        }
    }

    /// Takes over the values of a model that [fits](Self::fits), and the terms' amplitudes.
    pub fn set_model(&mut self, model: &CalibrationModel, amplitudes: impl Iterator<Item = f64>) {
        match &mut self.kind {
            Kind::Joints { chain, .. } | Kind::Frozen { chain, .. } => chain.set_model(&model.kinematics),
            Kind::Elastic { chain } => chain.take(model),
        }
        for (own, amplitude) in self.terms.amplitudes.iter_mut().zip(amplitudes) {
            *own = amplitude;
        }
    }

    /// Computes what does not change with the parameters for an observation.
    pub fn prepare(&mut self, pose: &PoseQuery<'_>) -> Result<Prepared, ElasticError> {
        let mut told = Prepared { command: pose.command.to_vec(), ..Prepared::default() };
        let payload = Carried::of(pose.payload);
        match &mut self.kind {
            Kind::Joints { predicted, joints, .. } => {
                match predicted {
                    Some(_) => self.nominal.actuators.joints_from_command(pose.command, joints),
                    None => nominal_joints(&self.nominal, pose.command, joints)?,
                }
                if let Some(predicted) = predicted {
                    predicted.carry(payload);
                    predicted.rest(pose.command, &[], Deflection::Equilibrium)?;
                    for (q, deflection) in joints.iter_mut().zip(predicted.deflections()) {
                        *q += deflection;
                    }
                }
                told.command.copy_from_slice(joints);
            }
            Kind::Frozen { ideal, predicted, .. } => {
                predicted.carry(payload);
                predicted.rest(pose.command, &[], Deflection::Equilibrium)?;
                ideal.hold(pose.command, &[], predicted.deflections())?;
                told.motions = motions(&self.nominal.kinematics, ideal.link_frames());
            }
            Kind::Elastic { .. } => {
                told.payload = payload;
                told.basis.extend(self.terms.ids.iter().map(|id| id.basis(&self.nominal, pose)));
            }
        }
        Ok(told)
    }

    /// Moves to the command of the observation.
    pub fn place(&mut self, told: &Prepared) -> Result<(), ElasticError> {
        match &mut self.kind {
            Kind::Joints { chain, .. } => chain.place(&told.command),
            Kind::Frozen { chain, .. } => chain.place_at(&told.motions),
            Kind::Elastic { chain } => {
                self.terms.displace(&told.basis);
                chain.carry(told.payload);
                chain.rest(&told.command, &self.terms.corrections, Deflection::Equilibrium)?;
            }
        }
        Ok(())
    }

    /// [`place`](Self::place) for a pose that was not prepared.
    pub fn place_at(&mut self, pose: &PoseQuery<'_>) -> Result<Prepared, ElasticError> {
        let told = self.prepare(pose)?;
        self.place(&told)?;
        Ok(told)
    }

    /// Position of a target at `in_flange` in the base frame, m.
    pub fn target(&self, in_flange: &Vector3<f64>) -> Vector3<f64> {
        match &self.kind {
            Kind::Joints { chain, .. } | Kind::Frozen { chain, .. } => chain.target(in_flange),
            Kind::Elastic { chain } => chain.target(in_flange),
        }
    }

    /// Prepares the Jacobian's columns for that target.
    pub fn differentiate(&mut self, in_flange: &Vector3<f64>, told: &Prepared) -> Result<(), ElasticError> {
        match &mut self.kind {
            Kind::Joints { .. } | Kind::Frozen { .. } => {}
            Kind::Elastic { chain } => {
                chain.differentiate(in_flange)?;
                self.terms.differentiate(chain, &told.basis);
            }
        }
        Ok(())
    }

    /// Change of the target at `in_base` per unit of a parameter of links, target, compliances, masses or linkage, in the base frame.
    pub fn column(&self, id: ParameterId, in_base: &Vector3<f64>) -> Vector3<f64> {
        match &self.kind {
            Kind::Joints { chain, .. } | Kind::Frozen { chain, .. } => chain.column(id, in_base),
            Kind::Elastic { chain } => chain.change(id),
        }
    }

    /// The rotation of `base_from_flange`.
    pub fn rotation(&self) -> Rotation3<f64> {
        self.base_from_flange().rotation
    }

    /// Prepares the columns of the flange's rotation, in place of those of a target.
    pub fn differentiate_turn(&mut self, told: &Prepared) -> Result<(), ElasticError> {
        match &mut self.kind {
            Kind::Joints { .. } | Kind::Frozen { .. } => {}
            Kind::Elastic { chain } => {
                chain.prepare_turn()?;
                self.terms.differentiate(chain, &told.basis);
            }
        }
        Ok(())
    }

    /// Rotation of the flange per unit of a parameter of links, compliances, masses or linkage: a rotation vector in the base's axes, rad per unit.
    pub fn turn(&self, id: ParameterId) -> Vector3<f64> {
        match &self.kind {
            Kind::Joints { chain, .. } | Kind::Frozen { chain, .. } => chain.turn(id),
            Kind::Elastic { chain } => chain.change(id),
        }
    }

    /// Change of what was prepared per unit of a term's amplitude; `term` is its position in the order of the terms.
    pub fn term_column(&self, term: usize) -> Vector3<f64> {
        self.terms.columns[term]
    }

    /// Change of the target at `in_base`, prepared by [`differentiate`](Self::differentiate), per unit of every command. A deflection that is
    /// predicted from the nominal robot alone is held constant.
    pub fn by_command(
        &self,
        pose: &PoseQuery<'_>,
        in_base: &Vector3<f64>,
        tell: impl FnMut(usize, Vector3<f64>),
    ) {
        self.by_commands(pose, |chain, id| chain.column(id, in_base), tell);
    }

    /// Like [`by_command`](Self::by_command), for the flange's rotation, prepared by [`differentiate_turn`](Self::differentiate_turn), rad per unit.
    pub fn turn_by_command(&self, pose: &PoseQuery<'_>, tell: impl FnMut(usize, Vector3<f64>)) {
        self.by_commands(pose, KinematicChain::turn, tell);
    }

    fn by_commands(
        &self,
        pose: &PoseQuery<'_>,
        of_chain: impl Fn(&KinematicChain, ParameterId) -> Vector3<f64>,
        mut tell: impl FnMut(usize, Vector3<f64>),
    ) {
        let links = &self.nominal.kinematics.links;
        match &self.kind {
            Kind::Joints { chain, .. } | Kind::Frozen { chain, .. } => {
                let mut by_joint: Vec<Vector3<f64>> = (0..links.len())
                    .map(|link| of_chain(chain, ParameterId::Link { link, term: chain.joint_term(link) }))
                    .collect();
                // With a parallelogram, the shoulder's actuator turns the elbow back.
                if let Some(drive) = self.nominal.actuators.elbow() {
                    let elbow = by_joint[drive.elbow];
                    let (by_psi, by_shoulder) = self.closure_rates(pose.command);
                    by_joint[drive.shoulder] += by_shoulder * elbow;
                    by_joint[drive.elbow] = by_psi * elbow;
                }
                for command in 0..links.len() {
                    let moved = by_joint.iter().enumerate();
                    tell(command, moved.map(|(a, by)| self.nominal.actuators.rate(a, command) * by).sum());
                }
            }
            Kind::Elastic { chain } => {
                for command in 0..links.len() {
                    tell(
                        command,
                        chain.change_by_command(command) + self.terms.change(&self.nominal, pose, command),
                    );
                }
            }
        }
    }

    /// Rates of the elbow with psi and with the shoulder, as in [`prepare`](Self::prepare): those of the ideal map where deflections are predicted.
    fn closure_rates(&self, command: &[f64]) -> (f64, f64) {
        let rigid = matches!(self.kind, Kind::Joints { predicted: None, .. });
        let mut positions = command.to_vec();
        self.nominal.actuators.actuators_from_command(command, &mut positions);
        let closes = |(_, elbow, _, linkage): &(usize, usize, f64, &FourBar)| {
            rigid && !is_parallelogram(&self.nominal.kinematics, *elbow, linkage)
        };
        let linkage = self.nominal.actuators.four_bar().filter(closes);
        let linkage = linkage.and_then(|_| {
            ElbowLinkage::new(&self.nominal.kinematics, &self.nominal.actuators).ok().flatten()
        });
        let closure = linkage.and_then(|linkage| linkage.closure(&positions).ok());
        closure.map_or((1.0, -1.0), |closure| (closure.by_psi, closure.by_shoulder))
    }

    /// `base_from_flange`.
    pub fn base_from_flange(&self) -> &Transform {
        match &self.kind {
            Kind::Joints { chain, .. } | Kind::Frozen { chain, .. } => chain.base_from_flange(),
            Kind::Elastic { chain } => chain.base_from_flange(),
        }
    }

    /// `base_from_link` of every link at the observation that was placed last; `kinematics` belongs to the current model.
    pub fn links(&self, told: &Prepared, kinematics: &KinematicModel) -> Vec<Transform> {
        match &self.kind {
            Kind::Joints { .. } => frames(kinematics, &told.command),
            Kind::Frozen { .. } => frames_behind(kinematics, &told.motions),
            Kind::Elastic { chain } => chain.link_frames().to_vec(),
        }
    }
}

/// Step to either side of a command for the slope of a basis function, m or rad: the functions are smooth over far more, and it is above
/// rounding.
const BESIDE: f64 = 1e-6;

impl Terms {
    fn displace(&mut self, basis: &[f64]) {
        for (_, displacement) in &mut self.corrections {
            *displacement = 0.0;
        }
        for ((place, amplitude), basis) in self.place.iter().zip(&self.amplitudes).zip(basis) {
            self.corrections[*place].1 += amplitude * basis;
        }
    }

    /// What terms add to the change by a command: their basis functions change with the command of their own joint.
    fn change(&self, model: &CalibrationModel, pose: &PoseQuery<'_>, command: usize) -> Vector3<f64> {
        let own = self.ids.iter().enumerate().filter(|(_, id)| id.joint() == command);
        let change = |(term, id): (usize, &TermId)| {
            let at = |by: f64| {
                let mut moved = pose.command.to_vec();
                moved[command] += by;
                id.basis(model, &PoseQuery { command: &moved, ..*pose })
            };
            let slope = (at(BESIDE) - at(-BESIDE)) / (2.0 * BESIDE);
            self.amplitudes[term] * slope * self.place_columns[self.place[term]]
        };
        own.map(change).sum()
    }

    fn differentiate(&mut self, chain: &ElasticChain, basis: &[f64]) {
        for (column, (place, _)) in self.place_columns.iter_mut().zip(&self.corrections) {
            *column = chain.change_of_place(*place);
        }
        for ((column, place), basis) in self.columns.iter_mut().zip(&self.place).zip(basis) {
            *column = *basis * self.place_columns[*place];
        }
    }
}

/// The part behind the fixed part of every link of a chain with these `frames` (`base_from_link`).
fn motions(kinematics: &KinematicModel, frames: &[Transform]) -> Vec<Transform> {
    let mut previous = kinematics.base_from_first;
    let links = kinematics.links.iter().zip(frames);
    let motion = |(link, frame): (&CraigLink, &Transform)| {
        let motion = (previous * link.fixed_part()).inverse() * frame;
        previous = *frame;
        motion
    };
    links.map(motion).collect()
}

/// The inverse of [`motions`].
fn frames_behind(kinematics: &KinematicModel, motions: &[Transform]) -> Vec<Transform> {
    let mut base_from_link = kinematics.base_from_first;
    let links = kinematics.links.iter().zip(motions);
    let frame = |(link, motion): (&CraigLink, &Transform)| {
        base_from_link *= link.fixed_part() * motion;
        base_from_link
    };
    links.map(frame).collect()
}

/// Whether only the drives, and the four-bar's rod behind the elbow's drive, are elastic.
fn is_elastic_in_drives_alone(model: &CalibrationModel) -> bool {
    use calibrig_model::Compliance;
    let of_drives = |c: &Compliance| matches!(c, Compliance::Drive { .. } | Compliance::Rod);
    model.compliances().iter().all(of_drives)
}

/// The model with the exact parallelogram in place of the four-bar.
fn with_ideal_map(model: &CalibrationModel) -> CalibrationModel {
    let mut ideal = model.clone();
    ideal.actuators = ideal.actuators.without_linkage();
    ideal
}
