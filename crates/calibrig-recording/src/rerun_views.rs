//! The views of a Rerun recording, in tabs.

use nalgebra::{Rotation3, Unit, Vector3};
use rerun::blueprint::components::ContainerKind::{Grid, Horizontal, Tabs, Vertical};
use rerun::external::re_sdk_types::blueprint::archetypes::{EntityBehavior, EyeControls3D, PlotLegend};
use rerun::external::re_sdk_types::blueprint::components::Corner2D;
use rerun::log::LogMsg;

use super::RecordingError;
use super::Story;
use super::figures::{Correlations, identified};
use super::rerun_analysis::bins;
use super::rerun_entities::{
    ARROWS, AXES, CALIBRATED, CONVERGENCE, CORRELATION, COST, DEFLECTED, DEFLECTION, DRIVEN_PATH, NORM, PATH,
    ROD_FORCE, SCENE, TEMPERATURE, histogram_path, xyz,
};
use super::rerun_layout::{self, Container, Force, Node, View};
use super::scene;
use calibrig_estimation::identification::Mode;
use calibrig_model::measurement::SetOutcome;

/// Half the assumed angle of view, rad.
const HALF_VIEW: f64 = 0.55;
/// Shares of the left and the right side of a tab.
const SHARES: [f32; 2] = [3.0, 2.0];

/// The messages of the layout for `story`. The first tab is what one sees on opening.
pub(super) fn layout(story: &Story<'_>, force: Force) -> Result<Vec<LogMsg>, RecordingError> {
    let mut tabs = vec![robot(story)];
    tabs.extend(histograms(story));
    tabs.extend(machine(story));
    tabs.extend(compensated(story));
    tabs.extend(estimates(story));
    rerun_layout::messages(&Container::new(Tabs, tabs), force)
}

fn page(title: &str, origin: impl Into<String>) -> Node {
    View::new("TextDocument", title, origin).into()
}

fn curves(title: impl Into<String>, origin: impl Into<String>) -> View {
    View::new("TimeSeries", title, origin)
}

/// A view in space from which all of `setting` can be seen.
fn picture(title: &str, setting: &Setting, drawn: Vec<String>) -> View {
    View::new("3D", title, SCENE).with_contents(drawn).set("EyeControls3D", &eye(setting))
}

fn without_legend(view: View) -> View {
    view.set("PlotLegend", &PlotLegend::new().with_visible(false))
}

/// The robot on the left, residuals over poses and tables on the right.
fn robot(story: &Story<'_>) -> Node {
    let mut drawn = shown(story, ARROWS);
    drawn[0] = format!("+ /{SCENE}/**");
    drawn.extend([DEFLECTED, DRIVEN_PATH].map(|root| format!("- /{root}/**")));
    let title = "Robot; arrows: residuals x100, 10 cm for 1 mm";
    let mut picture = picture(title, &Setting::of(story), drawn);
    if story.truth.is_some() {
        // Only millimetres from the machine, so hidden: a click on its eye in the blueprint panel shows it.
        let place = format!("ViewContents/overrides/{CALIBRATED}/visualizers");
        picture = picture.set(place, &EntityBehavior::new().with_visible(false));
    }
    let log = View::new("TextLog", "Log", "log");
    let left = Container::new(Vertical, [picture.into(), log.into()]).shared([4.0, 1.0]);
    let right = Container::new(Vertical, [residuals(story), pages()]).shared([3.0, 2.0]);
    Container::new(Horizontal, [left.into(), right.into()]).shared(SHARES).named("Robot and residuals").into()
}

/// What lies under `root`, without the modes before identification: their large errors would hide the small ones after it.
fn shown(story: &Story<'_>, root: &str) -> Vec<String> {
    let uncalibrated = story.modes.iter().filter(|m| m.estimate.is_none());
    let mut contents = vec![format!("+ /{root}/**")];
    if identified(story).next().is_some() {
        contents.extend(uncalibrated.map(|m| format!("- /{root}/{}/**", m.mode.key())));
    }
    contents
}

fn residuals(story: &Story<'_>) -> Node {
    let axes = AXES.iter().enumerate().map(|(index, axis)| -> Node {
        let root = format!("residual_mm/{axis}");
        let contents = shown(story, &root);
        let view = curves(format!("Residual {axis}, mm"), root).with_contents(contents);
        // All three have the same curves: one legend is enough.
        if index == 0 { view.into() } else { without_legend(view).into() }
    });
    let axes = Container::new(Vertical, axes).named("Residuals").into();
    Container::new(Tabs, [axes, curves("3-D error of all modes, mm", "residual_mm/norm").into()]).into()
}

fn pages() -> Node {
    let pages = [
        ("Accuracy", "tables/accuracy"),
        ("This pose", "tables/pose"),
        ("Parameters", "tables/parameters"),
        ("Identification", "tables/identification"),
    ];
    Container::new(Tabs, pages.map(|(title, path)| page(title, path))).into()
}

/// One row a mode: its errors in 3-D and along each axis. The verification set comes first.
fn histograms(story: &Story<'_>) -> Option<Node> {
    let bins: Vec<_> = story.modes.iter().filter_map(|mode| Some((mode.mode, bins(story, mode)?))).collect();
    let measured = |set: &&SetOutcome| !set.measurements.observations.is_empty();
    let tabs = story.sets.iter().rev().filter(measured).map(|set| -> Node {
        let charts = bins.iter().flat_map(|(mode, bins)| {
            let width = 1e3 * bins.width;
            [NORM].into_iter().chain(AXES).map(move |axis| -> Node {
                let title = match axis {
                    NORM => format!("{}: 3-D error, mm", mode.title()),
                    axis => format!("{axis}, mm (poses per {width} mm)"),
                };
                let path = histogram_path(set.kind, *mode, axis);
                without_legend(View::new("BarChart", title, path)).into()
            })
        });
        let poses = set.measurements.observations.len();
        let name = format!("{} set, {poses} observations", set.kind.key());
        Container::new(Grid, charts).in_columns(4).named(name).into()
    });
    let tabs: Vec<_> = tabs.collect();
    (!tabs.is_empty()).then(|| Container::new(Tabs, tabs).named("Error histograms").into())
}

/// The deflections of the simulated machine.
fn machine(story: &Story<'_>) -> Option<Node> {
    let truth = story.truth?;
    let drawn = vec![
        format!("+ /{SCENE}/**"),
        format!("- /{ARROWS}/**"),
        format!("- /{DRIVEN_PATH}/**"),
        format!("- /{SCENE}/measured/**"),
        format!("- /{SCENE}/nests/**"),
        format!("- /{SCENE}/line_of_sight/**"),
        format!("- /{CALIBRATED}/**"),
    ];
    let title = "Machine, and its deflection drawn x100 (magenta): 10 cm for 1 mm";
    let picture = picture(title, &Setting::of(story), drawn);
    let rod = truth.poses.iter().flatten().any(|settled| settled.rod_force.is_some());
    let temperature = truth.effects.iter().flatten().any(|effects| effects.temperature.is_some());
    let tab = beside_machine(picture, rod, temperature);
    Some(tab.named("Deflection x100").into())
}

/// The effect of corrected commands: the path with enlarged errors, and the tables.
fn compensated(story: &Story<'_>) -> Option<Node> {
    let driven = story.closed_loop?;
    let tables = page("Commands corrected and driven again", "tables/compensation");
    if driven.path.is_none() {
        return Some(Container::new(Tabs, [tables]).named("Compensated").into());
    }
    let mut drawn = shown(story, DRIVEN_PATH);
    drawn.extend([format!("+ /{PATH}"), format!("+ /{SCENE}/trackers")]);
    let title = "Path as planned (white), and as measured with errors x100: 10 cm for 1 mm";
    let path = picture(title, &Setting::of(story), drawn).into();
    Some(Container::new(Horizontal, [path, tables]).shared(SHARES).named("Compensated path x100").into())
}

/// A picture of the machine, and beside it its curves and its table.
fn beside_machine(picture: View, rod: bool, temperature: bool) -> Container {
    let deflection = Some(("Deflection at the target by elasticity, mm", DEFLECTION));
    let rod = rod.then_some(("Tension of the four-bar's rod, N", ROD_FORCE));
    let temperature = temperature.then_some(("Temperature of the air, °C", TEMPERATURE));
    let plots = [deflection, rod, temperature].into_iter().flatten();
    let plots = Container::new(Vertical, plots.map(|(title, path)| curves(title, path).into()));
    let right = Container::new(Vertical, [plots.into(), page("Machine at this pose", "tables/machine")]);
    Container::new(Horizontal, [picture.into(), right.shared([3.0, 2.0]).into()]).shared(SHARES)
}

fn estimates(story: &Story<'_>) -> Vec<Node> {
    let modes: Vec<_> = identified(story).collect();
    if modes.is_empty() {
        return Vec::new();
    }
    let ways = modes.iter().map(|(mode, _)| {
        let title = format!("log10 of σ to go, {}", mode.title());
        curves(title, format!("{CONVERGENCE}/{}", mode.key()))
    });
    let plots = std::iter::once(curves("log10 of the cost, all modes", COST)).chain(ways);
    let legend = PlotLegend::new().with_corner(Corner2D::RightTop);
    let plots = Container::new(Grid, plots.map(|plot| plot.set("PlotLegend", &legend).into())).in_columns(2);
    let convergence =
        Container::new(Horizontal, [plots.into(), page("The way to the minimum", "tables/convergence")])
            .shared(SHARES)
            .named("Convergence (timeline: iteration)");

    let known = modes.iter().filter(|(_, estimate)| Correlations::of(estimate).is_some());
    let pictures: Vec<_> = known.map(|(mode, _)| correlations(*mode)).collect();
    let mut tabs = vec![convergence.into()];
    if !pictures.is_empty() {
        tabs.push(Container::new(Tabs, pictures).named("Correlations").into());
    }
    tabs
}

fn correlations(mode: Mode) -> Node {
    let root = format!("{CORRELATION}/{}", mode.key());
    let page = page("Strongest correlations", format!("tables/{root}"));
    let picture = View::new("2D", "disc +, square -, area: strength", root).into();
    Container::new(Horizontal, [picture, page]).shared(SHARES).named(mode.title()).into()
}

/// The messages of the layout for a session while it is measured: the machine, and how it gives way.
pub(super) fn session(setting: &Setting) -> Result<Vec<LogMsg>, RecordingError> {
    let drawn = vec![format!("+ /{SCENE}/**"), format!("- /{DEFLECTED}/**"), format!("- /{ARROWS}/**")];
    let picture = picture("Robot while it is measured", setting, drawn);
    rerun_layout::messages(&beside_machine(picture, setting.rod, false), Force::Active)
}

/// What a view in space has to show.
pub(super) struct Setting {
    /// Direction against gravity.
    pub up: Vector3<f64>,
    /// Where the trackers stand, m.
    pub trackers: Vec<Vector3<f64>>,
    /// Other points that must be visible, m.
    pub seen: Vec<Vector3<f64>>,
    /// Whether there is a four-bar.
    pub rod: bool,
}

impl Setting {
    fn of(story: &Story<'_>) -> Self {
        let measured = story.sets.iter().flat_map(|set| scene::measured_points(story, &set.measurements));
        Self {
            up: scene::up(story),
            trackers: scene::trackers(story).iter().map(|t| t.translation.vector).collect(),
            seen: measured.collect(),
            rod: false,
        }
    }
}

/// A point of view from which the base, the trackers and all measured points are visible, on the trackers' side.
fn eye(setting: &Setting) -> EyeControls3D {
    let Setting { up, trackers, seen, .. } = setting;
    let seen = || seen.iter().chain(trackers).copied().chain([Vector3::zeros()]);
    let lowest = seen().fold(Vector3::repeat(f64::INFINITY), |low, p| low.inf(&p));
    let highest = seen().fold(Vector3::repeat(f64::NEG_INFINITY), |high, p| high.sup(&p));
    let centre = (lowest + highest) / 2.0;
    let radius = seen().map(|p| (p - centre).norm()).fold(0.5, f64::max);

    let towards = trackers.first().map_or(Vector3::x(), |t| t - centre);
    let level = towards - up * up.dot(&towards);
    let level = level.try_normalize(1e-9).unwrap_or_else(|| scene::across(up).into_inner());
    // To one side of the line of sight, which would otherwise be seen end on.
    let aside = Rotation3::from_axis_angle(&Unit::new_normalize(*up), 0.7) * level;
    let direction = (aside + 0.45 * up).normalize();
    let position = centre + direction * radius / HALF_VIEW.sin();
    EyeControls3D::new().with_position(xyz(&position)).with_look_target(xyz(&centre)).with_eye_up(xyz(up))
}
