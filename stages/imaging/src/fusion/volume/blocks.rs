//! Blocks of 8 x 8 x 8 voxels near measured surfaces.
//!
//! Voxel (i, j, k) stands at (i, j, k) times the voxel's side, for any whole numbers; block (a, b, c) holds the voxels from
//! 8 (a, b, c) on. Within a block i runs fastest.

use std::collections::HashMap;

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::camera::model::Camera;
use crate::camera::ray_row::RayRow;
use rockface_core::artefact::Depth;

/// Voxels along a side of a block.
pub const SIDE: i32 = 8;
/// Voxels of a block.
pub const VOXELS: usize = 512;
/// Rows of the depth map of one task.
const ROWS: usize = 64;
/// Rays this many voxels apart, and twice as much around them, leave no block out.
const RAY_SPACING: f64 = 3.0;

/// The position of a block, in blocks.
pub type Key = [i32; 3];

/// Geometry of a volume.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layout {
    /// Side of a voxel, metres.
    pub voxel_m: f64,
    /// Distance from a surface at which distances end, metres.
    pub truncation_m: f64,
    /// Window of the points that are fused: X from, to, Y from, to, metres.
    pub window_m: Option<[f64; 4]>,
}

/// Sums of weighted distances; the blocks are sorted by their keys.
#[derive(Debug, Clone)]
pub struct Volume {
    /// Size of the voxels, truncation and window.
    pub layout: Layout,
    /// Places of the blocks, ascending.
    pub keys: Vec<Key>,
    /// Number of a block by its place.
    pub numbers: HashMap<Key, u32>,
    /// Sum of weight times distance (in truncations, -1 to 1, positive before the surface), [`VOXELS`] a block.
    pub distance: Vec<f32>,
    /// Sum of the weights of each voxel, in the order of `distance`.
    pub weight: Vec<f32>,
    /// Maps that contributed, 255 at most.
    pub maps: Vec<u8>,
}

impl Volume {
    /// An empty volume with these blocks.
    pub fn new(layout: Layout, mut keys: Vec<Key>) -> Self {
        keys.sort_unstable();
        keys.dedup();
        let numbers = keys.iter().enumerate().map(|(i, key)| (*key, i as u32)).collect();
        let voxels = keys.len() * VOXELS;
        Self { layout, keys, numbers, distance: vec![0.0; voxels], weight: vec![0.0; voxels], maps: vec![0; voxels] }
    }
}

/// The blocks within the truncation of the surface of a depth map.
pub fn near(depth: &Depth, layout: &Layout) -> Vec<Key> {
    let camera = Camera::of_depth(depth);
    let nearest_m = depth.z.iter().filter(|z| Depth::is_seen(**z)).fold(f32::INFINITY, |a, z| a.min(*z));
    if !nearest_m.is_finite() {
        return Vec::new();
    }
    // The farthest pixel has the widest spacing, but a map of one face spans few distances.
    let farthest_m = depth.z.iter().filter(|z| z.is_finite()).fold(0.0f32, |a, z| a.max(*z));
    let pixel_m = f64::from(farthest_m) / depth.sensor.f * f64::from(depth.downscale);
    let stride = ((RAY_SPACING * layout.voxel_m / pixel_m) as usize).max(1);
    let tasks = (0..depth.height).step_by(ROWS).collect::<Vec<_>>();
    let mut blocks: Vec<Key> = tasks
        .into_par_iter()
        .flat_map_iter(|first| {
            let mut keys = Vec::new();
            let rows = first..depth.height.min(first + ROWS);
            for row in rows.filter(|row| row % stride == 0) {
                walk(depth, &camera, layout, row, stride, &mut keys);
            }
            keys.sort_unstable();
            keys.dedup();
            keys
        })
        .collect();
    blocks.par_sort_unstable();
    blocks.dedup();
    blocks
}

fn walk(depth: &Depth, camera: &Camera, layout: &Layout, row: usize, stride: usize, keys: &mut Vec<Key>) {
    let block_m = layout.voxel_m * f64::from(SIDE);
    let margin = Vector3::repeat(2.0 * RAY_SPACING * layout.voxel_m);
    let steps = (2.0 * layout.truncation_m / (0.5 * block_m)).ceil().max(1.0) as i32;
    let mut rays = RayRow::new(camera, row, depth.downscale);
    let mut last = vec![([i32::MIN; 3], [i32::MIN; 3]); steps as usize + 1];
    for column in (0..depth.width).step_by(stride) {
        let z = depth.z[row * depth.width + column];
        let Some(ray) = rays.ray(column).filter(|_| Depth::is_seen(z)) else { continue };
        let z = f64::from(z);
        let direction = camera.direction(ray).normalize();
        let point = camera.unproject(ray, z);
        let inside =
            layout.window_m.is_none_or(|[a, b, c, d]| (a..=b).contains(&point.x) && (c..=d).contains(&point.y));
        if !inside {
            continue;
        }
        for (step, last) in last.iter_mut().enumerate() {
            let along = layout.truncation_m * (2.0 * step as f64 / f64::from(steps) - 1.0);
            let at = point + direction * along;
            let key = |p: Vector3<f64>| -> Key { (p / block_m).map(|x| x.floor() as i32).into() };
            let range = (key(at - margin), key(at + margin));
            if range != *last {
                *last = range;
                push_all(range, keys);
            }
        }
    }
}

fn push_all((low, high): (Key, Key), keys: &mut Vec<Key>) {
    for a in low[0]..=high[0] {
        for b in low[1]..=high[1] {
            keys.extend((low[2]..=high[2]).map(|c| [a, b, c]));
        }
    }
}
