//! Image blocks and their covariance, through `import-cameras`.

use rockface_core::artefact::{Cameras, Frame, Image, Sensor};
use rockface_core::testing::small_sensor;
use serde_json::json;

use super::Verdict;
use super::host::{Files, run};
use crate::parts::cut;

/// The block whose covariance is read, and from which seeds are written: two images of one camera.
pub fn image_block() -> Cameras {
    let sensor = Sensor { name: "sensor1".into(), k: [-0.1, 0.02, 0.0, 0.0], ..small_sensor() };
    let image = |name: &str, x: f64| Image {
        name: name.into(),
        sensor: 0,
        camera_from_object: [0.0, 1.0, 0.0, 0.0],
        centre_m: [x, 0.0, 20.0],
    };
    Cameras { frame: Frame::Wall, sensors: vec![sensor], images: vec![image("a.png", -2.0), image("b.png", 2.5)] }
}

fn block(names: &[&str], bytes: &[u8], size: bool) -> Verdict {
    let parts = if names.len() == 1 { vec![bytes] } else { cut(bytes) };
    let files = names.iter().copied().zip(parts).collect();
    let with = if size { json!({"path": "block", "image_size_px": [60, 40]}) } else { json!({"path": "block"}) };
    run("import-cameras", &with, &Files(&[("block", files)]), &[])
}

/// JSON, ours and the simple one.
pub fn json(bytes: &[u8]) -> Verdict {
    block(&["cameras.json"], bytes, false)
}

/// The camera XML of Metashape.
pub fn metashape(bytes: &[u8]) -> Verdict {
    block(&["cameras.xml"], bytes, false)
}

/// Bundler's file, and the list where the case has a second part.
pub fn bundler(bytes: &[u8]) -> Verdict {
    block(&["bundle.out", "list.txt"], bytes, true)
}

/// COLMAP's text model: cameras, images.
pub fn colmap_text(bytes: &[u8]) -> Verdict {
    block(&["cameras.txt", "images.txt"], bytes, false)
}

/// COLMAP's binary model: cameras, images.
pub fn colmap_binary(bytes: &[u8]) -> Verdict {
    block(&["cameras.bin", "images.bin"], bytes, false)
}

/// The covariance of [`image_block`].
pub fn covariance(bytes: &[u8]) -> Verdict {
    use rockface_core::artefact::Noun;
    let Ok(cameras) = image_block().encode() else { return Verdict::Refused };
    let files = [("block", vec![("cameras.json", cameras.as_slice())]), ("file", vec![("covariance.json", bytes)])];
    run("import-cameras", &json!({"path": "block", "covariance": "file"}), &Files(&files), &[])
}
