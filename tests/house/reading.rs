//! The commands that read the state of things: `plan`, `explain`, `graph`, `stages`, `completions`.

use serde_json::Value;

use crate::cli::{House, SMALL, last_line};

/// A face, two sweeps of its raster, and their difference.
const SWEPT: &str = "# Rasters of a face.
rockface: 1
name: swept
seed: 1
axes: {cell: {values: [0.05, 0.1]}}
steps:
  face: {stage: synthesise-face, keep: false, with: {width_m: 2, height_m: 1.5, spacing_m: 0.05}}
  dem: {stage: rasterise-dem, in: {surface: face.mesh}, with: {cell_m: \"${cell}\", method: tin}}
  table: {stage: describe-noise, with: {scales_cells: [1, 2, 4]}, in: {raster: dem.raster}}
targets: [dem]
";

fn json(house: &House, arguments: &[&str]) -> Value {
    let (code, out, err) = house.rockface(arguments);
    assert_eq!(code, Some(0), "{err}");
    serde_json::from_str(&out).unwrap()
}

/// `path: old -> new` of every change of one cause.
fn changes(cause: &Value) -> Vec<String> {
    let change =
        |change: &Value| format!("{}: {} -> {}", change["path"].as_str().unwrap(), change["old"], change["new"]);
    cause["changes"].as_array().unwrap().iter().map(change).collect()
}

#[test]
fn explain_prints_the_very_recipe_that_is_the_key() {
    let house = House::new(SMALL);
    house.rockface(&["run", "p.yaml"]);
    let told = json(&house, &["explain", "p.yaml", "dem", "--json"]);
    assert_eq!((told["asked"]["answer"].as_str(), told["causes"].as_array().unwrap().len()), (Some("hit"), 0));
    let text = told["recipe_text"].as_str().unwrap();
    assert_eq!(told["key"], rockface_cache::Digest::of(text.as_bytes()).to_string());
    assert_eq!(serde_json::from_str::<Value>(text).unwrap(), told["recipe"]);
    let manifest = std::fs::read_to_string(house.path(".rockface/runs/latest/run.json")).unwrap();
    assert!(manifest.contains(told["key"].as_str().unwrap()));
    let (_, out, _) = house.rockface(&["explain", "p.yaml", "dem"]);
    assert!(out.starts_with("dem (rasterise-dem): hit\nkey ") && out.contains("\"cell_m\": 0.05"), "{out}");
}

#[test]
fn explain_names_what_changed() {
    let house = House::new(SMALL);
    house.rockface(&["run", "p.yaml"]);
    let set = ["explain", "p.yaml", "dem", "--set", "steps.dem.with.cell_m=0.1"];
    let (code, out, err) = house.rockface(&set);
    assert_eq!(code, Some(0), "{err}");
    assert!(out.starts_with("dem (rasterise-dem): runs, no record has this recipe\n"), "{out}");
    assert!(out.ends_with("\n  params.cell_m: 0.05 -> 0.1\n"), "{out}");
    let run = std::fs::read_link(house.path(".rockface/runs/latest")).unwrap().display().to_string();
    assert!(out.contains(&format!("… (in run {run}), which it had before")), "{out}");
    assert_eq!(json(&house, &[&set[..], &["--json"]].concat())["causes"][0]["former_run"], run);
    let (_, out, _) = house.rockface(&[&set[..], &["--runs", "elsewhere"]].concat());
    assert!(out.contains("… (no run folder names it), the closest"), "{out}");
    let (_, plan, _) = house.rockface(&["plan", "p.yaml", "--set", "steps.dem.with.cell_m=0.1"]);
    assert!(plan.contains("no record has this recipe"), "{plan}");
}

#[test]
fn explain_follows_a_changed_input_to_the_root_cause() {
    let house = House::new(SMALL);
    house.rockface(&["run", "p.yaml"]);
    let other = ["--set", "steps.face.with.width_m=3"];
    // The changed face has not run: it is what is explained.
    let told = json(&house, &[&["explain", "p.yaml", "dem", "--json"][..], &other].concat());
    assert_eq!((&told["asked"]["answer"], &told["asked"]["why"]), (&"depends".into(), &"waits for face".into()));
    assert_eq!((&told["explained"]["step"], &told["explained"]["answer"]), (&"face".into(), &"runs".into()));
    assert_eq!(changes(&told["causes"][0]), ["params.width_m: 2.0 -> 3.0"]);
    // It has run, its consumer has not: two links lead to the cause.
    house.rockface(&[&["run", "p.yaml", "--target", "face"][..], &other].concat());
    let told = json(&house, &[&["explain", "p.yaml", "dem", "--json"][..], &other].concat());
    assert_eq!(told["asked"]["answer"], "runs");
    let first = changes(&told["causes"][0]);
    assert!(first.len() == 1 && first[0].starts_with("inputs.surface: "), "{first:?}");
    assert_eq!(told["causes"][1]["step"], "face");
    assert_eq!(changes(&told["causes"][1]), ["params.width_m: 2.0 -> 3.0"]);
    let (_, out, _) = house.rockface(&[&["explain", "p.yaml", "dem"][..], &other].concat());
    assert!(out.contains("… (from face, port mesh)\n") && out.ends_with("  params.width_m: 2.0 -> 3.0\n"), "{out}");
}

#[test]
fn explain_follows_a_gathered_input_through_several_steps() {
    let sweep = "axes: {relief: {values: [0.1, 0.2]}}";
    let yaml = SMALL
        .replace("seed: 1\n", &format!("seed: 1\n{sweep}\n"))
        .replace("width_m: 2", "relief_m: \"${relief}\", width_m: 2")
        + "  stat: {stage: describe-noise, with: {scales_cells: [1, 2, 4]}, in: {raster: dem.raster}}\n"
        + "  all: {stage: tabulate, in: {rows: {each: stat.features, over: [relief]}}}\n";
    let house = House::new(&yaml);
    let (code, _, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    let set = ["--set", "steps.dem.with.method=mean"];
    house.rockface(&[&["run", "p.yaml", "--target", "stat"][..], &set].concat());
    let told = json(&house, &[&["explain", "p.yaml", "all", "--json"][..], &set].concat());
    let causes = told["causes"].as_array().unwrap();
    let steps: Vec<&str> = causes.iter().map(|cause| cause["step"].as_str().unwrap()).collect();
    assert_eq!(steps, ["all", "stat", "dem"]);
    let paths: Vec<&str> =
        causes[0]["changes"].as_array().unwrap().iter().map(|change| change["path"].as_str().unwrap()).collect();
    assert_eq!(paths, ["inputs.rows[relief=0.1]", "inputs.rows[relief=0.2]"]);
    assert_eq!(causes[2]["point"]["relief"], "0.1");
    assert_eq!(changes(&causes[2]), ["params.method: \"tin\" -> \"mean\""]);
}

#[test]
fn explain_compares_with_the_most_like_record_and_agrees_with_plan() {
    let house = House::new(SWEPT);
    let (_, out, _) = house.rockface(&["explain", "p.yaml", "face"]);
    assert!(out.contains("no record of stage `synthesise-face` exists"), "{out}");
    house.rockface(&["run", "p.yaml"]);
    // Two components away from one point, one from the other.
    let set = ["--set", "axes.cell.values=[0.05, 0.2]", "--set", "steps.dem.with.method=mean"];
    let point = "dem[cell=0.05]";
    let told = json(&house, &[&["explain", "p.yaml", point, "--json"][..], &set].concat());
    assert_eq!(told["causes"][0]["records"], 2);
    assert_eq!(changes(&told["causes"][0]), ["params.method: \"tin\" -> \"mean\""]);
    // The face is recorded and not kept: it runs for its values.
    let (_, out, _) = house.rockface(&[&["explain", "p.yaml", "face"][..], &set].concat());
    assert!(out.starts_with("face (synthesise-face): runs, its values are needed\n"), "{out}");
    let (_, out, _) = house.rockface(&["explain", "p.yaml", "face", "--set", "steps.face.keep=true"]);
    assert!(out.starts_with("face (synthesise-face): runs, its outputs were not kept and now are to be\n"), "{out}");
    // No target needs the table; it can be explained all the same.
    let (code, out, err) = house.rockface(&["explain", "p.yaml", "table[cell=0.1]"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(out.contains("no record of stage `describe-noise` exists"), "{out}");
}

#[test]
fn explain_asks_for_a_point_and_says_which_there_are() {
    let house = House::new(SWEPT);
    let (code, _, err) = house.rockface(&["explain", "p.yaml", "dem"]);
    assert_eq!(code, Some(2));
    assert!(err.contains("2 instances that fit") && err.contains("'dem[cell=0.05]'\n  'dem[cell=0.1]'"), "{err}");
    for (step, expected) in [
        ("dem[cell=7]", "no instance at [cell=7]; it has:"),
        ("dem[cell", "STEP[axis=item,...]"),
        ("deem", "did you mean `dem`?"),
    ] {
        let (code, _, err) = house.rockface(&["explain", "p.yaml", step]);
        assert_eq!(code, Some(2));
        assert!(err.contains(expected), "{err}");
    }
}

#[test]
fn graph_folds_sweeps_and_marks_targets_and_what_is_not_kept() {
    let house = House::new(SWEPT);
    let (code, out, err) = house.rockface(&["graph", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    let line = |needle: &str| out.lines().find(|line| line.contains(needle)).unwrap_or_else(|| panic!("{out}"));
    assert!(out.starts_with("digraph {") && out.ends_with("}\n"), "{out}");
    assert!(line("rasterise-dem").contains(r"dem\lrasterise-dem\l2 instances over cell\l"), "{out}");
    assert!(line("rasterise-dem").contains("peripheries=2") && !line("rasterise-dem").contains("dashed"), "{out}");
    assert!(line("synthesise-face").contains("style=dashed") && !line("synthesise-face").contains("instances"));
    assert!(line("describe-noise").contains("gray") && line("describe-noise").contains("0 instances"), "{out}");
    assert!(line("0 -> 1").contains(r#"label = "mesh → surface""#), "{out}");
    assert!(line("1 -> 2").contains(r#"label = "raster""#), "{out}");
    let (_, out, _) = house.rockface(&["graph", "p.yaml", "--format", "mermaid", "--target", "table"]);
    let expected = "flowchart LR
  s0[\"face<br/>synthesise-face\"]
  style s0 stroke-dasharray: 5 5
  s1[\"dem<br/>rasterise-dem<br/>2 instances over cell\"]
  s2[[\"table<br/>describe-noise<br/>2 instances over cell\"]]
  s0 -->|\"mesh → surface\"| s1
  s1 -->|\"raster\"| s2
";
    assert_eq!(out, expected);
    assert!(!house.path(".rockface").exists(), "drawing makes nothing on disk");
}

#[test]
fn graph_tells_choices_picks_and_gathering() {
    let yaml = SWEPT
        .replace("raster: dem.raster}", "raster: \"dem.raster[cell=0.1]\"}")
        .replace("targets: [dem]", "  all: {stage: tabulate, in: {rows: {each: own.features, over: [cell]}}}")
        .replace(
            "  table:",
            "  own: {stage: describe-noise, with: {scales_cells: [1, 2, 4]}, in: {raster: {by: cell, 0.05: dem.raster, 0.1: dem.raster}}}\n  table:",
        );
    let (code, out, err) = House::new(&yaml).rockface(&["graph", "p.yaml", "--format", "mermaid"]);
    assert_eq!(code, Some(0), "{err}");
    for arrow in ["raster[cell=0.1] → raster", "raster (cell=0.05|0.1)", "features → rows (each cell)"] {
        assert!(out.contains(&format!("|\"{arrow}\"|")), "{arrow}: {out}");
    }
}

#[test]
fn completions_ask_the_program_for_commands() {
    let house = House::new(SMALL);
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let (code, out, _) = house.rockface(&["completions", shell]);
        assert_eq!(code, Some(0));
        assert!(out.contains("rockface") && out.contains("ROCKFACE_COMPLETE"), "{shell}: {out}");
    }
    assert_eq!(house.rockface(&["completions", "tcsh"]).0, Some(2));
    let asked = house.command(&["--", "rockface", "ex"]).env("ROCKFACE_COMPLETE", "fish").output().unwrap();
    let offered = String::from_utf8(asked.stdout).unwrap();
    assert!(offered.contains("explain\t") && offered.contains("export\t"), "{offered}");
}

#[test]
fn a_run_with_little_memory_makes_the_same() {
    let raster = |arguments: &[&str]| {
        let house = House::new(&SMALL.replace("face: {", "face: {keep: false, "));
        let (code, _, err) = house.rockface(arguments);
        assert_eq!(code, Some(0), "{err}");
        std::fs::read(house.path(".rockface/runs/latest/outputs/dem/raster.tif")).unwrap()
    };
    assert_eq!(raster(&["run", "p.yaml", "--memory", "0.000001"]), raster(&["run", "p.yaml"]));
    for wrong in ["0", "-1", "nan", "4 cows", "1e300"] {
        let (code, _, err) = House::new(SMALL).rockface(&["run", "p.yaml", &format!("--memory={wrong}")]);
        assert_eq!(code, Some(2));
        assert!(err.contains("GiB"), "{err}");
    }
}

#[test]
fn graph_draws_a_picture_with_sweeps_folded() {
    let house = House::new(&SWEPT.replace("name: dem", "name: \"<dem>\""));
    let (code, out, err) = house.rockface(&["graph", "p.yaml", "--format", "svg"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(out.starts_with("<svg xmlns=") && out.ends_with("</svg>\n"), "{out}");
    for part in ["2 × cell", ">rasterise-dem<", "prefers-color-scheme:dark", "bold frame: target", "mesh → surface"]
    {
        assert!(out.contains(part), "{part}: {out}");
    }
    assert_eq!(out.matches("<g class=").count(), 3, "one box a step: {out}");
    assert!(!out.contains("url(") && !out.contains(" id="), "it may stand in any page: {out}");
    assert!(!house.path(".rockface").exists(), "drawing makes nothing on disk");
}

/// Items that a step makes, and steps over them.
const LISTED: &str = "rockface: 1
axes: {row: {from: pts.table}}
steps:
  pts: {stage: import-table, with: {path: t.csv}}
  each: {stage: tabulate, over: [row], in: {rows: pts.table}}
  all: {stage: tabulate, in: {rows: {each: each.table, over: [row]}}}
";

#[test]
fn what_is_over_items_that_are_not_known_says_who_makes_them() {
    let house = House::new(LISTED);
    std::fs::write(house.path("t.csv"), "item\np1\np2\n").unwrap();
    for step in ["each[row=p1]", "each", "all"] {
        let (code, _, err) = house.rockface(&["explain", "p.yaml", step]);
        let expected = "the items of axis `row` are made by step `pts`, which has not run";
        assert!(code == Some(2) && err.contains(expected) && err.contains("or explain `pts`"), "{err}");
    }
    let (code, out, err) = house.rockface(&["explain", "p.yaml", "pts"]);
    assert!(code == Some(0) && out.starts_with("pts (import-table): runs"), "{out}{err}");
}

#[test]
fn a_plan_says_which_times_are_not_known() {
    let house = House::new(LISTED);
    std::fs::write(house.path("t.csv"), "item\np1\np2\n").unwrap();
    let plan = |set: &str| house.rockface(&["plan", "p.yaml", "--set", set]).1;
    let out = plan("steps.pts.with.path=t.csv");
    assert!(
        out.contains("how long 1 steps take is not known: no step of these stages is on record (1 of import-table)"),
        "{out}"
    );
    assert!(out.contains("not counted: 2 steps over axis `row`, whose items are not known yet"), "{out}");
    assert!(out.contains("each item adds 1 steps of unknown length") && !out.contains("of work"), "{out}");
    let (code, _, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    std::fs::write(house.path("u.csv"), "item\np3\n").unwrap();
    // The same stages are on record; the items of the other list are still made by a step that has not run.
    let out = plan("steps.pts.with.path=u.csv");
    assert!(out.contains("of work, going by 1 steps of stages on record, and what is not known yet"), "{out}");
    assert!(out.contains("not counted: 2 steps over axis `row`") && out.contains("each item adds about"), "{out}");
}

#[test]
fn graph_counts_items_that_are_on_record() {
    let house = House::new(LISTED);
    std::fs::write(house.path("t.csv"), "item\np1\np2\n").unwrap();
    let drawn = || house.rockface(&["graph", "p.yaml", "--store", "store"]).1;
    assert!(drawn().contains("unknown instances over row") && !house.path("store").exists());
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--store", "store", "--target", "pts"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(drawn().contains("2 instances over row"), "{}", drawn());
    // A missing file is no reason not to draw.
    std::fs::remove_file(house.path("t.csv")).unwrap();
    assert!(drawn().contains("unknown instances over row"), "{}", drawn());
}

#[test]
fn graph_draws_for_a_target_what_it_needs() {
    let house = House::new(SWEPT);
    let told = json(&house, &["graph", "p.yaml", "--target", "dem", "--json"]);
    let steps: Vec<&str> = told["nodes"].as_array().unwrap().iter().map(|n| n["step"].as_str().unwrap()).collect();
    assert_eq!(steps, ["face", "dem"]);
    assert_eq!((&told["nodes"][1]["instances"], &told["nodes"][1]["axes"][0]), (&2.into(), &"cell".into()));
    let edge = &told["edges"].as_array().unwrap()[..];
    let ends = |edge: &Value| ["from", "output", "to", "input"].map(|key| edge[key].as_str().unwrap().to_owned());
    assert_eq!(edge.iter().map(ends).collect::<Vec<_>>(), [["face", "mesh", "dem", "surface"]]);
    assert_eq!(told, json(&house, &["graph", "p.yaml", "--target", "dem", "--format", "json"]));
}

#[test]
fn stages_are_told_to_programs() {
    let house = House::new(SMALL);
    let all = json(&house, &["stages", "--json"]);
    assert_eq!(all.as_array().unwrap().len(), rockface_stages::registry().stages().len());
    let one = json(&house, &["stages", "rasterise-dem", "--json"]);
    assert!(all.as_array().unwrap().contains(&one));
    assert_eq!(one["outputs"][0]["kinds"], serde_json::json!(["raster"]));
    assert!(one["version"].is_u64() && one["parameters"]["properties"]["cell_m"]["default"].is_number(), "{one}");
}

/// A sweep whose values are not kept, gathered at the end.
const UNKEPT: &str = "rockface: 1
axes: {relief: {values: [0.1, 0.2]}}
steps:
  face: {stage: synthesise-face, keep: false, with: {width_m: 2, height_m: 1.5, spacing_m: 0.05, relief_m: \"${relief}\"}}
  dem: {stage: rasterise-dem, keep: false, in: {surface: face.mesh}, with: {cell_m: 0.05, method: tin}}
  stat: {stage: describe-noise, keep: false, with: {scales_cells: [1, 2, 4]}, in: {raster: dem.raster}}
  all: {stage: tabulate, in: {rows: {each: stat.features, over: [relief]}}}
";

#[test]
fn a_plan_counts_what_may_have_to_be_made_again() {
    let house = House::new(UNKEPT);
    house.rockface(&["run", "p.yaml"]);
    let more = ["p.yaml", "--sweep", "relief=0.1,0.2,0.3"];
    let (_, out, _) = house.rockface(&[&["plan"][..], &more].concat());
    assert!(out.contains("its values may be needed by "), "{out}");
    assert_eq!(last_line(&out), "0 hit, 1 run, 9 depend on what runs");
    let told = json(&house, &["explain", more[0], "dem[relief=0.1]", more[1], more[2], "--json"]);
    assert_eq!((&told["asked"]["answer"], &told["explained"]["step"]), (&"depends".into(), &"dem".into()));
    let (_, out, _) = house.rockface(&[&["run"][..], &more].concat());
    assert!(last_line(&out).contains("ran 10, cached 0"), "{out}");
}

#[test]
fn a_plan_knows_equal_recipes() {
    let house = House::new(LISTED);
    std::fs::write(house.path("t.csv"), "item\np1\np2\np3\n").unwrap();
    house.rockface(&["run", "p.yaml", "--target", "pts"]);
    let each = ["p.yaml", "--target", "each"];
    let (_, out, _) = house.rockface(&[&["plan"][..], &each].concat());
    assert_eq!(last_line(&out), "3 hit, 1 run, 0 depend on what runs");
    let told = json(&house, &[&["plan"][..], &each, &["--json"]].concat());
    let why: Vec<&str> = told.as_array().unwrap().iter().filter_map(|told| told["why"].as_str()).collect();
    assert_eq!(why, ["no record has this recipe", "the same as each[row=p1]", "the same as each[row=p1]"]);
    let (_, out, _) = house.rockface(&["explain", "p.yaml", "each[row=p2]"]);
    assert!(out.starts_with("each[row=p2] (tabulate): hit, the same as each[row=p1]\nkey "), "{out}");
    let (_, out, _) = house.rockface(&[&["run"][..], &each].concat());
    assert!(last_line(&out).contains("ran 1, cached 3"), "{out}");
}

#[test]
fn a_plan_tells_the_times_of_programs_apart() {
    let step = |name: &str, sleep_s: f64| {
        let arguments = format!("[\"-c\", \"sleep {sleep_s}; echo {{param.n}} > {{out.text}}\"]");
        let rest = "outputs: {text: {kind: file, extension: txt}}, params: {n: 1}, version: sh";
        format!("  {name}: {{stage: command, with: {{program: sh, args: {arguments}, {rest}}}}}\n")
    };
    let house = House::new(&format!("rockface: 1\nsteps:\n{}{}", step("slow", 0.4), step("quick", 0.0)));
    let (code, _, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    let set = ["--set", "steps.slow.with.params.n=2", "--set", "steps.quick.with.params.n=2"];
    let told = json(&house, &[&["plan", "p.yaml", "--json"][..], &set].concat());
    let seconds = |step: &str| {
        let told = told.as_array().unwrap().iter().find(|told| told["step"] == step).unwrap();
        told["estimate_s"].as_f64().unwrap()
    };
    assert!(seconds("slow") >= 0.4 && seconds("quick") < seconds("slow"), "{told}");
}

#[test]
fn what_cannot_be_written_is_told() {
    let Ok(full) = std::fs::OpenOptions::new().write(true).open("/dev/full") else { return };
    let house = House::new(SMALL);
    let done = house.command(&["plan", "p.yaml", "--json"]).stdout(full).output().unwrap();
    let err = String::from_utf8(done.stderr).unwrap();
    assert!(done.status.code() == Some(3) && err.contains("cannot write to standard output"), "{err}");
}
