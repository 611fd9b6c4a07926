//! What a Rerun file holds, kept in columns until the file is written: an entity is one chunk, however many poses it has rows for.

use std::collections::HashMap;
use std::iter::repeat_n;

use nalgebra::UnitQuaternion;
use rerun::archetypes::{Arrows3D, LineStrips3D, Points3D, Scalars, TextDocument, TextLog, Transform3D};
use rerun::components::{MediaType, Radius, TextLogLevel};
use rerun::external::arrow::array::ListArray;
use rerun::external::arrow::buffer::{NullBuffer, OffsetBuffer};
use rerun::external::arrow::datatypes::Field;
use rerun::external::re_log_types::{SetStoreInfo, StoreInfo};
use rerun::log::{Chunk, ChunkComponents, ChunkId, LogMsg, RowId, TimeColumn};
use rerun::{
    AsComponents, EntityPath, Quaternion, SerializationResult, SerializedComponentBatch,
    SerializedComponentColumn, StoreId,
};

use super::rerun_scene::{color, single, xyz};
use super::scene::{Arrow, Colour};
use super::{LogLevel, RecordingError};
use calibrig_model::geometry::Transform;

/// Most rows of a chunk: viewers load and cache whole chunks.
const MOST_ROWS: usize = 4096;

/// When something is shown.
#[derive(Debug, Clone, Copy)]
pub(super) enum Time {
    /// At a pose: its running number, and simulated time, ns.
    Pose { number: i64, nanos: i64 },
    /// After an iteration, from 1.
    Iteration(i64),
}

/// What an entity shows at one time.
#[derive(Debug, Clone)]
pub(super) enum Shown {
    Place(Transform),
    Lines {
        strips: Vec<Vec<[f32; 3]>>,
        colour: Colour,
        radius: Radius,
    },
    Arrows {
        arrows: Vec<Arrow>,
        colour: Colour,
        radius: Radius,
        label: Option<String>,
    },
    Points {
        points: Vec<[f32; 3]>,
        colour: Colour,
        radius: Radius,
    },
    Value(f64),
    /// Markdown.
    Page(String),
    /// A line of the log.
    Entry(LogLevel, String),
}

/// The parts of `rows` that `part` finds.
fn parts<'a, T>(rows: &'a [Shown], part: impl Fn(&'a Shown) -> Option<T>) -> Vec<T> {
    rows.iter().filter_map(part).collect()
}

/// The rows of one entity, all of one kind, as columns.
pub(super) fn columns(rows: &[Shown]) -> SerializationResult<Vec<SerializedComponentColumn>> {
    let mut columns = Vec::with_capacity(6);
    let colours = || parts(rows, |row| row.style().map(|(colour, _)| color(colour)));
    let radii = || parts(rows, |row| row.style().map(|(_, radius)| radius));
    match rows.first() {
        None => {}
        Some(Shown::Place(_)) => {
            let places = parts(rows, |row| if let Shown::Place(place) = row { Some(place) } else { None });
            let all = Transform3D::update_fields()
                .with_many_translation(places.iter().map(|place| xyz(&place.translation.vector)))
                .with_many_quaternion(places.iter().map(|place| quaternion(place)));
            columns.extend(all.columns_of_unit_batches()?);
        }
        Some(Shown::Lines { .. }) => {
            let lines = parts(rows, |row| {
                if let Shown::Lines { strips, .. } = row { Some(strips.as_slice()) } else { None }
            });
            let strips = lines.iter().copied().flatten().map(|strip| strip.iter().copied());
            let all = LineStrips3D::update_fields().with_strips(strips);
            columns.extend(all.columns(lines.iter().map(|strips| strips.len()))?);
            let style = LineStrips3D::update_fields().with_colors(colours()).with_radii(radii());
            columns.extend(style.columns_of_unit_batches()?);
        }
        Some(Shown::Arrows { .. }) => {
            let arrows = parts(rows, |row| {
                if let Shown::Arrows { arrows, .. } = row { Some(arrows.as_slice()) } else { None }
            });
            let flat = || arrows.iter().copied().flatten();
            let all = Arrows3D::update_fields()
                .with_vectors(flat().map(|arrow| xyz(&arrow.vector)))
                .with_origins(flat().map(|arrow| xyz(&arrow.origin)));
            columns.extend(all.columns(arrows.iter().map(|arrows| arrows.len()))?);
            let mut style = Arrows3D::update_fields().with_colors(colours()).with_radii(radii());
            let labels =
                parts(
                    rows,
                    |row| {
                        if let Shown::Arrows { label, .. } = row { label.as_deref() } else { None }
                    },
                );
            if labels.len() == rows.len() {
                style = style.with_labels(labels).with_many_show_labels(repeat_n(true, rows.len()));
            }
            columns.extend(style.columns_of_unit_batches()?);
        }
        Some(Shown::Points { .. }) => {
            let points = parts(rows, |row| {
                if let Shown::Points { points, .. } = row { Some(points.as_slice()) } else { None }
            });
            let all = Points3D::update_fields().with_positions(points.iter().copied().flatten().copied());
            columns.extend(all.columns(points.iter().map(|points| points.len()))?);
            let style = Points3D::update_fields().with_colors(colours()).with_radii(radii());
            columns.extend(style.columns_of_unit_batches()?);
        }
        Some(Shown::Value(_)) => {
            let values = parts(rows, |row| if let Shown::Value(value) = row { Some(*value) } else { None });
            columns.extend(Scalars::update_fields().with_scalars(values).columns_of_unit_batches()?);
        }
        Some(Shown::Page(_)) => {
            let pages =
                parts(rows, |row| if let Shown::Page(text) = row { Some(text.as_str()) } else { None });
            let types = repeat_n(MediaType::markdown(), pages.len());
            let all = TextDocument::update_fields().with_many_text(pages).with_many_media_type(types);
            columns.extend(all.columns_of_unit_batches()?);
        }
        Some(Shown::Entry(..)) => {
            let levels = parts(rows, |row| match row {
                Shown::Entry(LogLevel::Info, _) => Some(TextLogLevel::INFO),
                Shown::Entry(LogLevel::Warning, _) => Some(TextLogLevel::WARN),
                _ => None,
            });
            let texts =
                parts(rows, |row| if let Shown::Entry(_, text) = row { Some(text.as_str()) } else { None });
            let all = TextLog::update_fields().with_many_text(texts).with_many_level(levels);
            columns.extend(all.columns_of_unit_batches()?);
        }
    }
    Ok(columns)
}

impl Shown {
    fn style(&self) -> Option<(Colour, Radius)> {
        match self {
            Self::Lines { colour, radius, .. }
            | Self::Arrows { colour, radius, .. }
            | Self::Points { colour, radius, .. } => Some((*colour, *radius)),
            Self::Place(_) | Self::Value(_) | Self::Page(_) | Self::Entry(..) => None,
        }
    }
}

pub(super) fn quaternion(transform: &Transform) -> Quaternion {
    let q = UnitQuaternion::from_rotation_matrix(&transform.rotation);
    Quaternion::from_xyzw([q.i, q.j, q.k, q.w].map(single))
}

/// What is told of a run, by entity.
pub(super) struct Columns {
    store: StoreInfo,
    /// What has no time, and what is complete.
    chunks: Vec<Chunk>,
    /// In the order in which they were first told of.
    entities: Vec<Entity>,
    indices: HashMap<String, usize>,
    now: Time,
}

struct Entity {
    path: String,
    /// What holds from the first row on.
    from_first: Vec<SerializedComponentBatch>,
    times: Vec<Time>,
    rows: Vec<Shown>,
}

impl Columns {
    pub(super) fn new(store: StoreInfo, properties: &impl AsComponents) -> Result<Self, RecordingError> {
        let mut columns = Self {
            store,
            chunks: Vec::new(),
            entities: Vec::new(),
            indices: HashMap::new(),
            now: Time::Pose { number: 0, nanos: 0 },
        };
        let path = EntityPath::properties();
        columns.chunks.push(chunk(path, Vec::new(), whole(properties.as_serialized_batches()))?);
        Ok(columns)
    }

    pub(super) fn at(&mut self, time: Time) {
        self.now = time;
    }

    pub(super) fn fixed(&mut self, path: &str, shape: &impl AsComponents) -> Result<(), RecordingError> {
        let path = EntityPath::from(path);
        self.chunks.push(chunk(path, Vec::new(), whole(shape.as_serialized_batches()))?);
        Ok(())
    }

    /// What a curve looks like. It lies in the curve's first row: one chunk less than beside it.
    pub(super) fn curve(&mut self, path: &str, look: &impl AsComponents) {
        let look = look.as_serialized_batches();
        self.entity(path).from_first.extend(look);
    }

    pub(super) fn put(&mut self, path: &str, shown: Shown) -> Result<(), RecordingError> {
        let now = self.now;
        let entity = self.entity(path);
        entity.times.push(now);
        entity.rows.push(shown);
        if entity.rows.len() == MOST_ROWS {
            let full = entity.take()?;
            self.chunks.extend(full);
        }
        Ok(())
    }

    fn entity(&mut self, path: &str) -> &mut Entity {
        let index = match self.indices.get(path) {
            Some(index) => *index,
            None => {
                self.indices.insert(path.to_owned(), self.entities.len());
                self.entities.push(Entity {
                    path: path.to_owned(),
                    from_first: Vec::new(),
                    times: Vec::new(),
                    rows: Vec::new(),
                });
                self.entities.len() - 1
            }
        };
        &mut self.entities[index]
    }

    /// All of it, in an order that only depends on what was told.
    pub(super) fn messages(mut self) -> Result<Vec<LogMsg>, RecordingError> {
        let mut messages = vec![opening(&self.store)];
        for entity in &mut self.entities {
            self.chunks.extend(entity.take()?);
        }
        for chunk in &self.chunks {
            messages.push(message(&self.store.store_id, chunk)?);
        }
        Ok(messages)
    }
}

impl Entity {
    /// Its rows as a chunk, if there are any.
    fn take(&mut self) -> Result<Option<Chunk>, RecordingError> {
        let (times, rows) = (std::mem::take(&mut self.times), std::mem::take(&mut self.rows));
        if rows.is_empty() {
            return Ok(None);
        }
        let mut columns = columns(&rows).map_err(RecordingError::unrecordable)?;
        columns.extend(self.from_first.drain(..).map(|batch| first_of(batch, rows.len())));
        chunk(EntityPath::from(self.path.as_str()), timelines(&times), columns).map(Some)
    }
}

fn timelines(times: &[Time]) -> Vec<TimeColumn> {
    let part = |part: fn(&Time) -> Option<i64>| -> Vec<i64> { times.iter().filter_map(part).collect() };
    match times.first() {
        None => Vec::new(),
        Some(Time::Pose { .. }) => {
            let numbers =
                part(|time| if let Time::Pose { number, .. } = time { Some(*number) } else { None });
            let nanos = part(|time| if let Time::Pose { nanos, .. } = time { Some(*nanos) } else { None });
            vec![TimeColumn::new_sequence("pose", numbers), TimeColumn::new_duration_nanos("sim_time", nanos)]
        }
        Some(Time::Iteration(_)) => {
            let iterations = part(|time| if let Time::Iteration(index) = time { Some(*index) } else { None });
            vec![TimeColumn::new_sequence("iteration", iterations)]
        }
    }
}

/// One row of each.
pub(super) fn whole(batches: Vec<SerializedComponentBatch>) -> Vec<SerializedComponentColumn> {
    batches.into_iter().map(Into::into).collect()
}

/// A column of `rows` rows, of which only the first has something.
fn first_of(batch: SerializedComponentBatch, rows: usize) -> SerializedComponentColumn {
    let field = Field::new_list_field(batch.array.data_type().clone(), true);
    let later = rows.saturating_sub(1);
    let offsets = OffsetBuffer::from_lengths(std::iter::once(batch.array.len()).chain(repeat_n(0, later)));
    let there: Vec<_> = std::iter::once(true).chain(repeat_n(false, later)).collect();
    let list = ListArray::new(field.into(), offsets, batch.array, Some(NullBuffer::from(there)));
    SerializedComponentColumn::new(list, batch.descriptor)
}

/// A chunk; without times it always holds.
pub(super) fn chunk(
    path: EntityPath,
    times: Vec<TimeColumn>,
    columns: Vec<SerializedComponentColumn>,
) -> Result<Chunk, RecordingError> {
    let times = times.into_iter().map(|column| (*column.timeline().name(), column)).collect();
    let components: ChunkComponents = columns.into_iter().collect();
    Chunk::from_auto_row_ids(ChunkId::new(), path, times, components).map_err(RecordingError::unrecordable)
}

/// What makes the store known.
pub(super) fn opening(store: &StoreInfo) -> LogMsg {
    LogMsg::SetStoreInfo(SetStoreInfo { row_id: *RowId::new(), info: store.clone() })
}

pub(super) fn message(store: &StoreId, chunk: &Chunk) -> Result<LogMsg, RecordingError> {
    let message = chunk.to_arrow_msg().map_err(RecordingError::unrecordable)?;
    Ok(LogMsg::ArrowMsg(store.clone(), message))
}
