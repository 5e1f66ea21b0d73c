//! The bytes every stage makes on a small scene, pinned by a line a stage: who changes them raises the stage's VERSION.
//!
//! `ROCKFACE_BLESS=1 cargo test --test house golden` writes the list anew, but for stages that make other bytes under the same version of the
//! same inputs and parameters. Digests are those of one processor family
//! (`x86_64`); elsewhere the last digits of eigenvectors may differ, and the test says that it was skipped.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::LazyLock;

use rockface_cache::{Digest, Recipe};
use rockface_core::artefact::{Artefact, Kind};

use crate::lab::{Bench, Ran};

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

/// The scene, and what was made of it.
static MADE: LazyLock<(Bench, Ran)> = LazyLock::new(|| {
    let bench = Bench::rocks();
    let ran = bench.run(SCENE, &[]);
    assert!(!ran.summary.failed, "{:?}", ran.events.last());
    (bench, ran)
});

/// What a stage made on the scene.
#[derive(Default)]
struct Made {
    /// The recipe of each instance, without the version of the stage.
    questions: Vec<String>,
    /// Each output with its digest.
    outputs: Vec<String>,
}

impl Made {
    /// The line of the list: stage, version, digest of what it was asked, digest of what it made.
    fn pin(&self, stage: &str, version: u32) -> String {
        let digest = |lines: &[String]| Digest::of(lines.join("\n").as_bytes());
        format!("{stage} {version} {} {}", digest(&self.questions), digest(&self.outputs))
    }
}

/// Whether a line of the list has other outputs than another with the same stage, version and question.
fn is_unversioned(pin: &str, pinned: &BTreeSet<&str>) -> bool {
    let Some((asked, _)) = pin.rsplit_once(' ') else { return false };
    !pinned.contains(pin) && pinned.iter().any(|known| known.rsplit_once(' ').is_some_and(|(known, _)| known == asked))
}

#[test]
fn changed_bytes_need_a_new_version() {
    if cfg!(not(target_arch = "x86_64")) {
        println!("skipped: the pinned digests are those of x86_64");
        return;
    }
    let (bench, ran) = &*MADE;
    let mut made: BTreeMap<&str, Made> = BTreeMap::new();
    for (instance, result) in ran.summary.instances.iter().enumerate() {
        let (label, of_stage) =
            (ran.plan.label(instance), made.entry(ran.plan.step(instance).stage.name()).or_default());
        let recipe = Recipe { version: 0, ..result.recipe(&bench.store).expect("it ran") };
        of_stage.questions.push(format!("{label} {}", recipe.key()));
        let outputs = &result.outcome.as_ref().unwrap().outputs;
        of_stage.outputs.extend(outputs.iter().map(|(port, output)| format!("{label}.{port} {}", output.digest)));
    }
    for of_stage in made.values_mut() {
        of_stage.questions.sort();
        of_stage.outputs.sort();
    }
    let registry = rockface_stages::registry();
    let missing: Vec<&str> = registry
        .stages()
        .iter()
        .map(|stage| stage.name())
        .filter(|name| !made.contains_key(name) && !NEED_FILES.contains(name))
        .collect();
    assert!(
        missing.is_empty(),
        "nothing pins what {missing:?} make: add a step to tests/house/golden.yaml and name it in its `targets` (what needs files or \
         programs goes into NEED_FILES)"
    );
    let version = |name: &str| registry.stages().iter().find(|stage| stage.name() == name).unwrap().version();
    let now: BTreeMap<String, &Made> = made.iter().map(|(name, made)| (made.pin(name, version(name)), made)).collect();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(LIST);
    let list = std::fs::read_to_string(&path).unwrap_or_default();
    let pinned: BTreeSet<&str> = list.lines().collect();
    let unversioned: Vec<(&str, &[String])> = now
        .iter()
        .filter(|(pin, _)| is_unversioned(pin, &pinned))
        .map(|(pin, made)| (pin.split(' ').next().unwrap_or_default(), made.outputs.as_slice()))
        .collect();
    // Not blessed either: stores would go on giving the former bytes.
    assert!(
        unversioned.is_empty(),
        "these stages make other bytes of the same inputs than {LIST} has; raise their VERSION:\n{unversioned:#?}"
    );
    if std::env::var_os("ROCKFACE_BLESS").is_some() {
        let lines: Vec<&str> = now.keys().map(String::as_str).collect();
        return std::fs::write(&path, lines.join("\n") + "\n").unwrap();
    }
    let changed: Vec<&str> = now.keys().map(String::as_str).filter(|pin| !pinned.contains(pin)).collect();
    let gone: Vec<&str> = pinned.into_iter().filter(|pin| !now.contains_key(*pin)).collect();
    assert!(
        changed.is_empty() && gone.is_empty(),
        "{LIST} is to be written anew (ROCKFACE_BLESS=1): versions, parameters or inputs of these stages changed\nnow: {changed:#?}\n\
         in the list: {gone:#?}"
    );
}

#[test]
fn a_list_is_not_blessed_where_a_version_was_forgotten() {
    let pinned = BTreeSet::from(["cut 1 q a", "join 2 q b"]);
    assert!(is_unversioned("cut 1 q z", &pinned));
    for sound in ["cut 1 q a", "cut 2 q z", "cut 1 r z", "new 1 q z"] {
        assert!(!is_unversioned(sound, &pinned), "{sound}");
    }
}

/// Stages that hand on the columns of what they are given: the page explains these with the stages that made them.
const HAND_ON: [&str; 3] = ["join-inventories", "select-features", "tabulate"];

/// What stands in code in the sections of the page of columns that name a stage, or in all of them for one that hands columns on.
fn names_told<'a>(page: &'a str, stage: &str) -> BTreeSet<&'a str> {
    let code = |section: &'a str| section.split('`').skip(1).step_by(2).collect::<BTreeSet<&str>>();
    let sections = page.split("\n## ").skip(1).map(code);
    sections.filter(|names| HAND_ON.contains(&stage) || names.contains(stage)).flatten().collect()
}

/// Whether a name is that of the page, in which `…` stands for any text.
fn is_of_pattern(name: &str, pattern: &str) -> bool {
    pattern.split_once('…').map_or(name == pattern, |(head, tail)| {
        name.strip_prefix(head).and_then(|rest| rest.strip_suffix(tail)).is_some_and(|rest| !rest.is_empty())
    })
}

/// Whether the names explain a column: components along Y and Z stand with that along X, ends of an interval with its middle.
fn is_explained(names: &BTreeSet<&str>, column: &str) -> bool {
    let has = |name: &str| names.iter().any(|pattern| is_of_pattern(name, pattern));
    let along_x = column.replace("_y_m", "_x_m").replace("_z_m", "_x_m");
    let of_axis = column.strip_suffix("_y").or(column.strip_suffix("_z")).map(|stem| format!("{stem}_x"));
    let middle = column.strip_suffix("_low").or(column.strip_suffix("_high"));
    has(column) || has(&along_x) || of_axis.is_some_and(|name| has(&name)) || middle.is_some_and(has)
}

#[test]
fn columns_are_explained_where_their_stage_is() {
    let page = "# Columns\n\n`id`\n\n## Of `cut`\n\n`n`, `box_x_m`, `p_…`, `… (real)`\n\n## Of `join`\n\n`share`\n";
    let is_told = |stage: &str, column: &str| is_explained(&names_told(page, stage), column);
    for column in ["n", "n_low", "n_high", "box_z_m", "p_sigma", "rate (real)"] {
        assert!(is_told("cut", column) && is_told("tabulate", column) && !is_told("join", column), "{column}");
    }
    for column in ["id", "share", "p_", " (real)", "low", "box_m", "x_m"] {
        assert!(!is_told("cut", column), "{column}");
    }
}

#[test]
fn every_column_that_people_open_is_explained() {
    let (bench, ran) = &*MADE;
    let page = include_str!("../../docs/reference/columns.md");
    // Tables have the items of axes too.
    let points: Vec<_> = (0..ran.summary.instances.len()).map(|instance| ran.plan.point(instance)).collect();
    let axes: BTreeSet<&str> = points.iter().flat_map(|point| point.keys().map(AsRef::as_ref)).collect();
    let mut missing = BTreeSet::new();
    for (instance, result) in ran.summary.instances.iter().enumerate() {
        let stage = ran.plan.step(instance).stage.name();
        let names = names_told(page, stage);
        for (port, output) in &result.outcome.as_ref().unwrap().outputs {
            let kind = output.kind.parse::<Kind>().ok().filter(|kind| [Kind::Table, Kind::Inventory].contains(kind));
            let decode = |kind| Artefact::decode(kind, &bench.store.get(&output.digest).unwrap()).unwrap();
            let columns = match kind.map(decode) {
                Some(Artefact::Table(table)) => table.columns,
                Some(Artefact::Inventory(inventory)) => inventory.columns,
                _ => continue,
            };
            let unknown =
                columns.into_iter().filter(|column| !axes.contains(column.as_str()) && !is_explained(&names, column));
            missing.extend(unknown.map(|column| format!("{stage}.{port}: {column}")));
        }
    }
    assert!(
        missing.is_empty(),
        "no section of docs/reference/columns.md that names their stage says what these columns are: {missing:#?}"
    );
}
