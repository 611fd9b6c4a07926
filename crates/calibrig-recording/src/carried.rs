//! The payloads at the flange, and at how many poses each was carried, for reports.

use std::fmt;

use serde::{Deserialize, Serialize};

use calibrig_model::Payload;

/// What the flange carried at some poses; all `None` where it carried nothing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CarriedReport {
    /// Name.
    pub name: Option<String>,
    /// kg
    pub mass_kg: Option<f64>,
    /// Centre of the mass in the flange frame, m.
    pub centre_m: Option<[f64; 3]>,
    /// Force that pulls at the centre, in the base frame, N.
    pub force_n: Option<[f64; 3]>,
    /// Distinct poses with it.
    pub poses: usize,
}

impl CarriedReport {
    /// Of a payload; `None` is an empty flange.
    pub fn of(payload: Option<&Payload>, poses: usize) -> Self {
        Self {
            name: payload.map(|payload| payload.name.clone()),
            mass_kg: payload.map(|payload| payload.mass),
            centre_m: payload.map(|payload| payload.centre.into()),
            force_n: payload.map(|payload| payload.force.into()),
            poses,
        }
    }
}

/// "25 kg (25.0 kg) at 20 poses".
impl fmt::Display for CarriedReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.name {
            None => f.write_str("nothing")?,
            Some(name) => write!(f, "{name} ({:.1} kg", self.mass_kg.unwrap_or(0.0))?,
        }
        let pull = self.force_n.map_or(0.0, |force| force.iter().map(|axis| axis * axis).sum::<f64>().sqrt());
        if pull > 0.0 {
            write!(f, " and {pull:.1} N")?;
        }
        if self.name.is_some() {
            f.write_str(")")?;
        }
        write!(f, " at {} pose{}", self.poses, if self.poses == 1 { "" } else { "s" })
    }
}
