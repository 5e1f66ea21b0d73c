//! What is probably wrong with a text that is no YAML, in words that need no knowledge of YAML: the usual slips.

use std::ops::Range;

use super::outline;

/// A slip: the bytes at fault, what is wrong, and the way out.
#[derive(Debug, PartialEq, Eq)]
pub struct Slip {
    /// The bytes at fault.
    pub bytes: Range<usize>,
    /// What is wrong, in words that need no knowledge of YAML.
    pub message: String,
    /// What the user can do about it.
    pub hint: String,
}

/// The slip behind a fault that a YAML reader found at byte `at`, for `reason`; `None` where it is none of the usual ones.
pub fn slip(text: &str, at: usize, reason: &str) -> Option<Slip> {
    let at = (0..=at.min(text.len())).rev().find(|at| text.is_char_boundary(*at)).unwrap_or(0);
    let of_escape = reason.contains("escape character") || reason.contains("hexadecimal");
    of_escape
        .then(|| escape(text, at))
        .flatten()
        .or_else(|| {
            let (line, number) = line_at(text, at);
            tab(text, &line, number)
        })
        .or_else(|| pick(text, at))
        .or_else(|| reason.contains("misplaced bracket").then(|| surplus(text, at)).flatten())
        .or_else(|| reason.contains("flow").then(|| missing_colon(text, at).or_else(|| unclosed(text, at))).flatten())
        .or_else(|| reason.contains("not YAML").then(|| outline::slip(text, at)).flatten())
}

/// The bytes of the line that holds a byte, and its number from one.
fn line_at(text: &str, at: usize) -> (Range<usize>, usize) {
    let start = text[..at].rfind('\n').map_or(0, |end| end + 1);
    let end = text[at..].find('\n').map_or(text.len(), |end| at + end);
    (start..end, text[..start].matches('\n').count() + 1)
}

/// A tab in front of what a line begins with.
pub fn tab(text: &str, line: &Range<usize>, number: usize) -> Option<Slip> {
    let own = &text[line.clone()];
    let indent = own.len() - own.trim_start_matches([' ', '\t']).len();
    let place = line.start + own[..indent].find('\t')?;
    let message = format!("line {number} is indented with a tab, and YAML takes spaces only");
    Some(Slip { bytes: place..place + 1, message, hint: "put two spaces in place of each tab".to_owned() })
}

/// `"C:\Daten"`: in double quotes a backslash and what follows stand for another character, and not all of them do.
fn escape(text: &str, at: usize) -> Option<Slip> {
    const KNOWN: &str = "0abt\tnvfre \"/\\N_LPxuU\n\r";
    let open = at + text[at..].find('"')? + 1;
    let mut chars = text[open..].char_indices();
    while let Some((place, c)) = chars.next() {
        match c {
            '"' => return None,
            '\\' => {
                let (_, next) = chars.next()?;
                let (start, end) = (open + place, open + place + 1 + next.len_utf8());
                let digits =
                    [('x', 2), ('u', 4), ('U', 8)].iter().find(|(c, _)| *c == next).map_or(0, |(_, count)| *count);
                let found = text[end..].chars().take(digits).filter(char::is_ascii_hexdigit).count();
                if !KNOWN.contains(next) || found < digits {
                    let bytes = start..end;
                    let message = format!(
                        "the backslash of `{}` in double quotes does not stand for itself",
                        &text[bytes.clone()]
                    );
                    let hint = "put single quotes around the text, or write `/` for each backslash of a path";
                    return Some(Slip { bytes, message, hint: hint.to_owned() });
                }
            }
            _ => {}
        }
    }
    None
}

/// `step.port[axis=item]` without quotes between braces: the bracket begins a list.
fn pick(text: &str, at: usize) -> Option<Slip> {
    let (line, _) = line_at(text, at);
    let is_word = |c: char| c.is_alphanumeric() || matches!(c, '_' | '-' | '.');
    for (open, _) in text[line.clone()].match_indices('[') {
        let open = line.start + open;
        let head = text[line.start..open].rsplit(|c| !is_word(c)).next().unwrap_or_default();
        let Some(length) = text[open..line.end].find(']') else { continue };
        let start = open - head.len();
        let is_quoted = text[..start].ends_with(['"', '\'']);
        if head.contains('.') && text[open..open + length].contains('=') && !is_quoted {
            let name = &text[start..=open + length];
            let message = format!("`{name}` without quotes cannot stand between braces or brackets");
            return Some(Slip {
                bytes: start..open + length + 1,
                message,
                hint: format!("put quotes around it: \"{name}\""),
            });
        }
    }
    None
}

fn surplus(text: &str, at: usize) -> Option<Slip> {
    let place = [at, at.saturating_sub(1)]
        .into_iter()
        .find(|at| text.get(*at..).is_some_and(|rest| rest.starts_with(['}', ']'])))?;
    let bracket = &text[place..=place];
    let message = format!("this `{bracket}` closes nothing");
    Some(Slip {
        bytes: place..place + 1,
        message,
        hint: "remove it, or add the bracket that it is to close".to_owned(),
    })
}

/// `with {` for `with: {`.
fn missing_colon(text: &str, at: usize) -> Option<Slip> {
    let (line, _) = line_at(text, at);
    let before = text[line.start..at].trim_end();
    let before = before.strip_suffix('=').unwrap_or(before).trim_end();
    let key = before.rsplit(|c: char| !(c.is_alphanumeric() || c == '_')).next().filter(|key| !key.is_empty())?;
    if !text[at..].starts_with(['{', '[']) {
        return None;
    }
    let start = line.start + before.len() - key.len();
    let message = format!("a colon is missing after `{key}`");
    Some(Slip { bytes: start..start + key.len(), message, hint: format!("write `{key}: {}`", &text[at..=at]) })
}

/// A bracket of an earlier line that is still open.
fn unclosed(text: &str, at: usize) -> Option<Slip> {
    let open = still_open(&text[..at]);
    // Where every bracket of the text is closed, none is missing.
    let place = *open.last().filter(|_| !still_open(text).is_empty())?;
    let ((_, number), (_, here)) = (line_at(text, place), line_at(text, at));
    if number == here {
        return None;
    }
    let bracket = &text[place..=place];
    let close = if bracket == "{" { "}" } else { "]" };
    let message = format!("the `{bracket}` of line {number} is not closed");
    Some(Slip { bytes: place..place + 1, message, hint: format!("add `{close}` where it ends, before line {here}") })
}

/// The brackets of a text that are not closed in it.
fn still_open(text: &str) -> Vec<usize> {
    let mut open = Vec::new();
    let mut quote = None;
    let mut before = '\n';
    let mut in_comment = false;
    for (place, c) in text.char_indices() {
        match (c, quote) {
            ('\n', _) => in_comment = false,
            _ if in_comment => {}
            (_, Some(mark)) => quote = Some(mark).filter(|mark| *mark != c),
            ('"' | '\'', None) if !before.is_alphanumeric() => quote = Some(c),
            ('#', None) if before.is_whitespace() => in_comment = true,
            ('{' | '[', None) => open.push(place),
            ('}' | ']', None) => drop(open.pop()),
            _ => {}
        }
        before = c;
    }
    open
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(text: &str, mark: &str, reason: &str) -> String {
        slip(text, text.find(mark).unwrap(), reason).map_or_else(String::new, |slip| slip.message)
    }

    #[test]
    fn the_usual_slips_are_called_by_their_name() {
        let flow = "while parsing a flow mapping, did not find expected ',' or '}'";
        assert!(told("a:\n\tb: 1\n", "b", "").starts_with("line 2 is indented with a tab"));
        let picked = slip("x: {reference: dem.raster[epoch=pre], b: c}", 25, flow).unwrap();
        assert!(picked.message.starts_with("`dem.raster[epoch=pre]` without quotes") && picked.bytes == (15..36));
        assert_eq!(told("a: {b: 1}}\n", "}\n", "misplaced bracket"), "this `}` closes nothing");
        assert_eq!(told("a: {in: {b: c}, with {d: 1}}", "{d", flow), "a colon is missing after `with`");
        assert_eq!(told("a: {b: 1 # {\nc: 2\n", "c: 2", flow), "the `{` of line 1 is not closed");
        assert_eq!(told("x: \"a.b[c=d]\" y", "y", ""), "");
        let escape = "while parsing a quoted scalar, found unknown escape character";
        let path = slip(r#"a: {path: "C:\new\Daten\a.ply"}"#, 10, escape).unwrap();
        assert!(
            path.message.starts_with(r"the backslash of `\D` in double quotes") && path.bytes == (17..19),
            "{path:?}"
        );
        let hex = "while parsing a quoted scalar, did not find expected hexadecimal number";
        assert!(told(r#"a: "C:\users\a.ply""#, "\"C", hex).contains(r"`\u`"));
    }

    #[test]
    fn any_place_in_any_text_is_looked_at_without_panic() {
        let text = "é: {a [\"\\ü\n\t}] # ü\n  'x: [b.c[d=ß]}\n\"\\x";
        for at in 0..=text.len() + 2 {
            for reason in ["misplaced bracket", "flow", "not YAML", "escape character", ""] {
                let _ = slip(text, at, reason);
            }
        }
    }
}
