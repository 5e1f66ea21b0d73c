//! Programs that stay alive between jobs: started when a step first needs one, ended with the run.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{ErrorKind, Read, Write};
use std::os::fd::AsFd;
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, ExitStatus, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use std::os::unix::process::ExitStatusExt;

use rockface_cache::{SafePath, Scratch, Store};
use rockface_core::{Job, JobResult, ProgramResult, StageError};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::process::{Pid, Signal, kill_process_group};
use serde_json::{Value, json};

use super::program::{self, Fault, Used, failed, in_folder, is_full};
use crate::plan::InputFile;
use crate::run::process_bytes;

/// How often it is looked at whether a job is to be ended.
const LOOK_EVERY: Duration = Duration::from_millis(10);
/// How long a program that closed its output has to end by itself.
const END_WITHIN: Duration = Duration::from_secs(2);
/// The longest answer; a longer one is none.
const LONGEST_ANSWER: usize = 64 << 20;
/// Folders that are emptied between jobs.
const PLACES: [&str; 2] = ["in", "out"];

/// The programs of a run that are at rest, by what was started.
#[derive(Default)]
pub struct Standing {
    idle: Mutex<Vec<(String, Process)>>,
}

impl Standing {
    /// Gives a job to a program at rest, or starts one. `give_up` is asked now and then; when it says so, the program and its
    /// children are killed.
    pub fn employ(
        &self,
        job: &Job,
        files: &BTreeMap<String, Vec<InputFile>>,
        store: &Store,
        give_up: &dyn Fn() -> bool,
    ) -> Result<(JobResult, Used), Fault> {
        for path in job.inputs.iter().map(|(path, _)| path).chain(&job.outputs) {
            SafePath::new(path).map_err(|error| StageError::new(error.to_string()))?;
        }
        let name = format!("{:?}", job.program);
        let idle = {
            let mut idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner);
            idle.iter().position(|(known, _)| *known == name).map(|place| idle.swap_remove(place).1)
        };
        let mut process = idle.map_or_else(|| Process::start(job, files, store), Ok)?;
        let (done, used) = process.work(job, files, give_up)?;
        let retires = done.answer.as_ref().is_none_or(|answer| answer.get("retire") == Some(&Value::Bool(true)));
        if !retires {
            self.idle.lock().unwrap_or_else(PoisonError::into_inner).push((name, process));
        }
        Ok((done, used))
    }
}

/// A program that waits for jobs or works on one. It is killed with all it started when this is dropped.
struct Process {
    child: Child,
    stdin: ChildStdin,
    stdout: ChildStdout,
    /// Its own files and those of the job.
    scratch: Scratch,
}

impl Process {
    fn start(job: &Job, files: &BTreeMap<String, Vec<InputFile>>, store: &Store) -> Result<Self, Fault> {
        let scratch = store.scratch()?;
        let folder = scratch.path();
        for place in PLACES.into_iter().chain(["tmp"]) {
            let path = folder.join(place);
            fs::create_dir(&path).map_err(in_folder("make the folder", &path))?;
        }
        let (name, mut command) = program::prepared(&job.program, files, &scratch)?;
        let said = folder.join("stderr");
        let said = File::create(&said).map_err(in_folder("write", &said))?;
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(said);
        let mut child = command.spawn().map_err(|error| {
            StageError::new(format!("cannot run `{name}`: {error}")).hint("install it, or put it on the search path")
        })?;
        match (child.stdin.take(), child.stdout.take()) {
            (Some(stdin), Some(stdout)) => Ok(Self { child, stdin, stdout, scratch }),
            _ => Err(StageError::new(format!("`{name}` was started without pipes")).into()),
        }
    }

    fn work(
        &mut self,
        job: &Job,
        files: &BTreeMap<String, Vec<InputFile>>,
        give_up: &dyn Fn() -> bool,
    ) -> Result<(JobResult, Used), Fault> {
        let folder = self.scratch.path().to_owned();
        lay_out(job, &folder)?;
        let paths = job.paths.iter().map(|(name, piece)| {
            Ok((name.clone(), Value::String(program::joined(std::slice::from_ref(piece), files)?)))
        });
        let paths: serde_json::Map<String, Value> = paths.collect::<Result<_, StageError>>()?;
        let line = json!({ "folder": folder, "paths": paths, "request": job.request }).to_string() + "\n";
        let before = self.cpu_s();
        // One that has ended meanwhile shows in its answer.
        let told = self.stdin.write_all(line.as_bytes()).and_then(|()| self.stdin.flush());
        let answer = match told {
            Ok(()) => self.answer(give_up)?,
            Err(error) if error.kind() == ErrorKind::BrokenPipe => None,
            Err(error) => return Err(failed("talk to a program")(error).into()),
        };
        let used = Used { cpu_s: self.cpu_s() - before, peak_bytes: self.peak_bytes(), ..Used::default() };
        let answer = answer.and_then(|line| serde_json::from_slice(&line).ok());
        let mut result = ProgramResult::default();
        if answer.is_none() {
            let status = self.end()?;
            (result.exit_code, result.signal) = (status.code(), status.signal());
            if is_full(&folder) {
                return Err(rockface_cache::StoreError::DiskFull { path: folder }.into());
            }
        }
        let read = in_folder("read what a program left in", &folder);
        result.stdout = program::kept_of(&folder.join("stdout")).map_err(&read)?;
        result.stderr = program::kept_of(&folder.join("stderr")).map_err(&read)?;
        (result.outputs, result.others) =
            program::collected(&job.outputs, &folder, program::largest_outputs()).map_err(&read)?;
        clear(&folder).map_err(in_folder("empty", &folder))?;
        Ok((JobResult { answer, result }, used))
    }

    /// The line it answers; `None` if it ended or closed its output first.
    fn answer(&mut self, give_up: &dyn Fn() -> bool) -> Result<Option<Vec<u8>>, StageError> {
        let mut line = Vec::new();
        let mut part = [0; 1 << 12];
        let timeout = rustix::event::Timespec { tv_sec: 0, tv_nsec: LOOK_EVERY.subsec_nanos().into() };
        loop {
            let stdout = self.stdout.as_fd();
            let mut ready = [PollFd::new(&stdout, PollFlags::IN)];
            match poll(&mut ready, Some(&timeout)) {
                Ok(0) | Err(rustix::io::Errno::INTR) if give_up() => {
                    return Err(StageError::new("the program was ended before it was done"));
                }
                Ok(0) | Err(rustix::io::Errno::INTR) => continue,
                Ok(_) => {}
                Err(errno) => return Err(failed("wait for a program")(errno.into())),
            }
            let count = self.stdout.read(&mut part).map_err(failed("listen to a program"))?;
            line.extend_from_slice(&part[..count]);
            if line.last() == Some(&b'\n') {
                return Ok(Some(line));
            }
            if count == 0 || line.len() > LONGEST_ANSWER {
                return Ok(None);
            }
        }
    }

    /// Waits a moment for its end, or brings it about.
    fn end(&mut self) -> Result<ExitStatus, StageError> {
        let wait = failed("wait for it");
        let deadline = std::time::Instant::now() + END_WITHIN;
        loop {
            match self.child.try_wait().map_err(&wait)? {
                Some(status) => return Ok(status),
                None if std::time::Instant::now() > deadline => {
                    self.kill();
                    return self.child.wait().map_err(&wait);
                }
                None => std::thread::sleep(Duration::from_millis(1)),
            }
        }
    }

    fn kill(&self) {
        if let Some(group) = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw) {
            // There may be none left.
            let _ = kill_process_group(group, Signal::KILL);
        }
    }

    /// Processor seconds so far.
    fn cpu_s(&self) -> f64 {
        let stat = fs::read_to_string(format!("/proc/{}/stat", self.child.id())).unwrap_or_default();
        // The name in brackets may hold anything; user and system time are the 12th and 13th words after it.
        let words = stat.rsplit_once(')').map_or("", |(_, rest)| rest).split_whitespace().skip(11).take(2);
        let ticks: f64 = words.filter_map(|word| word.parse::<f64>().ok()).sum();
        ticks / rustix::param::clock_ticks_per_second() as f64
    }

    /// The greatest resident memory so far, bytes.
    fn peak_bytes(&self) -> u64 {
        process_bytes(&self.child.id().to_string(), "VmHWM").unwrap_or(0)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
        // What it started is ended with its folder.
        let _ = self.child.wait();
    }
}

fn lay_out(job: &Job, folder: &Path) -> Result<(), Fault> {
    for (path, bytes) in &job.inputs {
        let path = folder.join(path);
        if let Some(parent) = path.parent().filter(|parent| !parent.is_dir()) {
            fs::create_dir_all(parent).map_err(in_folder("make the folder", parent))?;
        }
        fs::write(&path, bytes).map_err(in_folder("write", &path))?;
    }
    Ok(())
}

/// Removes what a job left in the folder. A file is removed, not overwritten: the program may still have it mapped.
fn clear(folder: &Path) -> std::io::Result<()> {
    for place in PLACES {
        for entry in fs::read_dir(folder.join(place))? {
            let path = entry?.path();
            if path.is_dir() && !path.is_symlink() { fs::remove_dir_all(&path)? } else { fs::remove_file(&path)? }
        }
    }
    for said in ["stdout", "stderr"] {
        fs::remove_file(folder.join(said)).or_else(|error| match error.kind() {
            ErrorKind::NotFound => Ok(()),
            _ => Err(error),
        })?;
    }
    Ok(())
}
