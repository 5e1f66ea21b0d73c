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
