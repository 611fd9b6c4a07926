//! A factory's table, with nearly parallel axes whose common normals are hundreds of metres away.

use std::fmt::Write as _;

use nalgebra::Vector3;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::super::*;
use crate::kinematics::target_in_base;
use calibrig_files::{Source as Text, parse_robot};
use calibrig_model::geometry::{rotation_x, rotation_z, translation};
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::{CraigLink, KinematicModel, LinkTerm};

/// a mm, alpha deg, d mm, theta deg of a 6R robot like a UR, calculated from axes that are parallel to within 1 mrad.
const TABLE: &str = "
0 0 130 0
0 90 -412162.1168985784 -35.53768226336827
-496.37738976641793 0.04928769182017715 850623.6995938465 170.68688693861372
316.17903961360395 0.061974858696288576 -438301.6866952867 -146.60838607448594
0 90 115.00000000000021 -162.81126614607533
0 90 92.00000000005988 -174.27042204869176";

fn rows() -> Vec<[f64; 4]> {
    let row = |line: &str| {
        let numbers: Vec<f64> = line.split(' ').map(|number| number.parse().expect("a number")).collect();
        numbers.try_into().expect("four numbers")
    };
    TABLE.trim().lines().map(row).collect()
}

fn text() -> String {
    let mut text = "schema = \"calibrig.robot/1\"\nname = \"far\"\nconvention = \"craig\"\n".to_owned();
    for (i, [a, alpha, d, theta]) in rows().iter().enumerate() {
        write!(
            text,
            "[[joint]]\nname = \"J{i}\"\ntype = \"revolute\"\na_mm = {a:?}\nalpha_deg = {alpha:?}\nd_mm = {d:?}\ntheta_deg = {theta:?}\n\
             min_deg = -180\nmax_deg = 180\n"
        )
        .expect("text");
    }
    text + "[actuators]\nkind = \"direct\"\n"
}

#[test]
fn a_table_with_far_normals_is_identified_as_any_other() {
    let robot = parse_robot(Text::new("far.toml", text()), None, None).expect("a robot");
    assert_eq!(robot.remarks.len(), 1, "{:?}", robot.remarks);
    assert!(robot.remarks[0].contains("J1, J2, J3"), "{:?}", robot.remarks);
    let row = |(i, [a, alpha, d, theta]): (usize, &[f64; 4])| {
        CraigLink::revolute(format!("J{i}")).row(a / 1e3, alpha.to_radians(), d / 1e3, theta.to_radians())
    };
    let stated = KinematicModel::new(rows().iter().enumerate().map(row).collect()).expect("a chain");
    let mut random = stream(21, 0, StreamSource::AsBuilt);
    let joints = |random: &mut rand_chacha::ChaCha8Rng| -> Vec<f64> {
        (0..6).map(|_| random.random_range(-3.0..3.0)).collect()
    };
    let target = Vector3::new(0.08, -0.05, 0.12);
    for _ in 0..50 {
        let q = joints(&mut random);
        let [one, other] = [&stated, &robot.model.kinematics]
            .map(|chain| target_in_base(chain, &q, &target).expect("a pose"));
        assert!((one - other).norm() < 1e-10, "{}", (one - other).norm());
    }
    let mut real = robot.model.kinematics.clone();
    let normal = |random: &mut rand_chacha::ChaCha8Rng| -> f64 { StandardNormal.sample(random) };
    for link in &mut real.links {
        for term in LinkTerm::ALL {
            let sigma = if matches!(term, LinkTerm::A | LinkTerm::D) { 0.5e-3 } else { 1e-3 };
            *link.term_mut(term) += sigma * normal(&mut random);
        }
    }
    let station = translation(3.0, 0.5, -0.4) * rotation_x(0.3) * rotation_z(2.0);
    let noise = 20e-6;
    let points = (0..120).map(|_| {
        let q = joints(&mut random);
        let at = target_in_base(&real, &q, &target).expect("a pose");
        let seen = station.transform_point(&at.into()).coords;
        (q, seen + noise * Vector3::from_fn(|_, _| normal(&mut random)))
    });
    let set = MeasurementSet::of_points(points.collect::<Vec<_>>());
    let estimate = identify(&robot.model, &set, &IdentificationOptions::default()).expect("an estimate");
    assert!(estimate.is_sound(), "{:?}", estimate.warnings);
    assert_eq!((estimate.spectrum.rank, estimate.spectrum.weak.len()), (27, 0));
    let NoiseScale::Residuals(found) = estimate.noise else { panic!("{:?}", estimate.noise) };
    // With 333 degrees of freedom, one standard deviation is 4 %.
    assert!((found / noise - 1.0).abs() < 0.15, "{found}");
}
