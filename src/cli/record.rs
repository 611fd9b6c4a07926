//! The recording of a run while it goes on.

use std::io::BufWriter;
use std::path::{Path, PathBuf};

use super::say;
use crate::pipeline::{Outcome, SessionEvent};
use calibrig_recording::{McapRecorder, Preamble, RecordingError, SessionRecorder, UnfinishedFile};

type Recorder<'a> = SessionRecorder<'a, McapRecorder<'static>>;

/// `recording.mcap` while it is written. A failure ends the recording, not the run.
pub(super) struct Recording<'a> {
    file: UnfinishedFile,
    recorder: Result<Recorder<'a>, RecordingError>,
}

impl<'a> Recording<'a> {
    /// Begins a recording in `folder`.
    pub(super) fn begin(folder: &Path, preamble: Preamble<'a>) -> Result<Self, RecordingError> {
        let file = UnfinishedFile::create(folder, "recording.mcap")?;
        let sink = file.handle().map(BufWriter::new);
        let recorder = sink.and_then(McapRecorder::new).map(|mcap| SessionRecorder::new(preamble, mcap));
        Ok(Self { file, recorder })
    }

    /// Its place until it is finished.
    pub(super) fn path(&self) -> PathBuf {
        self.file.path().to_path_buf()
    }

    pub(super) fn hear(&mut self, event: SessionEvent<'_>) {
        let Ok(recorder) = &mut self.recorder else { return };
        if let Err(error) = recorder.hear(event) {
            say(&format!("the recording ends here, but the run continues: {error}"));
            self.recorder = Err(error);
        }
    }

    /// Adds the results of the session. The file is then complete, and waits for its name.
    pub(super) fn complete(self, outcome: &Outcome) -> Result<UnfinishedFile, RecordingError> {
        let Self { file, recorder } = self;
        let completed =
            recorder.and_then(|recorder| recorder.evaluated(&outcome.story())).and_then(McapRecorder::finish);
        match completed {
            Ok(()) => Ok(file),
            Err(error) => {
                file.discard();
                Err(error)
            }
        }
    }

    /// Closes it where it is, for `recover`.
    pub(super) fn abandon(self) -> PathBuf {
        self.path()
    }

    /// Removes it: the run itself failed.
    pub(super) fn discard(self) {
        // The writer first: it would write to a file that is gone.
        drop(self.recorder);
        self.file.discard();
    }
}
