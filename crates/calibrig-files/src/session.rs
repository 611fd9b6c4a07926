//! `session.toml`: the parts of a session without columns in its measurement files. Stations with their base nests, targets with
//! their uncertainty, constant payloads, poses that were not measured. Every number reads back to the same bits.

mod instrument;
#[cfg(test)]
mod tests;
mod text;

pub use text::{SessionTextError, session_text};

use std::ops::Range;
use std::path::Path;

use nalgebra::{Cholesky, Matrix3, Vector3};
use serde::Deserialize;

use self::instrument::InstrumentTable;
use crate::LoadedMeasurements;
use crate::input::{InputError, Source, Spanned, quoted};
use crate::orientation::{Four, OrientationKeys, Square, Three, check_numbers, covariance_of};
use crate::payloads::{PayloadFile, PayloadTable, read_payloads};
use calibrig_model::Payload;
use calibrig_model::measurement::{
    Face, MeasurementSet, NestObservation, Reading, RegistrationError, SetKind, SphericalReading,
    StatedInstrument, Station, Target, register,
};

const SCHEMA: &str = "calibrig.session/1";

/// Contents of a `session.toml`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SessionFile {
    stations: Vec<Described<Station>>,
    targets: Vec<Described<Target>>,
    payloads: Vec<Described<Payload>>,
    dropped: Vec<(SetKind, u32, String)>,
}

/// A station, a target or a payload as the file describes it.
#[derive(Debug, Clone, PartialEq)]
struct Described<T> {
    /// The set that it belongs to; `None` for both.
    set: Option<SetKind>,
    item: T,
    /// Its name in the text.
    place: Range<usize>,
    /// Its nests in the text.
    nests: Vec<Range<usize>>,
}

impl<T> Described<T> {
    fn is_of(&self, kind: SetKind) -> bool {
        self.set.is_none_or(|set| set == kind)
    }
}

/// A set as a session file describes it: which, what was measured, and the poses that were not.
pub type SessionSet<'a> = (SetKind, &'a MeasurementSet, &'a [(u32, String)]);

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SessionTable {
    schema: Spanned<String>,
    #[serde(default)]
    station: Vec<StationTable>,
    #[serde(default)]
    target: Vec<TargetTable>,
    #[serde(default)]
    payload: Vec<Spanned<PayloadTable>>,
    #[serde(default)]
    dropped: Vec<DroppedTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StationTable {
    name: Spanned<String>,
    set: Option<Spanned<String>>,
    instrument: Option<InstrumentTable>,
    #[serde(default)]
    nest: Vec<Spanned<NestTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NestTable {
    name: Spanned<String>,
    time_s: Option<Spanned<f64>>,
    face: Option<Spanned<String>>,
    in_base_m: Three,
    in_base_sigma_m: Option<Spanned<f64>>,
    in_base_covariance_m2: Option<Square>,
    range_m: Option<Spanned<f64>>,
    az_rad: Option<Spanned<f64>>,
    el_rad: Option<Spanned<f64>>,
    sigma_range_m: Option<Spanned<f64>>,
    sigma_az_rad: Option<Spanned<f64>>,
    sigma_el_rad: Option<Spanned<f64>>,
    covariance_m_rad: Option<Square>,
    position_m: Option<Three>,
    sigma_m: Option<Spanned<f64>>,
    covariance_m2: Option<Square>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TargetTable {
    name: Spanned<String>,
    set: Option<Spanned<String>>,
    in_flange_m: Three,
    sigma_m: Option<Spanned<f64>>,
    covariance_m2: Option<Square>,
    rotation_quaternion_wxyz: Option<Four>,
    rotation_quaternion_xyzw: Option<Four>,
    rotation_vector_rad: Option<Three>,
    rotation_euler_rad: Option<Three>,
    rotation_sequence: Option<Spanned<String>>,
    rotation_matrix: Option<Square>,
    rotation_sigma_rad: Option<Spanned<f64>>,
    rotation_covariance_rad2: Option<Square>,
}

impl TargetTable {
    fn orientation(&self) -> OrientationKeys<'_> {
        OrientationKeys {
            quaternion_wxyz: self.rotation_quaternion_wxyz.as_ref(),
            quaternion_xyzw: self.rotation_quaternion_xyzw.as_ref(),
            vector_rad: self.rotation_vector_rad.as_ref(),
            euler_rad: self.rotation_euler_rad.as_ref(),
            sequence: self.rotation_sequence.as_ref(),
            matrix: self.rotation_matrix.as_ref(),
            sigma_rad: self.rotation_sigma_rad.as_ref(),
            covariance_rad2: self.rotation_covariance_rad2.as_ref(),
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DroppedTable {
    set: Spanned<String>,
    pose: u32,
    reason: String,
}

/// Reads a session file, with the text that it was read from.
pub fn load_session(path: &Path) -> Result<(SessionFile, Source), InputError> {
    let source = Source::read(path)?;
    Ok((parse_session(&source)?, source))
}

/// Reads a session file from a text in memory.
pub fn parse_session(source: &Source) -> Result<SessionFile, InputError> {
    let file: SessionTable = source.toml()?;
    if file.schema.get_ref() != SCHEMA {
        let message = format!("schema is {:?}", file.schema.get_ref());
        return Err(source.error(file.schema.span(), message, Some(format!("expected {SCHEMA:?}"))));
    }
    let reader = Reader { source };
    let mut session = SessionFile::default();
    for table in file.station {
        let station = reader.station(table, &session.stations)?;
        session.stations.push(station);
    }
    for table in file.target {
        let target = reader.target(table, &session.targets)?;
        session.targets.push(target);
    }
    session.payloads = reader.payloads(&file.payload)?;
    for table in file.dropped {
        session.dropped.push((reader.set(&table.set)?, table.pose, table.reason));
    }
    Ok(session)
}

struct Reader<'a> {
    source: &'a Source,
}

impl Reader<'_> {
    fn error(&self, span: Range<usize>, message: impl std::fmt::Display, expected: &str) -> InputError {
        self.source.error(span, message, Some(format!("expected {expected}")))
    }

    fn set(&self, key: &Spanned<String>) -> Result<SetKind, InputError> {
        SetKind::ALL.into_iter().find(|kind| kind.key() == key.get_ref()).ok_or_else(|| {
            let message = format!("set is {:?}", key.get_ref());
            self.error(key.span(), message, "identification or verification")
        })
    }

    fn some_set(&self, key: Option<&Spanned<String>>) -> Result<Option<SetKind>, InputError> {
        key.map(|key| self.set(key)).transpose()
    }

    /// Rows of a measurement file find their station and target by name.
    fn distinct<'n>(
        &self,
        what: &str,
        name: &Spanned<String>,
        set: Option<SetKind>,
        mut others: impl Iterator<Item = (Option<SetKind>, &'n str)>,
    ) -> Result<(), InputError> {
        let shared = |other: Option<SetKind>| set.is_none() || other.is_none() || set == other;
        if others.any(|(other, known)| known == name.get_ref() && shared(other)) {
            let message = format!("{what} {:?} appears twice", name.get_ref());
            return Err(self.error(name.span(), message, "distinct names in a set"));
        }
        Ok(())
    }

    fn station(
        &self,
        table: StationTable,
        known: &[Described<Station>],
    ) -> Result<Described<Station>, InputError> {
        let set = self.some_set(table.set.as_ref())?;
        self.distinct("station", &table.name, set, known.iter().map(|known| (known.set, &*known.item.name)))?;
        let mut nests: Vec<NestObservation> = Vec::with_capacity(table.nest.len());
        for nest in &table.nest {
            let read = self.nest(nest)?;
            self.distinct_nest(&nest.get_ref().name, &read, &nests)?;
            nests.push(read);
        }
        let instrument =
            table.instrument.as_ref().map(|stated| self.instrument(stated, known)).transpose()?;
        Ok(Described {
            set,
            place: table.name.span(),
            nests: table.nest.iter().map(Spanned::span).collect(),
            item: Station {
                name: table.name.into_inner(),
                nests,
                instrument,
                motion: None,
                sweeps: Vec::new(),
            },
        })
    }

    /// Stations whose instruments have one name share its errors, which must therefore be the same.
    fn instrument(
        &self,
        table: &InstrumentTable,
        stations: &[Described<Station>],
    ) -> Result<StatedInstrument, InputError> {
        let stated = table.read(self.source)?;
        for station in stations {
            let Some(known) = station.item.instrument.as_ref().filter(|known| known.name == stated.name)
            else {
                continue;
            };
            if let Some(difference) = instrument::difference(&stated, known) {
                let message = format!(
                    "instrument {:?} is stated differently at station {:?}: {difference}",
                    stated.name, station.item.name
                );
                let expected = "the same errors wherever an instrument is named; or a different name for a different instrument";
                return Err(self.error(table.name.span(), message, expected));
            }
        }
        Ok(stated)
    }

    /// A nest that is measured again has the same certified place, and another time or face.
    fn distinct_nest(
        &self,
        name: &Spanned<String>,
        nest: &NestObservation,
        others: &[NestObservation],
    ) -> Result<(), InputError> {
        for known in others.iter().filter(|known| known.name == nest.name) {
            let apart = (known.in_base - nest.in_base).norm();
            if apart > 0.0 {
                let message = format!(
                    "nest {:?} appears twice, with certified places {:.4} mm apart",
                    nest.name,
                    1e3 * apart
                );
                return Err(self.error(
                    name.span(),
                    message,
                    "the same certified place for one nest, or another name",
                ));
            }
            let differ = matches!((known.time, nest.time), (Some(a), Some(b)) if a != b);
            if !differ && known.reading.face() == nest.reading.face() {
                let message = format!("nest {:?} appears twice, but not at two different times", nest.name);
                let expected = "time_s of each measurement of a nest that is measured again, or another name";
                return Err(self.error(name.span(), message, expected));
            }
        }
        Ok(())
    }

    fn target(
        &self,
        table: TargetTable,
        known: &[Described<Target>],
    ) -> Result<Described<Target>, InputError> {
        let set = self.some_set(table.set.as_ref())?;
        self.distinct("target", &table.name, set, known.iter().map(|known| (known.set, &*known.item.name)))?;
        let in_flange = self.vector("in_flange_m", &table.in_flange_m)?;
        let covariance = self
            .spread(("sigma_m", table.sigma_m.as_ref()), ("covariance_m2", table.covariance_m2.as_ref()))?;
        let orientation = table.orientation().read(self.source)?;
        Ok(Described {
            set,
            place: table.name.span(),
            nests: Vec::new(),
            item: Target { name: table.name.into_inner(), in_flange, covariance, orientation },
        })
    }

    /// At most one for each set.
    fn payloads(&self, tables: &[Spanned<PayloadTable>]) -> Result<Vec<Described<Payload>>, InputError> {
        let read = read_payloads(self.source, tables, PayloadFile::Session)?;
        let mut payloads: Vec<Described<Payload>> = Vec::with_capacity(read.len());
        for (item, table) in read.into_iter().zip(tables) {
            let set = self.some_set(table.get_ref().set.as_ref())?;
            let described = Described { set, item, place: table.span(), nests: Vec::new() };
            for kind in SetKind::ALL {
                let Some(other) = payloads.iter().find(|other| other.is_of(kind) && described.is_of(kind))
                else {
                    continue;
                };
                let message = format!(
                    "payloads {:?} and {:?} are both said to be carried by all poses of the {} set",
                    other.item.name,
                    described.item.name,
                    kind.key()
                );
                let expected = "one per set; if poses carry different payloads, a column of the measurement file that names \
                                them";
                return Err(self.error(table.span(), message, expected));
            }
            payloads.push(described);
        }
        Ok(payloads)
    }

    fn face(&self, key: Option<&Spanned<String>>) -> Result<Face, InputError> {
        let Some(key) = key else { return Ok(Face::Front) };
        [Face::Front, Face::Back, Face::Both].into_iter().find(|face| face.key() == key.get_ref()).ok_or_else(
            || {
                self.error(
                    key.span(),
                    format!("face is {:?}", key.get_ref()),
                    "\"front\", \"back\", or \"both\" for the mean of the two",
                )
            },
        )
    }

    fn vector(&self, key: &str, value: &Three) -> Result<Vector3<f64>, InputError> {
        check_numbers(self.source, key, value.span(), value.get_ref().iter())?;
        Ok((*value.get_ref()).into())
    }

    fn covariance(&self, key: &str, value: &Square) -> Result<Matrix3<f64>, InputError> {
        covariance_of(self.source, key, value)
    }

    /// A covariance that is stated as a whole, or as the standard deviation of each axis.
    fn spread(
        &self,
        (sigma_key, sigma): (&str, Option<&Spanned<f64>>),
        (key, covariance): (&str, Option<&Square>),
    ) -> Result<Option<Matrix3<f64>>, InputError> {
        match (sigma, covariance) {
            (None, None) => Ok(None),
            (None, Some(covariance)) => self.covariance(key, covariance).map(Some),
            (Some(sigma), None) => {
                let sigma = self.source.not_negative(sigma_key, sigma)?;
                Ok(Some(Matrix3::from_diagonal_element(sigma * sigma)))
            }
            (Some(sigma), Some(_)) => {
                let message = format!("both {sigma_key} and {key} are given");
                Err(self.error(sigma.span(), message, "only one of them"))
            }
        }
    }

    fn nest(&self, table: &Spanned<NestTable>) -> Result<NestObservation, InputError> {
        let (nest, span) = (table.get_ref(), table.span());
        let in_base_covariance = self.spread(
            ("in_base_sigma_m", nest.in_base_sigma_m.as_ref()),
            ("in_base_covariance_m2", nest.in_base_covariance_m2.as_ref()),
        )?;
        let Some(in_base_covariance) = in_base_covariance else {
            let message = format!("nest {:?}: its certified place has no uncertainty", nest.name.get_ref());
            return Err(self.error(span, message, "in_base_sigma_m or in_base_covariance_m2"));
        };
        Ok(NestObservation {
            name: nest.name.get_ref().clone(),
            in_base: self.vector("in_base_m", &nest.in_base_m)?,
            in_base_covariance,
            reading: self.reading(nest, span)?,
            time: nest.time_s.as_ref().map(|time| self.source.finite("time_s", time)).transpose()?,
        })
    }

    fn reading(&self, nest: &NestTable, span: Range<usize>) -> Result<Reading, InputError> {
        let spherical = [nest.range_m.as_ref(), nest.az_rad.as_ref(), nest.el_rad.as_ref()];
        let refused = |message: &str| {
            let expected = "range_m, az_rad and el_rad, or position_m";
            Err(self.error(span.clone(), format!("nest {:?}: {message}", nest.name.get_ref()), expected))
        };
        match (&nest.position_m, spherical) {
            (Some(position), [None, None, None]) => {
                if let Some(face) = &nest.face {
                    let message = "face applies to range and angles, but this reading is a position";
                    return Err(self.error(face.span(), message, "range_m, az_rad and el_rad, or no face"));
                }
                let covariance = self.spread(
                    ("sigma_m", nest.sigma_m.as_ref()),
                    ("covariance_m2", nest.covariance_m2.as_ref()),
                )?;
                Ok(Reading::Cartesian { position: self.vector("position_m", position)?, covariance })
            }
            (None, [Some(range), Some(azimuth), Some(elevation)]) => {
                Ok(Reading::Spherical(SphericalReading {
                    range: self.source.positive("range_m", range)?,
                    azimuth: self.source.finite("az_rad", azimuth)?,
                    elevation: self.source.finite("el_rad", elevation)?,
                    covariance: Some(self.spherical_covariance(nest, span)?),
                    face: self.face(nest.face.as_ref())?,
                }))
            }
            (None, [None, None, None]) => refused("there is no reading"),
            (None, _) => refused("the reading is incomplete"),
            (Some(_), _) => refused("there are two readings"),
        }
    }

    fn spherical_covariance(&self, nest: &NestTable, span: Range<usize>) -> Result<Matrix3<f64>, InputError> {
        let sigmas = [nest.sigma_range_m.as_ref(), nest.sigma_az_rad.as_ref(), nest.sigma_el_rad.as_ref()];
        match (&nest.covariance_m_rad, sigmas) {
            (Some(covariance), [None, None, None]) => self.covariance("covariance_m_rad", covariance),
            (None, [Some(range), Some(azimuth), Some(elevation)]) => {
                let sigma = Vector3::new(
                    self.source.not_negative("sigma_range_m", range)?,
                    self.source.not_negative("sigma_az_rad", azimuth)?,
                    self.source.not_negative("sigma_el_rad", elevation)?,
                );
                Ok(Matrix3::from_diagonal(&sigma.component_mul(&sigma)))
            }
            _ => {
                let message = format!(
                    "nest {:?}: the uncertainty of its reading is missing or given twice",
                    nest.name.get_ref()
                );
                let expected = "either sigma_range_m, sigma_az_rad and sigma_el_rad, or covariance_m_rad";
                Err(self.error(span, message, expected))
            }
        }
    }
}

impl SessionFile {
    /// Adds what this file, whose text is `source`, states about the set `kind` to the contents of a measurement file. Stations and targets
    /// are then in the order of this file. If it describes no station (no target), those of the measurement file stay. If the measurement
    /// file does not name its only station (target), the described one is meant.
    ///
    /// # Errors
    /// Errors if the measurement file names a station or a target that is not described, or does not name one of several; or if it states
    /// itself what poses carry.
    pub fn complete(
        &self,
        source: &Source,
        kind: SetKind,
        loaded: &mut LoadedMeasurements,
    ) -> Result<(), InputError> {
        let find = |what: &str, name: &str, is_named: bool, described: &[&str]| {
            let by_name = described.iter().position(|known| *known == name);
            if let Some(place) = by_name.or((!is_named && described.len() == 1).then_some(0)) {
                return Ok(place);
            }
            if !is_named && described.len() > 1 {
                let message = format!(
                    "the {} set does not name its {what}, but {} are described: {}",
                    kind.key(),
                    described.len(),
                    described.join(", ")
                );
                let help =
                    format!("expected a column {what} in the measurement file, or only one [[{what}]]");
                return Err(source.error(self.places(what, kind), message, Some(help)));
            }
            let message = format!("{what} {name:?} of the {} set is not described", kind.key());
            let others = if described.is_empty() {
                String::new()
            } else {
                format!("; described are {}", described.join(", "))
            };
            let help = format!("expected [[{what}]] with name = {}{others}", quoted(name));
            Err(source.error(self.places(what, kind), message, Some(help)))
        };
        let set = &mut loaded.set;
        if let Some(stations) = of_set(&self.stations, kind) {
            let names: Vec<_> = stations.iter().map(|station| &*station.name).collect();
            for observation in &mut set.observations {
                let name = &set.stations[observation.station].name;
                observation.station = find("station", name, loaded.names_stations, &names)?;
            }
            set.stations = stations;
            loaded.names_stations = true;
        }
        if let Some(targets) = of_set(&self.targets, kind) {
            let names: Vec<_> = targets.iter().map(|target| &*target.name).collect();
            for observation in &mut set.observations {
                let name = &set.targets[observation.target].name;
                observation.target = find("target", name, loaded.names_targets, &names)?;
            }
            set.targets = targets;
            loaded.names_targets = true;
        }
        if let Some(payload) = self.payloads.iter().find(|known| known.is_of(kind)) {
            if let Some((observation, other)) =
                set.observations.iter().find_map(|o| Some((o, o.payload.as_ref()?)))
            {
                let message = format!(
                    "payload {:?} is said to be carried by all poses of the {} set, but pose {} of its measurement file \
                     carries {:?}",
                    payload.item.name,
                    kind.key(),
                    observation.pose,
                    other.name
                );
                let help = "expected only one of them: this table, or the payloads of the measurement file"
                    .to_owned();
                return Err(source.error(payload.place.clone(), message, Some(help)));
            }
            for observation in &mut set.observations {
                observation.payload = Some(payload.item.clone());
            }
        }
        let dropped = self.dropped.iter().filter(|(set, ..)| *set == kind);
        let dropped = dropped.map(|(_, pose, reason)| (*pose, reason.clone()));
        loaded.dropped = dropped.chain(std::mem::take(&mut loaded.dropped)).collect();
        Ok(())
    }

    /// Where the first station (target) of the set is described; the start of the text if none is.
    fn places(&self, what: &str, kind: SetKind) -> Range<usize> {
        let of_set = |(known, place): (bool, &Range<usize>)| known.then(|| place.clone());
        let first = match what {
            "station" => self.stations.iter().map(|known| (known.is_of(kind), &known.place)).find_map(of_set),
            _ => self.targets.iter().map(|known| (known.is_of(kind), &known.place)).find_map(of_set),
        };
        first.unwrap_or(0..0)
    }

    /// The payloads that it describes, one per `[[payload]]`, of whichever set.
    pub fn payloads(&self) -> impl Iterator<Item = &Payload> {
        self.payloads.iter().map(|described| &described.item)
    }

    /// Whether it describes targets; then it describes all.
    pub fn describes_targets(&self) -> bool {
        !self.targets.is_empty()
    }

    /// Refuses what an identification cannot use, in the text `source`: nests that do not place their station, and an uncertainty of a target
    /// that is not positive definite.
    ///
    /// # Errors
    /// Errors if the station has nests, but fewer than three, or all on one line, or one without an uncertainty; or if the covariance of the target
    /// is not positive definite.
    pub fn check_usable(&self, source: &Source) -> Result<(), InputError> {
        for Described { item: station, place, nests, .. } in
            self.stations.iter().filter(|known| !known.item.nests.is_empty())
        {
            let Err(error) = register(station) else { continue };
            let (place, expected) = match &error {
                RegistrationError::Covariance { nest } => {
                    let at = station.nests.iter().position(|known| known.name == *nest);
                    let at = at.and_then(|at| nests.get(at)).unwrap_or(place);
                    (
                        at,
                        "an uncertainty of the reading and of the certified place above zero in every direction",
                    )
                }
                _ => (
                    place,
                    "three nests or more that are not on one line, or no nests: then the station's place is identified",
                ),
            };
            let message = format!("station {:?}: {error}{}", station.name, on_one_line(station, &error));
            return Err(source.error(place.clone(), message, Some(format!("expected {expected}"))));
        }
        for Described { item: target, place, .. } in &self.targets {
            if target.covariance.is_some_and(|covariance| Cholesky::new(covariance).is_none()) {
                let message =
                    format!("target {:?}: its uncertainty is not above zero in every direction", target.name);
                let expected = "expected sigma_m or covariance_m2 of a measured offset, or neither: then it is identified";
                return Err(source.error(place.clone(), message, Some(expected.to_owned())));
            }
            let turn = target.orientation.as_ref().and_then(|orientation| orientation.covariance);
            if turn.is_some_and(|covariance| Cholesky::new(covariance).is_none()) {
                let message = format!(
                    "target {:?}: the uncertainty of its rotation is not above zero in every direction",
                    target.name
                );
                let expected = "expected rotation_sigma_rad or rotation_covariance_rad2 of a measured rotation, or neither: then it is identified";
                return Err(source.error(place.clone(), message, Some(expected.to_owned())));
            }
        }
        Ok(())
    }
}

/// Which nests lie on one line, and how close to it.
fn on_one_line(station: &Station, error: &RegistrationError) -> String {
    let nests = &station.nests;
    let far = |from: &NestObservation| {
        let away = |nest: &NestObservation| (nest.in_base - from.in_base).norm();
        nests.iter().max_by(|a, b| away(a).total_cmp(&away(b)))
    };
    let ends = nests.first().and_then(far).and_then(|end| Some((end, far(end)?)));
    let (RegistrationError::OnOneLine, Some((one, other))) = (error, ends) else { return String::new() };
    let mut names: Vec<&str> = Vec::new();
    for nest in nests {
        if !names.contains(&&*nest.name) {
            names.push(&nest.name);
        }
    }
    let along = other.in_base - one.in_base;
    let off = |nest: &NestObservation| match along.try_normalize(0.0) {
        Some(along) => (nest.in_base - one.in_base).cross(&along).norm(),
        None => 0.0,
    };
    let off = nests.iter().map(off).fold(0.0, f64::max);
    format!(" ({} lie on it within {:.3} mm)", names.join(", "), 1e3 * off)
}

/// Those of one set; `None` if the file describes none at all.
fn of_set<T: Clone>(described: &[Described<T>], kind: SetKind) -> Option<Vec<T>> {
    let own = described.iter().filter(|known| known.is_of(kind));
    (!described.is_empty()).then(|| own.map(|known| known.item.clone()).collect())
}
