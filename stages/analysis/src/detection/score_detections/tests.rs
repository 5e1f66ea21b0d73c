//! `score-detections` on a scene made by hand: one niche, two that merge, one that splits, a false alarm, one hidden.

use serde_json::{Value, json};

use super::*;
use rockface_core::artefact::{Frame, Polygon};
use rockface_core::testing::{TestHost, run_stage};

const GRID: Grid = Grid { columns: 20, rows: 10, cell_m: 0.1, left_m: 0.0, top_m: 1.0 };

/// Rectangles [left, right), [top, bottom) in cells, each with a volume.
fn inventory(column: &str, parts: &[([u8; 4], f64, f64)]) -> Inventory {
    let feature = |(number, (sides, volume, visible)): (usize, &([u8; 4], f64, f64))| {
        let [left, right, top, bottom] = sides.map(|cells| f64::from(cells) * 0.1);
        let exterior = vec![[left, 1.0 - bottom], [right, 1.0 - bottom], [right, 1.0 - top], [left, 1.0 - top]];
        let outline = vec![Polygon { exterior, holes: Vec::new() }];
        Feature { outline, values: [(number + 11) as f64, *volume, *visible].map(Cell::from).to_vec() }
    };
    let columns = ["id", column, "visible_fraction"].map(str::to_owned).to_vec();
    Inventory { frame: Frame::Wall, columns, features: parts.iter().enumerate().map(feature).collect() }
}

fn searched() -> Raster {
    let mut values = vec![-0.05; GRID.cells()];
    // The last column was not surveyed.
    values.iter_mut().skip(19).step_by(20).for_each(|value| *value = f32::NAN);
    Raster::single(GRID, Frame::Wall, "difference", "difference", values)
}

fn truth() -> Inventory {
    let parts = [
        ([1, 3, 1, 3], 0.2, 1.0), // found as it is
        ([5, 7, 1, 3], 0.1, 1.0), // merged with the next
        ([8, 10, 1, 3], 0.1, 1.0),
        ([1, 8, 5, 7], 0.4, 1.0),   // split in two
        ([12, 14, 1, 3], 0.1, 1.0), // missed
        ([19, 20, 1, 3], 0.1, 1.0), // not surveyed
        ([16, 18, 5, 7], 0.1, 0.2), // mostly under an overhang
    ];
    inventory("removed_m3", &parts)
}

fn detections() -> Inventory {
    let parts = [
        ([1, 3, 1, 3], 0.1, 1.0),
        ([5, 10, 1, 3], 0.3, 1.0),
        ([1, 4, 5, 7], 0.1, 1.0),
        ([5, 8, 5, 7], 0.2, 1.0),
        ([12, 14, 7, 9], 0.5, 1.0), // a false alarm
    ];
    inventory("volume_m3", &parts)
}

fn run(detections: Artefact, with: &Value) -> Result<(Table, Inventory, Inventory, Raster), StageError> {
    let inputs = [("truth", truth().into()), ("detections", detections), ("grid", searched().into())];
    let mut made = run_stage::<ScoreDetections>(&TestHost::default(), with, &inputs)?.into_inner();
    let mut take = |port: &str| made.remove(port);
    match (take("summary"), take("truth"), take("detections"), take("confusion")) {
        (
            Some(Artefact::Table(s)),
            Some(Artefact::Inventory(t)),
            Some(Artefact::Inventory(d)),
            Some(Artefact::Raster(c)),
        ) => Ok((s, t, d, c)),
        _ => panic!("outputs are missing"),
    }
}

fn check(summary: &Table, expected: &[(&str, f64)]) {
    for (name, expected) in expected {
        let found = summary.rows[0][summary.column(name).unwrap()].number().unwrap_or(f64::NAN);
        assert!((found - expected).abs() < 1e-12, "{name}: {found}, not {expected}");
    }
}

fn words(inventory: &Inventory) -> Vec<&str> {
    let at = inventory.column("outcome").unwrap();
    inventory.features.iter().map(|feature| feature.values[at].text().unwrap()).collect()
}

#[test]
fn every_count_and_volume_is_that_counted_by_hand() {
    let (summary, truth, detections, confusion) =
        run(detections().into(), &json!({"least_visible_fraction": 0.5})).unwrap();
    let rates = [
        ("truths", 7.0),
        ("hidden", 2.0),
        ("detections", 5.0),
        ("true_positives", 4.0),
        ("false_positives", 1.0),
        ("found", 4.0),
        ("missed", 1.0),
        ("precision", 0.8),
        ("recall", 0.8),
        ("f1", 0.8),
        ("pairs", 3.0),
        ("precision_1to1", 0.6),
        ("recall_1to1", 0.6),
        ("cells_true_positive", 4.0 + 8.0 + 12.0),
        ("cells_false_positive", 2.0 + 4.0),
        ("cells_false_negative", 2.0 + 4.0 + 4.0),
        ("cells_true_negative", 190.0 - 24.0 - 6.0 - 10.0),
        ("truth_m3", 0.9),
        ("found_truth_m3", 0.8),
        ("detected_m3", 1.2),
        ("true_detected_m3", 0.7),
        // Pairs: 0.1 of 0.2, 0.3 of 0.1, and one half of the split niche, 0.1 or 0.2 of 0.4.
        ("volume_error_median", -0.5),
        ("iou_mean", (1.0 + 0.4 + 6.0 / 14.0) / 3.0),
    ];
    check(&summary, &rates);
    assert_eq!(words(&truth), ["found", "found", "found", "found", "missed", "hidden", "hidden"]);
    let positive = "true_positive";
    assert_eq!(words(&detections), [positive, positive, positive, positive, "false_positive"]);
    let number = |inventory: &Inventory, name: &str, place: usize| inventory.numbers(name).unwrap()[place];
    assert_eq!((number(&truth, "detection", 0), number(&truth, "detections", 3)), (Some(11.0), Some(2.0)));
    assert_eq!((number(&truth, "volume_error", 0), number(&truth, "iou", 4)), (Some(-0.5), None));
    assert_eq!((number(&detections, "truths", 1), number(&detections, "truth_m3", 0)), (Some(2.0), Some(0.2)));
    let ratio = number(&truth, "log_volume_ratio", 0).unwrap();
    assert!((ratio + std::f64::consts::LN_2).abs() < 1e-12);
    assert_eq!(confusion.bands[0].values[39].to_bits(), 255f32.to_bits());
}

#[test]
fn text_among_the_volumes_is_warned_of() {
    let host = TestHost::default();
    let mut truth = truth();
    truth.features[0].values[1] = "0,2".into();
    let inputs = [("truth", truth.into()), ("detections", detections().into()), ("grid", searched().into())];
    run_stage::<ScoreDetections>(&host, &json!({}), &inputs).unwrap();
    let warnings = host.warnings();
    let expected = "truth: 1 of 7 rows hold text in `removed_m3`, such as `0,2`";
    assert!(warnings.len() == 1 && warnings[0].starts_with(expected), "{warnings:?}");
}

#[test]
fn a_stricter_overlap_and_no_overhang_rule() {
    let (summary, ..) = run(detections().into(), &json!({"least_iou": 0.5})).unwrap();
    let rates = [("hidden", 1.0), ("true_positives", 1.0), ("found", 1.0), ("missed", 5.0), ("precision", 0.2)];
    check(&summary, &rates);
}

#[test]
fn labels_of_another_program_are_scored_the_same_way() {
    let mut labels = vec![0.0f32; GRID.cells()];
    (0..2).for_each(|i| labels[(1 + i) * 20 + 1..(1 + i) * 20 + 3].fill(3.0));
    labels[8 * 20 + 12..8 * 20 + 14].fill(9.0);
    let raster = Raster::single(GRID, Frame::Wall, "label", "l", labels);
    let (summary, _, found, _) = run(raster.clone().into(), &json!({})).unwrap();
    check(&summary, &[("detections", 2.0), ("true_positives", 1.0), ("false_positives", 1.0), ("found", 1.0)]);
    assert_eq!(found.numbers("id").unwrap(), [Some(3.0), Some(9.0)]);
    assert!((found.numbers("volume_m3").unwrap()[0].unwrap() - 4.0 * 0.01 * 0.05).abs() < 1e-9);
    let elsewhere = Raster { grid: Grid { top_m: 5.0, ..GRID }, ..raster };
    assert!(run(elsewhere.into(), &json!({})).unwrap_err().message.contains("must have one band and the grid"));
}

#[test]
fn a_mask_in_the_place_of_labels_is_warned_of() {
    let warnings = |numbers: [f32; 4]| {
        let mut labels = vec![0.0f32; GRID.cells()];
        (0..4).for_each(|i| labels[(1 + 2 * i) * 20 + 1..(1 + 2 * i) * 20 + 3].fill(numbers[i]));
        let raster = Raster::single(GRID, Frame::Wall, "label", "l", labels);
        let inputs = [("truth", truth().into()), ("detections", raster.into()), ("grid", searched().into())];
        let host = TestHost::default();
        run_stage::<ScoreDetections>(&host, &json!({}), &inputs).unwrap();
        host.warnings()
    };
    let told = warnings([1.0; 4]);
    assert!(told.len() == 1 && told[0].starts_with("label 1 lies in 4 places that do not touch"), "{told:?}");
    assert!(warnings([1.0, 2.0, 3.0, 4.0]).is_empty() && warnings([1.0, 1.0, 2.0, 2.0]).is_empty());
}

#[test]
fn nothing_found_is_a_result_and_a_wrong_column_is_not() {
    let (summary, ..) = run(inventory("volume_m3", &[]).into(), &json!({})).unwrap();
    check(&summary, &[("detections", 0.0), ("recall", 0.0), ("f1", 0.0)]);
    assert_eq!(summary.rows[0][summary.column("precision").unwrap()], Cell::Empty(()));
    let error = run(detections().into(), &json!({"column": "v"})).unwrap_err();
    assert!(error.message.contains("no column `v` in the detections; there are id, volume_m3"));
}
