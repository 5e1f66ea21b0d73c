//! Every pipeline there is to read plans: the programs, the examples of the stages' pages, the YAML of the documentation.

use std::path::{Path, PathBuf};

use rockface_cache::Store;
use rockface_engine::pipeline::{Overrides, Pipeline};
use rockface_engine::plan::{Plan, plan, resolve};
use rockface_engine::watch::Event;

use crate::book::pages;
use crate::cli::House;
use crate::lab::Bench;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Plans a text as if it were a file of `folder`; with `files`, the files it names must be there.
fn check(text: &str, name: &str, folder: PathBuf, files: bool) -> Option<Plan> {
    let pipeline = Pipeline::parse(text, name, "example", folder, &overrides()).unwrap_or_else(|f| panic!("{f}"));
    if !files {
        resolve(&pipeline, &[], rockface_stages::registry().stages()).unwrap_or_else(|faults| panic!("{faults}"));
        return None;
    }
    let place = tempfile::tempdir().unwrap();
    let store = Store::open(&place.path().join("store")).unwrap();
    Some(plan(&pipeline, &[], rockface_stages::registry().stages(), &store).unwrap_or_else(|faults| panic!("{faults}")))
}

/// With the parts that come with the program.
fn overrides() -> Overrides {
    Overrides { parts: rockface_stages::registry().parts(), ..Overrides::default() }
}

fn names_files(text: &str) -> bool {
    text.contains("path:")
        || text.contains("${data}")
        || text.contains("module:")
        || text.contains("covariance: ${")
        || text.contains("covariance: \"")
}

#[test]
fn the_pipelines_plan() {
    let shared = root().join("../shared/data/outcrop-survey");
    let mut seen = 0;
    let folders = ["pipelines", "pipelines/paper"].map(|folder| root().join(folder));
    for entry in folders.iter().flat_map(|folder| std::fs::read_dir(folder).unwrap().flatten()) {
        let path = entry.path();
        if path.extension().is_none_or(|extension| extension != "yaml") {
            continue;
        }
        seen += 1;
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.starts_with("# "), "{}: say first what it shows, what it costs, what it makes", path.display());
        let there = shared.is_dir() || !text.contains("shared/data");
        if !there {
            println!("{}: names checked, files not: the shared data is not here", path.display());
        }
        check(&text, &path.display().to_string(), path.parent().unwrap().to_owned(), there);
    }
    assert!(seen >= 2);
}

#[test]
fn the_examples_of_the_pages_plan() {
    for stage in rockface_stages::registry().stages() {
        let example = stage.page().example();
        assert!(example.contains(stage.name()), "the example of `{}` does not use it", stage.name());
        check(example, stage.name(), root().to_owned(), !names_files(example));
    }
}

#[test]
fn the_examples_that_need_no_file_run() {
    let bench = Bench::rocks();
    let (mut ran, mut failures) = (0, Vec::new());
    for stage in rockface_stages::registry().stages().iter().filter(|stage| !names_files(stage.page().example())) {
        let result = bench.run(stage.page().example(), &[]);
        ran += 1;
        failures.extend(result.events.iter().filter_map(|event| match event {
            Event::Failed { message, .. } => Some(format!("the example of `{}` fails: {message}", stage.name())),
            _ => None,
        }));
    }
    assert!(failures.is_empty(), "{failures:#?}");
    assert!(ran >= 10, "only {ran} examples need no file");
}

#[test]
fn the_yaml_of_the_documentation_plans() {
    let mut seen = 0;
    let outside = ["README.md", "ARCHITECTURE.md", "CHANGELOG.md"];
    let outside = outside.map(|name| (name.into(), std::fs::read_to_string(root().join(name)).unwrap()));
    for (document, text) in pages().into_iter().chain(outside) {
        let document = document.to_str().unwrap();
        for block in text.split("```yaml\n").skip(1).filter_map(|rest| rest.split("```").next()) {
            seen += 1;
            assert!(block.contains("rockface: 1"), "{document}: a YAML block is not a whole pipeline:\n{block}");
            check(block, document, root().to_owned(), !names_files(block));
        }
    }
    assert!(seen > 0);
}

#[test]
fn the_pipelines_of_the_book_that_need_no_file_run() {
    // The examples of the stages are run elsewhere, those of the language are small and alike.
    let mine = pages().into_iter().filter(|(path, _)| !path.starts_with("reference"));
    let texts: Vec<String> = mine.map(|(_, text)| text).collect();
    let blocks =
        texts.iter().flat_map(|text| text.split("```yaml\n").skip(1).filter_map(|rest| rest.split("```").next()));
    let mut ran = 0;
    for block in blocks.filter(|block| !names_files(block)) {
        let house = House::new(block);
        let (code, _, err) = house.rockface(&["run", "p.yaml"]);
        assert_eq!(code, Some(0), "{block}\n{err}");
        ran += 1;
    }
    assert!(ran >= 6);
}

#[test]
fn the_commands_of_the_page_about_sweeps_work() {
    let rest = std::fs::read_to_string(root().join("docs/how-to/sweep.md")).unwrap();
    let house = House::new(rest.split("```yaml\n").nth(1).and_then(|rest| rest.split("```").next()).unwrap());
    let (sweep, output) = ("cell_m=0.05..0.2:7", "dem[cell_m=0.1,trial=3].raster");
    assert!(rest.contains(&format!("--sweep {sweep}\n")) && rest.contains(&format!("export RUN '{output}' dem.tif")));
    for arguments in [&["run", "p.yaml", "--sweep", sweep][..], &["run", "p.yaml"]] {
        let (code, _, err) = house.rockface(arguments);
        assert_eq!(code, Some(0), "{err}");
    }
    let (code, _, err) = house.rockface(&["export", "latest", output, "dem.tif"]);
    assert!(code == Some(0) && house.path("dem.tif").is_file(), "{err}");
}

#[test]
fn the_covariance_of_the_page_about_projects_is_read() {
    let page = std::fs::read_to_string(root().join("docs/how-to/metashape-and-colmap.md")).unwrap();
    let covariance = page.split("```json\n").nth(1).and_then(|rest| rest.split("```").next()).unwrap();
    let house = House::new(
        "rockface: 1\nseed: 1\nsteps:\n  rig: {stage: import-cameras, with: {path: cameras.json, covariance: covariance.json}}\n  \
         noisy: {stage: perturb-cameras, in: {cameras: rig.cameras, covariance: rig.covariance}}\n",
    );
    let image = |name: &str, x: f64| serde_json::json!({"name": name, "sensor": "s", "q_wxyz": [0.0, 1.0, 0.0, 0.0], "C": [x, 0.0, 20.0]});
    let sensor = serde_json::json!({"id": "s", "width": 160, "height": 120, "f": 200.0, "cx": 79.5, "cy": 59.5});
    let cameras =
        serde_json::json!({"sensors": [sensor], "images": [image("IMG_7.JPG", -2.0), image("IMG_8.JPG", 2.0)]});
    std::fs::write(house.path("cameras.json"), cameras.to_string()).unwrap();
    std::fs::write(house.path("covariance.json"), covariance).unwrap();
    let (code, out, err) = house.rockface(&["run", "p.yaml"]);
    assert!(code == Some(0) && !err.contains("warning"), "{out}{err}");
}

#[test]
fn every_page_is_complete() {
    for stage in rockface_stages::registry().stages() {
        let (name, page) = (stage.name(), stage.page());
        for (heading, text) in
            [("what", page.what()), ("method", page.method()), ("frames", page.frames()), ("fails", page.fails())]
        {
            assert!(text.len() > 20, "`{name}` says too little under `{heading}`");
        }
        assert!(stage.outputs().iter().all(|port| port.kinds.len() == 1), "`{name}`: an output has one kind");
        for field in stage.fields() {
            assert!(field.doc.len() > 3, "`{name}`: parameter `{}` has no doc", field.name);
        }
    }
}

/// The page of the language names every key the reader knows, in the table of its section.
#[test]
fn the_page_of_the_language_has_every_key() {
    use rockface_engine::pipeline::keys;
    let page = std::fs::read_to_string(root().join("docs/language.md")).unwrap();
    let section = |title: &str| {
        let start = page.find(&format!("\n## {title}\n")).unwrap_or_else(|| panic!("no section {title}"));
        let rest = &page[start + 4..];
        rest[..rest.find("\n## ").unwrap_or(rest.len())].to_owned()
    };
    for (title, keys) in [
        ("The file", keys::TOP),
        ("Steps", keys::STEP),
        ("Axes", keys::AXIS),
        ("Parameters", keys::PARAMETER),
        ("Parts", keys::USE),
        ("Parts", keys::PART),
    ] {
        let text = section(title);
        for key in keys {
            let named = [format!("`{key}`"), format!("{{{key}: "), format!("`{key}: "), format!(", {key}: ")];
            assert!(named.iter().any(|form| text.contains(form)), "docs/language.md, {title}: nothing of `{key}`");
        }
    }
    for (_, word) in rockface_engine::pipeline::ValueKind::WORDS {
        assert!(section("Parameters").contains(&format!("`{word}`")), "{word}");
    }
}

#[test]
fn every_part_that_ships_reads_and_is_used_somewhere() {
    let parts = rockface_stages::registry().parts();
    let folders = ["pipelines", "pipelines/paper", "pipelines/parts", "src/cli/templates"];
    let files = folders.iter().flat_map(|folder| std::fs::read_dir(root().join(folder)).unwrap().flatten());
    let texts: Vec<String> = files.filter_map(|file| std::fs::read_to_string(file.path()).ok()).collect();
    for part in parts {
        let about = Pipeline::part(part.name, parts).unwrap_or_else(|faults| panic!("{faults}"));
        assert!(!about.doc.is_empty() && about.params.iter().all(|param| !param.doc.is_empty()), "{}", part.name);
        assert!(texts.iter().any(|text| text.contains(&format!("use: {}", part.name))), "nothing uses {}", part.name);
    }
    assert!(parts.len() >= 8);
}

#[test]
fn the_templates_plan() {
    for file in std::fs::read_dir(root().join("src/cli/templates")).unwrap().flatten() {
        let text = std::fs::read_to_string(file.path()).unwrap();
        check(&text, &file.path().display().to_string(), root().to_owned(), !names_files(&text));
    }
}
