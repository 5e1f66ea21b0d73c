//! `detect-raster` on scenes whose clusters and volumes are counted by hand.

use serde_json::{Value, json};

use super::*;
use rockface_core::artefact::{Artefact, Georeference, Grid, Inventory, Transform};
use rockface_core::testing::{TestHost, run_stage};

const GRID: Grid = Grid { columns: 20, rows: 12, cell_m: 0.02, left_m: -0.2, top_m: 0.12 };

/// A difference of rectangles [left, right), [top, bottom) in cells, each with a value in metres.
fn scene(parts: &[([usize; 4], f32)]) -> Raster {
    let mut values = vec![0.0f32; GRID.cells()];
    for ([left, right, top, bottom], value) in parts {
        for row in *top..*bottom {
            values[row * 20 + left..row * 20 + right].fill(*value);
        }
    }
    Raster::single(GRID, Frame::Wall, "difference", "difference", values)
}

fn run(difference: &Raster, with: &Value, more: &[(&str, Artefact)]) -> Result<Inventory, StageError> {
    let mut inputs = vec![("difference", difference.clone().into())];
    inputs.extend(more.iter().cloned());
    let made = run_stage::<DetectRaster>(&TestHost::default(), with, &inputs)?;
    let Some(Artefact::Inventory(found)) = made.into_inner().remove("detections") else { panic!("no detections") };
    Ok(found)
}

fn volumes(found: &Inventory) -> Vec<f64> {
    found.numbers("volume_m3").unwrap().into_iter().flatten().collect()
}

#[test]
fn filters_that_let_single_cells_pass_are_told() {
    let warned = |with: &Value| {
        let host = TestHost::default();
        run_stage::<DetectRaster>(&host, with, &[("difference", scene(&[([1, 4, 1, 4], -0.1)]).into())]).unwrap();
        host.warnings().iter().any(|text| text.contains("single cells count"))
    };
    assert!(warned(&json!({"min_width_m": 0.02, "min_area_m2": 0.0004})));
    assert!(!warned(&json!({})) && !warned(&json!({"min_width_m": 0, "min_area_m2": 0})));
    assert!(!warned(&json!({"min_width_m": 0.01, "min_area_m2": 0.001})));
}

#[test]
fn only_losses_beyond_the_limit_that_are_large_enough_count() {
    let difference = scene(&[
        ([1, 4, 1, 4], -0.1),     // found: 9 cells
        ([8, 11, 1, 4], 0.1),     // gain
        ([14, 17, 1, 4], -0.02),  // below the limit
        ([1, 9, 8, 9], -0.1),     // one cell wide
        ([14, 16, 8, 10], -0.05), // found: 4 cells
    ]);
    let found = run(&difference, &json!({}), &[]).unwrap();
    let expected = [9.0 * 4e-4 * 0.1, 4.0 * 4e-4 * 0.05];
    assert_eq!(found.features.len(), 2);
    volumes(&found).iter().zip(expected).for_each(|(v, e)| assert!((v - e).abs() < 1e-9, "{v}"));
    assert_eq!(found.numbers("cells").unwrap(), [Some(9.0), Some(4.0)]);
    let gain = run(&difference, &json!({"change": "gain"}), &[]).unwrap();
    assert_eq!(gain.features.len(), 1);
    let low = run(&difference, &json!({"lod": {"fixed": {"lod_m": 0.01}}}), &[]).unwrap();
    assert_eq!(low.features.len(), 3);
    let thin = run(&difference, &json!({"min_width_m": 0}), &[]).unwrap();
    assert_eq!(thin.features.len(), 3);
    let round = run(&difference, &json!({"min_width_m": 0, "min_axis_ratio": 0.2}), &[]).unwrap();
    assert_eq!(round.features.len(), 2);
    let large = run(&difference, &json!({"min_area_m2": 0.002}), &[]).unwrap();
    assert_eq!(large.features.len(), 1);
}

#[test]
fn iterations_widen_the_opening_and_reconstruction_keeps_margins() {
    // A square of 4 with a tail of one cell.
    let difference = scene(&[([2, 6, 2, 6], -0.1), ([6, 10, 3, 4], -0.1)]);
    let cells = |with: &Value| run(&difference, with, &[]).unwrap().numbers("cells").unwrap();
    assert_eq!(cells(&json!({})), [Some(16.0)]);
    assert_eq!(cells(&json!({"opening": "reconstruction"})), [Some(20.0)]);
    assert_eq!(cells(&json!({"iterations": 3})), [Some(16.0)]);
    assert!(cells(&json!({"iterations": 4})).is_empty());
    assert_eq!(cells(&json!({"iterations": 0})), [Some(20.0)]);
}

#[test]
fn limits_from_spread_and_roughness() {
    let mut difference = scene(&[([1, 4, 1, 4], -0.1)]);
    let flat = run(&difference, &json!({"lod": "empirical"}), &[]).unwrap_err();
    assert!(flat.message.contains("no spread") && flat.hint.unwrap().contains("fixed"));
    difference.bands[0].values.iter_mut().enumerate().for_each(|(i, v)| *v += if i % 2 == 0 { 0.01 } else { -0.01 });
    assert_eq!(run(&difference, &json!({"lod": "empirical"}), &[]).unwrap().features.len(), 1);
    let plane = |z: f32| Raster::single(GRID, Frame::Wall, "elevation", "elevation", vec![z; GRID.cells()]);
    let both = [("reference", plane(1.0).into()), ("comparison", plane(1.0).into())];
    for (word, registration_m, count) in [("quadrature", 0.04, 1), ("lague", 0.04, 1), ("quadrature", 0.06, 0)] {
        let with = json!({"lod": {word: {"registration_m": registration_m}}});
        assert_eq!(run(&difference, &with, &both).unwrap().features.len(), count, "{word}");
    }
    let with = json!({"lod": {"lague": {"registration_m": 0.01}}});
    assert!(run(&difference, &with, &both[..1]).unwrap_err().message.contains("both elevations"));
}

#[test]
fn a_limit_below_the_noise_is_warned_of() {
    let mut difference = scene(&[]);
    difference.bands[0].values.iter_mut().enumerate().for_each(|(i, d)| *d = 0.02 * ((i * 7 % 11) as f32 - 5.0) / 5.0);
    let warnings = |lod_m: f64| {
        let host = TestHost::default();
        let with = json!({"lod": {"fixed": {"lod_m": lod_m}}});
        run_stage::<DetectRaster>(&host, &with, &[("difference", difference.clone().into())]).unwrap();
        host.warnings()
    };
    // The median of the deviations is 12 mm.
    let least_m = 1.96 * 1.4826 * 0.012;
    assert_eq!(warnings(least_m + 1e-3), Vec::<String>::new());
    let low = warnings(least_m - 1e-3);
    assert!(low.len() == 1 && low[0].contains("(NMAD) of the difference, 0.035 m"), "{low:?}");
}

#[test]
fn what_is_no_difference_or_lies_elsewhere_is_refused() {
    let difference = scene(&[]);
    let elsewhere = Raster { grid: Grid { left_m: 5.0, ..GRID }, ..difference.clone() };
    let error = run(&difference, &json!({}), &[("reference", elsewhere.into())]).unwrap_err();
    assert!(error.message.contains("`reference` has 20 x 12"), "{error}");
    let mut two = difference.clone();
    two.bands.push(two.bands[0].clone());
    assert!(run(&two, &json!({}), &[]).unwrap_err().message.contains("2 bands"));
    let mut empty = difference;
    empty.bands[0].values.fill(f32::NAN);
    assert!(run(&empty, &json!({}), &[]).unwrap_err().message.contains("no cell"));
}

/// Noise of this spread in each half of 160 x 160 cells, and an offset, metres.
fn noisy([left, right]: [f32; 2], offset: f32) -> Raster {
    let grid = Grid { columns: 160, rows: 160, cell_m: 0.02, left_m: 0.0, top_m: 3.2 };
    let field = rockface_core::numerics::random::Key([7; 32]).field();
    let value = |cell: usize| {
        let spread = if cell % 160 < 80 { left } else { right };
        offset + spread * field.normal((cell / 160) as i32, (cell % 160) as i32) as f32
    };
    Raster::single(grid, Frame::Wall, "difference", "difference", (0..grid.cells()).map(value).collect())
}

fn warnings(difference: Raster, lod: &Value) -> Vec<String> {
    let host = TestHost::default();
    run_stage::<DetectRaster>(&host, &json!({ "lod": lod }), &[("difference", difference.into())]).unwrap();
    host.warnings()
}

#[test]
fn an_offset_and_uneven_noise_are_warned_of() {
    let lod = json!({"empirical": {}});
    assert_eq!(warnings(noisy([0.004, 0.004], 0.0), &lod), Vec::<String>::new());
    let two = warnings(noisy([0.004, 0.008], 0.0), &lod);
    assert!(
        two.len() == 1 && two[0].contains(" % of the cells are beyond the limit of detection as a gain"),
        "{two:?}"
    );
    assert_eq!(warnings(noisy([0.004, 0.008], 0.0), &json!({"empirical": {"factor": 1.0}})), Vec::<String>::new());
    let off = warnings(noisy([0.004, 0.004], -0.012), &lod);
    assert!(off.len() == 1 && off[0].contains("above -12.") && off[0].contains("register-icp"), "{off:?}");
    let uneven = warnings(noisy([0.001, 0.008], 0.0), &lod);
    assert!(uneven.len() == 1 && uneven[0].contains("1.0 mm in quiet") && uneven[0].contains("noisy"), "{uneven:?}");
}

#[test]
fn the_deviation_of_a_volume_does_not_depend_on_how_many_of_them_make_the_limit() {
    let mut difference = noisy([0.004, 0.004], 0.0);
    (0..12).for_each(|row| difference.bands[0].values[row * 160..row * 160 + 12].fill(-0.1));
    let deviation = |factor: f64| {
        let found =
            run(&difference, &json!({"lod": {"empirical": {"factor": factor}}, "min_area_m2": 0.04}), &[]).unwrap();
        (found.features.len(), found.numbers("volume_sd_m3").unwrap()[0].unwrap())
    };
    let [(one, at_two), (other, at_three)] = [deviation(2.5), deviation(3.5)];
    assert_eq!((one, other), (1, 1));
    assert!((at_two / at_three - 1.0).abs() < 0.02, "{at_two} {at_three}");
}

/// A loss of 10 x `rows` cells with so many cells without a value above it and then beside it.
fn missing_warned(rows: usize, missing: usize) -> bool {
    let mut difference = scene(&[([4, 14, 2, 2 + rows], -0.1)]);
    let above = (3..15).map(|column| 20 + column);
    let beside = (2..12).map(|row| row * 20 + 3);
    above.chain(beside).take(missing).for_each(|cell| difference.bands[0].values[cell] = f32::NAN);
    let host = TestHost::default();
    run_stage::<DetectRaster>(&host, &json!({}), &[("difference", difference.into())]).unwrap();
    host.warnings().iter().any(|text| text.contains("cells without a value touch the"))
}

#[test]
fn cells_without_a_value_around_what_was_found_are_warned_of_beyond_a_share() {
    // 15 % of 80 cells are 12; of 20 cells it takes 10.
    assert_eq!([12, 13].map(|missing| missing_warned(8, missing)), [false, true]);
    assert_eq!([9, 10].map(|missing| missing_warned(2, missing)), [false, true]);
}

#[test]
fn places_in_the_world_need_elevations() {
    // The wall frame is at (500, 600, 70), and its Z is X of the world.
    let turn = nalgebra::Matrix3::new(0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0);
    let way = Transform::new("world", "wall", &turn, [500.0, 600.0, 70.0].into(), nalgebra::Vector3::zeros());
    let frame = Frame::Wall.at(Some(Georeference { crs: None, wall_from_world: Some(way) }));
    let difference = |frame| Raster { frame, ..scene(&[([1, 4, 1, 4], -0.1)]) };
    let reference = Raster::single(GRID, frame, "elevation", "elevation", vec![3.0; GRID.cells()]);
    let found = |frame, more: &[(&str, Artefact)]| {
        let mut inputs = vec![("difference", difference(frame).into())];
        inputs.extend(more.iter().cloned());
        let host = TestHost::default();
        let made = run_stage::<DetectRaster>(&host, &json!({}), &inputs).unwrap();
        let Some(Artefact::Inventory(found)) = made.into_inner().remove("detections") else { panic!("none") };
        (["x", "y", "z"].map(|axis| found.numbers(&format!("centroid_world_{axis}_m")).unwrap()[0]), host.warnings())
    };
    let (world, told) = found(frame, &[("reference", reference.into())]);
    assert!(told.is_empty() && (world[0].unwrap() - 502.95).abs() < 1e-6, "{world:?} {told:?}");
    let (world, told) = found(frame, &[]);
    assert_eq!(world, [None; 3]);
    assert!(told.len() == 1 && told[0].contains("to `reference`"), "{told:?}");
    assert!(found(Frame::Wall, &[]).1.is_empty());
}

#[test]
fn a_survey_of_a_part_of_the_face_is_told_with_its_share() {
    let told = |tested: usize, with_reference: bool| {
        let mut difference = scene(&[]);
        difference.bands[0].values[tested..].fill(f32::NAN);
        // The face fills 200 of the 240 cells.
        let mut reference = Raster::single(GRID, Frame::Wall, "elevation", "elevation", vec![3.0; GRID.cells()]);
        reference.bands[0].values[200..].fill(f32::NAN);
        let mut inputs: Vec<(&str, Artefact)> = vec![("difference", difference.into())];
        inputs.extend(with_reference.then(|| ("reference", reference.into())));
        let host = TestHost::default();
        let made = run_stage::<DetectRaster>(&host, &json!({}), &inputs).unwrap().into_inner();
        let Artefact::Table(summary) = &made["summary"] else { panic!("no summary") };
        let number = |name: &str| summary.rows[0][summary.column(name).unwrap()].number().unwrap();
        assert_eq!(number("detections").to_bits(), 0.0f64.to_bits());
        assert!((number("tested_m2") - tested as f64 * 4e-4).abs() < 1e-9);
        (number("tested_share"), host.warnings())
    };
    for (tested, share, warns) in [(200, 1.0, false), (182, 0.91, false), (178, 0.89, true), (6, 0.03, true)] {
        let (found, warnings) = told(tested, true);
        assert!((found - share).abs() < 1e-9 && warnings.is_empty() != warns, "{tested}: {found} {warnings:?}");
    }
    let (share, warnings) = told(60, false);
    assert!((share - 0.25).abs() < 1e-9 && warnings.is_empty(), "{share} {warnings:?}");
}
