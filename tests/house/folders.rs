//! Run folders as others find them: inspected, archived with all files of the pipeline, whole or not there.

use std::collections::BTreeMap;
use std::os::unix::fs::PermissionsExt;
use std::process::Command;

use rockface_cache::{Digest, Record, Store};
use serde_json::Value;

use crate::cli::{House, SMALL};

/// A pipeline that includes another file, run once.
fn including() -> House {
    let house = House::new("rockface: 1\nname: whole\ninclude: parts/part.yaml\n");
    std::fs::create_dir(house.path("parts")).unwrap();
    std::fs::write(house.path("parts/part.yaml"), SMALL).unwrap();
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--set", "steps.dem.with.cell_m=0.1"]);
    assert_eq!(code, Some(0), "{err}");
    house
}

#[test]
fn what_only_a_picture_shows_is_among_the_headlines() {
    let picture = "  picture: {stage: draw-picture, in: {subject: dem.raster}}\n";
    let house = House::new(&format!("{SMALL}{picture}"));
    let (code, out, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    // The face is read by the DEM too, which speaks for itself.
    assert!(out.contains("\ndem: ") && !out.contains("\nface: "), "{out}");
}

/// The texts of the files of a tar archive.
pub fn unpacked(path: &std::path::Path) -> BTreeMap<String, Vec<u8>> {
    let mut archive = tar::Archive::new(std::fs::File::open(path).unwrap());
    let read = |entry: std::io::Result<tar::Entry<std::fs::File>>| {
        let mut entry = entry.unwrap();
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut entry, &mut bytes).unwrap();
        (entry.path().unwrap().display().to_string(), bytes)
    };
    archive.entries().unwrap().map(read).collect()
}

/// The files of an archive in a folder of their own.
fn extracted(files: &BTreeMap<String, Vec<u8>>) -> House {
    let elsewhere = House::new("");
    for (path, bytes) in files {
        let path = elsewhere.path(path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    elsewhere
}

#[test]
fn inspect_tells_of_a_run_by_its_folder_and_by_its_manifest() {
    let house = including();
    for what in [".rockface/runs/latest", ".rockface/runs/latest/run.json"] {
        let (code, out, err) = house.rockface(&["inspect", what, "--json"]);
        assert_eq!(code, Some(0), "{err}");
        let facts: serde_json::Value = serde_json::from_str(&out).unwrap();
        assert_eq!(
            (&facts["kind"], &facts["pipeline"], &facts["status"]),
            (&"run".into(), &"whole".into(), &"done".into())
        );
        assert_eq!(facts["executed, cached, not made"], serde_json::json!([2, 0, 0]));
        assert_eq!(facts["set"][0], "steps.dem.with.cell_m=0.1");
        assert!(facts["includes"][0].as_str().unwrap().ends_with("parts/part.yaml"));
    }
    std::fs::write(house.path("other.json"), r#"{"format": 7, "pipeline": {}, "steps": []}"#).unwrap();
    let (code, _, err) = house.rockface(&["inspect", "other.json"]);
    assert!(code == Some(2) && err.contains("format 7"), "{err}");
}

#[test]
fn an_archive_has_the_included_files_where_they_lay() {
    let house = including();
    let (code, _, err) = house.rockface(&["archive", "latest", "-o", "run.tar"]);
    assert_eq!(code, Some(0), "{err}");
    let files = unpacked(&house.path("run.tar"));
    assert_eq!(files["pipeline/parts/part.yaml"], SMALL.as_bytes());
    let elsewhere = extracted(&files);
    let (code, out, err) = elsewhere.rockface(&["plan", "pipeline/p.yaml"]);
    assert!(code == Some(0) && out.contains("dem"), "{out}{err}");
}

/// A face of two triangles.
const FACE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0.5\nv 0 1 0.5\nf 1 2 3\nf 1 3 4\n";

#[test]
fn inspect_reads_meshes_of_other_programs() {
    let house = House::new("");
    std::fs::write(house.path("face.obj"), FACE).unwrap();
    // By its content: what a colleague has renamed is read by `import-mesh` too.
    std::fs::write(house.path("face.ply"), FACE).unwrap();
    for file in ["face.obj", "face.ply"] {
        let (code, out, err) = house.rockface(&["inspect", file, "--json"]);
        assert_eq!(code, Some(0), "{err}");
        let facts: Value = serde_json::from_str(&out).unwrap();
        assert_eq!((&facts["kind"], &facts["triangles"]), (&"mesh".into(), &2.into()), "{file}: {out}");
        assert_eq!(facts["read by"], "`stage: import-mesh`");
    }
}

#[test]
fn a_run_is_repeated_in_the_folder_that_its_project_was_moved_to() {
    let house = House::new(
        "rockface: 1\nsteps: {a: {stage: synthesise-face, with: {width_m: 1, height_m: 1, spacing_m: 0.1}}}\n",
    );
    let (before, now) = (house.path("before"), house.path("now"));
    std::fs::create_dir(&before).unwrap();
    std::fs::rename(house.path("p.yaml"), before.join("p.yaml")).unwrap();
    assert_eq!(house.rockface(&["run", "before/p.yaml"]).0, Some(0));
    std::fs::rename(&before, &now).unwrap();
    let (code, out, err) = house.rockface(&["run", "now/.rockface/runs/latest/run.json"]);
    assert!(code == Some(0) && out.contains("ran 0, cached 1"), "{out}{err}");
    assert!(err.contains("is gone, where this run was made; it is repeated in") && !before.exists(), "{err}");
}

#[test]
fn an_archive_with_its_inputs_is_repeated_wherever_it_lies() {
    let house = House::new("");
    for folder in ["site/pipelines/parts", "site/scans", "other"] {
        std::fs::create_dir_all(house.path(folder)).unwrap();
    }
    std::fs::write(house.path("site/scans/face.obj"), FACE).unwrap();
    std::fs::write(house.path("other/face.obj"), FACE.replace("0.5", "0.25")).unwrap();
    let part = "rockface: 1
steps:
  near: {stage: import-mesh, with: {path: ../scans/face.obj}}
  dem: {stage: rasterise-dem, in: {surface: near.mesh}, with: {cell_m: 0.1, method: tin}}
";
    std::fs::write(house.path("site/pipelines/parts.yaml"), part).unwrap();
    let main = "rockface: 1
name: whole
seed: 1
include: parts.yaml
params: {face: none}
steps:
  far: {stage: import-mesh, with: {path: '${face}'}}
";
    std::fs::write(house.path("site/pipelines/p.yaml"), main).unwrap();
    // One file is named relative to the pipeline, the other one by its whole path.
    let face = format!("params.face={}", house.path("other/face.obj").display());
    let (code, _, err) = house.rockface(&["run", "site/pipelines/p.yaml", "--set", &face]);
    assert_eq!(code, Some(0), "{err}");
    let archive = || {
        house.rockface(&[
            "archive",
            "site/pipelines/p.yaml",
            "--runs",
            "site/pipelines/.rockface/runs",
            "--inputs",
            "-o",
            "run.tar",
        ])
    };
    let (code, out, err) = archive();
    assert_eq!(code, Some(0), "{out}{err}");
    let files = unpacked(&house.path("run.tar"));
    for path in ["other/face.obj", "site/scans/face.obj", "site/pipelines/p.yaml", "site/pipelines/parts.yaml"] {
        assert!(files.contains_key(&format!("inputs/{path}")), "{path} in {:?}", files.keys());
    }
    // An input that is not what the run read is no input of the run.
    std::fs::write(house.path("other/face.obj"), FACE).unwrap();
    let (code, _, err) = archive();
    assert!(code == Some(2) && err.contains("other/face.obj is not what the run read any more"), "{code:?} {err}");
    assert_eq!(unpacked(&house.path("run.tar")), files, "the archive that was there stays");
    for folder in ["site", "other"] {
        std::fs::remove_dir_all(house.path(folder)).unwrap();
    }
    let elsewhere = extracted(&files);
    // Where the archive has a link, results would go where that leads.
    let (own, home) = (elsewhere.path("inputs/site/pipelines/.rockface"), elsewhere.path("home"));
    std::fs::create_dir(&home).unwrap();
    std::os::unix::fs::symlink(&home, &own).unwrap();
    let (code, _, err) = elsewhere.rockface(&["run", "run.json"]);
    assert!(code == Some(2) && err.contains("which came with the archive, by a link"), "{code:?} {err}");
    assert_eq!(std::fs::read_dir(&home).unwrap().count(), 0);
    std::fs::remove_file(&own).unwrap();
    // A link higher up leads out just as well.
    let (folder, aside) = (elsewhere.path("inputs/site/pipelines"), elsewhere.path("aside"));
    std::fs::rename(&folder, &aside).unwrap();
    std::os::unix::fs::symlink(&aside, &folder).unwrap();
    let (code, _, err) = elsewhere.rockface(&["run", "run.json"]);
    assert!(code == Some(2) && err.contains("which came with the archive, by a link"), "{code:?} {err}");
    assert!(!aside.join(".rockface").exists());
    std::fs::remove_file(&folder).unwrap();
    std::fs::rename(&aside, &folder).unwrap();
    let (code, out, err) = elsewhere.rockface(&["run", "run.json"]);
    assert!(code == Some(0) && out.contains("all 3 outputs are the same: 3 steps were computed again"), "{out}{err}");
    // So is the repetition, an archive of it too, and the pipeline runs by its file where it names its files relative to itself.
    let again = elsewhere.path("inputs/site/pipelines/.rockface/runs/latest/run.json");
    let (code, out, err) = elsewhere.rockface(&["run", again.to_str().unwrap()]);
    assert!(code == Some(0) && out.contains("all 3 outputs are the same: all of them from the store"), "{out}{err}");
    let (code, _, err) = elsewhere.rockface(&["archive", again.to_str().unwrap(), "--inputs", "-o", "again.tar"]);
    assert_eq!(code, Some(0), "{err}");
    let third = extracted(&unpacked(&elsewhere.path("again.tar")));
    let (code, out, err) = third.rockface(&["run", "run.json"]);
    assert!(code == Some(0) && out.contains("all 3 outputs are the same: 3 steps were computed again"), "{out}{err}");
    let (code, out, err) = elsewhere.rockface(&["plan", "inputs/site/pipelines/p.yaml", "--target", "dem"]);
    assert!(code == Some(0) && out.contains("dem"), "{out}{err}");
    // What differs is named by where it lies now.
    std::fs::write(elsewhere.path("inputs/other/face.obj"), FACE).unwrap();
    let (code, out, _) = elsewhere.rockface(&["run", "run.json"]);
    assert!(code == Some(0) && out.contains("changed") && out.contains("inputs/other/face.obj"), "{out}");
}

#[test]
fn an_archive_may_lie_below_what_it_has_copied_and_keeps_programs() {
    let house = House::new(
        "rockface: 1
name: near
params: {face: face.obj}
steps:
  near: {stage: import-mesh, with: {path: '${face}'}}
  made: {stage: command, with: {version: '1', program: '{file.script}', args: ['{out.table}'], files: {script: s.sh}, outputs: {table: {kind: table, extension: csv}}}}
",
    );
    std::fs::write(house.path("face.obj"), FACE).unwrap();
    std::fs::write(house.path("s.sh"), "#!/bin/sh\nprintf 'a\\n1\\n' > $1\n").unwrap();
    std::fs::set_permissions(house.path("s.sh"), std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
    let ran = |arguments: &[&str], expected: &str| {
        let (code, out, err) = house.rockface(arguments);
        assert!(code == Some(0) && out.contains(expected), "{arguments:?}: {out}{err}");
    };
    ran(&["run", "p.yaml"], "ran 2");
    // Another folder called `inputs` is no copy.
    std::fs::create_dir(house.path(".rockface/runs/latest/inputs")).unwrap();
    ran(&["run", ".rockface/runs/latest/run.json"], "all 2 outputs are the same");
    std::fs::remove_dir(house.path(".rockface/runs/latest/inputs")).unwrap();
    ran(&["archive", "latest", "--inputs", "-o", "run.tar"], "run.tar");
    let unpacked = std::process::Command::new("tar")
        .args(["-xf", "run.tar", "--one-top-level=ex"])
        .current_dir(house.path("."))
        .status();
    assert!(unpacked.unwrap().success());
    ran(&["run", "ex/run.json"], "all 2 outputs are the same: 2 steps were computed again");
    ran(&["run", "ex/inputs/.rockface/runs/latest/run.json"], "all 2 outputs are the same: all of them from the store");
    // A file that is in no archive is read where it is.
    std::fs::write(house.path("new.obj"), FACE.replace("0.5", "0.75")).unwrap();
    let new = format!("params.face={}", house.path("new.obj").display());
    ran(&["run", "ex/run.json", "--set", &new], "differs  near.mesh");
}

#[test]
fn an_archive_has_no_two_files_in_one_place() {
    let house = House::new(
        "rockface: 1\nname: two\nsteps:\n  one: {stage: import-mesh, with: {path: face.obj}}\n  two: {stage: import-mesh, with: {path: link/../face.obj}}\n",
    );
    std::fs::create_dir_all(house.path("other/deep")).unwrap();
    std::os::unix::fs::symlink("other/deep", house.path("link")).unwrap();
    std::fs::write(house.path("face.obj"), FACE).unwrap();
    std::fs::write(house.path("other/face.obj"), FACE.replace("0.5", "0.25")).unwrap();
    assert_eq!(house.rockface(&["run", "p.yaml"]).0, Some(0));
    let (code, _, err) = house.rockface(&["archive", "latest", "--inputs", "-o", "run.tar"]);
    assert!(code == Some(2) && err.contains("another file has its place, inputs/face.obj"), "{err}");
}

/// The manifest of the latest run, and of it the part of one step.
fn done(house: &House, step: &str) -> Value {
    let manifest = std::fs::read(house.path(".rockface/runs/latest/run.json")).unwrap();
    let manifest: Value = serde_json::from_slice(&manifest).unwrap();
    manifest["steps"].as_array().unwrap().iter().find(|done| done["step"] == step).unwrap().clone()
}

/// Gives a step another log, as another version of the program may have written it.
fn put_log(house: &House, step: &str, log: &[u8]) {
    let key: Digest = done(house, step)["key"].as_str().unwrap().parse().unwrap();
    let store = Store::open(&house.path(".rockface/store")).unwrap();
    let record = store.record(&key).unwrap();
    let log = Some(store.put(log).unwrap());
    store.commit(&Record { log, ..record }).unwrap();
    store.sync().unwrap();
}

#[test]
fn a_log_that_cannot_be_read_costs_no_run_folder() {
    let house = House::new(SMALL);
    let (code, _, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    // Former versions wrote `null` for a number that is not finite, and could not read it.
    put_log(&house, "face", br#"[{"type":"metric","name":"area","value":null,"unit":"m2"}]"#);
    put_log(&house, "dem", br#"[{"type":"tune"}]"#);
    std::fs::remove_dir_all(house.path(".rockface/runs")).unwrap();
    let (code, out, err) = house.rockface(&["run", "p.yaml"]);
    assert!(code == Some(0) && out.contains("ran 0, cached 2"), "{out}{err}");
    assert!(err.contains("dem: the log of a step cannot be read") && !err.contains("face: the log"), "{err}");
    assert_eq!(done(&house, "face")["metrics"][0]["value"], Value::Null);
    assert!(house.path(".rockface/runs/latest/report.html").is_file());
}

#[test]
fn a_step_whose_log_is_damaged_is_computed_again_in_the_run_that_finds_it() {
    let house = House::new(SMALL);
    let (code, _, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    let points = || std::fs::read_to_string(house.path(".rockface/runs/latest/points.csv")).unwrap();
    let (before, mut flipped) = (points(), 0);
    let key: Digest = done(&house, "dem")["key"].as_str().unwrap().parse().unwrap();
    let store = Store::open(&house.path(".rockface/store")).unwrap();
    let said = store.get(&store.record(&key).unwrap().log.unwrap()).unwrap();
    drop(store);
    std::fs::remove_dir_all(house.path(".rockface/runs")).unwrap();
    for entry in std::fs::read_dir(house.path(".rockface/store/segments")).unwrap() {
        let path = entry.unwrap().path();
        let mut bytes = std::fs::read(&path).unwrap();
        if let Some(at) = bytes.windows(said.len()).position(|window| window == said) {
            bytes[at + 3] ^= 1;
            flipped += 1;
        }
        std::fs::write(&path, bytes).unwrap();
    }
    assert_eq!(flipped, 1);
    let (code, out, err) = house.rockface(&["run", "p.yaml"]);
    assert!(code == Some(0) && !out.contains("ran 0"), "{out}{err}");
    assert!(err.contains("its `log` has to be recomputed") && !err.contains("\u{1b}["), "{err}");
    assert_eq!(points(), before);
}

#[test]
fn what_stands_in_the_place_of_a_mark_or_a_pin_is_neither_followed_nor_waited_for() {
    let house = House::new(SMALL);
    let (code, _, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    let run = house.path(".rockface/runs/latest").canonicalize().unwrap();
    std::fs::write(house.path("precious"), "mine").unwrap();
    std::os::unix::fs::symlink(house.path("precious"), run.join("pinned")).unwrap();
    let (code, _, err) = house.rockface(&["runs", "pin", "latest"]);
    assert_eq!(code, Some(0), "{err}");
    assert_eq!(std::fs::read_to_string(house.path("precious")).unwrap(), "mine");
    assert!(std::fs::symlink_metadata(run.join("pinned")).unwrap().is_file());
    let pipe = |path: &std::path::Path| assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
    pipe(&run.join(".unfinished"));
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--seed", "5"]);
    assert_eq!(code, Some(0), "{err}");
    std::fs::remove_file(house.path(".rockface/store/format")).unwrap();
    pipe(&house.path(".rockface/store/format"));
    let (code, _, err) = house.rockface(&["run", "p.yaml"]);
    assert!(code == Some(3) && err.contains("format is a link or no plain file"), "{err}");
}

#[test]
fn files_are_for_whom_the_umask_lets_read_them() {
    for (umask, expected) in [("077", 0o600), ("002", 0o664)] {
        let house = House::new(SMALL);
        let script = format!(
            "umask {umask}; \"$0\" run p.yaml -q --trace trace.json && \"$0\" runs pin latest && \"$0\" archive latest -o run.tar && \"$0\" report latest -o page.html"
        );
        let program = house.command(&[]).get_program().to_owned();
        let mut shell = Command::new("sh");
        let done = shell.arg("-c").arg(script).arg(program).current_dir(house.path(".")).output().unwrap();
        assert!(done.status.success(), "{done:?}");
        let run = std::fs::read_dir(house.path(".rockface/runs/latest")).unwrap().map(|entry| entry.unwrap().path());
        let run: Vec<_> = run.filter(|path| path.is_file()).collect();
        for file in ["run.mcap", "run.json", "report.html", "pinned"] {
            assert!(run.iter().any(|path| path.ends_with(file)), "{file} of {run:?}");
        }
        for file in ["run.tar", "page.html", "trace.json"].map(|file| house.path(file)).into_iter().chain(run) {
            let mode = std::fs::metadata(&file).unwrap().permissions().mode() & 0o777;
            assert_eq!(mode, expected, "{} {umask}", file.display());
        }
    }
}

#[test]
fn a_page_from_elsewhere_is_not_handed_to_a_browser() {
    let house = House::new(SMALL);
    assert_eq!(house.rockface(&["run", "p.yaml", "-q"]).0, Some(0));
    std::fs::create_dir(house.path("gift")).unwrap();
    std::fs::rename(house.path(".rockface/runs/latest").canonicalize().unwrap(), house.path("gift/run")).unwrap();
    std::fs::remove_dir_all(house.path(".rockface")).unwrap();
    std::fs::write(house.path("gift/run/report.html"), "<script>alert(1)</script>").unwrap();
    let (code, _, err) = house.rockface(&["report", "gift/run", "--open"]);
    assert!(code == Some(2) && err.contains("was not written here, so it is not opened"), "{code:?} {err}");
}

#[test]
fn a_variable_without_a_meaning_is_refused() {
    let house = House::new(SMALL);
    for (name, value) in [("ROCKFACE_SHARED_STORE", "banana"), ("ROCKFACE_LOG", "rockface=loud")] {
        let done = house.command(&["run", "p.yaml", "-q"]).env(name, value).output().unwrap();
        let err = String::from_utf8_lossy(&done.stderr);
        assert!(done.status.code() == Some(2) && err.contains(name) && err.contains(value), "{err}");
    }
    let done = house.command(&["run", "p.yaml", "-q"]).env("ROCKFACE_SHARED_STORE", "no").output().unwrap();
    assert!(done.status.success());
}

#[test]
fn a_folder_whose_writer_died_is_no_run_and_goes_with_the_next() {
    let house = including();
    let left = house.path(".rockface/runs/2020-01-01T000000Z-left-00000000");
    std::fs::create_dir(&left).unwrap();
    std::fs::write(left.join(".unfinished"), "rockface is writing this run folder\n").unwrap();
    std::fs::write(left.join("run.mcap"), "half").unwrap();
    // A file of that name in a folder of other things says nothing: it may have come with an archive.
    let scans = house.path(".rockface/runs/scans");
    std::fs::create_dir(&scans).unwrap();
    std::fs::write(scans.join(".unfinished"), "").unwrap();
    std::fs::write(scans.join("cliff.laz"), "the only one").unwrap();
    let (_, out, _) = house.rockface(&["runs", "list"]);
    assert!(!out.contains("left"), "{out}");
    let (code, _, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(!left.exists() && scans.join("cliff.laz").exists());
    let latest = house.path(".rockface/runs/latest");
    let names = std::fs::read_dir(latest).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    assert_eq!(names.filter(|name| name.starts_with('.')).count(), 0);
}

#[test]
fn an_interrupt_while_the_folder_is_written_leaves_none_and_loses_nothing() {
    let house = House::new(
        "rockface: 1\naxes: {k: {count: 4000}}\nsteps:\n  read: {stage: import-table, with: {path: t.csv}}\n  \
         many: {stage: tabulate, in: {rows: read.table}, with: {constants: {k: \"${k}\"}}}\n",
    );
    std::fs::write(house.path("t.csv"), "a\n1\n").unwrap();
    let runs = house.path(".rockface/runs");
    let folders = || std::fs::read_dir(&runs).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut child = house.command(&["run", "p.yaml", "--quiet"]).stdout(std::process::Stdio::null()).spawn().unwrap();
    while !folders().any(|folder| folder.join(".unfinished").exists()) {
        assert!(child.try_wait().unwrap().is_none(), "it ended before its folder was begun");
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert_eq!(folders().count(), 0, "a folder that tells half of a run would mislead");
    let (code, out, err) = house.rockface(&["run", "p.yaml"]);
    assert!(code == Some(0) && out.contains("ran 0, cached 4001"), "{out}{err}");
}

#[test]
fn a_former_folder_that_somebody_wrote_to_answers_no_more() {
    let house = House::new(SMALL);
    let folder = || std::fs::canonicalize(house.path(".rockface/runs/latest")).unwrap();
    let run = || {
        let (code, out, err) = house.rockface(&["run", "p.yaml"]);
        assert!(code == Some(0), "{err}");
        (folder(), out)
    };
    let first = run().0;
    assert_eq!(run().0, first);
    let raster = "outputs/dem/raster.tif";
    let whole = std::fs::read(first.join(raster)).unwrap();
    for spoil in [raster, "run.mcap", "report.html", "run.json"] {
        let before = folder();
        // The system may tell times no finer than to some milliseconds.
        std::thread::sleep(std::time::Duration::from_millis(30));
        match spoil {
            "report.html" => std::fs::remove_file(before.join(spoil)).unwrap(),
            "run.json" => std::fs::write(before.join(spoil), "").unwrap(),
            _ => std::fs::write(before.join(spoil), "edited").unwrap(),
        }
        let (after, out) = run();
        assert!(after != before && out.contains("ran 0"), "{spoil}: {out}");
        assert_eq!(std::fs::read(after.join(raster)).unwrap(), whole, "{spoil}");
    }
}
