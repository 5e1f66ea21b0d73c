//! The threads of claims: one writes and reads entries, the other gives signs of life.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::entry::{Entry, LIMIT};
use super::members::{entry_name, object_name};
use super::view::View;
use super::{Common, EFFECT, HANDED, Phase};
use crate::Digest;
use crate::remote::backend::{Backend, BackendError};
use crate::remote::{AT_ONCE, OBJECT_LIMIT, each_at_once};

/// A pause after a request that failed.
const PAUSE: Duration = Duration::from_millis(200);
/// Values on their way are no larger, bytes.
const VALUE_LIMIT: u64 = 16 * OBJECT_LIMIT;

/// The threads of a process that takes part.
#[derive(Debug)]
pub(super) struct Threads(Vec<JoinHandle<()>>);

impl Threads {
    /// Starts them; `None` where the system gives none.
    pub fn start(common: &Arc<Common>) -> Option<Self> {
        let (keeping, beating) = (Arc::clone(common), Arc::clone(common));
        let spawn = |name: &str, work: Box<dyn FnOnce() + Send>| {
            std::thread::Builder::new().name(name.to_owned()).spawn(work).ok()
        };
        let beats = spawn("beats", Box::new(move || beating.give_signs()))?;
        let claims = spawn("claims", Box::new(move || keeping.keep()))?;
        Some(Self(vec![claims, beats]))
    }

    /// Waits for their end.
    pub fn join(self) {
        self.0.into_iter().for_each(|thread| drop(thread.join()));
    }
}

/// Seconds of a clock that goes on while the machine sleeps.
pub(super) fn clock() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// What came of a turn.
enum Turn {
    /// There may be more to read or to say.
    Again,
    /// Everything was read, and there was nothing to say.
    Idle,
    /// This worker is taken for dead, or may be.
    Lost,
    /// The last entry was written.
    Left,
}

impl Common {
    /// The thread that writes and reads entries.
    fn keep(&self) {
        let result = loop {
            if self.shared.breaker.is_off() {
                break Ok(());
            }
            match self.join() {
                Ok(true) => {}
                Ok(false) => break Ok(()),
                Err(fault) => break Err(fault),
            }
            self.state().phase = Phase::Joined;
            self.changed.notify_all();
            match self.turns() {
                Ok(Turn::Lost) => self.state().phase = Phase::Joining,
                Ok(_) => return self.end(Phase::Left),
                Err(fault) => break Err(fault),
            }
        };
        if let Err(fault) = result
            && !self.shared.breaker.is_off()
        {
            self.shared.breaker.warn_once(&format!("takes no claims ({fault}): {EFFECT}"));
        }
        self.end(Phase::Off);
    }

    fn end(&self, phase: Phase) {
        let mut state = self.state();
        (state.phase, state.view) = (phase, View::default());
        self.changed.notify_all();
    }

    /// Takes turns until it is over. An error is one after which the place is left alone.
    fn turns(&self) -> Result<Turn, BackendError> {
        for number in 1.. {
            match self.turn(number) {
                Ok(Turn::Again) => {}
                Ok(Turn::Idle) => self.rest(),
                Ok(over) => return Ok(over),
                Err(BackendError::Unavailable(_)) if !self.shared.breaker.is_off() => std::thread::sleep(PAUSE),
                Err(fault) => return Err(fault),
            }
        }
        Ok(Turn::Left)
    }

    /// Waits until there is something to say, or the time of the next look has come.
    fn rest(&self) {
        let mut state = self.state();
        let begun = Instant::now();
        loop {
            let are_others = state.are_others();
            let is_waiting = state.waited.is_some_and(|at| at.elapsed() < 4 * self.times.poll_beside);
            let every = match (are_others, is_waiting) {
                (false, _) => self.times.poll_alone,
                (true, true) => self.times.poll_waiting,
                (true, false) => self.times.poll_beside,
            };
            let rest = every.saturating_sub(begun.elapsed());
            if rest.is_zero() || state.is_ending || !state.giving.is_empty() || state.is_urgent() {
                return;
            }
            state = self.wait(state, rest);
        }
    }

    fn turn(&self, turn: u64) -> Result<Turn, BackendError> {
        self.upload_given()?;
        let (entry, number) = {
            let state = self.state();
            let is_late = clock() - state.beaten > 0.75 * self.times.expiry.as_secs_f64();
            if is_late || state.view.is_gone(&state.name) {
                return Ok(if state.is_ending { Turn::Left } else { Turn::Lost });
            }
            let entry = if state.is_ending {
                let batches = state.batches.clone();
                Some(Entry { worker: state.name.clone(), batches, leaves: true, ..Entry::default() })
            } else {
                state.entry()
            };
            (entry, state.view.read + 1)
        };
        let (backend, breaker) = (&self.shared.backend, &self.shared.breaker);
        let name = entry_name(number);
        let Some(entry) = entry.map(|entry| Entry { turn, ..entry }) else {
            return match breaker.attempt(|| backend.get(&name, LIMIT)) {
                Ok(bytes) => self.read(number, &Entry::decode(&bytes)),
                Err(BackendError::Missing) => Ok(Turn::Idle),
                Err(fault) => Err(fault),
            };
        };
        if !breaker.attempt(|| backend.create(&name, &entry.encode()))? {
            let found = match breaker.attempt(|| backend.get(&name, LIMIT)) {
                // Entries that this worker has not read are removed: it was away for long.
                Err(BackendError::Missing) => return Ok(Turn::Lost),
                bytes => Entry::decode(&bytes?),
            };
            // An answer may get lost, and a request be sent twice.
            if (&found.worker, found.turn) != (&entry.worker, turn) {
                return self.read(number, &found);
            }
        }
        self.said(number, &entry);
        if entry.leaves {
            // Who finds it later takes this worker for dead, which does no harm.
            drop(backend.delete(&object_name(&entry.worker)));
            let handed = std::mem::take(&mut self.state().handed);
            each_at_once(handed.into_iter().collect(), AT_ONCE, |digest| drop(backend.delete(&handed_name(&digest))));
            return Ok(Turn::Left);
        }
        for dead in &entry.dead {
            drop(backend.delete(&object_name(dead)));
        }
        Ok(Turn::Again)
    }

    /// The entry of this number is one of this worker.
    fn said(&self, number: u64, entry: &Entry) {
        let mut state = self.state();
        state.view.apply(number, entry);
        let new: Vec<Digest> = entry.takes.iter().filter(|key| !state.is_used(key)).copied().collect();
        state.ahead.extend(new);
        state.next.clear();
        state.batches.retain(|batch| !entry.batches.contains(batch));
        state.given.retain(|given| !entry.given.contains(given));
        state.dead.clear();
        state.forget_answered();
        state.entries.push_back((number, Instant::now()));
        self.changed.notify_all();
    }

    /// Reads the entry of another worker: first what it names, then itself.
    fn read(&self, number: u64, entry: &Entry) -> Result<Turn, BackendError> {
        let (is_unsure, wanted) = {
            let state = self.state();
            let had_all = |name: &String| state.view.own(name).all;
            // Who had all steps reported no records, and the dead may not have come to it.
            let is_over = entry.all == Some(false) || entry.leaves;
            let is_unsure = !entry.dead.is_empty() || (is_over && had_all(&entry.worker));
            let wanted = |(name, digest): &(Digest, Digest)| Some((*digest, state.wants.get(name)?.clone()));
            (is_unsure, entry.given.iter().filter_map(wanted).collect::<Vec<_>>())
        };
        if is_unsure {
            self.shared.breaker.attempt(|| self.shared.refresh())?;
        }
        for batch in &entry.batches {
            self.shared.read_batch(batch)?;
        }
        for (digest, folder) in wanted {
            self.fetch_value(&digest, &folder)?;
        }
        let mut state = self.state();
        state.view.apply(number, entry);
        entry.given.iter().for_each(|(name, _)| _ = state.wants.remove(name));
        state.forget_answered();
        self.changed.notify_all();
        Ok(if state.view.is_gone(&state.name) { Turn::Lost } else { Turn::Again })
    }

    /// Fetches a value that another worker has given, and puts it where it is wanted. One that is damaged or gone is asked for again a few times.
    fn fetch_value(&self, digest: &Digest, folder: &Path) -> Result<(), BackendError> {
        let found = self.shared.breaker.attempt(|| self.shared.backend.get(&handed_name(digest), VALUE_LIMIT));
        let bytes = match found {
            Err(fault @ BackendError::Unavailable(_)) => return Err(fault),
            found => found.ok().filter(|bytes| Digest::of(bytes) == *digest),
        };
        let put = |bytes: Vec<u8>| crate::values::put_into(folder, digest, &bytes).ok();
        if bytes.and_then(put).is_none() {
            *self.state().lost.entry(*digest).or_default() += 1;
        }
        Ok(())
    }

    /// Uploads the values that others want.
    fn upload_given(&self) -> Result<(), BackendError> {
        loop {
            let Some((name, digest, bytes)) = self.state().giving.pop() else { return Ok(()) };
            if !self.state().handed.contains(&digest) {
                let backend = &self.shared.backend;
                let put = self.shared.breaker.attempt(|| backend.put(&handed_name(&digest), &bytes));
                if let Err(fault) = put {
                    self.state().giving.push((name, digest, bytes));
                    return Err(fault);
                }
            }
            let mut state = self.state();
            state.handed.insert(digest);
            state.given.push((name, digest));
        }
    }

    /// The thread that gives signs of life.
    fn give_signs(&self) {
        let mut last = Instant::now();
        for count in 1_u64.. {
            let mut state = self.state();
            loop {
                if state.is_ending || matches!(state.phase, Phase::Off | Phase::Left) {
                    return;
                }
                let rest = self.times.beat.saturating_sub(last.elapsed());
                if rest.is_zero() {
                    break;
                }
                state = self.wait(state, rest);
            }
            last = Instant::now();
            let (is_joined, are_others) = (state.phase == Phase::Joined, state.are_others());
            let old = state.old_entries(2 * self.times.expiry);
            drop(state);
            // What fails now is done with the next sign; the breaker takes note of it.
            if is_joined {
                drop(self.beat());
                if are_others || count.is_multiple_of(6) {
                    drop(self.look_for_dead());
                }
                each_at_once(old, AT_ONCE, |number| drop(self.shared.backend.delete(&entry_name(number))));
            }
        }
    }
}

/// The name of a value on its way.
fn handed_name(digest: &Digest) -> String {
    format!("{HANDED}{digest}")
}

impl super::State {
    fn is_used(&self, key: &Digest) -> bool {
        self.locked.contains(key) || self.uploading.contains_key(key)
    }

    /// What nobody wants any more may be wanted again.
    fn forget_answered(&mut self) {
        let wants: Vec<Digest> =
            self.view.others(&self.name).flat_map(|(_, held)| held.wants.iter().copied()).collect();
        self.answered.retain(|name| wants.contains(name));
    }

    /// Own entries of so long ago, which are removed: all who live have read them.
    fn old_entries(&mut self, age: Duration) -> Vec<u64> {
        let newest = self.view.read;
        let is_old = |(number, at): &(u64, Instant)| at.elapsed() > age && *number < newest;
        let count = self.entries.iter().take_while(|entry| is_old(entry)).count();
        let old: VecDeque<_> = self.entries.drain(..count).collect();
        old.into_iter().map(|(number, _)| number).collect()
    }
}
