//! Programs as steps: what they are given, what they leave, and how they are ended.

use std::time::{Duration, Instant};

use rockface_core::artefact::{File, Table};
use rockface_engine::run::Options;
use rockface_engine::watch::Event;

use crate::cli::House;
use crate::lab::{Bench, Ran};

fn command(with: &str) -> String {
    format!(
        "rockface: 1\nsteps:\n  c:\n    stage: command\n    with:\n      program: sh\n      version: POSIX sh\n      \
         outputs: {{t: {{kind: table, extension: csv}}, f: {{kind: file, extension: txt}}}}\n{with}"
    )
}

fn failure(ran: &Ran) -> String {
    let failed = ran.events.iter().find_map(|event| match event {
        Event::Failed { message, hint, .. } => Some(format!("{message} | {}", hint.as_deref().unwrap_or_default())),
        _ => None,
    });
    failed.expect("it should have failed")
}

#[test]
fn a_program_makes_artefacts_and_runs_again_when_its_script_changes() {
    let bench = Bench::rocks();
    let script = bench.folder.path().join("make.sh");
    std::fs::write(&script, "echo a,b > $1; echo 1,x >> $1; echo $NAME $2 > $3; echo said >&2").unwrap();
    let yaml = command(
        "      files: {s: make.sh}\n      environment: {NAME: me}\n      params: {k: 0.5}\n      \
         args: ['{file.s}', '{out.t}', '{param.k}', '{out.f}']\n",
    );
    let ran = bench.run(&yaml, &[]);
    let table: Table = ran.value(&bench.store, "c", "t");
    let file: File = ran.value(&bench.store, "c", "f");
    assert_eq!(
        (table.columns.as_slice(), table.rows[0][0].number()),
        (&["a".to_owned(), "b".to_owned()][..], Some(1.0))
    );
    assert_eq!(file.bytes, b"me 0.5\n");
    assert!(bench.run(&yaml, &[]).executed().is_empty());
    assert_eq!(bench.run(&yaml, &["steps.c.with.params.k=1"]).executed(), ["c"]);
    assert_eq!(bench.run(&yaml, &["steps.c.with.version=another"]).executed(), ["c"]);
    std::fs::write(&script, "echo a > $1; echo 2 >> $1; echo > $3").unwrap();
    assert_eq!(bench.run(&yaml, &[]).executed(), ["c"]);
}

#[test]
fn gathered_inputs_come_with_their_points() {
    let yaml = "
rockface: 1
axes: {k: {values: [5, 7]}}
steps:
  made:
    stage: command
    with: {program: sh, version: sh, outputs: {f: {kind: file, extension: txt}}, params: {k: '${k}'}, args: ['-c', 'echo {param.k} > {out.f}']}
  joined:
    stage: command
    in: {all: {each: made.f, over: [k]}}
    with:
      program: sh
      version: sh
      inputs: {all: {kind: file, extension: txt, many: true}}
      outputs: {f: file}
      args: ['-c', 'cat {in.all}/*.txt {in.all}/index.json > {out.f}']
";
    let bench = Bench::rocks();
    let ran = bench.run(yaml, &[]);
    let file: File = ran.value(&bench.store, "joined", "f");
    let text = String::from_utf8(file.bytes).unwrap();
    assert!(text.starts_with("5\n7\n[") && text.contains(r#"{"k":"7"}"#), "{text}");
}

#[test]
fn a_program_that_fails_says_why() {
    let bench = Bench::rocks();
    let fails = |script: &str| failure(&bench.run(&command(&format!("      args: ['-c', '{script}']\n")), &[]));
    let code = fails("echo bad luck >&2; exit 3");
    assert!(code.contains("code 3") && code.contains("bad luck"), "{code}");
    let missing = fails("echo a > {out.t}");
    assert!(missing.contains("no output `f`") && missing.contains("out/f.txt"), "{missing}");
    let broken = fails("echo > {out.f}; printf \"a,b\\n1\\n\" > {out.t}");
    assert!(broken.contains("output `t`") && broken.contains("is no table"), "{broken}");
    let empty = fails("echo > {out.f}; : > {out.t}");
    assert!(empty.contains("output `t`") && empty.contains("first line names no column"), "{empty}");
    let absent = failure(&bench.run(&command("").replace("program: sh", "program: no-such-program"), &[]));
    assert!(absent.contains("cannot run `no-such-program`"), "{absent}");
}

#[test]
fn a_timeout_ends_a_program_and_its_children_and_retries_try_again() {
    let bench = Bench::rocks();
    let begun = Instant::now();
    let slow = command("      args: ['-c', 'sleep 60 & sleep 60']\n    timeout: 300ms\n    retries: 1\n");
    let said = failure(&bench.run(&slow, &[]));
    assert!(said.contains("timeout of 300ms"), "{said}");
    assert!(begun.elapsed() < Duration::from_secs(20));
    let flag = bench.folder.path().join("tried");
    let script = format!(
        "if test -e {0}; then echo a > {{out.t}}; echo > {{out.f}}; else touch {0}; exit 1; fi",
        flag.display()
    );
    let flaky = bench.run(&command(&format!("      args: ['-c', '{script}']\n    retries: 2\n")), &[]);
    assert!(!flaky.summary.failed && flaky.warnings()[0].contains("attempt 1 of 3"), "{:?}", flaky.warnings());
}

#[test]
fn tables_of_programs_are_read_as_table_files_are() {
    let bench = Bench::rocks();
    let make = |text: &str| {
        bench.run(&command(&format!("      args: ['-c', 'printf \"{text}\" > {{out.t}}; echo > {{out.f}}']\n")), &[])
    };
    let ran = make("a;b\\\\n1.5;x\\\\nnan;true\\\\n");
    let table: Table = ran.value(&bench.store, "c", "t");
    assert_eq!(table.rows, [vec![1.5.into(), "x".into()], vec![f64::NAN.into(), true.into()]]);
    assert!(failure(&make("a,a\\\\n1,2\\\\n")).contains("two columns are called `a`"));
}

#[test]
fn nothing_a_program_leaves_running_outlives_its_step() {
    let bench = Bench::rocks();
    let pid = bench.folder.path().join("pid");
    let script = format!("sleep 60 & echo $! > {}; echo a > {{out.t}}; echo > {{out.f}}", pid.display());
    let ran = bench.run(&command(&format!("      args: ['-c', '{script}']\n")), &[]);
    assert!(!ran.summary.failed);
    let place = format!("/proc/{}/cmdline", std::fs::read_to_string(pid).unwrap().trim());
    let runs = || std::fs::read(&place).is_ok_and(|line| line.starts_with(b"sleep"));
    let begun = Instant::now();
    while runs() && begun.elapsed() < Duration::from_secs(20) {
        std::thread::sleep(Duration::from_millis(20));
    }
    assert!(!runs(), "{place} goes on");
}

#[test]
fn a_program_that_draws_gets_another_number_at_each_replicate() {
    let yaml = "
rockface: 1
seed: 1
axes: {k: {count: 3}}
steps:
  c:
    stage: command
    over: [k]
    with: {program: sh, version: sh, outputs: {f: file}, args: ['-c', 'echo {seed} > {out.f}']}
";
    let bench = Bench::rocks();
    let numbers = |set: &[&str]| {
        let ran = bench.run_with(yaml, set, &Options { jobs: 2, ..Options::default() });
        let number = |k: usize| {
            let file: File = ran.value(&bench.store, &format!("c[k={k}]"), "f");
            String::from_utf8(file.bytes).unwrap().trim().parse::<u32>().unwrap()
        };
        [number(0), number(1), number(2)]
    };
    let (one, other) = (numbers(&[]), numbers(&["seed=2"]));
    assert!(one[0] != one[1] && one[1] != one[2] && one != other && one == numbers(&[]), "{one:?} {other:?}");
}

#[test]
fn a_signal_is_named_and_a_folder_in_place_of_a_file_told() {
    let bench = Bench::rocks();
    let fails = |script: &str| failure(&bench.run(&command(&format!("      args: ['-c', '{script}']\n")), &[]));
    let killed = fails("kill -SEGV $$");
    assert!(killed.contains("was ended by SIGSEGV (signal 11"), "{killed}");
    let folder = fails("echo a > {out.t}; mkdir {out.f}");
    assert!(folder.contains("made a folder where its output `f` is to be a file"), "{folder}");
    let left = std::fs::read_dir(bench.folder.path().join("store/scratch")).unwrap().count();
    assert_eq!(left, 0, "the folders programs work in are gone");
}

#[test]
fn a_program_that_is_interrupted_has_not_failed() {
    let house = House::new(
        "rockface: 1\nsteps:\n  nap:\n    stage: command\n    with: {program: sleep, args: [\"30\"], outputs: {n: {kind: file, extension: txt}}, version: any}\n",
    );
    let mut child =
        house.command(&["run", "p.yaml", "--verbose"]).stderr(std::process::Stdio::piped()).spawn().unwrap();
    let mut lines = std::io::BufRead::lines(std::io::BufReader::new(child.stderr.take().unwrap()));
    assert!(lines.by_ref().any(|line| line.unwrap().contains("started  nap")));
    let id = child.id().to_string();
    assert!(std::process::Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    let rest: Vec<String> = lines.map(Result::unwrap).collect();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{rest:?}");
    assert!(rest.iter().all(|line| !line.contains("failed")) && rest.iter().any(|line| line.contains("interrupted")));
}

#[test]
fn a_failed_step_leaves_why_it_failed_and_what_it_said() {
    let house = House::new(
        "rockface: 1\naxes: {i: {count: 3}}\nsteps:\n  a:\n    stage: command\n    over: [i]\n    retries: 1\n    with:\n      \
         program: sh\n      version: POSIX sh\n      params: {i: '${i}'}\n      outputs: {f: {kind: file, extension: txt}}\n      \
         args: ['-c', 'echo hello {param.i}; echo oh dear >&2; test {param.i} != 1 && echo {param.i} > {out.f}']\n  \
         b: {stage: command, in: {f: a.f}, with: {program: cp, version: any, inputs: {f: {kind: file, extension: txt}}, \
         args: ['{in.f}', '{out.f}'], outputs: {f: {kind: file, extension: txt}}}}\n",
    );
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--keep-going", "--quiet"]);
    assert_eq!(code, Some(1), "{err}");
    let folder = house.path(".rockface/runs/latest");
    let text = std::fs::read_to_string(folder.join("run.json")).unwrap();
    let run: serde_json::Value = serde_json::from_str(&text).unwrap();
    let told = |step: &str| {
        let is_meant = |done: &&serde_json::Value| done["step"] == step && done["point"]["i"] == "1";
        run["steps"].as_array().unwrap().iter().find(is_meant).unwrap().clone()
    };
    let (failed, beyond) = (told("a"), told("b"));
    assert!(failed["status"] == "failed" && beyond["status"] == "not reached" && beyond.get("failure").is_none());
    assert!(failed["failure"].as_str().unwrap().contains("ended with code 1, saying\n  oh dear"), "{failed}");
    for command in [["runs", "show", "latest"].as_slice(), &["inspect", ".rockface/runs/latest"]] {
        let (_, out, _) = house.rockface(command);
        assert!(out.contains("a[i=1]: `sh` ended with code 1"), "{out}");
    }
    let (_, log, _) = house.rockface(&["inspect", failed["log"].as_str().unwrap()]);
    assert!(log.contains("hello 1") && log.contains("attempt 1 of 2 failed"), "{log}");
    let page = std::fs::read_to_string(folder.join("report.html")).unwrap();
    assert!(page.contains("<h2>Failures</h2>") && page.contains("oh dear"));
    let log = std::fs::read(folder.join("run.mcap")).unwrap();
    let said = |message: &mcap::Message| String::from_utf8_lossy(&message.data).into_owned();
    let said: Vec<String> = mcap::MessageStream::new(&log).unwrap().map(|message| said(&message.unwrap())).collect();
    assert!(said.iter().any(|text| text.contains("failed: `sh` ended with code 1")), "{said:?}");
}

#[test]
fn a_record_counts_what_its_program_took() {
    let bench = Bench::rocks();
    let script = "i=0; while test $i -lt 60000; do i=$((i + 1)); done; echo a > {out.t}; echo > {out.f}";
    let ran = bench.run(&command(&format!("      args: ['-c', '{script}']\n")), &[]);
    let cost = ran.summary.instances[0].outcome.as_ref().unwrap().cost;
    assert!(cost.cpu_s > 0.01 && cost.peak_bytes > 500_000, "{cost:?}");
}

#[test]
fn a_program_that_changed_is_told_of_and_what_it_made_is_kept() {
    let house = House::new(
        "rockface: 1\naxes: {k: {count: 3}}\nsteps:\n  c:\n    stage: command\n    over: [k]\n    with:\n      program: mytool\n      \
         version: one\n      params: {k: '${k}'}\n      args: ['{out.f}', '{param.k}']\n      outputs: {f: {kind: file, extension: txt}}\n",
    );
    let tool = |folder: &str, text: &str| {
        use std::os::unix::fs::PermissionsExt;
        std::fs::create_dir_all(house.path(folder)).unwrap();
        let path = house.path(folder).join("mytool");
        std::fs::write(&path, format!("#!/bin/sh\n{text}")).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
        let past = std::time::SystemTime::now() - Duration::from_hours(1);
        std::fs::File::open(&path).unwrap().set_modified(past).unwrap();
        std::thread::sleep(Duration::from_millis(25));
    };
    let search =
        format!("{}:{}:{}", house.path("first").display(), house.path("bin").display(), std::env::var("PATH").unwrap());
    let rockface = |arguments: &[&str]| {
        let output = house.command(arguments).env("PATH", &search).output().unwrap();
        (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap())
    };
    tool("bin", "echo $2 > $1");
    let (out, err) = rockface(&["run", "p.yaml"]);
    assert!(out.contains("ran 3, cached 0"), "{out}{err}");
    for _ in 0..2 {
        let (out, err) = rockface(&["run", "p.yaml"]);
        assert!(out.contains("ran 0, cached 3") && !err.contains("has changed"), "{out}{err}");
    }
    tool("bin", "echo other $2 > $1");
    for command in [["run", "p.yaml"], ["run", "p.yaml"], ["plan", "p.yaml"]] {
        let (out, err) = rockface(&command);
        assert!(out.contains("ran 0, cached 3") || out.contains("3 hit"), "{out}");
        assert_eq!(err.matches("the program `mytool`").count(), 1, "{err}");
        assert!(err.contains("has changed since it made 3 results") && err.contains("change `version`"), "{err}");
    }
    tool("bin", "echo $2 > $1");
    assert!(!rockface(&["run", "p.yaml"]).1.contains("has changed"), "the same bytes are the same program");
    tool("first", "echo earlier on the search path");
    assert!(rockface(&["run", "p.yaml"]).1.contains("first/mytool) has changed"));
    std::fs::remove_file(house.path("first/mytool")).unwrap();
    tool("bin", "echo other $2 > $1");
    let (out, err) = rockface(&["run", "p.yaml", "--set", "steps.c.with.version=two"]);
    assert!(out.contains("ran 3") && !err.contains("has changed"), "{out}{err}");
}

#[test]
fn a_number_for_a_program_is_one_however_it_is_written() {
    let bench = Bench::rocks();
    let yaml =
        command("      params: {v: 1, w: 0.5}\n      args: ['-c', 'echo a > {out.t}; echo {param.v} > {out.f}']\n");
    let ran = bench.run(&yaml, &[]);
    assert_eq!(ran.value::<File>(&bench.store, "c", "f").bytes, b"1\n");
    for same in ["v=1.0", "v=1e0", "w=5e-1"] {
        assert!(bench.run(&yaml, &[&format!("steps.c.with.params.{same}")]).executed().is_empty(), "{same}");
    }
    assert_eq!(bench.run(&yaml, &["steps.c.with.params.v='1.0'"]).executed(), ["c"], "text stays as it is written");
    assert_eq!(bench.run(&yaml, &["steps.c.with.params.v=-1"]).executed(), ["c"]);
}
