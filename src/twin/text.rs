//! The scenario file of a twin, written for the person who edits it.

use std::fmt::Write;

use nalgebra::Vector3;

use super::class::Figures;
use super::{Drive, Surveyed, TwinOptions, is_guess};
use calibrig_files::Robot;
use calibrig_model::{CraigLink, JointKind};
use calibrig_plant::experiment::{Place, WorkingRegion};

/// What is to be written.
pub(super) struct Written<'a> {
    pub robot: &'a Robot,
    pub named: &'a str,
    pub options: &'a TwinOptions,
    pub surveyed: &'a Surveyed,
    pub figures: &'a Figures,
    /// m, if the robot's file does not state one.
    pub target: Option<Vector3<f64>>,
    pub region: &'a WorkingRegion,
    pub extent: [Vector3<f64>; 2],
    pub place: &'a Place,
    pub nests: &'a [Vector3<f64>],
    /// `None` for a robot without masses.
    pub drives: Option<&'a [Drive]>,
    pub parameters: [usize; 2],
    pub unknown: usize,
    pub poses: [u32; 2],
    pub told: &'a [String],
}

/// Writing to a String cannot fail.
macro_rules! line {
    ($text:expr) => { $text.push('\n') };
    ($text:expr, $($format:tt)*) => {{ let _ = writeln!($text, $($format)*); }};
}

fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

/// A comment stays one line.
fn plain(text: &str) -> String {
    let plain: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    plain.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// In thousandths of a unit, as they are read, without a minus in front of a zero.
fn milli(value: f64) -> f64 {
    (1e6 * value).round() / 1e3 + 0.0
}

fn place(text: &mut String, value: &Vector3<f64>) {
    let [x, y, z] = [value.x, value.y, value.z].map(milli);
    line!(text, "x_mm = {x}\ny_mm = {y}\nz_mm = {z}");
}

fn headline(text: &mut String, what: &str) {
    let rule = "-".repeat(130_usize.saturating_sub(what.len()));
    line!(text, "\n# --- {what} {rule}");
}

impl Written<'_> {
    pub fn text(&self) -> String {
        let mut text = String::new();
        self.head(&mut text);
        self.machine(&mut text);
        self.effects(&mut text);
        self.poses(&mut text);
        self.tracker(&mut text);
        self.session(&mut text);
        self.identification(&mut text);
        text
    }

    /// The joints that take commands, with their places in the chain.
    fn commanded(&self) -> impl Iterator<Item = (usize, &CraigLink)> {
        let model = &self.robot.model;
        model.kinematics.links.iter().enumerate().filter(|(joint, _)| model.actuators.is_commanded(*joint))
    }

    fn head(&self, text: &mut String) {
        let Surveyed { class, reach, mass, .. } = self.surveyed;
        let name = plain(&self.robot.name);
        line!(
            text,
            "# The simulated twin of {name}, made by `calibrig scenario new` from only the robot's file."
        );
        line!(
            text,
            "# What that file does not state is assumed, each with its reason: change what you know better. docs/formats.md \
             has every key."
        );
        line!(text, "#");
        let moving =
            mass.map_or("its masses are unknown".to_owned(), |mass| format!("it moves {mass:.0} kg"));
        let chosen = if self.options.class.is_some() { "as asked for (--class)" } else { "by size" };
        line!(
            text,
            "# Size class \"{class}\", {chosen}: one that {}. This one reaches {reach:.2} m from its first joint; {moving}.",
            class.rule()
        );
        for told in self.told {
            line!(text, "# Note: {}.", plain(told));
        }
        line!(text, "schema = \"calibrig.scenario/1\"");
        line!(text, "name = {}", quoted(&format!("{name} twin")));
        line!(text, "seed = {}", self.options.seed);
        line!(text, "robot = {}", quoted(self.named));
        if self.surveyed.turned {
            match self.options.mounting {
                Some(_) => line!(
                    text,
                    "\n# As mounted (--mounting), in place of what the robot's file says. m/s² in the base frame."
                ),
                None => line!(
                    text,
                    "\n# The robot's file does not state gravity: the base is assumed to stand upright. m/s² in the base frame."
                ),
            }
            let [x, y, z] = [0, 1, 2].map(|axis| self.surveyed.gravity[axis] + 0.0);
            line!(text, "[gravity]\nx_m_per_s2 = {x:?}\ny_m_per_s2 = {y:?}\nz_m_per_s2 = {z:?}");
        }
        if let Some(target) = &self.target {
            line!(
                text,
                "\n# Where the reflector is in the flange frame. The robot's file does not state exactly one target: assumed, \
                 on a bracket that sets it off the last axis, so that"
            );
            line!(
                text,
                "# turning about that axis is visible. In the frame of the flange, whichever way its axes point."
            );
            line!(text, "[target]");
            place(text, target);
        }
    }

    fn machine(&self, text: &mut String) {
        let figures = self.figures;
        headline(text, "The machine as built: what identification must find");
        line!(
            text,
            "# Every trial draws its own machine. Sizes are standard deviations of every link parameter."
        );
        line!(text, "# {}", figures.errors_why);
        let Some(drives) = self.drives else {
            line!(text, "#");
            line!(
                text,
                "# The robot's file gives no masses (with stiffnesses and [gravity]), so that nothing deflects: the sag of \
                 the real robot"
            );
            line!(
                text,
                "# is missing here. State [joint.body] and stiffness_nm_per_rad in it, or make it from a URDF with inertials \
                 (`calibrig model from-urdf`)."
            );
            line!(text, "[as_built]\ndrives = \"rigid\"");
            self.drawn(text, None);
            return;
        };
        line!(text, "[as_built]\ndrives = \"elastic\"");
        if is_guess(self.robot) {
            line!(
                text,
                "\n# The robot's file marks its stiffnesses as guesses. The machine has those of its class, as factors of the \
                 guesses, if gravity loads the drive."
            );
            line!(text, "# {}", figures.stiffness_why);
            for (link, drive) in self.robot.model.kinematics.links.iter().zip(drives) {
                let Some(factor) = drive.factor else { continue };
                let (unit, load) = match link.kind {
                    JointKind::Prismatic => ("N/m", "N"),
                    JointKind::Revolute => ("N m/rad", "N m"),
                };
                line!(text, "[[as_built.joint]]\njoint = {}", quoted(&link.name));
                line!(
                    text,
                    "stiffness_factor = {factor} # {:.1e} {unit}; gravity loads it with up to {:.0} {load}, which is {:.2} mrad (mm)",
                    drive.stiffness,
                    drive.torque,
                    1e3 * drive.torque / drive.stiffness
                );
            }
            line!(text, "# The drives of this machine differ from those figures by some 20 %.");
            self.drawn(text, Some(0.2));
        } else {
            let sigma = self.robot.compliance_sigma.unwrap_or(0.1).min(0.2);
            line!(
                text,
                "# Compliances differ from the predicted ones as the robot's file states, else by some 10 %."
            );
            self.drawn(text, Some(sigma));
        }
    }

    fn drawn(&self, text: &mut String, compliance: Option<f64>) {
        line!(text, "[as_built.drawn]\ndistribution = \"normal\"\nparameters = \"all\"");
        line!(text, "lengths_mm = {}\nangles_mrad = {}", self.figures.lengths, self.figures.angles);
        line!(
            text,
            "target_mm = 0.5        # a bracket as drawn; its measured offset is within target_sigma_um"
        );
        if let Some(fraction) = compliance {
            line!(text, "compliance_fraction = {fraction}");
            line!(text, "mass_fraction = 0.02   # a mass from a drawing is rarely better");
            line!(text, "base_tilt_mrad = 0.5   # levelled within half a millimetre per metre");
        }
        if self.robot.model.actuators.four_bar().is_some() {
            line!(
                text,
                "linkage_mm = 0.3       # bars differ from their drawings by some tenths of a millimetre"
            );
            line!(text, "linkage_angles_mrad = 0.5");
            let [shift, tilt] = self.figures.crank_axis;
            line!(text, "# The crank's axis relative to the shoulder's. {}", self.figures.crank_axis_why);
            line!(text, "crank_axis_mm = {shift}\ncrank_tilts_mrad = {tilt}");
        }
    }

    fn effects(&self, text: &mut String) {
        let figures = self.figures;
        headline(text, "Errors that no table of link parameters holds");
        line!(
            text,
            "# Sizes of the class, not of this robot. `calibrig run FILE --ablate` shows what each contributes; enabled = false switches a section off."
        );
        line!(text, "\n# {}", figures.harmonics_why);
        for (index, link) in self.commanded() {
            line!(text, "[[effects.harmonics.joint]]\njoint = {}", quoted(&link.name));
            let known = self.robot.model.motor_turns.get(index).copied().flatten().is_some();
            // Spread, so that joints do not have equal errors.
            let phases = [(70 * index + 20) % 360, (130 * index + 50) % 360];
            match link.kind {
                JointKind::Revolute => {
                    if !known {
                        line!(text, "motor_turns_per_rev = {} # assumed", figures.turns_per_rev);
                    }
                    line!(text, "once_arcsec = {}\nonce_phase_deg = {}", figures.harmonics[0], phases[0]);
                    line!(text, "twice_arcsec = {}\ntwice_phase_deg = {}", figures.harmonics[1], phases[1]);
                }
                JointKind::Prismatic => {
                    if !known {
                        line!(text, "motor_turns_per_m = {} # assumed", figures.turns_per_m);
                    }
                    line!(text, "once_um = {}\nonce_phase_deg = {}", figures.slide_harmonics[0], phases[0]);
                    line!(text, "twice_um = {}\ntwice_phase_deg = {}", figures.slide_harmonics[1], phases[1]);
                }
            }
        }
        let of_kind = |kind| self.commanded().filter(move |(_, link)| link.kind == kind);
        if of_kind(JointKind::Prismatic).next().is_some() {
            line!(text, "\n# Racks and spindles: the error of their pitch.");
            for (_, link) in of_kind(JointKind::Prismatic) {
                line!(text, "[[effects.ratio.joint]]\njoint = {}", quoted(&link.name));
                line!(text, "relative_ppm = {}", figures.slide_ppm);
            }
        }
        self.per_joint(text, "backlash", "gap", figures.backlash_why, figures.backlash);
        self.thermal(text);
        self.per_joint(text, "repeatability", "sigma", figures.repeatability_why, figures.repeatability);
    }

    fn per_joint(&self, text: &mut String, section: &str, key: &str, why: &str, sizes: [f64; 2]) {
        line!(text, "\n# {why}");
        for (_, link) in self.commanded() {
            line!(text, "[[effects.{section}.joint]]\njoint = {}", quoted(&link.name));
            match link.kind {
                JointKind::Revolute => line!(text, "{key}_arcsec = {}", sizes[0]),
                JointKind::Prismatic => line!(text, "{key}_um = {}", sizes[1]),
            }
        }
    }

    /// The links that are longer than a tenth of the reach, along x to the next joint and along z.
    fn thermal(&self, text: &mut String) {
        let links = &self.robot.model.kinematics.links;
        let mut parts = Vec::new();
        for (index, link) in links.iter().enumerate() {
            let next = links.get(index + 1).map_or(0.0, |next| next.a);
            parts.extend([("x", next), ("z", link.d)].map(|(axis, length)| (link, axis, length)));
        }
        parts.retain(|(_, _, length)| length.abs() > 0.1 * self.surveyed.reach);
        if parts.is_empty() {
            return;
        }
        line!(
            text,
            "\n# A hall that warms by a degree an hour, and swings a little with its heating. {}",
            self.figures.thermal_why
        );
        line!(
            text,
            "[effects.thermal]\nreference_c = 20\nstart_c = 20\ndrift_c_per_h = 1\nswing_c = 0.3\nswing_period_s = 1800"
        );
        for (link, axis, length) in parts {
            line!(text, "[[effects.thermal.link]]\njoint = {}", quoted(&link.name));
            line!(text, "axis = \"{axis}\"\nlength_mm = {}", milli(length));
            line!(text, "expansion_ppm_per_k = {}\nlag_s = {}", self.figures.expansion, self.figures.lag);
        }
    }

    fn poses(&self, text: &mut String) {
        headline(text, "Poses");
        let [selected, rank] = self.parameters;
        line!(
            text,
            "# {selected} link parameters can be identified ({rank} of them at these poses); with the drives that gravity \
             loads there are {} unknowns. Two poses for each, six readings,",
            self.unknown
        );
        line!(
            text,
            "# leave enough to estimate the machine's own noise; more where some are hidden. Half as many, never fitted, verify."
        );
        line!(text, "[poses]\nidentification = {}\nverification = {}", self.poses[0], self.poses[1]);
        line!(text);
        line!(
            text,
            "# Drawn uniformly in this box of joint variables: the largest found in which none of 2000 poses touches floor or \
             robot, and that the tracker"
        );
        line!(
            text,
            "# sees, within 98 % of the limits and at most 170 deg either way. Links were taken as capsules; cables and the \
             surroundings are unknown: check it."
        );
        let [low, high] = self.extent.map(|corner| corner.map(|value| milli(value).round()));
        line!(
            text,
            "# The target goes from ({}, {}, {}) to ({}, {}, {}) mm in the base frame.",
            low.x,
            low.y,
            low.z,
            high.x,
            high.y,
            high.z
        );
        let model = &self.robot.model;
        let links = model.kinematics.links.iter().enumerate();
        for (joint, link) in links.filter(|(joint, _)| model.actuators.is_commanded(*joint)) {
            let (centre, half) = (self.region.centre[joint], self.region.half_width[joint]);
            line!(text, "[[poses.region]]\njoint = {}", quoted(&link.name));
            match link.kind {
                JointKind::Prismatic => {
                    line!(text, "centre_mm = {}\nhalf_width_mm = {}", milli(centre), milli(half));
                }
                JointKind::Revolute => {
                    let range = [centre - half, centre + half].map(|q| q.to_degrees().round() + 0.0);
                    line!(text, "centre_rad = {} # {} to {} deg", milli(centre) / 1e3, range[0], range[1]);
                    line!(text, "half_width_rad = {}", milli(half) / 1e3);
                }
            }
        }
    }

    fn tracker(&self, text: &mut String) {
        let Place { position, yaw, seen, range } = self.place;
        headline(text, "The tracker");
        line!(
            text,
            "# Of all places around the robot that were tried, this one sees most: {:.0} % of the poses, at {range:.1} m on \
             average; out of the robot's reach, within 45 deg of level.",
            100.0 * seen
        );
        line!(text, "[tracker]\npreset = \"{}\"", self.options.preset.key());
        place(text, position);
        line!(text, "yaw_deg = {}", yaw.to_degrees().round() + 0.0);
        line!(text, "nest_sigma_um = 10     # certified places on the base (assumed)");
        line!(text, "target_sigma_um = 10   # the bracket on a coordinate measuring machine (assumed)");
        line!(
            text,
            "\n# Nests around the base that the tracker sees past the robot; they may be anywhere that does not move."
        );
        for (index, nest) in self.nests.iter().enumerate() {
            line!(text, "[[tracker.nest]]\nname = \"N{}\"", index + 1);
            place(text, nest);
        }
        line!(
            text,
            "\n# A hall, all assumed: its sensors of temperature and pressure are off by some tenths, and it is warmer upwards."
        );
        line!(text, "[tracker.environment]\ntemperature_c = 20\npressure_hpa = 1010\nhumidity_percent = 45");
        line!(
            text,
            "temperature_sigma_k = 0.3\npressure_sigma_hpa = 1\nhumidity_sigma_percent = 5\ngradient_k_per_m = 0.3"
        );
        line!(text, "\n# Reflectors and nests as makers state them.");
        line!(text, "[tracker.smr]\ncentring_um = 3\nseat_um = 4\nacceptance_deg = 30");
        line!(
            text,
            "\n# The stand: nests of a public data set moved by some 50 um in a session. It is warm but for the last few um."
        );
        line!(text, "[tracker.drift]\nwarm_up_um = [2, 8]\nwarm_up_time_s = 1200\nwalk_um_per_root_h = 30");
    }

    fn session(&self, text: &mut String) {
        headline(text, "The session");
        line!(text, "[session]\norder = \"short_travel\"\nmotion_s = 8\nsettling_s = 1\naveraging_s = 1");
        line!(text, "\n[session.nests]\nevery_poses = 20\nafter = true");
        line!(
            text,
            "\n# The reflector is turned to the tracker at every pose, like one that follows the beam. A fixed one accepts a \
             cone of 30 deg: state"
        );
        line!(
            text,
            "# session.opening = [x, y, z] in the flange frame for it, and see with `calibrig run` how many poses are left."
        );
        line!(text, "[session.line_of_sight]");
        match self.surveyed.radius {
            None => line!(text, "links = \"shapes\""),
            Some(radius) => {
                line!(text, "links = \"capsules\"");
                line!(
                    text,
                    "capsule_radius_mm = {} # the robot's file has no shapes: assumed",
                    milli(radius)
                );
            }
        }
        line!(text, "floor_mm = {}", milli(self.surveyed.floor));
    }

    fn identification(&self, text: &mut String) {
        headline(text, "Identification");
        line!(
            text,
            "# What would be done with measurements of the real robot. The priors of the link parameters are the sizes above."
        );
        let modes: &[&str] = match self.drives {
            None => &["without_calibration", "only_calibration"],
            Some(_) if is_guess(self.robot) => {
                &["without_calibration", "only_calibration", "elasto_geometric"]
            }
            Some(_) => &["without_calibration", "only_calibration", "with_gravity", "elasto_geometric"],
        };
        line!(text, "# \"extended\" would add terms for backlash, transmission and pitch.");
        line!(
            text,
            "[identification]\nmodes = [{}]",
            modes.iter().map(|mode| quoted(mode)).collect::<Vec<_>>().join(", ")
        );
        line!(text, "parameters = \"complete\"");
        line!(text, "tolerance_mm = {}\ntolerance_mrad = {}", self.figures.lengths, self.figures.angles);
        line!(
            text,
            "frame = \"nests\"\ntarget = \"measured\"\nmachine_noise = \"estimated\" # the machine's own random errors, pose \
             by pose"
        );
    }
}
