//! What beginners get wrong, and the first line they are told; `docs/troubleshooting.md` has the same lines.

use crate::cli::House;

const RIGHT: &str = r#"rockface: 1
name: small
seed: 1
params: {cell_m: 0.05}
axes:
  epoch: {items: [pre, post]}
steps:
  face: {stage: synthesise-face, over: [epoch], with: {width_m: 2, height_m: 1.5, spacing_m: 0.05}}
  dem: {stage: rasterise-dem, in: {surface: face.mesh}, with: {cell_m: "${cell_m}", method: tin}}
  change: {stage: difference-dem, in: {reference: "dem.raster[epoch=pre]", comparison: "dem.raster[epoch=post]"}}
"#;

/// What is written in place of what, the first line that is said, and how many faults are told in all.
const MISTAKES: [(&str, &str, &str, usize); 26] = [
    (
        "\"dem.raster[epoch=pre]\"",
        "dem.raster[epoch=pre]",
        "`dem.raster[epoch=pre]` without quotes cannot stand between braces or brackets",
        1,
    ),
    ("  dem:", "\tdem:", "line 9 is indented with a tab, and YAML takes spaces only", 1),
    ("steps:", "step:", "unknown key `step` in the pipeline", 1),
    ("rockface: 1\n", "", "the format version is missing", 1),
    ("rasterise-dem", "rasterize-dem", "unknown stage `rasterize-dem`", 1),
    ("stage: rasterise-dem", "stage: rasterise", "unknown stage `rasterise`", 1),
    ("dem: {stage: rasterise-dem", "dem: {stage rasterise-dem", "a colon is missing after `stage` in step `dem`", 1),
    ("face.mesh", "fase.mesh", "unknown step `fase`", 1),
    ("face.mesh", "face.mehs", "step `face` (synthesise-face) has no output `mehs`", 1),
    ("{surface: face.mesh}", "{mesh: face.mesh}", "stage `rasterise-dem` (step `dem`) has no input `mesh`", 1),
    ("in: {surface: face.mesh}, ", "", "step `dem` is not given its input `surface` (surface or mesh or cloud)", 1),
    (
        "stage: difference-dem, in: {reference: \"dem.raster[epoch=pre]\", comparison: \"dem.raster[epoch=post]\"}",
        "stage: transform-crs, in: {mesh: dem.raster}",
        "input `mesh` takes a mesh, but `dem.raster` is a raster",
        1,
    ),
    (
        "cell_m: \"${cell_m}\"",
        "cell: \"${cell_m}\"",
        "step `dem` (rasterise-dem): unknown parameter `cell` (at 2 instances)",
        1,
    ),
    ("${cell_m}", "${cel_m}", "`${cel_m}` names neither a parameter nor an axis", 1),
    (
        "width_m: 2",
        "width_m: -2",
        "step `face` (synthesise-face): `width_m`: -2 is out of range: must be > 0 (at 2 instances)",
        1,
    ),
    (
        "width_m: 2",
        "width_m: wide",
        "step `face` (synthesise-face): `width_m`: expected a number, found the text \"wide\" (at 2 instances)",
        1,
    ),
    (
        "method: tin",
        "method: linear",
        "step `dem` (rasterise-dem): `method`: expected one of mean, median, nearest, tin, found \"linear\" (at 2 instances)",
        1,
    ),
    ("epoch=post", "epoch=after", "`after` is no item of axis `epoch`", 1),
    ("epoch: {items: [pre, post]}", "epoch: [pre, post]", "axis `epoch` is a list; a key says what the list is", 1),
    ("over: [epoch], ", "", "no step depends on axis `epoch`", 3),
    ("method: tin}}", "method: tin}", "the `{` of line 9 is not closed", 1),
    ("  change:", "   change:", "line 10 begins after 3 spaces, line 9 before it after 2", 1),
    ("  change:", "  dem:", "the key `dem` occurs twice", 1),
    ("surface: face.mesh", "surface: change.raster", "these steps wait for each other in a circle: dem, change", 2),
    (
        "face: {stage: synthesise-face, over: [epoch], with: {width_m: 2, height_m: 1.5, spacing_m: 0.05}}",
        "face: {stage: import-mesh, over: [epoch], with: {path: fase.ply}}",
        "step `face`: cannot read `./fase.ply`: No such file or directory (os error 2) (at 2 instances)",
        1,
    ),
    (
        "stage: synthesise-face, over: [epoch], with: {width_m: 2, height_m: 1.5, spacing_m: 0.05}",
        "stage: import-mesh, over: [epoch], with: {path: \"C:\\Data\\face.ply\"}",
        "the backslash of `\\D` in double quotes does not stand for itself",
        1,
    ),
];

/// Commands that are wrong for the pipeline as it is right.
const COMMANDS: [(&[&str], &str); 5] = [
    (&["run", "pipline.yaml"], "cannot read the pipeline `pipline.yaml`: No such file or directory (os error 2)"),
    (&["plan", "p.yaml", "--set", "steps.dem.cell_m=0.1"], "unknown key `cell_m` in step `dem`"),
    (&["plan", "p.yaml", "--sweep", "cell=0.1,0.2"], "no step depends on axis `cell`"),
    (&["plan", "p.yaml", "--target", "dme"], "unknown target step `dme`"),
    (&["stages", "match"], "there is no stage `match`; stages with it in their name: match-image, match-pair"),
];

fn page() -> String {
    std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/troubleshooting.md")).unwrap()
}

#[test]
fn the_first_line_says_what_is_wrong_and_the_page_has_it() {
    let (page, mut wrong) = (page(), Vec::new());
    for (right, written, line, faults) in MISTAKES {
        assert!(RIGHT.contains(right), "{right}");
        let house = House::new(&RIGHT.replace(right, written));
        let (code, out, err) = house.rockface(&["plan", "p.yaml"]);
        let told = err.lines().filter(|line| line.starts_with("error")).count();
        if code != Some(2) || err.lines().next() != Some(&format!("error: {line}")) || told != faults {
            wrong.push(format!("{written}: {told} faults\n{out}{err}"));
        }
        assert!(page.contains(&format!("error: {line} |")), "docs/troubleshooting.md lacks: error: {line}");
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn wrong_commands_are_answered_and_the_page_has_it() {
    let page = page();
    let house = House::new(RIGHT);
    for (arguments, line) in COMMANDS {
        let (code, _, err) = house.rockface(arguments);
        assert_eq!((code, err.lines().next()), (Some(2), Some(&*format!("error: {line}"))), "{err}");
        assert!(page.contains(&format!("error: {line} |")), "docs/troubleshooting.md lacks: error: {line}");
    }
    let empty = House::new("");
    let (_, _, err) = empty.rockface(&["plan", "p.yaml"]);
    assert_eq!(err.lines().next(), Some("error: the pipeline is empty"));
}

#[test]
fn slips_are_answered_with_what_was_meant() {
    let house = House::new(RIGHT);
    std::fs::create_dir(house.path("below")).unwrap();
    std::fs::write(house.path("below/site.yaml"), RIGHT).unwrap();
    std::fs::write(
        house.path("data.yaml"),
        "rockface: 1\nparams: {data: scans, size: s}\nsteps: {m: {stage: import-mesh, with: {path: '${data}/face.ply'}}}\n",
    )
    .unwrap();
    assert_eq!(house.rockface(&["run", "p.yaml"]).0, Some(0));
    for (arguments, meant) in [
        (&["plan", "p.yaml", "--set", "cell=0.1"][..], "did you mean `params.cell_m`?"),
        (&["plan", "p.yaml", "--set", "dem.cell_m=0.1"], "did you mean `steps.dem.with.cell_m`?"),
        (&["plan", "p.yaml", "--set", "dem.with.cell_m=0.1"], "did you mean `steps.dem.with.cell_m`?"),
        (
            &["plan", "quickstart", "--set", "real.compared.align.between_points=false"],
            "did you mean `steps.real.with.compared.align.between_points`? `rockface parts rockface/no-change` lists what",
        ),
        (&["plan", "site.yaml"], "there is `below/site.yaml`"),
        (&["plan", "data.yaml"], "`--set params.data=...` gives another path"),
        (&["export", "latest", "change", "x.tif"], "did you mean `change.raster`?"),
        (&["export", "latest", "dem", "x.tif"], "of `dem` it has dem[epoch="),
        (&["plan", "p.yaml", "--sweep", "seed=1,2,3"], "swept values change no random numbers"),
        (&["plan", "p.yaml", "--sweep", "seed=1,2,3"], "a run for each seed: `--seed 1`"),
        (&["inspect", "latest"], "`latest` is a run: `rockface runs show latest`"),
    ] {
        let (code, _, err) = house.rockface(arguments);
        assert!(code == Some(2) && err.contains(meant), "{arguments:?}: {err}");
    }
    let typed = RIGHT.replace("cell_m: 0.05", "cell_m: {type: number, default: 0.05}");
    let (_, _, err) = House::new(&typed).rockface(&["plan", "p.yaml", "--set", "params.cell_m=0,1"]);
    assert!(err.contains("numbers are written with a point: 0.1"), "{err}");
}

#[test]
fn a_comparison_shows_what_differs() {
    let house = House::new(RIGHT);
    assert_eq!(house.rockface(&["run", "p.yaml"]).0, Some(0));
    let (_, same, _) = house.rockface(&["runs", "compare", "latest", "latest"]);
    assert!(same.lines().count() == 2 && same.contains("metrics are the same in all"), "{same}");
    let (_, all, _) = house.rockface(&["runs", "compare", "latest", "latest", "--all"]);
    let (_, csv, _) = house.rockface(&["runs", "compare", "latest", "latest", "--format", "csv"]);
    assert!(all.lines().count() > 5 && csv.lines().count() == all.lines().count() - 1, "{all}{csv}");
}

#[test]
fn a_parameter_that_decides_the_outputs_does_not_differ_between_items() {
    let yaml = "rockface: 1
axes: {c: {values: [true, false]}}
steps:
  face: {stage: synthesise-face, with: {width_m: 2, height_m: 1.5, spacing_m: 0.05}}
  dem: {stage: rasterise-dem, in: {surface: face.mesh}, with: {cell_m: 0.05, method: mean, coverage: \"${c}\"}}
";
    let (code, _, err) = House::new(yaml).rockface(&["plan", "p.yaml"]);
    assert!(code == Some(2) && err.contains("`coverage`: it decides the inputs and outputs of the step"), "{err}");
    // A parameter of the pipeline is one value.
    let one = yaml.replace("axes: {c: {values: [true, false]}}", "params: {c: true}");
    let (code, _, err) = House::new(&one).rockface(&["plan", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
}
