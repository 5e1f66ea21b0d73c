//! `python`: calls a Python function over typed inputs and outputs, in a process that stays alive for the whole run.

mod describe;
mod exchange;
mod types;

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::Deserialize;
use serde_json::{Map, Value, json};

use super::declared::{self, Declared};
use rockface_core::artefact::Artefact;
use rockface_core::params::{Fault, FileRef};
use rockface_core::program::{Found, Job, JobResult, Piece, Program, ended};
use rockface_core::{Arity, Context, Entry, Inputs, Outputs, Page, Planner, Port, Ports, Stage, StageError, params};

params! {
    /// Parameters of `python`.
    pub struct PythonParams {
        /// The Python file with the function.
        module: FileRef,
        /// The function, decorated with `@rockface.stage`.
        function: String,
        /// Values of its parameters; those left out have the default of the function.
        params: BTreeMap<String, Value> = BTreeMap::new(),
        /// Files for its parameters of type `Path`; their content is part of what a result is known by.
        files: BTreeMap<String, FileRef> = BTreeMap::new(),
        /// Environment variables handed on from outside; for what does not change results, such as a number of threads.
        inherit: Vec<String> = Vec::new(),
        /// Input ports. They follow from the function; what is written here must agree with it.
        inputs: BTreeMap<String, Declared> = BTreeMap::new(),
        /// Output ports. They follow from the function; what is written here must agree with it.
        outputs: BTreeMap<String, Declared> = BTreeMap::new(),
        /// Python files that the module imports and that are in no installed package. They follow from the module.
        sources: BTreeMap<String, FileRef> = BTreeMap::new(),
        /// Versions of Python and of the packages that the module imports. They follow from the module.
        packages: BTreeMap<String, String> = BTreeMap::new(),
        /// Types, defaults and ranges of the function's parameters. They follow from the function.
        types: BTreeMap<String, Value> = BTreeMap::new(),
        /// Whether it draws random numbers. It follows from the function.
        draws: bool = false,
    }
}

/// The interpreter: that of the environment rockface is installed in or is called from.
const INTERPRETER: Found = Found { variable: "ROCKFACE_PYTHON", name: "python3" };

/// Variables that decide which interpreter is found, and which packages it finds.
const VARIABLES: [&str; 4] = [INTERPRETER.variable, "PYTHONPATH", "VIRTUAL_ENV", "CONDA_PREFIX"];

/// Calls a function of a Python file over typed inputs and outputs: your own noise, detector or figure as a cached
/// step.
pub struct Python;

impl Stage for Python {
    type Params = PythonParams;
    const NAME: &'static str = "python";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("python.md"));
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[];
    const STARTS_PROGRAMS: bool = true;
    const IS_COMPLETED: bool = true;
    const VARIABLES: &'static [&'static str] = &VARIABLES;

    fn complete(with: &Value, planner: &dyn Planner) -> Result<Map<String, Value>, Vec<Fault>> {
        describe::complete(with, planner)
    }

    fn ports(with: &Value) -> Result<Ports, Vec<Fault>> {
        declared::ports(with, "the function has no output: say what it returns, for example `-> rockface.Raster`")
    }

    fn draws(params: &PythonParams) -> bool {
        params.draws
    }

    fn check(params: &PythonParams) -> Vec<Fault> {
        types::check(params)
    }

    fn run(params: &PythonParams, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let ports = declared::ports_of(&params.inputs, &params.outputs);
        let done = context.employ(&job(params, inputs, context)?)?;
        ended::tell(context, &done.result);
        answered(params, &done, context)?;
        ports.outputs.iter().try_fold(Outputs::default(), |outputs, port| {
            Ok(outputs.and(port.name, output(port.name, &params.outputs[port.name], &done)?))
        })
    }
}

fn job(params: &PythonParams, inputs: &Inputs, context: &Context) -> Result<Job, StageError> {
    let (given, files) = given(params, inputs)?;
    let made = params
        .outputs
        .iter()
        .map(|(port, declared)| json!({ "port": port, "kind": declared.kind.word(), "place": place("out", port) }));
    let request = json!({
        "function": params.function,
        "params": params.params,
        "types": params.types,
        "inputs": given,
        "outputs": made.collect::<Vec<_>>(),
        "stream": params.draws.then(|| context.stream_digits("python", "")),
        "sources": params.sources.keys().collect::<Vec<_>>(),
    });
    let file = |(name, file): (&String, &FileRef)| (name.clone(), Piece::File(file.0.clone()));
    let sources = params.sources.iter().map(file).map(|(name, piece)| (format!("source {name}"), piece));
    let own = params.files.iter().map(file).map(|(name, piece)| (format!("file {name}"), piece));
    let module = [("module".to_owned(), Piece::File(params.module.0.clone()))];
    Ok(Job {
        program: program(params),
        request,
        paths: module.into_iter().chain(sources).chain(own).collect(),
        inputs: files,
        outputs: params.outputs.keys().map(|port| place("out", port)).collect(),
    })
}

/// One process for all functions of a module: modules of other folders may have helpers of the same names.
fn program(params: &PythonParams) -> Program {
    let text = |text: &str| vec![Piece::Text(text.to_owned())];
    let fixed = [("PYTHONHASHSEED", "0"), ("PYTHONDONTWRITEBYTECODE", "1"), ("PYTHONUNBUFFERED", "1")];
    Program {
        program: vec![Piece::Found(INTERPRETER)],
        args: vec![text("-m"), text("rockface._worker"), vec![Piece::File(params.module.0.clone())]],
        environment: fixed.map(|(name, value)| (name.to_owned(), value.to_owned())).into(),
        inherit: VARIABLES[1..].iter().map(ToString::to_string).chain(params.inherit.iter().cloned()).collect(),
        inputs: Vec::new(),
        outputs: Vec::new(),
    }
}

fn place(side: &str, port: &str) -> String {
    format!("{side}/{port}")
}

/// Files of the exchange, by place.
type Exchanged = Vec<(String, Vec<u8>)>;

/// What the function is told of its inputs, and their files.
fn given(params: &PythonParams, inputs: &Inputs) -> Result<(Vec<Value>, Exchanged), StageError> {
    let (mut told, mut files) = (Vec::new(), Vec::new());
    for (port, declared) in &params.inputs {
        let mut elements = Vec::new();
        for (number, element) in inputs.elements(port).iter().enumerate() {
            let place = format!("in/{port}-{number:06}");
            files.push((place.clone(), exchange::write(port, element.artefact()?)?));
            elements.push(json!({ "place": place, "point": element.point }));
        }
        let many = declared.arity == Arity::Many;
        told.push(json!({ "port": port, "kind": declared.kind.word(), "many": many, "elements": elements }));
    }
    Ok((told, files))
}

/// What the worker answers.
#[derive(Deserialize, Default)]
struct Answer {
    /// What the function logged.
    #[serde(default)]
    log: Vec<Entry>,
    /// Why the function failed; `None` where it is done.
    error: Option<Failure>,
}

#[derive(Deserialize)]
struct Failure {
    message: String,
    #[serde(default)]
    traceback: Vec<String>,
    hint: Option<String>,
}

/// Keeps what the function logged, and refuses any answer but that it is done.
fn answered(params: &PythonParams, done: &JobResult, context: &Context) -> Result<(), StageError> {
    let function = &params.function;
    let Some(answer) = &done.answer else { return Err(died(function, done)) };
    let answer: Answer = serde_json::from_value(answer.clone())
        .map_err(|error| StageError::new(format!("the worker of `{function}` gave no proper answer: {error}")))?;
    answer.log.into_iter().for_each(|entry| context.record(entry));
    let Some(failure) = answer.error else { return Ok(()) };
    let mut message = format!("`{function}`: {}", failure.message);
    for line in &failure.traceback {
        let _ = write!(message, "\n  {line}");
    }
    let error = StageError::new(message);
    Err(failure.hint.into_iter().fold(error, StageError::hint))
}

/// The process ended in the middle of the function.
fn died(function: &str, done: &JobResult) -> StageError {
    if done.result.stderr.contains("No module named rockface") {
        let error = StageError::new("this Python has no package `rockface`");
        return error
            .hint("install it there (`pip install .` in a clone, or a wheel), or name another one in ROCKFACE_PYTHON");
    }
    let error = ended::ended(function, &done.result);
    let message = format!("the Python process ended in the middle of the function: {}", error.message);
    StageError::new(message).hint("the stack of Python at that point is in the message, as far as it could be written")
}

fn output(port: &str, declared: &Declared, done: &JobResult) -> Result<Artefact, StageError> {
    let bytes = done.result.outputs.get(&place("out", port));
    let bytes = bytes.ok_or_else(|| StageError::new(format!("the worker made no output `{port}`")))?;
    exchange::read(declared.kind, bytes)
        .map_err(|error| StageError::new(format!("output `{port}` is no {} that can be kept: {error}", declared.kind)))
}

#[cfg(test)]
mod tests;
