//! Bags of ROS 2 in MCAP: states of joints and measured points, joined by their stamps.

mod states;
mod topics;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use self::states::{Moving, Sample, States};
use self::topics::{Kind, Topic};
use super::cdr::{self, CdrError, Point};
use super::mcap_records::{Trouble, messages};
use super::{Table, TableRow, counted, number_text};
use crate::input::InputError;
use crate::measurements::rows::Place;

/// Default for the time between a point and its joints, s: a tenth of a second at rest is enough for a robot, and states come ten times as
/// often.
pub const DEFAULT_TOLERANCE_S: f64 = 0.05;

/// Columns of orientations, as ROS orders a quaternion.
const TURN: [&str; 4] = ["qx", "qy", "qz", "qw"];

/// Dropped points that are reported one by one.
const TOLD: usize = 5;

/// What is read of a bag.
#[derive(Debug, Clone, PartialEq)]
pub struct BagOptions {
    /// Topic of `sensor_msgs/JointState`; the only one if not stated.
    pub joints: Option<String>,
    /// Topics of `PointStamped`, `PoseStamped`, `PoseWithCovarianceStamped`, `TransformStamped` or `Odometry`; the only one if none is stated. Each
    /// of several is a target with its topic's name.
    pub points: Vec<String>,
    /// Largest time between a point and its joints, s.
    pub tolerance_s: f64,
    /// Names of the joints that a row must have; if none are stated, all in the bag.
    pub names: Vec<String>,
    /// If none are stated: those of the bag's joints that are sufficient, if any.
    pub enough: Vec<String>,
}

impl Default for BagOptions {
    fn default() -> Self {
        Self {
            joints: None,
            points: Vec::new(),
            tolerance_s: DEFAULT_TOLERANCE_S,
            names: Vec::new(),
            enough: Vec::new(),
        }
    }
}

/// Reads the bag at `path`: one row per point, with the joint state nearest in time.
///
/// Columns are `time_s` (since the first point), one per joint by its name (rad or m, as in ROS), `x`, `y`, `z` (m), for poses `qx`, `qy`, `qz`, `qw`
/// (the target's orientation in the frame of the points), and if there are several `target` (topic, or child frame of a transform) and `station`
/// (frame of the points). Stamps are those of the messages' headers; if no message of a topic has one, the times of the file, which is reported. A
/// point without a state of every joint within the tolerance is dropped and reported; a robot that moves is reported as well.
///
/// # Errors
/// Errors if the file cannot be read or is damaged, if topics are missing or ambiguous, or if a message does not match its topic.
pub fn read_bag(path: &Path, options: &BagOptions) -> Result<Table, InputError> {
    let name = path.display().to_string();
    let file = File::open(path)
        .map_err(|error| InputError::Unreadable { path: path.to_path_buf(), reason: error.to_string() })?;
    bag_of(&mut BufReader::with_capacity(1 << 20, file), &name, options)
}

pub(super) fn bag_of(
    file: &mut (impl Read + Seek),
    name: &str,
    options: &BagOptions,
) -> Result<Table, InputError> {
    let bag = Bag { name, options };
    let topics = bag.topics(file)?;
    let joints = bag.joints_topic(&topics)?;
    let chosen = bag.points_topics(&topics)?;
    let (mut points, mut notes) = bag.points(file, &topics, &chosen)?;
    points.sort_by_key(|point| point.stamp);
    let states = bag.states(file, &joints, &points, &mut notes)?;
    bag.table(&joints, &chosen, &points, &states, &notes)
}

struct Bag<'a> {
    name: &'a str,
    options: &'a BagOptions,
}

/// A measured point.
#[derive(Debug, Clone)]
struct Measured {
    /// ns
    stamp: i64,
    topic: Arc<str>,
    /// On its topic, from 1.
    number: u64,
    frame: Arc<str>,
    child: Option<Arc<str>>,
    position: [f64; 3],
    turn: Option<[f64; 4]>,
}

impl Measured {
    /// Its message, for people.
    fn called(&self) -> String {
        format!("{}, message {}", self.topic, self.number)
    }
}

/// Remarks on the messages.
#[derive(Debug, Default)]
struct Notes {
    /// Topics without stamps, whose messages have the times of the file.
    unstamped: Vec<String>,
    not_finite: Vec<String>,
    /// Whether all points have an orientation, or some.
    turns: Turns,
}

/// How many of the points have an orientation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Turns {
    #[default]
    None,
    Some,
    All,
}

impl Turns {
    fn of(points: &[Measured]) -> Self {
        match points.iter().filter(|point| point.turn.is_some()).count() {
            0 => Self::None,
            all if all == points.len() => Self::All,
            _ => Self::Some,
        }
    }
}

impl Bag<'_> {
    fn refuse(&self, message: impl fmt::Display, expected: impl fmt::Display) -> InputError {
        let (place, message) = (self.name.to_owned(), message.to_string());
        InputError::Place { place, message, help: Some(format!("expected {expected}")) }
    }

    fn trouble(&self, trouble: Trouble) -> InputError {
        match trouble {
            Trouble::Container(why) => self.refuse(
                format!("the bag cannot be read: {why}"),
                "a whole MCAP file; `calibrig recover` saves the sound parts of a damaged or unfinished one"
                    .to_owned(),
            ),
            Trouble::Stopped(why) => self.refuse(why, "messages as their schemas describe them".to_owned()),
        }
    }

    /// The points of the chosen topics that are finite.
    fn points(
        &self,
        file: &mut (impl Read + Seek),
        topics: &BTreeMap<String, Topic>,
        chosen: &[String],
    ) -> Result<(Vec<Measured>, Notes), InputError> {
        let mut notes = Notes::default();
        let mut points: Vec<Measured> = Vec::new();
        let mut counts: BTreeMap<Arc<str>, u64> = BTreeMap::new();
        let mut names: BTreeSet<Arc<str>> = BTreeSet::new();
        let mut shared = |text: &str| -> Arc<str> {
            if let Some(known) = names.get(text) {
                return Arc::clone(known);
            }
            let new: Arc<str> = text.into();
            names.insert(Arc::clone(&new));
            new
        };
        let mut logged: Vec<i64> = Vec::new();
        messages(file, &mut |_, channel, log_time, data| {
            let Some(kind) = Kind::of(channel).filter(|_| chosen.contains(&channel.topic)) else {
                return Ok(());
            };
            let topic = shared(&channel.topic);
            let number = counts.entry(Arc::clone(&topic)).or_default();
            *number += 1;
            let read = match kind {
                Kind::Transform => cdr::transform(data),
                Kind::Pose => cdr::pose(data),
                Kind::Point | Kind::Joints => cdr::point(data),
            };
            let Point { header, child, position, turn } =
                read.map_err(|error| at(&topic, *number, &error))?;
            if position.iter().any(|axis| !axis.is_finite()) {
                notes.not_finite.push(format!("{topic}, message {number}"));
                return Ok(());
            }
            logged.push(i64::try_from(log_time).unwrap_or(i64::MAX));
            points.push(Measured {
                stamp: header.stamp_ns,
                frame: shared(header.frame),
                child: child.map(&mut shared),
                topic,
                number: *number,
                position,
                // Four zeros mean that the orientation was not filled in.
                turn: turn.filter(|turn| turn.iter().all(|part| part.is_finite()) && *turn != [0.0; 4]),
            });
            Ok(())
        })
        .map_err(|trouble| self.trouble(trouble))?;
        notes.turns = Turns::of(&points);
        debug_assert!(chosen.iter().all(|name| topics.contains_key(name)));
        for topic in chosen {
            let of_topic = |point: &&Measured| *point.topic == **topic;
            if points.iter().filter(of_topic).all(|point| point.stamp == 0)
                && points.iter().any(|point| *point.topic == **topic)
            {
                notes.unstamped.push(topic.clone());
                for (point, logged) in
                    points.iter_mut().zip(&logged).filter(|(point, _)| *point.topic == **topic)
                {
                    point.stamp = *logged;
                }
            }
        }
        Ok((points, notes))
    }

    fn tolerance(&self) -> i64 {
        // A tolerance of years is as good as none.
        let tolerance = Duration::try_from_secs_f64(self.options.tolerance_s.min(1e9)).unwrap_or_default();
        i64::try_from(tolerance.as_nanos()).unwrap_or(i64::MAX)
    }

    /// The states of every joint that lie near a point, in the order of their stamps.
    fn states(
        &self,
        file: &mut (impl Read + Seek),
        topic: &str,
        points: &[Measured],
        notes: &mut Notes,
    ) -> Result<States, InputError> {
        let tolerance = self.tolerance();
        let mut states = States::default();
        let stamps: Vec<i64> = points.iter().map(|point| point.stamp).collect();
        let mut number = 0_u64;
        let mut unstamped = true;
        messages(file, &mut |_, channel, _, data| {
            if channel.topic == topic {
                number += 1;
                unstamped &= cdr::stamp(data).map_err(|error| at(topic, number, &error))? == 0;
            }
            Ok(())
        })
        .map_err(|trouble| self.trouble(trouble))?;
        if unstamped {
            notes.unstamped.push(topic.to_owned());
        }
        number = 0;
        messages(file, &mut |_, channel, log_time, data| {
            if channel.topic != topic {
                return Ok(());
            }
            number += 1;
            let stamp = if unstamped {
                i64::try_from(log_time).unwrap_or(i64::MAX)
            } else {
                cdr::stamp(data).map_err(|error| at(topic, number, &error))?
            };
            states.span =
                Some(states.span.map_or((stamp, stamp), |(first, last)| (first.min(stamp), last.max(stamp))));
            let next = stamps.partition_point(|point| *point < stamp.saturating_sub(tolerance));
            let is_near = stamps.get(next).is_some_and(|point| *point <= stamp.saturating_add(tolerance));
            // Of the other states, those next to a point on either side are kept for messages.
            if !is_near && !states.is_first(stamp) {
                return Ok(());
            }
            let state = cdr::joint_state(data).map_err(|error| at(topic, number, &error))?;
            if state.names.len() != state.positions.len() {
                let (names, positions) = (state.names.len(), state.positions.len());
                return Err(format!(
                    "{topic}, message {number}: {names} names of joints, but {positions} positions"
                ));
            }
            for (i, name) in state.names.iter().enumerate() {
                let velocity = state.velocities.get(i).copied().filter(|velocity| velocity.is_finite());
                let sample = Sample { stamp, position: state.positions[i], velocity };
                states.push(name, sample, is_near);
            }
            Ok(())
        })
        .map_err(|trouble| self.trouble(trouble))?;
        states.sort();
        Ok(states)
    }

    /// The joints that every row must have.
    fn names(&self, states: &States) -> Result<Vec<String>, InputError> {
        if self.options.names.is_empty() {
            let enough: Vec<String> =
                states.order.iter().filter(|name| self.options.enough.contains(name)).cloned().collect();
            return Ok(if enough.is_empty() { states.order.clone() } else { enough });
        }
        let missing: Vec<&str> = self
            .options
            .names
            .iter()
            .filter(|name| !states.order.contains(name))
            .map(String::as_str)
            .collect();
        if !missing.is_empty() {
            let known = states.order.join(", ");
            return Err(self.refuse(format!("the bag has no joint named {}", missing.join(", ")),
                format!(
                    "the robot's joints by their names in the bag, {known}: rename the joints in the robot's file, or list \
                     these names in a column map, under columns of [joints] in the robot's order"
                ),
            ));
        }
        Ok(self.options.names.clone())
    }

    fn table(
        &self,
        joints: &str,
        chosen: &[String],
        points: &[Measured],
        states: &States,
        notes: &Notes,
    ) -> Result<Table, InputError> {
        let names = self.names(states)?;
        let frames: BTreeSet<&Arc<str>> = points.iter().map(|point| &point.frame).collect();
        let children: BTreeSet<&Arc<str>> = points.iter().filter_map(|point| point.child.as_ref()).collect();
        let has_targets = chosen.len() > 1 || children.len() > 1;
        let has_stations = frames.len() > 1;
        let mut header = vec!["time_s".to_owned()];
        header.extend(names.iter().cloned());
        header.extend(["x", "y", "z"].map(str::to_owned));
        let has_turns = notes.turns == Turns::All;
        header.extend(TURN.into_iter().filter(|_| has_turns).map(str::to_owned));
        header.extend(has_targets.then(|| "target".to_owned()));
        header.extend(has_stations.then(|| "station".to_owned()));
        let mut remarks = self.remarks(joints, chosen, notes, has_targets, has_stations.then_some(&frames));
        let first = points.first().map_or(0, |point| point.stamp);
        let place =
            |point: &Measured| Place::Message { topic: Arc::clone(&point.topic), number: point.number };
        let head = Place::Message { topic: joints.into(), number: 1 };
        let mut rows = vec![TableRow { place: head, cells: header }];
        let mut dropped = Vec::new();
        let mut moving = Moving::default();
        for point in points {
            let nearest = names.iter().map(|name| states.nearest(name, point.stamp));
            let nearest: Vec<Option<Sample>> = nearest.collect();
            let tolerance = self.tolerance();
            let lacks = nearest.iter().zip(&names).find(|(sample, _)| {
                sample.is_none_or(|sample| sample.stamp.abs_diff(point.stamp) > tolerance.unsigned_abs())
            });
            if let Some((_, name)) = lacks {
                let within = milliseconds(tolerance.unsigned_abs());
                dropped.push(format!("{}: no state of {name} within {within}", point.called()));
                continue;
            }
            for name in &names {
                moving.look(point, states.change(name, point.stamp, tolerance));
            }
            let since = (point.stamp - first) as f64 * 1e-9;
            let mut cells = vec![number_text(since)];
            cells.extend(
                nearest.iter().map(|sample| number_text(sample.map_or(f64::NAN, |sample| sample.position))),
            );
            cells.extend(point.position.map(number_text));
            cells.extend(point.turn.into_iter().filter(|_| has_turns).flatten().map(number_text));
            if has_targets {
                let child = point.child.as_deref().filter(|_| children.len() > 1);
                cells.push(match child {
                    Some(child) if chosen.len() > 1 => format!("{} {child}", point.topic),
                    Some(child) => child.to_owned(),
                    None => point.topic.to_string(),
                });
            }
            cells.extend(has_stations.then(|| point.frame.to_string()));
            rows.push(TableRow { place: place(point), cells });
        }
        if rows.len() == 1 {
            return Err(self.nothing_left(points, states, &dropped));
        }
        remarks.extend(self.told("dropped", "point", &dropped));
        remarks.extend(moving.words(self.name, self.options.tolerance_s));
        Ok(Table { name: self.name.to_owned(), rows, remarks })
    }

    /// Every point was dropped.
    fn nothing_left(&self, points: &[Measured], states: &States, dropped: &[String]) -> InputError {
        let seconds = |stamp: i64| format!("{:.3} s", stamp as f64 * 1e-9);
        let span = |span: Option<(i64, i64)>| {
            span.map_or_else(
                || "never".to_owned(),
                |(first, last)| format!("from {} to {}", seconds(first), seconds(last)),
            )
        };
        let of_points = points.first().zip(points.last()).map(|(first, last)| (first.stamp, last.stamp));
        let message = format!(
            "none of {} has a state of every joint within {}: points are stamped {}, states {}{}",
            counted(points.len(), "point"),
            milliseconds(self.tolerance().unsigned_abs()),
            span(of_points),
            span(states.span),
            dropped.first().map_or_else(String::new, |first| format!(" ({first})"))
        );
        self.refuse(
            message,
            "stamps of one clock, and a tolerance that covers the time between point and state (--bag-tolerance-ms)"
                .to_owned(),
        )
    }

    /// The first of them, and how many there are.
    fn told(&self, what: &str, noun: &str, list: &[String]) -> Vec<String> {
        let Some(rest) = list.len().checked_sub(TOLD.min(list.len())).filter(|_| !list.is_empty()) else {
            return Vec::new();
        };
        let more = if rest > 0 { format!("; and {rest} more") } else { String::new() };
        let first = list.iter().take(TOLD).cloned().collect::<Vec<_>>().join("; ");
        vec![format!("{}: {} {what}: {first}{more}", self.name, counted(list.len(), noun))]
    }

    fn remarks(
        &self,
        joints: &str,
        chosen: &[String],
        notes: &Notes,
        has_targets: bool,
        frames: Option<&BTreeSet<&Arc<str>>>,
    ) -> Vec<String> {
        let name = self.name;
        let mut remarks = vec![format!(
            "{name}: joints of {joints} (rad and m, as ROS has it), points of {} (m), joined by {} within {}",
            chosen.join(", "),
            match notes.unstamped.as_slice() {
                [] => "the stamps of their headers".to_owned(),
                without => format!(
                    "the stamps of their headers and, where they have none (on {}), by the times of the file",
                    without.join(", ")
                ),
            },
            milliseconds(self.tolerance().unsigned_abs())
        )];
        match notes.turns {
            Turns::None => {}
            Turns::Some => remarks.push(format!(
                "{name}: some points have no orientation: the positions are read, the orientations are not"
            )),
            Turns::All => remarks.push(format!(
                "{name}: orientations are in the columns {}; they are read if [rotation] of a column map names them (form = \
                 \"quaternion\", order = \"xyzw\", transform = \"target_in_tracker\"), otherwise only the positions",
                TURN.join(", ")
            )),
        }
        if has_targets {
            remarks.push(format!("{name}: each topic or child frame is a separate target"));
        }
        if let Some(frames) = frames {
            let names: Vec<&str> = frames.iter().map(|frame| &***frame).collect();
            remarks.push(format!(
                "{name}: points are given in the frames {}: each is a separate station",
                names.join(", ")
            ));
        }
        remarks.extend(self.told("dropped, coordinates not finite", "point", &notes.not_finite));
        remarks
    }
}

fn at(topic: &str, number: u64, error: &CdrError) -> String {
    format!("{topic}, message {number}: {error}")
}

fn milliseconds(nanoseconds: u64) -> String {
    format!("{} ms", nanoseconds as f64 * 1e-6)
}
