//! Runs a plan and writes its folder; results that turn out to be damaged while they are laid out are recomputed.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use rockface_cache::{Digest, Outcome, Store, StoreError};

use crate::plan::Plan;
use crate::run::{Finished, Options, RunError, RunFolder, Summary, finish, scheduler, tools};
use crate::watch::{Event, Observer, Progress};

/// Runs a plan to its end and writes its folder.
///
/// # Errors
///
/// Those of [`crate::run::execute`] and [`finish`]; a lost blob is one of them only when it was lost twice.
pub fn execute_and_tell(
    plan: &mut Plan,
    store: &Arc<Store>,
    options: &Options,
    stop: &Arc<AtomicBool>,
    observer: &mut dyn Observer,
    about: &RunFolder,
) -> Result<(Summary, Finished), RunError> {
    about.prepare()?;
    let mut summary = scheduler::run(plan, store, options, stop, observer)?;
    let changed = tools::behind(plan, store, summary.keys()).changed;
    changed.into_iter().for_each(|(step, text)| warn(&summary, step, text, observer));
    let mut lost = BTreeSet::new();
    loop {
        let error = match finish(plan, &summary, store, about, &lost, stop) {
            Ok(finished) => {
                store.adopt(summary.keys().map(|(_, key)| key))?;
                return Ok((summary, finished));
            }
            Err(error) => error,
        };
        let Some((digest, why)) = lost_blob(&error).filter(|(digest, _)| lost.insert(*digest)) else {
            return Err(error);
        };
        warn_lost(plan, &summary, &digest, &why, observer);
        // Where one blob is damaged others may be: all are looked through now, not one a go.
        let blobs = summary.instances.iter().filter_map(|result| result.outcome.as_ref()).flat_map(Outcome::blobs);
        for damage in store.scrub(blobs.map(|(digest, _)| digest))? {
            let told = StoreError::Damaged { digest: damage.digest, moved_to: damage.moved_to }.of_recomputed();
            warn_lost(plan, &summary, &damage.digest, &told, observer);
        }
        // Reported here, with the name of the step.
        drop(store.take_damaged());
        summary = after(&summary, scheduler::run(plan, store, options, stop, observer)?);
    }
}

/// The blob for which a folder could not be written, and what happened to it.
fn lost_blob(error: &RunError) -> Option<(Digest, String)> {
    match error {
        RunError::Store(fault @ (StoreError::Damaged { digest, .. } | StoreError::Missing { digest })) => {
            Some((*digest, fault.of_recomputed()))
        }
        _ => None,
    }
}

fn warn(summary: &Summary, step: String, text: String, observer: &mut dyn Observer) {
    let total = summary.instances.len();
    observer.event(&Event::Warning { step, text }, Progress { done: total, total, remaining_s: None });
}

fn warn_lost(plan: &Plan, summary: &Summary, digest: &Digest, why: &str, observer: &mut dyn Observer) {
    for (instance, result) in summary.instances.iter().enumerate() {
        let Some(outcome) = &result.outcome else { continue };
        let port = outcome.outputs.iter().find(|(_, output)| output.digest == *digest).map(|(port, _)| port.as_str());
        let what = port.or((outcome.log == Some(*digest)).then_some("log"));
        let what = what.or((outcome.sketches == Some(*digest)).then_some("sketches"));
        if let Some(what) = what {
            let text = format!("its `{what}` has to be recomputed: {why}");
            warn(summary, plan.label(instance), text, observer);
        }
    }
}

/// A run that took two goes, as one.
fn after(first: &Summary, mut second: Summary) -> Summary {
    for (before, now) in first.instances.iter().zip(&mut second.instances) {
        now.executed |= before.executed;
    }
    second.wall_s += first.wall_s;
    second
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::history::RunContents;
    use crate::pipeline::{Overrides, Pipeline};
    use crate::plan::plan;
    use crate::run::{LayOut, Reporter};
    use std::os::unix::fs::PermissionsExt;
    use std::path::Path;

    #[derive(Debug)]
    struct NoPage;

    impl Reporter for NoPage {
        fn report(&self, _: &RunContents, _: &Path) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[derive(Default)]
    struct Warned(Vec<String>);

    impl Observer for Warned {
        fn event(&mut self, event: &Event, _: Progress) {
            if let Event::Warning { step, text } = event {
                self.0.push(format!("{step}: {text}"));
            }
        }
    }

    /// A run of a pipeline in a folder; with what it warned of.
    fn ran(home: &Path, text: &str) -> (Summary, Vec<String>) {
        let store = Arc::new(Store::open(&home.join("store")).unwrap());
        let overrides = Overrides::default();
        let pipeline = Pipeline::parse(text, "p.yaml", "p", home.to_owned(), &overrides).unwrap();
        let registry = rockface_stages::registry();
        let mut plan = plan(&pipeline, &[], registry.stages(), &store).unwrap_or_else(|told| panic!("{told}"));
        let options = Options { jobs: 1, look: registry.look(), ..Options::default() };
        let (runs, path) = (home.join("runs"), home.join("p.yaml"));
        let about = RunFolder {
            runs: &runs,
            pipeline_path: &path,
            pipeline: &pipeline,
            overrides: &overrides,
            targets: &[],
            jobs: 1,
            lay_out: LayOut::default(),
            look: registry.look(),
            reporter: &NoPage,
        };
        let (stop, mut warned) = (Arc::default(), Warned::default());
        let (summary, _) = execute_and_tell(&mut plan, &store, &options, &stop, &mut warned, &about).unwrap();
        (summary, warned.0)
    }

    /// Flips a bit of what is stored where these bytes are, as a failing disk does: times stay. Says how often they were found.
    fn damage(folder: &Path, needle: &[u8]) -> usize {
        let mut found = 0;
        for entry in std::fs::read_dir(folder).unwrap().map(Result::unwrap) {
            if entry.path().is_dir() {
                found += damage(&entry.path(), needle);
                continue;
            }
            let mut bytes = std::fs::read(entry.path()).unwrap();
            if let Some(at) = bytes.windows(needle.len()).position(|window| window == needle) {
                bytes[at] ^= 1;
                let modified = entry.metadata().unwrap().modified().unwrap();
                std::fs::set_permissions(entry.path(), std::fs::Permissions::from_mode(0o644)).unwrap();
                std::fs::write(entry.path(), bytes).unwrap();
                std::fs::File::options().append(true).open(entry.path()).unwrap().set_modified(modified).unwrap();
                found += 1;
            }
        }
        found
    }

    #[test]
    fn damaged_sketches_are_recomputed_with_their_step_and_a_warning() {
        let home = tempfile::tempdir().unwrap();
        let text =
            "rockface: 1\nsteps:\n  face: {stage: synthesise-face, with: {width_m: 1, height_m: 1, spacing_m: 0.1}}\n";
        let (first, warned) = ran(home.path(), text);
        let sketches = first.instances[0].outcome.as_ref().unwrap().sketches.unwrap();
        assert!(first.executed() == 1 && warned.is_empty(), "{warned:?}");
        let bytes = Store::open(&home.path().join("store")).unwrap().get(&sketches).unwrap();
        let middle = &bytes[bytes.len() / 2..][..32.min(bytes.len() / 2)];
        assert_eq!(damage(&home.path().join("store"), middle), 1);
        let (second, warned) = ran(home.path(), &format!("{text}# another text\n"));
        assert!(warned.len() == 1 && warned[0].contains("face: its `sketches` has to be recomputed"), "{warned:?}");
        assert_eq!((second.executed(), second.instances[0].outcome.as_ref().unwrap().sketches), (1, Some(sketches)));
        assert_eq!(Store::open(&home.path().join("store")).unwrap().get(&sketches).unwrap(), bytes);
    }
}
