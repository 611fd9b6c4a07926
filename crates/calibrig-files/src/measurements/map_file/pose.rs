//! Full poses and faces in a column map. Numbers do not show their conventions, so each is stated.

use super::Reader;
use super::entries::{Codes, RawEntry};
use super::tables::{CovarianceTable, FaceTable, MapFile, RotationTable};
use crate::input::{InputError, Spanned};
use crate::measurements::columns::{
    BackAngles, FaceColumn, Noise, PositionColumns, RotationColumns, RotationSigma, Uncertainty,
};
use crate::rotation::{EulerSequence, MatrixOrder, QuaternionOrder, RotationForm};
use calibrig_model::measurement::Face;

/// What a map says of full poses, and of the uncertainty of its readings.
pub(super) struct OfPose {
    pub rotation: Option<RotationColumns>,
    pub uncertainty: Option<Uncertainty>,
    pub noise: Option<Noise>,
}

const FORMS: &str = "\"quaternion\", \"rotation_vector\", \"euler\", \"matrix\", or by their names \"kuka_abc\", \"abb_quaternion\", \"fanuc_wpr\", \
                     \"ur_rotation_vector\", \"staubli_rxryrz\", \"kawasaki_oat\"";

impl Reader<'_> {
    pub fn pose(
        &self,
        file: &MapFile,
        position: &PositionColumns,
        sigmas: Option<Uncertainty>,
    ) -> Result<OfPose, InputError> {
        let noise = file.noise.as_ref().map(|noise| self.noise(noise)).transpose()?;
        let Some(table) = &file.rotation else {
            if let Some(covariance) = &file.covariance {
                let message = "[covariance] applies to full poses, but there is no [rotation]";
                let expected = "[rotation], or [sigma] for points";
                return Err(self.error(covariance.span(), message, expected));
            }
            if let Some(stated) = file.noise.as_ref().and_then(|noise| noise.get_ref().rotation_urad.as_ref())
            {
                let message = "rotation_urad applies to full poses, but there is no [rotation]";
                return Err(self.error(stated.span(), message, "[rotation], or no rotation_urad"));
            }
            return Ok(OfPose { rotation: None, uncertainty: sigmas, noise });
        };
        let rotation = self.rotation(table)?;
        if rotation.is_of_tracker && matches!(position, PositionColumns::Spherical { .. }) {
            let message = "tracker_in_target has a spherical position, but a tracker's range and angles are measured from the tracker";
            return Err(self.error(
                table.span(),
                message,
                "transform = \"target_in_tracker\", or system = \"cartesian\"",
            ));
        }
        let is_noisy = noise.as_ref().map(|noise| noise.rotation.is_some());
        let uncertainty = match (&file.covariance, sigmas) {
            (None, sigmas) => {
                self.whole_or_none(table, &rotation, sigmas.is_some(), is_noisy)?;
                sigmas
            }
            (Some(covariance), None) if rotation.sigma.is_none() => {
                Some(self.covariance_columns(covariance)?)
            }
            (Some(covariance), _) => {
                let message = "[covariance] and sigmas state the same uncertainty";
                return Err(self.error(
                    covariance.span(),
                    message,
                    "either [covariance], or [sigma] and sigma in [rotation]",
                ));
            }
        };
        if file.covariance.is_some() && is_noisy == Some(false) {
            let message = "[noise] states the size for positions, but not for rotations";
            return Err(self.error(table.span(), message, "rotation_urad in [noise], or no [noise]"));
        }
        Ok(OfPose { rotation: Some(rotation), uncertainty, noise })
    }

    /// Refuses an uncertainty of positions without one of rotations, and the reverse.
    fn whole_or_none(
        &self,
        table: &Spanned<RotationTable>,
        rotation: &RotationColumns,
        has_sigmas: bool,
        noise: Option<bool>,
    ) -> Result<(), InputError> {
        let of_position = has_sigmas || noise.is_some();
        let of_rotation = rotation.sigma.is_some() || noise == Some(true);
        let (message, expected) = match (of_position, of_rotation) {
            (true, false) => (
                "the uncertainty of positions is stated, but not that of rotations",
                "sigma in [rotation], or rotation_urad in [noise]",
            ),
            (false, true) => (
                "the uncertainty of rotations is stated, but not that of positions",
                "[sigma], or range and transverse in [noise]",
            ),
            _ => return Ok(()),
        };
        Err(self.error(table.span(), message, expected))
    }

    fn rotation(&self, spanned: &Spanned<RotationTable>) -> Result<RotationColumns, InputError> {
        let (t, span) = (spanned.get_ref(), spanned.span());
        let table = ("rotation", &span);
        let Some(transform) = &t.transform else {
            let message = "[rotation] does not say which frame is given in which";
            let expected = "transform = \"target_in_tracker\": the target's pose in the tracker's frame; or transform = \
                            \"tracker_in_target\"";
            return Err(self.error(span, message, expected));
        };
        let is_of_tracker = match transform.get_ref().as_str() {
            "target_in_tracker" => false,
            "tracker_in_target" => true,
            other => {
                let message = format!("transform is {other:?}");
                return Err(self.error(
                    transform.span(),
                    message,
                    "\"target_in_tracker\" or \"tracker_in_target\"",
                ));
            }
        };
        let form = self.form(spanned)?;
        if let Some(unit) = t.unit.as_ref().filter(|_| !form.has_unit()) {
            return Err(self.error(
                unit.span(),
                "unit applies to angles, but these numbers are not angles",
                "no unit here",
            ));
        }
        let written = self.needed(table, "columns", t.columns.as_ref())?;
        let columns = self.entries(written)?;
        if columns.len() != form.count() {
            let message = format!("columns names {} columns of the rotation", columns.len());
            return Err(self.error(written.span(), message, &format!("{} columns", form.count())));
        }
        let sigma = t.sigma.as_ref().map(|sigma| self.rotation_sigma(sigma, t)).transpose()?;
        if let Some(k) = t.k.as_ref().filter(|_| sigma.is_none()) {
            return Err(self.error(
                k.span(),
                "k is the coverage factor of sigma, but there is no sigma",
                "sigma, or no k",
            ));
        }
        Ok(RotationColumns {
            form,
            columns,
            unit: t.unit.as_ref().map(|unit| *unit.get_ref()),
            is_of_tracker,
            sigma,
        })
    }

    fn rotation_sigma(
        &self,
        sigma: &Spanned<RawEntry>,
        t: &RotationTable,
    ) -> Result<RotationSigma, InputError> {
        let columns = self.entries(sigma)?;
        if columns.len() != 1 && columns.len() != 3 {
            let message = format!("sigma names {} columns", columns.len());
            let expected = "one for all axes, or three: about the tracker's x, y and z";
            return Err(self.error(sigma.span(), message, expected));
        }
        Ok(RotationSigma { columns, unit: t.sigma_unit, coverage: self.coverage(t.k.as_ref())? })
    }

    fn form(&self, spanned: &Spanned<RotationTable>) -> Result<RotationForm, InputError> {
        let (t, span) = (spanned.get_ref(), spanned.span());
        let form = self.needed(("rotation", &span), "form", t.form.as_ref());
        let form = form.map_err(|_| {
            self.error(
                span.clone(),
                "[rotation] does not say in which form its numbers are",
                &format!("form = {FORMS}"),
            )
        })?;
        let by_name = match form.get_ref().as_str() {
            "kuka_abc" => Some(RotationForm::Euler(EulerSequence::KUKA)),
            "abb_quaternion" => Some(RotationForm::Quaternion(QuaternionOrder::ScalarFirst)),
            "fanuc_wpr" => Some(RotationForm::Euler(EulerSequence::FANUC)),
            "ur_rotation_vector" => Some(RotationForm::Vector),
            "staubli_rxryrz" => Some(RotationForm::Euler(EulerSequence::STAUBLI)),
            "kawasaki_oat" => Some(RotationForm::Euler(EulerSequence::KAWASAKI)),
            _ => None,
        };
        let (order, sequence) = (t.order.as_ref(), t.sequence.as_ref());
        let stated = match form.get_ref().as_str() {
            "quaternion" => self.quaternion(&span, order)?,
            "matrix" => self.matrix(&span, order)?,
            "rotation_vector" => RotationForm::Vector,
            "euler" => self.euler(&span, sequence)?,
            other => by_name.ok_or_else(|| {
                self.error(form.span(), format!("form is {other:?}"), &format!("one of {FORMS}"))
            })?,
        };
        let takes_order =
            by_name.is_none() && matches!(stated, RotationForm::Quaternion(_) | RotationForm::Matrix(_));
        let takes_sequence = by_name.is_none() && matches!(stated, RotationForm::Euler(_));
        let stray = order.filter(|_| !takes_order).map(|key| ("order", key));
        match stray.or(sequence.filter(|_| !takes_sequence).map(|key| ("sequence", key))) {
            Some((name, key)) => {
                let message = format!("{name} does not belong to the form {:?}", form.get_ref());
                Err(self.error(key.span(), message, &format!("no {name} here")))
            }
            None => Ok(stated),
        }
    }

    fn quaternion(
        &self,
        table: &std::ops::Range<usize>,
        order: Option<&Spanned<String>>,
    ) -> Result<RotationForm, InputError> {
        let expected = "order = \"wxyz\" where w, the scalar, is the first of the columns, order = \"xyzw\" where it is the last";
        let Some(order) = order else {
            return Err(self.error(
                table.clone(),
                "[rotation] does not say the order of its quaternion",
                expected,
            ));
        };
        match order.get_ref().as_str() {
            "wxyz" => Ok(RotationForm::Quaternion(QuaternionOrder::ScalarFirst)),
            "xyzw" => Ok(RotationForm::Quaternion(QuaternionOrder::ScalarLast)),
            other => Err(self.error(order.span(), format!("order is {other:?}"), expected)),
        }
    }

    fn matrix(
        &self,
        table: &std::ops::Range<usize>,
        order: Option<&Spanned<String>>,
    ) -> Result<RotationForm, InputError> {
        let expected = "order = \"rows\" where the columns of the file are the first row, the second and the third; or order = \"columns\"";
        let Some(order) = order else {
            return Err(self.error(
                table.clone(),
                "[rotation] does not say the order of its matrix",
                expected,
            ));
        };
        match order.get_ref().as_str() {
            "rows" => Ok(RotationForm::Matrix(MatrixOrder::ByRows)),
            "columns" => Ok(RotationForm::Matrix(MatrixOrder::ByColumns)),
            other => Err(self.error(order.span(), format!("order is {other:?}"), expected)),
        }
    }

    fn euler(
        &self,
        table: &std::ops::Range<usize>,
        sequence: Option<&Spanned<String>>,
    ) -> Result<RotationForm, InputError> {
        let expected = "sequence = \"zyx intrinsic\" (each about the axes as the turns before left them) or \"xyz fixed\" \
                        (about axes that stay), with the axes in the order of the columns";
        let Some(sequence) = sequence else {
            return Err(self.error(
                table.clone(),
                "[rotation] does not say the sequence of its angles",
                expected,
            ));
        };
        EulerSequence::parse(sequence.get_ref()).map(RotationForm::Euler).ok_or_else(|| {
            self.error(sequence.span(), format!("sequence is {:?}", sequence.get_ref()), expected)
        })
    }

    fn covariance_columns(&self, spanned: &Spanned<CovarianceTable>) -> Result<Uncertainty, InputError> {
        let t = spanned.get_ref();
        let (Some(unit), Some(angle_unit)) = (t.unit, t.angle_unit) else {
            let message = "[covariance] does not say its units";
            let expected =
                "unit and angle_unit, such as \"mm\" and \"rad\": each element is a product of two of them";
            return Err(self.error(spanned.span(), message, expected));
        };
        let columns = if let RawEntry::List(items) = t.columns.get_ref() {
            // In a whole matrix one column may be at both places of an element.
            items.iter().map(|item| self.sum(item)).collect::<Result<Vec<_>, _>>()?
        } else {
            vec![self.sum(&t.columns)?]
        };
        if columns.len() != 21 && columns.len() != 36 {
            let message = format!("[covariance] names {} columns", columns.len());
            let expected = "21, the upper triangle by rows, or all 36 of position (x, y, z) and rotation (about x, y, z)";
            return Err(self.error(t.columns.span(), message, expected));
        }
        Ok(Uncertainty::Pose { columns, units: (unit, angle_unit) })
    }

    pub fn face(
        &self,
        spanned: &Spanned<FaceTable>,
        position: &PositionColumns,
    ) -> Result<FaceColumn, InputError> {
        let t = spanned.get_ref();
        if matches!(position, PositionColumns::Cartesian { .. }) {
            let message = "[face] applies to range and angles, but [position] is cartesian";
            let expected = "a spherical position; or no [face], and repeats = \"average\" in [rows]: then both faces of a \
                            pose are averaged as repeats";
            return Err(self.error(spanned.span(), message, expected));
        }
        let words = match (&t.front, &t.back) {
            (None, None) => [Face::Front, Face::Back].map(|face| vec![face.key().to_owned()]),
            (Some(front), Some(back)) => {
                [front, back].map(|codes: &Spanned<Codes>| codes.get_ref().0.clone())
            }
            (one, _) => {
                let (missing, there) = if one.is_some() { ("back", "front") } else { ("front", "back") };
                let message = format!(
                    "[face] says which texts mean the {there} face, but not which mean the {missing}"
                );
                return Err(self.error(
                    spanned.span(),
                    message,
                    "front and back, such as front = [\"1\"], back = [\"2\"]",
                ));
            }
        };
        let [front, back] = &words;
        if let Some(both) = front.iter().find(|word| back.contains(word)) {
            let message = format!("{both:?} stands for both the front and the back face");
            return Err(self.error(spanned.span(), message, "different texts for the two faces"));
        }
        let angles = match t.angles.as_ref().map(|angles| (angles, angles.get_ref().as_str())) {
            None => BackAngles::Found,
            Some((_, "raw")) => BackAngles::Raw,
            Some((_, "direction")) => BackAngles::Direction,
            Some((angles, other)) => {
                let expected = "\"raw\": back-face angles as the encoders show them, azimuth + 180° and 360° - zenith; or \
                                \"direction\": of the point, as in the front face";
                return Err(self.error(angles.span(), format!("angles is {other:?}"), expected));
            }
        };
        Ok(FaceColumn { column: self.single(&t.column)?, words, angles })
    }
}
