//! From a model, measurements and options to the problem that the solver is given.

use nalgebra::{Cholesky, DMatrix, DVector, Matrix3, Vector3};

use super::factor::triangular_factor;
use super::machine::Machine;
use super::noise::{MachineNoise, MachineNoiseChoice, Noise, poses};
use super::parameters::{Column, Columns, columns};
use super::place::{Ends, best_fit_station, starting_offsets};
use super::problem::{CalibrationProblem, Current, Prior, Row};
use super::{
    DependentGroup, FrameChoice, IdentificationOptions, IdentifyError, LeastSquares, Redundancy,
    TargetChoice, select_independent,
};
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{MeasurementSet, Observation, register};
use calibrig_model::{CalibrationModel, ParameterId};

/// A compliance whose prior's standard deviation moves the whitened measurements by less than this in all, beside what the geometry can
/// do as well, is not told by them: its own standard deviation stays above 0.89 of its prior's.
const UNEXCITED: f64 = 0.5;

/// A problem, and what was decided on the way to it.
#[derive(Debug, Clone)]
pub(super) struct Built {
    pub problem: CalibrationProblem,
    /// Standard deviation of every parameter's own prior.
    pub sigmas: Vec<Option<f64>>,
    /// Compliances that the user named and gravity does not load.
    pub unexcited: Vec<ParameterId>,
    /// Parameters that were left out as redundant.
    pub fixed: Vec<DependentGroup>,
    /// All parameters that were left out: those, and what gravity does not load.
    pub left_out: Vec<ParameterId>,
    /// Where the search starts: zero, but for targets whose nominal place tells nothing of the tracker's.
    pub x: Vec<f64>,
}

/// The problem of `options`, with what gravity does not excite left out, and what is redundant where it shall be fixed.
pub(super) fn build(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
) -> Result<Built, IdentifyError> {
    let Columns { robot: mut columns, redundant_ends } =
        columns(model, options, options.freedom(&set.stations, &set.targets))?;
    let ends = Ends::new(set, options, &redundant_ends);
    let mut built = assemble(model, set, options, &columns, &ends)?;
    if !options.mode.is_coupled() && options.redundant != Redundancy::Fix {
        return Ok(built);
    }
    let (residuals, mut jacobian) = start(&mut built.problem, &built.x)?;
    let measured = Measured::new(&built.problem, &jacobian);
    let effects = measured.effects_beyond_geometry();
    let is_unexcited = |(column, effect): (&Column, &f64)| {
        matches!(column.id, ParameterId::Compliance(_)) && effect * column.sigma.unwrap_or(1.0) < UNEXCITED
    };
    let unexcited: Vec<bool> = columns.iter().zip(&effects).map(is_unexcited).collect();
    let named = columns.iter().zip(&unexcited).filter(|(column, unexcited)| column.named && **unexcited);
    let named: Vec<_> = named.map(|(column, _)| column.id).collect();
    let mut fixed = Vec::new();
    if options.redundant == Redundancy::Fix {
        fixed = redundant(&measured.r, &measured.parameters);
    }
    let stays = |(column, unexcited): (&Column, &bool)| {
        !fixed.iter().any(|group| group.redundant == column.id) && (column.named || !unexcited)
    };
    let stays: Vec<bool> = columns.iter().zip(&unexcited).map(stays).collect();
    let dropped: Vec<usize> = (0..columns.len()).filter(|place| !stays[*place]).collect();
    let dropped_ids: Vec<_> = dropped.iter().map(|place| columns[*place].id).collect();
    if !dropped.is_empty() {
        let mut stays = stays.iter();
        columns.retain(|_| stays.next() == Some(&true));
        built = assemble(model, set, options, &columns, &ends)?;
        // The robot's own parameters are the first.
        jacobian = jacobian.remove_columns_at(&dropped);
    }
    // What is left of a group are the robot's own parameters: frame and target stay in the fit.
    fixed.retain(|group| !columns.iter().any(|column| column.id == group.redundant));
    if built.x.iter().all(|value| *value == 0.0) {
        built.problem.start_from(residuals, jacobian);
    }
    built.fixed.extend(fixed);
    built.left_out.extend(dropped_ids);
    Ok(Built { unexcited: named, ..built })
}

/// The triangular factor of observations, nests and targets, with the columns of links, frame and target first.
struct Measured {
    r: DMatrix<f64>,
    /// Of the columns of `r`, in their order; the first `geometric` are of links, frame and target.
    parameters: Vec<ParameterId>,
    geometric: usize,
    /// Of every column of `r`, its place in the problem.
    places: Vec<usize>,
}

impl Measured {
    fn new(problem: &CalibrationProblem, jacobian: &DMatrix<f64>) -> Self {
        let is_geometric = |column: &usize| {
            let id = problem.parameters[*column];
            matches!(id, ParameterId::Link { .. } | ParameterId::Frame { .. } | ParameterId::Target { .. })
        };
        let (mut places, others): (Vec<usize>, Vec<usize>) =
            (0..problem.parameters.len()).partition(is_geometric);
        let geometric = places.len();
        places.extend(others);
        Self {
            r: triangular_factor(jacobian.rows(0, problem.measured_rows()).as_view(), &places),
            parameters: places.iter().map(|place| problem.parameters[*place]).collect(),
            geometric,
            places,
        }
    }

    /// What a unit of every parameter of the problem does to the whitened measurements that links, frame and target cannot do as well; zero
    /// for those.
    fn effects_beyond_geometry(&self) -> Vec<f64> {
        let first = self.geometric.min(self.r.nrows());
        let mut effects = vec![0.0; self.places.len()];
        for (column, place) in self.places.iter().enumerate().skip(self.geometric) {
            effects[*place] = self.r.column(column).rows_range(first..).norm();
        }
        effects
    }
}

/// The problem with those of the robot's parameters that are among `kept`: what [`build`] made of the same options before.
pub(super) fn rebuild(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    kept: &[ParameterId],
) -> Result<CalibrationProblem, IdentifyError> {
    let Columns { robot: mut columns, redundant_ends } =
        columns(model, options, options.freedom(&set.stations, &set.targets))?;
    columns.retain(|column| kept.contains(&column.id));
    Ok(assemble(model, set, options, &columns, &Ends::new(set, options, &redundant_ends))?.problem)
}

/// The robot's parameters that the observations, nests and targets alone cannot tell from the others; of two that do the same, the one
/// further from the geometry of the links. `measured` is the triangular factor of those rows, with a column for each of `parameters`.
pub(super) fn redundant(measured: &DMatrix<f64>, parameters: &[ParameterId]) -> Vec<DependentGroup> {
    let rank = |id: &ParameterId| match id {
        ParameterId::Frame { .. } => 0,
        ParameterId::Target { .. } => 1,
        ParameterId::Link { .. } => 2,
        ParameterId::Compliance(_) => 3,
        ParameterId::Mass { .. } => 4,
        ParameterId::Linkage(_) => 5,
        ParameterId::Term(_) => 6,
    };
    let mut order: Vec<usize> = (0..parameters.len()).collect();
    order.sort_by_key(|column| rank(&parameters[*column]));
    let ids: Vec<_> = order.iter().map(|column| parameters[*column]).collect();
    select_independent(&measured.select_columns(&order), &ids).1
}

/// Residuals and Jacobian of the nominal robot, with the targets of the start `x`.
pub(super) fn start(
    problem: &mut CalibrationProblem,
    x: &[f64],
) -> Result<(DVector<f64>, DMatrix<f64>), IdentifyError> {
    let (m, n) = (problem.rows(), problem.parameters());
    let mut residuals = DVector::zeros(m);
    let mut jacobian = DMatrix::zeros(m, n);
    problem.evaluate(x, &mut residuals, Some(&mut jacobian));
    let failed = (0..problem.rows.len()).find(|row| !residuals[3 * row].is_finite());
    match failed.and_then(|row| problem.failure(row)) {
        Some((pose, source)) => Err(IdentifyError::Machine { pose, source }),
        None => Ok((residuals, jacobian)),
    }
}

fn assemble(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    columns: &[Column],
    ends: &Ends,
) -> Result<Built, IdentifyError> {
    let mut parameters: Vec<ParameterId> = columns.iter().map(|column| column.id).collect();
    let mut sigmas: Vec<Option<f64>> = columns.iter().map(|column| column.sigma).collect();
    let weights = |links: bool| {
        let of_links = move |id: &ParameterId| matches!(id, ParameterId::Link { .. }) == links;
        let columns = columns.iter().enumerate().filter(move |(_, column)| of_links(&column.id));
        columns.filter_map(|(place, column)| Some((place, 1.0 / column.sigma?))).collect::<Vec<_>>()
    };
    let (own_priors, tolerances) = (weights(false), weights(true));
    let mut priors = Vec::new();
    let offsets = starting_offsets(model, set, options.target, &ends.target_axes);
    let stations = stations(model, set, options.frame, (&offsets, ends), &mut parameters, &mut priors)?;
    targets(set, options.target, ends, &mut parameters, &mut priors)?;
    sigmas.resize(parameters.len(), None);
    let targets: Vec<Vector3<f64>> = set.targets.iter().map(|t| t.in_flange).collect();
    let x = parameters.iter().map(|id| match *id {
        ParameterId::Target { target, axis } => offsets[target][axis] - targets[target][axis],
        _ => 0.0,
    });
    let x = x.collect();
    let mut machine = Machine::new(options.mode, model);
    machine.set_terms(columns.iter().filter_map(|column| match column.id {
        ParameterId::Term(term) => Some(term),
        _ => None,
    }));
    let mut problem = CalibrationProblem {
        nominal: model.clone(),
        rows: rows(set, options.unmodelled_sigma, &mut machine)?,
        current: Current::new(model, machine, &stations, &targets),
        parameters,
        priors,
        own_priors,
        tolerances,
        stations,
        targets,
        poses: poses(set),
        motions: Vec::new(),
        unmodelled: options.unmodelled_sigma,
        stated_actuators: stated_actuators(options),
        noise: Noise::default(),
        joined: Vec::new(),
        start: None,
    };
    if problem.stated_actuators.is_some() {
        problem.prepare_motions(set);
    }
    if let Some(row) = problem.rows.iter().find(|row| row.reading.is_some_and(|c| Cholesky::new(c).is_none()))
    {
        return Err(IdentifyError::Covariance { what: format!("pose {}", row.pose) });
    }
    problem.weigh(&Noise::default())?;
    let fixed = ends.fixed.clone();
    let left_out = fixed.iter().map(|group| group.redundant).collect();
    Ok(Built { problem, sigmas, unexcited: Vec::new(), fixed, left_out, x })
}

fn stations(
    model: &CalibrationModel,
    set: &MeasurementSet,
    choice: FrameChoice,
    (offsets, ends): (&[Vector3<f64>], &Ends),
    parameters: &mut Vec<ParameterId>,
    priors: &mut Vec<Prior>,
) -> Result<Vec<Transform>, IdentifyError> {
    let mut stations = Vec::new();
    for (index, station) in set.stations.iter().enumerate() {
        let choice = choice.of(station);
        if choice == FrameChoice::Free {
            let told = ParameterId::all_of_frame(index).into_iter().zip(ends.frame_components);
            parameters.extend(told.filter(|(_, told)| *told).map(|(id, _)| id));
            stations.push(best_fit_station(model, set, offsets, index)?);
            continue;
        }
        let registration = register(station)
            .map_err(|source| IdentifyError::Registration { station: station.name.clone(), source })?;
        if choice == FrameChoice::Nests {
            let covariance = DMatrix::from_iterator(6, 6, registration.covariance.iter().copied());
            priors.push(prior(&format!("station {}", station.name), parameters.len(), covariance)?);
            parameters.extend(ParameterId::all_of_frame(index));
        }
        stations.push(registration.tracker_from_base);
    }
    Ok(stations)
}

fn targets(
    set: &MeasurementSet,
    choice: TargetChoice,
    ends: &Ends,
    parameters: &mut Vec<ParameterId>,
    priors: &mut Vec<Prior>,
) -> Result<(), IdentifyError> {
    for (index, target) in set.targets.iter().enumerate() {
        match (choice.of(target), target.covariance) {
            (TargetChoice::Fixed, _) => continue,
            (TargetChoice::Measured, Some(covariance)) => {
                let covariance = DMatrix::from_iterator(3, 3, covariance.iter().copied());
                priors.push(prior(&format!("target {}", target.name), parameters.len(), covariance)?);
            }
            (TargetChoice::Measured, None) => {
                return Err(IdentifyError::Covariance {
                    what: format!("target {} has no measured uncertainty", target.name),
                });
            }
            // The fitted observations say nothing of a target that only others saw: it stays where it was stated to be.
            _ if !set.observations.iter().any(|observation| observation.target == index) => continue,
            (TargetChoice::Identified | TargetChoice::AsStated, _) => {}
        }
        let told = ParameterId::all_of_target(index).into_iter().zip(ends.target_axes[index]);
        parameters.extend(told.filter(|(_, told)| *told).map(|(id, _)| id));
    }
    Ok(())
}

/// What the options state of the actuators' errors.
fn stated_actuators(options: &IdentificationOptions) -> Option<MachineNoise> {
    let MachineNoiseChoice::Stated(sigmas) = &options.machine_noise else { return None };
    let stated = MachineNoise { position: 0.0, actuators: sigmas.clone(), freedom: None };
    sigmas.iter().any(|sigma| *sigma > 0.0).then_some(stated)
}

fn rows(
    set: &MeasurementSet,
    unmodelled_sigma: f64,
    machine: &mut Machine,
) -> Result<Vec<Row>, IdentifyError> {
    let row = |observation: &Observation| {
        let pose = observation.pose;
        let unmodelled = Matrix3::identity() * unmodelled_sigma * unmodelled_sigma;
        Ok(Row {
            pose,
            told: machine
                .prepare(&observation.into())
                .map_err(|source| IdentifyError::Machine { pose, source })?,
            seen: observation.reading.position(),
            reading: observation.reading.position_covariance().map(|covariance| covariance + unmodelled),
            whitening: Matrix3::identity(),
            station: observation.station,
            target: observation.target,
        })
    };
    set.observations.iter().map(row).collect()
}

fn prior(what: &str, column: usize, covariance: DMatrix<f64>) -> Result<Prior, IdentifyError> {
    let whitening = Cholesky::new(covariance)
        .and_then(|c| c.l().try_inverse())
        .ok_or_else(|| IdentifyError::Covariance { what: what.to_owned() })?;
    Ok(Prior { column, whitening })
}
