//! Runs, their files and their making are found from where the user stands.

use crate::cli::{House, SMALL, last_line};

#[test]
fn runs_of_a_pipeline_below_are_found_by_every_command() {
    let house = House::new("rockface: 1\n");
    for folder in ["pipelines", "other"] {
        std::fs::create_dir(house.path(folder)).unwrap();
        std::fs::write(house.path(&format!("{folder}/x.yaml")), SMALL).unwrap();
    }
    let (code, out, err) = house.rockface(&["run", "pipelines/x.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(out.contains("/report.html\n") && last_line(&out).starts_with("done"), "{out}");
    for command in [
        &["runs", "list"][..],
        &["runs", "show", "latest"],
        &["runs", "show", "pipelines/x.yaml"],
        &["runs", "show", "small"],
        &["report", "latest"],
        &["export", "latest", "dem.raster", "dem.tif"],
        &["archive", "latest", "-o", "run.tar"],
        &["store", "stat"],
    ] {
        let (code, out, err) = house.rockface(command);
        assert_eq!(code, Some(0), "{command:?}: {out}{err}");
    }
    let (_, out, _) = house.rockface(&["run", "other/x.yaml", "--set", "steps.dem.with.cell_m=0.1"]);
    assert!(last_line(&out).starts_with("done"), "{out}");
    let (_, out, _) = house.rockface(&["runs", "list"]);
    assert_eq!(out.lines().count(), 3, "{out}");
    let shown = |name: &str| house.rockface(&["runs", "show", name]).1;
    assert!(shown("latest").contains("cell_m=0.1") && shown("other/x.yaml").contains("cell_m=0.1"));
    assert!(!shown("pipelines/x.yaml").contains("cell_m=0.1"));
    let (code, _, err) = house.rockface(&["runs", "show", "p.yaml"]);
    assert!(code == Some(2) && err.contains("p.yaml has no run in"), "{err}");
}

#[test]
fn a_former_run_that_was_asked_for_again_is_the_last_one() {
    let house = House::new(SMALL);
    let coarse = ["run", "p.yaml", "--set", "steps.dem.with.cell_m=0.1"];
    for run in [["run", "p.yaml"].as_slice(), &coarse, &["run", "p.yaml"]] {
        assert_eq!(house.rockface(run).0, Some(0));
    }
    let shown = |name: &str| house.rockface(&["runs", "show", name]).1;
    for name in ["latest", "p.yaml", "small"] {
        assert!(!shown(name).contains("cell_m=0.1"), "{name}");
        assert!(shown(&format!("{name}~1")).contains("cell_m=0.1"), "{name}~1");
    }
    assert_eq!(house.rockface(&coarse).0, Some(0));
    assert!(shown("p.yaml").contains("cell_m=0.1") && !shown("small~1").contains("cell_m=0.1"));
}

#[test]
fn a_file_leads_to_step_parameters_and_command() {
    let more = "  picture: {stage: draw-picture, in: {subject: dem.raster}}\n  spread: {stage: describe-noise, in: {raster: dem.raster}}\n";
    let house = House::new(&format!("{SMALL}{}", more.replace("spread: {stage: describe-noise, in: {raster: dem.raster}}", "noise: {stage: describe-noise, with: {scales_cells: [1, 2, 4]}, in: {raster: dem.raster}}\n  spread: {stage: tabulate, in: {rows: noise.features}}")));
    house.rockface(&["run", "p.yaml"]);
    house.rockface(&["export", "latest", "dem.raster", "copy.tif"]);
    for file in ["copy.tif", ".rockface/runs/latest/outputs/dem/raster.tif"] {
        let (_, out, err) = house.rockface(&["inspect", file, "--json"]);
        let told: serde_json::Value = serde_json::from_str(&out).unwrap_or_else(|_| panic!("{out}{err}"));
        assert_eq!(told["made by"], "step `dem`, port `raster`", "{file}");
        assert_eq!(told["parameters"]["cell_m"], 0.05);
        let again = told["make again"].as_str().unwrap();
        assert!(again.starts_with("rockface run ") && again.ends_with("run.json --target dem"), "{again}");
    }
    // Alone in a folder without runs, the file says it itself.
    let elsewhere = House::new(SMALL);
    for (output, file) in
        [("dem.raster", "a.tif"), ("face.mesh", "a.ply"), ("picture.picture", "a.png"), ("spread.table", "a.json")]
    {
        let (code, out, err) = house.rockface(&["export", "latest", output, file]);
        assert_eq!(code, Some(0), "{out}{err}");
        std::fs::copy(house.path(file), elsewhere.path(file)).unwrap();
        let _ = std::fs::copy(
            house.path(&format!("{file}.provenance.json")),
            elsewhere.path(&format!("{file}.provenance.json")),
        );
        let (_, out, err) = elsewhere.rockface(&["inspect", file, "--json"]);
        let told: serde_json::Value = serde_json::from_str(&out).unwrap_or_else(|_| panic!("{out}{err}"));
        let (step, port) = output.split_once('.').unwrap();
        assert_eq!(told["made by"], format!("step `{step}`, port `{port}`, as the file says"));
        assert_eq!(told["kind"], if file == "a.json" { "table" } else { told["kind"].as_str().unwrap() });
        assert!(told["make again"].as_str().unwrap().starts_with("rockface run "), "{out}");
    }
    std::fs::write(house.path("foreign.tif"), "no raster").unwrap();
    assert!(!house.rockface(&["inspect", "foreign.tif"]).1.contains("made by"));
    std::fs::write(house.path("cameras.json"), r#"{"sensors": [{"id": "left"}], "images": []}"#).unwrap();
    let (_, out, _) = house.rockface(&["inspect", "cameras.json"]);
    assert!(out.contains("`stage: import-cameras`") && !out.contains("as covariance"), "{out}");
}

#[test]
fn a_file_that_was_read_afterwards_still_leads_to_the_step_that_made_it() {
    let house = House::new(SMALL);
    let folder = house.path("Gruppe Müller");
    std::fs::create_dir(&folder).unwrap();
    std::fs::copy(house.path("p.yaml"), folder.join("p.yaml")).unwrap();
    let rockface = |arguments: &[&str]| {
        let output = house.command(arguments).current_dir(&folder).output().unwrap();
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    rockface(&["run", "p.yaml"]);
    rockface(&["export", "p.yaml", "face.mesh", "face.ply"]);
    rockface(&["export", "p.yaml", "face.mesh", "plain.ply", "--plain"]);
    let reader = "rockface: 1\nsteps:\n  scan: {stage: import-mesh, with: {path: face.ply}}\n  other: {stage: import-mesh, with: {path: plain.ply}}\n";
    std::fs::write(folder.join("q.yaml"), reader).unwrap();
    rockface(&["run", "q.yaml"]);
    for file in ["face.ply", "plain.ply"] {
        let told: serde_json::Value = serde_json::from_str(&rockface(&["inspect", file, "--json"])).unwrap();
        assert_eq!(told["made by"], "step `face`, port `mesh`", "{file}");
    }
    // The command is one that a shell can read, from anywhere above too.
    let above = house.rockface(&["inspect", "Gruppe Müller/face.ply", "--runs", "Gruppe Müller/.rockface/runs"]).1;
    assert!(above.contains("rockface run 'Gruppe Müller/.rockface/runs/"), "{above}");
}

#[test]
fn a_run_has_one_table_of_all_points_and_steps_have_titles() {
    let titled = "dem: {title: \"Elevations <of the face>\", doc: As one sees it., ";
    let house = House::new(&SMALL.replace("dem: {", titled));
    let (code, out, err) = house.rockface(&["run", "p.yaml", "--sweep", "steps.dem.with.cell_m=0.05,0.1,0.2"]);
    assert_eq!(code, Some(0), "{out}{err}");
    let table = std::fs::read_to_string(house.path(".rockface/runs/latest/points.csv")).unwrap();
    let head = table.lines().next().unwrap();
    assert!(head.contains("dem.") && table.lines().count() >= 4, "{table}");
    let page = std::fs::read_to_string(house.path(".rockface/runs/latest/report.html")).unwrap();
    assert!(page.contains("Elevations &lt;of the face&gt;") && page.contains("As one sees it."));
    assert!(page.contains("id=\"curves\"") && page.contains("points.csv"));
}

#[test]
fn the_values_of_a_design_are_in_the_table_and_drawn_over() {
    let drawn = SMALL
        .replace("seed: 1\n", "seed: 1\naxes: {p: {sample: grid, count: 2, over: {cell_m: [0.05, 0.1]}}}\n")
        .replace("cell_m: 0.05", "cell_m: '${p.cell_m}'");
    let house = House::new(&drawn);
    let (code, out, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{out}{err}");
    let table = std::fs::read_to_string(house.path(".rockface/runs/latest/points.csv")).unwrap();
    let rows: Vec<&str> = table.lines().collect();
    assert!(rows[0].starts_with("p,p.cell_m,") && rows[0].contains("dem."), "{table}");
    assert!(rows[1].starts_with("0,0.05,") && rows[2].starts_with("1,0.1,"), "{table}");
    let page = std::fs::read_to_string(house.path(".rockface/runs/latest/report.html")).unwrap();
    assert!(page.contains("over p.cell_m") && !page.contains("over p<"), "{page}");
}

#[test]
fn a_sweep_whose_target_gathers_is_drawn_too() {
    let swept = SMALL
        .replace("seed: 1\n", "seed: 1\naxes: {cell_m: {values: [0.05, 0.04]}}\n")
        .replace("cell_m: 0.05", "cell_m: '${cell_m}'");
    let more = "  noise: {stage: describe-noise, with: {scales_cells: [1, 2]}, in: {raster: dem.raster}}\n  \
                table: {stage: tabulate, in: {rows: {each: noise.features, over: [cell_m]}}}\n";
    let house = House::new(&format!("{swept}{more}"));
    let (code, out, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{out}{err}");
    let page = std::fs::read_to_string(house.path(".rockface/runs/latest/report.html")).unwrap();
    assert!(page.contains("id=\"curves\"") && page.contains("over cell_m"), "no curves");
}
