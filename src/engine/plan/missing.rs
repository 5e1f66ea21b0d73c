//! What is said of a file that is not there.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::graph::{Graph, GraphStep};
use super::parameters::{fill, value_at};
use super::points::{count, points};
use crate::diagnostic::{Diagnostic, Span, nearest};

/// Points of a step above which the files that it names elsewhere are not looked at.
const POINTS: u64 = 200;

/// A file that a parameter names and that is not there.
pub struct Missing<'a> {
    /// The graph of the step.
    pub graph: &'a Graph,
    /// The step that names the file.
    pub step: &'a GraphStep,
    /// The keys that lead to the parameter.
    pub parameter: &'a [String],
    /// The path as it is written.
    pub written: &'a str,
    /// Where that is.
    pub path: &'a Path,
}

impl Missing<'_> {
    /// The fault, with what may be meant or done.
    pub fn fault(&self, span: Span, message: &str) -> Diagnostic {
        let fault = Diagnostic::at(span, message);
        let (written, path) = (self.written, self.path);
        if written.trim().is_empty() || path.symlink_metadata().is_ok() {
            // What was named is there: nothing beside it was meant instead.
            return fault;
        }
        if let Some(way) = self.graph.former.as_ref().and_then(|former| former.way(path)) {
            return fault.hint(way);
        }
        if written.contains(char::is_control) {
            let hint = "in double quotes a backslash begins an escape: put single quotes around the path, or write `/`";
            return fault.hint(hint);
        }
        let name = path.file_name().map_or_else(|| written.to_owned(), |name| name.to_string_lossy().into_owned());
        let Some(Ok(entries)) = path.parent().map(std::fs::read_dir) else {
            let folder = path.parent().unwrap_or(Path::new("")).display();
            return fault
                .hint(format!("paths are relative to the folder of the pipeline file; there is no folder {folder}"));
        };
        let names: Vec<String> =
            entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
        let elsewhere = self.named_elsewhere();
        let names: Vec<&str> = names.iter().map(String::as_str).filter(|name| !elsewhere.contains(*name)).collect();
        match nearest(&name, &names) {
            Some(near) => fault.hint(format!("there is a `{near}` in that folder; did you mean it?")),
            None => fault.hint("paths are relative to the folder of the pipeline file"),
        }
    }

    /// The names of the files that the parameter names at other items of an axis: none of them was meant here.
    fn named_elsewhere(&self) -> BTreeSet<String> {
        let axes = &self.step.with_axes;
        if axes.iter().any(|axis| self.graph.is_pending(*axis)) || count(self.graph, axes) > POINTS {
            return BTreeSet::new();
        }
        let name = |items: Vec<usize>| {
            let items: BTreeMap<usize, usize> = axes.iter().copied().zip(items).collect();
            let with = fill(self.graph, self.step, &items).ok()?;
            let name = Path::new(&value_at(&with, self.parameter)).file_name()?.to_string_lossy().into_owned();
            Some(name)
        };
        points(self.graph, axes).into_iter().filter_map(name).collect()
    }
}
