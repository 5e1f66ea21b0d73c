//! Files of a run folder: written whole or not at all.

use std::io::{self, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use tempfile::NamedTempFile;

use crate::run::RunError;

/// Whether nobody has asked for a stop.
pub(super) fn going_on(stop: &AtomicBool) -> Result<(), RunError> {
    if stop.load(Ordering::Relaxed) { Err(RunError::Interrupted) } else { Ok(()) }
}

/// Writes a whole file or none. It becomes durable with all others of the folder.
pub(super) fn write_file(path: &Path, bytes: &[u8]) -> Result<(), RunError> {
    put(staged(path, |file| file.write_all(bytes))?, path)
}

/// What is to be the file at `path`, written beside it; [`put`] gives it its name.
fn staged(path: &Path, write: impl FnOnce(&mut NamedTempFile) -> io::Result<()>) -> Result<NamedTempFile, RunError> {
    let write = || {
        let mut file = rockface_cache::readable_file(path.parent().unwrap_or(Path::new(".")))?;
        write(&mut file).map(|()| file)
    };
    write().map_err(failed(path))
}

/// What is to be the file at `path`, written and made durable beside it; [`put`] gives it its name.
pub(super) fn durable(
    path: &Path,
    write: impl FnOnce(&mut NamedTempFile) -> io::Result<()>,
) -> Result<NamedTempFile, RunError> {
    let file = staged(path, write)?;
    file.as_file().sync_all().map_err(failed(path))?;
    Ok(file)
}

/// Gives a finished file its name.
pub(super) fn put(file: NamedTempFile, path: &Path) -> Result<(), RunError> {
    file.persist(path).map(drop).map_err(|fault| failed(path)(fault.error))
}

/// The error of a file or folder that cannot be used.
pub(super) fn failed(path: &Path) -> impl FnOnce(std::io::Error) -> RunError + use<> {
    let path = path.to_owned();
    move |source| RunError::Folder { path, source }
}
