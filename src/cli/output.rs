//! What the program prints: results on standard output, warnings and errors on standard error. Neither ever panics.

use std::io::{self, ErrorKind, Write};
use std::sync::{Mutex, PoisonError};

/// Why standard output could not be written to, the first time; there is one standard output for the whole process.
static FAULT: Mutex<Option<io::Error>> = Mutex::new(None);

/// Writes a line to standard output. A reader that has gone away ends the writing quietly; whatever else keeps the text from
/// being written, such as a full disk, is kept for [`fault`].
pub fn say(text: &str) {
    note(writeln!(io::stdout(), "{}", rockface_engine::diagnostic::printable(text)));
}

/// Notes what came of writing to standard output.
pub fn note(written: io::Result<()>) {
    if let Err(error) = written.and_then(|()| io::stdout().flush())
        && error.kind() != ErrorKind::BrokenPipe
    {
        FAULT.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
    }
}

/// Why something that was to be said could not be written, told once.
pub fn fault() -> Option<io::Error> {
    FAULT.lock().unwrap_or_else(PoisonError::into_inner).take()
}

/// Writes a line to standard error. Where that cannot be written there is nobody left to tell.
pub fn complain(text: &str) {
    let _ = writeln!(io::stderr(), "{}", rockface_engine::diagnostic::printable(text));
}

/// The same for what has colours: all but the escape character that begins them is written out.
pub fn complain_in_colour(text: &str) {
    let parts: Vec<_> = text.split('\u{1b}').map(rockface_engine::diagnostic::printable).collect();
    let _ = writeln!(io::stderr(), "{}", parts.join("\u{1b}"));
}

/// Whether no colours are wanted. See <https://no-color.org>: any text but an empty one.
pub fn is_plain() -> bool {
    std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty())
}
