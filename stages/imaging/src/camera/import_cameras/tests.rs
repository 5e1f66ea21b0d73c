//! Tests of `import-cameras`: one block from every format, covariances, and what cannot be read.

use super::*;
use crate::camera::camera_files::{bundler, colmap_binary, metashape};
use crate::camera::model::Camera;
use nalgebra::Vector3;
use rockface_core::artefact::Artefact;
use rockface_core::params::ParamType;
use rockface_core::testing::{TestHost, shared};
use serde_json::{Value, json};

fn outcrop() -> Option<TestHost> {
    let file = |name: &str| shared(&format!("outcrop-survey/{name}"));
    let (cameras, covariance) = (file("cameras.json")?, file("bba_covariance.json")?);
    let model = ["cameras.txt", "images.txt", "points3D.txt"].map(|name| (name, file(&format!("colmap/{name}"))));
    let [Some(a), Some(b), Some(c)] = model.clone().map(|(_, bytes)| bytes) else { return None };
    Some(
        TestHost::default()
            .with("cameras.json", &[("cameras.json", &cameras)])
            .with("bba.json", &[("bba.json", &covariance)])
            .with("colmap", &[("cameras.txt", &a), ("images.txt", &b), ("points3D.txt", &c)]),
    )
}

fn import(host: &TestHost, with: &Value) -> Result<(Cameras, Covariance), StageError> {
    let params = ImportCamerasParams::decode(with).unwrap();
    let made = ImportCameras::run(&params, &Inputs::default(), &Context::new(host))?.into_inner();
    match (&made["cameras"], &made["covariance"]) {
        (Artefact::Cameras(cameras), Artefact::Covariance(covariance)) => Ok((cameras.clone(), covariance.clone())),
        other => panic!("{other:?}"),
    }
}

#[test]
fn json_and_colmap_of_the_outcrop_are_one_block() {
    let Some(host) = outcrop() else { return };
    let (a, nothing) = import(&host, &json!({"path": "cameras.json", "frame": "wall"})).unwrap();
    let (b, full) = import(&host, &json!({"path": "colmap", "covariance": "bba.json", "frame": "wall"})).unwrap();
    assert!(nothing.parameters.is_empty());
    assert_eq!((full.parameters.len(), full.parameters[0].as_str()), (26, "cam1.png.rx"));
    assert!(full.full_joint && host.warnings().is_empty());
    for (x, y) in a.sensors.iter().zip(&b.sensors) {
        let same = [x.f - y.f, x.cx - y.cx, x.cy - y.cy, x.k[0] - y.k[0], x.k[1] - y.k[1], x.p[0] - y.p[0]];
        assert!(same.iter().all(|d| d.abs() < 1e-9), "{same:?}");
        assert_eq!(format!("{}.png", x.name), y.name);
    }
    for (x, y) in a.images.iter().zip(&b.images) {
        assert!((x.centre() - y.centre()).norm() < 1e-9);
        assert!((x.matrix() - y.matrix()).norm() < 1e-9);
    }
}

#[test]
fn the_points_of_the_model_fall_on_their_observations() {
    let Some(host) = outcrop() else { return };
    let (block, _) = import(&host, &json!({"path": "colmap"})).unwrap();
    let read = |i: usize| String::from_utf8(host.files["colmap"][i].1.clone()).unwrap();
    let numbers = |line: &str| line.split(' ').filter_map(|w| w.parse::<f64>().ok()).collect::<Vec<_>>();
    let lines = |text: String| text.lines().filter(|l| !l.starts_with('#')).map(str::to_owned).collect::<Vec<_>>();
    let points: Vec<Vec<f64>> = lines(read(2)).iter().map(|line| numbers(line)).collect();
    let observed: Vec<Vec<f64>> = lines(read(1)).iter().skip(1).step_by(2).map(|line| numbers(line)).collect();
    for (image, line) in block.images.iter().zip(&observed) {
        let camera = Camera::new(block.sensor(image), image);
        let residual = |seen: &[f64]| {
            let point = &points[seen[2] as usize - 1];
            let [u, v] = camera.project(&Vector3::new(point[1], point[2], point[3])).unwrap();
            [seen[0] - 0.5 - u, seen[1] - 0.5 - v]
        };
        let residuals: Vec<[f64; 2]> = line.chunks(3).map(residual).collect();
        let n = residuals.len() as f64;
        // The observations carry the 0.4 px of the tie points: standard error 0.02 px of their mean.
        for axis in 0..2 {
            let mean = residuals.iter().map(|r| r[axis]).sum::<f64>() / n;
            let rms = (residuals.iter().map(|r| r[axis] * r[axis]).sum::<f64>() / n).sqrt();
            println!("{} axis {axis}: mean {mean:.4}, rms {rms:.4} px of {n} observations", image.name);
            assert!(mean.abs() < 0.08 && (0.34..0.46).contains(&rms), "mean {mean}, rms {rms} px");
        }
    }
}

#[test]
fn blocks_alone_are_warned_of() {
    let Some(host) = outcrop() else { return };
    let mut json: Value = serde_json::from_slice(&host.files["bba.json"][0].1).unwrap();
    for i in 0..26 {
        for j in 0..26 {
            if i != j {
                json["covariance"][i][j] = json!(0.0);
            }
        }
    }
    let host = host.with("diagonal.json", &[("diagonal.json", json.to_string().as_bytes())]);
    import(&host, &json!({"path": "cameras.json", "covariance": "diagonal.json"})).unwrap();
    assert_eq!(host.warnings().len(), 1);
}

#[test]
fn names_with_folders_become_items_of_axes() {
    let block = |names: [&str; 2]| {
        let sensor = json!({"id": "day1/a.jpg", "width": 200, "height": 100, "f": 400, "cx": 99.5, "cy": 49.5});
        let image = |name: &str| json!({"name": name, "sensor": "day1/a.jpg", "q_wxyz": [0, 1, 0, 0], "C": [0, 0, 20]});
        json!({"sensors": [sensor], "images": names.map(image)}).to_string()
    };
    let matrix = [[1e-6, 0.0], [0.0, 1e-6]];
    let covariance = json!({"parameters": ["day1/a.jpg.X", "b.jpg.Z"], "covariance": matrix, "sigma0_applied": true, "full_joint": true});
    let import_block = |names: [&str; 2]| {
        let host = TestHost::default()
            .with("c.json", &[("c.json", block(names).as_bytes())])
            .with("cov.json", &[("cov.json", covariance.to_string().as_bytes())]);
        (import(&host, &json!({"path": "c.json", "covariance": "cov.json", "frame": "wall"})), host)
    };
    let (found, host) = import_block(["day1/a.jpg", "b.jpg"]);
    let (cameras, covariance) = found.unwrap();
    assert_eq!(cameras.images.iter().map(|image| image.name.as_str()).collect::<Vec<_>>(), ["day1_a.jpg", "b.jpg"]);
    assert_eq!(covariance.parameters, ["day1_a.jpg.X", "b.jpg.Z"]);
    assert!(
        host.warnings().iter().any(|warning| warning.contains("`day1/a.jpg` is called `day1_a.jpg`")),
        "{:?}",
        host.warnings()
    );
    let twins = import_block(["day1/a.jpg", "day1_a.jpg"]).0.unwrap_err();
    assert!(twins.message.contains("would be called `day1_a.jpg`") || twins.message.contains("b.jpg"), "{twins}");
}

#[test]
fn a_focal_length_in_millimetres_is_warned_of() {
    let image = b"1 1 0 0 0 0 0 0 1 a.png\n\n";
    let warnings = |camera: &[u8]| {
        let host = TestHost::default().with("model", &[("cameras.txt", camera), ("images.txt", image)]);
        import(&host, &json!({"path": "model"})).unwrap();
        host.warnings()
    };
    assert!(warnings(b"1 PINHOLE 6000 4000 5000 5000 3000 2000").is_empty());
    let found = warnings(b"1 PINHOLE 6000 4000 35 35 3000 2000");
    assert!(found.len() == 1 && found[0].contains("f = 35 px for a width of 6000 px"), "{found:?}");
    // 0.3 of the width.
    assert!(warnings(b"1 PINHOLE 6000 4000 1801 1801 3000 2000").is_empty());
    assert_eq!(warnings(b"1 PINHOLE 6000 4000 1799 1799 3000 2000").len(), 1);
}

#[test]
fn a_sensor_larger_than_any_is_refused() {
    let of = |camera: &[u8]| {
        let files = [("cameras.txt", camera), ("images.txt", b"1 1 0 0 0 0 0 0 1 a.png\n\n")];
        import(&TestHost::default().with("model", &files), &json!({"path": "model"}))
    };
    let error = of(b"1 PINHOLE 4000000000 4000 5000 5000 3000 2000").unwrap_err();
    assert!(error.message.contains("4000000000 x 4000 pixels"), "{error}");
    assert!(of(b"1 PINHOLE 4000 1000001 5000 5000 2000 500000").unwrap_err().message.contains("4000 x 1000001 pixels"));
    assert!(of(b"1 PINHOLE 4000 1000000 5000 5000 2000 500000").is_ok());
}

#[test]
fn blocks_of_a_metashape_file_are_warned_of() {
    let Some(host) = outcrop() else { return };
    let (cameras, full) =
        import(&host, &json!({"path": "cameras.json", "covariance": "bba.json", "frame": "wall"})).unwrap();
    let xml = metashape::write(&cameras, Some(&full)).unwrap();
    let host = host.with("block.xml", &[("block.xml", &xml)]);
    let (again, blocks) = import(&host, &json!({"path": "block.xml", "frame": "wall"})).unwrap();
    assert_eq!((again.images.len(), blocks.parameters.len()), (2, 26));
    let warnings = host.warnings();
    assert!(warnings.len() == 1 && warnings[0].contains("tear the images apart"), "{warnings:?}");
    let (_, joint) = import(&host, &json!({"path": "block.xml", "covariance": "bba.json", "frame": "wall"})).unwrap();
    assert!(joint.full_joint && host.warnings().len() == 1);
}

#[test]
fn binary_models_and_bundler_files_are_read() {
    let Some(host) = outcrop() else { return };
    let (mut cameras, _) = import(&host, &json!({"path": "colmap", "frame": "wall"})).unwrap();
    let model = colmap_binary::write(&cameras).unwrap();
    let host = host.with("binary", &[("cameras.bin", &model[0].1), ("images.bin", &model[1].1)]);
    let (again, _) = import(&host, &json!({"path": "binary", "frame": "wall"})).unwrap();
    assert_eq!(again.images[1].name, cameras.images[1].name);
    assert!((again.sensors[1].cx - cameras.sensors[1].cx).abs() < 1e-9);
    for sensor in &mut cameras.sensors {
        (sensor.cx, sensor.cy, sensor.b1, sensor.p) = (949.5, 799.5, 0.0, [0.0; 2]);
    }
    let files = bundler::write(&cameras).unwrap();
    let host = host.with("bundler", &[("bundle.out", &files[0].1), ("list.txt", &files[1].1)]);
    let with = json!({"path": "bundler", "frame": "wall", "image_size_px": [1900, 1600]});
    assert_eq!(import(&host, &with).unwrap().0.images[0].name, cameras.images[0].name);
    let error = import(&host, &json!({"path": "bundler"})).unwrap_err();
    assert!(error.hint.unwrap().contains("image_size_px"), "{}", error.message);
}

#[test]
fn what_cannot_be_read_says_why() {
    let host = TestHost::default()
        .with("two", &[("a.json", b" {}"), ("b.json", b"{}")])
        .with("empty.json", &[("empty.json", b" \n")])
        .with("block.xml", &[("block.xml", b"<?xml version=\"1.0\"?><document/>")])
        .with("a.jpg", &[("a.jpg", b"\xFF\xD8\xFF")])
        .with("binary", &[("cameras.bin", b"\x01\0"), ("images.bin", b"\x01\0")])
        .with("half", &[("cameras.txt", b"1 PINHOLE 9 7 9 9 1 1")])
        .with("bad.json", &[("bad.json", b"{\"sensors\": []}")]);
    let says = |path: &str, text: &str| {
        let message = import(&host, &json!({"path": path})).unwrap_err().message;
        assert!(message.contains(text), "{message}");
    };
    says("two", "found [a.json, b.json]");
    says("half", "found [cameras.txt], but no images.txt");
    says("bad.json", "`bad.json`: not a camera file: missing field `images`");
    says("empty.json", "`empty.json`: neither JSON, XML, a Bundler file nor a COLMAP model: it is empty");
    says("block.xml", "0 chunks");
    says("a.jpg", "it starts with `\\xff\\xd8");
    says("binary", "cameras.bin: the file ends too early");
    says("absent", "cannot read `absent`");
}

#[test]
fn the_example_of_the_reference_is_read() {
    let page = include_str!("../../../../../docs/reference/files.md");
    let example = page.split("## Cameras").nth(1).and_then(|rest| rest.split("```").nth(1)).expect("an example");
    let bytes = example.trim_start_matches("json").as_bytes();
    let host = TestHost::default().with("cameras.json", &[("cameras.json", bytes)]);
    let (cameras, _) = import(&host, &json!({"path": "cameras.json"})).unwrap();
    assert_eq!((cameras.images.len(), cameras.frame), (1, Frame::Wall));
}
