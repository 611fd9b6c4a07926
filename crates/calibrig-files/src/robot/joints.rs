//! `[[joint]]`: rows of the D-H table, limits, drives and gears.

use std::f64::consts::TAU;

use serde::Deserialize;

use super::axes::{FollowsTable, ShownTable};
use super::flexibility::{BeamTable, BearingTable};
use super::frames::BodyTable;
use super::{Convention, Reader};
use crate::input::{InputError, Spanned};
use calibrig_model::geometry::{Transform, rotation_x, translation};
use calibrig_model::{CraigLink, JointKind, KinematicModel};

#[derive(Deserialize, Clone, Copy, PartialEq)]
#[serde(rename_all = "snake_case")]
pub(super) enum JointType {
    Revolute,
    Prismatic,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct JointTable {
    pub name: Spanned<String>,
    pub r#type: JointType,
    pub a_mm: Spanned<f64>,
    pub alpha_deg: Spanned<f64>,
    pub d_mm: Spanned<f64>,
    pub theta_deg: Spanned<f64>,
    pub beta_deg: Option<Spanned<f64>>,
    pub min_mm: Option<Spanned<f64>>,
    pub max_mm: Option<Spanned<f64>>,
    pub min_deg: Option<Spanned<f64>>,
    pub max_deg: Option<Spanned<f64>>,
    pub stiffness_n_per_m: Option<Spanned<f64>>,
    pub stiffness_nm_per_rad: Option<Spanned<f64>>,
    pub mass_percent: Option<Spanned<f64>>,
    pub centre_mm: Option<Spanned<f64>>,
    pub motor_turns_per_rev: Option<Spanned<f64>>,
    pub motor_turns_per_m: Option<Spanned<f64>>,
    pub bearing: Option<Spanned<BearingTable>>,
    pub beam: Option<Spanned<BeamTable>>,
    pub body: Option<Spanned<BodyTable>>,
    pub shown: Option<Spanned<ShownTable>>,
    pub follows: Option<Spanned<FollowsTable>>,
}

impl Reader<'_> {
    pub(super) fn kinematics(&self) -> Result<KinematicModel, InputError> {
        if self.file.joint.is_empty() {
            return self.error(
                0..0,
                "the robot has no joint",
                "one table [[joint]] per joint, starting at the base",
            );
        }
        let mut links: Vec<CraigLink> = Vec::new();
        // A standard row's a and alpha stand in front of the next joint in Craig's table: Tx and Rx commute.
        let mut behind = (0.0, 0.0);
        for table in &self.file.joint {
            let mut link = self.link(table)?;
            if links.iter().any(|other| other.name == link.name) {
                let span = table.get_ref().name.span();
                return self.error(
                    span,
                    format!("a second joint {:?}", link.name),
                    "a different name for each joint",
                );
            }
            if self.file.convention == Convention::Standard {
                if let Some(beta) = &table.get_ref().beta_deg {
                    let message = "beta_deg in a table of the standard convention, which has none";
                    return self.error(beta.span(), message, "no beta_deg, or convention = \"craig\"");
                }
                let own = (link.a, link.alpha);
                (link.a, link.alpha) = std::mem::replace(&mut behind, own);
            }
            links.push(link);
        }
        let last_from_flange: Transform = translation(behind.0, 0.0, 0.0)
            * rotation_x(behind.1)
            * self.frame("flange", self.file.flange.as_ref())?;
        let base_from_first = self.frame("base", self.file.base.as_ref())?;
        Ok(KinematicModel { links, base_from_first, last_from_flange })
    }

    fn link(&self, table: &Spanned<JointTable>) -> Result<CraigLink, InputError> {
        let joint = table.get_ref();
        let name = joint.name.get_ref();
        if name.trim().is_empty() {
            return self.error(joint.name.span(), "name is empty", "the joint's name, as in the URDF");
        }
        let beta = joint.beta_deg.as_ref().map_or(Ok(0.0), |beta| self.degrees("beta_deg", beta))?;
        Ok(CraigLink {
            name: name.clone(),
            kind: match joint.r#type {
                JointType::Revolute => JointKind::Revolute,
                JointType::Prismatic => JointKind::Prismatic,
            },
            a: self.millimetres("a_mm", &joint.a_mm)?,
            alpha: self.degrees("alpha_deg", &joint.alpha_deg)?,
            beta,
            d: self.millimetres("d_mm", &joint.d_mm)?,
            theta: self.degrees("theta_deg", &joint.theta_deg)?,
            limits: self.limits(table)?,
        })
    }

    /// The value of the key in the joint's unit; the key in the other unit is an error.
    fn in_unit_of_joint<'v>(
        &self,
        table: &Spanned<JointTable>,
        prismatic: (&str, &'v Option<Spanned<f64>>),
        revolute: (&str, &'v Option<Spanned<f64>>),
    ) -> Result<(String, Option<&'v Spanned<f64>>), InputError> {
        let joint = table.get_ref();
        let (kind, (right, value), (wrong, other)) = match joint.r#type {
            JointType::Prismatic => ("prismatic", prismatic, revolute),
            JointType::Revolute => ("revolute", revolute, prismatic),
        };
        if let Some(other) = other {
            let message = format!("{wrong} of joint {:?}, which is {kind}", joint.name.get_ref());
            return self.error(other.span(), message, right);
        }
        Ok((right.to_owned(), value.as_ref()))
    }

    fn limits(&self, table: &Spanned<JointTable>) -> Result<[f64; 2], InputError> {
        let joint = table.get_ref();
        let bounds = [
            self.in_unit_of_joint(table, ("min_mm", &joint.min_mm), ("min_deg", &joint.min_deg))?,
            self.in_unit_of_joint(table, ("max_mm", &joint.max_mm), ("max_deg", &joint.max_deg))?,
        ];
        let mut limits = [0.0; 2];
        for (limit, (key, value)) in limits.iter_mut().zip(&bounds) {
            let Some(value) = value else {
                let message = format!("joint {:?} has no {key}", joint.name.get_ref());
                return self.error(table.span(), message, key);
            };
            *limit = match joint.r#type {
                JointType::Prismatic => self.millimetres(key, value)?,
                JointType::Revolute => self.degrees(key, value)?,
            };
        }
        if limits[0] >= limits[1] {
            let (key, value) = &bounds[1];
            let message = format!("{key} of joint {:?} is not above {}", joint.name.get_ref(), bounds[0].0);
            let span = value.map_or(table.span(), Spanned::span);
            return self.error(span, message, "the lower limit below the upper");
        }
        Ok(limits)
    }

    /// N/m or N m/rad, one per joint; `None` if no joint has any.
    pub(super) fn drives(&self) -> Result<Option<Vec<f64>>, InputError> {
        let mut stiffness = Vec::new();
        let mut without = None;
        for table in &self.file.joint {
            let joint = table.get_ref();
            let (key, value) = self.in_unit_of_joint(
                table,
                ("stiffness_n_per_m", &joint.stiffness_n_per_m),
                ("stiffness_nm_per_rad", &joint.stiffness_nm_per_rad),
            )?;
            match value {
                // A rigid drive.
                Some(value) if *value.get_ref() == f64::INFINITY => stiffness.push(f64::INFINITY),
                Some(value) => stiffness.push(self.source.positive(&key, value)?),
                None => without = without.or(Some((table, key))),
            }
        }
        match without {
            Some(_) if stiffness.is_empty() => Ok(None),
            Some((table, key)) => {
                let message =
                    format!("joint {:?} has no {key}, but others have", table.get_ref().name.get_ref());
                self.error(table.span(), message, "a stiffness of every drive, or of none")
            }
            None => Ok(Some(stiffness)),
        }
    }

    /// Per metre or per radian, one per joint, if known.
    pub(super) fn motor_turns(&self) -> Result<Vec<Option<f64>>, InputError> {
        let turns = |table: &Spanned<JointTable>| {
            let joint = table.get_ref();
            let (key, value) = self.in_unit_of_joint(
                table,
                ("motor_turns_per_m", &joint.motor_turns_per_m),
                ("motor_turns_per_rev", &joint.motor_turns_per_rev),
            )?;
            let per_unit = match joint.r#type {
                JointType::Prismatic => 1.0,
                JointType::Revolute => TAU,
            };
            value.map(|value| Ok(self.source.positive(&key, value)? / per_unit)).transpose()
        };
        self.file.joint.iter().map(turns).collect()
    }
}
