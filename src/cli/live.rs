//! A run shown in an open Rerun viewer while it goes on.

#[cfg(feature = "rerun")]
pub(super) use with_rerun::{HERE, Live, address};
#[cfg(not(feature = "rerun"))]
pub(super) use without_rerun::{HERE, Live, address};

#[cfg(feature = "rerun")]
mod with_rerun {
    use crate::cli::{CliError, say};
    use crate::pipeline::{Outcome, SessionEvent};
    use calibrig_recording::{LiveRecorder, Preamble, RecordingError, SessionRecorder, Viewer};

    pub(in crate::cli) use calibrig_recording::VIEWER_URL as HERE;

    /// The address of a viewer, as given on the command line.
    pub(in crate::cli) fn address(text: &str) -> Result<String, RecordingError> {
        calibrig_recording::viewer_url(text)
    }

    /// The viewer that was asked for, if any.
    pub(in crate::cli) struct Live<'a>(Option<SessionRecorder<'a, LiveRecorder>>);

    impl<'a> Live<'a> {
        /// Finds the viewer at `url`.
        pub(in crate::cli) fn begin(url: Option<&str>, preamble: Preamble<'a>) -> Result<Self, CliError> {
            let viewer = url.map(Viewer::connect).transpose()?;
            Ok(Self(viewer.map(|viewer| SessionRecorder::new(preamble, LiveRecorder::new(viewer)))))
        }

        pub(in crate::cli) fn hear(&mut self, event: SessionEvent<'_>) {
            if let Some(recorder) = &mut self.0 {
                // It reports its problems at the end.
                let _ = recorder.hear(event);
            }
        }

        /// Shows the results of the session. A viewer that is gone is a remark, not a failure.
        pub(in crate::cli) fn complete(self, outcome: &Outcome) {
            let Some(recorder) = self.0 else { return };
            if let Err(error) = recorder.evaluated(&outcome.story()).and_then(LiveRecorder::finish) {
                say(&format!("{error}; the run itself is complete"));
            }
        }
    }
}

#[cfg(not(feature = "rerun"))]
mod without_rerun {
    use std::marker::PhantomData;

    use crate::cli::CliError;
    use crate::pipeline::{Outcome, SessionEvent};
    use calibrig_recording::Preamble;

    pub(in crate::cli) const HERE: &str = "";

    /// A build without Rerun accepts no address.
    pub(in crate::cli) fn address(_: &str) -> Result<String, &'static str> {
        Err(
            "this build has no Rerun: build with `--features rerun`, or open the run's recording.mcap in a viewer",
        )
    }

    /// No viewer.
    pub(in crate::cli) struct Live<'a>(PhantomData<&'a ()>);

    #[allow(clippy::unused_self)]
    impl<'a> Live<'a> {
        #[allow(clippy::unnecessary_wraps)]
        pub(in crate::cli) fn begin(_: Option<&str>, _: Preamble<'a>) -> Result<Self, CliError> {
            Ok(Self(PhantomData))
        }

        pub(in crate::cli) fn hear(&mut self, _: SessionEvent<'_>) {}

        pub(in crate::cli) fn complete(self, _: &Outcome) {}
    }
}
