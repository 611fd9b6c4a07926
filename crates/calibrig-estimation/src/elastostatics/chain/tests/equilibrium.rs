//! The chain at rest against the minimum of the energy, found with plain products of transforms and numerical derivatives.

use nalgebra::{DMatrix, DVector, Vector3};

use super::robots::{Case, painter, serial};
use crate::elastostatics::{Deflection, ElasticChain};
use calibrig_model::geometry::{Transform, rotation_x, rotation_y, rotation_z, translation};
use calibrig_model::{BeamRun, Bearing, BearingSide, JointKind, Section, StaticProperties};

/// A chain bent by hand.
struct Bent {
    /// Of weights and forces, J.
    load_energy: f64,
    /// Of every coordinate; zero for the free elbow.
    stiffness: Vec<f64>,
    /// Index of the free elbow.
    free: Option<usize>,
    /// Distance of crank's and lever's end, m.
    rod: f64,
    base_from_flange: Transform,
}

struct Bender<'a> {
    statics: &'a StaticProperties,
    u: &'a [f64],
    bent: Bent,
}

impl Bender<'_> {
    fn take(&mut self, stiffness: f64) -> f64 {
        self.bent.stiffness.push(stiffness);
        self.u.get(self.bent.stiffness.len() - 1).copied().unwrap_or(0.0)
    }

    fn weigh(&mut self, mass: f64, at: Vector3<f64>) {
        self.bent.load_energy -= mass * self.statics.gravity.dot(&at);
    }

    fn group(&mut self, at: Vector3<f64>, stiffness: [f64; 6]) -> Transform {
        let mut u = [0.0; 6];
        for (u, k) in u.iter_mut().zip(stiffness) {
            if k.is_finite() {
                *u = self.take(k);
            }
        }
        translation(at.x, at.y, at.z)
            * translation(u[0], u[1], u[2])
            * rotation_x(u[3])
            * rotation_y(u[4])
            * rotation_z(u[5])
            * translation(-at.x, -at.y, -at.z)
    }

    fn bearing(&mut self, bearing: &Bearing, kind: JointKind) -> Transform {
        let mut stiffness = bearing.stiffness;
        stiffness[if kind == JointKind::Prismatic { 2 } else { 5 }] = f64::INFINITY;
        self.group(Vector3::new(0.0, 0.0, bearing.at), stiffness)
    }
}

fn segment_stiffness(s: &Section, run: BeamRun, l: f64) -> [f64; 6] {
    let shear = |ga: f64, ei: f64| 1.0 / (l / ga + l.powi(3) / (12.0 * ei));
    let (axial, torsion) = (s.axial / l, s.torsion / l);
    let [second, third] = [shear(s.shear[0], s.bending[1]), shear(s.shear[1], s.bending[0])];
    let [about_second, about_third] = s.bending.map(|ei| ei / l);
    match run {
        BeamRun::AlongX => [axial, second, third, torsion, about_second, about_third],
        BeamRun::EndsAtOrigin => [second, third, axial, about_second, about_third, torsion],
    }
}

/// Bends the robot of `case` by `u`; the free elbow's coordinate is its joint angle less that of the ideal map.
fn bend(case: &Case, u: &[f64]) -> Bent {
    let model = &case.model;
    let statics = model.statics.as_ref().expect("statics");
    let mut q = case.command.clone();
    model.actuators.joints_from_command(&case.command, &mut q);
    let bent = Bent {
        load_energy: 0.0,
        stiffness: Vec::new(),
        free: None,
        rod: 0.0,
        base_from_flange: Transform::identity(),
    };
    let mut bender = Bender { statics, u, bent };
    let mut frame = model.kinematics.base_from_first;
    let place = |frame: &Transform, at: Vector3<f64>| frame.transform_point(&at.into()).coords;
    let mut crank_end = Vector3::zeros();
    for (i, link) in model.kinematics.links.iter().enumerate() {
        let bearing = &statics.bearings[i];
        frame *= link.fixed_part();
        if bearing.side == BearingSide::Fixed {
            frame *= bender.bearing(bearing, link.kind);
        }
        let mut drive = statics.drive_stiffness[i];
        if let (Some((shoulder, elbow, offset, bar)), Some(linkage)) =
            (model.actuators.four_bar(), &statics.linkage)
        {
            if i == shoulder {
                let psi = case.command[elbow] + offset + case.model.kinematics.links[elbow].theta;
                let axis = bar.axis;
                let crank = frame
                    * (translation(axis.x, axis.y, 0.0) * rotation_x(axis.rx) * rotation_y(axis.ry))
                    * rotation_z(psi + bender.take(statics.drive_stiffness[elbow]));
                crank_end = place(&crank, bar.crank.end());
                bender.weigh(linkage.crank.mass, place(&crank, linkage.crank.centre_of_mass));
                bender.weigh(0.5 * linkage.rod_mass, crank_end);
            } else if i == elbow {
                drive = 0.0;
                bender.bent.free = Some(bender.bent.stiffness.len());
            }
        }
        let variable = q[i] + bender.take(drive);
        frame *= match link.kind {
            JointKind::Prismatic => translation(0.0, 0.0, variable),
            JointKind::Revolute => rotation_z(variable),
        };
        if bearing.side == BearingSide::Moving {
            frame *= bender.bearing(bearing, link.kind);
        }
        let body = &statics.bodies[i];
        bender.weigh(body.mass, place(&frame, body.centre_of_mass));
        if let Some(beam) = &statics.beams[i] {
            let total: f64 = beam.segments.iter().map(|s| s.length.at(q[i])).sum();
            let along = |s: f64| match beam.run {
                BeamRun::AlongX => Vector3::new(s, 0.0, 0.0),
                BeamRun::EndsAtOrigin => Vector3::new(0.0, 0.0, s - total),
            };
            let rigid = frame;
            let mut root = 0.0;
            for segment in &beam.segments {
                let l = segment.length.at(q[i]);
                let mass = segment.section.mass_per_length * l;
                // The beam's mass is part of the body's.
                bender.weigh(-mass, place(&rigid, along(root + 0.5 * l)));
                bender.weigh(0.5 * mass, place(&frame, along(root + l / 6.0)));
                let stiffness = segment_stiffness(&segment.section, beam.run, l);
                frame *= bender.group(along(root + 0.5 * l), stiffness);
                bender.weigh(0.5 * mass, place(&frame, along(root + 5.0 * l / 6.0)));
                root += l;
            }
        }
        for load in statics.loads.iter().filter(|load| load.link == i) {
            let at = place(&frame, load.at);
            bender.weigh(load.mass, at);
            bender.bent.load_energy -= load.force.dot(&at);
        }
        if let (Some((_, elbow, _, bar)), Some(linkage)) = (model.actuators.four_bar(), &statics.linkage)
            && i == elbow
        {
            let lever_end = place(&frame, bar.lever.end());
            bender.weigh(0.5 * linkage.rod_mass, lever_end);
            bender.bent.rod = (lever_end - crank_end).norm();
        }
    }
    bender.bent.base_from_flange = frame * model.kinematics.last_from_flange;
    bender.bent
}

fn target(case: &Case, u: &[f64]) -> Vector3<f64> {
    bend(case, u).base_from_flange.transform_point(&case.in_flange.into()).coords
}

fn rod_length(case: &Case) -> f64 {
    case.model.actuators.four_bar().map_or(0.0, |(_, _, _, bar)| bar.rod)
}

fn rod_stiffness(case: &Case) -> f64 {
    let statics = case.model.statics.as_ref().expect("statics");
    statics.linkage.as_ref().map_or(0.0, |l| l.rod_stiffness)
}

/// Turns the free elbow until the rod has the length, by the secant rule.
fn close(case: &Case, u: &mut [f64], length: f64) {
    let Some(free) = bend(case, u).free else { return };
    let mut misfit = |angle: f64| {
        u[free] = angle;
        bend(case, u).rod - length
    };
    let (mut before, mut angle) = (0.0, 1e-3);
    let mut misfit_before = misfit(before);
    for _ in 0..20 {
        let now = misfit(angle);
        if (now - misfit_before).abs() < 1e-16 {
            break;
        }
        let next = angle - now * (angle - before) / (now - misfit_before);
        (before, misfit_before, angle) = (angle, now, next);
    }
    assert!(misfit(angle).abs() < 1e-14);
}

/// Of springs, rod and loads, J. A rigid rod is closed by the elbow instead.
fn energy(case: &Case, u: &[f64]) -> f64 {
    let k = rod_stiffness(case);
    let mut u = u.to_vec();
    if k.is_infinite() {
        close(case, &mut u, rod_length(case));
    }
    let bent = bend(case, &u);
    let springs: f64 = bent.stiffness.iter().zip(&u).map(|(k, u)| 0.5 * k * u * u).sum();
    let rod = if k.is_finite() { 0.5 * k * (bent.rod - rod_length(case)).powi(2) } else { 0.0 };
    springs + rod + bent.load_energy
}

/// Central difference of the fourth order.
fn slope(f: impl Fn(&[f64]) -> f64, u: &[f64], index: usize) -> f64 {
    let h = 1e-3;
    let at = |by: f64| {
        let mut u = u.to_vec();
        u[index] += by;
        f(&u)
    };
    (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h)
}

/// Newton's method on the coordinates `active`, with the second derivatives of the start.
fn minimize(case: &Case, start: &[f64], active: &[usize]) -> Vec<f64> {
    let h = 1e-3;
    let mut u = start.to_vec();
    let n = active.len();
    let mut hessian = DMatrix::zeros(n, n);
    for i in 0..n {
        for j in 0..=i {
            let at = |by_i: f64, by_j: f64| {
                let mut u = start.to_vec();
                u[active[i]] += by_i;
                u[active[j]] += by_j;
                energy(case, &u)
            };
            let second = (at(h, h) - at(h, -h) - at(-h, h) + at(-h, -h)) / (4.0 * h * h);
            hessian[(i, j)] = second;
            hessian[(j, i)] = second;
        }
    }
    let hessian = hessian.cholesky().expect("a stable pose");
    for _ in 0..30 {
        let gradient = DVector::from_fn(n, |i, _| slope(|u| energy(case, u), &u, active[i]));
        let step = hessian.solve(&gradient);
        for (i, by) in active.iter().zip(step.iter()) {
            u[*i] -= by;
        }
        if step.amax() < 3e-13 {
            return u;
        }
    }
    panic!("Newton's method does not converge");
}

fn check_equilibrium(case: &Case, what: &str) {
    let bent = bend(case, &[]);
    let mut start = vec![0.0; bent.stiffness.len()];
    close(case, &mut start, rod_length(case));
    let rigid = rod_stiffness(case).is_infinite();
    let active: Vec<_> = (0..start.len()).filter(|i| !(rigid && bent.free == Some(*i))).collect();
    let mut u = minimize(case, &start, &active);
    if rigid {
        close(case, &mut u, rod_length(case));
    }
    let mut chain = ElasticChain::of(&case.model);
    let settled = chain.settle(&case.command, &[], Deflection::Equilibrium).expect("rest");
    let (found, expected) = (chain.target(&case.in_flange), target(case, &u));
    let droop = (expected - target(case, &start)).norm();
    eprintln!(
        "{what}: {:.2} mm, {:.1e} m, {} iterations",
        droop * 1e3,
        (found - expected).norm(),
        settled.iterations
    );
    assert!(droop > 1e-4, "{droop}");
    assert!((found - expected).norm() <= 1e-10, "{what}: {found} {expected}");
}

#[test]
fn serial_robots_rest_where_their_energy_is_least() {
    for seed in 0..12 {
        check_equilibrium(&serial(seed), &format!("serial {seed}"));
    }
}

#[test]
fn robots_with_a_four_bar_rest_where_their_energy_is_least() {
    for seed in 0..3 {
        check_equilibrium(&painter(seed), &format!("painter {seed}"));
    }
}

#[test]
fn a_rigid_rod_is_a_constraint() {
    let mut case = painter(3);
    let statics = case.model.statics.as_mut().expect("statics");
    statics.linkage.as_mut().expect("a linkage").rod_stiffness = f64::INFINITY;
    // Closing the rod at every energy is slow: fewer springs.
    for bearing in &mut statics.bearings {
        bearing.stiffness = calibrig_model::RIGID;
    }
    statics.beams[2] = None;
    check_equilibrium(&case, "rigid rod");
}

#[test]
fn first_order_is_compliance_times_the_load_of_the_undeflected_pose() {
    for case in (0..8).map(serial).chain((0..3).map(painter)) {
        let bent = bend(&case, &[]);
        let mut rigid = vec![0.0; bent.stiffness.len()];
        close(&case, &mut rigid, rod_length(&case));
        let load = |index| -slope(|u| bend(&case, u).load_energy, &rigid, index);
        let stretch = |index| slope(|u| bend(&case, u).rod, &rigid, index);
        let force = bent.free.map_or(0.0, |free| load(free) / stretch(free));
        let mut u: Vec<_> = (0..rigid.len())
            .map(|i| {
                (load(i) - if bent.free.is_some() { force * stretch(i) } else { 0.0 }) / bent.stiffness[i]
            })
            .collect();
        if let Some(free) = bent.free {
            u[free] = rigid[free];
            close(&case, &mut u, rod_length(&case) + force / rod_stiffness(&case));
        }
        let mut chain = ElasticChain::of(&case.model);
        chain.settle(&case.command, &[], Deflection::FirstOrder).expect("a pose");
        let error = (chain.target(&case.in_flange) - target(&case, &u)).norm();
        assert!(error <= 1e-10, "{error}");
    }
}
