//! Slips in the outline of a YAML text: lines that begin in a wrong column, keys without a colon, tabs. The reader of YAML finds them late and far off,
//! since a line that is out of place may go on with the value before it.

use std::ops::Range;

use super::first_words::{Slip, tab};

/// The first slip in the lines up to the one at byte `at`, or a tab in the line after it.
pub fn slip(text: &str, at: usize) -> Option<Slip> {
    let mut outline =
        Outline { text, levels: Vec::new(), former: None, scalar: None, block: None, flow: Flow::default() };
    let mut start = 0;
    for (number, line) in (1..).zip(text.split_inclusive('\n')) {
        let bytes = start..start + line.trim_end().len();
        let after = start > at;
        start += line.len();
        let content = text[bytes.clone()].trim_start();
        if content.is_empty() || content.starts_with('#') || ["---", "..."].contains(&content) {
            continue;
        }
        let found = outline.line(number, &bytes, after);
        if found.is_some() || after {
            return found;
        }
    }
    None
}

/// A line of block style.
#[derive(Debug, Clone)]
struct Line {
    number: usize,
    /// Column of its first key.
    column: usize,
    /// Bytes from there to its end.
    bytes: Range<usize>,
    /// Whether it is a key without a value in its line.
    is_open: bool,
}

struct Outline<'a> {
    text: &'a str,
    /// Columns of the maps that are open, the innermost last.
    levels: Vec<usize>,
    /// The line of block style before, with a key or in a list.
    former: Option<Line>,
    /// A line without a colon below a key without a value: its value, or the first key of a map whose colon is missing.
    scalar: Option<Line>,
    /// Column of the key of a block of text (`|` or `>`), whose lines are not looked at.
    block: Option<usize>,
    flow: Flow,
}

impl Outline<'_> {
    fn line(&mut self, number: usize, bytes: &Range<usize>, only_tab: bool) -> Option<Slip> {
        if self.flow.is_open() {
            return if only_tab { None } else { self.flow.enter(self.text, bytes.clone()) };
        }
        let line = &self.text[bytes.clone()];
        let indent = line.len() - line.trim_start_matches([' ', '\t']).len();
        if self.block.is_some_and(|column| indent > column) {
            return None;
        }
        self.block = None;
        if let Some(tab) = tab(self.text, bytes, number) {
            return Some(tab);
        }
        if only_tab {
            return None;
        }
        if line[indent..].starts_with('-') && is_item_without_space(&line[indent..]) {
            let place = bytes.start + indent;
            let hint = format!("write `- {}`", line[indent + 1..].trim());
            return Some(Slip { bytes: place..place + 1, message: "a space is missing after `-`".to_owned(), hint });
        }
        let mut column = indent;
        while let Some(rest) = line[column..].strip_prefix('-').filter(|rest| rest.is_empty() || rest.starts_with(' '))
        {
            self.levels.retain(|level| *level <= column);
            column = line.len() - rest.trim_start().len();
        }
        let in_list = column > indent;
        if in_list && without_marks(&line[column..]).is_empty() {
            // What the item is begins in a line below, deeper than its dash.
            self.former = Some(Line { number, column: indent, bytes: bytes.clone(), is_open: true });
            self.scalar = None;
            return None;
        }
        let value = value_of(&line[column..]);
        let own =
            Line { number, column, bytes: bytes.start + column..bytes.end, is_open: value.is_some_and(str::is_empty) };
        let found = match value {
            Some(_) => self.key(&own, in_list),
            None if in_list => None,
            None => self.without_colon(&own),
        };
        if found.is_some() {
            return found;
        }
        match value {
            Some(_) => (self.former, self.scalar) = (Some(own), None),
            None if in_list => {
                self.levels.push(column);
                (self.former, self.scalar) = (Some(own.clone()), Some(own));
            }
            None => {}
        }
        let value = value.unwrap_or(&line[column..]);
        if value.starts_with(['|', '>']) {
            self.block = Some(indent);
            return None;
        }
        let offset = bytes.end - value.len();
        self.flow.enter(self.text, offset..bytes.end)
    }

    /// A line with a key: in the column of a map that is open, or deeper below a key without a value.
    fn key(&mut self, own: &Line, in_list: bool) -> Option<Slip> {
        if in_list {
            self.levels.push(own.column);
            return None;
        }
        if let Some(scalar) = self.scalar.take().filter(|scalar| scalar.column == own.column) {
            return self.missing_colon(&scalar);
        }
        let Some(former) = self.former.clone() else {
            self.levels.push(own.column);
            return None;
        };
        if own.column > former.column {
            if former.is_open {
                self.levels.push(own.column);
                return None;
            }
            return Some(crooked(
                own,
                &former,
                "a key that has its value in its line has no keys below it, and keys of one map begin in one column",
            ));
        }
        self.levels.retain(|level| *level <= own.column);
        let is_level = self.levels.last() == Some(&own.column);
        (!is_level && own.column != former.column).then(|| crooked(own, &former, "keys of one map begin in one column"))
    }

    /// A line that is neither a key nor in a list: a value, or the rest of one, where it is deeper than the key before it.
    fn without_colon(&mut self, own: &Line) -> Option<Slip> {
        match &self.former {
            None => {
                self.scalar = Some(own.clone());
                None
            }
            Some(former) if own.column > former.column => {
                if former.is_open && self.scalar.is_none() {
                    self.scalar = Some(own.clone());
                }
                None
            }
            _ if self.levels.contains(&own.column) => self.missing_colon(own),
            _ => None,
        }
    }

    fn missing_colon(&self, own: &Line) -> Option<Slip> {
        let line = &self.text[own.bytes.clone()];
        let name = line.find(|c: char| !is_word(c)).map_or(line, |end| &line[..end]);
        let rest = line[name.len()..].trim_start();
        if !name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_') {
            return None;
        }
        let bytes = own.bytes.start..own.bytes.start + name.len();
        if let Some(value) = rest.strip_prefix(':') {
            let message = format!("a space is missing after the colon of `{name}`");
            return Some(Slip { bytes, message, hint: format!("write `{name}: {value}`") });
        }
        let value = rest.strip_prefix('=').unwrap_or(rest).trim();
        let hint = if value.is_empty() { format!("write `{name}:`") } else { format!("write `{name}: {value}`") };
        Some(Slip { bytes, message: format!("a colon is missing after `{name}`"), hint })
    }
}

/// Whether a line is `-x: 1` or `-{`, where a list begins or goes on.
fn is_item_without_space(line: &str) -> bool {
    let rest = &line[1..];
    let is_named = rest.starts_with(|c: char| c.is_ascii_alphabetic()) && value_of(rest).is_some();
    is_named || rest.starts_with(['{', '['])
}

fn crooked(own: &Line, former: &Line, hint: &str) -> Slip {
    let spaces = |count: usize| format!("{count} space{}", if count == 1 { "" } else { "s" });
    let message = format!(
        "line {} begins after {}, line {} before it after {}",
        own.number,
        spaces(own.column),
        former.number,
        former.column
    );
    Slip { bytes: own.bytes.clone(), message, hint: hint.to_owned() }
}

const fn is_word(c: char) -> bool {
    c.is_ascii_alphanumeric() || matches!(c, '_' | '-')
}

/// What follows the key of a line, without a comment, an anchor and a tag; `None` where the line has no key.
fn value_of(line: &str) -> Option<&str> {
    let end = match line.chars().next()? {
        quote @ ('"' | '\'') => {
            let end = line[1..].find(quote)? + 2;
            line[end..].starts_with(':').then_some(end)?
        }
        '{' | '[' | '}' | ']' => return None,
        _ => line
            .match_indices(':')
            .map(|(at, _)| at)
            .find(|at| line[at + 1..].is_empty() || line[at + 1..].starts_with([' ', '\t']))?,
    };
    if line[..end].contains(" #") {
        return None;
    }
    Some(without_marks(&line[end + 1..]))
}

/// A value without the anchor and the tag before it, and without a comment in its place.
fn without_marks(value: &str) -> &str {
    let mut value = value.trim_start();
    while value.starts_with(['&', '!']) {
        value = value.find(' ').map_or("", |space| value[space..].trim_start());
    }
    if value.starts_with('#') { "" } else { value }
}

/// Brackets and quotes that are open, over the ends of lines.
#[derive(Default)]
struct Flow {
    /// Where the text since the last separator begins, for each bracket that is open, and whether that is a brace.
    brackets: Vec<(usize, bool)>,
    quote: Option<char>,
}

impl Flow {
    fn is_open(&self) -> bool {
        self.quote.is_some() || !self.brackets.is_empty()
    }

    /// Goes through a part of a line; a word before a quote or a bracket, without a colon between them, is a key whose colon is missing.
    fn enter(&mut self, text: &str, bytes: Range<usize>) -> Option<Slip> {
        let mut before = ' ';
        let mut letters = text[bytes.clone()].char_indices().peekable();
        while let Some((place, c)) = letters.next() {
            let at = bytes.start + place;
            match (c, self.quote) {
                // What a backslash stands before, and two single quotes, end no text.
                ('\\', Some('"')) => drop(letters.next()),
                ('\'', Some('\'')) if letters.peek().is_some_and(|(_, next)| *next == '\'') => drop(letters.next()),
                (_, Some(quote)) => self.quote = Some(quote).filter(|quote| *quote != c),
                ('#', None) if before.is_whitespace() => return None,
                ('"' | '\'' | '{' | '[', None) if self.brackets.is_empty() && place > 0 => return None,
                ('"' | '\'' | '{' | '[', None) => {
                    if let Some((start, true)) = self.brackets.last()
                        && let Some(slip) = key_without_colon(text, *start, at)
                    {
                        return Some(slip);
                    }
                    if matches!(c, '"' | '\'') {
                        self.quote = Some(c).filter(|_| !is_word(before));
                    } else {
                        self.brackets.push((at + 1, c == '{'));
                    }
                }
                ('}' | ']', None) => drop(self.brackets.pop()),
                (',', None) => self.brackets.last_mut().into_iter().for_each(|(start, _)| *start = at + 1),
                _ => {}
            }
            before = c;
        }
        None
    }
}

/// `cell_m "${cell_m}"` between braces.
fn key_without_colon(text: &str, start: usize, at: usize) -> Option<Slip> {
    let before = text[start..at].trim_start();
    let name = before.trim_end();
    let name = name.strip_suffix('=').unwrap_or(name).trim_end();
    if name.len() == before.len() || name.is_empty() || !name.chars().all(is_word) {
        return None;
    }
    let from = at - before.len();
    let message = format!("a colon is missing after `{name}`");
    Some(Slip { bytes: from..from + name.len(), message, hint: format!("write `{name}: {}…`", &text[at..=at]) })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The message for the slip in a text that is read up to the line with `mark`.
    fn told(text: &str, mark: &str) -> String {
        slip(text, text.find(mark).unwrap()).map_or_else(String::new, |slip| slip.message)
    }

    const HEAD: &str = "rockface: 1\nsteps:\n  face:\n";

    #[test]
    fn a_tab_in_the_line_after_the_fault_is_named() {
        let text = format!("{HEAD}    stage: a\n\n  # now\n\twith:\n      width_m: 4\n");
        assert_eq!(told(&text, "stage"), "line 7 is indented with a tab, and YAML takes spaces only");
        let text = format!("{HEAD}    stage: a\n    \twith: {{b: 1}}\n");
        assert_eq!(told(&text, "stage"), "line 5 is indented with a tab, and YAML takes spaces only");
    }

    #[test]
    fn lines_in_a_wrong_column_are_named_with_the_line_before() {
        let deeper = format!("{HEAD}    stage: a\n     with:\n      width_m: 4\n");
        assert_eq!(told(&deeper, "with"), "line 5 begins after 5 spaces, line 4 before it after 4");
        let between = format!("{HEAD}    with:\n      width_m: 4\n     height_m: 3\n");
        assert_eq!(told(&between, "height_m"), "line 6 begins after 5 spaces, line 5 before it after 6");
        // The line above the one that YAML complains of.
        let above = format!("{HEAD}    with:\n      width_m: 4\n    height_m: 3\n      spacing_m: 0.05\n");
        assert_eq!(told(&above, "spacing_m"), "line 7 begins after 6 spaces, line 6 before it after 4");
    }

    #[test]
    fn keys_without_a_colon_are_named() {
        for (line, message, hint) in [
            ("width_m 4", "a colon is missing after `width_m`", "write `width_m: 4`"),
            ("width_m:4", "a space is missing after the colon of `width_m`", "write `width_m: 4`"),
            ("width_m = 4", "a colon is missing after `width_m`", "write `width_m: 4`"),
        ] {
            let first = format!("{HEAD}    with:\n      {line}\n      height_m: 3\n");
            let last = format!("{HEAD}    with:\n      height_m: 3\n      {line}\n");
            for (text, mark) in [(&first, "height_m"), (&last, line)] {
                let slip = slip(text, text.find(mark).unwrap()).unwrap();
                assert_eq!((slip.message.as_str(), slip.hint.as_str()), (message, hint), "{text}");
                assert_eq!(&text[slip.bytes], "width_m");
            }
        }
        assert_eq!(
            told(&format!("{HEAD}    stage: a\n    with\n      b: 1\n"), "with"),
            "a colon is missing after `with`"
        );
        assert_eq!(told("rockface 1\nname: a\n", "name"), "a colon is missing after `rockface`");
        let item = format!("{HEAD}    joints:\n      - dip_deg:70\n        direction_deg: 10\n");
        assert_eq!(told(&item, "direction"), "a space is missing after the colon of `dip_deg`");
        let dash = format!("{HEAD}    joints:\n      - a: 1\n      -dip_deg: 20\n        direction_deg: 10\n");
        assert_eq!(told(&dash, "direction"), "a space is missing after `-`");
        let equals = format!("{HEAD}    with: {{matching = {{noise: learnt}}}}\n    in: {{a: \"b\"}}\n");
        assert_eq!(told(&equals, "in:"), "a colon is missing after `matching`");
        let flow = format!("{HEAD}    with: {{cell_m \"${{cell_m}}\", method: tin}}\n    in: {{a: \"b\"}}\n");
        assert_eq!(told(&flow, "in:"), "a colon is missing after `cell_m`");
    }

    #[test]
    fn what_is_in_its_place_is_left_alone() {
        let text = "rockface: 1\nparams:\n  a: {type: text, default: \"x: y\",\n   doc: it's so}\n  b: &b [1, 2] # c: d\n  t: |\n   free text\n     here\n\
                    axes:\n- a: 1\n  b: \"two\n lines: here\"\n-  - 3\n   - c: 1\nsteps:\n  face: &f\n    stage: word\n      goes on\n    'with': !t\n      x:\n        text\n      <<: *b\nend: 1\n";
        let others = "---\na:\n  -\n   x: 1\n   y: 2\n  - &z\n    x: \"it \\\"is\n b: c\"\n    y: 'it''s\n d: e'\n  - [rock 'n' roll, b]\n  - plain\nend: 1\n";
        for mark in ["x: 1", "y: 2", "&z", "b: c", "d: e", "roll", "plain", "end"] {
            assert_eq!(told(others, mark), "", "{mark}");
        }
        for mark in ["doc", "free", "axes", "lines", "steps", "stage", "goes", "x:", "end"] {
            assert_eq!(told(text, mark), "", "{mark}");
        }
    }

    #[test]
    fn any_place_in_any_text_is_looked_at_without_panic() {
        let text = "é: {a [\"\\ü\n\t}] # ü\n  'x: [b.c[d=ß]}\n- - ü\n -é: |\n\"\\x: \n'é\n";
        for cut in (0..=text.len()).filter(|cut| text.is_char_boundary(*cut)) {
            for at in 0..=cut + 2 {
                let _ = slip(&text[..cut], at);
                let _ = slip(&text[cut..], at);
            }
        }
    }
}
