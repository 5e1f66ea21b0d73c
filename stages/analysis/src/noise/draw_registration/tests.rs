//! Trends have the distribution of the members', and their place on the face.

use serde_json::json;

use super::*;
use crate::noise::learn_noise::tests::{CLEAN, COLUMNS, ROWS, grid};
use rockface_core::artefact::{Artefact, Band, Frame, Noun};
use rockface_core::testing::{TestHost, run_stage};

/// A model whose trends have a mean and a spread, and the trends.
fn model() -> (Noise, Vec<Trend>) {
    let mut noise = Noise { asymmetry_gain: [0.0; 3], bend_shapes: Vec::new(), ..CLEAN.clone() };
    for (number, member) in noise.members.iter_mut().enumerate() {
        let sign = if number % 2 == 0 { 1.0 } else { -1.0 };
        member.trend_m = [2.0, 3.0, -1.0, 2.0, 1.0, 2.0, -2.0, 1.0, 3.0, 1.0].map(|m| 0.001 * sign * m);
        member.trend_m[0] += 0.002;
        member.trend_m[3] += 0.001;
    }
    let trends = noise.members.iter().map(|member| member.trend_m).collect();
    (noise, trends)
}

fn settled(seed: u64, raster: &Raster) -> Result<Raster, StageError> {
    settled_by(model().0, seed, raster)
}

fn settled_by(noise: Noise, seed: u64, raster: &Raster) -> Result<Raster, StageError> {
    let inputs = [("raster", raster.clone().into()), ("noise", Artefact::Noise(noise))];
    let outputs = run_stage::<DrawRegistration>(&TestHost::seeded(seed), &json!({}), &inputs)?.into_inner();
    Ok(Raster::of(&outputs["raster"]).unwrap().clone())
}

fn tilted() -> Raster {
    let value = |i: usize| if i % 11 == 3 { f32::NAN } else { 0.02 - 0.001 * (i % COLUMNS) as f32 };
    with_values(&(0..COLUMNS * ROWS).map(value).collect::<Vec<_>>())
}

#[test]
fn the_trend_of_a_difference_becomes_one_like_those_of_the_members() {
    let trends = model().1;
    let drawn: Vec<Trend> =
        (0..400).map(|seed| trend(&settled(seed, &tilted()).unwrap().bands[0].values, COLUMNS, &[]).unwrap()).collect();
    let moments = |trends: &[Trend], k: usize| {
        let mean = trends.iter().map(|trend| trend[k]).sum::<f64>() / trends.len() as f64;
        let variance = trends.iter().map(|trend| (trend[k] - mean) * (trend[k] - mean)).sum::<f64>();
        (mean, (variance / trends.len() as f64).sqrt())
    };
    let wider = of_another(trends.len()).sqrt();
    for k in 0..10 {
        let ((mean, deviation), (wanted, spread)) = (moments(&drawn, k), moments(&trends, k));
        let spread = wider * spread;
        assert!((mean - wanted).abs() < 0.15 * spread, "{k}: {mean} {wanted}");
        assert!((0.9..1.1).contains(&(deviation / spread)), "{k}: {deviation} {spread}");
    }
    let copies = drawn.iter().filter(|drawn| trends.iter().any(|trend| (trend[0] - drawn[0]).abs() < 1e-7)).count();
    assert!(copies < 20, "{copies}");
}

#[test]
fn replicates_take_the_trends_of_all_rasters_in_turn() {
    let (mut noise, mut trends) = model();
    noise.jitter = 0.0;
    for (number, member) in noise.members.iter_mut().enumerate() {
        member.trend_m[0] = 0.001 * number as f64;
        trends[number] = member.trend_m;
    }
    let count = trends.len() as u32;
    // One more raster differs more from their mean than they do.
    let (mean, wider) = (0.0005 * f64::from(count - 1), of_another(trends.len()).sqrt());
    trends.iter_mut().for_each(|trend| trend[0] = mean + wider * (trend[0] - mean));
    let offset_m = |replicate: u32| {
        let inputs = [("raster", tilted().into()), ("noise", Artefact::Noise(noise.clone()))];
        let with = json!({"replicate": replicate});
        let outputs = run_stage::<DrawRegistration>(&TestHost::seeded(1), &with, &inputs).unwrap().into_inner();
        trend(&Raster::of(&outputs["raster"]).unwrap().bands[0].values, COLUMNS, &[]).unwrap()[0]
    };
    let mut found: Vec<f64> = (0..count).map(offset_m).collect();
    assert!((offset_m(count) - found[0]).abs() < 1e-9);
    // Each takes that of the raster whose strengths its first survey has.
    let [first, _] = &noise.orders;
    assert!(first.iter().zip(&found).all(|(member, found)| (found - trends[*member][0]).abs() < 1e-7), "{found:?}");
    found.sort_by(f64::total_cmp);
    assert!(found.iter().zip(&trends).all(|(found, trend)| (found - trend[0]).abs() < 1e-7), "{found:?}");
}

#[test]
fn gaps_and_details_stay_and_a_part_of_the_face_has_its_part_of_the_trend() {
    let whole = settled(1, &tilted()).unwrap();
    let gaps = |raster: &Raster| raster.bands[0].values.iter().map(|z| z.is_nan()).collect::<Vec<_>>();
    assert_eq!(gaps(&whole), gaps(&tilted()));
    // The right half of the columns.
    let half = COLUMNS / 2;
    let part = |raster: &Raster| {
        let values = raster.bands[0].values.chunks(COLUMNS).flat_map(|row| row[half..].to_vec()).collect();
        let grid = Grid { columns: half, left_m: 0.0, ..grid() };
        Raster { grid, bands: vec![Band { values, ..raster.bands[0].clone() }], ..raster.clone() }
    };
    let (found, wanted) = (settled(1, &part(&tilted())).unwrap(), part(&whole));
    for (found, wanted) in found.bands[0].values.iter().zip(&wanted.bands[0].values).filter(|(z, _)| !z.is_nan()) {
        assert!((found - wanted).abs() < 1e-7, "{found} {wanted}");
    }
}

#[test]
fn what_comes_with_a_bend_on_this_face_is_added_where_it_belongs() {
    let mut noise = model().0;
    let without = settled_by(noise.clone(), 1, &tilted()).unwrap();
    let shape: Vec<f32> = (0..COLUMNS * ROWS).map(|i| (i % 7) as f32).collect();
    noise.bend_shapes = (0..7).map(|k| if k == 1 { shape.clone() } else { vec![0.0; shape.len()] }).collect();
    let bend_m = trend(&without.bands[0].values, COLUMNS, &[]).unwrap()[4];
    // A part of the face, which begins three columns and two rows further on.
    let part = |raster: &Raster| {
        let values = raster.bands[0].values.chunks(COLUMNS).skip(2).flat_map(|row| row[3..].to_vec()).collect();
        let Grid { columns, rows, cell_m, left_m, top_m } = raster.grid;
        let (left_m, top_m) = (left_m + 3.0 * cell_m, top_m - 2.0 * cell_m);
        let grid = Grid { columns: columns - 3, rows: rows - 2, cell_m, left_m, top_m };
        Raster { grid, bands: vec![Band { values, ..raster.bands[0].clone() }], ..raster.clone() }
    };
    for of in [&part as &dyn Fn(&Raster) -> Raster, &Raster::clone] {
        let found = settled_by(noise.clone(), 1, &of(&tilted())).unwrap().bands.remove(0).values;
        let (without, shape) = (of(&without).bands.remove(0).values, of(&with_values(&shape)).bands.remove(0).values);
        let missed = found.iter().zip(&without).zip(&shape).filter(|((found, _), _)| !found.is_nan());
        let missed =
            missed.map(|((found, without), shape)| (f64::from(found - without) - bend_m * f64::from(*shape)).abs());
        assert!(missed.fold(0.0, f64::max) < 1e-6);
    }
}

fn with_values(values: &[f32]) -> Raster {
    Raster::single(grid(), Frame::Wall, "difference", "change", values.to_vec())
}

#[test]
fn noise_that_is_stronger_on_one_side_leaves_an_offset() {
    let mut raster = tilted();
    raster.bands[0].values.iter_mut().skip(5).step_by(10).for_each(|z| *z += 0.01);
    let mut noise = model().0;
    noise.members.iter_mut().for_each(|member| member.trend_m[3..].fill(0.0));
    let (with_m, wanted_m, asymmetry_m) = with_and_without_gain(&noise, &raster);
    assert!((asymmetry_m - 0.001).abs() < 0.0002, "{asymmetry_m}");
    assert!(with_m.iter().zip(wanted_m).all(|(with, wanted)| (with - wanted).abs() < 1e-6), "{with_m:?} {wanted_m:?}");
}

/// The trend of a difference with a gain of the offset, what it should be by that without one, and the asymmetry that it has.
fn with_and_without_gain(noise: &Noise, raster: &Raster) -> (Trend, Trend, f64) {
    let gain = 1.5;
    let left = |gain: f64| {
        let noise = Noise { asymmetry_gain: [gain, 0.0, 0.0], ..noise.clone() };
        settled_by(noise, 1, raster).unwrap().bands.remove(0).values
    };
    let (with, without) = (left(gain), left(0.0));
    let mut wanted_m = trend(&without, COLUMNS, &noise.trend_weights).unwrap();
    let asymmetry_m = asymmetry(&without, COLUMNS, &wanted_m).unwrap()[0];
    wanted_m[0] += gain * asymmetry_m;
    (trend(&with, COLUMNS, &noise.trend_weights).unwrap(), wanted_m, asymmetry_m)
}

#[test]
fn a_surface_that_is_bent_more_has_more_of_an_offset() {
    let bent = |bend_m: f64| {
        let mut noise = model().0;
        noise.members.iter_mut().for_each(|member| {
            member.trend_m[3..].fill(0.0);
            member.trend_m[3] = bend_m;
        });
        with_and_without_gain(&noise, &tilted())
    };
    let ((with_m, wanted_m, asymmetry_m), (.., flat_m)) = (bent(0.02), bent(0.0));
    // A trough agrees with its floor: two thirds of the face lie below the mean.
    assert!(asymmetry_m > 0.001 && flat_m.abs() < 1e-6, "{asymmetry_m} {flat_m}");
    assert!(with_m.iter().zip(wanted_m).all(|(with, wanted)| (with - wanted).abs() < 1e-6), "{with_m:?} {wanted_m:?}");
}

#[test]
fn differences_without_an_area_and_of_another_frame_are_refused() {
    let mut line = tilted();
    line.bands[0].values.iter_mut().skip(COLUMNS).for_each(|z| *z = f32::NAN);
    assert!(settled(1, &line).unwrap_err().message.contains("lie on a line"));
    let world = Raster { frame: Frame::World, ..tilted() };
    assert!(settled(1, &world).unwrap_err().message.contains("the world frame"));
}
