//! The corpus: sound files of every format, small, written by rockface itself or written out here.

mod artefacts;
mod cameras;
mod foreign;
mod pipelines;
mod runs;

use std::io;

use crate::{corpus, find};

/// A file of a target: the target's name, the file's name, its bytes.
pub type Seed = (&'static str, String, Vec<u8>);

/// Writes the corpus; how many files it has. Files that are not among them are left alone.
///
/// # Errors
/// The disk, or a writer of rockface that fails.
pub fn write() -> io::Result<usize> {
    let mut seeds = artefacts::all()?;
    seeds.extend(cameras::all()?);
    seeds.extend(foreign::all()?);
    seeds.extend(pipelines::all()?);
    seeds.extend(runs::all()?);
    for (target, name, bytes) in &seeds {
        let target = find(target).ok_or_else(|| io::Error::other(format!("no target `{target}`")))?;
        let folder = corpus::folder("corpus", target);
        std::fs::create_dir_all(&folder)?;
        std::fs::write(folder.join(name), bytes)?;
    }
    Ok(seeds.len())
}

/// A seed that is written out.
fn seed(target: &'static str, name: &str, bytes: impl AsRef<[u8]>) -> Seed {
    (target, name.to_owned(), bytes.as_ref().to_vec())
}
