//! What a report shows, of a manifest made by hand.

use serde_json::json;

use super::*;
use rockface_engine::history::Manifest;

/// A manifest of one step with two instances, in a folder with the table it made.
fn manifest() -> Manifest {
    let step = |trial: &str, value: f64| {
        json!({
            "step": "noise", "point": {"trial": trial}, "stage": "describe-noise", "version": 3, "status": "executed",
            "key": null, "outputs": {}, "cost": {"wall_s": 1.25, "cpu_s": 2.0, "peak_bytes": 10, "finished_unix_s": 0},
            "parameters": {"cell_m": 0.1 + 0.2, "name": "<script>alert(1)</script>"},
            "metrics": [{"name": "sill", "value": value, "unit": "m2"}],
        })
    };
    serde_json::from_value(json!({
        "format": 1, "pipeline": {"name": "p & q", "path": "p.yaml", "text": "steps: {}\n</pre><script>alert(2)</script>"},
        "overrides": {"set": ["a=<b>"], "seed": null}, "seed": 7, "finished": "2026-11-21T19:05:19Z", "wall_s": 3.5, "jobs": 2,
        "status": "done", "program": {"rockface": "0.1.0"}, "headlines": ["noise[trial=0]: all is <well>"],
        "steps": [step("0", 1.0 / 3.0), step("1", 2.5e-7)],
    }))
    .unwrap()
}

fn page() -> String {
    let (manifest, folder) = (manifest(), Path::new("/nowhere"));
    let run = RunContents { folder, manifest: &manifest, store: None, graph: None, logs: None };
    html(&Source { run, look: rockface_core::Registry::default().look() }, Links::Relative).unwrap()
}

#[test]
fn what_users_write_is_text_and_nothing_else() {
    let page = page();
    assert_eq!(page.matches("<script").count(), 1, "only the page's own");
    for expected in ["p &amp; q", "all is &lt;well&gt;", "--set a=&lt;b&gt;", "&lt;&#x2f;pre&gt;"] {
        assert!(page.contains(expected), "{expected}");
    }
}

#[test]
fn a_browser_runs_the_script_of_the_page_and_no_other() {
    let page = page();
    let script = page.split_once("<script>").unwrap().1.split_once("</script>").unwrap().0;
    let digest = base64::engine::general_purpose::STANDARD.encode(Sha256::digest(script));
    let policy = page.split_once("Content-Security-Policy\" content=\"").unwrap().1.split_once('"').unwrap().0;
    assert!(policy.starts_with("default-src 'none';"), "{policy}");
    assert!(policy.contains(&format!("; script-src 'sha256-{digest}';")), "{policy}");
    assert!(page.find("Content-Security-Policy") < page.find("<style"), "it holds for all that comes after it");
    for (name, text) in TEMPLATES {
        let handler = text.split(' ').find(|word| word.starts_with("on") && word.contains("=\""));
        assert!(handler.is_none() && !text.contains("javascript:"), "{name}: {handler:?} would not run");
    }
}

#[test]
fn numbers_are_those_of_the_manifest() {
    let page = page();
    for exact in [1.0 / 3.0, 2.5e-7, 0.1 + 0.2] {
        let digits = serde_json::to_string(&exact).unwrap();
        assert!(page.contains(&format!("<data value=\"{digits}\"")), "{digits}");
    }
    assert!(page.contains(">0.33333<") && page.contains("ran 2"), "short ones are shown");
}

#[test]
fn a_page_needs_nothing_from_elsewhere() {
    let page = page();
    let loads = ["http://", "https://", "src=\"/", "@import", "url("];
    for part in loads {
        let found = page.match_indices(part).map(|(at, _)| &page[at..page.len().min(at + 60)]);
        let foreign: Vec<&str> = found.filter(|text| !text.starts_with("http://www.w3.org/2000/svg")).collect();
        assert!(foreign.is_empty(), "{foreign:?}");
    }
    assert!(page.contains("prefers-color-scheme:dark") && page.contains("@media print"));
}

#[test]
fn runs_side_by_side_tell_what_differs() {
    let one = rockface_engine::history::PastRun {
        name: "one".into(),
        folder: "/nowhere".into(),
        manifest: manifest(),
        pinned: false,
    };
    let mut other = one.clone();
    other.name = "other".into();
    other.manifest.steps[1].parameters = json!({"cell_m": 0.5, "name": "x"}).into();
    let page = comparison(&[one, other], None, rockface_core::Registry::default().look()).unwrap();
    assert!(page.contains("noise.cell_m") && page.contains("noise[trial=0].sill") && page.contains("other"));
}

#[test]
fn files_outside_of_the_run_folder_are_none_of_the_runs() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    std::fs::create_dir(&run).unwrap();
    std::fs::write(folder.path().join("private"), "x").unwrap();
    std::fs::write(run.join("own"), "x").unwrap();
    let manifest = manifest();
    let run = RunContents { folder: &run, manifest: &manifest, store: None, graph: None, logs: None };
    let source = Source { run, look: rockface_core::Registry::default().look() };
    let has = |path: &Path| source.file(path).is_some();
    assert!(has(Path::new("own")) && has(Path::new("./own")));
    assert!(!has(Path::new("../private")) && !has(&folder.path().join("private")) && !has(Path::new("/dev/zero")));
}
