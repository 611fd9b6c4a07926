//! Whether the elbow's four-bar closes, and how well its rod turns the elbow.

use std::fmt;

use nalgebra::Point3;

use super::{ActuatorMap, CraigLink, FourBar, KinematicModel};
use crate::geometry::rotation_z;

/// Least angle between the rod and the arm that it turns, rad. Below it the rod is nearly in line with the lever: its force, and the
/// effect of an error of its length on the elbow, grow without bound, and the pose is refused.
pub const LEAST_TRANSMISSION_ANGLE: f64 = 10.0 * std::f64::consts::PI / 180.0;

/// Number of elbow angles at which a four-bar is checked: 0.1 to 0.2 deg apart on a usual elbow.
const SAMPLES: u32 = 1000;
/// Number of shoulder and elbow angles, if the crank's axis differs from the shoulder's, so that both change the
/// four-bar's shape.
const OFF_AXIS_SAMPLES: [u32; 2] = [36, 250];

/// An angle of the elbow, within its limits, at which a four-bar fails.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkageFault {
    /// Of the ideal parallelogram, rad.
    pub elbow: f64,
    /// Of the shoulder, rad, if the crank's axis differs from the shoulder's; otherwise the four-bar's shape depends only on the
    /// elbow.
    pub shoulder: Option<f64>,
    /// Angle between rod and lever, rad; `None` where the bars do not reach each other.
    pub transmission: Option<f64>,
}

impl fmt::Display for LinkageFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.transmission {
            None => write!(f, "the four-bar does not close")?,
            Some(angle) => {
                write!(f, "rod and lever are within {:.1} deg of one line", angle.to_degrees())?;
            }
        }
        write!(f, " with the elbow at {:.1} deg", self.elbow.to_degrees())?;
        match self.shoulder {
            Some(shoulder) => write!(f, " and the shoulder at {:.1} deg", shoulder.to_degrees()),
            None => Ok(()),
        }
    }
}

/// The worst fault of the four-bar between the limits of the elbow (and of the shoulder, if its crank's axis differs from the shoulder's), if
/// it has any.
pub fn linkage_fault(kinematics: &KinematicModel, actuators: &ActuatorMap) -> Option<LinkageFault> {
    let (shoulder, elbow, _, linkage) = actuators.four_bar()?;
    let (upper, link) = (&kinematics.links[shoulder], &kinematics.links[elbow]);
    let between = |[low, high]: [f64; 2], sample: u32, samples: u32| {
        low + (high - low) * f64::from(sample) / f64::from(samples)
    };
    let [shoulders, elbows] = if linkage.axis.is_shoulders() { [0, SAMPLES] } else { OFF_AXIS_SAMPLES };
    (0..=shoulders)
        .flat_map(|sample| (0..=elbows).map(move |elbow| (sample, elbow)))
        .map(|(sample, elbow)| {
            let shoulder = (shoulders > 0).then(|| between(upper.limits, sample, shoulders));
            let elbow = between(link.limits, elbow, elbows);
            let transmission = linkage.transmission(link, shoulder.unwrap_or(0.0), elbow);
            LinkageFault { elbow, shoulder, transmission }
        })
        .filter(|fault| fault.transmission.is_none_or(|angle| angle < LEAST_TRANSMISSION_ANGLE))
        .min_by(|a, b| a.transmission.unwrap_or(-1.0).total_cmp(&b.transmission.unwrap_or(-1.0)))
}

impl FourBar {
    /// Transmission angle, 0 to pi/2: its sine times the rod's force times the lever is the moment about the elbow's axis. `None` where the
    /// linkage does not close.
    ///
    /// `elbow` is the joint variable of the exact parallelogram, `psi + offset - shoulder`. It is the same for both ways to close. The shoulder's
    /// joint variable matters only if the crank's axis differs from the shoulder's.
    fn transmission(&self, elbow_link: &CraigLink, shoulder: f64, elbow: f64) -> Option<f64> {
        // In front of the elbow's motion the lever's end runs on a circle about z, and the crank's end stands still.
        let in_shoulder = if self.axis.is_shoulders() {
            rotation_z(elbow + elbow_link.theta)
        } else {
            rotation_z(-shoulder)
                * self.axis.shoulder_from_axis()
                * rotation_z(shoulder + elbow + elbow_link.theta)
        };
        let crank = elbow_link.fixed_part().inverse() * (in_shoulder * Point3::from(self.crank.end()));
        let (reach, lever) = (crank.x.hypot(crank.y), self.lever.length);
        let apart = crank.z - self.lever.along;
        let cosine =
            (reach * reach + lever * lever + apart * apart - self.rod * self.rod) / (2.0 * reach * lever);
        // Written this way round, it treats NaN as not closing.
        (cosine.abs() <= 1.0).then(|| (reach * (1.0 - cosine * cosine).sqrt() / self.rod).min(1.0).asin())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{rotation_x, rotation_y, translation};
    use crate::{CrankAxis, JointKind, LinkageArm};

    /// Shoulder and elbow 1.35 m apart, with arms of 0.35 m.
    fn machine(change: impl Fn(&mut FourBar)) -> (KinematicModel, ActuatorMap) {
        let link = |a: f64, limits: [f64; 2]| CraigLink {
            name: String::new(),
            kind: JointKind::Revolute,
            a,
            alpha: 0.0,
            beta: 0.0,
            d: 0.0,
            theta: 0.0,
            limits: limits.map(f64::to_radians),
        };
        let arm = LinkageArm { length: 0.35, angle: std::f64::consts::FRAC_PI_2, along: 0.25 };
        let mut linkage = FourBar { crank: arm, lever: arm, rod: 1.35, axis: CrankAxis::default() };
        change(&mut linkage);
        let kinematics = KinematicModel {
            links: vec![link(0.0, [-150.0, -50.0]), link(1.35, [-45.0, 60.0])],
            base_from_first: crate::geometry::Transform::identity(),
            last_from_flange: crate::geometry::Transform::identity(),
        };
        let actuators =
            ActuatorMap::Parallelogram { shoulder: 0, elbow: 1, offset: 0.0, linkage: Some(linkage) };
        (kinematics, actuators)
    }

    /// In an exact parallelogram the rod stays parallel to the upper arm.
    #[test]
    fn an_exact_parallelogram_transmits_by_the_angle_between_lever_and_upper_arm() {
        let (kinematics, actuators) = machine(|_| {});
        let linkage = *actuators.four_bar().unwrap().3;
        for elbow in [-1.2, -0.5_f64, 0.0, 0.4, 1.1] {
            let found = linkage.transmission(&kinematics.links[1], 0.7, elbow).unwrap();
            let expected = std::f64::consts::FRAC_PI_2 - elbow.abs();
            assert!((found - expected).abs() < 1e-9, "{elbow}: {found}");
        }
        assert_eq!(linkage_fault(&kinematics, &actuators), None);
    }

    #[test]
    fn the_worst_angle_of_the_elbow_is_named() {
        let (mut kinematics, actuators) = machine(|_| {});
        kinematics.links[1].limits = [-45_f64, 85.0].map(f64::to_radians);
        let fault = linkage_fault(&kinematics, &actuators).unwrap();
        assert!((fault.elbow.to_degrees() - 85.0).abs() < 1e-9);
        assert!((fault.transmission.unwrap().to_degrees() - 5.0).abs() < 1e-6);
        assert!(fault.to_string().contains("within 5.0 deg of one line"), "{fault}");

        // At -45 deg the crank's end is 1.13 m from the elbow: rod and lever together are too short or too long by far.
        let (kinematics, actuators) = machine(|linkage| linkage.rod = 1.9);
        let fault = linkage_fault(&kinematics, &actuators).unwrap();
        assert_eq!(fault.transmission, None);
        assert!(fault.to_string().contains("does not close"), "{fault}");
        let (kinematics, actuators) = machine(|linkage| linkage.rod = 0.1);
        assert_eq!(linkage_fault(&kinematics, &actuators).unwrap().transmission, None);
    }

    #[test]
    fn an_axis_off_the_shoulders_is_looked_at_wherever_the_shoulder_turns_it() {
        // 0.3 m off along x of the shoulder's frame: with the upper arm away from it the rod is too short, at right angles it is not.
        let (mut kinematics, actuators) = machine(|linkage| linkage.axis.x = 0.3);
        let fault = linkage_fault(&kinematics, &actuators).unwrap();
        assert_eq!(fault.transmission, None);
        assert!(fault.to_string().contains("and the shoulder at -150.0 deg"), "{fault}");
        kinematics.links[0].limits = [-105_f64, -95.0].map(f64::to_radians);
        kinematics.links[1].limits = [-5_f64, 5.0].map(f64::to_radians);
        assert_eq!(linkage_fault(&kinematics, &actuators), None);
    }

    /// Moment about the elbow per rod force and lever, from the rotated lever end.
    #[test]
    fn the_sine_of_the_angle_is_the_lever_arm_of_the_rod() {
        let (kinematics, actuators) = machine(|linkage| {
            linkage.lever = LinkageArm { length: 0.31, angle: 1.4, along: 0.19 };
            linkage.rod = 1.37;
            linkage.axis = CrankAxis { x: 0.02, y: -0.03, rx: 0.04, ry: -0.02 };
        });
        let linkage = *actuators.four_bar().unwrap().3;
        let elbow_link = CraigLink { alpha: 0.02, beta: -0.01, d: 0.03, ..kinematics.links[1].clone() };
        let (shoulder, ideal) = (-1.9, 0.3);
        let axis = translation(0.02, -0.03, 0.0) * rotation_x(0.04) * rotation_y(-0.02);
        let crank = axis * rotation_z(shoulder + ideal) * Point3::from(linkage.crank.end());
        let distance = |q: f64| {
            let lever = rotation_z(shoulder) * elbow_link.transform(q) * Point3::from(linkage.lever.end());
            (lever - crank).norm()
        };
        // The closure by bisection.
        let (mut low, mut high) = (ideal - 0.6, ideal + 0.6);
        assert!((distance(low) - linkage.rod) * (distance(high) - linkage.rod) < 0.0);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            let same = (distance(middle) - linkage.rod) * (distance(low) - linkage.rod) > 0.0;
            if same { low = middle } else { high = middle }
        }
        let step = 1e-6;
        let arm = (distance(low + step) - distance(low - step)) / (2.0 * step * linkage.lever.length);
        let found = linkage.transmission(&elbow_link, shoulder, ideal).unwrap();
        assert!((found.sin() - arm.abs()).abs() < 1e-8, "{} {arm}", found.sin());
    }
}
