//! What planning lends a stage whose ports follow from a file that a parameter names.

use std::path::{Path, PathBuf};

use crate::program::Found;

/// What planning lends [`crate::Stage::complete`].
pub trait Planner {
    /// Asks a program: runs it with these arguments and this text on its standard input, in no particular folder, and
    /// returns what it prints. Equal questions are asked once.
    ///
    /// # Errors
    /// It cannot be started, fails or takes too long: the message says why.
    fn ask(&self, program: Found, args: &[&str], input: &str) -> Result<String, String>;

    /// The absolute path of a file that a parameter names.
    fn path(&self, written: &str) -> PathBuf;

    /// Notes a file or folder that the answer rests on: when it changes, planning asks again.
    fn rests_on(&self, path: &Path);
}
