//! What is known of a face stays to the bit; elsewhere strength follows the relief, and fields go on mirrored.

use serde_json::{Value, json};

use super::*;
use crate::noise::learn_noise::tests::{CLEAN, COLUMNS, ROWS, grid, mean, survey};
use crate::noise::learning::whitening::BANDS;
use rockface_core::artefact::{Artefact, Frame, Grid, Noun, ReliefLaw};
use rockface_core::numerics::bands::Bands;
use rockface_core::testing::{TestHost, run_stage};
use rockface_imaging::matching::noise::changed_face::law;
use rockface_imaging::matching::noise::ensemble::{Numbers, draw, log_strength_at};
use rockface_imaging::matching::noise::parametric::Ground;

/// A law by which a step of the face shows.
const RELIEF: ReliefLaw = ReliefLaw { flat_px: 0.1, gain_px_m: 5.0, window_cells: 4 };

fn model() -> Noise {
    Noise { relief: RELIEF, ..CLEAN.clone() }
}

fn face(grid: Grid, z: impl Fn(usize, usize) -> f32) -> Raster {
    let values = (0..grid.cells()).map(|i| z(i % grid.columns, i / grid.columns)).collect();
    Raster::single(grid, Frame::Wall, "elevation", "dem", values)
}

fn transfer_on(host: &TestHost, noise: Noise, dem: &Raster, with: &Value) -> Result<Noise, StageError> {
    let (cameras, pairs) = survey();
    let inputs: [(&str, Artefact); 4] = [
        ("noise", Artefact::Noise(noise)),
        ("dem", dem.clone().into()),
        ("cameras", cameras.into()),
        ("pairs", pairs.into()),
    ];
    let outputs = run_stage::<TransferNoise>(host, with, &inputs)?.into_inner();
    let noise = Noise::of(&outputs["noise"]).unwrap().clone();
    noise.check().unwrap();
    Ok(noise)
}

fn transfer(dem: &Raster, with: &Value) -> Result<Noise, StageError> {
    transfer_on(&TestHost::default(), model(), dem, with)
}

/// Whitened fields of some draws of a model.
fn drawn(noise: &Noise, count: u64) -> Vec<Vec<f64>> {
    let one = |seed: u64| {
        let host = TestHost::seeded(seed);
        let keys = |purpose: &str, item: &str| Context::new(&host).stream(purpose, item);
        draw(noise, Ground::of(noise).as_ref(), Numbers::default(), &keys).field
    };
    let filled = |field: Vec<f64>| field.into_iter().map(|v| if v.is_nan() { 0.0 } else { v }).collect();
    (0..count).map(|seed| filled(one(seed))).collect()
}

/// Mean correlation of draws at lags of 1, 2, ... cells.
fn correlation(noise: &Noise) -> Vec<f64> {
    let bands = Bands::new(noise.grid.columns, noise.grid.rows, BANDS);
    let all: Vec<Vec<f64>> = drawn(noise, 12).iter().map(|field| bands.correlation(field)).collect();
    (1..12).map(|lag| mean(all.iter().map(|correlation| correlation[lag]))).collect()
}

#[test]
fn on_the_same_face_a_model_stays_as_it_is() {
    let holes = |column: usize, row: usize| if (column + row).is_multiple_of(31) { f32::NAN } else { 0.0 };
    let host = TestHost::default();
    let dem = face(grid(), holes);
    let noise = Noise { elevation: dem.bands[0].values.clone(), ..model() };
    assert_eq!(transfer_on(&host, noise.clone(), &dem, &json!({})).unwrap(), noise);
    assert_eq!((host.metric("known_share"), host.metric("strength_law_median")), (Some(1.0), None));
}

#[test]
fn a_face_that_is_half_new_keeps_the_known_half_and_has_strength_by_relief_in_the_other() {
    // Right of column 60 the face stands a metre further out, in steps of 8 cm every 20 rows.
    let z = |column: usize, row: usize| if column < 60 { 0.02 } else { 1.0 + 0.08 * (row / 20) as f32 };
    let host = TestHost::default();
    let noise = transfer_on(&host, model(), &face(grid(), z), &json!({})).unwrap();
    for i in 0..COLUMNS * ROWS {
        let (column, row) = (i % COLUMNS, i / COLUMNS);
        if column < 60 {
            assert_eq!((noise.strength[i], noise.elevation[i]), (CLEAN.strength[i], 0.0));
        } else {
            assert_eq!(noise.elevation[i], z(column, row));
        }
    }
    let at = |column: usize, row: usize| f64::from(noise.strength[row * COLUMNS + column]);
    // Nine rows of the window, four of them 8 cm higher or lower.
    let relief = 0.08 * (20.0f64 / 81.0).sqrt();
    assert!((at(80, 10) - RELIEF.flat_px).abs() < 1e-6 && (at(80, 20) - law(&RELIEF, relief)).abs() < 1e-4);
    assert!((host.metric("known_share").unwrap() - 60.0 / 96.0).abs() < 1e-12);
    assert_eq!((&noise.fields, &noise.weights), (&CLEAN.fields, &CLEAN.weights));
    // Classes end at other strengths; each acquisition has the factor it had there.
    for (member, old) in noise.members.iter().zip(&CLEAN.members) {
        for (middle, value) in noise.class_log_strength.iter().zip(&member.log_strength) {
            assert_eq!(*value, log_strength_at(&CLEAN.class_log_strength, &old.log_strength, *middle));
        }
    }
}

#[test]
fn bends_and_weights_of_trends_keep_their_place_between_the_edges() {
    let shape: Vec<f32> = (0..COLUMNS * ROWS).map(|i| (1 + i % COLUMNS + 1000 * (i / COLUMNS)) as f32).collect();
    let noise = Noise { bend_shapes: vec![shape.clone(); 7], trend_weights: shape.clone(), ..model() };
    // Cells twice as large: under the middle of each lies the corner of four.
    let coarse = Grid { columns: COLUMNS / 2, rows: ROWS / 2, cell_m: 0.1, ..grid() };
    let moved = transfer_on(&TestHost::default(), noise, &face(coarse, |_, _| 0.0), &json!({})).unwrap();
    let under = |i: usize| (2 * (i / coarse.columns) + 1) * COLUMNS + 2 * (i % coarse.columns) + 1;
    let wanted: Vec<f32> = (0..coarse.cells()).map(|i| shape[under(i)]).collect();
    assert_eq!((moved.bend_shapes, moved.trend_weights), (vec![wanted.clone(); 7], wanted));
}

#[test]
fn beyond_its_edges_a_model_is_mirrored() {
    let larger = Grid { columns: 120, left_m: grid().left_m + 40.0 * 0.05, ..grid() };
    let noise = transfer(&face(larger, |_, _| 0.0), &json!({})).unwrap();
    let old = |column: usize, row: usize| row * COLUMNS + if column < COLUMNS { column } else { 191 - column };
    for (i, value) in noise.fields[3].iter().enumerate() {
        let cell = old(i % 120 + 40, i / 120);
        assert_eq!((*value, noise.weights[3][i]), (CLEAN.fields[3][cell], CLEAN.weights[3][cell]));
        let known = i % 120 + 40 < COLUMNS;
        assert_eq!(noise.strength[i], if known { CLEAN.strength[cell] } else { RELIEF.flat_px as f32 });
    }
}

#[test]
fn of_another_site_nothing_is_known_by_its_place() {
    let elsewhere = Grid { left_m: 0.33, ..grid() };
    let noise = transfer(&face(elsewhere, |_, _| 0.0), &json!({"same_site": false})).unwrap();
    assert!(noise.strength.iter().all(|s| *s == RELIEF.flat_px as f32));
    assert_eq!(noise.fields, CLEAN.fields);
    let host = TestHost::default();
    transfer_on(&host, model(), &face(grid(), |_, _| 5.0), &json!({})).unwrap();
    assert!(host.warnings()[0].contains("same_site: false"), "{:?}", host.warnings());
}

#[test]
fn draws_keep_their_spectrum_on_a_grid_of_another_size() {
    let smaller = Grid { columns: 90, rows: 48, top_m: 1.2, ..grid() };
    let noise = transfer(&face(smaller, |_, _| 0.0), &json!({})).unwrap();
    let (before, after) = (correlation(&CLEAN), correlation(&noise));
    assert!(before.iter().zip(&after).take(4).all(|(a, b)| (a - b).abs() < 0.05), "{before:?} {after:?}");
}

#[test]
fn a_field_scale_makes_the_noise_so_many_cells_longer_and_as_strong() {
    let noise = transfer(&face(grid(), |_, _| 0.0), &json!({"same_site": false, "field_scale": 2.0})).unwrap();
    let (before, after) = (correlation(&CLEAN), correlation(&noise));
    assert!((0..4).all(|lag| (before[lag] - after[2 * lag + 1]).abs() < 0.1), "{before:?} {after:?}");
    let variance = |values: Vec<f64>| mean(values.iter().map(|v| v * v));
    for field in &noise.fields {
        assert!((variance(field.iter().map(|v| f64::from(*v)).collect()) - 1.0).abs() < 1e-5);
    }
    let of_draws = |noise: &Noise| mean(drawn(noise, 12).into_iter().map(variance));
    let ratio = of_draws(&noise) / of_draws(&CLEAN);
    assert!((ratio - 1.0).abs() < 0.1, "{ratio}");
    assert_eq!((noise.relief.window_cells, noise.length_cells), (8, 2.0 * CLEAN.length_cells));
}

#[test]
fn frames_that_differ_tiny_faces_and_faces_that_no_pair_shows_are_refused() {
    let message =
        |noise: Noise, dem: &Raster| transfer_on(&TestHost::default(), noise, dem, &json!({})).unwrap_err().message;
    let flat = face(grid(), |_, _| 0.0);
    assert!(message(Noise { frame: Frame::World, ..model() }, &flat).contains("the model is in the world frame"));
    let world = Raster { frame: Frame::World, ..flat.clone() };
    assert!(message(model(), &world).contains("the cameras in the wall frame"));
    let tiny = Grid { rows: 5, ..grid() };
    assert!(message(model(), &face(tiny, |_, _| 0.0)).contains("96 x 5 cells"));
    let far = Grid { left_m: 500.0, ..grid() };
    assert!(message(model(), &face(far, |_, _| 0.0)).contains("no pair shows"));
    let fewer = Noise { class_log_strength: vec![0.0], ..model() };
    assert!(message(fewer, &flat).contains("classes of place"));
}
