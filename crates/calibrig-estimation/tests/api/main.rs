//! What the public functions do with what cannot be: always an error with the field in its text (or `None`), never a panic.
//!
//! A valid robot, set or estimate is drawn, and one thing of it is broken. Proptest fails a case that panics; a call that hangs fails the run.

// What a test expects of its own robots is no case of the interface.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod beams;
mod circle_points;
mod coverage;
mod diagnosis;
mod divided;
mod drift;
mod extremes;
mod faults;
mod four_bar;
mod hidden;
mod instrument;
mod numbers;
mod poses;
mod predictions;
mod presliding_size;
mod robots;
mod round_trip;
mod several;
mod smooth;

use std::fmt::Display;

/// The text of the error that was due.
#[track_caller]
fn refused<T, E: Display>(result: Result<T, E>, by: &str) -> String {
    match result {
        Ok(_) => panic!("{by}: taken for valid"),
        Err(error) => error.to_string(),
    }
}

/// That there was an error, and that it names the field.
#[track_caller]
fn names<T, E: Display>(result: Result<T, E>, field: &str, by: &str) {
    let text = refused(result, by);
    assert!(text.contains(field), "{by}: expected {field:?} in {text:?}");
}
