//! Writes the entities of a Rerun recording: to a viewer at once, or into a file when all is told.

use std::sync::Arc;

use rerun::archetypes::TextDocument;
use rerun::external::re_log_encoding::Encoder;
use rerun::log::LogMsg;
use rerun::sink::LogSink;
use rerun::{AsComponents, RecordingStream, RecordingStreamBuilder, SerializedComponentBatch};

use super::RecordingError;
use super::rerun_columns::{self, Columns, Shown, Time};
use super::rerun_entities::APPLICATION;

/// Where the entities go.
pub(super) enum EntityWriter {
    /// To a viewer, at once.
    Stream(RecordingStream),
    /// Into a file, when all is told. The layout comes first.
    File { layout: Vec<LogMsg>, columns: Box<Columns> },
}

impl EntityWriter {
    /// Of a recording in memory called `name`, with its layout.
    pub(super) fn in_memory(name: &str, layout: Vec<LogMsg>) -> Result<Self, RecordingError> {
        let (_, store, properties, ..) = builder(name).into_args();
        let columns = Box::new(Columns::new(store, &properties.unwrap_or_default())?);
        Ok(Self::File { layout, columns })
    }

    /// Of a recording called `name` that `sink` is told at once.
    pub(super) fn telling(name: &str, sink: Box<dyn LogSink>) -> Result<Self, RecordingError> {
        let stream = builder(name)
            .batcher_config(sink.default_batcher_config())
            .buffered()
            .map_err(RecordingError::unrecordable)?;
        stream.set_sink(sink);
        stream.set_log_time_enabled(false);
        stream.set_log_tick_enabled(false);
        Ok(Self::Stream(stream))
    }

    /// The bytes of the file; none where a viewer was told.
    pub(super) fn finish(self) -> Result<Vec<u8>, RecordingError> {
        let mut encoder = Encoder::local().map_err(RecordingError::unrecordable)?;
        for message in self.messages()? {
            encoder.append(&message).map_err(RecordingError::unrecordable)?;
        }
        encoder.finish().map_err(RecordingError::unrecordable)?;
        encoder.into_inner().map_err(RecordingError::unrecordable)
    }

    /// All that was told in memory.
    pub(super) fn messages(self) -> Result<Vec<LogMsg>, RecordingError> {
        // The layout comes first: a viewer that reads part of the recording before it makes its own layout and keeps it.
        let Self::File { layout: mut messages, columns } = self else { return Ok(Vec::new()) };
        messages.extend(columns.messages()?);
        Ok(messages)
    }

    /// Queues a layout. A viewer that does not read blocks the thread of the stream, not the run.
    pub(super) fn lay_out(&mut self, mut messages: Vec<LogMsg>) {
        match self {
            Self::Stream(stream) => {
                if let Some(LogMsg::BlueprintActivationCommand(activation)) = messages.pop() {
                    stream.send_blueprint(messages, activation);
                }
            }
            Self::File { layout, .. } => *layout = messages,
        }
    }

    /// Shows `shape` at all times.
    pub(super) fn fixed(&mut self, path: &str, shape: &impl AsComponents) -> Result<(), RecordingError> {
        match self {
            Self::Stream(stream) => stream.log_static(path, shape).map_err(RecordingError::unrecordable),
            Self::File { columns, .. } => columns.fixed(path, shape),
        }
    }

    /// Shows a page of Markdown at all times.
    pub(super) fn document(&mut self, path: &str, markdown: String) -> Result<(), RecordingError> {
        self.fixed(path, &TextDocument::from_markdown(markdown))
    }

    /// What the curve at `path` looks like.
    pub(super) fn curve(&mut self, path: &str, look: &impl AsComponents) -> Result<(), RecordingError> {
        match self {
            Self::Stream(_) => self.fixed(path, look),
            Self::File { columns, .. } => {
                columns.curve(path, look);
                Ok(())
            }
        }
    }

    /// Shows something from the present time on.
    pub(super) fn put(&mut self, path: &str, shown: Shown) -> Result<(), RecordingError> {
        match self {
            Self::Stream(stream) => {
                let row = rerun_columns::columns(&[shown]).map_err(RecordingError::unrecordable)?;
                let values = row.into_iter().map(|column| {
                    SerializedComponentBatch::new(Arc::clone(column.list_array.values()), column.descriptor)
                });
                stream.log_serialized_batches(path, false, values).map_err(RecordingError::unrecordable)
            }
            Self::File { columns, .. } => columns.put(path, shown),
        }
    }

    /// What follows belongs to `time`.
    pub(super) fn at(&mut self, time: Time) {
        match (self, time) {
            (Self::File { columns, .. }, time) => columns.at(time),
            (Self::Stream(stream), Time::Pose { number, nanos }) => {
                stream.reset_time();
                stream.set_time_sequence("pose", number);
                stream.set_duration_secs("sim_time", nanos as f64 * 1e-9);
            }
            (Self::Stream(stream), Time::Iteration(number)) => {
                stream.reset_time();
                stream.set_time_sequence("iteration", number);
            }
        }
    }
}

fn builder(name: &str) -> RecordingStreamBuilder {
    // Rerun's environment variables can switch recording off; here the user asked for it.
    RecordingStreamBuilder::new(APPLICATION).enabled(true).recording_name(name)
}
