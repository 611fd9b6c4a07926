//! What nests and measured targets show in addition to the points.

use nalgebra::{Matrix3, Point3, Vector3};

use super::*;
use calibrig_model::measurement::NestObservation;

fn stated(set: &mut MeasurementSet) {
    set.targets[0].in_flange = TOOL;
    set.targets[0].covariance = Some(Matrix3::identity() * 1e-8);
}

/// Nests around the base, seen from where [`measure`] puts the tracker.
fn with_nests(set: &mut MeasurementSet) {
    let place: Transform = translation(3.0, -1.0, 0.5) * rotation_z(0.7) * rotation_x(0.02);
    let places = [(1.5, 0.2, 0.0), (-1.1, 0.9, 0.1), (0.2, -1.4, 0.3), (0.4, 1.2, 1.0)];
    set.stations[0].nests = places
        .iter()
        .map(|(x, y, z)| NestObservation {
            time: None,
            name: format!("{x}"),
            in_base: Vector3::new(*x, *y, *z),
            in_base_covariance: Matrix3::identity() * 1e-9,
            reading: Reading::Cartesian {
                position: (place * Point3::new(*x, *y, *z)).coords,
                covariance: Some(Matrix3::identity() * 1e-9),
            },
        })
        .collect();
}

fn turned(set: &mut MeasurementSet, joint: usize, by: f64) {
    set.observations.iter_mut().for_each(|o| o.command[joint] += by);
}

/// A wrong zero of the last joint turns the target about its axis: found where the target is stated, and invisible where it is free.
#[test]
fn the_zero_of_the_last_joint_is_told_where_the_target_is_stated() {
    let model = industrial();
    for (by, quarters) in [(FRAC_PI_2, -1), (-FRAC_PI_2, 1), (PI, 2)] {
        let mut set = measure(&model, 30, 1e-3);
        turned(&mut set, 5, by);
        assert_eq!(first(&model, &set).1, ["sound"]);
        stated(&mut set);
        let (found, _) = first(&model, &set);
        assert_eq!(found.hypotheses[0].parts, [Part::Offset { joint: 5, quarters }], "{found:?}");
    }
    // A sound session stays sound, also if the statement is off by some tenths of a millimetre.
    let mut set = measure(&model, 30, 1e-3);
    stated(&mut set);
    set.targets[0].in_flange += Vector3::new(3e-4, -2e-4, 1e-4);
    assert_eq!(first(&model, &set).1, ["sound"]);
}

/// A wrong zero of the first joint turns the base: found where nests determine the base.
#[test]
fn the_zero_of_the_first_joint_is_told_where_nests_place_the_base() {
    let model = industrial();
    for (by, quarters) in [(FRAC_PI_2, -1), (-FRAC_PI_2, 1), (PI, 2)] {
        let mut set = measure(&model, 30, 1e-3);
        turned(&mut set, 0, by);
        assert_eq!(first(&model, &set).1, ["sound"]);
        with_nests(&mut set);
        let (found, _) = first(&model, &set);
        assert_eq!(found.hypotheses[0].parts, [Part::Offset { joint: 0, quarters }], "{found:?}");
    }
    // Nothing is free where both are stated.
    let mut set = measure(&model, 30, 1e-3);
    with_nests(&mut set);
    stated(&mut set);
    assert_eq!(first(&model, &set).1, ["sound"]);
    set.targets[0].covariance = None;
    assert_eq!(first(&model, &set).1, ["sound"]);
    // The nests are read in the same way as the points.
    for nest in &mut set.stations[0].nests {
        let p = nest.reading.position();
        nest.reading = Reading::Cartesian { position: Vector3::new(p.y, p.x, p.z), covariance: None };
    }
    points(&mut set, |p| Vector3::new(p.y, p.x, p.z));
    assert_eq!(first(&model, &set).1, ["mirrored_frame"]);
}
