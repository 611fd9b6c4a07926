//! `[joint.shown]` and `[joint.follows]`: how the controller counts its axes, and joints that it does not command.

use std::collections::BTreeMap;
use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use serde::Deserialize;

use super::Reader;
use super::joints::{JointTable, JointType};
use crate::input::{InputError, Spanned};
use calibrig_model::{ActuatorMap, AxisMap};

/// What the controller shows of a joint: `sign · ratio · (q + coupling · q of others) + offset`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ShownTable {
    sign: Option<Spanned<f64>>,
    ratio: Option<Spanned<f64>>,
    offset_deg: Option<Spanned<f64>>,
    offset_mm: Option<Spanned<f64>>,
    #[serde(default)]
    coupling: BTreeMap<String, Spanned<f64>>,
}

/// A joint that follows another one: `q = ratio · q of that + offset`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FollowsTable {
    joint: Spanned<String>,
    ratio: Option<Spanned<f64>>,
    offset_deg: Option<Spanned<f64>>,
    offset_mm: Option<Spanned<f64>>,
}

/// Size of a joint's unit in the file: deg or mm.
fn unit(joint: &JointTable) -> f64 {
    match joint.r#type {
        JointType::Revolute => 1_f64.to_radians(),
        JointType::Prismatic => 1e-3,
    }
}

impl Reader<'_> {
    /// The map of a robot whose actuators, regardless of how they are shown, are `mechanism`.
    pub(super) fn axes(&self, mechanism: ActuatorMap) -> Result<ActuatorMap, InputError> {
        let joints: Vec<&JointTable> = self.file.joint.iter().map(Spanned::get_ref).collect();
        if joints.iter().all(|joint| joint.shown.is_none() && joint.follows.is_none()) {
            return Ok(mechanism);
        }
        let count = joints.len();
        let (mut rows, mut zero) = (DMatrix::identity(count, count), DVector::zeros(count));
        let mut followers = Vec::new();
        for (axis, joint) in joints.iter().enumerate() {
            match (&joint.shown, &joint.follows) {
                (Some(_), Some(follows)) => {
                    let message = format!("joint {:?} has both shown and follows", joint.name.get_ref());
                    return self.error(
                        follows.span(),
                        message,
                        "only one of them: a joint that follows another has no command",
                    );
                }
                (Some(shown), None) => {
                    zero[axis] = self.offset(
                        joint,
                        shown.get_ref().offset_deg.as_ref(),
                        shown.get_ref().offset_mm.as_ref(),
                    )?;
                    self.shown(&joints, axis, shown.get_ref(), &mut rows)?;
                }
                (None, Some(follows)) => {
                    let table = follows.get_ref();
                    let leader = self.leader(&joints, axis, table)?;
                    if mechanism.elbow().is_some_and(|drive| drive.elbow == axis) {
                        let message = "the elbow of the parallelogram follows a joint";
                        return self.error(follows.span(), message, "no [joint.follows] there");
                    }
                    let ratio = self.finite_or_one("follows.ratio", table.ratio.as_ref())?;
                    rows[(axis, leader)] -= ratio * unit(joint) / unit(joints[leader]);
                    zero[axis] = -self.offset(joint, table.offset_deg.as_ref(), table.offset_mm.as_ref())?;
                    followers.push(axis);
                }
                (None, None) => {}
            }
        }
        let axes = AxisMap::new(rows, zero).map_err(|error| {
            let place = joints.iter().find_map(|joint| {
                let coupled = joint.shown.as_ref().filter(|table| !table.get_ref().coupling.is_empty());
                coupled.map(Spanned::span)
            });
            let expected = "expected couplings that determine every joint variable".to_owned();
            self.source.error(place.unwrap_or(0..0), error, Some(expected))
        })?;
        Ok(ActuatorMap::Axes { axes: axes.with_followers(&followers), elbow: mechanism.elbow() })
    }

    /// Fills the row of an axis that is shown differently.
    fn shown(
        &self,
        joints: &[&JointTable],
        axis: usize,
        table: &ShownTable,
        rows: &mut DMatrix<f64>,
    ) -> Result<(), InputError> {
        let joint = joints[axis];
        let mut factor = 1.0;
        if let Some(sign) = &table.sign {
            if ![1.0, -1.0].contains(sign.get_ref()) {
                let message = format!("shown.sign of joint {:?} is {}", joint.name.get_ref(), sign.get_ref());
                return self.error(sign.span(), message, "1 or -1; use ratio for other factors");
            }
            factor = *sign.get_ref();
        }
        if let Some(ratio) = &table.ratio {
            factor *= self.source.positive("shown.ratio", ratio)?;
        }
        for (name, share) in &table.coupling {
            let other = self.joint_named(joints, "shown.coupling", name, share.span())?;
            if other == axis {
                let message = format!("shown.coupling couples joint {name:?} with itself");
                return self.error(share.span(), message, "the names of other joints");
            }
            rows[(axis, other)] =
                self.source.finite("shown.coupling", share)? * unit(joint) / unit(joints[other]);
        }
        rows.row_mut(axis).scale_mut(factor);
        Ok(())
    }

    /// The joint that another one follows: itself, or through others, a commanded one.
    fn leader(&self, joints: &[&JointTable], axis: usize, table: &FollowsTable) -> Result<usize, InputError> {
        let name = &table.joint;
        let leader = self.joint_named(joints, "follows.joint", name.get_ref(), name.span())?;
        let mut at = leader;
        for _ in joints {
            let Some(next) = &joints[at].follows else { return Ok(leader) };
            if at == axis {
                break;
            }
            let next = &next.get_ref().joint;
            at = self.joint_named(joints, "follows.joint", next.get_ref(), next.span())?;
        }
        let message = format!(
            "joint {:?} is in a circle of joints that follow each other",
            joints[axis].name.get_ref()
        );
        self.error(name.span(), message, "a chain that ends at a commanded joint")
    }

    fn joint_named(
        &self,
        joints: &[&JointTable],
        key: &str,
        name: &str,
        span: Range<usize>,
    ) -> Result<usize, InputError> {
        match joints.iter().position(|joint| joint.name.get_ref() == name) {
            Some(index) => Ok(index),
            None => {
                let names: Vec<_> = joints.iter().map(|joint| joint.name.get_ref().as_str()).collect();
                self.error(
                    span,
                    format!("{key}: no joint is named {name:?}"),
                    &format!("one of {}", names.join(", ")),
                )
            }
        }
    }

    fn offset(
        &self,
        joint: &JointTable,
        degrees: Option<&Spanned<f64>>,
        millimetres: Option<&Spanned<f64>>,
    ) -> Result<f64, InputError> {
        let (own, other) = match joint.r#type {
            JointType::Revolute => (("offset_deg", degrees), millimetres),
            JointType::Prismatic => (("offset_mm", millimetres), degrees),
        };
        if let Some(other) = other {
            let message = format!("an offset in the other unit, that of joint {:?}", joint.name.get_ref());
            return self.error(other.span(), message, own.0);
        }
        let (key, value) = own;
        value.map_or(Ok(0.0), |value| Ok(self.source.finite(key, value)? * unit(joint)))
    }

    fn finite_or_one(&self, key: &str, value: Option<&Spanned<f64>>) -> Result<f64, InputError> {
        value.map_or(Ok(1.0), |value| self.source.finite(key, value))
    }
}
