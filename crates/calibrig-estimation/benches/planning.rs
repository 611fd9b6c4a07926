//! Choosing 60 of 10,000 candidate poses of three rows each about 45 parameters, on one core, by every criterion that is linear or a determinant; and the
//! order of 60 poses.
//!
//! `cargo bench --bench planning`

#![allow(clippy::expect_used, missing_docs)]

use std::hint::black_box;

use calibrig_estimation::planning::{
    Choice, Criterion, DesignRows, DesignSpace, OrderWeights, ParameterScale, Way, choose, ordered,
};
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::{LinkTerm, ParameterId};
use criterion::{Criterion as Bench, criterion_group, criterion_main};
use nalgebra::{DMatrix, RowDVector};
use rand::RngExt;

const PARAMETERS: usize = 45;

/// Smooth functions of seven joint variables, as the columns of a robot are.
fn space() -> DesignSpace {
    let mut rng = stream(1, 0, StreamSource::Splits);
    let paces = DMatrix::from_fn(7, 3 * PARAMETERS, |_, _| rng.random_range(-1.5_f64..1.5));
    let mut block = || {
        let joints = RowDVector::from_fn(7, |_, _| rng.random_range(-1.0_f64..1.0));
        DMatrix::from_fn(3, PARAMETERS, |i, j| joints.tr_dot(&paces.column(3 * j + i)).sin() + 0.1)
    };
    let rows = DesignRows {
        candidates: (0..10_000).map(|_| block()).collect(),
        fixed: DMatrix::identity(PARAMETERS, PARAMETERS) * 0.1,
        region: (0..200).map(|_| block()).collect(),
        beside: Vec::new(),
    };
    let link = |link| ParameterId::Link { link, term: LinkTerm::Theta };
    DesignSpace::new((0..PARAMETERS).map(link).collect(), &rows, &ParameterScale::Effect).expect("a space")
}

fn planning(bench: &mut Bench) {
    let space = space();
    let mut group = bench.benchmark_group("60 of 10000 poses, 45 parameters");
    group.sample_size(10);
    for criterion in [Criterion::D, Criterion::I, Criterion::A, Criterion::E, Criterion::G] {
        for starts in [0, 2] {
            let choice = Choice { criterion, starts, ..Choice::of(60) };
            group.bench_function(format!("{}, {starts} random starts", criterion.key()), |bench| {
                bench.iter(|| choose(black_box(std::slice::from_ref(&space)), &choice).expect("a design"));
            });
        }
    }
    group.finish();
    let mut rng = stream(2, 0, StreamSource::Splits);
    let commands: Vec<Vec<f64>> =
        (0..60).map(|_| (0..7).map(|_| rng.random_range(-1.0..1.0)).collect()).collect();
    let weights = OrderWeights { balance: 60.0, drift: 0.0 };
    let way = Way { commands: &commands, home: None, speeds: &[0.3; 7], drift: None, weights };
    bench.bench_function("order of 60 poses", |bench| {
        bench.iter(|| ordered(black_box(&way)).expect("an order"));
    });
}

criterion_group!(benches, planning);
criterion_main!(benches);
