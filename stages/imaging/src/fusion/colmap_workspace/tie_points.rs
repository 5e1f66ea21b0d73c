//! Points that several depth maps see: COLMAP takes the overlap of images from them.

use nalgebra::Vector3;

use super::View;
use super::fused::Bounds;

/// Probed pixels along the longer side of a map.
const LATTICE: usize = 32;
/// Share of the depth by which two maps may differ about a point that both see.
const AGREEMENT: f64 = 0.02;

/// A point and the images that see it.
pub struct TiePoint {
    /// From the origin of the workspace, metres.
    pub point_m: Vector3<f64>,
    /// Image, and the position in it, pixels from the centre of the first.
    pub seen: Vec<(usize, [f64; 2])>,
}

/// Points of a lattice of pixels in every map that at least one other map sees, and the box around all of the lattices.
pub fn tie_points(views: &[View]) -> (Vec<TiePoint>, Bounds) {
    let (mut ties, mut bounds) = (Vec::new(), Bounds::default());
    for (this, view) in views.iter().enumerate() {
        let (width, height) = (view.map.width, view.map.height);
        let step = width.max(height).div_ceil(LATTICE);
        for row in (step / 2..height).step_by(step) {
            for column in (step / 2..width).step_by(step) {
                let z_m = f64::from(view.map.z[row * width + column]);
                if !z_m.is_finite() {
                    continue;
                }
                let position = [column as f64, row as f64];
                let [x, y] = view.map.ray(position);
                let rotation = view.depth.image.matrix();
                let point_m = view.centre_m + rotation.tr_mul(&Vector3::new(x * z_m, y * z_m, z_m));
                bounds.include(&point_m, z_m);
                let others = (0..views.len()).filter(|other| *other != this);
                let others = others.filter_map(|other| Some((other, sees(&views[other], &point_m)?)));
                let seen: Vec<_> = std::iter::once((this, position)).chain(others).collect();
                if seen.len() > 1 {
                    ties.push(TiePoint { point_m, seen });
                }
            }
        }
    }
    (ties, bounds)
}

/// Position of a point in an image; `None` where it is hidden, or the map has no depth.
fn sees(view: &View, point_m: &Vector3<f64>) -> Option<[f64; 2]> {
    let point = view.depth.image.matrix() * (point_m - view.centre_m);
    let (index, position) = view.map.place(&point)?;
    let shown = f64::from(view.map.z[index]);
    ((shown - point.z).abs() <= AGREEMENT * point.z).then_some(position)
}
