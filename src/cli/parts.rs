//! `rockface parts`: the parts that come with the program, and what has to be known to use one.

use clap::Args;
use rockface_core::Registry;
use rockface_engine::pipeline::{Declared, Interface, PartInput, Pipeline};
use serde_json::{Value, json};

use super::{CliError, say};

/// Arguments of `rockface parts`.
#[derive(Debug, Args)]
pub struct PartsArgs {
    /// Show this part: its name, or the path of its file.
    #[arg(add = super::candidates::parts())]
    name: Option<String>,
    /// Print the text of the part, to begin one of your own from.
    #[arg(long, requires = "name")]
    text: bool,
    /// Print them as JSON.
    #[arg(long, conflicts_with = "text")]
    json: bool,
}

impl PartsArgs {
    /// Prints the list or one part.
    pub fn run(self, registry: &Registry) -> Result<(), CliError> {
        let read = |name: &str| Pipeline::part(name, registry.parts()).map_err(CliError::Pipeline);
        let pretty = |value: &Value| serde_json::to_string_pretty(value).unwrap_or_default();
        let Some(name) = self.name else {
            let all: Vec<(&str, Interface)> = registry
                .parts()
                .iter()
                .map(|part| Ok((part.name, read(part.name)?)))
                .collect::<Result<_, CliError>>()?;
            if self.json {
                say(&pretty(&all.iter().map(|(name, part)| about(name, part)).collect()));
            } else {
                let width = all.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
                all.iter().for_each(|(name, part)| say(&format!("{name:width$}  {}", part.doc)));
                say("\n`rockface parts NAME` shows parameters, inputs, outputs and how a step uses it.");
            }
            return Ok(());
        };
        let part = read(&name)?;
        if self.text {
            let shipped = registry.parts().iter().find(|part| part.name == name).map(|part| part.text.to_owned());
            let text = shipped.map_or_else(|| Pipeline::read_file(name.as_ref()).map_err(CliError::Pipeline), Ok)?;
            say(text.trim_end());
        } else if self.json {
            say(&pretty(&about(&name, &part)));
        } else {
            say(&page(&name, &part));
        }
        Ok(())
    }
}

fn about(name: &str, part: &Interface) -> Value {
    let input = |input: &PartInput| {
        let kinds: Vec<&str> = input.kinds.iter().map(|kind| kind.word()).collect();
        json!({"name": input.name.text, "kinds": kinds, "optional": input.optional, "doc": input.doc})
    };
    json!({
        "name": name, "doc": part.doc, "outputs": part.outputs,
        "inputs": part.inputs.iter().map(input).collect::<Vec<_>>(),
        "parameters": part.params.iter().map(parameter).collect::<Vec<_>>(),
    })
}

/// A declared parameter for programs.
pub fn parameter(param: &Declared) -> Value {
    json!({
        "name": param.name.text, "type": param.kind.word(), "unit": param.unit, "min": param.min, "max": param.max,
        "choices": param.choices, "default": param.default.as_ref().map(rockface_engine::pipeline::Node::to_value),
        "needed": param.default.is_none(), "doc": param.doc,
    })
}

/// A declared parameter in one line, `value` being what it is now.
pub fn line(param: &Declared, value: Option<&Value>) -> String {
    let mut facts = vec![param.kind.word().to_owned()];
    facts.extend(param.unit.clone());
    facts.extend(Some(param.range()).filter(|range| !range.is_empty()));
    facts.extend(Some(param.choice_words()).filter(|words| !words.is_empty()));
    let value = value.map_or_else(|| ", needed".to_owned(), |value| format!(" = {value}"));
    let doc = if param.doc.is_empty() { String::new() } else { format!(": {}", param.doc) };
    format!("- `{}`{value} ({}){doc}", param.name.text, facts.join(", "))
}

/// The page of a part, as Markdown.
pub fn page(name: &str, part: &Interface) -> String {
    let mut lines = vec![format!("# {name}\n"), part.doc.clone()];
    let mut section = |title: &str, list: Vec<String>| {
        if !list.is_empty() {
            lines.push(format!("\n## {title}\n"));
            lines.extend(list);
        }
    };
    let input = |input: &PartInput| {
        let optional = if input.optional { ", optional" } else { "" };
        let doc = if input.doc.is_empty() { String::new() } else { format!(": {}", input.doc) };
        format!("- `{}` ({}{optional}){doc}", input.name.text, input.kind_words())
    };
    section("Inputs", part.inputs.iter().map(input).collect());
    section("Outputs", part.outputs.iter().map(|name| format!("- `{name}`")).collect());
    let default = |param: &Declared| param.default.as_ref().map(rockface_engine::pipeline::Node::to_value);
    section("Parameters", part.params.iter().map(|param| line(param, default(param).as_ref())).collect());
    section("Use", vec![usage(name, part)]);
    lines.join("\n")
}

/// A step that uses it, with all that is needed.
fn usage(name: &str, part: &Interface) -> String {
    let needed = part.params.iter().filter(|param| param.default.is_none());
    let with: Vec<String> = needed.map(|param| format!("{}: …", param.name.text)).collect();
    let fed: Vec<String> = part
        .inputs
        .iter()
        .filter(|input| !input.optional)
        .map(|input| format!("{}: step.port", input.name.text))
        .collect();
    let mut lines = vec![format!("```yaml\nmine:\n  use: {name}")];
    lines.extend((!with.is_empty()).then(|| format!("  with: {{{}}}", with.join(", "))));
    lines.extend((!fed.is_empty()).then(|| format!("  in: {{{}}}", fed.join(", "))));
    lines.push("```".to_owned());
    lines.join("\n")
}
