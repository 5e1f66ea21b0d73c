//! Workers as threads of one process, on a place in memory.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};

use super::*;
use crate::remote::backend::{Backend, BackendError, Object};
use crate::remote::{InMemory, Remote, Use};

/// A handle to a place in memory.
#[derive(Debug)]
struct Handle {
    place: Arc<InMemory>,
    /// It writes objects that are there, though it was asked not to.
    ignores_conditions: bool,
    /// Nothing reaches it any more.
    is_cut: Arc<AtomicBool>,
}

impl Handle {
    fn place(&self) -> Result<&InMemory, BackendError> {
        let fault = || BackendError::Unavailable("the cable is cut".to_owned());
        if self.is_cut.load(Relaxed) { Err(fault()) } else { Ok(&self.place) }
    }
}

impl Backend for Handle {
    fn url(&self) -> &str {
        self.place.url()
    }
    fn get(&self, name: &str, limit: u64) -> Result<Vec<u8>, BackendError> {
        self.place()?.get(name, limit)
    }
    fn put(&self, name: &str, bytes: &[u8]) -> Result<(), BackendError> {
        self.place()?.put(name, bytes)
    }
    fn create(&self, name: &str, bytes: &[u8]) -> Result<bool, BackendError> {
        if self.ignores_conditions {
            return self.place()?.put(name, bytes).map(|()| true);
        }
        self.place()?.create(name, bytes)
    }
    fn list(&self, prefix: &str) -> Result<Vec<Object>, BackendError> {
        self.place()?.list(prefix)
    }
    fn delete(&self, name: &str) -> Result<(), BackendError> {
        self.place()?.delete(name)
    }
}

const TIMES: Times = Times {
    beat: Duration::from_millis(100),
    expiry: Duration::from_secs(2),
    poll_waiting: Duration::from_millis(5),
    poll_beside: Duration::from_millis(20),
    poll_alone: Duration::from_millis(20),
};

fn remote(place: &Arc<InMemory>, is_cut: &Arc<AtomicBool>) -> Remote {
    let handle = Handle { place: Arc::clone(place), ignores_conditions: false, is_cut: Arc::clone(is_cut) };
    Remote::open(Box::new(handle), None, Use::Layer, Box::new(|_| ())).unwrap()
}

/// A worker of a machine of this name.
fn worker(place: &Arc<InMemory>, machine: &str) -> Claims {
    Claims::new(Arc::clone(&remote(place, &Arc::default()).shared), machine, TIMES)
}

fn key(number: u32) -> Digest {
    Digest::of(&number.to_le_bytes())
}

/// Asks until the answer is yes.
fn take(worker: &Claims, key: &Digest) -> Claim {
    until(|| worker.take(key))
}

fn until<T>(mut look: impl FnMut() -> Option<T>) -> T {
    let begun = Instant::now();
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(begun.elapsed() < Duration::from_mins(1), "it never came");
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn entries(place: &InMemory) -> usize {
    place.objects().keys().filter(|name| name.starts_with(CLAIMS)).count()
}

#[test]
fn one_that_is_alone_says_so_once_and_shares_when_another_comes() {
    let place = Arc::new(InMemory::default());
    let (one, other) = (worker(&place, "one"), worker(&place, "other"));
    let held: Vec<Claim> = (0..50).map(|number| one.take(&key(number)).unwrap()).collect();
    assert_eq!(entries(&place), 1, "all steps with one entry");
    assert!(other.take(&key(7)).is_none());
    let far = take(&other, &key(100));
    assert!(one.take(&key(100)).is_none() && other.take(&key(7)).is_none());
    drop(held);
    let _seven = take(&other, &key(7));
    drop(far);
    let _far = take(&one, &key(100));
}

#[test]
fn of_many_workers_each_step_has_one() {
    let place = Arc::new(InMemory::default());
    let wins: Vec<AtomicU32> = (0..200).map(|_| AtomicU32::new(0)).collect();
    std::thread::scope(|scope| {
        for number in 0..6_u32 {
            let (place, wins) = (&place, &wins);
            scope.spawn(move || {
                let worker = worker(place, &format!("m{number}"));
                let mut kept = BTreeMap::new();
                let taken = || wins.iter().filter(|wins| wins.load(Relaxed) > 0).count();
                while taken() < wins.len() {
                    for at in (0..200_u32).map(|at| (at * 7 + number * 31) % 200) {
                        let claim = if kept.contains_key(&at) { None } else { worker.take(&key(at)) };
                        if let Some(claim) = claim {
                            wins[at as usize].fetch_add(1, Relaxed);
                            kept.insert(at, claim);
                        }
                    }
                }
                // Until the others have seen it too.
                std::thread::sleep(Duration::from_millis(200));
            });
        }
    });
    assert!(wins.iter().all(|wins| wins.load(Relaxed) == 1));
}

#[test]
fn a_step_whose_record_is_on_its_way_stays_taken_until_it_has_arrived() {
    let place = Arc::new(InMemory::default());
    let (one, other) = (worker(&place, "one"), worker(&place, "other"));
    let claim = one.take(&key(1)).unwrap();
    assert!(other.take(&key(1)).is_none());
    one.uploads(&key(1));
    drop(claim);
    std::thread::sleep(Duration::from_millis(100));
    assert!(other.take(&key(1)).is_none());
    one.uploaded(&[key(1)], Some(Digest::of(b"batch")));
    let _mine = take(&other, &key(1));
}

#[test]
fn a_value_is_said_to_be_there_until_the_records_of_those_who_used_it_have_arrived() {
    let place = Arc::new(InMemory::default());
    let (one, other) = (worker(&place, "one"), worker(&place, "other"));
    let value = Digest::of(b"value");
    let claim = one.take(&key(1)).unwrap();
    assert!(other.take(&key(1)).is_none());
    let having = one.announce(&value);
    until(|| other.is_elsewhere(&value).then_some(()));
    one.uploads(&key(1));
    drop((claim, having));
    std::thread::sleep(Duration::from_millis(200));
    assert!(other.is_elsewhere(&value) && !other.is_free(&key(1)));
    // Records that set out later are not waited for.
    let _second = take(&one, &key(2));
    one.uploads(&key(2));
    one.uploaded(&[key(1)], Some(Digest::of(b"batch")));
    until(|| (!other.is_elsewhere(&value)).then_some(()));
    assert!(other.is_free(&key(1)) && !other.is_free(&key(2)));
}

#[test]
fn steps_taken_ahead_need_no_entry_of_their_own() {
    let place = Arc::new(InMemory::default());
    let (one, other) = (worker(&place, "one"), worker(&place, "other"));
    let _first = one.take(&key(0)).unwrap();
    let _second = take(&other, &key(1000));
    until(|| (one.worth_ahead(&key(1), 1000) > 0).then_some(()));
    one.take_ahead((2..100).map(key).collect());
    let _claim = one.take(&key(1)).unwrap();
    let before = entries(&place);
    let claims: Vec<Claim> = (2..100).map(|number| one.take(&key(number)).unwrap()).collect();
    assert_eq!((entries(&place), one.worth_ahead(&key(2), 1000)), (before, 0));
    assert!(until(|| Some(other.take(&key(50)).is_none())));
    drop(claims);
}

#[test]
fn a_value_goes_from_who_has_it_to_who_wants_it() {
    let place = Arc::new(InMemory::default());
    let (one, other) = (worker(&place, "one"), worker(&place, "other"));
    let folder = tempfile::tempdir().unwrap();
    let (value, step) = (Digest::of(b"value"), key(1));
    let _claim = one.take(&step).unwrap();
    assert!(other.take(&step).is_none());
    other.want(&step, folder.path());
    until(|| one.wanted().contains(&step).then_some(()));
    let having = one.announce(&value);
    one.give(&step, &value, b"value".to_vec());
    // However long it takes to get all that the step makes, it comes in one piece.
    std::thread::sleep(3 * TIMES.beat);
    let second = Digest::of(b"second");
    one.give(&step, &second, b"second".to_vec());
    one.answer(&step);
    assert!(one.wanted().is_empty());
    assert_eq!(until(|| std::fs::read(folder.path().join(second.to_string())).ok()), b"second");
    let path = folder.path().join(value.to_string());
    assert_eq!(until(|| std::fs::read(&path).ok()), b"value");
    until(|| other.is_elsewhere(&value).then_some(()));
    // One that is damaged on its way is asked for a few times, and then is nowhere.
    std::fs::remove_file(&path).unwrap();
    place.objects().insert(format!("{HANDED}{value}"), (b"damaged".to_vec(), 0));
    for _ in 0..FETCHES {
        other.want(&value, folder.path());
        until(|| one.wanted().contains(&value).then_some(()));
        one.give(&value, &value, b"value".to_vec());
        one.answer(&value);
        until(|| (!other.common.state().wants.contains_key(&value)).then_some(()));
    }
    assert!(!path.exists() && !other.is_elsewhere(&value));
    drop(having);
    one.leave();
    assert!(place.objects().keys().all(|name| !name.starts_with(HANDED)), "values go with who gave them");
}

#[test]
fn what_the_dead_held_is_free_and_who_was_cut_off_holds_nothing() {
    let place = Arc::new(InMemory::default());
    let is_cut = Arc::new(AtomicBool::new(false));
    let dead = Claims::new(Arc::clone(&remote(&place, &is_cut).shared), "one", TIMES);
    let other = worker(&place, "other");
    let _first = other.take(&key(0)).unwrap();
    let lost = take(&dead, &key(1));
    assert!(other.take(&key(1)).is_none());
    // No sign of life any more, as of a process that was killed.
    is_cut.store(true, Relaxed);
    let begun = Instant::now();
    let _claim = take(&other, &key(1));
    assert!(begun.elapsed() > TIMES.expiry / 2);
    drop(lost);
    // One that is declared dead while it lives begins anew.
    let late = worker(&place, "late");
    let held = take(&late, &key(2));
    let name = late.common.state().name.clone();
    other.common.state().dead.insert(name.clone());
    other.common.changed.notify_all();
    until(|| (late.common.state().name != name && late.common.state().phase == Phase::Joined).then_some(()));
    drop(held);
    let _two = take(&other, &key(2));
    let _three = take(&late, &key(3));
}

#[test]
fn a_process_of_this_machine_that_has_ended_is_seen_at_once() {
    let place = Arc::new(InMemory::default());
    let own = members::process("here");
    let (rest, _) = own.rsplit_once('-').unwrap();
    let gone = format!("{rest}-4294967295-abc");
    let holds = Holdings { steps: [key(1)].into(), ..Holdings::default() };
    let member = entry::Member { read: 0, holds };
    place.put(&format!("{WORKERS}{gone}"), &member.encode()).unwrap();
    let begun = Instant::now();
    let _claim = take(&worker(&place, "here"), &key(1));
    assert!(begun.elapsed() < TIMES.expiry / 2);
}

#[test]
fn old_entries_go_and_who_comes_later_reads_on_from_what_workers_hold() {
    let place = Arc::new(InMemory::default());
    let (one, other) = (worker(&place, "one"), worker(&place, "other"));
    let _hold = one.take(&key(0)).unwrap();
    let _far = take(&other, &key(1000));
    for number in 1..40 {
        drop(take(&one, &key(number)));
    }
    let held = take(&one, &key(500));
    let many = entries(&place);
    until(|| (entries(&place) < many / 2).then_some(()));
    let third = worker(&place, "third");
    assert!(third.take(&key(500)).is_none() && third.take(&key(1000)).is_none());
    let _free = take(&third, &key(20));
    drop(held);
    let _then = take(&third, &key(500));
}

#[test]
fn without_conditions_or_where_nothing_answers_everybody_gets_what_he_asks_for() {
    let place = Arc::new(InMemory::default());
    let handle = Handle { place: Arc::clone(&place), ignores_conditions: true, is_cut: Arc::default() };
    let told = Arc::new(Mutex::new(Vec::new()));
    let heard = Arc::clone(&told);
    let warn = Box::new(move |text: &str| heard.lock().unwrap().push(text.to_owned()));
    let shared = Arc::clone(&Remote::open(Box::new(handle), None, Use::Layer, warn).unwrap().shared);
    let one = Claims::new(shared, "one", TIMES);
    let _claim = one.take(&key(1)).unwrap();
    assert_eq!(entries(&place), 0);
    let told = told.lock().unwrap().join("\n");
    assert!(told.contains("whatever is asked of it") && told.contains("may do a step twice"), "{told}");
    let (two, three) = (worker(&place, "two"), worker(&place, "three"));
    let _two = two.take(&key(2)).unwrap();
    let _three = take(&three, &key(3));
    place.is_down.store(true, Relaxed);
    let _again = take(&three, &key(2));
    assert!(three.common.shared.breaker.is_off());
}

#[test]
fn what_strangers_write_is_read_past() {
    let place = Arc::new(InMemory::default());
    place.put(&format!("{WORKERS}nobody"), b"no object of a worker").unwrap();
    place.put("claims/00000000000000000005", b"no entry").unwrap();
    place.put("claims/x", b"no entry").unwrap();
    place.put("claims/18446744073709551615", b"{}").unwrap();
    // Names that would lead out of a folder; the dead of them are not removed.
    place.put("claims/00000000000000000006", br#"{"worker": "../../x", "all": true}"#).unwrap();
    place.put("claims/00000000000000000007", br#"{"worker": "far-1", "dead": ["../../x"]}"#).unwrap();
    place.put(&format!("{WORKERS}far-1"), br#"{"read": 6}"#).unwrap();
    place.put("x", b"kept").unwrap();
    let one = worker(&place, "one");
    let _claim = one.take(&key(1)).unwrap();
    let names: BTreeMap<String, _> = place.objects().clone();
    assert!(names.contains_key("claims/00000000000000000008") && names.contains_key("x"), "{:?}", names.keys());
}
