//! The parameters of a mode, and the prior knowledge of each.

use super::instrument::parameters_of;
use super::options::{Freedom, InstrumentChoice};
use super::{
    ComplianceChoice, DependentGroup, FrameChoice, IdentifiabilityReport, IdentificationOptions,
    IdentifyError, LINKAGE, Mode, ParameterChoice, UNKNOWN_STIFFNESS, complete_set_by_name, dependent_ends,
    neighbour_axis_rules,
};
use calibrig_model::measurement::{Station, Target};
use calibrig_model::{
    BodyUncertainty, CalibrationModel, Compliance, FAMILIES, LinkTerm, ParameterId, TermId, Unit,
};

/// A parameter of the robot with its own prior.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Column {
    pub id: ParameterId,
    /// Standard deviation of the parameter's zero-mean prior, SI.
    pub sigma: Option<f64>,
    /// Whether the user named it, so that it is kept where the measurements do not show it.
    pub named: bool,
    /// Quantity to which the prior applies.
    pub prior: PriorKind,
}

/// Quantity to which a parameter's own prior applies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PriorKind {
    /// The parameter.
    Own,
    /// The logarithm of one plus the parameter.
    Logarithm,
    /// The parameter, where it was stated for the robot: the prior counts with nests and targets.
    Stated,
}

impl Column {
    fn new(id: ParameterId, sigma: Option<f64>, named: bool) -> Self {
        Self { id, sigma, named, prior: PriorKind::Own }
    }

    /// How far the prior lets the parameter go: one standard deviation.
    pub fn reach(&self) -> f64 {
        match (self.sigma, self.prior) {
            (Some(sigma), PriorKind::Logarithm) => sigma.exp_m1(),
            (sigma, _) => sigma.unwrap_or(1.0),
        }
    }
}

/// The robot's parameters, and the parts of frame and target that cannot be determined beside each other.
#[derive(Debug, Clone)]
pub(super) struct Columns {
    /// The robot's parameters in the order of their columns.
    pub robot: Vec<Column>,
    /// Components of a free station's frame (of station 0) and of an unknown target (0) that the structure of the chain makes redundant.
    pub redundant_ends: Vec<DependentGroup>,
}

/// Standard deviation of the four-bar's lengths and of the crank's axis from their drawing, where the options state none, m and rad.
const LINKAGE_SIGMA: f64 = 1e-3;

/// The robot's parameters in the order of their columns: links, compliances, masses, linkage, terms.
pub(super) fn columns(
    model: &CalibrationModel,
    options: &IdentificationOptions,
    free: Freedom,
) -> Result<Columns, IdentifyError> {
    let (mut columns, redundant_ends) = links(model, options, free)?;
    if options.mode.is_coupled() {
        columns.extend(compliances(model, options)?);
        columns.extend(masses(model, options)?);
        columns.extend(bodies(model, options)?);
    }
    if options.mode == Mode::Extended {
        columns.extend(linkage(model, options)?);
        columns.extend(terms(model, options)?);
    }
    columns.retain(|column| !options.fix.contains(&column.id));
    Ok(Columns { robot: columns, redundant_ends })
}

/// All parameters that a fit with these options can have, before the measurements show which of them gravity excites.
pub(super) fn candidate_parameters(
    model: &CalibrationModel,
    options: &IdentificationOptions,
    stations: &[Station],
    targets: &[Target],
) -> Result<Vec<ParameterId>, IdentifyError> {
    let free = options.freedom(stations, targets);
    let mut ids: Vec<_> = columns(model, options, free)?.robot.into_iter().map(|column| column.id).collect();
    if options.frame != FrameChoice::Fixed {
        ids.extend((0..stations.len()).flat_map(ParameterId::all_of_frame));
    }
    let of_targets = (0..targets.len()).flat_map(ParameterId::all_of_target);
    let turned = targets.iter().enumerate().filter(|(_, target)| target.orientation.is_some());
    let of_orientations = turned.flat_map(|(target, _)| ParameterId::all_of_orientation(target));
    ids.extend(of_targets.chain(of_orientations).filter(|id| options.fits_target(*id)));
    if options.instrument == InstrumentChoice::AsStated && options.mode != Mode::WithoutCalibration {
        ids.extend(parameters_of(stations).into_iter().filter(|id| !options.fix.contains(id)));
    }
    Ok(ids)
}

fn links(
    model: &CalibrationModel,
    options: &IdentificationOptions,
    free: Freedom,
) -> Result<(Vec<Column>, Vec<DependentGroup>), IdentifyError> {
    let joints = model.kinematics.joint_count();
    let choice =
        if options.mode == Mode::Extended { &options.extended_parameters } else { &options.parameters };
    let fixed_ends = options.fixed_of_all_targets();
    let fix: Vec<_> =
        options.fix.iter().copied().filter(|id| matches!(id, ParameterId::Link { .. })).collect();
    let ends = || dependent_ends(model, free, &fixed_ends);
    let (mut chosen, redundant_ends) = match choice {
        ParameterChoice::NeighbourAxisRules => (neighbour_axis_rules(&model.kinematics).0, ends()?),
        ParameterChoice::Complete => {
            let IdentifiabilityReport { mut selected, mut dependent, .. } =
                complete_set_by_name(model, free, &[fix.as_slice(), &fixed_ends].concat(), &options.free)?;
            selected.retain(|id| matches!(id, ParameterId::Link { .. }));
            dependent.retain(|group| !matches!(group.redundant, ParameterId::Link { .. }));
            (selected, dependent)
        }
        ParameterChoice::Listed(listed) => (listed.clone(), ends()?),
    };
    if options.mode != Mode::WithoutCalibration {
        chosen.extend(options.free.iter().filter(|id| matches!(id, ParameterId::Link { .. })));
    }
    for id in &chosen {
        match *id {
            ParameterId::Link { link, .. } if link < joints => {}
            _ => return Err(IdentifyError::UnknownParameter { name: id.to_string() }),
        }
    }
    let order = |id: &ParameterId| match *id {
        ParameterId::Link { link, term } => (link, LinkTerm::ALL.iter().position(|t| *t == term)),
        _ => (joints, None),
    };
    chosen.sort_by_key(order);
    chosen.dedup();
    let Some(tolerance) = options.tolerance else {
        let columns = chosen.into_iter().map(|id| Column::new(id, None, true));
        return Ok((columns.collect(), redundant_ends));
    };
    let [length, angle] = [tolerance.length, tolerance.angle]
        .map(|sigma| positive(sigma, "the tolerance of the link parameters"));
    let (length, angle) = (length?, angle?);
    let sigma = |id: &ParameterId| if id.unit() == Unit::Metre { length } else { angle };
    let columns = chosen.into_iter().map(|id| Column::new(id, Some(sigma(&id)), true));
    Ok((columns.collect(), redundant_ends))
}

fn compliances(
    model: &CalibrationModel,
    options: &IdentificationOptions,
) -> Result<Vec<Column>, IdentifyError> {
    let (sigma, prior) = if options.stiffness_unknown {
        (UNKNOWN_STIFFNESS, PriorKind::Logarithm)
    } else {
        (positive(options.compliance_sigma, "the prior of the compliances")?, PriorKind::Own)
    };
    let known = model.compliances();
    let known_too = known.clone();
    let (mut chosen, named) = match &options.compliances {
        ComplianceChoice::Drives => {
            let of_drives = |c: &Compliance| matches!(c, Compliance::Drive { .. } | Compliance::Rod);
            (known.into_iter().filter(of_drives).collect(), false)
        }
        ComplianceChoice::All => (known, false),
        ComplianceChoice::Listed(listed) => {
            if let Some(unknown) = listed.iter().find(|compliance| !known.contains(compliance)) {
                let name = ParameterId::Compliance(*unknown).to_string();
                return Err(IdentifyError::RigidOrUnknown { name });
            }
            (listed.clone(), true)
        }
    };
    let freed: Vec<Compliance> = options
        .free
        .iter()
        .filter_map(|id| match id {
            ParameterId::Compliance(compliance) => Some(*compliance),
            _ => None,
        })
        .collect();
    chosen.extend(freed.iter().copied().filter(|compliance| known_too.contains(compliance)));
    let mut seen = Vec::with_capacity(chosen.len());
    chosen.retain(|compliance| {
        let new = !seen.contains(compliance);
        seen.push(*compliance);
        new
    });
    let column = |c| {
        let named = named || freed.contains(&c);
        Column { prior, ..Column::new(ParameterId::Compliance(c), Some(sigma), named) }
    };
    Ok(chosen.into_iter().map(column).collect())
}

fn masses(model: &CalibrationModel, options: &IdentificationOptions) -> Result<Vec<Column>, IdentifyError> {
    let sigma = Some(positive(options.mass_sigma, "the prior of the masses")?);
    let mut links = options.masses.clone();
    links.extend(options.free.iter().filter_map(|id| match id {
        ParameterId::Mass { link } => Some(*link),
        _ => None,
    }));
    links.sort_unstable();
    links.dedup();
    links
        .into_iter()
        .map(|link| {
            let id = ParameterId::Mass { link };
            match &model.statics {
                Some(statics) if link < statics.bodies.len() => Ok(Column::new(id, sigma, true)),
                _ => Err(IdentifyError::UnknownParameter { name: id.to_string() }),
            }
        })
        .collect()
}

/// Masses and centres whose uncertainty is stated, for the links whose mass is not [identified](masses).
fn bodies(model: &CalibrationModel, options: &IdentificationOptions) -> Result<Vec<Column>, IdentifyError> {
    let known = model.statics.as_ref().map_or(0, |statics| statics.bodies.len());
    if !options.bodies.is_empty() && options.bodies.len() != known {
        let what = format!("masses and centres: {} uncertainties for {known} bodies", options.bodies.len());
        return Err(IdentifyError::Covariance { what });
    }
    let mut columns = Vec::new();
    for (link, BodyUncertainty { mass, centre }) in options.bodies.iter().enumerate() {
        let mut push = |id, sigma: f64| {
            if sigma != 0.0 {
                let sigma = positive(sigma, &format!("the uncertainty of {id}"))?;
                columns.push(Column { prior: PriorKind::Stated, ..Column::new(id, Some(sigma), false) });
            }
            Ok::<_, IdentifyError>(())
        };
        if !options.masses.contains(&link) && !options.free.contains(&ParameterId::Mass { link }) {
            push(ParameterId::Mass { link }, *mass)?;
        }
        (0..3).try_for_each(|axis| push(ParameterId::Centre { link, axis }, *centre))?;
    }
    Ok(columns)
}

fn linkage(model: &CalibrationModel, options: &IdentificationOptions) -> Result<Vec<Column>, IdentifyError> {
    let ids = model.linkage_terms().into_iter().map(ParameterId::Linkage);
    let wanted = ids.filter(|id| options.has_terms(LINKAGE) || options.free.contains(id));
    let column = |id: ParameterId| {
        let sigma = options.term_sigma(LINKAGE, id.unit()).unwrap_or(LINKAGE_SIGMA);
        Ok(Column::new(id, Some(positive(sigma, "the prior of the linkage")?), false))
    };
    wanted.map(column).collect()
}

fn terms(model: &CalibrationModel, options: &IdentificationOptions) -> Result<Vec<Column>, IdentifyError> {
    let known = |key: &String| key == LINKAGE || FAMILIES.iter().any(|family| family.key() == key);
    let named = options.term_priors.iter().map(|prior| &prior.family).chain(options.terms.iter().flatten());
    for key in named {
        if !known(key) {
            return Err(IdentifyError::UnknownTerms { key: key.clone() });
        }
    }
    let mut columns = Vec::new();
    for family in FAMILIES {
        let wanted =
            |id: &TermId| options.has_terms(family.key()) || options.free.contains(&ParameterId::Term(*id));
        for id in TermId::all_of(family.key(), model).unwrap_or_default().into_iter().filter(wanted) {
            let sigma = options.term_sigma(family.key(), id.unit()).unwrap_or_else(|| id.prior_sigma());
            let sigma = Some(positive(sigma, family.key())?);
            columns.push(Column::new(ParameterId::Term(id), sigma, false));
        }
    }
    Ok(columns)
}

fn positive(sigma: f64, what: &str) -> Result<f64, IdentifyError> {
    if sigma.is_finite() && sigma > 0.0 {
        return Ok(sigma);
    }
    Err(IdentifyError::Covariance { what: what.to_owned() })
}
