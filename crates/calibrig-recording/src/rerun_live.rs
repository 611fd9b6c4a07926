//! Shows a run in an open Rerun viewer while it goes on.

use std::net::{TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use nalgebra::Vector3;
use rerun::external::re_uri::ProxyUri;
use rerun::log::{ChunkBatcherConfig, LogMsg};
use rerun::sink::{GrpcSink, GrpcSinkConnectionState, LogSink, SinkFlushError};

use super::Story;
use super::rerun_layout::Force;
use super::rerun_sink::RerunRecorder;
use super::rerun_views::{self, Setting};
use super::rerun_writer::EntityWriter;
use super::scene::{self, Sighting};
use super::{Chain, ChainKind, LogEntry, Measured, PoseStep, Preamble, Recorder, RecordingError};
use calibrig_estimation::evaluation::ModeOutcome;
use calibrig_estimation::evaluation::closed_loop::ClosedLoop;
use calibrig_model::CalibrationModel;
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{Observation, SetOutcome};
use calibrig_plant::AsBuilt;

/// Default address of a viewer.
pub const VIEWER_URL: &str = "rerun+http://127.0.0.1:9876/proxy";

/// How long to wait for a viewer's answer.
const PATIENCE: Duration = Duration::from_secs(5);
/// Pause between two looks for the answer.
const GLANCE: Duration = Duration::from_millis(10);
/// How long to wait at the end, until the viewer has read everything.
const LAST_PATIENCE: Duration = Duration::from_secs(20);

/// Reads the address of a viewer.
pub fn viewer_url(text: &str) -> Result<String, RecordingError> {
    uri(text).map(|uri| uri.to_string())
}

fn uri(text: &str) -> Result<ProxyUri, RecordingError> {
    let bad = |reason| RecordingError::BadViewerUrl { url: text.to_owned(), reason };
    text.parse::<ProxyUri>().map_err(|error| bad(error.to_string()))
}

/// A connection to a viewer.
trait Line: Send + Sync + 'static {
    /// Queues a message.
    fn send(&self, message: LogMsg);
    /// Waits until all messages are sent.
    fn flush(&self, timeout: Duration) -> Result<(), SinkFlushError>;
    /// Why the connection is broken, if it is.
    fn loss(&self) -> Option<String>;
}

impl Line for GrpcSink {
    fn send(&self, message: LogMsg) {
        LogSink::send(self, message);
    }

    fn flush(&self, timeout: Duration) -> Result<(), SinkFlushError> {
        self.flush_blocking(timeout)
    }

    fn loss(&self) -> Option<String> {
        match self.status() {
            GrpcSinkConnectionState::Disconnected(Err(error)) => Some(error.to_string()),
            GrpcSinkConnectionState::Disconnected(Ok(())) => Some("it was closed".to_owned()),
            _ => None,
        }
    }
}

/// An open Rerun viewer.
pub struct Viewer {
    url: String,
    line: Arc<dyn Line>,
}

impl Viewer {
    /// Finds the viewer that listens at `url`.
    pub fn connect(url: &str) -> Result<Self, RecordingError> {
        let uri = uri(url)?;
        let absent = |reason: String| RecordingError::NoViewer {
            url: url.to_owned(),
            reason,
            version: rerun::build_info().version.to_string(),
        };
        // Checked first: the sink would retry for ever, without an error.
        reachable(&uri).map_err(|error| absent(error.to_string()))?;
        let sink = GrpcSink::new(uri);
        let mut waits = PATIENCE.as_millis() / GLANCE.as_millis();
        while !matches!(sink.status(), GrpcSinkConnectionState::Connected) {
            if waits == 0 {
                abandon(sink);
                return Err(absent("what listens there does not speak gRPC".to_owned()));
            }
            waits -= 1;
            thread::sleep(GLANCE);
        }
        Ok(Self { url: url.to_owned(), line: Arc::new(sink) })
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

/// Leaks what would wait for its viewer for ever when dropped.
fn abandon<T>(waiting: T) {
    std::mem::forget(waiting);
}

/// The connection as the sink of a recording stream. It never waits for ever.
struct Wire(Arc<dyn Line>);

impl LogSink for Wire {
    fn send(&self, message: LogMsg) {
        self.0.send(message);
    }

    fn flush_blocking(&self, timeout: Duration) -> Result<(), SinkFlushError> {
        self.0.flush(timeout.min(LAST_PATIENCE))
    }

    fn default_batcher_config(&self) -> ChunkBatcherConfig {
        ChunkBatcherConfig::LOW_LATENCY
    }
}

/// Shows a run in a viewer. Trouble with the viewer never ends the run: the rest is not shown, and [`finish`](Self::finish) says why.
pub struct LiveRecorder {
    viewer: Viewer,
    /// From the session's opening on.
    recorder: Option<RerunRecorder>,
    session: Option<Session>,
    lost: Option<String>,
}

/// What is needed to draw the poses of a simulated session.
struct Session {
    as_built: AsBuilt,
    /// `tracker_from_base`, one a station.
    stations: Vec<Transform>,
    model: CalibrationModel,
    /// In the flange frame, m.
    targets: Vec<Vector3<f64>>,
}

impl LiveRecorder {
    /// Waits for a session.
    pub fn new(viewer: Viewer) -> Self {
        Self { viewer, recorder: None, session: None, lost: None }
    }

    fn wire(&self) -> Wire {
        Wire(Arc::clone(&self.viewer.line))
    }

    /// Remembers why nothing more can be shown: an error, or the loss of the connection.
    fn note(&mut self, result: Result<(), RecordingError>) {
        let told = result.err().map(|error| error.to_string());
        self.lost = told.or_else(|| self.viewer.line.loss());
    }

    fn tell(&mut self, tell: impl FnOnce(&mut RerunRecorder) -> Result<(), RecordingError>) {
        if self.lost.is_none()
            && let Some(recorder) = &mut self.recorder
        {
            let told = tell(recorder);
            self.note(told);
        }
    }

    /// Sends the layout, then the machine before it moves.
    fn open_session(&mut self, preamble: &Preamble<'_>) -> Result<(), RecordingError> {
        let (as_built, trackers) = match preamble.truth {
            Some(truth) => {
                (Some(truth.as_built), truth.stations.iter().map(Transform::inverse).collect::<Vec<_>>())
            }
            None => (None, Vec::new()),
        };
        let up = scene::up_of(preamble.model, as_built);
        let setting = Setting {
            up,
            trackers: trackers.iter().map(|tracker| tracker.translation.vector).collect(),
            seen: scene::reach(&preamble.model.kinematics),
            rod: preamble.model.actuators.four_bar().is_some(),
        };
        let wire = self.wire();
        wire.send_all(rerun_views::session(&setting)?);
        let recorder = self
            .recorder
            .insert(RerunRecorder::on(EntityWriter::telling(&preamble.input.name, Box::new(wire))?));
        recorder.writer.surroundings(&up, &trackers, Vec::new())?;
        let Some(truth) = preamble.truth else { return Ok(()) };
        recorder.writer.robot(ChainKind::True, preamble.visuals)?;
        recorder.machine_curves()?;
        self.session = Some(Session {
            as_built: truth.as_built.clone(),
            stations: truth.stations.to_vec(),
            model: preamble.model.clone(),
            targets: Vec::new(),
        });
        Ok(())
    }

    /// Waits until the viewer has everything; the error says why it has not.
    pub fn finish(mut self) -> Result<(), RecordingError> {
        self.close();
        let url = self.viewer.url.clone();
        self.lost.take().map_or(Ok(()), |reason| Err(RecordingError::ViewerLost { url, reason }))
    }

    fn close(&mut self) {
        let Some(recorder) = self.recorder.take() else { return };
        let EntityWriter::Stream(stream) = recorder.writer else { return };
        if self.lost.is_none() {
            let flushed = stream.flush_with_timeout(LAST_PATIENCE).map_err(RecordingError::unrecordable);
            self.note(flushed);
        }
        if self.lost.is_some() && self.viewer.line.loss().is_none() {
            // The viewer is still connected, but does not read.
            abandon((stream, Arc::clone(&self.viewer.line)));
        }
    }
}

impl Drop for LiveRecorder {
    fn drop(&mut self) {
        self.close();
    }
}

impl Session {
    fn chains(&self, measured: &Measured<'_>) -> Vec<Chain> {
        let (Some(observation), Some(settled)) = (measured.observations.first(), measured.truth.first())
        else {
            return Vec::new();
        };
        let target = self.targets.get(observation.target);
        let rigid = measured.rigid.first();
        scene::machine_chains(&self.as_built, settled, rigid, &self.model, target, observation)
            .unwrap_or_default()
    }

    fn sightings(&self, measured: &Measured<'_>) -> Vec<Sighting> {
        let sighting = |o: &Observation| Some(scene::sighting_from(self.stations.get(o.station)?, o));
        measured.observations.iter().filter_map(sighting).collect()
    }
}

impl Recorder for LiveRecorder {
    fn open(&mut self, preamble: &Preamble<'_>) -> Result<(), RecordingError> {
        let opened = self.open_session(preamble);
        self.note(opened);
        Ok(())
    }

    fn set(&mut self, _: u64, set: &SetOutcome, _: Option<u32>) -> Result<(), RecordingError> {
        if let Some(session) = &mut self.session {
            session.targets = set.measurements.targets.iter().map(|target| target.in_flange).collect();
        }
        Ok(())
    }

    fn measured(&mut self, measured: &Measured<'_>) -> Result<(), RecordingError> {
        if let Some(session) = &self.session {
            let (chains, sightings) = (session.chains(measured), session.sightings(measured));
            self.tell(|recorder| recorder.measuring(measured, &chains, &sightings));
        }
        Ok(())
    }

    fn begin(&mut self, story: &Story<'_>) -> Result<(), RecordingError> {
        if self.lost.is_none() {
            let layout = rerun_views::layout(story, Force::Active);
            self.tell(|recorder| layout.map(|messages| recorder.writer.lay_out(messages)));
        }
        self.tell(|recorder| recorder.begin(story));
        Ok(())
    }

    fn pose(&mut self, step: &PoseStep<'_>) -> Result<(), RecordingError> {
        self.tell(|recorder| recorder.pose(step));
        Ok(())
    }

    fn estimate(&mut self, time: u64, story: &Story<'_>, mode: &ModeOutcome) -> Result<(), RecordingError> {
        self.tell(|recorder| recorder.estimate(time, story, mode));
        Ok(())
    }

    fn closed_loop(&mut self, time: u64, driven: &ClosedLoop) -> Result<(), RecordingError> {
        self.tell(|recorder| recorder.closed_loop(time, driven));
        Ok(())
    }

    fn log(&mut self, entry: &LogEntry) -> Result<(), RecordingError> {
        self.tell(|recorder| recorder.log(entry));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;
    use std::net::TcpListener;
    use std::sync::Mutex;

    use rerun::log::Chunk;

    use crate::{record, synthetic};

    /// A viewer that is closed when it has so many messages.
    struct Listener {
        heard: Mutex<Vec<LogMsg>>,
        patience: usize,
    }

    impl Line for Listener {
        fn send(&self, message: LogMsg) {
            let mut heard = self.heard.lock().expect("not poisoned");
            if heard.len() < self.patience {
                heard.push(message);
            }
        }

        fn flush(&self, _: Duration) -> Result<(), SinkFlushError> {
            Ok(())
        }

        fn loss(&self) -> Option<String> {
            (self.heard.lock().expect("not poisoned").len() == self.patience).then(|| "closed".to_owned())
        }
    }

    fn listener(patience: usize) -> (Arc<Listener>, LiveRecorder) {
        let listener = Arc::new(Listener { heard: Mutex::default(), patience });
        let line: Arc<dyn Line> = listener.clone();
        (listener, LiveRecorder::new(Viewer { url: VIEWER_URL.to_owned(), line }))
    }

    #[test]
    fn a_viewer_is_told_its_layout_first_and_every_pose_once() {
        let outcome = synthetic::outcome(6, 3, true);
        let (listener, mut live) = listener(usize::MAX);
        record(&outcome.story(), &mut live).expect("told");
        live.finish().expect("heard");
        let heard = listener.heard.lock().expect("not poisoned");
        let is_layout = |message: &&LogMsg| message.store_id().is_blueprint();
        assert!(heard.iter().take_while(is_layout).count() > 10);
        let in_force = |m: &LogMsg| matches!(m, LogMsg::BlueprintActivationCommand(c) if c.make_active);
        assert_eq!(heard.iter().filter(|m| in_force(m)).count(), 2, "of the session, of the evaluation");

        let mut rows: BTreeMap<String, usize> = BTreeMap::new();
        for message in heard.iter().filter(|message| !is_layout(message)) {
            if let LogMsg::ArrowMsg(_, message) = message {
                let chunk = Chunk::from_arrow_msg(message).expect("sound");
                *rows.entry(chunk.entity_path().to_string()).or_default() += chunk.num_rows();
            }
        }
        for path in [
            "/scene/true/chain",
            "/scene/nominal/chain",
            "/scene/calibrated/chain",
            "/scene/deflection_x100/at_target",
            "/scene/line_of_sight",
            "/tables/machine",
            "/tables/pose",
        ] {
            assert_eq!(rows.get(path), Some(&9), "{path}");
        }
    }

    #[test]
    fn a_viewer_that_is_closed_stops_nothing_and_is_told_of_at_the_end() {
        let outcome = synthetic::outcome(6, 3, true);
        let (listener, mut live) = listener(60);
        record(&outcome.story(), &mut live).expect("goes on");
        let error = live.finish().expect_err("closed");
        assert!(matches!(&error, RecordingError::ViewerLost { reason, .. } if reason == "closed"), "{error}");
        assert_eq!(listener.heard.lock().expect("not poisoned").len(), 60);
    }

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
