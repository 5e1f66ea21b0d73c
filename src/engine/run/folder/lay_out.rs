//! Outputs under names people can read: `outputs/<step>/<point>/<port>.<extension>`, and further files beside them.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use rockface_cache::{Digest, Materialised, NameError, OutputRecord, Outputs, SafeName, SafePath, Store};
use rockface_core::artefact::{Artefact, Kind};
use serde::{Deserialize, Serialize};

use super::files::{failed, going_on, write_file};
use super::side_by_side::each;
use crate::history::output_folder;
use crate::plan::Plan;
use crate::run::{RunError, Summary};

/// A run with more outputs than this lays out those of its targets only, step by step as long as there are no more, unless it
/// says otherwise: a folder for each of very many points costs more than the whole rerun.
pub const OUTPUTS_LIMIT: usize = 1000;

/// Which outputs get a name in the run folder. All others are in the store, and `rockface export` gives them a name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum LayOut {
    /// Those of all steps up to 1000 outputs; beyond, those of target steps, step by step, up to 1000 in all.
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
pub type Paths = BTreeMap<String, SafePath>;

/// What was laid out; paths are relative to the run folder.
#[derive(Debug, Default)]
pub struct Laid {
    /// The outputs of each instance.
    pub paths: Vec<Paths>,
    /// All files of the target steps, each with the step.
    pub of_targets: Vec<(usize, SafePath)>,
    /// All files; with the digest of its blob one that is but another name of that.
    pub files: Files,
    /// How many kept outputs have no file.
    pub unnamed: usize,
}

impl Laid {
    /// The files of the target steps: first pictures, then those that no other step reads, otherwise as written.
    pub fn of_targets(&self, plan: &Plan) -> Vec<SafePath> {
        let (steps, ends) = (&plan.graph.steps, plan.graph.ends());
        let mut files: Vec<&(usize, SafePath)> = self.of_targets.iter().collect();
        files.sort_by_key(|(step, _)| {
            (!steps[*step].draws(), !ends[*step], steps[*step].axes.len(), steps[*step].written)
        });
        files.into_iter().map(|(_, path)| path.clone()).collect()
    }
}

impl LayOut {
    /// Gives the outputs of a run their names.
    pub fn lay_out(
        self,
        plan: &Plan,
        summary: &Summary,
        store: &Store,
        folder: &Path,
        threads: usize,
        stop: &AtomicBool,
    ) -> Result<Laid, RunError> {
        let counts = counts(plan, summary);
        let wanted = self.wanted(plan, &counts);
        let layer = Layer { plan, store, folder };
        let named_files = |instance: usize| {
            going_on(stop)?;
            let result = &summary.instances[instance];
            match (&result.outcome, &result.failure) {
                (Some(outcome), _) if wanted[instance] => {
                    layer.outputs(instance, &outcome.outputs, plan.step(instance).keep)
                }
                // What explains a failure is always wanted.
                (None, Some(failure)) => layer.outputs(instance, &failure.outputs, true),
                _ => Ok((Paths::new(), Vec::new())),
            }
        };
        let mut laid = Laid::default();
        for (instance, (named, files)) in each(threads, summary.instances.len(), named_files)?.into_iter().enumerate() {
            if plan.targets.binary_search(&instance).is_ok() {
                let step = plan.instances[instance].step;
                laid.of_targets.extend(files.iter().map(|(path, _)| (step, path.clone())));
            }
            laid.files.extend(files);
            laid.paths.push(named);
        }
        let named: usize = laid.paths.iter().map(BTreeMap::len).sum();
        laid.unnamed = counts.iter().sum::<usize>().saturating_sub(named);
        Ok(laid)
    }

    /// Whether the outputs of each instance get names; `counts` has the number of kept outputs of each step.
    fn wanted(self, plan: &Plan, counts: &[usize]) -> Vec<bool> {
        let is_large = counts.iter().sum::<usize>() > OUTPUTS_LIMIT;
        let fitting = fitting_targets(plan, counts);
        let is_wanted = |instance: usize| match self {
            Self::All => true,
            Self::Auto if !is_large => true,
            Self::Auto => fitting[plan.instances[instance].step],
            Self::Targets => plan.targets.binary_search(&instance).is_ok(),
            Self::None => false,
        };
        (0..plan.instances.len()).map(is_wanted).collect()
    }

    /// The outputs that get names.
    pub fn blobs(self, plan: &Plan, summary: &Summary) -> Vec<Digest> {
        let wanted = self.wanted(plan, &counts(plan, summary));
        let named = summary.instances.iter().enumerate().filter(|(instance, _)| wanted[*instance]);
        let outcomes =
            named.filter(|(instance, _)| plan.step(*instance).keep).filter_map(|(_, one)| one.outcome.as_ref());
        let outputs = outcomes.flat_map(|outcome| outcome.outputs.values());
        outputs.filter(|output| output.kept).map(|output| output.digest).collect()
    }
}

/// How many kept outputs each step has.
fn counts(plan: &Plan, summary: &Summary) -> Vec<usize> {
    let mut counts = vec![0; plan.graph.steps.len()];
    for (instance, result) in summary.instances.iter().enumerate().filter(|(instance, _)| plan.step(*instance).keep) {
        let outputs = result.outcome.iter().flat_map(|outcome| outcome.outputs.values());
        counts[plan.instances[instance].step] += outputs.filter(|output| output.kept).count();
    }
    counts
}

/// Which steps are targets whose outputs fit under the limit together with those of targets before them.
fn fitting_targets(plan: &Plan, counts: &[usize]) -> Vec<bool> {
    let (mut left, mut fitting) = (OUTPUTS_LIMIT, vec![false; counts.len()]);
    for step in &plan.graph.targets {
        fitting[*step] = counts[*step] <= left;
        left -= if fitting[*step] { counts[*step] } else { 0 };
    }
    fitting
}

/// Files, and the blobs that some of them are other names of.
type Files = Vec<(SafePath, Option<Digest>)>;

struct Layer<'a> {
    plan: &'a Plan,
    store: &'a Store,
    folder: &'a Path,
}

impl Layer<'_> {
    /// Links the kept outputs of an instance and writes their further files; returns the former by port, and then all with
    /// the blobs that some are other names of, relative to the folder.
    fn outputs(&self, instance: usize, outputs: &Outputs, is_kept: bool) -> Result<(Paths, Files), RunError> {
        let step = self.plan.step(instance);
        let (mut named, mut files, mut exports) = (Paths::new(), Vec::new(), Vec::new());
        let kept = outputs.iter().filter(|(_, output)| is_kept && output.kept);
        let kept = kept.filter_map(|(port, output)| Some((port, output, output.kind.parse::<Kind>().ok()?)));
        let place = self.place(instance).map_err(|error| failed(self.folder)(error.into()))?;
        for (port, output, kind) in kept {
            if named.is_empty() {
                let place = self.folder.join(&place);
                std::fs::create_dir_all(&place).map_err(failed(&place))?;
            }
            let file = SafeName::new(format!("{port}.{}", step.extension(port, kind)));
            let path = place.with(&file.map_err(|error| failed(self.folder)(error.into()))?);
            let how = self.store.materialise_new(&output.digest, &self.folder.join(&path))?;
            files.push((path.clone(), (how == Materialised::HardLink).then_some(output.digest)));
            if kind.has_exports() {
                exports.extend(self.exports(&place, port, output, kind)?);
            }
            named.insert(port.to_string(), path);
        }
        files.extend(exports.into_iter().map(|path| (path, None)));
        Ok((named, files))
    }

    /// Where the outputs of an instance go.
    fn place(&self, instance: usize) -> Result<SafePath, NameError> {
        output_folder(&self.plan.step(instance).name, &self.plan.point_text(instance))
    }

    /// Writes the further files of an output; returns their paths.
    fn exports(
        &self,
        place: &SafePath,
        port: &str,
        output: &OutputRecord,
        kind: Kind,
    ) -> Result<Vec<SafePath>, RunError> {
        let made = Artefact::decode(kind, &self.store.get(&output.digest)?)
            .and_then(|value| value.exports(port))
            .map_err(|error| failed(&self.folder.join(place).join(port))(std::io::Error::other(error)))?;
        let write = |export: &rockface_core::artefact::Export| {
            // The names of an archive or of parts, which were read from a stored file.
            let path = SafePath::new(&export.path).map_err(|error| failed(&self.folder.join(place))(error.into()))?;
            let path = place.below(&path);
            let file = self.folder.join(&path);
            let parent = file.parent().unwrap_or(self.folder);
            std::fs::create_dir_all(parent).map_err(failed(parent))?;
            write_file(&file, &export.bytes)?;
            Ok(path)
        };
        made.iter().map(write).collect()
    }
}
