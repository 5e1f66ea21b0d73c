//! `rockface init`: a folder with a commented pipeline to begin with, or with a copy of a shipped one.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::own_file::write_new;
use super::shipped::Shipped;
use super::{CliError, say};

/// What a folder may begin with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Template {
    /// Three steps: a face, its raster, a picture.
    #[default]
    Starter,
    /// A rockfall on a mesh of your own, surveyed before and after it, and a verdict on the noise.
    Mesh,
    /// A rockfall surveyed by a stereo pair before and after it.
    Stereo,
    /// Two flights of a UAV along an unchanged cliff.
    Uav,
    /// Simulated noise of a site of your own, judged by its references.
    Calibrate,
    /// Three detectors against exact ground truth.
    Benchmark,
    /// Noise over a swept parameter.
    Sweep,
    /// Scans of a face, week after week: what fell since the scan before, in map coordinates.
    Monitor,
}

impl Template {
    /// The text of the pipeline.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Starter => include_str!("templates/starter.yaml"),
            Self::Mesh => include_str!("templates/mesh.yaml"),
            Self::Stereo => include_str!("templates/stereo.yaml"),
            Self::Uav => include_str!("templates/uav.yaml"),
            Self::Calibrate => include_str!("templates/calibrate.yaml"),
            Self::Benchmark => include_str!("templates/benchmark.yaml"),
            Self::Sweep => include_str!("templates/sweep.yaml"),
            Self::Monitor => include_str!("templates/monitor.yaml"),
        }
    }
}

/// Arguments of `rockface init`.
#[derive(Debug, Args)]
pub struct InitArgs {
    /// The folder, created if it does not exist.
    dir: PathBuf,
    /// Copy this pipeline that ships with rockface, with the files it reads, instead of the starter.
    #[arg(long, value_name = "NAME", add = super::candidates::shipped())]
    from: Option<String>,
    /// What to begin with.
    #[arg(long, value_enum, default_value_t, conflicts_with = "from")]
    template: Template,
}

impl InitArgs {
    /// Writes the files; those that are there stay.
    pub fn run(self) -> Result<(), CliError> {
        let files = match &self.from {
            Some(name) => Shipped::find(name)?.files(),
            None => vec![("pipeline.yaml", self.template.text())],
        };
        if self.dir.exists() && !self.dir.is_dir() {
            return Err(CliError::Usage(format!("{} is a file: give a folder", self.dir.display())));
        }
        let paths = files.iter().map(|(path, _)| self.dir.join(path));
        if let Some(there) = paths.into_iter().find(|path| std::fs::symlink_metadata(path).is_ok()) {
            return Err(CliError::Usage(format!("{} is there already: give another folder", there.display())));
        }
        // The pipeline itself comes last: where it is, all it reads is there too.
        for (path, text) in files.iter().rev() {
            write_new(&self.dir.join(path), text.as_bytes())?;
        }
        let path = self.dir.join(files[0].0);
        say(&format!("{}\ntry it: rockface run {}", path.display(), for_shell(&path)));
        Ok(())
    }
}

/// A path as one word of a shell.
pub fn for_shell(path: &Path) -> String {
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
