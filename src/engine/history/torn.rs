//! What can be read of a manifest that is not whole.

use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use rockface_cache::Digest;

use super::HistoryError;

/// Digits of a digest as it is written.
const DIGITS: usize = 64;

/// Every digest that stands in the manifest of a run folder, whole or torn, and when that was written, seconds since 1970.
///
/// # Errors
///
/// When the file cannot be read.
pub fn digests_told(folder: &Path) -> Result<(Vec<Digest>, u64), HistoryError> {
    let path = folder.join(super::MANIFEST_FILE);
    let text = std::fs::read(&path).map_err(HistoryError::io("read", &path))?;
    let written = std::fs::metadata(&path).and_then(|meta| meta.modified()).unwrap_or(SystemTime::UNIX_EPOCH);
    let words = text.split(|byte| !byte.is_ascii_hexdigit()).filter(|word| word.len() == DIGITS);
    let digests = words.filter_map(|word| std::str::from_utf8(word).ok()?.parse().ok()).collect();
    Ok((digests, written.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stands_before_the_tear_is_read() {
        let folder = tempfile::tempdir().unwrap();
        assert!(digests_told(folder.path()).is_err());
        let (one, other) = (Digest::of(b"one"), Digest::of(b"other"));
        let text = format!("{{\"steps\": [\n {{\"key\": \"{one}\", \"log\": null}},\n {{\"key\": \"{other}");
        std::fs::write(folder.path().join("run.json"), &text[..text.len() - 1]).unwrap();
        let (digests, written_s) = digests_told(folder.path()).unwrap();
        assert_eq!(digests, [one]);
        assert!(written_s > 0);
        std::fs::write(folder.path().join("run.json"), [0, 0xff, 0]).unwrap();
        assert_eq!(digests_told(folder.path()).unwrap().0, []);
    }
}
