//! Pipelines as people write them: the YAML text, its faults, and the typed document.

mod document;
mod node;
mod overrides;
mod reference;
mod substitute;

use std::path::{Path, PathBuf};

pub use document::{Axis, Document, Input, Step, Stream, Word};
pub use node::{Data, Key, Node};
pub use reference::Reference;
pub use substitute::{filled, mentioned};

use crate::diagnostic::{Diagnostic, Diagnostics, Source};

/// A pipeline that was read, with the texts its places point into.
#[derive(Debug, Clone)]
pub struct Pipeline {
    /// The pipeline file first, then each override.
    pub sources: Vec<Source>,
    /// Paths in parameters are relative to this folder.
    pub folder: PathBuf,
    /// The typed document.
    pub document: Document,
}

/// Values given on the command line.
#[derive(Debug, Clone, Default)]
pub struct Overrides {
    /// `PATH=VALUE` texts, applied in order.
    pub set: Vec<String>,
    /// Takes the place of the pipeline's seed.
    pub seed: Option<u64>,
}

impl Pipeline {
    /// Reads a pipeline file and applies the overrides.
    pub fn load(path: &Path, overrides: &Overrides) -> Result<Self, Diagnostics> {
        let text = std::fs::read_to_string(path)
            .map_err(|error| Diagnostics { sources: Vec::new(), list: vec![unreadable(path, &error)] })?;
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")).to_owned();
        let stem = path.file_stem().map_or_else(|| "pipeline".into(), |stem| stem.to_string_lossy().into_owned());
        Self::parse(&text, &path.display().to_string(), &stem, folder, overrides)
    }

    /// Reads a pipeline text; `name` is what messages call it, `stem` its name if the text gives none.
    pub fn parse(
        text: &str,
        name: &str,
        stem: &str,
        folder: PathBuf,
        overrides: &Overrides,
    ) -> Result<Self, Diagnostics> {
        let mut sources = vec![Source { name: name.to_owned(), text: text.to_owned() }];
        let mut faults = Vec::new();
        let mut document = None;
        match Node::parse(text, 0) {
            Ok(mut root) => {
                let seed = overrides.seed.map(|seed| format!("seed={seed}"));
                for set in overrides.set.iter().chain(&seed) {
                    faults.extend(overrides::apply(&mut root, set, &mut sources).err());
                }
                document = document::read(&root, stem, &mut faults);
            }
            Err(fault) => faults.push(fault),
        }
        match document {
            Some(document) if faults.is_empty() => Ok(Self { sources, folder, document }),
            _ => Err(Diagnostics { sources, list: faults }),
        }
    }
}

fn unreadable(path: &Path, error: &std::io::Error) -> Diagnostic {
    let beside = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let files: Vec<String> = std::fs::read_dir(beside)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path().display().to_string())
        .filter(|name| Path::new(name).extension().is_some_and(|e| e == "yaml" || e == "yml"))
        .collect();
    Diagnostic::general(format!("cannot read the pipeline `{}`: {error}", path.display()))
        .suggest(&path.display().to_string(), files.iter().map(String::as_str))
}
