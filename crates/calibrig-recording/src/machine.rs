//! The recorded machine, for reports alone: what identifies never looks here.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use mcap::records::Record;
use prost::Message;

use super::scan::{ReadError, check_integrity, check_magic, scan};
use super::schema::v1;
use super::story::TrueSetting;
use super::{RecordingError, truth};
use calibrig_model::CalibrationModel;

/// The machine of a simulated run as its recording describes it. Comparable, and nothing else.
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
    let unreadable = |source| RecordingError::Unreadable { path: path.to_path_buf(), source };
    let mut file = BufReader::new(File::open(path).map_err(unreadable)?);
    find(&mut file).map_err(|error| match error {
        ReadError::Io(source) => unreadable(source),
        ReadError::Recording(error) => error,
    })
}

fn find(file: &mut BufReader<File>) -> Result<Option<RecordedMachine>, ReadError> {
    const TOPIC: &str = "/truth/as_built";
    check_magic(file)?;
    check_integrity(file)?;
    let (mut channel, mut machine) = (None, None);
    scan(file, &mut |opcode, body| {
        match mcap::parse_record(opcode, body)? {
            Record::Channel(known) if known.topic == TOPIC => channel = Some(known.id),
            Record::Message { header, data } if Some(header.channel_id) == channel => {
                let message = v1::AsBuilt::decode(data.as_ref()).map_err(|error| {
                    let (topic, sequence) = (TOPIC.to_owned(), header.sequence);
                    RecordingError::InvalidMessage { topic, sequence, reason: error.to_string() }
                })?;
                // What of it yields is told by its first pose.
                machine = Some(RecordedMachine(v1::AsBuilt { elastic: Vec::new(), ..message }));
            }
            _ => {}
        }
        Ok(())
    })?;
    Ok(machine)
}
