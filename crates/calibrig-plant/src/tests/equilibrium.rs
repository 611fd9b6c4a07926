//! The pose at rest, found without rapier and without our own kinematics: Newton's method on the potential energy
//! `V(q) = Σ k (q - rest)² / 2 - Σ m g·c(q)`, its derivatives exact.
//!
//! With the link matrices `L(q) = F exp(q G)`, G the generator of the joint's motion, a point c carried by joint i has
//! `∂c/∂qᵢ = Sᵢ c` and `∂²c/∂qᵢ∂qⱼ = Sᵢ Sⱼ c` for i <= j, where `Sᵢ = Tᵢ Gᵢ Tᵢ⁻¹`.

use nalgebra::{DMatrix, DVector, Matrix4, Vector3, Vector4};

use super::AsBuilt;
use calibrig_model::JointKind;

pub(super) struct Equilibrium<'a> {
    pub(super) robot: &'a AsBuilt,
    /// The joint variables without a load.
    pub(super) rest: &'a [f64],
}

pub(super) fn turn(axis: usize, angle: f64) -> Matrix4<f64> {
    let (sin, cos) = angle.sin_cos();
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut matrix = Matrix4::identity();
    matrix[(u, u)] = cos;
    matrix[(v, v)] = cos;
    matrix[(u, v)] = -sin;
    matrix[(v, u)] = sin;
    matrix
}

pub(super) fn shift(axis: usize, by: f64) -> Matrix4<f64> {
    let mut matrix = Matrix4::identity();
    matrix[(axis, 3)] = by;
    matrix
}

fn generator(kind: JointKind) -> Matrix4<f64> {
    let mut matrix = Matrix4::zeros();
    match kind {
        JointKind::Prismatic => matrix[(2, 3)] = 1.0,
        JointKind::Revolute => {
            matrix[(0, 1)] = -1.0;
            matrix[(1, 0)] = 1.0;
        }
    }
    matrix
}

pub(super) fn point(v: &Vector3<f64>) -> Vector4<f64> {
    Vector4::new(v.x, v.y, v.z, 1.0)
}

impl Equilibrium<'_> {
    /// `base_from_link` of every link.
    pub(super) fn frames(&self, q: &DVector<f64>) -> Vec<Matrix4<f64>> {
        let mut frame = self.robot.kinematics.base_from_first.to_homogeneous();
        let links = self.robot.kinematics.links.iter().zip(q.iter());
        links
            .map(|(link, q)| {
                let (angle, offset) = match link.kind {
                    JointKind::Revolute => (link.theta + q, link.d),
                    JointKind::Prismatic => (link.theta, link.d + q),
                };
                frame *= turn(0, link.alpha)
                    * shift(0, link.a)
                    * turn(1, link.beta)
                    * turn(2, angle)
                    * shift(2, offset);
                frame
            })
            .collect()
    }

    /// The target in the base frame, m.
    pub(super) fn target(&self, q: &DVector<f64>) -> Vector3<f64> {
        let flange = self.robot.kinematics.last_from_flange.to_homogeneous();
        let frames = self.frames(q);
        (frames[frames.len() - 1] * flange * point(&self.robot.target)).xyz()
    }

    fn is_rigid(&self, joint: usize) -> bool {
        self.robot.statics.drive_stiffness[joint].is_infinite()
    }

    /// V, J.
    pub(super) fn energy(&self, q: &DVector<f64>) -> f64 {
        let statics = &self.robot.statics;
        let springs = (0..q.len())
            .filter(|&i| !self.is_rigid(i))
            .map(|i| 0.5 * statics.drive_stiffness[i] * (q[i] - self.rest[i]).powi(2));
        let weights = self.frames(q).into_iter().zip(&statics.bodies).map(|(frame, body)| {
            -body.mass * statics.gravity.dot(&(frame * point(&body.centre_of_mass)).xyz())
        });
        springs.sum::<f64>() + weights.sum::<f64>()
    }

    /// Gradient and Hessian of V; a rigid drive has no say.
    pub(super) fn derivatives(&self, q: &DVector<f64>) -> (DVector<f64>, DMatrix<f64>) {
        let statics = &self.robot.statics;
        let n = q.len();
        let frames = self.frames(q);
        let spatial: Vec<_> = frames
            .iter()
            .zip(&self.robot.kinematics.links)
            .map(|(frame, link)| frame * generator(link.kind) * frame.try_inverse().expect("rigid"))
            .collect();
        let (mut gradient, mut hessian) = (DVector::zeros(n), DMatrix::zeros(n, n));
        for (b, (frame, body)) in frames.iter().zip(&statics.bodies).enumerate() {
            let centre = frame * point(&body.centre_of_mass);
            let weight = body.mass * statics.gravity;
            for j in 0..=b {
                let moved = spatial[j] * centre;
                gradient[j] -= weight.dot(&moved.xyz());
                for i in 0..=j {
                    hessian[(i, j)] -= weight.dot(&(spatial[i] * moved).xyz());
                }
            }
        }
        hessian.fill_lower_triangle_with_upper_triangle();
        for i in 0..n {
            if self.is_rigid(i) {
                gradient[i] = 0.0;
                hessian.row_mut(i).fill(0.0);
                hessian.column_mut(i).fill(0.0);
                hessian[(i, i)] = 1.0;
            } else {
                gradient[i] += statics.drive_stiffness[i] * (q[i] - self.rest[i]);
                hessian[(i, i)] += statics.drive_stiffness[i];
            }
        }
        (gradient, hessian)
    }

    /// The joint variables at the minimum of V next to the commanded ones.
    pub(super) fn solve(&self) -> DVector<f64> {
        let mut q = DVector::from_column_slice(self.rest);
        for _ in 0..50 {
            let (gradient, hessian) = self.derivatives(&q);
            let step = hessian.cholesky().expect("a minimum").solve(&gradient);
            q -= &step;
            if step.amax() < 1e-14 {
                return q;
            }
        }
        panic!("Newton's method did not converge");
    }
}
