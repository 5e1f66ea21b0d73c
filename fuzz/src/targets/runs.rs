//! What a run folder tells: its manifest and the logs of its steps.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use rockface::report::{self, Links, Source};
use rockface_cache::Store;
use rockface_core::Entry;
use rockface_engine::history::{Contents, PastRun, RunContents, archive, compare, crate_metadata};

use super::Verdict;

/// What a step said.
pub fn step_log(bytes: &[u8]) -> Verdict {
    let Ok(entries) = serde_json::from_slice::<Vec<Entry>>(bytes) else { return Verdict::Refused };
    let text = serde_json::to_vec(&entries);
    Verdict::of(text.is_ok_and(|text| serde_json::from_slice::<Vec<Entry>>(&text).is_ok()))
}

/// A manifest: written again, compared, reported, described and archived.
pub fn manifest(bytes: &[u8]) -> Verdict {
    let Ok(folder) = tempfile::tempdir() else { return Verdict::Refused };
    let run = folder.path().join("run");
    let put = std::fs::create_dir(&run).and_then(|()| std::fs::write(run.join("run.json"), bytes));
    match put.ok().and_then(|()| PastRun::open(&run).ok()) {
        Some(past) => {
            told(&past, folder.path());
            Verdict::Accepted
        }
        None => Verdict::Refused,
    }
}

fn told(past: &PastRun, folder: &Path) {
    let mut text = Vec::new();
    past.manifest.clone().write(&mut text).expect("memory takes all that is written");
    let again = folder.join("again.json");
    if std::fs::write(&again, &text).is_ok() {
        let read = rockface_engine::history::Manifest::read(&again).expect("what was written can be read");
        assert_eq!(read, past.manifest, "a manifest comes back as it was");
    }
    let comparison = compare(&[past.clone(), past.clone()]);
    assert!(comparison.parameters.is_empty(), "a run does not differ from itself");
    let _ = (past.manifest.counts(), past.manifest.failures().count());
    drop(crate_metadata(&past.folder, &past.manifest));
    let run = RunContents { folder: &past.folder, manifest: &past.manifest, store: None, graph: None, logs: None };
    let look = rockface_stages::registry().look();
    let source = Source { run, look };
    for links in [Links::Relative, Links::Absolute] {
        report::html(&source, links).expect("the template fits every manifest");
    }
    if let Ok(store) = Store::open(&folder.join("store")) {
        // Paths that fit into no archive are refused.
        let contents = Contents { inputs: true, outputs: true };
        drop(archive(past, &store, contents, &folder.join("run.tar"), &AtomicBool::new(false)));
    }
}
