//! What the public functions do with numbers and names that cannot be: they return, with an error, `None` or no number.

use calibrig_model::geometry::{
    best_fit_transform, rotation_vector, rotation_x, rotation_z, small_displacement,
};
use calibrig_model::measurement::{
    MeasurementSet, NestObservation, Reading, Station, nest_system, register, remove_drift,
};
use calibrig_model::nalgebra::{Matrix3, Vector3, Vector6};
use calibrig_model::statistics::{
    beta_regularised, binomial_cdf, chi2_cdf, chi2_quantile, chi2_survival, clopper_pearson, f_ln_survival,
    ln_gamma, normal_quantile, normal_survival, student_t_quantile,
};
use calibrig_model::{ActuatorMap, CalibrationModel, CraigLink, FAMILIES, ParameterId, PoseQuery, TermId};
use proptest::prelude::*;

/// Any number, most of them ordinary.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        6 => -3.0..3.0_f64,
        2 => prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -0.0, 1.0]),
        1 => prop::sample::select(vec![1e308, -1e308, 1e-308, 1e160, 5e-324, 1e9, 1e12, 1e13, 1e16]),
        1 => 0.0..1e6_f64,
    ]
}

fn vector() -> impl Strategy<Value = Vector3<f64>> {
    prop::array::uniform3(number()).prop_map(Vector3::from)
}

fn is_probability(p: f64) -> bool {
    p.is_nan() || (-1e-12..=1.0 + 1e-9).contains(&p)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn distributions_return(x in number(), a in number(), b in number(), p in number()) {
        for (what, found) in [
            ("chi2_cdf", chi2_cdf(x, a)),
            ("chi2_survival", chi2_survival(x, a)),
            ("normal_survival", normal_survival(x)),
        ] {
            prop_assert!(is_probability(found), "{}({}, {}) = {}", what, x, a, found);
        }
        for wrong in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            prop_assert!(chi2_quantile(p, wrong).is_nan(), "chi2_quantile({}, {})", p, wrong);
        }
        for wrong in [0.0, -1.0, f64::NAN, f64::NEG_INFINITY] {
            prop_assert!(student_t_quantile(p, wrong).is_nan(), "student_t_quantile({}, {})", p, wrong);
            prop_assert!(beta_regularised(wrong, 2.0, 0.5).is_nan() && beta_regularised(2.0, wrong, 0.5).is_nan());
            prop_assert!(chi2_cdf(1.0, wrong).is_nan() && chi2_survival(1.0, wrong).is_nan());
        }
        prop_assert!(chi2_quantile(f64::NAN, 3.0).is_nan() && student_t_quantile(f64::NAN, 3.0).is_nan());
        prop_assert!(normal_quantile(f64::NAN).is_nan());
        let quantile = chi2_quantile(p, a);
        prop_assert!(quantile.is_nan() || quantile >= 0.0, "chi2_quantile({}, {}) = {}", p, a, quantile);
        let _ = (student_t_quantile(p, a), normal_quantile(p), ln_gamma(x));
        let _ = (beta_regularised(a, b, p), f_ln_survival(x, a, b));
    }

    #[test]
    fn binomials_return(hits in 0..2000_u64, trials in 0..2000_u64, p in number()) {
        let found = binomial_cdf(hits, trials, p);
        prop_assert!(is_probability(found) , "{}", found);
        let (low, high) = clopper_pearson(hits, trials, p);
        prop_assert!(low.is_nan() || high.is_nan() || low <= high || hits > trials || !(0.0..1.0).contains(&p), "{} {}", low, high);
    }

    #[test]
    fn transforms_that_points_do_not_determine_are_none(a in prop::collection::vec(vector(), 0..7), b in prop::collection::vec(vector(), 0..7), xi in prop::array::uniform6(number())) {
        let found = best_fit_transform(&a, &b);
        prop_assert!(found.is_none() || (a.len() == b.len() && a.len() >= 3));
        let one_line: Vec<_> = (0..a.len()).map(|i| Vector3::x() * i as f64).collect();
        prop_assert!(best_fit_transform(&one_line, &one_line).is_none());
        let _ = best_fit_transform(&a, &a);
        let _ = rotation_vector(&small_displacement(&Vector6::from(xi)).rotation);
    }

    #[test]
    fn stations_that_nests_do_not_determine_are_refused(
        places in prop::collection::vec((vector(), vector(), number(), any::<bool>()), 0..6)
    ) {
        let nest = |(in_base, seen, variance, stated): &(Vector3<f64>, Vector3<f64>, f64, bool)| NestObservation { time: None,
            name: "N".to_owned(),
            in_base: *in_base,
            in_base_covariance: Matrix3::identity() * *variance,
            reading: Reading::Cartesian { position: *seen, covariance: stated.then(|| Matrix3::identity() * 1e-10) },
        };
        let station = Station { name: "T".to_owned(), nests: places.iter().map(nest).collect(), ..Station::default() };
        match register(&station) {
            Ok(registration) => prop_assert!(station.nests.len() >= 3 && registration.chi2 >= 0.0),
            Err(error) => prop_assert!(error.to_string().contains("nest")),
        }
        let from = rotation_x(0.3) * rotation_z(-1.0);
        if let Err(error) = nest_system(&station, &from) {
            prop_assert!(error.to_string().contains("nest N"));
        }
        let set = MeasurementSet { stations: vec![station], ..MeasurementSet::of_points([(vec![0.0], Vector3::x())]) };
        let finite = places.iter().all(|(a, b, v, _)| a.iter().chain(b.iter()).all(|v| v.is_finite()) && v.is_finite());
        match set.check(1) {
            Ok(()) => prop_assert!(finite),
            Err(error) => prop_assert!(!finite && error.to_string().contains("nest N of station T"), "{}", error),
        }
    }

    #[test]
    fn rounds_of_nests_that_cannot_be_return(
        rounds in prop::collection::vec((0..4_u8, vector(), number(), prop::option::of(number())), 0..40), same in any::<bool>()
    ) {
        let nest = |(name, seen, certified, time): &(u8, Vector3<f64>, f64, Option<f64>)| NestObservation {
            time: *time,
            name: format!("N{name}"),
            in_base: if same { Vector3::x() * f64::from(*name) } else { Vector3::x() * *certified },
            in_base_covariance: Matrix3::identity(),
            reading: Reading::Cartesian { position: *seen, covariance: certified.is_sign_positive().then(|| Matrix3::identity() * *certified) },
        };
        let station = Station { name: "T".to_owned(), nests: rounds.iter().map(nest).collect(), ..Station::default() };
        let mut set = MeasurementSet { stations: vec![station.clone(), station], ..MeasurementSet::of_points([(vec![0.0], Vector3::x())]) };
        match remove_drift(&set) {
            Ok(steady) => {
                let names: std::collections::BTreeSet<_> = steady.measurements.stations[0].nests.iter().map(|n| n.name.clone()).collect();
                prop_assert_eq!(names.len(), steady.measurements.stations[0].nests.len(), "merged");
            }
            Err(error) => prop_assert!(error.to_string().contains("station T"), "{}", error),
        }
        set.share_certificates();
    }

    #[test]
    fn names_of_parameters_are_read_back_or_are_none(
        first in prop::sample::select(vec!["delta_a", "delta_theta", "frame", "target", "mass", "compliance_drive", "compliance_bearing", "ratio_d", "rail_d", "harmonic_theta", "", "x"]),
        count in prop_oneof![0..400_u64, Just(u64::MAX)], last in prop::sample::select(vec!["", "_x", "_rx", "_x2", "_sin1", "_", "_z9"])
    ) {
        let name = format!("{first}{count}{last}");
        if let Some(id) = ParameterId::parse(&name) {
            prop_assert_eq!(ParameterId::parse(&id.to_string()), Some(id));
            let _ = id.unit();
        }
    }

    #[test]
    fn commands_and_terms_of_another_robot_return(
        command in prop::collection::vec(number(), 0..5), approach in prop::collection::vec(-1..=1_i8, 0..5),
        ends in prop::array::uniform2(prop_oneof![0..4_usize, Just(usize::MAX)]), offset in number()
    ) {
        let [shoulder, elbow] = ends;
        let map = ActuatorMap::Parallelogram { shoulder, elbow, offset, linkage: None };
        let mut joints = vec![0.0; 3];
        map.joints_from_command(&command, &mut joints);
        prop_assert_eq!(map.command_from_joints(&command).len(), command.len());
        prop_assert_eq!(map.check(3).is_ok(), shoulder < elbow && elbow < 3 && offset.is_finite());
        let links = vec![CraigLink::prismatic("x").limits(0.0, 1.0), CraigLink::revolute("y"), CraigLink::revolute("z")];
        let model = CalibrationModel::new(links).expect("a chain").with_motor_turns(vec![Some(10.0), None, Some(2.0)]).expect("turns");
        let mut broken = model.clone();
        broken.actuators = map;
        broken.motor_turns.clear();
        let pose = PoseQuery::at(&command).approached(&approach);
        for family in FAMILIES {
            for term in TermId::all_of(family.key(), &model).expect("a family") {
                let _ = (term.basis(&model, &pose), term.basis(&broken, &pose), term.place(), term.to_string());
            }
            let _ = TermId::all_of(family.key(), &broken);
        }
        let _ = (broken.compliances(), broken.linkage_terms(), broken.kinematics.characteristic_length());
    }
}
