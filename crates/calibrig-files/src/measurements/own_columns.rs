//! calibrig's own columns.
//!
//! They are read without a map (SI, unit in the name): `q1_rad` or `q1_m` and so on; either `range_m`, `az_rad`, `el_rad` or
//! `x_m`, `y_m`, `z_m`; and, if the file has them, `pose`, `station`, `target`, `time_s`, `temperature_c`, `approach1` and so on,
//! `since_reversal1_rad` (or `_m`) and so on, what the flange carries (`payload`, a name, with `payload_mass_kg`, `payload_x_m`, `payload_y_m`,
//! `payload_z_m`, and `payload_force_x_n`, `payload_force_y_n`, `payload_force_z_n`; empty where nothing), and the uncertainty: `sigma_range_m`,
//! `sigma_az_rad`, `sigma_el_rad` (`sigma_x_m`, `sigma_y_m`, `sigma_z_m`), or the covariance's upper triangle `cov_range_range_m2`,
//! `cov_range_az_m_rad`, `cov_range_el_m_rad`, `cov_az_az_rad2`, `cov_az_el_rad2`, `cov_el_el_rad2` (`cov_xx_m2`, `cov_xy_m2`, `cov_xz_m2`,
//! `cov_yy_m2`, `cov_yz_m2`, `cov_zz_m2`). A full pose has, in addition to `x_m`, `y_m`, `z_m` its rotation `tracker_from_target` by rows, `r11` to
//! `r33`, `sigma_rx_rad`, `sigma_ry_rad`, `sigma_rz_rad` with the sigmas of the place, or the 21 elements of both, `cov_x_rx_m_rad` and `cov_rx_rx_rad2`
//! among them. A spherical reading may have its `face`, `front` or `back`.

use super::columns::{
    BackAngles, Entry, FaceColumn, Mapping, PayloadColumns, PolarAngle, PositionColumns, RotationColumns,
    RotationSigma, RowChoices, Sets, SigmaUnits, Uncertainty,
};
use super::layout::TableFormat;
use super::text::TextFormat;
use super::units::{AngleUnit, LengthUnit, TemperatureUnit, TimeUnit};
use crate::rotation::{MatrixOrder, RotationForm};
use calibrig_model::JointKind;
use calibrig_model::measurement::Face;

pub const POSE: &str = "pose";
pub const STATION: &str = "station";
pub const TARGET: &str = "target";
pub const SPHERICAL: [&str; 3] = ["range_m", "az_rad", "el_rad"];
pub const SPHERICAL_SIGMA: [&str; 3] = ["sigma_range_m", "sigma_az_rad", "sigma_el_rad"];
pub const SPHERICAL_COVARIANCE: [&str; 6] = [
    "cov_range_range_m2",
    "cov_range_az_m_rad",
    "cov_range_el_m_rad",
    "cov_az_az_rad2",
    "cov_az_el_rad2",
    "cov_el_el_rad2",
];
pub const CARTESIAN: [&str; 3] = ["x_m", "y_m", "z_m"];
pub const CARTESIAN_SIGMA: [&str; 3] = ["sigma_x_m", "sigma_y_m", "sigma_z_m"];
pub const CARTESIAN_COVARIANCE: [&str; 6] =
    ["cov_xx_m2", "cov_xy_m2", "cov_xz_m2", "cov_yy_m2", "cov_yz_m2", "cov_zz_m2"];
/// `tracker_from_target` by rows.
pub const ROTATION: [&str; 9] = ["r11", "r12", "r13", "r21", "r22", "r23", "r31", "r32", "r33"];
pub const ROTATION_SIGMA: [&str; 3] = ["sigma_rx_rad", "sigma_ry_rad", "sigma_rz_rad"];
pub const POSE_COVARIANCE: [&str; 21] = [
    "cov_xx_m2",
    "cov_xy_m2",
    "cov_xz_m2",
    "cov_x_rx_m_rad",
    "cov_x_ry_m_rad",
    "cov_x_rz_m_rad",
    "cov_yy_m2",
    "cov_yz_m2",
    "cov_y_rx_m_rad",
    "cov_y_ry_m_rad",
    "cov_y_rz_m_rad",
    "cov_zz_m2",
    "cov_z_rx_m_rad",
    "cov_z_ry_m_rad",
    "cov_z_rz_m_rad",
    "cov_rx_rx_rad2",
    "cov_rx_ry_rad2",
    "cov_rx_rz_rad2",
    "cov_ry_ry_rad2",
    "cov_ry_rz_rad2",
    "cov_rz_rz_rad2",
];
pub const FACE: &str = "face";
pub const TIME: &str = "time_s";
pub const TEMPERATURE: &str = "temperature_c";
pub const PAYLOAD: &str = "payload";
pub const PAYLOAD_MASS: &str = "payload_mass_kg";
pub const PAYLOAD_CENTRE: [&str; 3] = ["payload_x_m", "payload_y_m", "payload_z_m"];
pub const PAYLOAD_FORCE: [&str; 3] = ["payload_force_x_n", "payload_force_y_n", "payload_force_z_n"];

/// Column of the joint at `index`.
pub fn joint(index: usize, kind: JointKind) -> String {
    match kind {
        JointKind::Revolute => format!("q{}_rad", index + 1),
        JointKind::Prismatic => format!("q{}_m", index + 1),
    }
}

/// Column of the approach direction of the actuator at `index`.
pub fn approach(index: usize) -> String {
    format!("approach{}", index + 1)
}

/// Column of how far the actuator at `index` has moved since it last reversed.
pub fn since_reversal(index: usize, kind: JointKind) -> String {
    match kind {
        JointKind::Revolute => format!("since_reversal{}_rad", index + 1),
        JointKind::Prismatic => format!("since_reversal{}_m", index + 1),
    }
}

/// The own columns that a file with this header has.
///
/// # Errors
/// In words: columns of both kinds, of more joints than the robot has, or an incomplete group.
pub(super) fn mapping(header: &[&str], joints: &[JointKind]) -> Result<Mapping, String> {
    let has = |name: &str| header.contains(&name);
    let surplus = [JointKind::Revolute, JointKind::Prismatic].map(|kind| joint(joints.len(), kind));
    if let Some(name) = surplus.iter().find(|name| has(name)) {
        return Err(format!("there is a column {name}, but the robot has {} joints", joints.len()));
    }
    let cartesian = CARTESIAN.iter().any(|name| has(name));
    if cartesian && SPHERICAL.iter().any(|name| has(name)) {
        return Err("there are columns of both x_m, y_m, z_m and range_m, az_rad, el_rad".to_owned());
    }
    let position = if cartesian {
        PositionColumns::Cartesian { axes: CARTESIAN.map(Entry::named), unit: Some(LengthUnit::M) }
    } else {
        let [range, azimuth, polar] = SPHERICAL.map(Entry::named);
        PositionColumns::Spherical {
            range,
            range_unit: Some(LengthUnit::M),
            azimuth,
            polar,
            polar_angle: PolarAngle::Elevation,
            angle_unit: Some(AngleUnit::Rad),
        }
    };
    let rotation = rotation(header, cartesian)?;
    let uncertainty = uncertainty(header, cartesian, rotation.is_some())?;
    let optional = |name: &str| has(name).then(|| Entry::named(name));
    let approach: Vec<_> = (0..joints.len()).map(approach).collect();
    let directed = approach.iter().any(|name| has(name));
    let ways: Vec<_> = joints.iter().enumerate().map(|(index, kind)| since_reversal(index, *kind)).collect();
    // One of these columns requires all of them.
    let moved = ways.iter().any(|name| has(name));
    Ok(Mapping {
        joints: joints.iter().enumerate().map(|(index, kind)| Entry::named(&joint(index, *kind))).collect(),
        revolute: Some(AngleUnit::Rad),
        prismatic: Some(LengthUnit::M),
        position,
        rotation,
        uncertainty,
        noise: None,
        pose: optional(POSE),
        station: optional(STATION),
        target: optional(TARGET),
        time: optional(TIME),
        time_unit: TimeUnit::S,
        temperature: optional(TEMPERATURE),
        temperature_unit: TemperatureUnit::C,
        air: Vec::new(),
        face: optional(FACE).map(|column| FaceColumn {
            column,
            words: [Face::Front, Face::Back].map(|face| vec![face.key().to_owned()]),
            angles: BackAngles::Own,
        }),
        approach: if directed {
            approach.iter().map(|name| Entry::named(name)).collect()
        } else {
            Vec::new()
        },
        payload: payload(header)?,
        since_reversal: if moved { ways.iter().map(|name| Entry::named(name)).collect() } else { Vec::new() },
        rows: RowChoices::default(),
        sets: Sets::default(),
        join: None,
        text: TextFormat::default(),
        table: TableFormat::default(),
    })
}

/// The own columns of a payload, if the file has them; one of them requires mass and centre.
fn payload(header: &[&str]) -> Result<Option<PayloadColumns>, String> {
    let has = |name: &&str| header.contains(name);
    let has_force = PAYLOAD_FORCE.iter().any(has);
    let numbers = [PAYLOAD_MASS].iter().chain(&PAYLOAD_CENTRE).any(has);
    if !numbers && !has_force {
        if !has(&PAYLOAD) {
            return Ok(None);
        }
        return Err(format!(
            "there is a column {}, but neither {} nor {}, one of which must say what it is",
            PAYLOAD,
            PAYLOAD_MASS,
            PAYLOAD_CENTRE.join(", ")
        ));
    }
    Ok(Some(PayloadColumns::Numbers {
        name: has(&PAYLOAD).then(|| Entry::named(PAYLOAD)),
        mass: Entry::named(PAYLOAD_MASS),
        centre: PAYLOAD_CENTRE.map(Entry::named),
        unit: LengthUnit::M,
        force: has_force.then(|| PAYLOAD_FORCE.map(Entry::named)),
    }))
}

/// The own columns of a rotation, if the file has them.
fn rotation(header: &[&str], cartesian: bool) -> Result<Option<RotationColumns>, String> {
    let has = |name: &&str| header.contains(name);
    if !ROTATION.iter().any(has) {
        return Ok(None);
    }
    if !cartesian {
        return Err("there are columns of a rotation, r11 to r33, but no x_m, y_m, z_m".to_owned());
    }
    // One column of a group requires the whole group, so that a misspelt one is reported.
    let sigma = ROTATION_SIGMA.iter().any(has).then(|| RotationSigma {
        columns: ROTATION_SIGMA.map(Entry::named).into(),
        unit: Some(AngleUnit::Rad),
        coverage: 1.0,
    });
    Ok(Some(RotationColumns {
        form: RotationForm::Matrix(MatrixOrder::ByRows),
        columns: ROTATION.map(Entry::named).into(),
        unit: None,
        is_of_tracker: false,
        sigma,
    }))
}

/// The own columns of an uncertainty, if the file has them; here, too, one column of a group requires the whole group.
fn uncertainty(header: &[&str], cartesian: bool, is_pose: bool) -> Result<Option<Uncertainty>, String> {
    let (sigma, covariance) = if cartesian {
        (CARTESIAN_SIGMA, CARTESIAN_COVARIANCE)
    } else {
        (SPHERICAL_SIGMA, SPHERICAL_COVARIANCE)
    };
    let covariance: Vec<&str> = if is_pose { POSE_COVARIANCE.into() } else { covariance.into() };
    let has = |name: &&str| header.contains(name);
    Ok(match (sigma.iter().any(has), covariance.iter().any(has)) {
        (true, true) => return Err("there are columns of both sigma and cov: keep one kind".to_owned()),
        (true, false) => Some(Uncertainty::Sigmas {
            columns: sigma.map(Entry::named),
            units: if cartesian {
                SigmaUnits::Cartesian(Some(LengthUnit::M))
            } else {
                SigmaUnits::Spherical(Some(LengthUnit::M), Some(AngleUnit::Rad))
            },
            coverage: 1.0,
        }),
        (false, true) => {
            let columns: Vec<Entry> = covariance.iter().map(|name| Entry::named(name)).collect();
            Some(match <[Entry; 6]>::try_from(columns) {
                Ok(columns) => Uncertainty::Covariance(columns),
                Err(columns) => Uncertainty::Pose { columns, units: (LengthUnit::M, AngleUnit::Rad) },
            })
        }
        (false, false) => None,
    })
}
