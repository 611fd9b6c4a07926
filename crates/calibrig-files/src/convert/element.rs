//! Elements of a URDF that describe the chain: their numbers, read when they are needed.

use std::ops::Range;

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

use crate::input::{InputError, Source};
use calibrig_model::geometry::Transform;

/// A start tag: its attributes, and the elements in it.
#[derive(Debug, Clone)]
pub(super) struct Element {
    pub name: String,
    pub span: Range<usize>,
    /// Name, value and place of the value.
    pub attributes: Vec<(String, String, Range<usize>)>,
    pub children: Vec<Element>,
}

impl Element {
    /// The value of an attribute with its place.
    pub fn attribute(&self, name: &str) -> Option<(&str, Range<usize>)> {
        let found = self.attributes.iter().find(|(known, ..)| known == name)?;
        Some((&found.1, found.2.clone()))
    }

    pub fn child(&self, name: &str) -> Option<&Self> {
        self.children.iter().find(|child| child.name == name)
    }

    /// `count` numbers of an attribute; `None` if it is missing.
    pub fn numbers(&self, source: &Source, name: &str, count: usize) -> Result<Option<Vec<f64>>, InputError> {
        let Some((text, span)) = self.attribute(name) else { return Ok(None) };
        let numbers: Vec<f64> = text
            .split_whitespace()
            .filter_map(|word| word.parse::<f64>().ok())
            .filter(|number| number.is_finite() && number.abs() <= 1e15)
            .collect();
        if numbers.len() != count || text.split_whitespace().count() != count {
            let expected = match count {
                1 => "expected a finite number".to_owned(),
                _ => format!("expected {count} finite numbers separated by blanks"),
            };
            return Err(source.error(span, format!("{name} of <{}> is {text:?}", self.name), Some(expected)));
        }
        Ok(Some(numbers))
    }

    /// One number; `None` if it is missing.
    pub fn number(&self, source: &Source, name: &str) -> Result<Option<f64>, InputError> {
        Ok(self.numbers(source, name, 1)?.map(|numbers| numbers[0]))
    }

    /// The number, which is required.
    pub fn required(&self, source: &Source, name: &str) -> Result<f64, InputError> {
        match self.number(source, name)? {
            Some(number) => Ok(number),
            None => Err(source.error(
                self.span.clone(),
                format!("<{}> has no {name}", self.name),
                Some(format!("expected {name}=\"...\"")),
            )),
        }
    }
}

/// The frame of an `<origin>`, the identity if there is none: roll, pitch and yaw are about the fixed x, y and z.
pub(super) fn origin(source: &Source, element: Option<&Element>) -> Result<Transform, InputError> {
    let Some(element) = element else { return Ok(Transform::identity()) };
    let three = |name| {
        Ok::<_, InputError>(
            element.numbers(source, name, 3)?.map_or_else(Vector3::zeros, |v| Vector3::from_row_slice(&v)),
        )
    };
    let (place, turn) = (three("xyz")?, three("rpy")?);
    let rotation = match element.numbers(source, "quat_xyzw", 4)? {
        None => rotation(&turn),
        Some(q) => {
            let quaternion = Quaternion::new(q[3], q[0], q[1], q[2]);
            if element.attribute("rpy").is_some() || !(0.5..2.0).contains(&quaternion.norm()) {
                let message =
                    "an <origin> with both rpy and quat_xyzw, or with a quaternion that is not a rotation";
                return Err(source.error(
                    element.span.clone(),
                    message,
                    Some("expected rpy, or a quaternion of length one".to_owned()),
                ));
            }
            UnitQuaternion::from_quaternion(quaternion).to_rotation_matrix()
        }
    };
    Ok(Transform::from_parts(place.into(), rotation))
}

/// `Rz(yaw) · Ry(pitch) · Rx(roll)`.
fn rotation(rpy: &Vector3<f64>) -> Rotation3<f64> {
    Rotation3::from_euler_angles(rpy.x, rpy.y, rpy.z)
}

/// Mass (kg), centre of mass (m) and inertia about it (kg m²) of an `<inertial>`, in its link's frame.
pub(super) fn inertial(
    source: &Source,
    element: &Element,
) -> Result<(f64, Vector3<f64>, Matrix3<f64>), InputError> {
    let at = origin(source, element.child("origin"))?;
    let mass = match element.child("mass") {
        Some(mass) => mass.required(source, "value")?,
        None => 0.0,
    };
    let inertia = match element.child("inertia") {
        Some(inertia) => {
            let entry = |name| inertia.number(source, name).map(|value| value.unwrap_or(0.0));
            let [xx, yy, zz] = [entry("ixx")?, entry("iyy")?, entry("izz")?];
            let [xy, xz, yz] = [entry("ixy")?, entry("ixz")?, entry("iyz")?];
            Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
        }
        None => Matrix3::zeros(),
    };
    let turn = at.rotation.matrix();
    Ok((mass, at.translation.vector, turn * inertia * turn.transpose()))
}
