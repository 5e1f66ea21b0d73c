//! A survey that smooths the noise is made up for; one that loses nothing leaves the model as it is.

use serde_json::{Value, json};

use super::*;
use crate::noise::learn_noise::tests::{CLEAN, COLUMNS, ROWS, grid, mean, of_two, survey};
use crate::noise::learning::whitening::{BANDS, CLASSES};
use rockface_core::artefact::{Artefact, Contrast, Frame, LevelContrast, Noun};
use rockface_core::numerics::gaussian::smoothed;
use rockface_core::numerics::trend::{bends_at, bent, trend, without_trend};
use rockface_core::testing::{TestHost, run_stage, small_sensor};
use rockface_imaging::matching::noise::ensemble::draw;
use rockface_imaging::matching::noise::skewness::with_skewness;

/// Differences of two acquisitions of the model, metres, smoothed by some cells.
fn differences(count: u64, cells: f64) -> Vec<Raster> {
    let step_m = (20.0 * 20.0 / (small_sensor().f * 2.0)) as f32;
    let epoch = |seed: u64| {
        let keys = |purpose: &str, item: &str| {
            let host = TestHost::seeded(seed);
            Context::new(&host).stream(purpose, item)
        };
        draw(&CLEAN, None, of_two(seed), &keys).errors_px(&CLEAN, &CLEAN.strength)
    };
    let one = |number: u64| {
        let (pre, post) = (epoch(1000 + 2 * number), epoch(1001 + 2 * number));
        let values: Vec<f32> = pre.iter().zip(post).map(|(pre, post)| (post - pre) * step_m).collect();
        let smooth = if cells > 0.0 {
            let smooth = smoothed(&values, COLUMNS, cells);
            values.iter().zip(smooth).map(|(v, s)| if v.is_nan() { f32::NAN } else { s as f32 }).collect()
        } else {
            values
        };
        Raster::single(grid(), Frame::Wall, "difference", &format!("s{number}"), smooth)
    };
    (0..count).map(one).collect()
}

fn adjust(simulated: Vec<Raster>, drawn: Vec<Raster>, noise: Noise) -> Result<Noise, StageError> {
    adjust_with(&json!({}), simulated, drawn, noise)
}

fn adjust_with(with: &Value, simulated: Vec<Raster>, drawn: Vec<Raster>, noise: Noise) -> Result<Noise, StageError> {
    run_on(&TestHost::default(), with, simulated, drawn, noise)
}

fn run_on(
    host: &TestHost,
    with: &Value,
    simulated: Vec<Raster>,
    drawn: Vec<Raster>,
    noise: Noise,
) -> Result<Noise, StageError> {
    let (cameras, pairs) = survey();
    let dem = Raster::single(grid(), Frame::Wall, "elevation", "dem", vec![0.0; COLUMNS * ROWS]);
    let mut inputs: Vec<(&str, Artefact)> = simulated.into_iter().map(|r| ("simulated", r.into())).collect();
    inputs.extend(drawn.into_iter().map(|r| ("drawn", r.into())));
    inputs.extend([
        ("noise", Artefact::Noise(noise)),
        ("dem", dem.into()),
        ("cameras", cameras.into()),
        ("pairs", pairs.into()),
    ]);
    let outputs = run_stage::<AdjustNoise>(host, with, &inputs)?.into_inner();
    Ok(Noise::of(&outputs["noise"]).unwrap().clone())
}

#[test]
fn what_is_smoothed_away_is_added_and_nothing_else() {
    let drawn = differences(6, 0.0);
    let mut clean = Noise { bend_shapes: Vec::new(), ..CLEAN.clone() };
    clean.contrast.levels.iter_mut().for_each(|level| level.drawn = level.usual);
    let same = adjust(drawn.clone(), drawn.clone(), clean.clone()).unwrap();
    assert_eq!(Noise { contrast: clean.contrast.clone(), ..same.clone() }, clean);
    // Where nothing is missing, powers that the figures hardly need become smaller.
    let squares = |noise: &Noise| {
        let of = |level: &LevelContrast| {
            let powers = level.own_power.iter().chain(&level.local_power);
            powers.map(|power| power * power).sum::<f64>()
        };
        noise.contrast.levels.iter().map(of).collect::<Vec<_>>()
    };
    assert!(squares(&same).into_iter().zip(squares(&clean)).all(|(now, before)| now <= before), "{:?}", same.contrast);
    let more = adjust(differences(6, 0.7), drawn.clone(), CLEAN.clone()).unwrap();
    // What is left is whitened to unit variance: the fine third gains against the rest.
    let gains = &more.log_gain;
    let (coarse, fine) = gains.split_at(BANDS - 4);
    let mean_of = |some: &[f64]| mean(some.iter().copied());
    assert!(mean_of(fine) > 0.1 && mean_of(fine) > mean_of(coarse) + 0.1, "{gains:?}");
    let raised = mean(more.members.iter().zip(&CLEAN.members).map(|(a, b)| a.log_strength[2] - b.log_strength[2]));
    assert!(raised > 0.02, "{raised}");
    let relaxed = adjust_with(&json!({"relaxation": 1.5}), differences(6, 0.7), drawn, CLEAN.clone()).unwrap();
    let added = |noise: &Noise, k: usize| noise.log_gain[k] - CLEAN.log_gain[k];
    assert!((0..BANDS).all(|k| (added(&relaxed, k) - 1.5 * added(&more, k)).abs() < 1e-12), "{:?}", relaxed.log_gain);
    assert_eq!(relaxed.members, more.members);
}

#[test]
fn what_comes_with_bends_of_surveys_is_no_noise_of_them() {
    let drawn = differences(6, 0.0);
    let wave = |i: usize| 0.5 * rockface_core::numerics::portable_math::sin(0.5 * (i % COLUMNS) as f64) as f32;
    let shape =
        without_trend(&(0..COLUMNS * ROWS).map(wave).collect::<Vec<_>>(), COLUMNS, &CLEAN.trend_weights).unwrap();
    let bend_shapes: Vec<Vec<f32>> =
        (0..7).map(|k| if k == 2 { shape.clone() } else { vec![0.0; shape.len()] }).collect();
    let mut simulated = drawn.clone();
    for (number, raster) in simulated.iter_mut().enumerate() {
        // The bend that a raster has with its noise is one that was drawn.
        let own = trend(&raster.bands[0].values, COLUMNS, &CLEAN.trend_weights).unwrap();
        let mut added = own.map(|factor| -factor);
        added[5] += 0.02 * (number as f64 - 2.0);
        raster.bands[0].values = bent(&raster.bands[0].values, COLUMNS, &added, &[]);
        let bend = std::array::from_fn(|k| own[k] + added[k]);
        let with = |(i, value): (usize, &mut f32)| *value += bends_at(&bend, &bend_shapes, i) as f32;
        raster.bands[0].values.iter_mut().enumerate().for_each(with);
    }
    let noise = Noise { bend_shapes, ..CLEAN.clone() };
    let found = adjust(simulated, drawn, noise.clone()).unwrap();
    let changes = found.log_gain.iter().zip(&noise.log_gain).map(|(a, b)| (a - b).abs());
    // With gaps a shape is not quite without a trend.
    assert!(changes.fold(0.0, f64::max) < 0.06, "{:?}", found.log_gain);
}

#[test]
fn noise_that_a_survey_makes_by_itself_does_not_run_away() {
    let drawn = differences(6, 2.0);
    let mut simulated = drawn.clone();
    for (number, raster) in simulated.iter_mut().enumerate() {
        let white = rockface_core::numerics::random::Key([number as u8; 32]).field();
        let values = raster.bands[0].values.iter_mut().enumerate();
        values
            .for_each(|(i, value)| *value += (0.004 * white.normal((i % COLUMNS) as i32, (i / COLUMNS) as i32)) as f32);
    }
    let mut noise = CLEAN.clone();
    for _ in 0..4 {
        noise = adjust_with(&json!({"relaxation": 1.9}), simulated.clone(), drawn.clone(), noise).unwrap();
        noise.encode().unwrap();
    }
    assert!((noise.log_gain[BANDS - 1] - LOG_GAINS[0]).abs() < 1e-12, "{:?}", noise.log_gain);
    let host = TestHost::default();
    run_on(&host, &json!({}), simulated, drawn, noise).unwrap();
    assert!(host.warnings().iter().any(|warning| warning.contains("by themselves")), "{:?}", host.warnings());
}

#[test]
fn where_a_survey_loses_more_the_map_of_strength_makes_up_for_it() {
    let drawn = differences(6, 0.0);
    let mut simulated = drawn.clone();
    for raster in &mut simulated {
        let values = raster.bands[0].values.iter_mut().enumerate();
        values.filter(|(i, _)| i / COLUMNS < ROWS / 3).for_each(|(_, value)| *value *= 0.8);
    }
    let found = adjust(simulated, drawn, CLEAN.clone()).unwrap();
    // Strengths of the map and of the classes together.
    let level = |noise: &Noise| mean(noise.members.iter().map(|member| mean(member.log_strength.iter().copied())));
    let classes = exp(level(&found) - level(&CLEAN));
    let raised = |rows: std::ops::Range<usize>| {
        mean((rows.start * COLUMNS..rows.end * COLUMNS).map(|i| f64::from(found.strength[i] / CLEAN.strength[i])))
            * classes
    };
    let (above, below) = (raised(0..ROWS / 4), raised(ROWS / 2..ROWS));
    assert!((above - 1.25).abs() < 0.04 && (below - 1.0).abs() < 0.04, "{above} {below}");
}

#[test]
fn gaps_that_a_survey_adds_come_off_those_of_the_model() {
    let drawn = differences(6, 0.0);
    let seen = seen(drawn.iter().map(|raster| raster.bands[0].values.as_slice()));
    let share = |rasters: &[Raster]| {
        let values: Vec<&[f32]> = rasters.iter().map(|raster| raster.bands[0].values.as_slice()).collect();
        mean(gaps(&values, &seen).into_iter().map(|[share]| share))
    };
    let mut simulated = drawn.clone();
    for raster in &mut simulated {
        // Each gap is one cell wider to the right.
        let values = &mut raster.bands[0].values;
        for i in (1..values.len()).rev().filter(|i| i % COLUMNS > 0) {
            if values[i - 1].is_nan() {
                values[i] = f32::NAN;
            }
        }
    }
    let expected = CLEAN.gap_gain * share(&drawn) / share(&simulated);
    let found = adjust(simulated.clone(), drawn.clone(), CLEAN.clone()).unwrap().gap_gain;
    // A little of what is added is left out as chance.
    assert!(expected < 0.9 * CLEAN.gap_gain && found >= expected && found < 1.1 * expected, "{found} {expected}");
    let same = adjust(drawn.clone(), drawn, CLEAN.clone()).unwrap();
    assert_eq!(same.gap_gain.to_bits(), CLEAN.gap_gain.to_bits());
}

#[test]
fn skewness_that_a_survey_loses_is_made_up_for() {
    let mut drawn = differences(6, 0.0);
    let values = drawn.iter_mut().flat_map(|raster| &mut raster.bands[0].values);
    values.filter(|value| value.is_nan()).for_each(|value| *value = 0.0);
    let lean = |raster: &Raster, skewness: f64| {
        let values = raster.bands[0].values.iter().map(|value| f64::from(*value)).collect();
        let values = with_skewness(values, COLUMNS, skewness).into_iter().map(|value| value as f32).collect();
        Raster::single(grid(), Frame::Wall, "difference", "s", values)
    };
    let skewed = |scale: f64| -> Vec<Raster> {
        drawn.iter().enumerate().map(|(i, raster)| lean(raster, scale * (i as f64 - 2.5))).collect()
    };
    let gain = |simulated: Vec<Raster>, drawn| adjust(simulated, drawn, CLEAN.clone()).unwrap().skewness_gain;
    let raised = gain(skewed(0.12), skewed(0.2)) / CLEAN.skewness_gain;
    // Planes are taken off, which moves skewness a little: a part of what is lost counts as chance.
    assert!((1.35..1.7).contains(&raised), "{raised}");
    assert_eq!(gain(skewed(0.2), skewed(0.2)).to_bits(), CLEAN.skewness_gain.to_bits());
}

#[test]
fn what_is_lost_of_details_is_made_up_for() {
    let mut contrast = Contrast::none();
    let levels = contrast.levels.len();
    for level in &mut contrast.levels {
        level.growth = std::array::from_fn(|row| std::array::from_fn(|column| if row == column { 0.2 } else { 0.0 }));
        level.deviation = [0.003; UNEVENNESS];
    }
    let first = CLASSES + BANDS;
    let mut losses = vec![Departure { difference: 0.0, error: 0.0 }; first + OF_LEVEL * levels];
    losses[first + 3].difference = -0.03;
    losses[first + UNEVENNESS + 1].difference = 0.1;
    let found = adjusted(&Noise { contrast: contrast.clone(), ..CLEAN.clone() }, &losses, 1.0).contrast;
    let grown = 0.2 * found.levels[0].local_power[0];
    assert!((grown - 0.03).abs() < 0.002 && found.levels[1..] == contrast.levels[1..], "{found:?}");
    let [x, y, diagonal] = found.levels[0].log_gain;
    assert!((-0.1..-0.05).contains(&y) && x.abs() + diagonal.abs() < 1e-12, "{found:?}");
}

#[test]
fn losses_are_those_of_a_usual_raster_and_its_directions() {
    let usual =
        LevelFigures { unevenness: [log(3.0) + 1.0, log(3.0) + 0.5, log(3.0) + 0.5, -0.7, -0.9], log_rms: [0.0; 3] };
    let level = LevelContrast { usual, ..LevelContrast::default() };
    let drawn = [log(3.0) + 2.0, log(3.0) + 0.1, log(3.0) + 1.0, -0.6, -0.8, 0.0, 0.0, 0.0];
    let mut lost = [-0.2, -0.1, -0.1, -0.03, -0.02, -0.5, -0.3, -0.1];
    to_usual(&mut lost, &drawn, &level);
    let expected = [-0.1, -0.2, -0.05, -0.03, -0.02, -0.2, 0.0, 0.2];
    assert!(lost.iter().zip(expected).all(|(lost, expected)| (lost - expected).abs() < 1e-9), "{lost:?}");
}

#[test]
fn rasters_that_are_no_pairs_too_few_or_of_another_model_are_refused() {
    let refused = |simulated: u64, drawn: u64, noise: Noise| {
        adjust(differences(simulated, 0.0), differences(drawn, 0.0), noise).unwrap_err().message
    };
    assert!(refused(3, 2, CLEAN.clone()).contains("3 simulated rasters and 2 drawn ones"));
    assert!(refused(1, 1, CLEAN.clone()).contains("1 simulated raster,"));
    let mut other = CLEAN.clone();
    other.grid.left_m += 1.0;
    assert!(refused(2, 2, other).contains("not those of `dem`"));
}
