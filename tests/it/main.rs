//! Tests of the whole: what a user does, and what keeps the code in shape.

// Helpers of tests stand outside `#[test]` functions, where clippy's leave for tests does not reach.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod a_user_brings_a_robot;
mod a_user_brings_files;
mod a_user_brings_full_poses;
mod a_user_calibrates_a_palletizer;
mod a_user_calibrates_a_real_robot;
mod a_user_checks_the_elimination;
mod a_user_chooses_parameters;
mod a_user_compares_with_the_truth;
mod a_user_corrects_commands;
mod a_user_counts_axes_otherwise;
mod a_user_drives_corrected_commands;
mod a_user_exchanges_files;
#[cfg(unix)]
mod a_user_follows_the_guide;
mod a_user_has_a_copy_of_another_writer;
mod a_user_has_a_damaged_recording;
#[cfg(unix)]
mod a_user_has_a_killed_run;
mod a_user_has_a_machine_that_no_formula_fits;
mod a_user_has_a_session_that_makes_no_sense;
mod a_user_has_a_sheet_or_a_bag;
mod a_user_has_a_twin_made;
mod a_user_has_no_room;
mod a_user_judges_an_estimate;
mod a_user_knows_no_stiffness;
mod a_user_makes_a_mistake;
mod a_user_measures_full_poses;
mod a_user_measures_in_two_faces;
mod a_user_measures_with_payloads;
mod a_user_picks_a_robot_of_the_zoo;
mod a_user_plans_a_session;
mod a_user_plans_poses;
mod a_user_replays_a_recording;
mod a_user_reproduces_the_paper;
mod a_user_runs_a_campaign;
mod a_user_splits_a_campaign;
mod a_user_states_what_is_known;
mod a_user_studies_what_matters;
mod a_user_sweeps_axes;
mod a_user_takes_a_calibrated_robot_away;
mod a_user_tests_poses;
mod a_user_trusts_a_drawn_tracker;
mod a_user_trusts_a_model_that_lacks_something;
mod a_user_trusts_the_uncertainty;
mod cli;
mod effects_against_the_model;
mod elastostatics_against_plant;
mod fuzz;
mod layers;
mod sandbox;

/// How often a test repeats what a few repetitions decide as well: `usual` times, or with `CALIBRIG_FULL=1` as often as the documents say.
fn repeated(full: u32, usual: u32) -> u32 {
    if std::env::var_os("CALIBRIG_FULL").is_some() { full } else { usual }
}
