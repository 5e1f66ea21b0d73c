//! Tests of `perturb-cameras`: joint draws keep rays together, names address draws, bad input is refused.

use super::*;
use crate::camera::camera_files::json as json_file;
use crate::camera::covariance_files;
use crate::camera::model::Camera;
use nalgebra::{Matrix3, Vector3};
use rockface_core::artefact::{Artefact, Frame};
use rockface_core::params::ParamType;
use rockface_core::testing::{TestHost, run_stage, shared};
use serde_json::{Value, json};
use std::sync::Arc;

fn pair() -> Cameras {
    let sensor =
        |id: u64| json!({"id": id, "width": 1900, "height": 1600, "f": 4550, "cx": 950, "cy": 800, "k1": -0.08});
    let image =
        |name: &str, id: u64, x: f64| json!({"name": name, "sensor": id, "q_wxyz": [0, 1, 0, 0], "C": [x, 0, 20]});
    let file = json!({"sensors": [sensor(0), sensor(1)], "images": [image("a", 0, -3.0), image("b", 1, 3.0)]});
    json_file::read(file.to_string().as_bytes(), Frame::Wall).unwrap().cameras
}

fn covariance(names: &[&str]) -> Covariance {
    let n = names.len();
    let row = |i: usize| (0..n).map(|j| if i == j { 1e-6 } else { 2e-7 }).collect();
    Covariance {
        frame: Frame::Wall,
        parameters: names.iter().map(ToString::to_string).collect(),
        matrix: (0..n).map(row).collect(),
        sigma0_applied: true,
        full_joint: true,
    }
}

fn perturb(
    host: &TestHost,
    cameras: &Cameras,
    covariance: Option<&Covariance>,
    with: &Value,
) -> Result<Cameras, StageError> {
    let mut inputs = Inputs::default();
    inputs.push("cameras", rockface_core::Point::new(), Arc::new(cameras.clone().into()));
    if let Some(covariance) = covariance {
        inputs.push("covariance", rockface_core::Point::new(), Arc::new(covariance.clone().into()));
    }
    let params = PerturbCamerasParams::decode(with).unwrap();
    match PerturbCameras::run(&params, &inputs, &Context::new(host))?.into_inner().remove("cameras") {
        Some(Artefact::Cameras(cameras)) => Ok(cameras),
        other => panic!("{other:?}"),
    }
}

/// Ordinate (px) of a pixel on the plane parallel to the baseline that is least inclined to both images.
fn rectified_y(rectify: &Matrix3<f64>, camera: &Camera, pixel: [f64; 2]) -> f64 {
    let [x, y] = camera.normalised(pixel).unwrap();
    let ray = rectify * camera.camera_from_object().transpose() * Vector3::new(x, y, 1.0);
    4550.0 * ray.y / ray.z
}

/// Y-parallax (px) of true pixels under the estimated orientation, for every point both images hold.
fn parallaxes(truth: &Cameras, noisy: &Cameras, points: &[Vector3<f64>]) -> Vec<f64> {
    let cameras = |block: &Cameras| [0, 1].map(|i| Camera::new(&block.sensors[i], &block.images[i]));
    let (truth, [a, b]) = (cameras(truth), cameras(noisy));
    let x = (b.centre() - a.centre()).normalize();
    let sum = noisy.images[0].axis() + noisy.images[1].axis();
    let z = (sum - x * sum.dot(&x)).normalize();
    let rectify = Matrix3::from_rows(&[x.transpose(), z.cross(&x).transpose(), z.transpose()]);
    let parallax = |point: &Vector3<f64>| {
        let (p, q) = (truth[0].project(point)?, truth[1].project(point)?);
        Some(rectified_y(&rectify, &a, p) - rectified_y(&rectify, &b, q))
    };
    points.iter().filter_map(parallax).collect()
}

fn rms_parallax(truth: &Cameras, covariance: &Covariance, points: &[Vector3<f64>]) -> f64 {
    let draw =
        |seed| perturb(&TestHost::seeded(seed), truth, Some(covariance), &json!({"allow_blocks": true})).unwrap();
    let all: Vec<f64> = (0..40).flat_map(|seed| parallaxes(truth, &draw(seed), points)).collect();
    (all.iter().map(|dy| dy * dy).sum::<f64>() / all.len() as f64).sqrt()
}

#[test]
fn joint_draws_keep_rays_together_and_diagonal_ones_do_not() {
    let file = |name: &str| shared(&format!("outcrop-survey/{name}"));
    let (Some(cameras), Some(bba), Some(points)) =
        (file("cameras.json"), file("bba_covariance.json"), file("colmap/points3D.txt"))
    else {
        return;
    };
    let truth = json_file::read(&cameras, Frame::Wall).unwrap().cameras;
    let (joint, _) = covariance_files::read(&bba, &truth).unwrap();
    let points: Vec<Vector3<f64>> = String::from_utf8(points)
        .unwrap()
        .lines()
        .filter(|line| !line.starts_with('#'))
        .map(|line| line.split(' ').skip(1).take(3).map(|word| word.parse().unwrap()).collect::<Vec<f64>>())
        .map(|p| Vector3::new(p[0], p[1], p[2]))
        .collect();
    let mut diagonal = joint.clone();
    for (i, row) in diagonal.matrix.iter_mut().enumerate() {
        row.iter_mut().enumerate().filter(|(j, _)| *j != i).for_each(|(_, value)| *value = 0.0);
    }
    let (together, apart) = (rms_parallax(&truth, &joint, &points), rms_parallax(&truth, &diagonal, &points));
    println!("y-parallax: joint {together:.4} px, diagonal {apart:.2} px");
    assert!((0.03..0.12).contains(&together), "{together} px");
    assert!(apart > 5.0, "{apart} px");
}

#[test]
fn a_name_addresses_its_draw_whatever_else_there_is() {
    let with = json!({"model": "independent", "independent": {"position_m": [0.01, 0.01, 0.02], "focal_px": 1}});
    let full = perturb(&TestHost::default(), &pair(), None, &with).unwrap();
    let mut swapped = pair();
    swapped.images.reverse();
    let turned = perturb(&TestHost::default(), &swapped, None, &with).unwrap();
    let mut alone = pair();
    alone.images.remove(0);
    let single = perturb(&TestHost::default(), &alone, None, &with).unwrap();
    assert_eq!(full.images[1], turned.images[0]);
    assert_eq!(full.images[1], single.images[0]);
    assert_eq!(full.sensors, turned.sensors);
    assert_ne!(full.images[1], pair().images[1]);
    let ordered =
        perturb(&TestHost::default(), &pair(), Some(&covariance(&["a.X", "b.Y", "a.f"])), &json!({})).unwrap();
    let other = perturb(&TestHost::default(), &pair(), Some(&covariance(&["a.f", "a.X", "b.Y"])), &json!({})).unwrap();
    let apart = |i: usize| (ordered.images[i].centre() - other.images[i].centre()).norm();
    assert!(apart(0) < 1e-15 && apart(1) < 1e-15, "{} {}", apart(0), apart(1));
    assert!(ordered.images[0].centre_m[0] != pair().images[0].centre_m[0]);
}

#[test]
fn scale_and_switches_act_on_the_draws() {
    let joint = covariance(&["a.X", "b.Y", "a.f"]);
    let errors = |with: Value| {
        let noisy = perturb(&TestHost::default(), &pair(), Some(&joint), &with).unwrap();
        let moved = |i: usize, k: usize| noisy.images[i].centre_m[k] - pair().images[i].centre_m[k];
        [moved(0, 0), moved(1, 1), noisy.sensors[0].f - 4550.0]
    };
    let (once, twice) = (errors(json!({})), errors(json!({"scale": 2})));
    assert!(once.iter().zip(&twice).all(|(a, b)| (2.0 * a - b).abs() < 1e-11 && *a != 0.0));
    let exterior = errors(json!({"interior": false}));
    assert_eq!((exterior[0], exterior[1], exterior[2]), (once[0], once[1], 0.0));
    assert_eq!(errors(json!({"scale": 0})), [0.0; 3]);
    let shifted = errors(json!({"model": "none", "shift": {"position_m": [0.5, 0, 0], "focal_px": -3}}));
    assert_eq!(shifted, [0.5, 0.0, -3.0]);
}

#[test]
fn only_what_draws_needs_a_seed() {
    let draws = |with: Value| PerturbCameras::draws(&PerturbCamerasParams::decode(&with).unwrap());
    assert!(draws(json!({})));
    assert!(!draws(json!({"scale": 0})));
    assert!(!draws(json!({"model": "none", "shift": {"focal_px": 1}})));
    assert!(!draws(json!({"model": "independent"})));
    assert!(draws(json!({"model": "independent", "independent": {"k": [1e-4, 0, 0, 0]}})));
    assert!(!draws(json!({"exterior": false, "interior": false})));
}

#[test]
fn what_moves_nothing_draws_nothing() {
    let rule = json!([{"of": ["f"], "error": {"normal": {"mean": 5, "sd": 1}}}]);
    let still = [
        json!({"scale": 0}),
        json!({"exterior": false, "interior": false}),
        json!({"model": "independent", "scale": 0, "independent": {"focal_px": 2}}),
        json!({"model": "independent", "scale": 0, "errors": rule}),
        json!({"model": "independent", "exterior": false, "interior": false, "errors": rule}),
    ];
    for with in still {
        let inputs = [("cameras", pair().into()), ("covariance", covariance(&["a.X"]).into())];
        let made = run_stage::<PerturbCameras>(&TestHost::default(), &with, &inputs).unwrap();
        let Some(Artefact::Cameras(cameras)) = made.into_inner().remove("cameras") else { panic!("no cameras") };
        assert_eq!(cameras, pair(), "{with}");
    }
}

#[test]
fn bad_input_is_refused() {
    let host = TestHost::default();
    let says = |covariance: Option<Covariance>, text: &str| {
        let message = perturb(&host, &pair(), covariance.as_ref(), &json!({})).unwrap_err().message;
        assert!(message.contains(text), "{message}");
    };
    says(None, "needs a covariance");
    says(Some(covariance(&[])), "needs a covariance");
    says(Some(Covariance { frame: Frame::World, ..covariance(&["a.X"]) }), "world frame");
    says(Some(covariance(&["c.X"])), "`c.X`");
    let mut indefinite = covariance(&["a.X", "b.X"]);
    (indefinite.matrix[0][1], indefinite.matrix[1][0]) = (2e-6, 2e-6);
    says(Some(indefinite), "positive semi-definite");
    // The covariance of the blocks of single images, as Metashape exports it.
    let mut blocks = covariance(&["a.X", "b.X"]);
    (blocks.matrix[0][1], blocks.matrix[1][0]) = (0.0, 0.0);
    says(Some(blocks.clone()), "between different images are zero");
    says(Some(Covariance { full_joint: false, ..covariance(&["a.X", "b.X"]) }), "not a full joint");
    assert!(perturb(&host, &pair(), Some(&blocks), &json!({"allow_blocks": true})).is_ok());
    let faults = |with: Value| PerturbCameras::check(&PerturbCamerasParams::decode(&with).unwrap());
    assert_eq!(faults(json!({"independent": {"focal_px": 1}})).len(), 1);
    assert_eq!(faults(json!({"model": "independent", "independent": {"focal_px": -1}})).len(), 1);
}

#[test]
fn errors_of_any_distribution_go_to_the_images_and_sensors_they_name() {
    let errors = |seed: u64, rules: Value| {
        let with = json!({"model": "independent", "independent": {"position_m": [0.01, 0, 0], "affinity_px": [0, 0.3]}, "errors": rules});
        perturb(&TestHost::seeded(seed), &pair(), None, &with).unwrap()
    };
    let uniform = json!({"of": ["X", "Y"], "at": ["a"], "error": {"uniform": {"min": 0.02, "max": 0.03}}});
    let fixed = json!({"of": ["b1", "k4"], "error": 0.25});
    let turned = json!({"of": ["rz"], "at": ["b"], "error": 1.0});
    let rules = json!([uniform, fixed, turned]);
    for seed in 0..20 {
        let noisy = errors(seed, rules.clone());
        let moved = |i: usize, k: usize| noisy.images[i].centre_m[k] - pair().images[i].centre_m[k];
        assert!((0.02..0.03).contains(&moved(0, 0)) && (0.02..0.03).contains(&moved(0, 1)), "{noisy:?}");
        assert!(moved(1, 1) == 0.0 && moved(1, 0) != 0.0 && moved(1, 0).abs() < 0.06);
        for (sensor, before) in noisy.sensors.iter().zip(pair().sensors) {
            assert_eq!((sensor.b1, sensor.k[3]), (0.25, 0.25));
            assert!(sensor.b2 != before.b2 && sensor.b2.abs() < 1.8);
        }
        let turn = noisy.images[1].matrix() * pair().images[1].matrix().transpose();
        assert!((nalgebra::Rotation3::from_matrix_unchecked(turn).angle().to_degrees() - 1.0).abs() < 1e-9);
        assert_eq!(noisy.images[0].camera_from_object, pair().images[0].camera_from_object);
    }
    // The last rule for a parameter counts.
    let last = errors(1, json!([uniform, {"of": ["X"], "error": 0.5}]));
    assert_eq!(
        last.images.iter().zip(pair().images).map(|(a, b)| a.centre_m[0] - b.centre_m[0]).collect::<Vec<_>>(),
        [0.5, 0.5]
    );
    let unknown = json!({"model": "independent", "errors": [{"of": ["X"], "at": ["c"], "error": 1}]});
    let error = perturb(&TestHost::default(), &pair(), None, &unknown).unwrap_err();
    assert!(error.message.contains("image `c`") && error.hint.unwrap().contains("a, b"));
    let paths = |with: Value| {
        let faults = PerturbCameras::check(&PerturbCamerasParams::decode(&with).unwrap());
        faults.iter().map(|fault| fault.path.join(".")).collect::<Vec<_>>()
    };
    assert_eq!(paths(json!({"model": "independent", "errors": [{"of": ["X", "k9"], "error": 1}]})), ["errors.0.of.1"]);
    assert_eq!(
        paths(json!({"model": "independent", "errors": [{"of": ["X", "f"], "at": ["a"], "error": 1}]})),
        ["errors.0.at"]
    );
    assert_eq!(paths(json!({"errors": [{"of": ["X"], "error": 1}]})), ["errors"]);
}
