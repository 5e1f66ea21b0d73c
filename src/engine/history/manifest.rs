//! The manifest of a run, `run.json`, as it is read back.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rockface_cache::{Cost, Digest, Outputs, RecipeInput, SafePath};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{HistoryError, Ran, headline};
use crate::diagnostic::printable;
use crate::pipeline::{Copied, Label};

/// Bytes that are written at a time.
const PIECE_BYTES: usize = 64 << 10;

/// The version of manifests this program writes and reads.
pub const FORMAT: u32 = 1;

/// Everything that is needed to check and to repeat a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// The version of this format.
    pub format: u32,
    /// The texts of the pipeline.
    pub pipeline: PipelineText,
    /// What was changed from outside.
    pub overrides: Overridden,
    /// The seed in force.
    pub seed: u64,
    /// The target steps asked for; empty for those the pipeline names itself.
    #[serde(default)]
    pub targets: Vec<String>,
    /// When it ended, RFC 3339.
    pub finished: String,
    /// Wall time in seconds.
    pub wall_s: f64,
    /// How many threads the steps had together.
    pub jobs: usize,
    /// `done`, or `failed` where a step failed.
    pub status: String,
    /// Version, compiler, target, lock file and processor of the program.
    pub program: Value,
    /// The results, a line each.
    pub headlines: Vec<String>,
    /// Whether `outputs/` has `all` kept outputs or `some`; `rockface export` gives any other a name.
    #[serde(default)]
    pub laid_out: String,
    /// The parts that steps come from, a use each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<PartUsed>,
    /// Where its store is, absolute, if that is not the one beside the folder of runs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub store: Option<PathBuf>,
    /// What the items of an axis stand for, where they have several values: by axis, item and name of the value, as
    /// `${axis.name}`. The points of a design, and the rows of a table that another step makes.
    #[serde(default, skip_serializing_if = "ItemValues::is_empty")]
    pub values: ItemValues,
    /// What became of each step instance. The last field: see [`Manifest::write`].
    pub steps: Vec<StepDone>,
}

/// The named values of items: by axis and item.
pub type ItemValues = BTreeMap<String, BTreeMap<String, Map<String, Value>>>;

/// The pipeline of a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PipelineText {
    /// The name of the pipeline, which its run folders are named after.
    pub name: String,
    /// The file as it was given.
    pub path: PathBuf,
    /// The folder its paths are relative to, absolute.
    #[serde(default)]
    pub folder: PathBuf,
    /// The YAML text of the pipeline file, without what it includes.
    pub text: String,
    /// The copy its files were read from, where it was run from an archive.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub copied: Option<Copied>,
    /// What planning has read to know the ports of its steps, also of steps that were not run: modules of Python functions.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub asked: Vec<FileUsed>,
    /// The files it includes, in the order they were met.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub included: Vec<IncludedText>,
}

/// A file that a pipeline includes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct IncludedText {
    /// Where it was, absolute.
    pub path: PathBuf,
    /// The YAML text of the file as it was then.
    pub text: String,
}

/// A use of a part.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PartUsed {
    /// The step that uses it, with those around it: the names of its steps begin with this and `/`.
    pub name: String,
    /// The part: its name, or the path of its file.
    pub part: String,
    /// The BLAKE3 of its text, where it has one of its own: it stands in a file, or comes with the program.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub blake3: Option<Digest>,
    /// Its outputs: by name, what stands behind them: `use/step.port`.
    pub outputs: BTreeMap<String, String>,
}

/// Values given on the command line.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Overridden {
    /// `AXIS=VALUES` texts of `--sweep`.
    #[serde(default)]
    pub sweep: Vec<String>,
    /// `PATH=VALUE` texts of `--set`, in the order they were given.
    pub set: Vec<String>,
    /// In place of the pipeline's seed.
    pub seed: Option<u64>,
}

/// A step instance of a past run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StepDone {
    /// The name of the step.
    pub step: String,
    /// Its items by axis.
    pub point: BTreeMap<String, String>,
    /// The stage it uses.
    pub stage: Cow<'static, str>,
    /// The version of the stage.
    pub version: u32,
    /// `executed`, `cached`, `failed`, or `not reached` because something before it failed.
    pub status: Cow<'static, str>,
    /// Why it failed, if it did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failure: Option<String>,
    /// The key of its recipe.
    pub key: Option<Digest>,
    /// Its outputs, by port.
    pub outputs: Option<Outputs>,
    /// Its log, a blob.
    #[serde(default)]
    pub log: Option<Digest>,
    /// Sketches of its outputs, a blob.
    #[serde(default)]
    pub sketches: Option<Digest>,
    /// What it took when it was computed.
    pub cost: Option<Cost>,
    /// Its parameters, files replaced by their digests.
    #[serde(with = "rockface_cache::shared")]
    pub parameters: Arc<Value>,
    /// The numbers it logged.
    #[serde(default)]
    pub metrics: Vec<Metric>,
    /// What it warned of.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
    /// The files its parameters name.
    #[serde(default)]
    pub files: Vec<FileUsed>,
    /// What each input port read.
    #[serde(default)]
    pub inputs: BTreeMap<String, RecipeInput>,
    /// The files of its outputs by port, relative to the run folder.
    #[serde(default)]
    pub paths: BTreeMap<String, SafePath>,
}

/// A number that a step logged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Metric {
    /// The name the stage gave it, such as `holes_m2`.
    pub name: String,
    /// Its value; `None` where it was no finite number.
    pub value: Option<f64>,
    /// The unit of the value.
    pub unit: String,
}

/// An input file of a step.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileUsed {
    /// Its path when it was read.
    pub path: PathBuf,
    /// The BLAKE3 of its content.
    pub blake3: Digest,
}

impl Manifest {
    /// The names of the values that the items of an axis have, in the order of the first item that has them.
    pub fn value_names(&self, axis: &str) -> Vec<&str> {
        let mut names: Vec<&str> = Vec::new();
        for name in self.values.get(axis).into_iter().flat_map(BTreeMap::values).flat_map(Map::keys) {
            if !names.contains(&name.as_str()) {
                names.push(name);
            }
        }
        names
    }

    /// A value of an item of an axis; `None` where it has none of this name.
    pub fn value(&self, axis: &str, item: &str, name: &str) -> Option<&Value> {
        self.values.get(axis)?.get(item)?.get(name)
    }

    /// Reads a manifest.
    ///
    /// # Errors
    ///
    /// When the file cannot be read, is no manifest, or is one of another version.
    pub fn read(path: &Path) -> Result<Self, HistoryError> {
        let text = std::fs::read(path).map_err(HistoryError::io("read", path))?;
        Self::parse(&text).map_err(|why| HistoryError::Manifest { path: path.to_owned(), why })
    }

    fn parse(text: &[u8]) -> Result<Self, String> {
        let head: Head = serde_json::from_slice(text).map_err(|error| error.to_string())?;
        match head.format.as_ref().and_then(Value::as_u64) {
            Some(format) if format == u64::from(FORMAT) => {
                serde_json::from_slice(text).map_err(|error| error.to_string())
            }
            Some(format) => {
                Err(format!("it has format {format}, this version reads {FORMAT}; use the version that wrote it"))
            }
            None => Err("it says no format".to_owned()),
        }
    }

    /// The program that made the run, such as `rockface 0.1.0 (commit 0123456789ab)`.
    pub fn made_by(&self) -> String {
        let source = self.program["source"].as_str().or(self.program["rockface"].as_str());
        format!("rockface {}", printable(source.unwrap_or("of an unknown version")))
    }

    /// What a label names where it is an output of a use: the step, port and items behind it.
    pub fn behind<'t>(&'t self, label: &Label<'t>) -> Option<Label<'t>> {
        let used = self.parts.iter().find(|used| used.name == label.step)?;
        label.of_inner(used.outputs.get(label.port?)?)
    }

    /// How many step instances were executed, how many were cached, and how many were not made.
    pub fn counts(&self) -> [usize; 3] {
        let count = |status: &str| self.steps.iter().filter(|done| done.status == status).count();
        let (executed, cached) = (count("executed"), count("cached"));
        [executed, cached, self.steps.len() - executed - cached]
    }

    /// The labels of the step instances that were executed.
    pub fn executed(&self) -> Ran {
        self.steps.iter().filter(|done| done.status == "executed").map(StepDone::label).collect()
    }

    /// The result that stands for the run in a list: see [`headline`].
    pub fn headline(&self) -> Option<&str> {
        headline(&self.headlines, &self.executed())
    }

    /// The step instances that failed, and why.
    pub fn failures(&self) -> impl Iterator<Item = (String, &str)> {
        self.steps.iter().filter_map(|done| Some((done.label(), done.failure.as_deref()?)))
    }

    /// What step instances warned of.
    pub fn warnings(&self) -> impl Iterator<Item = (String, &str)> {
        self.steps.iter().flat_map(|done| done.warnings.iter().map(|text| (done.label(), text.as_str())))
    }

    /// Writes the file: JSON, with a line for each step instance. Of a large run it is never in memory as a whole.
    ///
    /// # Errors
    ///
    /// Those of `out`.
    pub fn write(mut self, out: &mut impl Write) -> io::Result<()> {
        let steps = std::mem::take(&mut self.steps);
        let mut text = serde_json::to_vec_pretty(&self)?;
        // `steps` is the last field; its list is empty now.
        text.truncate(text.trim_ascii_end().strip_suffix(b"]\n}").map_or(0, <[u8]>::len));
        for (number, done) in steps.iter().enumerate() {
            text.extend_from_slice(if number == 0 { b"\n    " } else { b",\n    " });
            serde_json::to_writer(&mut text, done)?;
            if text.len() >= PIECE_BYTES {
                out.write_all(&text)?;
                text.clear();
            }
        }
        text.extend_from_slice(if steps.is_empty() { b"]\n}\n" } else { b"\n  ]\n}\n" });
        out.write_all(&text)
    }
}

/// What tells the version.
#[derive(Deserialize)]
struct Head {
    #[serde(default)]
    format: Option<Value>,
}

impl StepDone {
    /// The instance as messages call it: `step[axis=item,...]`, or only `step` where it depends on no axis.
    pub fn label(&self) -> String {
        if self.point.is_empty() {
            return self.step.clone();
        }
        let items: Vec<String> = self.point.iter().map(|(axis, item)| format!("{axis}={item}")).collect();
        format!("{}[{}]", self.step, items.join(","))
    }
}

#[cfg(test)]
impl Manifest {
    /// A run of the pipeline at `path`, in this folder.
    pub fn of_test(path: &str, folder: &str, steps: Vec<StepDone>) -> Self {
        let (path, folder) = (path.into(), folder.into());
        Self {
            format: FORMAT,
            pipeline: PipelineText {
                name: "p".into(),
                path,
                folder,
                text: "include: …".into(),
                copied: None,
                asked: Vec::new(),
                included: Vec::new(),
            },
            overrides: Overridden::default(),
            seed: 1,
            targets: Vec::new(),
            finished: String::new(),
            wall_s: 0.0,
            jobs: 1,
            status: "done".to_owned(),
            program: Value::Null,
            headlines: Vec::new(),
            laid_out: String::new(),
            parts: Vec::new(),
            store: None,
            values: ItemValues::new(),
            steps,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_versions_and_other_files_are_refused_with_a_reason() {
        for (text, expected) in [
            ("{\"format\": 99}", "it has format 99, this version reads 1"),
            ("{}", "it says no format"),
            ("[", "EOF"),
            ("{\"format\": 1}", "missing field"),
        ] {
            let why = Manifest::parse(text.as_bytes()).unwrap_err();
            assert!(why.contains(expected), "{why}");
        }
    }
}
