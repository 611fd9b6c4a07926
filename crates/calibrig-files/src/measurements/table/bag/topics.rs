//! Which topics of a bag are read.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read, Seek};

use super::Bag;
use crate::input::InputError;
use crate::measurements::table::counted;
use crate::measurements::table::mcap_records::{Channel, messages};

/// Usable content of a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Joints,
    Point,
    Pose,
    /// A pose behind its child frame.
    Transform,
}

/// Messages that hold a point, for people.
const POINTS: &str = "geometry_msgs/PointStamped, PoseStamped, PoseWithCovarianceStamped or TransformStamped, or nav_msgs/Odometry";

impl Kind {
    pub fn of(channel: &Channel) -> Option<Self> {
        let (package, name) = channel.schema.split_once('/')?;
        let name = name.strip_prefix("msg/").unwrap_or(name);
        match (package, name) {
            ("sensor_msgs", "JointState") => Some(Self::Joints),
            ("geometry_msgs", "PointStamped") => Some(Self::Point),
            ("geometry_msgs", "PoseStamped" | "PoseWithCovarianceStamped") => Some(Self::Pose),
            ("geometry_msgs", "TransformStamped") | ("nav_msgs", "Odometry") => Some(Self::Transform),
            _ => None,
        }
    }
}

/// A topic of use.
#[derive(Debug, Clone)]
pub(super) struct Topic {
    pub kind: Kind,
    schema: String,
    messages: u64,
}

impl Bag<'_> {
    /// Topics of use, by name.
    pub fn topics(&self, file: &mut (impl Read + Seek)) -> Result<BTreeMap<String, Topic>, InputError> {
        let mut topics: BTreeMap<String, Topic> = BTreeMap::new();
        let mut others = BTreeSet::new();
        let mut calibrig = false;
        messages(file, &mut |_, channel, _, _| {
            calibrig |= channel.schema.starts_with("calibrig.");
            let Some(kind) = Kind::of(channel) else {
                others.insert(format!("{} ({})", channel.topic, channel.schema));
                return Ok(());
            };
            if channel.encoding != "cdr" {
                return Err(format!(
                    "{}: its messages are encoded as {:?}; expected CDR, as ROS 2 writes",
                    channel.topic, channel.encoding
                ));
            }
            let topic = topics.entry(channel.topic.clone()).or_insert_with(|| Topic {
                kind,
                schema: channel.schema.clone(),
                messages: 0,
            });
            if topic.kind != kind {
                return Err(format!("{}: its messages are of different types", channel.topic));
            }
            topic.messages += 1;
            Ok(())
        })
        .map_err(|trouble| self.trouble(trouble))?;
        if topics.is_empty() {
            if calibrig {
                return Err(self.refuse("it is a calibrig recording, not a ROS 2 bag".to_owned(),
                    "`calibrig replay`, which identifies from it, or `calibrig export csv`, which turns it into text files".to_owned(),
                ));
            }
            let others: Vec<_> = others.into_iter().take(12).collect();
            let found = if others.is_empty() { "no messages".to_owned() } else { others.join(", ") };
            return Err(self.refuse(
                format!("the bag has neither joint states nor points; it has {found}"),
                format!("sensor_msgs/JointState, and {POINTS}"),
            ));
        }
        Ok(topics)
    }

    /// Topics of the right types, with the numbers of their messages.
    fn listed(topics: &BTreeMap<String, Topic>, joints: bool) -> Vec<String> {
        let right = topics.iter().filter(|(_, topic)| (topic.kind == Kind::Joints) == joints);
        right
            .map(|(name, topic)| {
                format!("{name} ({}, {})", topic.schema, counted(count(topic.messages), "message"))
            })
            .collect()
    }

    pub fn joints_topic(&self, topics: &BTreeMap<String, Topic>) -> Result<String, InputError> {
        let of_joints: Vec<&String> =
            topics.iter().filter(|(_, topic)| topic.kind == Kind::Joints).map(|(name, _)| name).collect();
        let listed = || Self::listed(topics, true).join(", ");
        match (&self.options.joints, of_joints.as_slice()) {
            (Some(asked), known) if known.contains(&asked) => Ok(asked.clone()),
            (Some(asked), _) => {
                let message = format!("there is no sensor_msgs/JointState on {asked}");
                Err(self.refuse(message, format!("one of: {}", listed())))
            }
            (None, [only]) => Ok((*only).clone()),
            (None, []) => Err(self.refuse(
                "the bag has no joint states".to_owned(),
                "a topic of sensor_msgs/JointState: record it together with the points".to_owned(),
            )),
            (None, _) => Err(self.refuse(
                "several topics have joint states".to_owned(),
                format!("--bag-joints with one of: {}", listed()),
            )),
        }
    }

    pub fn points_topics(&self, topics: &BTreeMap<String, Topic>) -> Result<Vec<String>, InputError> {
        let of_points: Vec<String> = topics
            .iter()
            .filter(|(_, topic)| topic.kind != Kind::Joints)
            .map(|(name, _)| name.clone())
            .collect();
        let listed = || Self::listed(topics, false).join(", ");
        for asked in &self.options.points {
            if !of_points.contains(asked) {
                return Err(
                    self.refuse(format!("there are no points on {asked}"), format!("one of: {}", listed()))
                );
            }
        }
        match (self.options.points.as_slice(), of_points.as_slice()) {
            ([], []) => {
                Err(self.refuse("the bag has no measured points".to_owned(), format!("a topic of {POINTS}")))
            }
            ([], [only]) => Ok(vec![only.clone()]),
            ([], _) => Err(self.refuse(
                "several topics have points".to_owned(),
                format!(
                    "--bag-points with one of them, or with several if each is a different target: {}",
                    listed()
                ),
            )),
            (asked, _) => Ok(asked.to_vec()),
        }
    }
}

fn count(number: u64) -> usize {
    usize::try_from(number).unwrap_or(usize::MAX)
}
