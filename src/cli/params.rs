//! `rockface params`: what a pipeline may be given by `--set params.NAME=VALUE`.

use clap::Args;
use rockface_core::Registry;
use rockface_engine::pipeline::{Node, Pipeline};
use serde_json::{Value, json};

use super::{CliError, PipelineArgs, parts, say};

/// Arguments of `rockface params`.
#[derive(Debug, Args)]
pub struct ParamsArgs {
    #[command(flatten)]
    pipeline: PipelineArgs,
    /// Print them as JSON.
    #[arg(long)]
    json: bool,
}

impl ParamsArgs {
    /// Prints the parameters with their values, units, ranges and what they are about.
    pub fn run(mut self, registry: &Registry) -> Result<(), CliError> {
        self.pipeline.take()?;
        let pipeline = self.pipeline.load(registry)?;
        if self.json {
            say(&serde_json::to_string_pretty(&list(&pipeline)).unwrap_or_default());
        } else if pipeline.document.params.is_empty() {
            say("this pipeline has no parameters");
        } else {
            for (name, value) in values(&pipeline) {
                match pipeline.document.declared.iter().find(|param| param.name.text == *name) {
                    Some(param) => say(&parts::line(param, Some(&value))),
                    None => say(&format!("- `{name}` = {value}")),
                }
            }
            say("\nchange one: --set params.NAME=VALUE, sweep one: --sweep params.NAME=VALUE,VALUE");
        }
        Ok(())
    }
}

fn values(pipeline: &Pipeline) -> impl Iterator<Item = (&String, Value)> {
    pipeline.document.params.iter().map(|(key, node): &(_, Node)| (&key.name, node.to_value()))
}

fn list(pipeline: &Pipeline) -> Value {
    let one = |(name, value): (&String, Value)| {
        let declared = pipeline.document.declared.iter().find(|param| param.name.text == *name);
        let mut about = declared.map_or_else(|| json!({"name": name}), parts::parameter);
        about["value"] = value;
        about
    };
    values(pipeline).map(one).collect()
}
