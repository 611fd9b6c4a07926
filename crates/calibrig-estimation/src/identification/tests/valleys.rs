//! Robots whose tool is near their last axis: the direction of that axis hardly shows, and only together with the place of the tool.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::Vector3;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use super::super::*;
use crate::kinematics::target_in_base;
use calibrig_model::geometry::{rotation_x, rotation_z, translation};
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::{CalibrationModel, CraigLink, LinkTerm};

const NOISE: f64 = 20e-6;

fn normal(random: &mut impl Rng) -> f64 {
    StandardNormal.sample(random)
}

/// A 6R robot, with right-angle and zero twists for even numbers and with arbitrary ones for odd numbers.
fn robot(number: u32, random: &mut impl Rng) -> CalibrationModel {
    let twists = [0.0, FRAC_PI_2, 0.0, FRAC_PI_2, -FRAC_PI_2, FRAC_PI_2];
    let row = |(i, twist): (usize, f64)| {
        let alpha = if number.is_multiple_of(2) { twist } else { random.random_range(-PI..PI) };
        let (a, d) = (random.random_range(-0.5..0.5), random.random_range(-0.5..0.5));
        CraigLink::revolute(format!("j{i}")).row(a, alpha, d, random.random_range(-PI..PI)).limits(-2.5, 2.5)
    };
    let links = twists.into_iter().enumerate().map(row).collect();
    CalibrationModel::new(links).expect("a robot")
}

/// Measurements of the robot by a tracker, with errors in its links, and its tool `off` the last axis.
fn measured(nominal: &CalibrationModel, off: f64, random: &mut impl Rng) -> MeasurementSet {
    let mut real = nominal.clone();
    for link in &mut real.kinematics.links {
        for term in LinkTerm::ALL {
            let sigma = if matches!(term, LinkTerm::A | LinkTerm::D) { 0.5e-3 } else { 1e-3 };
            *link.term_mut(term) += sigma * normal(random);
        }
    }
    let around = random.random_range(-PI..PI);
    let tool = Vector3::new(off * around.cos(), off * around.sin(), random.random_range(0.05..0.3));
    let station = translation(3.0, 0.5, -0.4) * rotation_x(0.3) * rotation_z(2.0);
    let points = (0..30).map(|_| {
        let joints: Vec<f64> = (0..6).map(|_| random.random_range(-2.5..2.5)).collect();
        let at = target_in_base(&real.kinematics, &joints, &tool).expect("a pose");
        let seen = station.transform_point(&at.into()).coords;
        (joints, seen + NOISE * Vector3::from_fn(|_, _| normal(random)))
    });
    MeasurementSet::of_points(points.collect::<Vec<_>>())
}

#[test]
fn a_tool_near_the_last_axis_is_found_in_few_iterations() {
    for off in [0.0, 1e-5, 1e-4, 1e-3] {
        for stated in [true, false] {
            let mut counts = Vec::new();
            for number in 0..100 {
                let mut random = stream(7, number, StreamSource::AsBuilt);
                let nominal = robot(number, &mut random);
                let set = measured(&nominal, off, &mut random);
                let set = if stated { set.with_sigma(NOISE) } else { set };
                let estimate =
                    identify(&nominal, &set, &IdentificationOptions::default()).expect("an estimate");
                assert!(estimate.termination.converged(), "{off} {number}: {:?}", estimate.termination);
                counts.push(estimate.iterations.len());
            }
            counts.sort_unstable();
            println!(
                "{:.0} um off, noise stated: {stated}: {} iterations, at most {}",
                1e6 * off,
                counts[50],
                counts[99]
            );
            assert!(counts[99] <= 30, "{off}: {counts:?}");
        }
    }
}
