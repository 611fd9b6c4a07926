//! A gigabyte of text, read: bytes a second, and the memory that it takes beside the set itself.
//!
//! `cargo bench -p calibrig-files --bench text`, with the number of megabytes behind `--` where it should be another

// A bench may stop at its first error.
#![allow(clippy::expect_used, clippy::disallowed_methods, missing_docs)]

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::time::Instant;

use calibrig_files::{ColumnMap, Source, parse_column_map, read_measurements};
use calibrig_model::JointKind;

const MEGABYTES: u64 = 1000;
const MAP: &str = "schema = \"calibrig.columns/1\"\n[joints]\ncolumns = [\"J1\", \"J2\", \"J3\", \"J4\", \"J5\", \"J6\"]\nrevolute_unit = \"deg\"\n\
                   [position]\nsystem = \"cartesian\"\nunit = \"mm\"\nx = \"X\"\ny = \"Y\"\nz = \"Z\"\n";

fn main() {
    let asked = std::env::args().skip(1).find_map(|argument| argument.parse().ok());
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("m.csv");
    let bytes = write(&path, 1_000_000 * asked.unwrap_or(MEGABYTES)).expect("written");
    let map: ColumnMap = parse_column_map(&Source::new("map.toml", MAP)).expect("a map");
    // Once for the page cache, so that it is not the disk that is measured.
    std::io::copy(&mut File::open(&path).expect("there"), &mut std::io::sink()).expect("read");
    let before = kibibytes("VmRSS");
    let (begun, worked) = (Instant::now(), processor_seconds());
    let loaded = read_measurements(&path, &map, &[JointKind::Revolute; 6]).expect("valid");
    let (seconds, worked) = (begun.elapsed().as_secs_f64(), processor_seconds() - worked);
    let (after, peak) = (kibibytes("VmRSS"), kibibytes("VmHWM"));
    let megabytes = bytes as f64 / 1e6;
    let rows = loaded.set.observations.len();
    println!(
        "{megabytes:.0} MB, {rows} rows: {seconds:.1} s, {:.0} MB/s; {worked:.1} s of a processor, {:.0} MB/s",
        megabytes / seconds,
        megabytes / worked
    );
    println!(
        "the set takes {:.0} MiB, the most while it was read is {:.1} MiB above it",
        (after - before) / 1024.0,
        (peak - after) / 1024.0
    );
    println!("before it was read the process took {:.1} MiB", before / 1024.0);
}

/// Rows of six joints and a position, until there are so many bytes.
fn write(path: &Path, bytes: u64) -> std::io::Result<u64> {
    let mut file = BufWriter::new(File::create(path)?);
    let (mut written, mut row) = (0, 0_u32);
    writeln!(file, "No,J1,J2,J3,J4,J5,J6,X,Y,Z")?;
    let mut line = Vec::new();
    while written < bytes {
        line.clear();
        let angle = |joint: f64| 170.0 * (f64::from(row) * 0.37 * joint).sin();
        let place = |axis: f64| 2500.0 + 1200.0 * (f64::from(row) * 0.11 * axis).cos();
        write!(line, "{row}")?;
        for joint in 1..=6 {
            write!(line, ",{:.5}", angle(f64::from(joint)))?;
        }
        writeln!(line, ",{:.4},{:.4},{:.4}", place(1.0), place(2.0), place(3.0))?;
        file.write_all(&line)?;
        written += line.len() as u64;
        row += 1;
    }
    file.flush()?;
    Ok(written)
}

/// What the process had of its processors, where the system says: on a machine with other work, less than the time that went by.
fn processor_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields = stat.rsplit(')').next().unwrap_or_default().split_whitespace();
    // Hundredths of a second in user and in system mode.
    fields.skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / 100.0
}

/// Memory of the process, where the system says.
fn kibibytes(what: &str) -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix(what)?.strip_prefix(':'));
    line.and_then(|line| line.trim().trim_end_matches(" kB").trim().parse().ok()).unwrap_or(f64::NAN)
}
