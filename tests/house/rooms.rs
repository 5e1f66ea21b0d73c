//! Who may import whom: the rooms of the house, lowest first, and every arrow between them with its reason.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::tidy::{sources, without_tests};

/// The rooms, lowest first; a room imports only rooms above it in this list, so no circle crosses a room.
const ROOMS: &[&str] = &[
    "cache",
    "remote",
    "numerics",
    "core",
    "format",
    "raster",
    "face",
    "camera",
    "rockfall",
    "depth",
    "matching",
    "survey",
    "fusion",
    "noise",
    "detection",
    "dataset",
    "figure",
    "look",
    "command",
    "registry",
    "diagnostic",
    "version",
    "pipeline",
    "plan",
    "watch",
    "history",
    "run",
    "explain",
    "drawing",
    "report",
    "cli",
    "program",
];

/// The rooms of stages that stand on rasters.
const ON_RASTERS: &[&str] = &[
    "face",
    "camera",
    "rockfall",
    "depth",
    "matching",
    "survey",
    "fusion",
    "noise",
    "detection",
    "dataset",
    "figure",
    "look",
];

/// From, to, why. What every stage needs (`core`, `numerics`, `format`, `raster`) is listed once for all.
const ARROWS: &[(&[&str], &[&str], &str)] = &[
    (&["remote"], &["cache"], "object stores are remote places under a store"),
    (&["cli"], &["remote"], "`--remote` names an object store"),
    (&["core"], &["numerics"], "a stage is lent the key of a random stream"),
    (&["format"], &["core"], "a format writes and reads artefacts"),
    (&["cli"], &["format"], "an exported raster gets overviews and says where it comes from"),
    (&["format"], &["numerics"], "quantisation rounds alike everywhere"),
    (ON_RASTERS, &["core"], "the contract of a stage, and the artefacts"),
    (&["raster", "command", "registry"], &["core"], "the contract of a stage, and the artefacts"),
    (ON_RASTERS, &["numerics"], "random numbers, transforms, quantiles"),
    (&["raster"], &["numerics"], "quantiles and fits"),
    (&["raster", "face", "camera", "rockfall", "fusion", "figure", "command"], &["format"], "files of artefacts"),
    (ON_RASTERS, &["raster"], "grids, windows and frames; what turns a surface into a grid"),
    (&["rockfall"], &["face"], "blocks are checked and cut as the meshes of a face are"),
    (&["depth", "matching", "survey", "fusion"], &["camera"], "pixels and rays"),
    (&["survey"], &["depth"], "tie points are seen or hidden in drawn depth maps"),
    (&["survey"], &["matching"], "a forecast uses the noise model, and pairs are judged by how they are rectified"),
    (&["detection", "figure"], &["rockfall"], "what is found is compared with, or drawn over, ground truth"),
    (&["noise"], &["matching"], "a noise model is learnt with the geometry and the classes it is drawn with"),
    (&["figure"], &["noise"], "figures of descriptors"),
    (&["dataset", "figure"], &["detection"], "tiles and figures show comparisons and detectability"),
    (&["look"], &["camera"], "points of a depth map"),
    (&["look"], &["figure"], "previews are small pictures in the same colours"),
    (&["registry"], ON_RASTERS, "it lists the stages of every room"),
    (&["registry"], &["raster", "command"], "it lists the stages of every room"),
    (
        &["version", "pipeline", "plan", "watch", "history", "run", "explain", "report", "cli"],
        &["cache"],
        "digests, records, recipes and the store",
    ),
    (
        &["plan", "watch", "history", "run", "explain", "report", "cli", "program"],
        &["core"],
        "the contract of a stage; no room of the science",
    ),
    (&["pipeline"], &["core"], "parts declare the kinds of artefact that they take"),
    (
        &["pipeline", "plan", "history", "run", "drawing", "cli"],
        &["diagnostic"],
        "messages with place, caret and way out",
    ),
    (&["watch"], &["diagnostic"], "names and logs of others are made fit for a terminal"),
    (&["plan", "run", "drawing", "report", "cli"], &["pipeline"], "the document as it was read"),
    (&["history"], &["pipeline"], "outputs of past runs are named as pipelines name them"),
    (&["history", "run", "explain", "drawing", "report", "cli"], &["plan"], "instances and their recipes"),
    (&["history", "run", "report", "cli"], &["watch"], "events, logs, and how times are written"),
    (&["run", "explain", "report", "cli"], &["history"], "manifests and the names of the files of a run folder"),
    (&["report", "cli"], &["run"], "what is run; who writes the page at its end"),
    (&["run", "cli"], &["version"], "the manifest says which program it was"),
    (&["cli"], &["explain"], "`rockface explain`"),
    (&["report", "cli"], &["drawing"], "the graph of a run, `rockface graph`"),
    (&["cli"], &["report"], "`rockface report`"),
    (&["report"], &["numerics"], "the median of a curve"),
    (&["cli"], &["camera"], "`inspect --pixel` follows a ray"),
    (&["cli"], &["raster", "face"], "`inspect` says what is wrong with a mesh"),
    (&["program"], &["registry"], "the program is handed the stages that ship with it"),
    (&["program"], &["cli"], "the program parses and runs a command"),
    (&["program"], &["run"], "how much of the machine's memory is left decides whether freed memory is kept"),
];

/// Crates by the name they are imported by: the folder of their sources, and the room of files outside of the rooms.
const CRATES: &[(&str, &str, &str)] = &[
    ("rockface_cache", "cache/src", "cache"),
    ("rockface_remote", "cache/remote/src", "remote"),
    ("rockface_core", "stages/core/src", "core"),
    ("rockface_raster", "stages/raster/src", "raster"),
    ("rockface_rock", "stages/rock/src", ""),
    ("rockface_imaging", "stages/imaging/src", ""),
    ("rockface_analysis", "stages/analysis/src", ""),
    ("rockface_stages", "stages/src", "registry"),
    ("rockface_engine", "src/engine", ""),
    ("rockface", "src", "program"),
];

/// The room of a module of a crate; empty for what only lists rooms.
fn room<'a>(home: (&str, &'a str), modules: &[&'a str]) -> &'a str {
    let (name, other) = home;
    let is_room = |module: &str| match name {
        "rockface_cache" | "rockface_remote" | "rockface_raster" | "rockface_stages" => false,
        "rockface_core" => matches!(module, "numerics" | "format"),
        _ => ROOMS.contains(&module),
    };
    modules.first().copied().filter(|first| is_room(first)).unwrap_or(other)
}

/// The names behind `crate::`, `super::` or the name of a crate, up to three of them, for every place where one stands.
fn references(code: &str) -> Vec<Vec<String>> {
    let mut found = Vec::new();
    let is_name = |c: char| c.is_alphanumeric() || c == '_';
    for (at, _) in code.match_indices("::") {
        let head = code[..at].rsplit(|c: char| !is_name(c)).next().unwrap_or_default();
        let before = code[..at - head.len()].chars().next_back();
        let starts = head == "crate" || head == "super" || CRATES.iter().any(|(name, ..)| *name == head);
        if !starts || matches!(before, Some(':' | '$')) {
            continue;
        }
        let rest = &code[at + 2..];
        let mut path = vec![head.to_owned()];
        for part in rest.split("::") {
            let name = part.split(|c| !is_name(c)).next().unwrap_or_default();
            path.extend((!name.is_empty()).then(|| name.to_owned()));
            if name.len() < part.len() {
                break;
            }
        }
        // What stands in braces right behind the prefix: `use crate::{a::b, c};`.
        let group = rest.trim_start_matches(|c| is_name(c) || c == ':');
        if let Some(inside) = group.strip_prefix('{') {
            let prefix = rest[..rest.len() - group.len()].split("::").filter(|part| !part.is_empty());
            let prefix: Vec<String> = std::iter::once(head).chain(prefix).map(str::to_owned).collect();
            let mut depth = 0;
            let end = inside.find(|c| {
                depth += i32::from(c == '{') - i32::from(c == '}');
                depth < 0
            });
            for item in inside[..end.unwrap_or(inside.len())].split(',') {
                let name = item.trim().split(|c| !is_name(c)).next().unwrap_or_default();
                found.push(prefix.iter().cloned().chain([name.to_owned()]).collect());
            }
        } else {
            found.push(path);
        }
    }
    found
}

/// Every arrow that leaves a room, with one file it is in.
fn arrows() -> BTreeMap<(String, String), String> {
    let mut arrows = BTreeMap::new();
    for (name, folder, other) in CRATES {
        for (path, text) in without_tests(sources(folder)) {
            let root = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
            let relative = path.strip_prefix(&root).unwrap().with_extension("");
            // The engine has a folder of its own inside the sources of the program.
            if *name == "rockface" && relative.starts_with("engine") {
                continue;
            }
            let mut modules: Vec<&str> = relative.iter().filter_map(|part| part.to_str()).collect();
            if matches!(modules.last(), Some(&("mod" | "lib" | "main"))) {
                modules.pop();
            }
            let from = room((name, other), &modules);
            let code: Vec<&str> = text.lines().filter(|line| !line.trim_start().starts_with("//")).collect();
            for reference in references(&code.join("\n")) {
                let (head, rest) = reference.split_first().unwrap();
                let rest: Vec<&str> = rest.iter().map(String::as_str).collect();
                let to = match head.as_str() {
                    "crate" => room((name, other), &rest),
                    "super" => {
                        let up = 1 + rest.iter().take_while(|part| **part == "super").count();
                        let base = modules.len().saturating_sub(up);
                        let whole: Vec<&str> = modules[..base].iter().chain(&rest[up - 1..]).copied().collect();
                        room((name, other), &whole)
                    }
                    _ => {
                        let (home, _, outside) = CRATES.iter().find(|(crate_name, ..)| crate_name == head).unwrap();
                        room((home, outside), &rest)
                    }
                };
                if from != to && !from.is_empty() && !to.is_empty() {
                    arrows.entry((from.to_owned(), to.to_owned())).or_insert_with(|| relative.display().to_string());
                }
            }
        }
    }
    arrows
}

#[test]
fn rooms_import_only_what_the_list_allows() {
    let allowed: BTreeSet<(&str, &str)> = ARROWS
        .iter()
        .flat_map(|(from, to, _)| from.iter().flat_map(move |from| to.iter().map(move |to| (*from, *to))))
        .collect();
    let arrows = arrows();
    for ((from, to), file) in &arrows {
        assert!(
            allowed.contains(&(from.as_str(), to.as_str())),
            "{file}: room `{from}` imports room `{to}`; tests/house/rooms.rs does not allow it (see \"Rooms\" in ARCHITECTURE.md)"
        );
    }
    let is_unused = |(from, to): &&(&str, &str)| !arrows.contains_key(&((*from).to_owned(), (*to).to_owned()));
    let unused: Vec<&(&str, &str)> = allowed.iter().filter(is_unused).collect();
    assert!(unused.is_empty(), "arrows that nobody uses: {unused:?}");
    println!("{} rooms, {} arrows", ROOMS.len(), arrows.len());
    assert!(arrows.len() > 50, "the listing has lost its arrows");
}

#[test]
fn no_arrow_goes_up() {
    let floor =
        |room: &str| ROOMS.iter().position(|known| *known == room).unwrap_or_else(|| panic!("no room `{room}`"));
    for (from, to, why) in ARROWS {
        for (from, to) in from.iter().flat_map(|from| to.iter().map(move |to| (from, to))) {
            assert!(floor(to) < floor(from), "`{from}` -> `{to}` ({why}) goes up: a circle");
        }
        assert!(why.len() > 10, "an arrow needs a reason");
    }
}

#[test]
fn references_are_found_however_they_are_written() {
    let found = |code: &str| references(code).into_iter().map(|path| path.join("/")).collect::<Vec<_>>();
    assert_eq!(found("use crate::plan::Plan;"), ["crate/plan/Plan"]);
    assert_eq!(found("use crate::{plan::Plan, run};"), ["crate/plan", "crate/run"]);
    assert_eq!(found("super::super::face::read()"), ["super/super/face/read"]);
    assert_eq!(found("use rockface_core::{Stage, format::png};"), ["rockface_core/Stage", "rockface_core/format"]);
    assert_eq!(found("$crate::params::Fault; std::fs::read"), [""; 0]);
}
