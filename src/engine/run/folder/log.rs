//! The MCAP log of a run, put together from what the records of its steps keep.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::atomic::AtomicBool;

use rockface_cache::{Cost, Digest, Outcome, Outputs, Record, Store};
use rockface_core::Entry;
use rockface_core::Look;
use rockface_core::artefact::{Artefact, Kind};

use super::files::{failed, going_on, put, write_file};
use crate::history::{LAYOUT_FILE, LOG_FILE, PIPELINE_FILE};
use crate::pipeline::LogLevel;
use crate::plan::Plan;
use crate::run::{InstanceResult, RunError, Summary};
use crate::watch::step_log::{self, Shown, StepLogError};
use crate::watch::{Facts, Made, RunLog, StepNote, layout};

/// A buffered file that knows where it is: to ask it does not write out what is in the buffer.
struct Buffered<W: Write> {
    inner: BufWriter<W>,
    at: u64,
}

impl<W: Write> Buffered<W> {
    const BYTES: usize = 64 << 10;

    fn new(file: W) -> Self {
        Self { inner: BufWriter::with_capacity(Self::BYTES, file), at: 0 }
    }
}

impl<W: Write> Write for Buffered<W> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let count = self.inner.write(bytes)?;
        self.at += count as u64;
        Ok(count)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.inner.flush()
    }
}

impl<W: Write + Seek> Seek for Buffered<W> {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        if to != SeekFrom::Current(0) {
            self.at = self.inner.seek(to)?;
        }
        Ok(self.at)
    }
}

/// What the log is made of.
pub struct Telling<'a> {
    /// The plan that was run, for the names of its instances.
    pub plan: &'a Plan,
    /// What became of it.
    pub summary: &'a Summary,
    /// Where records and blobs are.
    pub store: &'a Store,
    /// What draws outputs that have no sketches yet.
    pub look: &'a dyn Look,
    /// The log of each instance.
    pub entries: &'a [Vec<Entry>],
    /// The files of each instance by port, relative to the run folder.
    pub paths: &'a [super::lay_out::Paths],
    /// Metadata of the log: seed, overrides, versions.
    pub about: BTreeMap<String, String>,
    /// The text of the pipeline.
    pub pipeline_text: &'a str,
    /// Blobs that a step was computed again for already.
    pub lost: &'a BTreeSet<Digest>,
    /// Set when the user asks for a stop.
    pub stop: &'a AtomicBool,
}

impl Telling<'_> {
    /// Writes log and layout into a run folder.
    pub fn write(&self, folder: &Path) -> Result<(), RunError> {
        let path = folder.join(LOG_FILE);
        let unwritten = |error: mcap::McapError| {
            failed(&path)(match error {
                mcap::McapError::Io(error) => error,
                error => std::io::Error::other(error),
            })
        };
        let file = rockface_cache::readable_file(folder).map_err(failed(&path))?;
        let mut log = RunLog::new(Buffered::new(file), &self.about).map_err(unwritten)?;
        let levels = self.plan.log_levels();
        let nothing = Outcome { outputs: Outputs::default(), log: None, sketches: None, cost: Cost::default() };
        let mut numbers: Vec<(String, String)> = Vec::new();
        for (instance, result) in self.summary.instances.iter().enumerate() {
            going_on(self.stop)?;
            let (outcome, is_done) = match (&result.outcome, &result.failure) {
                (Some(outcome), _) => (outcome, true),
                (None, Some(_)) => (&nothing, false),
                (None, None) => continue,
            };
            let is_shown = is_done && levels[instance] == LogLevel::Full;
            let shown = if is_shown { self.shown(result, outcome)? } else { Ok(Vec::new()) };
            let (shown, unshown) = shown.map_or_else(|why| (Vec::new(), why), |shown| (shown, String::new()));
            let said = if levels[instance] == LogLevel::None { &[][..] } else { &self.entries[instance] };
            let note = self.note(instance, result, outcome, &shown, unshown);
            log.add(&note, said, &shown).map_err(unwritten)?;
            self.plottable(instance, said, &mut numbers);
        }
        let pipeline = (PIPELINE_FILE, "application/yaml", self.pipeline_text.as_bytes());
        let (out, topics) = log.finish(&[pipeline]).map_err(unwritten)?;
        let file = out.inner.into_inner().map_err(|error| failed(&path)(error.into_error()))?;
        // While other files are written.
        file.as_file().sync_all().map_err(failed(&path))?;
        put(file, &path)?;
        let text = serde_json::to_string_pretty(&layout::layout(&topics, &numbers)).unwrap_or_default();
        write_file(&folder.join(LAYOUT_FILE), format!("{text}\n").as_bytes())
    }

    /// Numbers of steps with several points make curves.
    fn plottable(&self, instance: usize, said: &[Entry], numbers: &mut Vec<(String, String)>) {
        let step = self.plan.step(instance);
        for entry in said.iter().filter(|_| !step.axes.is_empty()) {
            let Entry::Metric { name, .. } = entry else { continue };
            let curve = (format!("/{}/metrics", step.name), name.clone());
            if !numbers.contains(&curve) {
                numbers.push(curve);
            }
        }
    }

    fn note<'a>(
        &'a self,
        instance: usize,
        result: &'a InstanceResult,
        outcome: &'a Outcome,
        shown: &[Shown],
        unshown: String,
    ) -> StepNote<'a> {
        let step = self.plan.step(instance);
        let (stage, version) = (step.stage.name(), step.stage.version());
        let is_shown = |port: &str| shown.iter().any(|shown| shown.port == port);
        let made = outcome.outputs.iter().filter(|(port, _)| is_shown(port.as_str())).map(|(port, output)| {
            let path = self.paths[instance].get(port.as_str()).map(|path| path.display().to_string());
            (port.to_string(), Made { digest: output.digest.to_string(), path })
        });
        StepNote {
            step: &step.name,
            point: self.plan.point(instance),
            label: self.plan.label(instance),
            facts: Facts { stage, version, key: result.key, outputs: &outcome.outputs },
            made: made.collect(),
            failure: result.failure.as_ref().map(|failure| failure.message.as_str()),
            unshown,
            recipe: result.recipe_text(self.store).unwrap_or_else(|| "null".to_owned()),
        }
    }

    /// The sketches of an instance, made now from its outputs if none were made when it ran; otherwise why there are none. Lost ones
    /// are an error the first time: they are recomputed with their step.
    fn shown(&self, result: &InstanceResult, outcome: &Outcome) -> Result<Result<Vec<Shown>, String>, RunError> {
        match step_log::read(outcome, self.store) {
            Ok(Some(shown)) => return Ok(Ok(shown)),
            Ok(None) => {}
            Err(StepLogError::Store(error)) if outcome.sketches.is_some_and(|blob| !self.lost.contains(&blob)) => {
                return Err(error.into());
            }
            Err(error) => return Ok(Err(error.of_one_step()?)),
        }
        let kept = outcome.outputs.values().all(|output| self.store.contains(&output.digest));
        if !kept {
            let why =
                "it ran without being sketched, and its outputs were not kept; `log: full` sketches the next that runs";
            return Ok(Err(why.to_owned()));
        }
        match sketch_stored(outcome, self.store, self.look)? {
            Err(why) => Ok(Err(why)),
            Ok(bytes) => {
                let digest = self.store.put(&bytes)?;
                if let Some(recipe) = result.recipe(self.store) {
                    let Outcome { outputs, log, cost, .. } = outcome.clone();
                    let record = Record { recipe, outputs, log, sketches: Some(digest), cost };
                    self.store.commit(&record)?;
                }
                Ok(Shown::read_all(&bytes).map_err(|error| error.to_string()))
            }
        }
    }
}

/// Sketches of outputs that are in the store.
fn sketch_stored(outcome: &Outcome, store: &Store, look: &dyn Look) -> Result<Result<Vec<u8>, String>, RunError> {
    let mut shown = Vec::new();
    for (port, output) in &outcome.outputs {
        let Ok(kind) = output.kind.parse::<Kind>() else { continue };
        let value = match Artefact::decode(kind, &store.get(&output.digest)?) {
            Ok(value) => value,
            Err(error) => return Ok(Err(format!("output `{port}` cannot be read: {error}"))),
        };
        let sketches = look.sketches(&value).into_iter();
        shown.extend(sketches.map(|sketch| Shown { port: port.to_string(), sketch }));
    }
    Ok(Shown::write_all(&shown).map_err(|error| error.to_string()))
}
