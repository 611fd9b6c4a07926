//! `[as_built]`: the truth, as deviations from the robot's file.

#[cfg(test)]
mod tests;

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};
use serde::Deserialize;

use super::file::{joint_index, refuse_twice};
use calibrig_estimation::identification::{complete_set_of, neighbour_axis_rules};
use calibrig_files::{InputError, Source, Spanned};
use calibrig_files::{LoadTable, Robot, read_loads};
use calibrig_model::{
    Body, CalibrationModel, Compliance, LinkTerm, ParameterId, RIGID, StaticProperties, linkage_fault,
};
use calibrig_plant::effects::Effects;
use calibrig_plant::{AsBuilt, AsBuiltDistribution, Spread};

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub(super) struct AsBuiltFile {
    #[serde(default)]
    drives: Drives,
    #[serde(default)]
    joint: Vec<JointErrorsFile>,
    linkage: Option<Spanned<LinkageFile>>,
    base: Option<BaseFile>,
    target: Option<TargetFile>,
    #[serde(default)]
    load: Vec<Spanned<LoadTable>>,
    drawn: Option<Spanned<DrawnFile>>,
}

#[derive(Deserialize, Default, Clone, Copy, PartialEq)]
#[serde(rename_all = "snake_case")]
enum Drives {
    #[default]
    Elastic,
    Rigid,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JointErrorsFile {
    joint: Spanned<String>,
    delta_a_mm: Option<Spanned<f64>>,
    delta_alpha_rad: Option<Spanned<f64>>,
    delta_beta_rad: Option<Spanned<f64>>,
    delta_d_mm: Option<Spanned<f64>>,
    delta_theta_rad: Option<Spanned<f64>>,
    stiffness_factor: Option<Spanned<f64>>,
    bearing_factor: Option<Spanned<f64>>,
    beam_factor: Option<Spanned<f64>>,
    mass_factor: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LinkageFile {
    delta_crank_mm: Option<Spanned<f64>>,
    delta_lever_mm: Option<Spanned<f64>>,
    delta_rod_mm: Option<Spanned<f64>>,
    delta_crank_angle_mrad: Option<Spanned<f64>>,
    delta_lever_angle_mrad: Option<Spanned<f64>>,
    delta_axis_x_mm: Option<Spanned<f64>>,
    delta_axis_y_mm: Option<Spanned<f64>>,
    delta_axis_tilt_x_mrad: Option<Spanned<f64>>,
    delta_axis_tilt_y_mrad: Option<Spanned<f64>>,
    rod_stiffness_factor: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BaseFile {
    tilt_x_mrad: Option<Spanned<f64>>,
    tilt_y_mrad: Option<Spanned<f64>>,
    tilt_z_mrad: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TargetFile {
    delta_x_mm: Option<Spanned<f64>>,
    delta_y_mm: Option<Spanned<f64>>,
    delta_z_mm: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DrawnFile {
    distribution: DistributionFile,
    parameters: Option<Spanned<toml::Value>>,
    lengths_mm: Option<Spanned<f64>>,
    angles_mrad: Option<Spanned<f64>>,
    compliances: Option<Spanned<toml::Value>>,
    compliance_fraction: Option<Spanned<f64>>,
    mass_fraction: Option<Spanned<f64>>,
    linkage_mm: Option<Spanned<f64>>,
    linkage_angles_mrad: Option<Spanned<f64>>,
    crank_axis_mm: Option<Spanned<f64>>,
    crank_tilts_mrad: Option<Spanned<f64>>,
    base_tilt_mrad: Option<Spanned<f64>>,
    target_mm: Option<Spanned<f64>>,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "snake_case")]
enum DistributionFile {
    Normal,
    Uniform,
}

/// The machine with its `effects`, and the distribution from which trials draw. `robot_key` is where the file names the robot. For one without
/// statics, which has to be rigid, gravity only states which way is up.
pub(super) fn as_built(
    source: &Source,
    file: &AsBuiltFile,
    robot_key: &Spanned<String>,
    robot: &Robot,
    (effects, gravity): (Effects, Vector3<f64>),
) -> Result<(AsBuilt, Option<AsBuiltDistribution>), InputError> {
    let missing = |what: &str, where_: &str| {
        source.error(
            robot_key.span(),
            format!("the robot's files give no {what}"),
            Some(format!("a simulation needs {where_}")),
        )
    };
    let statics = match &robot.model.statics {
        Some(statics) => statics.clone(),
        None if file.drives == Drives::Rigid => weightless(robot.model.kinematics.joint_count(), gravity),
        None => {
            return Err(missing(
                "masses, drive stiffnesses and gravity",
                "a URDF with inertials (or [joint.body]), stiffness_* of every joint and [gravity]; or drives = \"rigid\" in \
                 [as_built], so that nothing deflects",
            ));
        }
    };
    if robot.targets.len() > 1 {
        let message = format!(
            "the robot's file states {} targets, but a simulation measures only one",
            robot.targets.len()
        );
        return Err(source.error(
            robot_key.span(),
            message,
            Some(
                "expected one [target] in the robot's file, or the measured one as [target] here".to_owned(),
            ),
        ));
    }
    let target =
        robot.target().ok_or_else(|| missing("target offset", "[target] in the robot's file, or here"))?;
    let (kinematics, actuators) = (robot.model.kinematics.clone(), robot.model.actuators.clone());
    let mut machine = AsBuilt { kinematics, actuators, statics, target, effects };
    let reader = Reader { source };
    let mut seen = vec![false; machine.kinematics.joint_count()];
    for entry in &file.joint {
        let index = joint_index(source, &entry.joint, &machine.kinematics)?;
        refuse_twice(source, &mut seen, index, &entry.joint)?;
        reader.joint(entry, index, &mut machine)?;
    }
    if let Some(linkage) = &file.linkage {
        reader.linkage(linkage, &mut machine)?;
    }
    reader.base_and_target(file, &mut machine)?;
    let names: Vec<_> = robot.model.kinematics.links.iter().map(|link| link.name.as_str()).collect();
    machine.statics.loads = read_loads(source, &file.load, &names, &machine.statics.loads)?;
    if file.drives == Drives::Rigid {
        machine.statics.make_rigid();
    }
    let place = file.linkage.as_ref().map_or(robot_key.span(), Spanned::span);
    reader.check_closing(&machine, place, "as_built.linkage")?;
    let drawn = file.drawn.as_ref().map(|drawn| reader.drawn(drawn, &machine, &robot.model));
    Ok((machine, drawn.transpose()?))
}

/// Placeholder for the statics of a rigid robot without known ones: its bodies of a kilogram deflect nothing.
fn weightless(joints: usize, gravity: Vector3<f64>) -> StaticProperties {
    let body = Body { mass: 1.0, centre_of_mass: Vector3::zeros(), inertia: Matrix3::identity() };
    StaticProperties::of_drives(vec![body; joints], vec![f64::INFINITY; joints], gravity)
}

struct Reader<'a> {
    source: &'a Source,
}

impl Reader<'_> {
    fn error(&self, span: Range<usize>, message: String, expected: &str) -> InputError {
        self.source.error(span, message, Some(format!("expected {expected}")))
    }

    /// Zero if the key is missing.
    fn number(&self, key: &str, unit: f64, value: Option<&Spanned<f64>>) -> Result<f64, InputError> {
        value.map_or(Ok(0.0), |value| Ok(unit * self.source.finite(key, value)?))
    }

    fn joint(&self, entry: &JointErrorsFile, index: usize, machine: &mut AsBuilt) -> Result<(), InputError> {
        for (key, delta, unit, term) in [
            ("delta_a_mm", &entry.delta_a_mm, 1e-3, LinkTerm::A),
            ("delta_alpha_rad", &entry.delta_alpha_rad, 1.0, LinkTerm::Alpha),
            ("delta_beta_rad", &entry.delta_beta_rad, 1.0, LinkTerm::Beta),
            ("delta_d_mm", &entry.delta_d_mm, 1e-3, LinkTerm::D),
            ("delta_theta_rad", &entry.delta_theta_rad, 1.0, LinkTerm::Theta),
        ] {
            *machine.kinematics.links[index].term_mut(term) += self.number(key, unit, delta.as_ref())?;
        }
        if let Some(factor) = &entry.stiffness_factor {
            machine.statics.drive_stiffness[index] *= self.source.positive("stiffness_factor", factor)?;
        }
        if let Some(factor) = &entry.bearing_factor {
            let scale = self.source.positive("bearing_factor", factor)?;
            if machine.statics.bearings[index].stiffness == RIGID {
                return Err(self.nothing_to_scale("bearing_factor", factor, entry, "[joint.bearing]"));
            }
            machine.scale_bearing(index, scale);
        }
        if let Some(factor) = &entry.beam_factor {
            let scale = self.source.positive("beam_factor", factor)?;
            if machine.statics.beams[index].is_none() {
                return Err(self.nothing_to_scale("beam_factor", factor, entry, "[joint.beam]"));
            }
            machine.scale_beam(index, scale);
        }
        if let Some(factor) = &entry.mass_factor {
            machine.scale_mass(index, self.source.positive("mass_factor", factor)?);
        }
        Ok(())
    }

    fn nothing_to_scale(
        &self,
        key: &str,
        value: &Spanned<f64>,
        entry: &JointErrorsFile,
        table: &str,
    ) -> InputError {
        let message =
            format!("{key}: joint \"{}\" has no {table} in the robot's file", entry.joint.get_ref());
        self.error(value.span(), message, &format!("{table} there, or no {key}"))
    }

    fn linkage(&self, table: &Spanned<LinkageFile>, machine: &mut AsBuilt) -> Result<(), InputError> {
        let file = table.get_ref();
        let Some(linkage) = machine.linkage_mut() else {
            let message = "as_built.linkage: the robot's file has no [actuators.linkage]".to_owned();
            return Err(self.error(
                table.span(),
                message,
                "[actuators.linkage] there, or no [as_built.linkage]",
            ));
        };
        for (key, delta, length) in [
            ("delta_crank_mm", &file.delta_crank_mm, &mut linkage.crank.length),
            ("delta_lever_mm", &file.delta_lever_mm, &mut linkage.lever.length),
            ("delta_rod_mm", &file.delta_rod_mm, &mut linkage.rod),
        ] {
            *length += self.number(key, 1e-3, delta.as_ref())?;
            if let Some(delta) = delta.as_ref().filter(|_| *length <= 0.0) {
                let message = format!("{key} leaves a length of {:.3} mm", *length * 1e3);
                return Err(self.error(delta.span(), message, "a length above zero"));
            }
        }
        let angle = |key, delta| self.number(key, 1e-3, delta);
        linkage.crank.angle += angle("delta_crank_angle_mrad", file.delta_crank_angle_mrad.as_ref())?;
        linkage.lever.angle += angle("delta_lever_angle_mrad", file.delta_lever_angle_mrad.as_ref())?;
        self.crank_axis(file, machine)?;
        if let (Some(factor), Some(statics)) = (&file.rod_stiffness_factor, &mut machine.statics.linkage) {
            statics.rod_stiffness *= self.source.positive("rod_stiffness_factor", factor)?;
        }
        Ok(())
    }

    /// Displaces the crank's axis from the nominal one, and reports by name if that alone opens the loop.
    fn crank_axis(&self, file: &LinkageFile, machine: &mut AsBuilt) -> Result<(), InputError> {
        let coaxial = linkage_fault(&machine.kinematics, &machine.actuators);
        let Some(linkage) = machine.linkage_mut() else { return Ok(()) };
        let mut moved = None;
        for (key, delta, place) in [
            ("delta_axis_x_mm", &file.delta_axis_x_mm, &mut linkage.axis.x),
            ("delta_axis_y_mm", &file.delta_axis_y_mm, &mut linkage.axis.y),
            ("delta_axis_tilt_x_mrad", &file.delta_axis_tilt_x_mrad, &mut linkage.axis.rx),
            ("delta_axis_tilt_y_mrad", &file.delta_axis_tilt_y_mrad, &mut linkage.axis.ry),
        ] {
            *place += self.number(key, 1e-3, delta.as_ref())?;
            moved = moved.or(delta.as_ref().map(|delta| (key, delta.span())));
        }
        match moved {
            Some((key, span)) if coaxial.is_none() => {
                self.check_closing(machine, span, &format!("as_built.linkage.{key}"))
            }
            _ => Ok(()),
        }
    }

    fn base_and_target(&self, file: &AsBuiltFile, machine: &mut AsBuilt) -> Result<(), InputError> {
        if let Some(base) = &file.base {
            let turn = Vector3::new(
                self.number("tilt_x_mrad", 1e-3, base.tilt_x_mrad.as_ref())?,
                self.number("tilt_y_mrad", 1e-3, base.tilt_y_mrad.as_ref())?,
                self.number("tilt_z_mrad", 1e-3, base.tilt_z_mrad.as_ref())?,
            );
            machine.tilt(&turn);
        }
        if let Some(target) = &file.target {
            machine.target += Vector3::new(
                self.number("delta_x_mm", 1e-3, target.delta_x_mm.as_ref())?,
                self.number("delta_y_mm", 1e-3, target.delta_y_mm.as_ref())?,
                self.number("delta_z_mm", 1e-3, target.delta_z_mm.as_ref())?,
            );
        }
        Ok(())
    }

    fn check_closing(&self, machine: &AsBuilt, place: Range<usize>, key: &str) -> Result<(), InputError> {
        match linkage_fault(&machine.kinematics, &machine.actuators) {
            Some(fault) => {
                let expected = "errors with which the linkage closes between the elbow's limits";
                Err(self.error(place, format!("{key}: {fault}"), expected))
            }
            None => Ok(()),
        }
    }

    fn drawn(
        &self,
        table: &Spanned<DrawnFile>,
        machine: &AsBuilt,
        nominal: &CalibrationModel,
    ) -> Result<AsBuiltDistribution, InputError> {
        let file = table.get_ref();
        let (spread, largest) = match file.distribution {
            DistributionFile::Normal => (Spread::Normal, 0.2),
            DistributionFile::Uniform => (Spread::Uniform, 0.9),
        };
        let size = |key, unit: f64, value: &Option<Spanned<f64>>| {
            value.as_ref().map_or(Ok(0.0), |value| Ok(unit * self.source.not_negative(key, value)?))
        };
        let fraction = |key, value: &Option<Spanned<f64>>| -> Result<f64, InputError> {
            let size = size(key, 1.0, value)?;
            match value {
                // Wider, it would reach zero.
                Some(value) if size > largest => {
                    let expected = format!("at most {largest} for this distribution");
                    Err(self.error(value.span(), format!("{key} is {size}"), &expected))
                }
                _ => Ok(size),
            }
        };
        let distribution = AsBuiltDistribution {
            spread,
            link_parameters: self.link_parameters(file.parameters.as_ref(), nominal)?,
            length: size("lengths_mm", 1e-3, &file.lengths_mm)?,
            angle: size("angles_mrad", 1e-3, &file.angles_mrad)?,
            compliances: self.compliances(file.compliances.as_ref(), nominal)?,
            compliance: fraction("compliance_fraction", &file.compliance_fraction)?,
            mass: fraction("mass_fraction", &file.mass_fraction)?,
            linkage_length: size("linkage_mm", 1e-3, &file.linkage_mm)?,
            linkage_angle: size("linkage_angles_mrad", 1e-3, &file.linkage_angles_mrad)?,
            crank_axis: size("crank_axis_mm", 1e-3, &file.crank_axis_mm)?,
            crank_tilt: size("crank_tilts_mrad", 1e-3, &file.crank_tilts_mrad)?,
            tilt: size("base_tilt_mrad", 1e-3, &file.base_tilt_mrad)?,
            target: size("target_mm", 1e-3, &file.target_mm)?,
        };
        self.check_drawn_linkages(table, &distribution, machine)?;
        Ok(distribution)
    }

    /// Which link parameters deviate; all without the key.
    fn link_parameters(
        &self,
        value: Option<&Spanned<toml::Value>>,
        nominal: &CalibrationModel,
    ) -> Result<Vec<(usize, LinkTerm)>, InputError> {
        let model = &nominal.kinematics;
        let links = model.joint_count();
        let all = ParameterId::all_of_links(links);
        let Some(value) = value else { return Ok(of_links(&all)) };
        let refused = |what: String| {
            let expected = format!(
                "\"all\", \"complete\", \"neighbour_axis_rules\", or a list of delta_a, delta_alpha, delta_beta, delta_d, delta_theta with a joint \
                 number from 1 to {links}"
            );
            self.error(value.span(), format!("as_built.drawn.parameters: {what}"), &expected)
        };
        match value.get_ref() {
            toml::Value::String(name) if name == "all" => Ok(of_links(&all)),
            toml::Value::String(name) if name == "neighbour_axis_rules" => {
                Ok(of_links(&neighbour_axis_rules(model).0))
            }
            // As they are identified where base and target are known.
            toml::Value::String(name) if name == "complete" => {
                let set =
                    complete_set_of(nominal, false, false).map_err(|error| refused(error.to_string()))?;
                Ok(of_links(&set.selected))
            }
            toml::Value::Array(names) => names
                .iter()
                .map(|name| match name.as_str().and_then(ParameterId::parse) {
                    Some(ParameterId::Link { link, term }) if link < links => Ok((link, term)),
                    _ => Err(refused(format!("{name} is not a link parameter of this robot"))),
                })
                .collect(),
            other => Err(refused(format!("{other} is not a valid choice"))),
        }
    }

    /// Which compliances deviate; all without the key.
    fn compliances(
        &self,
        value: Option<&Spanned<toml::Value>>,
        model: &CalibrationModel,
    ) -> Result<Vec<Compliance>, InputError> {
        let known = model.compliances();
        let Some(value) = value else { return Ok(known) };
        let refused = |what: String| {
            let names = known.iter().map(|which| format!("\"{}\"", ParameterId::Compliance(*which)));
            let expected =
                format!("\"all\", \"drives\", or a list of: {}", names.collect::<Vec<_>>().join(", "));
            self.error(value.span(), format!("as_built.drawn.compliances: {what}"), &expected)
        };
        match value.get_ref() {
            toml::Value::String(name) if name == "all" => Ok(known),
            toml::Value::String(name) if name == "drives" => {
                let of_drives = |c: &Compliance| matches!(c, Compliance::Drive { .. } | Compliance::Rod);
                Ok(known.into_iter().filter(of_drives).collect())
            }
            toml::Value::Array(names) => names
                .iter()
                .map(|name| match name.as_str().and_then(ParameterId::parse) {
                    Some(ParameterId::Compliance(which)) if known.contains(&which) => Ok(which),
                    _ => Err(refused(format!("{name} is not a compliance of this robot"))),
                })
                .collect(),
            other => Err(refused(format!("{other} is not a valid choice"))),
        }
    }

    /// Refuses a spread of the four-bar whose extremes (three standard deviations of a normal one) do not close.
    fn check_drawn_linkages(
        &self,
        table: &Spanned<DrawnFile>,
        distribution: &AsBuiltDistribution,
        machine: &AsBuilt,
    ) -> Result<(), InputError> {
        let extreme = match distribution.spread {
            Spread::Normal => 3.0,
            Spread::Uniform => 1.0,
        };
        let (length, angle) = (extreme * distribution.linkage_length, extreme * distribution.linkage_angle);
        let (shift, tilt) = (extreme * distribution.crank_axis, extreme * distribution.crank_tilt);
        let corners = if shift > 0.0 || tilt > 0.0 { 128_u32 } else { 16 };
        // The lever's angle turns the elbow alone.
        for corner in 0..corners {
            let sign = |bit: u32| if corner >> bit & 1 == 1 { 1.0 } else { -1.0 };
            let mut other = machine.clone();
            let Some(linkage) = other.linkage_mut() else { return Ok(()) };
            linkage.crank.length += sign(0) * length;
            linkage.lever.length += sign(1) * length;
            linkage.rod += sign(2) * length;
            linkage.crank.angle += sign(3) * angle;
            linkage.axis.x += sign(4) * shift;
            linkage.axis.y += sign(5) * shift;
            linkage.axis.rx += sign(6) * tilt;
            linkage.axis.ry -= sign(6) * tilt;
            let positive = linkage.crank.length.min(linkage.lever.length).min(linkage.rod) > 0.0;
            let place = || {
                let file = table.get_ref();
                let keys = [
                    &file.linkage_mm,
                    &file.linkage_angles_mrad,
                    &file.crank_axis_mm,
                    &file.crank_tilts_mrad,
                ];
                keys.into_iter().flatten().map(Spanned::span).next().unwrap_or(table.span())
            };
            if !positive {
                let message = "linkage_mm: a drawn crank, lever or rod could have length zero".to_owned();
                return Err(self.error(place(), message, "less than their lengths"));
            }
            self.check_closing(
                &other,
                place(),
                "as_built.drawn: with linkage_mm, linkage_angles_mrad, crank_axis_mm and crank_tilts_mrad",
            )?;
        }
        Ok(())
    }
}

fn of_links(ids: &[ParameterId]) -> Vec<(usize, LinkTerm)> {
    ids.iter()
        .filter_map(|id| match *id {
            ParameterId::Link { link, term } => Some((link, term)),
            _ => None,
        })
        .collect()
}
