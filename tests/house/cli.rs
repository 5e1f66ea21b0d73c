//! The program as a user meets it: what it prints, its exit codes, and what a killed run leaves behind.

use std::path::Path;
use std::process::{Command, Output};

pub const SMALL: &str = "# A small face.
rockface: 1
name: small
seed: 1
steps:
  face: {stage: synthesise-face, with: {width_m: 2, height_m: 1.5, spacing_m: 0.05}}
  dem: {stage: rasterise-dem, in: {surface: face.mesh}, with: {cell_m: 0.05, method: tin}}
";

pub struct House(tempfile::TempDir);

impl House {
    pub fn new(yaml: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("p.yaml"), yaml).unwrap();
        Self(folder)
    }

    pub fn path(&self, name: &str) -> std::path::PathBuf {
        self.0.path().join(name)
    }

    pub fn rockface(&self, arguments: &[&str]) -> (Option<i32>, String, String) {
        let Output { status, stdout, stderr } = self.command(arguments).output().unwrap();
        (status.code(), String::from_utf8(stdout).unwrap(), String::from_utf8(stderr).unwrap())
    }

    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rockface"));
        command.env_remove("ROCKFACE_STORE").env_remove("ROCKFACE_REMOTE");
        command.current_dir(self.0.path()).args(arguments).env("RUST_BACKTRACE", "0");
        command
    }
}

pub fn last_line(text: &str) -> &str {
    text.lines().last().unwrap_or_default()
}

#[test]
fn a_run_leaves_files_people_can_find_and_the_next_runs_nothing() {
    let house = House::new(SMALL);
    let (code, out, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(last_line(&out).starts_with("done: ran 2, cached 0,"), "{out}");
    let latest = house.path(".rockface/runs/latest");
    for file in ["run.json", "run.mcap", "outputs/dem/raster.tif", "outputs/face/mesh.ply"] {
        assert!(latest.join(file).is_file(), "{file} is missing");
    }
    let manifest: serde_json::Value = serde_json::from_slice(&std::fs::read(latest.join("run.json")).unwrap()).unwrap();
    assert_eq!(manifest["steps"].as_array().unwrap().len(), 2);
    assert_eq!(manifest["pipeline"]["text"], SMALL);
    assert!(house.path(".rockface/store/CACHEDIR.TAG").is_file());

    let folder = std::fs::read_link(&latest).unwrap();
    let (code, out, _) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0));
    assert!(last_line(&out).starts_with("done: ran 0, cached 2,"), "{out}");
    assert_eq!(std::fs::read_link(&latest).unwrap(), folder, "a run of hits is told by its former folder");

    let (_, out, _) = house.rockface(&["run", "p.yaml", "--set", "steps.dem.with.cell_m=0.1"]);
    assert!(last_line(&out).starts_with("done: ran 1, cached 1,"), "{out}");
}

#[test]
fn plan_says_what_would_run_and_makes_nothing() {
    let house = House::new(SMALL);
    let (code, out, _) = house.rockface(&["plan", "p.yaml"]);
    assert_eq!((code, last_line(&out)), (Some(0), "0 hit, 1 run, 1 depend on what runs"));
    house.rockface(&["run", "p.yaml"]);
    let (_, out, _) = house.rockface(&["plan", "p.yaml", "--set", "steps.dem.with.cell_m=0.1"]);
    assert_eq!(last_line(&out), "1 hit, 1 run, 0 depend on what runs");
    let (_, out, _) = house.rockface(&["plan", "p.yaml", "--json"]);
    let answers: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert!(answers.as_array().unwrap().iter().all(|answer| answer["answer"] == "hit"));
}

#[test]
fn exit_codes_tell_what_is_wrong() {
    let house = House::new(SMALL);
    let (code, _, err) = house.rockface(&["run", "q.yaml"]);
    assert_eq!(code, Some(2));
    assert!(err.contains("cannot read the pipeline `q.yaml`") && err.contains("p.yaml"), "{err}");
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--set", "steps.dem.with.cell=1"]);
    assert_eq!(code, Some(2));
    assert!(err.contains("unknown parameter `cell`") && err.contains("did you mean `cell_m`?"), "{err}");
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--set", "steps.dem.with.window_m=[0, 1, 0, 1e9]"]);
    assert_eq!(code, Some(1), "{err}");
    assert!(err.contains("failed   dem (rasterise-dem)"), "{err}");
    std::fs::write(house.path("file"), "in the way").unwrap();
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--store", "file/store"]);
    assert_eq!(code, Some(3), "{err}");
    let planned = House::new(SMALL).command(&["plan", "p.yaml"]).env("TMPDIR", house.path("nowhere")).output().unwrap();
    assert_eq!(planned.status.code(), Some(3));
    let err = String::from_utf8(planned.stderr).unwrap();
    assert!(err.contains("nowhere`: ") && err.contains("TMPDIR names another place"), "{err}");
    let (code, _, _) = house.rockface(&["run"]);
    assert_eq!(code, Some(2));
}

#[test]
fn a_place_that_is_no_text_is_refused_in_words() {
    use std::os::unix::ffi::OsStrExt;
    let house = House::new(SMALL);
    let odd = std::ffi::OsStr::from_bytes(b"odd\xff");
    for option in ["--store", "--runs"] {
        let output = house.command(&["run", "p.yaml", option]).arg(odd).output().unwrap();
        let err = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && err.contains("is no UTF-8 text"), "{option}: {err}");
    }
    let inside = house.path(odd.to_string_lossy().as_ref()).with_file_name(odd);
    std::fs::create_dir(&inside).unwrap();
    std::fs::copy(house.path("p.yaml"), inside.join("p.yaml")).unwrap();
    let output = house.command(&["run", "p.yaml"]).current_dir(&inside).output().unwrap();
    assert_eq!(output.status.code(), Some(2), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn numbers_that_cannot_be_are_refused_with_those_that_can() {
    let house = House::new(SMALL);
    for (arguments, way) in [
        (["run", "p.yaml", "--seed", "-1"].as_slice(), "a seed is a whole number from 0 to 18446744073709551615"),
        (&["run", "p.yaml", "--seed", "1.5"], "a seed is a whole number from 0"),
        (&["run", "p.yaml", "--jobs", "-1"], "jobs from 1 to 1024"),
        (&["run", "p.yaml", "-j", "-1"], "jobs from 1 to 1024"),
        (&["run", "p.yaml", "--memory", "-3"], "a number of GiB above 0"),
        (&["store", "gc", "--max-age", "-1"], "a number from 0"),
        (&["store", "gc", "--max-size", "-1"], "a size from 0"),
        (&["inspect", "x", "--pixel", "-1,2"], "whole numbers from 0"),
    ] {
        let (code, _, err) = house.rockface(arguments);
        assert!(code == Some(2) && err.contains(way) && !err.contains("'-- "), "{arguments:?}: {err}");
    }
    let (code, out, err) = house.rockface(&["plan", "p.yaml", "--set", "steps.face.with.width_m=-1"]);
    assert!(code == Some(2) && err.contains("-1 is out of range"), "{out}{err}");
}

#[test]
fn an_output_of_a_use_that_has_no_value_of_its_own_is_told_from_an_unknown_one() {
    let house = House::new(
        "rockface: 1\nparts:\n  wide:\n    in: {rows: table}\n    out: {table: t.table}\n    steps:\n      t: {stage: tabulate, in: {rows: in.rows}}\n\
         axes: {rep: {count: 2}}\nsteps:\n  read: {stage: import-table, with: {path: t.csv}}\n  \
         many: {use: wide, over: [rep], in: {rows: read.table}}\n  other: {use: wide, in: {rows: read.table}}\n",
    );
    std::fs::write(house.path("t.csv"), "a\n1\n").unwrap();
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--quiet", "--target", "many"]);
    assert_eq!(code, Some(0), "{err}");
    for (name, way) in [
        ("many.table", "behind it are many/t[rep=0].table, many/t[rep=1].table"),
        ("other.table", "the steps behind it were not needed in this run"),
        ("mani.table", "did you mean `many.table`?"),
    ] {
        let (code, _, err) = house.rockface(&["export", "latest", name, "out.json"]);
        assert!(code == Some(2) && err.contains(&format!("no output `{name}`: {way}")), "{name}: {err}");
    }
    // Into a folder, under a name of its own.
    let (code, _, err) = house.rockface(&["export", "latest", "many/t[rep=0].table", "into/"]);
    assert!(code == Some(0) && house.path("into/many.t[rep=0].table.json").is_file(), "{err}");
    let (code, _, err) = house.rockface(&["inspect", "t.csv", "--pixel", "1,1"]);
    assert!(code == Some(2) && err.contains("is no depth map"), "{err}");
}

#[test]
fn an_output_is_named_with_its_axes_in_any_order() {
    let house = House::new(
        "rockface: 1\naxes: {rep: {count: 2}, image: {items: [left, right]}}\nsteps:\n  read: {stage: import-table, with: {path: t.csv}}\n  \
         t: {stage: tabulate, over: [rep], in: {rows: read.table}, with: {constants: {image: '${image}'}}}\n  \
         u: {stage: tabulate, in: {rows: 't[image=left,rep=0].table'}}\ntargets: [t, u]\n",
    );
    std::fs::write(house.path("t.csv"), "a\n1\n").unwrap();
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--quiet"]);
    assert_eq!(code, Some(0), "{err}");
    for name in [
        "t[rep=0,image=left].table",
        "t[image=left,rep=0].table",
        "t.table[rep=0,image=left]",
        "t.table[ image=left, rep=0 ]",
    ] {
        let (code, out, err) = house.rockface(&["export", "latest", name, "out.json"]);
        assert!(code == Some(0), "{name}: {out}{err}");
    }
    for name in ["t[rep=0].table", "t.table", "t[rep=0,image=left,k=1].table"] {
        let (code, _, err) = house.rockface(&["export", "latest", name, "out.json"]);
        assert!(code == Some(2) && err.contains("no output"), "{name}: {err}");
    }
    for name in ["t[rep=0,image=left]", "t[image=left,rep=0]", "t.table[image=left,rep=0]"] {
        let (code, out, err) = house.rockface(&["explain", "p.yaml", name]);
        assert!(code == Some(0) && out.starts_with("t[rep=0,image=left] (tabulate): hit"), "{name}: {out}{err}");
    }
    let (code, _, err) = house.rockface(&["plan", "p.yaml", "--target", "t[rep=0,image=left]"]);
    assert!(code == Some(2) && err.contains("a target is a whole step: write `t`"), "{err}");
}

#[test]
fn the_catalogue_and_its_pages() {
    let house = House::new(SMALL);
    let (code, out, _) = house.rockface(&["stages"]);
    assert_eq!(code, Some(0));
    assert!(rockface_stages::registry().stages().iter().all(|stage| out.contains(stage.name())));
    for stage in rockface_stages::registry().stages() {
        let (code, out, _) = house.rockface(&["stages", stage.name()]);
        assert_eq!(code, Some(0));
        for heading in
            ["## Parameters", "## Method and references", "## Units and frames", "## Fails when", "## Example"]
        {
            assert!(out.contains(heading), "{}: {heading}", stage.name());
        }
    }
    let (code, _, err) = house.rockface(&["stages", "rasterize-dem"]);
    assert_eq!(code, Some(2));
    assert!(err.contains("did you mean `rasterise-dem`?"), "{err}");
}

#[test]
fn a_killed_run_loses_nothing_finished_and_leaves_nothing_torn() {
    let house = House::new(
        &SMALL.replace("seed: 1\n", "seed: 1\naxes: {k: {count: 40}}\n").replace("face: {", "face: {over: [k], "),
    );
    let bytes = |house: &House| {
        let mut files = Vec::new();
        let outputs = house.path(".rockface/runs/latest/outputs/dem");
        for entry in std::fs::read_dir(outputs).unwrap().flatten() {
            files.push((entry.file_name(), std::fs::read(entry.path().join("raster.tif")).unwrap()));
        }
        files.sort();
        files
    };
    for delay_ms in [5, 20, 40, 80, 120] {
        let mut child =
            house.command(&["run", "p.yaml", "--quiet"]).stdout(std::process::Stdio::null()).spawn().unwrap();
        std::thread::sleep(std::time::Duration::from_millis(delay_ms));
        child.kill().unwrap();
        child.wait().unwrap();
    }
    let (code, out, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{out}{err}");
    let whole = House::new(&std::fs::read_to_string(house.path("p.yaml")).unwrap());
    whole.rockface(&["run", "p.yaml", "--jobs", "1"]);
    assert_eq!(bytes(&house), bytes(&whole));
    assert_eq!(bytes(&house).len(), 40);
}

#[test]
fn an_interrupt_stops_with_its_own_code_and_the_next_run_goes_on() {
    let house = House::new(
        &SMALL.replace("seed: 1\n", "seed: 1\naxes: {k: {count: 400}}\n").replace("face: {", "face: {over: [k], "),
    );
    let mut child = house.command(&["run", "p.yaml", "--quiet"]).stdout(std::process::Stdio::null()).spawn().unwrap();
    // Once something is stored it is at work.
    let segments = house.path(".rockface/store/segments");
    while !std::fs::read_dir(&segments).is_ok_and(|mut files| files.next().is_some()) {
        assert!(child.try_wait().unwrap().is_none(), "it ended before it had stored anything");
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    let kill = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(kill.success());
    let status = child.wait_with_output().unwrap().status;
    assert_eq!(status.code(), Some(130));
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--quiet"]);
    assert_eq!(code, Some(0), "{err}");
}

#[test]
fn the_store_can_be_elsewhere_and_shared() {
    let house = House::new(SMALL);
    let store = house.path("elsewhere");
    let arguments = ["run", "p.yaml", "--store", store.to_str().unwrap(), "--runs", "told"];
    house.rockface(&arguments);
    assert!(house.path("told/latest/run.json").is_file() && !house.path(".rockface").exists());
    std::fs::copy(house.path("p.yaml"), house.path("copy.yaml")).unwrap();
    let (_, out, _) = house.rockface(&["run", "copy.yaml", "--store", store.to_str().unwrap(), "--runs", "told"]);
    assert!(out.contains("ran 0, cached 2"), "{out}");
    assert!(Path::new(&house.path("told/latest/outputs/dem/raster.tif")).is_file());
}

#[test]
fn a_former_folder_answers_only_for_the_same_question() {
    let house = House::new(SMALL);
    let (_, out, _) = house.rockface(&["run", "p.yaml"]);
    assert!(!out.contains("outputs/face"), "{out}");
    let folder = || std::fs::read_link(house.path(".rockface/runs/latest")).unwrap();
    let first = folder();
    let (_, out, _) = house.rockface(&["run", "p.yaml", "--target", "dem", "--target", "face"]);
    assert!(out.contains("ran 0") && out.contains("outputs/face/mesh.ply"), "{out}");
    let both = folder();
    assert_ne!(both, first);
    std::fs::write(house.path("p.yaml"), SMALL.replace("A small", "A little")).unwrap();
    house.rockface(&["run", "p.yaml"]);
    assert!(folder() != first && folder() != both);
    let text = std::fs::read_to_string(house.path(".rockface/runs/latest/run.json")).unwrap();
    assert!(text.contains("A little face"));
    // The same word for another folder is another folder.
    std::fs::create_dir(house.path("sub")).unwrap();
    std::fs::write(house.path("sub/p.yaml"), SMALL).unwrap();
    let store = house.path("store");
    for place in [house.path(""), house.path("sub")] {
        let mut command = house.command(&["run", "p.yaml", "--runs", "told", "--store", store.to_str().unwrap()]);
        assert!(command.current_dir(&place).status().unwrap().success());
        assert!(place.join("told/latest/run.json").is_file());
    }
}

/// Flips bytes of every file below a folder that holds `needle`, and says how many it found.
pub fn damage(folder: &Path, needle: &[u8]) -> usize {
    let mut found = 0;
    for entry in std::fs::read_dir(folder).unwrap().flatten() {
        let path = entry.path();
        if path.is_dir() {
            found += damage(&path, needle);
            continue;
        }
        let mut bytes = std::fs::read(&path).unwrap();
        let places: Vec<usize> =
            (0..bytes.len().saturating_sub(needle.len())).filter(|i| bytes[*i..].starts_with(needle)).collect();
        places.iter().for_each(|i| bytes[*i] ^= 1);
        if !places.is_empty() {
            let mut mode = std::fs::metadata(&path).unwrap().permissions();
            std::os::unix::fs::PermissionsExt::set_mode(&mut mode, 0o644);
            std::fs::set_permissions(&path, mode).unwrap();
            std::fs::write(&path, bytes).unwrap();
            found += places.len();
        }
    }
    found
}

#[test]
fn damaged_results_are_remade_with_a_warning_that_names_them() {
    // A small blob inside a segment, then a large one with a file of its own.
    for (step, needle, width) in [("face", b"element vertex".as_slice(), "2"), ("face", b"element vertex", "40")] {
        let house = House::new(&SMALL.replace("width_m: 2,", &format!("width_m: {width},")));
        let run = ["run", "p.yaml", "--target", "face"];
        house.rockface(&run);
        std::fs::remove_dir_all(house.path(".rockface/runs")).unwrap();
        assert_eq!(damage(&house.path(".rockface/store"), needle), 1);
        let (code, out, err) = house.rockface(&run);
        assert_eq!(code, Some(0), "{err}");
        assert!(err.contains(&format!("warning  {step}: ")) && err.contains("quarantine"), "{err}");
        assert!(last_line(&out).contains("ran 1, cached 0"), "{out}");
        std::fs::remove_dir_all(house.path(".rockface/runs")).unwrap();
        let (code, out, err) = house.rockface(&run);
        assert_eq!((code, err.as_str()), (Some(0), ""));
        assert!(last_line(&out).contains("ran 0, cached 1"), "{out}");
    }
}

#[test]
fn the_verdict_stands_at_the_end_and_folders_are_marked() {
    let house = House::new(SMALL);
    let (code, out, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    let lines: Vec<&str> = out.lines().collect();
    assert!(lines.len() > 2 && lines[lines.len() - 2].starts_with("dem: "), "{out}");
    assert_eq!(std::fs::read_to_string(house.path(".rockface/.gitignore")).unwrap(), "*\n");
    let tag = std::fs::read_to_string(house.path(".rockface/CACHEDIR.TAG")).unwrap();
    assert!(tag.starts_with("Signature: 8a477f597d28d172789f06886806bc55"));
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--jobs", "65535"]);
    assert_eq!(code, Some(2));
    assert!(err.contains("1024"), "{err}");
}

#[test]
fn long_names_and_unwritable_folders_cost_no_work() {
    let axis = "a".repeat(150);
    let item = "i".repeat(150);
    let yaml = SMALL
        .replace("seed: 1\n", &format!("seed: 1\naxes: {{{axis}: {{items: [{item}]}}}}\n"))
        .replace("face: {", &format!("face: {{over: [{axis}], "));
    let house = House::new(&yaml);
    let (code, _, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    std::fs::write(house.path("file"), "in the way").unwrap();
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--seed", "5", "--runs", "file/runs", "-v"]);
    assert_eq!(code, Some(3), "{err}");
    assert!(!err.contains("started"), "{err}");
}

#[test]
fn plan_foresees_what_is_remade() {
    let house = House::new(&SMALL.replace("face: {", "face: {keep: false, "));
    house.rockface(&["run", "p.yaml"]);
    let (_, out, _) = house.rockface(&["plan", "p.yaml"]);
    assert_eq!(last_line(&out), "2 hit, 0 run, 0 depend on what runs");
    let (_, out, _) = house.rockface(&["plan", "p.yaml", "--set", "steps.dem.with.cell_m=0.1"]);
    assert!(out.contains("its values are needed") && out.contains("no record has this recipe"), "{out}");
    assert_eq!(last_line(&out), "0 hit, 2 run, 0 depend on what runs");
    let (_, out, _) = house.rockface(&["plan", "p.yaml", "--set", "steps.face.keep=true", "--target", "face"]);
    assert!(out.contains("its outputs were not kept and now are to be"), "{out}");
}

#[test]
fn what_is_no_pipeline_file_is_told_as_it_is() {
    let house = House::new(SMALL);
    std::fs::create_dir(house.path("folder")).unwrap();
    std::fs::write(house.path("latin.yaml"), b"# caf\xe9\n").unwrap();
    for (path, expected) in [("folder", "is a folder"), ("latin.yaml", "is not a text in UTF-8: its byte 5")] {
        let (code, _, err) = house.rockface(&["plan", path]);
        assert_eq!(code, Some(2));
        assert!(err.contains(expected) && !err.contains("did you mean"), "{err}");
    }
}

#[test]
fn a_pipeline_from_a_pipe_is_refused_with_the_way_out() {
    let house = House::new(SMALL);
    let refused = |command: &mut Command| {
        let Output { status, stderr, .. } = command.output().unwrap();
        let err = String::from_utf8(stderr).unwrap();
        assert_eq!(status.code(), Some(2), "{err}");
        assert!(err.contains("is no regular file") && err.contains("write it to a file"), "{err}");
    };
    for command in [&["run"][..], &["plan"], &["graph"], &["explain"]] {
        let step: &[&str] = if command == ["explain"] { &["dem"] } else { &[] };
        let arguments = |path: &'static str| [command, &[path], step].concat();
        let file = || std::fs::File::open(house.path("p.yaml")).unwrap();
        refused(house.command(&arguments("/dev/stdin")).stdin(file()));
        refused(house.command(&arguments("/proc/self/fd/0")).stdin(file()));
        let mut cat =
            Command::new("cat").arg(house.path("p.yaml")).stdout(std::process::Stdio::piped()).spawn().unwrap();
        refused(house.command(&arguments("/dev/stdin")).stdin(cat.stdout.take().unwrap()));
        cat.wait().unwrap();
        refused(&mut house.command(&arguments("/dev/null")));
    }
    assert!(!Path::new("/dev/.rockface").exists() && !house.path(".rockface").exists());
}

#[test]
fn an_empty_variable_for_the_store_is_as_good_as_none() {
    let house = House::new(SMALL);
    for arguments in [&["run", "p.yaml"][..], &["store", "stat"], &["plan", "p.yaml"]] {
        let done = house.command(arguments).env("ROCKFACE_STORE", "").output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    }
    assert!(house.path(".rockface/store/CACHEDIR.TAG").is_file());
}

#[test]
fn a_step_that_fails_leaves_what_explains_it() {
    let house = House::new(
        "rockface: 1\nname: deep\nseed: 1\nsteps:\n  \
         face: {stage: synthesise-face, with: {width_m: 2, height_m: 1.5, spacing_m: 0.05}}\n  \
         blocks: {stage: generate-blocks}\n  \
         after: {stage: remove-blocks, in: {mesh: face.mesh, blocks: blocks.blocks}, with: {min_depth_m: 50, max_failed_attempts: 5}}\n",
    );
    let (code, _, err) = house.rockface(&["run", "p.yaml"]);
    assert!(code == Some(1) && err.contains("`attempts`"), "{err}");
    let folder = house.path(".rockface/runs/latest/outputs/after");
    let attempts = std::fs::read_to_string(folder.join("attempts.csv")).unwrap();
    assert_eq!(attempts.lines().count(), 1 + 5, "{attempts}");
    assert!(folder.join("volumes.csv").exists() && !folder.join("mesh.ply").exists());
}
