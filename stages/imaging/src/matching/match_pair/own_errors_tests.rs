//! Errors of the user's own at port `errors`.

use super::tests::{convergent, pairs, scene};
use super::*;
use rockface_core::artefact::{Artefact, Noun};
use rockface_core::testing::{TestHost, height_mesh, run_stage, small_sensor};
use serde_json::{Value, json};

/// An error that no two pixels share.
fn error_px(row: usize, column: usize) -> f32 {
    0.01 * row as f32 - 0.003 * column as f32
}

fn run(with: &Value, change: impl Fn(&mut Depth)) -> Result<(Depth, Depth), StageError> {
    let mesh = height_mesh(60, [-12.0, 12.0, -12.0, 12.0], |x, y| 0.05 * x * y + 0.3 * x);
    let scene = scene(convergent(small_sensor()), &mesh, 1);
    let ideal = scene.depths[0].clone();
    let mut errors = ideal.clone();
    let values = (0..ideal.z.len()).map(|pixel| error_px(pixel / ideal.width, pixel % ideal.width));
    errors.channels.insert("error_px".into(), values.collect());
    change(&mut errors);
    let inputs = [
        ("first", Artefact::Depth(scene.depths[0].clone())),
        ("second", Artefact::Depth(scene.depths[1].clone())),
        ("noisy", Artefact::Cameras(scene.noisy.clone())),
        ("pairs", Artefact::Pairs(pairs())),
        ("errors", Artefact::Depth(errors)),
    ];
    let outputs = run_stage::<MatchPair>(&TestHost::default(), with, &inputs)?.into_inner();
    Ok((Depth::of(&outputs["depth"]).unwrap().clone(), ideal))
}

#[test]
fn every_disparity_has_the_error_of_its_pixel() {
    let paper = json!({"sigma_local_px": 0.1, "sigma_regular_px": 0.2, "spacing_px": 20, "channels": true});
    let mut terms = paper.clone();
    terms["matcher"] = json!({});
    for with in &[paper, terms] {
        let (map, ideal) = run(with, |_| {}).unwrap();
        let mut seen = 0;
        for pixel in (0..map.z.len()).filter(|pixel| !map.z[*pixel].is_nan()) {
            let others = ["disparity.ideal", "noise.local", "noise.regular", "noise.blunder", "noise.sub_pixel"];
            let others = others.iter().filter_map(|name| map.channels.get(*name));
            let added = map.channels["disparity"][pixel] - others.map(|channel| channel[pixel]).sum::<f32>();
            let wanted = error_px(pixel / ideal.width, pixel % ideal.width);
            assert!((added - wanted).abs() < 1e-3, "{added} instead of {wanted}");
            seen += 1;
        }
        assert!(seen > 1000, "{seen}");
    }
}

#[test]
fn pairs_have_errors_of_their_own_and_a_missing_one_is_a_hole() {
    let with = json!({"sigma_local_px": 0, "sigma_regular_px": 0, "channels": true});
    let (map, _) = run(&with, |errors| {
        let mut own = vec![0.25; errors.z.len()];
        own[..errors.width * 20].fill(f32::NAN);
        errors.channels.insert("error_px.left+right".into(), own);
    })
    .unwrap();
    let width = map.width;
    assert!(map.z[..width * 20].iter().all(|z| z.is_nan()), "no match where there is no error");
    let added = |pixel: usize| map.channels["disparity"][pixel] - map.channels["disparity.ideal"][pixel];
    let pixels: Vec<usize> = (width * 20..map.z.len()).filter(|pixel| !map.z[*pixel].is_nan()).collect();
    assert!(pixels.len() > 1000 && pixels.iter().all(|pixel| (added(*pixel) - 0.25).abs() < 1e-4));
}

#[test]
fn errors_of_something_else_are_refused() {
    let plain = json!({});
    let said = |with: &Value, change: &dyn Fn(&mut Depth)| run(with, change).unwrap_err().message;
    let other = said(&plain, &|errors| errors.image.name = "third".into());
    assert!(other.contains("image `third`") && other.contains("`left`"), "{other}");
    let size = said(&plain, &|errors| errors.height -= 1);
    assert!(size.contains("`errors` has"), "{size}");
    let none = said(&plain, &|errors| errors.channels.clear());
    assert!(none.contains("neither channel `error_px`"), "{none}");
    let rectified = said(&json!({"sampling": "rectified"}), &|_| {});
    assert!(rectified.contains("rectified"), "{rectified}");
}
