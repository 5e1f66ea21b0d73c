//! The report of a run: one page that needs nothing but a browser, made from the run's manifest and what it names.
//!
//! Everything in it comes from the manifest and the artefacts and logs that points at, so that a page made at the end of a
//! run, one made months later by `rockface report`, and `run.json` say the same.

mod compared;
mod curves;
mod graph;
mod groups;
mod media;
mod number;
mod page;
mod source;
mod steps;
mod tables;

use std::path::{Path, PathBuf};

use base64::Engine;
use minijinja::value::{Serde, Value};
use minijinja::{AutoEscape, Environment};
use rockface_core::Look;
use rockface_engine::history::RunContents;
use rockface_engine::run::Reporter;
use serde::Serialize;
use sha2::{Digest, Sha256};

pub use compared::comparison;
pub use graph::of as graph_of;
pub use source::Source;

/// What a page begins with.
pub const BEGINS: &[u8] = b"<!doctype html>";

/// Why a report cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The template does not fit what it is given: a fault of this program.
    #[error("cannot fill in the report: {0}")]
    Template(#[from] minijinja::Error),
    /// The page could not be written to disk.
    #[error("cannot write the report {}: {source}", path.display())]
    Io {
        /// Where the page was to go.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

/// The page of a run. Links lead to the files of its folder: relative ones where the page lies in that folder, absolute ones
/// otherwise.
///
/// # Errors
/// A template that does not fit.
pub fn html(source: &Source, links: Links) -> Result<String, ReportError> {
    render("run.html", page::of(source, links))
}

/// How links to the files of the run folder are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Links {
    /// The page lies in the folder.
    Relative,
    /// The page lies elsewhere.
    Absolute,
}

/// Writes the report of a run to a file, whole or not at all.
///
/// # Errors
/// A template that does not fit, or the disk.
pub fn write(source: &Source, to: &Path) -> Result<(), ReportError> {
    let inside = to.parent().and_then(|parent| parent.canonicalize().ok()) == source.folder.canonicalize().ok();
    let links = if inside { Links::Relative } else { Links::Absolute };
    save(to, &html(source, links)?)
}

/// Writes a page to a file, whole or not at all, and makes the folder it is in.
///
/// # Errors
/// Those of the disk.
pub fn save(to: &Path, text: &str) -> Result<(), ReportError> {
    let parent = to.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let write = || {
        std::fs::create_dir_all(parent)?;
        let mut file = rockface_cache::readable_file(parent)?;
        std::io::Write::write_all(&mut file, text.as_bytes())?;
        file.persist(to).map(drop).map_err(|error| error.error)
    };
    write().map_err(|source| ReportError::Io { path: to.to_owned(), source })
}

/// Writes the page of a run when it ends.
#[derive(Debug)]
pub struct Pages(
    /// What makes large pictures small.
    pub &'static dyn Look,
);

impl Reporter for Pages {
    fn report(&self, run: &RunContents, to: &Path) -> std::io::Result<()> {
        match write(&Source { run: *run, look: self.0 }, to) {
            Ok(()) => Ok(()),
            Err(ReportError::Io { source, .. }) => Err(source),
            Err(error) => {
                tracing::warn!("the run has no report: {error:#}");
                Ok(())
            }
        }
    }
}

const TEMPLATES: [(&str, &str); 4] = [
    ("base.html", include_str!("assets/base.html")),
    ("parts.html", include_str!("assets/parts.html")),
    ("run.html", include_str!("assets/run.html")),
    ("compared.html", include_str!("assets/compared.html")),
];

/// The script of every page.
const SCRIPT: &str = include_str!("assets/script.js");

/// What a browser lets a page do, whatever is in it: run our script, which is known by its digest, and show what the page holds.
fn policy() -> String {
    let digest = base64::engine::general_purpose::STANDARD.encode(Sha256::digest(SCRIPT));
    format!(
        "default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; \
         form-action 'none'"
    )
}

fn render(name: &str, page: impl Serialize) -> Result<String, ReportError> {
    let mut environment = Environment::new();
    environment.set_auto_escape_callback(|_| AutoEscape::Html);
    for (name, text) in TEMPLATES {
        environment.add_template(name, text)?;
    }
    environment.add_global("style", Value::from_safe_string(include_str!("assets/style.css").to_owned()));
    environment.add_global("script", Value::from_safe_string(SCRIPT.to_owned()));
    environment.add_global("policy", Value::from_safe_string(policy()));
    environment.add_global("rockface_version", env!("CARGO_PKG_VERSION"));
    Ok(environment.get_template(name)?.render(Value::from(Serde(page)))?)
}

#[cfg(test)]
mod tests;
