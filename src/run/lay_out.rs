//! Outputs under names people can read: `outputs/<step>/<point>/<port>.<extension>`, and further files beside them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rockface_cache::{Digest, Outcome, OutputRecord, Store};
use rockface_stages::artefact::{Artefact, Kind};
use serde::{Deserialize, Serialize};

use super::folder::failed;
use super::{RunError, Summary};
use crate::plan::Plan;

/// A run with more outputs than this lays out those of its targets only, unless it is told otherwise.
pub const OUTPUTS_LIMIT: usize = 1000;

/// Which outputs get a name in the run folder. All others are in the store, and `rockface export` gives them a name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum LayOut {
    /// Those of all steps up to 1000 outputs; beyond, those of the target steps.
    #[default]
    Auto,
    /// Those of all steps.
    All,
    /// Those of the target steps.
    Targets,
    /// None.
    None,
}

/// The files of the outputs of an instance by port, relative to the run folder.
pub type Paths = BTreeMap<String, PathBuf>;

/// What was laid out; paths are relative to the run folder.
#[derive(Debug, Default)]
pub struct Laid {
    /// The outputs of each instance.
    pub paths: Vec<Paths>,
    /// All files of the target steps.
    pub of_targets: Vec<PathBuf>,
    /// Whether every kept output has a file.
    pub whole: bool,
}

impl LayOut {
    /// Gives the outputs of a run their names.
    pub fn lay_out(self, plan: &Plan, summary: &Summary, store: &Store, folder: &Path) -> Result<Laid, RunError> {
        let wanted = self.settled(plan, summary);
        let layer = Layer { plan, store, folder };
        let mut laid = Laid { whole: wanted == Self::All, ..Laid::default() };
        for (instance, result) in summary.instances.iter().enumerate() {
            let is_target = plan.targets.binary_search(&instance).is_ok();
            let is_wanted = wanted == Self::All || (wanted == Self::Targets && is_target);
            let outcome = result.outcome.as_ref().filter(|_| is_wanted);
            let (named, exports) =
                outcome.map_or(Ok((Paths::new(), Vec::new())), |outcome| layer.outputs(instance, outcome))?;
            if is_target {
                laid.of_targets.extend(named.values().cloned().chain(exports));
            }
            laid.paths.push(named);
        }
        Ok(laid)
    }

    fn settled(self, plan: &Plan, summary: &Summary) -> Self {
        if self != Self::Auto {
            return self;
        }
        let kept = |(instance, result): (usize, &super::InstanceResult)| {
            let outcome = result.outcome.as_ref().filter(|_| plan.step(instance).keep);
            outcome.map_or(0, |outcome| outcome.outputs.len())
        };
        let count: usize = summary.instances.iter().enumerate().map(kept).sum();
        if count > OUTPUTS_LIMIT { Self::Targets } else { Self::All }
    }
}

struct Layer<'a> {
    plan: &'a Plan,
    store: &'a Store,
    folder: &'a Path,
}

impl Layer<'_> {
    /// Links the kept outputs of an instance and writes their further files; returns both, relative to the folder.
    fn outputs(&self, instance: usize, outcome: &Outcome) -> Result<(Paths, Vec<PathBuf>), RunError> {
        let step = self.plan.step(instance);
        let (mut named, mut exports) = (Paths::new(), Vec::new());
        let kept = outcome.outputs.iter().filter(|(_, output)| step.keep && output.kept);
        let kept = kept.filter_map(|(port, output)| Some((port, output, output.kind.parse::<Kind>().ok()?)));
        for (port, output, kind) in kept {
            if named.is_empty() {
                let place = self.folder.join(self.place(instance));
                std::fs::create_dir_all(&place).map_err(failed(&place))?;
            }
            let path = self.place(instance).join(format!("{port}.{}", step.extension(port, kind)));
            self.store.materialise_new(&output.digest, &self.folder.join(&path))?;
            if kind.has_exports() {
                exports.extend(self.exports(instance, port, output, kind)?);
            }
            named.insert(port.clone(), path);
        }
        Ok((named, exports))
    }

    /// Where the outputs of an instance go.
    fn place(&self, instance: usize) -> PathBuf {
        let step = self.plan.step(instance);
        let place = Path::new("outputs").join(readable_name(&step.name));
        if step.axes.is_empty() { place } else { place.join(readable_name(&self.plan.point_text(instance))) }
    }

    /// Writes the further files of an output; returns their paths.
    fn exports(
        &self,
        instance: usize,
        port: &str,
        output: &OutputRecord,
        kind: Kind,
    ) -> Result<Vec<PathBuf>, RunError> {
        let place = self.place(instance);
        let made = Artefact::decode(kind, &self.store.get(&output.digest)?)
            .and_then(|value| value.exports(port))
            .map_err(|error| failed(&self.folder.join(&place).join(port))(std::io::Error::other(error)))?;
        let write = |export: &rockface_stages::artefact::Export| {
            let path = place.join(&export.path);
            let file = self.folder.join(&path);
            let parent = file.parent().unwrap_or(self.folder);
            std::fs::create_dir_all(parent).map_err(failed(parent))?;
            std::fs::write(&file, &export.bytes).map_err(failed(&file))?;
            Ok(path)
        };
        made.iter().map(write).collect()
    }
}

/// The longest name of a folder; file systems take 255 bytes, and some of the tools that read them fewer.
const NAME_BYTES: usize = 200;

/// A name that every file system takes: a long one is cut, and told from others by a digest of the whole.
pub fn readable_name(name: &str) -> String {
    if name.len() <= NAME_BYTES {
        return name.to_owned();
    }
    let digest = Digest::of(name.as_bytes()).to_string();
    let cut = (0..=NAME_BYTES - 17).rev().find(|end| name.is_char_boundary(*end)).unwrap_or(0);
    format!("{}-{}", &name[..cut], &digest[..16])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_names_are_cut_and_stay_apart() {
        let long = |last: char| format!("{}{last}", "ö".repeat(300));
        assert_eq!(readable_name("epoch=pre"), "epoch=pre");
        let (one, other) = (readable_name(&long('a')), readable_name(&long('b')));
        assert!(one.len() <= NAME_BYTES && one.starts_with("öö") && one != other, "{one}");
    }
}
