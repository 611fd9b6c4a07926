//! What tables and merges take: `cargo bench -p calibrig-campaign --bench table`. With `CALIBRIG_FULL=1` of a million rows, once.

#![allow(clippy::expect_used)]

use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

use calibrig_campaign::shards::{Folder, Input, Manifest, Software};
use calibrig_campaign::statistics::quantiles;
use calibrig_campaign::table::{Cell, Column, Kind, Table, TableReader};
use criterion::Criterion;

/// As a mode with some 33 parameters has.
const NUMBERS: usize = 200;

fn manifest(trials: u64, shards: u32) -> Manifest {
    let mut columns = vec![Column::new("trial", Kind::Integer), Column::new("status", Kind::Text)];
    columns.extend((0..NUMBERS).map(|n| Column::new(format!("x{n}_m"), Kind::Number)));
    Manifest {
        schema: Manifest::schema(),
        name: "bench".to_owned(),
        scenario: "bench.toml".to_owned(),
        software: Software {
            version: "0".to_owned(),
            binary_sha256: "0".to_owned(),
            target: "any".to_owned(),
        },
        inputs: vec![Input { role: "scenario".to_owned(), sha256: "0".to_owned() }],
        seed: 1,
        first: 0,
        trials,
        shards,
        study: serde_json::Value::Null,
        columns,
    }
}

/// A number whose low bits are as random as those of a measured one.
fn number(trial: u64, column: u64) -> f64 {
    let mixed = (trial * 1000 + column).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    1e-4 * (1.0 + (mixed >> 11) as f64 / (1_u64 << 53) as f64)
}

fn row(trial: u64) -> Vec<Cell> {
    let mut cells = vec![Cell::count(trial), Cell::text("ok")];
    cells.extend((0..NUMBERS as u64).map(|column| Cell::Number(number(trial, column))));
    cells
}

fn shards(path: &Path, trials: u64, shards: u32) -> Folder {
    let folder = Folder::begin(path, &manifest(trials, shards)).expect("a folder");
    for shard in 0..shards {
        let range = folder.manifest().range_of(shard);
        let mut part = folder.begin_part().expect("a part");
        range.clone().for_each(|trial| part.push(&row(trial)).expect("a row"));
        folder.put_part(&range, part).expect("room");
        folder.complete_shard(shard).expect("a shard");
    }
    folder
}

fn merge(folder: &Folder) {
    let inventory = folder.inventory(&mut |_| {});
    folder.merge(&inventory, &mut |_| {}).expect("all shards");
}

fn exact_quantiles(table: &TableReader) -> f64 {
    let column = table.place_of("x7_m").expect("a column");
    let visit = |take: &mut dyn FnMut(f64)| {
        table
            .visit(&[column], 0..table.rows(), &mut |row| row[0].as_number().into_iter().for_each(&mut *take))
    };
    quantiles(visit, &[0.05, 0.5, 0.95], 0.95).expect("numbers").quantiles[1].estimate.value
}

fn main() {
    let root = tempfile::tempdir().expect("a folder");
    if std::env::var_os("CALIBRIG_FULL").is_some() {
        // The wall of one pass is what is asked for.
        #[allow(clippy::disallowed_methods)]
        let clock = Instant::now;
        let begun = clock();
        let folder = shards(root.path(), 1_000_000, 40);
        println!(
            "40 shards of a million rows of {NUMBERS} numbers written in {:.1} s",
            begun.elapsed().as_secs_f64()
        );
        let begun = clock();
        merge(&folder);
        let bytes = std::fs::metadata(folder.table()).expect("a table").len();
        println!("merged in {:.1} s: {:.0} MB", begun.elapsed().as_secs_f64(), bytes as f64 / 1e6);
        let begun = clock();
        let table = TableReader::open(&folder.table()).expect("a table");
        println!("median of a column {} in {:.2} s", exact_quantiles(&table), begun.elapsed().as_secs_f64());
        return;
    }
    let mut criterion = Criterion::default().sample_size(10).configure_from_args();
    let folder = shards(root.path(), 20_000, 8);
    criterion.bench_function("merge 20,000 rows of 200 numbers in 8 shards", |b| {
        b.iter(|| merge(black_box(&folder)));
    });
    let table = TableReader::open(&folder.table()).expect("a table");
    criterion
        .bench_function("three quantiles of 20,000 rows", |b| b.iter(|| exact_quantiles(black_box(&table))));
    criterion.final_summary();
}
