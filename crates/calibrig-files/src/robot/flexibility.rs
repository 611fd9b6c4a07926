//! `[joint.bearing]` and `[joint.beam]`: what deflects besides the drives.

use serde::Deserialize;

use super::Reader;
use super::joints::{JointTable, JointType};
use super::section::{Material, Shape};
use crate::input::{InputError, Spanned};
use crate::spring_table;
use calibrig_model::{Beam, BeamRun, BeamSegment, Bearing, BearingSide, Section, SegmentLength};

spring_table! {
    pub(super) struct BearingTable {
        #[serde(default)]
        side: Side,
        at_mm: Option<Spanned<f64>>,
    }
}

#[derive(Deserialize, Default, Clone, Copy)]
#[serde(rename_all = "snake_case")]
enum Side {
    #[default]
    Moving,
    Fixed,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BeamTable {
    run: Run,
    #[serde(default)]
    segment: Vec<Spanned<SegmentTable>>,
}

#[derive(Deserialize, Clone, Copy, PartialEq)]
#[serde(rename_all = "snake_case")]
enum Run {
    AlongX,
    EndsAtOrigin,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SegmentTable {
    length_mm: Option<Spanned<f64>>,
    housed_mm: Option<Spanned<f64>>,
    youngs_modulus_gpa: Option<Spanned<f64>>,
    shear_modulus_gpa: Option<Spanned<f64>>,
    density_kg_per_m3: Option<Spanned<f64>>,
    mass_per_length_kg_per_m: Option<Spanned<f64>>,
    wall_mm: Option<Spanned<f64>>,
    tube_diameter_mm: Option<Spanned<f64>>,
    box_width_mm: Option<Spanned<f64>>,
    box_height_mm: Option<Spanned<f64>>,
    axial_n: Option<Spanned<f64>>,
    shear_2_n: Option<Spanned<f64>>,
    shear_3_n: Option<Spanned<f64>>,
    torsion_nm2: Option<Spanned<f64>>,
    bending_2_nm2: Option<Spanned<f64>>,
    bending_3_nm2: Option<Spanned<f64>>,
}

impl SegmentTable {
    /// The keys of a section given by its stiffnesses.
    fn stiffnesses(&self) -> [(&'static str, &Option<Spanned<f64>>); 6] {
        [
            ("axial_n", &self.axial_n),
            ("shear_2_n", &self.shear_2_n),
            ("shear_3_n", &self.shear_3_n),
            ("torsion_nm2", &self.torsion_nm2),
            ("bending_2_nm2", &self.bending_2_nm2),
            ("bending_3_nm2", &self.bending_3_nm2),
        ]
    }

    /// The keys of a section given by its shape.
    fn of_shape(&self) -> [(&'static str, &Option<Spanned<f64>>); 7] {
        [
            ("youngs_modulus_gpa", &self.youngs_modulus_gpa),
            ("shear_modulus_gpa", &self.shear_modulus_gpa),
            ("density_kg_per_m3", &self.density_kg_per_m3),
            ("wall_mm", &self.wall_mm),
            ("tube_diameter_mm", &self.tube_diameter_mm),
            ("box_width_mm", &self.box_width_mm),
            ("box_height_mm", &self.box_height_mm),
        ]
    }
}

impl Reader<'_> {
    /// One per joint, rigid without a table.
    pub(super) fn bearings(&self) -> Result<Vec<Bearing>, InputError> {
        let joints = self.file.joint.iter().map(Spanned::get_ref);
        joints
            .map(|joint| {
                joint.bearing.as_ref().map_or(Ok(Bearing::default()), |table| self.bearing(joint, table))
            })
            .collect()
    }

    fn bearing(&self, joint: &JointTable, table: &Spanned<BearingTable>) -> Result<Bearing, InputError> {
        let file = table.get_ref();
        let name = joint.name.get_ref();
        let keys = file.stiffnesses();
        let (own_axis, drive) = match joint.r#type {
            JointType::Prismatic => (2, "stiffness_n_per_m of the joint itself, for its drive"),
            JointType::Revolute => (5, "stiffness_nm_per_rad of the joint itself, for its drive"),
        };
        if let (key, Some(value)) = keys[own_axis] {
            let message = format!("{key} of the bearing is along or about the axis of joint {name:?}");
            return self.error(value.span(), message, drive);
        }
        if keys.iter().all(|(_, value)| value.is_none()) {
            let message = format!("[joint.bearing] of joint {name:?} has no stiffness");
            return self.error(table.span(), message, "at least one stiffness, or no [joint.bearing]");
        }
        let mut bearing = Bearing {
            side: match file.side {
                Side::Moving => BearingSide::Moving,
                Side::Fixed => BearingSide::Fixed,
            },
            ..Bearing::default()
        };
        for (stiffness, (key, value)) in bearing.stiffness.iter_mut().zip(keys) {
            if let Some(value) = value {
                *stiffness = self.source.positive(key, value)?;
            }
        }
        if let Some(at) = &file.at_mm {
            bearing.at = self.millimetres("at_mm", at)?;
        }
        Ok(bearing)
    }

    /// One per joint with a flexible link. `limits` are those of the joints' variables.
    pub(super) fn beams(&self, limits: &[[f64; 2]]) -> Result<Vec<Option<Beam>>, InputError> {
        let joints = self.file.joint.iter().map(Spanned::get_ref).zip(limits);
        joints
            .map(|(joint, limits)| {
                joint.beam.as_ref().map(|table| self.beam(joint, table, *limits)).transpose()
            })
            .collect()
    }

    fn beam(
        &self,
        joint: &JointTable,
        table: &Spanned<BeamTable>,
        limits: [f64; 2],
    ) -> Result<Beam, InputError> {
        let file = table.get_ref();
        if file.segment.is_empty() {
            let message = format!("[joint.beam] of joint {:?} has no segment", joint.name.get_ref());
            return self.error(table.span(), message, "[[joint.beam.segment]], from root to tip");
        }
        let segments = file.segment.iter().map(|segment| {
            Ok(BeamSegment {
                length: self.segment_length(joint, file.run, segment, limits)?,
                section: self.section(segment)?,
            })
        });
        Ok(Beam {
            run: match file.run {
                Run::AlongX => BeamRun::AlongX,
                Run::EndsAtOrigin => BeamRun::EndsAtOrigin,
            },
            segments: segments.collect::<Result<_, InputError>>()?,
        })
    }

    fn segment_length(
        &self,
        joint: &JointTable,
        run: Run,
        table: &Spanned<SegmentTable>,
        limits: [f64; 2],
    ) -> Result<SegmentLength, InputError> {
        let segment = table.get_ref();
        match (&segment.length_mm, &segment.housed_mm) {
            (Some(length), None) => {
                Ok(SegmentLength::Constant(self.source.positive("length_mm", length)? / 1e3))
            }
            (None, Some(housed)) => {
                if joint.r#type == JointType::Revolute || run == Run::AlongX {
                    let message =
                        format!("housed_mm of joint {:?}, which is not a telescope", joint.name.get_ref());
                    let expected = "length_mm, or a prismatic joint with run = \"ends_at_origin\"";
                    return self.error(housed.span(), message, expected);
                }
                let length = SegmentLength::Extension(self.millimetres("housed_mm", housed)?);
                if length.at(limits[0]) <= 0.0 {
                    let message = format!(
                        "housed_mm leaves no length of the segment at min_mm of joint {:?}",
                        joint.name.get_ref()
                    );
                    return self.error(housed.span(), message, "housed_mm below min_mm");
                }
                Ok(length)
            }
            (Some(length), Some(_)) => {
                self.error(length.span(), "both length_mm and housed_mm are given", "only one of the two")
            }
            (None, None) => self.error(
                table.span(),
                "a segment without a length",
                "length_mm, or housed_mm of a telescope",
            ),
        }
    }

    fn section(&self, table: &Spanned<SegmentTable>) -> Result<Section, InputError> {
        let segment = table.get_ref();
        if segment.stiffnesses().iter().any(|(_, value)| value.is_some()) {
            return self.stated_section(table);
        }
        let material = self.material(table)?;
        let shape = self.shape(table)?;
        match (&segment.density_kg_per_m3, &segment.mass_per_length_kg_per_m) {
            (Some(density), None) => {
                Ok(shape.section(material, self.source.not_negative("density_kg_per_m3", density)?))
            }
            (None, Some(mass)) => Ok(Section {
                mass_per_length: self.source.not_negative("mass_per_length_kg_per_m", mass)?,
                ..shape.section(material, 0.0)
            }),
            (Some(density), Some(_)) => self.error(
                density.span(),
                "both density_kg_per_m3 and mass_per_length_kg_per_m are given",
                "only one of the two",
            ),
            (None, None) => self.error(
                table.span(),
                "a segment without a weight",
                "density_kg_per_m3 or mass_per_length_kg_per_m, which may be 0",
            ),
        }
    }

    /// A section by its stiffnesses, of any shape and material.
    fn stated_section(&self, table: &Spanned<SegmentTable>) -> Result<Section, InputError> {
        let segment = table.get_ref();
        if let Some((key, Some(value))) = segment.of_shape().into_iter().find(|(_, value)| value.is_some()) {
            let message = format!("{key} is given together with stiffnesses of the section");
            return self.error(
                value.span(),
                message,
                "the section either by its stiffnesses, or by shape and material",
            );
        }
        let mut stated = [0.0; 6];
        for (stiffness, (key, value)) in stated.iter_mut().zip(segment.stiffnesses()) {
            *stiffness = self.source.positive(key, self.needed(table, key, value.as_ref())?)?;
        }
        let key = "mass_per_length_kg_per_m";
        let mass = self.needed(table, key, segment.mass_per_length_kg_per_m.as_ref())?;
        let [axial, shear_2, shear_3, torsion, bending_2, bending_3] = stated;
        Ok(Section {
            axial,
            shear: [shear_2, shear_3],
            torsion,
            bending: [bending_2, bending_3],
            mass_per_length: self.source.not_negative(key, mass)?,
        })
    }

    /// A required key of a segment.
    fn needed<'v>(
        &self,
        table: &Spanned<SegmentTable>,
        key: &str,
        value: Option<&'v Spanned<f64>>,
    ) -> Result<&'v Spanned<f64>, InputError> {
        match value {
            Some(value) => Ok(value),
            None => self.error(
                table.span(),
                format!("missing key `{key}` in [joint.beam.segment]"),
                &format!("{key} with a value; the unit is part of the key"),
            ),
        }
    }

    fn material(&self, table: &Spanned<SegmentTable>) -> Result<Material, InputError> {
        let segment = table.get_ref();
        let gigapascals = |key, value| {
            Ok::<_, InputError>(1e9 * self.source.positive(key, self.needed(table, key, value)?)?)
        };
        let youngs_modulus = gigapascals("youngs_modulus_gpa", segment.youngs_modulus_gpa.as_ref())?;
        let shear_modulus = gigapascals("shear_modulus_gpa", segment.shear_modulus_gpa.as_ref())?;
        let ratio = youngs_modulus / shear_modulus;
        if !(2.0..=3.0).contains(&ratio) {
            let message = format!("shear_modulus_gpa means a Poisson's ratio of {:.2}", ratio / 2.0 - 1.0);
            let expected = "a third to half of youngs_modulus_gpa, Poisson's ratio 0.5 to 0";
            let span = segment.shear_modulus_gpa.as_ref().map_or(table.span(), Spanned::span);
            return self.error(span, message, expected);
        }
        Ok(Material { youngs_modulus, shear_modulus })
    }

    fn shape(&self, table: &Spanned<SegmentTable>) -> Result<Shape, InputError> {
        let segment = table.get_ref();
        let size = |key, value| Ok(self.source.positive(key, value)? / 1e3);
        let wall_mm = self.needed(table, "wall_mm", segment.wall_mm.as_ref())?;
        let wall = size("wall_mm", wall_mm)?;
        let (shape, least) = match (&segment.tube_diameter_mm, &segment.box_width_mm, &segment.box_height_mm)
        {
            (Some(diameter), None, None) => {
                let diameter = size("tube_diameter_mm", diameter)?;
                (Shape::Tube { diameter, wall }, diameter)
            }
            (None, Some(width), Some(height)) => {
                let width = size("box_width_mm", width)?;
                let height = size("box_height_mm", height)?;
                (Shape::Box { width, height, wall }, width.min(height))
            }
            _ => {
                let expected = "tube_diameter_mm and wall_mm, or box_width_mm, box_height_mm and wall_mm";
                return self.error(
                    table.span(),
                    "a segment whose shape is not exactly one tube or one box",
                    expected,
                );
            }
        };
        if 2.0 * wall >= least {
            let message = "wall_mm leaves no hollow";
            return self.error(wall_mm.span(), message, "less than half of the shape's smaller size");
        }
        Ok(shape)
    }
}
