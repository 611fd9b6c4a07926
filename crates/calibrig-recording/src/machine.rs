//! The recorded machine, for reports only: identification never reads it.

use std::path::Path;

use super::messages::{decode, read_messages};
use super::schema::v1;
use super::story::TrueSetting;
use super::{RecordingError, truth};
use calibrig_model::CalibrationModel;

/// The machine of a simulated run as its recording describes it. Two of them can be compared; nothing in them can be read.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedMachine(v1::AsBuilt);

impl RecordedMachine {
    /// What a recording would hold of a machine whose model is `nominal`.
    pub fn of(nominal: &CalibrationModel, setting: TrueSetting<'_>) -> Self {
        Self(truth::as_built(&nominal.kinematics, setting))
    }
}

/// The machine in the recording at `path`; `None` where it was not simulated.
pub fn read_recorded_machine(path: &Path) -> Result<Option<RecordedMachine>, RecordingError> {
    let mut machine = None;
    read_messages(path, &mut |topic, schema, data| {
        if topic == "/truth/as_built" {
            // The names of what yields come with its first pose.
            machine = Some(RecordedMachine(v1::AsBuilt { elastic: Vec::new(), ..decode(schema, data)? }));
        }
        Ok(())
    })?;
    Ok(machine)
}
