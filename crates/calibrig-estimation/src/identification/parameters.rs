//! The parameters of a mode, and what is known of each beforehand.

use super::options::Freedom;
use super::{
    ComplianceChoice, DependentGroup, FrameChoice, IdentifiabilityReport, IdentificationOptions,
    IdentifyError, LINKAGE, Mode, ParameterChoice, TargetChoice, complete_set, dependent_ends,
    neighbour_axis_rules,
};
use calibrig_model::measurement::{Station, Target};
use calibrig_model::{CalibrationModel, Compliance, FAMILIES, LinkTerm, ParameterId, TermId, Unit};

/// A parameter of the robot with its own prior.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Column {
    pub id: ParameterId,
    /// Standard deviation of its zero-mean prior, SI.
    pub sigma: Option<f64>,
    /// Whether the user named it, so that it stays where the measurements do not show it.
    pub named: bool,
}

/// The robot's parameters, and what of frame and target cannot be told beside each other.
#[derive(Debug, Clone)]
pub(super) struct Columns {
    /// In their order.
    pub robot: Vec<Column>,
    /// Components of a free station's frame (of station 0) and of an unknown target (0) that the structure of the chain makes redundant.
    pub redundant_ends: Vec<DependentGroup>,
}

/// How far the four-bar's lengths are from their drawing, where the options do not say, m.
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
    }
    if options.mode == Mode::Extended {
        columns.extend(linkage(model, options)?);
        columns.extend(terms(model, options)?);
    }
    Ok(Columns { robot: columns, redundant_ends })
}

/// All parameters that a fit with these options can have, before the measurements tell which of them gravity excites.
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
    if options.target != TargetChoice::Fixed {
        ids.extend((0..targets.len()).flat_map(ParameterId::all_of_target));
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
    let ends = || dependent_ends(&model.kinematics, free.frame, free.target);
    let (mut chosen, redundant_ends) = match choice {
        ParameterChoice::NeighbourAxisRules => (neighbour_axis_rules(&model.kinematics).0, ends()?),
        ParameterChoice::Complete => {
            let IdentifiabilityReport { mut selected, mut dependent, .. } =
                complete_set(&model.kinematics, free.frame, free.target)?;
            selected.retain(|id| matches!(id, ParameterId::Link { .. }));
            dependent.retain(|group| !matches!(group.redundant, ParameterId::Link { .. }));
            (selected, dependent)
        }
        ParameterChoice::Listed(listed) => (listed.clone(), ends()?),
    };
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
        let columns = chosen.into_iter().map(|id| Column { id, sigma: None, named: true });
        return Ok((columns.collect(), redundant_ends));
    };
    let [length, angle] = [tolerance.length, tolerance.angle]
        .map(|sigma| positive(sigma, "the tolerance of the link parameters"));
    let (length, angle) = (length?, angle?);
    let sigma = |id: &ParameterId| if id.unit() == Unit::Metre { length } else { angle };
    let columns = chosen.into_iter().map(|id| Column { id, sigma: Some(sigma(&id)), named: true });
    Ok((columns.collect(), redundant_ends))
}

fn compliances(
    model: &CalibrationModel,
    options: &IdentificationOptions,
) -> Result<Vec<Column>, IdentifyError> {
    let sigma = Some(positive(options.compliance_sigma, "the prior of the compliances")?);
    let known = model.compliances();
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
    let mut seen = Vec::with_capacity(chosen.len());
    chosen.retain(|compliance| {
        let new = !seen.contains(compliance);
        seen.push(*compliance);
        new
    });
    Ok(chosen.into_iter().map(|c| Column { id: ParameterId::Compliance(c), sigma, named }).collect())
}

fn masses(model: &CalibrationModel, options: &IdentificationOptions) -> Result<Vec<Column>, IdentifyError> {
    let sigma = Some(positive(options.mass_sigma, "the prior of the masses")?);
    let mut links = options.masses.clone();
    links.sort_unstable();
    links.dedup();
    links
        .into_iter()
        .map(|link| {
            let id = ParameterId::Mass { link };
            match &model.statics {
                Some(statics) if link < statics.bodies.len() => Ok(Column { id, sigma, named: true }),
                _ => Err(IdentifyError::UnknownParameter { name: id.to_string() }),
            }
        })
        .collect()
}

fn linkage(model: &CalibrationModel, options: &IdentificationOptions) -> Result<Vec<Column>, IdentifyError> {
    if !options.has_terms(LINKAGE) {
        return Ok(Vec::new());
    }
    let sigma = options.term_sigma(LINKAGE, Unit::Metre).unwrap_or(LINKAGE_SIGMA);
    let sigma = Some(positive(sigma, "the prior of the linkage")?);
    let lengths = model.linkage_lengths().into_iter();
    Ok(lengths.map(|length| Column { id: ParameterId::Linkage(length), sigma, named: false }).collect())
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
    for family in FAMILIES.iter().filter(|family| options.has_terms(family.key())) {
        for id in TermId::all_of(family.key(), model).unwrap_or_default() {
            let sigma = options.term_sigma(family.key(), id.unit()).unwrap_or_else(|| id.prior_sigma());
            let sigma = Some(positive(sigma, family.key())?);
            columns.push(Column { id: ParameterId::Term(id), sigma, named: false });
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
