//! The log of a run, and the depth maps behind it: complete when all was cached, the same at any number of threads, and with
//! the numbers that the other files have.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::Value;

use crate::cli::House;

/// A small survey before and after something; the matched maps are not kept.
const SURVEY: &str = "
rockface: 1
name: survey
seed: 5
axes:
  epoch: {items: [pre, post]}
  trial: {count: 6}
steps:
  face: {stage: synthesise-face, with: {width_m: 2, height_m: 1.5, spacing_m: 0.05}}
  survey: {stage: plan-survey, in: {mesh: face.mesh}, with: {width_px: 60, height_px: 40, focal_px: 400, distance_m: 20, baseline_m: 5}}
  pairs: {stage: select-pairs, in: {cameras: survey.cameras, mesh: face.mesh}}
  left: {stage: project-depth, in: {mesh: face.mesh, cameras: survey.cameras}, with: {image: left}}
  right: {stage: project-depth, in: {mesh: face.mesh, cameras: survey.cameras}, with: {image: right}}
  noisy: {stage: perturb-cameras, over: [epoch, trial], in: {cameras: survey.cameras}, with: {model: independent, independent: {position_m: [0.001, 0.001, 0.001]}}}
  matched: {stage: match-pair, keep: false, in: {first: left.depth, second: right.depth, noisy: noisy.cameras, pairs: pairs.pairs}, with: {max_y_parallax_px: 9, matcher: {blunders: {share: 0.1}, disparity_step_px: 0.0625}}}
  surface: {stage: fuse-depth, in: {depth: matched.depth}}
  dem: {stage: rasterise-dem, in: {surface: surface.surface}, with: {cell_m: 0.06}}
  features: {stage: describe-noise, in: {raster: dem.raster}, with: {scales_cells: [1, 2, 4]}}
  table: {stage: tabulate, in: {rows: {each: features.features, over: [epoch, trial]}}}
";

struct Log {
    /// Topic, second, encoding and bytes of every message.
    messages: Vec<(String, u64, String, Vec<u8>)>,
}

impl Log {
    fn read(bytes: &[u8]) -> Self {
        let messages = mcap::MessageStream::new(bytes).unwrap().map(|message| {
            let message = message.unwrap();
            let encoding = message.channel.message_encoding.clone();
            (message.channel.topic.clone(), message.log_time / 1_000_000_000, encoding, message.data.to_vec())
        });
        Self { messages: messages.collect() }
    }

    fn json(&self, topic: &str) -> Vec<Value> {
        let of_topic = self.messages.iter().filter(|(name, ..)| name == topic);
        of_topic.map(|(.., data)| serde_json::from_slice(data).unwrap()).collect()
    }

    fn count(&self, topic: &str) -> usize {
        self.messages.iter().filter(|(name, ..)| name == topic).count()
    }
}

fn log_of(house: &House) -> Vec<u8> {
    std::fs::read(house.path(".rockface/runs/latest/run.mcap")).unwrap()
}

fn run(house: &House, more: &[&str]) -> String {
    let (code, out, err) = house.rockface(&[&["run", "p.yaml"], more].concat());
    assert_eq!(code, Some(0), "{out}{err}");
    out
}

fn forget_runs(house: &House) {
    std::fs::remove_dir_all(house.path(".rockface/runs")).unwrap();
}

fn manifest(house: &House) -> Value {
    serde_json::from_slice(&std::fs::read(house.path(".rockface/runs/latest/run.json")).unwrap()).unwrap()
}

#[test]
fn the_log_is_the_same_at_any_jobs_and_when_all_was_cached() {
    let (one, other) = (House::new(SURVEY), House::new(SURVEY));
    run(&one, &["--jobs", "1"]);
    run(&other, &["--jobs", "3"]);
    let first = log_of(&one);
    assert_eq!(first, log_of(&other));
    forget_runs(&one);
    assert!(run(&one, &[]).contains("ran 0"));
    assert_eq!(first, log_of(&one));
    let log = Log::read(&first);
    // What was not kept is shown, the first point of six by two and the last three.
    for topic in
        ["/matched/depth", "/matched/depth/cloud", "/matched/depth/camera", "/surface/surface", "/dem/raster/image"]
    {
        assert_eq!(log.count(topic), 4, "{topic}");
    }
    assert_eq!((log.count("/matched/step"), log.count("/face/mesh"), log.count("/table/table")), (12, 1, 1));
    let times: Vec<u64> = log.messages.iter().map(|(_, second, ..)| *second).collect();
    assert!(times.is_sorted() && times.last() == Some(&(manifest(&one)["steps"].as_array().unwrap().len() as u64)));
    let layout = std::fs::read(one.path(".rockface/runs/latest/foxglove-layout.json")).unwrap();
    let layout: Value = serde_json::from_slice(&layout).unwrap();
    assert_eq!(layout["configById"]["3D!scene"]["topics"]["/face/mesh"]["visible"], true);
}

#[test]
fn numbers_in_the_log_are_those_of_the_manifest_and_the_tables() {
    let house = House::new(SURVEY);
    run(&house, &[]);
    let log = Log::read(&log_of(&house));
    let mut compared = 0;
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    for step in manifest(&house)["steps"].as_array().unwrap() {
        let topic = format!("/{}/metrics", step["step"].as_str().unwrap());
        let told: Vec<&Value> = step["metrics"].as_array().unwrap().iter().collect();
        if told.is_empty() {
            continue;
        }
        let place = seen.entry(topic.clone()).or_default();
        let message = &log.json(&topic)[*place];
        *place += 1;
        assert_eq!(message["point"], step["point"]);
        for metric in told {
            let name = metric["name"].as_str().unwrap();
            assert_eq!((&message["values"][name], &message["units"][name]), (&metric["value"], &metric["unit"]));
            compared += 1;
        }
    }
    assert!(compared > 30, "{compared}");
    let csv = std::fs::read_to_string(house.path(".rockface/runs/latest/outputs/table/table.csv")).unwrap();
    let mut lines = csv.lines();
    let columns: Vec<&str> = lines.next().unwrap().split(',').collect();
    let [table] = log.json("/table/table").try_into().unwrap();
    for (line, row) in lines.zip(table["rows"].as_array().unwrap()) {
        for (column, cell) in columns.iter().zip(line.split(',')) {
            if let Some(number) = row[*column].as_f64() {
                assert_eq!(cell.parse::<f64>().unwrap().to_bits(), number.to_bits(), "{column}");
            }
        }
    }
    assert_eq!(table["rows"].as_array().unwrap().len(), 12);
}

#[test]
fn a_step_says_how_much_of_it_is_logged_and_older_records_are_sketched_late() {
    let house = House::new(SURVEY);
    run(&house, &["--set", "log=none"]);
    let log = Log::read(&log_of(&house));
    assert!(log.messages.iter().all(|(topic, ..)| topic.ends_with("/step")), "nothing but what was there");
    assert_eq!(log.json("/left/step")[0]["entries"], Value::Array(Vec::new()));
    // The records have no sketches: what was kept is sketched now, nothing runs.
    assert!(run(&house, &["--set", "steps.face.log=brief", "--set", "steps.dem.log=full"]).contains("ran 0"));
    let log = Log::read(&log_of(&house));
    assert_eq!((log.count("/face/mesh"), log.count("/left/depth"), log.count("/dem/raster")), (0, 1, 12));
    assert_eq!(log.count("/matched/depth"), 0);
    assert!(log.json("/matched/step")[0]["unshown"].as_str().unwrap().contains("were not kept"));
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--set", "steps.dem.log=much"]);
    assert!(code == Some(2) && err.contains("full, brief or none"), "{err}");
}

/// Checks one stop of a followed pixel: the sum of the terms, and what was made again.
fn check_sum(facts: &Value) {
    let number = |name: &str| facts[name].as_f64().unwrap_or_else(|| panic!("{name}: {facts}"));
    let terms = ["disparity.ideal", "noise.local", "noise.regular", "noise.blunder", "noise.sub_pixel"];
    let sum: f64 = terms.iter().map(|name| number(&format!("{name} (px)"))).sum();
    assert!((sum - number("disparity (px)")).abs() < 1e-4, "{facts}");
    assert!(facts["checked"].as_str().unwrap().starts_with("recomputed, identical"), "{facts}");
}

#[test]
fn a_pixel_is_followed_from_the_true_point_to_the_noisy_one() {
    let house = House::new(SURVEY);
    run(&house, &[]);
    let steps = manifest(&house)["steps"].clone();
    let step = |name: &str| steps.as_array().unwrap().iter().find(|step| step["step"] == name).unwrap().clone();
    let digest = step("matched")["outputs"]["depth"]["digest"].as_str().unwrap().to_owned();
    let (code, out, err) = house.rockface(&["inspect", &digest[..16], "--pixel", "30,20", "--json"]);
    assert_eq!(code, Some(0), "{err}");
    let told: Value = serde_json::from_str(&out).unwrap();
    let [ideal, noisy] = [0, 1].map(|i| told["chain"][i]["facts"].clone());
    check_sum(&noisy);
    assert!(
        ideal["checked"].as_str().unwrap().starts_with("recomputed, identical") && ideal["its corners (m)"].is_array(),
        "{ideal}"
    );
    let axis = |facts: &Value, i: usize| facts["point in the wall frame (m)"][i].as_f64().unwrap();
    let moved = (0..3).map(|i| noisy["moved by (m)"][i].as_f64().unwrap());
    assert!(moved.enumerate().all(|(i, by)| (by - (axis(&noisy, i) - axis(&ideal, i))).abs() < 1e-12));
    // The file of the ideal map leads to the same stop.
    let file = Path::new(".rockface/runs/latest/outputs/left/depth.exr");
    let (_, out, _) = house.rockface(&["inspect", file.to_str().unwrap(), "--pixel", "30,20", "--json"]);
    let told: Value = serde_json::from_str(&out).unwrap();
    assert_eq!(told["chain"][0]["facts"], ideal);
    let (code, _, err) = house.rockface(&["inspect", &digest[..16], "--pixel", "60,20"]);
    assert!(code == Some(2) && err.contains("columns 0 to 59, rows 0 to 39"), "{err}");
    let (code, out, _) = house.rockface(&["inspect", file.to_str().unwrap(), "--picture", "always"]);
    assert!(code == Some(0) && out.contains("depth: viridis from") && out.contains('\u{2580}'), "{out}");
}
