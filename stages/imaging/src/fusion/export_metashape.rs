//! `export-metashape`: a folder from which Agisoft Metashape builds a mesh of depth maps made here.

use crate::fusion::metashape_project::{Project, lay_out};
use rockface_core::artefact::{Depth, Files, Kind};
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};

params! {
    /// Parameters of `export-metashape`.
    pub struct ExportMetashapeParams {}
}

/// The stage.
pub struct ExportMetashape;

impl Stage for ExportMetashape {
    type Params = ExportMetashapeParams;
    const NAME: &'static str = "export-metashape";
    const VERSION: u32 = 1;
    const PAGE: Page = Page {
        what: "Lays out depth maps for Agisoft Metashape Professional: depth images, pictures, cameras, and a Python script that imports \
               them, builds a mesh from the depth maps and writes it. `import-mesh` takes the mesh back. The run's folder has the files in \
               a folder of the port's name, with a README.",
        method: "Paper 2.1.2, Algorithm 2 lines 28 to 30: external fusion. Maps are carried to cameras without distortion as in \
                 `fuse-colmap`. Depth images: float32 TIFF, one channel, z along the optical axis, for Metashape's importDepthImages. Cameras \
                 as by `export-cameras`. The script checks that Metashape took every picture, orientation and calibration.",
        frames: "Metres in the frame of the depth maps; beyond 10 km from the origin coordinates count from a corner that README.txt names, as \
                 single precision would lose millimetres there. 0 is no depth.",
        fails: "Depth maps are in different frames; an image has a name that XML cannot hold.",
        example: "\
rockface: 1
name: maps-for-metashape
seed: 1
axes:
  image: {items: [left, right]}
steps:
  face:   {stage: synthesise-face, with: {width_m: 4, height_m: 3}}
  survey: {stage: plan-survey, in: {mesh: face.mesh}}
  depth:  {stage: project-depth, in: {mesh: face.mesh, cameras: survey.cameras}, with: {image: \"${image}\", downscale: 8}}
  folder: {stage: export-metashape, in: {depths: {each: depth.depth, over: [image]}}}
",
    };
    const INPUTS: &'static [Port] = &[Port::many("depths", &[Kind::Depth], "Depth maps, one an image.")];
    const OUTPUTS: &'static [Port] = &[Port::one("files", &[Kind::Files], "The folder.")];

    fn memory_bytes(_params: &Self::Params, inputs: &InputSizes) -> u64 {
        inputs.total().saturating_mul(6)
    }

    fn run(_params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let depths: Vec<&Depth> = inputs.many::<Depth>("depths")?.into_iter().map(|(_, depth)| depth).collect();
        let Some(first) = depths.first() else { fail!("there is no depth map to export") };
        if let Some(other) = depths.iter().find(|depth| depth.frame != first.frame) {
            let (name, found, frame) = (&other.image.name, other.frame, first.frame);
            fail!("the depth map of image `{name}` is in the {found} frame, the first one in the {frame} frame");
        }
        let Project { files, origin_m } = lay_out(&depths, first.frame)?;
        if origin_m.iter().any(|x| *x != 0.0) {
            let [x, y, z] = origin_m;
            context.note(format!("coordinates count from ({x}, {y}, {z}): give this as `offset_m` to `import-mesh`"));
        }
        context.headline(format!("{} depth maps for Metashape; README.txt says how to go on", depths.len()));
        Ok(Outputs::of("files", Files { files }))
    }
}
