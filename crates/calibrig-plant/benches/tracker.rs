//! How fast a tracker with every error on reads points, and an acceptance test goes, on one core.

// The functions that criterion generates have no docs; a bench may stop at its first error.
#![allow(missing_docs, clippy::expect_used)]

use std::hint::black_box;

use calibrig_model::measurement::Face;
use calibrig_model::nalgebra::Vector3;
use calibrig_model::random::{StreamSource, stream};
use calibrig_plant::tracker::acceptance::draw_and_test;
use calibrig_plant::tracker::{
    Air, Conditions, DriftLaw, EnvironmentLaw, Instrument, LaserTracker, Motion, Preset, Shot, SmrLaw,
    is_missed,
};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};

const OBSERVATIONS: usize = 10_000;

/// With everything that a tracker can have.
fn tracker() -> LaserTracker {
    let instrument = Instrument { air: 0.5e-6, ..Preset::At500.instrument() };
    let mut tracker = LaserTracker::levelled(instrument, Vector3::new(4.0, 1.0, 1.5), 0.3, &Vector3::z());
    tracker.conditions = Conditions {
        environment: Some(EnvironmentLaw {
            air: Air::ROOM,
            sensor_sigma: Air { temperature: 0.3, pressure: 100.0, humidity: 0.05 },
            gradient: 0.4,
        }),
        drift: Some(DriftLaw {
            ramp: Motion { shift: 1e-5, turn: 1e-6 },
            warm_up: [Motion { shift: 2e-5, turn: 0.0 }, Motion { shift: 8e-5, turn: 1e-6 }],
            warm_up_time: 1200.0,
            walk: Motion { shift: 3e-5, turn: 1e-6 },
        }),
        smr: Some(SmrLaw { centring_sigma: 3e-6, seat_sigma: 4e-6, acceptance: 0.5 }),
        misses: 0.005,
    };
    tracker.drawn(1, 0, 0, 10.0 * OBSERVATIONS as f64).expect("an instrument that passes")
}

fn benches(c: &mut Criterion) {
    let tracker = tracker();
    let points: Vec<_> = (0..OBSERVATIONS)
        .map(|k| {
            let k = k as f64;
            Vector3::new((0.7 * k).sin(), 2.0 * (1.1 * k).sin(), 1.5 + (1.9 * k).sin())
        })
        .collect();
    let smr = tracker.conditions.smr.expect("stated").draw(&mut stream(1, 0, StreamSource::Smr));
    let mut group = c.benchmark_group("tracker");
    group.throughput(Throughput::Elements(OBSERVATIONS as u64));
    group.bench_function("observations with every error on", |b| {
        let mut noise = stream(1, 0, StreamSource::IdentificationNoise);
        let mut misses = stream(1, 0, StreamSource::Misses);
        b.iter(|| {
            let mut sum = 0.0;
            for (index, point) in points.iter().enumerate() {
                if is_missed(tracker.conditions.misses, &mut misses) {
                    continue;
                }
                let face = if index % 2 == 0 { Face::Front } else { Face::Back };
                let shot = Shot { face, ..Shot::at(10.0 * index as f64) };
                let seen = point + smr.centring;
                sum += tracker.measure(black_box(&seen), &shot, &mut noise).expect("in reach").range;
            }
            sum
        });
    });
    group.throughput(Throughput::Elements(1));
    group.bench_function("acceptance test of an instrument", |b| {
        let mut trial = 0;
        b.iter(|| {
            trial += 1;
            draw_and_test(black_box(&tracker.instrument), 1, trial, 0).expect("in reach").1.passes()
        });
    });
    group.finish();
}

criterion_group!(all, benches);
criterion_main!(all);
