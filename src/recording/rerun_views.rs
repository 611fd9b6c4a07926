//! The views of a Rerun recording, in tabs.

use nalgebra::{Rotation3, Unit, Vector3};
use rerun::blueprint::{
    BarChartView, ContainerLike, Grid, Horizontal, Spatial2DView, Spatial3DView, Tabs, TextDocumentView,
    TextLogView, TimeSeriesView, Vertical,
};
use rerun::external::re_sdk_types::blueprint::archetypes::{EntityBehavior, EyeControls3D, PlotLegend};
use rerun::external::re_sdk_types::blueprint::components::Corner2D;
use rerun::{AsComponents, EntityPath};

use super::figures::Correlations;
use super::rerun_analysis::{CONVERGENCE, CORRELATION, COST, bins, histogram_path};
use super::rerun_scene::xyz;
use super::rerun_sink::{
    ARROWS, AXES, CALIBRATED, DEFLECTED, DEFLECTION, NORM, ROD_FORCE, SCENE, TEMPERATURE,
};
use super::scene;
use crate::pipeline::{Outcome, SetOutcome};
use calibrig_estimation::identification::{Estimate, Mode};

/// Half the angle that the eye is taken to see.
const HALF_VIEW: f64 = 0.55;

/// What a place of the layout is set to beyond what the views' builders can say.
pub(super) type Property = (EntityPath, Box<dyn AsComponents>);

/// The views that suit an outcome.
pub(super) struct Views<'a> {
    outcome: &'a Outcome,
    pub properties: Vec<Property>,
}

impl<'a> Views<'a> {
    pub(super) fn of(outcome: &'a Outcome) -> Self {
        Self { outcome, properties: Vec::new() }
    }

    /// All views. The first tab is what one sees on opening.
    pub(super) fn tabs(&mut self) -> Tabs {
        let mut tabs = vec![self.robot()];
        tabs.extend(self.histograms());
        tabs.extend(self.machine());
        tabs.extend(self.estimates());
        Tabs::new(tabs)
    }

    fn identified(&self) -> impl Iterator<Item = (Mode, &'a Estimate)> {
        self.outcome.modes.iter().filter_map(|m| Some((m.mode, m.estimate.as_ref()?)))
    }

    fn set(&mut self, view: &ContainerLike, name: &str, value: impl AsComponents + 'static) {
        self.properties.extend(property(view, name, value));
    }

    fn without_legend(&mut self, view: &ContainerLike) {
        self.set(view, "PlotLegend", PlotLegend::new().with_visible(false));
    }

    /// The robot on the left, residuals over poses and tables on the right.
    fn robot(&mut self) -> ContainerLike {
        let mut drawn = self.shown(ARROWS);
        drawn[0] = format!("+ /{SCENE}/**");
        drawn.push(format!("- /{DEFLECTED}/**"));
        let picture: ContainerLike = Spatial3DView::new("Robot; arrows: residuals x100, 10 cm for 1 mm")
            .with_origin(SCENE)
            .with_contents(drawn)
            .into();
        self.set(&picture, "EyeControls3D", eye(&Setting::of(self.outcome)));
        if self.outcome.truth.is_some() {
            // On the machine's, but for millimetres: a click on its eye in the blueprint panel shows it.
            let place = format!("ViewContents/overrides/{CALIBRATED}/visualizers");
            self.set(&picture, &place, EntityBehavior::new().with_visible(false));
        }
        let log = TextLogView::new("Log").with_origin("log").into();
        let left = Vertical::new([picture, log]).with_row_shares([4.0, 1.0]);
        let right = Vertical::new([self.residuals(), Self::pages()]).with_row_shares([3.0, 2.0]);
        Horizontal::new([left.into(), right.into()])
            .with_column_shares([3.0, 2.0])
            .with_name("Robot and residuals")
            .into()
    }

    /// What lies under `root`, but for the modes before identification: their errors would hide what is left after it.
    fn shown(&self, root: &str) -> Vec<String> {
        let uncalibrated = self.outcome.modes.iter().filter(|m| m.estimate.is_none());
        let mut contents = vec![format!("+ /{root}/**")];
        if self.identified().next().is_some() {
            contents.extend(uncalibrated.map(|m| format!("- /{root}/{}/**", m.mode.key())));
        }
        contents
    }

    fn residuals(&mut self) -> ContainerLike {
        let axes = AXES.map(|axis| -> ContainerLike {
            let root = format!("residual_mm/{axis}");
            TimeSeriesView::new(format!("Residual {axis}, mm"))
                .with_contents(self.shown(&root))
                .with_origin(root)
                .into()
        });
        // The three have the same curves: one legend serves them.
        for view in &axes[1..] {
            self.without_legend(view);
        }
        let all = TimeSeriesView::new("3-D error of all modes, mm").with_origin("residual_mm/norm").into();
        Tabs::new([Vertical::new(axes).with_name("Residuals").into(), all]).into()
    }

    fn pages() -> ContainerLike {
        let pages = [
            ("Accuracy", "tables/accuracy"),
            ("This pose", "tables/pose"),
            ("Parameters", "tables/parameters"),
            ("Identification", "tables/identification"),
        ];
        Tabs::new(pages.map(|(title, path)| TextDocumentView::new(title).with_origin(path).into())).into()
    }

    /// A row a mode: its errors in 3-D and per axis; the set that the fit has not seen first.
    fn histograms(&mut self) -> Option<ContainerLike> {
        let outcome = self.outcome;
        let mut sets: Vec<&SetOutcome> =
            outcome.sets.iter().filter(|set| !set.measurements.observations.is_empty()).collect();
        sets.reverse();
        let mut tabs = Vec::new();
        for set in sets {
            let mut charts = Vec::new();
            for mode in &outcome.modes {
                let Some(bins) = bins(outcome, mode) else { continue };
                let width = 1e3 * bins.width;
                for axis in [NORM].into_iter().chain(AXES) {
                    let title = match axis {
                        NORM => format!("{}: 3-D error, mm", mode.mode.title()),
                        axis => format!("{axis}, mm (poses per {width} mm)"),
                    };
                    let chart: ContainerLike = BarChartView::new(title)
                        .with_origin(histogram_path(set.kind, mode.mode, axis))
                        .into();
                    self.without_legend(&chart);
                    charts.push(chart);
                }
            }
            let poses = set.measurements.observations.len();
            let name = format!("{} set, {poses} observations", set.kind.key());
            tabs.push(Grid::new(charts).with_grid_columns(4).with_name(name).into());
        }
        (!tabs.is_empty()).then(|| Tabs::new(tabs).with_name("Error histograms").into())
    }

    /// How the simulated machine gives way.
    fn machine(&mut self) -> Option<ContainerLike> {
        let truth = self.outcome.truth.as_ref()?;
        let drawn = [
            format!("+ /{SCENE}/**"),
            format!("- /{ARROWS}/**"),
            format!("- /{SCENE}/measured/**"),
            format!("- /{SCENE}/nests/**"),
            format!("- /{SCENE}/line_of_sight/**"),
            format!("- /{CALIBRATED}/**"),
        ];
        let picture: ContainerLike =
            Spatial3DView::new("Machine, and its deflection drawn x100 (magenta): 10 cm for 1 mm")
                .with_origin(SCENE)
                .with_contents(drawn)
                .into();
        self.set(&picture, "EyeControls3D", eye(&Setting::of(self.outcome)));
        let rod = truth.poses.iter().flatten().any(|settled| settled.rod_force.is_some());
        let temperature = truth.effects.iter().flatten().any(|effects| effects.temperature.is_some());
        let curves = Vertical::new(machine_curves(rod, temperature));
        let page = TextDocumentView::new("Machine at this pose").with_origin("tables/machine").into();
        let right = Vertical::new([curves.into(), page]).with_row_shares([3.0, 2.0]);
        let tab = Horizontal::new([picture, right.into()]).with_column_shares([3.0, 2.0]);
        Some(tab.with_name("Deflection x100").into())
    }

    fn estimates(&mut self) -> Vec<ContainerLike> {
        let modes: Vec<_> = self.identified().collect();
        if modes.is_empty() {
            return Vec::new();
        }
        let curves = |title: String, path: String| TimeSeriesView::new(title).with_origin(path).into();
        let cost: ContainerLike = curves("log10 of the cost, all modes".to_owned(), COST.to_owned());
        let ways = modes.iter().map(|(mode, _)| {
            let title = format!("log10 of σ to go, {}", mode.title());
            curves(title, format!("{CONVERGENCE}/{}", mode.key()))
        });
        let plots: Vec<ContainerLike> = std::iter::once(cost).chain(ways).collect();
        for plot in &plots {
            self.set(plot, "PlotLegend", PlotLegend::new().with_corner(Corner2D::RightTop));
        }
        let page = TextDocumentView::new("The way to the minimum").with_origin("tables/convergence").into();
        let plots = Grid::new(plots).with_grid_columns(2);
        let convergence = Horizontal::new([plots.into(), page])
            .with_column_shares([3.0, 2.0])
            .with_name("Convergence (timeline: iteration)");

        let known = modes.iter().filter(|(_, estimate)| Correlations::of(estimate).is_some());
        let pictures: Vec<ContainerLike> = known.map(|(mode, _)| correlations(*mode)).collect();
        let mut tabs = vec![convergence.into()];
        if !pictures.is_empty() {
            tabs.push(Tabs::new(pictures).with_name("Correlations").into());
        }
        tabs
    }
}

fn property(view: &ContainerLike, name: &str, value: impl AsComponents + 'static) -> Option<Property> {
    let ContainerLike::View(view) = view else { return None };
    Some((view.blueprint_path().join(&name.into()), Box::new(value)))
}

fn correlations(mode: Mode) -> ContainerLike {
    let root = format!("{CORRELATION}/{}", mode.key());
    let page = TextDocumentView::new("Strongest correlations").with_origin(format!("tables/{root}")).into();
    let picture = Spatial2DView::new("disc +, square -, area: strength").with_origin(root).into();
    Horizontal::new([picture, page]).with_column_shares([3.0, 2.0]).with_name(mode.title()).into()
}

/// The view of a session while it is measured: the machine, and how it gives way.
pub(super) fn session(setting: &Setting) -> (Horizontal, Vec<Property>) {
    let drawn = [format!("+ /{SCENE}/**"), format!("- /{DEFLECTED}/**"), format!("- /{ARROWS}/**")];
    let picture: ContainerLike =
        Spatial3DView::new("Robot while it is measured").with_origin(SCENE).with_contents(drawn).into();
    let properties = property(&picture, "EyeControls3D", eye(setting)).into_iter().collect();
    let page = TextDocumentView::new("Machine at this pose").with_origin("tables/machine").into();
    let curves = Vertical::new(machine_curves(setting.rod, false)).into();
    let right = Vertical::new([curves, page]).with_row_shares([3.0, 2.0]);
    (Horizontal::new([picture, right.into()]).with_column_shares([3.0, 2.0]), properties)
}

/// What is known of the surroundings before anything was measured.
pub(super) struct Setting {
    /// Opposite to gravity.
    pub up: Vector3<f64>,
    /// Where the trackers stand, m.
    pub trackers: Vec<Vector3<f64>>,
    /// What has to be in the picture beside them, m.
    pub seen: Vec<Vector3<f64>>,
    /// Whether there is a four-bar.
    pub rod: bool,
}

impl Setting {
    fn of(outcome: &Outcome) -> Self {
        let measured = outcome.sets.iter().flat_map(|set| scene::measured_points(outcome, &set.measurements));
        Self {
            up: scene::up(outcome),
            trackers: scene::trackers(outcome).iter().map(|t| t.translation.vector).collect(),
            seen: measured.collect(),
            rod: false,
        }
    }
}

fn machine_curves(rod: bool, temperature: bool) -> Vec<ContainerLike> {
    let deflection = Some(("Deflection at the target by elasticity, mm", DEFLECTION));
    let rod = rod.then_some(("Tension of the four-bar's rod, N", ROD_FORCE));
    let temperature = temperature.then_some(("Temperature of the air, °C", TEMPERATURE));
    let curves = [deflection, rod, temperature].into_iter().flatten();
    curves.map(|(title, path)| TimeSeriesView::new(title).with_origin(path).into()).collect()
}

/// An eye that sees the base, the trackers and all measured points, from the trackers' side.
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
    // Beside the line of sight, which would otherwise be seen end on.
    let aside = Rotation3::from_axis_angle(&Unit::new_normalize(*up), 0.7) * level;
    let direction = (aside + 0.45 * up).normalize();
    let position = centre + direction * radius / HALF_VIEW.sin();
    EyeControls3D::new().with_position(xyz(&position)).with_look_target(xyz(&centre)).with_eye_up(xyz(up))
}
