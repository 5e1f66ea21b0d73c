//! The limits a case must keep, and the child processes in which cases are tried.

use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use rustix::process::{Resource, Rlimit, setrlimit};

/// Address space of a child: what a case of a few kilobytes may take with all that the program itself needs.
pub const MEMORY_BYTES: u64 = 2 << 30;
/// How long a case may take.
pub const PATIENCE: Duration = Duration::from_secs(10);
/// The stack a case has: that of the threads on which stages run.
pub const STACK_BYTES: usize = 2 << 20;

/// Limits the memory of this process for good.
///
/// # Errors
/// What the system says.
pub fn limit_memory() -> io::Result<()> {
    let limit = Some(MEMORY_BYTES);
    // A core file of every abort would fill the disk.
    setrlimit(Resource::Core, Rlimit { current: Some(0), maximum: Some(0) })?;
    setrlimit(Resource::As, Rlimit { current: limit, maximum: limit })?;
    Ok(())
}

/// Runs something on a thread with the stack of a worker; a panic in it ends the process.
pub fn on_a_small_stack(run: impl FnOnce() + Send) {
    std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().stack_size(STACK_BYTES).spawn_scoped(scope, run);
        let ended = thread.map(std::thread::ScopedJoinHandle::join);
        if !matches!(ended, Ok(Ok(()))) {
            std::process::exit(101);
        }
    });
}

/// A child that tries cases one after the other and names each before it begins.
pub struct Worker {
    child: Child,
    lines: Receiver<String>,
    told: Receiver<String>,
}

/// What came of waiting for a worker.
#[derive(Debug, PartialEq, Eq)]
pub enum Heard {
    /// It wrote a line.
    Line(String),
    /// It ended, or closed its output.
    Ended,
    /// It was silent for too long.
    Silent,
}

impl Worker {
    /// Starts this program again with these arguments; `scratch` is where its temporary files go.
    ///
    /// # Errors
    /// Where it cannot be started.
    pub fn start(arguments: &[String], scratch: &Path) -> io::Result<Self> {
        let mut child = Command::new(std::env::current_exe()?)
            .args(arguments)
            .env("TMPDIR", scratch)
            .env("RAYON_NUM_THREADS", "2")
            .env("RUST_BACKTRACE", "0")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()?;
        let lines = lines_of(child.stdout.take());
        let told = text_of(child.stderr.take());
        Ok(Self { child, lines, told })
    }

    /// The next line, or why there is none.
    pub fn hear(&self, patience: Duration) -> Heard {
        match self.lines.recv_timeout(patience) {
            Ok(line) => Heard::Line(line),
            Err(RecvTimeoutError::Disconnected) => Heard::Ended,
            Err(RecvTimeoutError::Timeout) => Heard::Silent,
        }
    }

    /// The next line of a child that was silent for a while, as long as it has not worked for `patience` since; on a busy
    /// machine it may only have waited. A child that neither works nor speaks for `waits` times as long hangs too.
    pub fn hear_after_work(&self, patience: Duration, waits: u32) -> Option<String> {
        let before = self.worked();
        for _ in 0..waits {
            match self.hear(patience) {
                Heard::Line(line) => return Some(line),
                Heard::Ended => return Some(String::new()),
                Heard::Silent => {}
            }
            let worked = self.worked().zip(before).map(|(now, before)| now.saturating_sub(before));
            if worked.is_none_or(|worked| worked >= patience) {
                return None;
            }
        }
        None
    }

    /// The processor time of the child, where the system tells.
    fn worked(&self) -> Option<Duration> {
        const TICK_MS: u64 = 10;
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.child.id())).ok()?;
        // User and system time are the 12th and 13th words after the name, which stands in parentheses.
        let mut words = stat.rsplit_once(')')?.1.split_whitespace().skip(11);
        let (user, system): (u64, u64) = (words.next()?.parse().ok()?, words.next()?.parse().ok()?);
        Some(Duration::from_millis((user + system) * TICK_MS))
    }

    /// Ends it if need be; how it ended and what it said on its standard error.
    pub fn end(mut self) -> (Option<std::process::ExitStatus>, String) {
        // A process that has ended already cannot be killed, which is just as well.
        let _ = self.child.kill();
        let status = self.child.wait().ok();
        (status, self.told.recv().unwrap_or_default())
    }

    /// Waits for it to end by itself.
    pub fn ended(mut self) -> (Option<std::process::ExitStatus>, String) {
        let status = self.child.wait().ok();
        (status, self.told.recv().unwrap_or_default())
    }
}

fn lines_of(pipe: Option<impl Read + Send + 'static>) -> Receiver<String> {
    let (send, lines) = channel();
    std::thread::spawn(move || {
        let lines = pipe.into_iter().flat_map(|pipe| BufReader::new(pipe).lines());
        for line in lines.map_while(Result::ok) {
            if send.send(line).is_err() {
                break;
            }
        }
    });
    lines
}

/// The end of what a pipe brings, at most 16 KiB.
fn text_of(pipe: Option<impl Read + Send + 'static>) -> Receiver<String> {
    const LAST_BYTES: usize = 16 << 10;
    let (send, text) = channel();
    std::thread::spawn(move || {
        let (mut kept, mut window) = (Vec::new(), [0; 4096]);
        if let Some(mut pipe) = pipe {
            while let Ok(count) = pipe.read(&mut window)
                && count > 0
            {
                kept.extend_from_slice(&window[..count]);
                let over = kept.len().saturating_sub(LAST_BYTES);
                kept.drain(..over);
            }
        }
        // Nobody may be left to hear it.
        let _ = send.send(String::from_utf8_lossy(&kept).into_owned());
    });
    text
}
