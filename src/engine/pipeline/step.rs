//! A step as it is written: its stage, parameters, inputs, axes, and how it is run.

use std::sync::Arc;
use std::time::Duration;

use serde_json::Value;

use super::input::Input;
use super::log_level::LogLevel;
use super::node::{Data, Key, Node, Word};
use super::reader::Reader;
use crate::diagnostic::Diagnostic;

/// The keys of a step.
pub const STEP: &[&str] =
    &["stage", "with", "in", "over", "keep", "stream", "timeout", "retries", "log", "title", "doc"];

/// A named use of a stage.
#[derive(Debug, Clone)]
pub struct Step {
    /// The name of the step, by which references and targets call it.
    pub name: Word,
    /// The stage it uses.
    pub stage: Word,
    /// Its parameters as written; `None` where it gives none.
    pub with: Option<Arc<Node>>,
    /// Where its inputs come from, by port.
    pub inputs: Vec<(Word, Input)>,
    /// Axes it depends on besides those that follow from its inputs and parameters.
    pub over: Vec<Word>,
    /// Whether its outputs are kept on disk.
    pub keep: bool,
    /// Narrows or shares its random stream.
    pub stream: Option<Stream>,
    /// How long one attempt may take.
    pub timeout: Option<Duration>,
    /// How often it is tried again after a failure.
    pub retries: u32,
    /// How much the log of a run shows of it.
    pub log: Option<LogLevel>,
    /// Its heading in reports.
    pub title: Option<String>,
    /// The sentence below its heading.
    pub doc: Option<String>,
    /// What could not be read of it.
    pub gaps: Gaps,
}

/// The parts of a step that failed to parse; already reported, so missing keys are not reported again.
#[derive(Debug, Clone, Copy, Default)]
pub struct Gaps {
    /// Whether its parameters could not be read.
    pub with: bool,
    /// Whether its inputs could not be read.
    pub inputs: bool,
    /// Any part of it.
    pub any: bool,
}

impl Step {
    /// Notes that none of it could be read whole.
    pub fn mark_gaps(&mut self) {
        self.gaps = Gaps { with: true, inputs: true, any: true };
    }
}

/// The random stream of a step.
#[derive(Debug, Clone)]
pub struct Stream {
    /// Takes the place of the step's name in the seed material.
    pub label: Option<Word>,
    /// The reseeding axes whose items count; `None`: all the step depends on.
    pub axes: Option<Vec<Word>>,
}

impl Reader<'_> {
    /// A step of its own.
    pub fn step(&mut self, name: Word, node: &mut Node) -> Option<Step> {
        let before = self.faults.len();
        let what = format!("step `{}`", name.text);
        if self.lacks_colon(&what, node) {
            return None;
        }
        self.map(node, &what, STEP)?;
        let strange_key = self.faults.len() > before;
        let stage = self.stage(&name, node);
        let bad_with = |with: &Node| {
            let bad_keys = !self.check_keys(with);
            self.any_map(with, "`with`").is_none() || bad_keys || self.bad_numbers && with.holds_bad_number()
        };
        let gap_in_with = node.get("with").map_or(strange_key, bad_with);
        let (inputs, gap_in_inputs) = node.get("in").map_or((Vec::new(), strange_key), |n| self.inputs(n));
        let over = node.get("over").map(|n| self.words(n, "an axis")).unwrap_or_default();
        let keep = self.flag(node.get("keep"), true);
        let stream = node.get("stream").and_then(|n| self.stream(n));
        let timeout = node.get("timeout").and_then(|n| self.duration(n));
        let retries = node.get("retries").map_or(0, |n| self.retries(n));
        let log = node.get("log").and_then(|n| self.log_level(n));
        let title = node.get("title").and_then(|n| self.sentence(n, "title"));
        let doc = node.get("doc").and_then(|n| self.sentence(n, "doc"));
        let with = node.take("with").filter(|with| with.entries().is_some()).map(Arc::new);
        let any = gap_in_with || gap_in_inputs || self.faults.len() > before;
        let gaps = Gaps { with: gap_in_with, inputs: gap_in_inputs, any };
        Some(Step { name, stage: stage?, with, inputs, over, keep, stream, timeout, retries, log, title, doc, gaps })
    }

    /// Reports a key such as `stage rasterise-dem`, which is `stage: rasterise-dem` without its colon.
    fn lacks_colon(&mut self, what: &str, node: &Node) -> bool {
        let split = |(key, _): &(Key, Node)| {
            let (word, rest) = key.name.split_once(' ')?;
            STEP.contains(&word).then(|| (key.span, word.to_owned(), rest.trim().to_owned()))
        };
        let Some((span, word, rest)) = node.entries().and_then(|entries| entries.iter().find_map(split)) else {
            return false;
        };
        let fault = Diagnostic::at(span, format!("a colon is missing after `{word}` in {what}"));
        self.fault(fault.hint(format!("write `{word}: {rest}`")));
        true
    }

    fn stage(&mut self, name: &Word, node: &Node) -> Option<Word> {
        let Some(stage) = node.get("stage") else {
            let fault = Diagnostic::at(name.span, format!("step `{}` names no `stage`", name.text));
            self.fault(fault.hint("`rockface stages` lists them; a step that stands for a part says `use`"));
            return None;
        };
        self.word(stage, "the name of a stage")
    }

    /// The inputs of a step, and whether some could not be read.
    pub fn inputs(&mut self, node: &Node) -> (Vec<(Word, Input)>, bool) {
        if let Data::Scalar(Value::String(output)) = &node.data {
            let fault = Diagnostic::at(node.span, format!("`in` does not say which port reads `{output}`"));
            self.fault(
                fault
                    .hint(format!("write `in: {{PORT: {output}}}`; `rockface stages NAME` lists the ports of a stage")),
            );
            return (Vec::new(), true);
        }
        let Some(entries) = self.any_map(node, "`in`") else { return (Vec::new(), true) };
        let mut inputs = Vec::with_capacity(entries.len());
        for (key, node) in entries {
            inputs.extend(self.input(node).map(|input| (Word { span: key.span, text: key.name.clone() }, input)));
        }
        let gap = inputs.len() < entries.len();
        (inputs, gap)
    }

    /// How much a log shows.
    pub fn log_level(&mut self, node: &Node) -> Option<LogLevel> {
        let level = node.text().and_then(LogLevel::of_word);
        if level.is_none() {
            self.expected(node, "full, brief or none");
        }
        level
    }

    fn duration(&mut self, node: &Node) -> Option<Duration> {
        let text = node.text().map(humantime::parse_duration);
        match text {
            Some(Ok(duration)) if !duration.is_zero() => return Some(duration),
            _ => self.expected(node, "a time with its unit, such as 90s, 15min or 2h"),
        }
        None
    }

    fn retries(&mut self, node: &Node) -> u32 {
        let count = node.to_value().as_u64().filter(|count| *count <= 100);
        if count.is_none() {
            self.expected(node, "a count of retries from 0 to 100");
        }
        count.unwrap_or(0) as u32
    }

    fn stream(&mut self, node: &Node) -> Option<Stream> {
        self.map(node, "`stream`", &["label", "axes"])?;
        let said = |key| node.get(key).filter(|n| !matches!(n.data, Data::Scalar(Value::Null)));
        let label = said("label").and_then(|n| self.word(n, "a label"));
        let axes = said("axes").map(|n| self.words(n, "an axis"));
        Some(Stream { label, axes })
    }
}
