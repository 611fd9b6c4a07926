//! What statics need, gathered: masses, stiffnesses, loads and gravity.

use nalgebra::Vector3;
use serde::Deserialize;

use super::Reader;
use super::joints::JointTable;
use super::loads::read_loads;
use super::urdf::UrdfRobot;
use crate::input::{InputError, Spanned};
use calibrig_model::{ActuatorMap, Beam, Body, BodyUncertainty, KinematicModel, StaticProperties};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct GravityTable {
    x_m_per_s2: Spanned<f64>,
    y_m_per_s2: Spanned<f64>,
    z_m_per_s2: Spanned<f64>,
}

/// `compliance_percent`: a number, or the word for unknown.
#[derive(Deserialize)]
#[serde(untagged)]
pub(super) enum CompliancePercent {
    Within(f64),
    Word(String),
}

/// The word for an unknown stiffness.
const UNKNOWN: &str = "unknown";

impl Reader<'_> {
    pub(super) fn gravity(&self) -> Result<Option<Vector3<f64>>, InputError> {
        let Some(table) = &self.file.gravity else { return Ok(None) };
        let gravity = table.get_ref();
        Ok(Some(Vector3::new(
            self.source.finite("x_m_per_s2", &gravity.x_m_per_s2)?,
            self.source.finite("y_m_per_s2", &gravity.y_m_per_s2)?,
            self.source.finite("z_m_per_s2", &gravity.z_m_per_s2)?,
        )))
    }

    /// Relative uncertainty of the stiffnesses; and whether they are stated as unknown.
    pub(super) fn compliance_sigma(&self) -> Result<(Option<f64>, bool), InputError> {
        let Some(stated) = &self.file.compliance_percent else { return Ok((None, false)) };
        match stated.get_ref() {
            CompliancePercent::Within(percent) => {
                let percent = Spanned::new(stated.span(), *percent);
                Ok((Some(self.source.positive("compliance_percent", &percent)? / 100.0), false))
            }
            CompliancePercent::Word(word) if word == UNKNOWN => Ok((None, true)),
            CompliancePercent::Word(word) => self.error(
                stated.span(),
                format!("compliance_percent is {word:?}"),
                &format!("a number above zero, or {UNKNOWN:?}"),
            ),
        }
    }

    /// Uncertainty of every body's mass and centre: from its joint's table, else from the file's common values; none if neither states it.
    pub(super) fn body_uncertainties(&self) -> Result<Vec<BodyUncertainty>, InputError> {
        let mut stated = Vec::new();
        let mut bodies = Vec::new();
        for table in &self.file.joint {
            let joint = table.get_ref();
            let mass = joint.mass_percent.as_ref().or(self.file.mass_percent.as_ref());
            let centre = joint.centre_mm.as_ref().or(self.file.centre_mm.as_ref());
            stated.extend([mass, centre].into_iter().flatten().map(Spanned::span));
            let number = |key, value: Option<&Spanned<f64>>| {
                value.map_or(Ok(0.0), |value| self.source.not_negative(key, value))
            };
            bodies.push(BodyUncertainty {
                mass: number("mass_percent", mass)? / 100.0,
                centre: number("centre_mm", centre)? / 1e3,
            });
        }
        match stated.first() {
            None => Ok(Vec::new()),
            Some(span) if self.file.urdf.is_none() && !self.states_bodies() => self.error(
                span.clone(),
                "there is a mass_percent or centre_mm, but there are no masses",
                "[joint.body] of every joint, or urdf = \"robot.urdf\" with the inertials",
            ),
            Some(_) => Ok(bodies),
        }
    }

    /// Deflections need stiffness, gravity and masses together: only some of them are a mistake.
    pub(super) fn statics(
        &self,
        kinematics: &KinematicModel,
        actuators: &ActuatorMap,
        urdf: Option<&UrdfRobot>,
    ) -> Result<Option<StaticProperties>, InputError> {
        let gravity = self.gravity()?;
        // Always read, so that a mistake in them is reported.
        let drives = self.drives()?;
        let bearings = self.bearings()?;
        let limits: Vec<_> = kinematics.links.iter().map(|link| link.limits).collect();
        let beams = self.beams(&limits)?;
        let linkage = self.linkage_statics(actuators)?;
        let names: Vec<_> = kinematics.links.iter().map(|link| link.name.as_str()).collect();
        let loads = read_loads(self.source, &self.file.load, &names, &[])?;
        let stated = self.states_bodies().then(|| self.stated_bodies(urdf)).transpose()?;
        let (drive_stiffness, gravity) = match (drives, gravity) {
            (None, None) => return self.refuse_statics_alone().map(|()| None),
            (Some(drives), Some(gravity)) => (drives, gravity),
            (Some(_), None) => {
                let span = self.file.joint[0].span();
                return self.error(
                    span,
                    "the drives have stiffnesses, but there is no [gravity]",
                    "[gravity]",
                );
            }
            (None, Some(_)) => {
                let span = self.file.gravity.as_ref().map_or(0..0, Spanned::span);
                let expected = "stiffness_n_per_m or stiffness_nm_per_rad of every joint";
                return self.error(span, "there is [gravity], but no drive has a stiffness", expected);
            }
        };
        if gravity == Vector3::zeros() && loads.iter().all(|load| load.force == Vector3::zeros()) {
            let span = self.file.gravity.as_ref().map_or(0..0, Spanned::span);
            let message = "[gravity] is zero, and no load has a force: nothing deflects";
            return self.error(
                span,
                message,
                "gravity in the base frame, or neither [gravity] nor stiffnesses",
            );
        }
        let bodies = stated.map_or_else(|| self.bodies(urdf), Ok)?;
        self.check_beam_masses(&limits, &beams, &bodies)?;
        Ok(Some(StaticProperties { bodies, drive_stiffness, bearings, beams, linkage, loads, gravity }))
    }

    /// Bearings, beams, loads and masses of the four-bar are meaningless without drives and gravity.
    fn refuse_statics_alone(&self) -> Result<(), InputError> {
        let of_joint = self.file.joint.iter().map(Spanned::get_ref).find_map(|joint| {
            let bearing = joint.bearing.as_ref().map(|table| (table.span(), "[joint.bearing]"));
            let beam = || joint.beam.as_ref().map(|table| (table.span(), "[joint.beam]"));
            bearing.or_else(beam)
        });
        let known = self.file.compliance_percent.as_ref().map(|value| (value.span(), "compliance_percent"));
        let load = || self.file.load.first().map(|table| (table.span(), "[[load]]"));
        let linkage =
            || self.linkage_statics_key().map(|span| (span, "stiffness or mass in [actuators.linkage]"));
        match of_joint.or_else(load).or_else(linkage).or(known) {
            Some((span, what)) => self.error(
                span,
                format!("there is a {what}, but no drive has a stiffness"),
                "stiffness_n_per_m or stiffness_nm_per_rad of every joint, and [gravity]",
            ),
            None => Ok(()),
        }
    }

    fn bodies(&self, urdf: Option<&UrdfRobot>) -> Result<Vec<Body>, InputError> {
        let Some(urdf) = urdf else {
            let message = "there are stiffnesses and [gravity], but no masses";
            let expected = "[joint.body] of every joint, or urdf = \"robot.urdf\" with the inertials";
            return self.error(0..0, message, expected);
        };
        urdf.joints
            .iter()
            .zip(&self.file.joint)
            .map(|(joint, table)| match &joint.body {
                Some(body) => Ok(body.clone()),
                None => {
                    let message =
                        format!("the URDF has no <inertial> for what joint {:?} carries", joint.name);
                    self.error(
                        table.get_ref().name.span(),
                        message,
                        "an <inertial>, or no stiffnesses and [gravity]",
                    )
                }
            })
            .collect()
    }

    /// Whether the file itself says what a joint carries.
    fn states_bodies(&self) -> bool {
        self.file.joint.iter().any(|table| table.get_ref().body.is_some())
    }

    /// The bodies of `[joint.body]`; those of a URDF must not be stated again.
    fn stated_bodies(&self, urdf: Option<&UrdfRobot>) -> Result<Vec<Body>, InputError> {
        let in_urdf = urdf.is_some_and(|urdf| urdf.joints.iter().any(|joint| joint.body.is_some()));
        // All first, so that a mistake in one is reported before the absence of others.
        let bodies: Vec<Option<Body>> =
            self.file.joint.iter().map(|table| self.stated_body(table)).collect::<Result<_, _>>()?;
        let stated = |(table, body): (&Spanned<JointTable>, Option<Body>)| match body {
            Some(body) if !in_urdf => Ok(body),
            Some(_) => {
                let span = table.get_ref().body.as_ref().map_or(0..0, Spanned::span);
                self.error(span, "masses are given here and in the URDF", "only one of them")
            }
            None => {
                let message = format!(
                    "joint {:?} has no [joint.body], but others have",
                    table.get_ref().name.get_ref()
                );
                self.error(table.span(), message, "mass and centre of what every joint carries, or of none")
            }
        };
        self.file.joint.iter().zip(bodies).map(stated).collect()
    }

    /// A beam is a part of its link's body.
    fn check_beam_masses(
        &self,
        limits: &[[f64; 2]],
        beams: &[Option<Beam>],
        bodies: &[Body],
    ) -> Result<(), InputError> {
        for (((table, limits), beam), body) in self.file.joint.iter().zip(limits).zip(beams).zip(bodies) {
            let (Some(beam), Some(file)) = (beam, &table.get_ref().beam) else { continue };
            let mass = beam.mass(limits[1]);
            if mass >= body.mass {
                let message = format!(
                    "the beam of joint {:?} weighs {mass:.3} kg, more than the {} kg of its whole link in the URDF",
                    table.get_ref().name.get_ref(),
                    body.mass
                );
                return self.error(file.span(), message, "a beam that is lighter than its link");
            }
        }
        Ok(())
    }
}
