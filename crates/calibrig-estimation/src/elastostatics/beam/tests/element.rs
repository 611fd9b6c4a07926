//! The uniform Timoshenko beam element.
//!
//! Source: J. S. Przemieniecki, Theory of Matrix Structural Analysis (1968), section 5.6. Its nodal displacements are exact for loads at
//! the nodes, and with the consistent load for a uniform one.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use calibrig_model::Section;

pub(super) type Matrix12 = SMatrix<f64, 12, 12>;
pub(super) type Vector12 = SVector<f64, 12>;

/// Stiffness in the element's axes: displacements along x (the beam), y, z and rotations about them, of one node, then of the other.
pub(super) fn stiffness(section: &Section, length: f64) -> Matrix12 {
    let mut k = Matrix12::zeros();
    for (dof, stiffness) in [(0, section.axial), (3, section.torsion)] {
        let s = stiffness / length;
        (k[(dof, dof)], k[(dof + 6, dof + 6)]) = (s, s);
        (k[(dof, dof + 6)], k[(dof + 6, dof)]) = (-s, -s);
    }
    // (deflection, rotation, sign of the rotation that lifts the far node): about z it lifts it along +y, about y along -z.
    for (deflection, rotation, sign, shear, bending) in [
        (1, 5, 1.0, section.shear[0], section.bending[1]),
        (2, 4, -1.0, section.shear[1], section.bending[0]),
    ] {
        let phi = 12.0 * bending / (shear * length * length);
        let s = bending / ((1.0 + phi) * length.powi(3));
        let arm = sign * length;
        let square = length * length;
        let plane = [
            [12.0, 6.0 * arm, -12.0, 6.0 * arm],
            [6.0 * arm, (4.0 + phi) * square, -6.0 * arm, (2.0 - phi) * square],
            [-12.0, -6.0 * arm, 12.0, -6.0 * arm],
            [6.0 * arm, (2.0 - phi) * square, -6.0 * arm, (4.0 + phi) * square],
        ];
        let dofs = [deflection, rotation, deflection + 6, rotation + 6];
        for (row, values) in dofs.into_iter().zip(plane) {
            for (column, value) in dofs.into_iter().zip(values) {
                k[(row, column)] = s * value;
            }
        }
    }
    k
}

/// Consistent nodal load of a uniform force per length (N/m) in the element's axes. Shear changes nothing in it.
pub(super) fn uniform_load(force: &Vector3<f64>, length: f64) -> Vector12 {
    let half = 0.5 * length * force;
    let moment = length * length / 12.0 * Vector3::new(0.0, -force.z, force.y);
    let mut load = Vector12::zeros();
    for (at, value) in [(0, half), (3, moment), (6, half), (9, -moment)] {
        load.fixed_rows_mut::<3>(at).copy_from(&value);
    }
    load
}

/// Turns both nodes' displacements and rotations from element axes to those of the frame.
pub(super) fn turn(frame_from_element: &Matrix3<f64>) -> Matrix12 {
    let mut turn = Matrix12::zeros();
    for block in 0..4 {
        turn.fixed_view_mut::<3, 3>(3 * block, 3 * block).copy_from(frame_from_element);
    }
    turn
}
