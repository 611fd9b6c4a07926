//! What a robot's file, a URDF or a table of offsets keeps of an identified robot, and what it loses against the full prediction, at poses that were
//! not fitted.

use nalgebra::{DMatrix, DVector, Rotation3, Vector3};
use rand::RngExt;
use serde::Serialize;

use super::{HandoverError, Region};
use calibrig_estimation::identification::{CalibratedRobot, Mode, PredictionError, Predictor};
use calibrig_model::geometry::Transform;
use calibrig_model::random::{StreamSource, stream_at};
use calibrig_model::{CalibrationModel, PoseQuery};

/// Poses to which offsets are fitted, and others at which all losses are evaluated.
const FITTED: usize = 200;
const HELD_OUT: usize = 400;
/// Draws per wanted pose: poses that the robot cannot reach are drawn again.
const TRIES: usize = 5;

/// A pose and the target's place in the full model.
#[derive(Debug, Clone)]
pub(super) struct Known {
    command: Vec<f64>,
    approach: Vec<i8>,
    /// m
    place: Vector3<f64>,
}

/// Poses within the region of an estimate.
#[derive(Debug, Clone)]
pub(super) struct Poses {
    pub fitted: Vec<Known>,
    pub held_out: Vec<Known>,
}

/// Errors of a form of the robot against the full model, m.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Loss {
    /// Root mean square along the base's axes.
    pub rms_m: [f64; 3],
    /// Largest along the base's axes.
    pub max_m: [f64; 3],
    /// Root mean square of the distance.
    pub rms_3d_m: f64,
    /// Largest distance.
    pub max_3d_m: f64,
    /// Poses.
    pub poses: usize,
}

impl Loss {
    fn of(errors: &[Vector3<f64>]) -> Self {
        let count = errors.len().max(1) as f64;
        let squares = errors.iter().map(|error| error.component_mul(error)).sum::<Vector3<f64>>() / count;
        let max = errors.iter().fold(Vector3::zeros(), |max: Vector3<f64>, error| max.sup(&error.abs()));
        Self {
            rms_m: squares.map(f64::sqrt).into(),
            max_m: max.into(),
            rms_3d_m: squares.sum().sqrt(),
            max_3d_m: errors.iter().map(Vector3::norm).fold(0.0, f64::max),
            poses: errors.len(),
        }
    }
}

impl Poses {
    /// Draws poses between the lowest and highest commands of a region, from both sides if these are known; the same for the same region.
    pub fn draw(robot: &CalibratedRobot, region: &Region) -> Result<Self, HandoverError> {
        let mut predictor = Predictor::new(robot)?;
        let bounds: Vec<_> = region.command_min.iter().zip(&region.command_max).collect();
        let wanted = FITTED + HELD_OUT;
        let mut known = Vec::new();
        let mut refusal = None;
        for index in 0..TRIES * wanted {
            if known.len() == wanted {
                break;
            }
            let mut random = stream_at(0, 0, StreamSource::Handover, index as u64);
            let mut within = |(low, high): &(&f64, &f64)| **low + (**high - **low) * random.random::<f64>();
            let command: Vec<f64> = bounds.iter().map(&mut within).collect();
            let side = |_: &(&f64, &f64)| if random.random::<bool>() { 1 } else { -1 };
            let approach: Vec<i8> =
                if region.approached { bounds.iter().map(side).collect() } else { Vec::new() };
            match predictor.in_base(PoseQuery::at(&command).approached(&approach)) {
                // The rest are squares.
                Ok(place) if !place.norm_squared().is_finite() => {}
                Ok(place) => known.push(Known { command, approach, place }),
                Err(error) => refusal = Some(error),
            }
        }
        if known.len() < wanted {
            return Err(HandoverError::Region { found: known.len(), wanted, why: refusal.map(Box::new) });
        }
        let held_out = known.split_off(FITTED);
        Ok(Self { fitted: known, held_out })
    }

    /// What a robot without terms loses.
    pub fn loss(&self, robot: &CalibratedRobot) -> Result<Loss, HandoverError> {
        let mut predictor = Predictor::new(robot)?;
        let error = |known: &Known| {
            let pose = PoseQuery::at(&known.command).approached(&known.approach);
            predictor.in_base(pose).map(|place| place - known.place)
        };
        Ok(Loss::of(&self.held_out.iter().map(error).collect::<Result<Vec<_>, _>>()?))
    }
}

/// A robot without terms whose target is the first one of `of`.
pub(super) fn robot_of(model: &CalibrationModel, mode: Mode, of: &CalibratedRobot) -> CalibratedRobot {
    CalibratedRobot {
        mode,
        nominal: model.clone(),
        model: model.clone(),
        terms: Vec::new(),
        stations: Vec::new(),
        targets: of.targets.iter().take(1).copied().collect(),
        instruments: Vec::new(),
        orientations: Vec::new(),
    }
}

/// The rigid chain of a model, with its joints where the ideal map of the commands has them.
pub(super) fn rigid(model: &CalibrationModel, of: &CalibratedRobot) -> CalibratedRobot {
    let mut ideal = model.clone();
    ideal.statics = None;
    ideal.actuators = ideal.actuators.without_linkage();
    robot_of(&ideal, Mode::OnlyCalibration, of)
}

/// Corrections for a controller that accepts only its own link parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Offsets {
    /// What is added to every command before the nominal kinematics, m or rad.
    pub commands: Vec<f64>,
    /// The tool in the nominal flange, m.
    pub tool: Vector3<f64>,
    /// Where the nominal robot's base is in the base.
    pub base_from_nominal: Transform,
    /// The losses.
    pub loss: Loss,
}

/// Which of the offsets are fitted, besides the tool's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Free {
    pub joints: bool,
    pub frame: bool,
}

/// The offsets of the nominal, rigid robot that bring the tool nearest to its place in the full model: least squares by Gauss and Newton, the
/// smallest among equivalent ones.
pub(super) fn fit_offsets(
    nominal: &CalibrationModel,
    full: &CalibratedRobot,
    poses: &Poses,
    free: Free,
) -> Result<Offsets, HandoverError> {
    let robot = rigid(nominal, full);
    let mut reduced =
        Reduced { predictor: Predictor::new(&robot)?, last_from_flange: nominal.kinematics.last_from_flange };
    let joints = nominal.kinematics.joint_count();
    let scale = nominal.kinematics.characteristic_length();
    let tool = full.targets.first().copied().unwrap_or_default();
    let mut offsets = Offsets {
        commands: vec![0.0; joints],
        tool,
        base_from_nominal: Transform::identity(),
        loss: Loss::of(&[]),
    };
    let moved = |joint: &usize| free.joints && nominal.actuators.is_commanded(*joint);
    let moved: Vec<usize> = (0..joints).filter(moved).collect();
    let columns = moved.len() + 3 + if free.frame { 6 } else { 0 };
    for _ in 0..ITERATIONS {
        let mut jacobian = DMatrix::zeros(3 * poses.fitted.len(), columns);
        let mut residuals = DVector::zeros(3 * poses.fitted.len());
        for (row, known) in poses.fitted.iter().enumerate() {
            let at = reduced.place(&offsets, known)?;
            residuals.fixed_rows_mut::<3>(3 * row).copy_from(&(known.place - at.place));
            for (column, joint) in moved.iter().enumerate() {
                let derivative = reduced.derivative(&offsets, known, *joint)?;
                jacobian.fixed_view_mut::<3, 1>(3 * row, column).copy_from(&derivative);
            }
            jacobian.fixed_view_mut::<3, 3>(3 * row, moved.len()).copy_from(at.turned.matrix());
            if free.frame {
                let frame = moved.len() + 3;
                jacobian.fixed_view_mut::<3, 3>(3 * row, frame).fill_with_identity();
                // Angles are scaled by the robot's size, so that the smallest change is measured as a length.
                let turning = -at.place.cross_matrix() / scale;
                jacobian.fixed_view_mut::<3, 3>(3 * row, frame + 3).copy_from(&turning);
            }
        }
        // The decomposition would not terminate.
        if !jacobian.iter().chain(&residuals).all(|value| value.is_finite()) {
            return Err(HandoverError::Offsets);
        }
        let triangular = jacobian.qr();
        triangular.q_tr_mul(&mut residuals);
        let decomposed = triangular.r().svd(true, true);
        let least = SMALLEST * decomposed.singular_values.max();
        let shown = residuals.rows(0, columns).into_owned();
        let step = decomposed.solve(&shown, least).map_err(|_| HandoverError::Offsets)?;
        for (joint, change) in moved.iter().zip(step.iter()) {
            offsets.commands[*joint] += change;
        }
        offsets.tool += step.fixed_rows::<3>(moved.len());
        if free.frame {
            let by = step.fixed_rows::<6>(moved.len() + 3);
            let turn = Rotation3::new(by.fixed_rows::<3>(3) / scale);
            let place = by.fixed_rows::<3>(0).into_owned();
            offsets.base_from_nominal = Transform::from_parts(place.into(), turn) * offsets.base_from_nominal;
        }
        if !step.iter().all(|change| change.is_finite()) {
            return Err(HandoverError::Offsets);
        }
        if step.amax() < AT_REST {
            break;
        }
    }
    let error = |known: &Known| reduced.place(&offsets, known).map(|at| at.place - known.place);
    let errors = poses.held_out.iter().map(error).collect::<Result<Vec<_>, _>>()?;
    offsets.loss = Loss::of(&errors);
    Ok(offsets)
}

const ITERATIONS: usize = 30;
/// Singular values below this share of the largest belong to combinations without effect.
const SMALLEST: f64 = 1e-9;
/// A step below this (m, rad) is the last.
const AT_REST: f64 = 1e-12;
/// Step of finite differences, m or rad: for a rigid chain they are exact to 1e-11 of its size.
const STEP: f64 = 1e-5;

/// The nominal robot with offsets.
struct Reduced<'a> {
    predictor: Predictor<'a>,
    last_from_flange: Transform,
}

/// The tool's place in the base, and the flange's orientation there.
struct Placed {
    place: Vector3<f64>,
    turned: Rotation3<f64>,
}

impl Reduced<'_> {
    fn place(&mut self, offsets: &Offsets, known: &Known) -> Result<Placed, PredictionError> {
        let command: Vec<f64> =
            known.command.iter().zip(&offsets.commands).map(|(c, offset)| c + offset).collect();
        self.at(offsets, &command)
    }

    fn at(&mut self, offsets: &Offsets, command: &[f64]) -> Result<Placed, PredictionError> {
        let last = self.predictor.links(command)?.pop().unwrap_or_else(Transform::identity);
        let flange = offsets.base_from_nominal * last * self.last_from_flange;
        Ok(Placed {
            place: flange.rotation * offsets.tool + flange.translation.vector,
            turned: flange.rotation,
        })
    }

    /// Of the tool with respect to a command, by central differences.
    fn derivative(
        &mut self,
        offsets: &Offsets,
        known: &Known,
        joint: usize,
    ) -> Result<Vector3<f64>, PredictionError> {
        let mut side = |step: f64| {
            let mut moved = offsets.clone();
            moved.commands[joint] += step;
            self.place(&moved, known).map(|at| at.place)
        };
        Ok((side(STEP)? - side(-STEP)?) / (2.0 * STEP))
    }
}
