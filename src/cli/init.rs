//! `rockface init`: a folder with a commented pipeline to begin with.

use std::path::PathBuf;

use clap::Args;

use super::{CliError, say};
use crate::run::RunError;

/// The pipeline everybody begins with.
pub const STARTER: &str = include_str!("starter.yaml");

/// Arguments of `rockface init`.
#[derive(Debug, Args)]
pub struct InitArgs {
    /// The folder; made if there is none.
    dir: PathBuf,
}

impl InitArgs {
    /// Writes the starter; a pipeline that is there stays.
    pub fn run(self) -> Result<(), CliError> {
        let failed = |source| CliError::Run(RunError::Folder { path: self.dir.clone(), source });
        let path = self.dir.join("pipeline.yaml");
        std::fs::create_dir_all(&self.dir).map_err(failed)?;
        let new = std::fs::OpenOptions::new().write(true).create_new(true).open(&path);
        match new.and_then(|mut file| std::io::Write::write_all(&mut file, STARTER.as_bytes())) {
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {
                return Err(CliError::Usage(format!("{} is there already: give another folder", path.display())));
            }
            other => other.map_err(failed)?,
        }
        say(&format!("{0}\ntry it: rockface run {0}", path.display()));
        Ok(())
    }
}
