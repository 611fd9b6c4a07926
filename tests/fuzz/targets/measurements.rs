//! Measurement files of text, their column maps, and session files.

use std::sync::LazyLock;

use calibrig::files::{
    ColumnMap, LoadedMeasurements, RowOptions, SessionSet, Source, measurements_text, parse_column_map,
    parse_commands, parse_measurements, parse_session, session_text, suggest_columns,
};
use calibrig::measurement::{SetKind, TargetOrientation, remove_drift};
use calibrig::model::{CalibrationModel, CraigLink, JointKind};
use calibrig::nalgebra::Rotation3;

use super::choices::Choices;
use super::edit::{Seed, text};
use super::file;
use super::numbers::check_estimate;

const JOINTS: [JointKind; 3] = [JointKind::Revolute, JointKind::Revolute, JointKind::Prismatic];

/// Each with a table that it fits.
const PAIRS: [(&str, &str); 3] = [
    (include_str!("../seeds/points.columns.toml"), include_str!("../seeds/points.csv")),
    (include_str!("../seeds/poses.columns.toml"), include_str!("../seeds/poses.csv")),
    (include_str!("../seeds/faces.columns.toml"), include_str!("../seeds/faces.csv")),
];
const OWN: &str = include_str!("../seeds/own.csv");
const SESSION: &str = include_str!("../seeds/session.toml");

static MAPS: LazyLock<Vec<Seed>> = LazyLock::new(|| PAIRS.map(|(map, _)| Seed::toml(map)).into());
static TABLES: LazyLock<Vec<Seed>> =
    LazyLock::new(|| [OWN, PAIRS[0].1, PAIRS[1].1, PAIRS[2].1].map(Seed::table).into());
static SESSIONS: LazyLock<Vec<Seed>> = LazyLock::new(|| vec![Seed::toml(SESSION)]);
static READY: LazyLock<Vec<ColumnMap>> = LazyLock::new(|| {
    let maps =
        PAIRS.map(|(map, _)| parse_column_map(&Source::new("columns.toml", map)).expect("a sound map"));
    std::iter::once(ColumnMap::default()).chain(maps).collect()
});

/// A column map, and the table behind it.
pub fn columns(data: &[u8]) {
    let choices = &mut Choices::new(data);
    let pair = choices.below(PAIRS.len());
    let map = if choices.below(8) == 7 { text(choices, &MAPS) } else { MAPS[pair].edited(choices, &MAPS) };
    read_map(&map, pair, choices);
}

pub fn map_files() -> &'static [Seed] {
    &MAPS
}

pub fn read_map(map: &str, pair: usize, choices: &mut Choices<'_>) {
    if let Ok(map) = parse_column_map(&Source::new("columns.toml", map)) {
        read(PAIRS[pair].1, &map, choices);
    }
}

/// A table, by calibrig's own columns or one of the maps.
pub fn csv(data: &[u8]) {
    let choices = &mut Choices::new(data);
    let kind = choices.below(READY.len());
    let table =
        if choices.below(8) == 7 { text(choices, &TABLES) } else { TABLES[kind].edited(choices, &TABLES) };
    read(&table, &READY[kind], choices);
}

/// A table of which a map is to be made; the map is then read.
pub fn suggest(data: &[u8]) {
    let choices = &mut Choices::new(data);
    let table = text(choices, &TABLES);
    let suggested = file::with(table.as_bytes(), |path, _| suggest_columns(&[path], &RowOptions::default()));
    if let Ok(suggested) = suggested
        && suggested.open.is_empty()
    {
        let map = parse_column_map(&Source::new("columns.toml", suggested.text.as_str()));
        let map = map.unwrap_or_else(|error| panic!("{error}\n{}", suggested.text));
        read(&table, &map, choices);
    }
}

/// A session file beside a table.
pub fn session(data: &[u8]) {
    let choices = &mut Choices::new(data);
    let text = text(choices, &SESSIONS);
    read_session(text, choices);
}

pub fn session_files() -> &'static [Seed] {
    &SESSIONS
}

pub fn read_session(text: String, choices: &mut Choices<'_>) {
    let source = Source::new("session.toml", text);
    let Ok(session) = parse_session(&source) else { return };
    let usable = session.check_usable(&source).is_ok();
    let mut loaded =
        parse_measurements(&Source::new("own.csv", OWN), &ColumnMap::default(), &JOINTS).expect("sound");
    let kind = *choices.pick(&SetKind::ALL);
    if session.complete(&source, kind, &mut loaded).is_err() {
        return;
    }
    let told: [SessionSet<'_>; 1] = [(kind, &loaded.set, &loaded.dropped)];
    if let Ok(text) = session_text(&told) {
        let read = parse_session(&Source::new("session.toml", text.as_str()));
        read.unwrap_or_else(|error| panic!("what is written is not read: {error}\n{text}"));
    }
    if usable {
        use_measurements(&loaded, choices);
    }
}

fn read(table: &str, map: &ColumnMap, choices: &mut Choices<'_>) {
    if let Ok(commands) = parse_commands(&Source::new("table.csv", table), map, &JOINTS) {
        let sound =
            |command: &Vec<f64>| command.len() == JOINTS.len() && command.iter().all(|q| q.is_finite());
        assert!(commands.iter().all(|(_, command)| sound(command)), "{commands:?}");
    }
    if let Ok(loaded) = parse_measurements(&Source::new("table.csv", table), map, &JOINTS) {
        use_measurements(&loaded, choices);
    }
}

/// What is read is sound, is written so that it reads back, and is identified from or refused.
pub fn use_measurements(loaded: &LoadedMeasurements, choices: &mut Choices<'_>) {
    let set = &loaded.set;
    if set.observations.is_empty() {
        return;
    }
    // How targets are turned on the flange is not in tables.
    let mut stated = set.clone();
    for target in stated.targets.iter_mut().filter(|_| set.has_poses()) {
        target
            .orientation
            .get_or_insert(TargetOrientation { flange_from_target: Rotation3::identity(), covariance: None });
    }
    stated.check(JOINTS.len()).expect("what is read is a set");
    if let Ok(text) = measurements_text(set, &JOINTS) {
        let source = Source::new("written.csv", text);
        let again = parse_measurements(&source, &ColumnMap::default(), &JOINTS);
        let again =
            again.unwrap_or_else(|error| panic!("what is written is not read: {error}\n{}", source.text));
        assert_eq!(again.set.observations.len(), set.observations.len());
    }
    let steady = remove_drift(&stated);
    if choices.one_in(16) && set.observations.len() <= 30 {
        let set = steady.as_ref().map_or(&stated, |steady| &steady.measurements);
        check_estimate(&arm(), set, choices);
    }
}

/// The robot that the tables are of.
fn arm() -> CalibrationModel {
    let links = vec![
        CraigLink::revolute("one").row(0.0, 0.0, 0.4, 0.0).limits(-3.0, 3.0),
        CraigLink::revolute("two").row(0.1, -1.57, 0.0, 0.0).limits(-3.0, 3.0),
        CraigLink::prismatic("three").row(0.5, 1.57, 0.1, 0.0).limits(0.0, 0.5),
    ];
    CalibrationModel::new(links).expect("a robot")
}
