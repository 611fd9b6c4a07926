//! `[actuators]` and `[actuators.linkage]`: how commands become joint variables.

use nalgebra::{Matrix3, Vector3};
use serde::Deserialize;

use super::Reader;
use super::joints::JointType;
use crate::input::{InputError, Spanned};
use calibrig_model::{ActuatorMap, Body, CrankAxis, FourBar, KinematicModel, LinkageArm, LinkageStatics};
use calibrig_model::{LEAST_TRANSMISSION_ANGLE, linkage_fault};

#[derive(Deserialize, Clone, Copy, PartialEq)]
#[serde(rename_all = "snake_case")]
enum ActuatorKind {
    Direct,
    Parallelogram,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ActuatorTable {
    kind: ActuatorKind,
    shoulder: Option<Spanned<String>>,
    elbow: Option<Spanned<String>>,
    offset_deg: Option<Spanned<f64>>,
    linkage: Option<Spanned<LinkageTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LinkageTable {
    crank_mm: Spanned<f64>,
    lever_mm: Spanned<f64>,
    rod_mm: Spanned<f64>,
    angle_deg: Option<Spanned<f64>>,
    crank_angle_deg: Option<Spanned<f64>>,
    lever_angle_deg: Option<Spanned<f64>>,
    along_mm: Option<Spanned<f64>>,
    axis_x_mm: Option<Spanned<f64>>,
    axis_y_mm: Option<Spanned<f64>>,
    axis_tilt_x_deg: Option<Spanned<f64>>,
    axis_tilt_y_deg: Option<Spanned<f64>>,
    rod_stiffness_n_per_m: Option<Spanned<f64>>,
    rod_mass_kg: Option<Spanned<f64>>,
    crank_mass_kg: Option<Spanned<f64>>,
    crank_centre_mm: Option<Spanned<f64>>,
}

impl Reader<'_> {
    pub(super) fn actuators(&self, kinematics: &KinematicModel) -> Result<ActuatorMap, InputError> {
        let table = self.file.actuators.get_ref();
        if table.kind == ActuatorKind::Direct {
            let names = [&table.shoulder, &table.elbow].into_iter().flatten().map(Spanned::span);
            let linkage = table.linkage.as_ref().map(Spanned::span);
            return match names.chain(table.offset_deg.as_ref().map(Spanned::span)).chain(linkage).next() {
                Some(span) => {
                    self.error(span, "kind = \"direct\" has no linkage", "kind = \"parallelogram\"")
                }
                None => Ok(ActuatorMap::Direct),
            };
        }
        let shoulder = self.loop_joint("shoulder", table.shoulder.as_ref())?;
        let elbow = self.loop_joint("elbow", table.elbow.as_ref())?;
        if let Some(name) = table.elbow.as_ref().filter(|_| shoulder == elbow) {
            return self.error(name.span(), "elbow and shoulder are the same joint", "two different joints");
        }
        let Some(offset) = &table.offset_deg else {
            return self.error(self.file.actuators.span(), "[actuators] has no offset_deg", "offset_deg");
        };
        let linkage = table.linkage.as_ref().map(|linkage| self.four_bar(linkage)).transpose()?;
        if let Some(table) = table.linkage.as_ref().filter(|_| elbow != shoulder + 1) {
            let message = "[actuators.linkage] spans more than shoulder and elbow";
            return self.error(table.span(), message, "an elbow that is the joint right after the shoulder");
        }
        let offset = self.degrees("offset_deg", offset)?;
        let actuators = ActuatorMap::Parallelogram { shoulder, elbow, offset, linkage };
        self.check_closing(kinematics, &actuators)?;
        Ok(actuators)
    }

    fn four_bar(&self, table: &Spanned<LinkageTable>) -> Result<FourBar, InputError> {
        let file = table.get_ref();
        let length = |key, value| Ok(self.source.positive(key, value)? / 1e3);
        let (crank, lever) = match (&file.angle_deg, &file.crank_angle_deg, &file.lever_angle_deg) {
            (Some(both), None, None) => (("angle_deg", both), ("angle_deg", both)),
            (None, Some(crank), Some(lever)) => (("crank_angle_deg", crank), ("lever_angle_deg", lever)),
            _ => {
                let message =
                    "[actuators.linkage] does not state the angle of crank and lever, or states it twice";
                return self.error(
                    table.span(),
                    message,
                    "either angle_deg, or crank_angle_deg and lever_angle_deg",
                );
            }
        };
        let along = file.along_mm.as_ref().map_or(Ok(0.0), |along| self.millimetres("along_mm", along))?;
        Ok(FourBar {
            crank: LinkageArm {
                length: length("crank_mm", &file.crank_mm)?,
                angle: self.degrees(crank.0, crank.1)?,
                along,
            },
            lever: LinkageArm {
                length: length("lever_mm", &file.lever_mm)?,
                angle: self.degrees(lever.0, lever.1)?,
                along,
            },
            rod: length("rod_mm", &file.rod_mm)?,
            axis: self.crank_axis(file)?,
        })
    }

    fn crank_axis(&self, file: &LinkageTable) -> Result<CrankAxis, InputError> {
        let along = |key, value: &Option<Spanned<f64>>| {
            value.as_ref().map_or(Ok(0.0), |value| self.millimetres(key, value))
        };
        let about = |key, value: &Option<Spanned<f64>>| {
            value.as_ref().map_or(Ok(0.0), |value| self.degrees(key, value))
        };
        Ok(CrankAxis {
            x: along("axis_x_mm", &file.axis_x_mm)?,
            y: along("axis_y_mm", &file.axis_y_mm)?,
            rx: about("axis_tilt_x_deg", &file.axis_tilt_x_deg)?,
            ry: about("axis_tilt_y_deg", &file.axis_tilt_y_deg)?,
        })
    }

    fn check_closing(&self, kinematics: &KinematicModel, actuators: &ActuatorMap) -> Result<(), InputError> {
        let Some(fault) = linkage_fault(kinematics, actuators) else { return Ok(()) };
        let span = self.file.actuators.get_ref().linkage.as_ref().map_or(0..0, Spanned::span);
        let expected = format!(
            "crank_mm, lever_mm, rod_mm, angles and axis with which it closes between min_deg and max_deg of the elbow, rod \
             and lever at least {:.0} deg from one line",
            LEAST_TRANSMISSION_ANGLE.to_degrees()
        );
        self.error(span, format!("actuators.linkage: {fault}"), &expected)
    }

    /// Masses and stiffness of the four-bar; `None` if there is no four-bar.
    pub(super) fn linkage_statics(
        &self,
        actuators: &ActuatorMap,
    ) -> Result<Option<LinkageStatics>, InputError> {
        let (Some(table), Some((_, _, _, four_bar))) =
            (&self.file.actuators.get_ref().linkage, actuators.four_bar())
        else {
            return Ok(None);
        };
        let file = table.get_ref();
        let mass = |key, value: &Option<Spanned<f64>>| {
            value.as_ref().map_or(Ok(0.0), |value| self.source.not_negative(key, value))
        };
        let rod_stiffness = match &file.rod_stiffness_n_per_m {
            Some(stiffness) => self.source.positive("rod_stiffness_n_per_m", stiffness)?,
            None => f64::INFINITY,
        };
        let arm = four_bar.crank;
        let centre = match &file.crank_centre_mm {
            Some(centre) => self.millimetres("crank_centre_mm", centre)?,
            None => 0.5 * arm.length,
        };
        let crank_mass = mass("crank_mass_kg", &file.crank_mass_kg)?;
        Ok(Some(LinkageStatics {
            rod_stiffness,
            rod_mass: mass("rod_mass_kg", &file.rod_mass_kg)?,
            crank: crank_body(crank_mass, &arm, centre),
        }))
    }

    /// Where the file states values of the four-bar that only statics need.
    pub(super) fn linkage_statics_key(&self) -> Option<std::ops::Range<usize>> {
        let file = self.file.actuators.get_ref().linkage.as_ref()?.get_ref();
        let keys =
            [&file.rod_stiffness_n_per_m, &file.rod_mass_kg, &file.crank_mass_kg, &file.crank_centre_mm];
        keys.into_iter().flatten().map(Spanned::span).next()
    }

    /// Index of the revolute joint that the parallelogram names.
    fn loop_joint(&self, key: &str, name: Option<&Spanned<String>>) -> Result<usize, InputError> {
        let Some(name) = name else {
            let message = format!("[actuators] has no {key}");
            return self.error(self.file.actuators.span(), message, "the name of a revolute joint");
        };
        let joints = || self.file.joint.iter().map(Spanned::get_ref);
        let Some(index) = joints().position(|joint| joint.name.get_ref() == name.get_ref()) else {
            let names: Vec<_> = joints().map(|joint| joint.name.get_ref().as_str()).collect();
            let message = format!("{key}: no joint is named {:?}", name.get_ref());
            return self.error(name.span(), message, &format!("one of {}", names.join(", ")));
        };
        if self.file.joint[index].get_ref().r#type == JointType::Prismatic {
            let message = format!("{key}: joint {:?} is prismatic", name.get_ref());
            return self.error(name.span(), message, "a revolute joint");
        }
        Ok(index)
    }
}

/// A crank with its centre of mass at `centre` along its arm. Its inertia, which has no effect at rest, is that of a square bar of the
/// arm's length and a fifth of it wide.
fn crank_body(mass: f64, arm: &LinkageArm, centre: f64) -> Body {
    let (sin, cos) = arm.angle.sin_cos();
    let (length, width) = (arm.length.powi(2), (0.2 * arm.length).powi(2));
    let along = Vector3::new(cos, sin, 0.0);
    let across = mass / 12.0 * (length + width);
    Body {
        mass,
        centre_of_mass: centre * along + Vector3::new(0.0, 0.0, arm.along),
        inertia: Matrix3::identity() * across + along * along.transpose() * (mass / 6.0 * width - across),
    }
}
