//! Running a program for a stage: in a folder of its own, with a plain environment, and no longer than it may.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

use rockface_cache::{SafePath, Scratch, Store, StoreError};
use rockface_core::limits::memory_limit;
use rockface_core::{Piece, Program, ProgramResult, StageError};
use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};
use wait4::Wait4;

use super::tools::{self, Call, Tools};
use crate::plan::{InputFile, kind_of};
use crate::run::MachineMemory;

/// What reaches every program from outside.
pub const INHERITED: [&str; 5] = ["PATH", "HOME", "USER", "LOGNAME", "LD_LIBRARY_PATH"];

/// How often it is looked at whether a program has ended or is to be ended.
const LOOK_EVERY: Duration = Duration::from_millis(10);

/// Bytes of the beginning, and as many of the end, that are kept of what a program prints.
const KEPT_BYTES: u64 = 64 << 10;

/// The store has less room than this: a program that failed did so for want of it.
const FULL_BYTES: u64 = 64 << 10;

/// What a program took, with all it started and waited for.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Used {
    /// Processor time, seconds, of all of them together.
    pub cpu_s: f64,
    /// The greatest resident memory of any one of them, bytes.
    pub peak_bytes: u64,
    /// The program files that were called by a name or a path.
    pub tools: Tools,
}

/// Why a program could not be run to its end.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub enum Fault {
    /// The program, or how it is called.
    Program(#[from] StageError),
    /// The store, in whose folders it runs.
    Store(#[from] StoreError),
}

/// Runs a program to its end. `give_up` is asked now and then; when it says so, the program and its children are killed.
pub fn execute(
    program: &Program,
    files: &BTreeMap<String, Vec<InputFile>>,
    store: &Store,
    give_up: &dyn Fn() -> bool,
) -> Result<(ProgramResult, Used), Fault> {
    for path in program.inputs.iter().map(|(path, _)| path).chain(&program.outputs) {
        SafePath::new(path).map_err(|error| StageError::new(error.to_string()))?;
    }
    let scratch = store.scratch()?;
    let folder = scratch.path();
    lay_out(program, folder)?;
    let (mut stdout, mut stderr) = (scratch_file(folder)?, scratch_file(folder)?);
    let (name, mut command) = prepared(program, files, &scratch)?;
    command
        .stdin(Stdio::null())
        .stdout(stdout.try_clone().map_err(in_folder("keep what a program prints in", folder))?)
        .stderr(stderr.try_clone().map_err(in_folder("keep what a program prints in", folder))?);
    let child = command.spawn().map_err(|error| {
        let fault = StageError::new(format!("cannot run `{name}`: {error}"));
        fault.hint("install it, or name a script under `files` and write {file.name}")
    })?;
    let (status, mut used) = wait(child, give_up)?;
    used.tools = tools::state(call(program, &name), store);
    if !status.success() && is_full(folder) {
        return Err(StoreError::DiskFull { path: folder.to_owned() }.into());
    }
    let read = in_folder("read what a program left in", folder);
    let (outputs, others) = collected(&program.outputs, folder, largest_outputs()).map_err(&read)?;
    let result = ProgramResult {
        exit_code: status.code(),
        signal: status.signal(),
        stdout: kept(&mut stdout).map_err(&read)?,
        stderr: kept(&mut stderr).map_err(&read)?,
        outputs,
        others,
    };
    Ok((result, used))
}

/// The name of a program, and how it is started: in its folder, in a process group of its own, with a plain environment.
pub fn prepared(
    program: &Program,
    files: &BTreeMap<String, Vec<InputFile>>,
    scratch: &Scratch,
) -> Result<(String, Command), StageError> {
    let name = joined(&program.program, files)?;
    let mut command = Command::new(&name);
    for arg in &program.args {
        command.arg(joined(arg, files)?);
    }
    let inherited = INHERITED.iter().copied().chain(program.inherit.iter().map(String::as_str));
    command
        .env_clear()
        .envs(inherited.filter_map(|name| Some((name, std::env::var_os(name)?))))
        .env("LC_ALL", "C.UTF-8")
        .env("TMPDIR", scratch.temporary())
        .envs(&program.environment)
        .current_dir(scratch.path())
        .process_group(0);
    Ok((name, command))
}

/// How a program was called; one that a parameter names is part of the recipe.
fn call(program: &Program, name: &str) -> Option<Call> {
    let named = program.program.iter().any(|piece| !matches!(piece, Piece::Text(_)));
    let search = program.environment.get("PATH").cloned();
    (!named).then(|| Call { program: name.to_owned(), search })
}

/// An error that says what failed.
pub fn failed(what: &'static str) -> impl Fn(std::io::Error) -> StageError {
    move |error| StageError::new(format!("cannot {what}: {error}"))
}

/// What goes wrong in a folder of the store is a fault of the store.
pub fn in_folder<'a>(action: &'static str, folder: &'a Path) -> impl Fn(std::io::Error) -> StoreError + use<'a> {
    move |error| StoreError::io(action, folder, error)
}

/// Whether nothing more can be written there.
pub fn is_full(folder: &Path) -> bool {
    rustix::fs::statvfs(folder).is_ok_and(|room| room.f_bavail.saturating_mul(room.f_frsize) < FULL_BYTES)
}

fn scratch_file(folder: &Path) -> Result<File, StoreError> {
    tempfile::tempfile_in(folder).map_err(in_folder("keep what a program prints in", folder))
}

fn lay_out(program: &Program, folder: &Path) -> Result<(), StoreError> {
    let made = |path: &Path| fs::create_dir_all(path).map_err(in_folder("make the folder", path));
    for place in ["in", "out", "tmp"] {
        made(&folder.join(place))?;
    }
    for (path, bytes) in &program.inputs {
        let path = folder.join(path);
        path.parent().map_or(Ok(()), made)?;
        fs::write(&path, bytes).map_err(in_folder("write", &path))?;
    }
    Ok(())
}

/// The text of pieces, with the paths of files.
pub fn joined(pieces: &[Piece], files: &BTreeMap<String, Vec<InputFile>>) -> Result<String, StageError> {
    let text = |piece: &Piece| match piece {
        Piece::Text(text) => Ok(text.clone()),
        Piece::Found(found) => Ok(crate::plan::find(*found).display().to_string()),
        Piece::File(written) => {
            let file = files.get(written).and_then(|files| files.first());
            let file = file.ok_or_else(|| StageError::new(format!("`{written}` is not named by a file parameter")))?;
            let path = std::path::absolute(&file.path).map_err(failed("find the working folder"))?;
            let shown = path.to_str().map(str::to_owned);
            shown.ok_or_else(|| StageError::new(format!("the path `{}` is not UTF-8", path.display())))
        }
    };
    pieces.iter().map(text).collect()
}

/// Waits for the end of a program, or brings it about.
fn wait(mut child: Child, give_up: &dyn Fn() -> bool) -> Result<(ExitStatus, Used), StageError> {
    let pid = i32::try_from(child.id()).ok().and_then(Pid::from_raw);
    let kill_all = || {
        // There may be none left.
        pid.map(|group| kill_process_group(group, Signal::KILL).ok())
    };
    let look = WaitIdOptions::EXITED | WaitIdOptions::NOWAIT | WaitIdOptions::NOHANG;
    loop {
        // Only looked at: its cost is reported once, when it is released.
        let ended = pid.map_or(Ok(true), |pid| waitid(WaitId::Pid(pid), look).map(|status| status.is_some()));
        if ended.map_err(|errno| failed("wait for it")(errno.into()))? {
            let ended = child.wait4().map_err(failed("wait for it"))?;
            // What it left running would write into a folder that is gone.
            kill_all();
            let cpu_s = (ended.rusage.utime + ended.rusage.stime).as_secs_f64();
            let used = Used { cpu_s, peak_bytes: ended.rusage.maxrss, ..Used::default() };
            return Ok((ended.status, used));
        }
        if give_up() {
            kill_all();
            child.wait().map_err(failed("wait for it"))?;
            return Err(StageError::new("the program was ended before it was done"));
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

/// What was printed; of a long text the beginning and the end.
fn kept(file: &mut File) -> std::io::Result<String> {
    let length = file.metadata()?.len();
    let mut read = |from: u64, count: u64| -> std::io::Result<String> {
        let mut bytes = Vec::new();
        file.seek(SeekFrom::Start(from))?;
        Read::by_ref(file).take(count).read_to_end(&mut bytes)?;
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    };
    if length <= 2 * KEPT_BYTES {
        return read(0, 2 * KEPT_BYTES);
    }
    let (head, tail) = (read(0, KEPT_BYTES)?, read(length - KEPT_BYTES, KEPT_BYTES)?);
    Ok(format!("{head}\n… {} bytes left out …\n{tail}", length - 2 * KEPT_BYTES))
}

/// What was printed to a file, if there is one.
pub fn kept_of(path: &Path) -> std::io::Result<String> {
    match File::open(path) {
        Ok(mut file) => kept(&mut file),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(String::new()),
        Err(error) => Err(error),
    }
}

/// The bytes of files by their place in the folder of the program.
type Collected = BTreeMap<String, Vec<u8>>;

/// What is in place of a file that does not fit into memory.
const TOO_LARGE: &str = "a file that is too large for the memory of a run";

/// What is in place of wanted files, by the place of these.
type Others = BTreeMap<String, &'static str>;

/// What may be read of the files of a program, bytes: what the values of one file may take, and no more than is left on the machine.
pub fn largest_outputs() -> u64 {
    memory_limit().min(MachineMemory::now().map_or(u64::MAX, |memory| memory.left))
}

/// The wanted files that are there, and what is in place of others: of files that are larger than `most` bytes together only that.
pub fn collected(wanted: &[String], folder: &Path, most: u64) -> std::io::Result<(Collected, Others)> {
    let (mut outputs, mut others, mut left) = (Collected::new(), Others::new(), most);
    for place in wanted {
        let path = folder.join(place);
        match fs::metadata(&path).or_else(|_| fs::symlink_metadata(&path)) {
            Ok(found) if found.is_file() => {
                let (mut bytes, file) = (Vec::new(), File::open(&path)?);
                // A file with holes may have any length, and one that is still written to another one now.
                let is_large = found.len() > left || file.take(left + 1).read_to_end(&mut bytes)? as u64 > left;
                if is_large {
                    others.insert(place.clone(), TOO_LARGE);
                } else {
                    left -= bytes.len() as u64;
                    outputs.insert(place.clone(), bytes);
                }
            }
            Ok(found) if found.is_symlink() => drop(others.insert(place.clone(), "a link that leads nowhere")),
            Ok(found) => drop(others.insert(place.clone(), kind_of(found.file_type()))),
            // It is not there.
            Err(_) => {}
        }
    }
    Ok((outputs, others))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_in_place_of_an_output_is_named_and_no_pipe_is_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        fs::write(place("file"), "bytes").unwrap();
        fs::create_dir(place("folder")).unwrap();
        rustix::fs::mknodat(rustix::fs::CWD, place("pipe"), rustix::fs::FileType::Fifo, 0o600.into(), 0).unwrap();
        std::os::unix::fs::symlink(place("file"), place("link")).unwrap();
        std::os::unix::fs::symlink(place("nowhere"), place("dangling")).unwrap();
        let wanted = ["file", "folder", "pipe", "link", "dangling", "none"].map(str::to_owned);
        let (outputs, others) = collected(&wanted, folder.path(), 1000).unwrap();
        assert_eq!(outputs.into_keys().collect::<Vec<_>>(), ["file", "link"]);
        let expected = [("dangling", "a link that leads nowhere"), ("folder", "a folder"), ("pipe", "a pipe")];
        assert_eq!(others, expected.map(|(place, kind)| (place.to_owned(), kind)).into());
        File::create(place("sparse")).unwrap().set_len(1 << 40).unwrap();
        let wanted = ["sparse", "file", "link"].map(str::to_owned);
        let (outputs, others) = collected(&wanted, folder.path(), 9).unwrap();
        assert_eq!(outputs.into_keys().collect::<Vec<_>>(), ["file"]);
        assert_eq!(others, ["link", "sparse"].map(|place| (place.to_owned(), TOO_LARGE)).into());
    }
}
