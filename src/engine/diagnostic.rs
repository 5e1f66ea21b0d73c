//! Messages about a pipeline that show the place, the value and the way out.

mod printable;

use std::borrow::Cow;
use std::collections::HashSet;
use std::fmt;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use annotate_snippets::{AnnotationKind, Group, Level, Renderer, Snippet, Title};

pub use printable::printable;

/// A text that diagnostics can point into: a file, one `--set` of the command line, or a part as one step uses it.
#[derive(Debug, Clone)]
pub struct Source {
    /// What it is called in messages.
    pub name: String,
    /// The whole text, which places point into.
    pub text: Arc<str>,
    /// What kind of text it is.
    pub origin: Origin,
}

/// Where a text comes from.
#[derive(Debug, Clone)]
pub enum Origin {
    /// A file in this folder; paths in its steps are relative to that.
    File(Arc<Path>),
    /// A part that comes with the program.
    Shipped,
    /// An option of the command line, such as `--set`.
    Override,
    /// The text of a part once more, for one use of it.
    Use {
        /// Where the use stands.
        at: Span,
        /// What the names of its steps begin with, such as `before/`.
        prefix: Arc<str>,
        /// Paths in its steps are relative to this folder.
        folder: Arc<Path>,
    },
}

impl Source {
    /// A text of the command line.
    pub fn given(option: &str, text: &str) -> Self {
        Self { name: option.to_owned(), text: text.into(), origin: Origin::Override }
    }

    /// A file in a folder.
    pub fn file(name: String, text: &str, folder: impl Into<Arc<Path>>) -> Self {
        Self { name, text: text.into(), origin: Origin::File(folder.into()) }
    }

    /// The folder that paths in its steps are relative to.
    pub fn folder(&self) -> Option<&Arc<Path>> {
        match &self.origin {
            Origin::File(folder) | Origin::Use { folder, .. } => Some(folder),
            Origin::Shipped | Origin::Override => None,
        }
    }
}

/// A stretch of a source, in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Span {
    /// Index of the source.
    pub source: usize,
    /// The first byte of the stretch, counted from the start of the text.
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
    /// What the user can do about it.
    pub hint: Option<String>,
    /// Another place that has to do with it, and why.
    pub also: Option<Box<(Span, String)>>,
}

impl Diagnostic {
    /// A fault at a place.
    pub fn at(span: Span, message: impl Into<String>) -> Self {
        Self { message: message.into(), span: Some(span), label: String::new(), hint: None, also: None }
    }

    /// A fault of the whole pipeline.
    pub fn general(message: impl Into<String>) -> Self {
        Self { message: message.into(), span: None, label: String::new(), hint: None, also: None }
    }

    /// Adds short text under the caret.
    #[must_use]
    pub fn label(mut self, label: impl Into<String>) -> Self {
        self.label = label.into();
        self
    }

    /// Names another place that has to do with it.
    #[must_use]
    pub fn also(mut self, span: Span, why: impl Into<String>) -> Self {
        self.also = Some(Box::new((span, why.into())));
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
fn shortened(text: &str) -> Cow<'_, str> {
    if text.len() <= MESSAGE_BYTES {
        return text.into();
    }
    let end = (0..=MESSAGE_BYTES).rev().find(|end| text.is_char_boundary(*end)).unwrap_or(0);
    format!("{}… ({} bytes)", &text[..end], text.len()).into()
}

/// A message as it is shown: short, and with nothing that a terminal takes for a command.
fn shown(text: &str) -> Cow<'_, str> {
    match shortened(text) {
        Cow::Borrowed(text) => printable(text),
        Cow::Owned(text) => printable(&text).into_owned().into(),
    }
}

/// The closest known word, if any is close.
pub fn nearest<'a>(given: &str, known: &[&'a str]) -> Option<&'a str> {
    // What differs in capitals only is near, however many there are.
    if let Some(same) = known.iter().copied().find(|word| word.eq_ignore_ascii_case(given)) {
        return Some(same);
    }
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
    /// Every text of the pipeline; the `source` of a [`Span`] is an index into this list.
    pub sources: Vec<Source>,
    /// The faults, in the order of the text.
    pub list: Vec<Diagnostic>,
}

impl Diagnostics {
    /// Renders every fault with its source line and caret; `colour` for a terminal.
    pub fn render(&self, colour: bool) -> String {
        let renderer = if colour { Renderer::styled() } else { Renderer::plain() };
        let ordered = self.told_once();
        let texts: Vec<String> = ordered.iter().take(SHOWN).map(|d| self.render_one(&renderer, d)).collect();
        let count = match ordered.len() {
            1 => "1 error; nothing was run".to_owned(),
            n if n > SHOWN => format!("{n} errors, of which the first {SHOWN} are shown; nothing was run"),
            n => format!("{n} errors; nothing was run"),
        };
        format!("{}\n\n{count}", texts.join("\n\n"))
    }

    /// The faults in the order of the texts. A fault in a part is reported at its first use that shows it.
    pub fn told_once(&self) -> Vec<&Diagnostic> {
        let mut ordered: Vec<&Diagnostic> = self.list.iter().collect();
        ordered.sort_by_key(|d| d.span.map(|span| (span.source, span.start)));
        let mut seen = HashSet::new();
        ordered.retain(|fault| self.in_part(fault).is_none_or(|known| seen.insert(known)));
        ordered
    }

    /// What tells a fault in a part from others of it: the text, the place, and the message without the names of the use.
    fn in_part<'d>(&'d self, fault: &'d Diagnostic) -> Option<(&'d str, usize, String)> {
        let span = fault.span?;
        let source = self.sources.get(span.source)?;
        let Origin::Use { prefix, .. } = &source.origin else { return None };
        Some((source.name.as_str(), span.start, fault.message.replace(prefix.as_ref(), "")))
    }

    fn render_one(&self, renderer: &Renderer, diagnostic: &Diagnostic) -> String {
        let title = Level::ERROR.primary_title(shown(&diagnostic.message));
        let mut notes: Vec<(Span, &str)> = Vec::new();
        let place = diagnostic.span.and_then(|span| Some((self.sources.get(span.source)?, span)));
        let mut group = match place {
            Some((source, span)) => {
                let span = of_mention(&source.text, span, &diagnostic.message);
                let mut used = source;
                while let Origin::Use { at, .. } = &used.origin {
                    notes.push((*at, "used here"));
                    let Some(outer) = self.sources.get(at.source) else { break };
                    used = outer;
                }
                snippet(title, source, span, AnnotationKind::Primary, &diagnostic.label)
            }
            None => Group::with_title(title),
        };
        notes.extend(diagnostic.also.as_deref().map(|(span, why)| (*span, why.as_str())));
        if let Some(hint) = &diagnostic.hint {
            group = group.element(Level::HELP.message(shown(hint)));
        }
        let noted = notes.iter().filter_map(|(span, why)| {
            let source = self.sources.get(span.source)?;
            Some(snippet(Level::NOTE.secondary_title(shown(why)), source, *span, AnnotationKind::Primary, ""))
        });
        let groups: Vec<Group> = std::iter::once(group).chain(noted).collect();
        renderer.render(&groups)
    }
}

/// A title with the line of a place below it.
fn snippet<'a>(title: Title<'a>, source: &'a Source, span: Span, kind: AnnotationKind, label: &'a str) -> Group<'a> {
    let range = visible(&source.text, span.start..span.end);
    let (mut line, first) = line_at(&source.text, range.start);
    if source.text[line.clone()].starts_with(MARK) && first == 1 {
        line.start += MARK.len_utf8();
    }
    let in_line = |at: usize| at.saturating_sub(line.start);
    let mut annotation = kind.span(in_line(range.start)..in_line(range.end));
    if !label.is_empty() {
        annotation = annotation.label(shown(label));
    }
    let snippet = Snippet::source(as_many_bytes(&source.text[line])).line_start(first);
    let name = printable(&source.name).replace('\n', "\\n");
    title.element(snippet.path(name).annotation(annotation))
}

/// The line of a source with places where they were. Pictures of the control characters of ASCII, and of letters that turn the
/// direction, come from what draws the line; there are others, and some terminals take commands from them.
fn as_many_bytes(line: &str) -> Cow<'_, str> {
    const FURTHER: std::ops::RangeInclusive<char> = '\u{80}'..='\u{9f}';
    let is_further = |letter: char| FURTHER.contains(&letter);
    if line.contains(is_further) { line.replace(is_further, "\u{b7}").into() } else { line.into() }
}

impl fmt::Display for Diagnostics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.render(false))
    }
}

impl std::error::Error for Diagnostics {}

/// The mark of UTF-8 with which some editors begin a text: it is no column of the first line.
pub const MARK: char = '\u{feff}';

/// The place of the mention `${name}` that a fault is about, where its value takes several lines: the value begins before that.
fn of_mention(text: &str, span: Span, message: &str) -> Span {
    let found = || {
        let name = message.split_once("`${")?.1.split_once('}')?.0;
        let value = text.get(span.start..span.end.min(text.len()))?.trim_end();
        let is_meant = |(at, _): &(usize, &str)| {
            let inner = value[at + 2..].split_once('}').map(|(inner, _)| inner.trim());
            inner == Some(name) && !value[..*at].ends_with('$')
        };
        let (at, _) = value.contains('\n').then(|| value.match_indices("${").find(is_meant)).flatten()?;
        let end = at + value[at..].find('}')? + 1;
        Some(Span { start: span.start + at, end: span.start + end, ..span })
    };
    found().unwrap_or(span)
}

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
        let sources = vec![Source::file("p.yaml".into(), &text, Path::new("."))];
        let shown = Diagnostics { sources, list: (0..30_000).rev().map(fault).collect() }.to_string();
        assert!(
            shown.contains("fault 99\n") && !shown.contains("fault 100\n") && shown.contains("p.yaml:100:1"),
            "{shown}"
        );
        assert!(shown.ends_with("30000 errors, of which the first 100 are shown; nothing was run"), "{shown}");
    }

    #[test]
    fn a_word_in_other_capitals_is_near() {
        assert_eq!(nearest("Face.PLY", &["base.ply", "face.ply"]), Some("face.ply"));
        assert_eq!(nearest("Face.PLY", &["base.ply", "rock.obj"]), None);
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
            sources: vec![Source::file("p.yaml".into(), &text, Path::new("."))],
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
    fn nothing_in_a_fault_is_taken_for_a_command_by_a_terminal() {
        let evil = "\u{1b}]0;T\u{7}\u{9b}2J\u{202e}\r";
        let text = format!("a: {evil} b\n");
        let span = Span { source: 0, start: 3 + evil.len() + 1, end: 3 + evil.len() + 2 };
        let fault = Diagnostic::at(span, evil).label(evil).hint(evil).also(span, evil);
        let sources = vec![Source::file(format!("p{evil}\n.yaml"), &text, Path::new("."))];
        let told = Diagnostics { sources, list: vec![fault, Diagnostic::general(evil)] };
        let plain = told.to_string();
        let is_command = |letter: &char| (letter.is_control() && *letter != '\n') || *letter == '\u{202e}';
        assert_eq!(plain.chars().find(is_command), None, "{plain:?}");
        // The place is that of the text as it is.
        assert!(plain.contains("\\n.yaml:1:16"), "{plain}");
        // All escapes are colours of the program.
        let coloured = told.render(true);
        let colours = coloured.split('\u{1b}').skip(1).all(|part| part.starts_with('['));
        assert!(colours && !coloured.contains(['\u{7}', '\u{9b}', '\u{202e}', '\r']), "{coloured:?}");
    }

    fn shown_at(text: &str, span: Span, message: &str) -> String {
        let sources = vec![Source::file("p.yaml".into(), text, Path::new("."))];
        Diagnostics { sources, list: vec![Diagnostic::at(span, message)] }.to_string()
    }

    #[test]
    fn the_mark_of_utf_8_is_no_column() {
        let text = "\u{feff}ab: 1\nc: 2\n";
        assert!(shown_at(text, Span { source: 0, start: 7, end: 8 }, "m").contains("p.yaml:1:5"));
        assert!(shown_at(text, Span { source: 0, start: 0, end: 1 }, "m").contains("p.yaml:1:1"));
        assert!(shown_at(text, Span { source: 0, start: 12, end: 13 }, "m").contains("p.yaml:2:4"));
    }

    #[test]
    fn a_mention_in_a_long_text_is_shown_on_its_line() {
        for text in [
            "a: >\n  $${no} one\n  two ${no}\n",
            "a: |-\n  one\n  two ${ no }\nb: 1\n",
            "a: \"one\n  two ${no}\"\n",
            "a: one\n  two ${no}\n",
        ] {
            let text = if text.lines().count() > 2 { text } else { &format!("x: 1\n{text}") };
            let span = crate::pipeline::Node::parse(text, 0).unwrap().get("a").unwrap().span;
            let shown = shown_at(text, span, "`${no}` names nothing");
            assert!(shown.contains("p.yaml:3:7"), "{text} {span:?} {shown}");
        }
    }

    #[test]
    fn a_span_beyond_the_text_is_no_panic() {
        assert_eq!(visible("ab\nö", 9..12), 5..5);
        assert_eq!(visible("ab\nö", 0..5), 0..2);
        assert_eq!(visible("ab\nö", 4..5), 3..5);
    }
}
