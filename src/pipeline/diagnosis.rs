//! A diagnosis in words, with the remedies.

use calibrig_estimation::diagnosis::{Diagnosis, FarOff, Hypothesis, Part, Undetermined};
use calibrig_model::measurement::{MeasurementSet, Reading};
use calibrig_model::{CalibrationModel, CraigLink, JointKind};

/// Rows that are listed by name; more are counted.
const LISTED: usize = 8;

/// Names of joints, observations and targets of a session.
#[derive(Debug, Clone, PartialEq)]
pub struct Names {
    links: Vec<CraigLink>,
    /// How far a joint moves with its own command, if that moves no other one.
    alone: Vec<Option<f64>>,
    /// Name of observations: rows if they are numbered consecutively, else poses.
    called: &'static str,
    /// Number of every observation's pose.
    poses: Vec<u32>,
    targets: Vec<String>,
    /// Largest span of a revolute joint's commands, rad.
    span: f64,
    is_spherical: bool,
}

impl Names {
    /// Those of `set`, measured on the robot of `model`.
    pub fn new(model: &CalibrationModel, set: &MeasurementSet) -> Self {
        let observations = &set.observations;
        let are_rows = observations.iter().zip(1..).all(|(observation, row)| observation.pose == row);
        let links = model.kinematics.links.clone();
        let span = |(joint, _): (usize, &CraigLink)| {
            let commands = observations.iter().filter_map(|o| o.command.get(joint));
            let ends = commands.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (v.min(l), v.max(h)));
            ends.1 - ends.0
        };
        let revolute = links.iter().enumerate().filter(|(_, link)| link.kind == JointKind::Revolute);
        let joints = links.len();
        Self {
            alone: (0..joints).map(|joint| moved_alone(model, joint)).collect(),
            span: revolute.map(span).fold(0.0, f64::max),
            called: if are_rows { "row" } else { "pose" },
            poses: observations.iter().map(|observation| observation.pose).collect(),
            targets: set.targets.iter().map(|target| target.name.clone()).collect(),
            is_spherical: observations.iter().any(|o| matches!(o.reading, Reading::Spherical(_))),
            links,
        }
    }

    fn joint(&self, joint: usize) -> &str {
        &self.links[joint].name
    }

    /// Number of an observation as the file has it.
    pub fn row(&self, observation: usize) -> u32 {
        self.poses.get(observation).copied().unwrap_or_default()
    }

    fn joints(&self, joints: &[usize]) -> String {
        joints.iter().map(|joint| self.joint(*joint)).collect::<Vec<_>>().join(", ")
    }

    fn rows(&self, rows: &[usize]) -> String {
        let mut rows: Vec<u32> = rows.iter().map(|row| self.row(*row)).collect();
        rows.sort_unstable();
        let named: Vec<_> = rows.iter().take(LISTED).map(u32::to_string).collect();
        let more =
            if rows.len() > LISTED { format!(" and {} more", rows.len() - LISTED) } else { String::new() };
        let plural = if rows.len() == 1 { "" } else { "s" };
        format!("{}{plural} {}{more}", self.called, and(&named, more.is_empty()))
    }

    /// All rows, as a flag takes them.
    fn listed(&self, rows: &[usize]) -> String {
        let mut rows: Vec<u32> = rows.iter().map(|row| self.row(*row)).collect();
        rows.sort_unstable();
        rows.dedup();
        rows.iter().map(u32::to_string).collect::<Vec<_>>().join(",")
    }

    /// Rows with their distances.
    pub fn far(&self, rows: &[FarOff]) -> String {
        let words =
            |far: &FarOff| format!("{} {} by {}", self.called, self.row(far.observation), mm(far.distance));
        let mut list: Vec<_> = rows.iter().take(LISTED).map(words).collect();
        if rows.len() > LISTED {
            list.push(format!("{} more", rows.len() - LISTED));
        }
        list.join(", ")
    }

    /// Joints and rows of a hypothesis, by name and number.
    pub fn places(&self, part: &Part) -> (Vec<String>, Vec<u32>) {
        let joints = part.joints().iter().map(|joint| self.joint(*joint).to_owned()).collect();
        let mut rows: Vec<u32> = part.rows().iter().map(|row| self.row(*row)).collect();
        rows.sort_unstable();
        (joints, rows)
    }

    /// A hypothesis in words.
    pub fn says(&self, hypothesis: &Hypothesis) -> String {
        if hypothesis.parts.is_empty() {
            return "as it was read".to_owned();
        }
        hypothesis.parts.iter().map(|part| self.part(part)).collect::<Vec<_>>().join("; and ")
    }

    /// The remedy of a hypothesis: columns that several parts concern are stated once, with all changes.
    pub fn remedies(&self, hypothesis: &Hypothesis) -> String {
        let is_of_columns = |part: &&Part| match part {
            Part::Sign { .. } | Part::Order { .. } | Part::Offset { .. } => true,
            Part::Coupling { of_joint, .. } => !of_joint,
            _ => false,
        };
        let (columns, others): (Vec<&Part>, Vec<&Part>) = hypothesis.parts.iter().partition(is_of_columns);
        let mut remedies: Vec<String> = Vec::new();
        match columns.as_slice() {
            [] => {}
            [one] => remedies.push(self.remedy(one)),
            several => remedies.extend(self.columns(several)),
        }
        // In the order of the parts, if nothing is combined.
        if remedies.len() <= 1 && columns.len() <= 1 {
            return hypothesis.parts.iter().map(|part| self.remedy(part)).collect::<Vec<_>>().join("; ");
        }
        remedies.extend(others.into_iter().map(|part| self.remedy(part)));
        remedies.join("; ")
    }

    /// Several parts that concern columns, one after the other: the resulting columns, and the offsets of zeros with them.
    fn columns(&self, parts: &[&Part]) -> Vec<String> {
        let n = self.links.len();
        let mut entries: Vec<Vec<f64>> =
            (0..n).map(|i| (0..n).map(|j| f64::from(u8::from(i == j))).collect()).collect();
        let mut quarters = vec![0.0; n];
        for part in Part::in_order(parts) {
            match part {
                Part::Sign { joint } => {
                    entries[*joint].iter_mut().for_each(|share| *share = -*share);
                    quarters[*joint] = -quarters[*joint];
                }
                Part::Offset { joint, quarters: by } => quarters[*joint] += f64::from(*by),
                Part::Coupling { joint, with, share, .. } => {
                    let (row, by) = (entries[*with].clone(), quarters[*with]);
                    entries[*joint].iter_mut().zip(row).for_each(|(own, other)| *own += share * other);
                    quarters[*joint] += share * by;
                }
                Part::Order { from, .. } => {
                    entries = from.iter().map(|column| entries[*column].clone()).collect();
                    quarters = from.iter().map(|column| quarters[*column]).collect();
                }
                _ => {}
            }
        }
        let is_own = |(i, row): (usize, &Vec<f64>)| {
            row.iter().enumerate().all(|(j, v)| *v == f64::from(u8::from(i == j)))
        };
        let mut remedies = Vec::new();
        if !entries.iter().enumerate().all(is_own) {
            let entries: Vec<String> = entries.iter().map(|row| format!("\"{}\"", self.entry(row))).collect();
            remedies.push(format!(
                "`columns = [{}]` in [joints] of the column map, in the file's own names",
                entries.join(", ")
            ));
        }
        remedies.extend(
            (0..n).filter(|joint| quarters[*joint] != 0.0).map(|joint| self.zero(joint, quarters[joint])),
        );
        remedies
    }

    /// A sum of columns, as a column map has it.
    fn entry(&self, shares: &[f64]) -> String {
        let mut text = String::new();
        for (joint, share) in shares.iter().enumerate() {
            // Shares are whole numbers: a term is repeated accordingly.
            let mut left = share.abs();
            while left > 0.5 {
                left -= 1.0;
                text += match (text.is_empty(), *share < 0.0) {
                    (true, true) => "-",
                    (true, false) => "",
                    (false, true) => " - ",
                    (false, false) => " + ",
                };
                text += self.joint(joint);
            }
        }
        text
    }

    /// What moves a joint's zero by quarters of a turn of its command.
    fn zero(&self, joint: usize, quarters: f64) -> String {
        let name = self.joint(joint);
        match self.alone[joint] {
            Some(rate) => {
                let by = 90.0 * rate * quarters;
                let change = if by < 0.0 { "lower" } else { "raise" };
                format!("{change} `theta_deg` of {name} in the robot's file by {}", by.abs().round())
            }
            None => {
                let change = if quarters > 0.0 { "lower" } else { "raise" };
                format!(
                    "{change} `offset_deg` in [joint.shown] of {name} in the robot's file (0 where it is not stated) by {}",
                    90.0 * quarters.abs()
                )
            }
        }
    }

    /// A part in words.
    pub fn part(&self, part: &Part) -> String {
        match part {
            Part::AngleUnit { joints, factor } => {
                let (unit, span) = if *factor > 1.0 {
                    ("radians", format!("{:.1} deg at most", self.span.to_degrees()))
                } else {
                    ("degrees", format!("up to {:.1} rad", self.span))
                };
                if joints.len() > 1 {
                    format!("the joints' angles span {span}: read as {unit}")
                } else {
                    format!("the angles of {} read as {unit}", self.joints(joints))
                }
            }
            Part::TravelUnit { joints, factor } => {
                format!("the travel of {} times {}", self.joints(joints), number(*factor))
            }
            Part::PointUnit { factor } => format!("the points times {}", number(*factor)),
            Part::TrackerAngleUnit { factor, .. } => {
                let unit = if *factor > 1.0 { "radians" } else { "degrees" };
                format!("the tracker's angles read as {unit}")
            }
            Part::Sign { joint } => format!("{} with the other sign", self.joint(*joint)),
            Part::Offset { joint, quarters } => {
                let sign = if *quarters < 0 { '-' } else { '+' };
                format!("{} {sign} {} deg", self.joint(*joint), 90 * i32::from(quarters.unsigned_abs()))
            }
            Part::Order { .. } => {
                let joints = part.joints();
                if joints.len() == 2 {
                    format!("the columns of {} and {} exchanged", self.joint(joints[0]), self.joint(joints[1]))
                } else {
                    format!("the columns of {} in another order: {}", self.joints(&joints), self.order(part))
                }
            }
            Part::Coupling { joint, with, share, .. } => {
                let sign = if *share < 0.0 { '-' } else { '+' };
                let (joint, with) = (self.joint(*joint), self.joint(*with));
                format!("{joint} is driven with {with}: its angle is {joint} {sign} {with}")
            }
            Part::Convention { standard: true } => "the table read in the standard D-H convention".to_owned(),
            Part::Convention { .. } => "the table read in Craig's convention".to_owned(),
            Part::ToolLink { joint } => {
                format!("the target moves with {}, not with the joints after it", self.joint(*joint))
            }
            Part::ShiftedRows { by } => {
                let (rows, side) =
                    (if by.abs() == 1 { "one row".to_owned() } else { format!("{} rows", by.abs()) }, if *by > 0 { "lower" } else { "higher" });
                format!("the points are {rows} {side} their joints")
            }
            Part::ZenithElevation { .. } => "the angle from the zenith was read as an elevation, or the other way round".to_owned(),
            Part::AnglesExchanged { .. } => "azimuth and elevation exchanged".to_owned(),
            Part::Mirrored if self.is_spherical => {
                "the points are a mirror image: counting the azimuth the other way fits, as does exchanging x and y".to_owned()
            }
            Part::Mirrored => "the points are a mirror image: exchanging x and y fits".to_owned(),
            Part::ExchangedRows { cycles } => {
                let words = |cycle: &Vec<usize>| {
                    let rows = self.rows(cycle);
                    if cycle.len() == 2 { format!("{rows} have each other's points") } else { format!("{rows} have each \
                                                                                                       other's points, in turn") }
                };
                cycles.iter().map(words).collect::<Vec<_>>().join("; ") + ": they are exchanged"
            }
            Part::GrossErrors { rows } => format!("{} off", self.far(rows)),
            Part::MissedShots { rows } => {
                format!("no point that the robot could reach, by the distance from the middle of the others: {} (a code for \
                         missed shots?)", self.far(rows))
            }
            Part::SeveralTargets { target, others } => format!(
                "the points of {} are those of {} targets at different offsets: {} of another one",
                named("target", self.targets.get(*target).map_or("", String::as_str)),
                others.len() + 1,
                others.iter().map(|rows| self.rows(rows)).collect::<Vec<_>>().join(", and ")
            ),
            _ => format!("read otherwise ({})", part.kind()),
        }
    }

    /// The columns in the order that a part asks for.
    fn order(&self, part: &Part) -> String {
        let Part::Order { from, .. } = part else { return String::new() };
        from.iter().map(|column| self.joint(*column)).collect::<Vec<_>>().join(", ")
    }

    /// The remedy of a part.
    pub fn remedy(&self, part: &Part) -> String {
        match part {
            Part::AngleUnit { joints, factor } => {
                let unit = if *factor > 1.0 { "rad" } else { "deg" };
                if joints.len() > 1 {
                    format!("`revolute_unit = \"{unit}\"` in [joints] of the column map (`calibrig columns suggest` writes one)")
                } else {
                    format!("the unit of the column of {} is {unit}: convert it, or state the unit in the column map", self.joints(joints))
                }
            }
            Part::TravelUnit { factor, .. } => {
                format!("a `prismatic_unit` in [joints] of the column map that is {} times as large", number(*factor))
            }
            Part::PointUnit { factor } => format!(
                "a {} in [position] of the column map that is {} times as large",
                if self.is_spherical { "`range_unit`" } else { "`unit`" },
                number(*factor)
            ),
            Part::TrackerAngleUnit { factor, .. } => {
                let unit = if *factor > 1.0 { "rad" } else { "deg" };
                format!("`angle_unit = \"{unit}\"` in [position] of the column map")
            }
            Part::Sign { joint } => {
                let joint = self.joint(*joint);
                format!("a minus in front of the column of {joint} in `columns` of the column map, as \"-{joint}\", or remove \
                         the one that is there; or `shown = {{ sign = -1 }}` of {joint} in the robot's file")
            }
            Part::Offset { joint, quarters } => {
                self.zero(*joint, f64::from(*quarters))
            }
            Part::Order { from, .. } => {
                let names: Vec<_> = from.iter().map(|column| format!("\"{}\"", self.joint(*column))).collect();
                format!("`columns = [{}]` in [joints] of the column map, in the file's own names", names.join(", "))
            }
            Part::Coupling { joint, with, share, of_joint: true } => {
                let (joint, with) = (self.joint(*joint), self.joint(*with));
                let by = if *share < 0.0 { "1 more" } else { "1 less" };
                format!("`coupling` in [joint.shown] of {joint} in the robot's file: of {with} {by} (0 where it is not stated)")
            }
            Part::Coupling { joint, with, share, .. } => {
                let sign = if *share < 0.0 { '-' } else { '+' };
                let (joint, with) = (self.joint(*joint), self.joint(*with));
                format!("\"{joint} {sign} {with}\" in the place of {joint} in `columns` of the column map; or `shown.coupling` of {joint} in the robot's file")
            }
            Part::Convention { standard } => {
                format!("`convention = \"{}\"` in the robot's file", if *standard { "standard" } else { "craig" })
            }
            Part::ToolLink { joint } => format!(
                "a robot's file that ends with [[joint]] {}, and a column map without the columns of the joints after it",
                self.joint(*joint)
            ),
            Part::ShiftedRows { by } => format!("--shift-points {by}"),
            Part::ZenithElevation { .. } => {
                "`zenith` in the place of `elevation` in [position] of the column map, or `elevation` in that of `zenith`".to_owned()
            }
            Part::AnglesExchanged { .. } => "exchange the columns of azimuth and elevation in [position] of the column map".to_owned(),
            Part::Mirrored if self.is_spherical => {
                "a minus in front of the column of the azimuth, or of the elevation, in [position] of the column map".to_owned()
            }
            Part::Mirrored => {
                "exchange the columns of x and y in [position] of the column map, or reverse the sign of one axis, as in `z = \
                 [\"-Z\"]`; for a file of angles, a minus in front of the column of the azimuth".to_owned()
            }
            Part::ExchangedRows { .. } => format!(
                "exchange their points in the file, or --leave-out {}",
                self.listed(&part.rows())
            ),
            Part::GrossErrors { .. } => {
                format!("--leave-out {}, or `--loss tukey`, which gives them no weight", self.listed(&part.rows()))
            }
            Part::MissedShots { .. } => format!("--leave-out {}, or state the code of a missed shot in the column map", self.listed(&part.rows())),
            Part::SeveralTargets { .. } => {
                "name them in a column, and state that column as `target` in [columns] of the column map".to_owned()
            }
            _ => "check how the file is read".to_owned(),
        }
    }

    /// What cannot be determined, and why.
    pub fn undetermined(&self, what: &Undetermined) -> String {
        match what {
            Undetermined::NeverMoved { joints } => format!(
                "{} never moved: sign, unit, order and zero of {} cannot be determined, nor errors of the links",
                self.joints(joints),
                if joints.len() == 1 { "it" } else { "these" }
            ),
            Undetermined::FewPoses { distinct, needed } => format!(
                "{} fewer than {needed}: tracker and target alone explain nearly all measurements, so no convention can be \
                 checked",
                if *distinct == 1 { "all poses are the same one:".to_owned() } else { format!("{distinct} different poses:") }
            ),
            Undetermined::EqualPoses { poses, observations } => format!(
                "{poses} {} measured more than once ({observations} readings): repeats show the repeatability, not the robot",
                if *poses == 1 { "pose was" } else { "poses were" }
            ),
            Undetermined::Line => {
                "all points are on one line: neither the tracker's turn about it nor anything across it can be determined".to_owned()
            }
            Undetermined::Plane => {
                "all points are in one plane: neither a mirror image nor anything along its normal can be determined".to_owned()
            }
            Undetermined::Sphere { radius } => format!(
                "all points are on one sphere of radius {}: neither what is in front of its centre nor the tracker's place \
                 relative to the base can be determined",
                mm(*radius)
            ),
            _ => "something that the session does not show".to_owned(),
        }
    }
}

/// How far a joint moves with its own command, if that moves no other one.
fn moved_alone(model: &CalibrationModel, joint: usize) -> Option<f64> {
    let joints = model.kinematics.links.len();
    let (mut command, mut before, mut after) = (vec![0.0; joints], vec![0.0; joints], vec![0.0; joints]);
    model.actuators.joints_from_command(&command, &mut before);
    command[joint] = 1.0;
    model.actuators.joints_from_command(&command, &mut after);
    let moved = |other: usize| after[other] - before[other];
    (0..joints).all(|other| other == joint || moved(other).abs() < 1e-12).then(|| moved(joint))
}

impl Names {
    /// The hypotheses that explain the points as well as the first, and are as simple: none for a sound session.
    pub fn as_good(diagnosis: &Diagnosis) -> impl Iterator<Item = &Hypothesis> {
        let first = diagnosis.hypotheses.first();
        let is_as_good = move |other: &&Hypothesis| {
            first.is_some_and(|first| other.class == first.class && other.parts.len() <= first.parts.len())
        };
        diagnosis.hypotheses.iter().skip(1).filter(is_as_good)
    }
}

/// `a, b and c`.
fn and(words: &[String], is_all: bool) -> String {
    match words.split_last() {
        Some((last, rest)) if is_all && !rest.is_empty() => format!("{} and {last}", rest.join(", ")),
        _ => words.join(", "),
    }
}

/// A name without its kind.
fn named(what: &str, name: &str) -> String {
    if name.starts_with(what) { name.to_owned() } else { format!("{what} {name}") }
}

fn number(factor: f64) -> String {
    if factor >= 1.0 { format!("{factor}") } else { format!("1/{}", (1.0 / factor * 1e6).round() / 1e6) }
}

/// A length in mm.
pub fn mm(metres: f64) -> String {
    let value = 1e3 * metres;
    let digits = if value < 10.0 { 3 } else { 0 };
    format!("{value:.digits$} mm")
}
