//! One step instance: lock its key, run the stage, which reads its inputs, store the outputs, then the record.

use std::collections::BTreeMap;
use std::os::unix::fs::MetadataExt;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use rockface_cache::{
    Announced, Cost, Digest, KeyLock, Outcome, OutputRecord, Outputs, Parcel, Recipe, Record, SafeName, Store,
    StoreError,
};
use rockface_core::artefact::{Artefact, Kind};
use rockface_core::{AnyStage, Context, Entry, Inputs, Later, Look, Point, Port, StageError};

use super::failure::{Failure, Left, Trouble, guarded};
use super::host::StepHost;
use super::program::Used;
use super::standing::Standing;
use super::threads::Threads;
use super::tools;
use crate::PHASE;
use crate::plan::{InputFile, StepParams, has_ports};
use crate::run::spill::Spilled;

/// An artefact that is in memory, or where it is read from when the stage asks for it.
pub enum Value {
    /// In memory, so many bytes.
    Ready(Arc<Later<'static>>, usize),
    /// Not in memory.
    Away(Source),
}

impl Value {
    /// A value in memory that others may ask for too.
    pub fn shared(value: Arc<Artefact>) -> Self {
        let bytes = value.memory_bytes();
        Self::Ready(Arc::new(Later::ready(value)), bytes)
    }

    /// A value in memory that only this task will ask for: its stage may change it in place.
    pub fn last(value: Arc<Artefact>) -> Self {
        let bytes = value.memory_bytes();
        Self::Ready(Arc::new(Later::last(value)), bytes)
    }
}

/// What an artefact is read from.
pub enum Source {
    /// A blob of this kind in the store.
    Stored(Kind, Digest),
    /// A file, to which it was written for want of memory.
    Spilled(Arc<Spilled>),
}

/// One element of an input.
pub struct Feed {
    /// The input port that it feeds.
    pub port: &'static str,
    /// Items of the gathered axes.
    pub point: Point,
    /// Producer and its port.
    pub from: (usize, &'static str),
    /// The digest of the artefact and the bytes of its blob, whether it is in the store or not.
    pub blob: Option<(Digest, u64)>,
    /// The artefact, or where to read it.
    pub value: Value,
}

/// Everything a worker needs to run one instance.
pub struct Task {
    /// What its work is shown as in a trace.
    pub span: tracing::Span,
    /// The number of the instance in the plan.
    pub instance: usize,
    /// The stage it uses.
    pub stage: &'static dyn AnyStage,
    /// What its result is determined by: stage, version, parameters, seed and inputs.
    pub recipe: Recipe,
    /// The key of the recipe.
    pub key: Digest,
    /// Its parameters, filled in and checked.
    pub params: Arc<StepParams>,
    /// The artefacts it reads, an element for each.
    pub feeds: Vec<Feed>,
    /// Output ports its step declares.
    pub ports: &'static [Port],
    /// Output ports it must make.
    pub outputs: Vec<(&'static str, Kind)>,
    /// Whether its outputs are kept.
    pub keep: bool,
    /// It is recorded, but its values are needed.
    pub recompute: bool,
    /// The lock of its key, if it is held already.
    pub lease: Option<KeyLock>,
    /// Whether it runs twice, to see whether its outputs are the same.
    pub check: bool,
    /// How long one attempt may take.
    pub timeout: Option<Duration>,
    /// How often it is tried again after a failure.
    pub retries: u32,
    /// What draws its outputs, where the log is to show them.
    pub sketch: Option<&'static dyn Look>,
    /// The greatest memory of the process that was seen since it began, bytes.
    pub peak_bytes: Arc<AtomicU64>,
}

impl Task {
    /// The bytes of its inputs in memory; `None` where some have yet to be read.
    fn bytes(&self) -> Option<usize> {
        let of_feed = |feed: &Feed| match &feed.value {
            Value::Ready(_, bytes) => Some(*bytes),
            Value::Away(_) => None,
        };
        self.feeds.iter().map(of_feed).sum()
    }
}

/// Where a worker works.
#[derive(Clone, Copy)]
pub struct Place<'a> {
    /// Inputs, results and locks.
    pub store: &'a Store,
    /// The threads that stages compute on, shared by all workers.
    pub threads: &'a Threads,
    /// Set once the user asked to stop; stages and waits look at it.
    pub stop: &'a AtomicBool,
    /// Programs that stay alive between jobs.
    pub standing: &'a Standing,
}

/// What a worker brings back.
pub struct Done {
    /// What the record says.
    pub outcome: Outcome,
    /// The outputs in memory; empty when another process had done the work.
    pub values: BTreeMap<&'static str, Arc<Artefact>>,
    /// What other processes see that it is in memory here, as it is in no store.
    pub announced: BTreeMap<&'static str, Arc<Announced>>,
    /// Inputs it had to read and kept, for other consumers.
    pub loaded: Vec<((usize, &'static str), Arc<Artefact>)>,
    /// Warnings for people: of failed attempts, of missing sketches, and those the stage logged.
    pub warnings: Vec<String>,
    /// Another process did the work meanwhile.
    pub elsewhere: bool,
}

impl Done {
    /// Another process has done the work.
    fn elsewhere(outcome: Outcome) -> Self {
        let (values, announced) = (BTreeMap::new(), BTreeMap::new());
        Self { outcome, values, announced, loaded: Vec::new(), warnings: Vec::new(), elsewhere: true }
    }
}

/// Runs one instance.
///
/// Locks are taken and the store is used on the calling thread. Only computing goes into the pool, unless it is short: a thread of the pool
/// that waits for its fellows takes up other work meanwhile, and must not come upon a lock held further down its stack.
pub fn work(task: &Task, place: Place) -> Result<Done, Failure> {
    let Place { store, threads, .. } = place;
    let _step = task.span.enter();
    // What has come from a remote place since it was settled need not be locked, which takes a request there.
    if task.lease.is_none()
        && store.remote().is_some()
        && let Some(outcome) = done_elsewhere(task, store)
    {
        return Ok(Done::elsewhere(outcome));
    }
    let lock = if task.lease.is_none() { phase!("lock", store.try_lock(&task.key))? } else { None };
    if task.lease.is_none() && lock.is_none() {
        return Err(Failure::Held);
    }
    // Whoever held the key before may have done the work since it was last looked for.
    phase!("refresh", store.refresh())?;
    if let Some(outcome) = done_elsewhere(task, store) {
        return Ok(Done::elsewhere(outcome));
    }
    let start = Instant::now();
    let cpu = process_cpu_s();
    let trouble = Trouble::default();
    let (inputs, stored) = inputs(task, store, &trouble);
    let before = fingerprints(task)?;
    let given = Given { inputs: &inputs, trouble: &trouble };
    let (outputs, entries, retried, programs) = phase!("stage", attempts(task, given, place))?;
    if task.check {
        check_again(task, given, place, &outputs)?;
    }
    unchanged_files(task, store, &before)?;
    let unchanged = unchanged(task, &outputs)?;
    let values: BTreeMap<_, _> =
        outputs.into_inner().into_iter().map(|(port, value)| (port, Arc::new(value))).collect();
    let mut parcel = store.parcel();
    let mut outcome = keep(task, &mut parcel, threads, &values, &unchanged, &entries)?;
    let (sketches, unsketched) = phase!("sketch", sketch(task, (store, &mut parcel), threads, &values, &outcome))?;
    outcome.sketches = sketches;
    let kept = |(from, later): &(_, Arc<Later>)| later.kept().map(|value| (*from, value.clone()));
    let loaded: Vec<_> = stored.iter().filter_map(kept).collect();
    let handled = values.values().chain(loaded.iter().map(|(_, value)| value));
    let handled_bytes: u64 = handled.map(|value| value.memory_bytes() as u64).sum();
    let finished = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    outcome.cost = Cost {
        wall_s: start.elapsed().as_secs_f64(),
        cpu_s: process_cpu_s() - cpu + programs.cpu_s,
        peak_bytes: handled_bytes.max(task.peak_bytes.load(Ordering::Relaxed)).max(programs.peak_bytes),
        finished_unix_s: finished,
    };
    // Before anybody can see that it is done.
    let announced = announce(task, store, &outcome)?;
    let Outcome { outputs, log, sketches, cost } = outcome.clone();
    let put_again = || {
        // The small ones are in the first parcel.
        let mut again = store.parcel();
        let made = keep(task, &mut again, threads, &values, &unchanged, &entries)?;
        sketch(task, (store, &mut again), threads, &values, &made)
    };
    let record = Record { recipe: task.recipe.clone(), outputs, log, sketches, cost };
    phase!("commit", parcel.commit_or(&record, || put_again().map(drop)))?;
    tools::remember(store, &task.key, &programs.tools)?;
    let warnings =
        entries.into_iter().filter_map(|entry| if let Entry::Warning { text } = entry { Some(text) } else { None });
    let warnings = retried.into_iter().chain(unsketched).chain(warnings).collect();
    Ok(Done { outcome, values, announced, loaded, warnings, elsewhere: false })
}

/// Lets other processes see what is in memory here and in no store.
fn announce(
    task: &Task,
    store: &Store,
    outcome: &Outcome,
) -> Result<BTreeMap<&'static str, Arc<Announced>>, StoreError> {
    let made = task.outputs.iter().filter(|_| !task.keep);
    made.map(|(port, _)| Ok((*port, Arc::new(store.announce(&outcome.outputs[*port].digest)?)))).collect()
}

/// The outcome another process has recorded meanwhile, if it has the values this task is for.
fn done_elsewhere(task: &Task, store: &Store) -> Option<Outcome> {
    let owed = task.outputs.iter().map(|(port, _)| *port);
    let outcome = crate::plan::hit(store, &task.key, task.keep, |outcome| has_ports(outcome, task.ports, owed))?;
    let values_there = outcome.outputs.values().all(|output| store.contains(&output.digest));
    (!task.recompute || values_there).then_some(outcome)
}

/// Inputs that were not in memory, by producer and port.
type Stored<'s> = Vec<((usize, &'static str), Arc<Later<'s>>)>;
/// The inputs of a task. Those that are in the store are read when the stage asks for them, in its thread: reading takes no
/// lock that is held while others compute.
fn inputs<'s>(task: &'s Task, store: &'s Store, trouble: &'s Trouble) -> (Inputs<'s>, Stored<'s>) {
    let (mut inputs, mut stored) = (Inputs::default(), Stored::new());
    for feed in &task.feeds {
        let known = stored.iter().find(|(from, _)| *from == feed.from).map(|(_, later)| later);
        let value = match (&feed.value, known) {
            (Value::Ready(later, _), _) | (Value::Away(_), Some(later)) => later.clone(),
            (Value::Away(source), None) => {
                let later = Arc::new(Later::new(move || {
                    read(feed, source, store).map_err(|failure| {
                        *trouble.lock().unwrap_or_else(PoisonError::into_inner) = Some(failure);
                        StageError::new(format!("input `{}` cannot be read", feed.port))
                    })
                }));
                stored.push((feed.from, later.clone()));
                later
            }
        };
        inputs.push_later(feed.port, feed.point.clone(), value);
    }
    (inputs, stored)
}

fn read(feed: &Feed, source: &Source, store: &Store) -> Result<Arc<Artefact>, Failure> {
    let _input = tracing::trace_span!(target: PHASE, "input", port = feed.port).entered();
    let lost = |why: String| Failure::Lost(feed.from.0, why);
    let (kind, digest) = match source {
        Source::Spilled(spilled) => return spilled.read().map(Arc::new).map_err(lost),
        Source::Stored(kind, digest) => (*kind, digest),
    };
    let bytes = match store.get(digest) {
        Ok(bytes) => bytes,
        Err(error @ StoreError::Damaged { .. }) => return Err(lost(error.of_recomputed())),
        Err(error) if !store.contains(digest) => return Err(lost(error.of_recomputed())),
        Err(error) => return Err(error.into()),
    };
    let decoded = Artefact::decode(kind, &bytes);
    decoded.map(Arc::new).map_err(|error| unreadable(feed, digest, &error.to_string()))
}

/// A blob that is what was stored and yet cannot be read: making it again would not help.
fn unreadable(feed: &Feed, digest: &Digest, why: &str) -> Failure {
    let message = format!("input `{}` (blob {}) cannot be read back: {why}", feed.port, digest.short());
    let hint = "the stage that made it wrote what no reader takes; please report it with the pipeline";
    StageError::new(message).hint(hint).into()
}

fn run_stage(task: &Task, inputs: &Inputs, host: &StepHost) -> Result<Made, Failure> {
    let context = Context::new(host);
    let run = || task.stage.run(&task.params.canonical, inputs, &context).map_err(Failure::from);
    let outputs = guarded(run)?;
    for (port, kind) in &task.outputs {
        match outputs.get(port) {
            Some(value) if value.kind() == *kind => {}
            found => {
                let found = found.map_or_else(|| "nothing".to_owned(), |value| format!("a {}", value.kind()));
                let message = format!("the stage owes a {kind} at `{port}` and made {found}");
                return Err(StageError::new(message).into());
            }
        }
    }
    Ok(outputs)
}

/// What a stage is given, and where a failure outside of it is noted.
#[derive(Clone, Copy)]
struct Given<'a> {
    inputs: &'a Inputs<'a>,
    trouble: &'a Trouble,
}

type Made = rockface_core::Outputs;
/// The result of one attempt, the log of the stage, and the cost of its programs.
type Attempt = (Result<Made, StageError>, (Vec<Entry>, Used));
/// Size, times of modification and change, inode.
type Fingerprint = (u64, i64, i64, i64, i64, u64);

/// Runs the stage, and repeats it as often as it may fail; also returns the failures that a retry has overcome, and what programs took
/// in the go that succeeded.
fn attempts(task: &Task, given: Given, place: Place) -> Result<(Made, Vec<Entry>, Vec<String>, Used), Failure> {
    let (mut told, mut said) = (Vec::new(), Vec::new());
    loop {
        let (result, (entries, used)) = attempt(task, given, place)?;
        let error = match result {
            Ok(outputs) => return Ok((outputs, entries, told, used)),
            Err(error) => error,
        };
        said.extend(entries);
        if told.len() == task.retries as usize || place.stop.load(Ordering::Relaxed) {
            // If log and evidence cannot be stored, the cause is reported all the same.
            let log = keep_log(place.store, &said).unwrap_or_default();
            let outputs = evidence(&error, place.store).unwrap_or_default();
            return Err(Failure::Stage(error, Left { log, outputs }));
        }
        let text = format!("attempt {} of {} failed: {error}", told.len() + 1, task.retries + 1);
        said.push(Entry::Warning { text: text.clone() });
        told.push(text);
    }
}

/// Runs the stage once more and refuses outputs that differ.
fn check_again(task: &Task, given: Given, place: Place, first: &Made) -> Result<(), Failure> {
    let (second, _) = attempt(task, given, place)?;
    let second = second?;
    for (port, value) in first.by_port() {
        let encoded = |value: &Artefact| value.encode().map_err(|error| StageError::new(error.to_string()));
        let again = second.get(port).map(encoded).transpose()?;
        if again.as_ref() != Some(&encoded(value)?) {
            let message =
                format!("it is not deterministic: output `{port}` differs between two runs with equal inputs");
            let hint =
                "draw random numbers from the step's own stream only, and depend on no clock, thread or order of a set";
            return Err(StageError::new(message).hint(hint).into());
        }
    }
    Ok(())
}

/// Stores the outputs that explain a failure.
fn evidence(error: &StageError, store: &Store) -> Result<Outputs, Failure> {
    let mut outputs = Outputs::default();
    for (port, value) in error.evidence.iter().flat_map(|evidence| evidence.by_port()) {
        let encoded = value.encode().map_err(|error| StageError::new(error.to_string()))?;
        let digest = store.put(&encoded)?;
        outputs.insert(port_name(port)?, record_of(value, digest, encoded.len() as u64, true));
    }
    Ok(outputs)
}

fn port_name(port: &str) -> Result<SafeName, Failure> {
    SafeName::new(port).map_err(|error| StageError::new(error.to_string()).into())
}

fn record_of(value: &Artefact, digest: Digest, bytes: u64, kept: bool) -> OutputRecord {
    OutputRecord {
        kind: value.kind().word().to_owned(),
        digest,
        bytes,
        memory_bytes: Some(value.memory_bytes() as u64),
        kept,
        items: value.items(),
    }
}

/// Stores the log of a step, unless it is empty.
fn keep_log(store: &Store, said: &[Entry]) -> Result<Option<Digest>, StoreError> {
    log_text(said).map(|text| store.put(&text)).transpose()
}

/// The bytes of a log; `None` of an empty one.
fn log_text(said: &[Entry]) -> Option<Vec<u8>> {
    (!said.is_empty()).then(|| serde_json::json!(said).to_string().into_bytes())
}

fn attempt(
    task: &Task,
    Given { inputs, trouble }: Given,
    Place { store, threads, stop, standing }: Place,
) -> Result<Attempt, Failure> {
    let seed = task.recipe.seed.as_ref().map(rockface_cache::SeedMaterial::key);
    let deadline = task.timeout.map(|timeout| Instant::now() + timeout);
    let programs = task.stage.starts_programs().then_some(standing);
    let host = StepHost::new(seed, &task.params.files, store, stop, deadline, trouble, programs);
    let result = threads.run(task.stage.name(), task.bytes(), || run_stage(task, inputs, &host));
    if let Some(failure) = trouble.lock().unwrap_or_else(PoisonError::into_inner).take() {
        return Err(failure);
    }
    let result = match (result, task.timeout) {
        (Err(Failure::Stage(error, _)), Some(timeout)) if host.is_late() && !stop.load(Ordering::Relaxed) => {
            let message =
                format!("it took longer than its timeout of {}: {error}", humantime::format_duration(timeout));
            let hint = "give it more with `timeout:` on the step, or less to do";
            Err(StageError::new(message).hint(hint))
        }
        (Err(Failure::Stage(error, _)), _) => Err(error),
        (result, _) => Ok(result?),
    };
    Ok((result, host.end()))
}

/// The states of all input files.
fn fingerprints(task: &Task) -> Result<Vec<Fingerprint>, Failure> {
    let look = |file: &InputFile| {
        let meta = std::fs::metadata(&file.path).map_err(|error| cannot_read(file, &error))?;
        Ok((meta.len(), meta.mtime(), meta.mtime_nsec(), meta.ctime(), meta.ctime_nsec(), meta.ino()))
    };
    task.params.files.values().flatten().map(look).collect()
}

fn cannot_read(file: &InputFile, error: &std::io::Error) -> StageError {
    let path = file.path.display();
    let Some(run) = &file.gone_since else { return StageError::new(format!("cannot read `{path}`: {error}")) };
    let message = format!("`{path}` is not there, and this step has no result in the store that spares reading it");
    StageError::new(message).hint(format!("put back the file that run {run} read (BLAKE3 {}…)", file.digest.short()))
}

/// An input file that changed while the stage read it must not be recorded under its former digest.
fn unchanged_files(task: &Task, store: &Store, before: &[Fingerprint]) -> Result<(), Failure> {
    let touched = fingerprints(task)? != before;
    for file in task.params.files.values().flatten() {
        let now = store.hash_file(&file.path)?.digest;
        if touched || now != file.digest {
            let message = format!("`{}` changed while it was read", file.path.display());
            return Err(StageError::new(message).hint("run again once nobody writes to it").into());
        }
    }
    Ok(())
}

/// The blobs of outputs that are inputs unchanged. What a stage says of that is held against the bytes where its determinism is checked, and
/// in every test.
fn unchanged(task: &Task, outputs: &Made) -> Result<BTreeMap<&'static str, (Digest, u64)>, Failure> {
    let mut unchanged = BTreeMap::new();
    for (output, value) in outputs.by_port() {
        let Some(input) = outputs.unchanged_from(output) else { continue };
        let mut feeds = task.feeds.iter().filter(|feed| feed.port == input);
        let (Some(feed), None) = (feeds.next(), feeds.next()) else { continue };
        let Some(blob) = feed.blob else { continue };
        if task.check || cfg!(debug_assertions) {
            let (digest, _, given) = Digest::of_pieces(|take| value.stream(take));
            given.map_err(|error| StageError::new(error.to_string()))?;
            if digest != blob.0 {
                let message = format!("output `{output}` is said to be input `{input}` unchanged, and differs from it");
                return Err(StageError::new(message).hint("a fault of the stage: please report it").into());
            }
        }
        unchanged.insert(output, blob);
    }
    Ok(unchanged)
}

fn keep(
    task: &Task,
    parcel: &mut Parcel,
    threads: &Threads,
    values: &BTreeMap<&'static str, Arc<Artefact>>,
    unchanged: &BTreeMap<&'static str, (Digest, u64)>,
    entries: &[Entry],
) -> Result<Outcome, Failure> {
    let mut outputs = Outputs::default();
    for (port, value) in values {
        let unwritable = |error| StageError::new(format!("output `{port}` cannot be written: {error}"));
        // Writing text takes no threads.
        let text = value.kind().extension() == "json";
        let bytes = if text { 0 } else { value.memory_bytes() };
        let (digest, bytes) = if task.keep {
            let encoded = phase!("encode", threads.compute(bytes, || value.encode())).map_err(unwritable)?;
            let bytes = encoded.len() as u64;
            (phase!("put", parcel.put(encoded))?, bytes)
        } else if let Some(blob) = unchanged.get(port) {
            *blob
        } else {
            let hash = || Digest::of_pieces(|take| value.stream(take));
            let (digest, bytes, given) = phase!("hash", threads.compute(bytes, hash));
            given.map_err(unwritable)?;
            (digest, bytes)
        };
        outputs.insert(port_name(port)?, record_of(value, digest, bytes, task.keep));
    }
    let log = log_text(entries).map(|text| parcel.put(text)).transpose()?;
    Ok(Outcome { outputs, log, sketches: None, cost: Cost::default() })
}

/// Stores sketches of the outputs if the log is to show them, or else keeps those of an earlier go with equal outputs.
/// A failure to draw them is reported; the outputs of the stage are kept.
fn sketch(
    task: &Task,
    (store, parcel): (&Store, &mut Parcel),
    threads: &Threads,
    values: &BTreeMap<&'static str, Arc<Artefact>>,
    outcome: &Outcome,
) -> Result<(Option<Digest>, Option<String>), Failure> {
    let Some(look) = task.sketch else {
        let former = store.record(&task.key).filter(|former| former.outputs == outcome.outputs);
        return Ok((former.and_then(|former| former.sketches).filter(|blob| store.contains(blob)), None));
    };
    let made = guarded(|| {
        let bytes = values.values().map(|value| value.memory_bytes()).sum();
        let bytes = threads.compute(bytes, || crate::watch::step_log::sketched(values, look));
        bytes.map_err(|error| StageError::new(error.to_string()).into())
    });
    match made {
        Ok(bytes) => Ok((Some(parcel.put(bytes)?), None)),
        Err(Failure::Stage(error, _)) => Ok((None, Some(format!("the log cannot show its outputs: {error}")))),
        Err(failure) => Err(failure),
    }
}

/// Processor seconds of this process so far, all threads.
fn process_cpu_s() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_anywhere_is_a_failure_that_says_what_was_said() {
        for panic in [|| panic!("at {}", 7), || panic!("at 7")] {
            match guarded::<()>(panic) {
                Err(Failure::Stage(error, _)) => assert_eq!(error.message, "the stage panicked: at 7"),
                _ => panic!("it should have failed"),
            }
        }
        assert!(guarded(|| Ok(1)).is_ok_and(|one| one == 1));
    }
}
