//! The names of what can be identified.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;

use super::measurement::InstrumentTerm;
use super::terms::TermId;

/// One of the five parameters of a Craig/Hayati link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum LinkTerm {
    /// Link length a(i-1).
    A,
    /// Link twist alpha(i-1).
    Alpha,
    /// Hayati's beta.
    Beta,
    /// Link offset d.
    D,
    /// Joint angle theta.
    Theta,
}

impl LinkTerm {
    /// All five, in the order of the published table with beta last.
    pub const ALL: [Self; 5] = [Self::A, Self::Alpha, Self::D, Self::Theta, Self::Beta];

    /// Whether the parameter is a length (m) or an angle (rad).
    pub fn unit(self) -> Unit {
        match self {
            Self::A | Self::D => Unit::Metre,
            Self::Alpha | Self::Beta | Self::Theta => Unit::Radian,
        }
    }
}

/// The SI unit of a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Unit {
    /// m
    Metre,
    /// rad
    Radian,
    /// A fraction, such as the relative deviation of a compliance.
    One,
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Metre => "m",
            Self::Radian => "rad",
            Self::One => "1",
        })
    }
}

/// Which compliance of the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Compliance {
    /// Of a joint's drive, along or about its axis (the elbow's turns the crank where there is a four-bar).
    Drive {
        /// Index of the joint.
        joint: usize,
    },
    /// Of a joint's bearing.
    Bearing {
        /// Index of the joint.
        joint: usize,
        /// 0..3 along, 3..6 about x, y, z of the bearing's frame.
        axis: usize,
    },
    /// Of a whole flexible link.
    Beam {
        /// Index of the link.
        link: usize,
    },
    /// Of the four-bar's rod.
    Rod,
}

/// A parameter of the elbow's four-bar.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum LinkageTerm {
    /// Length from the crank's axis to the rod.
    Crank,
    /// Length from the elbow's axis to the rod.
    Lever,
    /// Length of the coupler rod.
    Rod,
    /// Displacement of the crank's axis along x of the shoulder's frame ([`CrankAxis`](crate::CrankAxis)).
    AxisX,
    /// Along y.
    AxisY,
    /// Tilt of the crank's axis about x of the shoulder's frame.
    AxisRx,
    /// About y.
    AxisRy,
}

impl LinkageTerm {
    /// All seven, lengths first.
    pub const ALL: [Self; 7] =
        [Self::Crank, Self::Lever, Self::Rod, Self::AxisX, Self::AxisY, Self::AxisRx, Self::AxisRy];

    /// Whether the parameter is a length (m) or an angle (rad).
    pub fn unit(self) -> Unit {
        match self {
            Self::Crank | Self::Lever | Self::Rod | Self::AxisX | Self::AxisY => Unit::Metre,
            Self::AxisRx | Self::AxisRy => Unit::Radian,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Crank => "crank",
            Self::Lever => "lever",
            Self::Rod => "rod",
            Self::AxisX => "axis_x",
            Self::AxisY => "axis_y",
            Self::AxisRx => "axis_rx",
            Self::AxisRy => "axis_ry",
        }
    }
}

/// A scalar that identification may change. Links, stations and targets count from zero here and from one in messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum ParameterId {
    /// Deviation of a link parameter from its nominal value.
    Link {
        /// Index of the link.
        link: usize,
        /// Which of its five parameters.
        term: LinkTerm,
    },
    /// Displacement of the base in the tracker's frame: components 0..3 along, 3..6 about the base's x, y, z.
    Frame {
        /// Index of the tracker station.
        station: usize,
        /// 0..6
        component: usize,
    },
    /// Deviation of the target's position in the flange frame from its measured or nominal value.
    Target {
        /// Index of the target.
        target: usize,
        /// 0..3 for x, y, z
        axis: usize,
    },
    /// Deviation of the target's orientation on the flange: a component of ξ in `flange_from_target · exp(ξ)`.
    Orientation {
        /// Index of the target.
        target: usize,
        /// 0..3 about the target's own x, y, z
        axis: usize,
    },
    /// Relative deviation x of a compliance from its predicted value c: it is c (1 + x), and x is at least -1.
    Compliance(Compliance),
    /// Relative deviation of the mass of a link's body from its stated value.
    Mass {
        /// Index of the link.
        link: usize,
    },
    /// Displacement of the centre of mass of a link's body from its stated place, along an axis of the link's frame.
    Centre {
        /// Index of the link.
        link: usize,
        /// 0..3 for x, y, z
        axis: usize,
    },
    /// Deviation of a parameter of the four-bar.
    Linkage(LinkageTerm),
    /// Amplitude of a correction that depends on the pose, its approach or its time.
    Term(TermId),
    /// Error of the measuring instrument that all its readings share.
    Instrument {
        /// Index of the instrument, in the order in which stations first name them.
        instrument: usize,
        /// Which error.
        term: InstrumentTerm,
    },
    /// Steady motion of a station on its stand, as [`Frame`](Self::Frame) displaces it: the amount per hour.
    Drift {
        /// Index of the tracker station.
        station: usize,
        /// 0..6
        component: usize,
    },
}

impl ParameterId {
    /// Examples of names, for messages.
    pub const EXAMPLES: &str = "a name such as delta_a2, delta_theta4, compliance_drive3, mass3, frame_x, target_z, linkage_rod, \
                                ratio_d5 or tracker_range_offset (docs/notation.md)";

    /// A link parameter by zero-based link index.
    pub const fn link(link: usize, term: LinkTerm) -> Self {
        Self::Link { link, term }
    }

    /// The SI unit.
    pub fn unit(self) -> Unit {
        match self {
            Self::Link { term, .. } => term.unit(),
            Self::Frame { component, .. } | Self::Drift { component, .. } if component >= 3 => Unit::Radian,
            Self::Frame { .. } | Self::Drift { .. } | Self::Target { .. } | Self::Centre { .. } => {
                Unit::Metre
            }
            Self::Orientation { .. } => Unit::Radian,
            Self::Linkage(term) => term.unit(),
            Self::Compliance(_) | Self::Mass { .. } => Unit::One,
            Self::Term(term) => term.unit(),
            Self::Instrument { term, .. } => term.unit(),
        }
    }

    /// The five parameters of every link, in table order.
    pub fn all_of_links(links: usize) -> Vec<Self> {
        (0..links).flat_map(|link| LinkTerm::ALL.map(|term| Self::Link { link, term })).collect()
    }

    /// The six components of a station's frame.
    pub fn all_of_frame(station: usize) -> Vec<Self> {
        (0..6).map(|component| Self::Frame { station, component }).collect()
    }

    /// The three components of a target's offset.
    pub fn all_of_target(target: usize) -> Vec<Self> {
        (0..3).map(|axis| Self::Target { target, axis }).collect()
    }

    /// The six components of a station's drift.
    pub fn all_of_drift(station: usize) -> Vec<Self> {
        (0..6).map(|component| Self::Drift { station, component }).collect()
    }

    /// All errors of an instrument.
    pub fn all_of_instrument(instrument: usize) -> Vec<Self> {
        InstrumentTerm::ALL.map(|term| Self::Instrument { instrument, term }).to_vec()
    }

    /// The three components of a target's orientation on the flange.
    pub fn all_of_orientation(target: usize) -> Vec<Self> {
        (0..3).map(|axis| Self::Orientation { target, axis }).collect()
    }

    /// Reads the name that `Display` prints.
    pub fn parse(name: &str) -> Option<Self> {
        let number = |text: &str| text.parse::<usize>().ok().and_then(|n| n.checked_sub(1));
        if let Some(rest) = name.strip_prefix("delta_") {
            for (prefix, term) in [
                ("alpha", LinkTerm::Alpha),
                ("beta", LinkTerm::Beta),
                ("theta", LinkTerm::Theta),
                ("a", LinkTerm::A),
                ("d", LinkTerm::D),
            ] {
                if let Some(index) = rest.strip_prefix(prefix) {
                    return number(index).map(|link| Self::Link { link, term });
                }
            }
            return None;
        }
        if let Some(term) = TermId::parse(name) {
            return Some(Self::Term(term));
        }
        if let Some(rest) = name.strip_prefix("compliance_") {
            return parse_compliance(rest).map(Self::Compliance);
        }
        if let Some(rest) = name.strip_prefix("mass") {
            return number(rest).map(|link| Self::Mass { link });
        }
        if let Some(rest) = name.strip_prefix("linkage_") {
            return LinkageTerm::ALL.into_iter().find(|term| term.name() == rest).map(Self::Linkage);
        }
        let (group, component) = name.split_once('_')?;
        if let Some(index) = group.strip_prefix("tracker") {
            let instrument = if index.is_empty() { 0 } else { number(index)? };
            return InstrumentTerm::parse(component).map(|term| Self::Instrument { instrument, term });
        }
        for (prefix, is_drift) in [("frame", false), ("drift", true)] {
            let Some(index) = group.strip_prefix(prefix) else { continue };
            let station = if index.is_empty() { 0 } else { number(index)? };
            let component = FRAME_NAMES.iter().position(|n| *n == component)?;
            return Some(if is_drift {
                Self::Drift { station, component }
            } else {
                Self::Frame { station, component }
            });
        }
        let component = FRAME_NAMES.iter().position(|n| *n == component)?;
        if let Some(index) = group.strip_prefix("centre") {
            return number(index)
                .filter(|_| component < 3)
                .map(|link| Self::Centre { link, axis: component });
        }
        let index = group.strip_prefix("target")?;
        let target = if index.is_empty() { 0 } else { number(index)? };
        Some(match component.checked_sub(3) {
            None => Self::Target { target, axis: component },
            Some(axis) => Self::Orientation { target, axis },
        })
    }
}

/// Reads what follows `compliance_`.
fn parse_compliance(name: &str) -> Option<Compliance> {
    let number = |text: &str| text.parse::<usize>().ok().and_then(|n| n.checked_sub(1));
    if name == "rod" {
        return Some(Compliance::Rod);
    }
    if let Some(joint) = name.strip_prefix("drive") {
        return number(joint).map(|joint| Compliance::Drive { joint });
    }
    if let Some(link) = name.strip_prefix("beam") {
        return number(link).map(|link| Compliance::Beam { link });
    }
    let (joint, axis) = name.strip_prefix("bearing")?.split_once('_')?;
    let axis = FRAME_NAMES.iter().position(|n| *n == axis)?;
    number(joint).map(|joint| Compliance::Bearing { joint, axis })
}

const FRAME_NAMES: [&str; 6] = ["x", "y", "z", "rx", "ry", "rz"];

fn frame_name(component: usize) -> &'static str {
    FRAME_NAMES.get(component).copied().unwrap_or("none")
}

/// By its name.
impl Serialize for ParameterId {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for ParameterId {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        Self::parse(&name)
            .ok_or_else(|| D::Error::custom(format_args!("{name:?}: expected {}", Self::EXAMPLES)))
    }
}

impl fmt::Display for ParameterId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let counted =
            |index: usize| if index == 0 { String::new() } else { index.saturating_add(1).to_string() };
        let name = match *self {
            Self::Link { link, term } => {
                let term = match term {
                    LinkTerm::A => "a",
                    LinkTerm::Alpha => "alpha",
                    LinkTerm::Beta => "beta",
                    LinkTerm::D => "d",
                    LinkTerm::Theta => "theta",
                };
                format!("delta_{term}{}", link.saturating_add(1))
            }
            Self::Frame { station, component } => {
                format!("frame{}_{}", counted(station), frame_name(component))
            }
            Self::Drift { station, component } => {
                format!("drift{}_{}", counted(station), frame_name(component))
            }
            Self::Target { target, axis } => {
                format!("target{}_{}", counted(target), frame_name(axis))
            }
            Self::Orientation { target, axis } => {
                format!("target{}_{}", counted(target), frame_name(axis.saturating_add(3)))
            }
            Self::Compliance(Compliance::Drive { joint }) => {
                format!("compliance_drive{}", joint.saturating_add(1))
            }
            Self::Compliance(Compliance::Bearing { joint, axis }) => {
                format!("compliance_bearing{}_{}", joint.saturating_add(1), frame_name(axis))
            }
            Self::Compliance(Compliance::Beam { link }) => {
                format!("compliance_beam{}", link.saturating_add(1))
            }
            Self::Compliance(Compliance::Rod) => "compliance_rod".to_owned(),
            Self::Mass { link } => format!("mass{}", link.saturating_add(1)),
            Self::Centre { link, axis } => format!("centre{}_{}", link.saturating_add(1), frame_name(axis)),
            Self::Linkage(term) => format!("linkage_{}", term.name()),
            Self::Term(term) => term.to_string(),
            Self::Instrument { instrument, term } => format!("tracker{}_{term}", counted(instrument)),
        };
        f.pad(&name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back() {
        let mut all = ParameterId::all_of_links(12);
        all.extend(ParameterId::all_of_frame(0));
        all.extend(ParameterId::all_of_frame(2));
        all.extend(ParameterId::all_of_target(0));
        all.extend(ParameterId::all_of_target(1));
        all.extend(ParameterId::all_of_orientation(0));
        all.extend(ParameterId::all_of_orientation(2));
        all.extend([
            ParameterId::Compliance(Compliance::Drive { joint: 2 }),
            ParameterId::Compliance(Compliance::Bearing { joint: 11, axis: 4 }),
            ParameterId::Compliance(Compliance::Beam { link: 4 }),
            ParameterId::Compliance(Compliance::Rod),
            ParameterId::Mass { link: 6 },
            ParameterId::Centre { link: 0, axis: 0 },
            ParameterId::Centre { link: 11, axis: 2 },
        ]);
        all.extend(LinkageTerm::ALL.map(ParameterId::Linkage));
        all.extend(ParameterId::all_of_instrument(0));
        all.extend(ParameterId::all_of_instrument(1));
        all.extend(ParameterId::all_of_drift(0));
        all.extend(ParameterId::all_of_drift(3));
        for id in all {
            assert_eq!(ParameterId::parse(&id.to_string()), Some(id), "{id}");
        }
        for wrong in [
            "delta_a0",
            "delta_x1",
            "frame_q",
            "target_r",
            "",
            "delta_",
            "beta4",
            "mass0",
            "centre_x",
            "centre2_rx",
            "linkage_x",
            "tracker_x",
            "tracker0_collimation",
            "drift_q",
            "compliance_drive",
            "compliance_bearing2_q",
        ] {
            assert_eq!(ParameterId::parse(wrong), None, "{wrong}");
        }
    }
}
