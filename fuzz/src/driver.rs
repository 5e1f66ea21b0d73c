//! The driver: cases one after the other in a child process, and what becomes of a child that a case brings down.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitStatus;
use std::time::{Duration, Instant};

use crate::guard::{self, Heard, PATIENCE, Worker};
use crate::mutate::{self, Material};
use crate::{Target, Verdict, corpus, find};

/// Cases after which a child is followed by a new one, so that what one leaves behind does not add up.
const CASES_A_CHILD: u64 = 5000;
/// Silence without work after which a child hangs, in multiples of the patience.
const WAITS: u32 = 12;

/// A case that a target did not stand.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// The bytes of the case.
    pub bytes: Vec<u8>,
    /// What happened, in a line: equal for equal faults.
    pub what: String,
    /// Everything that was said.
    pub said: String,
}

/// What came of trying a target.
#[derive(Debug, Default)]
pub struct Tried {
    /// Cases that were tried.
    pub cases: u64,
    /// How many of them were accepted.
    pub accepted: u64,
    /// One case for each fault, by what happened, and how often that was.
    pub findings: BTreeMap<String, (Finding, u64)>,
}

/// The work of a child: damaged files from this number on, each named before it is tried.
///
/// # Errors
/// Files that cannot be read, or limits the system does not grant.
pub fn work(target: &Target, seed: u64, first: u64) -> io::Result<()> {
    let material = corpus::material(target)?;
    guard::limit_memory()?;
    guard::on_a_small_stack(|| {
        for number in first..first + CASES_A_CHILD {
            let case = mutate::case(&material, seed, target.name, number);
            tell(number, || (target.run)(&case));
        }
    });
    Ok(())
}

/// The work of a child: these files, each named by its place before it is tried.
///
/// # Errors
/// Files that cannot be read, or limits the system does not grant.
pub fn work_on(target: &Target, files: &[PathBuf]) -> io::Result<()> {
    let cases = files.iter().map(std::fs::read).collect::<io::Result<Vec<_>>>()?;
    guard::limit_memory()?;
    guard::on_a_small_stack(|| {
        for (number, case) in cases.iter().enumerate() {
            tell(number as u64, || (target.run)(case));
        }
    });
    Ok(())
}

fn tell(number: u64, run: impl FnOnce() -> Verdict) {
    println!("{number}");
    if run() == Verdict::Accepted {
        println!("accepted");
    }
}

/// Tries damaged files of a target until the deadline.
///
/// # Errors
/// A child that cannot be started, or files that cannot be read.
pub fn mutations(target: &Target, seed: u64, time: Duration, scratch: &Path) -> io::Result<Tried> {
    let (material, end) = (corpus::material(target)?, Instant::now() + time);
    let (mut tried, mut next) = (Tried::default(), 0);
    while Instant::now() < end {
        let arguments = ["work", target.name, &seed.to_string(), &next.to_string()].map(str::to_owned);
        let (last, fault) = watch(&arguments, end, scratch, &mut tried)?;
        let Some(last) = last else {
            // On a busy machine the time may be over before a child has begun.
            return if fault.is_none() { Ok(tried) } else { Err(no_case(fault.as_ref())) };
        };
        next = last + 1;
        if let Some((what, said)) = fault {
            tried.keep(Finding { bytes: mutate::case(&material, seed, target.name, last), what, said });
        }
    }
    Ok(tried)
}

/// Tries files of a target.
///
/// # Errors
/// A child that cannot be started, or files that cannot be read.
pub fn replay(target: &Target, files: &[PathBuf], scratch: &Path) -> io::Result<Tried> {
    let (mut tried, mut done) = (Tried::default(), 0);
    while let Some(rest) = files.get(done..).filter(|rest| !rest.is_empty()) {
        let names = rest.iter().map(|path| path.display().to_string());
        let arguments: Vec<String> = ["try-here".to_owned(), target.name.to_owned()].into_iter().chain(names).collect();
        let far = Instant::now() + PATIENCE * 1000;
        let (last, fault) = watch(&arguments, far, scratch, &mut tried)?;
        let Some(last) = last else { return Err(no_case(fault.as_ref())) };
        if let Some((what, said)) = fault {
            tried.keep(Finding { bytes: std::fs::read(&rest[last as usize])?, what, said });
        }
        done += last as usize + 1;
    }
    Ok(tried)
}

fn no_case(fault: Option<&Fault>) -> io::Error {
    let (what, said) = fault.cloned().unwrap_or_default();
    io::Error::other(format!("the child tried no case: {what} {said}"))
}

impl Tried {
    /// Counts what a child says: the number of the case that it begins, or that it was accepted.
    fn count(&mut self, line: &str) -> Option<u64> {
        let number = line.parse().ok();
        self.cases += u64::from(number.is_some());
        self.accepted += u64::from(line == "accepted");
        number
    }

    fn keep(&mut self, finding: Finding) {
        let known = self.findings.entry(finding.what.clone()).or_insert_with(|| (finding.clone(), 0));
        known.1 += 1;
        if finding.bytes.len() < known.0.bytes.len() {
            known.0 = finding;
        }
    }
}

/// What happened, and what was said.
type Fault = (String, String);

/// Follows a child until it ends, hangs, or the time is over; the last case it named, and what befell it.
fn watch(
    arguments: &[String],
    end: Instant,
    scratch: &Path,
    tried: &mut Tried,
) -> io::Result<(Option<u64>, Option<Fault>)> {
    let worker = Worker::start(arguments, scratch)?;
    let mut last = None;
    loop {
        let left = end.saturating_duration_since(Instant::now());
        match worker.hear(left.min(PATIENCE)) {
            Heard::Line(line) => last = tried.count(&line).or(last),
            Heard::Ended => {
                let (status, said) = worker.ended();
                return Ok((last, fault(status, said)));
            }
            Heard::Silent if left <= PATIENCE => {
                worker.end();
                return Ok((last, None));
            }
            Heard::Silent => {
                let Some(line) = worker.hear_after_work(PATIENCE, WAITS) else {
                    let (_, said) = worker.end();
                    return Ok((last, Some(("it hangs".to_owned(), said))));
                };
                last = tried.count(&line).or(last);
            }
        }
        if left.is_zero() {
            worker.end();
            return Ok((last, None));
        }
    }
}

/// How a child ended; nothing where all went well.
fn fault(status: Option<ExitStatus>, said: String) -> Option<Fault> {
    use std::os::unix::process::ExitStatusExt;
    let status = status?;
    if status.success() {
        return None;
    }
    let line = |words: &str| said.lines().find(|line| line.contains(words)).map(str::to_owned);
    let what = line("has overflowed its stack")
        .map(|_| "the stack overflows".to_owned())
        .or_else(|| line("memory allocation of").map(|_| "memory runs out".to_owned()))
        .or_else(|| line("panicked at").map(|line| place(&line)))
        .or_else(|| status.signal().map(|signal| format!("signal {signal}")))
        .unwrap_or_else(|| status.to_string());
    Some((what, said))
}

/// The place of a panic in its message.
fn place(line: &str) -> String {
    let place = line.split_once("panicked at ").map_or(line, |(_, place)| place).trim_end_matches(':');
    let short = place.rsplit_once("/registry/src/").and_then(|(_, path)| path.split_once('/'));
    format!("panic at {}", short.map_or(place, |(_, path)| path))
}

/// The verdict of one case in a child of its own: what befell it.
///
/// # Errors
/// A child that cannot be started, or a file that cannot be written.
pub fn befalls(target: &Target, bytes: &[u8], scratch: &Path) -> io::Result<Option<String>> {
    let file = scratch.join("case");
    std::fs::write(&file, bytes)?;
    let tried = replay(target, &[file], scratch)?;
    Ok(tried.findings.into_keys().next())
}

/// The case of a number, as `work` makes it.
///
/// # Errors
/// Files that cannot be read.
pub fn case(target: &Target, seed: u64, number: u64) -> io::Result<Vec<u8>> {
    let material: Material = corpus::material(target)?;
    Ok(mutate::case(&material, seed, target.name, number))
}

/// The target of a name, or what there is.
///
/// # Errors
/// A name that no target has.
pub fn named(name: &str) -> Result<&'static Target, String> {
    find(name).ok_or_else(|| format!("there is no target `{name}`; `rockface-fuzz list` names those there are"))
}
