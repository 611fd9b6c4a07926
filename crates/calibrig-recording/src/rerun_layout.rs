//! How a Rerun recording is laid out on the screen: views, in groups.

use rerun::blueprint::components::{ContainerKind, PanelState, PlayState};
use rerun::external::re_log_types::BlueprintActivationCommand;
use rerun::external::re_sdk_types::blueprint::archetypes::{
    ContainerBlueprint, PanelBlueprint, TimePanelBlueprint, ViewBlueprint, ViewContents, ViewportBlueprint,
};
use rerun::external::re_sdk_types::datatypes::Uuid;
use rerun::log::{LogMsg, TimeColumn};
use rerun::{AsComponents, EntityPath, RecordingStreamBuilder, SerializedComponentBatch, StoreId};

use super::RecordingError;
use super::rerun_columns::{chunk, message, opening, whole};
use super::rerun_entities::APPLICATION;

/// Speed of the viewer's playback.
const POSES_PER_SECOND: f64 = 4.0;

/// Whether a layout is only for viewers that have none, or replaces the present one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Force {
    Default,
    Active,
}

/// A view, or what holds several.
pub(super) enum Node {
    View(View),
    Container(Container),
}

/// Something to look at.
pub(super) struct View {
    class: &'static str,
    name: String,
    origin: String,
    contents: Vec<String>,
    /// Its properties: name and values.
    properties: Vec<(String, Vec<SerializedComponentBatch>)>,
}

/// Views and groups side by side, one upon the other, in a grid or in tabs.
pub(super) struct Container {
    kind: ContainerKind,
    name: Option<String>,
    /// Shares of the width or the height.
    shares: Vec<f32>,
    columns: Option<u32>,
    contents: Vec<Node>,
}

impl View {
    /// Shows `origin` and what lies under it, as Rerun's views of class `class` do.
    pub(super) fn new(class: &'static str, name: impl Into<String>, origin: impl Into<String>) -> Self {
        let contents = vec!["$origin/**".to_owned()];
        Self { class, name: name.into(), origin: origin.into(), contents, properties: Vec::new() }
    }

    /// Shows something else.
    pub(super) fn with_contents(mut self, contents: impl IntoIterator<Item = String>) -> Self {
        self.contents = contents.into_iter().collect();
        self
    }

    pub(super) fn set(mut self, name: impl Into<String>, value: &impl AsComponents) -> Self {
        self.properties.push((name.into(), value.as_serialized_batches()));
        self
    }
}

impl Container {
    pub(super) fn new(kind: ContainerKind, contents: impl IntoIterator<Item = Node>) -> Self {
        let contents = contents.into_iter().collect();
        Self { kind, name: None, shares: Vec::new(), columns: None, contents }
    }

    pub(super) fn named(self, name: impl Into<String>) -> Self {
        Self { name: Some(name.into()), ..self }
    }

    pub(super) fn shared(self, shares: [f32; 2]) -> Self {
        Self { shares: shares.to_vec(), ..self }
    }

    pub(super) fn in_columns(self, columns: u32) -> Self {
        Self { columns: Some(columns), ..self }
    }
}

impl From<View> for Node {
    fn from(view: View) -> Self {
        Self::View(view)
    }
}

impl From<Container> for Node {
    fn from(container: Container) -> Self {
        Self::Container(container)
    }
}

/// The messages of a layout. They are told before the recording.
pub(super) fn messages(root: &Container, force: Force) -> Result<Vec<LogMsg>, RecordingError> {
    let (_, store, ..) = RecordingStreamBuilder::new(APPLICATION).blueprint().into_args();
    let mut plan = Plan { messages: vec![opening(&store)], store: store.store_id, places: 0 };
    let (_, root) = plan.container(root)?;
    plan.put("viewport", &ViewportBlueprint::new().with_root_container(root).with_auto_views(false))?;
    let collapsed = PanelState::Collapsed;
    for panel in ["blueprint_panel", "selection_panel"] {
        plan.put(panel, &PanelBlueprint::new().with_state(collapsed))?;
    }
    let mut time =
        TimePanelBlueprint::new().with_state(collapsed).with_timeline("pose").with_fps(POSES_PER_SECOND);
    if force == Force::Active {
        // A live view follows the newest pose.
        time = time.with_play_state(PlayState::Following);
    }
    plan.put("time_panel", &time)?;
    // The last message activates the layout.
    plan.messages.push(LogMsg::BlueprintActivationCommand(BlueprintActivationCommand {
        blueprint_id: plan.store,
        make_active: force == Force::Active,
        make_default: true,
    }));
    Ok(plan.messages)
}

/// A layout while it is turned into messages.
struct Plan {
    store: StoreId,
    messages: Vec<LogMsg>,
    /// Views and groups so far.
    places: u128,
}

impl Plan {
    fn put(&mut self, path: &str, value: &impl AsComponents) -> Result<(), RecordingError> {
        self.put_all(path, value.as_serialized_batches())
    }

    fn put_all(&mut self, path: &str, values: Vec<SerializedComponentBatch>) -> Result<(), RecordingError> {
        // The timeline on which viewers expect layouts.
        let time = TimeColumn::new_sequence("blueprint", [0_i64]);
        let chunk = chunk(EntityPath::from(path), vec![time], whole(values))?;
        self.messages.push(message(&self.store, &chunk)?);
        Ok(())
    }

    /// A new path under `root`, and its identity.
    fn place(&mut self, root: &str) -> (String, Uuid) {
        self.places += 1;
        let bytes = self.places.to_be_bytes();
        let digits = format!("{:032x}", self.places);
        let parts = [0..8, 8..12, 12..16, 16..20, 20..32].map(|part| &digits[part]);
        (format!("/{root}/{}", parts.join("-")), Uuid { bytes })
    }

    fn node(&mut self, node: &Node) -> Result<String, RecordingError> {
        match node {
            Node::View(view) => self.view(view),
            Node::Container(container) => self.container(container).map(|(path, _)| path),
        }
    }

    fn view(&mut self, view: &View) -> Result<String, RecordingError> {
        let (path, _) = self.place("view");
        let looks = ViewBlueprint::new(view.class)
            .with_display_name(view.name.as_str())
            .with_space_origin(format!("/{}", view.origin));
        self.put(&path, &looks)?;
        let contents = view.contents.iter().map(String::as_str);
        self.put(&format!("{path}/ViewContents"), &ViewContents::new(contents))?;
        for (name, values) in &view.properties {
            self.put_all(&format!("{path}/{name}"), values.clone())?;
        }
        Ok(path)
    }

    fn container(&mut self, container: &Container) -> Result<(String, Uuid), RecordingError> {
        let mut contents = Vec::with_capacity(container.contents.len());
        for node in &container.contents {
            contents.push(self.node(node)?);
        }
        let mut looks = ContainerBlueprint::new(container.kind);
        if let Some(name) = &container.name {
            looks = looks.with_display_name(name.as_str());
        }
        if !contents.is_empty() {
            looks = looks.with_contents(contents);
        }
        if !container.shares.is_empty() {
            let shares = container.shares.iter().copied();
            looks = match container.kind {
                ContainerKind::Vertical => looks.with_row_shares(shares),
                _ => looks.with_col_shares(shares),
            };
        }
        if let Some(columns) = container.columns {
            looks = looks.with_grid_columns(columns);
        }
        let (path, id) = self.place("container");
        self.put(&path, &looks)?;
        Ok((path, id))
    }
}
