//! What a stage asks the engine to run for it, and what comes back; no stage starts a process itself.

pub mod ended;

use std::collections::BTreeMap;

/// A part of an argument.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Piece {
    /// Text as it is.
    Text(String),
    /// The absolute path of a file that a parameter names, as it was written there.
    File(String),
}

/// A program with all it is given. It runs in a fresh folder of its own, which is gone afterwards.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Program {
    /// The program: a name to be found on the search path, or a path.
    pub program: Vec<Piece>,
    /// Its arguments.
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
    /// The wanted files in whose place there is a folder.
    pub folders: Vec<String>,
}
