//! What is stated beforehand about stations and targets: by a session file, else by the robot's file. Measurement files only name them.

#[cfg(test)]
mod tests;

use std::collections::BTreeSet;

use crate::LoadedMeasurements;
use crate::input::{InputError, Source};
use crate::robot::{Robot, StatedTarget};
use crate::session::SessionFile;
use calibrig_model::measurement::{MeasurementSet, Reading, SetKind, Station, Target};

/// A measurement file and what it holds.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredFile {
    /// Which set it is.
    pub kind: SetKind,
    /// Its name, for messages; the first one of several.
    pub name: String,
    /// What was read of it.
    pub loaded: LoadedMeasurements,
}

/// Remarks on the statements, in words.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Statements {
    /// What an identification takes as known about every station and target, with equal ones in one line.
    pub assumed: Vec<String>,
    /// Changes to the robot's table, and statements that are not used.
    pub remarks: Vec<String>,
}

/// Nests that place a station.
const ENOUGH_NESTS: usize = 3;
/// Names in one line.
const MOST_NAMES: usize = 6;

/// Adds the statements about stations and targets to the measured sets, the fitted one first. A session file describes all stations (targets)
/// or none; the targets of the robot's file are used only if it describes none. Statements without measurements are left out. The other sets
/// then have stations and targets in the order of the first, so that an index means the same in all of them.
///
/// # Errors
/// Errors for a measured station or target that the session file does not describe; a target without a name, or with an unnamed statement,
/// if several are stated; measured names without any statement; a held-out station or target that is neither in the fitted set nor stated;
/// and a column of targets that names every reading.
pub fn state(
    robot: &Robot,
    session: Option<(&SessionFile, &Source)>,
    files: &mut [MeasuredFile],
) -> Result<Statements, InputError> {
    let mut remarks = robot.remarks.clone();
    remarks.extend(files.iter_mut().filter_map(count_identical_once));
    remarks.extend(files.iter().filter_map(partly_stated));
    if let Some((session, source)) = session {
        for file in &mut *files {
            session.complete(source, file.kind, &mut file.loaded)?;
        }
    }
    let robot_source = robot.sources.iter().find(|(role, _)| role == "robot").map(|(_, source)| source);
    let by_session = session.filter(|(session, _)| session.describes_targets());
    let (stated, by) = match (by_session, robot_source) {
        (Some((_, source)), _) => {
            if let Some(robot_source) = robot_source.filter(|_| !robot.targets.is_empty()) {
                remarks
                    .push(format!("targets are taken from {}, not from {}", source.name, robot_source.name));
            }
            (names(files, |set| &set.targets), source.name.as_str())
        }
        (None, Some(source)) => (state_targets(&robot.targets, source, files, &mut remarks)?, &*source.name),
        (None, None) => (BTreeSet::new(), ""),
    };
    if let Some((_, source)) = session {
        drop_unmeasured(files, source, &mut remarks);
    }
    let columns = robot.sources.iter().find(|(role, _)| role == "columns").map(|(_, source)| source);
    refuse_named_shots(files, columns, &stated)?;
    align(files, &stated, &mut remarks)?;
    let fitted = files.first().map(|file| &file.loaded.set);
    let placed_by = session.map_or("", |(_, source)| source.name.as_str());
    let assumed = fitted.map_or_else(Vec::new, |set| in_words(set, &stated, placed_by, by));
    Ok(Statements { assumed, remarks })
}

/// Leaves out readings that repeat another one to the last digit, command included: they are copies, not measurements.
fn count_identical_once(file: &mut MeasuredFile) -> Option<String> {
    let mut seen = BTreeSet::new();
    let mut copies = Vec::new();
    let kept: Vec<bool> = file
        .loaded
        .set
        .observations
        .iter()
        .map(|observation| {
            let position = observation.reading.position();
            let covariance = observation.reading.position_covariance();
            // A probe that turns about its centre is in another pose.
            let turn: &[f64] = match &observation.reading {
                Reading::Pose(pose) => pose.rotation.matrix().as_slice(),
                Reading::Spherical(_) | Reading::Cartesian { .. } => &[],
            };
            let numbers: Vec<_> = observation
                .command
                .iter()
                .chain(position.iter())
                .chain(turn)
                .chain(covariance.iter().flatten())
                .map(|v| v.to_bits())
                .collect();
            let (station, target, face) =
                (observation.station, observation.target, observation.reading.face());
            let is_new = seen.insert((station, target, face, observation.approach.clone(), numbers));
            if !is_new {
                copies.push(observation.pose.to_string());
            }
            is_new
        })
        .collect();
    if !copies.is_empty() {
        file.loaded.keep(&kept);
    }
    let (count, s) = (copies.len(), if copies.len() == 1 { "s" } else { "" });
    // Those of one stop have the number of one pose.
    copies.dedup();
    let poses = if copies.len() == 1 { "pose" } else { "poses" };
    let words = format!(
        "{}: {count} of the readings repeat{s} another to the last digit and count{s} only once with it ({poses} {})",
        file.name,
        listed(&copies)
    );
    (!copies.is_empty()).then_some(words)
}

/// Remark that some readings of a file state their uncertainty, but others do not.
fn partly_stated(file: &MeasuredFile) -> Option<String> {
    let observations = &file.loaded.set.observations;
    let unstated: Vec<_> = observations
        .iter()
        .filter(|observation| observation.reading.position_covariance().is_none())
        .map(|observation| observation.pose.to_string())
        .collect();
    if unstated.is_empty() || unstated.len() == observations.len() {
        return None;
    }
    let (count, all) = (unstated.len(), observations.len());
    let (s, poses) = if count == 1 { ("s", "pose") } else { ("", "poses") };
    let name = &file.name;
    Some(format!(
        "{name}: {count} of {all} readings state{s} no uncertainty ({poses} {}); the others state theirs",
        listed(&unstated)
    ))
}

/// A station or a target.
trait Named: Clone {
    const WHAT: &'static str;
    fn name(&self) -> &str;
}

impl Named for Station {
    const WHAT: &'static str = "station";
    fn name(&self) -> &str {
        &self.name
    }
}

impl Named for Target {
    const WHAT: &'static str = "target";
    fn name(&self) -> &str {
        &self.name
    }
}

/// The names that the sets have of something.
fn names<T: Named>(files: &[MeasuredFile], of: impl Fn(&MeasurementSet) -> &Vec<T>) -> BTreeSet<String> {
    files.iter().flat_map(|file| of(&file.loaded.set)).map(|item| item.name().to_owned()).collect()
}

/// Gives the measured targets the statements of the robot's file, whose text is `source`; returns their names.
fn state_targets(
    stated: &[StatedTarget],
    source: &Source,
    files: &mut [MeasuredFile],
    remarks: &mut Vec<String>,
) -> Result<BTreeSet<String>, InputError> {
    let mut matched = BTreeSet::new();
    let Some(first) = stated.first() else { return Ok(matched) };
    let refused = |target: &StatedTarget, message: String, expected: &str| {
        Err(source.error(target.place.clone(), message, Some(format!("expected {expected}"))))
    };
    let mut measured: Vec<String> = Vec::new();
    for file in files.iter().filter(|file| file.loaded.names_targets) {
        for target in &file.loaded.set.targets {
            if !measured.contains(&target.name) {
                measured.push(target.name.clone());
            }
        }
    }
    if first.name.is_none() && measured.len() > 1 {
        let message =
            format!("the target has no name, but {} are measured: {}", measured.len(), listed(&measured));
        if first.sigma.is_some() {
            return refused(
                first,
                message,
                "name = \"...\" with one of these, and [[target]] for each of several",
            );
        }
        remarks.push(format!("{}: {message}; nothing is used from it", source.name));
        return Ok(matched);
    }
    for file in &mut *files {
        let named = file.loaded.names_targets;
        if !named && stated.len() > 1 && !file.loaded.set.targets.is_empty() {
            let all: Vec<_> = stated.iter().filter_map(|target| target.name.clone()).collect();
            let message = format!(
                "{} targets are stated ({}), but {} does not name which one was measured",
                stated.len(),
                listed(&all),
                file.name
            );
            return refused(first, message, "a column target in the measurement file, or one [target]");
        }
        for target in &mut file.loaded.set.targets {
            let is_meant = |known: &&StatedTarget| match &known.name {
                Some(name) => !named || *name == target.name,
                None => true,
            };
            let Some(known) = stated.iter().find(is_meant) else { continue };
            if let Some(name) = &known.name {
                target.name.clone_from(name);
            }
            target.in_flange = known.in_flange;
            target.covariance = known.covariance();
            target.orientation.clone_from(&known.orientation);
            matched.insert(target.name.clone());
        }
    }
    let unmeasured: Vec<_> = stated
        .iter()
        .filter_map(|target| target.name.clone())
        .filter(|name| !matched.contains(name))
        .collect();
    if matched.is_empty() && !measured.is_empty() {
        let message = format!(
            "no reading names a stated target, {}; measured are {}",
            listed(&unmeasured),
            listed(&measured)
        );
        return refused(
            first,
            message,
            "the same names in both, or --session SESSION.toml with the targets of these measurements",
        );
    }
    if !unmeasured.is_empty() {
        remarks.push(not_measured("target", &unmeasured, source));
    }
    Ok(matched)
}

fn not_measured(what: &str, names: &[String], source: &Source) -> String {
    let (s, them) = if names.len() == 1 { ("", "it is") } else { ("s", "they are") };
    format!(
        "{what}{s} {} of {}: no reading names {}, and {them} left out",
        listed(names),
        source.name,
        if s.is_empty() { "it" } else { "them" }
    )
}

/// Some names, with the total number if there are many.
fn listed(names: &[String]) -> String {
    if names.len() <= MOST_NAMES {
        return names.join(", ");
    }
    format!("{}, ... ({} in all)", names[..MOST_NAMES].join(", "), names.len())
}

/// Leaves out what no observation of any set has.
fn drop_unmeasured(files: &mut [MeasuredFile], source: &Source, remarks: &mut Vec<String>) {
    let (mut stations, mut targets) = (BTreeSet::new(), BTreeSet::new());
    for set in files.iter().map(|file| &file.loaded.set) {
        for observation in &set.observations {
            stations.insert(set.stations[observation.station].name.clone());
            targets.insert(set.targets[observation.target].name.clone());
        }
    }
    let (mut left_stations, mut left_targets) = (BTreeSet::new(), BTreeSet::new());
    for set in files.iter_mut().map(|file| &mut file.loaded.set) {
        let kept = keep(&mut set.stations, &stations, &mut left_stations);
        for observation in &mut set.observations {
            observation.station = kept[observation.station];
        }
        let kept = keep(&mut set.targets, &targets, &mut left_targets);
        for observation in &mut set.observations {
            observation.target = kept[observation.target];
        }
    }
    for (what, names) in [("station", left_stations), ("target", left_targets)] {
        if !names.is_empty() {
            remarks.push(not_measured(what, &names.into_iter().collect::<Vec<_>>(), source));
        }
    }
}

/// Keeps the `wanted`; the new place of every old one.
fn keep<T: Named>(items: &mut Vec<T>, wanted: &BTreeSet<String>, left: &mut BTreeSet<String>) -> Vec<usize> {
    let mut places = Vec::with_capacity(items.len());
    let mut next = 0;
    items.retain(|item| {
        let stays = wanted.contains(item.name());
        places.push(next);
        next += usize::from(stays);
        if !stays {
            left.insert(item.name().to_owned());
        }
        stays
    });
    places
}

/// Targets with one reading each say nothing about the robot: three coordinates for three unknowns. If they are most of all readings, their
/// names are those of shots.
fn refuse_named_shots(
    files: &[MeasuredFile],
    columns: Option<&Source>,
    stated: &BTreeSet<String>,
) -> Result<(), InputError> {
    let Some(MeasuredFile { name, loaded, .. }) = files.first() else { return Ok(()) };
    let mut readings = vec![0_usize; loaded.set.targets.len()];
    for observation in &loaded.set.observations {
        readings[observation.target] += 1;
    }
    let count = readings.iter().filter(|readings| **readings == 1).count();
    let is_stated = loaded.set.targets.iter().any(|target| stated.contains(&target.name));
    if count < 2 || 2 * count <= loaded.set.observations.len() || is_stated {
        return Ok(());
    }
    let key =
        columns.map(|columns| (columns, columns.place_of("columns.target"))).filter(|(_, at)| !at.is_empty());
    let column = key.as_ref().and_then(|(map, place)| map.text.get(place.clone())).unwrap_or("target");
    let message = format!(
        "{count} targets with one reading each say nothing about the robot: the column {column} names the shot, not the \
         reflector"
    );
    let help = "expected the reflector's name, the same in all rows where it was measured; or no target column (in a column \
                map: leave `target` out)";
    Err(match key {
        Some((map, place)) => map.error(place, message, Some(help.to_owned())),
        None => InputError::Place {
            place: loaded.place_where(|o| readings[o.target] == 1).unwrap_or_else(|| name.clone()),
            message,
            help: Some(help.to_owned()),
        },
    })
}

/// Orders stations and targets of the other sets as those of the first.
fn align(
    files: &mut [MeasuredFile],
    stated: &BTreeSet<String>,
    remarks: &mut Vec<String>,
) -> Result<(), InputError> {
    let Some((fitted, others)) = files.split_first_mut() else { return Ok(()) };
    for other in others {
        let named = (fitted.loaded.names_stations, other.loaded.names_stations);
        let order = in_order(&mut fitted.loaded.set.stations, &mut other.loaded.set.stations, named);
        for observation in &mut other.loaded.set.observations {
            observation.station = order[observation.station];
        }
        let named = (fitted.loaded.names_targets, other.loaded.names_targets);
        let order = in_order(&mut fitted.loaded.set.targets, &mut other.loaded.set.targets, named);
        for observation in &mut other.loaded.set.observations {
            observation.target = order[observation.target];
        }
        let (set, fit) = (&other.loaded.set, &fitted.loaded.set);
        let unknown = |what: &str, name: &str, names: &[String], of_what: &str, place: Option<String>| {
            let message = format!(
                "{what} {name:?} of the {} set is not in the identification set ({}), and {of_what}",
                other.kind.key(),
                listed(names)
            );
            let help = format!(
                "expected a {what} of the identification set, or one that is stated (--session SESSION.toml)"
            );
            let place = place.unwrap_or_else(|| other.name.clone());
            Err(InputError::Place { place, message, help: Some(help) })
        };
        for (place, station) in set.stations.iter().enumerate() {
            let has = |set: &MeasurementSet| set.observations.iter().any(|o| o.station == place);
            if has(set) && !has(fit) && station.distinct_nests().len() < ENOUGH_NESTS {
                let names = measured_names(&fit.stations, |place| {
                    fit.observations.iter().any(|o| o.station == place)
                });
                let at = other.loaded.place_where(|o| o.station == place);
                return unknown("station", &station.name, &names, "no nests place it", at);
            }
            if fit.stations.get(place).is_some_and(|known| known.nests != station.nests) {
                remarks.push(format!(
                    "station {}: the nests of the {} set differ; its place is that of the identification set",
                    station.name,
                    other.kind.key()
                ));
            }
        }
        for (place, target) in set.targets.iter().enumerate() {
            let has = |set: &MeasurementSet| set.observations.iter().any(|o| o.target == place);
            if has(set) && !has(fit) && !stated.contains(&target.name) {
                let names =
                    measured_names(&fit.targets, |place| fit.observations.iter().any(|o| o.target == place));
                let at = other.loaded.place_where(|o| o.target == place);
                return unknown("target", &target.name, &names, "nothing is stated about it", at);
            }
        }
    }
    Ok(())
}

fn measured_names<T: Named>(items: &[T], is_measured: impl Fn(usize) -> bool) -> Vec<String> {
    let measured = items.iter().enumerate().filter(|(place, _)| is_measured(*place));
    measured.map(|(_, item)| item.name().to_owned()).collect()
}

/// Brings `own` into the order of `fitted`, which takes what it lacks: the new place of every old one.
fn in_order<T: Named>(
    fitted: &mut Vec<T>,
    own: &mut Vec<T>,
    (fitted_named, own_named): (bool, bool),
) -> Vec<usize> {
    let one_each = fitted.len() == 1 && own.len() == 1 && !(fitted_named && own_named);
    let begins_alike =
        own.len() <= fitted.len() && own.iter().zip(&*fitted).all(|(a, b)| a.name() == b.name());
    if one_each || begins_alike {
        return (0..own.len()).collect();
    }
    let mut places = Vec::with_capacity(own.len());
    for item in &*own {
        let place = fitted.iter().position(|known| known.name() == item.name());
        places.push(place.unwrap_or_else(|| {
            fitted.push(item.clone());
            fitted.len() - 1
        }));
    }
    let as_own = |known: &T| own.iter().find(|item| item.name() == known.name()).unwrap_or(known).clone();
    *own = fitted.iter().map(as_own).collect();
    places
}

fn in_words(set: &MeasurementSet, stated: &BTreeSet<String>, placed_by: &str, by: &str) -> Vec<String> {
    let mut lines = Vec::new();
    grouped(&set.stations, &mut lines, |station| match station.distinct_nests().len() {
        nests if nests >= ENOUGH_NESTS && station.nests.len() > nests => {
            format!("placed by {nests} nests of {placed_by}, {} readings", station.nests.len())
        }
        nests if nests >= ENOUGH_NESTS => format!("placed by {nests} nests of {placed_by}"),
        _ => "identified, because no nests are stated".to_owned(),
    });
    grouped(&set.targets, &mut lines, |target| match target.covariance {
        Some(covariance) => {
            let sigma = (covariance.trace() / 3.0).sqrt();
            format!("stated by {by}, +- {} mm per axis", rounded(1e3 * sigma))
        }
        None if stated.contains(&target.name) => {
            format!("identified, starting from the offset that {by} states without an uncertainty")
        }
        None => "identified, because nothing is stated about it".to_owned(),
    });
    lines
}

/// A line for all with the same statement.
fn grouped<T: Named>(items: &[T], lines: &mut Vec<String>, words: impl Fn(&T) -> String) {
    let mut groups: Vec<(String, Vec<String>)> = Vec::new();
    for item in items {
        let words = words(item);
        match groups.iter_mut().find(|(known, _)| *known == words) {
            Some((_, names)) => names.push(item.name().to_owned()),
            None => groups.push((words, vec![item.name().to_owned()])),
        }
    }
    for (words, names) in groups {
        // calibrig's own names are self-explanatory.
        let what = match names.as_slice() {
            [one] if one.starts_with(T::WHAT) => one.clone(),
            [one] => format!("{} {one}", T::WHAT),
            many => format!("{}s {}", T::WHAT, listed(many)),
        };
        let words = if names.len() > 1 { words.replace("of it", "of them") } else { words };
        lines.push(format!("{what}: {words}"));
    }
}

/// To three digits.
fn rounded(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}
