//! The story of a run, told to an open Rerun viewer while it goes on.

use std::net::{TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use rerun::RecordingStream;
use rerun::external::re_uri::ProxyUri;
use rerun::log::{ChunkBatcherConfig, LogMsg};
use rerun::sink::{GrpcSink, GrpcSinkConnectionState, LogSink, SinkFlushError};

use super::rerun_sink::RerunRecorder;
use super::{LogEntry, Measured, PoseStep, Preamble, Recorder, RecordingError};
use crate::pipeline::{ModeOutcome, Outcome, SetKind, SetOutcome};

/// Where a viewer listens unless told otherwise.
pub const VIEWER_URL: &str = "rerun+http://127.0.0.1:9876/proxy";

/// How long a viewer may take to answer.
const PATIENCE: Duration = Duration::from_secs(5);
/// How long it may take to read what is under way at the end.
const LAST_PATIENCE: Duration = Duration::from_secs(20);

/// Reads the address of a viewer.
pub fn viewer_url(text: &str) -> Result<String, RecordingError> {
    let bad = |reason| RecordingError::BadViewerUrl { url: text.to_owned(), reason };
    match text.parse::<ProxyUri>() {
        Ok(uri) => Ok(uri.to_string()),
        Err(error) => Err(bad(error.to_string())),
    }
}

/// An open Rerun viewer.
pub struct Viewer {
    url: String,
    sink: Arc<GrpcSink>,
}

impl Viewer {
    /// Finds the viewer that listens at `url`.
    pub fn connect(url: &str) -> Result<Self, RecordingError> {
        let uri: ProxyUri = url.parse().map_err(|error| RecordingError::BadViewerUrl {
            url: url.to_owned(),
            reason: format!("{error}"),
        })?;
        let absent = |reason: String| RecordingError::NoViewer {
            url: url.to_owned(),
            reason,
            version: rerun::build_info().version.to_string(),
        };
        // Asked first by itself: the sink tries again and again without a word.
        reachable(&uri).map_err(|error| absent(error.to_string()))?;
        let sink = Arc::new(GrpcSink::new(uri));
        let begun = Instant::now();
        while !matches!(sink.status(), GrpcSinkConnectionState::Connected) {
            if begun.elapsed() > PATIENCE {
                abandon(sink);
                return Err(absent("what listens there does not speak gRPC".to_owned()));
            }
            thread::sleep(Duration::from_millis(10));
        }
        Ok(Self { url: url.to_owned(), sink })
    }

    /// Why nothing more gets through.
    fn loss(&self) -> Option<String> {
        match self.sink.status() {
            GrpcSinkConnectionState::Disconnected(Err(error)) => Some(error.to_string()),
            GrpcSinkConnectionState::Disconnected(Ok(())) => Some("it was closed".to_owned()),
            _ => None,
        }
    }
}

fn reachable(uri: &ProxyUri) -> std::io::Result<()> {
    let place = format!("{}:{}", uri.origin.format_host(), uri.origin.port);
    let mut last = std::io::Error::from(std::io::ErrorKind::NotFound);
    for address in place.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, PATIENCE) {
            Ok(_) => return Ok(()),
            Err(error) => last = error,
        }
    }
    Err(last)
}

/// Lets go of what would otherwise wait for its viewer for ever when it is dropped.
fn abandon<T>(waiting: T) {
    std::mem::forget(waiting);
}

/// The connection as the recording stream sees it: it never waits for long.
struct Wire(Arc<GrpcSink>);

impl LogSink for Wire {
    fn send(&self, message: LogMsg) {
        self.0.send(message);
    }

    fn flush_blocking(&self, timeout: Duration) -> Result<(), SinkFlushError> {
        self.0.flush_blocking(timeout.min(LAST_PATIENCE))
    }

    fn default_batcher_config(&self) -> ChunkBatcherConfig {
        ChunkBatcherConfig::LOW_LATENCY
    }
}

/// Tells a viewer. What goes wrong with the viewer never ends a run: the rest is not told, and [`finish`](Self::finish) says why.
pub struct LiveRecorder {
    viewer: Viewer,
    recorder: RerunRecorder,
    lost: Option<String>,
}

impl LiveRecorder {
    /// Begins a recording in the viewer, with views that suit `outcome`.
    pub fn new(outcome: &Outcome, viewer: Viewer) -> Result<Self, RecordingError> {
        let wire = Wire(Arc::clone(&viewer.sink));
        let recorder = RerunRecorder::telling(outcome, Box::new(wire))?;
        Ok(Self { viewer, recorder, lost: None })
    }

    fn told(&mut self, tell: impl FnOnce(&mut RerunRecorder) -> Result<(), RecordingError>) {
        if self.lost.is_some() {
            return;
        }
        let told = tell(&mut self.recorder).err().map(|error| error.to_string());
        self.lost = told.or_else(|| self.viewer.loss());
    }

    /// Waits until the viewer has everything; the error says what it has not.
    pub fn finish(mut self) -> Result<(), RecordingError> {
        let stream: RecordingStream = self.recorder.into_stream();
        if self.lost.is_none() {
            self.lost = stream.flush_with_timeout(LAST_PATIENCE).err().map(|error| error.to_string());
        }
        let lost = self.lost.or_else(|| self.viewer.loss());
        let Some(reason) = lost else { return Ok(()) };
        if self.viewer.loss().is_none() {
            // It is there and does not read.
            abandon((stream, self.viewer.sink));
        }
        Err(RecordingError::ViewerLost { url: self.viewer.url, reason })
    }
}

impl Recorder for LiveRecorder {
    fn open(&mut self, preamble: &Preamble<'_>) -> Result<(), RecordingError> {
        self.told(|recorder| recorder.open(preamble));
        Ok(())
    }

    fn set(&mut self, time: u64, set: &SetOutcome, planned: Option<u32>) -> Result<(), RecordingError> {
        self.told(|recorder| recorder.set(time, set, planned));
        Ok(())
    }

    fn measured(&mut self, measured: &Measured<'_>) -> Result<(), RecordingError> {
        self.told(|recorder| recorder.measured(measured));
        Ok(())
    }

    fn dropped(&mut self, time: u64, kind: SetKind, pose: u32, reason: &str) -> Result<(), RecordingError> {
        self.told(|recorder| recorder.dropped(time, kind, pose, reason));
        Ok(())
    }

    fn set_end(&mut self, time: u64, kind: SetKind, observations: usize) -> Result<(), RecordingError> {
        self.told(|recorder| recorder.set_end(time, kind, observations));
        Ok(())
    }

    fn begin(&mut self, outcome: &Outcome) -> Result<(), RecordingError> {
        self.told(|recorder| recorder.begin(outcome));
        Ok(())
    }

    fn pose(&mut self, step: &PoseStep<'_>) -> Result<(), RecordingError> {
        self.told(|recorder| recorder.pose(step));
        Ok(())
    }

    fn estimate(&mut self, time: u64, outcome: &Outcome, mode: &ModeOutcome) -> Result<(), RecordingError> {
        self.told(|recorder| recorder.estimate(time, outcome, mode));
        Ok(())
    }

    fn log(&mut self, entry: &LogEntry) -> Result<(), RecordingError> {
        self.told(|recorder| recorder.log(entry));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    #[test]
    fn where_no_viewer_listens_the_error_says_how_to_get_one() {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let port = listener.local_addr().expect("bound").port();
        drop(listener);
        let url = format!("rerun+http://127.0.0.1:{port}/proxy");
        let error = Viewer::connect(&url).err().expect("nobody there");
        assert!(matches!(&error, RecordingError::NoViewer { version, .. } if version.starts_with("0.36")));
        let help = miette::Diagnostic::help(&error).expect("help").to_string();
        assert!(help.contains("pip install rerun-sdk==0.36"), "{help}");
    }

    #[test]
    fn only_the_address_of_a_viewer_is_taken() {
        assert_eq!(viewer_url(VIEWER_URL).expect("sound"), VIEWER_URL);
        for bad in
            ["", "scenarios/paper.toml", "http://127.0.0.1:9876", "rerun+http://127.0.0.1:9876/catalog"]
        {
            assert!(matches!(viewer_url(bad), Err(RecordingError::BadViewerUrl { .. })), "{bad}");
        }
    }
}
