//! Lines and cells of a delimited text, each with its place, so that a message can point at the cell.
//!
//! The csv crate gives the place of a record but not of a field, knows no `//` comments and no runs of blanks as delimiter; it
//! writes our files and checks this reader in the tests.

use std::borrow::Cow;
use std::ops::Range;

/// What stands between two cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Delimiter {
    /// Exactly one of it.
    Character(char),
    /// Any run of blanks or tabs.
    Blanks,
}

impl Delimiter {
    /// In the order in which they are tried.
    pub const ALL: [Self; 4] =
        [Self::Character(','), Self::Character(';'), Self::Character('\t'), Self::Blanks];
}

/// One value; surrounding blanks and quotes are not part of `text`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Cell<'a> {
    pub text: Cow<'a, str>,
    /// Bytes of the whole text, quotes included.
    pub span: Range<usize>,
}

/// A quote that does not pair.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct QuoteError {
    pub span: Range<usize>,
    pub message: &'static str,
}

/// Where the lines with content lie: without comments (`#`, `//`), blank lines and line ends.
pub(super) fn content_lines(text: &str) -> impl Iterator<Item = Range<usize>> {
    let mut start = 0;
    text.split_inclusive('\n').filter_map(move |line| {
        let from = start;
        start += line.len();
        // A byte-order mark is no content.
        let skipped = if from == 0 && line.starts_with('\u{feff}') { '\u{feff}'.len_utf8() } else { 0 };
        let content = line[skipped..].trim_end_matches(['\n', '\r']);
        let first = content.trim_start();
        let comment = first.starts_with('#') || first.starts_with("//");
        (!first.is_empty() && !comment).then(|| from + skipped..from + skipped + content.len())
    })
}

/// The cells of one line.
pub(super) fn split_line(
    text: &str,
    line: Range<usize>,
    delimiter: Delimiter,
) -> Result<Vec<Cell<'_>>, QuoteError> {
    let mut splitter = Splitter { text, at: line.start, end: line.end, delimiter };
    let mut cells = Vec::new();
    splitter.skip_blanks();
    loop {
        if delimiter == Delimiter::Blanks && splitter.at == splitter.end {
            return Ok(cells);
        }
        cells.push(splitter.cell()?);
        if !splitter.skip_delimiter() {
            return Ok(cells);
        }
    }
}

struct Splitter<'a> {
    text: &'a str,
    at: usize,
    end: usize,
    delimiter: Delimiter,
}

impl<'a> Splitter<'a> {
    fn rest(&self) -> &'a str {
        &self.text[self.at..self.end]
    }

    fn is_blank(&self, c: char) -> bool {
        matches!(c, ' ' | '\t') && self.delimiter != Delimiter::Character(c)
    }

    fn is_end(&self, c: char) -> bool {
        match self.delimiter {
            Delimiter::Character(delimiter) => c == delimiter,
            Delimiter::Blanks => matches!(c, ' ' | '\t'),
        }
    }

    fn skip_blanks(&mut self) {
        let rest = self.rest();
        self.at += rest.find(|c| !self.is_blank(c)).unwrap_or(rest.len());
    }

    /// Behind the delimiter; false at the end of the line.
    fn skip_delimiter(&mut self) -> bool {
        self.skip_blanks();
        match (self.delimiter, self.rest().chars().next()) {
            (_, None) => false,
            (Delimiter::Blanks, Some(_)) => true,
            (Delimiter::Character(_), Some(c)) => {
                self.at += c.len_utf8();
                true
            }
        }
    }

    fn cell(&mut self) -> Result<Cell<'a>, QuoteError> {
        self.skip_blanks();
        if self.rest().starts_with('"') {
            return self.quoted();
        }
        let rest = self.rest();
        let length = rest.find(|c| self.is_end(c)).unwrap_or(rest.len());
        let text = rest[..length].trim_end();
        let start = self.at;
        self.at += length;
        Ok(Cell { text: Cow::Borrowed(text), span: start..start + text.len() })
    }

    fn quoted(&mut self) -> Result<Cell<'a>, QuoteError> {
        let start = self.at;
        self.at += 1;
        let mut text = Cow::Borrowed("");
        loop {
            let rest = self.rest();
            let Some(length) = rest.find('"') else {
                return Err(QuoteError {
                    span: start..self.end,
                    message: "the quote is not closed on this line",
                });
            };
            text += &rest[..length];
            self.at += length + 1;
            // A doubled quote stands for one.
            if !self.rest().starts_with('"') {
                break;
            }
            text += "\"";
            self.at += 1;
        }
        let span = start..self.at;
        self.skip_blanks();
        match self.rest().chars().next() {
            Some(c) if !self.is_end(c) && self.delimiter != Delimiter::Blanks => {
                Err(QuoteError { span, message: "text behind a closing quote" })
            }
            _ => Ok(Cell { text, span }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cells(line: &str, delimiter: Delimiter) -> Vec<String> {
        let cells = split_line(line, 0..line.len(), delimiter).expect("quotes in pairs");
        for cell in &cells {
            assert!(cell.span.start <= cell.span.end && cell.span.end <= line.len());
        }
        cells.into_iter().map(|cell| cell.text.into_owned()).collect()
    }

    #[test]
    fn lines_without_content_are_skipped_and_the_rest_keeps_its_place() {
        let text = "\u{feff}// SA export\r\n# units mm\n\n a,b\r\n1,2\n   \n3,4";
        let lines: Vec<_> = content_lines(text).map(|line| &text[line]).collect();
        assert_eq!(lines, [" a,b", "1,2", "3,4"]);
        let marked = "\u{feff}a,b\n1,2";
        assert_eq!(content_lines(marked).map(|line| &marked[line]).collect::<Vec<_>>(), ["a,b", "1,2"]);
        assert_eq!(content_lines("").count(), 0);
    }

    #[test]
    fn cells_are_split_and_trimmed() {
        assert_eq!(cells("a, b c ,,", Delimiter::Character(',')), ["a", "b c", "", ""]);
        assert_eq!(cells("  a\t b  c ", Delimiter::Blanks), ["a", "b", "c"]);
        assert_eq!(cells("a\t\tb c", Delimiter::Character('\t')), ["a", "", "b c"]);
        assert_eq!(cells(" \"a \"\"b\"\", c\" ;d", Delimiter::Character(';')), ["a \"b\", c", "d"]);
        assert_eq!(cells("\"a b\" c", Delimiter::Blanks), ["a b", "c"]);
        let broken = |line: &str| split_line(line, 0..line.len(), Delimiter::Character(',')).unwrap_err();
        assert_eq!(broken("1,\"2,3").span, 2..6);
        assert_eq!(broken("1,\"2\"3,4").message, "text behind a closing quote");
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
            let found = cells(line.trim_end_matches('\n'), Delimiter::Character(char::from(delimiter)));
            prop_assert_eq!(found, fields);
        }

        /// Where the csv crate reads the same fields: no quotes, no blanks around values.
        #[test]
        fn it_splits_as_the_csv_crate_does(line in "[a-z0-9,.é-]{1,30}") {
            let mut reader = csv::ReaderBuilder::new().has_headers(false).from_reader(line.as_bytes());
            let record = reader.records().next().unwrap().unwrap();
            prop_assert_eq!(cells(&line, Delimiter::Character(',')), record.iter().collect::<Vec<_>>());
        }

        #[test]
        fn no_text_panics(text in "(\\PC|[\",;\t\r\n #/]){0,60}") {
            for delimiter in Delimiter::ALL {
                for line in content_lines(&text) {
                    if let Ok(cells) = split_line(&text, line.clone(), delimiter) {
                        for cell in cells {
                            prop_assert!(line.start <= cell.span.start && cell.span.end <= line.end);
                            prop_assert!(text.get(cell.span).is_some());
                        }
                    }
                }
            }
        }
    }
}
