//! The files of a project read back.

use std::collections::BTreeMap;

use tiff::decoder::{Decoder, DecodingResult};

use super::*;
use crate::camera::model::Camera;
use rockface_core::testing::{image_at, small_sensor};

fn wall(name: &str, x: f64) -> Depth {
    let sensor = Sensor { k: [-0.1, 0.0, 0.0, 0.0], b1: 1.0, ..small_sensor() };
    let image = image_at(name, [x, 0.0, 20.0], [0.0, 0.1, 0.0]);
    let camera = Camera::new(&sensor, &image);
    let (width, height) = (60, 40);
    let z = |at: usize| {
        let ray = camera.direction(camera.normalised([(at % width) as f64, (at / width) as f64]).unwrap());
        (-20.0 / ray.z) as f32
    };
    let z = (0..width * height).map(z).collect();
    Depth { frame: Frame::Wall, sensor, image, downscale: 1, width, height, z, channels: BTreeMap::new() }
}

#[test]
fn depths_unprojected_by_the_cameras_of_the_file_lie_on_the_wall() {
    let (left, right) = (wall("left one", -2.0), wall("right", 2.0));
    let project = lay_out(&[&left, &right], Frame::Wall).unwrap();
    let file = |name: &str| project.files.iter().find(|(own, _)| own == name).unwrap().1.clone();
    let xml = String::from_utf8(file("cameras.xml")).unwrap();
    let read = metashape::read(&xml, Frame::Wall).unwrap().cameras;
    assert_eq!((read.sensors.len(), read.images[0].name.as_str()), (1, "0000_left_one"));
    for image in &read.images {
        let tif = file(&format!("depth/{}.tif", image.name));
        let DecodingResult::F32(z) = Decoder::new(Cursor::new(tif)).unwrap().read_image().unwrap() else {
            panic!("no floats")
        };
        let camera = Camera::new(&read.sensors[0], image);
        let mut seen = 0;
        for (at, z) in z.iter().enumerate().filter(|(_, z)| **z > 0.0) {
            let ray = camera.normalised([(at % 60) as f64, (at / 60) as f64]).unwrap();
            assert!(camera.unproject(ray, f64::from(*z)).z.abs() < 1e-4);
            seen += 1;
        }
        assert!(seen > 2200, "{seen}");
    }
    let list: serde_json::Value = serde_json::from_slice(&file("images.json")).unwrap();
    assert_eq!((list["images"][1]["image"].as_str(), list["offset_m"][0].as_f64()), (Some("right"), Some(0.0)));
    assert!(String::from_utf8(file("README.txt")).unwrap().contains("path: fused.ply, frame: wall, defects"));
}

#[test]
fn far_coordinates_count_from_a_corner() {
    let mut far = wall("a", 0.0);
    far.image.centre_m[0] += 451_234.5;
    let project = lay_out(&[&far], Frame::World).unwrap();
    assert_eq!(project.origin_m, [451_000.0, 0.0, 0.0]);
    let readme = &project.files.iter().find(|(name, _)| name == "README.txt").unwrap().1;
    assert!(std::str::from_utf8(readme).unwrap().contains("offset_m: [451000, 0, 0]"));
}
