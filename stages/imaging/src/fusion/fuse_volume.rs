//! `fuse-volume`: fuses many depth maps to one mesh, with overhangs.

use crate::fusion::volume::blocks::{Layout, VOXELS, Volume, near};
use crate::fusion::volume::integration::integrate;
use crate::fusion::volume::surface::extract;
use rockface_core::artefact::{Depth, Frame, Kind};
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};
use rockface_raster::window;

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

/// Most voxels of a truncation.
const MAXIMUM_TRUNCATION: f64 = 50.0;
/// Most blocks of a volume: 9 GB.
const MAXIMUM_BLOCKS: usize = 2_000_000;

/// Fuses depth maps to one triangle mesh in space.
pub struct FuseVolume;

impl Stage for FuseVolume {
    type Params = FuseVolumeParams;
    const NAME: &'static str = "fuse-volume";
    const VERSION: u32 = 3;
    const PAGE: Page = Page::new(include_str!("fuse_volume.md"));
    const INPUTS: &'static [Port] = &[Port::many("depths", &[Kind::Depth], "Depth maps, one or more.")];
    const OUTPUTS: &'static [Port] = &[Port::one("mesh", &[Kind::Mesh], "The fused surface.")];

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        // The depth maps that are held (one at a time where they are not); the volume and its mesh, going by a surface a few
        // images wide at voxels of about two pixels.
        inputs.total() + 32 * inputs.largest("depths")
    }

    fn check(params: &Self::Params) -> Vec<Fault> {
        if let Some(truncation_m) = params.truncation_m.filter(|t| *t > MAXIMUM_TRUNCATION * params.voxel_m) {
            let text = format!("{truncation_m} m is more than {MAXIMUM_TRUNCATION} voxels of {} m", params.voxel_m);
            return vec![Fault { path: vec!["truncation_m".into()], ..Fault::new(text) }];
        }
        window::faults(params.window_m)
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let facts = Facts::gather(inputs, params.truncation_m.is_none(), context)?;
        let truncation_m = params.truncation_m.unwrap_or_else(|| facts.truncation_m(params.voxel_m));
        let layout = Layout { voxel_m: params.voxel_m, truncation_m, window_m: params.window_m };
        let mut volume = allocate(inputs, layout, context)?;
        for index in 0..facts.maps {
            context.check_cancelled()?;
            let add = |depth: &Depth| integrate(&mut volume, depth, depth.channels.get("sigma").map(Vec::as_slice));
            inputs.visit("depths", index, add)?;
        }
        let pieces = params.min_component_triangles as usize;
        let mesh = extract(&volume, facts.frame, params.min_images as u8, pieces);
        if mesh.triangles.is_empty() {
            let (n, least) = (facts.maps, params.min_images);
            return Err(StageError::new(format!("{n} depth maps leave no surface that {least} of them saw")).hint(
                "lower `min_images` or `min_component_triangles`, or raise `truncation_m` if the maps lie apart",
            ));
        }
        context.metric("blocks", volume.keys.len() as f64, "1");
        context.metric("truncation", truncation_m, "m");
        context.metric("triangles", mesh.triangles.len() as f64, "1");
        context.headline(format!(
            "{} depth maps, {} blocks of {} voxels, {} triangles",
            facts.maps,
            volume.keys.len(),
            VOXELS,
            mesh.triangles.len()
        ));
        Ok(Outputs::of("mesh", mesh))
    }
}

/// Figures of all depth maps that are needed before the first one is added.
struct Facts {
    maps: usize,
    frame: Frame,
    /// Maps with a channel `sigma`.
    with_sigma: usize,
    /// Sum of all sigmas, metres, and how many there are.
    sigma: (f64, usize),
}

impl Facts {
    /// Scans one depth map after the other; their sigmas only if needed.
    fn gather(inputs: &Inputs, sigmas: bool, context: &Context) -> Result<Self, StageError> {
        let maps = inputs.elements("depths").len();
        let mut facts = Self { maps, frame: Frame::Wall, with_sigma: 0, sigma: (0.0, 0) };
        for index in 0..maps {
            context.check_cancelled()?;
            inputs.visit("depths", index, |depth: &Depth| facts.add(index, depth, sigmas))??;
        }
        if facts.with_sigma != 0 && facts.with_sigma != maps {
            let with = facts.with_sigma;
            let text = format!("{with} of {maps} depth maps have a channel `sigma`: they cannot be weighed");
            return Err(StageError::new(text).hint("make all of them by one stage with the same channels"));
        }
        Ok(facts)
    }

    fn add(&mut self, index: usize, depth: &Depth, sigmas: bool) -> Result<(), StageError> {
        if index == 0 {
            self.frame = depth.frame;
        } else if self.frame != depth.frame {
            let (name, frame, first) = (&depth.image.name, depth.frame, self.frame);
            fail!("the depth map of image `{name}` is in the {frame} frame, the first one in the {first} frame");
        }
        let Some(sigma) = depth.channels.get("sigma") else { return Ok(()) };
        self.with_sigma += 1;
        for value in sigma.iter().filter(|value| sigmas && value.is_finite()) {
            self.sigma = (self.sigma.0 + f64::from(*value), self.sigma.1 + 1);
        }
        Ok(())
    }

    /// Three voxels, or three times the mean sigma of the maps.
    fn truncation_m(&self, voxel_m: f64) -> f64 {
        let (sum, count) = self.sigma;
        (3.0 * voxel_m).max(3.0 * sum / count.max(1) as f64).min(MAXIMUM_TRUNCATION * voxel_m)
    }
}

fn allocate(inputs: &Inputs, layout: Layout, context: &Context) -> Result<Volume, StageError> {
    let (mut keys, maps) = (Vec::new(), inputs.elements("depths").len());
    for index in 0..maps {
        context.check_cancelled()?;
        keys.extend(inputs.visit("depths", index, |depth: &Depth| near(depth, &layout))?);
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
        let error = StageError::new(format!("none of {maps} depth maps has a depth in the window"));
        return Err(error.hint("are the maps empty? if not, widen `window_m`"));
    }
    Ok(Volume::new(layout, keys))
}

#[cfg(test)]
mod tests;
