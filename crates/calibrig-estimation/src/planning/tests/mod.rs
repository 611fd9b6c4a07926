mod brute_force;
mod orders;
mod published;
mod refusals;
mod robots;
mod spray_painter;

use nalgebra::DMatrix;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{DesignRows, DesignSpace, ParameterScale};
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::{LinkTerm, ParameterId};

fn names(count: usize) -> Vec<ParameterId> {
    (0..count).map(|link| ParameterId::Link { link, term: LinkTerm::Theta }).collect()
}

fn drawn(rng: &mut ChaCha8Rng, rows: usize, columns: usize) -> DMatrix<f64> {
    DMatrix::from_fn(rows, columns, |_, _| rng.random_range(-1.0..1.0))
}

/// Random rows: candidates of one to three rows about `p` parameters, with a weak prior or none, and four poses to predict.
fn random_rows(seed: u64, candidates: usize, p: usize, prior: bool) -> DesignRows {
    let mut rng = stream(seed, 0, StreamSource::Splits);
    let rng = &mut rng;
    DesignRows {
        candidates: (0..candidates).map(|i| drawn(rng, 1 + i % 3, p)).collect(),
        fixed: if prior { DMatrix::identity(p, p) * 0.1 } else { DMatrix::zeros(0, p) },
        region: (0..4).map(|_| drawn(rng, 3, p)).collect(),
        beside: Vec::new(),
    }
}

fn space(rows: &DesignRows) -> DesignSpace {
    let p = rows.fixed.ncols();
    DesignSpace::new(names(p), rows, &ParameterScale::Effect).expect("a space")
}

/// All ways to choose `count` of `from..candidates`, in ascending order.
fn subsets(from: usize, candidates: usize, count: usize, repeats: bool) -> Vec<Vec<usize>> {
    if count == 0 {
        return vec![Vec::new()];
    }
    let mut all = Vec::new();
    for first in from..candidates {
        for rest in subsets(first + usize::from(!repeats), candidates, count - 1, repeats) {
            all.push([vec![first], rest].concat());
        }
    }
    all
}
