//! What sweeps of single axes show: circle point analysis.

use std::fmt::Write;

use maud::{Markup, html};
use serde::{Deserialize, Serialize};

use super::words::counted;
use crate::pipeline::{Outcome, swept_stations};
use calibrig_estimation::circle_points::{SweptAxis, SweptStation};
use calibrig_model::JointKind;
use calibrig_model::nalgebra::Vector3;

/// A station that read sweeps of two axes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonSweeps {
    /// Name of the station.
    pub station: String,
    /// The two axes that place it.
    pub axes: Vec<JsonSweptAxis>,
    /// Angle between them, rad.
    pub angle_rad: f64,
    /// Its standard deviation, rad.
    pub angle_sigma_rad: f64,
    /// Of the nominal robot, rad.
    pub nominal_angle_rad: f64,
    /// Distance between them where both turn, m.
    pub distance_m: Option<f64>,
    /// Its standard deviation, m.
    pub distance_sigma_m: Option<f64>,
    /// Of the nominal robot, m.
    pub nominal_distance_m: Option<f64>,
    /// Where the tracker stands in the base if the axes are where the nominal robot has them, m.
    #[serde(default)]
    pub stand_m: [f64; 3],
    /// Its standard deviation by the scatter of the sweeps, m.
    #[serde(default)]
    pub stand_sigma_m: [f64; 3],
    /// Standard deviation of its turn about the axes of the base, rad.
    #[serde(default)]
    pub turn_sigma_rad: [f64; 3],
    /// Directions of the place that rest on the nominal target.
    pub directions_from_nominal: usize,
}

/// A swept axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonSweptAxis {
    /// Name of the joint.
    pub joint: String,
    /// Readings fitted.
    pub readings: usize,
    /// m or rad.
    pub span: f64,
    /// Of the circle, m; null of a line.
    pub radius_m: Option<f64>,
    /// RMS distance per coordinate from line or circle, m.
    pub rms_m: f64,
    /// Null where the readings state no noise.
    pub chi2_per_dof: Option<f64>,
    /// Numbers of readings that were left out as gross errors.
    pub gross: Vec<u32>,
}

pub(super) fn json_sweeps(outcome: &Outcome) -> Vec<JsonSweeps> {
    let axis = |axis: &SweptAxis| JsonSweptAxis {
        joint: axis.name.clone(),
        readings: axis.readings,
        span: axis.span,
        radius_m: axis.radius,
        rms_m: axis.rms,
        chi2_per_dof: axis.chi2_per_dof,
        gross: axis.gross.clone(),
    };
    let of = |swept: SweptStation| {
        let [angle_rad, angle_sigma_rad, nominal_angle_rad] = swept.angle;
        JsonSweeps {
            axes: swept.axes.iter().map(axis).collect(),
            station: swept.station,
            angle_rad,
            angle_sigma_rad,
            nominal_angle_rad,
            distance_m: swept.distance.map(|d| d[0]),
            distance_sigma_m: swept.distance.map(|d| d[1]),
            nominal_distance_m: swept.distance.map(|d| d[2]),
            stand_m: swept.stand[0].into(),
            stand_sigma_m: swept.stand[1].into(),
            turn_sigma_rad: swept.turn.into(),
            directions_from_nominal: swept.open,
        }
    };
    swept_stations(outcome).into_iter().filter_map(|(_, swept)| swept.ok().map(of)).collect()
}

/// A line a finding.
pub(super) fn sweep_words(outcome: &Outcome) -> Vec<String> {
    let words = |(_, swept)| match swept {
        Ok(swept) => of_station(&swept),
        Err(why) => vec![format!("{why}")],
    };
    swept_stations(outcome).into_iter().flat_map(words).collect()
}

fn of_station(swept: &SweptStation) -> Vec<String> {
    let [angle, sigma, nominal] = swept.angle.map(f64::to_degrees);
    let mut first = format!(
        "station {}: sweeps of {} and of {}; the two axes are {angle:.4} +- {sigma:.4} deg apart (nominal {nominal:.4})",
        swept.station,
        of_axis(&swept.axes[0]),
        of_axis(&swept.axes[1])
    );
    if let Some([distance, sigma, nominal]) = swept.distance.map(|d| d.map(|metres| 1e3 * metres)) {
        // Writing to a String cannot fail.
        let _ = write!(first, ", {distance:.3} +- {sigma:.3} mm from each other (nominal {nominal:.3})");
    }
    let mut lines = vec![first, stand_words(swept)];
    match swept.open {
        0 => {}
        1 => lines
            .push("the height along the turning axis is taken from the nominal target (within 0.1 m): measure base nests to know it better".to_owned()),
        _ => lines
            .push("sliding axes do not tell where the tracker is: its place is taken from the nominal target (within 0.1 m); sweep a turning axis or measure base nests".to_owned()),
    }
    for axis in swept.axes.iter().filter(|axis| !axis.gross.is_empty()) {
        let gross: Vec<_> = axis.gross.iter().map(u32::to_string).collect();
        lines.push(format!("sweep of {}: left out as gross errors: reading {}", axis.name, gross.join(", ")));
    }
    lines
}

fn stand_words(swept: &SweptStation) -> String {
    let three = |of: Vector3<f64>, unit: f64, digits: usize| {
        let [x, y, z] = (unit * of).into();
        format!("{x:.digits$}, {y:.digits$}, {z:.digits$}")
    };
    format!(
        "they place the tracker at {} mm in the base frame, with a standard deviation of {} mm and {} urad from their scatter, if the axes are where the nominal robot has them",
        three(swept.stand[0], 1e3, 1),
        three(swept.stand[1], 1e3, 3),
        three(swept.turn, 1e6, 1)
    )
}

fn of_axis(axis: &SweptAxis) -> String {
    let readings = counted(axis.readings, "reading");
    let rms = 1e6 * axis.rms;
    match (axis.kind, axis.radius) {
        (JointKind::Revolute, Some(radius)) => format!(
            "{} ({readings} over {:.1} deg, {rms:.1} um RMS off a circle of {radius:.3} m)",
            axis.name,
            axis.span.to_degrees()
        ),
        _ => format!("{} ({readings} over {:.3} m, {rms:.1} um RMS off a line)", axis.name, axis.span),
    }
}

/// A section of the page; nothing where no station read sweeps.
pub(super) fn sweep_section(outcome: &Outcome) -> Markup {
    let lines = sweep_words(outcome);
    html! {
        @if !lines.is_empty() {
            h3 { "Sweeps of single axes" }
            ul { @for line in lines { li { (line) } } }
        }
    }
}
