//! Workers as objects of the place: their names, their signs of life, and who is dead.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Duration;

use super::entry::{Entry, LIMIT, Member, is_name};
use super::view::View;
use super::{CLAIMS, Common, EFFECT, WORKERS};
use crate::Digest;
use crate::remote::backend::{Backend, BackendError, Object};
use crate::remote::{AT_ONCE, each_at_once};

/// No more old entries are removed by one who begins.
const CLEARED: usize = 1000;
/// Digits of the number of an entry.
const DIGITS: usize = 20;
/// No entry has this number.
const LAST: u64 = u64::MAX / 2;

/// The name of an entry.
pub(super) fn entry_name(number: u64) -> String {
    format!("{CLAIMS}{number:0DIGITS$}")
}

/// The number of an entry, from the name of its object.
pub(in crate::remote) fn entry_number(name: &str) -> Option<u64> {
    // A number that leaves none after it was not written by this program.
    name.strip_prefix(CLAIMS).filter(|digits| digits.len() == DIGITS)?.parse().ok().filter(|number| *number < LAST)
}

/// The name of the object of a worker.
pub(super) fn object_name(worker: &str) -> String {
    format!("{WORKERS}{worker}")
}

/// The machine and the process: who has them in common with a worker can see whether it lives.
pub(super) fn process(machine: &str) -> String {
    // Processes of containers have numbers of their own, one space of names for each container.
    let space = std::fs::read_link("/proc/self/ns/pid").ok().and_then(|link| link.to_str().map(str::to_owned));
    let space: String = space.unwrap_or_default().chars().filter(char::is_ascii_digit).collect();
    format!("{machine}-{space}-{}", std::process::id())
}

/// A name that no worker had before.
pub(super) fn new_name(process: &str) -> String {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let now = std::time::SystemTime::now();
    let unique = Digest::of(format!("{process} {now:?} {}", COUNT.fetch_add(1, Relaxed)).as_bytes());
    format!("{process}-{}", &unique.to_string()[..12])
}

/// Whether the process of a worker is seen to have ended: it was one of this machine.
fn has_ended(worker: &str, process: &str) -> bool {
    let split = |name: &str| name.rsplit_once('-').map(|(rest, last)| (rest.to_owned(), last.to_owned()));
    let Some((of_worker, pid)) = split(worker).and_then(|(rest, _)| split(&rest)) else { return false };
    let is_here = split(process).is_some_and(|(own, _)| own == of_worker);
    // Where the system shows no processes, none is taken to have ended.
    is_here && pid.parse::<u32>().is_ok_and(|pid| !is_seen(pid)) && is_seen(std::process::id())
}

/// Whether the system shows a process that runs: one that has ended stays there until its parent asks how.
fn is_seen(process: u32) -> bool {
    let stat = std::fs::read_to_string(Path::new("/proc").join(process.to_string()).join("stat")).unwrap_or_default();
    // The name of the program stands in brackets before its state, and may have any character.
    let state = stat.rsplit_once(')').and_then(|(_, rest)| rest.trim_start().chars().next());
    state.is_some_and(|state| !matches!(state, 'Z' | 'X' | 'x'))
}

impl Common {
    /// Writes the object of this worker: what the entries say that it holds.
    pub fn beat(&self) -> Result<(), BackendError> {
        let (name, member) = {
            let state = self.state();
            let member = Member { read: state.view.read, holds: state.view.own(&state.name).clone() };
            (state.name.clone(), member)
        };
        let sent = super::keeper::clock();
        let backend = &self.shared.backend;
        self.shared.breaker.attempt(|| backend.put(&object_name(&name), &member.encode()))?;
        self.state().beaten = sent;
        Ok(())
    }

    /// The workers that are dead: their processes have ended, or they gave no sign of life for too long.
    pub fn silent(&self, own: &str, listed: &[Object]) -> Vec<String> {
        let named = |object: &'_ Object| object.name.strip_prefix(WORKERS).map(str::to_owned);
        let now = listed.iter().find(|object| named(object).as_deref() == Some(own)).map(|own| own.modified_unix_s);
        let others = listed.iter().filter_map(|object| Some((named(object)?, object.modified_unix_s)));
        let others = others.filter(|(worker, _)| is_name(worker));
        let is_dead = |worker: &str, at: u64| {
            let silent = now.map_or(0, |now| now.saturating_sub(at));
            has_ended(worker, &self.process) || Duration::from_secs(silent) > self.times.expiry
        };
        others.filter(|(worker, at)| worker != own && is_dead(worker, *at)).map(|(worker, _)| worker).collect()
    }

    /// Looks who is dead, for the next entry to say.
    pub fn look_for_dead(&self) -> Result<(), BackendError> {
        let listed = self.shared.breaker.attempt(|| self.shared.backend.list(WORKERS))?;
        let mut state = self.state();
        let silent = self.silent(&state.name, &listed);
        let there: Vec<&str> = listed.iter().filter_map(|object| object.name.strip_prefix(WORKERS)).collect();
        // One without an object has left, or the object was removed; its farewell may come with the next entries.
        let absent: Vec<String> = state.view.others(&state.name).map(|(name, _)| name.to_owned()).collect();
        let absent = absent.into_iter().filter(|name| !there.contains(&name.as_str())).collect();
        let twice: Vec<String> = state.absent.intersection(&absent).cloned().collect();
        state.absent = absent;
        let dead: Vec<String> = silent.into_iter().chain(twice).filter(|name| state.view.has(name)).collect();
        state.dead.extend(dead);
        self.changed.notify_all();
        Ok(())
    }

    /// Takes part: reads what the others hold, and lets them see this process. Returns false where there can be no claims.
    pub fn join(&self) -> Result<bool, BackendError> {
        let shared = &self.shared;
        if !shared.honours()? {
            shared
                .breaker
                .warn_once(&format!("writes objects that are there already, whatever is asked of it: {EFFECT}"));
            return Ok(false);
        }
        let name = new_name(&self.process);
        // In this order: who begins later than this listing writes its entries after those that are listed.
        let entries = shared.backend.list(CLAIMS)?;
        let mut numbers: Vec<u64> = entries.iter().filter_map(|object| entry_number(&object.name)).collect();
        numbers.sort_unstable();
        let newest = numbers.last().copied().unwrap_or(0);
        let sent = super::keeper::clock();
        let own = Member { read: newest, ..Member::default() };
        shared.backend.put(&object_name(&name), &own.encode())?;
        let listed = shared.backend.list(WORKERS)?;
        let mut members = BTreeMap::new();
        for object in &listed {
            let is_other = |worker: &&str| *worker != name && is_name(worker);
            let Some(worker) = object.name.strip_prefix(WORKERS).filter(is_other) else { continue };
            match shared.backend.get(&object.name, LIMIT) {
                Ok(bytes) => members.extend(Member::decode(&bytes).map(|member| (worker.to_owned(), member))),
                // It has left meanwhile.
                Err(BackendError::Missing | BackendError::TooLarge { .. }) => {}
                Err(fault) => return Err(fault),
            }
        }
        let mut dead = self.silent(&name, &listed);
        // What this process held under its former name is free for it too.
        dead.extend(Some(self.state().name.clone()).filter(|former| !former.is_empty()));
        // What the dead have read does not matter: their entries may be gone.
        let live = members.iter().filter(|(worker, _)| !dead.contains(*worker)).map(|(_, member)| member.read);
        let oldest = live.min().unwrap_or(newest).min(newest);
        members.values_mut().for_each(|member| member.read = member.read.max(oldest));
        let mut view = View::of_members(members, newest);
        let start = view.read;
        for number in numbers.into_iter().filter(|number| *number > start) {
            match shared.backend.get(&entry_name(number), LIMIT) {
                Ok(bytes) => view.apply(number, &Entry::decode(&bytes)),
                // Nobody who lives needs it any more.
                Err(BackendError::Missing | BackendError::TooLarge { .. }) => {}
                Err(fault) => return Err(fault),
            }
        }
        view.read = newest;
        shared.refresh()?;
        self.clear_old(&entries, newest, oldest, &listed, &name);
        let mut state = self.state();
        state.absent.clear();
        (state.view, state.name, state.beaten, state.dead) = (view, name, sent, dead.into_iter().collect());
        Ok(true)
    }

    /// Removes entries that everybody has read long ago. Failures are made good by the next.
    fn clear_old(&self, entries: &[Object], newest: u64, oldest: u64, listed: &[Object], own: &str) {
        let own = object_name(own);
        let Some(now) = listed.iter().find(|object| object.name == own).map(|own| own.modified_unix_s) else { return };
        let long_ago = now.saturating_sub(2 * self.times.expiry.as_secs().max(1));
        let is_old = |object: &&Object| {
            let number = entry_number(&object.name);
            object.modified_unix_s < long_ago && number.is_some_and(|number| number < newest && number <= oldest)
        };
        let old = entries.iter().filter(is_old).take(CLEARED).map(|object| object.name.clone()).collect();
        each_at_once(old, AT_ONCE, |name: String| drop(self.shared.backend.delete(&name)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_that_has_ended_is_not_seen_though_its_parent_has_not_asked() {
        let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        assert!(is_seen(child.id()) && is_seen(std::process::id()));
        child.kill().unwrap();
        let begun = std::time::Instant::now();
        while is_seen(child.id()) {
            assert!(begun.elapsed() < std::time::Duration::from_mins(1), "it is seen still");
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        assert!(Path::new("/proc").join(child.id().to_string()).exists(), "it was not asked for yet");
        child.wait().unwrap();
        assert!(!is_seen(child.id()));
    }

    #[test]
    fn entries_and_workers_have_names_that_are_read_back() {
        assert_eq!(entry_number(&entry_name(17)), Some(17));
        assert_eq!(entry_number("claims/17"), None);
        let own = process("machine");
        let name = new_name(&own);
        assert!(name.starts_with(&own) && name != new_name(&own));
        assert!(!has_ended(&name, &own), "this process lives");
        let (rest, _) = own.rsplit_once('-').unwrap();
        // No process has the greatest number.
        assert!(has_ended(&format!("{rest}-4294967295-abc"), &own));
        assert!(!has_ended("elsewhere-1-4294967295-abc", &own), "of another machine nothing is seen");
    }
}
