//! Campaigns against the store: runs killed at any moment, two at once, a full disk, a sweep of a thousand points.

use std::collections::BTreeMap;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::cli::{House, last_line};
use crate::lab::Bench;

/// Forty small faces, each brought onto a raster: work enough to be killed in.
const GRAPH: &str = "
rockface: 1
name: campaign
seed: 1
axes: {k: {count: 40}}
steps:
  face: {stage: synthesise-face, over: [k], with: {width_m: 3, height_m: 2, spacing_m: 0.05}}
  dem: {stage: rasterise-dem, in: {surface: face.mesh}, with: {cell_m: 0.05, method: tin}}
";

/// Whether the long form of a test is wanted.
fn slow() -> bool {
    std::env::var_os("ROCKFACE_SLOW").is_some()
}

/// The digests of the newest run, by instance and port.
fn digests(house: &House) -> BTreeMap<String, String> {
    let manifest = std::fs::read(house.path(".rockface/runs/latest/run.json")).unwrap();
    let manifest: Value = serde_json::from_slice(&manifest).unwrap();
    let steps = manifest["steps"].as_array().unwrap().iter().flat_map(|done| {
        let outputs = done["outputs"].as_object().unwrap().iter();
        outputs.map(move |(port, output)| {
            (format!("{}{}.{port}", done["step"], done["point"]), output["digest"].to_string())
        })
    });
    steps.collect()
}

fn spawn(house: &House, arguments: &[&str]) -> Child {
    house.command(arguments).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap()
}

/// A plain congruential sequence: moments that are no pattern, the same every time.
fn moments(count: usize, most_ms: u64) -> impl Iterator<Item = Duration> {
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    std::iter::repeat_with(move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        Duration::from_millis((state >> 33) % most_ms)
    })
    .take(count)
}

fn executed(lines: &str) -> Vec<String> {
    let events = lines.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    let finished = events.filter(|event| event["event"] == "finished");
    finished.filter_map(|event| Some(event["step"].as_str()?.to_owned())).collect()
}

#[test]
fn killed_at_any_moment_a_run_accepts_nothing_torn_and_redoes_no_more_than_was_in_flight() {
    let whole = House::new(GRAPH);
    let started = Instant::now();
    whole.rockface(&["run", "p.yaml", "--quiet"]);
    let most_ms = (started.elapsed().as_millis() as u64).clamp(50, 4000);
    let expected = digests(&whole);
    assert_eq!(expected.len(), 80);
    let kills = if slow() { 200 } else { 12 };
    let mut house = House::new(GRAPH);
    let mut told: BTreeMap<String, u32> = BTreeMap::new();
    let mut in_flight = 0;
    for moment in moments(kills, most_ms) {
        let mut child = spawn(&house, &["run", "p.yaml", "--json", "--jobs", "2"]);
        std::thread::sleep(moment);
        // The run may have ended by itself.
        let _ = child.kill();
        let out = child.wait_with_output().unwrap();
        in_flight += 2;
        for step in executed(&String::from_utf8_lossy(&out.stdout)) {
            *told.entry(step).or_default() += 1;
        }
        if out.status.success() {
            assert_eq!(digests(&house), expected);
            assert_redone(&told, in_flight);
            (house, told, in_flight) = (House::new(GRAPH), BTreeMap::new(), 0);
        }
    }
    let (code, out, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "no manual unlock, no leftover in the way: {out}{err}");
    assert_eq!(digests(&house), expected);
    assert_redone(&told, in_flight);
    let (code, out, _) = house.rockface(&["store", "verify"]);
    assert_eq!(code, Some(0), "{out}");
}

/// What a run said it had finished is never done again.
fn assert_redone(told: &BTreeMap<String, u32>, in_flight: u32) {
    let redone: Vec<_> = told.iter().filter(|(_, count)| **count > 1).collect();
    assert!(redone.is_empty(), "{redone:?} were done again, {in_flight} were in flight");
}

#[test]
fn two_runs_at_once_share_the_work() {
    let house = House::new(GRAPH);
    let children = [(); 2].map(|()| spawn(&house, &["run", "p.yaml", "--json", "--jobs", "2"]));
    let outs = children.map(|child| child.wait_with_output().unwrap());
    let mut all = Vec::new();
    for out in outs {
        assert_eq!(out.status.code(), Some(0));
        all.extend(executed(&String::from_utf8_lossy(&out.stdout)));
    }
    all.sort();
    let count = all.len();
    all.dedup();
    assert_eq!((count, all.len()), (80, 80), "each step ran once in all");
}

#[test]
fn a_full_disk_ends_a_run_with_its_own_code_and_the_next_goes_on() {
    let house = House::new(&GRAPH.replace("width_m: 3, height_m: 2", "width_m: 12, height_m: 8"));
    let disk = house.path("disk");
    std::fs::create_dir(&disk).unwrap();
    let Some(_mounted) = Mounted::new(&disk, "20m") else {
        println!("skipped: this user may not mount a small file system");
        return;
    };
    let arguments = ["run", "p.yaml", "--store", "disk/store"];
    let (code, _, err) = house.rockface(&arguments);
    assert_eq!(code, Some(3), "{err}");
    assert!(err.contains("no space left to write") && err.contains("free some space"), "{err}");
    assert!(
        std::process::Command::new("mount").args(["-o", "remount,size=800m"]).arg(&disk).status().unwrap().success()
    );
    let (code, out, err) = house.rockface(&arguments);
    assert_eq!(code, Some(0), "{err}");
    assert!(!last_line(&out).contains("ran 80"), "what was finished was kept: {out}");
}

/// A small file system in memory, gone when dropped.
struct Mounted(std::path::PathBuf);

impl Mounted {
    fn new(at: &std::path::Path, size: &str) -> Option<Self> {
        let mut mount = std::process::Command::new("mount");
        mount.args(["-t", "tmpfs", "-o", &format!("size={size}"), "tmpfs"]).arg(at).stderr(Stdio::null());
        mount.status().is_ok_and(|status| status.success()).then(|| Self(at.to_owned()))
    }
}

impl Drop for Mounted {
    fn drop(&mut self) {
        let _ = std::process::Command::new("umount").arg(&self.0).status();
    }
}

#[test]
fn one_more_point_on_a_thousand_runs_its_own_steps_only() {
    let sweep = |count: usize| {
        let values: Vec<String> = (0..count).map(|value| value.to_string()).collect();
        format!(
            "
rockface: 1
axes: {{x: {{values: [{}]}}}}
steps:
  base: {{stage: emit, with: {{value: 3}}}}
  shared: {{stage: add, in: {{terms: base.out}}, with: {{plus: 0.125}}}}
  own: {{stage: add, in: {{terms: shared.out}}, with: {{plus: '${{x}}'}}}}
  next: {{stage: add, in: {{terms: own.out}}, with: {{plus: 0.25}}}}
  last: {{stage: add, in: {{terms: next.out}}, with: {{plus: 0.5}}}}
",
            values.join(", ")
        )
    };
    let bench = Bench::new();
    assert_eq!(bench.run(&sweep(1000), &[]).summary.executed(), 3002);
    let more = bench.run(&sweep(1001), &[]);
    let own: Vec<String> = ["last", "next", "own"].map(|step| format!("{step}[x=1000]")).into();
    assert_eq!(more.executed(), own);
    assert_eq!(bench.run(&sweep(1000), &[]).executed(), Vec::<String>::new());
}

/// Coarse values, the best of them, finer values around it: the axis of the second stage is known when the first is done.
const SEARCH: &str = "
rockface: 1
name: search
seed: 3
axes:
  coarse: {count: 12}
  fine: {from: rows.table, reseeds: false}
steps:
  face: {stage: synthesise-face, over: [coarse], with: {width_m: 3, height_m: 2, spacing_m: 0.05}}
  dem: {stage: rasterise-dem, in: {surface: face.mesh}, with: {cell_m: 0.1, method: tin}}
  noise: {stage: describe-noise, with: {scales_cells: [1, 2, 4]}, in: {raster: dem.raster}}
  coarse_rows: {stage: tabulate, in: {rows: {each: noise.features, over: [coarse]}}}
  rows:
    stage: command
    in: {rows: coarse_rows.table}
    with:
      program: sh
      args: [\"-c\", \"test -s {in.rows} && printf 'cell_m\\n0.04\\n0.05\\n0.06\\n0.07\\n0.08\\n0.09\\n' > {out.table}\"]
      version: POSIX sh
      inputs: {rows: {kind: table, extension: csv}}
      outputs: {table: {kind: table, extension: csv}}
  fine_dem: {stage: rasterise-dem, in: {surface: 'face.mesh[coarse=3]'}, with: {cell_m: '${fine.cell_m}', method: tin}}
  fine_noise: {stage: describe-noise, with: {scales_cells: [1, 2, 4]}, in: {raster: fine_dem.raster}}
  found: {stage: tabulate, in: {rows: {each: fine_noise.features, over: [fine]}}}
targets: [found]
";

#[test]
fn a_search_in_two_stages_killed_again_and_again_gives_the_same_table() {
    let whole = House::new(SEARCH);
    let started = Instant::now();
    let (code, _, err) = whole.rockface(&["run", "p.yaml", "--quiet"]);
    assert_eq!(code, Some(0), "{err}");
    let most_ms = (started.elapsed().as_millis() as u64).clamp(50, 4000);
    let house = House::new(SEARCH);
    let kills = if slow() { 40 } else { 6 };
    for moment in moments(kills, most_ms) {
        let mut child = spawn(&house, &["run", "p.yaml", "--json", "--jobs", "2"]);
        std::thread::sleep(moment);
        // The run may have ended by itself.
        let _ = child.kill();
        child.wait().unwrap();
    }
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--jobs", "2"]);
    assert_eq!(code, Some(0), "{err}");
    assert_eq!(digests(&house), digests(&whole));
    let described = |name: &&String| name.contains("fine_noise") && name.ends_with(".features");
    assert_eq!(digests(&whole).keys().filter(described).count(), 6);
    let left = std::fs::read_dir(house.path(".rockface/store/scratch")).unwrap().count();
    assert_eq!(left, 0, "what killed programs left is swept up");
}
