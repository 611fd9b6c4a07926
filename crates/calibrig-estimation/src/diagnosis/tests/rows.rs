//! Bad rows among those that are weighed and among all others.

use super::*;

fn exchange(set: &mut MeasurementSet, a: usize, b: usize) {
    let first = set.observations[a].reading.clone();
    set.observations[a].reading = set.observations[b].reading.clone();
    set.observations[b].reading = first;
}

/// Moves the points of some rows to where another target on the flange would be seen.
fn of_another_target(
    model: &CalibrationModel,
    set: &mut MeasurementSet,
    rows: &[usize],
    offset: Vector3<f64>,
) {
    let place: Transform = translation(3.0, -1.0, 0.5) * rotation_z(0.7) * rotation_x(0.02);
    for row in rows {
        let command = set.observations[*row].command.clone();
        let at = |target: &Vector3<f64>| target_in_base(&model.kinematics, &command, target).expect("a pose");
        let moved = place.rotation * (at(&offset) - at(&TOOL));
        let position = set.observations[*row].reading.position() + moved;
        set.observations[*row].reading = Reading::Cartesian { position, covariance: None };
    }
}

#[test]
fn three_targets_under_one_name_are_told_apart() {
    let model = industrial();
    let of = |remainder: usize| (0..60).filter(|i| i % 4 == remainder).collect::<Vec<_>>();
    let groups = [of(1), of(3)];
    let mut set = measure(&model, 60, 1e-3);
    of_another_target(&model, &mut set, &groups[0], Vector3::new(-0.1, 0.02, 0.15));
    of_another_target(&model, &mut set, &groups[1], Vector3::new(0.02, 0.14, 0.05));
    let (found, _) = first(&model, &set);
    let [Part::SeveralTargets { target: 0, others }] = found.hypotheses[0].parts.as_slice() else {
        panic!("{found:?}");
    };
    let mut others = others.clone();
    others.sort();
    assert_eq!(others, groups);
}

/// An explanation by a joint that never moved does not come before several targets alone.
#[test]
fn targets_are_told_alone_where_a_joint_never_moved() {
    let model = industrial();
    let mut set = measure(&model, 60, 0.0);
    for observation in &mut set.observations {
        // The first axis is equivalent to the tracker's place.
        let turn = rotation_z(-observation.command[0]);
        let place: Transform = translation(3.0, -1.0, 0.5) * rotation_z(0.7) * rotation_x(0.02);
        let in_base = place.inverse() * Point3::from(observation.reading.position());
        let position = (place * turn * in_base).coords;
        (observation.command[0], observation.reading) =
            (0.0, Reading::Cartesian { position, covariance: None });
    }
    let second: Vec<usize> = (40..60).collect();
    of_another_target(&model, &mut set, &second, Vector3::new(-0.1, 0.02, 0.15));
    let (found, _) = first(&model, &set);
    assert_eq!(found.hypotheses[0].parts, [Part::SeveralTargets { target: 0, others: vec![second] }]);
}

/// For long files only a part of the rows is weighed; the rows between are examined nevertheless.
#[test]
fn rows_between_those_that_are_weighed_are_looked_at() {
    let model = industrial();
    let sound = measure(&model, 1000, 1e-3);
    let told = |set: &MeasurementSet| first(&model, set).0.hypotheses[0].parts.clone();
    // Two exchanged rows and two that are off; one of each is weighed.
    let mut set = sound.clone();
    exchange(&mut set, 400, 511);
    for row in [600, 701] {
        let position = set.observations[row].reading.position() + Vector3::new(0.0, 0.03, 0.0);
        set.observations[row].reading = Reading::Cartesian { position, covariance: None };
    }
    let parts = told(&set);
    let [Part::ExchangedRows { cycles }, Part::GrossErrors { rows }] = parts.as_slice() else {
        panic!("{parts:?}");
    };
    let mut cycle = cycles[0].clone();
    cycle.sort_unstable();
    assert_eq!((cycles.len(), cycle), (1, vec![400, 511]));
    let mut off: Vec<usize> = rows.iter().map(|far| far.observation).collect();
    off.sort_unstable();
    assert_eq!(off, [600, 701]);
    // Every row is assigned to its target.
    let mut set = sound.clone();
    let second: Vec<usize> = (0..1000).filter(|i| i % 7 < 3).collect();
    of_another_target(&model, &mut set, &second, Vector3::new(-0.1, 0.02, 0.15));
    assert_eq!(told(&set), [Part::SeveralTargets { target: 0, others: vec![second] }]);
}

#[test]
fn progress_goes_up_to_the_end() {
    let model = industrial();
    let set = measure(&model, 30, 1e-3);
    let mut told = Vec::new();
    let found = diagnose_with(&model, &set, |done, of| told.push((done, of)));
    assert_eq!(found, diagnose(&model, &set));
    assert!(told.len() > 100 && told.is_sorted(), "{told:?}");
    assert!(told.iter().all(|(done, of)| done <= of && *of == told[0].1));
}
