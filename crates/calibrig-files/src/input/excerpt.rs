//! Lines of a text that is not in memory as a whole, with their line numbers.

use std::ops::Range;

use miette::{MietteError, MietteSpanContents, SourceCode, SourceSpan, SpanContents};

/// Some lines of a text, for an error to point into.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Excerpt {
    text: String,
    first_line: usize,
}

impl Excerpt {
    /// A text from its first line on.
    pub fn whole(text: impl Into<String>) -> Self {
        Self::new(text, 1)
    }

    /// Lines of a text, the first of which has this number there, from 1.
    pub fn new(text: impl Into<String>, first_line: usize) -> Self {
        Self { text: text.into(), first_line }
    }

    /// The lines.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Number of the first of them, from 1.
    pub fn first_line(&self) -> usize {
        self.first_line
    }
}

/// A line longer than this is not shown as a whole, bytes: it would hide everything else, and the renderer counts columns in 16 bits.
const LONG: usize = 400;
/// Bytes shown of such a line on either side of the place.
const BESIDE: usize = 100;
/// Lines to either side of a place that are shown with it.
const AROUND: usize = 3;

impl Excerpt {
    /// The excerpt of the text for an error at `span` (bytes), and the span within it: all of it, or a piece of the line if the surrounding lines are
    /// too long. The span is on boundaries of characters.
    pub(super) fn shown_at(self, span: Range<usize>) -> (Self, Range<usize>) {
        let text = &self.text;
        let start = text.floor_char_boundary(span.start.min(text.len()));
        let end = text.ceil_char_boundary(span.end.clamp(start, text.len()));
        let line = text[..start].rfind('\n').map_or(0, |at| at + 1);
        let before = text[..line].rsplit('\n').skip(1).take(AROUND);
        let behind = text[line..].split('\n').take(1 + AROUND);
        if before.chain(behind).all(|line| line.len() <= LONG) && end - start <= 20 * LONG {
            return (self, start..end);
        }
        let line_end = text[start..].find('\n').map_or(text.len(), |at| start + at);
        let shown_end = end.min(line_end).min(text.ceil_char_boundary(start + BESIDE));
        let from = text.floor_char_boundary(start.saturating_sub(BESIDE)).max(line);
        let to = text.ceil_char_boundary((shown_end + BESIDE).min(line_end));
        let mark = |cut: bool| if cut { "\u{2026}" } else { "" };
        let head = mark(from > line);
        let piece = format!("{head}{}{}", &text[from..to], mark(to < line_end));
        let number = self.first_line + text[..line].matches('\n').count();
        let place = head.len() + (start - from);
        (Self::new(piece, number), place..place + (shown_end - start))
    }
}

impl SourceCode for Excerpt {
    fn read_span<'a>(
        &'a self,
        span: &SourceSpan,
        context_lines_before: usize,
        context_lines_after: usize,
    ) -> Result<Box<dyn SpanContents<'a> + 'a>, MietteError> {
        let contents = self.text.read_span(span, context_lines_before, context_lines_after)?;
        Ok(Box::new(MietteSpanContents::new(
            contents.data(),
            *contents.span(),
            contents.line() + self.first_line.saturating_sub(1),
            contents.column(),
            contents.line_count(),
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_any_length_is_shown_about_the_place() {
        for (before, behind) in [(0, 0), (10, 300_000), (300_000, 10), (70_000, 70_000)] {
            let text =
                format!("first\n{}\u{e4}place\u{f6}{}\nlast", "\u{e9}".repeat(before), "x".repeat(behind));
            let at = text.find("place").expect("there");
            let (shown, span) = Excerpt::new(text.clone(), 7).shown_at(at..at + 5);
            assert_eq!(&shown.text()[span.clone()], "place");
            assert!(shown.text().len() <= 500, "{}", shown.text().len());
            let line = shown.first_line() + shown.text()[..span.start].matches('\n').count();
            assert_eq!(line, 8);
            let (shown, span) = Excerpt::new(text.clone(), 1).shown_at(text.len() + 5..text.len() + 9);
            assert!(span.end <= shown.text().len());
        }
        // A span that begins within a character, and one over all of a long line.
        let (shown, span) = Excerpt::whole("\u{e4}\u{e4}").shown_at(1..3);
        assert_eq!((shown.text(), span), ("\u{e4}\u{e4}", 0..4));
        let long = "y".repeat(100_000);
        let (shown, span) = Excerpt::whole(long).shown_at(0..100_000);
        assert!(shown.text().len() < 500 && span.end <= shown.text().len());
    }
}
