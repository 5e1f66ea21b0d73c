//! Running a plan and telling of it; what turns out to be damaged while the results are laid out is made again.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use rockface_cache::{Digest, Store, StoreError};

use super::{Finished, Options, RunError, RunFolder, Summary, execute, finish};
use crate::plan::Plan;
use crate::watch::{Event, Observer, Progress};

/// Runs a plan to its end and writes its folder.
///
/// # Errors
///
/// Those of [`execute`] and [`finish`]; a lost blob is one of them only when it was lost twice.
pub fn execute_and_tell(
    plan: &mut Plan,
    store: &Arc<Store>,
    options: &Options,
    stop: &Arc<AtomicBool>,
    observer: &mut dyn Observer,
    about: &RunFolder,
) -> Result<(Summary, Finished), RunError> {
    about.prepare()?;
    let mut summary = execute(plan, store, options, stop, observer)?;
    let mut lost = BTreeSet::new();
    loop {
        let error = match finish(plan, &summary, store, about, stop) {
            Ok(finished) => return Ok((summary, finished)),
            Err(error) => error,
        };
        let Some(digest) = lost_blob(&error).filter(|digest| lost.insert(*digest)) else { return Err(error) };
        // Told of here, with the name of the step.
        drop(store.take_damaged());
        warn(plan, &summary, &digest, &error, observer);
        summary = after(&summary, execute(plan, store, options, stop, observer)?);
    }
}

fn lost_blob(error: &RunError) -> Option<Digest> {
    match error {
        RunError::Store(StoreError::Damaged { digest, .. } | StoreError::Missing { digest }) => Some(*digest),
        _ => None,
    }
}

fn warn(plan: &Plan, summary: &Summary, digest: &Digest, error: &RunError, observer: &mut dyn Observer) {
    let total = summary.instances.len();
    for (instance, result) in summary.instances.iter().enumerate() {
        let Some(outcome) = &result.outcome else { continue };
        let port = outcome.outputs.iter().find(|(_, output)| output.digest == *digest).map(|(port, _)| port.as_str());
        let what = port.or((outcome.log == Some(*digest)).then_some("log"));
        let what = what.or((outcome.sketches == Some(*digest)).then_some("sketches"));
        if let Some(what) = what {
            let text = format!("its `{what}` has to be made again: {error}");
            let progress = Progress { done: total, total, remaining_s: None };
            observer.event(&Event::Warning { step: plan.label(instance), text }, progress);
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
