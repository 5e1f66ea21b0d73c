//! Placeholders in the arguments of a program: which there are, and what they stand for.

use serde_json::Value;

use super::CommandParams;
use rockface_core::StageError;
use rockface_core::params::Fault;
use rockface_core::program::Piece;

/// How a placeholder for a file begins.
pub const TEMPLATE: &str = "{file.";

/// Sides of a placeholder's dot that mean something here.
const SIDES: [&str; 4] = ["in", "out", "param", "file"];

/// The placeholders of a step.
pub struct Names(Vec<String>);

impl Names {
    /// Those of these parameters.
    pub fn of(params: &CommandParams) -> Self {
        let named = |side: &'static str, names: Vec<&String>| {
            names.into_iter().map(move |name| format!("{side}.{name}")).collect::<Vec<_>>()
        };
        let sides = [
            named("in", params.inputs.keys().collect()),
            named("out", params.outputs.keys().collect()),
            named("param", params.params.keys().collect()),
            named("file", params.files.keys().collect()),
        ];
        Self(sides.into_iter().flatten().collect())
    }

    /// The placeholders of a text that stand for nothing.
    pub fn strangers(&self, text: &str) -> Vec<Fault> {
        let strange = |name: &&str| is_placeholder(name) && !self.0.iter().any(|known| known == *name);
        let told = |name: &str| {
            let known = self.0.iter().map(|name| format!("{{{name}}}")).collect();
            Fault { known, ..Fault::new(format!("`{{{name}}}` names nothing that is declared")) }
        };
        split(text).into_iter().filter_map(|(_, name)| name).filter(strange).map(told).collect()
    }
}

/// Whether the inside of braces is meant as a placeholder; anything else stays as it is.
fn is_placeholder(inside: &str) -> bool {
    inside
        .split_once('.')
        .is_some_and(|(side, name)| SIDES.contains(&side) && !name.is_empty() && !name.contains(char::is_whitespace))
}

/// Text before each pair of braces with what is inside, and the rest.
fn split(text: &str) -> Vec<(&str, Option<&str>)> {
    let (mut parts, mut rest) = (Vec::new(), text);
    while let Some(open) = rest.find('{') {
        let Some(length) = rest[open..].find('}') else { break };
        let inside = &rest[open + 1..open + length];
        // Of braces within braces the innermost count.
        let open = open + inside.rfind('{').map_or(0, |at| at + 1);
        let close = open + rest[open..].find('}').unwrap_or(0);
        parts.push((&rest[..open], Some(&rest[open + 1..close])));
        rest = &rest[close + 1..];
    }
    parts.push((rest, None));
    parts
}

/// A text with its placeholders filled in.
pub fn pieces(text: &str, names: &Names, params: &CommandParams, seed: Option<u32>) -> Result<Vec<Piece>, StageError> {
    let mut pieces = Vec::new();
    let mut open = String::new();
    for (before, inside) in split(text) {
        open.push_str(before);
        let Some(inside) = inside else { continue };
        match (inside.split_once('.'), seed) {
            (None, Some(seed)) if inside == "seed" => open.push_str(&seed.to_string()),
            (Some(("file", name)), _) if names.0.iter().any(|known| known == inside) => {
                pieces.push(Piece::Text(std::mem::take(&mut open)));
                pieces.push(Piece::File(params.files[name].0.clone()));
            }
            (Some((side, name)), _) if names.0.iter().any(|known| known == inside) => {
                open.push_str(&filled(side, name, params)?);
            }
            _ => open.push_str(&format!("{{{inside}}}")),
        }
    }
    pieces.push(Piece::Text(open));
    Ok(pieces)
}

fn filled(side: &str, name: &str, params: &CommandParams) -> Result<String, StageError> {
    match (side, params.params.get(name)) {
        ("in", _) => Ok(params.inputs[name].place("in", name)),
        ("out", _) => Ok(params.outputs[name].place("out", name)),
        (_, Some(Value::String(text))) => Ok(text.clone()),
        (_, Some(value)) => Ok(value.to_string()),
        (_, None) => Err(StageError::new(format!("`{{{side}.{name}}}` names nothing"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::params::ParamType;

    #[test]
    fn placeholders_are_filled_and_other_braces_stay() {
        let with = serde_json::json!({
            "program": "sh", "version": "1", "inputs": {"a": "mesh"}, "outputs": {"b": {"kind": "file", "extension": "txt"}},
            "params": {"k": 0.5, "name": "x"}, "files": {"script": "s.py"},
        });
        let params = CommandParams::decode(&with).unwrap();
        let filled = |text: &str| pieces(text, &Names::of(&params), &params, Some(7)).unwrap();
        let text = |text: &str| vec![Piece::Text(text.to_owned())];
        assert_eq!(filled("{in.a}:{out.b}:{param.k}:{param.name}"), text("in/a.ply:out/b.txt:0.5:x"));
        assert_eq!(filled("awk '{print {param.k}} {' {seed} {}"), text("awk '{print 0.5} {' 7 {}"));
        let file = Piece::File("s.py".to_owned());
        assert_eq!(filled("x={file.script}"), [Piece::Text("x=".to_owned()), file, Piece::Text(String::new())]);
    }
}
