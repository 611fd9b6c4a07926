//! Errors and estimates of the whole run, in Rerun.

use nalgebra::Vector3;
use rerun::archetypes::{BarChart, Boxes2D, LineStrips2D, Points2D, SeriesLines, SeriesPoints, TextDocument};
use rerun::components::{Length, MarkerShape, Radius};

use super::Story;
use super::figures::{Bins, Correlations, approaches, group};
use super::rerun_columns::{Shown, Time};
use super::rerun_entities::{AXES, CONVERGENCE, CORRELATION, COST, NORM, color, histogram_path, single};
use super::rerun_writer::EntityWriter;
use super::scene::{self, Colour};
use super::{RecordingError, tables};
use calibrig_estimation::evaluation::ModeOutcome;
use calibrig_estimation::identification::{Estimate, Mode};

/// Number of curves in a plot of parameters.
const SLOWEST: usize = 6;
/// Number of correlations in a table.
const STRONGEST: usize = 25;
/// How many of them are numbered in the picture.
const NUMBERED: usize = 10;
/// The weakest correlation that is drawn: its mark is a fifth as wide as that of a full correlation.
const WEAKEST: f64 = 0.04;
/// Colours of parameters; their marks differ, too.
const COLOURS: [Colour; SLOWEST] = [
    [230, 159, 0, 255],
    [86, 180, 233, 255],
    [0, 158, 115, 255],
    [240, 228, 66, 255],
    [204, 121, 167, 255],
    [213, 94, 0, 255],
];
const MARKS: [MarkerShape; SLOWEST] = [
    MarkerShape::Circle,
    MarkerShape::Square,
    MarkerShape::Up,
    MarkerShape::Diamond,
    MarkerShape::Cross,
    MarkerShape::Plus,
];

/// The bins of a mode's errors. All identified modes share theirs; the errors of the others are many times larger.
pub(super) fn bins(story: &Story<'_>, mode: &ModeOutcome) -> Option<Bins> {
    let alike = story.modes.iter().filter(|m| m.estimate.is_some() == mode.estimate.is_some());
    Bins::around(alike.flat_map(|m| m.errors.iter().flatten()))
}

impl EntityWriter {
    /// Errors of all modes on all sets, in 3-D and per axis.
    pub(super) fn histograms(&mut self, story: &Story<'_>) -> Result<(), RecordingError> {
        for mode in story.modes {
            let Some(bins) = bins(story, mode) else { continue };
            for (set, errors) in story.sets.iter().zip(&mode.errors) {
                let norms = bins.lengths(errors.iter().map(Vector3::norm));
                let axes = AXES
                    .iter()
                    .zip(0..)
                    .map(|(axis, i)| (*axis, bins.signed(errors.iter().map(move |e: &Vector3<f64>| e[i]))));
                for (axis, histogram) in [(NORM, norms)].into_iter().chain(axes) {
                    let middles: Vec<_> = histogram.centres.iter().map(|m| 1e3 * m).collect();
                    let widths = vec![Length::from(single(1e3 * bins.width)); middles.len()];
                    let chart = BarChart::new(histogram.counts)
                        .with_abscissa(middles)
                        .with_widths(widths)
                        .with_color(color(scene::mode_colour(mode.mode)));
                    self.fixed(&histogram_path(set.kind, mode.mode, axis), &chart)?;
                }
            }
        }
        Ok(())
    }

    /// The correlations of a mode's parameters: discs where positive, squares where negative, area by strength.
    pub(super) fn correlations(&mut self, mode: Mode, estimate: &Estimate) -> Result<(), RecordingError> {
        let root = format!("{CORRELATION}/{}", mode.key());
        let text = tables::correlations(mode, estimate, STRONGEST);
        self.fixed(&format!("tables/{root}"), &TextDocument::from_markdown(text))?;
        let Some(correlations) = Correlations::of(estimate) else { return Ok(()) };
        self.labelled_groups(&root, estimate)?;

        let seen: Vec<_> = correlations.pairs().filter(|(_, _, r)| r.abs() >= WEAKEST).collect();
        let name = |(row, column, r): (usize, usize, f64)| {
            let [one, other] = [row, column].map(|index| estimate.parameters[index].id);
            format!("{one}, {other}: {r:+.3}")
        };
        let place = |(row, column, _): (usize, usize, f64)| [single(column as f64), single(row as f64)];
        let size = |(_, _, r): (usize, usize, f64)| single(0.45 * r.abs().sqrt());
        let (positive, negative): (Vec<_>, Vec<_>) = seen.into_iter().partition(|(_, _, r)| *r > 0.0);
        let discs = Points2D::new(positive.iter().copied().map(place))
            .with_radii(positive.iter().copied().map(size))
            .with_colors([color(scene::POSITIVE)])
            .with_labels(positive.iter().copied().map(name))
            .with_show_labels(false);
        self.fixed(&format!("{root}/positive"), &discs)?;
        let halves = negative.iter().copied().map(|pair| [size(pair); 2]);
        let squares = Boxes2D::from_centers_and_half_sizes(negative.iter().copied().map(place), halves)
            .with_radii([Radius::new_scene_units(0.06)])
            .with_colors([color(scene::NEGATIVE)])
            .with_labels(negative.iter().copied().map(name))
            .with_show_labels(false);
        self.fixed(&format!("{root}/negative"), &squares)?;

        let strongest = correlations.strongest(NUMBERED);
        let numbers = Points2D::new(strongest.iter().copied().map(place))
            .with_radii([0.08])
            .with_colors([color(scene::POINT)])
            .with_labels((1..=strongest.len()).map(|number| number.to_string()))
            .with_show_labels(true);
        self.fixed(&format!("{root}/strongest"), &numbers)
    }

    /// The diagonal, labelled with the groups of the parameters.
    fn labelled_groups(&mut self, root: &str, estimate: &Estimate) -> Result<(), RecordingError> {
        let groups: Vec<_> = estimate.parameters.iter().map(|p| group(p.id)).collect();
        let (mut labels, mut places, mut steps) = (Vec::new(), Vec::new(), Vec::new());
        let mut start = 0_usize;
        for run in groups.chunk_by(|a, b| a == b) {
            let (from, to) = (start as f64 - 0.5, (start + run.len()) as f64 - 0.5);
            start += run.len();
            steps.push([[from, from], [to, from], [to, to]].map(|corner| corner.map(single)));
            // Beside the diagonal, where no pair is drawn.
            places.push([to + 0.06 * groups.len() as f64, f64::midpoint(from, to)].map(single));
            labels.extend(run.first().cloned());
        }
        let lines = LineStrips2D::new(steps)
            .with_colors([color(scene::GHOST)])
            .with_radii([Radius::new_ui_points(0.5)]);
        self.fixed(&format!("{root}/groups"), &lines)?;
        let names = Points2D::new(places)
            .with_labels(labels)
            .with_show_labels(true)
            .with_colors([color(scene::GHOST)])
            .with_radii([Radius::new_ui_points(0.0)]);
        self.fixed(&format!("{root}/group_names"), &names)
    }

    /// The cost of a mode and the distance of its slowest parameters from their final values, on the timeline `iteration`.
    pub(super) fn convergence(&mut self, mode: Mode, estimate: &Estimate) -> Result<(), RecordingError> {
        let ways = approaches(estimate);
        let root = format!("{CONVERGENCE}/{}", mode.key());
        let slowest: Vec<_> = ways
            .iter()
            .take(SLOWEST)
            .map(|way| (format!("{root}/{}", estimate.parameters[way.parameter].id), way))
            .collect();
        for ((path, way), (colour, mark)) in slowest.iter().zip(COLOURS.into_iter().zip(MARKS)) {
            let name = estimate.parameters[way.parameter].id.to_string();
            let line = SeriesLines::new().with_names([name.as_str()]).with_colors([color(colour)]);
            self.curve(path, &line.with_widths([1.5]))?;
            let points = SeriesPoints::new().with_names([name]).with_colors([color(colour)]);
            self.curve(path, &points.with_markers([mark]).with_marker_sizes([4.0]))?;
        }
        for (index, iteration) in estimate.iterations.iter().enumerate() {
            self.at(Time::Iteration(i64::try_from(index).unwrap_or(i64::MAX).saturating_add(1)));
            // Costs fall by many powers of ten; that of an exact fit is zero.
            self.logarithm(&format!("{COST}/{}", mode.key()), iteration.cost)?;
            for (path, way) in &slowest {
                self.logarithm(path, way.distances[index])?;
            }
        }
        Ok(())
    }

    /// The decimal logarithm of `value`, if it is finite.
    fn logarithm(&mut self, path: &str, value: f64) -> Result<(), RecordingError> {
        let exponent = value.log10();
        if exponent.is_finite() { self.put(path, Shown::Value(exponent)) } else { Ok(()) }
    }
}
