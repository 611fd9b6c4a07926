//! Place, weight and validity of a flexible link.

use nalgebra::Vector3;
use thiserror::Error;

use super::{Beam, BeamRun, BeamSegment, CraigLink, JointKind, Section, SegmentLength};

/// What is wrong with a flexible link. Segments count from zero here and from one in messages.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[non_exhaustive]
pub enum BeamError {
    /// A beam without segments.
    #[error("the beam has no segments")]
    Empty,
    /// A segment without length at some joint variable.
    #[error("beam segment {} is {length} m long at the joint variable {q}; its length must be positive", segment.saturating_add(1))]
    Length {
        /// Index of the segment.
        segment: usize,
        /// m
        length: f64,
        /// The joint variable, rad or m.
        q: f64,
    },
    /// A segment that grows with a turning joint.
    #[error("beam segment {} follows the extension of a joint that is not prismatic", segment.saturating_add(1))]
    ExtensionOfRevolute {
        /// Index of the segment.
        segment: usize,
    },
    /// A stiffness that is not positive.
    #[error("beam segment {} has the {property} {value}; it must be positive (infinite if rigid)", segment.saturating_add(1))]
    Stiffness {
        /// Index of the segment.
        segment: usize,
        /// Which.
        property: &'static str,
        /// N or N m²
        value: f64,
    },
    /// A mass that is negative or infinite.
    #[error("beam segment {} has {value} kg/m; it must be finite and not negative", segment.saturating_add(1))]
    MassPerLength {
        /// Index of the segment.
        segment: usize,
        /// kg/m
        value: f64,
    },
}

impl BeamRun {
    /// The link frame's axes in the order of the section's: along the beam, then its second and third axis.
    pub fn axes(self) -> [usize; 3] {
        match self {
            Self::AlongX => [0, 1, 2],
            Self::EndsAtOrigin => [2, 0, 1],
        }
    }
}

impl Section {
    /// The stiffnesses by name: axial, shear, torsion, bending.
    fn named(&self) -> [(&'static str, f64); 6] {
        [
            ("axial stiffness", self.axial),
            ("shear stiffness along its second axis", self.shear[0]),
            ("shear stiffness along its third axis", self.shear[1]),
            ("torsional stiffness", self.torsion),
            ("bending stiffness about its second axis", self.bending[0]),
            ("bending stiffness about its third axis", self.bending[1]),
        ]
    }
}

impl Beam {
    /// From root to tip at the joint variable `q`, m.
    pub fn length(&self, q: f64) -> f64 {
        self.segments.iter().map(|s| s.length.at(q)).sum()
    }

    /// At the joint variable `q`, kg.
    pub fn mass(&self, q: f64) -> f64 {
        self.segments.iter().map(|s| s.length.at(q) * s.section.mass_per_length).sum()
    }

    /// The point at `from_root` (m) along the undeflected beam in the link's frame, m.
    pub fn point(&self, from_root: f64, q: f64) -> Vector3<f64> {
        match self.run {
            BeamRun::AlongX => Vector3::new(from_root, 0.0, 0.0),
            BeamRun::EndsAtOrigin => Vector3::new(0.0, 0.0, from_root - self.length(q)),
        }
    }

    /// The segments' lengths from root to tip at the joint variable `q`, m.
    ///
    /// # Errors
    ///
    /// [`BeamError::Length`] where one is not positive and finite.
    pub fn lengths(&self, q: f64) -> Result<Vec<f64>, BeamError> {
        let length = |(segment, s): (usize, &BeamSegment)| {
            let length = s.length.at(q);
            if length > 0.0 && length.is_finite() {
                Ok(length)
            } else {
                Err(BeamError::Length { segment, length, q })
            }
        };
        self.segments.iter().enumerate().map(length).collect()
    }

    /// Whether the beam is valid for `link` between its joint's limits.
    ///
    /// # Errors
    ///
    /// [`BeamError`].
    pub fn check(&self, link: &CraigLink) -> Result<(), BeamError> {
        self.check_sections()?;
        let extends = |segment: &BeamSegment| matches!(segment.length, SegmentLength::Extension(_));
        if link.kind != JointKind::Prismatic
            && let Some(segment) = self.segments.iter().position(extends)
        {
            return Err(BeamError::ExtensionOfRevolute { segment });
        }
        // A length is linear in the joint variable: the limits are the extremes.
        link.limits.iter().try_for_each(|q| self.lengths(*q).map(drop))
    }

    /// Whether its sections are valid, whatever link carries it.
    ///
    /// # Errors
    ///
    /// [`BeamError`] for a beam without segments, or with an invalid stiffness or mass.
    pub fn check_sections(&self) -> Result<(), BeamError> {
        if self.segments.is_empty() {
            return Err(BeamError::Empty);
        }
        for (segment, BeamSegment { section, .. }) in self.segments.iter().enumerate() {
            if let Some((property, value)) = section.named().into_iter().find(|(_, value)| !(*value > 0.0)) {
                return Err(BeamError::Stiffness { segment, property, value });
            }
            let value = section.mass_per_length;
            if !(value >= 0.0 && value.is_finite()) {
                return Err(BeamError::MassPerLength { segment, value });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TUBE: Section =
        Section { axial: 4e8, shear: [8e7, 9e7], torsion: 5e5, bending: [6e5, 7e5], mass_per_length: 20.0 };

    fn telescope() -> (Beam, CraigLink) {
        let segments = vec![
            BeamSegment { length: SegmentLength::Constant(0.4), section: TUBE },
            BeamSegment { length: SegmentLength::Extension(1.2), section: TUBE },
        ];
        let link = CraigLink {
            name: "forearm".to_owned(),
            kind: JointKind::Prismatic,
            a: 0.0,
            alpha: 0.0,
            beta: 0.0,
            d: 0.0,
            theta: 0.0,
            limits: [1.7, 2.3],
        };
        (Beam { run: BeamRun::EndsAtOrigin, segments }, link)
    }

    #[test]
    fn a_telescope_ends_at_its_frame_and_grows_with_its_joint() {
        let (beam, link) = telescope();
        assert_eq!(beam.check(&link), Ok(()));
        assert!((beam.length(2.0) - 1.2).abs() < 1e-15 && (beam.mass(2.0) - 24.0).abs() < 1e-14);
        assert!(beam.point(beam.length(2.0), 2.0).norm() == 0.0);
        assert!((beam.point(0.4, 2.0) - Vector3::new(0.0, 0.0, -0.8)).norm() < 1e-15);
        let arm = Beam { run: BeamRun::AlongX, ..beam };
        assert_eq!(arm.point(0.4, 2.0), Vector3::new(0.4, 0.0, 0.0));
    }

    #[test]
    fn beams_that_cannot_be_are_refused() {
        let (beam, link) = telescope();
        let changed = |change: &dyn Fn(&mut Beam, &mut CraigLink)| {
            let (mut beam, mut link) = (beam.clone(), link.clone());
            change(&mut beam, &mut link);
            beam.check(&link)
        };
        assert_eq!(changed(&|beam, _| beam.segments.clear()), Err(BeamError::Empty));
        assert_eq!(
            changed(&|_, link| link.kind = JointKind::Revolute),
            Err(BeamError::ExtensionOfRevolute { segment: 1 })
        );
        assert_eq!(
            changed(&|_, link| link.limits[0] = 1.2),
            Err(BeamError::Length { segment: 1, length: 0.0, q: 1.2 })
        );
        assert!(matches!(
            changed(&|_, link| link.limits[1] = f64::INFINITY),
            Err(BeamError::Length { segment: 1, .. })
        ));
        for wrong in [0.0, -1.0, f64::NAN] {
            assert!(matches!(
                changed(&|beam, _| beam.segments[1].section.bending[1] = wrong),
                Err(BeamError::Stiffness {
                    segment: 1,
                    property: "bending stiffness about its third axis",
                    ..
                })
            ));
        }
        for wrong in [f64::INFINITY, -1.0, f64::NAN] {
            assert!(matches!(
                changed(&|beam, _| beam.segments[0].section.mass_per_length = wrong),
                Err(BeamError::MassPerLength { segment: 0, .. })
            ));
        }
        assert_eq!(changed(&|beam, _| beam.segments[0].section = Section::RIGID), Ok(()));
    }
}
