//! Reference rasters that cannot be used: each is refused from the command line with its name, its fault and a way out.

use rockface_core::artefact::{Frame, Grid, Noun, Raster};

use crate::cli::House;

const PIPELINE: &str = "\
rockface: 1
name: references
steps:
  real:  {stage: import-rasters, with: {path: real}}
  noise: {stage: describe-noise, in: {raster: real.raster}, with: {scales_cells: [1, 2, 4]}}
  model: {stage: fit-acceptance, in: {features: noise.features}}
";

const SIDE: usize = 40;

/// A number between -1 and 1 for a cell of a raster, without pattern.
fn scatter(raster: usize, cell: usize) -> f32 {
    let mixed = (raster * 1_000_003 + cell + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    ((mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 40) as f32 / 8_388_608.0 - 1.0
}

fn noise(raster: usize) -> Vec<f32> {
    (0..SIDE * SIDE).map(|cell| 0.002 * (1.0 + 0.1 * (raster % 5) as f32) * scatter(raster, cell)).collect()
}

/// Means over 17 x 17 cells that weigh the nearer ones more: so smooth that the variogram starts as a parabola, without nugget.
fn smooth(raster: usize) -> Vec<f32> {
    let wide = SIDE + 16;
    let weight = |k: usize| 9.0 - (k as f32 - 8.0).abs();
    let mean = |cell: usize| {
        let places =
            (0..289).map(|k| (weight(k / 17) * weight(k % 17), (cell / SIDE + k / 17) * wide + cell % SIDE + k % 17));
        places.map(|(weight, place)| weight * scatter(raster, place)).sum::<f32>() / 6561.0
    };
    (0..SIDE * SIDE).map(|cell| 0.02 * mean(cell)).collect()
}

/// Exit code and messages for so many rasters, whose values and left edge (metres) are told by number.
fn fit(count: usize, values: impl Fn(usize) -> Vec<f32>, left_m: impl Fn(usize) -> f64) -> (Option<i32>, String) {
    let house = House::new(PIPELINE);
    std::fs::create_dir(house.path("real")).unwrap();
    for k in 0..count {
        let grid = Grid { columns: SIDE, rows: SIDE, cell_m: 0.01, left_m: left_m(k), top_m: 0.0 };
        let raster = Raster::single(grid, Frame::Wall, "difference", "d", values(k));
        std::fs::write(house.path(&format!("real/r{k:02}.tif")), raster.encode().unwrap()).unwrap();
    }
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--quiet", "--jobs", "1"]);
    (code, err)
}

fn check(found: &(Option<i32>, String), code: i32, told: &[&str]) {
    assert_eq!(found.0, Some(code), "{}", found.1);
    for text in told {
        assert!(found.1.contains(text), "`{text}` is missing: {}", found.1);
    }
}

#[test]
fn too_few_constant_empty_and_shifted_rasters_are_refused_by_name() {
    let fifth = |odd: f32| move |k: usize| if k == 5 { vec![odd; SIDE * SIDE] } else { noise(k) };
    let here = |_: usize| 0.0;
    check(&fit(11, noise, here), 1, &["at least 12 reference rasters, found 11", "add real rasters"]);
    check(&fit(14, fifth(0.25), here), 1, &["`r05`", "all its values are 0.25", "leave it out"]);
    check(&fit(14, fifth(f32::NAN), here), 1, &["`r05.tif`", "no value in any of its cells", "leave the file out"]);
    let shifted = fit(14, noise, |k| if k == 7 { 0.004 } else { 0.0 });
    check(&shifted, 1, &["`r07.tif`", "left 0.004 m", "resample the files to one grid"]);
    check(&fit(14, |_| noise(0), here), 1, &["none of mean_m", "varies over the 14 reference rasters"]);
}

#[test]
fn a_nugget_that_is_zero_everywhere_punishes_a_simulation_that_has_one() {
    check(&fit(14, smooth, |_| 0.0), 0, &["the same in all references: nugget_m2", "is punished for it"]);
}
