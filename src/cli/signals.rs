//! What ends a run from outside: Ctrl-C, `kill`, the end of the terminal.

use std::ffi::c_int;
use std::io;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ};
use signal_hook::flag;

/// The exit code of a command that was interrupted.
pub const INTERRUPTED: c_int = 130;

/// The first Ctrl-C (or SIGTERM) asks the command to stop, the second ends the process.
///
/// The end of the terminal (SIGHUP) asks too, and never ends the process: it is often told twice. A run that was started to
/// outlive its terminal, with `nohup`, goes on.
pub fn stop_on_signal(stop: &Arc<AtomicBool>) {
    let ask = |signal: c_int| flag::register(signal, stop.clone()).map(drop);
    // Registered first, it sees whether the run was asked before.
    let insist = |signal: c_int| flag::register_conditional_shutdown(signal, INTERRUPTED, stop.clone()).map(drop);
    let twice = |signal: c_int| insist(signal).and_then(|()| ask(signal));
    let hangup = || if is_ignored(SIGHUP) { io::Result::Ok(()) } else { ask(SIGHUP) };
    // A file beyond the limit of `ulimit -f` is an error where it is written, and not the end of the process.
    let _ = flag::register(SIGXFSZ, Arc::default());
    if let Err(error) = twice(SIGINT).and_then(|()| twice(SIGTERM)).and_then(|()| hangup()) {
        tracing::warn!("Ctrl-C will end the program at once: {error}");
    }
}

/// Whether the process was started with a signal ignored; false where the system does not tell.
fn is_ignored(signal: c_int) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask >> (signal - 1) & 1 == 1
}
