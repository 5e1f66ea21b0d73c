//! The calibration pipeline at a small size: killed half way it goes on to the same table, and a wider range simulates its own points only.

use std::process::Stdio;

use serde_json::Value;

use crate::cli::House;

const PIPELINE: &str = include_str!("../../pipelines/calibrate.yaml");

/// Images of 160 pixels and cells of 9 cm; four coarse points, six fine ones, 14 references.
const SMALL: [&str; 13] = [
    "params.image_px=160",
    "params.focal_px=1954",
    "params.cell_m=0.09",
    "params.lag_cells=30",
    "axes.reference.count=14",
    "steps.covariance.with={}",
    "steps.two_stage.with.thetas=[1]",
    "steps.two_stage.with.locals_px=[0.5, 0.8]",
    "steps.two_stage.with.regulars_px=[0.5]",
    "steps.two_stage.with.spacings_px=[10, 40]",
    "steps.two_stage.with.repeats=2",
    "steps.two_stage.with.fine_points=6",
    "steps.two_stage.with.best=2",
];

fn arguments<'a>(more: &[&'a str]) -> Vec<&'a str> {
    let mut all = vec!["run", "p.yaml", "--json", "--jobs", "2", "--target", "two_stage"];
    all.extend(SMALL.iter().flat_map(|set| ["--set", set]));
    all.extend(more.iter().flat_map(|set| ["--set", set]));
    all
}

/// The instances a run computed.
fn executed(lines: &str) -> Vec<String> {
    let events = lines.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    let finished = events.filter(|event| event["event"] == "finished");
    finished.filter_map(|event| Some(event["step"].as_str()?.to_owned())).collect()
}

fn run(house: &House, more: &[&str]) -> Vec<String> {
    let (code, out, err) = house.rockface(&arguments(more));
    assert_eq!(code, Some(0), "{err}");
    executed(&out)
}

fn ranking(house: &House) -> String {
    std::fs::read_to_string(house.path(".rockface/runs/latest/outputs/two_stage/ranked/ranking.csv")).unwrap()
}

#[test]
fn a_search_killed_half_way_ends_with_the_same_table_and_a_wider_one_reuses_it() {
    let whole = House::new(PIPELINE);
    let all = run(&whole, &[]).len();
    let table = ranking(&whole);
    assert_eq!(table.lines().count(), 1 + 6, "{table}");

    let house = House::new(PIPELINE);
    let mut child = house.command(&arguments(&[])).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let mut told = 0;
    let mut lines = std::io::BufRead::lines(std::io::BufReader::new(child.stdout.take().unwrap()));
    while told < all / 2 {
        let Some(Ok(line)) = lines.next() else { break };
        told += executed(&line).len();
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let resumed = run(&house, &[]);
    // What is not kept (`keep: false`) may be made again where its reader was not done.
    assert!(resumed.len() < all - told / 2, "{told} of {all} were done, then {}", resumed.len());
    assert_eq!(ranking(&house), table);

    let more = run(&whole, &["steps.two_stage.with.spacings_px=[10, 20, 40]", "steps.two_stage.with.fine_points=2"]);
    let described: Vec<&String> = more.iter().filter(|step| step.contains("/one/noise")).collect();
    assert!(described.iter().all(|step| !step.starts_with("references/")), "{described:?}");
    assert_eq!(described.iter().filter(|step| step.starts_with("two_stage/gridded/")).count(), 2, "{described:?}");
}
