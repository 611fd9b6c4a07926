//! The text of a robot file made from a chain, with its assumptions.

use std::f64::consts::TAU;
use std::fmt::Write;

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::chain::Chain;
use crate::input::quoted;
use crate::robot::frames::sphere;
use calibrig_model::geometry::Transform;
use calibrig_model::{Body, CraigLink, JointKind, KinematicModel, STANDARD_GRAVITY};

/// What is to be written.
pub(super) struct Text<'a> {
    pub file: &'a str,
    pub name: &'a str,
    pub chain: &'a Chain,
    pub model: &'a KinematicModel,
    /// (follower, leader, ratio, offset in rad or m)
    pub follows: &'a [(usize, usize, f64, f64)],
    pub bodies: Option<Bodies>,
    pub target: Option<Vector3<f64>>,
    /// m/s² in the base; against its z axis without it.
    pub gravity: Option<Vector3<f64>>,
    pub faults: &'a [String],
}

/// What the joints carry, in their links' frames, and a stiffness of every drive to begin with.
pub(super) struct Bodies {
    bodies: Vec<Body>,
    stiffness: Vec<f64>,
}

/// Assumed deflection of a drive under its load with the arm stretched out, rad or m per m of it.
const SAG: f64 = 1e-3;

/// The softest drive is assumed to have at least this share of the stiffness of the stiffest one of its kind.
const SOFTEST: f64 = 0.02;

/// How well they are known: geared drives have about this stiffness, cables and belts a tenth of it.
const COMPLIANCE_PERCENT: f64 = 1000.0;

/// Travel of a slide whose limits are not stated, m either way.
const SLIDE: f64 = 1.0;

impl Bodies {
    /// `None` if a joint carries nothing with a mass: then no deflection can be predicted.
    pub fn of(in_base: &[Option<Body>], frames: &[Transform], chain: &Chain) -> Option<Self> {
        let bodies: Vec<Body> = in_base
            .iter()
            .zip(frames)
            .map(|(body, frame)| body.as_ref().map(|body| in_frame(body, frame)))
            .collect::<Option<_>>()?;
        let stiffness = stiffness(&bodies, frames, chain)?;
        Some(Self { bodies, stiffness })
    }
}

fn in_frame(body: &Body, base_from_link: &Transform) -> Body {
    let link_from_base = base_from_link.inverse();
    let turn = link_from_base.rotation.matrix();
    Body {
        mass: body.mass,
        centre_of_mass: (link_from_base * nalgebra::Point3::from(body.centre_of_mass)).coords,
        inertia: turn * body.inertia * turn.transpose(),
    }
}

/// For every drive, the stiffness that deflects by [`SAG`] under its whole load, stretched out.
fn stiffness(bodies: &[Body], frames: &[Transform], chain: &Chain) -> Option<Vec<f64>> {
    let place = |joint: usize| frames[joint].translation.vector;
    let load = |joint: usize| {
        let mut way = 0.0;
        let mut torque = 0.0;
        for (outer, body) in bodies.iter().enumerate().skip(joint) {
            if outer > joint {
                way += (place(outer) - place(outer - 1)).norm();
            }
            torque += STANDARD_GRAVITY * body.mass * (way + body.centre_of_mass.norm());
        }
        match chain.joints[joint].kind {
            JointKind::Revolute => torque / SAG,
            JointKind::Prismatic => {
                STANDARD_GRAVITY * bodies[joint..].iter().map(|b| b.mass).sum::<f64>() / SAG
            }
        }
    };
    let stiffness: Vec<f64> = (0..bodies.len()).map(load).collect();
    let stiffest = |kind: JointKind| {
        let of_kind = stiffness.iter().zip(&chain.joints).filter(|(_, joint)| joint.kind == kind);
        of_kind.map(|(k, _)| *k).fold(0.0, f64::max)
    };
    let floored = stiffness
        .iter()
        .zip(&chain.joints)
        .map(|(k, joint)| k.max(SOFTEST * stiffest(joint.kind)))
        .map(|k| (k > 0.0 && k.is_finite()).then(|| two_digits(k)));
    floored.collect()
}

/// A guess has no more digits.
fn two_digits(value: f64) -> f64 {
    let unit = 10_f64.powf(value.log10().floor() - 1.0);
    (value / unit).round() * unit
}

/// Limits of every joint (rad or m), and where they are assumed.
pub(super) fn limits(chain: &Chain) -> (Vec<[f64; 2]>, Vec<String>) {
    let mut assumed = Vec::new();
    let limits = chain.joints.iter().map(|joint| {
        joint.limits.unwrap_or_else(|| {
            let (limits, words) = match joint.kind {
                JointKind::Revolute => ([-TAU, TAU], "-360 to 360 deg"),
                JointKind::Prismatic => ([-SLIDE, SLIDE], "-1000 to 1000 mm"),
            };
            let why = if joint.continuous { "is continuous, and has no limits" } else { "states no limits" };
            assumed.push(format!("limits of joint {}, which {why}: {words}", joint.name));
            limits
        })
    });
    let limits = limits.collect();
    (limits, assumed)
}

/// A number that reads back to itself, or without the last digits if these are rounding of a rounder one.
pub(super) fn number(value: f64) -> String {
    for digits in 0..=9 {
        let scale = 10_f64.powi(digits);
        let round = (value * scale).round() / scale;
        if (round - value).abs() <= 1e-11 * value.abs().clamp(1e-2, 1.0) {
            // No minus in front of a zero.
            return format!("{}", round + 0.0);
        }
    }
    format!("{value}")
}

/// A text in quotes.
pub(super) fn mm(value: f64) -> String {
    number(1e3 * value)
}

pub(super) fn deg(value: f64) -> String {
    number(value.to_degrees())
}

/// Roll, pitch and yaw of a rotation, also exact if pitch is a quarter turn.
pub(crate) fn roll_pitch_yaw(rotation: &Rotation3<f64>) -> [f64; 3] {
    let r = rotation.matrix();
    let across = r.m11.hypot(r.m21);
    let pitch = (-r.m31).atan2(across);
    // At a quarter turn roll and yaw are equivalent; the roll below then takes up the rest.
    let yaw = if across > 1e-14 { r.m21.atan2(r.m11) } else { 0.0 };
    let (sin, cos) = yaw.sin_cos();
    let roll = (sin * r.m13 - cos * r.m23).atan2(cos * r.m22 - sin * r.m12);
    [roll, pitch, yaw]
}

/// Writing to a String cannot fail.
macro_rules! line {
    ($text:expr) => { $text.push('\n') };
    ($text:expr, $($format:tt)*) => {{ let _ = writeln!($text, $($format)*); }};
}
pub(crate) use line;

/// `[base]` or `[flange]`; nothing for the identity.
pub(super) fn frame(text: &mut String, key: &str, comment: &str, frame: &Transform) {
    let place = frame.translation.vector;
    let turn = roll_pitch_yaw(&frame.rotation);
    let entries = [
        ("x_mm", mm(place.x)),
        ("y_mm", mm(place.y)),
        ("z_mm", mm(place.z)),
        ("roll_deg", deg(turn[0])),
        ("pitch_deg", deg(turn[1])),
        ("yaw_deg", deg(turn[2])),
    ];
    let stated: Vec<_> = entries.iter().filter(|(_, value)| value != "0").collect();
    if stated.is_empty() {
        return;
    }
    line!(text);
    line!(text, "# {comment}");
    line!(text, "[{key}]");
    for (key, value) in stated {
        line!(text, "{key} = {value}");
    }
}

/// A row of the table with its limits.
pub(super) fn row(text: &mut String, link: &CraigLink, comments: [&str; 2]) {
    let kind = match link.kind {
        JointKind::Revolute => "revolute",
        JointKind::Prismatic => "prismatic",
    };
    line!(text);
    line!(text, "[[joint]]");
    line!(text, "name = {}", quoted(&link.name));
    line!(text, "type = \"{kind}\"");
    line!(text, "a_mm = {}", mm(link.a));
    line!(text, "alpha_deg = {}", deg(link.alpha));
    if link.beta != 0.0 {
        line!(text, "beta_deg = {}", deg(link.beta));
    }
    line!(text, "d_mm = {}", mm(link.d));
    line!(text, "theta_deg = {}", deg(link.theta));
    let [low, high] = match link.kind {
        JointKind::Revolute => link.limits.map(deg),
        JointKind::Prismatic => link.limits.map(mm),
    };
    let unit = if link.kind == JointKind::Revolute { "deg" } else { "mm" };
    line!(text, "min_{unit} = {low}{}", comments[0]);
    line!(text, "max_{unit} = {high}{}", comments[1]);
}

impl Text<'_> {
    /// The text, and its assumptions beyond `assumed`.
    pub fn write(&self, remarks: &[String], assumed: &[String]) -> (String, Vec<String>) {
        let mut more = Vec::new();
        let mut text = String::new();
        let (base, tip) = (&self.chain.base, &self.chain.tip);
        line!(
            text,
            "# Made by calibrig from {}: the chain from link {base} to link {tip}.",
            one_line(self.file)
        );
        line!(text, "#");
        line!(
            text,
            "# The rows follow from the joints' axes: Craig's where neighbouring axes cross, with Hayati's beta where they are nearly parallel."
        );
        line!(
            text,
            "# Joint variables, their signs and their zeros are those of the file; theta_deg (d_mm) holds the offset between \
             its zero and the table's."
        );
        for remark in remarks.iter().chain(self.faults) {
            line!(text, "# {}", one_line(remark));
        }
        line!(text, "# Values marked \"assumed\" are not in the file: check them.");
        line!(text);
        line!(text, "schema = \"calibrig.robot/1\"");
        line!(text, "name = {}", quoted(self.name));
        line!(text, "convention = \"craig\"");
        if self.bodies.is_some() {
            line!(
                text,
                "# Assumed: the stiffnesses below are guesses, more likely too high than too low; drives may be many times \
                 softer."
            );
            line!(text, "compliance_percent = {COMPLIANCE_PERCENT}");
        }
        let first = format!("From {base} to where the first row starts.");
        frame(&mut text, "base", &one_line(&first), &self.model.base_from_first);
        for index in 0..self.model.links.len() {
            self.joint(&mut text, index);
        }
        let last = format!("From the last joint's frame to {tip}.");
        frame(&mut text, "flange", &one_line(&last), &self.model.last_from_flange);
        line!(text);
        line!(text, "[actuators]");
        line!(text, "kind = \"direct\"");
        for line in assumed {
            line!(text, "# Assumed: {}", one_line(line));
        }
        if let Some(target) = self.target {
            line!(text);
            line!(text, "# As given by --target-mm, in the frame of {}.", one_line(tip));
            line!(text, "[target]");
            let [x, y, z] = [target.x, target.y, target.z].map(mm);
            line!(text, "x_mm = {x}\ny_mm = {y}\nz_mm = {z}");
        }
        match &self.bodies {
            Some(_) => {
                let gravity = self.gravity.unwrap_or(Vector3::new(0.0, 0.0, -STANDARD_GRAVITY));
                line!(text);
                match self.gravity {
                    Some(_) => line!(text, "# As given by --gravity-m-per-s2, in the frame of {}.", one_line(base)),
                    None => {
                        line!(text, "# Assumed: {} stands upright, its z axis pointing up.", one_line(base));
                        more.push(format!("gravity along -z of {base} (--gravity-m-per-s2)"));
                    }
                }
                line!(text, "[gravity]");
                line!(text, "x_m_per_s2 = {}\ny_m_per_s2 = {}\nz_m_per_s2 = {}", gravity.x, gravity.y, gravity.z);
                more.push(format!(
                    "stiffnesses of the drives, which the file does not state: {} mrad (mm) of sag under what each carries, \
                     and compliance_percent = {COMPLIANCE_PERCENT}",
                    1e3 * SAG
                ));
            }
            None => more.push(
                "no gravity modes: the file does not give every moving link a mass ([joint.body], stiffnesses and [gravity] \
                 can be added to the robot file)".to_owned(),
            ),
        }
        (text, more)
    }

    fn joint(&self, text: &mut String, index: usize) {
        let (link, joint) = (&self.model.links[index], &self.chain.joints[index]);
        let comment = if joint.limits.is_some() { "" } else { " # assumed" };
        row(text, link, [comment, comment]);
        if let Some(bodies) = &self.bodies {
            let key = match joint.kind {
                JointKind::Revolute => "stiffness_nm_per_rad",
                JointKind::Prismatic => "stiffness_n_per_m",
            };
            line!(text, "{key} = {} # assumed", bodies.stiffness[index]);
        }
        if let Some((_, leader, ratio, offset)) =
            self.follows.iter().find(|(follower, ..)| *follower == index)
        {
            let leader = &self.chain.joints[*leader];
            line!(text, "# A <mimic>: it has no command of its own.");
            line!(text, "[joint.follows]");
            line!(text, "joint = {}", quoted(&leader.name));
            let unit = |kind| if kind == JointKind::Revolute { 1_f64.to_radians() } else { 1e-3 };
            line!(text, "ratio = {}", number(ratio * unit(leader.kind) / unit(joint.kind)));
            match joint.kind {
                JointKind::Revolute => line!(text, "offset_deg = {}", deg(*offset)),
                JointKind::Prismatic => line!(text, "offset_mm = {}", mm(*offset)),
            }
        }
        if let Some(bodies) = &self.bodies {
            body(text, &bodies.bodies[index]);
        }
    }
}

fn body(text: &mut String, body: &Body) {
    line!(text, "[joint.body]");
    line!(text, "mass_kg = {}", number(body.mass));
    let [x, y, z] = [body.centre_of_mass.x, body.centre_of_mass.y, body.centre_of_mass.z].map(mm);
    line!(text, "x_mm = {x}\ny_mm = {y}\nz_mm = {z}");
    let is_assumed = |inertia: &Matrix3<f64>| (inertia - sphere(body.mass)).amax() <= 1e-12 * inertia.amax();
    if is_assumed(&body.inertia) {
        return;
    }
    let i = &body.inertia;
    for (key, value) in
        [("ixx", i.m11), ("iyy", i.m22), ("izz", i.m33), ("ixy", i.m12), ("ixz", i.m13), ("iyz", i.m23)]
    {
        // The rounding of a zero after turning axes.
        let value = if value.abs() < 1e-12 * i.amax() { 0.0 } else { value };
        line!(text, "{key}_kg_m2 = {value}");
    }
}

/// A comment stays one.
fn one_line(text: &str) -> String {
    let plain: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    plain.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::random::{StreamSource as Stream, stream};
    use rand::RngExt;

    #[test]
    fn roll_pitch_and_yaw_make_the_rotation_again() {
        let mut random = stream(5, 0, Stream::AsBuilt);
        for trial in 0..4000 {
            let near = [0.0, 1e-12, 1e-9, 3e-9, 1e-7, 1e-5][trial % 6];
            let quarter = std::f64::consts::FRAC_PI_2;
            let pitch = match trial % 3 {
                0 => quarter - near,
                1 => -quarter + near,
                _ => random.random_range(-1.5..1.5),
            };
            let [roll, yaw] = [0, 1].map(|_| random.random_range(-3.2..3.2));
            let rotation = Rotation3::from_euler_angles(roll, pitch, yaw);
            let [roll, pitch, yaw] = roll_pitch_yaw(&rotation);
            let again = Rotation3::from_euler_angles(roll, pitch, yaw);
            assert!((again.matrix() - rotation.matrix()).norm() < 1e-13);
        }
    }

    #[test]
    fn numbers_are_read_back_and_round_where_a_round_one_is_meant() {
        for (value, shown) in [
            (90.000_000_000_000_01, "90"),
            (-0.0, "0"),
            (1e-15, "0"),
            (89.159, "89.159"),
            (-392.250_000_000_000_06, "-392.25"),
            (1.0 / 3.0, "0.3333333333333333"),
        ] {
            assert_eq!(number(value), shown);
        }
        // What differs is kept.
        assert_eq!(number(90.000_210_459_153).parse::<f64>(), Ok(90.000_210_459_153));
    }
}
