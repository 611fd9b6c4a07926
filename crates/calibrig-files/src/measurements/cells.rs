//! Cells of a line of text, each with its place, so that a message can point at it.
//!
//! The csv crate gives the place of a record but not of a field, knows no runs of blanks and no widths as delimiter; it
//! writes our files and checks this reader in the tests.

use std::ops::Range;

use super::rows::Row;

/// What stands between two cells.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Delimiter {
    /// Exactly one of it.
    Character(char),
    /// Any run of blanks or tabs.
    Blanks,
    /// Nothing: every column but the last takes this number of characters.
    Widths(Vec<usize>),
}

impl Delimiter {
    /// In the order in which they are tried.
    pub const ALL: [Self; 5] = [
        Self::Character(','),
        Self::Character(';'),
        Self::Character('\t'),
        Self::Character('|'),
        Self::Blanks,
    ];
}

/// A quote that does not pair.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct QuoteError {
    /// Bytes of the line.
    pub span: Range<usize>,
    pub message: &'static str,
    /// Whether the quote may be closed on a line behind this one.
    pub is_open: bool,
}

/// Cuts the row's line into its cells. Surrounding blanks and quotes are not part of a cell.
pub(super) fn split(row: &mut Row, delimiter: &Delimiter) -> Result<(), QuoteError> {
    if let Delimiter::Widths(widths) = delimiter {
        split_at_widths(row, widths);
        return Ok(());
    }
    let bytes = row.line().as_bytes();
    if bytes.is_ascii() && !bytes.contains(&b'"') {
        match *delimiter {
            Delimiter::Character(c) if c.is_ascii() => {
                let wanted = c as u8;
                row.cut(|byte| byte == wanted, false);
                return Ok(());
            }
            Delimiter::Blanks => {
                row.cut(|byte| matches!(byte, b' ' | b'\t'), true);
                return Ok(());
            }
            _ => {}
        }
    }
    let line = std::mem::take(row.line_mut());
    let split = Splitter { text: &line, at: 0, delimiter }.all(row);
    // Cells that are not verbatim in the line are stored after it.
    let behind = std::mem::replace(row.line_mut(), line);
    row.append(&behind);
    split
}

fn split_at_widths(row: &mut Row, widths: &[usize]) {
    let line = std::mem::take(row.line_mut());
    let mut start = 0;
    for width in widths.iter().copied().chain([usize::MAX]) {
        let rest = &line[start..];
        let length = rest.char_indices().nth(width).map_or(rest.len(), |(at, _)| at);
        let cell = &rest[..length];
        let from = start + cell.len() - cell.trim_start().len();
        let span = from..from + cell.trim().len();
        // Behind the last width there need not be anything.
        if width < usize::MAX || !span.is_empty() {
            row.push_span(span.clone(), span);
        }
        start += length;
    }
    *row.line_mut() = line;
}

struct Splitter<'a> {
    text: &'a str,
    at: usize,
    delimiter: &'a Delimiter,
}

impl<'a> Splitter<'a> {
    fn all(&mut self, row: &mut Row) -> Result<(), QuoteError> {
        self.skip_blanks();
        loop {
            if *self.delimiter == Delimiter::Blanks && self.at == self.text.len() {
                return Ok(());
            }
            self.cell(row)?;
            if !self.skip_delimiter() {
                return Ok(());
            }
        }
    }

    fn rest(&self) -> &'a str {
        &self.text[self.at..]
    }

    fn is_blank(&self, c: char) -> bool {
        matches!(c, ' ' | '\t') && *self.delimiter != Delimiter::Character(c)
    }

    fn is_end(&self, c: char) -> bool {
        match self.delimiter {
            Delimiter::Character(delimiter) => c == *delimiter,
            _ => matches!(c, ' ' | '\t'),
        }
    }

    fn skip_blanks(&mut self) {
        let rest = self.rest();
        self.at += rest.find(|c| !self.is_blank(c)).unwrap_or(rest.len());
    }

    /// After the delimiter; false at the end of the line.
    fn skip_delimiter(&mut self) -> bool {
        self.skip_blanks();
        match (self.delimiter, self.rest().chars().next()) {
            (_, None) => false,
            (Delimiter::Character(_), Some(c)) => {
                self.at += c.len_utf8();
                true
            }
            (_, Some(_)) => true,
        }
    }

    fn cell(&mut self, row: &mut Row) -> Result<(), QuoteError> {
        self.skip_blanks();
        let rest = self.rest();
        if rest.starts_with('"') {
            return self.quoted(row);
        }
        let length = rest.find(|c| self.is_end(c)).unwrap_or(rest.len());
        let span = self.at..self.at + rest[..length].trim_end().len();
        self.at += length;
        row.push_span(span.clone(), span);
        Ok(())
    }

    fn quoted(&mut self, row: &mut Row) -> Result<(), QuoteError> {
        let start = self.at;
        self.at += 1;
        let mut text = String::new();
        let mut is_plain = true;
        let inner = loop {
            let rest = self.rest();
            let Some(length) = rest.find('"') else {
                let message = "the quote is not closed";
                return Err(QuoteError { span: start..self.text.len(), message, is_open: true });
            };
            text.push_str(&rest[..length]);
            self.at += length + 1;
            // A doubled quote stands for one.
            if !self.rest().starts_with('"') {
                break start + 1..self.at - 1;
            }
            is_plain = false;
            text.push('"');
            self.at += 1;
        };
        let span = start..self.at;
        self.skip_blanks();
        match self.rest().chars().next() {
            Some(c) if !self.is_end(c) && *self.delimiter != Delimiter::Blanks => {
                return Err(QuoteError { span, message: "text after a closing quote", is_open: false });
            }
            // A line break in a name would appear in every message.
            _ if text.contains(['\n', '\r']) => {
                let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
                row.push_behind(&text, self.text.len(), span);
            }
            _ if is_plain => row.push_span(inner, span),
            _ => row.push_behind(&text, self.text.len(), span),
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cells(line: &str, delimiter: &Delimiter) -> Vec<String> {
        let mut row = Row::default();
        row.start_line(1, line);
        split(&mut row, delimiter).expect("quotes in pairs");
        assert_eq!(row.line(), line);
        row.cells().map(str::to_owned).collect()
    }

    #[test]
    fn cells_are_split_and_trimmed() {
        assert_eq!(cells("a, b c ,,", &Delimiter::Character(',')), ["a", "b c", "", ""]);
        assert_eq!(cells("  a\t b  c ", &Delimiter::Blanks), ["a", "b", "c"]);
        assert_eq!(cells("a\t\tb c", &Delimiter::Character('\t')), ["a", "", "b c"]);
        assert_eq!(cells(" \"a \"\"b\"\", c\" ;d", &Delimiter::Character(';')), ["a \"b\", c", "d"]);
        assert_eq!(cells("\"a b\" c", &Delimiter::Blanks), ["a b", "c"]);
        assert_eq!(
            cells("  1 -2.5-10.25 P 7 x", &Delimiter::Widths(vec![3, 5, 6, 4])),
            ["1", "-2.5", "-10.25", "P 7", "x"]
        );
        assert_eq!(cells("é1 2", &Delimiter::Widths(vec![2, 2, 2])), ["é1", "2", ""]);
        let broken = |line: &str| {
            let mut row = Row::default();
            row.start_line(1, line);
            split(&mut row, &Delimiter::Character(',')).unwrap_err()
        };
        assert_eq!(broken("1,\"2,3").span, 2..6);
        assert_eq!(broken("1,\"2\"3,4").message, "text after a closing quote");
    }

    /// What the csv crate writes with line breaks in cells has as many cells; breaks are blanks.
    #[test]
    fn line_breaks_in_cells_are_blanks() {
        let mut writer = csv::WriterBuilder::new().from_writer(Vec::new());
        writer.write_record(["a\r\nb", "c\"\nd", "\n", "e"]).unwrap();
        let line = String::from_utf8(writer.into_inner().unwrap()).unwrap();
        let found = cells(line.trim_end_matches('\n'), &Delimiter::Character(','));
        assert_eq!(found, ["a b", "c\" d", "", "e"]);
    }

    proptest! {
        /// What the csv crate writes is split as it was.
        #[test]
        fn it_reads_what_the_csv_crate_writes(
            fields in prop::collection::vec("[a-z0-9 ,;\"#/é.-]{0,8}", 2..6), delimiter in prop::sample::select(vec![b',', b';', b'\t'])
        ) {
            // The crate keeps blanks around an unquoted value, this reader does not.
            let fields: Vec<_> = fields.iter().map(|field| field.trim()).collect();
            let mut writer = csv::WriterBuilder::new().delimiter(delimiter).from_writer(Vec::new());
            writer.write_record(&fields).unwrap();
            let line = String::from_utf8(writer.into_inner().unwrap()).unwrap();
            let found = cells(line.trim_end_matches('\n'), &Delimiter::Character(char::from(delimiter)));
            prop_assert_eq!(found, fields);
        }

        /// Where the csv crate reads the same fields: no quotes, no blanks around values.
        #[test]
        fn it_splits_as_the_csv_crate_does(line in "[a-z0-9,.é-]{1,30}") {
            let mut reader = csv::ReaderBuilder::new().has_headers(false).from_reader(line.as_bytes());
            let record = reader.records().next().unwrap().unwrap();
            prop_assert_eq!(cells(&line, &Delimiter::Character(',')), record.iter().collect::<Vec<_>>());
        }

        /// The way of plain lines gives what the other way does, which a quoted cell in front calls for.
        #[test]
        fn both_ways_cut_alike(line in "[ -!#-~\t]{0,40}", delimiter in prop::sample::select(Delimiter::ALL.to_vec())) {
            let plain = cells(&line, &delimiter);
            let between = match delimiter {
                Delimiter::Character(c) => c,
                _ => ' ',
            };
            let quoted = cells(&format!("\"q\"{between}{line}"), &delimiter);
            prop_assert_eq!(&quoted[1..], plain);
        }

        #[test]
        fn no_text_panics(line in "(\\PC|[\",;\t #/|]){0,60}", widths in prop::collection::vec(0usize..9, 0..5)) {
            for delimiter in Delimiter::ALL.into_iter().chain([Delimiter::Widths(widths)]) {
                let mut row = Row::default();
                row.start_line(1, &line);
                if split(&mut row, &delimiter).is_ok() {
                    for column in 0..row.len() {
                        let refused = row.refuse("m.csv", Some(column), "no", "yes");
                        prop_assert!(row.cell(column).is_some());
                        let drawn = format!("{:?}", miette::Report::new(refused));
                        prop_assert!(drawn.contains("m.csv:1: no"));
                    }
                }
            }
        }
    }
}
