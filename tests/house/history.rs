//! Past runs as a user meets them: listed, compared, repeated, exported, archived, described.

use std::path::Path;
use std::process::Command;
use std::sync::atomic::AtomicBool;

use rockface_cache::Store;
use rockface_engine::history::{self, HistoryError};
use serde_json::Value;

use crate::cli::{House, SMALL, last_line};

/// Two runs that differ in one parameter.
fn two_runs() -> House {
    let house = House::new(SMALL);
    for set in ["steps.dem.with.cell_m=0.05", "steps.dem.with.cell_m=0.1"] {
        let (code, _, err) = house.rockface(&["run", "p.yaml", "--set", set]);
        assert_eq!(code, Some(0), "{err}");
    }
    house
}

/// The names of the run folders, oldest first.
fn names(house: &House) -> Vec<String> {
    let (_, out, _) = house.rockface(&["runs", "list", "--format", "json"]);
    let runs: Value = serde_json::from_str(&out).unwrap();
    runs.as_array().unwrap().iter().map(|run| run["name"].as_str().unwrap().to_owned()).collect()
}

fn read_json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

#[test]
fn runs_are_listed_shown_and_compared_by_what_varies() {
    let house = two_runs();
    let names = names(&house);
    assert_eq!(names.len(), 2);
    let (code, out, _) = house.rockface(&["runs", "list"]);
    assert_eq!(code, Some(0));
    assert!(out.lines().count() == 3 && names.iter().all(|name| out.contains(name)), "{out}");
    let (_, out, _) = house.rockface(&["runs", "show", "latest"]);
    assert!(out.contains("set       steps.dem.with.cell_m=0.1") && out.contains("seed      1"), "{out}");
    let (code, out, err) = house.rockface(&["runs", "compare", &names[0], &names[1], "--format", "json"]);
    assert_eq!(code, Some(0), "{err}");
    let found: Value = serde_json::from_str(&out).unwrap();
    let parameters: Vec<&str> =
        found["parameters"].as_array().unwrap().iter().map(|p| p["name"].as_str().unwrap()).collect();
    assert_eq!(parameters, ["dem.cell_m"]);
    assert_eq!(found["parameters"][0]["values"], serde_json::json!([0.05, 0.1]));
    assert!(found["equal_parameters"].as_u64().unwrap() > 5);
    let (_, out, _) = house.rockface(&["runs", "compare", &names[0], "latest", "--format", "csv"]);
    assert!(out.starts_with("kind,name,") && out.contains("parameter,dem.cell_m,0.05,0.1,0.05,"), "{out}");
    let (code, _, err) = house.rockface(&["runs", "show", "latst"]);
    assert!(code == Some(2) && err.contains("runs list"), "{err}");
    let (code, _, err) = house.rockface(&["runs", "show", "smal"]);
    assert!(code == Some(2) && err.contains("fits several runs"), "{err}");
    // The name of a pipeline means its last run.
    let (code, out, _) = house.rockface(&["runs", "show", "small"]);
    assert!(code == Some(0) && out.contains("set       steps.dem.with.cell_m=0.1"), "{out}");
}

#[test]
fn runs_are_listed_for_programs() {
    let house = two_runs();
    let (_, out, _) = house.rockface(&["runs", "list", "--format", "csv"]);
    let lines: Vec<Vec<&str>> = out.lines().map(|line| line.splitn(10, ',').collect()).collect();
    let head = ["run", "pipeline", "seed", "status", "finished", "executed", "cached", "wall_s", "pinned", "result"];
    assert_eq!((lines.len(), &lines[0][..]), (3, &head[..]));
    assert_eq!((&lines[1][1..4], &lines[1][5..7]), (&["small", "1", "done"][..], &["2", "0"][..]));
    assert!(lines[1][7].parse::<f64>().is_ok() && lines[1][8] == "false", "{out}");
    let names = names(&house);
    for command in [&["runs", "list"][..], &["runs", "compare", &names[0], &names[1]]] {
        let told = |format: &[&str]| house.rockface(&[command, format].concat());
        assert_eq!(told(&["--json"]), told(&["--format", "json"]));
    }
    let (code, _, err) = house.rockface(&["runs", "list", "--runs", "nowhere"]);
    assert!(code == Some(2) && err.contains("there is no folder nowhere"), "{err}");
    let (code, out, _) = House::new(SMALL).rockface(&["runs", "list"]);
    assert!(code == Some(0) && out.lines().count() == 1, "{out}");
}

#[test]
fn a_repetition_names_the_files_that_changed() {
    let house = House::new("rockface: 1\nsteps:\n  a: {stage: import-table, with: {path: t.csv}}\n");
    let write = |text: &str| std::fs::write(house.path("t.csv"), text).unwrap();
    write("x\n1\n");
    let (code, _, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    let manifest = house.path(".rockface/runs/latest/run.json").canonicalize().unwrap();
    write("x\n23\n");
    let (code, out, err) = house.rockface(&["run", manifest.to_str().unwrap()]);
    assert_eq!(code, Some(0), "{err}");
    let digests = ["x\n1\n", "x\n23\n"].map(|text| blake3::hash(text.as_bytes()).to_hex()[..8].to_owned());
    let line = out.lines().find(|line| line.starts_with("changed  ")).unwrap_or_else(|| panic!("{out}"));
    assert!(line.contains("t.csv: ") && digests.iter().all(|digest| line.contains(digest.as_str())), "{out}");
    assert!(out.contains("repeated: 0 outputs are the same, 1 are not"), "{out}");
}

#[test]
fn a_manifest_repeats_its_run_and_says_whether_it_came_out_the_same() {
    let house = two_runs();
    let first = house.path(".rockface/runs").join(&names(&house)[0]);
    // Neither the pipeline file nor what was cached matters.
    std::fs::write(house.path("p.yaml"), "rockface: 1\nsteps: {}\n").unwrap();
    let manifest = first.join("run.json");
    let (code, out, err) = house.rockface(&["run", manifest.to_str().unwrap(), "--store", "another"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(out.contains("repeated: all 2 outputs are the same") && last_line(&out).contains("ran 2"), "{out}");
    let changed = ["run", manifest.to_str().unwrap(), "--set", "steps.dem.with.cell_m=0.15"];
    let (code, out, _) = house.rockface(&changed);
    assert_eq!(code, Some(0));
    assert!(
        out.contains("differs  dem.raster: ") && out.contains("repeated: 1 outputs are the same, 1 are not"),
        "{out}"
    );
    let (code, out, _) = house.rockface(&[&changed[..], &["--json"]].concat());
    let ended: serde_json::Value = serde_json::from_str(last_line(&out)).unwrap();
    assert_eq!(
        (code, &ended["repeated"]["same"], &ended["repeated"]["others"]),
        (Some(0), &1.into(), &1.into()),
        "{out}"
    );
    std::fs::write(house.path("other.json"), "{\"format\": 7}").unwrap();
    let (code, _, err) = house.rockface(&["run", "other.json"]);
    assert!(code == Some(2) && err.contains("format 7"), "{err}");
}

#[test]
fn outputs_are_exported_by_either_name_and_inspected() {
    let house = two_runs();
    let (code, out, err) = house.rockface(&["export", "latest", "dem.raster", "out/dem.tif", "--plain"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(out.contains("raster"), "{out}");
    let linked = house.path(".rockface/runs/latest/outputs/dem/raster.tif");
    assert_eq!(std::fs::read(house.path("out/dem.tif")).unwrap(), std::fs::read(&linked).unwrap());
    let (code, _, err) = house.rockface(&["export", "latest", "dem.rastr", "x.tif"]);
    assert!(code == Some(2) && err.contains("did you mean `dem.raster`?"), "{err}");

    let (_, out, _) = house.rockface(&["inspect", "out/dem.tif", "--json"]);
    let facts: Value = serde_json::from_str(&out).unwrap();
    assert_eq!((&facts["kind"], &facts["cell (m)"]), (&"raster".into(), &0.1.into()));
    let manifest = read_json(&house.path(".rockface/runs/latest/run.json"));
    let dem = manifest["steps"].as_array().unwrap().iter().find(|done| done["step"] == "dem").unwrap();
    let digest = dem["outputs"]["raster"]["digest"].as_str().unwrap();
    assert_eq!(facts["blake3"], digest);
    let (_, out, _) = house.rockface(&["inspect", &digest[..16]]);
    assert!(out.contains("raster of rasterise-dem") && out.contains("cell (m)"), "{out}");
    let (_, out, _) = house.rockface(&["inspect", &dem["key"].as_str().unwrap()[..16], "--json"]);
    let facts: Value = serde_json::from_str(&out).unwrap();
    assert_eq!(facts["recipe"]["params"]["cell_m"], 0.1);
    let (_, out, _) = house.rockface(&["inspect", ".rockface/runs/latest/run.mcap"]);
    assert!(out.contains("MCAP log") && out.contains("/dem/step"), "{out}");
    let (code, _, err) = house.rockface(&["inspect", "zzzz"]);
    assert!(code == Some(2) && err.contains("neither a file nor"), "{err}");
}

#[test]
fn an_output_whose_port_has_a_dot_is_exported_by_its_name() {
    let house = House::new(SMALL);
    assert_eq!(house.rockface(&["run", "p.yaml"]).0, Some(0));
    let manifest = house.path(".rockface/runs/latest/run.json");
    let text = std::fs::read_to_string(&manifest).unwrap();
    std::fs::write(&manifest, text.replace("\"raster\":", "\"v1.raster\":")).unwrap();
    let (code, _, err) = house.rockface(&["export", "latest", "dem.v1.raster", "dem.tif"]);
    assert!(code == Some(0) && house.path("dem.tif").is_file(), "{err}");
}

#[test]
fn an_archive_holds_what_is_needed_to_check_a_run() {
    let house = two_runs();
    for (name, extra) in [("a.tar", vec![]), ("b.tar", vec!["--outputs"])] {
        let mut arguments = vec!["archive", "latest", "-o", name];
        arguments.extend(extra);
        let (code, out, err) = house.rockface(&arguments);
        assert_eq!(code, Some(0), "{out}{err}");
        let mut archive = tar::Archive::new(std::fs::File::open(house.path(name)).unwrap());
        let mut files = std::collections::BTreeMap::new();
        for entry in archive.entries().unwrap() {
            let mut entry = entry.unwrap();
            let path = entry.path().unwrap().display().to_string();
            let mut bytes = Vec::new();
            std::io::Read::read_to_end(&mut entry, &mut bytes).unwrap();
            files.insert(path, bytes);
        }
        let sums = String::from_utf8(files["B3SUMS"].clone()).unwrap();
        assert_eq!(sums.lines().count(), files.len() - 1);
        for line in sums.lines() {
            let (digest, path) = line.split_once("  ").unwrap();
            assert_eq!(digest, blake3::hash(&files[path]).to_string(), "{path}");
        }
        let recipes: Vec<&String> = files.keys().filter(|path| path.starts_with("records/")).collect();
        assert_eq!(recipes.len(), 2);
        for path in recipes {
            let key = path.trim_start_matches("records/").trim_end_matches(".recipe.json");
            assert_eq!(key, blake3::hash(&files[path]).to_string(), "a recipe's digest is its key");
        }
        assert_eq!(files.contains_key("outputs/dem/raster.tif"), name == "b.tar");
        assert!(
            ["run.json", "run.mcap", "pipeline.yaml", "ro-crate-metadata.json"].iter().all(|f| files.contains_key(*f))
        );
    }
}

#[test]
fn an_archive_that_is_interrupted_leaves_what_was_there() {
    let house = House::new(SMALL);
    assert_eq!(house.rockface(&["run", "p.yaml"]).0, Some(0));
    let run = history::find(&house.path(".rockface/runs"), "latest").unwrap();
    let store = Store::open(&house.path(".rockface/store")).unwrap();
    let there = std::fs::read_dir(house.path("")).unwrap().count();
    let contents = history::Contents { inputs: true, outputs: true };
    let asked = history::archive(&run, &store, contents, &house.path("run.tar"), &AtomicBool::new(true));
    assert!(matches!(asked, Err(HistoryError::Interrupted)), "{asked:?}");
    assert_eq!(std::fs::read_dir(house.path("")).unwrap().count(), there);
}

#[test]
fn the_crate_of_a_run_refers_to_nothing_that_is_not_in_it() {
    let house = two_runs();
    let folder = house.path(".rockface/runs/latest");
    let described = read_json(&folder.join("ro-crate-metadata.json"));
    let graph = described["@graph"].as_array().unwrap();
    let ids: std::collections::BTreeSet<&str> = graph.iter().map(|entity| entity["@id"].as_str().unwrap()).collect();
    let mut referred = Vec::new();
    graph.iter().for_each(|entity| references(entity, &mut referred));
    let outside = |id: &&str| !ids.contains(*id) && !id.starts_with("https://w3id.org/ro/crate/1.1");
    assert_eq!(referred.iter().copied().filter(outside).collect::<Vec<_>>(), Vec::<&str>::new());
    let root = graph.iter().find(|entity| entity["@id"] == "./").unwrap();
    for part in root["hasPart"].as_array().unwrap() {
        let path = part["@id"].as_str().unwrap();
        assert!(folder.join(path).is_file(), "{path}");
    }
    let actions = graph.iter().filter(|entity| entity["@type"] == "CreateAction").count();
    assert_eq!(actions, 3, "the run and its two steps");
}

#[test]
fn the_crate_of_an_archive_names_the_files_that_are_in_it_and_no_others() {
    let house =
        House::new("rockface: 1\nname: reads\nsteps:\n  table: {stage: import-table, with: {path: face.csv}}\n");
    std::fs::write(house.path("face.csv"), "a\n1\n").unwrap();
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--outputs", "all"]);
    assert_eq!(code, Some(0), "{err}");
    for (contents, outputs, inputs) in [(&[][..], 0, 0), (&["--inputs", "--outputs"][..], 1, 2)] {
        let to = format!("{}.tar", contents.len());
        let (code, _, err) = house.rockface(&[&["archive", "latest", "-o", &to], contents].concat());
        assert_eq!(code, Some(0), "{err}");
        let folder = house.path(&format!("of-{}", contents.len()));
        std::fs::create_dir(&folder).unwrap();
        assert!(Command::new("tar").arg("-xf").arg(house.path(&to)).arg("-C").arg(&folder).status().unwrap().success());
        let described = read_json(&folder.join("ro-crate-metadata.json"));
        let graph = described["@graph"].as_array().unwrap();
        let is_file = |entity: &&Value| entity["@type"] == "File" || entity["@type"][0] == "File";
        let files: Vec<&str> = graph.iter().filter(is_file).map(|entity| entity["@id"].as_str().unwrap()).collect();
        files.iter().for_each(|file| assert!(folder.join(file).is_file(), "{file}"));
        let below = |top: &str| files.iter().filter(|file| file.starts_with(top)).count();
        assert_eq!((below("outputs/"), below("inputs/")), (outputs, inputs), "{files:?}");
        assert!(["README", "B3SUMS", "run.json"].iter().all(|file| files.contains(file)), "{files:?}");
        assert!(graph.iter().any(|entity| entity["@id"] == "records/" && entity["@type"] == "Dataset"));
        let run = graph.iter().find(|entity| entity["@id"] == "#run").unwrap().to_string();
        assert_eq!(run.contains("inputs/face.csv"), inputs > 0, "{run}");
        // Described after the run, and still what B3SUMS has.
        let sums = std::fs::read_to_string(folder.join("B3SUMS")).unwrap();
        let bytes = std::fs::read(folder.join("ro-crate-metadata.json")).unwrap();
        assert!(sums.contains(&format!("{}  ro-crate-metadata.json", blake3::hash(&bytes))), "{sums}");
    }
}

/// Every `@id` an entity refers to.
fn references<'a>(value: &'a Value, found: &mut Vec<&'a str>) {
    match value {
        Value::Object(map) => {
            if let (Some(Value::String(id)), 1) = (map.get("@id"), map.len()) {
                found.push(id);
            }
            map.iter().filter(|(key, _)| *key != "@id").for_each(|(_, inner)| references(inner, found));
        }
        Value::Array(list) => list.iter().for_each(|inner| references(inner, found)),
        _ => {}
    }
}

#[test]
fn the_starter_runs_and_is_not_overwritten() {
    let house = House::new(SMALL);
    let (code, out, _) = house.rockface(&["init", "new/place"]);
    assert!(code == Some(0) && out.contains("rockface run new/place/pipeline.yaml"), "{out}");
    let (code, _, err) = house.rockface(&["run", "new/place/pipeline.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    let (code, _, err) = house.rockface(&["init", "new/place"]);
    assert!(code == Some(2) && err.contains("is there already"), "{err}");
    let (_, out, _) = house.rockface(&["init", "a place"]);
    assert!(out.contains("rockface run 'a place/pipeline.yaml'"), "{out}");
    let (code, _, err) = house.rockface(&["init", "p.yaml"]);
    assert!(code == Some(2) && err.contains("p.yaml is a file"), "{err}");
    let (code, _, err) = house.rockface(&["init", "p.yaml/under"]);
    assert!(code == Some(3) && err.contains("cannot make the folder p.yaml/under"), "{err}");
}

#[test]
fn a_plan_tells_the_time_from_records() {
    let house = two_runs();
    let (_, out, _) = house.rockface(&["plan", "p.yaml", "--set", "steps.dem.with.cell_m=0.2"]);
    assert!(out.contains("of work, going by 1 steps of stages on record"), "{out}");
    let (_, out, _) = house.rockface(&["plan", "p.yaml"]);
    assert!(!out.contains("of work"), "{out}");
}

#[test]
fn a_repeated_run_has_the_texts_it_included() {
    let house = House::new("rockface: 1\nname: whole\ninclude: part.yaml\n");
    std::fs::write(house.path("part.yaml"), SMALL).unwrap();
    let (code, _, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    let manifest = house.path(".rockface/runs/latest/run.json").canonicalize().unwrap();
    assert_eq!(read_json(&manifest)["pipeline"]["included"][0]["text"], SMALL);
    std::fs::remove_file(house.path("part.yaml")).unwrap();
    std::fs::write(house.path("p.yaml"), "nothing").unwrap();
    let (code, out, err) = house.rockface(&["run", manifest.to_str().unwrap(), "--store", "another"]);
    assert!(code == Some(0) && out.contains("repeated: all 2 outputs are the same"), "{out}{err}");
}

#[test]
fn which_outputs_get_a_name_can_be_chosen() {
    let house = House::new(SMALL);
    let there = |outputs: &str| {
        let (code, _, err) = house.rockface(&["run", "p.yaml", "--outputs", outputs]);
        assert_eq!(code, Some(0), "{err}");
        let place = |file: &str| house.path(".rockface/runs/latest/outputs").join(file).is_file();
        let told = read_json(&house.path(".rockface/runs/latest/run.json"))["laid_out"].as_str().unwrap().to_owned();
        (place("face/mesh.ply"), place("dem/raster.tif"), told)
    };
    assert_eq!(there("auto"), (true, true, "all".to_owned()));
    assert_eq!(there("targets"), (false, true, "some".to_owned()));
    assert_eq!(there("none"), (false, false, "some".to_owned()));
    let (code, _, err) = house.rockface(&["export", "latest", "face.mesh", "face.ply"]);
    assert!(code == Some(0) && house.path("face.ply").is_file(), "{err}");
    assert_eq!(there("all"), (true, true, "all".to_owned()));
}

#[test]
fn an_export_has_the_format_of_its_name_and_replaces_none_but_exports() {
    let house = House::new(&format!(
        "{SMALL}  noise: {{stage: describe-noise, with: {{scales_cells: [1, 2, 4]}}, in: {{raster: dem.raster}}}}\ntargets: [noise]\n"
    ));
    let (code, _, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    let export = |output: &str, file: &str, more: &[&str]| {
        let (code, out, err) = house.rockface(&[&["export", "latest", output, file], more].concat());
        (code, format!("{out}{err}"))
    };
    std::fs::write(house.path("mine.tif"), "mine").unwrap();
    let (code, said) = export("dem.raster", "mine.tif", &[]);
    assert!(code == Some(2) && said.contains("no earlier export"), "{said}");
    assert_eq!(std::fs::read(house.path("mine.tif")).unwrap(), b"mine");
    for more in [&["--force"][..], &[], &["--plain"], &[]] {
        let (code, said) = export("dem.raster", "mine.tif", more);
        assert_eq!(code, Some(0), "{said}");
    }
    let (code, said) = export("dem.raster", "dem.asc", &[]);
    assert!(code == Some(2) && said.contains("outputs of kind raster are written as .tif, not as .asc"), "{said}");
    for _ in 0..2 {
        let (code, said) = export("noise.features", "noise.csv", &[]);
        assert!(code == Some(0) && house.path("noise.csv.provenance.json").is_file(), "{said}");
    }
    let origin = read_json(&house.path("noise.csv.provenance.json"));
    let run = read_json(&house.path(".rockface/runs/latest/run.json"));
    assert!(origin["seed"].is_u64() && origin["seed"] == run["seed"], "{origin}");
    assert!(std::fs::read_to_string(house.path("noise.csv")).unwrap().starts_with("raster,mean_m,"));
    for arguments in [&["run", "p.yaml", "--trace", "mine.txt"][..], &["report", "latest", "-o", "mine.txt"]] {
        std::fs::write(house.path("mine.txt"), "mine").unwrap();
        let (code, _, err) = house.rockface(arguments);
        assert!(code == Some(2) && err.contains("mine.txt is there and is no"), "{err}");
        assert_eq!(std::fs::read(house.path("mine.txt")).unwrap(), b"mine");
        std::fs::remove_file(house.path("mine.txt")).unwrap();
        for _ in 0..2 {
            let (code, _, err) = house.rockface(arguments);
            assert_eq!(code, Some(0), "{err}");
        }
    }
    let (code, said) = export("dem.raster", "new/", &[]);
    assert!(code == Some(0) && house.path("new/dem.raster.tif").is_file(), "{said}");
}

#[test]
fn what_reads_a_pipeline_takes_the_manifest_of_a_run() {
    let house = two_runs();
    for command in ["plan", "explain", "graph", "params"] {
        let step = (command == "explain").then_some("dem");
        let arguments: Vec<&str> = [command, ".rockface/runs/latest/run.json"].into_iter().chain(step).collect();
        let (code, out, err) = house.rockface(&arguments);
        assert!(code == Some(0) && !out.is_empty(), "{command}: {out}{err}");
    }
    let (_, out, err) = house.rockface(&["plan", ".rockface/runs/latest/run.json"]);
    assert!(out.contains("dem") && out.contains("face"), "{out}{err}");
}

#[test]
fn warnings_of_cached_steps_are_printed_again() {
    let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign/metashape-geographic.xml");
    let step = format!("{{stage: import-cameras, with: {{path: '{}'}}}}", file.display());
    let house = House::new(&format!("rockface: 1\nsteps:\n  read: {step}\n"));
    // Executed, remembered as a whole, and cached under another seed.
    for more in [&[][..], &[], &["--seed", "7"]] {
        let (code, _, err) = house.rockface(&[&["run", "p.yaml", "-q"], more].concat());
        assert_eq!(code, Some(0), "{err}");
        assert_eq!(err.matches("warning  read: the chunk is referenced").count(), 1, "{more:?} {err}");
    }
    let (_, out, _) = house.rockface(&["run", "p.yaml", "--json"]);
    let ended: Value = serde_json::from_str(last_line(&out)).unwrap();
    assert!(ended["warnings"][0].as_str().unwrap().contains("geocentric"), "{out}");
}

#[test]
fn outputs_of_very_many_points_stay_in_the_store() {
    if std::env::var_os("ROCKFACE_SLOW").is_none() {
        return;
    }
    let house = House::new(
        "rockface: 1\naxes: {k: {count: 1001}, j: {count: 600}}\nsteps:\n  base: {stage: import-table, with: {path: t.csv}}\n  \
         each: {stage: tabulate, over: [k], in: {rows: base.table}}\n  \
         few: {stage: tabulate, over: [j], in: {rows: base.table}}\n  \
         fewer: {stage: tabulate, over: [j], in: {rows: few.table}}\n  \
         all: {stage: tabulate, in: {rows: {each: each.table, over: [k]}}}\ntargets: [each, few, fewer, all]\n",
    );
    std::fs::write(house.path("t.csv"), "a\n1\n").unwrap();
    let (code, out, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(out.contains("1602 outputs are in the store only"), "{out}");
    let outputs = house.path(".rockface/runs/latest/outputs");
    let laid = ["all/table.csv", "few/j=599/table.csv", "each", "fewer"].map(|path| outputs.join(path).exists());
    assert_eq!(laid, [true, true, false, false]);
    let (code, _, err) = house.rockface(&["export", "latest", "each[k=7].table", "seven.json"]);
    assert!(code == Some(0) && house.path("seven.json").is_file(), "{err}");
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--outputs", "targets"]);
    assert!(code == Some(0) && house.path(".rockface/runs/latest/outputs/each/k=1000/table.csv").is_file(), "{err}");
}

/// A face in a file for each week, imported and gridded.
const WEEKS: &str = "rockface: 1
name: weeks
axes: {week: {items: [w1, w2, w3]}}
steps:
  face: {stage: import-mesh, with: {path: \"${week}.ply\"}}
  dem: {stage: rasterise-dem, in: {surface: face.mesh}, with: {cell_m: 0.2, method: tin}}
";

fn write_week(house: &House, name: &str, z: f64) {
    let head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\n";
    let text = format!(
        "{head}element face 2\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 {z}\n1 1 {z}\n3 0 1 2\n3 1 3 2\n"
    );
    std::fs::write(house.path(name), text).unwrap();
}

/// A house with three weeks that were run.
fn weeks() -> House {
    let house = House::new(WEEKS);
    for (week, z) in [("w1.ply", 0.1), ("w2.ply", 0.2), ("w3.ply", 0.3)] {
        write_week(&house, week, z);
    }
    let (code, _, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    house
}

#[test]
fn a_replaced_file_is_held_against_the_one_it_replaces() {
    let house = weeks();
    let former = read_json(&house.path(".rockface/runs/latest/run.json"));
    let is_third = |done: &&Value| done["step"] == "face" && done["point"]["week"] == "w3";
    let done = former["steps"].as_array().unwrap().iter().find(is_third).unwrap();
    let digest = done["files"][0]["blake3"].as_str().unwrap();
    write_week(&house, "w3.ply", 0.4);
    let (code, out, err) = house.rockface(&["explain", "p.yaml", "face[week=w3]"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(
        out.contains("which it had before") && out.contains(&format!("params.path.blake3: {}", &digest[..12])),
        "{out}"
    );
    // And runs say which file of which instance changed.
    let (code, _, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    let (code, out, err) = house.rockface(&["runs", "compare", "weeks~1", "weeks"]);
    assert_eq!(code, Some(0), "{err}");
    let told: Vec<&str> = out.lines().filter(|line| line.contains("blake3")).collect();
    assert!(
        told.len() == 1
            && told[0].contains("face[week=w3].path.blake3")
            && told[0].contains(&format!("w3.ply {}", &digest[..12])),
        "{out}"
    );
}

#[test]
fn results_of_a_file_that_is_gone_are_used_where_that_is_asked_for() {
    let house = weeks();
    std::fs::rename(house.path("w1.ply"), house.path("away")).unwrap();
    let (code, _, err) = house.rockface(&["run", "p.yaml"]);
    assert!(code == Some(2) && err.contains("--recorded-inputs") && err.contains("-weeks-"), "{err}");
    let recorded = ["run", "p.yaml", "--recorded-inputs"];
    let (code, out, err) = house.rockface(&recorded);
    assert!(code == Some(0) && last_line(&out).contains("ran 0, cached 6"), "{out}{err}");
    assert!(err.contains("w1.ply is not there") && err.contains("-weeks-"), "{err}");
    let (code, out, err) = house.rockface(&["explain", "p.yaml", "face[week=w1]", "--recorded-inputs"]);
    assert!(code == Some(0) && out.contains("face[week=w1] (import-mesh): hit"), "{out}{err}");
    // A week more: the others are cached, the run after it knows the file too.
    write_week(&house, "w4.ply", 0.5);
    std::fs::write(house.path("p.yaml"), WEEKS.replace("w3]", "w3, w4]")).unwrap();
    let (code, out, err) = house.rockface(&recorded);
    assert!(code == Some(0) && last_line(&out).contains("ran 2, cached 6"), "{out}{err}");
    let (code, out, err) = house.rockface(&recorded);
    assert!(code == Some(0) && last_line(&out).contains("ran 0, cached 8"), "{out}{err}");
    // What has to be read fails, and `plan` says so before.
    let set = "steps.face.with.unit_m=0.001";
    let (code, _, err) = house.rockface(&["plan", "p.yaml", "--recorded-inputs", "--set", set]);
    assert!(code == Some(0) && err.contains("face[week=w1] has to be computed and would fail"), "{err}");
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--recorded-inputs", "--keep-going", "--set", set]);
    assert!(code == Some(1) && err.contains("w1.ply` is not there, and this step has no result in the store"), "{err}");
}

#[test]
fn a_file_of_another_item_is_not_suggested() {
    let house = House::new(WEEKS);
    write_week(&house, "w2.ply", 0.2);
    write_week(&house, "w3.ply", 0.3);
    let (code, _, err) = house.rockface(&["plan", "p.yaml"]);
    assert!(code == Some(2) && err.contains("w1.ply") && !err.contains("did you mean"), "{err}");
    std::fs::rename(house.path("w3.ply"), house.path("w1_.ply")).unwrap();
    let (_, _, err) = house.rockface(&["plan", "p.yaml"]);
    assert!(err.contains("there is a `w1_.ply`"), "{err}");
}
