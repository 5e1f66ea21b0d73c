//! A remote place under the store, through the program: a cold machine takes what others made, and a place that fails costs time only.

use std::path::Path;
use std::process::Output;
use std::time::Duration;

use crate::cli::{House, SMALL, last_line};
use crate::s3::{Faults, Server};

fn run(house: &House, server: &Server, arguments: &[&str]) -> (Option<i32>, String, String) {
    let mut command = house.command(arguments);
    let Output { status, stdout, stderr } = command.envs(server.environment()).output().unwrap();
    (status.code(), String::from_utf8(stdout).unwrap(), String::from_utf8(stderr).unwrap())
}

const RUN: &[&str] = &["run", "p.yaml", "--remote", "s3://bucket/lab"];

/// Three steps, of which the first is not kept.
const CHAIN: &str = "rockface: 1
name: chain
seed: 1
steps:
  face: {stage: synthesise-face, keep: false, with: {width_m: 2, height_m: 1.5, spacing_m: 0.02}}
  dem: {stage: rasterise-dem, in: {surface: face.mesh}, with: {cell_m: 0.02, method: tin}}
  noise: {stage: describe-noise, in: {raster: dem.raster}}
";

fn outputs(house: &House) -> Vec<(String, Vec<u8>)> {
    let root = house.path(".rockface/runs/latest/outputs");
    let mut found = Vec::new();
    let mut folders = vec![root.clone()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).unwrap().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(&root).unwrap().display().to_string();
                found.push((name, std::fs::read(&path).unwrap()));
            }
        }
    }
    found.sort();
    found
}

fn log(house: &House) -> Vec<u8> {
    std::fs::read(house.path(".rockface/runs/latest/run.mcap")).unwrap()
}

/// A server that has the results of the chain, and the house they were made in.
fn warm() -> (Server, House) {
    let (server, house) = (Server::start(), House::new(CHAIN));
    let (code, out, err) = run(&house, &server, RUN);
    assert_eq!((code, err.contains("warning: remote")), (Some(0), false), "{err}");
    assert!(last_line(&out).starts_with("done: ran 3, cached 0"), "{out}");
    (server, house)
}

#[test]
fn a_cold_machine_runs_nothing_that_the_remote_place_has() {
    let (server, first) = warm();
    let cold = House::new(CHAIN);
    let (code, out, err) = run(&cold, &server, RUN);
    assert_eq!(code, Some(0), "{err}");
    assert!(last_line(&out).starts_with("done: ran 0, cached 3"), "{out}");
    assert!(out.contains("requests to s3://bucket/lab"), "{out}");
    assert!(outputs(&cold).len() >= 2 && outputs(&cold) == outputs(&first) && log(&cold) == log(&first));
    // All it needs is in its own store by now.
    let (_, out, _) = cold.rockface(&["run", "p.yaml"]);
    assert!(last_line(&out).starts_with("done: ran 0, cached 3"), "{out}");
    assert_eq!(cold.rockface(&["store", "verify"]).0, Some(0));
    // `plan` looks there too, and makes nothing.
    let third = House::new(CHAIN);
    let (_, out, _) = run(&third, &server, &["plan", "p.yaml", "--remote", "s3://bucket/lab"]);
    assert_eq!(last_line(&out), "3 hit, 0 run, 0 depend on what runs");
    assert!(!third.path(".rockface").exists());
}

#[test]
fn whatever_the_remote_place_does_the_run_ends_with_the_same_bytes() {
    let slow = Faults { delay: Duration::from_millis(200), ..Faults::default() };
    for (faults, warns) in [
        (slow, false),
        (Faults { fail_one_in: 3, ..Faults::default() }, false),
        (Faults { truncate: true, ..Faults::default() }, true),
        (Faults { damage: true, ..Faults::default() }, true),
        (Faults { hang_up: true, ..Faults::default() }, true),
        (Faults { delay: Duration::from_mins(1), ..Faults::default() }, true),
    ] {
        let (server, first) = warm();
        server.set(faults);
        let cold = House::new(CHAIN);
        let (code, out, err) = run(&cold, &server, RUN);
        assert_eq!(code, Some(0), "{faults:?}: {err}");
        assert!(last_line(&out).starts_with("done: "), "{out}");
        assert_eq!(err.contains("warning: remote s3://bucket/lab"), warns, "{faults:?}: {err}");
        assert!(outputs(&cold) == outputs(&first) && log(&cold) == log(&first), "{faults:?}");
        assert_eq!(cold.rockface(&["store", "verify"]).0, Some(0), "{faults:?}");
    }
}

#[test]
fn objects_that_are_gone_mean_computing_again_and_never_a_fault() {
    let (server, first) = warm();
    server.objects().retain(|name, _| name.contains("/records/") || name.ends_with("/format"));
    let cold = House::new(CHAIN);
    let (code, out, err) = run(&cold, &server, RUN);
    assert_eq!(code, Some(0), "{err}");
    assert!(last_line(&out).starts_with("done: ran 3, cached 0"), "{out}");
    assert!(outputs(&cold) == outputs(&first) && log(&cold) == log(&first));
    // What was made again is there for the next.
    let next = House::new(CHAIN);
    let (_, out, err) = run(&next, &server, RUN);
    assert!(last_line(&out).starts_with("done: ran 0, cached 3") && !err.contains("warning: remote"), "{out}{err}");
}

#[test]
fn what_is_forbidden_is_an_error_that_says_so() {
    let (server, _) = warm();
    server.set(Faults { forbid: true, ..Faults::default() });
    let cold = House::new(CHAIN);
    let (code, _, err) = run(&cold, &server, RUN);
    assert!(code == Some(3) && err.contains("forbidden") && err.contains("AWS_ACCESS_KEY_ID"), "{err}");
    let (code, _, err) = run(&cold, &server, &["run", "p.yaml", "--remote", "ftp://x/y"]);
    assert!(code == Some(2) && err.contains("ftp://x/y") && err.contains("s3://BUCKET/PREFIX"), "{err}");
}

#[test]
fn results_that_could_not_be_uploaded_are_uploaded_by_the_next_run() {
    let (server, house) = (Server::start(), House::new(SMALL));
    server.set(Faults { hang_up: true, ..Faults::default() });
    let (code, out, err) = run(&house, &server, RUN);
    assert!(code == Some(0) && last_line(&out).starts_with("done: ran 2"), "{out}{err}");
    assert_eq!(err.matches("warning: remote").count(), 1, "{err}");
    assert!(server.objects().is_empty());
    server.set(Faults::default());
    let (_, out, err) = run(&house, &server, RUN);
    assert!(last_line(&out).starts_with("done: ran 0, cached 2") && !err.contains("warning: remote"), "{out}{err}");
    let cold = House::new(SMALL);
    let (_, out, _) = run(&cold, &server, RUN);
    assert!(last_line(&out).starts_with("done: ran 0, cached 2"), "{out}");
}

#[test]
fn store_commands_take_a_remote_place_as_they_take_a_folder() {
    let (server, house) = (Server::start(), House::new(CHAIN));
    house.rockface(&["run", "p.yaml"]);
    let folder = format!("file://{}", house.path("lab").display());
    for url in ["s3://bucket/other", &folder] {
        let (code, out, err) = run(&house, &server, &["store", "push", url]);
        assert!(code == Some(0) && out.contains("copied 3 records") && out.contains(url), "{out}{err}");
        let (_, out, _) = run(&house, &server, &["store", "push", url, "--json"]);
        let told: serde_json::Value = serde_json::from_str(&out).unwrap();
        assert!(told["known"] == 3 && told["records"] == 0 && told["remote"]["bytes_written"] == 0, "{told}");
        let (_, out, err) = run(&house, &server, &["store", "stat", url]);
        assert!(out.contains("3 records in 1 objects") && last_line(&out).contains(url), "{out}{err}");
        let (code, out, err) = run(&house, &server, &["store", "pull", url, "--store", "pulled"]);
        assert!(code == Some(0) && out.contains("copied 3 records"), "{out}{err}");
        assert_eq!(house.rockface(&["store", "verify", "--store", "pulled"]).0, Some(0));
        std::fs::remove_dir_all(house.path("pulled")).unwrap();
        let (_, out, err) = run(&house, &server, &["store", "gc", url, "--max-age", "0", "--dry-run"]);
        assert!(out.starts_with("would remove") && out.contains("3 records"), "{out}{err}");
        let (_, out, _) = run(&house, &server, &["store", "gc", url, "--max-size", "0"]);
        assert!(out.starts_with("removed"), "{out}");
    }
    assert!(Path::new(&house.path("lab/format")).is_file());
    let (code, _, err) = run(&house, &server, &["store", "stat", "folder"]);
    assert!(code == Some(2) && err.contains("--store"), "{err}");
}
