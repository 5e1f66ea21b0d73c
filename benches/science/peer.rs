//! The same work by another program: its input in a folder of bare arrays, its result and its seconds from there.

use std::path::{Path, PathBuf};
use std::process::Command;

use bytemuck::Pod;
use serde_json::Value;

use crate::measure::threads;
use crate::row::digits;

/// What a peer has to say.
pub enum Answer {
    /// It ran.
    Done(Done),
    /// This package is not installed.
    Missing(String),
    /// It ended with an error, which it printed.
    Failed,
}

/// A work that a peer did.
pub struct Done {
    /// Its name and version.
    pub who: String,
    /// From start to end, seconds.
    pub wall_s: f64,
    /// Processor time, seconds.
    pub cpu_s: f64,
    /// Further seconds by name, for the table.
    pub further: Vec<(&'static str, String)>,
    answer: Value,
}

impl Done {
    /// A number of the answer.
    pub fn number(&self, name: &str) -> f64 {
        self.answer[name].as_f64().unwrap_or(f64::NAN)
    }
}

/// A folder that a peer reads from and writes to.
pub struct Peer {
    folder: tempfile::TempDir,
}

impl Peer {
    /// An empty folder.
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir().expect("a temporary folder") }
    }

    /// The path of a file in the folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes an array; its name ends with the kind of its numbers, such as `points.f8`.
    pub fn give<T: Pod>(&self, name: &str, values: &[T]) {
        std::fs::write(self.path(name), bytemuck::cast_slice(values)).expect("room in the temporary folder");
    }

    /// Reads an array that the peer wrote.
    pub fn take<T: Pod>(&self, name: &str) -> Vec<T> {
        let bytes = std::fs::read(self.path(name)).expect("the result of the peer");
        bytes.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned).collect()
    }

    /// Lets the peer work; `further` names more seconds of its answer, each with the words for the table.
    pub fn work(&self, work: &str, further: &[(&str, &'static str)]) -> Answer {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/peers/peers.py");
        let threads = threads().to_string();
        let mut command = Command::new(python());
        command.arg(script).arg(work).arg(self.folder.path()).arg(threads);
        let Ok(output) = command.output() else { return Answer::Missing("Python".to_owned()) };
        let text = String::from_utf8_lossy(&output.stdout);
        let answer: Option<Value> = text.lines().last().and_then(|line| serde_json::from_str(line).ok());
        let Some(answer) = answer.filter(|_| output.status.success()) else {
            eprintln!("{work}: {}", String::from_utf8_lossy(&output.stderr));
            return Answer::Failed;
        };
        if let Some(package) = answer["missing"].as_str() {
            return Answer::Missing(package.to_owned());
        }
        let number = |name: &str| answer[name].as_f64().unwrap_or(f64::NAN);
        Answer::Done(Done {
            who: answer["who"].as_str().unwrap_or(work).to_owned(),
            wall_s: number("wall_s"),
            cpu_s: number("cpu_s"),
            further: further.iter().map(|(name, words)| (*words, digits(number(name)))).collect(),
            answer,
        })
    }
}

/// The Python that has the peers.
fn python() -> PathBuf {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers/.venv/bin/python");
    let named = std::env::var_os("ROCKFACE_PEERS_PYTHON").map(PathBuf::from);
    named.or_else(|| beside.is_file().then_some(beside)).unwrap_or_else(|| "python3".into())
}

/// A check of the peer's result, where it has one.
pub fn check(answer: &Answer, compare: impl FnOnce(&Done) -> String) -> String {
    if let Answer::Done(done) = answer { compare(done) } else { String::new() }
}
