//! Any URDF as a tree of links and joints; elements that are not needed are counted and ignored.
//!
//! Values are read when the chain needs them, so that a mistake in an unused branch does no harm.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::ops::Range;

use roxmltree::{Document, Error as XmlError, Node, ParsingOptions};

use super::element::Element;
use crate::input::{InputError, Source};

/// More elements than any robot has: a larger file is refused before it uses up the memory.
const MOST_NODES: u32 = 5_000_000;

/// What is read of a joint.
const READ_OF_JOINTS: [&str; 6] = ["parent", "child", "origin", "axis", "limit", "mimic"];

/// A link with the elements that describe its mass.
#[derive(Debug, Clone)]
pub(super) struct Link {
    pub name: String,
    pub span: Range<usize>,
    pub inertial: Option<Element>,
}

/// A joint with the elements that describe its motion.
#[derive(Debug, Clone)]
pub(super) struct Joint {
    pub name: String,
    pub kind: String,
    pub parent: usize,
    pub child: usize,
    pub span: Range<usize>,
    pub origin: Option<Element>,
    pub axis: Option<Element>,
    pub limit: Option<Element>,
    pub mimic: Option<Element>,
}

/// The links and joints of a URDF.
#[derive(Debug, Clone)]
pub(super) struct Tree {
    pub name: String,
    pub links: Vec<Link>,
    pub joints: Vec<Joint>,
    /// For every link, the joint whose child it is; none for a root.
    pub above: Vec<Option<usize>>,
    pub passed_over: PassedOver,
    pub span: Range<usize>,
}

/// Counts of ignored elements.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct PassedOver(BTreeMap<String, usize>);

impl fmt::Display for PassedOver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_empty() {
            return f.write_str("ignored: nothing");
        }
        let counts: Vec<_> = self.0.iter().map(|(name, count)| format!("{count} <{name}>")).collect();
        write!(f, "ignored: {}", counts.join(", "))
    }
}

impl PassedOver {
    fn add(&mut self, name: &str) {
        *self.0.entry(name.to_owned()).or_default() += 1;
    }

    fn add_unread(&mut self, node: &Node<'_, '_>, read: &[&str]) {
        for child in node.children().filter(Node::is_element) {
            if !read.contains(&local(&child)) || child.tag_name().namespace().is_some() {
                self.add(&qualified(&child));
            }
        }
    }
}

/// What an element is called, without its prefix.
fn local<'a>(node: &Node<'a, '_>) -> &'a str {
    node.tag_name().name()
}

/// The name as the text has it, with its prefix.
fn qualified(node: &Node<'_, '_>) -> String {
    let text = node.document().input_text();
    let start = node.range().start + 1;
    let rest = text.get(start..).unwrap_or_default();
    rest.split(|c: char| c.is_whitespace() || c == '>' || c == '/').next().unwrap_or_default().to_owned()
}

/// The start tag of an element, in the text as it was parsed.
fn tag(node: &Node<'_, '_>) -> Range<usize> {
    let range = node.range();
    let text = node.document().input_text().get(range.clone()).unwrap_or_default();
    let length = text.find('>').map_or(text.len(), |at| at + 1);
    range.start..range.start + length
}

impl Tree {
    /// Reads a URDF; every refusal points into `source`.
    pub fn read(source: &Source) -> Result<Self, InputError> {
        let (text, changed) = with_namespaces(source)?;
        let document = Document::parse_with_options(&text, options())
            .map_err(|error| refusal(source, changed.lead, &error))?;
        Reader { source, changed }.tree(&document)
    }

    /// Index of the link of that name.
    pub fn link(&self, name: &str) -> Option<usize> {
        self.links.iter().position(|link| link.name == name)
    }
}

/// How the parsed text differs from the file's: what was left out in front of it, and what was added to the root's tag.
#[derive(Debug, Clone, Copy)]
struct Changed {
    lead: usize,
    at: usize,
    inserted: usize,
}

/// The text without what some editors put in front, and with a declaration for every prefix that it uses without one, as vendors' files do
/// with extensions.
fn with_namespaces(source: &Source) -> Result<(String, Changed), InputError> {
    let mut text = source.text.trim_start_matches(|c: char| c.is_whitespace() || c == '\u{feff}').to_owned();
    let mut changed = Changed { lead: source.text.len() - text.len(), at: text.len(), inserted: 0 };
    for _ in 0..100 {
        match Document::parse_with_options(&text, options()) {
            Err(XmlError::UnknownNamespace(prefix, _)) if prefix == "xacro" => {
                return Err(xacro(source, source.text.find("xacro:").unwrap_or(0)));
            }
            Err(XmlError::UnknownNamespace(prefix, _)) => {
                let Some(at) = root_tag_end(&text) else { break };
                let declaration = format!(" xmlns:{prefix}=\"{prefix}\"");
                text.insert_str(at, &declaration);
                changed = Changed { at, inserted: changed.inserted + declaration.len(), ..changed };
            }
            _ => break,
        }
    }
    Ok((text, changed))
}

fn options<'a>() -> ParsingOptions<'a> {
    ParsingOptions { allow_dtd: true, nodes_limit: MOST_NODES, ..ParsingOptions::default() }
}

/// Just behind `<robot`.
fn root_tag_end(text: &str) -> Option<usize> {
    Some(text.find("<robot")? + "<robot".len())
}

fn xacro(source: &Source, at: usize) -> InputError {
    let output = match source.name.strip_suffix(".xacro") {
        Some(name) => format!("{}.urdf", name.trim_end_matches(".urdf")),
        // Not overwriting the file itself.
        None => format!("{}.expanded.urdf", source.name.trim_end_matches(".urdf")),
    };
    source.error(
        at..at + 1,
        "this is xacro source, not a URDF: xacro macros are not expanded here",
        Some(format!(
            "expected a URDF: run `xacro {} > {output}` (ROS 2: `ros2 run xacro xacro ...`) with the arguments of the robot's \
             package, and pass {output}",
            source.name
        )),
    )
}

fn refusal(source: &Source, lead: usize, error: &XmlError) -> InputError {
    let position = error.pos();
    let text = &source.text[lead..];
    let lines = text.split_inclusive('\n').take(position.row.saturating_sub(1) as usize);
    let start: usize = lines.map(str::len).sum();
    let line = text.get(start..).unwrap_or_default();
    let column =
        line.chars().take(position.col.saturating_sub(1) as usize).map(char::len_utf8).sum::<usize>();
    let at = lead + start + column;
    let said = error.to_string();
    // This message names the line.
    let said = said.split(" at ").next().unwrap_or_default().replace('\n', "the end of the line");
    source.error(at..at + 1, format!("not valid XML: {said}"), Some("expected a URDF".to_owned()))
}

struct Reader<'a> {
    source: &'a Source,
    changed: Changed,
}

impl Reader<'_> {
    /// The place in the file of a place in the parsed text.
    fn place(&self, range: Range<usize>) -> Range<usize> {
        let Changed { lead, at, inserted } = self.changed;
        let back = |place: usize| lead + if place > at { place - inserted } else { place };
        back(range.start)..back(range.end)
    }

    fn error<T>(
        &self,
        span: Range<usize>,
        message: impl fmt::Display,
        expected: &str,
    ) -> Result<T, InputError> {
        Err(self.source.error(span, message, Some(format!("expected {expected}"))))
    }

    fn tree(&self, document: &Document<'_>) -> Result<Tree, InputError> {
        let root = document.root_element();
        let span = self.place(tag(&root));
        if let Some(node) = document.descendants().find(is_xacro) {
            return Err(xacro(self.source, self.place(tag(&node)).start));
        }
        if local(&root) != "robot" {
            let message = format!("the root element is <{}>", qualified(&root));
            return self.error(span, message, "a URDF, whose root element is <robot>");
        }
        let mut passed_over = PassedOver::default();
        passed_over.add_unread(&root, &["link", "joint"]);
        let of = |name: &'static str| {
            let is = move |node: &Node<'_, '_>| node.is_element() && node.tag_name().name() == name;
            root.children().filter(move |node| is(node) && node.tag_name().namespace().is_none())
        };
        let mut links: Vec<Link> = Vec::new();
        let mut by_name = BTreeMap::new();
        for node in of("link") {
            passed_over.add_unread(&node, &["inertial"]);
            let name = self.required(&node, "name")?;
            let span = self.place(tag(&node));
            if by_name.insert(name.clone(), links.len()).is_some() {
                return self.error(
                    span,
                    format!("a second link named {name}"),
                    "a different name for each link",
                );
            }
            self.check_single(&node, &format!("link {name}"), &["inertial"])?;
            let inertial = child(&node, "inertial");
            if let Some(inertial) = &inertial {
                self.check_single(
                    inertial,
                    &format!("the <inertial> of link {name}"),
                    &["origin", "mass", "inertia"],
                )?;
            }
            let inertial = inertial.map(|node| self.element(&node));
            links.push(Link { name, span, inertial });
        }
        let mut joints: Vec<Joint> = Vec::new();
        let mut joint_names = BTreeSet::new();
        let mut above: Vec<Option<usize>> = vec![None; links.len()];
        for node in of("joint") {
            passed_over.add_unread(&node, &READ_OF_JOINTS);
            let joint = self.joint(&node, &by_name)?;
            if !joint_names.insert(joint.name.clone()) {
                let message = format!("a second joint named {}", joint.name);
                return self.error(joint.span, message, "a different name for each joint");
            }
            if let Some(other) = above[joint.child].replace(joints.len()) {
                let message = format!(
                    "joint {} has the child link {}, which is already the child of joint {}",
                    joint.name, links[joint.child].name, joints[other].name
                );
                return self.error(
                    joint.span,
                    message,
                    "one parent joint per link: a URDF cannot hold loops",
                );
            }
            joints.push(joint);
        }
        let name = root
            .attribute("name")
            .map(str::trim)
            .filter(|name| !name.is_empty())
            .unwrap_or("robot")
            .to_owned();
        Ok(Tree { name, links, joints, above, passed_over, span })
    }

    /// Refuses a second element of a name, of which only the first would be read.
    fn check_single(&self, node: &Node<'_, '_>, of: &str, names: &[&str]) -> Result<(), InputError> {
        let second =
            |name: &&str| node.children().filter(|child| child.is_element() && local(child) == *name).nth(1);
        match names.iter().find_map(second) {
            Some(second) => self.error(
                self.place(tag(&second)),
                format!("{of} has more than one <{}>", local(&second)),
                "only one",
            ),
            None => Ok(()),
        }
    }

    fn joint(&self, node: &Node<'_, '_>, links: &BTreeMap<String, usize>) -> Result<Joint, InputError> {
        let (name, kind) = (self.required(node, "name")?, self.required(node, "type")?);
        self.check_single(node, &format!("joint {name}"), &READ_OF_JOINTS)?;
        let end = |role: &str| {
            let Some(at) = child(node, role) else {
                let message = format!("joint {name} has no <{role}>");
                return self.error(self.place(tag(node)), message, &format!("<{role} link=\"...\"/>"));
            };
            let link = self.required(&at, "link")?;
            match links.get(&link) {
                Some(index) => Ok(*index),
                None => {
                    let message = format!("joint {name} names a link {link} that does not exist");
                    self.error(self.place(tag(&at)), message, "the name of a link")
                }
            }
        };
        let (parent, carried) = (end("parent")?, end("child")?);
        let element = |what: &str| child(node, what).map(|node| self.element(&node));
        Ok(Joint {
            parent,
            child: carried,
            span: self.place(tag(node)),
            origin: element("origin"),
            axis: element("axis"),
            limit: element("limit"),
            mimic: element("mimic"),
            name,
            kind,
        })
    }

    fn required(&self, node: &Node<'_, '_>, attribute: &str) -> Result<String, InputError> {
        match node.attribute(attribute).map(str::trim) {
            Some(value) if !value.is_empty() => Ok(value.to_owned()),
            _ => self.error(
                self.place(tag(node)),
                format!("<{}> has no {attribute}", local(node)),
                &format!("{attribute}=\"...\""),
            ),
        }
    }

    fn element(&self, node: &Node<'_, '_>) -> Element {
        let attributes = node.attributes().map(|attribute| {
            (attribute.name().to_owned(), attribute.value().to_owned(), self.place(attribute.range_value()))
        });
        Element {
            name: local(node).to_owned(),
            span: self.place(tag(node)),
            attributes: attributes.collect(),
            children: node.children().filter(Node::is_element).map(|node| self.element(&node)).collect(),
        }
    }
}

fn child<'a, 'i>(node: &Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    node.children().find(|node| node.is_element() && local(node) == name)
}

/// A macro or its use, or a value that is still to be computed.
fn is_xacro(node: &Node<'_, '_>) -> bool {
    let is_macro = node.tag_name().namespace().is_some_and(|space| space.contains("xacro"));
    let is_open = |value: &str| value.contains("${") || value.contains("$(");
    let robot =
        ["robot", "link", "joint", "origin", "axis", "limit", "parent", "child", "mass", "inertia", "mimic"];
    node.is_element()
        && (is_macro || robot.contains(&local(node)) && node.attributes().any(|a| is_open(a.value())))
}
