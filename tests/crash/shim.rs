//! The library that is loaded into the program: built once, lent to commands.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// What happens to one system call.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Fault {
    /// An error, `short`, `kill`, `tear` or `threads`.
    pub what: &'static str,
    /// Whether it happens to all later calls, too.
    pub lasts: bool,
}

impl std::fmt::Display for Fault {
    fn fmt(&self, out: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(out, "{}{}", self.what, if self.lasts { " from then on" } else { "" })
    }
}

/// The library, or `None` after a line that says why there is none.
pub fn shim() -> Option<&'static Path> {
    static BUILT: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    match BUILT.get_or_init(build) {
        Ok(path) => Some(path),
        Err(why) => {
            println!("skipped: {why}");
            None
        }
    }
}

fn build() -> Result<PathBuf, String> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let (made, path) = (folder.join(format!("shim-{}.so", std::process::id())), folder.join("shim.so"));
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/crash/shim.c");
    let mut cc = Command::new("cc");
    cc.args(["-shared", "-fPIC", "-O1", "-Wall", "-Wextra", "-Werror", "-o"]).arg(&made).arg(&source);
    let out =
        cc.output().map_err(|error| format!("the shim needs a C compiler, and `cc` cannot be started: {error}"))?;
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    // Another test process may be using the former one.
    std::fs::rename(&made, &path).map_err(|error| error.to_string())?;
    let mut probe = Command::new(env!("CARGO_BIN_EXE_rockface"));
    load(&mut probe, &path, folder);
    let probed = probe.arg("--version").output().map_err(|error| error.to_string())?;
    let refused = || format!("this system lets no process filter its own system calls ({})", probed.status);
    probed.status.success().then_some(path).ok_or_else(refused)
}

fn load(command: &mut Command, shim: &Path, under: &Path) {
    command.env("LD_PRELOAD", shim).env("CRASH_UNDER", under);
}

/// A command with the library inside, which watches the files under a folder.
pub struct Watched<'a>(pub &'a mut Command);

impl Watched<'_> {
    /// Loads the library into a command, to watch the files under a folder.
    pub fn new<'a>(command: &'a mut Command, shim: &Path, under: &Path) -> Watched<'a> {
        load(command, shim, under);
        Watched(command)
    }

    /// Every change goes to this file.
    pub fn log(self, file: &Path) -> Self {
        self.0.env("CRASH_LOG", file);
        self
    }

    /// The clock of the process is ahead by so many seconds.
    pub fn later(self, seconds: u64) -> Self {
        self.0.env("CRASH_LATER", seconds.to_string());
        self
    }

    /// A fault befalls the call of this number among those it can befall; 0 counts them.
    pub fn fault(self, fault: &Fault, at: u64, report: &Path) -> Self {
        self.0.env("CRASH_WHAT", fault.what).env("CRASH_AT", at.to_string()).env("CRASH_REPORT", report);
        if fault.lasts {
            self.0.env("CRASH_LASTS", "1");
        }
        self
    }
}
