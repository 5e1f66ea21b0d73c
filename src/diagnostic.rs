//! Messages about a pipeline that show the place, the value and the way out.

use std::fmt;
use std::ops::Range;

use annotate_snippets::{AnnotationKind, Group, Level, Renderer, Snippet};

/// A text that diagnostics can point into: the pipeline file, or one `--set` of the command line.
#[derive(Debug, Clone)]
pub struct Source {
    /// What it is called in messages.
    pub name: String,
    /// Its whole text.
    pub text: String,
}

/// A stretch of a source, in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Span {
    /// Index of the source.
    pub source: usize,
    /// First byte.
    pub start: usize,
    /// Byte after the last.
    pub end: usize,
}

/// One thing that is wrong, where, and what to do about it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Diagnostic {
    /// What is wrong, in a sentence.
    pub message: String,
    /// Where; `None` when it concerns the pipeline as a whole.
    pub span: Option<Span>,
    /// Short text under the caret.
    pub label: String,
    /// The way out.
    pub hint: Option<String>,
}

impl Diagnostic {
    /// A fault at a place.
    pub fn at(span: Span, message: impl Into<String>) -> Self {
        Self { message: message.into(), span: Some(span), label: String::new(), hint: None }
    }

    /// A fault of the whole pipeline.
    pub fn general(message: impl Into<String>) -> Self {
        Self { message: message.into(), span: None, label: String::new(), hint: None }
    }

    /// Adds short text under the caret.
    #[must_use]
    pub fn label(mut self, label: impl Into<String>) -> Self {
        self.label = label.into();
        self
    }

    /// Adds another way out to the one there is.
    #[must_use]
    pub fn or_hint(mut self, hint: impl Into<String>) -> Self {
        let hint = hint.into();
        self.hint = Some(self.hint.map_or(hint.clone(), |first| format!("{first}; {hint}")));
        self
    }

    /// Adds the way out.
    #[must_use]
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }

    /// Adds `did you mean ...` where a known word is close, else the list of known words.
    #[must_use]
    pub fn suggest<'a>(self, given: &str, known: impl IntoIterator<Item = &'a str>) -> Self {
        let known: Vec<&str> = known.into_iter().collect();
        match nearest(given, &known) {
            Some(word) => self.hint(format!("did you mean `{word}`?")),
            None if known.is_empty() => self,
            None => self.hint(format!("known here: {}", known.join(", "))),
        }
    }
}

/// The known word most like the given one, if any is close.
pub fn nearest<'a>(given: &str, known: &[&'a str]) -> Option<&'a str> {
    let scored = known.iter().map(|word| (strsim::damerau_levenshtein(given, word), *word));
    let best = scored.min_by_key(|(distance, _)| *distance)?;
    (best.0 <= 1 + given.chars().count() / 3).then_some(best.1)
}

/// All that is wrong with a pipeline, with the texts it points into.
#[derive(Debug, Clone)]
pub struct Diagnostics {
    /// The texts.
    pub sources: Vec<Source>,
    /// The faults, in the order of the text.
    pub list: Vec<Diagnostic>,
}

impl Diagnostics {
    /// Renders every fault with its source line and caret; `colour` for a terminal.
    pub fn render(&self, colour: bool) -> String {
        let renderer = if colour { Renderer::styled() } else { Renderer::plain() };
        let mut ordered: Vec<&Diagnostic> = self.list.iter().collect();
        ordered.sort_by_key(|d| d.span.map(|span| (span.source, span.start)));
        let texts: Vec<String> = ordered.iter().map(|d| self.render_one(&renderer, d)).collect();
        let count = match texts.len() {
            1 => "1 error; nothing was run".to_owned(),
            n => format!("{n} errors; nothing was run"),
        };
        format!("{}\n\n{count}", texts.join("\n\n"))
    }

    fn render_one(&self, renderer: &Renderer, diagnostic: &Diagnostic) -> String {
        let title = Level::ERROR.primary_title(diagnostic.message.as_str());
        let mut groups: Vec<Group> = Vec::new();
        let mut group = match diagnostic.span.and_then(|span| Some((self.sources.get(span.source)?, span))) {
            Some((source, span)) => {
                let range = visible(&source.text, span.start..span.end);
                let mut annotation = AnnotationKind::Primary.span(range);
                if !diagnostic.label.is_empty() {
                    annotation = annotation.label(diagnostic.label.as_str());
                }
                title.element(Snippet::source(source.text.as_str()).path(source.name.as_str()).annotation(annotation))
            }
            None => Group::with_title(title),
        };
        if let Some(hint) = &diagnostic.hint {
            group = group.element(Level::HELP.message(hint.as_str()));
        }
        groups.push(group);
        renderer.render(&groups)
    }
}

impl fmt::Display for Diagnostics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.render(false))
    }
}

impl std::error::Error for Diagnostics {}

/// Cuts a span to its first line and to character boundaries, so that a caret stands under it.
fn visible(text: &str, range: Range<usize>) -> Range<usize> {
    let mut start = range.start.min(text.len());
    while !text.is_char_boundary(start) {
        start -= 1;
    }
    let line_end = text[start..].find('\n').map_or(text.len(), |offset| start + offset);
    let mut end = range.end.clamp(start, line_end);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    let trimmed = text[start..end].trim_end().len();
    start..(start + trimmed).max(start)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shows_file_line_column_caret_and_hint() {
        let text = "a: 1\nstage: rasterize-dem\n".to_owned();
        let diagnostics = Diagnostics {
            sources: vec![Source { name: "p.yaml".into(), text }],
            list: vec![
                Diagnostic::at(Span { source: 0, start: 12, end: 25 }, "unknown stage `rasterize-dem`")
                    .suggest("rasterize-dem", ["rasterise-dem", "import-mesh"]),
            ],
        };
        let shown = diagnostics.to_string();
        assert!(shown.contains("p.yaml:2:8"), "{shown}");
        assert!(shown.contains("^^^^^^^^^^^^^"), "{shown}");
        assert!(shown.contains("did you mean `rasterise-dem`?"), "{shown}");
    }

    #[test]
    fn a_span_beyond_the_text_is_no_panic() {
        assert_eq!(visible("ab\nö", 9..12), 5..5);
        assert_eq!(visible("ab\nö", 0..5), 0..2);
        assert_eq!(visible("ab\nö", 4..5), 3..5);
    }
}
