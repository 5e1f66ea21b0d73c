//! The joint covariance of orientation parameters from JSON, its names resolved against an image block.

use serde_json::{Map, Value};

use super::covariance_sampling::{JointRoot, lacks_cross_blocks};
use super::orientation_parameters::Parameter;
use rockface_core::artefact::{Cameras, Covariance, Frame};
use rockface_core::format::without_mark;
use rockface_core::{StageError, fail};

/// The artefact of rockface, or a foreign file that calls its matrix `covariance` and may have further keys.
#[derive(serde::Deserialize)]
struct CovarianceFile {
    frame: Option<Frame>,
    parameters: Vec<String>,
    #[serde(alias = "covariance")]
    matrix: Vec<Vec<f64>>,
    sigma0_applied: bool,
    full_joint: Option<bool>,
    units: Option<Map<String, Value>>,
    #[serde(flatten)]
    other: Map<String, Value>,
}

/// What a file needs, with an example.
const NEEDED: &str = "needed are `parameters` (names), `covariance` or `matrix` (rows and columns in their order) and `sigma0_applied` (whether the matrix was \
                      multiplied by the variance of unit weight), and `full_joint` may say whether it has covariances between images: {\"parameters\": \
                      [\"a.rx\", \"b.rx\"], \"covariance\": [[4e-8, 3e-8], [3e-8, 4e-8]], \"sigma0_applied\": true, \"full_joint\": true}";

/// Reads `{parameters, covariance, sigma0_applied, full_joint?, units?, ...}` or the covariance artefact of rockface.
///
/// Units are rad, m, px and 1; a file that states others is refused. Returns the covariance, with the full names of
/// `cameras`, and a note for each key that was ignored.
pub fn read(bytes: &[u8], cameras: &Cameras) -> Result<(Covariance, Vec<String>), StageError> {
    let file: CovarianceFile = serde_json::from_slice(without_mark(bytes))
        .map_err(|e| StageError::new(format!("not a covariance file: {e}")).hint(NEEDED))?;
    if let Some(frame) = file.frame.filter(|frame| *frame != cameras.frame) {
        fail!("the covariance is in the {frame} frame, the cameras in the {} frame", cameras.frame);
    }
    file.units.iter().flatten().try_for_each(|(names, unit)| check_units(names, unit))?;
    let covariance = Covariance {
        frame: cameras.frame,
        parameters: resolve(&file.parameters, cameras)?,
        matrix: file.matrix,
        sigma0_applied: file.sigma0_applied,
        full_joint: true,
    };
    JointRoot::new(&covariance)?;
    let full_joint = file.full_joint.unwrap_or_else(|| !lacks_cross_blocks(&covariance));
    Ok((Covariance { full_joint, ..covariance }, notes(&file.other)))
}

fn notes(other: &Map<String, Value>) -> Vec<String> {
    let keys: Vec<&str> = other.keys().map(String::as_str).collect();
    if keys.is_empty() { Vec::new() } else { vec![format!("keys of the file that are not used: {}", keys.join(", "))] }
}

/// `names` is a list such as `rx,ry,rz`.
fn check_units(names: &str, unit: &Value) -> Result<(), StageError> {
    for name in names.split(',').map(str::trim) {
        let expected = match name {
            "rx" | "ry" | "rz" => "rad",
            "X" | "Y" | "Z" => "m",
            "f" | "cx" | "cy" | "b1" | "b2" => "px",
            _ => "1",
        };
        if unit.as_str() != Some(expected) {
            fail!("the covariance file gives `{name}` in {unit}; here it must be in \"{expected}\"");
        }
    }
    Ok(())
}

fn resolve(names: &[String], cameras: &Cameras) -> Result<Vec<String>, StageError> {
    let mut resolved: Vec<Parameter> = Vec::with_capacity(names.len());
    for name in names {
        let parameter = Parameter::find(cameras, name)?;
        if resolved.contains(&parameter) {
            fail!("the covariance names the parameter `{name}` twice");
        }
        resolved.push(parameter);
    }
    Ok(resolved.into_iter().map(|parameter| parameter.name(cameras)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Image, Noun, Sensor};
    use serde_json::json;

    fn block() -> Cameras {
        let (k, p) = ([0.0; 4], [0.0; 2]);
        let name = "a.png".to_owned();
        let sensor =
            Sensor { name: name.clone(), width_px: 9, height_px: 7, f: 9.0, cx: 4.0, cy: 3.0, b1: 0.0, b2: 0.0, k, p };
        let image = Image { name, sensor: 0, camera_from_object: [1.0, 0.0, 0.0, 0.0], centre_m: [0.0; 3] };
        Cameras { frame: Frame::Wall, sensors: vec![sensor], images: vec![image] }
    }

    fn file() -> Value {
        json!({"parameters": ["a.rx", "a.f"], "covariance": [[1e-6, 1e-4], [1e-4, 1.0]], "sigma0_applied": true,
               "units": {"rx,ry,rz": "rad", "f": "px"}, "method": "by hand"})
    }

    #[test]
    fn names_get_their_extension_and_extras_are_noted() {
        let (covariance, notes) = read(file().to_string().as_bytes(), &block()).unwrap();
        assert_eq!(covariance.parameters, ["a.png.rx", "a.png.f"]);
        assert!(covariance.full_joint);
        assert_eq!(notes, ["keys of the file that are not used: method"]);
        let bytes = covariance.encode().unwrap();
        assert_eq!(read(&bytes, &block()).unwrap().0, covariance);
        let world = Cameras { frame: Frame::World, ..block() };
        assert!(read(&bytes, &world).unwrap_err().message.contains("wall frame"));
    }

    #[test]
    fn wrong_names_units_and_shapes_are_refused() {
        let says = |key: &str, value: Value, text: &str| {
            let mut bad = file();
            bad[key] = value;
            let message = read(bad.to_string().as_bytes(), &block()).unwrap_err().message;
            assert!(message.contains(text), "{message}");
        };
        says("parameters", json!(["b.rx", "a.f"]), "`b.rx`");
        says("parameters", json!(["a.rx", "a.png.rx"]), "`a.png.rx` twice");
        says("parameters", json!(["a.rx"]), "1 parameters but 2 rows");
        says("units", json!({"rx": "deg"}), "`rx` in \"deg\"");
        says("sigma0_applied", json!(null), "invalid type");
        let mut bad = file();
        bad.as_object_mut().unwrap().remove("sigma0_applied");
        let hint = read(bad.to_string().as_bytes(), &block()).unwrap_err().hint.unwrap();
        for field in ["`parameters`", "`covariance` or `matrix`", "`sigma0_applied`", "`full_joint`"] {
            assert!(hint.contains(field), "{hint}");
        }
        // The example in it is one.
        let example = hint.split_once(": {").map(|(_, example)| format!("{{{example}")).unwrap();
        let file: CovarianceFile = serde_json::from_str(&example).unwrap();
        assert_eq!(
            (file.parameters.len(), file.matrix.len(), file.sigma0_applied, file.full_joint),
            (2, 2, true, Some(true))
        );
    }
}
