//! A strict first pass over the text of a URDF: which elements are where, and whether each is supported.
//!
//! The URDF parser skips unknown elements, drops words from lists of numbers and gives no positions; this pass refuses the
//! first two and supplies the third.

use std::ops::Range;

use crate::input::{InputError, Source};

/// An element's start tag.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Element<'a> {
    pub name: &'a str,
    pub parent: Option<usize>,
    pub attributes: Vec<(&'a str, &'a str)>,
    /// Of the start tag, bytes.
    pub span: Range<usize>,
}

/// What an attribute holds.
#[derive(Debug, Clone, Copy)]
enum Content {
    Text,
    Numbers(usize),
    /// The type of a joint.
    Type,
}
use Content::{Numbers, Text, Type};

/// Types of joints that URDF has.
const TYPES: [&str; 6] = ["revolute", "continuous", "prismatic", "fixed", "floating", "planar"];

/// Element, the elements it may stand in, its attributes.
type Rule = (&'static str, &'static [&'static str], &'static [(&'static str, Content)]);

const RULES: &[Rule] = &[
    ("robot", &[""], &[("name", Text), ("version", Text)]),
    ("link", &["robot"], &[("name", Text)]),
    ("joint", &["robot"], &[("name", Text), ("type", Type)]),
    ("material", &["robot", "visual"], &[("name", Text)]),
    ("color", &["material"], &[("rgba", Numbers(4))]),
    ("inertial", &["link"], &[]),
    ("visual", &["link"], &[("name", Text)]),
    ("collision", &["link"], &[("name", Text)]),
    ("origin", &["inertial", "visual", "collision", "joint"], &[("xyz", Numbers(3)), ("rpy", Numbers(3))]),
    ("mass", &["inertial"], &[("value", Numbers(1))]),
    (
        "inertia",
        &["inertial"],
        &[
            ("ixx", Numbers(1)),
            ("ixy", Numbers(1)),
            ("ixz", Numbers(1)),
            ("iyy", Numbers(1)),
            ("iyz", Numbers(1)),
            ("izz", Numbers(1)),
        ],
    ),
    // The robot's file states which joint follows another one.
    ("mimic", &["joint"], &[("joint", Text), ("multiplier", Numbers(1)), ("offset", Numbers(1))]),
    ("geometry", &["visual", "collision"], &[]),
    ("box", &["geometry"], &[("size", Numbers(3))]),
    ("cylinder", &["geometry"], &[("radius", Numbers(1)), ("length", Numbers(1))]),
    ("sphere", &["geometry"], &[("radius", Numbers(1))]),
    ("parent", &["joint"], &[("link", Text)]),
    ("child", &["joint"], &[("link", Text)]),
    ("axis", &["joint"], &[("xyz", Numbers(3))]),
    (
        "limit",
        &["joint"],
        &[("lower", Numbers(1)), ("upper", Numbers(1)), ("effort", Numbers(1)), ("velocity", Numbers(1))],
    ),
    ("dynamics", &["joint"], &[("damping", Numbers(1)), ("friction", Numbers(1))]),
];

/// Element, its required attributes, and its required elements.
const REQUIRED: &[(&str, &[&str], &[&str])] = &[
    ("robot", &["name"], &[]),
    ("link", &["name"], &[]),
    ("joint", &["name", "type"], &["parent", "child"]),
    ("material", &["name"], &[]),
    ("color", &["rgba"], &[]),
    ("inertial", &[], &["mass", "inertia"]),
    ("mass", &["value"], &[]),
    ("inertia", &["ixx", "ixy", "ixz", "iyy", "iyz", "izz"], &[]),
    ("visual", &[], &["geometry"]),
    ("collision", &[], &["geometry"]),
    ("box", &["size"], &[]),
    ("cylinder", &["radius", "length"], &[]),
    ("sphere", &["radius"], &[]),
    ("parent", &["link"], &[]),
    ("child", &["link"], &[]),
    ("axis", &["xyz"], &[]),
    ("limit", &["lower", "upper", "velocity"], &[]),
];

/// Elements that may occur more than once in the same one.
const REPEATED: &[&str] = &["link", "joint", "material", "visual", "collision"];

/// The elements in the order of their start tags; an error for anything unsupported.
pub(super) fn scan(source: &Source) -> Result<Vec<Element<'_>>, InputError> {
    let mut scanner = Scanner { source, at: 0, elements: Vec::new(), open: Vec::new() };
    while scanner.next_markup()? {}
    if let Some(&index) = scanner.open.last() {
        let element = &scanner.elements[index];
        return Err(scanner.error(element.span.clone(), format!("<{}> is not closed", element.name)));
    }
    if scanner.elements.is_empty() {
        return Err(scanner.error(0..0, "there is no <robot> element"));
    }
    scanner.check_complete()?;
    Ok(scanner.elements)
}

struct Scanner<'a> {
    source: &'a Source,
    at: usize,
    elements: Vec<Element<'a>>,
    open: Vec<usize>,
}

impl<'a> Scanner<'a> {
    fn error(&self, span: Range<usize>, message: impl std::fmt::Display) -> InputError {
        self.source.error(span, message, Some("expected a URDF".to_owned()))
    }

    fn rest(&self) -> &'a str {
        &self.source.text[self.at..]
    }

    /// Goes past the next comment, instruction or tag; false at the end of the text.
    fn next_markup(&mut self) -> Result<bool, InputError> {
        let rest = self.rest();
        let text = rest.split('<').next().unwrap_or(rest);
        let stray = text.trim_matches(|c: char| c.is_whitespace() || c == '\u{feff}');
        if !stray.is_empty() {
            let start = self.at + text.find(stray).unwrap_or(0);
            return Err(self.error(start..start + stray.len(), "text outside any tag"));
        }
        self.at += text.len();
        let rest = self.rest();
        if rest.is_empty() {
            return Ok(false);
        }
        if rest.starts_with("<!--") {
            self.skip_behind("-->", "the comment is not closed")?;
        } else if rest.starts_with("<?") {
            self.skip_behind("?>", "the processing instruction is not closed")?;
        } else if rest.starts_with("<!") {
            return Err(self.error(self.at..self.at + 2, "only elements and comments are supported"));
        } else if rest.starts_with("</") {
            self.end_tag()?;
        } else {
            self.start_tag()?;
        }
        Ok(true)
    }

    fn skip_behind(&mut self, mark: &str, message: &str) -> Result<(), InputError> {
        match self.rest().find(mark) {
            Some(offset) => {
                self.at += offset + mark.len();
                Ok(())
            }
            None => Err(self.error(self.at..self.source.text.len(), message)),
        }
    }

    fn end_tag(&mut self) -> Result<(), InputError> {
        let start = self.at;
        self.skip_behind(">", "the tag is not closed")?;
        let name = self.source.text[start + 2..self.at - 1].trim_end();
        match self.open.pop() {
            Some(index) if self.elements[index].name == name => Ok(()),
            Some(index) => {
                let message = format!("</{name}> closes <{}>", self.elements[index].name);
                Err(self.error(start..self.at, message))
            }
            None => Err(self.error(start..self.at, format!("</{name}> closes no open element"))),
        }
    }

    fn start_tag(&mut self) -> Result<(), InputError> {
        let start = self.at;
        self.at += 1;
        let name = self.word();
        let parent = self.open.last().copied();
        let parent_name = parent.map_or("", |index| self.elements[index].name);
        if parent.is_none() && !self.elements.is_empty() {
            return Err(self.error(start..self.at, "a second element next to <robot>"));
        }
        let rule = RULES.iter().find(|(rule, parents, _)| *rule == name && parents.contains(&parent_name));
        let Some((_, _, allowed)) = rule else {
            return Err(self.unknown_element(start..self.at, name, parent_name));
        };
        let mut attributes = Vec::new();
        let closed = loop {
            self.skip_blanks();
            let rest = self.rest();
            if rest.starts_with("/>") {
                self.at += 2;
                break true;
            }
            if rest.starts_with('>') {
                self.at += 1;
                break false;
            }
            attributes.push(self.attribute(name, allowed, &attributes)?);
        };
        if !closed {
            self.open.push(self.elements.len());
        }
        self.elements.push(Element { name, parent, attributes, span: start..self.at });
        Ok(())
    }

    /// Required items are there exactly once. The URDF parser would complain without a place.
    fn check_complete(&self) -> Result<(), InputError> {
        for (index, element) in self.elements.iter().enumerate() {
            let name = element.name;
            let refused = |span: &Range<usize>, message: String, expected: String| {
                Err(self.source.error(span.clone(), message, Some(format!("expected {expected}"))))
            };
            let is_same = |other: &Element<'_>| other.parent == element.parent && other.name == name;
            if element.parent.is_some()
                && !REPEATED.contains(&name)
                && self.elements[..index].iter().any(is_same)
            {
                return refused(&element.span, format!("a second <{name}>"), "only one".to_owned());
            }
            let Some((_, attributes, children)) = REQUIRED.iter().find(|(required, ..)| *required == name)
            else {
                continue;
            };
            if let Some(missing) = attributes.iter().find(|a| element.attributes.iter().all(|(b, _)| b != *a))
            {
                return refused(
                    &element.span,
                    format!("<{name}> has no {missing}"),
                    format!("{missing}=\"...\""),
                );
            }
            let has =
                |child: &&&str| self.elements.iter().any(|e| e.parent == Some(index) && e.name == **child);
            if let Some(missing) = children.iter().find(|child| !has(child)) {
                return refused(
                    &element.span,
                    format!("<{name}> has no <{missing}>"),
                    format!("<{missing} .../>"),
                );
            }
        }
        Ok(())
    }

    fn unknown_element(&self, span: Range<usize>, name: &str, parent: &str) -> InputError {
        let known: Vec<_> = RULES.iter().filter(|(_, parents, _)| parents.contains(&parent)).collect();
        let place = if parent.is_empty() { "at the top".to_owned() } else { format!("in <{parent}>") };
        let expected = if known.is_empty() {
            "nothing".to_owned()
        } else {
            known.iter().map(|(name, ..)| format!("<{name}>")).collect::<Vec<_>>().join(", ")
        };
        self.source.error(
            span,
            format!("unknown element <{name}> {place}"),
            Some(format!("expected {expected}")),
        )
    }

    fn attribute(
        &mut self,
        element: &str,
        allowed: &[(&str, Content)],
        attributes: &[(&str, &str)],
    ) -> Result<(&'a str, &'a str), InputError> {
        let start = self.at;
        let name = self.word();
        self.skip_blanks();
        if name.is_empty() || !self.rest().starts_with('=') {
            let span = start..start + name.len();
            return Err(self.error(span, format!("<{element}> is not closed, or an attribute has no value")));
        }
        self.at += 1;
        self.skip_blanks();
        let Some(quote) = self.rest().chars().next().filter(|c| matches!(c, '"' | '\'')) else {
            return Err(self.error(start..self.at, format!("the value of {name} is not in quotes")));
        };
        let value_start = self.at + 1;
        self.at = value_start;
        let Some(length) = self.rest().find(quote) else {
            return Err(
                self.error(value_start..self.source.text.len(), format!("the value of {name} does not end"))
            );
        };
        let value = &self.rest()[..length];
        self.at += length + 1;
        let span = value_start..value_start + length;
        if attributes.iter().any(|(known, _)| *known == name) {
            let message = format!("a second {name} of <{element}>");
            return Err(self.source.error(
                start..self.at,
                message,
                Some("expected only one of them".to_owned()),
            ));
        }
        let Some((_, content)) = allowed.iter().find(|(allowed, _)| *allowed == name) else {
            let names: Vec<_> = allowed.iter().map(|(name, _)| *name).collect();
            let expected = if names.is_empty() { "no attribute".to_owned() } else { names.join(", ") };
            let message = format!("unknown attribute {name} of <{element}>");
            return Err(self.source.error(start..self.at, message, Some(format!("expected {expected}"))));
        };
        match content {
            Text if value.trim().is_empty() || value.contains(['<', '&']) => Err(self.source.error(
                span,
                format!("{name} of <{element}> is {value:?}"),
                Some("expected a name".to_owned()),
            )),
            Numbers(count) if !are_numbers(value, *count) => {
                let expected = match count {
                    1 => "expected a finite number".to_owned(),
                    _ => format!("expected {count} finite numbers separated by blanks"),
                };
                Err(self.source.error(span, format!("{name} of <{element}> is {value:?}"), Some(expected)))
            }
            Type if !TYPES.contains(&value) => Err(self.source.error(
                span,
                format!("{name} of <{element}> is {value:?}"),
                Some("expected revolute, prismatic or fixed".to_owned()),
            )),
            _ => Ok((name, value)),
        }
    }

    /// The characters up to the next blank or mark.
    fn word(&mut self) -> &'a str {
        let rest = self.rest();
        let length = rest.find(|c: char| c.is_whitespace() || "=/><\"'".contains(c)).unwrap_or(rest.len());
        self.at += length;
        &rest[..length]
    }

    fn skip_blanks(&mut self) {
        let rest = self.rest();
        self.at += rest.len() - rest.trim_start().len();
    }
}

fn are_numbers(text: &str, count: usize) -> bool {
    let finite = |word: &str| word.parse::<f64>().is_ok_and(f64::is_finite);
    text.split_whitespace().count() == count && text.split_whitespace().all(finite)
}
