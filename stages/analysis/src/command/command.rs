//! `command`: runs any program over declared inputs and outputs.

mod fill;

use std::collections::BTreeMap;

use serde_json::Value;

use self::fill::{Names, TEMPLATE, pieces};
use super::declared::{self, Declared};
use rockface_core::artefact::Artefact;
use rockface_core::format::table_file;
use rockface_core::params::{Fault, FileRef};
use rockface_core::program::{Piece, Program, ProgramResult, ended};
use rockface_core::{Arity, Context, Inputs, Outputs, Page, Port, Ports, Stage, StageError, params};

params! {
    /// Parameters of `command`.
    pub struct CommandParams {
        /// The program: a name on the search path, an absolute path, or `{file.name}` for one under `files`.
        program: String,
        /// Its arguments, one each; no shell looks at them. `{in.port}`, `{out.port}`, `{param.name}`, `{file.name}` and
        /// `{seed}` are filled in, other braces stay.
        args: Vec<String> = Vec::new(),
        /// The tool and its version, in words that change when its results may change: part of what a result is known by.
        version: String,
        /// Input ports: a kind each, or `{kind: table, many: true, optional: true, extension: csv}`.
        inputs: BTreeMap<String, Declared> = BTreeMap::new(),
        /// Output ports: a kind each, or `{kind: file, extension: txt}`.
        outputs: BTreeMap<String, Declared>,
        /// Values for `{param.name}`.
        params: BTreeMap<String, Value> = BTreeMap::new(),
        /// Files for `{file.name}`, such as scripts; their content is part of what a result is known by.
        files: BTreeMap<String, FileRef> = BTreeMap::new(),
        /// Environment variables the program is given.
        environment: BTreeMap<String, String> = BTreeMap::new(),
        /// Environment variables handed on from outside; for what does not change results, such as a licence.
        inherit: Vec<String> = Vec::new(),
    }
}

/// Runs a program over declared inputs and outputs: a script, a compiled tool, another photogrammetry package.
pub struct Command;

impl Stage for Command {
    type Params = CommandParams;
    const NAME: &'static str = "command";
    const VERSION: u32 = 4;
    const PAGE: Page = Page::new(include_str!("command.md"));
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[];
    const STARTS_PROGRAMS: bool = true;

    fn ports(with: &Value) -> Result<Ports, Vec<Fault>> {
        declared::ports(with, "no output is declared: for example outputs: {table: {kind: table, extension: csv}}")
    }

    fn draws(params: &CommandParams) -> bool {
        params.args.iter().chain(params.environment.values()).any(|text| text.contains("{seed}"))
    }

    fn check(params: &CommandParams) -> Vec<Fault> {
        let names = Names::of(params);
        let texts =
            params.args.iter().enumerate().map(|(index, text)| (vec!["args".to_owned(), index.to_string()], text));
        let variables =
            params.environment.iter().map(|(key, text)| (vec!["environment".to_owned(), key.clone()], text));
        let program = std::iter::once((vec!["program".to_owned()], &params.program));
        let mut faults: Vec<Fault> = program
            .chain(texts)
            .chain(variables)
            .flat_map(|(path, text)| {
                names.strangers(text).into_iter().map(move |fault| Fault { path: path.clone(), ..fault })
            })
            .collect();
        if params.program.contains('/') && !params.program.starts_with('/') && !params.program.contains(TEMPLATE) {
            let message = "a relative path would be looked for in the folder it runs in; name it under `files` and \
                           write {file.name}";
            faults.push(Fault { path: vec!["program".to_owned()], ..Fault::new(message) });
        }
        if params.version.trim().is_empty() {
            let message = "say which tool it is and its version; it tells old results from new ones";
            faults.push(Fault { path: vec!["version".to_owned()], ..Fault::new(message) });
        }
        faults
    }

    fn run(params: &CommandParams, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let ports = declared::ports_of(&params.inputs, &params.outputs);
        let program = program(params, inputs, context)?;
        let result = context.execute(&program)?;
        ended::tell(context, &result);
        ended::well(&params.program, &result)?;
        ports.outputs.iter().try_fold(Outputs::default(), |outputs, port| {
            let declared = &params.outputs[port.name];
            Ok(outputs.and(port.name, output(port.name, declared, &result, context)?))
        })
    }
}

fn program(params: &CommandParams, inputs: &Inputs, context: &Context) -> Result<Program, StageError> {
    let names = Names::of(params);
    let seed = if Command::draws(params) { Some(context.seed("command")) } else { None };
    let fill = |text: &String| pieces(text, &names, params, seed);
    let environment = params.environment.iter().map(|(name, text)| Ok((name.clone(), plain(&fill(text)?)?)));
    Ok(Program {
        program: fill(&params.program)?,
        args: params.args.iter().map(fill).collect::<Result<_, _>>()?,
        environment: environment.collect::<Result<_, StageError>>()?,
        inherit: params.inherit.clone(),
        inputs: given(params, inputs)?,
        outputs: params.outputs.iter().map(|(port, declared)| declared.place("out", port)).collect(),
    })
}

/// A variable has no use for the path of a file that only the engine knows.
fn plain(pieces: &[Piece]) -> Result<String, StageError> {
    let text = |piece: &Piece| match piece {
        Piece::Text(text) => Ok(text.clone()),
        Piece::File(_) | Piece::Found(_) => {
            Err(StageError::new("{file.name} stands for a path in `args`, not in `environment`"))
        }
    };
    pieces.iter().map(text).collect()
}

/// The input files of a program.
fn given(params: &CommandParams, inputs: &Inputs) -> Result<Vec<(String, Vec<u8>)>, StageError> {
    let mut files = Vec::new();
    for (port, declared) in &params.inputs {
        let elements = inputs.elements(port);
        if declared.arity != Arity::Many {
            for element in elements {
                files.push((declared.place("in", port), declared.bytes(port, element.artefact()?)?));
            }
            continue;
        }
        let mut index = Vec::new();
        for (number, element) in elements.iter().enumerate() {
            let name = format!("{number:06}.{}", declared.extension());
            files.push((format!("in/{port}/{name}"), declared.bytes(port, element.artefact()?)?));
            index.push(serde_json::json!({ "file": name, "point": element.point }));
        }
        files.push((format!("in/{port}/index.json"), Value::from(index).to_string().into_bytes()));
    }
    Ok(files)
}

fn output(port: &str, declared: &Declared, result: &ProgramResult, context: &Context) -> Result<Artefact, StageError> {
    let place = declared.place("out", port);
    let Some(bytes) = result.outputs.get(&place) else {
        let other = result.others.get(&place).copied();
        let message = match other {
            Some(other) => format!("the program made {other} where its output `{port}` is to be a file"),
            None => format!("the program made no output `{port}`"),
        };
        let several = if other == Some("a folder") { "; of several files make one, with tar for instance" } else { "" };
        let hint = format!("write it to {{out.{port}}}, which is `{place}` in the folder the program runs in{several}");
        return Err(StageError::new(message).hint(hint));
    };
    let decoded = if declared.is_csv() {
        table_file::read(bytes, &|| context.cancelled()).map(Artefact::Table)
    } else {
        Artefact::decode(declared.kind, bytes)
    };
    decoded.map_err(|error| StageError::new(format!("output `{port}` (`{place}`) is no {}: {error}", declared.kind)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Kind;
    use rockface_core::params::ParamType;

    fn params(text: &str) -> Result<CommandParams, Vec<Fault>> {
        CommandParams::decode(&serde_json::from_str(text).unwrap())
    }

    #[test]
    fn faults_name_the_argument() {
        let params = params(
            r#"{"program": "bin/tool", "args": ["{in.dem}", "{out.tabel} {param.k}", "{print $1}"], "version": "1",
                "inputs": {"dem": "raster"}, "outputs": {"table": "table"}}"#,
        )
        .unwrap();
        let faults = Command::check(&params);
        assert_eq!(faults[0].path, ["args", "1"]);
        assert!(faults[0].message.contains("{out.tabel}") && faults[2].path == ["program"], "{faults:?}");
        assert!(faults[1].path == ["args", "1"] && faults[1].message.contains("{param.k}"), "{faults:?}");
        assert_eq!(faults.len(), 3);
    }

    #[test]
    fn ports_follow_from_what_is_declared() {
        let with = serde_json::json!({
            "inputs": {"rows": {"kind": "table", "many": true}, "extra": {"kind": "mesh", "optional": true}},
            "outputs": {"plot": {"kind": "file", "extension": "svg"}, "table": "table"},
        });
        let ports = Command::ports(&with).unwrap();
        let told: Vec<_> = ports.inputs.iter().map(|port| (port.name, port.arity)).collect();
        assert_eq!(told, [("extra", Arity::Optional), ("rows", Arity::Many)]);
        assert_eq!((ports.outputs[0].extension, ports.outputs[1].kinds), (Some("svg"), &[Kind::Table][..]));
        let faults = Command::ports(&serde_json::json!({"outputs": {"a": "tabel"}})).unwrap_err();
        assert_eq!(faults[0].path, ["outputs", "a"]);
        assert!(Command::ports(&serde_json::json!({"outputs": {}})).is_err());
    }
}
