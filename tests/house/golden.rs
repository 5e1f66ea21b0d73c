//! The bytes every stage makes on a small scene, pinned by one digest a stage: who changes them raises the stage's VERSION.
//!
//! `ROCKFACE_BLESS=1 cargo test --test house golden` writes the list anew. Digests are those of one processor family
//! (`x86_64`); elsewhere the last digits of eigenvectors may differ, and the test says that it was skipped.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use rockface_cache::Digest;

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
    let mut made: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for (instance, result) in ran.summary.instances.iter().enumerate() {
        let of_stage = made.entry(ran.plan.step(instance).stage.name()).or_default();
        for (port, output) in &result.outcome.as_ref().unwrap().outputs {
            of_stage.push(format!("{}.{port} {}", ran.plan.label(instance), output.digest));
        }
    }
    made.values_mut().for_each(|lines| lines.sort());
    let registry = rockface_stages::registry();
    let missing: Vec<&str> = registry
        .stages()
        .iter()
        .map(|stage| stage.name())
        .filter(|name| !made.contains_key(name) && !NEED_FILES.contains(name))
        .collect();
    assert!(missing.is_empty(), "golden.yaml leaves out {missing:?}");
    let version = |name: &str| registry.stages().iter().find(|stage| stage.name() == name).unwrap().version();
    let pin = |(name, lines): (&&str, &Vec<String>)| {
        format!("{name} {} {}", version(name), Digest::of(lines.join("\n").as_bytes()))
    };
    let now: Vec<String> = made.iter().map(pin).collect();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(LIST);
    if std::env::var_os("ROCKFACE_BLESS").is_some() {
        std::fs::write(&path, now.join("\n") + "\n").unwrap();
    }
    let pinned = std::fs::read_to_string(&path).unwrap_or_default();
    let pinned: BTreeSet<&str> = pinned.lines().collect();
    let is_changed = |(pin, _): &(&String, _)| !pinned.contains(pin.as_str());
    let changed: Vec<_> = now.iter().zip(made.values()).filter(is_changed).collect();
    assert!(
        changed.is_empty() && pinned.len() == now.len(),
        "these bytes are not those pinned in {LIST}; if that is meant, raise the VERSION of the first stage along the chain and \
         bless the list:\n{changed:#?}"
    );
}
