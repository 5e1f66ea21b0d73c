//! What comes from strangers: stores, run folders and pipelines made up by hand, met by the real program.

use std::fs;
use std::os::unix::fs::{FileExt, PermissionsExt, symlink};
use std::path::{Path, PathBuf};

use rockface_cache::{Digest, Recipe, Store};
use serde_json::{Value, json};

use crate::cli::{House, SMALL, last_line};

/// A face whose mesh is large enough to be linked rather than copied.
fn large() -> House {
    House::new(&SMALL.replace("spacing_m: 0.05", "spacing_m: 0.01"))
}

/// Puts a record into a store as somebody would who writes its files by hand.
fn forge(store: &Path, recipe: &str, outcome: &Value) {
    let mut payload = (recipe.len() as u32).to_le_bytes().to_vec();
    payload.extend(recipe.as_bytes());
    payload.extend(outcome.to_string().as_bytes());
    let mut frame = b"RFS1\x02\0\0\0".to_vec();
    frame.extend((payload.len() as u32).to_le_bytes());
    frame.extend([0; 4]);
    let stamp = std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap().as_nanos() as u64;
    frame.extend(stamp.to_le_bytes());
    frame.extend(Digest::of(recipe.as_bytes()).as_bytes());
    frame.extend(&Digest::of(&payload).as_bytes()[..16]);
    let check = Digest::of(&frame);
    frame.extend(&check.as_bytes()[..8]);
    frame.extend(payload);
    fs::write(store.join("segments").join(format!("{stamp:016x}-forged.seg")), frame).unwrap();
}

fn output(digest: &Digest, kind: &str, bytes: usize) -> Value {
    json!({"kind": kind, "digest": digest.to_string(), "bytes": bytes, "kept": true})
}

fn outcome(outputs: &Value) -> Value {
    json!({"outputs": outputs, "log": null, "cost": {"wall_s": 1.0, "cpu_s": 1.0, "peak_bytes": 1, "finished_unix_s": 1}})
}

/// Every file below a folder whose name tells that a stranger put it there.
fn planted(folder: &Path) -> Vec<PathBuf> {
    let (mut found, mut folders) = (Vec::new(), vec![folder.to_owned()]);
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap().flatten() {
            if entry.file_type().unwrap().is_dir() {
                folders.push(entry.path());
            } else if entry.file_name().to_string_lossy().starts_with("planted") {
                found.push(entry.path());
            }
        }
    }
    found
}

/// The text of the recipe of a step, and what came out of it, of the latest run.
fn recipe_of(house: &House, step: &str) -> (String, Digest, usize) {
    let manifest: Value =
        serde_json::from_slice(&fs::read(house.path(".rockface/runs/latest/run.json")).unwrap()).unwrap();
    let done = manifest["steps"].as_array().unwrap().iter().find(|done| done["step"] == step).unwrap();
    let key: Digest = done["key"].as_str().unwrap().parse().unwrap();
    let mesh = &done["outputs"]["mesh"];
    let store = Store::open(&house.path(".rockface/store")).unwrap();
    let digest = mesh["digest"].as_str().unwrap().parse().unwrap();
    (store.recipe_text(&key).unwrap(), digest, mesh["bytes"].as_u64().unwrap() as usize)
}

#[test]
fn a_record_writes_no_file_where_its_step_writes_none() {
    let honest = House::new(SMALL);
    assert_eq!(honest.rockface(&["run", "p.yaml"]).0, Some(0));
    let (recipe, digest, bytes) = recipe_of(&honest, "face");
    let mesh = Store::open(&honest.path(".rockface/store")).unwrap().get(&digest).unwrap();
    let victim = House::new(SMALL);
    let absolute = victim.path("planted").display().to_string();
    let ports = ["../../../../../planted", "planted", "planted/../../planted", &absolute, "planted\n"];
    for (number, port) in ports.into_iter().enumerate() {
        let evil = victim.path(&format!("evil{number}"));
        assert_eq!(Store::open(&evil).unwrap().put(&mesh).unwrap(), digest);
        let outputs = json!({"mesh": output(&digest, "mesh", bytes), port: output(&digest, "mesh", bytes)});
        forge(&evil, &recipe, &outcome(&outputs));
        let evil = evil.display().to_string();
        let mine = format!("mine{number}");
        let (code, _, err) = victim.rockface(&["store", "pull", &evil, "--store", &mine]);
        assert_eq!(code, Some(0), "{err}");
        for store in [&mine, &evil] {
            let (code, out, err) =
                victim.rockface(&["run", "p.yaml", "--store", store, "--runs", &format!("{mine}.runs")]);
            assert_eq!(code, Some(0), "{port}: {err}");
            assert!(last_line(&out).starts_with("done: ran 2, cached 0"), "{port} was believed: {out}");
        }
        assert_eq!(planted(victim.path("").as_path()), Vec::<PathBuf>::new(), "{port}");
    }
}

#[test]
fn a_record_of_other_kinds_or_impossible_numbers_is_none() {
    let house = House::new(SMALL);
    assert_eq!(house.rockface(&["run", "p.yaml"]).0, Some(0));
    let (recipe, digest, bytes) = recipe_of(&house, "face");
    let store = house.path(".rockface/store");
    let good = outcome(&json!({"mesh": output(&digest, "mesh", bytes)}));
    let with = |path: &str, value: Value| {
        let mut changed = good.clone();
        *changed.pointer_mut(path).unwrap() = value;
        changed
    };
    let forged = [
        outcome(&json!({})),
        with("/outputs/mesh/kind", "table".into()),
        with("/outputs/mesh/bytes", u64::MAX.into()),
        with("/cost/wall_s", (-1).into()),
        with("/cost/finished_unix_s", u64::MAX.into()),
    ];
    for (number, outcome) in forged.iter().enumerate() {
        forge(&store, &recipe, outcome);
        for command in [["store", "stat"], ["store", "gc"]] {
            let (code, _, err) = house.rockface(&command);
            assert_eq!(code, Some(0), "{outcome}: {err}");
        }
        let (code, out, err) = house.rockface(&["run", "p.yaml", "--runs", &format!("runs{number}")]);
        assert_eq!(code, Some(0), "{outcome}: {err}");
        assert!(last_line(&out).starts_with("done: ran 1, cached 1"), "{outcome}: {out}");
    }
}

#[test]
fn looking_at_a_result_runs_no_program_of_its_record() {
    let house = House::new(SMALL);
    let store = house.path(".rockface/store");
    let digest = Store::open(&store).unwrap().put(b"no depth map").unwrap();
    let params = json!({
        "program": "sh", "args": ["-c", format!("touch {}", house.path("planted").display())], "version": "1",
        "inputs": {}, "outputs": {"map": {"kind": "depth", "many": false, "optional": false, "extension": "exr"}},
        "params": {}, "files": {}, "environment": {}, "inherit": [],
    });
    let version = rockface_stages::registry().find("command").unwrap().version();
    let recipe = Recipe { stage: "command".into(), version, params: params.into(), inputs: [].into(), seed: None };
    forge(&store, &recipe.text(), &outcome(&json!({"map": output(&digest, "depth", 12)})));
    let (code, _, err) = house.rockface(&["inspect", &digest.short(), "--pixel", "0,0"]);
    assert_eq!(code, Some(2), "{err}");
    assert!(err.contains("starts a program"), "{err}");
    assert_eq!(planted(&house.path("")), Vec::<PathBuf>::new());
}

/// The one large output in a store.
fn blob(house: &House) -> PathBuf {
    let folders = fs::read_dir(house.path(".rockface/store/blobs")).unwrap().flatten();
    let files = folders.flat_map(|folder| fs::read_dir(folder.path()).unwrap().flatten().map(|file| file.path()));
    files.max_by_key(|file| fs::metadata(file).unwrap().len()).unwrap()
}

/// Changes a file as a failing disk does: its times stay.
fn decay(path: &Path, change: impl FnOnce(&fs::File)) {
    let modified = fs::metadata(path).unwrap().modified().unwrap();
    fs::set_permissions(path, fs::Permissions::from_mode(0o644)).unwrap();
    let file = fs::File::options().read(true).write(true).open(path).unwrap();
    change(&file);
    file.set_modified(modified).unwrap();
    // A disk that decays leaves the mode as it is, and only a file that nobody can write to gets another name.
    fs::set_permissions(path, fs::Permissions::from_mode(0o444)).unwrap();
}

fn flip(file: &fs::File) {
    let mut byte = [0];
    file.read_exact_at(&mut byte, 1 << 20).unwrap();
    file.write_all_at(&[byte[0] ^ 1], 1 << 20).unwrap();
}

#[test]
fn bit_rot_is_found_before_a_result_is_linked_and_made_good_in_that_run() {
    let house = large();
    assert_eq!(house.rockface(&["run", "p.yaml"]).0, Some(0));
    let blob = blob(&house);
    let whole = fs::read(&blob).unwrap();
    assert!(whole.len() > 1 << 20);
    let run = |runs: &str, more: &[&str]| {
        let (code, out, err) = house.rockface(&[&["run", "p.yaml", "--runs", runs], more].concat());
        assert_eq!(code, Some(0), "{err}");
        (last_line(&out).to_owned(), err, fs::read(house.path(runs).join("latest/outputs/face/mesh.ply")).unwrap())
    };
    // A reflink or copy in the first run folder may be whole still.
    decay(&blob, flip);
    let (told, _, linked) = run("trusting", &["--trust-store"]);
    assert!(told.starts_with("done: ran 0, cached 2") && linked != whole, "{told}");
    let (told, err, linked) = run("careful", &[]);
    assert!(told.starts_with("done: ran 1, cached 1"), "{told}");
    assert!(err.contains("face: its `mesh` has to be recomputed") && err.contains("quarantine"), "{err}");
    assert!(linked == whole);
    let (told, err, linked) = run("again", &[]);
    assert!(told.starts_with("done: ran 0, cached 2") && !err.contains("damaged") && linked == whole, "{told}{err}");
}

#[test]
fn bit_rot_is_not_exported_nor_archived() {
    let house = large();
    assert_eq!(house.rockface(&["run", "p.yaml"]).0, Some(0));
    let linked = house.path(".rockface/runs/latest/outputs/face/mesh.ply");
    let whole = fs::read(&linked).unwrap();
    decay(&linked, flip);
    // The file in the folder is not what was made now; where it is a link and no copy, neither is the blob.
    let is_linked = fs::read(blob(&house)).unwrap() != whole;
    let (code, _, err) = house.rockface(&["archive", "latest", "--outputs", "-o", "run.tar"]);
    assert_eq!(code, Some(if is_linked { 3 } else { 0 }), "{err}");
    assert!(!is_linked || err.contains("is not what the run made any more"), "{err}");
    assert_eq!(house.path("run.tar").exists(), !is_linked);
    if is_linked {
        let (code, _, err) = house.rockface(&["run", "p.yaml", "--runs", "other"]);
        assert_eq!(code, Some(0), "{err}");
    }
    decay(&blob(&house), flip);
    let export = ["export", "latest", "face.mesh", "out.ply"];
    assert_eq!(house.rockface(&[&export[..], &["--trust-store"]].concat()).0, Some(0));
    assert!(fs::read(house.path("out.ply")).unwrap() != whole);
    fs::remove_file(house.path("out.ply")).unwrap();
    let (code, _, err) = house.rockface(&export);
    assert!(code == Some(3) && err.contains("was damaged on disk"), "{err}");
    assert!(!house.path("out.ply").exists());
}

#[test]
fn a_result_of_the_wrong_size_is_set_aside_and_made_again() {
    let house = large();
    assert_eq!(house.rockface(&["run", "p.yaml"]).0, Some(0));
    decay(&blob(&house), |file| file.set_len(1000).unwrap());
    let (code, out, err) = house.rockface(&["run", "p.yaml", "--runs", "other"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(last_line(&out).starts_with("done: ran 1, cached 1"), "{out}");
    assert!(err.contains("a stored output was damaged; it was moved to"), "{err}");
    let (code, out, _) = house.rockface(&["store", "verify"]);
    assert!(code == Some(0) && out.contains("all whole"), "{out}");
}

#[test]
fn links_in_a_store_lead_nowhere() {
    let house = House::new(SMALL);
    assert_eq!(house.rockface(&["run", "p.yaml"]).0, Some(0));
    let home = house.path("home");
    fs::create_dir(&home).unwrap();
    fs::write(home.join("letter"), "mine").unwrap();
    let store = house.path(".rockface/store");
    for name in ["live", "tmp", "scratch", "quarantine", "blobs", "segments", "trees", "answers"] {
        let place = store.join(name);
        fs::rename(&place, store.join("aside")).unwrap();
        symlink(&home, &place).unwrap();
        for command in [&["store", "gc"][..], &["run", "p.yaml", "--verbose"]] {
            let (code, _, err) = house.rockface(command);
            assert!(code == Some(3) && err.contains(name) && err.contains("is a link"), "{name}: {err}");
        }
        fs::remove_file(&place).unwrap();
        fs::rename(store.join("aside"), &place).unwrap();
    }
    let segment = store.join("segments/0000-planted.seg");
    symlink(home.join("letter"), &segment).unwrap();
    assert_eq!(house.rockface(&["run", "p.yaml", "--verbose"]).0, Some(3));
    fs::remove_file(segment).unwrap();
    assert_eq!(fs::read_to_string(home.join("letter")).unwrap(), "mine");
    assert_eq!(fs::read_dir(&home).unwrap().count(), 1, "nothing was put there");
    assert_eq!(house.rockface(&["run", "p.yaml", "--verbose"]).0, Some(0));
}

#[test]
fn a_manifest_reads_and_writes_nothing_outside_its_folder() {
    let house = House::new(SMALL);
    assert_eq!(house.rockface(&["run", "p.yaml"]).0, Some(0));
    let path = house.path(".rockface/runs/latest/run.json");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(house.path("secret"), "a secret").unwrap();
    let secret = house.path("secret").display().to_string();
    for outside in ["../../../secret", secret.as_str()] {
        fs::write(&path, text.replace("outputs/dem/raster.tif", outside)).unwrap();
        for command in [&["report", "latest"][..], &["export", "latest", "dem.raster", "."]] {
            let (code, _, err) = house.rockface(command);
            assert!(code == Some(2) && err.contains("cannot name a file"), "{err}");
        }
    }
    for (name, expected) in [("../planted", None), ("/planted", None), ("up/planted", Some("up.planted.raster.tif"))] {
        fs::write(&path, text.replace("\"step\":\"dem\"", &format!("\"step\":\"{name}\""))).unwrap();
        let (code, _, err) = house.rockface(&["export", "latest", &format!("{name}.raster"), "."]);
        match expected {
            None => assert!(code == Some(2) && err.contains("cannot name a file"), "{err}"),
            Some(file) => assert!(code == Some(0) && house.path(file).is_file(), "{err}"),
        }
    }
    assert_eq!(planted(&house.path("")), Vec::<PathBuf>::new());
}

#[test]
fn a_torn_manifest_does_not_stop_a_collection() {
    let house = House::new(SMALL);
    assert_eq!(house.rockface(&["run", "p.yaml"]).0, Some(0));
    let path = house.path(".rockface/runs/latest/run.json");
    let text = fs::read(&path).unwrap();
    for (size, count) in [(text.len() - 4, 2), (10, 0), (0, 0)] {
        fs::write(&path, &text[..size]).unwrap();
        let (code, out, err) = house.rockface(&["store", "gc", "--unnamed"]);
        assert_eq!(code, Some(0), "{err}");
        assert!(err.contains(&format!("what can still be read in it ({count} record")), "{err}");
        assert!(out.starts_with("removed 0 records"), "{out}");
    }
}

const PROGRAMS: &str = "rockface: 1
name: programs
steps:
  face: {stage: synthesise-face, with: {width_m: 2, height_m: 1.5, spacing_m: 0.1}}
  sizes:
    stage: command
    with: {program: touch, args: [\"{out.list}\"], outputs: {list: file}, version: \"1\"}
";

#[test]
fn no_program_is_started_where_none_is_wanted() {
    let house = House::new(PROGRAMS);
    for command in ["run", "plan"] {
        let (code, _, err) = house.rockface(&[command, "p.yaml", "--no-commands"]);
        assert_eq!(code, Some(2), "{err}");
        assert!(err.contains("step `sizes` starts a program (stage `command`)") && err.contains("p.yaml:5"), "{err}");
        let output = house.command(&[command, "p.yaml"]).env("ROCKFACE_NO_COMMANDS", "1").output().unwrap();
        assert_eq!(output.status.code(), Some(2));
    }
    assert!(!house.path(".rockface/store").exists(), "nothing was made");
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--no-commands", "--target", "face"]);
    assert_eq!(code, Some(0), "{err}");
    let output = house.command(&["run", "p.yaml"]).env("ROCKFACE_NO_COMMANDS", "0").output().unwrap();
    assert_eq!(output.status.code(), Some(0));
    // Repeating a run is running it.
    let (code, _, err) = house.rockface(&["run", ".rockface/runs/latest/run.json", "--no-commands"]);
    assert!(code == Some(2) && err.contains("step `sizes`"), "{err}");
}

/// A part of somebody else's, in a file of its own.
const PART: &str = "rockface: 1
part: sizes
out: {list: sizes.list}
steps:
  sizes: {stage: command, with: {program: touch, args: [\"{out.list}\"], outputs: {list: file}, version: \"1\"}}
";

#[test]
fn no_program_is_started_by_a_part_nor_to_look_at_a_pipeline() {
    let house = House::new("rockface: 1\nsteps: {u: {use: part.yaml}}\n");
    std::fs::write(house.path("part.yaml"), PART).unwrap();
    for command in ["run", "plan"] {
        let (code, _, err) = house.rockface(&[command, "p.yaml", "--no-commands"]);
        assert!(
            code == Some(2) && err.contains("step `u/sizes` starts a program") && err.contains("part.yaml:5"),
            "{err}"
        );
    }
    let (code, out, err) =
        house.rockface(&["submit", "p.yaml", "--dry-run", "--slurm", "--array=0-1", "--no-commands"]);
    assert!(code == Some(2) && err.contains("`u/sizes` starts a program"), "{out}{err}");
    let (_, out, _) = house.rockface(&["submit", "p.yaml", "--dry-run", "--slurm", "--array=0-1"]);
    assert!(out.contains("rockface") && !out.contains("--no-commands"), "{out}");
    // What the ports of a Python step are, Python is asked for, by every command that reads the pipeline.
    let python = "rockface: 1\nsteps: {t: {stage: python, with: {module: m.py, function: f}}}\n";
    let house = House::new(python);
    std::fs::write(house.path("m.py"), "def f() -> 'table': ...\n").unwrap();
    for arguments in [&["plan", "p.yaml"][..], &["graph", "p.yaml"], &["explain", "p.yaml", "t"]] {
        let output = house.command(arguments).env("ROCKFACE_NO_COMMANDS", "1").output().unwrap();
        let err = String::from_utf8_lossy(&output.stderr).into_owned();
        let is_refused = output.status.code() == Some(2) && err.contains("starts a program (stage `python`)");
        assert!(is_refused, "{arguments:?}: {err}");
    }
}

#[test]
fn a_file_called_latest_stays() {
    let house = House::new(SMALL);
    let runs = house.path("elsewhere");
    fs::create_dir(&runs).unwrap();
    fs::write(runs.join("latest"), "my notes").unwrap();
    let (code, _, told) = house.rockface(&["run", "p.yaml", "--runs", "elsewhere", "-q"]);
    assert_eq!(code, Some(3), "{told}");
    assert!(told.contains("latest") && told.contains("stays as it is"), "{told}");
    assert_eq!(fs::read_dir(&runs).unwrap().count(), 1, "before any work is done");
    assert_eq!(fs::read_to_string(runs.join("latest")).unwrap(), "my notes");
}

#[test]
fn an_archive_has_nothing_that_somebody_else_put_into_the_run_folder() {
    let house = House::new(SMALL);
    assert_eq!(house.rockface(&["run", "p.yaml"]).0, Some(0));
    let folder = house.path(".rockface/runs/latest");
    let strange = ["README", "B3SUMS", "a\nb", "c\u{1b}[31m", "notes.txt", "outputs/loose.csv"];
    for name in strange {
        fs::write(folder.join(name), "0000  README\n").unwrap();
    }
    for name in ["inputs", "pipeline", "records", "outputs/other"] {
        fs::create_dir(folder.join(name)).unwrap();
        fs::write(folder.join(name).join("x.csv"), "").unwrap();
    }
    symlink("/etc/hostname", folder.join("outputs/face/y.csv")).unwrap();
    fs::write(folder.join("outputs/face/further.csv"), "1\n").unwrap();
    let (code, _, err) = house.rockface(&["archive", "latest", "--outputs", "-o", "run.tar"]);
    // Six files, three folders, a file in a folder of no output, a link, and a table where the output is a mesh.
    assert!(code == Some(0) && err.contains("warning: 12 files, folders or links in"), "{code:?} {err}");
    let mut archive = tar::Archive::new(fs::File::open(house.path("run.tar")).unwrap());
    let names: Vec<String> =
        archive.entries().unwrap().map(|entry| entry.unwrap().path().unwrap().display().to_string()).collect();
    let once: std::collections::BTreeSet<&String> = names.iter().collect();
    assert_eq!(once.len(), names.len(), "{names:?}");
    assert!(names.iter().any(|name| name == "outputs/face/mesh.ply"), "{names:?}");
    let is_strange = |name: &&String| {
        name.ends_with("x.csv") || name.ends_with("further.csv") || name.ends_with("y.csv") || name.contains('\u{1b}')
    };
    assert_eq!(names.iter().find(is_strange), None);
}
