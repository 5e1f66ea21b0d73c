//! Pipelines: the text of one, what is given on the command line, and the tree of a long one in the store.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use rockface::drawing::Drawing;
use rockface_cache::{Digest, Store};
use rockface_engine::diagnostic::Diagnostics;
use rockface_engine::explain::Answers;
use rockface_engine::pipeline::{Overrides, Pipeline};
use rockface_engine::plan::{Graph, Plan, counts, resolve};

use super::Verdict;
use crate::parts::cut;

/// The second part of a case stands for the included file of this name, the third for the next.
pub const INCLUDED: [&str; 2] = ["part1.yaml", "part2.yaml"];
/// Plans of more instances, or of axes with more points between them, are not expanded: what is asked for is had, and takes
/// its time and memory.
const INSTANCES: usize = 5000;

/// A folder with the files that seeds name, and a store that holds nothing.
struct Place {
    folder: tempfile::TempDir,
    store: Store,
}

fn place() -> Option<&'static Place> {
    static PLACE: OnceLock<Option<Place>> = OnceLock::new();
    let make = || {
        let folder = tempfile::tempdir().ok()?;
        for name in ["face.ply", "cameras.json", "covariance.json", "blocks.csv", "real/a.tif", "real/b.tif"] {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent()?).ok()?;
            std::fs::write(path, name).ok()?;
        }
        let store = Store::open(&folder.path().join("store")).ok()?;
        Some(Place { folder, store })
    };
    PLACE.get_or_init(make).as_ref()
}

/// Nothing from outside but the parts that come with the program.
fn with_parts() -> Overrides {
    Overrides { parts: rockface_stages::registry().parts(), ..Overrides::default() }
}

/// A pipeline and the files it includes or uses.
pub fn text(bytes: &[u8]) -> Verdict {
    let Some(place) = place() else { return Verdict::Refused };
    let parts: Option<Vec<&str>> = cut(bytes).into_iter().map(|part| std::str::from_utf8(part).ok()).collect();
    let Some((main, others)) = parts.as_deref().and_then(<[&str]>::split_first) else { return Verdict::Refused };
    let path = |name: &&str| place.folder.path().join(name);
    let included: BTreeMap<PathBuf, String> =
        INCLUDED.iter().map(path).zip(others.iter().map(|text| (*text).to_owned())).collect();
    let main_path = place.folder.path().join("main.yaml");
    planned(Pipeline::of_text(main, included, &main_path, &with_parts()), &place.store)
}

const FIXED: &str = "rockface: 1\nname: fixed\nseed: 3\nparams: {width_m: 4}\n\
    axes: {replicate: {count: 3}, cell: {values: [0.25, 0.5]}}\nsteps:\n  \
    face: {stage: synthesise-face, over: [replicate], with: {width_m: \"${width_m}\", height_m: 3}}\n  \
    dem: {stage: rasterise-dem, in: {surface: face.mesh}, with: {cell_m: \"${cell}\"}}\n  \
    twice: {use: p, in: {face: face.mesh}}\nparts:\n  \
    p: {in: {face: mesh}, params: {c: {type: number, default: 1}}, out: {o: o.raster}, steps: {o: {stage: rasterise-dem, in: {surface: in.face}, with: {cell_m: \"${c}\"}}}}\n";

/// A line of the case is a `--set`, one that begins with `%` a `--sweep`.
pub fn overrides(bytes: &[u8]) -> Verdict {
    let (Some(place), Ok(text)) = (place(), std::str::from_utf8(bytes)) else { return Verdict::Refused };
    let (sweep, set): (Vec<&str>, Vec<&str>) = text.lines().take(20).partition(|line| line.starts_with('%'));
    let set = set.into_iter().map(str::to_owned).collect();
    let sweep = sweep.into_iter().map(|line| line[1..].to_owned()).collect();
    let overrides = Overrides { set, sweep, seed: Some(7), ..with_parts() };
    let pipeline = Pipeline::of_text(FIXED, BTreeMap::new(), &place.folder.path().join("main.yaml"), &overrides);
    planned(pipeline, &place.store)
}

/// A pipeline long enough for its tree to be kept.
pub fn long_text() -> String {
    let mut text = FIXED.to_owned();
    while text.len() <= 64 << 10 {
        text.push_str("# a line that says nothing, so that the text is long enough for its tree to be kept\n");
    }
    text
}

/// The tree of [`long_text`], with the mark of this user.
pub fn tree(bytes: &[u8]) -> Verdict {
    static TEXT: OnceLock<String> = OnceLock::new();
    let Some(place) = place() else { return Verdict::Refused };
    let text = TEXT.get_or_init(long_text);
    let (path, trees) = (place.folder.path().join("long.yaml"), place.folder.path().join("trees"));
    let digest = Digest::of(text.as_bytes());
    let Some(mark) = rockface_cache::mark(&[b"tree", digest.as_bytes(), bytes]) else { return Verdict::Refused };
    let mut file = format!("rockface tree 2 {digest} {mark}\n").into_bytes();
    file.extend_from_slice(bytes);
    let slot = trees.join(&digest.to_string()[..1]);
    let put = std::fs::create_dir_all(&trees)
        .and_then(|()| std::fs::write(&path, text))
        .and_then(|()| std::fs::write(&slot, &file));
    if put.is_err() {
        return Verdict::Refused;
    }
    let verdict = planned(Pipeline::load(&path, &with_parts(), Some(&trees)), &place.store);
    // A tree that was believed is left as it is; any other is replaced by the true one.
    if std::fs::read(&slot).is_ok_and(|now| now == file) { verdict } else { Verdict::Refused }
}

/// Goes as far with a pipeline as `rockface plan`, `explain` and `graph` do.
fn planned(pipeline: Result<Pipeline, Diagnostics>, store: &Store) -> Verdict {
    let planned = pipeline.and_then(|pipeline| {
        let graph = resolve(&pipeline, &[], rockface_stages::registry().stages())?;
        if graph.axes.iter().fold(1, |points: usize, axis| points.saturating_mul(axis.items.len().max(1))) > INSTANCES {
            return Ok(());
        }
        draw(&graph);
        let told = |list| Diagnostics { sources: pipeline.sources.clone(), list };
        if counts(&graph).map_err(told)?.into_iter().flatten().fold(0, usize::saturating_add) > INSTANCES {
            return Ok(());
        }
        let hash = |path: &Path| Ok(Digest::of(path.as_os_str().as_encoded_bytes()));
        look_at(&Plan::new(graph, &hash).map_err(told)?, store);
        Ok(())
    });
    match planned {
        Ok(()) => Verdict::Accepted,
        Err(faults) => {
            assert!(!faults.list.is_empty(), "a refusal has a reason");
            drop(faults.render(true));
            Verdict::Refused
        }
    }
}

fn draw(graph: &Graph) {
    if let Ok(drawing) = Drawing::of(graph) {
        let texts = [drawing.svg(), drawing.dot(), drawing.mermaid(), drawing.json().to_string()];
        assert!(texts.iter().all(|text| !text.is_empty()), "a drawing has a text");
    }
}

fn look_at(plan: &Plan, store: &Store) {
    let answers = Answers::new(plan, store);
    for (instance, answer) in answers.list().iter().enumerate() {
        drop((answer.why(plan), plan.label(instance), answers.recipe(instance)));
    }
    let _ = plan.log_levels();
}
