//! Dictionaries: what stands in files of a format, in libFuzzer's notation, a quoted word a line.

use std::path::Path;

/// The words of a dictionary; an unreadable line has none.
pub fn read(path: &Path) -> std::io::Result<Vec<Vec<u8>>> {
    let text = std::fs::read_to_string(path)?;
    Ok(text.lines().filter_map(word).collect())
}

/// The word between the first quote of a line and the last.
fn word(line: &str) -> Option<Vec<u8>> {
    let line = line.trim();
    if line.starts_with('#') {
        return None;
    }
    let (_, rest) = line.split_once('"')?;
    let (inside, _) = rest.rsplit_once('"')?;
    unescaped(inside.as_bytes())
}

fn unescaped(mut text: &[u8]) -> Option<Vec<u8>> {
    let mut word = Vec::new();
    while let Some((first, rest)) = text.split_first() {
        text = rest;
        if *first != b'\\' {
            word.push(*first);
            continue;
        }
        let (kind, rest) = text.split_first()?;
        text = rest;
        if *kind == b'x' {
            let (hex, rest) = text.split_at_checked(2)?;
            word.push(u8::from_str_radix(std::str::from_utf8(hex).ok()?, 16).ok()?);
            text = rest;
        } else {
            word.push(*kind);
        }
    }
    Some(word)
}
