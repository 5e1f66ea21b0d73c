//! `rockface stages`: the catalogue, and the page of one stage.

use clap::Args;
use rockface_core::Registry;
use rockface_core::params::{Field, Kind};
use rockface_core::{AnyStage, Arity, Port};
use serde_json::{Value, json};

use super::schema::map_of;
use super::{CliError, say};
use rockface_engine::diagnostic::{listed, nearest};

/// Arguments of `rockface stages`.
#[derive(Debug, Args)]
pub struct StagesArgs {
    /// Show the manual page of this stage.
    #[arg(add = super::candidates::stages())]
    name: Option<String>,
    /// Print the JSON Schema of pipelines, for editors: `rockface stages --schema > rockface.schema.json`.
    #[arg(long, conflicts_with_all = ["name", "json"])]
    schema: bool,
    /// Print the stages, or one of them, as JSON: ports with their kinds, parameters with their defaults.
    #[arg(long)]
    json: bool,
}

impl StagesArgs {
    /// Prints the catalogue or a page.
    pub fn run(self, registry: &Registry) -> Result<(), CliError> {
        let pretty = |value: &Value| serde_json::to_string_pretty(value).unwrap_or_default();
        match self.name {
            None if self.schema => say(&pretty(&super::schema::schema(registry.stages()))),
            None if self.json => say(&pretty(&registry.stages().iter().map(|stage| about(*stage)).collect())),
            None => say(&catalogue(registry)),
            Some(name) => {
                let stage = registry.find(&name).ok_or_else(|| unknown(registry, &name))?;
                say(&if self.json { pretty(&about(stage)) } else { page(stage) });
            }
        }
        Ok(())
    }
}

fn unknown(registry: &Registry, name: &str) -> CliError {
    let known: Vec<&str> = registry.stages().iter().map(|stage| stage.name()).collect();
    let with_it: Vec<&str> = known.iter().copied().filter(|known| known.contains(name)).collect();
    let hint = match nearest(name, &known) {
        _ if !with_it.is_empty() && !name.is_empty() => format!("stages with it in their name: {}", listed(with_it)),
        Some(near) => format!("did you mean `{near}`?"),
        None => "`rockface stages` lists them".to_owned(),
    };
    CliError::Usage(format!("there is no stage `{name}`; {hint}"))
}

/// One line a stage, by room.
fn catalogue(registry: &Registry) -> String {
    let width = registry.stages().iter().map(|stage| stage.name().len()).max().unwrap_or(0);
    let line = |stage: &&dyn AnyStage| format!("  {:width$}  {}", stage.name(), first_sentence(*stage));
    let mut lines = Vec::new();
    for room in registry.rooms() {
        lines.push(format!("{}: {}", room.name, room.doc));
        lines.extend(room.stages.iter().map(line));
        lines.push(String::new());
    }
    lines.push("`rockface stages NAME` shows ports, parameters, units, method and an example.".into());
    lines.join("\n")
}

/// What a stage does, in a sentence.
pub fn first_sentence(stage: &dyn AnyStage) -> &'static str {
    let what = stage.page().what();
    what.split_inclusive(". ").next().unwrap_or(what).trim()
}

/// What a program needs to know of a stage; its parameters as a JSON Schema.
fn about(stage: &dyn AnyStage) -> Value {
    let port = |port: &Port| {
        let kinds: Vec<&str> = port.kinds.iter().map(|kind| kind.word()).collect();
        let arity = match port.arity {
            Arity::One => "one",
            Arity::Optional => "optional",
            Arity::Many => "many",
        };
        json!({"name": port.name, "kinds": kinds, "arity": arity, "doc": port.doc})
    };
    json!({
        "name": stage.name(), "version": stage.version(), "what": stage.page().what(),
        "inputs": stage.inputs().iter().map(port).collect::<Vec<_>>(),
        "outputs": stage.outputs().iter().map(port).collect::<Vec<_>>(),
        "parameters": map_of(&stage.fields()),
    })
}

/// The whole page of a stage, as Markdown.
pub fn page(stage: &dyn AnyStage) -> String {
    let page = stage.page();
    let mut text = format!("# {} (version {})\n\n{}\n", stage.name(), stage.version(), page.what());
    text += &ports("Inputs", stage.inputs());
    text += &ports("Outputs", stage.outputs());
    text += "\n## Parameters\n\n";
    let parameters = stage.fields();
    text += &fields(&parameters, "");
    if let Some(distribution) = distribution(&parameters) {
        text += "\n## Distributions\n\nA number may be drawn anew each time: in its place stands a map with one of these keys.\n\n";
        text += &inner(&distribution, "");
    }
    text += &format!("\n## Method and references\n\n{}\n", page.method());
    text += &format!("\n## Units and frames\n\n{}\n", page.frames());
    text += &format!("\n## Fails when\n\n{}\n", page.fails());
    text += &format!("\n## Example\n\n```yaml\n{}\n```", page.example().trim());
    text
}

fn ports(title: &str, ports: &[Port]) -> String {
    if ports.is_empty() {
        return String::new();
    }
    let line = |port: &Port| {
        let kinds: Vec<_> = port.kinds.iter().map(ToString::to_string).collect();
        let many = match port.arity {
            Arity::One => "",
            Arity::Optional => ", optional",
            Arity::Many => ", one or a gathered list",
        };
        format!("- `{}` ({}{many}): {}\n", port.name, kinds.join(" or "), port.doc)
    };
    format!("\n## {title}\n\n{}", ports.iter().map(line).collect::<String>())
}

fn fields(fields: &[Field], indent: &str) -> String {
    if fields.is_empty() {
        return "None.\n".into();
    }
    let line = |field: &Field| {
        let range = field.range.to_string();
        let range = if range.is_empty() { range } else { format!(", {range}") };
        let default =
            field.default.as_ref().map_or_else(|| ", must be given".to_owned(), |value| format!(", default {value}"));
        let mut text = format!("{indent}- `{}` ({}{range}{default}): {}\n", field.name, field.kind, field.doc);
        text += &inner(&field.kind, indent);
        text
    };
    fields.iter().map(line).collect()
}

/// The kind of the first number that may be drawn from a distribution; all are of one kind.
fn distribution(fields: &[Field]) -> Option<Kind> {
    fields.iter().find_map(|field| inside(&field.kind))
}

fn inside(kind: &Kind) -> Option<Kind> {
    match kind {
        Kind::NumberOr(kind) => Some((**kind).clone()),
        Kind::Optional(kind) | Kind::List(kind, _) => inside(kind),
        Kind::Map(fields) | Kind::Union(fields) => distribution(fields),
        _ => None,
    }
}

fn variants(fields: &[Field], indent: &str) -> String {
    let line = |field: &Field| format!("{indent}- `{}`: {}\n{}", field.name, field.doc, inner(&field.kind, indent));
    fields.iter().map(line).collect()
}

fn inner(kind: &Kind, indent: &str) -> String {
    match kind {
        Kind::Map(inside) if inside.is_empty() => String::new(),
        Kind::Map(inside) => fields(inside, &format!("{indent}  ")),
        Kind::Union(inside) => variants(inside, &format!("{indent}  ")),
        Kind::Optional(kind) | Kind::List(kind, _) => inner(kind, indent),
        Kind::Choice(words) => {
            words.iter().map(|(word, doc)| format!("{indent}  - `{word}`: {}\n", doc.trim())).collect()
        }
        _ => String::new(),
    }
}
