//! Session files as text.

use std::fmt::Write;

use miette::Diagnostic;
use nalgebra::Matrix3;
use thiserror::Error;

use super::instrument::{DRIFT_KEYS, key_of};
use super::{SCHEMA, SessionSet};
use crate::input::quoted;
use calibrig_model::measurement::{
    Face, NestObservation, Reading, SphericalReading, StatedInstrument, Station, Target, TargetOrientation,
};

/// A session that no file can hold.
#[derive(Debug, Clone, PartialEq, Error, Diagnostic)]
#[non_exhaustive]
pub enum SessionTextError {
    /// A nest that was read as a full pose.
    #[error("station {station:?}: nest {nest:?} was read as a full pose, but a nest is a point")]
    #[diagnostic(help("expected a spherical or Cartesian reading of every nest"))]
    NestIsPose {
        /// Name of the station.
        station: String,
        /// Name of the nest.
        nest: String,
    },
}

/// The session file of these sets. What they have in common is written once.
///
/// # Errors
/// Errors for a nest that was read as a full pose, which no key holds.
pub fn session_text(sets: &[SessionSet<'_>]) -> Result<String, SessionTextError> {
    let mut text = format!("schema = {SCHEMA:?}\n");
    let stations: Vec<_> =
        sets.iter().map(|(_, set, _)| stations_text(&set.stations)).collect::<Result<_, _>>()?;
    let targets: Vec<_> = sets.iter().map(|(_, set, _)| targets_text(&set.targets)).collect();
    for tables in [stations, targets] {
        let alike = tables.windows(2).all(|pair| pair[0] == pair[1]);
        for ((kind, ..), tables) in sets.iter().zip(&tables).take(if alike { 1 } else { sets.len() }) {
            let set = if alike { String::new() } else { format!("set = {:?}\n", kind.key()) };
            for Entry { header, name, rest } in tables {
                // Writing to a String cannot fail.
                let _ = write!(text, "\n[[{header}]]\nname = {name}\n{set}{rest}");
            }
        }
    }
    for (kind, _, dropped) in sets {
        for (pose, reason) in *dropped {
            let (set, reason) = (kind.key(), quoted(reason));
            // Writing to a String does not fail, here and below.
            let _ = write!(text, "\n[[dropped]]\nset = {set:?}\npose = {pose}\nreason = {reason}\n");
        }
    }
    Ok(text)
}

/// A table in parts, with room for its set.
#[derive(PartialEq)]
struct Entry {
    header: &'static str,
    name: String,
    rest: String,
}

fn stations_text(stations: &[Station]) -> Result<Vec<Entry>, SessionTextError> {
    let entry = |station: &Station| {
        let mut rest = station.instrument.as_ref().map(instrument_text).unwrap_or_default();
        for nest in &station.nests {
            rest.push_str(&nest_text(station, nest)?);
        }
        Ok(Entry { header: "station", name: quoted(&station.name), rest })
    };
    stations.iter().map(entry).collect()
}

fn instrument_text(instrument: &StatedInstrument) -> String {
    let mut text = format!("\n[station.instrument]\nname = {}\n", quoted(&instrument.name));
    for (term, sigma) in &instrument.sigmas {
        let _ = writeln!(text, "{} = {sigma:?}", key_of(*term));
    }
    if let Some(drift) = instrument.drift {
        for (key, sigma) in DRIFT_KEYS.into_iter().zip([drift.motion_per_hour, drift.turn_per_hour]) {
            let _ = writeln!(text, "{key} = {sigma:?}");
        }
    }
    text
}

fn nest_text(station: &Station, nest: &NestObservation) -> Result<String, SessionTextError> {
    let mut text = format!(
        "\n[[station.nest]]\nname = {}\nin_base_m = {:?}\nin_base_covariance_m2 = {:?}\n",
        quoted(&nest.name),
        <[f64; 3]>::from(nest.in_base),
        rows(&nest.in_base_covariance),
    );
    if let Some(time) = nest.time {
        let _ = writeln!(text, "time_s = {time:?}");
    }
    match &nest.reading {
        Reading::Spherical(SphericalReading { range, azimuth, elevation, covariance, face }) => {
            let _ = write!(text, "range_m = {range:?}\naz_rad = {azimuth:?}\nel_rad = {elevation:?}\n");
            if let Some(covariance) = covariance {
                let _ = writeln!(text, "covariance_m_rad = {:?}", rows(covariance));
            }
            if *face != Face::Front {
                let _ = writeln!(text, "face = {:?}", face.key());
            }
        }
        Reading::Cartesian { position, covariance } => {
            let _ = writeln!(text, "position_m = {:?}", <[f64; 3]>::from(*position));
            if let Some(covariance) = covariance {
                let _ = writeln!(text, "covariance_m2 = {:?}", rows(covariance));
            }
        }
        Reading::Pose(_) => {
            return Err(SessionTextError::NestIsPose {
                station: station.name.clone(),
                nest: nest.name.clone(),
            });
        }
    }
    Ok(text)
}

fn orientation_text(orientation: &TargetOrientation) -> String {
    let mut text = format!("rotation_matrix = {:?}\n", rows(orientation.flange_from_target.matrix()));
    if let Some(covariance) = &orientation.covariance {
        let _ = writeln!(text, "rotation_covariance_rad2 = {:?}", rows(covariance));
    }
    text
}

fn targets_text(targets: &[Target]) -> Vec<Entry> {
    let entry = |target: &Target| {
        let covariance = target.covariance.as_ref().map(|c| format!("covariance_m2 = {:?}\n", rows(c)));
        let in_flange = <[f64; 3]>::from(target.in_flange);
        let turn = target.orientation.as_ref().map(orientation_text);
        let rest = format!(
            "in_flange_m = {in_flange:?}\n{}{}",
            covariance.unwrap_or_default(),
            turn.unwrap_or_default()
        );
        Entry { header: "target", name: quoted(&target.name), rest }
    };
    targets.iter().map(entry).collect()
}

/// `{:?}` of it is TOML, and reads back to the same bits.
fn rows(matrix: &Matrix3<f64>) -> [[f64; 3]; 3] {
    matrix.transpose().into()
}
