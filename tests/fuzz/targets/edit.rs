//! Texts that are valid but for a few edits, so that they get past the first check.

use std::ops::Range;

use super::choices::Choices;

/// What takes the place of a value: what is no number, or one at which things break.
const VALUES: [&str; 40] = [
    "0",
    "-0",
    "1",
    "-1",
    "1e-15",
    "1e15",
    "-1e15",
    "1e-16",
    "1.1e15",
    "5e-324",
    "1e300",
    "1.7976931348623157e308",
    "1e999",
    "nan",
    "inf",
    "-inf",
    "0.5",
    "90",
    "-90",
    "180",
    "360",
    "1e-9",
    "1e-6",
    "1000000",
    "4294967295",
    "4294967296",
    "9223372036854775807",
    "-9223372036854775808",
    "0x7f",
    "1_000",
    "true",
    "\"\"",
    "\"x\"",
    "[]",
    "{}",
    "[0, 0, 0]",
    "1979-05-27",
    "0.30000000000000004",
    "12,5",
    "é",
];
/// What takes the place of a character.
const CHARACTERS: [&str; 24] = [
    "",
    "\n",
    "\r",
    "\"",
    "'",
    "#",
    "=",
    "[",
    "]",
    "{",
    "}",
    ",",
    ";",
    "\t",
    " ",
    "<",
    ">",
    "/",
    "&",
    "-",
    "0",
    "\u{0}",
    "\u{feff}",
    "\u{1f916}",
];

/// A valid text, and where it can be edited.
pub struct Seed {
    pub text: String,
    lines: Vec<Range<usize>>,
    /// Tables of TOML with all in them; lines of other texts.
    blocks: Vec<Range<usize>>,
    /// Values behind keys, each number of a list, cells.
    values: Vec<Range<usize>>,
}

impl Seed {
    pub fn toml(text: &str) -> Self {
        let lines = lines(text);
        let mut values = Vec::new();
        let is_table = |line: &Range<usize>| text[line.clone()].starts_with('[');
        for line in lines.iter().filter(|line| !is_table(line)) {
            let content = text[line.clone()].split('#').next().unwrap_or_default();
            if let Some(equals) = content.find('=') {
                let value = line.start + equals + 1..line.start + content.len();
                values.extend(words(text, &value, &[',', '[', ']', '{', '}', '=']));
                values.push(trimmed(text, &value));
            }
        }
        let starts: Vec<usize> = lines.iter().filter(|line| is_table(line)).map(|line| line.start).collect();
        let ends = starts.iter().skip(1).copied().chain([text.len()]);
        let blocks = starts.iter().copied().zip(ends).map(|(start, end)| start..end).collect();
        Self::new(text, lines, blocks, values)
    }

    pub fn json(text: &str) -> Self {
        let lines = lines(text);
        let words = lines.iter().flat_map(|line| words(text, line, &[',', ':', '[', ']', '{', '}']));
        let values = words.filter(|word| !word.is_empty()).collect();
        Self::new(text, lines.clone(), lines, values)
    }

    pub fn xml(text: &str) -> Self {
        let mut values = Vec::new();
        let mut open = None;
        for (at, _) in text.match_indices(['"', '>', '<']) {
            let quote = text[at..].starts_with('"');
            match open {
                Some(start) if quote || text[at..].starts_with('<') => {
                    let value = start..at;
                    values.extend(words(text, &value, &[' ']));
                    values.push(value);
                    open = None;
                }
                _ => open = (quote || text[at..].starts_with('>')).then_some(at + 1),
            }
        }
        // Elements in one line, as spreadsheets have them, are edited as lines are.
        let starts: Vec<usize> = text.match_indices('<').map(|(at, _)| at).collect();
        let ends = starts.iter().skip(1).copied().chain([text.len()]);
        let blocks: Vec<_> = starts.iter().copied().zip(ends).map(|(start, end)| start..end).collect();
        Self::new(text, blocks.clone(), blocks, values)
    }

    pub fn table(text: &str) -> Self {
        let lines = lines(text);
        let values = lines.iter().flat_map(|line| words(text, line, &[',', ';', '\t', '\n'])).collect();
        Self::new(text, lines.clone(), lines, values)
    }

    fn new(
        text: &str,
        lines: Vec<Range<usize>>,
        blocks: Vec<Range<usize>>,
        values: Vec<Range<usize>>,
    ) -> Self {
        let some = |ranges: Vec<Range<usize>>| {
            if ranges.is_empty() { std::iter::once(0..text.len()).collect() } else { ranges }
        };
        Self { text: text.to_owned(), lines: some(lines), blocks: some(blocks), values: some(values) }
    }

    /// The text with each of its values replaced in turn by each of `values`.
    pub fn with_each_value_as<'a>(&'a self, values: &'a [&str]) -> impl Iterator<Item = String> + 'a {
        self.values.iter().flat_map(move |range| {
            values
                .iter()
                .map(move |value| [&self.text[..range.start], value, &self.text[range.end..]].concat())
        })
    }

    /// The text with a few edits, some of which bring in what `others` have.
    pub fn edited(&self, choices: &mut Choices<'_>, others: &[Self]) -> String {
        let mut edits: Vec<(Range<usize>, String)> = Vec::new();
        for _ in 0..choices.below(6) {
            let edit = self.edit(choices, others);
            edits.push(edit);
        }
        edits.sort_by_key(|(range, _)| (range.start, range.end));
        let (mut text, mut at) = (String::with_capacity(self.text.len() + 256), 0);
        for (range, with) in edits.iter().filter(|(range, _)| range.start <= range.end) {
            // Of edits that overlap, the first one is made.
            if range.start >= at {
                text += &self.text[at..range.start];
                text += with;
                at = range.end;
            }
        }
        text + &self.text[at..]
    }

    fn edit(&self, choices: &mut Choices<'_>, others: &[Self]) -> (Range<usize>, String) {
        let of = |seed: &Self, range: &Range<usize>| seed.text[range.clone()].to_owned();
        let kind = choices.below(16);
        match kind {
            0..=5 => (choices.pick(&self.values).clone(), (*choices.pick(&VALUES)).to_owned()),
            6 | 7 => (choices.pick(&self.values).clone(), choices.number().to_string()),
            8 => {
                let (range, value) = (choices.pick(&self.values).clone(), choices.pick(&self.values));
                (range, of(self, value))
            }
            9 => (choices.pick(&self.lines).clone(), String::new()),
            10 => (choices.pick(&self.blocks).clone(), String::new()),
            11 | 12 => {
                let end = choices.pick(&self.lines).end;
                let other = choices.pick(others);
                (end..end, of(other, choices.pick(&other.lines)))
            }
            13 | 14 => {
                let end = choices.pick(&self.blocks).end;
                let other = if kind == 13 { self } else { choices.pick(others) };
                (end..end, of(other, choices.pick(&other.blocks)))
            }
            _ => {
                let line = choices.pick(&self.lines).clone();
                let characters: Vec<usize> =
                    self.text[line.clone()].char_indices().map(|(at, _)| at).collect();
                let at = line.start + if characters.is_empty() { 0 } else { *choices.pick(&characters) };
                let length = self.text[at..].chars().next().map_or(0, char::len_utf8);
                (at..at + length, (*choices.pick(&CHARACTERS)).to_owned())
            }
        }
    }
}

/// One input in eight is the text itself; the others are edits of a seed.
pub fn text(choices: &mut Choices<'_>, seeds: &[Seed]) -> String {
    if choices.below(8) == 7 {
        let data = std::mem::replace(choices, Choices::new(&[])).rest();
        return String::from_utf8_lossy(data).into_owned();
    }
    choices.pick(seeds).edited(choices, seeds)
}

fn lines(text: &str) -> Vec<Range<usize>> {
    let mut at = 0;
    text.split_inclusive('\n')
        .map(|line| {
            at += line.len();
            at - line.len()..at
        })
        .collect()
}

fn trimmed(text: &str, range: &Range<usize>) -> Range<usize> {
    let content = &text[range.clone()];
    let start = range.start + content.len() - content.trim_start().len();
    start..start.max(range.start + content.trim_end().len())
}

/// What stands between the separators.
fn words(text: &str, range: &Range<usize>, separators: &[char]) -> Vec<Range<usize>> {
    let mut at = range.start;
    let word = |part: &str| {
        let word = trimmed(text, &(at..at + part.len()));
        at += part.len() + 1;
        word
    };
    text[range.clone()].split(separators).map(word).collect()
}
