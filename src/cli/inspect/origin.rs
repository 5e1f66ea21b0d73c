//! From a file to its making: step, stage, parameters and record, the runs that have it, and the command that makes it again.

use std::path::{Path, PathBuf};

use rockface_cache::Digest;
use serde_json::{Value, json};

use super::super::export::provenance;
use super::super::init::for_shell;
use super::super::places::Places;
use super::Facts;
use rockface_engine::history::{PastRun, StepDone};

/// How many runs that have the same output are named.
const RUNS_NAMED: usize = 5;

/// An output in a run, or a further file made of it.
struct Found<'a> {
    run: &'a PastRun,
    done: &'a StepDone,
    port: &'a str,
}

/// What the runs here tell of the file with this digest; nothing where none of them has it.
pub fn of(path: &Path, digest: &Digest, bytes: &[u8], places: &Places) -> Facts {
    let stated = provenance::read(path, bytes);
    let original = stated.as_ref().and_then(|facts| facts["digest"].as_str()?.parse().ok());
    let record = stated.as_ref().and_then(|facts| facts["record"].as_str()?.parse::<Digest>().ok());
    let runs = runs(path, places);
    let wanted = original.as_ref().unwrap_or(digest);
    let mut by_digest = runs.iter().rev().filter_map(|run| by_digest(run, wanted, digest)).collect::<Vec<_>>();
    // Where several steps have the same output, the one that the file names, else that of the oldest run: others can only have read it since.
    let named = by_digest.iter().find(|found| record.is_some() && found.done.key == record);
    if let Some(maker) = named.or(by_digest.last()).map(|found| found.done.stage.clone()) {
        by_digest.retain(|found| found.done.stage == maker);
    }
    let beside = || runs.iter().find_map(|run| beside(run, path));
    match (by_digest.first(), by_digest.len()) {
        (Some(found), count) => {
            let names = by_digest.iter().take(RUNS_NAMED).map(|found| found.run.name.clone()).collect::<Vec<_>>();
            let more =
                if count > RUNS_NAMED { format!(", … and {} more", count - RUNS_NAMED) } else { String::new() };
            facts(found, "made by", format!("{}{more}", names.join(", ")))
        }
        (None, _) => match (beside(), stated) {
            (Some(found), _) => {
                let name = found.run.name.clone();
                facts(&found, "made of the output of", name)
            }
            (None, Some(stated)) => as_stated(&stated),
            (None, None) => Facts::new(),
        },
    }
}

/// What a file says itself where no run here has it.
fn as_stated(stated: &Value) -> Facts {
    let word = |name: &str| stated[name].as_str().unwrap_or_default().to_owned();
    vec![
        ("made by".into(), format!("step `{}`, port `{}`, as the file says", word("step"), word("port")).into()),
        ("stage".into(), stated["stage"].clone()),
        ("parameters".into(), stated["parameters"].clone()),
        ("digest".into(), stated["digest"].clone()),
        ("record".into(), stated["record"].clone()),
        ("pipeline".into(), stated["pipeline"].clone()),
        ("run".into(), stated["run"].clone()),
        ("program".into(), stated["program"].clone()),
        ("make again".into(), stated["command"].clone()),
    ]
}

/// The run whose folder the file is in, or else all runs that are found here, oldest first.
fn runs(path: &Path, places: &Places) -> Vec<PastRun> {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| PathBuf::from(path));
    let absolute = absolute.canonicalize().unwrap_or(absolute);
    let own = absolute.ancestors().find(|folder| folder.join("run.json").is_file());
    let own = own.and_then(|folder| PastRun::open(folder).ok());
    own.map_or_else(|| places.list().map(|(runs, _)| runs).unwrap_or_default(), |run| vec![run])
}

/// The step of a run that made the output `digest`. One that read the `file` itself did not make it, even if what it read is its output.
fn by_digest<'a>(run: &'a PastRun, digest: &Digest, file: &Digest) -> Option<Found<'a>> {
    let made = |done: &&StepDone| done.files.iter().all(|used| used.blake3 != *file);
    run.manifest.steps.iter().filter(made).find_map(|done| {
        let (port, _) = done.outputs.iter().flatten().find(|(_, output)| output.digest == *digest)?;
        Some(Found { run, done, port: port.as_str() })
    })
}

/// The output that a further file lies beside: `cloud.laz` beside `cloud.ply`, `pieces/7.ply` beside `pieces.ply`.
fn beside<'a>(run: &'a PastRun, path: &Path) -> Option<Found<'a>> {
    let path = path.canonicalize().ok()?;
    let relative = path.strip_prefix(run.folder.canonicalize().ok()?).ok()?.to_path_buf();
    run.manifest.steps.iter().find_map(|done| {
        let (port, _) = done.paths.iter().find(|(_, file)| {
            let stem = file.to_path_buf().with_extension("");
            relative.with_extension("") == stem || relative.starts_with(&stem)
        })?;
        Some(Found { run, done, port })
    })
}

fn facts(found: &Found, how: &str, runs: String) -> Facts {
    let Found { run, done, port } = found;
    let manifest = run.folder.join("run.json");
    let here = std::env::current_dir().ok();
    let manifest = here.and_then(|here| manifest.strip_prefix(here).ok().map(Path::to_path_buf)).unwrap_or(manifest);
    let key = done.key.map_or(Value::Null, |key| key.to_string().into());
    vec![
        (how.into(), format!("step `{}`, port `{port}`", done.label()).into()),
        ("stage".into(), format!("{} {}", done.stage, done.version).into()),
        ("parameters".into(), json!(*done.parameters)),
        ("record".into(), key),
        ("pipeline".into(), run.manifest.pipeline.name.clone().into()),
        ("runs".into(), runs.into()),
        ("program".into(), run.manifest.made_by().into()),
        ("make again".into(), format!("rockface run {} --target {}", for_shell(&manifest), done.step).into()),
    ]
}
