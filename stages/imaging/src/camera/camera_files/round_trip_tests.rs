//! What a format holds comes back from it: random blocks written and read, their rays and covariance blocks compared.

use nalgebra::{UnitQuaternion, Vector3};
use proptest::prelude::*;

use super::{CameraFile, bundler, colmap_binary, colmap_text, json, metashape};
use crate::camera::model::Camera;
use crate::camera::orientation_parameters::{EXTERIOR, INTERIOR, Parameter};
use rockface_core::StageError;
use rockface_core::artefact::{Cameras, Covariance, Frame, Image, Noun, Sensor};

/// A block of two sensors and three images, from numbers between -1 and 1.
fn block(x: &[f64]) -> Cameras {
    let mut numbers = x.iter().copied().cycle();
    let mut next = || numbers.next().unwrap_or_default();
    let sensor = |name: &str, next: &mut dyn FnMut() -> f64| Sensor {
        name: name.into(),
        width_px: 1900,
        height_px: 1601,
        f: 4545.3 + 100.0 * next(),
        cx: 949.5 + 20.0 * next(),
        cy: 800.0 + 20.0 * next(),
        b1: 3.0 * next(),
        b2: 2.0 * next(),
        k: [0.1 * next(), 0.1 * next(), 0.05 * next(), 0.02 * next()],
        p: [1e-3 * next(), 1e-3 * next()],
    };
    let sensors = vec![sensor("sensor1", &mut next), sensor("c & <d>.png", &mut next)];
    let mut image = |name: &str, sensor| {
        let mut image = Image {
            name: name.into(),
            sensor,
            camera_from_object: [1.0, 0.0, 0.0, 0.0],
            centre_m: [300.0 * next(), 300.0 * next(), 300.0 * next()],
        };
        let axis = Vector3::new(next(), next(), next()) * std::f64::consts::PI;
        image.set_rotation(&UnitQuaternion::from_scaled_axis(axis));
        image
    };
    let images = vec![image("a.png", 0), image("b.png", 0), image("c & <d>.png", 1)];
    Cameras { frame: Frame::Wall, sensors, images }
}

fn numbers() -> impl Strategy<Value = Vec<f64>> {
    proptest::collection::vec(-1.0..1.0f64, 41)
}

/// What of a block COLMAP holds.
fn for_colmap(mut cameras: Cameras) -> Cameras {
    for sensor in &mut cameras.sensors {
        (sensor.b2, sensor.k[3]) = (0.0, 0.0);
    }
    cameras
}

/// What of a block Bundler holds: one sensor an image, no blanks in names.
fn for_bundler(mut cameras: Cameras) -> Cameras {
    let of_image = |image: &Image| {
        let sensor = cameras.sensor(image);
        let k = [sensor.k[0], sensor.k[1], 0.0, 0.0];
        Sensor { name: image.name.clone(), cx: 949.5, cy: 800.0, b1: 0.0, b2: 0.0, k, p: [0.0; 2], ..sensor.clone() }
    };
    cameras.sensors = cameras.images.iter().map(of_image).collect();
    for (at, (image, sensor)) in cameras.images.iter_mut().zip(&mut cameras.sensors).enumerate() {
        image.sensor = at;
        image.name = image.name.replace(' ', "_");
        sensor.name = image.name.clone();
    }
    cameras
}

/// Names and sizes are equal; pixels of the same object points agree to 1e-9 px.
fn same_rays(a: &Cameras, b: &Cameras) -> Result<(), TestCaseError> {
    let names = |c: &Cameras| {
        let sensors: Vec<_> = c.sensors.iter().map(|s| (s.name.clone(), s.width_px, s.height_px)).collect();
        (c.frame, sensors, c.images.iter().map(|i| (i.name.clone(), i.sensor)).collect::<Vec<_>>())
    };
    prop_assert_eq!(names(a), names(b));
    for (x, y) in a.images.iter().zip(&b.images) {
        let (one, two) = (Camera::new(a.sensor(x), x), Camera::new(b.sensor(y), y));
        for direction in [[0.0, 0.0], [0.15, -0.1], [-0.18, 0.12]] {
            let point = one.unproject(direction, 20.0);
            let ([u, v], [s, t]) = (one.project(&point).unwrap(), two.project(&point).unwrap());
            // Centres are 300 m away: a last digit there is 5e-14 m, 1e-11 px.
            prop_assert!((u - s).abs() < 1e-9 && (v - t).abs() < 1e-9, "{} {}", u - s, v - t);
        }
    }
    Ok(())
}

fn text(files: &[(String, Vec<u8>)], name: &str) -> String {
    let (_, bytes) = files.iter().find(|(other, _)| other == name).unwrap();
    String::from_utf8(bytes.clone()).unwrap()
}

fn check(cameras: &Cameras, read: Result<CameraFile, StageError>) -> Result<(), TestCaseError> {
    same_rays(cameras, &read.unwrap().cameras)
}

/// Blocks of 3 x 3 for rotations and centres and one for each sensor, symmetric and positive.
fn blocks(cameras: &Cameras, x: &[f64]) -> Covariance {
    let exterior = (0..cameras.images.len()).flat_map(|i| (0..EXTERIOR.len()).map(move |p| Parameter::Exterior(i, p)));
    let interior = (0..cameras.sensors.len()).flat_map(|s| (0..INTERIOR.len()).map(move |p| Parameter::Interior(s, p)));
    let all: Vec<Parameter> = exterior.chain(interior).collect();
    let owner = |p: Parameter| match p {
        Parameter::Exterior(i, place) => (i, place / 3),
        Parameter::Interior(s, _) => (s, 2),
    };
    let element = |i: usize, j: usize| match (i == j, owner(all[i]) == owner(all[j])) {
        (true, _) => 1.0 + x[i % x.len()].abs(),
        (_, true) => 0.05 * x[(i * j + 3) % x.len()],
        _ => 0.0,
    };
    let matrix = (0..all.len()).map(|i| (0..all.len()).map(|j| element(i, j)).collect()).collect();
    let parameters = all.iter().map(|p| p.name(cameras)).collect();
    Covariance { frame: cameras.frame, parameters, matrix, sigma0_applied: true, full_joint: false }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn colmap_text(x in numbers()) {
        let mut cameras = for_colmap(block(&x));
        cameras.images.iter_mut().for_each(|image| image.name = image.name.replace(' ', "_"));
        cameras.sensors.iter_mut().for_each(|sensor| sensor.name = sensor.name.replace(' ', "_"));
        let files = colmap_text::write(&cameras).unwrap();
        check(&cameras, colmap_text::read(&text(&files, "cameras.txt"), &text(&files, "images.txt"), Frame::Wall))?;
    }

    #[test]
    fn colmap_binary(x in numbers()) {
        let cameras = for_colmap(block(&x));
        let files = colmap_binary::write(&cameras).unwrap();
        check(&cameras, colmap_binary::read(&files[0].1, &files[1].1, Frame::Wall))?;
    }

    #[test]
    fn metashape_with_its_blocks(x in numbers()) {
        let cameras = block(&x);
        let covariance = blocks(&cameras, &x);
        let xml = metashape::write(&cameras, Some(&covariance)).unwrap();
        let mut file = metashape::read(std::str::from_utf8(&xml).unwrap(), Frame::Wall).unwrap();
        // Sensors come back under the numbers of the file.
        prop_assert_eq!(file.cameras.sensors[0].name.as_str(), "sensor0");
        file.cameras.sensors[0].name = "sensor1".into();
        same_rays(&cameras, &file.cameras)?;
        let found = file.covariance.unwrap();
        prop_assert!(!found.full_joint);
        let places: Vec<usize> = covariance.parameters.iter().map(|name| {
            let name = name.replace("sensor1.", "sensor0.");
            found.parameters.iter().position(|other| *other == name).unwrap()
        }).collect();
        for (i, row) in covariance.matrix.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                prop_assert!((found.matrix[places[i]][places[j]] - value).abs() < 1e-15);
            }
        }
    }

    #[test]
    fn bundler_out(x in numbers()) {
        let cameras = for_bundler(block(&x));
        let files = bundler::write(&cameras).unwrap();
        let (bundle, list) = (text(&files, "bundle.out"), text(&files, "list.txt"));
        check(&cameras, bundler::read(&bundle, Some(&list), [1900, 1601], Frame::Wall))?;
    }

    #[test]
    fn our_json_keeps_every_bit(x in numbers()) {
        let cameras = block(&x);
        prop_assert_eq!(json::read(&cameras.encode().unwrap(), Frame::World).unwrap().cameras, cameras);
    }
}

#[test]
fn what_a_format_lacks_is_named() {
    let full = block(&[0.5; 41]);
    let says = |written: Result<Vec<(String, Vec<u8>)>, StageError>, expected: &str| {
        let message = written.unwrap_err().message;
        assert!(message.contains(expected), "{message}");
    };
    says(colmap_text::write(&full), "sensor `sensor1`: b2 = 1 does not fit a COLMAP model");
    let mut straight = full.clone();
    straight.sensors.iter_mut().for_each(|sensor| sensor.b2 = 0.0);
    says(colmap_binary::write(&straight), "k4 = 0.01");
    says(bundler::write(&straight), "px from the middle");
    let mut names = for_colmap(full);
    names.images[0].name = "a b".into();
    says(colmap_text::write(&names), "ends a name of its text model at a blank");
    names.images[0].name = "a\0b".into();
    says(colmap_binary::write(&names), "zero byte");
    assert!(metashape::write(&names, None).unwrap_err().message.contains("XML cannot hold"));
}
