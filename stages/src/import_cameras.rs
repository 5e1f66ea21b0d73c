//! `import-cameras`: reads an image block, and the joint covariance of its orientation, from the files of other programs.

use std::io::Read;

use crate::artefact::{Cameras, Covariance, Frame, Kind};
use crate::kernel::camera_files::{CameraFile, colmap_text, json};
use crate::kernel::covariance_sampling::block_only;
use crate::kernel::covariance_files;
use crate::params::{FileRef, FilesRef};
use crate::{Context, Inputs, Outputs, Page, Port, SourceFile, Stage, StageError, choice, fail, params};

choice! {
    /// The frame a file's coordinates are in.
    pub enum FileFrame {
        /// The coordinate reference system of the input.
        World = "world",
        /// The frame of the face: X along it, Y up, Z towards the viewer.
        Wall = "wall",
    }
}

params! {
    /// Parameters of `import-cameras`.
    pub struct ImportCamerasParams {
        /// A JSON file, or the folder of a COLMAP text model (`cameras.txt`, `images.txt`).
        path: FilesRef,
        /// JSON file of the joint covariance; null: an output without parameters.
        covariance: Option<FileRef> = None,
        /// The frame of the projection centres; null: what the file says, or world where it says nothing.
        frame: Option<FileFrame> = None,
    }
}

/// A principal distance below this share of the width (a field of view above 118 degrees) is rarely meant.
const LEAST_USUAL_F_PER_WIDTH: f64 = 0.3;

/// The stage.
pub struct ImportCameras;

impl Stage for ImportCameras {
    type Params = ImportCamerasParams;
    const NAME: &'static str = "import-cameras";
    const VERSION: u32 = 1;
    const PAGE: Page = Page {
        what: "Reads sensors, oriented images and the joint covariance of their orientation parameters. A sensor used by \
               exactly one image takes that image's name, any other is called sensor<id>.",
        method: "JSON with sensors {id, width, height, f or fx and fy, cx, cy, b1, b2, k1..k4, p1, p2} and images {name, \
                 sensor, q_wxyz, C}; our own JSON; or a COLMAP text model (SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, \
                 OPENCV, FULL_OPENCV without denominator), C = -R^T t. JSON is told from COLMAP by content. The covariance is \
                 JSON {parameters, covariance, sigma0_applied, full_joint}; its names fit with or without file extension \
                 (paper 2.1.2: theta' = theta + e, e from the covariance of the bundle block adjustment).",
        frames: "Centres in metres in the frame `frame` says; X_c = R (X - C), camera x right, y down, z forward. JSON \
                 pixels: centre of the first at (0, 0); COLMAP pixels, first at (0.5, 0.5), are converted. Covariance in rad \
                 (left, camera frame), m, px, 1.",
        fails: "On unknown camera models or sensor keys, quaternions off unit length by more than 1e-6, unknown parameter \
                names, a matrix that is not symmetric and positive semi-definite, frames that contradict. It warns when the \
                covariance holds blocks of single images only: use the joint matrix then.",
        example: "rockface: 1\nname: import-cameras\nseed: 1\nsteps:\n  survey:\n    stage: import-cameras\n    \
                  with: {path: cameras.json, covariance: bba_covariance.json, frame: wall}\n  noisy:\n    \
                  stage: perturb-cameras\n    in: {cameras: survey.cameras, covariance: survey.covariance}\n",
    };
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[
        Port::one("cameras", &[Kind::Cameras], "Sensors and oriented images."),
        Port::one("covariance", &[Kind::Covariance], "Joint covariance; without parameters when no file is given."),
    ];

    fn run(params: &Self::Params, _inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let file = read_cameras(params, context)?;
        for note in &file.notes {
            context.note(note.as_str());
        }
        warn_of_short_focal_lengths(&file.cameras, context);
        let covariance = match &params.covariance {
            Some(path) => read_covariance(path, &file.cameras, context)?,
            None => nothing(file.cameras.frame),
        };
        let (images, sensors) = (file.cameras.images.len(), file.cameras.sensors.len());
        let (frame, known) = (file.cameras.frame, covariance.parameters.len());
        context.note(format!("{images} images, {sensors} sensors ({frame} frame), covariance of {known} parameters"));
        Ok(Outputs::of("cameras", file.cameras).and("covariance", covariance))
    }
}

fn warn_of_short_focal_lengths(cameras: &Cameras, context: &Context) {
    for sensor in &cameras.sensors {
        if sensor.f < LEAST_USUAL_F_PER_WIDTH * f64::from(sensor.width_px) {
            context.warn(format!(
                "sensor `{}`: f = {} px for a width of {} px: are these millimetres instead of pixels?",
                sensor.name, sensor.f, sensor.width_px
            ));
        }
    }
}

fn nothing(frame: Frame) -> Covariance {
    Covariance { frame, parameters: Vec::new(), matrix: Vec::new(), sigma0_applied: true, full_joint: true }
}

fn read_cameras(params: &ImportCamerasParams, context: &Context) -> Result<CameraFile, StageError> {
    let frame = params.frame.map(|frame| match frame {
        FileFrame::World => Frame::World,
        FileFrame::Wall => Frame::Wall,
    });
    let path = &params.path.0;
    let file = read_any(context.files(&params.path)?, path, frame.unwrap_or(Frame::World))
        .map_err(|e| StageError { message: format!("`{path}`: {}", e.message), hint: e.hint })?;
    match frame {
        Some(frame) if file.states_frame && frame != file.cameras.frame => {
            Err(StageError::new(format!("`{path}` is in the {} frame, not the {frame} frame", file.cameras.frame))
                .hint("leave `frame` out"))
        }
        _ => Ok(file),
    }
}

fn read_any(files: Vec<SourceFile>, path: &str, frame: Frame) -> Result<CameraFile, StageError> {
    let (mut json, mut cameras, mut images, mut others) = (Vec::new(), None, None, Vec::new());
    let only_one = files.len() == 1;
    for file in files {
        match (file.name.as_str(), peek(file.reader)?) {
            (name, (head, reader)) if is_json(&head) => json.push((name.to_owned(), reader)),
            ("cameras.txt", (_, reader)) => cameras = Some(reader),
            ("images.txt", (_, reader)) => images = Some(reader),
            (name, (head, _)) => others.push((name.to_owned(), head)),
        }
    }
    match (json.len(), cameras, images) {
        (0, Some(cameras), Some(images)) => colmap_text::read(&text(cameras)?, &text(images)?, frame),
        (1, None, None) => json::read(&whole(json.remove(0).1)?, frame),
        _ if others.iter().any(|(name, _)| name == "cameras.bin") => Err(StageError::new(
            "a binary COLMAP model, which is not read",
        )
        .hint("write it as text: `colmap model_converter --input_path DIR --output_path DIR --output_type TXT`")),
        (0, None, None) if only_one && !others.is_empty() => Err(unknown(&others[0].1)),
        (_, cameras, images) => {
            let names: Vec<&str> = json.iter().map(|(name, _)| name.as_str()).collect();
            let is = |found: bool| if found { "a" } else { "no" };
            Err(StageError::new(format!(
                "needed: one JSON file, or cameras.txt and images.txt; found {} cameras.txt, {} images.txt, JSON: [{}]",
                is(cameras.is_some()),
                is(images.is_some()),
                names.join(", ")
            ))
            .hint(format!("name the one file, or the folder of the COLMAP text model, instead of `{path}`")))
        }
    }
}

type Reader = Box<dyn Read + Send>;

/// The first bytes of a file, and the file from its start.
fn peek(mut reader: Reader) -> Result<(Vec<u8>, Reader), StageError> {
    let mut head = Vec::new();
    reader.by_ref().take(256).read_to_end(&mut head).map_err(|e| StageError::new(format!("cannot read: {e}")))?;
    Ok((head.clone(), Box::new(std::io::Cursor::new(head).chain(reader))))
}

/// Whether a file is a JSON map, by its first character that is not blank.
fn is_json(head: &[u8]) -> bool {
    head.iter().find(|byte| !byte.is_ascii_whitespace()) == Some(&b'{')
}

/// The refusal of a single file, by its first bytes.
fn unknown(head: &[u8]) -> StageError {
    let start = head.trim_ascii_start();
    let found = if start.is_empty() {
        "it is empty".to_owned()
    } else {
        format!("it starts with `{}`", start[..start.len().min(24)].escape_ascii())
    };
    StageError::new(format!("neither a JSON map nor a COLMAP text model: {found}"))
        .hint("give JSON with `sensors` and `images`, or the folder that holds cameras.txt and images.txt")
}

fn whole(mut reader: Reader) -> Result<Vec<u8>, StageError> {
    let mut bytes = Vec::new();
    reader.read_to_end(&mut bytes).map_err(|e| StageError::new(format!("cannot read: {e}")))?;
    Ok(bytes)
}

fn text(reader: Reader) -> Result<String, StageError> {
    String::from_utf8(whole(reader)?).map_err(|e| StageError::new(format!("COLMAP text model: {e}")))
}

fn read_covariance(path: &FileRef, cameras: &Cameras, context: &Context) -> Result<Covariance, StageError> {
    let (covariance, notes) = covariance_files::read(&context.read(path)?, cameras)
        .map_err(|e| StageError { message: format!("`{}`: {}", path.0, e.message), hint: e.hint })?;
    for note in notes {
        context.note(note);
    }
    if covariance.parameters.is_empty() {
        fail!("`{}`: a covariance without parameters", path.0);
    }
    if let Some(warning) = block_only(&covariance) {
        context.warn(warning);
    }
    if !covariance.sigma0_applied {
        context.warn(
            "the covariance was not multiplied by the variance of unit weight: multiply `scale` of perturb-cameras by sigma0",
        );
    }
    Ok(covariance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artefact::Artefact;
    use crate::kernel::camera::Camera;
    use crate::params::ParamType;
    use crate::testing::{TestHost, shared};
    use nalgebra::Vector3;
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
    }

    #[test]
    fn what_cannot_be_read_says_why() {
        let host = TestHost::default()
            .with("two", &[("a.json", b" {}"), ("b.json", b"{}")])
            .with("empty.json", &[("empty.json", b" \n")])
            .with("block.xml", &[("block.xml", b"<?xml version=\"1.0\"?><document/>")])
            .with("binary", &[("cameras.bin", b"\x01\0"), ("images.bin", b"\x01\0")])
            .with("half", &[("cameras.txt", b"1 PINHOLE 9 7 9 9 1 1")])
            .with("bad.json", &[("bad.json", b"{\"sensors\": []}")]);
        let says = |path: &str, text: &str| {
            let message = import(&host, &json!({"path": path})).unwrap_err().message;
            assert!(message.contains(text), "{message}");
        };
        says("two", "JSON: [a.json, b.json]");
        says("half", "found a cameras.txt, no images.txt");
        says("bad.json", "`bad.json`: not a camera file: missing field `images`");
        says("empty.json", "`empty.json`: neither a JSON map nor a COLMAP text model: it is empty");
        says("block.xml", "it starts with `<?xml");
        says("binary", "a binary COLMAP model");
        says("absent", "cannot read `absent`");
    }
}
