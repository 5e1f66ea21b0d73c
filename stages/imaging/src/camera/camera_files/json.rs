//! Cameras from JSON: sensors with `f, cx, cy, k1, ...`, images with `q_wxyz` and `C`, or the cameras artefact of rockface.

use std::collections::{HashMap, HashSet};

use serde_json::{Map, Value};

use super::{CameraFile, assemble, validated};
use rockface_core::artefact::{Cameras, Frame, Image, Noun, Sensor};
use rockface_core::format::without_mark;
use rockface_core::{StageError, fail};

#[derive(serde::Deserialize)]
struct BlockFile {
    frame: Option<Frame>,
    sensors: Vec<SensorFile>,
    images: Vec<ImageFile>,
    #[serde(flatten)]
    other: Map<String, Value>,
}

/// What images name a sensor by: a number or a text.
#[derive(Debug, Clone, PartialEq, Eq, Hash, serde::Deserialize)]
#[serde(untagged, expecting = "a sensor is named by a whole number or a text")]
enum Id {
    Number(u64),
    Text(String),
}

impl std::fmt::Display for Id {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Number(number) => write!(f, "{number}"),
            Self::Text(text) => write!(f, "`{text}`"),
        }
    }
}

/// An unknown key of a sensor is an error: it may be a distortion that this model lacks.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct SensorFile {
    id: Id,
    width: u32,
    height: u32,
    f: Option<f64>,
    fx: Option<f64>,
    fy: Option<f64>,
    cx: f64,
    cy: f64,
    b1: Option<f64>,
    #[serde(default)]
    b2: f64,
    #[serde(default)]
    k1: f64,
    #[serde(default)]
    k2: f64,
    #[serde(default)]
    k3: f64,
    #[serde(default)]
    k4: f64,
    #[serde(default)]
    p1: f64,
    #[serde(default)]
    p2: f64,
}

#[derive(serde::Deserialize)]
struct ImageFile {
    name: String,
    sensor: Id,
    q_wxyz: [f64; 4],
    #[serde(rename = "C")]
    centre_m: [f64; 3],
    #[serde(flatten)]
    other: Map<String, Value>,
}

/// Reads cameras from JSON; `frame` is used where the file does not name its frame.
///
/// Pixels have the centre of the first pixel at (0, 0), distortion is Brown-Conrady in the `OpenCV` convention,
/// `q_wxyz` is the quaternion of R in `X_c = R (X - C)`. Sensors of the artefact have a key `width_px`.
pub fn read(bytes: &[u8], frame: Frame) -> Result<CameraFile, StageError> {
    let bytes = without_mark(bytes);
    let json: Value = serde_json::from_slice(bytes).map_err(|e| StageError::new(format!("not valid JSON: {e}")))?;
    if json.pointer("/sensors/0/width_px").is_some() {
        let cameras = Cameras::decode(bytes).map_err(|e| StageError::new(e.to_string()))?;
        return Ok(CameraFile { states_frame: true, ..CameraFile::of(validated(cameras)?) });
    }
    let file: BlockFile = serde_json::from_slice(bytes).map_err(|e| {
        StageError::new(format!("not a camera file: {e}"))
            .hint("needed: sensors [{id, width, height, f, cx, cy, k1, ...}], images [{name, sensor, q_wxyz, C}]")
    })?;
    let notes = unused_keys(&file);
    let places = places(&file.sensors);
    let images = file.images.iter().map(|i| image(i, &file.sensors, &places)).collect::<Result<_, StageError>>()?;
    let sensors = file.sensors.iter().map(sensor).collect::<Result<Vec<_>, _>>()?;
    let numbered = (0..).zip(sensors).collect();
    let states_frame = file.frame.is_some();
    Ok(CameraFile { states_frame, ..assemble(file.frame.unwrap_or(frame), numbered, images, notes)? })
}

fn unused_keys(file: &BlockFile) -> Vec<String> {
    let mut seen = HashSet::new();
    let of_images = file.images.iter().flat_map(|image| image.other.keys());
    let of_images = of_images.filter(|key| seen.insert(*key)).map(|key| format!("images[].{key}"));
    let keys: Vec<String> = file.other.keys().cloned().chain(of_images).collect();
    if keys.is_empty() { Vec::new() } else { vec![format!("keys of the file that are not used: {}", some(&keys))] }
}

/// Names for a message, the first ones where there are many.
fn some(names: &[String]) -> String {
    const SHOWN: usize = 20;
    let beyond = names.len().saturating_sub(SHOWN);
    let shown = names[..names.len() - beyond].join(", ");
    if beyond == 0 { shown } else { format!("{shown} and {beyond} more") }
}

fn sensor(file: &SensorFile) -> Result<Sensor, StageError> {
    let (f, b1) = focal(file)?;
    Ok(Sensor {
        name: match &file.id {
            Id::Number(number) => format!("sensor{number}"),
            Id::Text(text) => text.clone(),
        },
        width_px: file.width,
        height_px: file.height,
        f,
        cx: file.cx,
        cy: file.cy,
        b1,
        b2: file.b2,
        k: [file.k1, file.k2, file.k3, file.k4],
        p: [file.p1, file.p2],
    })
}

/// f and b1 (`fy = f`, `fx = f + b1`) from whichever of f, fx, fy and b1 are there; contradictions are errors.
fn focal(file: &SensorFile) -> Result<(f64, f64), StageError> {
    let id = &file.id;
    let Some(f) = file.fy.or(file.f) else { fail!("sensor {id}: neither `f` nor `fy`") };
    if let Some(other) = file.f.filter(|other| other.to_bits() != f.to_bits()) {
        fail!("sensor {id}: f = {other} but fy = {f}; here f is fy, and fx = f + b1");
    }
    let b1 = file.fx.map(|fx| fx - f);
    match (b1, file.b1) {
        (Some(a), Some(b)) if (a - b).abs() > 1e-9 * f.abs() => {
            Err(StageError::new(format!("sensor {id}: fx - fy = {a} but b1 = {b}; give one of them")))
        }
        (_, Some(b1)) | (Some(b1), None) => Ok((f, b1)),
        (None, None) => Ok((f, 0.0)),
    }
}

/// Where in the file the sensor of an id is; nothing for an id that two of them have.
fn places(sensors: &[SensorFile]) -> HashMap<&Id, Option<usize>> {
    let mut places = HashMap::new();
    for (place, sensor) in sensors.iter().enumerate() {
        places.entry(&sensor.id).and_modify(|found| *found = None).or_insert(Some(place));
    }
    places
}

fn image(file: &ImageFile, sensors: &[SensorFile], places: &HashMap<&Id, Option<usize>>) -> Result<Image, StageError> {
    let Some(sensor) = places.get(&file.sensor).copied().flatten() else {
        let ids: Vec<_> = sensors.iter().map(|sensor| sensor.id.to_string()).collect();
        fail!("image `{}` names sensor {}: needed once among the sensors {}", file.name, file.sensor, some(&ids))
    };
    Ok(Image { name: file.name.clone(), sensor, camera_from_object: file.q_wxyz, centre_m: file.centre_m })
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "what is exact must be exact")]
mod tests {
    use super::*;
    use serde_json::json;

    fn block(sensor: &Value) -> Vec<u8> {
        let image = json!({"name": "a", "sensor": 4, "q_wxyz": [1, 0, 0, 0], "C": [1, 2, 3], "note": "x"});
        json!({"sensors": [sensor], "images": [image], "raster": {}}).to_string().into_bytes()
    }

    #[test]
    fn affinity_comes_from_fx_or_b1() {
        let sensor = json!({"id": 4, "width": 9, "height": 7, "fx": 102.5, "fy": 100, "cx": 4, "cy": 3});
        let file = read(&block(&sensor), Frame::World).unwrap();
        assert_eq!((file.cameras.sensors[0].f, file.cameras.sensors[0].b1), (100.0, 2.5));
        assert_eq!(file.cameras.sensors[0].name, "a");
        assert_eq!(file.notes, ["keys of the file that are not used: raster, images[].note"]);
        let sensor = json!({"id": 4, "width": 9, "height": 7, "f": 100, "b1": -1, "cx": 4, "cy": 3});
        assert_eq!(read(&block(&sensor), Frame::World).unwrap().cameras.sensors[0].b1, -1.0);
    }

    #[test]
    fn sensors_may_have_names_and_a_file_its_frame() {
        let image = |name: &str| json!({"name": name, "sensor": "left", "q_wxyz": [1, 0, 0, 0], "C": [1, 2, 3]});
        let sensor = json!({"id": "left", "width": 9, "height": 7, "f": 100, "cx": 4, "cy": 3});
        let block = json!({"frame": "wall", "sensors": [sensor], "images": [image("a"), image("b")]});
        let file = read(format!("\u{feff}{block}").as_bytes(), Frame::World).unwrap();
        assert!(file.states_frame && file.notes.is_empty());
        assert_eq!((file.cameras.frame, file.cameras.sensors[0].name.as_str()), (Frame::Wall, "left"));
        let other = block.to_string().replace("\"sensor\":\"left\"", "\"sensor\":\"right\"");
        let message = read(other.as_bytes(), Frame::World).unwrap_err().message;
        assert!(message.contains("names sensor `right`: needed once among the sensors `left`"), "{message}");
    }

    #[test]
    fn a_sensor_must_be_there_once_and_few_of_many_are_named() {
        let image = |sensor: u32| json!({"name": "a", "sensor": sensor, "q_wxyz": [1, 0, 0, 0], "C": [1, 2, 3]});
        let sensor = |id: u32| json!({"id": id, "width": 9, "height": 7, "f": 100, "cx": 4, "cy": 3});
        let read = |ids: Vec<u32>, of: u32| {
            let sensors: Vec<Value> = ids.into_iter().map(sensor).collect();
            let images = [image(of)];
            read(json!({"sensors": sensors, "images": images}).to_string().as_bytes(), Frame::Wall)
        };
        assert_eq!(read((0..30).collect(), 29).unwrap().cameras.images[0].sensor, 29);
        assert!(read(vec![1, 2, 1], 1).unwrap_err().message.contains("needed once among the sensors 1, 2, 1"));
        let message = read((0..30).collect(), 30).unwrap_err().message;
        assert!(message.ends_with("18, 19 and 10 more"), "{message}");
    }

    #[test]
    fn contradictions_and_unknown_sensor_keys_are_errors() {
        let says = |sensor: Value, text: &str| {
            let message = read(&block(&sensor), Frame::World).unwrap_err().message;
            assert!(message.contains(text), "{message}");
        };
        let full = json!({"id": 4, "width": 9, "height": 7, "f": 100, "cx": 4, "cy": 3});
        let with = |key: &str, value: Value| {
            let mut sensor = full.clone();
            sensor[key] = value;
            sensor
        };
        says(with("fy", json!(101)), "f = 100 but fy = 101");
        says(with("k5", json!(0.1)), "k5");
        says(with("id", json!(5)), "image `a` names sensor 4");
        says(with("f", json!(null)), "neither `f` nor `fy`");
    }

    #[test]
    fn our_own_file_comes_back() {
        let sensor = json!({"id": 4, "width": 9, "height": 7, "f": 100, "cx": 4, "cy": 3});
        let mut cameras = read(&block(&sensor), Frame::Wall).unwrap().cameras;
        cameras.images[0].camera_from_object =
            [0.182_574_185_835_055_36, 0.365_148_371_670_110_7, 0.547_722_557_505_166_1, 0.730_296_743_340_221_4];
        let again = read(&cameras.encode().unwrap(), Frame::World).unwrap();
        assert_eq!(again.cameras, cameras);
        assert!(again.states_frame);
    }
}
