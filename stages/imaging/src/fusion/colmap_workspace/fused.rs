//! The results of COLMAP for a workspace, transformed to the frame of its depth maps and checked.

use nalgebra::Vector3;

use rockface_core::artefact::{Cloud, Frame, Mesh};
use rockface_core::format::ply;
use rockface_core::format::ply::cloud;
use rockface_core::{StageError, fail};

/// Share of the largest depth by which points may lie beyond the box: the lattice it is made from misses the rims.
const MARGIN: f64 = 0.05;
/// Share of the points that may lie outside the box.
const STRAY: f64 = 0.01;

/// A box that points must lie in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    low: Vector3<f64>,
    high: Vector3<f64>,
    depth_m: f64,
}

impl Default for Bounds {
    fn default() -> Self {
        let (low, high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
        Self { low, high, depth_m: 0.0 }
    }
}

impl Bounds {
    /// Extends the box by a point seen at a depth.
    pub fn include(&mut self, point: &Vector3<f64>, depth_m: f64) {
        self.low = self.low.inf(point);
        self.high = self.high.sup(point);
        self.depth_m = self.depth_m.max(depth_m);
    }

    /// The same box relative to another origin.
    #[must_use]
    pub fn from(self, origin: &Vector3<f64>) -> Self {
        Self { low: self.low + origin, high: self.high + origin, ..self }
    }

    fn holds(&self, point: &[f64; 3]) -> bool {
        let margin = MARGIN * self.depth_m;
        (0..3).all(|axis| (self.low[axis] - margin..=self.high[axis] + margin).contains(&point[axis]))
    }

    /// Fails where too many points lie outside of the box.
    fn check<'a>(&self, what: &str, points: impl Iterator<Item = &'a [f64; 3]>) -> Result<(), StageError> {
        let (mut count, mut stray, mut first) = (0usize, 0usize, None);
        for point in points {
            count += 1;
            if !self.holds(point) {
                stray += 1;
                first = first.or(Some(*point));
            }
        }
        match first {
            Some([x, y, z]) if stray as f64 > STRAY * count as f64 => Err(StageError::new(format!(
                "{stray} of {count} points of {what} lie outside what the depth maps see, the first at ({x:.3}, {y:.3}, {z:.3}) m"
            ))
            .hint("is it the version of COLMAP that `version` names? its formats may have changed")),
            _ => Ok(()),
        }
    }
}

/// Reads `fused.ply` and `fused.ply.vis`: points and normals in the frame of the depth maps, and in `views` how many images
/// each point was fused from. The grey of the pictures is left out.
///
/// # Errors
/// Files that cannot be read or do not fit each other, no points, points that lie where no depth map saw anything.
pub fn read(ply: &[u8], vis: &[u8], frame: Frame, origin_m: [f64; 3], bounds: &Bounds) -> Result<Cloud, StageError> {
    let mut cloud = cloud::read(ply).map_err(|e| StageError::new(format!("the cloud COLMAP made: {e}")))?;
    if cloud.points.is_empty() {
        return Err(StageError::new("COLMAP fused no point").hint(
            "the maps agree nowhere: lower `min_num_pixels` (2 for a pair), raise `max_depth_error` and \
             `max_normal_error_deg`, widen `normal_window_px` where depths are noisy",
        ));
    }
    cloud.frame = frame;
    cloud.colours = Vec::new();
    shift(&mut cloud.points, origin_m);
    let views = views(vis, cloud.points.len())?;
    cloud.numbers = std::iter::once(("views".to_owned(), views)).collect();
    bounds.check("the cloud", cloud.points.iter())?;
    Ok(cloud)
}

/// Reads the mesh of `poisson_mesher`, in the frame of the depth maps.
///
/// # Errors
/// A file that cannot be read; no triangles: it trims what is sparser than `trim`; triangles far from the points.
pub fn read_mesh(ply: &[u8], frame: Frame, origin_m: [f64; 3], bounds: &Bounds) -> Result<Mesh, StageError> {
    let mut mesh = ply::read_mesh(ply).map_err(|e| StageError::new(format!("the mesh COLMAP made: {e}")))?;
    if mesh.triangles.is_empty() {
        return Err(StageError::new("the Poisson mesh is empty: no part of it is as dense as `trim` asks")
            .hint("lower `trim`; it may not exceed the octree depth that the points support, and 5 mostly does"));
    }
    mesh.frame = frame;
    mesh.colours = Vec::new();
    shift(&mut mesh.vertices, origin_m);
    bounds.check("the Poisson mesh", mesh.vertices.iter())?;
    Ok(mesh)
}

fn shift(points: &mut [[f64; 3]], origin_m: [f64; 3]) {
    points.iter_mut().for_each(|p| *p = [p[0] + origin_m[0], p[1] + origin_m[1], p[2] + origin_m[2]]);
}

/// Images of each point: a count of 64 bits, then for each point a count of 32 bits and as many numbers of images.
fn views(vis: &[u8], points: usize) -> Result<Vec<u32>, StageError> {
    let fault = |what: &str| StageError::new(format!("the visibility file COLMAP made {what}"));
    let (count, mut rest) = vis.split_first_chunk().ok_or_else(|| fault("has no count"))?;
    if u64::from_le_bytes(*count) != points as u64 {
        fail!("the visibility file COLMAP made has {} points, its cloud {points}", u64::from_le_bytes(*count));
    }
    let mut views = Vec::with_capacity(points);
    for _ in 0..points {
        let (count, after) = rest.split_first_chunk().ok_or_else(|| fault("is cut short"))?;
        let count = u32::from_le_bytes(*count);
        rest = after.get(4 * count as usize..).ok_or_else(|| fault("is cut short"))?;
        views.push(count);
    }
    Ok(views)
}
