//! The messages with the truth of a simulated run.

use super::schema::{self, v1};
use super::story::TrueSetting;
use super::{Measured, scene};
use calibrig_model::{CraigLink, JointKind, KinematicModel};
use calibrig_plant::{ElasticDeflection, ElasticPlace, SettledPose};

/// The machine, its trackers and its targets. The names of its elastic parts come from a pose ([`elastic_names`]).
pub(super) fn as_built(nominal: &KinematicModel, truth: TrueSetting<'_>) -> v1::AsBuilt {
    let TrueSetting { as_built: machine, stations, further_targets, payloads } = truth;
    let link = |link: &CraigLink| v1::Link {
        name: link.name.clone(),
        prismatic: link.kind == JointKind::Prismatic,
        a: link.a,
        alpha: link.alpha,
        beta: link.beta,
        d: link.d,
        theta: link.theta,
    };
    let deviations = scene::deviations(nominal, &machine.kinematics);
    v1::AsBuilt {
        links: machine.kinematics.links.iter().map(link).collect(),
        deviations: deviations
            .iter()
            .map(|(id, value)| v1::Parameter {
                name: id.to_string(),
                unit: id.unit().to_string(),
                value: Some(*value),
                sigma: None,
                prior_sigma: None,
                stated_sigma: None,
            })
            .collect(),
        target: schema::vector(&machine.target),
        tracker_from_base: stations.first().map(schema::pose),
        further_stations: stations.iter().skip(1).map(schema::pose).collect(),
        further_targets: further_targets.iter().flat_map(schema::vector).collect(),
        drive_stiffness: machine.statics.drive_stiffness.clone(),
        mass: machine.statics.bodies.iter().map(|b| b.mass).collect(),
        gravity: schema::vector(&machine.statics.gravity),
        elastic: Vec::new(),
        payloads: payloads.iter().map(schema::payload).collect(),
    }
}

/// Names of `SettledPose.elastic`, the same of every pose.
pub(super) fn elastic_names(settled: &SettledPose) -> Vec<String> {
    settled.elastic.iter().map(elastic_name).collect()
}

fn elastic_name(elastic: &ElasticDeflection) -> String {
    const AXES: [&str; 6] = ["x", "y", "z", "rx", "ry", "rz"];
    let axis = AXES.get(elastic.axis).copied().unwrap_or_default();
    match elastic.place {
        ElasticPlace::Bearing { joint } => format!("bearing{}_{axis}", joint + 1),
        ElasticPlace::Beam { link, segment } => format!("beam{}_{}_{axis}", link + 1, segment + 1),
        ElasticPlace::Rod => "rod".to_owned(),
        ElasticPlace::Foundation => format!("foundation_{axis}"),
    }
}

/// The machine at rest at observation `i` of the pose.
pub(super) fn settled_pose(measured: &Measured<'_>, i: usize) -> Option<v1::SettledPose> {
    let settled = measured.truth.get(i)?;
    Some(v1::SettledPose {
        set: measured.kind.key().to_owned(),
        index: schema::saturating(measured.first + i),
        pose: measured.observations.get(i)?.pose,
        target: schema::vector(&settled.target),
        deflection: settled.deflection.clone(),
        residual: settled.residual,
        steps: settled.steps,
        closure: settled.closure,
        linkage: settled.linkage.iter().flatten().flat_map(schema::vector).collect(),
        rod_force: settled.rod_force,
        rigid_target: measured.rigid.get(i).map(|rigid| schema::vector(&rigid.target)).unwrap_or_default(),
        elastic: settled.elastic.iter().map(|elastic| elastic.value).collect(),
    })
}

/// How the effects changed observation `i` of the pose.
pub(super) fn pose_effects(measured: &Measured<'_>, i: usize) -> Option<v1::PoseEffects> {
    let effects = measured.effects.get(i)?;
    Some(v1::PoseEffects {
        set: measured.kind.key().to_owned(),
        index: schema::saturating(measured.first + i),
        pose: measured.observations.get(i)?.pose,
        command: effects.command.clone(),
        displacements: effects.displacements.as_flattened().to_vec(),
        temperature: effects.temperature,
    })
}
