//! Which parts of a robot are compliant.

use super::{CalibrationModel, Compliance, JointKind, KinematicModel, LinkageTerm, StaticProperties};

impl CalibrationModel {
    /// Every compliance: joint by joint the drive, the bearing and the beam; then the rod.
    pub fn compliances(&self) -> Vec<Compliance> {
        self.statics.as_ref().map_or_else(Vec::new, |statics| statics.compliances(&self.kinematics))
    }

    /// The parameters of the four-bar, if known.
    pub fn linkage_terms(&self) -> Vec<LinkageTerm> {
        if self.actuators.four_bar().is_some() { LinkageTerm::ALL.to_vec() } else { Vec::new() }
    }
}

impl StaticProperties {
    fn compliances(&self, kinematics: &KinematicModel) -> Vec<Compliance> {
        let mut all = Vec::new();
        for (joint, link) in kinematics.links.iter().enumerate() {
            if self.drive_stiffness.get(joint).is_some_and(|k| k.is_finite()) {
                all.push(Compliance::Drive { joint });
            }
            let own = match link.kind {
                JointKind::Prismatic => 2,
                JointKind::Revolute => 5,
            };
            let bearing = self.bearings.get(joint).copied().unwrap_or_default();
            let yields = |axis: &usize| *axis != own && bearing.stiffness[*axis].is_finite();
            all.extend((0..6).filter(yields).map(|axis| Compliance::Bearing { joint, axis }));
            let beam = self.beams.get(joint).into_iter().flatten().flat_map(|beam| &beam.segments);
            if beam.map(|segment| segment.section).any(|section| !section.is_rigid()) {
                all.push(Compliance::Beam { link: joint });
            }
        }
        if self.linkage.as_ref().is_some_and(|linkage| linkage.rod_stiffness.is_finite()) {
            all.push(Compliance::Rod);
        }
        all
    }

    /// The stiffness behind a compliance: of the drive, the bearing's axis or the rod; for a beam, the bending stiffness EI of its
    /// first elastic segment, N m². `None` if the robot has no such part.
    pub fn stiffness(&self, compliance: Compliance) -> Option<f64> {
        match compliance {
            Compliance::Drive { joint } => self.drive_stiffness.get(joint).copied(),
            Compliance::Bearing { joint, axis } => self.bearings.get(joint)?.stiffness.get(axis).copied(),
            Compliance::Beam { link } => {
                let segments = &self.beams.get(link)?.as_ref()?.segments;
                segments.iter().map(|segment| segment.section.bending[0]).find(|ei| ei.is_finite())
            }
            Compliance::Rod => self.linkage.as_ref().map(|linkage| linkage.rod_stiffness),
        }
    }
}
