//! The weighted residuals of a measurement set, and their Jacobian.

use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3, Vector6};

use super::LeastSquares;
use crate::geometry::{Transform, cross_matrix, small_displacement};
use crate::kinematics::PlacedChain;
use crate::model::{KinematicModel, ParameterId};

/// One observation, ready for the fit.
#[derive(Debug, Clone)]
pub(super) struct Row {
    /// Measured position in the tracker's frame, m.
    pub seen: Vector3<f64>,
    /// Inverse Cholesky factor of its covariance: turns a difference in metres into standard deviations.
    pub whitening: Matrix3<f64>,
    pub station: usize,
    pub target: usize,
}

/// A Gaussian prior on consecutive parameters, zero mean.
#[derive(Debug, Clone)]
pub(super) struct Prior {
    /// Column of its first parameter.
    pub column: usize,
    /// Inverse Cholesky factor of its covariance.
    pub whitening: DMatrix<f64>,
}

/// Observations, priors and the model that joins them. All memory is taken when it is made; [`evaluate`](LeastSquares::evaluate)
/// takes none.
#[derive(Debug, Clone)]
pub(super) struct CalibrationProblem {
    pub nominal: KinematicModel,
    pub parameters: Vec<ParameterId>,
    /// Joint variables of every observation, deflection included, one after the other.
    pub joints: Vec<f64>,
    pub rows: Vec<Row>,
    pub priors: Vec<Prior>,
    /// One over the standard deviation of the first parameters' own priors.
    pub tolerances: Vec<f64>,
    /// `tracker_from_base` that the frame parameters displace.
    pub stations: Vec<Transform>,
    /// Offsets that the target parameters change.
    pub targets: Vec<Vector3<f64>>,
    pub current: Current,
}

/// The model at the parameters of one evaluation.
#[derive(Debug, Clone)]
pub(super) struct Current {
    pub kinematics: KinematicModel,
    pub stations: Vec<Transform>,
    pub targets: Vec<Vector3<f64>>,
    displacements: Vec<Vector6<f64>>,
    chain: PlacedChain,
}

impl Current {
    pub fn new(nominal: &KinematicModel, stations: &[Transform], targets: &[Vector3<f64>]) -> Self {
        Self {
            kinematics: nominal.clone(),
            stations: stations.to_vec(),
            targets: targets.to_vec(),
            displacements: vec![Vector6::zeros(); stations.len()],
            chain: PlacedChain::new(nominal),
        }
    }
}

impl CalibrationProblem {
    /// Puts the current model at `x`.
    pub fn set(&mut self, x: &[f64]) {
        let now = &mut self.current;
        for (link, nominal) in now.kinematics.links.iter_mut().zip(&self.nominal.links) {
            for term in crate::model::LinkTerm::ALL {
                *link.term_mut(term) = nominal.term(term);
            }
        }
        now.targets.copy_from_slice(&self.targets);
        now.displacements.fill(Vector6::zeros());
        for (id, &value) in self.parameters.iter().zip(x) {
            match *id {
                ParameterId::Link { .. } => now.kinematics.add(*id, value),
                ParameterId::Frame { station, component } => now.displacements[station][component] = value,
                ParameterId::Target { target, axis } => now.targets[target][axis] += value,
                ParameterId::Compliance(_)
                | ParameterId::Mass { .. }
                | ParameterId::Linkage(_)
                | ParameterId::Term(_) => {}
            }
        }
        now.chain.set_model(&now.kinematics);
        for ((station, origin), xi) in now.stations.iter_mut().zip(&self.stations).zip(&now.displacements) {
            *station = origin * small_displacement(xi);
        }
    }

    fn fill_observation(
        &mut self,
        index: usize,
        residuals: &mut DVector<f64>,
        jacobian: Option<&mut DMatrix<f64>>,
    ) {
        let row = &self.rows[index];
        let now = &mut self.current;
        let joints = self.nominal.joint_count();
        now.chain.place(&self.joints[index * joints..(index + 1) * joints]);
        let in_base = now.chain.target(&now.targets[row.target]);
        let tracker_from_base = &now.stations[row.station];
        let predicted = tracker_from_base.rotation * in_base + tracker_from_base.translation.vector;
        residuals.fixed_rows_mut::<3>(3 * index).copy_from(&(row.whitening * (predicted - row.seen)));
        let Some(jacobian) = jacobian else { return };
        let from_base = row.whitening * tracker_from_base.rotation.matrix();
        let from_origin = row.whitening * self.stations[row.station].rotation.matrix();
        let rotation_vector: Vector3<f64> = now.displacements[row.station].fixed_rows::<3>(3).into_owned();
        let turned = Rotation3::new(rotation_vector) * in_base;
        let left = left_jacobian(&rotation_vector);
        for (column, id) in self.parameters.iter().enumerate() {
            let derivative = match *id {
                ParameterId::Link { .. } => from_base * now.chain.column(*id, &in_base),
                ParameterId::Frame { station, component } if station == row.station => {
                    if component < 3 {
                        from_origin.column(component).into_owned()
                    } else {
                        from_origin * left.column(component - 3).cross(&turned)
                    }
                }
                ParameterId::Target { target, .. } if target == row.target => {
                    from_base * now.chain.column(*id, &in_base)
                }
                _ => Vector3::zeros(),
            };
            jacobian.fixed_view_mut::<3, 1>(3 * index, column).copy_from(&derivative);
        }
    }

    fn fill_priors(&self, x: &[f64], residuals: &mut DVector<f64>, mut jacobian: Option<&mut DMatrix<f64>>) {
        let mut first = 3 * self.rows.len();
        for prior in &self.priors {
            let n = prior.whitening.nrows();
            for i in 0..n {
                residuals[first + i] = (0..n).map(|j| prior.whitening[(i, j)] * x[prior.column + j]).sum();
            }
            if let Some(jacobian) = jacobian.as_deref_mut() {
                jacobian.rows_mut(first, n).fill(0.0);
                jacobian.view_mut((first, prior.column), (n, n)).copy_from(&prior.whitening);
            }
            first += n;
        }
        for (column, weight) in self.tolerances.iter().enumerate() {
            residuals[first + column] = weight * x[column];
            if let Some(jacobian) = jacobian.as_deref_mut() {
                jacobian.row_mut(first + column).fill(0.0);
                jacobian[(first + column, column)] = *weight;
            }
        }
    }
}

impl LeastSquares for CalibrationProblem {
    fn parameters(&self) -> usize {
        self.parameters.len()
    }

    fn rows(&self) -> usize {
        let priors: usize = self.priors.iter().map(|p| p.whitening.nrows()).sum();
        3 * self.rows.len() + priors + self.tolerances.len()
    }

    fn evaluate(&mut self, x: &[f64], residuals: &mut DVector<f64>, mut jacobian: Option<&mut DMatrix<f64>>) {
        self.set(x);
        for index in 0..self.rows.len() {
            self.fill_observation(index, residuals, jacobian.as_deref_mut());
        }
        self.fill_priors(x, residuals, jacobian);
    }
}

/// The matrix J with `R(r + dr) ≈ exp(J dr) R(r)`.
fn left_jacobian(r: &Vector3<f64>) -> Matrix3<f64> {
    let angle = r.norm();
    let cross = cross_matrix(r);
    // Below 1e-3 rad the series is exact to rounding, and the quotients are not.
    let (a, b) = if angle < 1e-3 {
        (0.5 - angle * angle / 24.0, 1.0 / 6.0 - angle * angle / 120.0)
    } else {
        ((1.0 - angle.cos()) / (angle * angle), (angle - angle.sin()) / (angle * angle * angle))
    };
    Matrix3::identity() + a * cross + b * cross * cross
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{rotation_x, rotation_y, translation};
    use crate::model::{CraigLink, JointKind};

    fn problem() -> CalibrationProblem {
        let link = |kind, a, alpha, d| CraigLink {
            name: String::new(),
            kind,
            a,
            alpha,
            beta: 0.0,
            d,
            theta: 0.0,
            limits: [-3.0, 3.0],
        };
        let nominal = KinematicModel {
            links: vec![
                link(JointKind::Prismatic, 0.0, 0.0, 0.0),
                link(JointKind::Revolute, 0.3, -1.57, 0.6),
                link(JointKind::Revolute, 1.3, 0.0, 0.1),
            ],
            last_from_flange: Transform::identity(),
        };
        let mut parameters = ParameterId::all_of_links(3);
        parameters.extend(ParameterId::all_of_frame(0));
        parameters.extend(ParameterId::all_of_frame(1));
        parameters.extend(ParameterId::all_of_target(0));
        let stations =
            vec![translation(1.0, 2.0, 3.0) * rotation_x(0.3), translation(-2.0, 0.0, 1.0) * rotation_y(2.0)];
        let targets = vec![Vector3::new(0.1, 0.2, 0.3)];
        let row = |station, seen: Vector3<f64>| Row {
            seen,
            whitening: Matrix3::new(3.0, 0.0, 0.0, 1.0, 2.0, 0.0, -0.5, 0.3, 4.0),
            station,
            target: 0,
        };
        CalibrationProblem {
            joints: vec![0.4, -0.3, 1.2, 1.1, 0.8, -0.9],
            rows: vec![row(0, Vector3::new(1.0, 1.0, 1.0)), row(1, Vector3::new(0.0, -1.0, 2.0))],
            priors: vec![Prior {
                column: 15,
                whitening: DMatrix::from_fn(6, 6, |i, j| if i < j { 0.0 } else { 1.0 + i as f64 - j as f64 }),
            }],
            tolerances: vec![2.0, 3.0, 4.0],
            current: Current::new(&nominal, &stations, &targets),
            nominal,
            parameters,
            stations,
            targets,
        }
    }

    /// At displaced frames too, where a rotation vector's components do not act one after the other.
    #[test]
    fn the_jacobian_is_the_central_difference_far_from_zero() {
        let mut problem = problem();
        let n = problem.parameters.len();
        let x: Vec<f64> = (0..n).map(|i| 0.3 * (1.7 * i as f64).sin()).collect();
        let m = LeastSquares::rows(&problem);
        let mut residuals = DVector::zeros(m);
        let mut jacobian = DMatrix::from_element(m, n, f64::NAN);
        problem.evaluate(&x, &mut residuals, Some(&mut jacobian));
        let step = 1e-6;
        for column in 0..n {
            let mut at = |sign: f64| {
                let mut moved = x.clone();
                moved[column] += sign * step;
                let mut r = DVector::zeros(m);
                problem.evaluate(&moved, &mut r, None);
                r
            };
            let difference = (at(1.0) - at(-1.0)) / (2.0 * step);
            let error = (jacobian.column(column) - difference).amax();
            assert!(error < 1e-7 * jacobian.amax(), "{}: {error}", problem.parameters[column]);
        }
    }

    #[test]
    fn evaluation_takes_no_memory() {
        let mut problem = problem();
        let x = vec![0.01; problem.parameters.len()];
        let mut residuals = DVector::zeros(LeastSquares::rows(&problem));
        let mut jacobian = DMatrix::zeros(residuals.len(), x.len());
        let info = allocation_counter::measure(|| problem.evaluate(&x, &mut residuals, Some(&mut jacobian)));
        assert_eq!(info.count_total, 0);
    }
}
