//! Lines of a text that is not held as a whole, with their true numbers.

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
