//! Builds the problem that the solver is given from a model, measurements and options.

use std::borrow::Cow;

use nalgebra::{Cholesky, DMatrix, DVector, Matrix3, Vector3};

use super::factor::triangular_factor;
use super::forward_model::ForwardModel;
use super::instrument::Instruments;
use super::noise::{MachineNoise, MachineNoiseChoice, Noise, poses};
use super::parameters::{Column, Columns, PriorKind, columns};
use super::place::{Ends, best_fit_station, flanges, starting_offsets};
use super::problem::{CalibrationProblem, Current, PositionRow, Prior};
use super::shared::{shared_errors, take_out};
use super::swept::swept_rows;
use super::turns::{TurnRow, starting_turn, stated_orientations, turns};
use super::{
    DependentGroup, FrameChoice, IdentificationOptions, IdentifyError, LeastSquares, LeftOut, LeftOutReason,
    Loss, Redundancy, Solution, TargetChoice, select_independent,
};
use crate::circle_points::{SweptPlace, place_by_sweeps};
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{MeasurementSet, Observation, Reading, Registration, register};
use calibrig_model::{CalibrationModel, ParameterId};

/// A compliance whose prior's standard deviation moves the whitened measurements by less than this in total, beyond what the geometry can do
/// as well, is not determined by them: its standard deviation stays above 0.89 of its prior's.
const UNEXCITED: f64 = 0.5;
/// What a model lacks is similar in neighbouring poses, so that these determine less than the same number of independent ones: the standard
/// deviation of a compliance from them counts this many times.
const ALIKE: f64 = 2.0;

/// Like [`UNEXCITED`], for a term that no measurement shows, and for a mass or a centre without effect on any.
const NEGLIGIBLE: f64 = 1e-3;

/// The least noise of measurements that state none, relative to [`UNSTATED_SIGMA`]: 1 um.
const LEAST_NOISE: f64 = 1e-2;

/// A compliance that is held by its prior is fitted nevertheless where the residuals ask for it by more than this chi-square of one: 0.1 %.
const ASKED: f64 = 10.83;

/// A problem, and what was decided while it was built.
#[derive(Debug, Clone)]
pub(super) struct Built {
    pub problem: CalibrationProblem,
    /// Standard deviation of each parameter's own prior.
    pub sigmas: Vec<Option<f64>>,
    /// Compliances that the user named.
    pub named: Vec<ParameterId>,
    /// Named compliances that gravity does not load at the nominal robot.
    pub unexcited: Vec<ParameterId>,
    /// Parameters that were left out as redundant.
    pub fixed: Vec<DependentGroup>,
    /// All parameters that were left out: the redundant ones, and those that the measurements do not excite.
    pub left_out: Vec<LeftOut>,
    /// Start of the search: zero, except for targets whose nominal place does not help to place the tracker.
    pub x: Vec<f64>,
    /// Whether the machine's noise from a fit with other compliances is used in the weights.
    pub goes_on: bool,
}

/// The problem of `options`, without parameters that gravity does not excite, and without redundant ones if these are to be fixed.
pub(super) fn build(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
) -> Result<Built, IdentifyError> {
    let Columns { robot: mut columns, redundant_ends } = columns(model, options, options.freedom_in(set))?;
    let ends = Ends::new(set, options, &redundant_ends);
    let mut built = assemble(model, set, options, &columns, (&ends, None))?;
    if !options.mode.is_coupled() && options.redundant != Redundancy::Fix {
        return Ok(built);
    }
    let (residuals, mut jacobian) = start(&mut built.problem, &built.x)?;
    let measured = Measured::new(&built.problem, &jacobian, &residuals);
    let effects = measured.effects_beyond_geometry();
    // The unknown noise is determined again when the residuals are known.
    let noise = if has_stated_noise(set) { 1.0 } else { LEAST_NOISE };
    let rows = built.problem.data_rows();
    let is_open = options.freedom_in(set).target;
    let reason = |(place, column): (usize, &Column)| match column.id {
        ParameterId::Compliance(_) => {
            let effect = effects[place] * column.reach() / noise;
            (effect < UNEXCITED).then_some(LeftOutReason::Unloaded { effect })
        }
        ParameterId::Term(_) => {
            let size = jacobian.view((0, place), (rows, 1)).norm();
            let is_term = |column: &&Column| matches!(column.id, ParameterId::Term(_));
            let term = columns[..place].iter().filter(is_term).count();
            // The start of an unknown target may lie on an axis on which the target does not lie.
            let is_told = || is_open && built.problem.rows.iter().any(|row| row.told.tells(term));
            (size * column.reach() < f64::EPSILON && !is_told()).then_some(LeftOutReason::NoBasis)
        }
        _ => None,
    };
    let reasons: Vec<_> = columns.iter().enumerate().map(reason).collect();
    let named = columns.iter().zip(&reasons).filter(|(column, reason)| column.named && reason.is_some());
    let unexcited: Vec<_> = named.map(|(column, _)| column.id).collect();
    let mut fixed = Vec::new();
    if options.redundant == Redundancy::Fix {
        fixed = redundant(&measured.factor(), &measured.parameters);
    }
    let is_unfelt = |place: usize, column: &Column| {
        let size = || jacobian.view((0, place), (rows, 1)).norm();
        column.prior == PriorKind::Stated && size() * column.reach() < NEGLIGIBLE
    };
    let mut left_out = Vec::new();
    let mut dropped = Vec::new();
    for (place, (column, reason)) in columns.iter().zip(reasons).enumerate() {
        let id = column.id;
        let reason = if fixed.iter().any(|group| group.redundant == id) {
            Some(LeftOutReason::Redundant)
        } else {
            reason.filter(|_| !column.named)
        };
        if reason.is_some() || is_unfelt(place, column) {
            dropped.push(place);
            left_out.extend(reason.map(|reason| LeftOut { id, reason }));
        }
    }
    if !dropped.is_empty() {
        let mut place = 0..;
        columns.retain(|_| place.next().is_none_or(|place| !dropped.contains(&place)));
        let known = std::mem::take(&mut built.problem.shared);
        built = assemble(model, set, options, &columns, (&ends, Some(known)))?;
        // The robot's own parameters come first.
        jacobian = jacobian.remove_columns_at(&dropped);
    }
    // Only the robot's own parameters of a group are left out: frame and target stay in the fit.
    fixed.retain(|group| !columns.iter().any(|column| column.id == group.redundant));
    built.problem.start_from(&built.x, residuals, jacobian);
    built.fixed.extend(fixed);
    built.left_out.extend(left_out);
    Ok(Built { unexcited, ..built })
}

/// The problem with the compliances that the measurements do excite, now that the fit of `built` has given their values and the noise, and
/// where to start it; `None` where they are those that were fitted. Compliances are left out only the first time (`may_drop`).
pub(super) fn reconsider(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    built: &Built,
    solution: &Solution,
    may_drop: bool,
) -> Result<Option<(Built, Vec<f64>)>, IdentifyError> {
    let is_compliance = |id: &ParameterId| matches!(id, ParameterId::Compliance(_));
    let is_unloaded = |left: &LeftOut| matches!(left.reason, LeftOutReason::Unloaded { .. });
    let fitted = &built.problem.parameters;
    if !fitted.iter().any(is_compliance) && !built.left_out.iter().any(is_unloaded) {
        return Ok(None);
    }
    let Columns { robot: mut columns, redundant_ends } = columns(model, options, options.freedom_in(set))?;
    let ends = Ends::new(set, options, &redundant_ends);
    let returns = |id| built.left_out.iter().any(|left| left.id == id && is_unloaded(left));
    columns.retain(|column| fitted.contains(&column.id) || returns(column.id));
    let known = || Some(built.problem.shared.clone());
    let mut whole = assemble(model, set, options, &columns, (&ends, known()))?.problem;
    whole.motions.clone_from(&built.problem.motions);
    whole.turn_motions.clone_from(&built.problem.turn_motions);
    whole.weigh(&built.problem.noise)?;
    let value = |id: &ParameterId| fitted.iter().position(|own| own == id).map_or(0.0, |at| solution.x[at]);
    let x: Vec<f64> = whole.parameters.iter().map(value).collect();
    let (residuals, jacobian) = if whole.parameters == *fitted && solution.weights.is_empty() {
        (solution.residuals.clone(), solution.jacobian.clone())
    } else {
        evaluated(&mut whole, &x, &solution.weights)
    };
    if residuals.iter().chain(jacobian.iter()).any(|v| !v.is_finite()) {
        return Ok(None);
    }
    let measured = Measured::new(&whole, &jacobian, &residuals);
    let effects = measured.effects_beyond_geometry();
    let asked = measured.asked_beyond_geometry(&x);
    let spread = if built.problem.noise.machine.is_some() { ALIKE } else { 1.0 };
    let mut left_out: Vec<_> = built.left_out.iter().copied().filter(|left| !is_unloaded(left)).collect();
    let mut place = 0..;
    columns.retain(|column| {
        let place = place.next().unwrap_or_default();
        let was_fitted = fitted.contains(&column.id);
        if !is_compliance(&column.id) || column.named || was_fitted && !may_drop {
            return true;
        }
        let effect = effects[place] * column.reach();
        let stays = effect >= UNEXCITED * spread || (asked[place] / spread).powi(2) >= ASKED;
        if !stays {
            left_out.push(LeftOut { id: column.id, reason: LeftOutReason::Unloaded { effect } });
        }
        stays
    });
    let mut next = assemble(model, set, options, &columns, (&ends, known()))?;
    if next.problem.parameters == *fitted {
        return Ok(None);
    }
    next.unexcited.clone_from(&built.unexcited);
    next.fixed.clone_from(&built.fixed);
    let values: Vec<f64> = next.problem.parameters.iter().map(value).collect();
    let noise = &built.problem.noise;
    if solution.weights.is_empty() && next.problem.stated_actuators.is_none() && noise.unstated.is_none() {
        next.goes_on = noise.machine.is_some();
        next.problem.motions = whole.motions;
        next.problem.turn_motions = whole.turn_motions;
        next.problem.weigh(noise)?;
        let place = |id: &ParameterId| whole.parameters.iter().position(|own| own == id);
        let places: Vec<usize> = next.problem.parameters.iter().filter_map(place).collect();
        // If the parameters that are now left out are zero, the robot is the same.
        if (0..x.len()).all(|place| x[place] == 0.0 || places.contains(&place)) {
            next.problem.start_from(&values, residuals, jacobian.select_columns(&places));
        }
    }
    Ok(Some((Built { left_out, ..next }, values)))
}

/// Residuals and Jacobian at `x`, with the weights of a robust loss.
fn evaluated(problem: &mut CalibrationProblem, x: &[f64], weights: &[f64]) -> (DVector<f64>, DMatrix<f64>) {
    let (m, n) = (problem.rows(), problem.parameters());
    let (mut residuals, mut jacobian) = (DVector::zeros(m), DMatrix::zeros(m, n));
    problem.evaluate(x, &mut residuals, Some(&mut jacobian));
    for (observation, weight) in weights.iter().enumerate() {
        residuals.rows_mut(3 * observation, 3).scale_mut(weight.sqrt());
        jacobian.rows_mut(3 * observation, 3).scale_mut(weight.sqrt());
    }
    (residuals, jacobian)
}

fn has_stated_noise(set: &MeasurementSet) -> bool {
    set.observations.iter().all(|o| o.reading.position_covariance().is_some())
}

/// The triangular factor of the observations and of what was stated: first the columns of links, frame, target and stated bodies, then the
/// others, and the residuals last.
struct Measured {
    r: DMatrix<f64>,
    /// Parameters of the columns of `r`, in their order; the first `geometric` belong to links, frame, target and stated bodies.
    parameters: Vec<ParameterId>,
    geometric: usize,
    /// Index in the problem of every column of `r` except the last.
    places: Vec<usize>,
    rows: usize,
}

impl Measured {
    fn new(problem: &CalibrationProblem, jacobian: &DMatrix<f64>, residuals: &DVector<f64>) -> Self {
        let is_geometric = |column: &usize| match problem.parameters[*column] {
            ParameterId::Link { .. }
            | ParameterId::Frame { .. }
            | ParameterId::Target { .. }
            | ParameterId::Orientation { .. }
            | ParameterId::Instrument { .. }
            | ParameterId::Drift { .. } => true,
            ParameterId::Mass { .. } | ParameterId::Centre { .. } => {
                problem.own_priors.iter().all(|(own, _)| own != column)
            }
            _ => false,
        };
        let n = problem.parameters.len();
        let (mut places, others): (Vec<usize>, Vec<usize>) = (0..n).partition(is_geometric);
        let geometric = places.len();
        places.extend(others);
        let rows = problem.measured_rows();
        let mut system = jacobian.rows(0, rows).insert_column(n, 0.0);
        system.column_mut(n).copy_from(&residuals.rows(0, rows));
        let columns: Vec<usize> = places.iter().copied().chain([n]).collect();
        Self {
            r: triangular_factor(system.as_view(), &columns),
            parameters: places.iter().map(|place| problem.parameters[*place]).collect(),
            geometric,
            places,
            rows,
        }
    }

    /// The factor without the residuals.
    fn factor(&self) -> DMatrix<f64> {
        let n = self.places.len();
        self.r.view((0, 0), (n.min(self.r.nrows()), n)).into_owned()
    }

    /// Change of the whitened measurements per unit of every parameter of the problem, beyond what links, frame and target can do as well; zero for
    /// those.
    fn effects_beyond_geometry(&self) -> Vec<f64> {
        let first = self.geometric.min(self.r.nrows());
        let mut effects = vec![0.0; self.places.len()];
        for (column, place) in self.places.iter().enumerate().skip(self.geometric) {
            effects[*place] = self.r.column(column).rows_range(first..).norm();
        }
        effects
    }

    /// The value that the measurements ask for, in its own standard deviations, of every parameter that geometry cannot replace, with the others
    /// held at `x` and without its own prior. The noise is at least what the residuals show.
    fn asked_beyond_geometry(&self, x: &[f64]) -> Vec<f64> {
        let first = self.geometric.min(self.r.nrows());
        let left = self.r.column(self.places.len());
        let left = left.rows_range(first..);
        let freedom = (self.rows - first).max(1) as f64;
        let noise = (left.norm_squared() / freedom).sqrt().max(1.0);
        let mut asked = vec![0.0; self.places.len()];
        for (column, place) in self.places.iter().enumerate().skip(self.geometric) {
            let column = self.r.column(column);
            let own = column.rows_range(first..);
            let size = own.norm();
            if size > 0.0 {
                asked[*place] = (x[*place] * size - own.dot(&left) / size) / noise;
            }
        }
        asked
    }
}

/// The problem with those parameters of the robot that are in `kept`, as [`build`] made it from the same options.
pub(super) fn rebuild(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    kept: &[ParameterId],
) -> Result<CalibrationProblem, IdentifyError> {
    let Columns { robot: mut columns, redundant_ends } = columns(model, options, options.freedom_in(set))?;
    columns.retain(|column| kept.contains(&column.id));
    let ends = Ends::new(set, options, &redundant_ends);
    Ok(assemble(model, set, options, &columns, (&ends, None))?.problem)
}

/// The robot's parameters that the observations, nests and targets alone cannot separate from the others; of two with the same effect, the
/// one further from the geometry of the links. `measured` is the triangular factor of those rows, with a column for each of `parameters`.
pub(super) fn redundant(measured: &DMatrix<f64>, parameters: &[ParameterId]) -> Vec<DependentGroup> {
    let rank = |id: &ParameterId| match id {
        ParameterId::Frame { .. } => 0,
        ParameterId::Target { .. } | ParameterId::Orientation { .. } => 1,
        ParameterId::Link { .. } => 2,
        ParameterId::Compliance(_) => 3,
        ParameterId::Mass { .. } | ParameterId::Centre { .. } => 4,
        ParameterId::Linkage(_) => 5,
        ParameterId::Term(_) => 6,
        ParameterId::Instrument { .. } | ParameterId::Drift { .. } => 7,
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

/// Assembles the problem; `known` are the errors that readings of the set share, if they were computed before.
fn assemble(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    columns: &[Column],
    (ends, known): (&Ends, Option<DMatrix<f64>>),
) -> Result<Built, IdentifyError> {
    options.machine_noise.check(model.kinematics.joint_count())?;
    let model = &*spread(model, set, columns);
    let mut parameters: Vec<ParameterId> = columns.iter().map(|column| column.id).collect();
    let mut sigmas: Vec<Option<f64>> = columns.iter().map(|column| column.sigma).collect();
    let weights = |links: bool| {
        let of_links = move |id: &ParameterId| matches!(id, ParameterId::Link { .. }) == links;
        let is_own = move |column: &Column| column.prior != PriorKind::Stated && of_links(&column.id);
        let columns = columns.iter().enumerate().filter(move |(_, column)| is_own(column));
        columns.filter_map(|(place, column)| Some((place, 1.0 / column.sigma?))).collect::<Vec<_>>()
    };
    let (mut own_priors, mut tolerances) = (weights(false), weights(true));
    let is_logarithmic =
        |(place, column): (usize, &Column)| (column.prior == PriorKind::Logarithm).then_some(place);
    let logarithmic = columns.iter().enumerate().filter_map(is_logarithmic).collect();
    let stated = columns.iter().enumerate().filter(|(_, column)| column.prior == PriorKind::Stated);
    let body = |(column, of): (usize, &Column)| {
        Some(Prior {
            columns: vec![column],
            whitening: DMatrix::from_element(1, 1, 1.0 / of.sigma?),
            offset: DVector::zeros(1),
        })
    };
    let mut priors: Vec<_> = stated.filter_map(body).collect();
    let offsets = starting_offsets(model, set, options.target, &ends.target_axes);
    let Stations { places, placed } = stations(model, set, options.frame, (&offsets, ends), &mut parameters)?;
    let stations = places;
    targets(set, options, ends, &mut parameters, &mut priors)?;
    orientations(set, options, ends, &mut parameters, &mut priors)?;
    let instruments = Instruments::new(set, options, &mut parameters, &mut priors);
    let mut forward = ForwardModel::new(options.mode, model);
    forward.set_terms(columns.iter().filter_map(|column| match column.id {
        ParameterId::Term(term) => Some(term),
        _ => None,
    }));
    let with = (&instruments, stations.as_slice(), parameters.as_slice());
    let swept = placing(set, placed, with, &mut forward, &mut priors, (&mut own_priors, &mut tolerances))?;
    sigmas.resize(parameters.len(), None);
    let targets: Vec<Vector3<f64>> = set.targets.iter().map(|t| t.in_flange).collect();
    let x = starting_values(model, set, options, &parameters, (&stations, &offsets));
    let (mut turns, orientations) = (turns(set), stated_orientations(set));
    let mut rows = rows(set, options.unmodelled_sigma, &mut forward)?;
    instruments.add_to(&mut rows, set.observations.iter(), set, &stations);
    // A loss weighs every reading by its own rows, so that shared errors are then treated as each reading's own.
    let shared = match options.solver.loss {
        Loss::Squared => known.unwrap_or_else(|| shared_errors(set, &rows, &turns)),
        _ => DMatrix::zeros(0, 0),
    };
    take_out(&shared, &mut rows, &mut turns);
    let mut problem = CalibrationProblem {
        nominal: model.clone(),
        rows,
        turn_of: turn_of(set.observations.len(), &turns),
        turns,
        current: Current::new(model, forward, &stations, &targets, &orientations),
        orientations,
        turn_motions: Vec::new(),
        turn_whitening: Vec::new(),
        shared,
        shared_whitening: None,
        parameters,
        priors,
        own_priors,
        logarithmic,
        tolerances,
        swept,
        left_of_swept: 0.0,
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
    problem.set(&vec![0.0; problem.parameters.len()]);
    if problem.stated_actuators.is_some() {
        let targets = problem.targets.clone();
        problem.prepare_motions(set, &targets);
    }
    if let Some(row) = problem.rows.iter().find(|row| row.reading.is_some_and(|c| Cholesky::new(c).is_none()))
    {
        return Err(IdentifyError::Covariance { what: format!("pose {}", row.pose) });
    }
    problem.weigh(&Noise::default())?;
    let is_named = |column: &&Column| column.named && matches!(column.id, ParameterId::Compliance(_));
    let named = columns.iter().filter(is_named).map(|column| column.id).collect();
    let fixed = ends.fixed.clone();
    let of_ends = |group: &DependentGroup| LeftOut { id: group.redundant, reason: LeftOutReason::Redundant };
    let mut left_out: Vec<LeftOut> = fixed.iter().map(of_ends).collect();
    let fixed_by_name = options.fix.iter().filter(|id| options.mode.can_fit(**id));
    left_out.extend(fixed_by_name.map(|id| LeftOut { id: *id, reason: LeftOutReason::ByName }));
    Ok(Built { problem, sigmas, named, unexcited: Vec::new(), fixed, left_out, x, goes_on: false })
}

/// The model with the spans of the commands, where terms are spread over them and no spans are stated.
fn spread<'m>(
    model: &'m CalibrationModel,
    set: &MeasurementSet,
    columns: &[Column],
) -> Cow<'m, CalibrationModel> {
    let is_spread =
        |column: &Column| matches!(column.id, ParameterId::Term(term) if term.family().is_of_spans());
    if !model.spans.is_empty() || !columns.iter().any(is_spread) {
        return Cow::Borrowed(model);
    }
    Cow::Owned(CalibrationModel { spans: set.spans(), ..model.clone() })
}

/// How a station is placed before the fit.
enum PlacedBy {
    /// Covariance of the displacement of the frame.
    Nests(DMatrix<f64>),
    Sweeps(Box<SweptPlace>),
}

/// Places of the stations before the fit.
struct Stations {
    /// `tracker_from_base` of each station, which the frame parameters displace.
    places: Vec<Transform>,
    /// Stations with a prior from nests or sweeps: index, first column of the frame, and the prior.
    placed: Vec<(usize, usize, PlacedBy)>,
}

/// Columns with the reciprocal of the standard deviation of their own prior.
type Weights = Vec<(usize, f64)>;

/// Appends the priors of stations that nests or sweeps place; for sweeps, also returns the index of the prior and its readings.
fn placing(
    set: &MeasurementSet,
    placed: Vec<(usize, usize, PlacedBy)>,
    (instruments, stations, parameters): (&Instruments, &[Transform], &[ParameterId]),
    forward: &mut ForwardModel,
    priors: &mut Vec<Prior>,
    (own_priors, tolerances): (&mut Weights, &mut Weights),
) -> Result<Vec<(usize, Vec<PositionRow>)>, IdentifyError> {
    let mut swept = Vec::new();
    for (index, frame, placed_by) in placed {
        let station = &set.stations[index];
        let own = match placed_by {
            PlacedBy::Sweeps(place) => {
                // This station is placed by where its axes are in the base: the tolerance of the links up to them is part of that.
                let carries = |id: ParameterId| matches!(id, ParameterId::Link { link, .. } if link <= place.last_joint);
                own_priors.extend(tolerances.extract_if(.., |(column, _)| carries(parameters[*column])));
                swept.push((priors.len(), swept_rows(set, index, &place, forward, (instruments, stations))?));
                Prior { columns: Vec::new(), whitening: DMatrix::zeros(0, 0), offset: DVector::zeros(0) }
            }
            PlacedBy::Nests(covariance) => {
                match instruments.nests((index, station), &stations[index], frame)? {
                    Some(own) => own,
                    None => prior(&format!("station {}", station.name), frame, covariance)?,
                }
            }
        };
        priors.push(own);
    }
    Ok(swept)
}

fn stations(
    model: &CalibrationModel,
    set: &MeasurementSet,
    choice: FrameChoice,
    (offsets, ends): (&[Vector3<f64>], &Ends),
    parameters: &mut Vec<ParameterId>,
) -> Result<Stations, IdentifyError> {
    let (mut stations, mut placed) = (Vec::new(), Vec::new());
    for (index, station) in set.stations.iter().enumerate() {
        let choice = choice.of(station);
        if choice == FrameChoice::Free {
            let told = ParameterId::all_of_frame(index).into_iter().zip(ends.frame_components);
            parameters.extend(told.filter(|(_, told)| *told).map(|(id, _)| id));
            stations.push(best_fit_station(model, set, offsets, index)?);
            continue;
        }
        let (place, placed_by) = match choice {
            FrameChoice::Sweeps => {
                let swept = place_by_sweeps(model, set, index)?.0;
                (swept.tracker_from_base, PlacedBy::Sweeps(Box::new(swept)))
            }
            _ => {
                let Registration { tracker_from_base, covariance, .. } =
                    register(station).map_err(|source| IdentifyError::Registration {
                        station: station.name.clone(),
                        source,
                    })?;
                let covariance = DMatrix::from_iterator(6, 6, covariance.iter().copied());
                (tracker_from_base, PlacedBy::Nests(covariance))
            }
        };
        stations.push(place);
        if choice != FrameChoice::Fixed {
            placed.push((index, parameters.len(), placed_by));
            parameters.extend(ParameterId::all_of_frame(index));
        }
    }
    Ok(Stations { places: stations, placed })
}

fn targets(
    set: &MeasurementSet,
    options: &IdentificationOptions,
    ends: &Ends,
    parameters: &mut Vec<ParameterId>,
    priors: &mut Vec<Prior>,
) -> Result<(), IdentifyError> {
    for (index, target) in set.targets.iter().enumerate() {
        let ids = ParameterId::all_of_target(index);
        let freed = |axis: &usize| options.free.contains(&ids[*axis]);
        let mut axes: Vec<usize> = (0..3).filter(|axis| ends.target_axes[index][*axis]).collect();
        match (options.target.of(target), target.covariance) {
            (TargetChoice::Fixed, _) => axes.retain(freed),
            (TargetChoice::Measured, Some(covariance)) => {
                // Axes with a prior come first, so that their columns are contiguous.
                axes.sort_by_key(freed);
                let held: Vec<usize> = axes.iter().copied().filter(|axis| !freed(axis)).collect();
                if !held.is_empty() {
                    let what = format!("target {}", target.name);
                    let covariance = of_axes(&covariance, &axes, held.len())
                        .ok_or_else(|| IdentifyError::Covariance { what: what.clone() })?;
                    priors.push(prior(&what, parameters.len(), covariance)?);
                }
            }
            (TargetChoice::Measured, None) => {
                return Err(IdentifyError::Covariance {
                    what: format!("target {} has no measured uncertainty", target.name),
                });
            }
            // The fitted observations do not contain a target that only others saw: it stays where it was stated to be.
            _ if !set.observations.iter().any(|observation| observation.target == index) => continue,
            (TargetChoice::Identified | TargetChoice::AsStated, _) => {}
        }
        parameters.extend(axes.into_iter().map(|axis| ids[axis]));
    }
    Ok(())
}

/// The orientation parameters of targets whose orientation the set shows.
fn orientations(
    set: &MeasurementSet,
    options: &IdentificationOptions,
    ends: &Ends,
    parameters: &mut Vec<ParameterId>,
    priors: &mut Vec<Prior>,
) -> Result<(), IdentifyError> {
    for (index, target) in set.targets.iter().enumerate() {
        let Some(orientation) = &target.orientation else { continue };
        let is_seen = |o: &Observation| o.target == index && matches!(o.reading, Reading::Pose(_));
        if !set.observations.iter().any(is_seen) {
            continue;
        }
        let ids = ParameterId::all_of_orientation(index);
        let freed = |axis: &usize| options.free.contains(&ids[*axis]);
        let mut axes: Vec<usize> = (0..3).filter(|axis| ends.orientation_axes[index][*axis]).collect();
        match (options.target.of_orientation(orientation), orientation.covariance) {
            (TargetChoice::Fixed, _) => axes.retain(freed),
            (TargetChoice::Measured, Some(covariance)) => {
                axes.sort_by_key(freed);
                let held = axes.iter().filter(|axis| !freed(axis)).count();
                if held > 0 {
                    let what = format!("the orientation of target {}", target.name);
                    let covariance = of_axes(&covariance, &axes, held)
                        .ok_or_else(|| IdentifyError::Covariance { what: what.clone() })?;
                    priors.push(prior(&what, parameters.len(), covariance)?);
                }
            }
            (TargetChoice::Measured | TargetChoice::Identified | TargetChoice::AsStated, _) => {}
        }
        parameters.extend(axes.into_iter().map(|axis| ids[axis]));
    }
    Ok(())
}

/// Start of the search: zero, except for targets that are far from where they are stated to be.
fn starting_values(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    parameters: &[ParameterId],
    (stations, offsets): (&[Transform], &[Vector3<f64>]),
) -> Vec<f64> {
    let is_unknown = |target: usize| {
        let orientation = set.targets[target].orientation.as_ref();
        orientation.is_some_and(|o| options.target.of_orientation(o) == TargetChoice::Identified)
    };
    let mut turned = vec![None; set.targets.len()];
    if parameters.iter().any(|id| matches!(id, ParameterId::Orientation { .. })) {
        let flanges = flanges(model, set);
        for (target, stated) in stated_orientations(set).iter().enumerate().filter(|(t, _)| is_unknown(*t)) {
            turned[target] = starting_turn(set, &flanges, stations, target, stated);
        }
    }
    let value = |id: &ParameterId| match *id {
        ParameterId::Target { target, axis } => offsets[target][axis] - set.targets[target].in_flange[axis],
        ParameterId::Orientation { target, axis } => turned[target].map_or(0.0, |turn| turn[axis]),
        _ => 0.0,
    };
    parameters.iter().map(value).collect()
}

fn turn_of(observations: usize, turns: &[TurnRow]) -> Vec<Option<usize>> {
    let mut of = vec![None; observations];
    for (turn, row) in turns.iter().enumerate() {
        of[row.observation] = Some(turn);
    }
    of
}

/// Covariance of the first `held` of a target's coordinates `axes`, with its other coordinates exactly as stated.
fn of_axes(covariance: &Matrix3<f64>, axes: &[usize], held: usize) -> Option<DMatrix<f64>> {
    if axes == [0, 1, 2] {
        return Some(DMatrix::from_fn(held, held, |i, j| covariance[(i, j)]));
    }
    let information = covariance.try_inverse()?;
    let of_axes = DMatrix::from_fn(axes.len(), axes.len(), |i, j| information[(axes[i], axes[j])]);
    Some(of_axes.try_inverse()?.view((0, 0), (held, held)).into_owned())
}

/// The actuators' errors that the options state.
fn stated_actuators(options: &IdentificationOptions) -> Option<MachineNoise> {
    let MachineNoiseChoice::Stated(sigmas) = &options.machine_noise else { return None };
    let stated = MachineNoise { position: 0.0, actuators: sigmas.clone(), freedom: None };
    sigmas.iter().any(|sigma| *sigma > 0.0).then_some(stated)
}

fn rows(
    set: &MeasurementSet,
    unmodelled_sigma: f64,
    forward: &mut ForwardModel,
) -> Result<Vec<PositionRow>, IdentifyError> {
    let row = |observation: &Observation| {
        let pose = observation.pose;
        let unmodelled = Matrix3::identity() * unmodelled_sigma * unmodelled_sigma;
        Ok(PositionRow {
            pose,
            told: forward
                .prepare(&observation.into())
                .map_err(|source| IdentifyError::Machine { pose, source })?,
            seen: observation.reading.position(),
            reading: observation.reading.position_covariance().map(|covariance| covariance + unmodelled),
            whitening: Matrix3::identity(),
            instrument: Vec::new(),
            hours: 0.0,
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
    let n = whitening.nrows();
    Ok(Prior { columns: (column..column + n).collect(), whitening, offset: DVector::zeros(n) })
}

#[cfg(test)]
mod tests;
