//! Normals of an organised surface from neighbourhoods so wide that noise does not tilt them.

use std::sync::OnceLock;

use nalgebra::Vector3;

use super::nearest::local;
use rockface_core::artefact::Surface;

/// Side of the blocks of points that share a normal.
const BLOCK: usize = 4;
/// Half width, in points, of the neighbourhood of a block's centre. Where matching noise is two point spacings, normals
/// from 5 x 5 points would be off by 16 degrees, from 17 x 17 they are off by 1.4.
const REACH: usize = 8;
/// Least share of the neighbourhood that has points.
const LEAST_FILLED: f64 = 0.5;

/// One normal for every block of 4 x 4 points, by regression over 17 x 17 points about it. Normals are computed on first use, as
/// a registration by a subset of points uses few.
pub struct Normals<'a> {
    surface: &'a Surface,
    blocks_wide: usize,
    blocks: Vec<OnceLock<Option<Vector3<f64>>>>,
}

impl<'a> Normals<'a> {
    /// The normals of a surface.
    pub fn new(surface: &'a Surface) -> Self {
        let (blocks_wide, blocks_high) = (surface.width.div_ceil(BLOCK), surface.height.div_ceil(BLOCK));
        Self { surface, blocks_wide, blocks: (0..blocks_wide * blocks_high).map(|_| OnceLock::new()).collect() }
    }

    /// Unit normal at a place of the surface, of either sign; `None` where too few points are near.
    pub fn at(&self, place: usize) -> Option<Vector3<f64>> {
        let (row, column) = (place / self.surface.width / BLOCK, place % self.surface.width / BLOCK);
        let centre = (row * BLOCK + BLOCK / 2, column * BLOCK + BLOCK / 2);
        *self.blocks[row * self.blocks_wide + column].get_or_init(|| normal_about(self.surface, centre))
    }
}

fn normal_about(surface: &Surface, (row, column): (usize, usize)) -> Option<Vector3<f64>> {
    let span = |at: usize, size: usize| at.saturating_sub(REACH)..(at + REACH + 1).min(size);
    let mut lines = Regression::default();
    for r in span(row, surface.height) {
        for c in span(column, surface.width) {
            let place = r * surface.width + c;
            if !surface.points[place][0].is_nan() {
                lines.add(c as f64 - column as f64, r as f64 - row as f64, local(surface, place));
            }
        }
    }
    let least = ((2 * REACH + 1) * (2 * REACH + 1)) as f64 * LEAST_FILLED;
    if lines.count >= least { lines.normal() } else { None }
}

/// Regression of points on their columns u and rows v. Noise along the view does not bias it, as it would a best-fit
/// plane by least distances.
#[derive(Default)]
struct Regression {
    count: f64,
    u: f64,
    v: f64,
    uu: f64,
    uv: f64,
    vv: f64,
    p: Vector3<f64>,
    up: Vector3<f64>,
    vp: Vector3<f64>,
}

impl Regression {
    fn add(&mut self, u: f64, v: f64, p: Vector3<f64>) {
        self.count += 1.0;
        (self.u, self.v) = (self.u + u, self.v + v);
        (self.uu, self.uv, self.vv) = (self.uu + u * u, self.uv + u * v, self.vv + v * v);
        (self.p, self.up, self.vp) = (self.p + p, self.up + p * u, self.vp + p * v);
    }

    /// Across both directions of the regression plane.
    fn normal(&self) -> Option<Vector3<f64>> {
        let n = self.count;
        let (uu, uv, vv) =
            (self.uu - self.u * self.u / n, self.uv - self.u * self.v / n, self.vv - self.v * self.v / n);
        let (up, vp) = (self.up - self.p * (self.u / n), self.vp - self.p * (self.v / n));
        // The common factor 1 / (uu vv - uv^2) does not turn the normal.
        let (along, down) = (up * vv - vp * uv, vp * uu - up * uv);
        down.cross(&along).try_normalize(0.0).filter(|normal| normal.iter().all(|x| x.is_finite()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Frame;
    use rockface_core::numerics::random::Key;

    #[test]
    fn noise_of_two_spacings_turns_them_by_little() {
        let (width, height, field) = (80, 60, Key([3; 32]).field());
        let at = |i: usize| {
            let (x, y) = ((i % width) as f32 * 0.01, (i / width) as f32 * -0.01);
            [x, y, 0.3 * x + 0.02 * field.normal((i % width) as i32, (i / width) as i32) as f32]
        };
        let points = (0..width * height).map(at).collect();
        let squares = vec![3; (width - 1) * (height - 1)];
        let surface = Surface { frame: Frame::Wall, width, height, origin_m: [0.0; 3], points, squares };
        let (normals, truth) = (Normals::new(&surface), Vector3::new(-0.3, 0.0, 1.0).normalize());
        let turned = |row: usize, column: usize| normals.at(row * width + column).unwrap().cross(&truth).norm();
        let inner: Vec<f64> =
            (10..50).flat_map(|row| (10..70).map(move |column| (row, column))).map(|(r, c)| turned(r, c)).collect();
        let rms = (inner.iter().map(|t| t * t).sum::<f64>() / inner.len() as f64).sqrt();
        // Slope error by regression: sigma sqrt(12) / (n L), n = 17 points and L = 0.17 m, in each direction.
        let expected = 0.02 * 12.0f64.sqrt() / (17.0 * 0.17) * 2.0f64.sqrt();
        assert!((rms / expected - 1.0).abs() < 0.25, "{rms} rad, expected {expected}");
    }
}
