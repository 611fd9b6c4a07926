//! How a Rerun recording is laid out on the screen.

use rerun::blueprint::components::{PanelState, PlayState};
use rerun::blueprint::{Blueprint, BlueprintActivation, BlueprintPanel, SelectionPanel, TimePanel};
use rerun::log::LogMsg;
use rerun::{RecordingStream, RecordingStreamBuilder, StoreId};

use super::RecordingError;
use super::rerun_sink::APPLICATION;
use super::rerun_views::{self, Property, Setting, Views};
use crate::pipeline::Outcome;

/// Of the viewer's playback.
const POSES_PER_SECOND: f64 = 4.0;

/// Whether a layout is for viewers without one of their own, or takes the place of what is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Force {
    Default,
    Active,
}

/// The messages of the layout for `outcome`. They are told before the recording.
pub(super) fn messages(outcome: &Outcome, force: Force) -> Result<Vec<LogMsg>, RecordingError> {
    let mut views = Views::of(outcome);
    let root = views.tabs();
    messages_of(Blueprint::new(root), &views.properties, force)
}

/// The same for a session while it is measured.
pub(super) fn session(setting: &Setting) -> Result<Vec<LogMsg>, RecordingError> {
    let (root, properties) = rerun_views::session(setting);
    messages_of(Blueprint::new(root), &properties, Force::Active)
}

fn messages_of(
    blueprint: Blueprint,
    properties: &[Property],
    force: Force,
) -> Result<Vec<LogMsg>, RecordingError> {
    let mut time =
        TimePanel::new().with_state(PanelState::Collapsed).with_timeline("pose").with_fps(POSES_PER_SECOND);
    if force == Force::Active {
        // What is shown live is shown at its end.
        time = time.with_play_state(PlayState::Following);
    }
    let blueprint = blueprint
        .with_auto_views(false)
        .with_blueprint_panel(BlueprintPanel::from_state(PanelState::Collapsed))
        .with_selection_panel(SelectionPanel::from_state(PanelState::Collapsed))
        .with_time_panel(time);
    let activation = BlueprintActivation { make_active: force == Force::Active, make_default: true };
    let (scratch, messages) = memory(RecordingStreamBuilder::new(APPLICATION))?;
    blueprint.send(&scratch, activation).map_err(RecordingError::unrecordable)?;
    let is_layout = |message: &LogMsg| message.store_id().is_blueprint();
    let mut messages: Vec<_> = messages.take().into_iter().filter(is_layout).collect();
    // The last one puts it into force.
    let Some(last) = messages.pop() else { return Ok(messages) };
    messages.extend(property_messages(last.store_id(), properties)?);
    messages.push(last);
    Ok(messages)
}

fn memory(
    builder: RecordingStreamBuilder,
) -> Result<(RecordingStream, rerun::sink::MemorySinkStorage), RecordingError> {
    let (stream, storage) =
        builder.enabled(true).send_properties(false).memory().map_err(RecordingError::unrecordable)?;
    stream.set_log_time_enabled(false);
    stream.set_log_tick_enabled(false);
    Ok((stream, storage))
}

/// The messages that set `properties` in the layout `id`.
fn property_messages(id: &StoreId, properties: &[Property]) -> Result<Vec<LogMsg>, RecordingError> {
    let (stream, messages) = memory(RecordingStreamBuilder::from_store_id(id))?;
    // The timeline on which viewers expect layouts.
    stream.set_time_sequence("blueprint", 0);
    for (path, property) in properties {
        stream.log(path.clone(), property.as_ref()).map_err(RecordingError::unrecordable)?;
    }
    Ok(messages.take().into_iter().filter(|message| matches!(message, LogMsg::ArrowMsg(..))).collect())
}
