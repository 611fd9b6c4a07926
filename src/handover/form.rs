//! `calibrig.estimate/1` as it is in the file.

use nalgebra::{DMatrix, Rotation3, Vector3};
use serde::{Deserialize, Serialize};

use calibrig_estimation::identification::{
    Assumption, CalibratedRobot, Contradiction, DependentGroup, Estimate, InstrumentErrors, IterationRecord,
    LeftOut, MachineNoise, Mode, NoiseScale, Outlier, ParameterBound, ParameterEstimate, Spectrum,
    TerminationReason, Warning,
};
use calibrig_model::float;
use calibrig_model::geometry::Transform;
use calibrig_model::{CalibrationModel, ParameterId, TermId};

use super::{EstimateFile, FittedRobot, MadeFrom, Region};

/// The only schema that is read.
pub(super) const SCHEMA: &str = "calibrig.estimate/1";

#[derive(Serialize, Deserialize)]
pub(super) struct Form {
    pub schema: String,
    pub software: Software,
    pub mode: Mode,
    pub input: MadeFrom,
    pub robot: FittedRobot,
    pub region: Region,
    pub parameters: Vec<Parameter>,
    pub covariance: Option<Vec<Vec<f64>>>,
    pub covariance_factor: Option<Vec<Vec<f64>>>,
    pub noise: Noise,
    pub terms: Vec<Term>,
    pub stations: Vec<Station>,
    pub targets: Vec<Target>,
    pub instruments: Vec<InstrumentErrors>,
    pub fit: FitRecord,
    pub nominal: CalibrationModel,
    pub calibrated: CalibrationModel,
}

#[derive(Serialize, Deserialize)]
pub(super) struct Software {
    pub version: String,
    pub method: u32,
}

#[derive(Serialize, Deserialize)]
pub(super) struct Parameter {
    pub name: ParameterId,
    pub unit: String,
    pub value: f64,
    pub deviation_from: String,
    pub nominal: Option<f64>,
    pub calibrated: Option<f64>,
    pub sigma: Option<f64>,
    pub stated_sigma: Option<f64>,
    pub prior_sigma: Option<f64>,
}

/// A number that may be infinite.
#[derive(Serialize, Deserialize)]
#[serde(transparent)]
pub(super) struct Number(#[serde(with = "float::scalar")] f64);

#[derive(Serialize, Deserialize)]
pub(super) struct Noise {
    readings: NoiseScale,
    reading_scale: Option<f64>,
    machine: Vec<NoiseOfMachine>,
    orientation_rad: Option<f64>,
    interval_degrees_of_freedom: Option<Number>,
}

#[derive(Serialize, Deserialize)]
struct NoiseOfMachine {
    position_m: f64,
    actuators: Vec<f64>,
    degrees_of_freedom: Option<Number>,
}

#[derive(Serialize, Deserialize)]
pub(super) struct Term {
    pub name: TermId,
    pub unit: String,
    pub amplitude: f64,
}

#[derive(Serialize, Deserialize)]
pub(super) struct Station {
    name: String,
    tracker_from_base: Transform,
}

#[derive(Serialize, Deserialize)]
pub(super) struct Target {
    name: String,
    in_flange_m: Vector3<f64>,
    flange_from_target: Option<Rotation3<f64>>,
}

/// Facts about the fit; predictions do not need them.
#[derive(Serialize, Deserialize)]
pub(super) struct FitRecord {
    #[serde(with = "float::scalar")]
    chi2: f64,
    #[serde(with = "float::scalar")]
    degrees_of_freedom: f64,
    termination: TerminationReason,
    warnings: Vec<Warning>,
    at_bound: Vec<ParameterId>,
    contradicted: Vec<Contradiction>,
    held: Vec<DependentGroup>,
    fixed: Vec<DependentGroup>,
    left_out: Vec<LeftOut>,
    bounds: Vec<ParameterBound>,
    assumptions: Vec<Assumption>,
    outliers: Vec<Outlier>,
    spectrum: Spectrum,
    weights: Vec<f64>,
    #[serde(with = "float::scalar")]
    weight_unit: f64,
    iterations: Vec<IterationRecord>,
}

/// The value to which a parameter is added, or which it multiplies.
fn deviation_from(id: ParameterId) -> &'static str {
    match id {
        ParameterId::Link { .. } | ParameterId::Linkage(_) | ParameterId::Centre { .. } => "nominal",
        ParameterId::Compliance(_) => "nominal compliance, relative",
        ParameterId::Mass { .. } => "nominal mass, relative",
        ParameterId::Frame { .. } => "registration",
        ParameterId::Target { .. } | ParameterId::Orientation { .. } => "stated",
        ParameterId::Term(_) | ParameterId::Instrument { .. } | ParameterId::Drift { .. } => "zero",
    }
}

/// The value in a model of a parameter with a unit.
fn in_model(model: &CalibrationModel, id: ParameterId) -> Option<f64> {
    match id {
        ParameterId::Link { link, term } => model.kinematics.links.get(link).map(|link| link.term(term)),
        ParameterId::Linkage(term) => model.actuators.linkage_term(term),
        ParameterId::Centre { link, axis } => {
            model.statics.as_ref()?.bodies.get(link)?.centre_of_mass.get(axis).copied()
        }
        _ => None,
    }
}

fn by_rows(matrix: &DMatrix<f64>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

/// A matrix with this number of rows; `None` if it has another number, or rows of different lengths.
fn matrix(rows: &[Vec<f64>], count: usize, columns: Option<usize>) -> Option<DMatrix<f64>> {
    let width = columns.or_else(|| rows.first().map(Vec::len)).unwrap_or(0);
    let fits = rows.len() == count && rows.iter().all(|row| row.len() == width);
    fits.then(|| DMatrix::from_row_iterator(count, width, rows.iter().flatten().copied()))
}

impl Form {
    pub fn of(file: &EstimateFile) -> Self {
        let estimate = &file.estimate;
        let robot = &estimate.robot;
        let parameter = |p: &ParameterEstimate| Parameter {
            name: p.id,
            unit: p.id.unit().to_string(),
            value: p.value,
            deviation_from: deviation_from(p.id).to_owned(),
            nominal: in_model(&robot.nominal, p.id),
            calibrated: in_model(&robot.model, p.id),
            sigma: p.sigma,
            stated_sigma: p.stated_sigma,
            prior_sigma: p.prior_sigma,
        };
        let name = |names: &[String], index: usize| names.get(index).cloned().unwrap_or_default();
        let machine = |noise: &MachineNoise| NoiseOfMachine {
            position_m: noise.position,
            actuators: noise.actuators.clone(),
            degrees_of_freedom: noise.freedom.map(Number),
        };
        Self {
            schema: SCHEMA.to_owned(),
            software: Software { version: file.software.clone(), method: file.method },
            mode: robot.mode,
            input: file.input.clone(),
            robot: file.robot.clone(),
            region: file.region.clone(),
            parameters: estimate.parameters.iter().map(parameter).collect(),
            covariance: estimate.covariance.as_ref().map(by_rows),
            covariance_factor: estimate.factor.as_ref().map(by_rows),
            noise: Noise {
                readings: estimate.noise,
                reading_scale: estimate.reading_scale,
                machine: estimate.machine_noise.iter().map(machine).collect(),
                orientation_rad: estimate.turn_noise,
                interval_degrees_of_freedom: estimate.interval_freedom.map(Number),
            },
            terms: robot
                .terms
                .iter()
                .map(|(name, amplitude)| Term {
                    name: *name,
                    unit: name.unit().to_string(),
                    amplitude: *amplitude,
                })
                .collect(),
            stations: robot
                .stations
                .iter()
                .enumerate()
                .map(|(index, place)| Station {
                    name: name(&file.stations, index),
                    tracker_from_base: *place,
                })
                .collect(),
            targets: robot
                .targets
                .iter()
                .enumerate()
                .map(|(index, offset)| Target {
                    name: name(&file.targets, index),
                    in_flange_m: *offset,
                    flange_from_target: robot.orientations.get(index).copied().flatten(),
                })
                .collect(),
            instruments: robot.instruments.clone(),
            fit: FitRecord {
                chi2: estimate.chi2,
                degrees_of_freedom: estimate.degrees_of_freedom,
                termination: estimate.termination,
                warnings: estimate.warnings.clone(),
                at_bound: estimate.at_bound.clone(),
                contradicted: estimate.contradicted.clone(),
                held: estimate.held.clone(),
                fixed: estimate.fixed.clone(),
                left_out: estimate.left_out.clone(),
                bounds: estimate.bounds.clone(),
                assumptions: estimate.assumptions.clone(),
                outliers: estimate.outliers.clone(),
                spectrum: estimate.spectrum.clone(),
                weights: estimate.weights.clone(),
                weight_unit: estimate.weight_unit,
                iterations: estimate.iterations.clone(),
            },
            nominal: robot.nominal.clone(),
            calibrated: robot.model.clone(),
        }
    }

    /// The estimate; or the key that is wrong, what is wrong with it, and what was expected.
    pub fn into_file(self) -> Result<EstimateFile, (&'static str, String, String)> {
        let count = self.parameters.len();
        let square = format!("{count} rows of {count} numbers, in the order of parameters");
        let covariance = match &self.covariance {
            None => None,
            Some(rows) => match matrix(rows, count, Some(count)) {
                None => {
                    return Err((
                        "covariance",
                        format!("{} rows for {count} parameters", rows.len()),
                        square,
                    ));
                }
                some => some,
            },
        };
        let factor = match &self.covariance_factor {
            None => None,
            Some(rows) => match matrix(rows, count, None) {
                None => {
                    let message =
                        format!("{} rows for {count} parameters, or rows of different lengths", rows.len());
                    return Err((
                        "covariance_factor",
                        message,
                        format!("{count} rows of as many numbers each"),
                    ));
                }
                some => some,
            },
        };
        for parameter in &self.parameters {
            let unit = parameter.name.unit().to_string();
            if parameter.unit != unit {
                let message = format!("{} has the unit {:?}", parameter.name, parameter.unit);
                return Err(("parameters", message, format!("{unit:?}, the unit of its value")));
            }
        }
        let estimated = |p: Parameter| ParameterEstimate {
            id: p.name,
            value: p.value,
            sigma: p.sigma,
            stated_sigma: p.stated_sigma,
            prior_sigma: p.prior_sigma,
        };
        let machine = |noise: NoiseOfMachine| MachineNoise {
            position: noise.position_m,
            actuators: noise.actuators,
            freedom: noise.degrees_of_freedom.map(|number| number.0),
        };
        let turns: Vec<_> = self.targets.iter().map(|target| target.flange_from_target).collect();
        let fit = self.fit;
        Ok(EstimateFile {
            software: self.software.version,
            method: self.software.method,
            input: self.input,
            robot: self.robot,
            region: self.region,
            stations: self.stations.iter().map(|station| station.name.clone()).collect(),
            targets: self.targets.iter().map(|target| target.name.clone()).collect(),
            estimate: Estimate {
                robot: CalibratedRobot {
                    mode: self.mode,
                    nominal: self.nominal,
                    model: self.calibrated,
                    terms: self.terms.iter().map(|term| (term.name, term.amplitude)).collect(),
                    stations: self.stations.iter().map(|station| station.tracker_from_base).collect(),
                    targets: self.targets.iter().map(|target| target.in_flange_m).collect(),
                    instruments: self.instruments,
                    orientations: turns,
                },
                parameters: self.parameters.into_iter().map(estimated).collect(),
                covariance,
                factor,
                weights: fit.weights,
                weight_unit: fit.weight_unit,
                noise: self.noise.readings,
                reading_scale: self.noise.reading_scale,
                machine_noise: self.noise.machine.into_iter().map(machine).collect(),
                turn_noise: self.noise.orientation_rad,
                interval_freedom: self.noise.interval_degrees_of_freedom.map(|number| number.0),
                chi2: fit.chi2,
                degrees_of_freedom: fit.degrees_of_freedom,
                termination: fit.termination,
                iterations: fit.iterations,
                spectrum: fit.spectrum,
                held: fit.held,
                fixed: fit.fixed,
                left_out: fit.left_out,
                bounds: fit.bounds,
                at_bound: fit.at_bound,
                contradicted: fit.contradicted,
                outliers: fit.outliers,
                assumptions: fit.assumptions,
                warnings: fit.warnings,
            },
        })
    }
}
