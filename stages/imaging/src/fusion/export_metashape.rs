//! `export-metashape`: a folder from which Agisoft Metashape builds a mesh of depth maps made here.

use crate::fusion::metashape_project::{Project, lay_out};
use rockface_core::artefact::{Depth, Files, Kind};
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};

params! {
    /// Parameters of `export-metashape`.
    pub struct ExportMetashapeParams {}
}

/// Writes depth maps as a folder that Agisoft Metashape Professional can import.
pub struct ExportMetashape;

impl Stage for ExportMetashape {
    type Params = ExportMetashapeParams;
    const NAME: &'static str = "export-metashape";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("export_metashape.md"));
    const INPUTS: &'static [Port] = &[Port::many("depths", &[Kind::Depth], "Depth maps, one an image.")];
    const OUTPUTS: &'static [Port] = &[Port::one("files", &[Kind::Files], "The folder.")];

    fn memory_bytes(_params: &Self::Params, inputs: &InputSizes) -> u64 {
        inputs.total().saturating_mul(6)
    }

    fn run(_params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let depths: Vec<&Depth> = inputs.many::<Depth>("depths")?.into_iter().map(|(_, depth)| depth).collect();
        let Some(first) = depths.first() else { fail!("there is no depth map to export") };
        if let Some(other) = depths.iter().find(|depth| depth.frame != first.frame) {
            let (name, other, frame) = (&other.image.name, other.frame, first.frame);
            fail!("the depth map of image `{name}` is in the {other} frame, the first one in the {frame} frame");
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
