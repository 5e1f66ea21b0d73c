//! `fuse-colmap`: COLMAP itself fuses depth maps, as the external program of the paper's configuration.

mod engine;

use serde_json::Value;

use crate::fusion::colmap_workspace;
use crate::fusion::colmap_workspace::Workspace;
use rockface_core::artefact::{Depth, Kind};
use rockface_core::params::{Fault, Range, deciding};
use rockface_core::program::ProgramResult;
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Ports, Stage, StageError, choice, fail, params};

choice! {
    /// How COLMAP is run.
    pub enum Engine {
        /// As the package pycolmap of a Python: `pip install pycolmap`.
        Pycolmap = "pycolmap",
        /// As the command-line program `colmap`.
        Colmap = "colmap",
    }
}

params! {
    /// A mesh by Poisson reconstruction; names as COLMAP has them.
    pub struct Poisson {
        /// Depth of the octree: cells are the size of the cloud over 2^depth.
        depth: u32 = 10; Range::Between(4.0, 16.0),
        /// Parts of the mesh with a density below this (a depth of the octree) are cut away; 0 keeps all. COLMAP's own 10 leaves
        /// nothing where the octree is not that deep.
        trim: f64 = 5.0; Range::NonNegative,
        /// Weight of the points against the smoothness of the surface.
        point_weight: f64 = 1.0; Range::NonNegative,
    }
}

params! {
    /// Parameters of `fuse-colmap`; those of the fusion have COLMAP's names, with a unit.
    pub struct FuseColmapParams {
        /// How COLMAP is run.
        engine: Engine = Engine::Pycolmap,
        /// The Python that has pycolmap, or the program: a name on the search path or an absolute path; null: `python3`, `colmap`.
        program: Option<String> = None,
        /// The version of COLMAP or pycolmap, such as `4.2.1`: part of what a result is known by, and checked.
        version: String,
        /// Fewest pixels that make a point; COLMAP's own 5 leaves nothing of a pair of images.
        min_num_pixels: u32 = 2; Range::AtLeast(1.0),
        /// Largest distance of a point from the pixel it is taken for, pixels of the depth maps.
        max_reproj_error_px: f64 = 2.0; Range::Positive,
        /// Largest share of the depth by which depths may differ.
        max_depth_error: f64 = 0.01; Range::Positive,
        /// Largest angle between normals, degrees.
        max_normal_error_deg: f64 = 10.0; Range::Positive,
        /// Most steps from image to image that a point is followed; from 3 on an image may add to a point twice.
        max_traversal_depth: u32 = 100; Range::AtLeast(1.0),
        /// Most images an image is compared with.
        check_num_images: u32 = 50; Range::AtLeast(1.0),
        /// Memory COLMAP may keep maps in, gigabytes; null: it keeps all of them (19 bytes a pixel).
        cache_gb: Option<f64> = None; Range::Positive,
        /// Side of the window that gives a pixel its normal, pixels of the depth maps: wide enough that noise does not turn normals
        /// by more than `max_normal_error_deg`.
        normal_window_px: u32 = 17; Range::Between(3.0, 101.0),
        /// A mesh of the points by Poisson reconstruction too, at the port `mesh`; null: none.
        poisson: Option<Poisson> = None,
    }
}

/// Fuses depth maps to a point cloud and, on request, a mesh by the external program COLMAP.
pub struct FuseColmap;

const CLOUD: Port =
    Port::one("cloud", &[Kind::Cloud], "The points, with normals; `views`: images each was fused from.");
const MESH: Port = Port::one("mesh", &[Kind::Mesh], "Their Poisson mesh; with `poisson` only.");

impl Stage for FuseColmap {
    type Params = FuseColmapParams;
    const NAME: &'static str = "fuse-colmap";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("fuse_colmap.md"));
    const INPUTS: &'static [Port] = &[Port::many("depths", &[Kind::Depth], "Depth maps of two images or more.")];
    const OUTPUTS: &'static [Port] = &[CLOUD, MESH];
    const STARTS_PROGRAMS: bool = true;

    fn ports(with: &Value) -> Result<Ports, Vec<Fault>> {
        const CLOUD_ONLY: &[Port] = &[CLOUD];
        let meshed = deciding(with, "poisson")?.is_some_and(|poisson| !poisson.is_null());
        Ok(Ports { inputs: Self::INPUTS, outputs: if meshed { Self::OUTPUTS } else { CLOUD_ONLY } })
    }

    fn check(params: &Self::Params) -> Vec<Fault> {
        let mut faults = Vec::new();
        let mut fault = |name: &str, text: &str| {
            faults.push(Fault { path: vec![name.to_owned()], ..Fault::new(text) });
        };
        if params.version.trim().is_empty() {
            fault("version", "say which version of COLMAP it is; it tells old results from new ones");
        }
        if params.program.as_ref().is_some_and(|program| program.contains('/') && !program.starts_with('/')) {
            fault(
                "program",
                "a relative path would be looked for in the folder it runs in: give an absolute one, or a name on the search path",
            );
        }
        // Densities go up to the depth and a little beyond.
        if let Some(poisson) = params.poisson.as_ref().filter(|poisson| poisson.trim >= f64::from(poisson.depth + 1)) {
            let (trim, depth) = (poisson.trim, poisson.depth);
            let text = format!("nothing is as dense as {trim} in an octree of depth {depth}: the mesh would be empty");
            faults.push(Fault { path: vec!["poisson".to_owned(), "trim".to_owned()], ..Fault::new(text) });
        }
        faults
    }

    /// Maps here, files for the program, and what it keeps of them itself.
    fn memory_bytes(_params: &Self::Params, inputs: &InputSizes) -> u64 {
        inputs.total().saturating_mul(12)
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let depths: Vec<&Depth> = inputs.many::<Depth>("depths")?.into_iter().map(|(_, depth)| depth).collect();
        let frame = colmap_workspace::frame_of(&depths)?;
        engine::check_version(params, context)?;
        context.check_cancelled()?;
        let Workspace { files, origin_m, tie_points, bounds } =
            colmap_workspace::lay_out(&depths, params.normal_window_px as usize / 2)?;
        context.metric("tie_points", tie_points as f64, "1");
        let result = engine::fuse(params, files, context)?;
        let (ply, vis) = (made(engine::FUSED, &result)?, made(engine::VISIBILITY, &result)?);
        let cloud = colmap_workspace::read(ply, vis, frame, origin_m, &bounds)?;
        let views = &cloud.numbers["views"];
        let mean_views = views.iter().map(|views| f64::from(*views)).sum::<f64>() / views.len() as f64;
        context.metric("points", cloud.points.len() as f64, "1");
        context.metric("views_mean", mean_views, "1");
        let mut summary = format!("{} depth maps, {} points", depths.len(), cloud.points.len());
        let mut outputs = Outputs::of("cloud", cloud);
        if params.poisson.is_some() {
            let mesh = colmap_workspace::read_mesh(made(engine::MESHED, &result)?, frame, origin_m, &bounds)?;
            context.metric("triangles", mesh.triangles.len() as f64, "1");
            summary += &format!(", {} triangles", mesh.triangles.len());
            outputs = outputs.and("mesh", mesh);
        }
        context.headline(summary);
        Ok(outputs)
    }
}

fn made<'a>(name: &str, result: &'a ProgramResult) -> Result<&'a [u8], StageError> {
    let Some(bytes) = result.outputs.get(name) else {
        fail!("COLMAP ended without an error and without making `{name}`; what it said is in the log of the step");
    };
    Ok(bytes)
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // to the bit
mod tests;
