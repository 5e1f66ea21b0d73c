//! The campaign: each system call of a command fails in each way in which it can, or is the last of its process.

use std::collections::BTreeMap;
use std::process::Output;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::place::{CHANGED, Digests, Ended, Place, RUN, Verdict, ended, is_whole};
use crate::shim::{Fault, Watched, shim};
use crate::{Draws, slow};

/// The store that results are handed to and taken from.
const OTHER: &str = ".rockface/other";

/// How many faults the short form injects.
const SAMPLE: usize = 40;

/// Every way in which a call can fail.
const WAYS: [(&str, bool); 14] = [
    ("kill", false),
    ("tear", false),
    ("EIO", false),
    ("EIO", true),
    ("ENOSPC", false),
    ("ENOSPC", true),
    ("EDQUOT", false),
    ("EINTR", false),
    ("EMFILE", false),
    ("EMFILE", true),
    ("EACCES", false),
    ("EROFS", true),
    ("short", false),
    ("short", true),
];

/// Commands that print what they print without a fault, or fail.
const SAYS_THE_SAME: [&str; 3] = ["verify", "runs show", "archive"];

/// A command that something happens to.
struct Scene {
    name: &'static str,
    /// The folder it starts from; each fault is tried in a copy.
    ready: Place,
    command: &'static [&'static str],
    /// Seconds by which its clock is ahead.
    later_s: u64,
    /// What must hold if the command succeeded in spite of the fault.
    done: fn(&Place, &Digests) -> Verdict,
    /// What must hold afterwards.
    after: fn(&Place, &Digests) -> Verdict,
    expected: Digests,
    /// What it must print if it succeeds; only of some commands that change nothing.
    prints: Option<String>,
}

fn scenes() -> Vec<Scene> {
    let (whole, changed) = (Place::new(), Place::new());
    whole.succeed(&RUN).unwrap();
    changed.succeed(&CHANGED).unwrap();
    let (first, second) = (whole.digests().unwrap(), changed.digests().unwrap());
    let both = whole.copy();
    both.succeed(&CHANGED).unwrap();
    let forgotten = both.copy();
    forget_all_but_latest(&forgotten);
    let scene = |name, ready: &Place, command, expected: &Digests| Scene {
        name,
        ready: ready.copy(),
        command,
        later_s: 0,
        done: Place::has_run,
        after: |place, expected| place.goes_on(&RUN, expected).map(drop),
        expected: expected.clone(),
        prints: None,
    };
    let nothing: fn(&Place, &Digests) -> Verdict = |_, _| Ok(());
    vec![
        scene("first run", &Place::new(), &RUN, &first),
        Scene {
            after: |place, expected| place.goes_on(&CHANGED, expected).map(drop),
            ..scene("changed run", &whole, &CHANGED, &second)
        },
        scene("run of nothing", &whole, &RUN, &first),
        Scene {
            later_s: 7200,
            done: nothing,
            after: collected,
            ..scene("gc", &forgotten, &["store", "gc", "--unnamed"], &second)
        },
        Scene { done: nothing, after: pushed, ..scene("push", &whole, &["store", "push", OTHER], &first) },
        Scene { done: nothing, after: pulled, ..scene("pull", &to_pull(&whole), &["store", "pull", OTHER], &first) },
        Scene { done: nothing, ..scene("verify", &whole, &["store", "verify"], &first) },
    ]
}

/// Commands that change nothing, after a run; the short form has the first of them.
fn reading_scenes() -> Vec<Scene> {
    let whole = Place::new();
    whole.succeed(&RUN).unwrap();
    let commands: [(&'static str, &'static [&'static str]); 8] = [
        ("verify", &["store", "verify"]),
        ("stat", &["store", "stat"]),
        ("gc --dry-run", &["store", "gc", "--unnamed", "--dry-run"]),
        ("runs show", &["runs", "show", "latest"]),
        ("plan", &["plan", "p.yaml"]),
        ("explain", &["explain", "p.yaml", "large"]),
        ("export", &["export", "latest", "large.mesh", "large.ply"]),
        ("archive", &["archive", "latest", "--output", "run.tar", "--outputs"]),
    ];
    let scene = |(name, command): (&'static str, &'static [&'static str])| {
        let place = whole.copy();
        let out = place.command(command).output().unwrap();
        assert!(out.status.success(), "{name}: {}", String::from_utf8_lossy(&out.stderr));
        Scene {
            name,
            ready: whole.copy(),
            command,
            later_s: 0,
            done: |_, _| Ok(()),
            after: |_, _| Ok(()),
            expected: Digests::new(),
            // The others count, plan and copy what can be looked at.
            prints: (slow() && SAYS_THE_SAME.contains(&name)).then(|| printed(&out, &place)),
        }
    };
    // The others take a minute.
    let count = if slow() { commands.len() } else { 1 };
    commands.into_iter().take(count).map(scene).collect()
}

/// What a command has printed, wherever its folder is.
fn printed(out: &Output, place: &Place) -> String {
    String::from_utf8_lossy(&out.stdout).replace(&place.root().display().to_string(), "")
}

/// What is then named by no run: the records of the first.
fn forget_all_but_latest(place: &Place) {
    let runs = place.path(".rockface/runs");
    let latest = std::fs::read_link(runs.join("latest")).unwrap();
    for entry in std::fs::read_dir(&runs).unwrap().flatten() {
        if entry.file_type().unwrap().is_dir() && *entry.file_name() != *latest {
            std::fs::remove_dir_all(entry.path()).unwrap();
        }
    }
}

fn to_pull(whole: &Place) -> Place {
    let place = whole.copy();
    std::fs::rename(place.path(".rockface/store"), place.path(OTHER)).unwrap();
    std::fs::remove_dir_all(place.path(".rockface/runs")).unwrap();
    place
}

/// After a collection nothing is lost that a run names, and the next one ends what this one began.
fn collected(place: &Place, expected: &Digests) -> Verdict {
    is_whole(&place.path(".rockface/store"))?;
    let last = place.goes_on(&CHANGED, expected)?;
    if !last.contains("\"executed\":0") {
        return Err(format!("the collection took what a run names: {last}"));
    }
    place.succeed(&["store", "gc", "--unnamed"])?;
    place.goes_on(&CHANGED, expected).map(drop)
}

/// After a push both stores are whole, and the next one leaves all there is in the other.
fn pushed(place: &Place, expected: &Digests) -> Verdict {
    place.goes_on(&RUN, expected)?;
    if place.path(OTHER).join("format").exists() {
        is_whole(&place.path(OTHER))?;
    }
    place.succeed(&["store", "push", OTHER])?;
    handed_on(place, expected)
}

fn pulled(place: &Place, expected: &Digests) -> Verdict {
    is_whole(&place.path(OTHER))?;
    if place.path(".rockface/store/format").exists() {
        is_whole(&place.path(".rockface/store"))?;
    }
    place.succeed(&["store", "pull", OTHER])?;
    handed_on(place, expected)
}

/// Both stores have all there is.
fn handed_on(place: &Place, expected: &Digests) -> Verdict {
    for store in [OTHER, ".rockface/store"] {
        is_whole(&place.path(store))?;
        let last = place.succeed(&[&RUN[..], &["--store", store, "--json"]].concat())?;
        place.has_run(expected)?;
        if !last.contains("\"executed\":0") {
            return Err(format!("not everything is in {store}: {last}"));
        }
    }
    Ok(())
}

impl Scene {
    /// Runs the command with a fault; returns how it ended, and what the library reported.
    fn run(&self, place: &Place, fault: &Fault, at: u64) -> Verdict<(Ended, String)> {
        let report = place.path("report");
        let mut command = place.command(self.command);
        let shim = shim().ok_or("there is no shim")?;
        Watched::new(&mut command, shim, &place.path(".rockface")).fault(fault, at, &report).later(self.later_s);
        let out = command.output().map_err(|error| error.to_string())?;
        let told = std::fs::read_to_string(&report).unwrap_or_default();
        let is_killed = matches!(fault.what, "kill" | "tear");
        let ended = ended(&out, is_killed, fault.what != "threads").map_err(|why| at_call(&told, &why))?;
        let printed = printed(&out, place);
        match &self.prints {
            Some(prints) if ended == Ended::Done && *prints != printed => {
                Err(at_call(&told, &format!("it printed {printed}")))
            }
            _ => Ok((ended, told)),
        }
    }

    /// How many calls the fault can befall.
    fn count(&self, fault: &Fault) -> u64 {
        let (_, told) =
            self.run(&self.ready.copy(), fault, 0).unwrap_or_else(|why| panic!("{} {fault}: {why}", self.name));
        let count = told.lines().find_map(|line| line.strip_prefix("of ")?.parse().ok());
        count.unwrap_or_else(|| panic!("{} {fault}: no count in `{told}`", self.name))
    }

    /// One fault and all that must hold after it. `None` where the process made fewer calls this time.
    fn befall(&self, fault: &Fault, at: u64) -> Verdict<Option<(Ended, String)>> {
        let place = self.ready.copy();
        let (ended, told) = self.run(&place, fault, at)?;
        let call = told.lines().next().filter(|line| !line.starts_with("of ")).unwrap_or_default().to_owned();
        let fault = |why: String| at_call(&told, &format!("{ended:?}: {why}"));
        if ended == Ended::Done {
            (self.done)(&place, &self.expected).map_err(fault)?;
        }
        (self.after)(&place, &self.expected).map_err(fault)?;
        Ok((!call.is_empty()).then_some((ended, call)))
    }
}

/// A verdict with the call that the fault befell, which is the first line of what the library reported.
fn at_call(told: &str, why: &str) -> String {
    format!("at `{}`: {why}", told.lines().next().unwrap_or_default())
}

/// One fault: scene, way and number of the call.
type Job<'a> = (&'a Scene, Fault, u64);

/// What happened, by scene and fault.
#[derive(Default)]
struct Tally {
    ended: BTreeMap<(&'static str, String), BTreeMap<Ended, usize>>,
    faults: Vec<String>,
}

#[test]
fn whatever_call_fails_or_is_the_last_the_next_run_gives_the_same_bytes() {
    if shim().is_none() {
        return;
    }
    let scenes = scenes();
    let asked = std::env::var("CRASH_FAULTS").ok().map(|count| count.parse().expect("CRASH_FAULTS is a number"));
    survive(&match (only(&scenes), asked.or((!slow()).then_some(SAMPLE))) {
        (Some(jobs), _) => jobs,
        (None, Some(count)) => drawn(&scenes, count),
        (None, None) => all(&scenes, &WAYS),
    });
}

#[test]
fn whatever_call_fails_a_command_that_reads_prints_the_same_or_what_is_wrong() {
    if shim().is_none() {
        return;
    }
    let scenes = reading_scenes();
    let ways = if slow() { &WAYS[..] } else { &[("EIO", false)] };
    survive(&only(&scenes).unwrap_or_else(|| all(&scenes, ways)));
}

/// Lets all these faults happen, as many at once as there are processors.
fn survive(jobs: &[Job]) {
    let (next, tally) = (AtomicUsize::new(0), Mutex::new(Tally::default()));
    let worker = || {
        while let Some((scene, fault, at)) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
            let verdict = scene.befall(fault, *at);
            let mut tally = tally.lock().unwrap();
            match verdict {
                Ok(Some((ended, _))) => {
                    *tally.ended.entry((scene.name, fault.to_string())).or_default().entry(ended).or_default() += 1;
                }
                Ok(None) => {}
                Err(why) => tally.faults.push(format!("{}/{at}: {why}", name(scene, fault))),
            }
        }
    };
    std::thread::scope(|scope| {
        (0..std::thread::available_parallelism().map_or(2, usize::from)).for_each(|_| drop(scope.spawn(worker)));
    });
    let tally = tally.into_inner().unwrap();
    print(&tally);
    let (count, first) = (tally.faults.len(), tally.faults.iter().take(100).map(String::as_str).collect::<Vec<_>>());
    assert!(count == 0, "{count} of {} faults were not survived:\n{}", jobs.len(), first.join("\n"));
}

/// Scene and fault, as `CRASH_ONLY` names them.
fn name(scene: &Scene, fault: &Fault) -> String {
    format!("{}/{}{}", scene.name, fault.what, if fault.lasts { "+" } else { "" })
}

/// The faults that `CRASH_ONLY` asks for: those of a scene, of one of its ways to fail, or one.
fn only(scenes: &[Scene]) -> Option<Vec<Job<'_>>> {
    let only = std::env::var("CRASH_ONLY").ok()?;
    let mut parts = only.splitn(3, '/');
    let (asked, way, at) = (parts.next()?, parts.next(), parts.next().map(|at| at.parse::<u64>().expect("a number")));
    let ways: Vec<(&'static str, bool)> = WAYS
        .into_iter()
        .filter(|(what, lasts)| {
            way.is_none_or(|way| way.strip_suffix('+').unwrap_or(way) == *what && way.ends_with('+') == *lasts)
        })
        .collect();
    let scenes = scenes.iter().filter(|scene| scene.name == asked);
    let mut jobs: Vec<Job> = scenes.flat_map(|scene| all(std::slice::from_ref(scene), &ways)).collect();
    jobs.retain(|job| at.is_none_or(|at| job.2 == at));
    Some(jobs)
}

/// Every call of every scene, failing in each of these ways.
fn all<'a>(scenes: &'a [Scene], ways: &[(&'static str, bool)]) -> Vec<Job<'a>> {
    let faults = ways.iter().map(|&(what, lasts)| Fault { what, lasts });
    let of_scene = |scene: &'a Scene| {
        let calls = faults.clone().map(move |fault| (scene.count(&fault), fault));
        calls.flat_map(move |(count, fault)| (1..=count).map(move |at| (scene, fault.clone(), at)))
    };
    scenes.iter().flat_map(of_scene).collect()
}

/// Some faults, the same every time: a call is drawn by its place in the run, so that a command that makes a call more or
/// less moves this one fault by a call, and no other.
fn drawn(scenes: &[Scene], count: usize) -> Vec<Job<'_>> {
    const PLACES: u64 = 1 << 20;
    let mut draws = Draws(11);
    let mut counts = BTreeMap::new();
    let mut draw = || {
        let scene = &scenes[draws.below(scenes.len() as u64) as usize];
        let (what, lasts) = WAYS[draws.below(WAYS.len() as u64) as usize];
        let fault = Fault { what, lasts };
        let calls = *counts.entry(name(scene, &fault)).or_insert_with(|| scene.count(&fault));
        let at = 1 + draws.below(PLACES) * calls / PLACES;
        (scene, fault, at)
    };
    (0..count).map(|_| draw()).collect()
}

fn print(tally: &Tally) {
    println!("{:16}{:20}{:>8}{:>12}{:>12}{:>8}", "scene", "fault", "done", "step failed", "disk failed", "killed");
    let mut total = 0;
    for ((scene, fault), ended) in &tally.ended {
        let count = |one: Ended| ended.get(&one).copied().unwrap_or_default();
        let (done, step, disk, killed) =
            (count(Ended::Done), count(Ended::StepFailed), count(Ended::DiskFailed), count(Ended::Killed));
        total += done + step + disk + killed;
        println!("{scene:16}{fault:20}{done:8}{step:12}{disk:12}{killed:8}");
    }
    println!("{total} faults, {} not survived", tally.faults.len());
}

#[test]
fn a_system_that_starts_no_threads_is_reported() {
    if shim().is_none() {
        return;
    }
    let expected = {
        let whole = Place::new();
        whole.succeed(&RUN).unwrap();
        whole.digests().unwrap()
    };
    let scene = Scene {
        name: "first run",
        ready: Place::new(),
        command: &RUN,
        later_s: 0,
        done: Place::has_run,
        after: |place, expected| place.goes_on(&RUN, expected).map(drop),
        expected,
        prints: None,
    };
    let (ended, _) = scene.run(&scene.ready, &Fault { what: "threads", lasts: false }, 0).unwrap();
    assert_eq!(ended, Ended::DiskFailed);
    (scene.after)(&scene.ready, &scene.expected).unwrap();
}
