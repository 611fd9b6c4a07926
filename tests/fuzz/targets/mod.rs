//! What is fuzzed: functions of bytes that must come back, whatever the bytes. Files are read as the commands read them, and what was read is then used.
//!
//! Run for long by `tests/fuzz/run`, on the corpus by `tests/it/fuzz.rs`; `docs/fuzzing.md` has the rest.

mod choices;
mod compensation;
mod edit;
mod file;
mod mcap_file;
mod measurements;
mod numbers;
mod protobuf;
mod recordings;
mod robots;
mod ros;
mod scenarios;
mod spreadsheets;

use choices::Choices;
use edit::Seed;

/// Panics, or does not end, where the input shows a mistake.
pub type Target = fn(&[u8]);

/// All targets by name, which is that of their folder in the corpus.
pub const TARGETS: [(&str, Target); 15] = [
    ("columns", measurements::columns),
    ("csv", measurements::csv),
    ("dh", robots::dh),
    ("estimate", compensation::estimate),
    ("goals", compensation::goals),
    ("identify", numbers::identify),
    ("mcap", recordings::mcap),
    ("numbers", numbers::numbers),
    ("robot", robots::robot),
    ("ros", ros::ros),
    ("scenario", scenarios::scenario),
    ("session", measurements::session),
    ("suggest", measurements::suggest),
    ("urdf", robots::urdf),
    ("xlsx", spreadsheets::xlsx),
];

/// What a key of a file may hold and what it may not.
const EXTREMES: [&str; 12] =
    ["0", "-0", "-1", "1e-15", "1e15", "-1e15", "9e-16", "5e-324", "1e300", "nan", "inf", "4294967296"];

/// Reads each kind of file with each of its values at each of the extremes; of all these files, one in `every`.
pub fn read_keys_at_extremes(every: usize) {
    type Read = fn(String, &mut Choices<'_>);
    let kinds: [(&[Seed], Read); 6] = [
        (compensation::goal_files(), compensation::read_goal_file),
        (robots::robot_files(), robots::read_robot),
        (robots::urdf_files(), robots::read_urdf),
        (scenarios::scenario_files(), scenarios::read_scenario),
        (measurements::session_files(), measurements::read_session),
        (measurements::map_files(), |text, choices| {
            (0..3).for_each(|pair| measurements::read_map(&text, pair, choices));
        }),
    ];
    for (seeds, read) in kinds {
        let texts = seeds.iter().flat_map(|seed| seed.with_each_value_as(&EXTREMES));
        for (number, text) in texts.enumerate().filter(|(number, _)| number % every == 0) {
            // Joints in the middle of their limits, more or less; now and then an identification.
            let choices = [u8::try_from(number % 251).unwrap_or(0); 16];
            read(text, &mut Choices::new(&choices));
        }
    }
}
