//! What a stage asks the engine to run for it, and what comes back; no stage starts a process itself.

pub mod ended;

use std::collections::BTreeMap;

use serde_json::Value;

/// A part of an argument.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Piece {
    /// Text as it is.
    Text(String),
    /// The absolute path of a file that a parameter names, as it was written there.
    File(String),
    /// A program that is not part of the pipeline.
    Found(Found),
}

/// A program that is looked for where the user has it: the one a variable of the environment names, else the one beside the
/// file of the running program, else the first on the search path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Found {
    /// The variable, such as `ROCKFACE_PYTHON`.
    pub variable: &'static str,
    /// The name, such as `python3`.
    pub name: &'static str,
}

/// A program with all it is given. It runs in a fresh folder of its own, which is gone afterwards.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Program {
    /// The program: a name to be found on the search path, or a path.
    pub program: Vec<Piece>,
    /// Its arguments, each joined from pieces such as texts and paths.
    pub args: Vec<Vec<Piece>>,
    /// Environment variables it is given.
    pub environment: BTreeMap<String, String>,
    /// Environment variables that are handed on from outside, besides those that every program needs.
    pub inherit: Vec<String>,
    /// Files that are there when it starts, relative to its folder.
    pub inputs: Vec<(String, Vec<u8>)>,
    /// Files it is to make, relative to its folder; their own folders are there when it starts.
    pub outputs: Vec<String>,
}

/// A job for a program that stays alive between jobs, so that it is started once for many steps.
///
/// The host writes a line of JSON to its standard input, `{"folder": ..., "paths": ..., "request": ...}`, and reads a line of
/// JSON from its standard output. The files of `inputs` lie in the folder, and it puts its outputs there. What it prints
/// meanwhile it directs to the files `stdout` and `stderr` of the folder. An answer with `"retire": true` is its last.
#[derive(Debug, Clone, PartialEq)]
pub struct Job {
    /// The program; jobs of equal programs share processes, one job at a time in each. It has no inputs and outputs itself.
    pub program: Program,
    /// What it is asked.
    pub request: Value,
    /// Files that parameters name, by what the program calls them.
    pub paths: BTreeMap<String, Piece>,
    /// Files that are in the folder when it is asked, relative to that.
    pub inputs: Vec<(String, Vec<u8>)>,
    /// Files it is to make, relative to the folder.
    pub outputs: Vec<String>,
}

/// What came of a job.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct JobResult {
    /// Its answer; `None` if it ended, or was no JSON.
    pub answer: Option<Value>,
    /// What it printed and made, and how it ended if it did.
    pub result: ProgramResult,
}

/// What a program left behind.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ProgramResult {
    /// The exit code; `None` if a signal ended it.
    pub exit_code: Option<i32>,
    /// The signal that ended it.
    pub signal: Option<i32>,
    /// What it wrote to standard output; a long text is cut in its middle.
    pub stdout: String,
    /// What it wrote to standard error; a long text is cut in its middle.
    pub stderr: String,
    /// The wanted files that are there.
    pub outputs: BTreeMap<String, Vec<u8>>,
    /// What is in place of wanted files, by these: such as `a folder` or `a pipe`.
    pub others: BTreeMap<String, &'static str>,
}
