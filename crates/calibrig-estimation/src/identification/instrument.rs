//! Errors that all readings of an instrument share, as parameters of the fit.
//!
//! What is stated of an instrument is a zero-mean prior on each of its errors. Readings of the robot and of the nests have a column for each, so that
//! nests no longer place a station better than the instrument that saw them: they, the robot and the data sheet are solved together.

use nalgebra::{DMatrix, DVector};

use super::factor::triangular_factor_of_all;
use super::options::InstrumentChoice;
use super::problem::{Prior, Row};
use super::{IdentificationOptions, IdentifyError};
use calibrig_model::ParameterId;
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{
    InstrumentTerm, MeasurementSet, Observation, StatedInstrument, Station, nest_system,
};

/// The errors of all instruments that the stations name.
pub(super) fn parameters_of(stations: &[Station]) -> Vec<ParameterId> {
    let (known, _) = StatedInstrument::of_stations(stations);
    let of = |(instrument, stated): (usize, &&StatedInstrument)| {
        stated.errors().map(move |(term, _)| ParameterId::Instrument { instrument, term }).collect::<Vec<_>>()
    };
    known.iter().enumerate().flat_map(of).collect()
}

/// The errors that are parameters, with their columns.
#[derive(Debug, Default)]
pub(super) struct Instruments {
    /// One list an instrument: the error, its column and the standard deviation of its prior.
    columns: Vec<Vec<(InstrumentTerm, usize, f64)>>,
    /// Of every station, the index of its instrument.
    own: Vec<Option<usize>>,
}

impl Instruments {
    /// Appends the errors to `parameters`, and their priors to `priors`.
    pub fn new(
        set: &MeasurementSet,
        options: &IdentificationOptions,
        parameters: &mut Vec<ParameterId>,
        priors: &mut Vec<Prior>,
    ) -> Self {
        if options.instrument == InstrumentChoice::Ignored {
            return Self { columns: Vec::new(), own: vec![None; set.stations.len()] };
        }
        let (known, own) = StatedInstrument::of_stations(&set.stations);
        let mut columns = Vec::new();
        for (instrument, stated) in known.into_iter().enumerate() {
            let mut of_one = Vec::new();
            for (term, sigma) in stated.errors() {
                let id = ParameterId::Instrument { instrument, term };
                if options.fix.contains(&id) {
                    continue;
                }
                priors.push(Prior {
                    columns: vec![parameters.len()],
                    whitening: DMatrix::from_element(1, 1, 1.0 / sigma),
                    offset: DVector::zeros(1),
                });
                of_one.push((term, parameters.len(), sigma));
                parameters.push(id);
            }
            columns.push(of_one);
        }
        Self { columns, own }
    }

    /// The errors of a station's instrument.
    fn of(&self, station: usize) -> &[(InstrumentTerm, usize, f64)] {
        let own = self.own.get(station).copied().flatten();
        own.and_then(|instrument| self.columns.get(instrument)).map_or(&[], Vec::as_slice)
    }

    /// Gives the rows of observations their columns.
    pub fn add_to(&self, rows: &mut [Row], observations: &[Observation]) {
        for (row, observation) in rows.iter_mut().zip(observations) {
            let displaced = |(term, column, _): &(InstrumentTerm, usize, f64)| {
                (*column, observation.reading.displaced_by(*term))
            };
            row.instrument = self.of(row.station).iter().map(displaced).collect();
        }
    }

    /// What the nests of a station say of its place, whose columns begin at `frame`, and of its instrument's errors; `None` of a station without.
    ///
    /// `place` is where the nests put the station if the instrument has none. From there on the system is linear to rounding: what an instrument's errors
    /// move it is some hundredths of a millimetre.
    pub fn nests(
        &self,
        (index, station): (usize, &Station),
        place: &Transform,
        frame: usize,
    ) -> Result<Option<Prior>, IdentifyError> {
        let own = self.of(index);
        if own.is_empty() {
            return Ok(None);
        }
        let nests = nest_system(station, place)
            .map_err(|source| IdentifyError::Registration { station: station.name.clone(), source })?;
        let told: Vec<_> = station.instrument.iter().flat_map(StatedInstrument::errors).collect();
        let n = 6 + own.len();
        let mut system = nests.jacobian.insert_columns(6, own.len() + 1, 0.0);
        for (column, (term, ..)) in (6..).zip(own) {
            if let Some(place) = told.iter().position(|(other, _)| other == term) {
                system.column_mut(column).copy_from(&nests.instrument.column(place));
            }
        }
        system.column_mut(n).copy_from(&nests.residuals);
        // What is left below are the residuals that neither place nor errors can take up: no parameter changes them.
        let r = triangular_factor_of_all(system.as_view());
        let rows = r.nrows().min(n);
        let columns = (frame..frame + 6).chain(own.iter().map(|(_, column, _)| *column)).collect();
        let whitening = r.view((0, 0), (rows, n)).into_owned();
        let offset = DVector::from_iterator(rows, r.column(n).iter().copied().take(rows));
        Ok(Some(Prior { columns, whitening, offset }))
    }

    /// The errors of every station's instrument where the parameters are `x`; empty where none is a parameter.
    pub fn at(
        set: &MeasurementSet,
        parameters: &[ParameterId],
        x: &[f64],
    ) -> Vec<Vec<(InstrumentTerm, f64)>> {
        let identified: Vec<_> = parameters
            .iter()
            .zip(x)
            .filter_map(|(id, value)| match *id {
                ParameterId::Instrument { instrument, term } => Some((instrument, term, *value)),
                _ => None,
            })
            .collect();
        if identified.is_empty() {
            return Vec::new();
        }
        let (_, own) = StatedInstrument::of_stations(&set.stations);
        let of = |station: &Option<usize>| {
            let own = identified.iter().filter(|(instrument, ..)| Some(*instrument) == *station);
            own.map(|(_, term, value)| (*term, *value)).collect()
        };
        own.iter().map(of).collect()
    }
}
