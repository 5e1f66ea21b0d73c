//! `rockface completions`.

use clap::Args;
use clap::builder::PossibleValuesParser;

use super::{candidates, say};

/// Arguments of `rockface completions`.
#[derive(Debug, Args)]
pub struct CompletionsArgs {
    /// The shell.
    #[arg(value_parser = PossibleValuesParser::new(["bash", "elvish", "fish", "powershell", "zsh"]))]
    shell: String,
}

impl CompletionsArgs {
    /// Prints a script for the shell, by which it asks the program for pipelines, steps, stages, parts, runs and outputs.
    pub fn run(self) {
        let script = candidates::script(&self.shell).unwrap_or_default();
        say(String::from_utf8_lossy(&script).trim_end());
    }
}
