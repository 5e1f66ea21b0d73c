//! Workers beside the run that they help, on one machine and on several: no step runs twice, whatever is kept and whoever dies.

use std::process::{Child, Stdio};
use std::time::{Duration, Instant, SystemTime};

use crate::cli::{House, SMALL, last_line};
use crate::s3::{Faults, Server};
use crate::together::{Counted, GATHERS, OVER_I, axis, chains, dynamic, expect, gather, starts, succeed};

/// Starts a process; one with a machine trusts no lock of another.
fn start(house: &House, verb: &str, machine: Option<usize>) -> Child {
    let mut command = house.command(&[verb, "p.yaml", "--jobs", "2"]);
    if let Some(machine) = machine {
        command.env("ROCKFACE_SHARED_STORE", "yes").env("ROCKFACE_MACHINE", format!("m{machine}"));
    }
    command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

/// One process that runs and others that work, each on a machine of its own if `machines`.
fn together(house: &House, count: usize, machines: bool) {
    let verb = |number: usize| if number == 0 { "run" } else { "work" };
    succeed((0..count).map(|number| start(house, verb(number), machines.then_some(number))).collect());
    for folder in ["workers", "leases"] {
        let left = std::fs::read_dir(house.path(".rockface/store").join(folder)).into_iter().flatten().flatten();
        let left: Vec<_> = left.map(|entry| entry.file_name()).collect();
        assert!(left.is_empty(), "{folder}: {left:?}");
    }
}

/// The same where each process has a store of its own, and all share a remote place. Returns what they said.
fn apart(house: &House, count: usize, remote: &str, environment: &[(&str, String)]) -> String {
    let child = |number: usize| {
        let store = format!("store-{number}");
        let verb = if number == 0 { "run" } else { "work" };
        let arguments = [verb, "p.yaml", "--jobs", "2", "--store", &store, "--remote", remote];
        let mut command = house.command(&arguments);
        command.envs(environment.iter().map(|(name, value)| (*name, value)));
        command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let children: Vec<Child> = (0..count).map(child).collect();
    let ends = children.into_iter().map(|child| child.wait_with_output().unwrap());
    let said = ends.map(|end| {
        let text = String::from_utf8_lossy(&end.stderr).into_owned();
        assert!(end.status.success(), "{text}");
        text
    });
    said.collect()
}

#[test]
fn processes_that_share_only_a_remote_place_do_every_step_once() {
    let folder = |house: &House| format!("file://{}", house.path("place").display());
    for count in [2, 4, 8] {
        let house = chains();
        apart(&house, count, &folder(&house), &[]);
        expect(&house, &[("a", 6), ("b", 6), ("c", 6)]);
    }
    let house = gather();
    apart(&house, 3, &folder(&house), &[]);
    expect(&house, &[("a", 6), ("b", 1)]);
    assert_eq!(outputs(&house, "b/f.txt"), "0\n1\n2\n3\n4\n5\n");
    let house = dynamic();
    apart(&house, 3, &folder(&house), &[]);
    expect(&house, &[("s", 1), ("list", 1), ("a", 4), ("b", 1)]);
    let left = |name: &str| std::fs::read_dir(house.path("place").join(name)).into_iter().flatten().count();
    assert_eq!((left("workers"), left("handed")), (0, 0));
}

#[test]
fn processes_that_share_only_a_bucket_do_every_step_once() {
    let server = Server::start();
    let house = chains();
    let said = apart(&house, 3, "s3://bucket/lab", &server.environment());
    expect(&house, &[("a", 6), ("b", 6), ("c", 6)]);
    assert!(!said.contains("warning"), "{said}");
    // A server that does not keep to conditions serves as well, but for what is done twice.
    server.set(Faults { ignore_conditions: true, ..Faults::default() });
    let house = gather();
    let said = apart(&house, 2, "s3://bucket/other", &server.environment());
    assert_eq!(outputs(&house, "b/f.txt"), "0\n1\n2\n3\n4\n5\n");
    assert!(said.contains("may do a step twice"), "{said}");
}

#[test]
fn what_a_process_that_was_killed_had_taken_at_a_remote_place_is_done_by_another() {
    let house = held_up();
    let place = format!("file://{}", house.path("place").display());
    let begin = |verb: &str, store: &str| {
        let mut command = house.command(&[verb, "p.yaml", "--jobs", "2", "--store", store, "--remote", &place]);
        command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let started = || started(&house);
    let mut dead = begin("work", "one");
    wait_until(&|| started() == 2);
    let other = begin("run", "other");
    wait_until(&|| started() == 4);
    dead.kill().unwrap();
    dead.wait().unwrap();
    go_on(&house);
    succeed(vec![other]);
    expect(&house, &[("a", 4 + 2), ("b", 1)]);
    assert_eq!(outputs(&house, "b/f.txt"), "0\n1\n2\n3\n");
}

#[test]
fn an_interrupted_process_gives_back_what_it_had_taken_at_a_remote_place() {
    let counted = Counted::new();
    let script = "while true; do sleep 0.02; done";
    let house = counted.step("a", OVER_I.0, OVER_I.1, script).write(&axis(2));
    let place = format!("file://{}", house.path("place").display());
    let child = house.command(&["run", "p.yaml", "--remote", &place]).stderr(Stdio::piped()).spawn().unwrap();
    let workers = || std::fs::read_dir(house.path("place/workers")).into_iter().flatten().count();
    wait_until(&|| workers() == 1 && house.path("count").exists());
    let process = rustix::process::Pid::from_raw(child.id() as i32).unwrap();
    rustix::process::kill_process(process, rustix::process::Signal::INT).unwrap();
    assert_eq!(child.wait_with_output().unwrap().status.code(), Some(130));
    assert_eq!(workers(), 0);
}

/// Values that are not kept and are gathered by one step; each waits for [`go_on`].
fn held_up() -> House {
    let counted = Counted::new();
    let go = counted.house.path("go").display().to_string();
    let script = format!("while test ! -e {go}{{param.i}}; do sleep 0.02; done; echo {{param.i}} > {{out.f}}");
    counted
        .step("a", OVER_I.0, OVER_I.1, &script)
        .step("b", "    in: {f: {each: a.f, over: [i]}}\n", GATHERS, "cat {in.f}/*.txt > {out.f}")
        .write(&axis(4))
}

fn go_on(house: &House) {
    (0..4).for_each(|number| std::fs::write(house.path(&format!("go{number}")), "").unwrap());
}

/// How many steps were started.
fn started(house: &House) -> usize {
    std::fs::read_to_string(house.path("count")).unwrap_or_default().lines().count()
}

fn wait_until(what: &dyn Fn() -> bool) {
    let begun = Instant::now();
    while !what() {
        assert!(begun.elapsed() < Duration::from_mins(2));
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn outputs(house: &House, name: &str) -> String {
    std::fs::read_to_string(house.path(".rockface/runs/latest/outputs").join(name)).unwrap()
}

#[test]
fn workers_and_the_run_they_help_do_every_step_once() {
    for count in [2, 4, 8] {
        let house = chains();
        together(&house, count, false);
        expect(&house, &[("a", 6), ("b", 6), ("c", 6)]);
    }
    let house = gather();
    together(&house, 3, false);
    expect(&house, &[("a", 6), ("b", 1)]);
    assert_eq!(outputs(&house, "b/f.txt"), "0\n1\n2\n3\n4\n5\n");
}

#[test]
fn machines_that_do_not_see_each_others_locks_do_every_step_once() {
    for count in [2, 4, 8] {
        let house = chains();
        together(&house, count, true);
        expect(&house, &[("a", 6), ("b", 6), ("c", 6)]);
    }
    let house = gather();
    together(&house, 3, true);
    expect(&house, &[("a", 6), ("b", 1)]);
    assert_eq!(outputs(&house, "b/f.txt"), "0\n1\n2\n3\n4\n5\n");
    let house = dynamic();
    together(&house, 3, true);
    expect(&house, &[("s", 1), ("list", 1), ("a", 4), ("b", 1)]);
}

#[test]
fn what_a_machine_that_died_had_is_done_again_and_nothing_else() {
    let house = held_up();
    let started = || started(&house);
    let mut dead = start(&house, "work", Some(1));
    wait_until(&|| started() == 2);
    let other = start(&house, "run", Some(2));
    wait_until(&|| started() == 4);
    dead.kill().unwrap();
    dead.wait().unwrap();
    go_on(&house);
    // No sign of life for two minutes, as the file system tells it.
    for entry in std::fs::read_dir(house.path(".rockface/store/workers")).unwrap().flatten() {
        if entry.file_name().to_string_lossy().starts_with("m1-") {
            let file = std::fs::File::options().write(true).open(entry.path()).unwrap();
            file.set_modified(SystemTime::now() - Duration::from_mins(2)).unwrap();
        }
    }
    succeed(vec![other]);
    expect(&house, &[("a", 4 + 2), ("b", 1)]);
    assert_eq!(outputs(&house, "b/f.txt"), "0\n1\n2\n3\n");
}

#[test]
fn several_machines_and_one_process_make_the_same_bytes() {
    let (one, many) = (House::new(SMALL), House::new(SMALL));
    together(&one, 1, false);
    together(&many, 3, true);
    for file in ["run.mcap", "outputs/dem/raster.tif", "outputs/face/mesh.ply"] {
        let read = |house: &House| std::fs::read(house.path(".rockface/runs/latest").join(file)).unwrap();
        assert!(read(&one) == read(&many), "{file}");
    }
    // What several machines have left is a store like any other.
    let (code, out, err) = many.rockface(&["store", "verify"]);
    assert_eq!(code, Some(0), "{out}{err}");
    let (code, out, err) = many.rockface(&["store", "gc"]);
    assert_eq!(code, Some(0), "{out}{err}");
    let (_, out, _) = many.rockface(&["run", "p.yaml"]);
    assert!(last_line(&out).starts_with("done: ran 0, cached 2"), "{out}");
}

#[test]
fn a_run_is_watched_from_its_files_and_nothing_is_changed() {
    let counted = Counted::new();
    let go = counted.house.path("go").display().to_string();
    let script = format!("while test ! -e {go}; do sleep 0.02; done; echo {{param.i}} > {{out.f}}");
    let house = counted.step("a", OVER_I.0, OVER_I.1, &script).write(&axis(4));
    let watch = |more: &[&str]| house.rockface(&[["watch", "p.yaml"].as_slice(), more].concat());
    let (code, out, err) = watch(&["--once"]);
    assert!(code == Some(2) && out.is_empty() && err.contains("there is no store in .rockface/store"), "{out}{err}");
    assert!(!house.path(".rockface").exists(), "who watches makes nothing");
    drop(rockface_cache::Store::open(&house.path(".rockface/store")).unwrap());
    let (code, out, _) = watch(&["--once"]);
    assert_eq!((code, out.as_str()), (Some(0), "nobody works on it, and no run of it has ended yet\n"));
    // What cannot be looked at is not nobody: here a file is in the place of the folder.
    std::fs::write(house.path(".rockface/store/workers"), "").unwrap();
    let (code, out, err) = watch(&["--once"]);
    assert!(code == Some(3) && out.is_empty() && err.contains("store/workers"), "{out}{err}");
    std::fs::remove_file(house.path(".rockface/store/workers")).unwrap();
    let children = vec![start(&house, "run", None), start(&house, "work", None)];
    let begun = Instant::now();
    let seen = loop {
        let (_, out, err) = watch(&["--once", "--json"]);
        let seen: serde_json::Value = serde_json::from_str(&out).unwrap_or_else(|_| panic!("{out}{err}"));
        let running: usize =
            seen["workers"].as_array().unwrap().iter().map(|worker| worker["running"].as_array().unwrap().len()).sum();
        if running == 4 {
            break seen;
        }
        assert!(begun.elapsed() < Duration::from_mins(1), "{seen}");
    };
    assert_eq!((&seen["done"], &seen["total"]), (&0.into(), &4.into()));
    let (_, out, _) = watch(&["--once"]);
    assert!(out.starts_with("0 of 4 steps done") && out.contains("2 processes") && out.contains("runs a[i="), "{out}");
    std::fs::write(house.path("go"), "").unwrap();
    let (code, out, _) = watch(&["--interval", "0.1"]);
    assert!(code == Some(0) && last_line(&out).starts_with("nobody works on it; the last run ended "), "{out}");
    succeed(children);
    for what in ["latest", "p.yaml"] {
        let (code, out, _) = house.rockface(&["watch", what]);
        assert!(code == Some(0) && out.contains("ended ") && out.contains("failed 0; results in "), "{out}");
    }
    assert_eq!(starts(&house).values().sum::<usize>(), 4);
    // A past run is shown without a store; of a pipeline, how it ended is said beside the fault.
    let (code, out, err) = house.rockface(&["watch", "latest", "--store", "nowhere"]);
    assert!(code == Some(0) && out.contains("failed 0; results in "), "{out}{err}");
    let (code, out, err) = house.rockface(&["watch", "p.yaml", "--store", "nowhere"]);
    assert!(code == Some(2) && out.is_empty() && err.contains("there is no store in nowhere"), "{out}{err}");
    assert!(err.contains("the last run of it here ended ") && err.contains("failed 0; results in "), "{err}");
}

#[test]
fn every_option_of_submit_that_is_for_the_work_reaches_the_script() {
    let house = House::new(SMALL);
    let place = format!("file://{}", house.path("place").display());
    let (store, runs) = (house.path("s"), house.path("r"));
    let of_both: [(&str, &str); 11] = [
        ("--target", "dem"),
        ("--set", "steps.face.with.width_m=2"),
        ("--sweep", "steps.dem.with.cell_m=0.1,0.2"),
        ("--seed", "3"),
        ("--store", store.to_str().unwrap()),
        ("--remote", &place),
        ("--remote-read-only", ""),
        ("--no-commands", ""),
        ("--memory", "0.5"),
        ("--keep-going", ""),
        ("--recorded-inputs", ""),
    ];
    let of_run = ("--runs", runs.to_str().unwrap());
    // None is forgotten here.
    let (_, help, _) = house.rockface(&["submit", "--help"]);
    let names = help
        .lines()
        .filter_map(|line| line.strip_prefix("      ")?.split(' ').next().filter(|word| word.starts_with("--")));
    let known = |name: &&str| {
        of_both.iter().chain([&of_run]).any(|(known, _)| known == name)
            || ["--slurm", "--hyperqueue", "--dry-run"].contains(name)
    };
    let unknown: Vec<&str> = names.filter(|name| !known(name)).collect();
    assert!(help.contains("--target") && unknown.is_empty(), "{unknown:?}: {help}");
    let given =
        of_both.iter().chain([&of_run]).flat_map(|(name, value)| [*name, *value]).filter(|word| !word.is_empty());
    let arguments: Vec<&str> =
        ["submit", "p.yaml", "--dry-run", "--slurm", "--array=0-1"].into_iter().chain(given).collect();
    let (code, script, err) = house.rockface(&arguments);
    assert_eq!(code, Some(0), "{err}");
    for verb in [" run ", " work "] {
        let line = script.lines().find(|line| line.contains("exec ") && line.contains(verb)).unwrap();
        for (name, value) in of_both {
            let told = if value.is_empty() { format!(" {name} ") } else { format!(" {name} {value} ") };
            assert!(line.contains(&told), "{told}: {line}");
        }
        assert_eq!(line.contains(&format!(" --runs {} ", of_run.1)), verb == " run ", "{line}");
    }
    let (_, out, _) =
        house.rockface(&["submit", "p.yaml", "--dry-run", "--hyperqueue", "--array=0-1 --cpus=\"2 compact\""]);
    assert!(out.starts_with("hq submit --name rockface-small --array=0-1 '--cpus=2 compact' -- "), "{out}");
}

#[test]
fn what_is_submitted_is_printed_first() {
    let house = House::new(SMALL);
    let submit = |more: &[&str]| house.rockface(&[["submit", "p.yaml", "--dry-run"].as_slice(), more].concat());
    let (code, out, err) =
        submit(&["--slurm", "--array=0-7 --cpus-per-task=4", "--set", "steps.dem.with.cell_m=0.1", "--seed", "3"]);
    assert_eq!(code, Some(0), "{err}");
    for part in [
        "#!/bin/sh\n",
        "#SBATCH --job-name=rockface-small\n",
        "#SBATCH --array=0-7 --cpus-per-task=4\n",
        " run /",
        " work /",
        "/p.yaml --store /",
        "--set steps.dem.with.cell_m=0.1 --seed 3 --jobs \"$jobs\"",
    ] {
        assert!(out.contains(part), "{part}: {out}");
    }
    let (_, out, _) = submit(&["--hyperqueue", "--array=0-7 --cpus=4"]);
    assert!(out.starts_with("hq submit --name rockface-small --array=0-7 --cpus=4 -- /bin/sh -c "), "{out}");
    let (_, out, _) = submit(&["--hyperqueue", "--array=1-4"]);
    assert!(out.contains("[ \"${HQ_TASK_ID:-1}\" = 1 ]"), "the least task writes the run: {out}");
    assert!(!house.path(".rockface").exists(), "nothing is made");
    let (code, _, err) = house.rockface(&["submit", "p.yaml"]);
    assert!(code == Some(2) && err.contains("--slurm") && err.contains("--hyperqueue"), "{err}");
    let (code, _, err) = house.rockface(&["submit", "p.yaml", "--slurm", "", "--set", "steps.dem.with.cell=1"]);
    assert!(code == Some(2) && err.contains("unknown parameter `cell`"), "{err}");
    // The script is one that a shell runs: as the only task of an array, it runs the pipeline.
    let (_, script, _) = submit(&["--slurm", "--array=0-0"]);
    let mut shell = std::process::Command::new("sh");
    let out = shell.args(["-c", &script]).current_dir(house.path("")).output().unwrap();
    assert!(String::from_utf8_lossy(&out.stdout).contains("done: ran 2"), "{out:?}");
    let (_, script, _) = submit(&["--slurm", "--array=0-1"]);
    let mut shell = std::process::Command::new("sh");
    shell.env("SLURM_ARRAY_TASK_ID", "1").env("SLURM_ARRAY_TASK_MIN", "0");
    let out = shell.args(["-c", &script]).current_dir(house.path("")).output().unwrap();
    assert!(String::from_utf8_lossy(&out.stdout).starts_with("done: ran 0 of 2 steps"), "{out:?}");
}
