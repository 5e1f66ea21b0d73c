//! The files cases are made of: sound ones in `corpus/`, such as once brought a reader down in `regressions/`.

use std::io;
use std::path::{Path, PathBuf};

use crate::mutate::Material;
use crate::{Target, words};

/// The folder of this crate: its corpus is there wherever the program is started.
pub fn home() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The folder of a target among `corpus`, `regressions` or `findings`.
pub fn folder(kind: &str, target: &Target) -> PathBuf {
    home().join(kind).join(target.name)
}

/// The files of a folder, sorted by name; none where there is no such folder.
///
/// # Errors
/// A folder that cannot be listed.
pub fn files(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let entries = match std::fs::read_dir(folder) {
        Err(fault) if fault.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries?,
    };
    let mut files = entries.map(|entry| Ok(entry?.path())).collect::<io::Result<Vec<_>>>()?;
    files.retain(|path| path.is_file());
    files.sort();
    Ok(files)
}

/// The sound files of a target and its regressions.
///
/// # Errors
/// A folder that cannot be listed.
pub fn known(target: &Target) -> io::Result<Vec<PathBuf>> {
    let mut known = files(&folder("corpus", target))?;
    known.extend(files(&folder("regressions", target))?);
    Ok(known)
}

/// What cases of a target are made of.
///
/// # Errors
/// A file that cannot be read.
pub fn material(target: &Target) -> io::Result<Material> {
    let files = known(target)?.iter().map(std::fs::read).collect::<io::Result<_>>()?;
    let words = match target.dictionary {
        "" => Vec::new(),
        name => words::read(&home().join("dictionaries").join(format!("{name}.dict")))?,
    };
    Ok(Material { files, words })
}
