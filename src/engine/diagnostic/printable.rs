//! Texts of others on a terminal.

use std::borrow::Cow;

/// A text as it may be put on a terminal: logs and names come from stores and files of others, and what a terminal takes for
/// a command, or what turns the direction of letters, is written out instead.
pub fn printable(text: &str) -> Cow<'_, str> {
    let turns = |letter: char| matches!(letter, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    let is_command = |letter: char| (letter.is_control() && !matches!(letter, '\n' | '\t')) || turns(letter);
    if !text.contains(is_command) {
        return text.into();
    }
    let written = |letter: char| match letter {
        // As JSON has it too, of which this may be a line: it writes out the control characters of ASCII by itself, and not these.
        _ if turns(letter) || (is_command(letter) && letter >= '\u{7f}') => format!("\\u{:04x}", u32::from(letter)),
        _ if is_command(letter) => letter.escape_default().to_string(),
        _ => letter.into(),
    };
    text.chars().map(written).collect::<String>().into()
}

#[cfg(test)]
mod tests {
    #[test]
    fn nothing_is_said_that_a_terminal_takes_for_a_command() {
        assert_eq!(super::printable("a\tb\nü"), "a\tb\nü");
        let turned = serde_json::json!({"text": "a\u{202e}b\u{2066}\u{7f}\u{9b}"}).to_string();
        let shown = super::printable(&turned);
        assert_eq!(shown, r#"{"text":"a\u202eb\u2066\u007f\u009b"}"#);
        let read: serde_json::Value = serde_json::from_str(&shown).unwrap();
        assert_eq!(read["text"], "a\u{202e}b\u{2066}\u{7f}\u{9b}");
        assert_eq!(super::printable("\u{1b}]0;title\u{7}\rend\u{9b}2J"), "\\u{1b}]0;title\\u{7}\\rend\\u009b2J");
    }
}
