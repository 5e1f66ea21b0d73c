//! Pictures and cameras. The frame of a camera is x right, y down, z forward, as Foxglove has it too.

use ::foxglove::messages as proto;
use rockface_core::artefact::{Cameras, Image, Sensor};

use super::super::step_log::sketch::PictureSketch;
use super::{Message, Place, message};

/// A picture, seen from the camera whose pixels it has.
pub fn picture(place: &Place, port: &str, topic: String, picture: &PictureSketch) -> Message {
    let frame_id = picture.image.as_ref().map(|image| place.camera(port, image)).unwrap_or_default();
    let value = proto::CompressedImage {
        timestamp: Some(place.time()),
        frame_id,
        data: picture.png.clone().into(),
        format: "png".to_owned(),
    };
    message("foxglove.CompressedImage", topic, &value)
}

/// Where the cameras stand, and the calibration of each.
pub fn cameras(place: &Place, port: &str, part: &str, cameras: &Cameras) -> Vec<Message> {
    let frame = cameras.frame.to_string();
    let transforms = cameras.images.iter().map(|image| pose(place, port, &frame, image)).collect();
    let part_of = |image: &str| if part.is_empty() { image.to_owned() } else { part.to_owned() };
    let poses = place.topic(port, if part.is_empty() { "" } else { "pose" });
    let mut messages = vec![message("foxglove.FrameTransforms", poses, &proto::FrameTransforms { transforms })];
    messages.extend(cameras.images.iter().map(|image| {
        let topic = place.topic(port, &part_of(&image.name));
        message("foxglove.CameraCalibration", topic, &calibration(place, port, cameras.sensor(image), image))
    }));
    messages
}

/// The camera in the frame of its block: `C` and the transpose of `R`.
fn pose(place: &Place, port: &str, frame: &str, image: &Image) -> proto::FrameTransform {
    let ([x, y, z], [w, i, j, k]) = (image.centre_m, image.camera_from_object);
    proto::FrameTransform {
        timestamp: Some(place.time()),
        parent_frame_id: frame.to_owned(),
        child_frame_id: place.camera(port, &image.name),
        translation: Some(proto::Vector3 { x, y, z }),
        rotation: Some(proto::Quaternion { x: -i, y: -j, z: -k, w }),
    }
}

/// Interior orientation in the convention of `OpenCV`. Its five-parameter model has no k4: a lens that has one is given
/// without distortion and with no model, as its sketch says.
fn calibration(place: &Place, port: &str, sensor: &Sensor, image: &Image) -> proto::CameraCalibration {
    let ([k1, k2, k3, k4], [p1, p2]) = (sensor.k, sensor.p);
    let plain = k4 == 0.0;
    let (fx, fy, skew, cx, cy) = (sensor.f + sensor.b1, sensor.f, sensor.b2, sensor.cx, sensor.cy);
    proto::CameraCalibration {
        timestamp: Some(place.time()),
        frame_id: place.camera(port, &image.name),
        width: sensor.width_px,
        height: sensor.height_px,
        distortion_model: if plain { "plumb_bob".to_owned() } else { String::new() },
        d: if plain { vec![k1, k2, p1, p2, k3] } else { Vec::new() },
        k: vec![fx, skew, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![fx, skew, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
}
