//! `--no-commands`: pipelines that start no program, and no others.

use clap::Args;
use clap::builder::FalseyValueParser;
use rockface_core::Registry;

use super::CliError;
use rockface_engine::pipeline::Pipeline;

/// The variable that says `--no-commands`.
const VARIABLE: &str = "ROCKFACE_NO_COMMANDS";

/// Whether the environment refuses programs: for commands without the option too, some of which ask Python what is in a module.
pub fn are_refused_by_environment() -> bool {
    const FALSEY: [&str; 7] = ["", "n", "no", "f", "false", "off", "0"];
    std::env::var_os(VARIABLE).is_some_and(|value| !FALSEY.contains(&value.to_string_lossy().to_lowercase().as_str()))
}

/// Whether steps may start programs.
#[derive(Debug, Args)]
pub struct ProgramArgs {
    /// Refuse a pipeline with steps that start programs (`command`, `python`, `fuse-colmap`), even if their results are cached.
    #[arg(long, env = VARIABLE, value_parser = FalseyValueParser::new())]
    no_commands: bool,
}

impl ProgramArgs {
    /// Whether programs are refused.
    pub fn are_refused(&self) -> bool {
        self.no_commands
    }

    /// Refuses a pipeline whose targets need a step that starts a program, where programs are refused.
    pub fn check(&self, registry: &Registry, pipeline: &Pipeline, targets: &[String]) -> Result<(), CliError> {
        if !self.no_commands {
            return Ok(());
        }
        let graph = rockface_engine::plan::resolve(pipeline, targets, registry.stages()).map_err(CliError::Pipeline)?;
        rockface_engine::plan::without_programs(&graph, pipeline).map_err(CliError::Pipeline)
    }
}
