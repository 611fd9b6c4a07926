//! identify
use super::{CalibratedRobot, Estimate};
use crate::measurement::MeasurementSet;
use crate::model::CalibrationModel;
use thiserror::Error;

/// Frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FrameChoice {}
/// Target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TargetChoice {}
/// Parameters.
#[derive(Debug, Clone, PartialEq)]
pub enum ParameterChoice {}
/// Options.
#[derive(Debug, Clone, PartialEq)]
pub struct IdentificationOptions {}
/// Errors.
#[derive(Debug, Error)]
pub enum IdentifyError {}
/// identify
pub fn identify(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
) -> Result<Estimate, IdentifyError> {
    let _ = (model, set, options);
    unimplemented!()
}
/// The nominal robot after registration.
pub fn without_calibration(
    model: &CalibrationModel,
    set: &MeasurementSet,
) -> Result<CalibratedRobot, IdentifyError> {
    let _ = (model, set);
    unimplemented!()
}
