//! Converts robots from other forms to robot files: a vendor's URDF, and a table of Denavit-Hartenberg rows.
//!
//! The result is the text of a `robot.toml`, with every assumption marked in it; the robot is then read from that text, so that a file in
//! between changes nothing. The kinematics of the text are compared with those of the URDF before it is returned.

mod bodies;
mod chain;
mod dh;
mod dh_cells;
mod element;
mod rows;
mod tables;
pub(crate) mod text;
mod tree;

#[cfg(test)]
mod tests;

use std::path::Path;

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::input::{InputError, Source};
use crate::robot::{Robot, parse_robot};
use calibrig_model::JointKind;
use calibrig_model::geometry::Transform;
use chain::{Chain, Finder};
use text::{Bodies, Text};
use tree::Tree;

pub use dh::{Convention, robot_from_dh};
pub use tables::{StandardRow, StandardTable, craig_table, standard_table};

/// Largest difference between a URDF's kinematics and those of the table made from it, m at the tip and at a metre from it.
pub const AGREEMENT: f64 = 1e-10;

/// Poses at which both are compared.
const POSES: usize = 1000;

/// What to take from a URDF, and what it does not state.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct UrdfOptions {
    /// Link whose frame is the base; the root if absent.
    pub base: Option<String>,
    /// Link whose frame is the flange; if absent, the end of the tree, if there is only one.
    pub tip: Option<String>,
    /// The target in the flange's frame, m.
    pub target: Option<Vector3<f64>>,
    /// Gravity in the base's frame, m/s²; against its z axis if absent.
    pub gravity: Option<Vector3<f64>>,
}

/// A robot file that was made.
#[derive(Debug, Clone)]
pub struct Converted {
    /// The text of the `robot.toml`.
    pub source: Source,
    /// The robot, read from it.
    pub robot: Robot,
    /// What was ignored, chosen and assumed, one line each.
    pub remarks: Vec<String>,
    /// Largest difference from the original, m, at a metre from the tip; `None` if there is nothing to compare with.
    pub difference: Option<f64>,
}

/// What was made from a chain, for comparison.
struct Compared<'a> {
    chain: &'a Chain,
    /// How joints follow others: (follower, leader, ratio, offset).
    follows: Vec<(usize, usize, f64, f64)>,
}

/// Makes a robot file of a URDF.
///
/// # Errors
///
/// [`InputError`] that points into the URDF: text that is not a URDF, links that do not form a single chain, joints that a table cannot hold, and
/// tables whose kinematics differ.
pub fn robot_from_urdf(source: &Source, options: &UrdfOptions) -> Result<Converted, InputError> {
    let tree = Tree::read(source)?;
    let finder = Finder { source, tree: &tree };
    let (chain, steps) = finder.chain(options.base.as_deref(), options.tip.as_deref())?;
    let (bodies, faults) = finder.bodies(&steps)?;
    let follows = followers(source, &tree, &chain)?;
    let (limits, mut assumed) = text::limits(&chain);
    let mut remarks = vec![format!("{}: {}", source.name, tree.passed_over)];
    remarks.extend(chain.chosen.iter().cloned());
    for joint in chain.joints.iter().filter(|joint| joint.mimic.is_some()) {
        let index = chain.joints.iter().position(|other| other.name == joint.name);
        if follows.iter().all(|(follower, ..)| Some(*follower) != index) {
            assumed.push(format!(
                "joint {} follows {}, which is outside the chain: here it is treated as an independent axis",
                joint.name,
                joint.mimic.as_ref().map_or("", |mimic| mimic.leader.as_str())
            ));
        }
    }
    let (model, frames) = rows::table(&chain, &limits);
    let text = Text {
        file: &file_name(&source.name),
        name: &tree.name,
        chain: &chain,
        model: &model,
        follows: &follows,
        bodies: Bodies::of(&bodies, &frames, &chain),
        target: options.target,
        gravity: options.gravity,
        faults: &faults,
    };
    let (text, more) = text.write(&remarks, &assumed);
    assumed.extend(more);
    let made = Source::new(made_name(&source.name), text);
    let robot = parse_robot(made.clone(), None, None).map_err(|error| in_original(source, &error))?;
    let difference = difference(&robot, &Compared { chain: &chain, follows }, &limits);
    // Written this way round, NaN also differs.
    if !(difference <= AGREEMENT) {
        let message = format!(
            "the table made from this URDF differs from it by {difference:.1e} m at some pose, so it was not written"
        );
        let expected = format!(
            "expected a difference of at most {AGREEMENT:.0e} m; check that lengths are in m and that no joint is \
                     kilometres away"
        );
        return Err(source.error(tree.span.clone(), message, Some(expected)));
    }
    remarks.extend(faults);
    remarks.extend(doubtful_units(&chain));
    remarks.extend(assumed.iter().map(|line| format!("assumed: {line}")));
    Ok(Converted { source: made, robot, remarks, difference: Some(difference) })
}

/// The joints of the chain that follow others in it, possibly through joints outside it.
fn followers(
    source: &Source,
    tree: &Tree,
    chain: &Chain,
) -> Result<Vec<(usize, usize, f64, f64)>, InputError> {
    let in_chain = |name: &str| chain.joints.iter().position(|joint| joint.name == name);
    let finder = Finder { source, tree };
    let mut follows = Vec::new();
    for (follower, joint) in chain.joints.iter().enumerate() {
        let Some(mimic) = &joint.mimic else { continue };
        let mut mimic = mimic.clone();
        let mut names = vec![joint.name.clone()];
        // The nearest joint of the chain; beyond it, the path is followed only to check that it ends.
        let mut leader = None;
        loop {
            if names.contains(&mimic.leader) {
                let message = format!("joint {} is in a circle of joints that follow each other", joint.name);
                return Err(source.error(
                    joint.span.clone(),
                    message,
                    Some("expected a <mimic> that leads to a joint without a <mimic>".to_owned()),
                ));
            }
            if leader.is_none() {
                leader = in_chain(&mimic.leader).map(|index| (index, mimic.ratio, mimic.offset));
            }
            names.push(mimic.leader.clone());
            // A joint outside the chain may in turn follow one in it.
            let Some(next) = finder.mimic_of(&mimic.leader)? else { break };
            mimic = chain::Mimic {
                leader: next.leader,
                ratio: mimic.ratio * next.ratio,
                offset: mimic.ratio * next.offset + mimic.offset,
            };
        }
        follows.extend(leader.map(|(leader, ratio, offset)| (follower, leader, ratio, offset)));
    }
    Ok(follows)
}

/// Largest distance between table and URDF at the tip and at points a metre from it, m.
fn difference(robot: &Robot, compared: &Compared<'_>, limits: &[[f64; 2]]) -> f64 {
    let model = &robot.model;
    // A fixed seed, so that the same file is always accepted or refused.
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut worst: f64 = 0.0;
    for _ in 0..POSES {
        let mut q: Vec<f64> = limits
            .iter()
            .zip(&compared.chain.joints)
            .map(|([low, high], joint)| {
                let reach = if joint.kind == JointKind::Revolute { std::f64::consts::PI } else { 1e3 };
                let (low, high) = (low.max(-reach), high.min(reach));
                if low < high { random.random_range(low..high) } else { low }
            })
            .collect();
        // Followers of followers settle in as many passes as there are joints.
        for _ in &compared.follows {
            for (follower, leader, ratio, offset) in &compared.follows {
                q[*follower] = ratio * q[*leader] + offset;
            }
        }
        let command = model.actuators.command_from_joints(&q);
        let mut joints = vec![0.0; q.len()];
        model.actuators.joints_from_command(&command, &mut joints);
        let (table, urdf) = (flange(robot, &joints), compared.chain.tip_at(&q));
        for point in [Vector3::zeros(), Vector3::x(), Vector3::y(), Vector3::z()] {
            let at = |frame: &Transform| frame.rotation * point + frame.translation.vector;
            let apart = (at(&table) - at(&urdf)).norm();
            worst = if apart > worst || apart.is_nan() { apart } else { worst };
        }
    }
    worst
}

/// The flange at joint variables, from the table.
fn flange(robot: &Robot, q: &[f64]) -> Transform {
    let chain = &robot.model.kinematics;
    let links = chain.links.iter().zip(q);
    links.fold(chain.base_from_first, |at, (link, q)| at * link.transform(*q)) * chain.last_from_flange
}

/// An error of the robot file that was made, reported for the original file: the made one cannot be looked at.
fn in_original(source: &Source, error: &InputError) -> InputError {
    let (said, help) = match error {
        InputError::Invalid { message, help, .. } => (message.clone(), help.clone()),
        other => (other.to_string(), None),
    };
    // The wrong value usually has a name in it.
    let mut named = said.split('"').skip(1).step_by(2).filter(|name| !name.is_empty());
    let span = named.find_map(|name| source.text.find(name).map(|at| at..at + name.len()));
    source.error(span.unwrap_or(0..0), format!("no robot can be made from it: {said}"), help)
}

/// Reaches of robots, m: from a watchmaker's to a shipyard's.
const REACHES: [f64; 2] = [0.02, 100.0];

/// Remark on lengths whose sum fits no robot.
fn doubtful_reach(reach: f64) -> Option<String> {
    let [least, most] = REACHES;
    let told =
        |unit: &str| format!("doubtful: the lengths add up to {reach:.4} m, which fits no robot: {unit}");
    if reach > most {
        Some(told("are they in mm?"))
    } else if reach > 0.0 && reach < least {
        Some(told("are they in m, but read as mm?"))
    } else {
        None
    }
}

/// The same of a URDF, whose lengths are m and whose angles are rad.
fn doubtful_units(chain: &Chain) -> Vec<String> {
    let origins = chain.joints.iter().map(|joint| &joint.previous_from_joint);
    let reach = origins.chain([&chain.last_from_tip]).map(|frame| frame.translation.vector.norm()).sum();
    let mut doubtful: Vec<String> = doubtful_reach(reach).into_iter().collect();
    if chain.largest_angle > MOST_TURNS {
        doubtful.push(format!(
            "doubtful: rpy has {}, and angles of a URDF are in rad: is it in deg?",
            chain.largest_angle
        ));
    }
    let is_far = |joint: &&chain::MovingJoint| {
        joint.kind == JointKind::Revolute
            && joint.limits.is_some_and(|limits| limits.iter().any(|l| l.abs() > FAR_TURNED))
    };
    let far: Vec<_> = chain.joints.iter().filter(is_far).map(|joint| joint.name.as_str()).collect();
    if !far.is_empty() {
        doubtful.push(format!(
            "doubtful: the limits of {} are more than three turns from zero, and angles of a URDF are in rad: are they in deg?",
            far.join(", ")
        ));
    }
    doubtful
}

/// Angles of an origin are less than a turn, rad.
const MOST_TURNS: f64 = std::f64::consts::TAU + 1e-3;
/// Three turns and a little, rad: some last joints go so far.
const FAR_TURNED: f64 = 20.0;

/// Name of the robot file if none is written: that of the original, with another ending.
fn made_name(name: &str) -> String {
    Path::new(name).with_extension("toml").display().to_string()
}

fn file_name(name: &str) -> String {
    Path::new(name).file_name().map_or_else(|| name.to_owned(), |name| name.to_string_lossy().into_owned())
}
