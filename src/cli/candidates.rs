//! What the shell offers for the word that is being typed: pipelines, steps, stages, parts, runs and outputs.

use std::ffi::{OsStr, OsString};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use clap::CommandFactory;
use clap_complete::engine::{ArgValueCompleter, CompletionCandidate, PathCompleter, ValueCompleter};
use clap_complete::env::{self, CompleteEnv, EnvCompleter, Shells};
use rockface_core::{PartText, Registry};

use super::places::Places;
use super::shipped::Shipped;
use super::{Cli, CliError};
use rockface_engine::diagnostic::printable;
use rockface_engine::pipeline::{Overrides, Pipeline};

/// The variable by which the shell asks for candidates.
const VARIABLE: &str = "ROCKFACE_COMPLETE";
/// The name of the program in the shell.
const PROGRAM: &str = "rockface";

/// What the program that asks is made of: stages with their first sentences, and parts.
struct Known {
    stages: Vec<(&'static str, &'static str)>,
    parts: &'static [PartText],
}

static KNOWN: OnceLock<Known> = OnceLock::new();

/// Answers a shell that asks for candidates; `false` where nobody does.
pub fn answer(registry: &Registry) -> bool {
    if std::env::var_os(VARIABLE).is_none() {
        return false;
    }
    let first = |text: &'static str| text.split_inclusive(". ").next().unwrap_or(text).trim();
    let stages = registry.stages().iter().map(|stage| (stage.name(), first(stage.page().what()))).collect();
    let _ = KNOWN.set(Known { stages, parts: registry.parts() });
    let here = std::env::current_dir().ok();
    let environment = CompleteEnv::with_factory(Cli::command).var(VARIABLE).shells(SHELLS);
    // A shell has no use for a message while somebody types: no candidates then.
    environment.try_complete(std::env::args_os(), here.as_deref()).unwrap_or(true)
}

/// The script by which a shell learns to ask; `None` for a shell that is not known.
pub fn script(shell: &str) -> Option<Vec<u8>> {
    let shells = Shells::builtins();
    let mut script = Vec::new();
    shells.completer(shell)?.write_registration(VARIABLE, PROGRAM, PROGRAM, PROGRAM, &mut script).ok()?;
    Some(script)
}

/// The shells that are answered.
const SHELLS: Shells = Shells(&[&Bash, &env::Elvish, &env::Fish, &env::Powershell, &env::Zsh]);

/// Bash, which puts what is offered into the line as it is, names of files too; the other shells quote it. What is no word as
/// it is has to be typed.
struct Bash;

impl EnvCompleter for Bash {
    fn name(&self) -> &'static str {
        env::Bash.name()
    }
    fn is(&self, name: &str) -> bool {
        env::Bash.is(name)
    }
    fn write_registration(
        &self,
        variable: &str,
        name: &str,
        program: &str,
        completer: &str,
        to: &mut dyn Write,
    ) -> io::Result<()> {
        env::Bash.write_registration(variable, name, program, completer, to)
    }
    fn write_complete(
        &self,
        command: &mut clap::Command,
        words: Vec<OsString>,
        here: Option<&Path>,
        to: &mut dyn Write,
    ) -> io::Result<()> {
        let mut offered = Vec::new();
        env::Bash.write_complete(command, words, here, &mut offered)?;
        let separator = std::env::var("_CLAP_IFS").unwrap_or_else(|_| "\n".to_owned());
        let offered = String::from_utf8_lossy(&offered);
        // An option, and a value after it, may be one word.
        let kept = offered.split(&separator).filter(|word| is_word(word.trim_start_matches('-')));
        to.write_all(kept.collect::<Vec<_>>().join(&separator).as_bytes())
    }
}

/// Whether a text is one word of a command line, as it is, to every shell: names of runs, steps and files may come from strangers,
/// and nobody looks at a word that the shell completes.
fn is_word(text: &str) -> bool {
    let is_plain = |letter: char| letter.is_alphanumeric() || "-_./=,:+%@".contains(letter);
    let are_plain = |text: &str| text.chars().all(is_plain);
    let text = text.strip_prefix("~/").unwrap_or(text);
    // Some shells take these for something else where a word begins with them.
    if text.starts_with(['=', '%', ':', '@', '+', ',']) {
        return false;
    }
    // To shells, brackets are a pattern for names of files: what it stands for may be no further command either.
    match text.split_once('[') {
        None => are_plain(text),
        Some((step, rest)) => rest.split_once(']').is_some_and(|(items, port)| {
            let is_port = port.is_empty() || (port.starts_with('.') && !port.contains('/'));
            is_port && [step, items, port].into_iter().all(are_plain)
        }),
    }
}

/// Those of these names that begin with what is typed, and are words that do nothing.
fn fitting<'a>(current: &OsStr, names: impl IntoIterator<Item = (&'a str, &'a str)>) -> Vec<CompletionCandidate> {
    let typed = current.to_string_lossy();
    let fits = |name: &str| name.starts_with(&*typed) && is_word(name) && !name.starts_with('-');
    let fits = names.into_iter().filter(|(name, _)| fits(name));
    let candidate = |(name, help): (&str, &str)| {
        let help = (!help.is_empty()).then(|| printable(help).replace(['\n', '\t'], " ").into());
        CompletionCandidate::new(name).help(help)
    };
    fits.map(candidate).collect()
}

fn plain<'a>(current: &OsStr, names: impl IntoIterator<Item = &'a String>) -> Vec<CompletionCandidate> {
    fitting(current, names.into_iter().map(|name| (name.as_str(), "")))
}

/// The words of the line, without the program and the word that is being typed.
fn words() -> Vec<String> {
    let mut words = std::env::args_os().skip_while(|word| word != "--").skip(2);
    let words: Vec<String> = words.by_ref().map(|word| word.to_string_lossy().into_owned()).collect();
    words
}

/// Names of stages.
pub fn stages() -> ArgValueCompleter {
    let stages = |current: &OsStr| {
        let known = KNOWN.get().map(|known| known.stages.as_slice()).unwrap_or_default();
        fitting(current, known.iter().copied())
    };
    ArgValueCompleter::new(stages)
}

/// Parts that come with the program.
pub fn parts() -> ArgValueCompleter {
    let parts = |current: &OsStr| {
        let known = KNOWN.get().map(|known| known.parts).unwrap_or_default();
        fitting(current, known.iter().map(|part| (part.name, "")))
    };
    ArgValueCompleter::new(parts)
}

/// Pipelines that ship with the program.
pub fn shipped() -> ArgValueCompleter {
    ArgValueCompleter::new(|current: &OsStr| fitting(current, Shipped::names().map(|name| (name, ""))))
}

fn is_pipeline(path: &Path) -> bool {
    let extension = path.extension().and_then(OsStr::to_str);
    path.is_dir() || matches!(extension, Some("yaml" | "yml")) || path.ends_with("run.json")
}

/// Pipelines: those that ship with the program, and files.
pub fn pipelines() -> ArgValueCompleter {
    let pipelines = |current: &OsStr| {
        let mut found = PathCompleter::any().filter(is_pipeline).complete(current);
        found.extend(fitting(current, Shipped::names().map(|name| (name, "ships with rockface"))));
        found
    };
    ArgValueCompleter::new(pipelines)
}

/// The pipeline on the line.
fn pipeline_on_line() -> Option<Pipeline> {
    let parts = KNOWN.get().map(|known| known.parts).unwrap_or_default();
    let overrides = Overrides { parts, ..Overrides::default() };
    words().into_iter().find_map(|word| {
        if let Ok(shipped) = Shipped::find(&word) {
            return shipped.pipeline(&overrides).ok();
        }
        let path = PathBuf::from(word);
        let is_file = path.is_file() && path.extension().is_some_and(|extension| extension != "json");
        is_file.then(|| Pipeline::load(&path, &overrides, None).ok()).flatten()
    })
}

/// Steps of the pipeline on the line, and its uses of parts.
pub fn steps() -> ArgValueCompleter {
    let steps = |current: &OsStr| {
        let Some(pipeline) = pipeline_on_line() else { return Vec::new() };
        let uses = pipeline.document.steps.iter().filter_map(|step| step.name.text.rsplit_once('/'));
        let mut uses: Vec<String> = uses.map(|(user, _)| user.to_owned()).collect();
        uses.dedup();
        let names = pipeline.document.steps.iter().map(|step| (step.name.text.as_str(), step.stage.text.as_str()));
        fitting(current, names.chain(uses.iter().map(|user| (user.as_str(), "a part"))))
    };
    ArgValueCompleter::new(steps)
}

/// Runs that are found from here, and what stands for one.
pub fn runs() -> ArgValueCompleter {
    let runs = |current: &OsStr| {
        let Ok((runs, _)) = Places::default().list() else { return Vec::new() };
        let mut names: Vec<String> = runs.iter().map(|run| run.manifest.pipeline.name.clone()).collect();
        names.sort();
        names.dedup();
        let latest = (!runs.is_empty()).then(|| "latest".to_owned());
        let of_runs = runs.iter().rev().map(|run| run.name.clone());
        let all: Vec<String> = latest.into_iter().chain(names).chain(of_runs).collect();
        plain(current, &all)
    };
    ArgValueCompleter::new(runs)
}

/// Outputs of the run on the line.
pub fn outputs() -> ArgValueCompleter {
    let outputs = |current: &OsStr| {
        let named = words().into_iter().skip_while(|word| word != "export").skip(1).find(|word| !word.starts_with('-'));
        let Some(Ok(run)) = named.map(|name| -> Result<_, CliError> { Places::default().find(&name) }) else {
            return Vec::new();
        };
        let steps = run.manifest.steps.iter();
        let names = steps.flat_map(|done| {
            done.outputs.iter().flatten().map(move |(port, _)| format!("{}.{port}", done.label())).collect::<Vec<_>>()
        });
        let parts = run.manifest.parts.iter();
        let parts = parts.flat_map(|used| used.outputs.keys().map(|output| format!("{}.{output}", used.name)));
        plain(current, &names.chain(parts).collect::<Vec<_>>())
    };
    ArgValueCompleter::new(outputs)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_words_that_do_nothing_are_offered() {
        for word in
            ["latest", "2026-11-30T124902Z-t-8543de27", "before/noisy.raster", "wände_2.yaml", "~/a/b.yaml", "../a", ""]
        {
            assert!(is_word(word), "{word}");
        }
        for word in ["dem[cell=0.05].raster", "dem[cell=0.05,trial=-1]"] {
            assert!(is_word(word), "{word}");
        }
        for sign in " \t\n\r\u{1b}\u{7}\u{9b}\u{a0}\u{202e}\"#$&'()*;<>?\\^`{|}!~".chars() {
            assert!(!is_word(&format!("x{sign}y")), "{sign:?}");
        }
        for word in ["=ls", "%1", "~root", "x[%-=]reboot", "x[%-=]./evil", "x[a", "x]", "x[a[b]", "x[;].y"] {
            assert!(!is_word(word), "{word}");
        }
        let offered = fitting(OsStr::new(""), [("a", "b\u{1b}[2J\nc"), ("-rf", ""), ("x$(y)", "")]);
        assert_eq!(offered, [CompletionCandidate::new("a").help(Some("b\\u{1b}[2J c".into()))]);
    }
}
