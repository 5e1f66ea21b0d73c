//! The bytes every stage makes on a small scene, pinned: who changes them raises the stage's VERSION.
//!
//! `ROCKFACE_BLESS=1 cargo test --test house golden` writes the list anew. Digests are those of one processor family
//! (`x86_64`); elsewhere the last digits of eigenvectors may differ, and the test says that it was skipped.

use std::collections::BTreeSet;
use std::path::Path;

use crate::lab::Bench;

const SCENE: &str = include_str!("golden.yaml");
const LIST: &str = "tests/house/golden.txt";

/// Stages that need files or programs; what they read is pinned by tests of their own.
const NEED_FILES: [&str; 10] = [
    "import-mesh",
    "import-cloud",
    "import-cameras",
    "import-rasters",
    "import-inventory",
    "command",
    "fuse-colmap",
    "import-blocks",
    "import-table",
    "python",
];

#[test]
fn changed_bytes_need_a_new_version() {
    if cfg!(not(target_arch = "x86_64")) {
        println!("skipped: the pinned digests are those of x86_64");
        return;
    }
    let bench = Bench::rocks();
    let ran = bench.run(SCENE, &[]);
    assert!(!ran.summary.failed, "{:?}", ran.events.last());
    let mut stages = BTreeSet::new();
    let mut lines: Vec<String> = Vec::new();
    for (instance, result) in ran.summary.instances.iter().enumerate() {
        let stage = ran.plan.step(instance).stage;
        stages.insert(stage.name());
        for (port, output) in &result.outcome.as_ref().unwrap().outputs {
            let label = ran.plan.label(instance);
            lines.push(format!("{} {} {label}.{port} {}", stage.name(), stage.version(), output.digest));
        }
    }
    lines.sort();
    let text = lines.join("\n") + "\n";
    let missing: Vec<&str> = rockface_stages::registry()
        .stages()
        .iter()
        .map(|stage| stage.name())
        .filter(|name| !stages.contains(name) && !NEED_FILES.contains(name))
        .collect();
    assert!(missing.is_empty(), "golden.yaml leaves out {missing:?}");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(LIST);
    if std::env::var_os("ROCKFACE_BLESS").is_some() {
        std::fs::write(&path, &text).unwrap();
    }
    let pinned = std::fs::read_to_string(&path).unwrap_or_default();
    let pinned: BTreeSet<&str> = pinned.lines().collect();
    let changed: Vec<&String> = lines.iter().filter(|line| !pinned.contains(line.as_str())).collect();
    assert!(
        changed.is_empty() && pinned.len() == lines.len(),
        "these bytes are not those pinned in {LIST}; if that is meant, raise the VERSION of the first stage along the chain and \
         bless the list:\n{changed:#?}"
    );
}
