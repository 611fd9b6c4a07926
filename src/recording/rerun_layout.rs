//! How a Rerun recording is laid out on the screen.

use nalgebra::{Rotation3, Unit, Vector3};
use rerun::blueprint::components::PanelState;
use rerun::blueprint::{
    Blueprint, BlueprintActivation, BlueprintPanel, ContainerLike, Horizontal, SelectionPanel, Spatial3DView,
    Tabs, TextDocumentView, TextLogView, TimePanel, TimeSeriesView, Vertical,
};
use rerun::external::re_log_types::BlueprintActivationCommand;
use rerun::external::re_sdk_types::blueprint::archetypes::{EyeControls3D, PlotLegend};
use rerun::log::LogMsg;
use rerun::{AsComponents, EntityPath, RecordingStream, RecordingStreamBuilder, StoreId};

use super::rerun_sink::{APPLICATION, ARROWS, AXES, DEFLECTION, ROD_FORCE, SCENE, TEMPERATURE, xyz};
use super::{RecordingError, scene};
use crate::pipeline::Outcome;

/// Of the viewer's playback.
const POSES_PER_SECOND: f64 = 4.0;
/// Half the angle that the eye is taken to see.
const HALF_VIEW: f64 = 0.55;

/// Puts the layout for `outcome` into the recording, as the default for a viewer without a layout of its own.
pub(super) fn send(outcome: &Outcome, stream: &RecordingStream) -> Result<(), RecordingError> {
    let Layout { blueprint, properties } = layout(outcome);
    let activation = BlueprintActivation { make_active: false, make_default: true };
    let (scratch, messages) = memory(RecordingStreamBuilder::new(APPLICATION))?;
    blueprint.send(&scratch, activation).map_err(RecordingError::unrecordable)?;
    let is_layout = |message: &LogMsg| {
        message.store_id().is_blueprint() && !matches!(message, LogMsg::BlueprintActivationCommand(_))
    };
    let mut messages: Vec<_> = messages.take().into_iter().filter(is_layout).collect();
    let Some(id) = messages.first().map(|message| message.store_id().clone()) else { return Ok(()) };
    messages.extend(property_messages(&id, &properties)?);
    let BlueprintActivation { make_active, make_default } = activation;
    stream
        .send_blueprint(messages, BlueprintActivationCommand { blueprint_id: id, make_active, make_default });
    Ok(())
}

type Property = (EntityPath, Box<dyn AsComponents>);

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

/// The robot on the left, residuals over poses and tables on the right.
fn layout(outcome: &Outcome) -> Layout {
    let mut properties = Vec::new();
    let mut drawn = shown(outcome, ARROWS);
    drawn[0] = format!("+ /{SCENE}/**");
    let title = match &outcome.truth {
        Some(_) => "Robot, residual arrows x100, deflection x100",
        None => "Robot, residual arrows x100",
    };
    let picture = Spatial3DView::new(title).with_origin(SCENE).with_contents(drawn).into();
    properties.extend(property(&picture, "EyeControls3D", eye(outcome)));
    let log = TextLogView::new("Log").with_origin("log").into();
    let left = Vertical::new([picture, log]).with_row_shares([4.0, 1.0]);

    let right = Vertical::new([plots(outcome, &mut properties), pages(outcome)]).with_row_shares([3.0, 2.0]);
    let time =
        TimePanel::new().with_state(PanelState::Collapsed).with_timeline("pose").with_fps(POSES_PER_SECOND);
    let blueprint =
        Blueprint::new(Horizontal::new([left.into(), right.into()]).with_column_shares([3.0, 2.0]))
            .with_auto_views(false)
            .with_blueprint_panel(BlueprintPanel::from_state(PanelState::Collapsed))
            .with_selection_panel(SelectionPanel::from_state(PanelState::Collapsed))
            .with_time_panel(time);
    Layout { blueprint, properties }
}

fn property(view: &ContainerLike, name: &str, value: impl AsComponents + 'static) -> Option<Property> {
    let ContainerLike::View(view) = view else { return None };
    Some((view.blueprint_path().join(&name.into()), Box::new(value)))
}

/// What lies under `root`, but for the modes before identification: their errors would hide what is left after it.
fn shown(outcome: &Outcome, root: &str) -> Vec<String> {
    let uncalibrated = outcome.modes.iter().filter(|m| m.estimate.is_none());
    let mut contents = vec![format!("+ /{root}/**")];
    if outcome.modes.iter().any(|m| m.estimate.is_some()) {
        contents.extend(uncalibrated.map(|m| format!("- /{root}/{}/**", m.mode.key())));
    }
    contents
}

fn plots(outcome: &Outcome, properties: &mut Vec<Property>) -> ContainerLike {
    let axes = AXES.map(|axis| -> ContainerLike {
        let root = format!("residual_mm/{axis}");
        TimeSeriesView::new(format!("Residual {axis}, mm"))
            .with_contents(shown(outcome, &root))
            .with_origin(root)
            .into()
    });
    // The three have the same curves: one legend serves them.
    properties.extend(
        axes[1..]
            .iter()
            .filter_map(|view| property(view, "PlotLegend", PlotLegend::new().with_visible(false))),
    );
    let all = TimeSeriesView::new("3-D error of all modes, mm").with_origin("residual_mm/norm").into();
    let cost =
        TimeSeriesView::new("log10 of the cost (on the timeline iteration)").with_origin("cost_log10").into();
    let residuals = Vertical::new(axes).with_name("Residuals").into();
    Tabs::new([residuals, all].into_iter().chain(machine(outcome)).chain([cost])).into()
}

/// How the simulated machine gives way.
fn machine(outcome: &Outcome) -> Option<ContainerLike> {
    let truth = outcome.truth.as_ref()?;
    let view = |title: &str, path: &str| TimeSeriesView::new(title).with_origin(path).into();
    let mut views: Vec<ContainerLike> = vec![view("Deflection at the target by elasticity, mm", DEFLECTION)];
    if truth.poses.iter().flatten().any(|settled| settled.rod_force.is_some()) {
        views.push(view("Tension of the four-bar's rod, N", ROD_FORCE));
    }
    if truth.effects.iter().flatten().any(|effects| effects.temperature.is_some()) {
        views.push(view("Temperature of the air, °C", TEMPERATURE));
    }
    Some(Vertical::new(views).with_name("Machine").into())
}

fn pages(outcome: &Outcome) -> ContainerLike {
    let machine = outcome.truth.as_ref().map(|_| ("Machine at this pose", "tables/machine"));
    let pages = [
        ("Accuracy", "tables/accuracy"),
        ("This pose", "tables/pose"),
        ("Parameters", "tables/parameters"),
        ("Identification", "tables/identification"),
    ];
    let pages = pages.into_iter().chain(machine);
    Tabs::new(pages.map(|(title, path)| TextDocumentView::new(title).with_origin(path).into())).into()
}

/// An eye that sees the base, the trackers and all measured points, from the trackers' side.
fn eye(outcome: &Outcome) -> EyeControls3D {
    let up = scene::up(outcome);
    let trackers: Vec<_> = scene::trackers(outcome).iter().map(|t| t.translation.vector).collect();
    let mut seen = vec![Vector3::zeros()];
    seen.extend(outcome.sets.iter().flat_map(|set| scene::measured_points(outcome, &set.measurements)));
    seen.extend(&trackers);
    let lowest = seen.iter().fold(Vector3::repeat(f64::INFINITY), |low, p| low.inf(p));
    let highest = seen.iter().fold(Vector3::repeat(f64::NEG_INFINITY), |high, p| high.sup(p));
    let centre = (lowest + highest) / 2.0;
    let radius = seen.iter().map(|p| (p - centre).norm()).fold(0.5, f64::max);

    let towards = trackers.first().map_or(Vector3::x(), |t| t - centre);
    let level = towards - up * up.dot(&towards);
    let level = level.try_normalize(1e-9).unwrap_or_else(|| scene::across(&up).into_inner());
    // Beside the line of sight, which would otherwise be seen end on.
    let aside = Rotation3::from_axis_angle(&Unit::new_normalize(up), 0.7) * level;
    let direction = (aside + 0.45 * up).normalize();
    let position = centre + direction * radius / HALF_VIEW.sin();
    EyeControls3D::new().with_position(xyz(&position)).with_look_target(xyz(&centre)).with_eye_up(xyz(&up))
}
