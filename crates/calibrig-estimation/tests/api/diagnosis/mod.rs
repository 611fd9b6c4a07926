//! Random sessions with something broken in them: what is told of them, how often it is right, and that nothing is told of sound ones.

mod robots;
mod session;

use std::collections::BTreeMap;

use calibrig_estimation::diagnosis::{Diagnosis, Hypothesis, diagnose};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use session::{Told, Truth, session};

/// Mirrored, axes exchanged, azimuth the other way: one class where the tracker's frame is free.
fn class(kind: &'static str) -> &'static str {
    match kind {
        "axes_exchanged" | "azimuth_sense" => "mirrored_frame",
        kind => kind,
    }
}

/// Kinds, and where, of what a hypothesis says.
fn told(hypothesis: &Hypothesis) -> Vec<(&'static str, Vec<usize>, Vec<usize>)> {
    let mut told: Vec<_> = hypothesis
        .parts
        .iter()
        .map(|part| {
            let (mut joints, mut rows) = (part.joints(), part.rows());
            joints.sort_unstable();
            rows.sort_unstable();
            (class(part.kind()), joints, rows)
        })
        .collect();
    told.sort();
    told
}

fn truth(truths: &[Truth]) -> Vec<(&'static str, Vec<usize>, Vec<usize>)> {
    let mut told: Vec<_> = truths
        .iter()
        .map(|truth| {
            let (mut joints, mut rows) = (truth.joints.clone(), truth.rows.clone());
            joints.sort_unstable();
            rows.sort_unstable();
            (class(truth.kind), joints, rows)
        })
        .collect();
    told.sort();
    told
}

/// Whether the first hypothesis is the right one, or one that fits the points of the robot as drawn exactly: nobody can tell them apart.
fn is_right(of: &Told, found: &Diagnosis) -> bool {
    let first = &found.hypotheses[0];
    if told(first) == truth(&of.truths) {
        return true;
    }
    let exact = diagnose(&of.model, &of.exact).expect("a session");
    let fits = |h: &&Hypothesis| h.rms < 1e-7 * exact.spread;
    let as_good: Vec<&Hypothesis> = exact.hypotheses.iter().filter(fits).collect();
    as_good.iter().any(|h| told(h) == truth(&of.truths)) && as_good.iter().any(|h| told(h) == told(first))
}

fn print_first(found: &Diagnosis) {
    for h in found.hypotheses.iter().take(6) {
        println!(
            "    {:?} rms {:.3} mm, links {:.4} mm, +{:.1}, class {}",
            told(h),
            1e3 * h.rms,
            1e3 * h.rms_links,
            h.above_first,
            h.class
        );
    }
}

fn rate(count: usize, sessions: u64, seed: u64) -> f64 {
    let mut right = 0_u32;
    let mut wrong: BTreeMap<&str, usize> = BTreeMap::new();
    for trial in 0..sessions {
        let mut rng = ChaCha8Rng::seed_from_u64(1000 * seed + trial);
        let of = session(count, &mut rng);
        let found = diagnose(&of.model, &of.set).expect("a session");
        if is_right(&of, &found) {
            right += 1;
        } else {
            let kinds = of.truths.iter().map(|t| t.kind);
            kinds.for_each(|kind| *wrong.entry(kind).or_default() += 1);
            println!(
                "trial {trial} ({}, {} rows): {:?}",
                of.table.style,
                of.set.observations.len(),
                truth(&of.truths)
            );
            print_first(&found);
            println!("  of the robot as drawn:");
            print_first(&diagnose(&of.model, &of.exact).expect("a session"));
        }
    }
    println!("{count} broken: {right} of {sessions} right; wrong: {wrong:?}");
    f64::from(right) / sessions as f64
}

fn sessions(whole: u64) -> u64 {
    if std::env::var_os("CALIBRIG_FULL").is_some() { whole } else { whole / 10 }
}

#[test]
fn one_broken_convention_is_found() {
    assert!(rate(1, sessions(200), 1) >= 0.95);
}

#[test]
fn two_broken_conventions_are_found() {
    assert!(rate(2, sessions(100), 2) >= 0.85);
}

#[test]
fn nothing_is_told_of_sound_sessions() {
    assert!(rate(0, sessions(200), 3) >= 1.0);
}
