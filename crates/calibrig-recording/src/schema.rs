//! The messages of package `calibrig.v1` (see `calibrig.proto`), and the conversion between them and the library's own types.

use nalgebra::{Matrix3, Matrix6, Rotation3, Vector3};

use calibrig_estimation::evaluation::closed_loop::DrivenPoint;
use calibrig_estimation::identification::Mode;
use calibrig_files::rotation_of_matrix;
use calibrig_model::Payload;
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{
    Face, InstrumentTerm, NestObservation, Observation, PoseReading, Reading, SetKind, SetOutcome,
    SphericalReading, StatedDrift, StatedInstrument, Station, Target, TargetOrientation,
};

/// The generated types.
#[allow(missing_docs, clippy::all, clippy::pedantic)]
pub mod v1 {
    include!(concat!(env!("OUT_DIR"), "/calibrig.v1.rs"));
}

/// The `google.protobuf.FileDescriptorSet` of the package: the schema that every recording carries.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/calibrig.v1.descriptors"));

/// The set of a key.
pub(super) fn set_kind(key: &str) -> Result<SetKind, String> {
    SetKind::ALL
        .into_iter()
        .find(|kind| kind.key() == key)
        .ok_or_else(|| format!("set {key:?} is not one of {}", SetKind::ALL.map(SetKind::key).join(", ")))
}

pub(super) fn vector(v: &Vector3<f64>) -> Vec<f64> {
    v.iter().copied().collect()
}

pub(super) fn matrix(m: &Matrix3<f64>) -> Vec<f64> {
    m.transpose().iter().copied().collect()
}

fn optional_matrix(m: Option<&Matrix3<f64>>) -> Vec<f64> {
    m.map(matrix).unwrap_or_default()
}

pub(super) fn pose(transform: &Transform) -> v1::Pose {
    v1::Pose {
        rotation: matrix(transform.rotation.matrix()),
        translation: vector(&transform.translation.vector),
    }
}

/// A number of a message, which must be there and finite.
fn number(value: Option<f64>, name: &str) -> Result<f64, String> {
    let value = value.ok_or_else(|| format!("{name} is missing"))?;
    if value.is_finite() {
        Ok(value)
    } else {
        Err(format!("{name} is {value}, a finite number was expected"))
    }
}

fn numbers<const N: usize>(values: &[f64], name: &str) -> Result<[f64; N], String> {
    if let Some(value) = values.iter().find(|v| !v.is_finite()) {
        return Err(format!("{name} holds {value}, finite numbers were expected"));
    }
    values.try_into().map_err(|_| format!("{name} has {} numbers, {N} were expected", values.len()))
}

fn to_vector(values: &[f64], name: &str) -> Result<Vector3<f64>, String> {
    numbers::<3>(values, name).map(Vector3::from)
}

fn to_matrix(values: &[f64], name: &str) -> Result<Matrix3<f64>, String> {
    numbers::<9>(values, name).map(|v| Matrix3::from_row_slice(&v))
}

/// A rotation matrix: right-handed, with orthonormal columns up to the digits of single precision. The nearest rotation is taken.
fn to_rotation(values: &[f64], name: &str) -> Result<Rotation3<f64>, String> {
    let matrix = to_matrix(values, name)?;
    let off = (matrix.transpose() * matrix - Matrix3::identity()).amax();
    if off > 1e-5 {
        return Err(format!(
            "{name} is no rotation: its columns differ from unit vectors at right angles by {off:.1e}, at most 1e-5 was expected"
        ));
    }
    if matrix.determinant() < 0.0 {
        return Err(format!("{name} is left-handed: a right-handed rotation was expected"));
    }
    rotation_of_matrix(&matrix).map_err(|error| format!("{name}: {error}"))
}

fn to_optional_matrix(values: &[f64], name: &str) -> Result<Option<Matrix3<f64>>, String> {
    if values.is_empty() { Ok(None) } else { to_matrix(values, name).map(Some) }
}

pub(super) fn to_pose(message: &v1::Pose) -> Result<Transform, String> {
    let rotation = to_matrix(&message.rotation, "rotation")?;
    let translation = to_vector(&message.translation, "translation")?;
    Ok(Transform::from_parts(translation.into(), Rotation3::from_matrix_unchecked(rotation)))
}

pub(super) fn to_point(message: &v1::Point) -> Result<Vector3<f64>, String> {
    to_vector(&message.position, "position")
}

impl From<&Reading> for v1::Reading {
    fn from(reading: &Reading) -> Self {
        let kind = match reading {
            Reading::Spherical(reading) => v1::reading::Kind::Spherical(v1::SphericalReading {
                range: Some(reading.range),
                azimuth: Some(reading.azimuth),
                elevation: Some(reading.elevation),
                covariance: optional_matrix(reading.covariance.as_ref()),
                back_face: reading.face == Face::Back,
                both_faces: reading.face == Face::Both,
            }),
            Reading::Cartesian { position, covariance } => {
                v1::reading::Kind::Cartesian(v1::CartesianReading {
                    position: vector(position),
                    covariance: optional_matrix(covariance.as_ref()),
                })
            }
            Reading::Pose(pose) => v1::reading::Kind::Pose(v1::PoseReading {
                position: vector(&pose.position),
                rotation: matrix(pose.rotation.matrix()),
                covariance: pose.covariance.map(|c| c.transpose().as_slice().to_vec()).unwrap_or_default(),
            }),
        };
        Self { kind: Some(kind) }
    }
}

fn to_reading(message: Option<&v1::Reading>) -> Result<Reading, String> {
    match message.and_then(|m| m.kind.as_ref()).ok_or("the reading is missing")? {
        v1::reading::Kind::Spherical(message) => Ok(Reading::Spherical(SphericalReading {
            range: number(message.range, "range")?,
            azimuth: number(message.azimuth, "azimuth")?,
            elevation: number(message.elevation, "elevation")?,
            covariance: to_optional_matrix(&message.covariance, "covariance of the reading")?,
            face: match (message.back_face, message.both_faces) {
                (_, true) => Face::Both,
                (true, false) => Face::Back,
                (false, false) => Face::Front,
            },
        })),
        v1::reading::Kind::Cartesian(reading) => Ok(Reading::Cartesian {
            position: to_vector(&reading.position, "position")?,
            covariance: to_optional_matrix(&reading.covariance, "covariance of the reading")?,
        }),
        v1::reading::Kind::Pose(pose) => Ok(Reading::Pose(Box::new(PoseReading {
            position: to_vector(&pose.position, "position")?,
            rotation: to_rotation(&pose.rotation, "rotation of the reading")?,
            covariance: match pose.covariance.as_slice() {
                [] => None,
                stated => Some(Matrix6::from_row_slice(&numbers::<36>(stated, "covariance of the reading")?)),
            },
        }))),
    }
}

fn instrument(stated: &StatedInstrument) -> v1::Instrument {
    let error = |(term, sigma): &(InstrumentTerm, f64)| v1::InstrumentError {
        term: term.key().to_owned(),
        sigma: Some(*sigma),
    };
    v1::Instrument {
        name: stated.name.clone(),
        errors: stated.sigmas.iter().map(error).collect(),
        drift_motion_per_hour: stated.drift.map(|drift| drift.motion_per_hour),
        drift_turn_per_hour: stated.drift.map(|drift| drift.turn_per_hour),
    }
}

fn to_instrument(message: &v1::Instrument) -> Result<StatedInstrument, String> {
    let error = |error: &v1::InstrumentError| {
        let term = InstrumentTerm::parse(&error.term).ok_or_else(|| {
            format!(
                "there is no error {:?} of an instrument: expected one of {}",
                error.term,
                InstrumentTerm::ALL.map(InstrumentTerm::key).join(", ")
            )
        })?;
        Ok::<_, String>((term, number(error.sigma, "sigma of an instrument's error")?))
    };
    Ok(StatedInstrument {
        name: message.name.clone(),
        sigmas: message.errors.iter().map(error).collect::<Result<_, _>>()?,
        drift: match (message.drift_motion_per_hour, message.drift_turn_per_hour) {
            (None, None) => None,
            (motion, turn) => Some(StatedDrift {
                motion_per_hour: number(motion, "drift_motion_per_hour")?,
                turn_per_hour: number(turn, "drift_turn_per_hour")?,
            }),
        },
    })
}

/// The message that describes a set before its observations.
pub(super) fn session(set: &SetOutcome, planned: Option<u32>) -> v1::Session {
    let measurements = &set.measurements;
    let swept = |(index, reading): (usize, &Observation)| observation(set.kind, index, reading);
    let station = |station: &Station| v1::Station {
        name: station.name.clone(),
        nests: Vec::new(),
        instrument: station.instrument.as_ref().map(instrument),
        sweeps: station.sweeps.iter().enumerate().map(swept).collect(),
    };
    let target = |target: &Target| {
        let turned = target.orientation.as_ref();
        v1::Target {
            name: target.name.clone(),
            in_flange: vector(&target.in_flange),
            covariance: optional_matrix(target.covariance.as_ref()),
            rotation: optional_matrix(turned.map(|turned| turned.flange_from_target.matrix())),
            rotation_covariance: optional_matrix(turned.and_then(|turned| turned.covariance.as_ref())),
        }
    };
    v1::Session {
        set: set.kind.key().to_owned(),
        stations: measurements.stations.iter().map(station).collect(),
        targets: measurements.targets.iter().map(target).collect(),
        dropped: Vec::new(),
        observation_count: None,
        planned_poses: planned,
    }
}

/// The nests that the stations of a set measured.
pub(super) fn nests(set: &SetOutcome) -> impl Iterator<Item = v1::BaseNest> {
    let nest = |nest: &NestObservation| v1::Nest {
        name: nest.name.clone(),
        in_base: vector(&nest.in_base),
        in_base_covariance: matrix(&nest.in_base_covariance),
        reading: Some((&nest.reading).into()),
        time: nest.time,
    };
    let stations = set.measurements.stations.iter().enumerate();
    stations.flat_map(move |(station, place)| {
        place.nests.iter().map(move |seen| v1::BaseNest {
            set: set.kind.key().to_owned(),
            station: saturating(station),
            nest: Some(nest(seen)),
        })
    })
}

pub(super) fn to_nest(nest: &v1::Nest) -> Result<NestObservation, String> {
    Ok(NestObservation {
        name: nest.name.clone(),
        in_base: to_vector(&nest.in_base, "in_base")?,
        in_base_covariance: to_matrix(&nest.in_base_covariance, "in_base_covariance")?,
        reading: to_reading(nest.reading.as_ref())?,
        time: nest.time.map(|time| number(Some(time), "time")).transpose()?,
    })
}

fn to_orientation(target: &v1::Target) -> Result<Option<TargetOrientation>, String> {
    if target.rotation.is_empty() {
        return Ok(None);
    }
    Ok(Some(TargetOrientation {
        flange_from_target: to_rotation(&target.rotation, "rotation of the target")?,
        covariance: to_optional_matrix(&target.rotation_covariance, "covariance of the target's rotation")?,
    }))
}

/// As the 32 bits of a message: counts in a recording are far smaller than 2^32.
pub(super) fn saturating(count: usize) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}

impl TryFrom<&v1::Session> for SetOutcome {
    type Error = String;

    fn try_from(message: &v1::Session) -> Result<Self, String> {
        let station = |station: &v1::Station| {
            let nests = station.nests.iter().map(to_nest).collect::<Result<_, _>>()?;
            let instrument = station.instrument.as_ref().map(to_instrument).transpose()?;
            Ok::<_, String>(Station {
                name: station.name.clone(),
                nests,
                instrument,
                motion: None,
                sweeps: Vec::new(),
            })
        };
        let target = |target: &v1::Target| {
            Ok::<_, String>(Target {
                name: target.name.clone(),
                in_flange: to_vector(&target.in_flange, "in_flange")?,
                covariance: to_optional_matrix(&target.covariance, "covariance of the target")?,
                orientation: to_orientation(target)?,
            })
        };
        let mut set = Self {
            kind: set_kind(&message.set)?,
            measurements: calibrig_model::measurement::MeasurementSet {
                stations: message.stations.iter().map(station).collect::<Result<_, _>>()?,
                targets: message.targets.iter().map(target).collect::<Result<_, _>>()?,
                observations: Vec::new(),
            },
            dropped: message.dropped.iter().map(|d| (d.pose, d.reason.clone())).collect(),
        };
        for (index, station) in message.stations.iter().enumerate() {
            let swept = station.sweeps.iter().map(|reading| to_observation(reading, &set));
            set.measurements.stations[index].sweeps = swept.collect::<Result<_, _>>()?;
        }
        Ok(set)
    }
}

/// The message of an observation at `index` of the set `kind`.
pub(super) fn observation(kind: SetKind, index: usize, observation: &Observation) -> v1::Observation {
    v1::Observation {
        set: kind.key().to_owned(),
        index: saturating(index),
        pose: observation.pose,
        command: observation.command.clone(),
        approach: observation.approach.iter().map(|&sign| i32::from(sign)).collect(),
        since_reversal: observation.since_reversal.clone(),
        temperature: observation.temperature,
        time: Some(observation.time),
        station: saturating(observation.station),
        target: saturating(observation.target),
        reading: Some((&observation.reading).into()),
        payload: observation.payload.as_ref().map(payload),
    }
}

/// The message of the tool at a goal.
pub(super) fn driven_point(mode: Mode, point: &DrivenPoint) -> v1::DrivenPoint {
    v1::DrivenPoint {
        mode: mode.key().to_owned(),
        pose: point.pose,
        goal: vector(&point.goal),
        measured: vector(&point.measured),
        command: point.command.clone(),
        sigma: point.sigma.as_ref().map(vector).unwrap_or_default(),
    }
}

/// The message of a load at the flange.
pub(super) fn payload(payload: &Payload) -> v1::Payload {
    v1::Payload {
        name: payload.name.clone(),
        mass: Some(payload.mass),
        centre: vector(&payload.centre),
        force: vector(&payload.force),
    }
}

pub(super) fn to_payload(message: &v1::Payload) -> Result<Payload, String> {
    let force = match message.force.as_slice() {
        [] => Vector3::zeros(),
        force => to_vector(force, "force of the payload")?,
    };
    let mass = number(message.mass, "mass of the payload")?;
    let centre = to_vector(&message.centre, "centre of the payload")?;
    let payload = Payload { name: message.name.clone(), mass, centre, force };
    payload.check().map_err(|error| error.to_string())?;
    Ok(payload)
}

/// The observation of a message, with its station and target in range of `set`.
pub(super) fn to_observation(message: &v1::Observation, set: &SetOutcome) -> Result<Observation, String> {
    let index = |value: u32, count: usize, name: &str| match usize::try_from(value) {
        Ok(index) if index < count => Ok(index),
        _ => Err(format!("{name} {value} does not exist: the session has {count}")),
    };
    let sign = |&sign: &i32| match sign {
        -1 => Ok(-1),
        0 => Ok(0),
        1 => Ok(1),
        _ => Err(format!("approach {sign} is not -1, 0 or 1")),
    };
    if let Some(value) = message.command.iter().find(|c| !c.is_finite()) {
        return Err(format!("command holds {value}, finite numbers were expected"));
    }
    if let Some(value) = message.since_reversal.iter().find(|way| !(way.is_finite() && **way >= 0.0)) {
        return Err(format!("since_reversal holds {value}, finite ways of zero or more were expected"));
    }
    let approach = match message.approach.as_slice() {
        // Another program may leave it out.
        [] => vec![0; message.command.len()],
        signs => signs.iter().map(sign).collect::<Result<_, _>>()?,
    };
    Ok(Observation {
        pose: message.pose,
        command: message.command.clone(),
        approach,
        since_reversal: message.since_reversal.clone(),
        temperature: message.temperature.map(|t| number(Some(t), "temperature")).transpose()?,
        time: number(message.time, "time")?,
        station: index(message.station, set.measurements.stations.len(), "station")?,
        target: index(message.target, set.measurements.targets.len(), "target")?,
        reading: to_reading(message.reading.as_ref())?,
        payload: message.payload.as_ref().map(to_payload).transpose()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;
    use prost::Message;

    #[test]
    fn observations_come_back_bit_for_bit() {
        let outcome = synthetic::outcome(6, 2, false);
        for set in &outcome.sets {
            let empty = SetOutcome::try_from(&session(set, None)).expect("sound");
            for (i, o) in set.measurements.observations.iter().enumerate() {
                let mut o = o.clone();
                o.command[0] = -0.0;
                o.time = -0.0;
                o.temperature = Some(f64::MIN_POSITIVE / 3.0);
                o.payload = (i > 0).then(|| Payload {
                    name: "plates \"25\"".to_owned(),
                    mass: f64::MIN_POSITIVE / 3.0,
                    centre: Vector3::new(-0.0, 0.1, -0.3),
                    force: Vector3::new(0.0, -0.0, 40.0),
                });
                let bytes = observation(set.kind, i, &o).encode_to_vec();
                let message = v1::Observation::decode(bytes.as_slice()).expect("decoded");
                let back = to_observation(&message, &empty).expect("sound");
                // `{:?}` tells -0.0 from 0.0 and prints enough digits for every bit.
                assert_eq!(format!("{back:?}"), format!("{o:?}"));
            }
        }
    }

    fn full_pose() -> PoseReading {
        let half = Matrix6::from_fn(|i, j| if i >= j { 1e-5 * (1.0 + (i * j) as f64) } else { 0.0 });
        let covariance = half * half.transpose();
        PoseReading {
            position: Vector3::new(1.0, -0.0, f64::MIN_POSITIVE),
            rotation: Rotation3::new(Vector3::new(0.4, -1.2, 2.0)),
            covariance: Some(Matrix6::from_fn(|i, j| covariance[(i.min(j), i.max(j))])),
        }
    }

    #[test]
    fn faces_full_poses_nests_in_rounds_instruments_and_turned_targets_come_back_bit_for_bit() {
        let outcome = synthetic::outcome(3, 1, false);
        let mut set = outcome.sets[0].clone();
        let measurements = &mut set.measurements;
        measurements.observations[0].reading = Reading::Pose(Box::new(full_pose()));
        measurements.observations[1].reading =
            Reading::Pose(Box::new(PoseReading { covariance: None, ..full_pose() }));
        let Reading::Spherical(reading) = &mut measurements.observations[2].reading else {
            panic!("spherical")
        };
        reading.face = Face::Back;
        let station = &mut measurements.stations[0];
        let mut again = station.nests[0].clone();
        (station.nests[0].time, again.time) = (Some(-0.0), Some(1800.5));
        station.nests.push(again);
        // In another order than that of the terms.
        let sigmas =
            InstrumentTerm::ALL.into_iter().rev().zip(1..).map(|(term, n)| (term, 1e-7 * f64::from(n)));
        station.instrument = Some(StatedInstrument {
            name: "AT \"1\"".to_owned(),
            sigmas: sigmas.collect(),
            drift: Some(StatedDrift { motion_per_hour: 1e-5, turn_per_hour: 0.0 }),
        });
        measurements.targets[0].orientation = Some(TargetOrientation {
            flange_from_target: Rotation3::new(Vector3::new(0.0, 0.1, -3.0)),
            covariance: Some(Matrix3::identity() * 1e-8),
        });
        let bytes = session(&set, None).encode_to_vec();
        let message = v1::Session::decode(bytes.as_slice()).expect("decoded");
        let mut back = SetOutcome::try_from(&message).expect("sound");
        for nest in nests(&set) {
            let decoded = v1::BaseNest::decode(nest.encode_to_vec().as_slice()).expect("decoded");
            let nest = to_nest(decoded.nest.as_ref().expect("a nest")).expect("sound");
            back.measurements.stations[decoded.station as usize].nests.push(nest);
        }
        for (i, o) in set.measurements.observations.iter().enumerate() {
            let bytes = observation(set.kind, i, o).encode_to_vec();
            let message = v1::Observation::decode(bytes.as_slice()).expect("decoded");
            let read = to_observation(&message, &back).expect("sound");
            back.measurements.observations.push(read);
        }
        assert_eq!(format!("{:?}", back.measurements), format!("{:?}", set.measurements));
    }

    #[test]
    fn rotations_and_instruments_that_make_no_sense_are_refused_with_the_field() {
        let outcome = synthetic::outcome(2, 1, false);
        let set = &outcome.sets[0];
        let mut good = set.measurements.observations[0].clone();
        good.reading = Reading::Pose(Box::new(full_pose()));
        let good = observation(set.kind, 0, &good);
        type Change = fn(&mut v1::PoseReading);
        let cases: [(Change, &str); 6] = [
            (|p| p.rotation[..3].iter_mut().for_each(|x| *x = -*x), "rotation of the reading is left-handed"),
            (|p| p.rotation[0] += 0.01, "rotation of the reading is no rotation"),
            (|p| p.rotation.truncate(4), "rotation of the reading has 4 numbers, 9 were expected"),
            (|p| p.rotation[2] = f64::NAN, "rotation of the reading holds NaN"),
            (|p| p.covariance.truncate(21), "covariance of the reading has 21 numbers, 36 were expected"),
            (|p| p.position.clear(), "position has 0 numbers, 3 were expected"),
        ];
        for (change, expected) in cases {
            let mut bad = good.clone();
            let Some(v1::reading::Kind::Pose(pose)) = bad.reading.as_mut().and_then(|r| r.kind.as_mut())
            else {
                panic!("a full pose")
            };
            change(pose);
            let error = to_observation(&bad, set).expect_err(expected);
            assert!(error.contains(expected), "{error}");
        }
        // In single precision it is the nearest rotation, and one to all digits.
        let mut single = good.clone();
        if let Some(v1::reading::Kind::Pose(pose)) = single.reading.as_mut().and_then(|r| r.kind.as_mut()) {
            #[expect(clippy::cast_possible_truncation, reason = "as a program in single precision has it")]
            pose.rotation.iter_mut().for_each(|x| *x = f64::from(*x as f32));
        }
        let Reading::Pose(read) = to_observation(&single, set).expect("sound").reading else {
            panic!("a pose")
        };
        let r = read.rotation.matrix();
        assert!((r.transpose() * r - Matrix3::identity()).amax() < 1e-14);
        assert!((r - full_pose().rotation.matrix()).amax() < 1e-7);

        let mut message = session(set, None);
        let instrument = |term: &str, sigma| v1::Instrument {
            drift_motion_per_hour: None,
            drift_turn_per_hour: None,
            name: "AT".to_owned(),
            errors: vec![v1::InstrumentError { term: term.to_owned(), sigma }],
        };
        for (bad, expected) in [
            (instrument("colimation", Some(1e-6)), "there is no error \"colimation\" of an instrument"),
            (instrument("collimation", None), "sigma of an instrument's error is missing"),
        ] {
            message.stations[0].instrument = Some(bad);
            let error = SetOutcome::try_from(&message).expect_err(expected);
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn what_another_program_does_not_know_may_be_left_out() {
        let outcome = synthetic::outcome(2, 1, false);
        let set = &outcome.sets[0];
        let mut message = observation(set.kind, 0, &set.measurements.observations[0]);
        message.approach.clear();
        if let Some(v1::reading::Kind::Spherical(reading)) =
            message.reading.as_mut().and_then(|reading| reading.kind.as_mut())
        {
            reading.covariance.clear();
        }
        let read = to_observation(&message, set).expect("sound");
        assert_eq!(read.approach, vec![0; read.command.len()]);
        let Reading::Spherical(reading) = &set.measurements.observations[0].reading else {
            panic!("spherical")
        };
        assert_eq!(
            read.reading,
            Reading::Spherical(SphericalReading { covariance: None, ..reading.clone() })
        );
    }

    #[test]
    fn observations_that_make_no_sense_are_refused_with_the_field() {
        let outcome = synthetic::outcome(2, 1, false);
        let set = &outcome.sets[0];
        let good = observation(set.kind, 0, &set.measurements.observations[0]);
        assert!(to_observation(&good, set).is_ok());
        type Change = fn(&mut v1::Observation);
        let cases: [(Change, &str); 8] = [
            (|o| o.station = 9, "station 9"),
            (|o| o.target = u32::MAX, "target 4294967295"),
            (|o| o.time = None, "time is missing"),
            (|o| o.command[0] = f64::NAN, "command holds NaN"),
            (|o| o.approach[0] = 2, "approach 2"),
            (|o| o.temperature = Some(f64::INFINITY), "temperature is inf"),
            (|o| o.reading = None, "reading is missing"),
            (
                |o| {
                    let reading = v1::CartesianReading { position: vec![1.0, 2.0], covariance: vec![] };
                    o.reading = Some(v1::Reading { kind: Some(v1::reading::Kind::Cartesian(reading)) });
                },
                "position has 2 numbers, 3 were expected",
            ),
        ];
        for (change, expected) in cases {
            let mut bad = good.clone();
            change(&mut bad);
            let error = to_observation(&bad, set).expect_err(expected);
            assert!(error.contains(expected), "{error}");
        }
    }
}
