use super::modes::{ParameterSums, Rows};
use super::*;
use calibrig_campaign::design::Sampling;
use calibrig_campaign::table::{Cell, Column, Kind};
use calibrig_estimation::evaluation::Coverage;
use calibrig_model::ParameterId;

/// A table of numbers, and of texts where the name says so.
fn table(columns: &[(&str, Kind)], rows: Vec<Vec<Cell>>) -> MemoryTable {
    MemoryTable::new(columns.iter().map(|(name, kind)| Column::new(*name, *kind)).collect(), rows)
}

fn numbers(name: &str, values: &[f64]) -> MemoryTable {
    table(&[(name, Kind::Number)], values.iter().map(|v| vec![Cell::Number(*v)]).collect())
}

fn mean_of(values: &[f64]) -> Option<MeanWithInterval> {
    let table = numbers("x", values);
    Rows { table: &table, rows: 0..table.rows(), tolerance: None }.mean("x").expect("the column")
}

#[test]
fn a_mean_with_its_interval_by_hand() {
    let m = mean_of(&[1.0, 2.0, 3.0, 4.0, 5.0]).expect("five values");
    assert_eq!((m.mean, m.trials), (3.0, 5));
    // t(0.975, 4) = 2.776445, s = sqrt(2.5).
    assert!((m.half_width.expect("five") - 2.776_445 * (2.5_f64 / 5.0).sqrt()).abs() < 1e-5);
    assert_eq!(m.quantiles, [1.2, 3.0, 4.8]);
    assert_eq!(mean_of(&[7.0]).expect("one").half_width, None);
    assert_eq!(mean_of(&[]), None);
}

#[test]
fn coverage_of_predictions_by_hand() {
    let columns = [("extended.predictions_inside", Kind::Integer), ("extended.predictions", Kind::Integer)];
    let of = |pairs: &[(i64, i64)]| {
        let rows = pairs.iter().map(|(a, b)| vec![Cell::Integer(*a), Cell::Integer(*b)]).collect();
        let table = table(&columns, rows);
        let rows = Rows { table: &table, rows: 0..table.rows(), tolerance: None };
        rows.predictions(Mode::Extended).expect("the columns")
    };
    let two = of(&[(10, 10), (8, 10)]).expect("two trials");
    assert_eq!(two.coverage, Coverage { hits: 18, trials: 20 });
    // Fractions 1 and 0.8: their mean has the standard error 0.1, and t(0.9995, 1) = 636.619.
    assert!((two.half_width.expect("two") - 63.661_9).abs() < 1e-3);
    assert_eq!(of(&[(3, 3)]).expect("one").half_width, None);
    assert_eq!(of(&[(0, 0)]), None);
}

#[test]
fn a_parameter_by_hand() {
    let id = ParameterId::Mass { link: 0 };
    let of = |entries: &[(f64, f64, Option<f64>, Option<f64>)]| {
        let mut sums = ParameterSums::default();
        for (error, sigma, one, other) in entries {
            sums.add(*error, *sigma, [*one, *other]);
        }
        sums.summary(id)
    };
    let p = of(&[(3.0, 1.0, Some(0.6), None), (-1.0, 1.0, Some(0.8), None)]).expect("two errors");
    assert_eq!((p.bias.value, p.stated, p.bayesian), (1.0, 1.0, None));
    assert!((p.rmse.value - 5.0_f64.sqrt()).abs() < 1e-15);
    assert!((p.consistency.value - 5.0_f64.sqrt()).abs() < 1e-15);
    assert!((p.least().expect("a bound") - 0.5_f64.sqrt()).abs() < 1e-15);
    assert!((p.over_bound.expect("a bound").value - 10.0_f64.sqrt()).abs() < 1e-12);
    assert_eq!(p.coverage, Coverage { hits: 1, trials: 2 });
    let drawn = of(&[(3.0, 1.0, Some(0.6), Some(0.1)), (-1.0, 1.0, Some(0.8), Some(0.1))]).expect("two");
    assert!((drawn.least().expect("a bound") - 0.1).abs() < 1e-15);
    // Where one trial lacks a bound, there is none of all.
    let lacking = of(&[(3.0, 1.0, Some(0.6), None), (-1.0, 1.0, None, None)]).expect("two");
    assert_eq!((lacking.cramer_rao, lacking.least()), (None, None));
    assert_eq!(of(&[]), None);
}

#[test]
fn reasons_that_differ_in_numbers_alone_are_one() {
    let columns = [
        ("trial", Kind::Integer),
        ("status", Kind::Text),
        ("reason", Kind::Text),
        ("redrawn", Kind::Integer),
    ];
    let row = |trial, status: &str, reason: &str, redrawn| {
        vec![Cell::Integer(trial), Cell::text(status), Cell::text(reason), Cell::Integer(redrawn)]
    };
    let table = table(
        &columns,
        vec![
            row(0, "ok", "", 2),
            row(1, "failed", "pose 7 is 1.5e-3 m off", 0),
            row(2, "failed", "no rank", 0),
            row(3, "failed", "pose 12 is 2.25 m off", 1),
            row(4, "doubtful", "", 0),
        ],
    );
    let counts = Counts::of(&table).expect("the columns");
    assert_eq!((counts.failed, counts.doubtful, counts.redrawn), (3, 1, 3));
    let told: Vec<_> = counts.reasons.iter().map(|r| (r.text.as_str(), r.trial, r.count)).collect();
    assert_eq!(told, [("pose 7 is 1.5e-3 m off", 1, 2), ("no rank", 2, 1)]);
}

#[test]
fn combinations_of_a_sweep_are_groups_also_of_a_table_that_is_not_complete() {
    let factor = |name: &str, levels: &[&str]| crate::scenario::Factor {
        name: name.to_owned(),
        keys: vec![name.to_owned()],
        scale: false,
        whole: false,
        values: crate::scenario::FactorValues::Levels(levels.iter().map(ToString::to_string).collect()),
    };
    let study = Study {
        plant: "analytic".to_owned(),
        design: Design::Sweep { levels: vec![2, 3], repeats: 10 },
        factors: vec![factor("a", &["1", "2"]), factor("b", &["x", "y", "z"])],
        machines_are_drawn: false,
        tolerance: None,
        modes: Vec::new(),
    };
    let groups = groups_of(&study, 0, 60);
    assert_eq!(groups.len(), 6);
    assert_eq!(groups[4], (vec!["2".to_owned(), "y".to_owned()], 40..50));
    let groups = groups_of(&study, 0, 25);
    assert_eq!(groups.last(), Some(&(vec!["1".to_owned(), "z".to_owned()], 20..25)));
    let plain =
        Study { design: Design::Plain { trials: 9, factors: 0, sampling: Sampling::Random }, ..study };
    assert_eq!(groups_of(&plain, 4, 5), [(Vec::new(), 0..5)]);
}
