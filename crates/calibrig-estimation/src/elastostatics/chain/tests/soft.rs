//! Loads that hang on springs so soft that they turn back more than the springs do: stable, and no fixed point of substitution.

use nalgebra::{Matrix3, Vector3};

use super::robots::painter;
use crate::elastostatics::{Deflection, ElasticChain, ElasticError};
use calibrig_model::{
    Body, CalibrationModel, Compliance, CraigLink, ParameterId, PointLoad, StaticProperties,
};

const GRAVITY: f64 = 9.81;

/// A pendulum of links of equal length about parallel horizontal axes, gravity along x, and a load at its end.
fn pendulum(stiffness: &[f64], length: f64, mass: f64) -> CalibrationModel {
    let link = |(i, _): (usize, &f64)| {
        let a = if i == 0 { 0.0 } else { length };
        CraigLink::revolute(format!("j{i}")).row(a, 0.0, 0.0, 0.0).limits(-3.0, 3.0)
    };
    let bodies = vec![
        Body { mass: 1.0, centre_of_mass: Vector3::zeros(), inertia: Matrix3::zeros() };
        stiffness.len()
    ];
    let gravity = Vector3::new(GRAVITY, 0.0, 0.0);
    let mut statics = StaticProperties::of_drives(bodies, stiffness.to_vec(), gravity);
    let at = Vector3::new(length, 0.0, 0.0);
    statics.loads.push(PointLoad {
        name: "load".to_owned(),
        link: stiffness.len() - 1,
        at,
        mass,
        force: Vector3::zeros(),
    });
    let model = CalibrationModel::new(stiffness.iter().enumerate().map(link).collect()).expect("a chain");
    model.with_statics(statics).expect("statics")
}

/// Energy of the two-link pendulum at joint angles `q` (J), and its end.
fn energy(stiffness: [f64; 2], length: f64, mass: f64, command: [f64; 2], q: [f64; 2]) -> f64 {
    let elbow = length * q[0].cos();
    let end = elbow + length * (q[0] + q[1]).cos();
    let springs: f64 = (0..2).map(|i| 0.5 * stiffness[i] * (q[i] - command[i]).powi(2)).sum();
    // The bodies of 1 kg sit at the joints.
    springs - GRAVITY * (elbow + mass * end)
}

/// The lowest energy on ever finer grids about the lowest so far.
fn lowest(energy: impl Fn([f64; 2]) -> f64, from: [f64; 2]) -> [f64; 2] {
    let (mut best, mut width) = (from, 2.0);
    while width > 1e-9 {
        let about = best;
        for i in -10..=10 {
            for j in -10..=10 {
                let q = [about[0] + width * f64::from(i) / 10.0, about[1] + width * f64::from(j) / 10.0];
                if energy(q) < energy(best) {
                    best = q;
                }
            }
        }
        width *= 0.5;
    }
    best
}

#[test]
fn a_soft_pendulum_rests_where_its_energy_is_least() {
    let (stiffness, length, mass) = ([60.0, 40.0], 0.8, 50.0);
    let model = pendulum(&stiffness, length, mass);
    for command in [[0.3, 0.2], [-0.7, 0.4], [1.2, 0.2]] {
        let mut chain = ElasticChain::of(&model);
        let settled = chain.settle(&command, &[], Deflection::Equilibrium).expect("rest");
        let q = lowest(|q| energy(stiffness, length, mass, command, q), command);
        let end = |q: [f64; 2]| {
            length * Vector3::new(q[0].cos() + (q[0] + q[1]).cos(), q[0].sin() + (q[0] + q[1]).sin(), 0.0)
        };
        let found = chain.target(&Vector3::new(length, 0.0, 0.0));
        println!("{command:?}: {q:?}, {} evaluations, {:.1e}", settled.iterations, (found - end(q)).norm());
        // Energies compare to half of the digits.
        assert!((found - end(q)).norm() < 1e-6, "{found} {:?}", end(q));
        assert!((end(q) - end(command)).norm() > 0.2, "hardly soft");
        assert!(settled.residual <= 1e-13);
    }
}

/// The columns are the derivatives of where it rests.
#[test]
fn columns_of_a_soft_pendulum_are_derivatives() {
    let model = pendulum(&[60.0, 40.0], 0.8, 50.0);
    let (command, at) = ([0.5, -0.3], Vector3::new(0.8, 0.1, 0.0));
    let rest = |id: Option<(ParameterId, f64)>| {
        let mut changed = model.clone();
        if let Some((id, by)) = id {
            crate::elastostatics::put(&mut changed, &model, id, by);
        }
        let mut chain = ElasticChain::of(&model);
        chain.set_model(&changed).expect("a model");
        chain.settle(&command, &[], Deflection::Equilibrium).expect("rest");
        chain
    };
    let mut chain = rest(None);
    chain.prepare(&at).expect("stable");
    for name in ["delta_a2", "delta_theta1", "delta_theta2", "mass2"] {
        check(&chain, ParameterId::parse(name).expect("a name"), &rest, &at);
    }
    for joint in 0..2 {
        check(&chain, ParameterId::Compliance(Compliance::Drive { joint }), &rest, &at);
    }
}

fn check(
    chain: &ElasticChain,
    id: ParameterId,
    rest: &impl Fn(Option<(ParameterId, f64)>) -> ElasticChain,
    at: &Vector3<f64>,
) {
    let h = 1e-4;
    let [up, down] = [h, -h].map(|by| rest(Some((id, by))).target(at));
    let difference = (up - down) / (2.0 * h);
    let column = chain.column(id).expect("a column");
    assert!((column - difference).norm() <= 1e-6 * (1.0 + difference.norm()), "{id}: {column} {difference}");
}

/// Upside down, the same load falls over.
#[test]
fn a_soft_pendulum_on_its_head_is_refused() {
    let model = pendulum(&[60.0, 40.0], 0.8, 50.0);
    let refusal = ElasticChain::of(&model).settle(&[3.0, 0.1], &[], Deflection::Equilibrium).unwrap_err();
    assert!(matches!(refusal, ElasticError::NotSettled { .. }), "{refusal}");
}

/// The descent and the substitution, where that settles, lead to the same place, with a four-bar and its elastic rod, too.
#[test]
fn a_softer_robot_with_a_four_bar_rests_where_substitution_leads() {
    let case = painter(0);
    for soften in [1.0, 10.0, 30.0] {
        let mut model = case.model.clone();
        let statics = model.statics.as_mut().expect("statics");
        statics.drive_stiffness.iter_mut().for_each(|k| *k /= soften);
        let mut chain = ElasticChain::of(&model);
        let settled = chain.settle(&case.command, &[], Deflection::Equilibrium).expect("rest");
        assert!(settled.iterations < 40, "by substitution");
        let by_substitution = chain.target(&case.in_flange);
        chain.descend().expect("rest");
        let by_descent = chain.target(&case.in_flange);
        assert!((by_substitution - by_descent).norm() < 1e-10, "{soften}");
    }
}
