//! The contents of a Rerun file, collected until it is written: all rows of an entity become one chunk, however many poses there are.

use std::collections::HashMap;
use std::iter::repeat_n;

use rerun::archetypes::{Arrows3D, LineStrips3D, Points3D, Scalars, TextDocument, TextLog, Transform3D};
use rerun::components::{MediaType, Radius, TextLogLevel};
use rerun::external::arrow::array::ListArray;
use rerun::external::arrow::buffer::{NullBuffer, OffsetBuffer};
use rerun::external::arrow::datatypes::Field;
use rerun::external::re_log_types::{SetStoreInfo, StoreInfo};
use rerun::log::{Chunk, ChunkComponents, ChunkId, LogMsg, RowId, TimeColumn};
use rerun::{
    AsComponents, EntityPath, SerializationResult, SerializedComponentBatch, SerializedComponentColumn,
    StoreId,
};

use super::rerun_entities::{color, quaternion, xyz};
use super::scene::{Arrow, Colour};
use super::{LogLevel, RecordingError};
use calibrig_model::geometry::Transform;

/// Greatest number of rows in a chunk: viewers load and cache whole chunks.
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

/// What `rows` hold, of those that have the form `form`.
macro_rules! parts {
    ($rows:expr, $form:pat => $part:expr) => {
        $rows.iter().filter_map(|row| if let $form = row { Some($part) } else { None }).collect::<Vec<_>>()
    };
}

/// The rows of one entity, all of one kind, as columns.
pub(super) fn columns(rows: &[Shown]) -> SerializationResult<Vec<SerializedComponentColumn>> {
    let styles: Vec<_> = rows.iter().filter_map(Shown::style).collect();
    let colours = || styles.iter().map(|(colour, _)| color(*colour));
    let radii = || styles.iter().map(|(_, radius)| *radius);
    Ok(match rows.first() {
        None => Vec::new(),
        Some(Shown::Place(_)) => {
            let places = parts!(rows, Shown::Place(place) => place);
            Transform3D::update_fields()
                .with_many_translation(places.iter().map(|place| xyz(&place.translation.vector)))
                .with_many_quaternion(places.iter().map(|place| quaternion(place)))
                .columns_of_unit_batches()?
                .collect()
        }
        Some(Shown::Lines { .. }) => {
            let lines = parts!(rows, Shown::Lines { strips, .. } => strips);
            let all = lines.iter().flat_map(|strips| strips.iter().map(|strip| strip.iter().copied()));
            let style = LineStrips3D::update_fields().with_colors(colours()).with_radii(radii());
            let strips = LineStrips3D::update_fields().with_strips(all);
            let strips = strips.columns(lines.iter().map(|strips| strips.len()))?;
            strips.chain(style.columns_of_unit_batches()?).collect()
        }
        Some(Shown::Arrows { .. }) => {
            let arrows = parts!(rows, Shown::Arrows { arrows, .. } => arrows);
            let all = || arrows.iter().flat_map(|arrows| arrows.iter());
            let mut style = Arrows3D::update_fields().with_colors(colours()).with_radii(radii());
            let labels = parts!(rows, Shown::Arrows { label: Some(label), .. } => label.as_str());
            if labels.len() == rows.len() {
                style = style.with_labels(labels).with_many_show_labels(repeat_n(true, rows.len()));
            }
            let vectors = Arrows3D::update_fields()
                .with_vectors(all().map(|arrow| xyz(&arrow.vector)))
                .with_origins(all().map(|arrow| xyz(&arrow.origin)));
            let vectors = vectors.columns(arrows.iter().map(|arrows| arrows.len()))?;
            vectors.chain(style.columns_of_unit_batches()?).collect()
        }
        Some(Shown::Points { .. }) => {
            let points = parts!(rows, Shown::Points { points, .. } => points);
            let style = Points3D::update_fields().with_colors(colours()).with_radii(radii());
            let places = Points3D::update_fields().with_positions(points.iter().copied().flatten().copied());
            let places = places.columns(points.iter().map(|points| points.len()))?;
            places.chain(style.columns_of_unit_batches()?).collect()
        }
        Some(Shown::Value(_)) => {
            let values = parts!(rows, Shown::Value(value) => *value);
            Scalars::update_fields().with_scalars(values).columns_of_unit_batches()?.collect()
        }
        Some(Shown::Page(_)) => {
            let pages = parts!(rows, Shown::Page(text) => text.as_str());
            let types = repeat_n(MediaType::markdown(), pages.len());
            let all = TextDocument::update_fields().with_many_text(pages).with_many_media_type(types);
            all.columns_of_unit_batches()?.collect()
        }
        Some(Shown::Entry(..)) => {
            let level = |level: &LogLevel| match level {
                LogLevel::Info => TextLogLevel::INFO,
                LogLevel::Warning => TextLogLevel::WARN,
            };
            let levels = parts!(rows, Shown::Entry(of_row, _) => level(of_row));
            let texts = parts!(rows, Shown::Entry(_, text) => text.as_str());
            let all = TextLog::update_fields().with_many_text(texts).with_many_level(levels);
            all.columns_of_unit_batches()?.collect()
        }
    })
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

/// The contents so far, by entity.
pub(super) struct Columns {
    store: StoreInfo,
    /// Chunks without time, and those that are full.
    chunks: Vec<Chunk>,
    /// In the order of their first rows.
    entities: Vec<Entity>,
    indices: HashMap<String, usize>,
    now: Time,
}

#[derive(Default)]
struct Entity {
    path: String,
    /// Valid from the first row on.
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

    /// What a curve looks like. This goes into the first row of the curve, which saves a chunk.
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
        let index = self.indices.get(path).copied().unwrap_or_else(|| {
            self.indices.insert(path.to_owned(), self.entities.len());
            self.entities.push(Entity { path: path.to_owned(), ..Entity::default() });
            self.entities.len() - 1
        });
        &mut self.entities[index]
    }

    /// All messages, in an order that depends on the contents only.
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
    let numbers = parts!(times, Time::Pose { number, .. } => *number);
    let nanos = parts!(times, Time::Pose { nanos, .. } => *nanos);
    let iterations = parts!(times, Time::Iteration(index) => *index);
    if numbers.is_empty() {
        vec![TimeColumn::new_sequence("iteration", iterations)]
    } else {
        vec![TimeColumn::new_sequence("pose", numbers), TimeColumn::new_duration_nanos("sim_time", nanos)]
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

/// A chunk; without times it is valid at all times.
pub(super) fn chunk(
    path: EntityPath,
    times: Vec<TimeColumn>,
    columns: Vec<SerializedComponentColumn>,
) -> Result<Chunk, RecordingError> {
    let times = times.into_iter().map(|column| (*column.timeline().name(), column)).collect();
    let components: ChunkComponents = columns.into_iter().collect();
    Chunk::from_auto_row_ids(ChunkId::new(), path, times, components).map_err(RecordingError::unrecordable)
}

/// The message that introduces a store.
pub(super) fn opening(store: &StoreInfo) -> LogMsg {
    LogMsg::SetStoreInfo(SetStoreInfo { row_id: *RowId::new(), info: store.clone() })
}

pub(super) fn message(store: &StoreId, chunk: &Chunk) -> Result<LogMsg, RecordingError> {
    let message = chunk.to_arrow_msg().map_err(RecordingError::unrecordable)?;
    Ok(LogMsg::ArrowMsg(store.clone(), message))
}
