//! `rockface init`: a folder with a commented pipeline to begin with.

use std::path::{Path, PathBuf};

use clap::Args;

use super::{CliError, say};
use rockface_engine::history::HistoryError;

/// The pipeline everybody begins with.
pub const STARTER: &str = include_str!("starter.yaml");

/// Arguments of `rockface init`.
#[derive(Debug, Args)]
pub struct InitArgs {
    /// The folder, created if it does not exist.
    dir: PathBuf,
}

impl InitArgs {
    /// Writes the starter; a pipeline that is there stays.
    pub fn run(self) -> Result<(), CliError> {
        if self.dir.exists() && !self.dir.is_dir() {
            return Err(CliError::Usage(format!("{} is a file: give a folder", self.dir.display())));
        }
        std::fs::create_dir_all(&self.dir).map_err(failed("make the folder", &self.dir))?;
        let path = self.dir.join("pipeline.yaml");
        let new = std::fs::OpenOptions::new().write(true).create_new(true).open(&path);
        match new.and_then(|mut file| std::io::Write::write_all(&mut file, STARTER.as_bytes())) {
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {
                return Err(CliError::Usage(format!("{} is there already: give another folder", path.display())));
            }
            other => other.map_err(failed("write", &path))?,
        }
        say(&format!("{}\ntry it: rockface run {}", path.display(), for_shell(&path)));
        Ok(())
    }
}

fn failed(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> CliError {
    let path = path.to_owned();
    move |source| CliError::History(HistoryError::Io { action, path, source })
}

/// A path as one word of a shell.
fn for_shell(path: &Path) -> String {
    let text = path.display().to_string();
    let is_plain = |letter: char| letter.is_alphanumeric() || "_-./+,:@%=".contains(letter);
    if text.chars().all(is_plain) { text } else { format!("'{}'", text.replace('\'', r"'\''")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_words_of_a_shell() {
        for (path, expected) in [("a/b.yaml", "a/b.yaml"), ("a b/c", "'a b/c'"), ("it's", r"'it'\''s'"), ("$x", "'$x'")]
        {
            assert_eq!(for_shell(Path::new(path)), expected);
        }
    }
}
