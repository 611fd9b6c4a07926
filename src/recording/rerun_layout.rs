//! How a Rerun recording is laid out on the screen.

use rerun::blueprint::components::PanelState;
use rerun::blueprint::{Blueprint, BlueprintActivation, BlueprintPanel, SelectionPanel, TimePanel};
use rerun::log::LogMsg;
use rerun::{RecordingStream, RecordingStreamBuilder, StoreId};

use super::RecordingError;
use super::rerun_sink::APPLICATION;
use super::rerun_views::{Property, Views};
use crate::pipeline::Outcome;

/// Of the viewer's playback.
const POSES_PER_SECOND: f64 = 4.0;

/// The messages of the layout for `outcome`, the default for a viewer without a layout of its own. They are told before the recording.
pub(super) fn messages(outcome: &Outcome) -> Result<Vec<LogMsg>, RecordingError> {
    let Layout { blueprint, properties } = layout(outcome);
    let activation = BlueprintActivation { make_active: false, make_default: true };
    let (scratch, messages) = memory(RecordingStreamBuilder::new(APPLICATION))?;
    blueprint.send(&scratch, activation).map_err(RecordingError::unrecordable)?;
    let is_layout = |message: &LogMsg| message.store_id().is_blueprint();
    let mut messages: Vec<_> = messages.take().into_iter().filter(is_layout).collect();
    // The last one puts it into force.
    let Some(last) = messages.pop() else { return Ok(messages) };
    messages.extend(property_messages(last.store_id(), &properties)?);
    messages.push(last);
    Ok(messages)
}

struct Layout {
    blueprint: Blueprint,
    /// What the views' builders cannot say.
    properties: Vec<Property>,
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

fn layout(outcome: &Outcome) -> Layout {
    let mut views = Views::of(outcome);
    let root = views.tabs();
    let time =
        TimePanel::new().with_state(PanelState::Collapsed).with_timeline("pose").with_fps(POSES_PER_SECOND);
    let blueprint = Blueprint::new(root)
        .with_auto_views(false)
        .with_blueprint_panel(BlueprintPanel::from_state(PanelState::Collapsed))
        .with_selection_panel(SelectionPanel::from_state(PanelState::Collapsed))
        .with_time_panel(time);
    Layout { blueprint, properties: views.properties }
}
