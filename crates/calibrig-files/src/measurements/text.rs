//! Text as rows: lines are read one by one, whatever the file's size, decoded, and cut into cells.

use std::collections::{HashMap, VecDeque};
use std::fs::File;
use std::io::{self, BufRead, BufReader, Cursor, Read};
use std::path::Path;

use super::cells::{Delimiter, QuoteError, split};
use super::layout::{Decimal, Wanted};
use super::rows::{Row, Rows};
use crate::input::{Excerpt, InputError, latin};

/// The form of a text; unknown parts are found from its first lines.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct TextFormat {
    pub delimiter: Option<Delimiter>,
    /// Starts of comment lines, in addition to `#` and `//`.
    pub comments: Vec<String>,
    /// Lines at the start that are skipped, whatever they hold.
    pub skipped_lines: u64,
}

/// Lines that are read before the first row is given.
const SAMPLE: usize = 300;
const SAMPLE_BYTES: usize = 1 << 18;
/// A longer line means that the file holds no rows.
const LONGEST_LINE: u64 = 1 << 20;
/// A quoted cell with more line breaks has a quote that was not closed.
const MOST_LINES_OF_A_ROW: usize = 100;
/// Comments that are kept.
const MOST_COMMENTS: usize = 50;

/// A text file as rows.
pub(super) struct TextRows {
    name: String,
    lines: Lines,
    delimiter: Delimiter,
    format: TextFormat,
    /// Read already, and not yet given.
    sample: VecDeque<(u64, String)>,
    /// A comment that holds the names of the columns.
    header: Option<u64>,
    comments: Vec<(u64, String)>,
    line: String,
}

impl TextRows {
    /// Opens a file, whose columns `wanted` are looked for.
    pub fn open(path: &Path, format: &TextFormat, wanted: &Wanted) -> Result<Self, InputError> {
        let unreadable = |reason: String| InputError::Unreadable { path: path.to_path_buf(), reason };
        if path.is_dir() {
            return Err(unreadable("it is a folder; expected a file".to_owned()));
        }
        let file = File::open(path).map_err(|error| unreadable(error.to_string()))?;
        let name = path.display().to_string();
        Self::new(name, Box::new(BufReader::with_capacity(1 << 16, file)), format, wanted)
    }

    /// The same of a text in memory.
    pub fn of_text(name: &str, text: &str, format: &TextFormat, wanted: &Wanted) -> Result<Self, InputError> {
        let bytes = Cursor::new(text.to_owned().into_bytes());
        Self::new(name.to_owned(), Box::new(bytes), format, wanted)
    }

    fn new(
        name: String,
        input: Box<dyn BufRead>,
        format: &TextFormat,
        wanted: &Wanted,
    ) -> Result<Self, InputError> {
        let mut lines = Lines::new(input).map_err(|error| unreadable(&name, &error))?;
        let (mut sample, mut bytes) = (VecDeque::new(), 0);
        while sample.len() < SAMPLE && bytes < SAMPLE_BYTES {
            let mut line = String::new();
            if !lines.next(&name, &mut line)? {
                break;
            }
            bytes += line.len();
            if lines.number > format.skipped_lines {
                sample.push_back((lines.number, line));
            }
        }
        let mut rows = Self {
            name,
            lines,
            delimiter: Delimiter::Blanks,
            format: format.clone(),
            sample,
            header: None,
            comments: Vec::new(),
            line: String::new(),
        };
        rows.take_separator_line();
        rows.delimiter = format.delimiter.clone().unwrap_or_else(|| rows.sniff(wanted));
        rows.header = rows.commented_header(wanted);
        rows.keep_comments();
        Ok(rows)
    }

    /// Spreadsheets begin a file with `sep=;`.
    fn take_separator_line(&mut self) {
        let Some((_, first)) = self.sample.front() else { return };
        let mut rest = first.trim().strip_prefix("sep=").unwrap_or_default().chars();
        if let (Some(delimiter), None) = (rest.next(), rest.next()) {
            self.format.delimiter.get_or_insert(Delimiter::Character(delimiter));
            self.delimiter = Delimiter::Character(delimiter);
            self.sample.pop_front();
        }
    }

    fn is_comment(&self, line: &str) -> bool {
        let line = line.trim_start();
        line.starts_with('#')
            || line.starts_with("//")
            || self.format.comments.iter().any(|prefix| line.starts_with(prefix.as_str()))
    }

    fn without_prefix<'l>(&self, line: &'l str) -> &'l str {
        let line = line.trim_start();
        let own = self.format.comments.iter().map(String::as_str);
        own.chain(["//", "#"]).find_map(|prefix| line.strip_prefix(prefix)).unwrap_or(line)
    }

    /// Whether a quoted cell goes on behind this line.
    fn is_open(&self, row: &mut Row, text: &str, delimiter: &Delimiter) -> bool {
        if !text.contains('"') || self.is_comment(text) {
            return false;
        }
        row.start_line(1, text);
        split(row, delimiter).is_err_and(|error| error.is_open)
    }

    /// The rows of the sample under a delimiter: lines, or several of them together where a quoted cell has line breaks.
    fn sampled(&self, delimiter: &Delimiter) -> Vec<(u64, String)> {
        let (mut rows, mut row, mut at) = (Vec::new(), Row::default(), 0);
        while let Some((number, first)) = self.sample.get(at) {
            let (mut text, mut end) = (first.clone(), at + 1);
            while self.is_open(&mut row, &text, delimiter)
                && end - at < MOST_LINES_OF_A_ROW
                && let Some((_, more)) = self.sample.get(end)
            {
                text.push('\n');
                text.push_str(more);
                end += 1;
            }
            // A quote that is not closed is of its line alone.
            if self.is_open(&mut row, &text, delimiter) {
                (text, end) = (first.clone(), at + 1);
            }
            rows.push((*number, text));
            at = end;
        }
        rows
    }

    /// The delimiter under which most wanted columns are found; among equals the one under which most rows have as many
    /// cells as the header, and among these the first in the list that makes most cells.
    fn sniff(&self, wanted: &Wanted) -> Delimiter {
        if *wanted == Wanted::default() {
            return self.sniff_anything();
        }
        let mut row = Row::default();
        let mut score = |delimiter: &Delimiter| {
            let (mut hits, mut header_cells, mut numbers, mut alike) = (0, 0, 0, 0);
            for (_, line) in &self.sampled(delimiter) {
                let comment = self.is_comment(line);
                row.start_line(1, if comment { self.without_prefix(line) } else { line });
                if line.trim_start().is_empty() || split(&mut row, delimiter).is_err() {
                    continue;
                }
                let found = wanted.hits(&row);
                if found > hits || (found == hits && header_cells == 0) {
                    (hits, header_cells, alike) = (found, row.len(), 0);
                } else {
                    alike += usize::from(row.len() == header_cells);
                }
                if !comment && !wanted.numbers.is_empty() {
                    numbers += wanted.numbers_in(&row, *delimiter != Delimiter::Character(','));
                }
            }
            (hits, numbers, if hits > 0 { alike } else { 0 }, if numbers == 0 { header_cells } else { 0 })
        };
        // The last of equal maxima is taken: reversed, so that the first in the list wins.
        Delimiter::ALL.into_iter().rev().max_by_key(|delimiter| score(delimiter)).unwrap_or(Delimiter::Blanks)
    }

    /// The first delimiter that cuts most lines into the same number of cells, and no two numbers into one cell.
    fn sniff_anything(&self) -> Delimiter {
        let order = ['\t', ';', '|', ','].map(Delimiter::Character);
        let mut row = Row::default();
        let mut fits = |delimiter: &Delimiter| {
            let (mut counts, mut lines) = (HashMap::<usize, usize>::new(), 0);
            for (_, line) in &self.sampled(delimiter) {
                if line.trim().is_empty() || self.is_comment(line) {
                    continue;
                }
                row.start_line(1, line);
                if split(&mut row, delimiter).is_err() {
                    return false;
                }
                let is_number =
                    |text: &str| Decimal::Comma.parse(text).or(Decimal::Point.parse(text)).is_some();
                let is_several =
                    |cell: &str| cell.split_whitespace().filter(|part| is_number(part)).count() > 1;
                if row.cells().any(is_several) {
                    return false;
                }
                lines += 1;
                *counts.entry(row.len()).or_default() += 1;
            }
            counts.iter().any(|(cells, count)| *cells > 1 && 2 * count > lines)
        };
        order.into_iter().find(|delimiter| fits(delimiter)).unwrap_or(Delimiter::Blanks)
    }

    /// A comment line with more of the wanted names than any other line: `# X Y Z`.
    fn commented_header(&self, wanted: &Wanted) -> Option<u64> {
        let mut row = Row::default();
        let mut hits = |line: &str| {
            row.start_line(1, line);
            if split(&mut row, &self.delimiter).is_ok() { wanted.hits(&row) } else { 0 }
        };
        let (mut best, mut header) = (0, None);
        for (number, line) in &self.sampled(&self.delimiter) {
            let comment = self.is_comment(line);
            let found = hits(if comment { self.without_prefix(line) } else { line });
            if found > best {
                (best, header) = (found, comment.then_some(*number));
            }
        }
        header
    }

    fn keep_comments(&mut self) {
        let lines = self.sample.iter().filter(|(_, line)| self.is_comment(line)).take(MOST_COMMENTS);
        self.comments = lines.map(|(number, line)| (*number, line.trim().to_owned())).collect();
    }
}

impl TextRows {
    /// The next line, and its number; `None` at the end.
    fn take_line(&mut self, line: &mut String) -> Result<Option<u64>, InputError> {
        if let Some((number, sampled)) = self.sample.pop_front() {
            *line = sampled;
            return Ok(Some(number));
        }
        Ok(self.lines.next(&self.name, line)?.then_some(self.lines.number))
    }

    /// Adds lines to the row that begins in line `number`, until its quoted cell is closed.
    fn read_to_the_closing_quote(
        &mut self,
        row: &mut Row,
        number: u64,
        opened: QuoteError,
    ) -> Result<(), InputError> {
        let first = row.line().to_owned();
        let (mut text, mut more) = (first.clone(), String::new());
        for _ in 1..MOST_LINES_OF_A_ROW {
            if text.len() as u64 > LONGEST_LINE || self.take_line(&mut more)?.is_none() {
                break;
            }
            text.push('\n');
            text.push_str(&more);
            row.start_line(number, &text);
            match split(row, &self.delimiter) {
                Ok(()) => return Ok(()),
                Err(error) if error.is_open => {}
                Err(error) => return Err(self.refuse_quote(&text, number, error)),
            }
        }
        Err(self.refuse_quote(&first, number, opened))
    }

    fn refuse_quote(&self, text: &str, number: u64, error: QuoteError) -> InputError {
        let excerpt = Excerpt::new(text, usize::try_from(number).unwrap_or(usize::MAX));
        let help = Some("expected quotes in pairs around a whole value".to_owned());
        InputError::in_excerpt(&self.name, excerpt, error.span, error.message, help)
    }
}

impl Rows for TextRows {
    fn name(&self) -> &str {
        &self.name
    }

    fn next_row(&mut self, row: &mut Row) -> Result<bool, InputError> {
        loop {
            let mut line = std::mem::take(&mut self.line);
            let number = self.take_line(&mut line)?;
            self.line = line;
            let Some(number) = number else { return Ok(false) };
            if number <= self.format.skipped_lines || self.line.trim_start().is_empty() {
                continue;
            }
            let comment = self.is_comment(&self.line);
            if comment && self.header != Some(number) {
                continue;
            }
            row.start_line(number, if comment { self.without_prefix(&self.line) } else { &self.line });
            match split(row, &self.delimiter) {
                Ok(()) => {}
                Err(error) if error.is_open && !comment => {
                    self.read_to_the_closing_quote(row, number, error)?;
                }
                Err(error) => return Err(self.refuse_quote(row.line(), number, error)),
            }
            return Ok(true);
        }
    }

    fn remarks(&self) -> Vec<String> {
        self.lines.remarks(&self.name)
    }

    fn breaks_off(&self) -> bool {
        self.sample.is_empty() && self.lines.breaks_off
    }

    fn comments(&self) -> &[(u64, String)] {
        &self.comments
    }
}

fn unreadable(name: &str, error: &io::Error) -> InputError {
    InputError::Unreadable { path: name.into(), reason: error.to_string() }
}

/// Lines of a file, decoded.
struct Lines {
    input: Box<dyn BufRead>,
    bytes: Vec<u8>,
    /// Of the line that was given last.
    number: u64,
    line_end: u8,
    /// Whether the line that was given last has no end: the file ends in it.
    breaks_off: bool,
    is_utf16: bool,
    /// First line that is not UTF-8, and the first of its bytes that cannot be.
    latin: Option<(u64, u8)>,
}

impl Lines {
    fn new(mut input: Box<dyn BufRead>) -> io::Result<Self> {
        let start = input.fill_buf()?;
        let utf16 = match start {
            [0xFF, 0xFE, ..] => Some(u16::from_le_bytes as fn([u8; 2]) -> u16),
            [0xFE, 0xFF, ..] => Some(u16::from_be_bytes as fn([u8; 2]) -> u16),
            _ => None,
        };
        // Files of old programs end lines with a carriage return alone.
        let line_end = if start.contains(&b'\r') && !start.contains(&b'\n') { b'\r' } else { b'\n' };
        if start.starts_with(&[0xEF, 0xBB, 0xBF]) {
            input.consume(3);
        }
        if let Some(unit) = utf16 {
            input.consume(2);
            let decoded = BufReader::new(Utf16 { input, unit, pending: VecDeque::new() });
            let input = Box::new(decoded);
            return Ok(Self {
                input,
                bytes: Vec::new(),
                number: 0,
                line_end: b'\n',
                breaks_off: false,
                is_utf16: true,
                latin: None,
            });
        }
        Ok(Self {
            input,
            bytes: Vec::new(),
            number: 0,
            line_end,
            breaks_off: false,
            is_utf16: false,
            latin: None,
        })
    }

    /// The next line, without its end; false at the end of the file.
    fn next(&mut self, name: &str, line: &mut String) -> Result<bool, InputError> {
        line.clear();
        self.bytes.clear();
        let mut limited = (&mut self.input).take(LONGEST_LINE);
        let count =
            limited.read_until(self.line_end, &mut self.bytes).map_err(|error| unreadable(name, &error))?;
        if count == 0 {
            return Ok(false);
        }
        self.number += 1;
        self.breaks_off = self.bytes.last() != Some(&self.line_end);
        while matches!(self.bytes.last(), Some(b'\n' | b'\r')) {
            self.bytes.pop();
        }
        // Where lines end the other way round.
        if self.bytes.first() == Some(&b'\r') {
            self.bytes.remove(0);
        }
        let refused = |reason: &str| {
            InputError::Place {
            place: format!("{name}:{}", self.number),
            message: reason.to_owned(),
            help: Some(
                "expected a text file with one line per measurement; save UTF-16 without a byte order mark as UTF-8 first"
                    .to_owned(),
            ),
        }
        };
        if count as u64 == LONGEST_LINE {
            return Err(refused("a line of more than a million bytes"));
        }
        match std::str::from_utf8(&self.bytes) {
            Ok(text) => line.push_str(text),
            Err(error) => {
                let byte = self.bytes[error.valid_up_to()];
                line.extend(self.bytes.iter().map(|byte| latin(*byte)));
                self.latin.get_or_insert((self.number, byte));
            }
        }
        if line.contains('\0') {
            return Err(refused("a zero byte, which text cannot contain"));
        }
        Ok(true)
    }

    fn remarks(&self, name: &str) -> Vec<String> {
        let mut remarks = Vec::new();
        if let Some((line, byte)) = self.latin {
            let read = latin(byte);
            remarks.push(format!(
                "{name}:{line}: not UTF-8 (the byte 0x{byte:02X}): read as Latin-1 (Windows-1252), in which it is {read:?}"
            ));
        }
        if self.is_utf16 {
            remarks.push(format!("{name}: read as UTF-16"));
        }
        remarks
    }
}

/// UTF-16 as UTF-8.
struct Utf16 {
    input: Box<dyn BufRead>,
    unit: fn([u8; 2]) -> u16,
    /// Decoded, and not yet given.
    pending: VecDeque<u8>,
}

impl Utf16 {
    fn read_unit(&mut self) -> io::Result<Option<u16>> {
        let mut bytes = [0; 2];
        match self.input.read_exact(&mut bytes) {
            Ok(()) => Ok(Some((self.unit)(bytes))),
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(None),
            Err(error) => Err(error),
        }
    }
}

impl Read for Utf16 {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while self.pending.len() < buffer.len() {
            let Some(first) = self.read_unit()? else { break };
            let second = if (0xD800..0xDC00).contains(&first) { self.read_unit()? } else { None };
            for decoded in char::decode_utf16([first].into_iter().chain(second)) {
                let c = decoded.unwrap_or(char::REPLACEMENT_CHARACTER);
                self.pending.extend(c.encode_utf8(&mut [0; 4]).bytes());
            }
        }
        self.pending.read(buffer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows_of(bytes: &[u8], format: &TextFormat, wanted: &Wanted) -> (Vec<Vec<String>>, Vec<String>) {
        let input = Box::new(Cursor::new(bytes.to_vec()));
        let mut rows = TextRows::new("m.txt".to_owned(), input, format, wanted).expect("text");
        let (mut found, mut row) = (Vec::new(), Row::default());
        while rows.next_row(&mut row).expect("text") {
            found.push(row.cells().map(str::to_owned).collect());
        }
        (found, rows.remarks())
    }

    fn named(names: &[&str]) -> Wanted {
        Wanted { names: names.iter().map(|name| (*name).to_owned()).collect(), numbers: Vec::new() }
    }

    #[test]
    fn lines_without_content_are_skipped() {
        let text = "\u{feff}// SA export\r\n# units mm\n\n a,b\r\n1,2\n   \n3,4";
        let (rows, remarks) = rows_of(text.as_bytes(), &TextFormat::default(), &named(&["a", "b"]));
        assert_eq!(rows, [["a", "b"], ["1", "2"], ["3", "4"]]);
        assert!(remarks.is_empty());
        let turned = rows_of(b"a b\n\r1 2\n\r", &TextFormat::default(), &named(&["a"])).0;
        assert_eq!(turned, [["a", "b"], ["1", "2"]]);
        let old = rows_of(b"a b\r1 2\r", &TextFormat::default(), &named(&["a"])).0;
        assert_eq!(old, [["a", "b"], ["1", "2"]]);
    }

    #[test]
    fn encodings_are_read_and_told() {
        let wanted = named(&["Ux", "T"]);
        let (rows, remarks) = rows_of(b"Ux [\xb5m];T [\xb0C]\n1;2\n", &TextFormat::default(), &wanted);
        assert_eq!(rows[0], ["Ux [µm]", "T [°C]"]);
        assert_eq!(
            remarks,
            ["m.txt:1: not UTF-8 (the byte 0xB5): read as Latin-1 (Windows-1252), in which it is 'µ'"]
        );
        let little: Vec<u8> = "\u{feff}Ux;T\n1;😀\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
        let big: Vec<u8> = "\u{feff}Ux;T\n1;😀\n".encode_utf16().flat_map(u16::to_be_bytes).collect();
        for bytes in [little, big] {
            let (rows, remarks) = rows_of(&bytes, &TextFormat::default(), &wanted);
            assert_eq!((rows[1][1].as_str(), remarks.len()), ("😀", 1));
        }
    }

    #[test]
    fn the_delimiter_is_found_without_names() {
        let wanted = Wanted { names: Vec::new(), numbers: vec![1, 2] };
        for (text, expected) in [
            ("P1 1.5 2.5\nP2 3.5 4.5\n", vec!["P1", "1.5", "2.5"]),
            ("P1;1,5;2,5\nP2;3,5;4,5\n", vec!["P1", "1,5", "2,5"]),
            ("P1,1.5,2.5\nP2,3.5,4.5\n", vec!["P1", "1.5", "2.5"]),
            ("P1, 1.5, 2.5\nP2, 3.5, 4.5\n", vec!["P1", "1.5", "2.5"]),
            ("P 1\t1,5\t2,5\n", vec!["P 1", "1,5", "2,5"]),
            ("sep=|\nP 1|1,5|2,5\n", vec!["P 1", "1,5", "2,5"]),
        ] {
            assert_eq!(rows_of(text.as_bytes(), &TextFormat::default(), &wanted).0[0], expected, "{text}");
        }
    }

    #[test]
    fn a_header_may_stand_in_a_comment() {
        let (rows, _) = rows_of(b"# robot 7\n# X Y Z\n1 2 3\n", &TextFormat::default(), &named(&["X", "Y"]));
        assert_eq!(rows, [["X", "Y", "Z"], ["1", "2", "3"]]);
        let format = TextFormat { comments: vec!["%".to_owned()], skipped_lines: 1, ..TextFormat::default() };
        let (rows, _) = rows_of(b"X Y Z\n% made by hand\nX Y Z\n1 2 3\n", &format, &named(&["X"]));
        assert_eq!(rows, [["X", "Y", "Z"], ["1", "2", "3"]]);
    }

    #[test]
    fn a_quoted_cell_may_have_line_breaks() {
        let text = "Name,\"X\r\n[mm]\",Y\r\n\"P 1\n\n# second line, of \"\"one\"\"\",1,2\nP2,3,4\n";
        for wanted in [named(&["Name", "X", "Y"]), Wanted::default()] {
            let input = Box::new(Cursor::new(text.as_bytes().to_vec()));
            let mut rows =
                TextRows::new("m.csv".to_owned(), input, &TextFormat::default(), &wanted).expect("text");
            let (mut found, mut row) = (Vec::new(), Row::default());
            while rows.next_row(&mut row).expect("text") {
                let cells: Vec<String> = row.cells().map(str::to_owned).collect();
                found.push((row.place().clone(), cells.join("|")));
            }
            let expected = [(1, "Name|X [mm]|Y"), (3, "P 1 # second line, of \"one\"|1|2"), (6, "P2|3|4")];
            let expected =
                expected.map(|(line, cells)| (super::super::rows::Place::Line(line), cells.to_owned()));
            assert_eq!(found, expected, "{wanted:?}");
            // What is wrong behind such a cell is in its own line.
            let refused = row.refuse("m.csv", Some(1), "column X is \"3\"", "more").to_string();
            assert!(refused.starts_with("m.csv:6:4: ") || refused.starts_with("m.csv:6: "), "{refused}");
        }
    }

    #[test]
    fn a_quote_that_is_not_closed_is_refused_where_it_opens() {
        let refused = |text: &str| {
            let input = Box::new(Cursor::new(text.as_bytes().to_vec()));
            let format = TextFormat { delimiter: Some(Delimiter::Character(',')), ..TextFormat::default() };
            let mut rows =
                TextRows::new("m.csv".to_owned(), input, &format, &Wanted::default()).expect("text");
            let mut row = Row::default();
            loop {
                match rows.next_row(&mut row) {
                    Ok(more) => assert!(more, "not refused: {text}"),
                    Err(error) => return error.to_string(),
                }
            }
        };
        let found = refused(&format!("a,b\n1,2\n3,\"4\n{}", "5,6\n".repeat(1000)));
        assert!(found.starts_with("m.csv:3") && found.contains("the quote is not closed"), "{found}");
        let found = refused("a,b\n1,\"2\n3,\"4\"\n");
        assert!(found.starts_with("m.csv:2") && found.contains("text after a closing quote"), "{found}");
        assert!(refused("a,b\n1,\"2").starts_with("m.csv:2"));
    }

    #[test]
    fn what_is_no_text_is_refused() {
        let wanted = Wanted::default();
        let refused = |bytes: Vec<u8>| {
            let input = Box::new(Cursor::new(bytes));
            TextRows::new("m.bin".to_owned(), input, &TextFormat::default(), &wanted).err().expect("refused")
        };
        assert!(refused(b"a,b\n1,\0\n".to_vec()).to_string().contains("m.bin:2: a zero byte"));
        assert!(refused(vec![b'x'; 2 << 20]).to_string().contains("more than a million bytes"));
    }
}
