//! Errors that all readings of an instrument share, as parameters of the fit.
//!
//! What is stated of an instrument is a zero-mean prior on each of its errors. Readings of the robot and of the nests have a column for each error,
//! so that nests do not place a station better than the instrument allows: nests, robot and data sheet are solved together.

use nalgebra::{DMatrix, DVector, Vector3};

use super::factor::triangular_factor_of_all;
use super::options::InstrumentChoice;
use super::problem::{PositionRow, Prior};
use super::robot::{InstrumentErrors, drift_displacement};
use super::{IdentificationOptions, IdentifyError, Mode};
use calibrig_model::ParameterId;
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{
    DRIFT_UNIT, MeasurementSet, Observation, StatedInstrument, Station, nest_system,
};

/// The errors of all instruments that the stations name, and the drift of the stations, each with the standard deviation of its prior.
fn stated(stations: &[Station]) -> Vec<(ParameterId, f64)> {
    let (known, _) = StatedInstrument::of_stations(stations);
    let of = |(instrument, stated): (usize, &&StatedInstrument)| {
        let own =
            stated.errors().map(move |(term, sigma)| (ParameterId::Instrument { instrument, term }, sigma));
        own.collect::<Vec<_>>()
    };
    let drift = |(station, of): (usize, &Station)| {
        let drift = of.instrument.as_ref().and_then(|stated| stated.drift);
        let sigma = move |component| drift.map_or(0.0, |drift| drift.sigma(component));
        let own = (0..6).map(move |component| (ParameterId::Drift { station, component }, sigma(component)));
        own.filter(|(_, sigma)| *sigma > 0.0).collect::<Vec<_>>()
    };
    let errors = known.iter().enumerate().flat_map(of);
    errors.chain(stations.iter().enumerate().flat_map(drift)).collect()
}

/// The parameters of all instruments that the stations name.
pub(super) fn parameters_of(stations: &[Station]) -> Vec<ParameterId> {
    stated(stations).into_iter().map(|(id, _)| id).collect()
}

/// The errors that are parameters, with their columns.
#[derive(Debug, Default)]
pub(super) struct Instruments {
    columns: Vec<(ParameterId, usize)>,
    /// Index of the instrument of every station.
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
        // Errors of the nominal robot would be attributed to the instrument.
        if options.instrument == InstrumentChoice::Ignored || options.mode == Mode::WithoutCalibration {
            return Self { columns: Vec::new(), own: vec![None; set.stations.len()] };
        }
        let mut columns = Vec::new();
        for (id, sigma) in stated(&set.stations) {
            if options.fix.contains(&id) {
                continue;
            }
            priors.push(Prior {
                columns: vec![parameters.len()],
                whitening: DMatrix::from_element(1, 1, 1.0 / sigma),
                offset: DVector::zeros(1),
            });
            columns.push((id, parameters.len()));
            parameters.push(id);
        }
        Self { columns, own: StatedInstrument::of_stations(&set.stations).1 }
    }

    /// The errors of a station's instrument, and its drift.
    pub fn of(&self, station: usize) -> Vec<(ParameterId, usize)> {
        let instrument = self.own.get(station).copied().flatten();
        let is_own = |(id, _): &&(ParameterId, usize)| match *id {
            ParameterId::Instrument { instrument: own, .. } => Some(own) == instrument,
            ParameterId::Drift { station: own, .. } => own == station,
            _ => false,
        };
        self.columns.iter().filter(is_own).copied().collect()
    }

    /// Adds the instruments' columns to the rows of observations.
    pub fn add_to<'a>(
        &self,
        rows: &mut [PositionRow],
        observations: impl Iterator<Item = &'a Observation>,
        set: &MeasurementSet,
        places: &[Transform],
    ) {
        let own: Vec<_> = (0..set.stations.len()).map(|station| self.of(station)).collect();
        let placed_at: Vec<f64> = set.stations.iter().map(Station::placed_at).collect();
        for (row, observation) in rows.iter_mut().zip(observations) {
            let station = observation.station;
            let hours = (observation.time - placed_at[station]) / DRIFT_UNIT;
            let seen = observation.reading.position();
            let displaced = |(id, column): &(ParameterId, usize)| {
                let by = match *id {
                    ParameterId::Instrument { term, .. } => observation.reading.displaced_by(term),
                    ParameterId::Drift { component, .. } => {
                        drift_displacement(component, &seen, &places[station]) * hours
                    }
                    _ => Vector3::zeros(),
                };
                (*column, by)
            };
            row.instrument = own[station].iter().map(displaced).collect();
            row.hours = hours;
        }
    }

    /// The prior that the nests of a station give for its place, whose columns begin at `frame`, and for its instrument's errors; `None` for a
    /// station without nests.
    ///
    /// `place` is where the nests put the station if the instrument has no errors. From there on the system is linear to rounding: an instrument's
    /// errors move it by some hundredths of a millimetre.
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
        for (column, (id, _)) in (6..).zip(&own) {
            match *id {
                ParameterId::Drift { component, .. } => {
                    system.column_mut(column).copy_from(&nests.drift.column(component));
                }
                ParameterId::Instrument { term, .. } => {
                    if let Some(place) = told.iter().position(|(other, _)| *other == term) {
                        system.column_mut(column).copy_from(&nests.instrument.column(place));
                    }
                }
                _ => {}
            }
        }
        system.column_mut(n).copy_from(&nests.residuals);
        // The rows below are residuals that neither place nor errors can absorb: no parameter changes them.
        let r = triangular_factor_of_all(system.as_view());
        let rows = r.nrows().min(n);
        let columns = (frame..frame + 6).chain(own.iter().map(|(_, column)| *column)).collect();
        let whitening = r.view((0, 0), (rows, n)).into_owned();
        let offset = DVector::from_iterator(rows, r.column(n).iter().copied().take(rows));
        Ok(Some(Prior { columns, whitening, offset }))
    }

    /// Errors of every station's instrument at the parameters `x`; empty where none is a parameter.
    pub fn at(set: &MeasurementSet, parameters: &[ParameterId], x: &[f64]) -> Vec<InstrumentErrors> {
        let is_one =
            |id: &ParameterId| matches!(id, ParameterId::Instrument { .. } | ParameterId::Drift { .. });
        if !parameters.iter().any(is_one) {
            return Vec::new();
        }
        let (_, own) = StatedInstrument::of_stations(&set.stations);
        let mut errors: Vec<_> = set
            .stations
            .iter()
            .map(|station| InstrumentErrors { placed_at: station.placed_at(), ..InstrumentErrors::default() })
            .collect();
        for (id, value) in parameters.iter().zip(x) {
            match *id {
                ParameterId::Drift { station, component } => errors[station].drift[component] = *value,
                ParameterId::Instrument { instrument, term } => {
                    let stations = errors.iter_mut().zip(&own).filter(|(_, own)| **own == Some(instrument));
                    stations.for_each(|(errors, _)| errors.shared.push((term, *value)));
                }
                _ => {}
            }
        }
        errors
    }
}
