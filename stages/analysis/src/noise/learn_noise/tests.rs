//! What the model learns from rasters whose noise is known.

use std::sync::LazyLock;

use serde_json::{Value, json};

use super::*;
use crate::noise::detrend::robust_plane;
use crate::noise::learning;
use crate::noise::learning::correction::variances;
use crate::noise::learning::departure::{Mean, of_another};
use crate::noise::learning::differences::gaps;
use crate::noise::learning::whitening::CLASSES;
use rockface_core::artefact::{Artefact, Frame, Grid, Member, Noun, Pair};
use rockface_core::numerics::gaussian::smoothed;
use rockface_core::numerics::portable_math;
use rockface_core::numerics::random::Key;
use rockface_core::numerics::trend::{trend, trend_at, with_trend, without_trend};
use rockface_core::params::ParamType;
use rockface_core::testing::{TestHost, image_at, run_stage, small_sensor};
use rockface_imaging::matching::noise::ensemble::{Numbers, draw};
use rockface_imaging::matching::noise::parametric::Ground;

pub(in crate::noise) const COLUMNS: usize = 96;
pub(in crate::noise) const ROWS: usize = 80;

pub(in crate::noise) fn grid() -> Grid {
    Grid { columns: COLUMNS, rows: ROWS, cell_m: 0.05, left_m: -2.4, top_m: 2.0 }
}

pub(in crate::noise) fn survey() -> (Cameras, Pairs) {
    let images = vec![image_at("a", [-1.0, 0.0, 20.0], [0.0; 3]), image_at("b", [1.0, 0.0, 20.0], [0.0; 3])];
    let (first, second) = ("a".to_owned(), "b".to_owned());
    let pair = Pair {
        name: "a+b".into(),
        first,
        second,
        baseline_m: 2.0,
        distance_m: 20.0,
        convergence_rad: 0.0,
        overlap: 1.0,
    };
    (Cameras { frame: Frame::Wall, sensors: vec![small_sensor()], images }, Pairs { pairs: vec![pair] })
}

/// White noise smoothed by `cells`, of unit variance.
fn unit(seed: u8, cells: f64) -> Vec<f64> {
    let field = Key([seed; 32]).field();
    let draw = |i: usize| field.normal((i % COLUMNS) as i32, (i / COLUMNS) as i32) as f32;
    let white: Vec<f32> = (0..COLUMNS * ROWS).map(draw).collect();
    let smooth = smoothed(&white, COLUMNS, cells);
    let rms = (smooth.iter().map(|v| v * v).sum::<f64>() / smooth.len() as f64).sqrt();
    smooth.iter().map(|v| v / rms).collect()
}

/// Differences of 2 mm rms, three times that left of the middle; those in `bad` have noise of twice the strength in addition.
fn differences(count: u8, bad: &[u8]) -> Vec<Raster> {
    let place = |i: usize| if i % COLUMNS < COLUMNS / 2 { 3.0 } else { 1.0 };
    let one = |b: u8| {
        let (usual, blur) = (unit(b, 1.5), unit(b + 100, 5.0));
        let more = if bad.contains(&b) { 2.0 } else { 0.0 };
        let level = 1.0 + 0.1 * (f64::from(b % 5) - 2.0);
        let gap = |i: usize| (i / COLUMNS) % 20 == 7 && (i % COLUMNS + usize::from(b)) % 30 < 4;
        let value =
            |i: usize| if gap(i) { f32::NAN } else { (0.002 * place(i) * (level * usual[i] + more * blur[i])) as f32 };
        Raster::single(grid(), Frame::Wall, "difference", &format!("n{b}"), (0..COLUMNS * ROWS).map(value).collect())
    };
    (0..count).map(one).collect()
}

/// Sixteen differences, good ones, without their values beyond a limit.
fn differences_within(limit_m: f32) -> Vec<Raster> {
    let mut rasters = differences(16, &[]);
    let values = rasters.iter_mut().flat_map(|raster| &mut raster.bands[0].values);
    values.filter(|value| value.abs() > limit_m).for_each(|value| *value = f32::NAN);
    rasters
}

fn learn(count: u8, bad: &[u8], with: &Value) -> Result<(Noise, TestHost), StageError> {
    learn_from(differences(count, bad), with)
}

fn learn_from(rasters: Vec<Raster>, with: &Value) -> Result<(Noise, TestHost), StageError> {
    let (cameras, pairs) = survey();
    let dem = Raster::single(grid(), Frame::Wall, "elevation", "dem", vec![0.0; COLUMNS * ROWS]);
    let mut inputs: Vec<(&str, Artefact)> = rasters.into_iter().map(|r| ("raster", r.into())).collect();
    inputs.extend([("dem", dem.into()), ("cameras", cameras.into()), ("pairs", pairs.into())]);
    let host = TestHost::default();
    let outputs = run_stage::<LearnNoise>(&host, with, &inputs)?.into_inner();
    Ok((Noise::of(&outputs["noise"]).unwrap().clone(), host))
}

pub(in crate::noise) static CLEAN: LazyLock<Noise> = LazyLock::new(|| learn(16, &[], &json!({})).unwrap().0);

/// The numbers of acquisitions that are compared two by two.
pub(in crate::noise) fn of_two(number: u64) -> Numbers {
    Numbers { acquisition: Some(number as u32 % 2), replicate: None }
}

/// Root mean squares of differences of two drawn acquisitions, right of the middle and left of it, pixels.
fn drawn_px(noise: &Noise, count: u64) -> Vec<[f64; 2]> {
    drawn_within_px(noise, count, f64::INFINITY)
}

/// The same of differences without values beyond a limit, pixels.
fn drawn_within_px(noise: &Noise, count: u64, limit_px: f64) -> Vec<[f64; 2]> {
    let acquisition = |seed: u64| {
        let keys = |purpose: &str, item: &str| {
            let host = TestHost::seeded(seed);
            Context::new(&host).stream(purpose, item)
        };
        draw(noise, Ground::of(noise).as_ref(), of_two(seed), &keys)
            .errors_px(noise, &noise.strength)
            .into_iter()
            .map(f64::from)
            .collect::<Vec<f64>>()
    };
    let rms = |seed: u64| {
        let (pre, post) = (acquisition(2 * seed), acquisition(2 * seed + 1));
        [false, true].map(|left| {
            let inside = (0..pre.len()).filter(|i| (i % COLUMNS < COLUMNS / 2) == left);
            let differences = inside.map(|i| post[i] - pre[i]).filter(|d| d.abs() <= limit_px);
            let squares: Vec<f64> = differences.map(|d| d * d).collect();
            (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
        })
    };
    (0..count).map(rms).collect()
}

pub(in crate::noise) fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.collect();
    values.iter().sum::<f64>() / values.len() as f64
}

/// Takes the plane that most cells of each raster agree on off it, as registration does.
fn align(rasters: &mut [Raster]) {
    for raster in rasters {
        let values = &mut raster.bands[0].values;
        let robust = robust_plane(values, COLUMNS).unwrap();
        let height = |i: usize, k: usize| {
            let half = [0.5 * COLUMNS as f64, 0.5 * ROWS as f64];
            let at = [1.0, (i % COLUMNS) as f64 / half[0] - 1.0, (i / COLUMNS) as f64 / half[1] - 1.0];
            robust[k] * at[k]
        };
        values.iter_mut().enumerate().for_each(|(i, z)| *z -= (0..3).map(|k| height(i, k)).sum::<f64>() as f32);
    }
}

#[test]
fn rasters_with_values_beyond_the_outlier_limit_are_refused_by_name() {
    let mut rasters = differences_within(0.012);
    rasters[3].bands[0].values[40..43].fill(-0.3);
    rasters[5].bands[0].values[50] = 0.2;
    let error = learn_from(rasters, &json!({"outlier_m": 0.012, "draws": 0})).err().unwrap();
    assert!(
        error.message.contains("raster `n3` has 3 values beyond `outlier_m`, 0.012 m, the largest 0.3 m; one other"),
        "{error}"
    );
    assert!(error.hint.unwrap().contains("`filter-outliers`"));
}

#[test]
fn rasters_that_are_there_twice_are_told() {
    let mut rasters = differences(6, &[]);
    rasters.push(rasters[2].clone());
    rasters[6].bands[0].name = "copy".to_owned();
    let (_, host) = learn_from(rasters, &json!({"draws": 0})).unwrap();
    assert!(
        host.warnings().iter().any(|text| text.contains("2 of 7 rasters") && text.contains("`n2` and `copy` (1.00)"))
    );
    let (_, host) = learn(6, &[], &json!({"draws": 0})).unwrap();
    assert!(!host.warnings().iter().any(|text| text.contains("correlate with another")), "{:?}", host.warnings());
}

#[test]
fn draws_are_as_asymmetric_as_rasters_that_are_bent() {
    let mut rasters = differences(16, &[]);
    for (b, raster) in rasters.iter_mut().enumerate() {
        let bend_m = 0.012 * (b as f64 - 7.5) / 7.5;
        let mut trend_m = Trend::default();
        trend_m[3] = bend_m;
        raster.bands[0].values = with_trend(&raster.bands[0].values, COLUMNS, &trend_m);
    }
    align(&mut rasters);
    let (noise, _) = learn_from(rasters, &json!({"draws": 24})).unwrap();
    assert!((0.7..1.4).contains(&noise.asymmetry_gain[0]), "{:?}", noise.asymmetry_gain);
}

#[test]
fn registration_that_aligns_what_most_cells_agree_on_is_known_by_its_offsets() {
    let mut rasters = differences(16, &[]);
    align(&mut rasters);
    let with = json!({"draws": 0});
    let (noise, _) = learn_from(rasters.clone(), &with).unwrap();
    assert!(noise.asymmetry_gain.iter().all(|gain| (gain - 1.0).abs() < 0.02), "{:?}", noise.asymmetry_gain);
    // Offset and tilts of what is left of the trend, where the raster has values.
    let rest = |(member, raster): (&Member, &Raster)| {
        let height = |i: usize| {
            let [x, y] = [(i % COLUMNS) as f64 / (0.5 * COLUMNS as f64), (i / COLUMNS) as f64 / (0.5 * ROWS as f64)];
            trend_at(&member.trend_m, x - 1.0, y - 1.0) as f32
        };
        let known = raster.bands[0].values.iter().enumerate();
        let left: Vec<f32> = known.map(|(i, z)| if z.is_nan() { f32::NAN } else { height(i) }).collect();
        trend(&left, COLUMNS, &noise.trend_weights).unwrap()[..3].iter().map(|m| m.abs()).fold(0.0, f64::max)
    };
    let rest = noise.members.iter().zip(&rasters).map(rest).fold(0.0, f64::max);
    assert!(rest < 1e-5, "{rest}");
}

#[test]
fn differences_of_drawn_acquisitions_have_the_strength_of_the_rasters_at_each_place() {
    let step_m = 20.0 * 20.0 / (small_sensor().f * 2.0);
    let drawn = drawn_px(&CLEAN, 80);
    for (side, expected) in [(0, 0.002), (1, 0.006)] {
        let ratio = mean(drawn.iter().map(|rms| rms[side])) * step_m / expected;
        assert!((ratio - 1.0).abs() < 0.08, "{side}: {ratio}");
    }
    let deviation = |values: Vec<f64>| {
        let middle = mean(values.iter().copied());
        mean(values.iter().map(|v| (v - middle) * (v - middle))).sqrt()
    };
    let spread = deviation(drawn.iter().map(|rms| portable_math::log(rms[0])).collect());
    assert!((0.08..0.25).contains(&spread), "the rasters vary by 0.145: {spread}");
}

#[test]
fn draws_are_as_strong_as_rasters_whose_largest_values_were_filtered_out() {
    let (limit_m, step_m) = (0.012f32, 20.0 * 20.0 / (small_sensor().f * 2.0));
    let rasters = differences_within(limit_m);
    let left = |raster: &Raster| {
        let cells = raster.bands[0].values.iter().enumerate();
        let inside = cells.filter(|(i, value)| i % COLUMNS < COLUMNS / 2 && !value.is_nan());
        mean(inside.map(|(_, value)| f64::from(*value) * f64::from(*value))).sqrt()
    };
    let expected_px = mean(rasters.iter().map(left)) / step_m;
    let ratio = |with: &Value| {
        let (noise, _) = learn_from(rasters.clone(), with).unwrap();
        mean(drawn_within_px(&noise, 60, f64::from(limit_m) / step_m).iter().map(|rms| rms[1])) / expected_px
    };
    let (known, unknown) = (ratio(&json!({"outlier_m": 0.012, "draws": 8})), ratio(&json!({"draws": 8})));
    assert!((known - 1.0).abs() < 0.08 && unknown < known - 0.01, "{known} {unknown}");
}

#[test]
fn gaps_are_as_frequent_as_in_the_rasters() {
    let of_noise = CLEAN.weights.iter().flatten().filter(|weight| **weight & rockface_core::artefact::GAP != 0).count();
    let expected = of_noise as f64 / (CLEAN.weights.len() * COLUMNS * ROWS) as f64;
    let share = |seed: u64| {
        let epoch = |seed: u64| {
            let keys = |purpose: &str, item: &str| {
                let host = TestHost::seeded(seed);
                Context::new(&host).stream(purpose, item)
            };
            draw(&CLEAN, None, of_two(seed), &keys).field
        };
        let both = epoch(2 * seed).into_iter().zip(epoch(2 * seed + 1));
        both.filter(|(a, b)| a.is_nan() || b.is_nan()).count() as f64 / (COLUMNS * ROWS) as f64
    };
    let found = mean((0..30).map(share));
    assert!(expected > 0.003 && (found / expected - 1.0).abs() < 0.4, "{found} {expected}");
}

#[test]
fn a_model_of_few_rasters_has_their_gaps_as_often_and_where_they_had_them() {
    let share = |rasters: &[Vec<f32>]| mean(gaps(rasters, &[true; COLUMNS * ROWS]).into_iter().map(|[share]| share));
    let rasters = differences(6, &[]);
    let real: Vec<Vec<f32>> = rasters.iter().map(|raster| raster.bands[0].values.clone()).collect();
    let (noise, _) = learn_from(rasters, &json!({"draws": 24})).unwrap();
    assert!(!noise.has_fields() && noise.has_gaps());
    let drawn = drawn_differences(&noise, 40);
    assert!((share(&drawn) / share(&real) - 1.0).abs() < 0.3, "{} {}", share(&drawn), share(&real));
    let never = |i: usize| real.iter().all(|raster| !raster[i].is_nan());
    assert!(drawn.iter().all(|raster| raster.iter().enumerate().all(|(i, value)| !value.is_nan() || !never(i))));
}

#[test]
fn bad_acquisitions_have_the_gaps_of_bad_rasters() {
    let mut rasters = differences(16, &[5, 6]);
    // Both differences of a bad epoch have gaps in a third of the columns, and others have some of these.
    for (b, raster) in rasters.iter_mut().enumerate() {
        let every = if b == 5 || b == 6 { 1 } else { 8 };
        let gap = |i: usize| i % COLUMNS % 3 == 1 && (i / COLUMNS + b).is_multiple_of(every);
        let values = raster.bands[0].values.iter_mut().enumerate();
        values.filter(|(i, _)| gap(*i)).for_each(|(_, value)| *value = f32::NAN);
    }
    let (noise, _) = learn_from(rasters, &json!({"draws": 8})).unwrap();
    assert_eq!(noise.by_class().0, [5, 6]);
    let share = |bad_share: f64, seed: u64| {
        let host = TestHost::seeded(seed);
        let context = Context::new(&host);
        let noise = Noise { bad_share, gap_gain: 1.0, ..noise.clone() };
        let drawn = draw(&noise, None, of_two(seed), &|purpose, item| context.stream(purpose, item));
        drawn.field.iter().filter(|value| value.is_nan()).count() as f64 / drawn.field.len() as f64
    };
    let [usual, bad] = [0.0, 1.0].map(|bad_share| mean((0..12).map(|seed| share(bad_share, seed))));
    assert!((bad - 0.34).abs() < 0.02 && usual < 0.05, "{bad} {usual}");
}

#[test]
fn shares_of_gaps_vary_as_in_the_rasters() {
    let mut rasters = differences(24, &[]);
    // Every third raster has gaps in squares besides, at places of its own.
    for (b, raster) in rasters.iter_mut().enumerate().filter(|(b, _)| b.is_multiple_of(3)) {
        let square = |i: usize| ((i / COLUMNS + 5 * b) / 6 + (i % COLUMNS + 7 * b) / 6).is_multiple_of(8);
        let values = raster.bands[0].values.iter_mut().enumerate();
        values.filter(|(i, _)| square(*i)).for_each(|(_, value)| *value = f32::NAN);
    }
    let shares = |rasters: &[Vec<f32>]| {
        let shares = gaps(rasters, &[true; COLUMNS * ROWS]);
        let share = Mean::of(&shares, 0);
        (share.value, (share.squared_error * shares.len() as f64).sqrt())
    };
    let real = shares(&rasters.iter().map(|raster| raster.bands[0].values.clone()).collect::<Vec<_>>());
    let (noise, _) = learn_from(rasters, &json!({"draws": 24})).unwrap();
    let drawn = |gap_variety: f64| shares(&drawn_differences(&Noise { gap_variety, ..noise.clone() }, 72));
    let (found, none) = (drawn(noise.gap_variety), drawn(0.0));
    assert!((found.0 / real.0 - 1.0).abs() < 0.25, "{found:?} {real:?} {}", noise.gap_variety);
    assert!((found.1 / real.1 - 1.0).abs() < 0.3 && none.1 < 0.6 * real.1, "{found:?} {none:?} {real:?}");
}

#[test]
fn outliers_that_are_filtered_out_do_not_add_to_the_gaps() {
    let (limit_m, step_m) = (0.012f32, 20.0 * 20.0 / (small_sensor().f * 2.0));
    let rasters = differences_within(limit_m);
    let share = |rasters: &[Vec<f32>]| mean(gaps(rasters, &[true; COLUMNS * ROWS]).into_iter().map(|[share]| share));
    let expected = share(&rasters.iter().map(|raster| raster.bands[0].values.clone()).collect::<Vec<_>>());
    let (noise, _) = learn_from(rasters, &json!({"outlier_m": 0.012, "draws": 16})).unwrap();
    let ratio = |noise: &Noise| {
        let host = TestHost::seeded(12);
        let context = Context::new(&host);
        let steps = vec![1.0; noise.grid.cells()];
        let limit_px = limit_m / step_m as f32;
        let drawn = learning::differences::differences(noise, 40, &steps, limit_px, &|p, item| context.stream(p, item));
        share(&drawn) / expected
    };
    let (found, before) = (ratio(&noise), ratio(&Noise { gap_gain: 1.0, ..noise.clone() }));
    // The limit is at two deviations of the strong half, so a third of the gaps were outliers: half of what is too much goes.
    assert!(before > 1.3 && (found - 1.0).abs() < 0.55 * (before - 1.0), "{found} {before} {}", noise.gap_gain);
}

#[test]
fn what_no_raster_shows_no_draw_does() {
    let mut rasters = differences(16, &[]);
    let strip = |i: usize| i % COLUMNS < 12;
    for raster in &mut rasters {
        let values = raster.bands[0].values.iter_mut().enumerate();
        values.filter(|(i, _)| strip(*i)).for_each(|(_, value)| *value = f32::NAN);
    }
    let (noise, _) = learn_from(rasters, &json!({"draws": 8})).unwrap();
    for raster in drawn_differences(&Noise { gap_gain: 0.3, ..noise }, 6) {
        assert!(raster.iter().enumerate().all(|(i, value)| !strip(i) || value.is_nan()));
        assert!(raster.iter().filter(|value| value.is_nan()).count() < COLUMNS * ROWS / 4);
    }
}

#[test]
fn draws_are_as_skewed_as_the_rasters() {
    let mut rasters = differences(16, &[]);
    for (b, raster) in rasters.iter_mut().enumerate() {
        let values = &mut raster.bands[0].values;
        let lean = if b % 2 == 0 { 0.03 } else { -0.03 };
        values.iter_mut().for_each(|value| *value += lean * value.abs() * (value.abs() / 0.003).min(2.0));
    }
    let rms = |rasters: &[Vec<f32>]| mean(skewnesses(rasters).into_iter().map(|skewness| skewness * skewness)).sqrt();
    let real = rms(&rasters.iter().map(|raster| raster.bands[0].values.clone()).collect::<Vec<_>>());
    let (noise, _) = learn_from(rasters, &json!({"draws": 16})).unwrap();
    let of_draws = |noise: &Noise| rms(&drawn_differences(noise, 48)) / real;
    let (found, without) = (of_draws(&noise), of_draws(&Noise { skewness_gain: 0.0, ..noise.clone() }));
    assert!((found - 1.0).abs() < 0.3 && without < 0.5, "{found} {without} of {real}");
}

/// Differences of two acquisitions, pixels.
fn drawn_differences(noise: &Noise, count: usize) -> Vec<Vec<f32>> {
    let host = TestHost::seeded(11);
    let context = Context::new(&host);
    let step_m = vec![1.0; noise.grid.cells()];
    learning::differences::differences(noise, count, &step_m, f32::INFINITY, &|purpose, item| {
        context.stream(purpose, item)
    })
}

#[test]
fn planes_of_the_rasters_are_not_part_of_the_noise() {
    let mut rasters = differences(16, &[]);
    let with = json!({"draws": 0});
    let (level, _) = learn_from(rasters.clone(), &with).unwrap();
    for (b, raster) in rasters.iter_mut().enumerate() {
        let tilt = 0.004 * (b as f64 - 7.5);
        let height = |i: usize| tilt * ((i % COLUMNS) as f64 / 48.0 - 1.0) + 0.01;
        raster.bands[0].values.iter_mut().enumerate().for_each(|(i, z)| *z += height(i) as f32);
    }
    let (tilted, _) = learn_from(rasters, &with).unwrap();
    let apart = level.strength.iter().zip(&tilted.strength).map(|(a, b)| (b / a - 1.0).abs()).fold(0.0, f32::max);
    assert!(apart < 1e-3, "{apart}");
    let figures = |noise: &Noise| noise.members.iter().flat_map(|m| m.log_amplitude.clone()).collect::<Vec<f64>>();
    assert!(figures(&level).iter().zip(figures(&tilted)).all(|(a, b)| (a - b).abs() < 1e-3));
}

#[test]
fn draws_differ_from_each_other_as_much_as_other_rasters_would() {
    // Fine and coarse noise in a proportion that differs from raster to raster.
    let one = |b: u8| {
        let (fine, coarse) = (unit(b, 0.8), unit(b + 100, 5.0));
        let part = portable_math::exp(0.3 * Key([200; 32]).field().normal(i32::from(b), 0));
        let value = |i: usize| (0.002 * (fine[i] + part * coarse[i])) as f32;
        Raster::single(grid(), Frame::Wall, "difference", &format!("n{b}"), (0..COLUMNS * ROWS).map(value).collect())
    };
    let rasters: Vec<Raster> = (0..24).map(one).collect();
    let (noise, _) = learn_from(rasters.clone(), &json!({})).unwrap();
    let bands: Vec<&Band> = rasters.iter().flat_map(|raster| &raster.bands).collect();
    let real = learning::differences::level(&bands, COLUMNS, &vec![1.0; COLUMNS * ROWS], &[]).unwrap().0;
    let places = Places::of(noise.strength.clone());
    let deviations = |rasters: &[Vec<f32>]| {
        let whitened = whiten(rasters, COLUMNS, &places);
        variances(&whitened.iter().collect::<Vec<_>>()).split_off(CLASSES)
    };
    // Beyond the coarsest bands, in which a raster has a few waves only.
    let wider = of_another(rasters.len());
    let ratio = |(drawn, real): (f64, f64)| 0.5 * portable_math::log(drawn / (wider * real));
    let ratios: Vec<f64> =
        deviations(&drawn_differences(&noise, 60)).into_iter().zip(deviations(&real)).map(ratio).skip(3).collect();
    let mean = mean(ratios.iter().copied());
    assert!(mean.abs() < 0.2, "{mean} {ratios:?}");
}

#[test]
fn fine_noise_that_is_the_same_in_all_rasters_is_so_in_all_draws() {
    // A few long waves by whose chance the rms of the rasters differs.
    let one = |b: u8| {
        let (fine, coarse) = (unit(b, 0.5), long_waves(b + 20));
        let value = |i: usize| (0.002 * (fine[i] + 0.7 * coarse[i])) as f32;
        Raster::single(grid(), Frame::Wall, "difference", &format!("n{b}"), (0..COLUMNS * ROWS).map(value).collect())
    };
    let rasters: Vec<Raster> = (0..20).map(one).collect();
    let fine = |raster: &[f32]| {
        let pairs = raster.windows(2).enumerate().filter(|(i, _)| (i + 1) % COLUMNS > 0);
        let steps = pairs.map(|(_, pair)| f64::from(pair[1] - pair[0]));
        0.5 * portable_math::log(mean(steps.map(|step| step * step)))
    };
    let deviation = |values: Vec<f64>| {
        let middle = mean(values.iter().copied());
        mean(values.iter().map(|value| (value - middle) * (value - middle))).sqrt()
    };
    let real = deviation(rasters.iter().map(|raster| fine(&raster.bands[0].values)).collect());
    let (noise, _) = learn_from(rasters, &json!({})).unwrap();
    let drawn = deviation(drawn_differences(&noise, 60).iter().map(|raster| fine(raster)).collect());
    assert!(drawn < 2.0 * real, "{drawn} {real}");
}

#[test]
fn nowhere_does_the_noise_of_two_acquisitions_cancel() {
    let side = 16;
    let strengths = |difference: &Vec<f32>| -> Vec<f64> {
        let block = |b: usize| {
            let (top, left) = (b / (COLUMNS / side) * side, b % (COLUMNS / side) * side);
            let cells = (0..side * side).map(|i| (top + i / side) * COLUMNS + left + i % side);
            let unit = cells.map(|i| f64::from(difference[i] / CLEAN.strength[i])).filter(|value| !value.is_nan());
            mean(unit.map(|value| value * value)).sqrt()
        };
        (0..COLUMNS / side * (ROWS / side)).map(block).collect()
    };
    let all: Vec<f64> = drawn_differences(&CLEAN, 40).iter().flat_map(strengths).collect();
    let weakest = all.iter().copied().fold(f64::INFINITY, f64::min);
    assert!(weakest > 0.3 * mean(all.iter().copied()), "{weakest}");
}

#[test]
fn every_raster_is_drawn_from_as_often_as_the_others() {
    let mut noise = Noise { jitter: 0.0, bad_share: 0.0, ..CLEAN.clone() };
    for (i, member) in noise.members.iter_mut().enumerate() {
        member.log_strength.fill(if i % 2 == 0 { 1.0 } else { -1.0 });
    }
    // As many differences as there are rasters: the strong half and the weak one have the same say, whatever the random numbers.
    let step_m = vec![1.0; noise.grid.cells()];
    let mean_square = |seed: u64| {
        let host = TestHost::seeded(seed);
        let context = Context::new(&host);
        let streams = |purpose: &str, item: &str| context.stream(purpose, item);
        let drawn = learning::differences::differences(&noise, 16, &step_m, f32::INFINITY, &streams);
        mean(drawn.iter().flatten().filter(|px| !px.is_nan()).map(|px| f64::from(*px) * f64::from(*px)))
    };
    let found = [1, 2, 3].map(mean_square);
    let middle = mean(found.into_iter());
    assert!(found.iter().all(|square| (square / middle - 1.0).abs() < 0.08), "{found:?}");
}

#[test]
fn details_of_draws_are_as_uneven_as_those_of_the_rasters() {
    let one = |b: u8| {
        let (fine, where_from, coarse) = (unit(b, 0.6), unit(b + 60, 2.5), unit(b + 120, 4.0));
        let value = |i: usize| (0.002 * (fine[i] * portable_math::exp(1.2 * where_from[i]) + coarse[i])) as f32;
        Raster::single(grid(), Frame::Wall, "difference", &format!("n{b}"), (0..COLUMNS * ROWS).map(value).collect())
    };
    let rasters: Vec<Raster> = (0..16).map(one).collect();
    let real =
        Figures::of(&rasters.iter().map(|raster| raster.bands[0].values.as_slice()).collect::<Vec<_>>(), COLUMNS);
    // In deviations from raster to raster: flatness of the finest details, and their cascade.
    let lacks = |with: &Value| {
        let (noise, _) = learn_from(rasters.clone(), with).unwrap();
        let drawn = drawn_differences(&noise, 24);
        let drawn = Figures::of(&drawn.iter().map(Vec::as_slice).collect::<Vec<_>>(), COLUMNS);
        let lack = |k: usize| (real.mean[0].unevenness[k] - drawn.mean[0].unevenness[k]) / real.deviation[0][k];
        [mean((0..3).map(lack)), lack(3)]
    };
    let (fitted, none) = (lacks(&json!({})), lacks(&json!({"contrast": 0.0, "draws": 8})));
    // Of the flatness a part is left to spare powers; the cascade may be off by what it differs from raster to raster.
    assert!(none[0] > 0.5 && fitted[0].abs() < 0.65 * none[0] && fitted[1].abs() < 1.0, "{fitted:?} {none:?}");
}

#[test]
fn one_or_two_bad_rasters_do_not_widen_the_good_draws() {
    for bad in [&[4u8][..], &[4, 11]] {
        let (noise, host) = learn(16, bad, &json!({"draws": 32})).unwrap();
        let flagged: Vec<&str> = noise.members.iter().filter(|m| m.bad).map(|m| m.name.as_str()).collect();
        assert_eq!(flagged, bad.iter().map(|b| format!("n{b}")).collect::<Vec<_>>());
        assert!((noise.bad_share - bad.len() as f64 / 32.0).abs() < 1e-12);
        assert_eq!(host.metric("bad_rasters"), Some(bad.len() as f64));
        assert!(host.warnings().iter().any(|text| flagged.iter().all(|name| text.contains(name))));
        let good = Noise { bad_share: 0.0, ..noise.clone() };
        let rms = |noise: &Noise| mean(drawn_px(noise, 120).iter().map(|rms| rms[0]));
        let ratio = rms(&good) / rms(&CLEAN);
        assert!((ratio - 1.0).abs() < 0.06, "{ratio}");
        let all_bad = Noise { bad_share: 1.0, ..noise };
        assert!(rms(&all_bad) / rms(&CLEAN) > 2.0);
    }
}

#[test]
fn few_rasters_make_a_parametric_model() {
    let (noise, _) = learn(6, &[], &json!({"draws": 8})).unwrap();
    assert!(!noise.has_fields() && noise.members.len() == 6);
    let ratio = mean(drawn_px(&noise, 40).iter().map(|rms| rms[0])) * 20.0 * 20.0 / (small_sensor().f * 2.0) / 0.002;
    // The relief of a plane says that all places are alike, which few rasters only half contradict.
    assert!((0.8..1.6).contains(&ratio), "{ratio}");
    assert_eq!(Noise::decode(&noise.encode().unwrap()).unwrap(), noise);
}

/// Waves of all lengths, the longer the stronger, as noise of a matcher has: smoothed by 1 to 16 cells.
fn long_waves(seed: u8) -> Vec<f64> {
    let parts: Vec<Vec<f64>> = (0..5).map(|k| unit(seed + 40 * k, f64::from(1u8 << k))).collect();
    (0..COLUMNS * ROWS).map(|i| parts.iter().map(|part| part[i]).sum()).collect()
}

#[test]
fn draws_of_a_parametric_model_are_as_strong_as_the_rasters_without_their_trends() {
    let raster = |seed: u8| {
        let values = long_waves(seed).into_iter().map(|value| (0.002 * value) as f32).collect();
        Raster::single(grid(), Frame::Wall, "difference", &format!("w{seed}"), values)
    };
    let rasters: Vec<Raster> = (0..6).map(raster).collect();
    let step_m = (20.0 * 20.0 / (small_sensor().f * 2.0)) as f32;
    let rms = |values: &[f32]| mean(values.iter().map(|value| f64::from(*value) * f64::from(*value))).sqrt();
    let (noise, _) = learn_from(rasters.clone(), &json!({"draws": 24})).unwrap();
    let level_of = |raster: &Raster| without_trend(&raster.bands[0].values, COLUMNS, &noise.trend_weights).unwrap();
    let real = mean(rasters.iter().map(|raster| rms(&level_of(raster)))) / f64::from(step_m);
    let drawn = mean(drawn_px(&noise, 40).iter().map(|rms| (0.5 * (rms[0] * rms[0] + rms[1] * rms[1])).sqrt()));
    assert!((drawn / real - 1.0).abs() < 0.12, "{drawn} {real}");
    // And as fine: where opposite edges of rasters differ, that is no fine noise.
    let steps = |values: &[f32]| {
        let rows = values.chunks(COLUMNS).flat_map(|row| row.windows(2));
        rms(&rows.map(|pair| pair[1] - pair[0]).collect::<Vec<f32>>())
    };
    let real = mean(rasters.iter().map(|raster| steps(&raster.bands[0].values))) / f64::from(step_m);
    let drawn = mean(drawn_differences(&noise, 40).iter().map(|values| steps(values)));
    assert!((drawn / real - 1.0).abs() < 0.07, "{drawn} {real}");
}

#[test]
fn what_cannot_be_learnt_from_is_refused() {
    assert!(learn(4, &[], &json!({"held_out": 0.6})).err().unwrap().message.contains("2 of 4 rasters"));
    let (noise, _) = learn(16, &[], &json!({"held_out": 0.25, "draws": 0})).unwrap();
    assert_eq!(noise.members.len(), 12);
    for slope in [0.0, 0.001] {
        let mut rasters = differences(4, &[]);
        let values = rasters[2].bands[0].values.iter_mut().enumerate();
        values.for_each(|(i, z)| *z = 0.3 + slope * (i % COLUMNS) as f32);
        let refused = learn_from(rasters, &json!({})).err().unwrap().message;
        assert!(refused.contains("`n2` is a plane"), "{refused}");
    }
}

/// The model learnt in a window of rasters whose cells from column 60 on are multiplied.
fn learnt_in(window_m: [f64; 4], beyond: f32) -> Result<Noise, StageError> {
    let mut rasters = differences(13, &[]);
    let values = rasters.iter_mut().flat_map(|raster| raster.bands[0].values.iter_mut().enumerate());
    values.filter(|(i, _)| i % COLUMNS >= 60).for_each(|(_, value)| *value *= beyond);
    learn_from(rasters, &json!({"window_m": window_m, "draws": 4})).map(|(noise, _)| noise)
}

#[test]
fn cells_outside_of_the_window_do_not_change_a_bit_of_the_model() {
    // Half a cell beyond column 59: whole cells alone count.
    let window_m = [-1e6, -2.4 + 60.5 * 0.05, -1.0, 1e6];
    let noise = learnt_in(window_m, 1.0).unwrap();
    assert_eq!((noise.grid.columns, noise.grid.rows), (60, 60));
    assert_eq!((noise.grid.left_m, noise.grid.top_m), (grid().left_m, grid().top_m));
    assert_eq!((noise.strength.len(), noise.fields[0].len(), noise.weights[12].len()), (3600, 3600, 3600));
    assert_eq!(learnt_in(window_m, 7.0).unwrap(), noise);
    assert_ne!(learnt_in([-1e6, 1e6, -1.0, 1e6], 7.0).unwrap(), learnt_in([-1e6, 1e6, -1.0, 1e6], 1.0).unwrap());
}

#[test]
fn windows_that_are_empty_beside_the_face_or_tiny_are_refused() {
    let params = LearnNoiseParams::decode(&json!({"window_m": [0, 1, 2, 1]})).unwrap();
    assert_eq!(LearnNoise::check(&params)[0].path, ["window_m"]);
    let refused = |window_m: [f64; 4]| learnt_in(window_m, 1.0).unwrap_err().message;
    assert!(refused([5.0, 6.0, -1.0, 1.0]).contains("96 x 80 cells"));
    assert!(refused([0.0, 0.2, -1.0, 1.0]).contains("4 x 40 cells"));
}
