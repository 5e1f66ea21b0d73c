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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
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
            None => self.hint(format!("known here: {}", listed(known))),
        }
    }
}

/// Faults that are shown; beyond, they are only counted.
pub const SHOWN: usize = 100;
/// Words of a list that are named.
const NAMED: usize = 20;
/// Longer words are not compared: the time grows with the product of their lengths.
const WORD_BYTES: usize = 200;
/// Longer messages are cut.
const MESSAGE_BYTES: usize = 2000;

/// Words with commas between them: the first ones, and how many there are beyond.
pub fn listed<'a>(words: impl IntoIterator<Item = &'a str>) -> String {
    let mut words = words.into_iter();
    let mut text = words.by_ref().take(NAMED).map(shortened).collect::<Vec<_>>().join(", ");
    match words.count() {
        0 => {}
        more => text += &format!(", … and {more} more"),
    }
    text
}

/// A text, or where it is very long its beginning.
fn shortened(text: &str) -> std::borrow::Cow<'_, str> {
    if text.len() <= MESSAGE_BYTES {
        return text.into();
    }
    let end = (0..=MESSAGE_BYTES).rev().find(|end| text.is_char_boundary(*end)).unwrap_or(0);
    format!("{}… ({} bytes)", &text[..end], text.len()).into()
}

/// The known word most like the given one, if any is close.
pub fn nearest<'a>(given: &str, known: &[&'a str]) -> Option<&'a str> {
    let furthest = 1 + given.chars().count() / 3;
    let may_be_near =
        |word: &&&str| word.len().max(given.len()) <= WORD_BYTES && word.len().abs_diff(given.len()) <= 4 * furthest;
    let scored = known.iter().filter(may_be_near).map(|word| (strsim::damerau_levenshtein(given, word), *word));
    let best = scored.min_by_key(|(distance, _)| *distance)?;
    (best.0 <= furthest).then_some(best.1)
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
        let texts: Vec<String> = ordered.iter().take(SHOWN).map(|d| self.render_one(&renderer, d)).collect();
        let count = match ordered.len() {
            1 => "1 error; nothing was run".to_owned(),
            n if n > SHOWN => format!("{n} errors, of which the first {SHOWN} are shown; nothing was run"),
            n => format!("{n} errors; nothing was run"),
        };
        format!("{}\n\n{count}", texts.join("\n\n"))
    }

    fn render_one(&self, renderer: &Renderer, diagnostic: &Diagnostic) -> String {
        let message = shortened(&diagnostic.message);
        let title = Level::ERROR.primary_title(message.as_ref());
        let mut groups: Vec<Group> = Vec::new();
        let mut group = match diagnostic.span.and_then(|span| Some((self.sources.get(span.source)?, span))) {
            Some((source, span)) => {
                let range = visible(&source.text, span.start..span.end);
                let (line, first) = line_at(&source.text, range.start);
                let mut annotation = AnnotationKind::Primary.span(range.start - line.start..range.end - line.start);
                if !diagnostic.label.is_empty() {
                    annotation = annotation.label(diagnostic.label.as_str());
                }
                let snippet = Snippet::source(&source.text[line]).line_start(first);
                title.element(snippet.path(source.name.as_str()).annotation(annotation))
            }
            None => Group::with_title(title),
        };
        let hint = diagnostic.hint.as_deref().map(shortened);
        if let Some(hint) = &hint {
            group = group.element(Level::HELP.message(hint.as_ref()));
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

/// The line that holds a byte, and its number; the end of a text belongs to its last line that is not empty. Only this much is
/// looked at where a fault is shown: the text may be long, and the faults many.
fn line_at(text: &str, at: usize) -> (Range<usize>, usize) {
    let end = text[at..].find('\n').map_or(text.len(), |offset| at + offset);
    let is_beyond = at == text.len() && text.ends_with('\n');
    let before = if is_beyond { &text[..at - 1] } else { &text[..at] };
    let start = before.rfind('\n').map_or(0, |newline| newline + 1);
    (start..end, 1 + before[..start].bytes().filter(|byte| *byte == b'\n').count())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_faults_are_counted_and_the_first_of_them_shown() {
        let text: String = (0..30_000).map(|step| format!("step{step:05}: {{}}\n")).collect();
        let fault = |step: usize| {
            let start = step * 14;
            Diagnostic::at(Span { source: 0, start, end: start + 9 }, format!("fault {step}"))
        };
        let sources = vec![Source { name: "p.yaml".into(), text }];
        let shown = Diagnostics { sources, list: (0..30_000).rev().map(fault).collect() }.to_string();
        assert!(
            shown.contains("fault 99\n") && !shown.contains("fault 100\n") && shown.contains("p.yaml:100:1"),
            "{shown}"
        );
        assert!(shown.ends_with("30000 errors, of which the first 100 are shown; nothing was run"), "{shown}");
    }

    #[test]
    fn lines_are_found_at_their_ends_too() {
        let text = "a\nbc\n\nd\n";
        let found = |at: usize| {
            let (line, number) = line_at(text, at);
            (&text[line], number)
        };
        assert_eq!([found(0), found(1), found(2), found(4)], [("a", 1), ("a", 1), ("bc", 2), ("bc", 2)]);
        assert_eq!([found(5), found(6), found(7), found(8)], [("", 3), ("d", 4), ("d", 4), ("d\n", 4)]);
        assert_eq!(line_at("", 0), (0..0, 1));
    }

    #[test]
    fn long_words_and_long_lists_stay_short() {
        let (key, other) = ("k".repeat(1 << 20), "l".repeat(1 << 20));
        assert_eq!(nearest(&key, &[&other, "k"]), None);
        let names: Vec<String> = (0..30_000).map(|name| format!("name{name}")).collect();
        let fault = Diagnostic::general(key).suggest("x", names.iter().map(String::as_str));
        assert!(fault.hint.as_ref().unwrap().ends_with("name19, … and 29980 more"), "{:?}", fault.hint);
        assert!(Diagnostics { sources: Vec::new(), list: vec![fault] }.to_string().len() < 3000);
        assert_eq!(nearest("rasterize-dem", &["rasterise-dem", "import-mesh"]), Some("rasterise-dem"));
    }

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
