//! Claims: of processes that share only a remote place, one computes a step and the others wait for it.
//!
//! # How
//!
//! The claims of all workers stand in numbered entries, `claims/00000000000000000017`. An entry is written on condition that
//! there is none of its number, and by a worker that has read all entries before it; so all workers read the same entries in
//! the same order, and an entry takes only what is free at its place. One entry says whatever its worker has to say at that
//! moment: many steps that it takes, outputs that were uploaded, values that it has and that are not kept, values that it wants.
//!
//! - A worker that is **alone** takes all steps with one entry, and then asks for none. Once another one is there it says which
//!   steps it computes, and from then on each step is taken by an entry; steps that will come next are taken along with it.
//! - A step is **free again** with the entry that names the records uploaded with it, and readers of an entry read these records
//!   first: who takes the step then finds it done.
//! - Each worker has an object, `workers/…`, written anew every five seconds, with what it holds and the entry up to which it has
//!   read. So one that begins reads a few entries only, and a worker removes entries of its own that all have read.
//! - A worker that gave **no sign of life** for a minute, by the clock of the place, is declared dead by an entry, and what it held is
//!   free; of two workers of one machine the one sees at once that the process of the other has ended. A worker that could not
//!   reach the place for so long holds nothing any more, and begins anew.
//! - **Values that are not kept** go from who has them to who wants them through an object, `handed/…`. One that was used up is said to be
//!   there until the records of the steps that have used it have arrived.
//!
//! Where the place does not keep to conditions, or fails, there are no claims: work goes on, and a step may be done twice.

mod entry;
mod keeper;
mod members;
#[cfg(test)]
mod tests;
mod view;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::open::Shared;
use crate::Digest;
use entry::{Entry, Holdings};
pub(super) use members::entry_number;
use view::View;

/// Starts the names of entries.
pub(super) const CLAIMS: &str = "claims/";
/// Starts the names of the objects of workers.
pub(super) const WORKERS: &str = "workers/";
/// Starts the names of values on their way.
pub(super) const HANDED: &str = "handed/";
/// Steps that are taken ahead suffice for about so long.
const AHEAD: Duration = Duration::from_millis(500);
/// No more steps are taken ahead.
const MOST_AHEAD: usize = 256;
/// A value that could not be fetched so often is computed.
const FETCHES: u32 = 3;
/// What a place without claims means.
const EFFECT: &str = "processes that share nothing else may do a step twice";
/// How long the end of a process waits for its last entry.
const FAREWELL: Duration = Duration::from_secs(3);

/// The times of claims; shorter ones in tests.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Times {
    /// Between two signs of life.
    pub beat: Duration,
    /// A worker that gave none for so long is dead.
    pub expiry: Duration,
    /// Between two looks for new entries while this process waits for others.
    pub poll_waiting: Duration,
    /// The same while it works beside others.
    pub poll_beside: Duration,
    /// The same while it is alone.
    pub poll_alone: Duration,
}

impl Default for Times {
    fn default() -> Self {
        Self {
            beat: Duration::from_secs(5),
            expiry: Duration::from_mins(1),
            poll_waiting: Duration::from_millis(100),
            poll_beside: Duration::from_millis(500),
            poll_alone: Duration::from_secs(1),
        }
    }
}

/// The claims of this process on a remote place. The first step that is asked for begins them.
#[derive(Debug)]
pub(crate) struct Claims {
    common: Arc<Common>,
    threads: Mutex<Option<keeper::Threads>>,
}

/// What the threads of this process share.
#[derive(Debug)]
struct Common {
    shared: Arc<Shared>,
    /// Which machine and process this is.
    process: String,
    times: Times,
    state: Mutex<State>,
    /// Something was asked for, or decided.
    changed: Condvar,
}

/// How far this process is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Phase {
    /// Nothing was asked for yet.
    #[default]
    New,
    /// It reads what the others hold.
    Joining,
    /// It takes part.
    Joined,
    /// There are no claims on this place: whoever asks gets what he asks for.
    Off,
    /// It has said its last entry.
    Left,
}

#[derive(Debug, Default)]
struct State {
    phase: Phase,
    /// The name of this worker.
    name: String,
    /// What the entries say, up to the last that was read.
    view: View,
    /// Steps that threads wait for.
    asked: BTreeSet<Digest>,
    /// Steps that will be asked for soon.
    next: Vec<Digest>,
    /// Steps that are taken and were not asked for yet.
    ahead: BTreeSet<Digest>,
    /// Steps that this process computes now.
    locked: BTreeSet<Digest>,
    /// Steps whose records are on their way, with a number that grows from one to the next.
    uploading: BTreeMap<Digest, u64>,
    /// How many records were ever on their way.
    uploads: u64,
    /// Values that are not here any more, with the number of uploads then. Others are told once these have arrived: among them may be
    /// the records of the steps that have used the value up, and who wants it for one of these must not take it for lost.
    used_up: BTreeMap<Digest, u64>,
    /// Batches of records that were written and not reported yet.
    batches: Vec<Digest>,
    /// Values that are here and not kept, with the number of their announcements.
    has: BTreeMap<Digest, u32>,
    /// Values that this process wants, by digest or by the key of their recipe, and the folder they go to.
    wants: BTreeMap<Digest, PathBuf>,
    /// Values that others want, by what was wanted, until all that belong together are there: the digests and the bytes.
    gathered: BTreeMap<Digest, Vec<(Digest, Vec<u8>)>>,
    /// Values on their way to others: what was wanted, the digest of the value, and its bytes.
    giving: Vec<(Digest, Digest, Vec<u8>)>,
    /// What was given, to be reported: what was wanted, and the digest.
    given: Vec<(Digest, Digest)>,
    /// What others want and this process has answered, until that is reported.
    answered: BTreeSet<Digest>,
    /// How often a value could not be fetched.
    lost: BTreeMap<Digest, u32>,
    /// Values that were put into the place for others.
    handed: BTreeSet<Digest>,
    /// Workers that are dead, to be reported.
    dead: BTreeSet<String>,
    /// Workers that had no object when it was last looked for.
    absent: BTreeSet<String>,
    /// Own entries that are still there, and when they were written.
    entries: VecDeque<(u64, Instant)>,
    /// When the last sign of life was sent, by [`keeper::clock`].
    beaten: f64,
    /// When this process last found what it asked for with another.
    waited: Option<Instant>,
    /// When a step was last taken, and the mean time between two.
    taken: Option<Instant>,
    pace_s: f64,
    /// The threads are to end.
    is_ending: bool,
}

/// The right to compute a step, among those that share the place; given back when this is dropped.
#[derive(Debug)]
pub(crate) struct Claim {
    common: Arc<Common>,
    key: Digest,
}

impl Drop for Claim {
    fn drop(&mut self) {
        // What is on its way stays taken until it has arrived.
        self.common.state().locked.remove(&self.key);
    }
}

/// What others see that this process has, until this is dropped.
#[derive(Debug)]
pub(crate) struct Having {
    common: Arc<Common>,
    digest: Digest,
}

impl Drop for Having {
    fn drop(&mut self) {
        let mut state = self.common.state();
        if let Some(count) = state.has.get_mut(&self.digest) {
            *count -= 1;
            if *count == 0 {
                state.has.remove(&self.digest);
                let uploads = state.uploads;
                state.used_up.insert(self.digest, uploads);
                state.tell_used_up();
            }
        }
    }
}

impl Common {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until something changes, or for so long.
    fn wait<'s>(&self, state: MutexGuard<'s, State>, longest: Duration) -> MutexGuard<'s, State> {
        self.changed.wait_timeout(state, longest).unwrap_or_else(PoisonError::into_inner).0
    }
}

impl State {
    /// Whether other workers take part.
    fn are_others(&self) -> bool {
        self.view.others(&self.name).next().is_some()
    }

    /// What this process holds in truth, whatever its entries say.
    fn holdings(&self) -> Holdings {
        let steps = self.ahead.iter().chain(&self.locked).chain(self.uploading.keys()).copied().collect();
        let wants = self.wants.keys().copied().collect();
        let has = self.has.keys().chain(self.used_up.keys()).copied().collect();
        Holdings { all: self.view.own(&self.name).all, waits: self.is_waiting(), steps, has, wants }
    }

    /// Whether this process has nothing to do but to wait for others.
    fn is_waiting(&self) -> bool {
        const LATELY: Duration = Duration::from_millis(200);
        let worked_lately = self.taken.is_some_and(|at| at.elapsed() < LATELY);
        let is_idle = self.locked.is_empty() && self.asked.is_empty() && !worked_lately;
        is_idle && self.waited.is_some_and(|at| at.elapsed() < LATELY)
    }

    /// What this process would write now as the next entry; `None` if it has nothing to say.
    fn entry(&self) -> Option<Entry> {
        let told = self.view.own(&self.name);
        let are_others = self.are_others();
        if told.all && !are_others {
            return None;
        }
        let truth = self.holdings();
        let is_free = |key: &&Digest| self.view.holder(key, &self.name).is_none();
        let asked = self.asked.iter().chain(&self.next).chain(&truth.steps).filter(|key| !told.steps.contains(key));
        let mut entry = Entry {
            worker: self.name.clone(),
            // With nobody else there, one word for all steps is enough.
            all: if are_others { told.all.then_some(false) } else { Some(true) },
            waits: (truth.waits != told.waits).then_some(truth.waits),
            takes: asked.filter(is_free).copied().collect(),
            ends: told.steps.difference(&truth.steps).copied().collect(),
            has: truth.has.difference(&told.has).copied().collect(),
            lacks: told.has.difference(&truth.has).copied().collect(),
            wants: truth.wants.difference(&told.wants).copied().collect(),
            unwants: told.wants.difference(&truth.wants).copied().collect(),
            batches: self.batches.clone(),
            given: self.given.clone(),
            dead: self.dead.iter().filter(|name| self.view.has(name)).cloned().collect(),
            ..Entry::default()
        };
        entry.ends.retain(|key| !entry.takes.contains(key));
        // The first entry is a greeting, so that one who is alone sees that it is not.
        (!entry.is_empty() || !self.view.has(&self.name)).then_some(entry)
    }

    /// Whether an entry should be written at once, rather than with the next look.
    fn is_urgent(&self) -> bool {
        let told = self.view.own(&self.name);
        if told.all && !self.are_others() {
            return false;
        }
        let wants = self.wants.keys().any(|name| !told.wants.contains(name));
        let dead = self.dead.iter().any(|name| self.view.has(name));
        let is_new = !self.view.has(&self.name);
        is_new || wants || dead || !self.asked.is_empty() || !self.given.is_empty() || !self.batches.is_empty()
    }
}

impl Claims {
    /// Claims for a process on a place; nothing is sent yet.
    pub(in crate::remote) fn new(shared: Arc<Shared>, machine: &str, times: Times) -> Self {
        let process = members::process(machine);
        let common = Common { shared, process, times, state: Mutex::default(), changed: Condvar::new() };
        Self { common: Arc::new(common), threads: Mutex::default() }
    }

    /// Takes the right to compute a step unless another process has it.
    pub fn take(&self, key: &Digest) -> Option<Claim> {
        let mut state = self.common.state();
        loop {
            match state.phase {
                Phase::New => {
                    state.phase = Phase::Joining;
                    drop(state);
                    self.start();
                    state = self.common.state();
                    continue;
                }
                Phase::Off | Phase::Left => {
                    state.locked.insert(*key);
                    return Some(Claim { common: Arc::clone(&self.common), key: *key });
                }
                Phase::Joined => {
                    let told = state.view.own(&state.name);
                    if told.all || told.steps.contains(key) {
                        state.asked.remove(key);
                        state.ahead.remove(key);
                        state.locked.insert(*key);
                        state.note_pace();
                        return Some(Claim { common: Arc::clone(&self.common), key: *key });
                    }
                    if state.view.holder(key, &state.name).is_some() {
                        state.asked.remove(key);
                        state.waited = Some(Instant::now());
                        return None;
                    }
                }
                Phase::Joining => {}
            }
            if state.asked.insert(*key) {
                self.common.changed.notify_all();
            }
            state = self.common.wait(state, self.common.times.poll_beside);
        }
    }

    fn start(&self) {
        let started = keeper::Threads::start(&self.common);
        if started.is_none() {
            // Where the system gives no thread there are no claims.
            self.common.state().phase = Phase::Off;
        }
        *self.threads.lock().unwrap_or_else(PoisonError::into_inner) = started;
    }

    /// How many steps are worth taking along with this one, of so many that are ready: none where steps need not be asked for, or this one is taken.
    pub fn worth_ahead(&self, key: &Digest, ready: usize) -> usize {
        let state = self.common.state();
        let told = state.view.own(&state.name);
        if state.phase != Phase::Joined || told.all || told.steps.contains(key) {
            return 0;
        }
        let others = state.view.others(&state.name).count();
        let pace = state.pace_s.max(AHEAD.as_secs_f64() / MOST_AHEAD as f64);
        ((AHEAD.as_secs_f64() / pace) as usize).min(ready / (2 * (others + 1)))
    }

    /// Whether no other process has this step.
    pub fn is_free(&self, key: &Digest) -> bool {
        let mut state = self.common.state();
        let is_free = state.view.holder(key, &state.name).is_none();
        if !is_free {
            state.waited = Some(Instant::now());
        }
        is_free
    }

    /// Steps to take along with the next that is asked for.
    pub fn take_ahead(&self, keys: Vec<Digest>) {
        self.common.state().next = keys;
    }

    /// A record is on its way: its step stays taken until it has arrived.
    pub fn uploads(&self, key: &Digest) {
        let mut state = self.common.state();
        if state.locked.contains(key) {
            let number = state.uploads;
            state.uploading.insert(*key, number);
            state.uploads += 1;
        }
    }

    /// Records have arrived with this batch, or will not arrive.
    pub fn uploaded(&self, keys: &[Digest], batch: Option<Digest>) {
        let mut state = self.common.state();
        keys.iter().for_each(|key| _ = state.uploading.remove(key));
        state.tell_used_up();
        // One that is alone reports nothing: who comes reads all records.
        if state.phase == Phase::Joined && !state.view.own(&state.name).all {
            state.batches.extend(batch);
        }
        self.common.changed.notify_all();
    }

    /// Whether others take part, so that what is made here should reach them soon.
    pub fn are_others(&self) -> bool {
        let state = self.common.state();
        state.phase == Phase::Joined && state.are_others()
    }

    /// Whether one of the others has nothing to do but to wait.
    pub fn are_awaited(&self) -> bool {
        let state = self.common.state();
        state.view.others(&state.name).any(|(_, holds)| holds.waits)
    }

    /// Lets others see that this process has a value.
    pub fn announce(&self, digest: &Digest) -> Having {
        *self.common.state().has.entry(*digest).or_default() += 1;
        Having { common: Arc::clone(&self.common), digest: *digest }
    }

    /// Whether another process has a value, and it is available from there.
    pub fn is_elsewhere(&self, digest: &Digest) -> bool {
        let mut state = self.common.state();
        state.waited = Some(Instant::now());
        let is_lost = state.lost.get(digest).is_some_and(|count| *count >= FETCHES);
        !is_lost && state.view.others(&state.name).any(|(_, held)| held.has.contains(digest))
    }

    /// Says that a value is wanted, by its digest or by the key of the recipe that makes it; it comes to this folder.
    pub fn want(&self, name: &Digest, folder: &Path) {
        let mut state = self.common.state();
        if state.wants.insert(*name, folder.to_owned()).is_none() {
            self.common.changed.notify_all();
        }
    }

    /// Says that it is not wanted any more.
    pub fn unwant(&self, name: &Digest) {
        self.common.state().wants.remove(name);
    }

    /// What others want.
    pub fn wanted(&self) -> Vec<Digest> {
        let state = self.common.state();
        let wants: BTreeSet<Digest> =
            state.view.others(&state.name).flat_map(|(_, held)| held.wants.iter().copied()).collect();
        wants.difference(&state.answered).copied().collect()
    }

    /// Gives a value to those who want `name`; it is sent when all is answered.
    pub fn give(&self, name: &Digest, digest: &Digest, bytes: Vec<u8>) {
        self.common.state().gathered.entry(*name).or_default().push((*digest, bytes));
    }

    /// All that was wanted by this name has been given: it is sent now, in one piece, since who wants it asks for nothing more afterwards.
    pub fn answer(&self, name: &Digest) {
        let mut state = self.common.state();
        if let Some(values) = state.gathered.remove(name) {
            state.giving.extend(values.into_iter().map(|(digest, bytes)| (*name, digest, bytes)));
            state.answered.insert(*name);
            self.common.changed.notify_all();
        }
    }

    /// Gives everything back and says so; waits a moment for that.
    pub fn leave(&self) {
        let mut state = self.common.state();
        state.is_ending = true;
        self.common.changed.notify_all();
        let until = Instant::now() + FAREWELL;
        while matches!(state.phase, Phase::Joining | Phase::Joined) && Instant::now() < until {
            state = self.common.wait(state, Duration::from_millis(50));
        }
        let has_ended = !matches!(state.phase, Phase::Joining | Phase::Joined);
        drop(state);
        let threads = self.threads.lock().unwrap_or_else(PoisonError::into_inner).take();
        threads.into_iter().filter(|_| has_ended).for_each(keeper::Threads::join);
    }
}

impl Drop for Claims {
    fn drop(&mut self) {
        self.leave();
    }
}

impl State {
    /// Values that are used up are no longer said to be here, once all records have arrived that were on their way then.
    fn tell_used_up(&mut self) {
        let first = self.uploading.values().min().copied();
        self.used_up.retain(|_, uploads| first.is_some_and(|first| first < *uploads));
    }

    /// A step was taken.
    fn note_pace(&mut self) {
        let now = Instant::now();
        if let Some(before) = self.taken.replace(now) {
            let interval = now.duration_since(before).as_secs_f64().min(1.0);
            self.pace_s = if self.pace_s == 0.0 { interval } else { 0.8 * self.pace_s + 0.2 * interval };
        }
    }
}
