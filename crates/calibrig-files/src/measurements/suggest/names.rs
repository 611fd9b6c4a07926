//! What the name of a column suggests.

use super::super::units::HeaderUnit;
use super::column::Role;

/// What a name says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Said {
    Role(Role),
    Joint(JointName),
}

/// The name of a joint's column.
#[derive(Debug, Clone, PartialEq, Eq)]
#[expect(clippy::struct_excessive_bools, reason = "each axis is stated or not, independently of the others")]
pub(in super::super) struct JointName {
    /// All of the name except its number: the same for joints that belong together.
    pub family: String,
    /// By its number, or by its place on an arm if its name shows that.
    pub order: Option<usize>,
    /// Not part of the arm: a rail, a turntable.
    pub is_external: bool,
    /// Whether its name is that of a sliding axis.
    pub slides: bool,
    /// Whether it is named by its kind rather than by a number.
    pub has_own_name: bool,
    /// In the style of a `sensor_msgs/JointState`, which is in rad and m.
    pub is_of_ros: bool,
    pub is_command: bool,
}

impl JointName {
    /// An axis with a letter instead of a number.
    pub(super) fn of_letter(family: &str, order: usize) -> Self {
        Self {
            family: format!("{family} letter"),
            order: Some(order),
            is_external: false,
            slides: false,
            has_own_name: false,
            is_of_ros: false,
            is_command: false,
        }
    }
}

/// Parts of names that change the quantity of a column.
const OTHER: [&str; 40] = [
    "velocity",
    "velocities",
    "vel",
    "speed",
    "effort",
    "efforts",
    "torque",
    "current",
    "acceleration",
    "acc",
    "nominal",
    "nom",
    "soll",
    "ref",
    "reference",
    "dev",
    "deviation",
    "error",
    "err",
    "delta",
    "tol",
    "sigma",
    "std",
    "sd",
    "unc",
    "uncertainty",
    "rms",
    "orientation",
    "quaternion",
    "rotation",
    "angular",
    "normal",
    "tolerance",
    "residual",
    "name",
    "frame",
    "seq",
    "u95",
    "diff",
    "offset",
];
const COMMAND: [&str; 7] = ["cmd", "command", "commanded", "soll", "setpoint", "nominal", "ref"];
/// What stands in front of the number of a joint.
const NUMBERED: [&str; 15] = [
    "j",
    "a",
    "q",
    "joint",
    "axis",
    "axe",
    "ax",
    "theta",
    "achse",
    "jt",
    "rax",
    "jnt",
    "gelenk",
    "position",
    "positions",
];
const EXTERNAL: [&str; 7] = ["e", "eax", "ext", "extax", "external", "exax", "zusatzachse"];
const SLIDES: [&str; 14] = [
    "rail",
    "track",
    "gantry",
    "slide",
    "slider",
    "linear",
    "carriage",
    "lift",
    "prismatic",
    "travel",
    "stroke",
    "schiene",
    "linearachse",
    "telescope",
];
const TURNS: [&str; 4] = ["turntable", "positioner", "drehtisch", "dreh"];
/// Parts of arms, from the base.
const ARM: [&[&str]; 8] = [
    &["base", "waist", "torso"],
    &["shoulder", "pan"],
    &["shoulder", "lift"],
    &["shoulder"],
    &["upperarm", "upper"],
    &["elbow"],
    &["forearm"],
    &["wrist"],
];

/// A name without the unit at its end: `x_mm`.
fn without_unit(name: &str) -> &str {
    match name.rsplit_once('_') {
        Some((stem, unit)) if HeaderUnit::parse(unit).is_some() => stem,
        _ => name,
    }
}

/// Words of a name, in lower case: `$AXIS_ACT.A1` is axis, act, a1.
pub(super) fn words(name: &str) -> Vec<String> {
    let parts = without_unit(name).split(|c: char| !c.is_alphanumeric());
    parts.filter(|part| !part.is_empty()).map(str::to_lowercase).collect()
}

/// What is left of a name without the x, y or z at its end or start: the same for columns that belong together.
pub(super) fn beside_axis(name: &str) -> Vec<String> {
    let is_axis = |word: &str| matches!(word, "x" | "y" | "z");
    let mut words = words(name);
    if words.last().is_some_and(|word| is_axis(word)) {
        words.pop();
    } else if words.first().is_some_and(|word| is_axis(word)) {
        words.remove(0);
    } else if let [word] = words.as_mut_slice() {
        // `posx`, `xmeas`.
        let axes = ['x', 'y', 'z'];
        *word = word.strip_prefix(axes).or(word.strip_suffix(axes)).unwrap_or(word).to_owned();
    }
    words
}

/// Letters and the number behind them: `a1`.
fn numbered(word: &str) -> Option<(&str, usize)> {
    let letters = word.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    Some((&word[..letters], word[letters..].parse().ok()?))
}

pub(super) fn said_by(name: &str) -> Option<Said> {
    let words = words(name);
    let has = |list: &[&str]| words.iter().any(|word| list.contains(&word.as_str()));
    if let Some(role) = role_of(&words) {
        return Some(Said::Role(role));
    }
    let is_command = has(&COMMAND);
    if has(&OTHER) && !is_command {
        return None;
    }
    joint(&words, is_command).map(Said::Joint)
}

fn joint(words: &[String], is_command: bool) -> Option<JointName> {
    let has = |list: &[&str]| words.iter().any(|word| list.contains(&word.as_str()));
    let named = has(&["shoulder", "elbow", "wrist", "forearm", "upperarm", "waist", "torso"]);
    // The lift of a shoulder turns.
    let slides = has(&SLIDES) && !named;
    let is_of_ros = has(&["position", "positions"])
        || words.windows(2).any(|pair| pair[0] == "joint" && matches!(pair[1].as_str(), "state" | "states"));
    let made = |family: String, order, is_external, has_own_name| {
        let is_of_ros = is_of_ros || family.contains("position");
        Some(JointName {
            family,
            order,
            is_external: is_external || slides || has(&TURNS),
            slides,
            has_own_name,
            is_of_ros,
            is_command,
        })
    };
    let all_but = |at: usize, stem: &str| {
        let rest =
            words.iter().enumerate().map(|(index, word)| if index == at { stem } else { word.as_str() });
        rest.collect::<Vec<_>>().join(" ").trim().to_owned()
    };
    if !named {
        for (at, word) in words.iter().enumerate().rev() {
            // `joint 1`, `position[0]`: the number is a word of its own.
            let alone = at.checked_sub(1).map(|before| words[before].as_str());
            let Some((stem, number)) = numbered(word) else { continue };
            let stem = if stem.is_empty() { alone.unwrap_or_default() } else { stem };
            if NUMBERED.contains(&stem) || EXTERNAL.contains(&stem) {
                let family =
                    all_but(at, if word.starts_with(|c: char| c.is_ascii_digit()) { "" } else { stem });
                return made(family, Some(number), EXTERNAL.contains(&stem), false);
            }
        }
        // ABB counts external axes with letters: `eax_a`.
        if let [.., before, last] = words
            && before == "eax"
            && let [letter @ b'a'..=b'f'] = last.as_bytes()
        {
            return made("eax".to_owned(), Some(usize::from(letter - b'a')), true, false);
        }
    }
    let is_joint = has(&["joint", "achse", "axis", "jnt"])
        && words.len() > 1
        && words.iter().any(|word| !is_plain(word));
    if !(named || slides || has(&TURNS) || is_joint) {
        return None;
    }
    let place = ARM.iter().position(|part| part.iter().all(|word| words.iter().any(|own| own == word)));
    let number = words.iter().rev().find_map(|word| numbered(word)).map_or(0, |(_, number)| number);
    made(String::new(), place.map(|place| 100 * place + number.min(99)), false, true)
}

/// Words that do not identify a joint.
fn is_plain(word: &str) -> bool {
    [
        "joint",
        "states",
        "state",
        "axis",
        "position",
        "positions",
        "act",
        "actual",
        "achse",
        "jnt",
        "angle",
        "value",
    ]
    .contains(&word)
}

fn role_of(words: &[String]) -> Option<Role> {
    let other = |word: &String| OTHER.contains(&word.as_str()) || COMMAND.contains(&word.as_str());
    let all: String = words.concat();
    if let Some(role) = whole_name(&all) {
        return Some(role);
    }
    if words.iter().any(other) || words.len() > 6 {
        return None;
    }
    let axis = |word: &str| match word {
        "x" => Some(Role::X),
        "y" => Some(Role::Y),
        "z" => Some(Role::Z),
        _ => None,
    };
    let stamp = |word: &str| match word {
        "sec" | "secs" | "nsec" | "nsecs" | "nanosec" | "nanosecs" | "stamp" | "time" | "timestamp" => {
            Some(Role::Time)
        }
        _ => None,
    };
    let (first, last) = (words.first()?, words.last()?);
    if words.len() > 1 {
        return axis(last).or(axis(first)).or(stamp(last));
    }
    stamp(last)
}

fn whole_name(name: &str) -> Option<Role> {
    Some(match name {
        "x" | "xpos" | "posx" | "xactual" | "xmeas" | "xmeasured" | "measx" | "actualx" | "xist" => Role::X,
        "y" | "ypos" | "posy" | "yactual" | "ymeas" | "ymeasured" | "measy" | "actualy" | "yist" => Role::Y,
        "z" | "zpos" | "posz" | "zactual" | "zmeas" | "zmeasured" | "measz" | "actualz" | "zist" => Role::Z,
        "r" | "range" | "dist" | "distance" | "d" | "slopedistance" | "sd" | "distanz" | "strecke" => {
            Role::Range
        }
        "az" | "azimuth" | "hz" | "horizontal" | "horizontalangle" | "ha" | "azimut" => Role::Azimuth,
        "el" | "elev" | "elevation" | "elevationangle" => Role::Elevation,
        "ze" | "zen" | "zenith" | "v" | "vertical" | "verticalangle" | "va" | "zenithangle" => Role::Zenith,
        "sx" | "sigmax" | "ux" | "stdx" | "stddevx" | "sdx" | "u95x" | "ux95" | "xuncertainty"
        | "uncertaintyx" => Role::SigmaX,
        "sy" | "sigmay" | "uy" | "stdy" | "stddevy" | "sdy" | "u95y" | "uy95" | "yuncertainty"
        | "uncertaintyy" => Role::SigmaY,
        "sz" | "sigmaz" | "uz" | "stdz" | "stddevz" | "sdz" | "u95z" | "uz95" | "zuncertainty"
        | "uncertaintyz" => Role::SigmaZ,
        "pose" | "no" | "nr" | "number" | "posenumber" | "poseno" | "index" | "lfdnr" | "nummer" => {
            Role::Pose
        }
        "name" | "point" | "pointname" | "id" | "pointid" | "label" | "nominal" | "punkt" | "punktname"
        | "punktnr" | "messpunkt" | "feature" => Role::Name,
        "station" | "instrument" => Role::Station,
        "target" | "smr" | "reflector" | "nest" | "reflektor" => Role::Target,
        "t" | "time" | "timestamp" | "datetime" | "clock" | "timeofday" | "zeit" | "uhrzeit"
        | "zeitstempel" | "date" | "datum" => Role::Time,
        "temperature" | "temp" | "airtemperature" | "temperatur" | "lufttemperatur" => Role::Temperature,
        "pressure" | "airpressure" | "druck" | "luftdruck" => Role::Pressure,
        "humidity" | "relativehumidity" | "rh" | "feuchte" | "luftfeuchte" => Role::Humidity,
        "face" | "lage" | "fernrohrlage" | "telescopeface" => Role::Face,
        "set" | "use" | "usage" => Role::Set,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joint(name: &str) -> JointName {
        match said_by(name) {
            Some(Said::Joint(joint)) => joint,
            other => panic!("{name}: {other:?}"),
        }
    }

    #[test]
    fn joints_are_known_by_the_names_that_robots_and_programs_give_them() {
        for (name, order) in [
            ("J1", Some(1)),
            ("Joint 6 [deg]", Some(6)),
            ("A3_act", Some(3)),
            ("$AXIS_ACT.A4", Some(4)),
            ("joint_a1", Some(1)),
            ("lbr_iiwa_joint_7", Some(7)),
            ("rax_2", Some(2)),
            ("position[0]", Some(0)),
            ("field.position5", Some(5)),
            ("q3_deg", Some(3)),
            ("Achse 2", Some(2)),
            ("shoulder_pan_joint", Some(100)),
            ("shoulder_lift_joint", Some(200)),
            ("elbow_joint", Some(500)),
            ("/joint_states/wrist_2_joint/position", Some(702)),
            ("panda_finger_joint", None),
        ] {
            assert_eq!(joint(name).order, order, "{name}");
        }
        for (name, is_external, slides) in [
            ("E1", true, false),
            ("eax_a", true, false),
            ("rail_joint", true, true),
            ("Linear axis", true, true),
            ("A1", false, false),
        ] {
            let found = joint(name);
            assert_eq!((found.is_external, found.slides), (is_external, slides), "{name}");
        }
        assert!(joint("J1 cmd").is_command && !joint("J1 act").is_command);
        assert_ne!(joint("J1 cmd").family, joint("J1 act").family);
        assert_eq!(joint("J1 cmd").family, joint("J2 cmd").family);
        for name in [
            "velocity[0]",
            "/joint_states/elbow_joint/velocity",
            "J1 torque",
            "field.name0",
            "Joint",
            "RMS",
            "",
        ] {
            assert_eq!(said_by(name), None, "{name}");
        }
    }

    #[test]
    fn places_and_times_are_known_by_the_last_word() {
        for (name, role) in [
            ("point.x", Role::X),
            ("/tracker/point/y", Role::Y),
            ("pose.position.z", Role::Z),
            ("X Actual", Role::X),
            ("X-Ist", Role::X),
            ("$POS_ACT.X", Role::X),
            ("header.stamp.nanosec", Role::Time),
            ("%time", Role::Time),
            ("__time", Role::Time),
            ("Datum", Role::Time),
        ] {
            assert_eq!(said_by(name), Some(Said::Role(role)), "{name}");
        }
        for name in ["X Nominal", "pose.orientation.x", "dev x", "X error"] {
            assert_eq!(said_by(name), None, "{name}");
        }
    }
}
