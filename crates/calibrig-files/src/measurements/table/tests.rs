//! Tables against what other programs wrote, and whatever is damaged.

mod bags;
mod sheets;

use std::io::Cursor;
use std::path::{Path, PathBuf};

use calibrig_model::random::{StreamSource as Stream, stream};
use proptest::prelude::*;
use rand::RngExt;
use rust_xlsxwriter::{ExcelDateTime, Format, Formula, Workbook};

use super::bag::{BagOptions, bag_of};
use super::sheet::parse_sheet;
use super::*;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/tables").join(name)
}

/// What `tests/tools/make_tables.py` put into its files.
const NAMES: [&str; 6] = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"];
const POSES: u32 = 12;

fn joint(pose: u32, number: usize) -> f64 {
    1.5 * (1.3 * f64::from(pose) + 0.7 * number as f64).sin()
}

fn place(pose: u32) -> [f64; 3] {
    let pose = f64::from(pose);
    [1.0 + 0.01 * pose, -0.5 + 0.1 * pose.cos(), 0.3 * (2.0 * pose).sin()]
}

fn numbers(row: &TableRow) -> Vec<f64> {
    row.cells.iter().map(|cell| cell.parse().unwrap_or_else(|_| panic!("{cell:?} is not a number"))).collect()
}

#[track_caller]
fn assert_near(found: &[f64], expected: impl IntoIterator<Item = f64>) {
    let expected: Vec<f64> = expected.into_iter().collect();
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        assert!(
            (found - expected).abs() <= 4.0 * f64::EPSILON * expected.abs().max(1.0),
            "{found} {expected}"
        );
    }
}
