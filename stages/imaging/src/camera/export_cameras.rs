//! `export-cameras`: writes an image block as another program's file, or fails where the format cannot hold it exactly.

use std::borrow::Cow;

use crate::camera::camera_files::{bundler, colmap_binary, colmap_text, metashape};
use crate::camera::orientation::{cameras_to_frame, covariance_to_frame};
use rockface_core::artefact::{Cameras, Covariance, Files, Frame, Kind, Noun, Transform};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, choice, params};

choice! {
    /// Who is to read it.
    pub enum Format {
        /// COLMAP's text model: cameras.txt, images.txt, an empty points3D.txt.
        ColmapText = "colmap-text",
        /// COLMAP's binary model: cameras.bin, images.bin, an empty points3D.bin.
        ColmapBinary = "colmap-binary",
        /// Metashape's camera XML: cameras.xml.
        Metashape = "metashape",
        /// Bundler v0.3: bundle.out and list.txt.
        Bundler = "bundler",
        /// Our own JSON: cameras.json.
        Json = "json",
    }
}

params! {
    /// Parameters of `export-cameras`.
    pub struct ExportCamerasParams {
        /// Who is to read it.
        format: Format = Format::ColmapText,
    }
}

/// Writes sensors and images in the format of another program.
pub struct ExportCameras;

impl Stage for ExportCameras {
    type Params = ExportCamerasParams;
    const NAME: &'static str = "export-cameras";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("export_cameras.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("cameras", &[Kind::Cameras], "The block to write."),
        Port::optional("covariance", &[Kind::Covariance], "Its covariance; only Metashape's format holds some of it."),
        Port::optional("transform", &[Kind::Transform], "wall_from_world: the block is written in the world frame."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("files", &[Kind::Files], "The files.")];

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let (cameras, covariance) = in_frame(inputs, context)?;
        let (cameras, covariance) = (&*cameras, covariance.as_deref());
        let single = |name: &str, bytes: Vec<u8>| vec![(name.to_owned(), bytes)];
        let files = match params.format {
            Format::ColmapText => colmap_text::write(cameras)?,
            Format::ColmapBinary => colmap_binary::write(cameras)?,
            Format::Metashape => single("cameras.xml", metashape::write(cameras, covariance)?),
            Format::Bundler => bundler::write(cameras)?,
            Format::Json => single("cameras.json", cameras.encode().map_err(|e| StageError::new(e.to_string()))?),
        };
        match (covariance, params.format) {
            (Some(_), Format::Metashape) => {
                context.note("of the covariance the file has the blocks of single images and sensors only");
            }
            (Some(_), _) => context.note("this format holds no covariance: none of it is written"),
            (None, _) => {}
        }
        context.note(format!("{} images, {} sensors", cameras.images.len(), cameras.sensors.len()));
        Ok(Outputs::of("files", Files { files }))
    }
}

/// The block and its covariance in the frame they are written in: that of the world where the transform from it is given.
fn in_frame<'a>(
    inputs: &'a Inputs,
    context: &Context,
) -> Result<(Cow<'a, Cameras>, Option<Cow<'a, Covariance>>), StageError> {
    let cameras: &Cameras = inputs.one("cameras")?;
    let covariance: Option<&Covariance> = inputs.optional("covariance")?;
    let Some(wall_from_world) = inputs.optional::<Transform>("transform")? else {
        if cameras.frame == Frame::Wall && cameras.frame.wall_from_world().is_some_and(|way| !way.is_identity()) {
            context.note(
                "the block is written in the wall frame; with the input `transform` it is written in the world's",
            );
        }
        return Ok((Cow::Borrowed(cameras), covariance.map(Cow::Borrowed)));
    };
    if wall_from_world.to != cameras.frame.to_string() {
        let (to, frame) = (&wall_from_world.to, cameras.frame);
        let error =
            StageError::new(format!("the transform leads to the {to} frame, the cameras are in the {frame} frame"));
        return Err(error.hint("give the `transform` that `transform-crs` made, or leave it out"));
    }
    let back = wall_from_world.inverse();
    let covariance = covariance.map(|covariance| covariance_to_frame(covariance, &back, Frame::World)).transpose()?;
    Ok((Cow::Owned(cameras_to_frame(cameras, &back, Frame::World)), covariance.map(Cow::Owned)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::camera_files::recognise;
    use crate::camera::camera_files::recognise::Part;
    use rockface_core::artefact::{Artefact, Frame};
    use rockface_core::testing::{TestHost, image_at, run_stage, small_sensor};
    use serde_json::json;

    fn block() -> Cameras {
        let images =
            vec![image_at("a", [0.0, 0.0, 20.0], [0.1, 0.0, 0.3]), image_at("b", [7.0, 1.0, 20.0], [0.0, 0.2, 0.0])];
        Cameras { frame: Frame::Wall, sensors: vec![small_sensor()], images }
    }

    fn export(format: &str, cameras: Cameras) -> Result<Files, StageError> {
        let made = run_stage::<ExportCameras>(
            &TestHost::default(),
            &json!({"format": format}),
            &[("cameras", Artefact::Cameras(cameras))],
        )?;
        match made.into_inner().remove("files") {
            Some(Artefact::Files(files)) => Ok(files),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn every_format_is_known_again_by_the_importer() {
        for format in ["colmap-text", "colmap-binary", "metashape", "bundler", "json"] {
            let files = export(format, block()).unwrap();
            let decoded = Files::decode(&files.encode().unwrap()).unwrap();
            assert_eq!(decoded, files);
            let part =
                |(name, bytes): (String, Vec<u8>)| Some(Part { role: recognise::role(&name, &bytes)?, name, bytes });
            let parts: Vec<Part> = files.files.into_iter().filter_map(part).collect();
            let size = (format == "bundler").then_some([60, 40]);
            let again = recognise::read(&parts, Frame::Wall, size).unwrap().cameras;
            for (x, y) in block().images.iter().zip(&again.images) {
                assert!(x.name == y.name && (x.matrix() - y.matrix()).norm() < 1e-14, "{format}");
                assert!((x.centre() - y.centre()).norm() < 1e-13, "{format}");
            }
        }
    }

    #[test]
    fn a_block_goes_back_to_the_world() {
        let world = Cameras { frame: Frame::World, ..block() };
        let turn = nalgebra::Rotation3::from_euler_angles(0.3, -0.2, 1.1);
        let (origin, shift) = ([480_000.0, 5_150_000.0, 1200.0].into(), [0.5, 0.0, -1.0].into());
        let wall_from_world = Transform::new("world", "wall", turn.matrix(), origin, shift);
        let inputs = [
            ("cameras", Artefact::Cameras(cameras_to_frame(&world, &wall_from_world, Frame::Wall))),
            ("transform", Artefact::Transform(wall_from_world)),
        ];
        let run = |inputs: &[(&'static str, Artefact)]| {
            run_stage::<ExportCameras>(&TestHost::default(), &json!({"format": "json"}), inputs)
        };
        let Some(Artefact::Files(files)) = run(&inputs).unwrap().into_inner().remove("files") else {
            panic!("no files")
        };
        let back = Cameras::decode(&files.files[0].1).unwrap();
        assert_eq!(back.frame, Frame::World);
        for (x, y) in world.images.iter().zip(&back.images) {
            assert!((x.matrix() - y.matrix()).norm() < 1e-14 && (x.centre() - y.centre()).norm() < 1e-8);
        }
        let [_, transform] = inputs;
        let error = run(&[("cameras", Artefact::Cameras(world)), transform]).unwrap_err();
        assert!(error.message.contains("leads to the wall frame"), "{error}");
    }

    #[test]
    fn what_does_not_fit_is_refused_and_files_have_a_folder() {
        let mut skewed = block();
        skewed.sensors[0].b2 = 0.5;
        assert!(export("colmap-text", skewed).unwrap_err().message.contains("b2 = 0.5"));
        let exports = export("bundler", block()).unwrap().exports("files").unwrap();
        assert_eq!(exports[1].path, "files/list.txt");
    }
}
