//! Running a program for a stage: in a folder of its own, with a plain environment, and no longer than it may.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

use rockface_cache::Store;
use rockface_stages::{Piece, Program, ProgramResult, StageError};
use rustix::process::{Pid, Signal, kill_process_group};

use crate::plan::InputFile;

/// What reaches every program from outside.
const INHERITED: [&str; 5] = ["PATH", "HOME", "USER", "LOGNAME", "LD_LIBRARY_PATH"];

/// How often it is looked at whether a program has ended or is to be ended.
const LOOK_EVERY: Duration = Duration::from_millis(10);

/// Bytes of the beginning, and as many of the end, that are kept of what a program prints.
const KEPT_BYTES: u64 = 64 << 10;

/// Runs a program to its end. `give_up` is asked now and then; when it says so, the program and its children are killed.
pub fn execute(
    program: &Program,
    files: &BTreeMap<String, Vec<InputFile>>,
    store: &Store,
    give_up: &dyn Fn() -> bool,
) -> Result<ProgramResult, StageError> {
    let scratch = store.scratch().map_err(|error| StageError::new(format!("no folder to run it in: {error}")))?;
    let folder = scratch.path();
    lay_out(program, folder)?;
    let (mut stdout, mut stderr) = (scratch_file(folder)?, scratch_file(folder)?);
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
        .env("TMPDIR", folder.join("tmp"))
        .envs(&program.environment)
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(stdout.try_clone().map_err(failed("keep what it prints"))?)
        .stderr(stderr.try_clone().map_err(failed("keep what it prints"))?)
        .process_group(0);
    let child = command.spawn().map_err(|error| {
        let fault = StageError::new(format!("cannot run `{name}`: {error}"));
        fault.hint("install it, or name a script under `files` and write {file.name}")
    })?;
    let status = wait(child, give_up)?;
    Ok(ProgramResult {
        exit_code: status.code(),
        signal: status.signal(),
        stdout: kept(&mut stdout)?,
        stderr: kept(&mut stderr)?,
        outputs: collect(program, folder)?,
        folders: program.outputs.iter().filter(|place| folder.join(place).is_dir()).cloned().collect(),
    })
}

fn failed(what: &'static str) -> impl Fn(std::io::Error) -> StageError {
    move |error| StageError::new(format!("cannot {what}: {error}"))
}

fn scratch_file(folder: &Path) -> Result<File, StageError> {
    tempfile::tempfile_in(folder).map_err(failed("keep what it prints"))
}

fn lay_out(program: &Program, folder: &Path) -> Result<(), StageError> {
    let made = |path: &Path| fs::create_dir_all(path).map_err(failed("make its folders"));
    for place in ["in", "out", "tmp"] {
        made(&folder.join(place))?;
    }
    for (path, bytes) in &program.inputs {
        let path = folder.join(path);
        path.parent().map_or(Ok(()), made)?;
        fs::write(&path, bytes).map_err(failed("write its inputs"))?;
    }
    Ok(())
}

fn joined(pieces: &[Piece], files: &BTreeMap<String, Vec<InputFile>>) -> Result<String, StageError> {
    let text = |piece: &Piece| match piece {
        Piece::Text(text) => Ok(text.clone()),
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
fn wait(mut child: Child, give_up: &dyn Fn() -> bool) -> Result<ExitStatus, StageError> {
    let group = i32::try_from(child.id()).ok().and_then(Pid::from_raw);
    let kill_all = || {
        // There may be none left.
        group.map(|group| kill_process_group(group, Signal::KILL).ok())
    };
    loop {
        if let Some(status) = child.try_wait().map_err(failed("wait for it"))? {
            // What it left running would write into a folder that is gone.
            kill_all();
            return Ok(status);
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
fn kept(file: &mut File) -> Result<String, StageError> {
    let mut read = |from: u64, count: u64| -> std::io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        file.seek(SeekFrom::Start(from))?;
        Read::by_ref(file).take(count).read_to_end(&mut bytes)?;
        Ok(bytes)
    };
    let whole = read(0, 2 * KEPT_BYTES + 1).map_err(failed("read what it printed"))?;
    if whole.len() as u64 <= 2 * KEPT_BYTES {
        return Ok(String::from_utf8_lossy(&whole).into_owned());
    }
    let length = file.metadata().map_err(failed("read what it printed"))?.len();
    let mut read = |from: u64| -> std::io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        file.seek(SeekFrom::Start(from))?;
        Read::by_ref(file).take(KEPT_BYTES).read_to_end(&mut bytes)?;
        Ok(bytes)
    };
    let (head, tail) = (read(0), read(length - KEPT_BYTES));
    let text = |part: std::io::Result<Vec<u8>>| {
        part.map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).map_err(failed("read what it printed"))
    };
    Ok(format!("{}\n… {} bytes left out …\n{}", text(head)?, length - 2 * KEPT_BYTES, text(tail)?))
}

fn collect(program: &Program, folder: &Path) -> Result<BTreeMap<String, Vec<u8>>, StageError> {
    let mut outputs = BTreeMap::new();
    for place in &program.outputs {
        let path = folder.join(place);
        if path.is_file() {
            outputs.insert(place.clone(), fs::read(&path).map_err(failed("read an output"))?);
        }
    }
    Ok(outputs)
}
