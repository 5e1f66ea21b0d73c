//! `rockface completions`.

use clap::{Args, CommandFactory};
use clap_complete::Shell;

use super::{Cli, say};

/// Arguments of `rockface completions`.
#[derive(Debug, Args)]
pub struct CompletionsArgs {
    /// The shell.
    shell: Shell,
}

impl CompletionsArgs {
    /// Prints a script for the shell.
    pub fn run(self) {
        let mut script = Vec::new();
        clap_complete::generate(self.shell, &mut Cli::command(), "rockface", &mut script);
        say(String::from_utf8_lossy(&script).trim_end());
    }
}
