//! `fuse-volume`: the mesh that many depth maps agree on, overhangs and all.

use crate::artefact::{Depth, Kind};
use crate::kernel::volume::blocks::{Layout, VOXELS, Volume, near};
use crate::kernel::volume::integration::integrate;
use crate::kernel::volume::surface::extract;
use crate::params::{Fault, Range};
use crate::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};

params! {
    /// Parameters of `fuse-volume`.
    pub struct FuseVolumeParams {
        /// Side of a voxel, metres.
        voxel_m: f64 = 0.01; Range::Positive,
        /// Distance from a measured surface at which distances are cut off, metres; null: three voxels, or three times the mean of
        /// the channel `sigma` of the depth maps where that is more.
        truncation_m: Option<f64> = None; Range::Positive,
        /// Fewest depth maps that must have seen a voxel.
        min_images: u32 = 2; Range::Between(1.0, 255.0),
        /// Fewest triangles of a connected piece.
        min_component_triangles: u32 = 100,
        /// Window (left, right, bottom, top) in metres that points must lie in; null: everywhere.
        window_m: Option<[f64; 4]> = None,
    }
}

/// Voxels a truncation may have.
const MAXIMUM_TRUNCATION: f64 = 50.0;
/// Blocks a volume may have: 9 GB.
const MAXIMUM_BLOCKS: usize = 2_000_000;

/// The stage.
pub struct FuseVolume;

impl Stage for FuseVolume {
    type Params = FuseVolumeParams;
    const NAME: &'static str = "fuse-volume";
    const VERSION: u32 = 1;
    const PAGE: Page = Page {
        what: "Fuses depth maps to one triangle mesh in space: what hangs over stays, and what one image hides another may show.",
        method: "Truncated signed distances along the rays, averaged by weight in voxels (Curless and Levoy 1996), kept in blocks of \
                 8 x 8 x 8 voxels near measured surfaces only (Niessner et al. 2013); the surface by marching cubes (Lorensen and \
                 Cline 1987) with faces cut alike from both sides. Weights are 1 / sigma^2 where the depth maps have a channel \
                 `sigma` (`match-image`), else all maps count the same. Internal fusion of the paper (2.1.2, Algorithm 2 lines 28 to 30).",
        frames: "The frame of the depth maps' cameras, metres; triangles are counter-clockwise seen from the cameras' side. Depth maps \
                 are added in the order of the input.",
        fails: "Depth maps in different frames; some with a channel `sigma` and some without; none with a depth in the window; more than \
                two million blocks (enlarge voxel_m or truncation_m is too large); no surface that min_images saw.",
        example: "\
rockface: 1
name: mesh-of-a-block
seed: 1
axes:
  image: {items: [left, right]}
steps:
  face:   {stage: synthesise-face, with: {width_m: 4, height_m: 3}}
  survey: {stage: plan-survey, in: {mesh: face.mesh}}
  depth:  {stage: project-depth, in: {mesh: face.mesh, cameras: survey.cameras}, with: {image: \"${image}\", downscale: 4}}
  mesh:   {stage: fuse-volume, in: {depths: {each: depth.depth, over: [image]}}, with: {voxel_m: 0.04}}
",
    };
    const INPUTS: &'static [Port] = &[Port::many("depths", &[Kind::Depth], "Depth maps, one or more.")];
    const OUTPUTS: &'static [Port] = &[Port::one("mesh", &[Kind::Mesh], "The fused surface.")];

    fn check(params: &Self::Params) -> Vec<Fault> {
        if let Some(truncation_m) = params.truncation_m.filter(|t| *t > MAXIMUM_TRUNCATION * params.voxel_m) {
            let text = format!("{truncation_m} m is more than {MAXIMUM_TRUNCATION} voxels of {} m", params.voxel_m);
            return vec![Fault { path: vec!["truncation_m".into()], ..Fault::new(text) }];
        }
        match params.window_m {
            Some([left, right, bottom, top]) if !(left < right && bottom < top) => {
                let text =
                    format!("[{left}, {right}, {bottom}, {top}] is empty; the order is left, right, bottom, top");
                vec![Fault { path: vec!["window_m".into()], ..Fault::new(text) }]
            }
            _ => Vec::new(),
        }
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let depths: Vec<&Depth> = inputs.many::<Depth>("depths")?.into_iter().map(|(_, depth)| depth).collect();
        let has_sigma = check_alike(&depths)?;
        let truncation_m = params.truncation_m.unwrap_or_else(|| truncation_m(&depths, params.voxel_m));
        let layout = Layout { voxel_m: params.voxel_m, truncation_m, window_m: params.window_m };
        let mut volume = allocate(&depths, layout, context)?;
        for depth in &depths {
            context.check_cancelled()?;
            integrate(&mut volume, depth, has_sigma.then(|| depth.channels["sigma"].as_slice()));
        }
        let pieces = params.min_component_triangles as usize;
        let mesh = extract(&volume, depths[0].frame, params.min_images as u8, pieces);
        if mesh.triangles.is_empty() {
            let (n, least) = (depths.len(), params.min_images);
            return Err(StageError::new(format!("{n} depth maps leave no surface that {least} of them saw")).hint(
                "lower `min_images` or `min_component_triangles`, or raise `truncation_m` if the maps lie apart",
            ));
        }
        context.metric("blocks", volume.keys.len() as f64, "1");
        context.metric("truncation", truncation_m, "m");
        context.metric("triangles", mesh.triangles.len() as f64, "1");
        context.headline(format!(
            "{} depth maps, {} blocks of {} voxels, {} triangles",
            depths.len(),
            volume.keys.len(),
            VOXELS,
            mesh.triangles.len()
        ));
        Ok(Outputs::of("mesh", mesh))
    }
}

/// Whether all depth maps have a channel `sigma`; an error where only some do, or where frames differ.
fn check_alike(depths: &[&Depth]) -> Result<bool, StageError> {
    let frame = depths[0].frame;
    if let Some(other) = depths.iter().find(|depth| depth.frame != frame) {
        let (name, found) = (&other.image.name, other.frame);
        fail!("the depth map of image `{name}` is in the {found} frame, the first one in the {frame} frame");
    }
    let with = depths.iter().filter(|depth| depth.channels.contains_key("sigma")).count();
    if with != 0 && with != depths.len() {
        let text = format!("{with} of {} depth maps have a channel `sigma`: they cannot be weighed", depths.len());
        return Err(StageError::new(text).hint("make all of them by one stage with the same channels"));
    }
    Ok(with > 0)
}

/// Three voxels, or three times the mean sigma of the maps.
fn truncation_m(depths: &[&Depth], voxel_m: f64) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for sigma in depths.iter().filter_map(|depth| depth.channels.get("sigma")) {
        for value in sigma.iter().filter(|value| value.is_finite()) {
            (sum, count) = (sum + f64::from(*value), count + 1);
        }
    }
    (3.0 * voxel_m).max(3.0 * sum / count.max(1) as f64).min(MAXIMUM_TRUNCATION * voxel_m)
}

fn allocate(depths: &[&Depth], layout: Layout, context: &Context) -> Result<Volume, StageError> {
    let mut keys = Vec::new();
    for depth in depths {
        context.check_cancelled()?;
        keys.extend(near(depth, &layout));
        keys.sort_unstable();
        keys.dedup();
        if keys.len() > MAXIMUM_BLOCKS {
            let (voxel, truncation) = (layout.voxel_m, layout.truncation_m);
            let text = format!(
                "voxels of {voxel} m and a truncation of {truncation} m need more than {MAXIMUM_BLOCKS} blocks"
            );
            return Err(StageError::new(text).hint("enlarge `voxel_m`, or narrow `truncation_m` or `window_m`"));
        }
    }
    if keys.is_empty() {
        let error = StageError::new(format!("none of {} depth maps has a depth in the window", depths.len()));
        return Err(error.hint("are the maps empty? if not, widen `window_m`"));
    }
    Ok(Volume::new(layout, keys))
}

#[cfg(test)]
#[path = "fuse_volume_tests.rs"]
mod tests;
