//! The folder that COLMAP's fusion of depth maps works on, laid out as its dense code reads it, and the cloud it makes.
//!
//! Undocumented requirements of its dense code: cameras without distortion only (`PINHOLE`; further terms are silently
//! ignored), principal points counted from the centre of the first pixel where its sparse code counts from the corner, depths
//! of 0 where there is none, normals in the camera frame as three planes one after the other, a picture for every image, and
//! points of the sparse model seen by both images of every pair that is to be fused, or there is nothing to fuse.

mod files;
mod fused;
mod tie_points;

use nalgebra::Vector3;

use self::tie_points::tie_points;
use crate::camera::pinhole::PinholeMap;
use rockface_core::artefact::{Depth, Frame};
use rockface_core::{StageError, fail};

pub use fused::{Bounds, read, read_mesh};

/// Multiple to which the origin of the coordinates is rounded, metres; COLMAP works in single precision.
const ORIGIN_STEP_M: f64 = 100.0;

/// A folder for COLMAP.
pub struct Workspace {
    /// Path in the folder and content of each file.
    pub files: Vec<(String, Vec<u8>)>,
    /// Origin of its coordinates in the frame of the depth maps, metres.
    pub origin_m: [f64; 3],
    /// Points of the sparse model.
    pub tie_points: usize,
    /// Box in which its points must lie, in the frame of the depth maps.
    pub bounds: Bounds,
}

/// An image of the workspace.
struct View<'a> {
    depth: &'a Depth,
    map: PinholeMap,
    /// Projection centre from the origin of the workspace, metres.
    centre_m: Vector3<f64>,
}

/// The frame of the depth maps, which must be the same.
///
/// # Errors
/// Fewer than two depth maps, or two frames.
pub fn frame_of(depths: &[&Depth]) -> Result<Frame, StageError> {
    let [first, _, ..] = depths else {
        return Err(StageError::new(format!("{} depth maps: COLMAP fuses what several images see", depths.len()))
            .hint("gather them: `depths: {each: matched.depth, over: [image]}`; one map alone is a surface by `fuse-depth`"));
    };
    for other in depths {
        if other.frame != first.frame {
            let (name, other, frame) = (&other.image.name, other.frame, first.frame);
            fail!("the depth map of image `{name}` is in the {other} frame, the first one in the {frame} frame");
        }
    }
    Ok(first.frame)
}

/// Lays out the folder; normals are found in windows of `2 normal_reach + 1` pixels a side.
///
/// # Errors
/// No two depth maps see a point in common.
pub fn lay_out(depths: &[&Depth], normal_reach: usize) -> Result<Workspace, StageError> {
    let mean = depths.iter().map(|depth| depth.image.centre()).sum::<Vector3<f64>>() / depths.len() as f64;
    let origin = mean.map(|x| (x / ORIGIN_STEP_M).round() * ORIGIN_STEP_M);
    let view = |depth: &&'_ Depth| (PinholeMap::of(depth), depth.image.centre() - origin);
    let views: Vec<View> = depths
        .iter()
        .map(|depth| {
            let (map, centre_m) = view(depth);
            View { depth, map, centre_m }
        })
        .collect();
    let (ties, bounds) = tie_points(&views);
    if ties.is_empty() {
        let text = format!("no two of {} depth maps see a point in common: there is nothing to fuse", views.len());
        return Err(StageError::new(text).hint("do the images overlap, and are the maps filled?"));
    }
    let mut files = files::sparse_model(&views, &ties);
    for (number, view) in views.iter().enumerate() {
        files.extend(files::dense_maps(number, &view.map, normal_reach)?);
    }
    files.push((
        "stereo/fusion.cfg".to_owned(),
        (0..views.len()).map(|n| files::image_name(n) + "\n").collect::<String>().into_bytes(),
    ));
    Ok(Workspace { files, origin_m: origin.into(), tie_points: ties.len(), bounds: bounds.from(&origin) })
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // to the bit
mod tests;
