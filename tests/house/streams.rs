//! Standard streams that are full, closed or gone, and signals: nothing panics, nothing is lost, the exit code is right.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::process::{Command, Stdio};

use crate::cli::{House, SMALL, last_line};

fn full() -> File {
    File::options().write(true).open("/dev/full").unwrap()
}

#[test]
fn errors_that_cannot_be_written_change_no_exit_code() {
    let house = House::new(SMALL);
    for (arguments, code) in [
        (&["run", "nosuch.yaml"][..], 2),
        (&["run", "p.yaml", "--set", "steps.dem.with.window_m=[0, 1, 0, 1e9]"][..], 1),
        (&["run", "p.yaml", "--verbose"][..], 0),
        (&["stages", "no-such-stage"][..], 2),
        (&["no-such-command"][..], 2),
    ] {
        let status = house.command(arguments).stderr(full()).stdout(Stdio::null()).status().unwrap();
        assert_eq!(status.code(), Some(code), "{arguments:?}");
    }
}

#[test]
fn results_that_cannot_be_written_are_a_fault_of_the_disk() {
    let house = House::new(SMALL);
    for arguments in
        [&["run", "p.yaml"][..], &["stages"], &["--help"], &["--version"], &["run", "p.yaml", "--json", "--seed", "2"]]
    {
        let out = house.command(arguments).stdout(full()).stderr(Stdio::piped()).output().unwrap();
        let err = String::from_utf8(out.stderr).unwrap();
        assert_eq!(out.status.code(), Some(3), "{arguments:?}: {err}");
        assert_eq!(err.matches("cannot write to standard output").count(), 1, "{err}");
        let status = house.command(arguments).stdout(full()).stderr(full()).status().unwrap();
        assert_eq!(status.code(), Some(3), "{arguments:?}");
    }
    let (_, out, _) = house.rockface(&["run", "p.yaml"]);
    assert!(last_line(&out).starts_with("done: ran 0, cached 2,"), "the run was done all the same: {out}");
}

#[test]
fn a_reader_that_goes_away_ends_the_writing_and_nothing_else() {
    let house = House::new(SMALL);
    for arguments in [&["stages"][..], &["run", "p.yaml", "--json"], &["--help"], &["stages", "--schema"]] {
        let mut child = house.command(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        let mut err = String::new();
        child.stderr.take().unwrap().read_to_string(&mut err).unwrap();
        assert_eq!((child.wait().unwrap().code(), err.as_str()), (Some(0), ""), "{arguments:?}");
    }
    assert!(house.path(".rockface/runs/latest/run.json").is_file());
}

#[test]
fn closed_streams_are_as_good_as_none() {
    let house = House::new(SMALL);
    let program = env!("CARGO_BIN_EXE_rockface");
    for (redirected, code) in [
        ("stages >&-", 0),
        ("run p.yaml <&- >&- 2>&-", 0),
        ("run nosuch.yaml 2>&-", 2),
        ("run p.yaml --json --seed 3 >&-", 0),
        ("store stat <&-", 0),
    ] {
        let mut shell = Command::new("sh");
        shell.current_dir(house.path("")).args(["-c", &format!("{program} {redirected}")]).env_remove("ROCKFACE_STORE");
        assert_eq!(shell.stdout(Stdio::null()).status().unwrap().code(), Some(code), "{redirected}");
    }
}

/// Begins a run of a program that takes half a minute, unless a file is there; ready when the program runs.
fn napping(house: &House, prefix: &str) -> (std::process::Child, impl Iterator<Item = String> + use<>) {
    let script = format!(
        "echo here > {0}; for i in 1 2 3 4 5 6; do for j in 1 2 3 4 5 6 7 8 9 0; do test -e {1} || sleep 0.5; done; done; echo a > {{out.f}}",
        house.path("naps").display(),
        house.path("go").display()
    );
    let yaml = format!(
        "rockface: 1\nsteps:\n  first: {{stage: synthesise-face, with: {{width_m: 2, height_m: 1.5, spacing_m: 0.05}}}}\n  nap:\n    stage: command\n    in: {{f: first.mesh}}\n    with: {{program: sh, args: ['-c', '{script}'], inputs: {{f: {{kind: mesh, extension: ply}}}}, outputs: {{f: {{kind: file, extension: txt}}}}, version: any}}\n"
    );
    std::fs::write(house.path("p.yaml"), yaml).unwrap();
    // These tests may themselves run without a terminal to lose (`nohup cargo test`), and a signal ignored is inherited.
    let heard = if prefix.is_empty() { "env --default-signal=HUP" } else { "" };
    let command = format!("{prefix} exec {heard} {} run p.yaml --verbose", env!("CARGO_BIN_EXE_rockface"));
    let mut shell = Command::new("sh");
    let mut child = shell
        .current_dir(house.path(""))
        .args(["-c", &command])
        .env_remove("ROCKFACE_STORE")
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
    assert!(lines.by_ref().any(|line| line.contains("started  nap")));
    while !house.path("naps").exists() {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    (child, lines)
}

fn signal(child: &std::process::Child, name: &str) {
    assert!(Command::new("kill").args([name, &child.id().to_string()]).status().unwrap().success());
}

#[test]
fn the_end_of_the_terminal_ends_a_run_tidily_and_is_often_told_twice() {
    let house = House::new("");
    let (mut child, lines) = napping(&house, "");
    signal(&child, "-HUP");
    signal(&child, "-HUP");
    let rest: Vec<String> = lines.collect();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{rest:?}");
    assert!(rest.iter().any(|line| line.contains("interrupted")), "{rest:?}");
    assert_eq!(std::fs::read_dir(house.path(".rockface/store/scratch")).unwrap().count(), 0);
    std::fs::write(house.path("go"), "").unwrap();
    let (code, out, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(last_line(&out).starts_with("done: ran 1, cached 1,"), "{out}");
}

#[test]
fn a_run_that_is_to_outlive_its_terminal_goes_on() {
    let house = House::new("");
    let (mut child, lines) = napping(&house, "trap '' HUP;");
    signal(&child, "-HUP");
    std::fs::write(house.path("go"), "").unwrap();
    let rest: Vec<String> = lines.collect();
    assert_eq!(child.wait().unwrap().code(), Some(0), "{rest:?}");
}
