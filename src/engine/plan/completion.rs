//! Steps whose parameters are completed by what a file says that they name: done once, before names are resolved.

use std::cell::RefCell;
use std::collections::HashMap;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use rockface_cache::{Digest, Seen};
use rockface_core::params::Fault;
use rockface_core::{AnyStage, Found, Planner};
use serde_json::Value;

use super::Stages;
use super::parameters::{Place, told};
use crate::diagnostic::{Source, Span};
use crate::pipeline::{Base, Data, Key, Node, Pipeline, Step};

/// How long a program may think about a question.
const ANSWER_WITHIN: Duration = Duration::from_mins(1);
/// How often it is looked at whether it has answered.
const LOOK_EVERY: Duration = Duration::from_millis(2);
/// Lines of its last words that are reported.
const LAST_LINES: usize = 8;

/// A question: the program, its arguments and its input.
type Question = (PathBuf, Vec<String>, String);

/// Completes the parameters of all steps whose stages add to them. Faults become faults of the pipeline, which
/// [`super::resolve`] reports with all others. Where no program is to be started, each such step is a fault.
pub fn complete(pipeline: &mut Pipeline, stages: &Stages, no_programs: bool) {
    let answers = RefCell::default();
    let looks = RefCell::default();
    let mut faults = Vec::new();
    let completed: Vec<_> = stages.iter().filter(|stage| stage.is_completed()).collect();
    for step in &mut pipeline.document.steps {
        let stage = completed.iter().copied().find(|stage| stage.name() == step.stage.text);
        let Some(stage) = stage else { continue };
        let own = pipeline.sources.get(step.name.span.source).and_then(Source::folder);
        let base =
            Base::new(own.map_or_else(|| Arc::from(pipeline.folder.as_path()), Arc::clone), pipeline.copied.clone());
        let with = step.with.as_ref().map_or(Value::Null, |with| with.to_value());
        let asker = Asker { base, answers: &answers, looks: &looks };
        let added = if no_programs { Err(vec![refused(*stage)]) } else { stage.complete(&with, &asker) };
        match added {
            Ok(added) => add(step, added),
            Err(found) => {
                let place =
                    Place { step: &step.name.text, stage: *stage, with: step.with.as_deref(), span: step.name.span };
                faults.extend(found.into_iter().map(|fault| told(&place, &with, &fault)));
                // Its ports are not known: that is no further fault.
                step.gaps.with = true;
                step.gaps.any = true;
            }
        }
    }
    pipeline.faults.extend(faults);
    pipeline.looks.extend(looks.into_inner());
}

fn refused(stage: &dyn AnyStage) -> Fault {
    let name = stage.name();
    Fault::new(format!(
        "it starts a program (stage `{name}`), and none is to be started; leave out --no-commands (or ROCKFACE_NO_COMMANDS) \
         if you trust the pipeline"
    ))
}

/// Adds keys to the parameters of a step; those that are written give way.
fn add(step: &mut Step, added: serde_json::Map<String, Value>) {
    let span = step.with.as_ref().map_or(step.name.span, |with| with.span);
    let with = step.with.get_or_insert_with(|| Arc::new(Node::made(span, Data::Map(Vec::new()))));
    let Data::Map(entries) = &mut Arc::make_mut(with).data else { return };
    for (name, value) in added {
        let value = node(value, span);
        match entries.iter_mut().find(|(key, _)| key.name == name) {
            Some((_, known)) => *known = value,
            None => entries.push((Key { span, name }, value)),
        }
    }
}

/// A value that no text holds; all of it is placed where the parameters stand.
fn node(value: Value, span: Span) -> Node {
    let data = match value {
        Value::Array(items) => Data::List(items.into_iter().map(|item| node(item, span)).collect()),
        Value::Object(map) => {
            Data::Map(map.into_iter().map(|(name, value)| (Key { span, name }, node(value, span))).collect())
        }
        scalar => Data::Scalar(scalar),
    };
    Node::made(span, data)
}

/// Asks programs for the stages, each question once.
struct Asker<'a> {
    base: Base,
    answers: &'a RefCell<HashMap<Question, Result<String, String>>>,
    looks: &'a RefCell<Vec<(PathBuf, Seen)>>,
}

impl Planner for Asker<'_> {
    fn ask(&self, program: Found, args: &[&str], input: &str) -> Result<String, String> {
        let args: Vec<String> = args.iter().map(ToString::to_string).collect();
        let question = (find(program), args, input.to_owned());
        if let Some(known) = self.answers.borrow().get(&question) {
            return known.clone();
        }
        let answer = ask(&question);
        self.answers.borrow_mut().insert(question, answer.clone());
        answer
    }

    fn path(&self, written: &str) -> PathBuf {
        let path = self.base.path(written);
        std::path::absolute(&path).unwrap_or(path)
    }

    fn rests_on(&self, path: &Path) {
        let seen = if path.is_dir() {
            Seen::folder(path)
        } else {
            std::fs::read(path).map_or(Seen::NoFile, |bytes| Seen::File(Digest::of(&bytes)))
        };
        self.looks.borrow_mut().push((path.to_owned(), seen));
    }
}

/// The file of a program that is not part of a pipeline, or its name if the search path is to be asked.
pub fn find(program: Found) -> PathBuf {
    if let Some(named) = std::env::var_os(program.variable).filter(|named| !named.is_empty()) {
        return PathBuf::from(named);
    }
    let beside = std::env::current_exe().ok().map(|own| own.with_file_name(program.name));
    beside.filter(|path| path.is_file()).unwrap_or_else(|| PathBuf::from(program.name))
}

fn ask((program, args, input): &Question) -> Result<String, String> {
    let failed = |error: std::io::Error| format!("cannot run `{}`: {error}", program.display());
    let file = || tempfile::tempfile().map_err(failed);
    let (mut question, mut answer, mut said) = (file()?, file()?, file()?);
    question.write_all(input.as_bytes()).and_then(|()| question.rewind()).map_err(failed)?;
    // Where it runs decides what some programs load: never the folder of a pipeline.
    let mut child = Command::new(program)
        .args(args)
        .current_dir("/")
        .stdin(Stdio::from(question))
        .stdout(Stdio::from(answer.try_clone().map_err(failed)?))
        .stderr(Stdio::from(said.try_clone().map_err(failed)?))
        .spawn()
        .map_err(failed)?;
    let deadline = Instant::now() + ANSWER_WITHIN;
    let status = loop {
        match child.try_wait().map_err(failed)? {
            Some(status) => break status,
            None if Instant::now() > deadline => {
                // It may have ended meanwhile.
                let _ = child.kill();
                let _ = child.wait();
                return Err(format!("`{}` did not answer within {} s", program.display(), ANSWER_WITHIN.as_secs()));
            }
            None => std::thread::sleep(LOOK_EVERY),
        }
    };
    if status.success() { text(&mut answer).map_err(failed) } else { Err(last_words(program, &mut said)) }
}

fn text(file: &mut std::fs::File) -> std::io::Result<String> {
    let mut bytes = Vec::new();
    file.seek(SeekFrom::Start(0))?;
    file.read_to_end(&mut bytes)?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

fn last_words(program: &Path, said: &mut std::fs::File) -> String {
    let said = text(said).unwrap_or_default();
    let lines: Vec<&str> = said.trim_end().lines().collect();
    let last = lines[lines.len().saturating_sub(LAST_LINES)..].join("\n  ");
    format!("`{}` failed, saying\n  {last}", program.display())
}
