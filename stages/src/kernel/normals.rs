//! Normals of an organised surface from neighbourhoods wide enough that noise does not turn them.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use rayon::prelude::*;

use super::nearest::local;
use crate::artefact::Surface;

/// Side of the blocks of points that share a normal.
const BLOCK: usize = 4;
/// Half width, in points, of the neighbourhood of a block's centre. Where matching noise is two point spacings, normals
/// from 5 x 5 points would be off by 16 degrees, from 17 x 17 they are off by 1.4.
const REACH: usize = 8;
/// Share of the neighbourhood that must have points.
const LEAST_FILLED: f64 = 0.5;

/// One normal for every block of 4 x 4 points, from the best-fit plane of 17 x 17 points about it.
pub struct Normals {
    width: usize,
    blocks_wide: usize,
    blocks: Vec<Option<Vector3<f64>>>,
}

impl Normals {
    /// The normals of a surface; the same bits at any thread count.
    pub fn new(surface: &Surface) -> Self {
        let (blocks_wide, blocks_high) = (surface.width.div_ceil(BLOCK), surface.height.div_ceil(BLOCK));
        let blocks = (0..blocks_wide * blocks_high).into_par_iter();
        let centre = |block: usize| (block / blocks_wide * BLOCK + BLOCK / 2, block % blocks_wide * BLOCK + BLOCK / 2);
        let blocks = blocks.map(|block| normal_about(surface, centre(block))).collect();
        Self { width: surface.width, blocks_wide, blocks }
    }

    /// Unit normal of a place of the surface, of either sign; `None` where too few points are about.
    pub fn at(&self, place: usize) -> Option<Vector3<f64>> {
        self.blocks[place / self.width / BLOCK * self.blocks_wide + place % self.width / BLOCK]
    }
}

fn normal_about(surface: &Surface, (row, column): (usize, usize)) -> Option<Vector3<f64>> {
    let span = |at: usize, size: usize| at.saturating_sub(REACH)..(at + REACH + 1).min(size);
    let places =
        span(row, surface.height).flat_map(|r| span(column, surface.width).map(move |c| r * surface.width + c));
    let points = || places.clone().filter(|p| !surface.points[*p][0].is_nan()).map(|p| local(surface, p));
    let (count, sum) = points().fold((0usize, Vector3::zeros()), |(n, sum), p| (n + 1, sum + p));
    let least = (((2 * REACH + 1) * (2 * REACH + 1)) as f64 * LEAST_FILLED).ceil() as usize;
    if count < least {
        return None;
    }
    let mean = sum / count as f64;
    let mut scatter = Matrix3::zeros();
    for d in points().map(|p| p - mean) {
        let [x, y, z] = [d.x, d.y, d.z];
        scatter += Matrix3::new(x * x, x * y, x * z, x * y, y * y, y * z, x * z, y * z, z * z);
    }
    let eigen = SymmetricEigen::new(scatter);
    eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned().try_normalize(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artefact::Frame;
    use crate::kernel::random::Key;

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
