//! Several processes on one store: every program is started once in all, whatever is kept and whoever ends early.

use std::collections::BTreeMap;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use crate::cli::House;

/// A pipeline of programs each of which writes its name into a file when it starts.
pub struct Counted {
    pub house: House,
    pub steps: String,
}

impl Counted {
    pub fn new() -> Self {
        Self { house: House::new(""), steps: String::new() }
    }

    /// Adds a step: `more` stands beside its stage, `with` among its parameters, and `script` writes `{out.f}`.
    pub fn step(mut self, name: &str, more: &str, with: &str, script: &str) -> Self {
        let count = self.house.path("count").display().to_string();
        self.steps.push_str(&format!(
            "  {name}:\n    stage: command\n{more}    with:\n{with}      program: sh\n      version: POSIX sh\n      \
             outputs: {{f: {{kind: file, extension: txt}}}}\n      args: ['-c', 'echo {name} >> {count}; {script}']\n"
        ));
        self
    }

    /// Adds the step `list`, which makes a table of `rows`; `more` and `with` as for [`Counted::step`], and `first` is run before.
    fn list(mut self, more: &str, with: &str, first: &str, rows: &str) -> Self {
        let count = self.house.path("count").display().to_string();
        self.steps.push_str(&format!(
            "  list:\n    stage: command\n{more}    with:\n{with}      program: sh\n      version: POSIX sh\n      \
             outputs: {{t: {{kind: table, extension: csv}}}}\n      \
             args: ['-c', 'echo list >> {count}; {first}printf \"value\\n{rows}\\n\" > {{out.t}}']\n"
        ));
        self
    }

    pub fn write(self, head: &str) -> House {
        std::fs::write(self.house.path("p.yaml"), format!("rockface: 1\n{head}steps:\n{}", self.steps)).unwrap();
        self.house
    }
}

/// A step over `i` that takes a moment and is not kept.
pub const OVER_I: (&str, &str) = ("    over: [i]\n    keep: false\n", "      params: {i: '${i}'}\n");
/// The parameter of a step that reads one file.
pub const READS: &str = "      inputs: {f: {kind: file, extension: txt}}\n";
/// That of a step that gathers them.
pub const GATHERS: &str = "      inputs: {f: {kind: file, extension: txt, many: true}}\n";

/// The parameter of a step over the rows of a list.
const OF_ROW: &str = "      params: {i: '${row.value}'}\n";

pub fn axis(count: usize) -> String {
    format!("axes: {{i: {{count: {count}}}}}\n")
}

fn start(house: &House, more: &[&str]) -> Child {
    start_with(house, &[&["--jobs", "2"], more].concat())
}

fn start_with(house: &House, more: &[&str]) -> Child {
    let arguments = [&["run", "p.yaml", "--quiet"], more].concat();
    house.command(&arguments).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

pub fn succeed(children: Vec<Child>) {
    for child in children {
        let out = child.wait_with_output().unwrap();
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    }
}

fn run_together(house: &House, processes: usize) {
    succeed((0..processes).map(|_| start(house, &[])).collect());
    assert_eq!(std::fs::read_dir(house.path(".rockface/store/scratch")).unwrap().count(), 0, "nothing is left over");
}

/// How often each step was started since this was last asked.
pub fn starts(house: &House) -> BTreeMap<String, usize> {
    let text = std::fs::read_to_string(house.path("count")).unwrap_or_default();
    let _ = std::fs::remove_file(house.path("count"));
    let mut counts = BTreeMap::new();
    text.lines().for_each(|name| *counts.entry(name.to_owned()).or_default() += 1);
    counts
}

pub fn expect(house: &House, expected: &[(&str, usize)]) {
    let expected: BTreeMap<String, usize> = expected.iter().map(|(name, count)| ((*name).to_owned(), *count)).collect();
    assert_eq!(starts(house), expected);
}

/// Values that are not kept, each used by one step.
pub fn chains() -> House {
    let second = format!("{READS}      params: {{i: '${{i}}'}}\n");
    Counted::new()
        .step("a", OVER_I.0, OVER_I.1, "sleep 0.05; echo {param.i} > {out.f}")
        .step("b", "    keep: false\n    in: {f: a.f}\n", &second, "cat {in.f} {in.f} > {out.f}")
        .step("c", "    in: {f: b.f}\n", READS, "sleep 0.02; cat {in.f} {in.f} > {out.f}")
        .write(&axis(6))
}

/// Values that are not kept, all used by one step.
pub fn gather() -> House {
    Counted::new()
        .step("a", OVER_I.0, OVER_I.1, "sleep 0.05; echo {param.i} > {out.f}")
        .step("b", "    in: {f: {each: a.f, over: [i]}}\n", GATHERS, "cat {in.f}/*.txt > {out.f}")
        .write(&axis(6))
}

#[test]
fn chains_of_values_that_are_not_kept_run_once_over_all_processes() {
    for processes in [2, 4] {
        let house = chains();
        run_together(&house, processes);
        expect(&house, &[("a", 6), ("b", 6), ("c", 6)]);
    }
}

#[test]
fn gathered_values_that_are_not_kept_are_made_once_over_all_processes() {
    for processes in [2, 4, 8] {
        let house = gather();
        run_together(&house, processes);
        expect(&house, &[("a", 6), ("b", 1)]);
        let text = std::fs::read_to_string(house.path(".rockface/runs/latest/outputs/b/f.txt")).unwrap();
        assert_eq!(text, "0\n1\n2\n3\n4\n5\n");
    }
}

#[test]
fn values_that_are_needed_again_are_made_again_once_over_all_processes() {
    for (house, last, expected) in
        [(gather(), "b", [("a", 6), ("b", 1)].as_slice()), (chains(), "c", [("a", 6), ("b", 6), ("c", 6)].as_slice())]
    {
        run_together(&house, 1);
        expect(&house, expected);
        let text = std::fs::read_to_string(house.path("p.yaml")).unwrap();
        let changed = text.replace(&format!("echo {last} >>"), &format!("true; echo {last} >>"));
        assert_ne!(text, changed);
        std::fs::write(house.path("p.yaml"), changed).unwrap();
        run_together(&house, 4);
        expect(&house, expected);
    }
}

/// The manifests of all runs.
fn manifests(house: &House) -> Vec<serde_json::Value> {
    let runs = std::fs::read_dir(house.path(".rockface/runs")).unwrap().flatten().map(|entry| entry.path());
    let runs = runs.filter(|run| run.is_dir() && !run.is_symlink()).map(|run| run.join("run.json"));
    runs.map(|path| serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()).collect()
}

#[test]
fn values_that_another_process_made_are_fetched_for_a_step_that_gathers_them() {
    let reads = |ports: &str| format!("      inputs: {{{ports}}}\n      params: {{i: '${{i}}'}}\n");
    let (one, many) = ("{kind: file, extension: txt}", "{kind: file, extension: txt, many: true}");
    let begun = || {
        Counted::new().step("a", OVER_I.0, OVER_I.1, "echo a {param.i} > {out.f}").step(
            "b",
            "    over: [i]\n    keep: false\n    in: {f: a.f}\n",
            &reads(&format!("f: {one}")),
            "cat {in.f} {in.f} > {out.f}",
        )
    };
    let all = "      params: {i: '${i}'}\n      inputs: {f: {kind: file, extension: txt, many: true}}\n";
    let gathered = begun()
        .step("c", "    over: [i]\n    in: {f: {each: b.f, over: [i]}}\n", all, "cat {in.f}/*.txt > {out.f}")
        .write(&axis(4));
    let diamond = begun()
        .step(
            "c",
            "    over: [i]\n    keep: false\n    in: {f: {each: b.f, over: [i]}, g: a.f}\n",
            &reads(&format!("f: {many}, g: {one}")),
            "cat {in.f}/*.txt {in.g} > {out.f}",
        )
        .step("d", "    in: {f: c.f, g: b.f}\n", &reads(&format!("f: {one}, g: {one}")), "cat {in.f} {in.g} > {out.f}")
        .write(&axis(4));
    for (house, steps) in [(gathered, &["a", "b", "c"][..]), (diamond, &["a", "b", "c", "d"][..])] {
        let process = || start_with(&house, &["--jobs", "1"]);
        succeed(vec![process(), process()]);
        expect(&house, &steps.iter().map(|step| (*step, 4)).collect::<Vec<_>>());
        let manifests = manifests(&house);
        assert_eq!(manifests.len(), 2);
        for done in manifests.iter().flat_map(|manifest| manifest["steps"].as_array().unwrap()) {
            assert!(done["outputs"].is_object(), "a run that succeeded has all outputs: {done}");
        }
    }
}

/// Points that become known on the way.
pub fn dynamic() -> House {
    Counted::new()
        .step("s", "", "", "sleep 0.05; echo 1 > {out.f}")
        .list("    in: {f: s.f}\n", READS, "", "3\\n4\\n5\\n6")
        .step("a", "    keep: false\n", OF_ROW, "sleep 0.05; echo {param.i} > {out.f}")
        .step("b", "    in: {f: {each: a.f, over: [row]}}\n", GATHERS, "cat {in.f}/*.txt > {out.f}")
        .write("axes: {row: {from: list.t, reseeds: false}}\n")
}

#[test]
fn points_that_become_known_on_the_way_run_once_over_all_processes() {
    let house = dynamic();
    run_together(&house, 3);
    expect(&house, &[("s", 1), ("list", 1), ("a", 4), ("b", 1)]);
}

#[test]
fn a_value_is_held_for_points_that_become_known_later() {
    let house = Counted::new()
        .step("a", "    keep: false\n", "", "echo a > {out.f}")
        .step("early", "    in: {f: a.f}\n", READS, "cat {in.f} {in.f} > {out.f}")
        .list("", "", "sleep 0.3; ", "3\\n4")
        .step("late", "    in: {f: a.f}\n", &format!("{READS}{OF_ROW}"), "cat {in.f} > {out.f}")
        .write("axes: {row: {from: list.t, reseeds: false}}\n");
    succeed(vec![start(&house, &[])]);
    expect(&house, &[("a", 1), ("early", 1), ("list", 1), ("late", 2)]);
}

#[test]
fn a_value_is_held_for_a_step_that_only_points_known_later_read() {
    let house = Counted::new()
        .step("a", "    keep: false\n", "", "echo a > {out.f}")
        .list("    in: {f: a.f}\n", READS, "", "3\\n4")
        .step("between", "    in: {f: a.f}\n", READS, "cat {in.f} {in.f} > {out.f}")
        .step("late", "    in: {f: between.f}\n", &format!("{READS}{OF_ROW}"), "cat {in.f} > {out.f}")
        .write("axes: {row: {from: list.t, reseeds: false}}\ntargets: [late]\n");
    succeed(vec![start(&house, &[])]);
    expect(&house, &[("a", 1), ("list", 1), ("between", 1), ("late", 2)]);
}

#[test]
fn two_runs_with_different_targets_share_a_value_that_is_not_kept() {
    let house = Counted::new()
        .step("a", "    keep: false\n", "", "sleep 0.5; echo a > {out.f}")
        .step("x", "    in: {f: a.f}\n", READS, "cat {in.f} > {out.f}")
        .step("y", "    in: {f: a.f}\n", READS, "cat {in.f} {in.f} > {out.f}")
        .write("");
    succeed(vec![start(&house, &["--target", "x"]), start(&house, &["--target", "y"])]);
    expect(&house, &[("a", 1), ("x", 1), ("y", 1)]);
}

#[test]
fn what_a_killed_process_had_is_made_again_and_nothing_else() {
    let wait = "while test ! -e GO; do sleep 0.02; done; ";
    let mut counted = Counted::new();
    let go = counted.house.path("go").display().to_string();
    let script = format!("{}echo {{param.i}} > {{out.f}}", wait.replace("GO", &format!("{go}{{param.i}}")));
    counted = counted.step("a", OVER_I.0, OVER_I.1, &script);
    let house = counted
        .step("b", "    in: {f: {each: a.f, over: [i]}}\n", GATHERS, "cat {in.f}/*.txt > {out.f}")
        .write(&axis(4));
    let started = |count: usize| {
        let begun = Instant::now();
        let lines = || std::fs::read_to_string(house.path("count")).unwrap_or_default().lines().count();
        while lines() < count {
            assert!(begun.elapsed() < Duration::from_mins(1), "{} of {count} have started", lines());
            std::thread::sleep(Duration::from_millis(5));
        }
    };
    // Each has two of the four; those of the first are done, so that it waits for the other's.
    let mut first = start(&house, &[]);
    started(2);
    let second = start(&house, &[]);
    started(4);
    std::fs::write(house.path("go0"), "").unwrap();
    std::fs::write(house.path("go1"), "").unwrap();
    let room = || {
        let mut entries = std::fs::read_dir(house.path(".rockface/store/scratch")).unwrap().flatten();
        entries.any(|entry| entry.file_name().to_string_lossy().starts_with("room-"))
    };
    let begun = Instant::now();
    while !room() {
        assert!(begun.elapsed() < Duration::from_mins(1), "the first never came to wait for the other");
        std::thread::sleep(Duration::from_millis(5));
    }
    first.kill().unwrap();
    first.wait().unwrap();
    std::fs::write(house.path("go2"), "").unwrap();
    std::fs::write(house.path("go3"), "").unwrap();
    succeed(vec![second]);
    expect(&house, &[("a", 4 + 2), ("b", 1)]);
}

#[test]
fn neither_of_two_runs_only_waits_for_the_other() {
    let house = chains();
    run_together(&house, 2);
    let manifests = manifests(&house);
    assert_eq!(manifests.len(), 2);
    for manifest in manifests {
        assert!(manifest["steps"].as_array().unwrap().iter().any(|done| done["status"] == "executed"));
    }
}

#[test]
fn a_process_that_is_alone_writes_no_value_that_is_not_kept() {
    // The folder through which values go is watched by a step that runs while one is in memory.
    let house = House::new("");
    let scratch = house.path(".rockface/store/scratch").display().to_string();
    let seen = house.path("seen").display().to_string();
    let yaml = format!(
        "rockface: 1\nsteps:\n  a: {{stage: synthesise-face, keep: false, with: {{width_m: 2, height_m: 1.5, spacing_m: 0.05}}}}\n  \
         b:\n    stage: command\n    in: {{f: a.mesh}}\n    with: {{program: sh, version: sh, inputs: {{f: {{kind: mesh, extension: ply}}}}, \
         outputs: {{f: {{kind: file, extension: txt}}}}, args: ['-c', 'ls {scratch} | grep -c room > {seen}; echo > {{out.f}}']}}\n"
    );
    std::fs::write(house.path("p.yaml"), yaml).unwrap();
    run_together(&house, 1);
    assert_eq!(std::fs::read_to_string(house.path("seen")).unwrap().trim(), "0");
}
