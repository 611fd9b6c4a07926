//! What is planned.

use std::fmt::Write;

use calibrig_estimation::identification::Mode;
use calibrig_estimation::planning::{Criterion, DesignFigures, Growth, Needed, OrderCost, Spread};
use calibrig_model::nalgebra::Vector3;
use calibrig_model::{JointKind, ParameterId};

/// A figure of the predicted standard deviations over a region.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Figure {
    /// Root of the mean variance.
    #[default]
    Rms,
    /// Mean.
    Mean,
    /// Value that 95 % of the poses stay below.
    Quantile95,
    /// Largest.
    Largest,
}

impl Figure {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Rms, Self::Mean, Self::Quantile95, Self::Largest];

    /// The key in files and on the command line.
    pub fn key(self) -> &'static str {
        match self {
            Self::Rms => "rms",
            Self::Mean => "mean",
            Self::Quantile95 => "q95",
            Self::Largest => "largest",
        }
    }

    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Rms => "RMS over the region",
            Self::Mean => "mean over the region",
            Self::Quantile95 => "95 % of the region stay below",
            Self::Largest => "largest in the region",
        }
    }

    /// Of a spread, m.
    pub fn of(self, spread: &Spread) -> f64 {
        match self {
            Self::Rms => spread.rms,
            Self::Mean => spread.mean,
            Self::Quantile95 => spread.quantile_95,
            Self::Largest => spread.largest,
        }
    }
}

/// A pose of the plan.
#[derive(Debug, Clone, PartialEq)]
pub struct ChosenPose {
    /// Its number: poses of a plan count from 1, those after a session continue.
    pub pose: u32,
    /// Joint variables, rad or m.
    pub joints: Vec<f64>,
    /// Command, rad or m, one number per joint.
    pub command: Vec<f64>,
    /// Sign of every joint's last motion on the way from the pose before; 0 if it has not moved yet.
    pub approach: Vec<i8>,
    /// The first target's place, in the base frame, m.
    pub target: Vector3<f64>,
}

/// Information of random poses of the region.
#[derive(Debug, Clone, PartialEq)]
pub struct AsDrawn {
    /// How many poses.
    pub poses: usize,
    /// How often they were drawn.
    pub draws: u32,
    /// The figure of every draw that determines the parameters, m, ascending.
    pub values: Vec<f64>,
    /// The same without the machine's noise, m, ascending.
    pub of_parameters: Vec<f64>,
}

impl AsDrawn {
    /// The median, m: with the machine's noise, and without.
    pub fn medians(&self) -> [f64; 2] {
        [&self.values, &self.of_parameters].map(|values| median(values))
    }
}

fn median(ascending: &[f64]) -> f64 {
    let n = ascending.len();
    match n {
        0 => f64::NAN,
        _ if n % 2 == 1 => ascending[n / 2],
        _ => 0.5 * (ascending[n / 2 - 1] + ascending[n / 2]),
    }
}

/// Costs of the order of the candidates and of the plan's order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrderChange {
    /// In the order of the candidates.
    pub before: OrderCost,
    /// In the plan's order.
    pub after: OrderCost,
}

/// Planned poses, and their information.
#[derive(Debug, Clone, PartialEq)]
pub struct PosePlan {
    /// Name of the scenario or robot.
    pub name: String,
    /// Which model is to be identified.
    pub mode: Mode,
    /// The criterion of the choice.
    pub criterion: Criterion,
    /// Which figure of the predicted standard deviations is given first.
    pub figure: Figure,
    /// Of all draws.
    pub seed: u64,
    /// Robots drawn within their tolerances for which the plan is made, in addition to the nominal one.
    pub robots: u32,
    /// Source of the candidates, in words.
    pub source: String,
    /// Candidates that were tried.
    pub looked: usize,
    /// Candidates that can be measured.
    pub candidates: usize,
    /// Why others cannot, and how many; the most frequent first.
    pub refused: Vec<(String, usize)>,
    /// The targets' places at the candidates, m.
    pub places: Vec<Vector3<f64>>,
    /// The parameters of the fit.
    pub parameters: Vec<ParameterId>,
    /// Scale of every parameter: the change that displaces the readings of the mean candidate by one standard
    /// deviation, SI.
    pub scale: Vec<f64>,
    /// The poses in their order.
    pub poses: Vec<ChosenPose>,
    /// Their information.
    pub figures: DesignFigures,
    /// Value of the criterion.
    pub value: f64,
    /// Whether no exchange of one pose improves it.
    pub settled: bool,
    /// What as many, and twice as many, random poses would determine; empty if hardly any can be drawn.
    pub random: Vec<AsDrawn>,
    /// Accuracy against number.
    pub growth: Growth,
    /// Accuracy to reach, m.
    pub accuracy: Option<f64>,
    /// How many poses that needs.
    pub needed: Option<Needed>,
    /// The order.
    pub order: OrderChange,
    /// Poses that were measured before.
    pub measured: usize,
    /// Region of the predictions, in words.
    pub region: String,
    /// The target's places there, m.
    pub region_places: Vec<Vector3<f64>>,
    /// Lowest and highest joint variables there, rad or m.
    pub region_ranges: Vec<[f64; 2]>,
    /// The trackers' places, m; empty if unknown.
    pub trackers: Vec<Vector3<f64>>,
    /// Name, kind and limits of every joint.
    pub links: Vec<(String, JointKind, [f64; 2])>,
    /// Which of them are commanded.
    pub commanded: Vec<bool>,
    /// Remarks.
    pub remarks: Vec<String>,
}

impl PosePlan {
    /// The figure of the predicted standard deviations over the region with the machine's noise, m.
    pub fn predicted(&self) -> Option<f64> {
        self.figures.accuracy.map(|accuracy| self.figure.of(&accuracy.with_machine))
    }

    /// The least determined parameters, with their standard deviations, SI: by how far these displace the readings.
    pub fn weakest(&self, most: usize) -> Vec<(ParameterId, f64)> {
        let mut all: Vec<(ParameterId, f64, f64)> = self
            .parameters
            .iter()
            .zip(&self.figures.sigmas)
            .zip(&self.scale)
            .map(|((id, sigma), scale)| (*id, *sigma, sigma / scale))
            .collect();
        all.sort_by(|a, b| b.2.total_cmp(&a.2));
        all.into_iter().take(most).map(|(id, sigma, _)| (id, sigma)).collect()
    }

    /// How many poses the accuracy needs, in words; `None` if none was asked for.
    pub fn needed_words(&self) -> Option<String> {
        let (accuracy, needed) = (self.accuracy?, self.needed?);
        Some(match needed {
            Needed::Poses { count, reached } => format!(
                "{count} poses reach {:.4} mm: {:.4} mm, {}",
                1e3 * accuracy,
                1e3 * reached,
                self.figure.words()
            ),
            other => format!("no number of poses reaches {:.4} mm: {}", 1e3 * accuracy, needed_words(&other)),
        })
    }
}

/// Why an accuracy is not reached.
pub(super) fn needed_words(needed: &Needed) -> String {
    let mm = |metres: &f64| format!("{:.4} mm", 1e3 * metres);
    match needed {
        Needed::BelowMachine { floor } => {
            format!("the machine's own random error, pose by pose, is already {}", mm(floor))
        }
        Needed::BelowCandidates { floor } => {
            format!("all candidates together, measured any number of times, end at {}", mm(floor))
        }
        Needed::MoreThan { count, reached } => {
            format!("{count} poses, the most that were tried, reach {}", mm(reached))
        }
        _ => "enough poses were found".to_owned(),
    }
}

/// The text of `plan.csv`: calibrig's own columns of a measurement file, without what is measured.
pub fn plan_csv(plan: &PosePlan) -> String {
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = write_csv(plan, &mut text);
    text
}

fn write_csv(plan: &PosePlan, text: &mut String) -> std::fmt::Result {
    let joints: Vec<usize> = (0..plan.links.len()).filter(|joint| plan.commanded[*joint]).collect();
    writeln!(text, "# calibrig plan: commands in the order in which the poses are driven")?;
    writeln!(
        text,
        "# add the measured values as further columns and give the file to calibrig identify (docs/formats.md)"
    )?;
    write!(text, "pose")?;
    for (number, joint) in joints.iter().enumerate() {
        let unit = if plan.links[*joint].1 == JointKind::Prismatic { "m" } else { "rad" };
        write!(text, ",q{}_{unit}", number + 1)?;
    }
    for number in 1..=joints.len() {
        write!(text, ",approach{number}")?;
    }
    writeln!(text)?;
    for own in &plan.poses {
        write!(text, "{}", own.pose)?;
        for joint in &joints {
            write!(text, ",{}", own.command[*joint])?;
        }
        for joint in &joints {
            write!(text, ",{}", own.approach.get(*joint).copied().unwrap_or(0))?;
        }
        writeln!(text)?;
    }
    Ok(())
}
