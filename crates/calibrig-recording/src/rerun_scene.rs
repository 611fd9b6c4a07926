//! The pictures in space that Rerun draws.

use nalgebra::Vector3;
use rerun::archetypes::{
    Arrows3D, Boxes3D, Cylinders3D, Ellipsoids3D, LineStrips3D, Points3D, ViewCoordinates,
};
use rerun::components::{FillMode, Radius};

use super::Story;
use super::rerun_columns::Shown;
use super::rerun_entities::{ARROWS, DEFLECTED, DRIVEN_PATH, PATH, SCENE, color, quaternion, single, xyz};
use super::rerun_writer::EntityWriter;
use super::scene::{self, Arrow, Colour, Sighting};
use super::{Chain, ChainKind, DEFLECTION_SCALE, Measured, RESIDUAL_SCALE, RecordingError};
use calibrig_estimation::evaluation::closed_loop::DrivenPath;
use calibrig_estimation::identification::Mode;
use calibrig_model::geometry::Transform;
use calibrig_model::{Visual, VisualShape};

/// Length of the bars that show the scale of enlarged errors and deflections, m.
const SCALE_BAR: f64 = 0.5;

impl EntityWriter {
    /// What does not move: the trackers and nests, and which way is up.
    pub(super) fn surroundings(
        &mut self,
        up: &Vector3<f64>,
        trackers: &[Transform],
        nests: Vec<(String, Vector3<f64>)>,
    ) -> Result<(), RecordingError> {
        self.fixed(SCENE, &coordinates(up))?;
        let places: Vec<_> = trackers.iter().map(|tracker| tracker.translation.vector).collect();
        let names = (1..=places.len()).map(|number| format!("tracker, station {number}")).collect();
        let shown = balls(&places, names, scene::TRACKER, 0.12).with_show_labels(true);
        self.fixed(&format!("{SCENE}/trackers"), &shown)?;
        let (names, nests): (Vec<_>, Vec<_>) = nests.into_iter().unzip();
        let shown = balls(&nests, names, scene::NEST, 0.04).with_show_labels(false);
        self.fixed(&format!("{SCENE}/nests"), &shown)?;
        self.scales(up, places.first().copied().unwrap_or_default())
    }

    /// The links' shapes of the robot `kind`.
    pub(super) fn robot(&mut self, kind: ChainKind, visuals: &[Vec<Visual>]) -> Result<(), RecordingError> {
        for (i, visuals) in visuals.iter().enumerate() {
            let link = if i == 0 { format!("{SCENE}/base") } else { link_path(kind, i - 1) };
            self.shapes(&link, visuals)?;
        }
        Ok(())
    }

    fn shapes(&mut self, link: &str, visuals: &[Visual]) -> Result<(), RecordingError> {
        let grey = color(scene::SHELL);
        for (i, visual) in visuals.iter().enumerate() {
            let path = format!("{link}/shape{}", i + 1);
            let centre = [xyz(&visual.link_from_shape.translation.vector)];
            let turn = [quaternion(&visual.link_from_shape)];
            match visual.shape {
                VisualShape::Box(edges) => {
                    let cube = Boxes3D::from_centers_and_sizes(centre, [xyz(&edges.into())]);
                    let cube = cube.with_quaternions(turn).with_colors([grey]);
                    self.fixed(&path, &cube.with_fill_mode(FillMode::Solid))?;
                }
                VisualShape::Cylinder { radius, length } => {
                    let cylinder = Cylinders3D::from_lengths_and_radii([single(length)], [single(radius)]);
                    let cylinder = cylinder.with_centers(centre).with_quaternions(turn).with_colors([grey]);
                    self.fixed(&path, &cylinder.with_fill_mode(FillMode::Solid))?;
                }
                VisualShape::Sphere(radius) => {
                    let ball = Ellipsoids3D::from_centers_and_radii(centre, [single(radius)]);
                    self.fixed(&path, &ball.with_colors([grey]).with_fill_mode(FillMode::Solid))?;
                }
            }
        }
        Ok(())
    }

    /// Bars above `place` that show the scale of errors and deflections.
    fn scales(&mut self, up: &Vector3<f64>, place: Vector3<f64>) -> Result<(), RecordingError> {
        let mut bar = |path: &str, what: &str, scale: f64, colour: Colour| {
            let along = SCALE_BAR * scene::across(up).into_inner();
            let bar = Arrows3D::from_vectors([xyz(&along)])
                .with_origins([xyz(&(place + 0.5 * up))])
                .with_labels([format!("{:.0} mm of {what}", 1e3 * SCALE_BAR / scale)])
                .with_show_labels(true)
                .with_colors([color(colour)])
                .with_radii([Radius::new_ui_points(3.0)]);
            self.fixed(path, &bar)
        };
        bar(&format!("{ARROWS}/scale"), "error", RESIDUAL_SCALE, scene::POINT)?;
        bar(&format!("{DEFLECTED}/scale"), "deflection", DEFLECTION_SCALE, scene::DEFLECTED)
    }

    /// A path as planned, and as measured with the commands of every mode.
    pub(super) fn driven_path(&mut self, path: &DrivenPath) -> Result<(), RecordingError> {
        let strip = |points: &[Vector3<f64>], colour: Colour| {
            LineStrips3D::new([points.iter().map(xyz).collect::<Vec<_>>()])
                .with_colors([color(colour)])
                .with_radii([Radius::new_ui_points(1.5)])
        };
        if let Some(points) = scene::planned_path(path) {
            self.fixed(PATH, &strip(&points, scene::POINT))?;
        }
        for mode in &path.modes {
            let drawn = strip(&scene::driven_path(mode), scene::mode_colour(mode.mode));
            self.fixed(&format!("{DRIVEN_PATH}/{}", mode.mode.key()), &drawn)?;
        }
        Ok(())
    }

    /// All measured points and all residual arrows, which do not change with the pose.
    pub(super) fn all_measured(&mut self, story: &Story<'_>) -> Result<(), RecordingError> {
        for (index, set) in story.sets.iter().enumerate() {
            let key = set.kind.key();
            let points = scene::measured_points(story, &set.measurements);
            let points = Points3D::new(points.iter().map(xyz))
                .with_colors([color(scene::POINT)])
                .with_radii([Radius::new_ui_points(2.0)]);
            self.fixed(&format!("{SCENE}/measured/{key}"), &points)?;
            for mode in story.modes {
                let observations = &set.measurements.observations;
                let errors = mode.errors.get(index).map_or(&[][..], Vec::as_slice);
                let arrows: Vec<_> =
                    observations.iter().zip(errors).filter_map(|(o, e)| scene::arrow(mode, o, e)).collect();
                let path = format!("{ARROWS}/{}/{key}", mode.mode.key());
                self.fixed(&path, &arrows3d(&arrows, scene::mode_colour(mode.mode), 1.0))?;
            }
        }
        Ok(())
    }

    /// A robot: with its links' shapes, or only as a line.
    pub(super) fn chain(&mut self, chain: &Chain, ghost: bool) -> Result<(), RecordingError> {
        for (i, link) in chain.links.iter().enumerate().filter(|_| !ghost) {
            self.put(&link_path(chain.kind, i), Shown::Place(*link))?;
        }
        // Another colour tells the calibrated robot from the machine beside it.
        let beside = ghost && chain.kind == ChainKind::Calibrated;
        let colour = if beside { scene::mode_colour(Mode::Extended) } else { chain.kind.colour() };
        let root = format!("{SCENE}/{}", chain.kind.key());
        let thickness = if chain.kind == ChainKind::Nominal { 1.0 } else { 2.5 };
        let strip = |points: &[Vector3<f64>], radius| {
            let strips = vec![points.iter().map(xyz).collect()];
            Shown::Lines { strips, colour, radius }
        };
        let thin = Radius::new_ui_points(thickness);
        self.put(&format!("{root}/chain"), strip(&chain.polyline(), thin))?;
        if let Some(linkage) = &chain.linkage {
            let radius = if ghost { thin } else { Radius::new_scene_units(single(scene::ROD_RADIUS)) };
            self.put(&format!("{root}/linkage"), strip(linkage, radius))?;
        }
        Ok(())
    }

    /// The deflection of the target, enlarged like that of the machine.
    pub(super) fn deflection(&mut self, measured: &Measured<'_>) -> Result<(), RecordingError> {
        let (Some(deflection), Some(rigid)) = (measured.deflection(0), measured.rigid.first()) else {
            return Ok(());
        };
        let drawn = DEFLECTION_SCALE * deflection;
        let label =
            format!("{:.1} mm of deflection, drawn as {:.2} m", 1e3 * deflection.norm(), drawn.norm());
        let arrow = Shown::Arrows {
            arrows: vec![Arrow { origin: rigid.target, vector: drawn }],
            colour: scene::DEFLECTED,
            radius: Radius::new_ui_points(2.5),
            label: Some(label),
        };
        self.put(&format!("{DEFLECTED}/at_target"), arrow)
    }

    /// From the trackers to the targets.
    pub(super) fn sightings(&mut self, sightings: &[Sighting]) -> Result<(), RecordingError> {
        let beams = Shown::Lines {
            strips: sightings.iter().map(|s| vec![xyz(&s.tracker), xyz(&s.point)]).collect(),
            colour: scene::BEAM,
            radius: Radius::new_ui_points(1.0),
        };
        self.put(&format!("{SCENE}/line_of_sight"), beams)?;
        let targets = Shown::Points {
            points: sightings.iter().map(|s| xyz(&s.point)).collect(),
            colour: scene::BEAM,
            radius: Radius::new_scene_units(0.05),
        };
        self.put(&format!("{SCENE}/target"), targets)?;
        // Only full poses have axes.
        for (place, (name, colour)) in ["x", "y", "z"].into_iter().zip(scene::AXES).enumerate() {
            let of_axis = sightings.iter().filter_map(|seen| seen.axes().nth(place));
            let arrows: Vec<Arrow> = of_axis.map(|(arrow, _)| arrow).collect();
            if !arrows.is_empty() {
                let axis = Shown::Arrows { arrows, colour, radius: Radius::new_ui_points(2.5), label: None };
                self.put(&format!("{SCENE}/target/{name}"), axis)?;
            }
        }
        Ok(())
    }
}

fn link_path(kind: ChainKind, index: usize) -> String {
    format!("{SCENE}/{}/link{}", kind.key(), index + 1)
}

fn balls(places: &[Vector3<f64>], names: Vec<String>, rgba: Colour, radius: f32) -> Points3D {
    Points3D::new(places.iter().map(xyz)).with_labels(names).with_colors([color(rgba)]).with_radii([radius])
}

fn arrows3d(arrows: &[Arrow], rgba: Colour, thickness: f32) -> Arrows3D {
    Arrows3D::from_vectors(arrows.iter().map(|a| xyz(&a.vector)))
        .with_origins(arrows.iter().map(|a| xyz(&a.origin)))
        .with_colors([color(rgba)])
        .with_radii([Radius::new_ui_points(thickness)])
}

fn coordinates(up: &Vector3<f64>) -> ViewCoordinates {
    match (up.iamax(), up.sum() > 0.0) {
        (0, true) => ViewCoordinates::RIGHT_HAND_X_UP(),
        (0, false) => ViewCoordinates::RIGHT_HAND_X_DOWN(),
        (1, true) => ViewCoordinates::RIGHT_HAND_Y_UP(),
        (1, false) => ViewCoordinates::RIGHT_HAND_Y_DOWN(),
        (_, true) => ViewCoordinates::RIGHT_HAND_Z_UP(),
        (_, false) => ViewCoordinates::RIGHT_HAND_Z_DOWN(),
    }
}
