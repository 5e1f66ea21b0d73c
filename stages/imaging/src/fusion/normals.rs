//! Normals of an organised surface from neighbourhoods so wide that noise does not tilt them.

use std::ops::Range;
use std::sync::OnceLock;

use nalgebra::Vector3;
use rayon::prelude::*;

use rockface_core::artefact::Surface;

/// Side of the blocks of points that share a normal.
const BLOCK: usize = 4;
/// Half width, in points, of the neighbourhood of a block's centre. Where matching noise is two point spacings, normals
/// from 5 x 5 points would be off by 16 degrees, from 17 x 17 they are off by 1.4.
const REACH: usize = 8;
/// Least share of the neighbourhood that has points.
const LEAST_FILLED: f64 = 0.5;

/// Rows of blocks whose normals are computed together: the rows of points they share are summed up once.
const BAND: usize = 8;

/// One normal for every block of 4 x 4 points, by regression over 17 x 17 points about it.
pub struct Normals<'a> {
    surface: &'a Surface,
    blocks_wide: usize,
    /// Those of a registration by a subset of points are computed on first use.
    blocks: Vec<OnceLock<Option<Vector3<f64>>>>,
}

impl<'a> Normals<'a> {
    /// The normals of a surface, of which about so many will be asked for.
    pub fn new(surface: &'a Surface, wanted: usize) -> Self {
        let (blocks_wide, blocks_high) = (surface.width.div_ceil(BLOCK), surface.height.div_ceil(BLOCK));
        let mut normals =
            Self { surface, blocks_wide, blocks: (0..blocks_wide * blocks_high).map(|_| OnceLock::new()).collect() };
        if wanted >= normals.blocks.len() / 2 {
            normals.compute_all();
        }
        normals
    }

    fn compute_all(&mut self) {
        let (surface, wide) = (self.surface, self.blocks_wide);
        self.blocks.par_chunks_mut(BAND * wide).enumerate().for_each(|(band, blocks)| {
            let first = band * BAND;
            let last = first + blocks.len() / wide - 1;
            let rows = span(centre(first), surface.height).start..span(centre(last), surface.height).end;
            let of_row = |row: usize| (0..wide).map(move |block| RowSums::of(surface, row, centre(block)));
            let sums: Vec<RowSums> = rows.clone().flat_map(of_row).collect();
            for (place, block) in blocks.iter_mut().enumerate() {
                let (row, column) = (centre(first + place / wide), place % wide);
                let sums = span(row, surface.height).map(|r| (r, sums[(r - rows.start) * wide + column]));
                *block = OnceLock::from(normal(row, sums));
            }
        });
    }

    /// Unit normal at a place of the surface, of either sign; `None` where too few points are near.
    pub fn at(&self, place: usize) -> Option<Vector3<f64>> {
        let (row, column) = (place / self.surface.width / BLOCK, place % self.surface.width / BLOCK);
        *self.blocks[row * self.blocks_wide + column].get_or_init(|| {
            let (row, column) = (centre(row), centre(column));
            normal(row, span(row, self.surface.height).map(|r| (r, RowSums::of(self.surface, r, column))))
        })
    }
}

/// The row or column about which the normal of a block is computed.
fn centre(block: usize) -> usize {
    block * BLOCK + BLOCK / 2
}

/// Rows or columns of the neighbourhood of a centre.
fn span(centre: usize, size: usize) -> Range<usize> {
    centre.saturating_sub(REACH)..(centre + REACH + 1).min(size)
}

/// Sums over the points in a row of a neighbourhood, by column u about its centre.
#[derive(Clone, Copy, Default)]
struct RowSums {
    count: f64,
    u: f64,
    uu: f64,
    p: [f64; 3],
    up: [f64; 3],
}

impl RowSums {
    fn of(surface: &Surface, row: usize, centre: usize) -> Self {
        let columns = span(centre, surface.width);
        let points = &surface.points[row * surface.width..][columns.clone()];
        let mut sums = Self::default();
        for (column, point) in columns.zip(points).filter(|(_, point)| !point[0].is_nan()) {
            let u = column as f64 - centre as f64;
            sums.count += 1.0;
            sums.u += u;
            sums.uu += u * u;
            let [x, y, z] = point.map(f64::from);
            sums.p = [sums.p[0] + x, sums.p[1] + y, sums.p[2] + z];
            sums.up = [sums.up[0] + x * u, sums.up[1] + y * u, sums.up[2] + z * u];
        }
        sums
    }
}

/// The normal of a neighbourhood by its rows; `None` for too few points.
fn normal(centre: usize, rows: impl Iterator<Item = (usize, RowSums)>) -> Option<Vector3<f64>> {
    let mut lines = Regression::default();
    rows.for_each(|(row, sums)| lines.add(row as f64 - centre as f64, &sums));
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
    /// Adds row v.
    fn add(&mut self, v: f64, row: &RowSums) {
        self.count += row.count;
        (self.u, self.v) = (self.u + row.u, self.v + v * row.count);
        (self.uu, self.uv, self.vv) = (self.uu + row.uu, self.uv + v * row.u, self.vv + v * v * row.count);
        let p = Vector3::from(row.p);
        (self.p, self.up, self.vp) = (self.p + p, self.up + Vector3::from(row.up), self.vp + p * v);
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
        let (normals, truth) = (Normals::new(&surface, 0), Vector3::new(-0.3, 0.0, 1.0).normalize());
        let turned = |row: usize, column: usize| normals.at(row * width + column).unwrap().cross(&truth).norm();
        let inner: Vec<f64> =
            (10..50).flat_map(|row| (10..70).map(move |column| (row, column))).map(|(r, c)| turned(r, c)).collect();
        let rms = (inner.iter().map(|t| t * t).sum::<f64>() / inner.len() as f64).sqrt();
        // Slope error by regression: sigma sqrt(12) / (n L), n = 17 points and L = 0.17 m, in each direction.
        let expected = 0.02 * 12.0f64.sqrt() / (17.0 * 0.17) * 2.0f64.sqrt();
        assert!((rms / expected - 1.0).abs() < 0.25, "{rms} rad, expected {expected}");
    }

    #[test]
    fn computed_together_they_have_the_bits_of_each_alone() {
        let (width, height, field) = (57, 101, Key([5; 32]).field());
        let at = |i: usize| {
            let (column, row) = ((i % width) as i32, (i / width) as i32);
            let gap = field.words(column / 9, row / 7)[1].is_multiple_of(4);
            let z = if gap { f32::NAN } else { field.normal(column, row) as f32 };
            [column as f32 + 0.0 * z, row as f32, z]
        };
        let points = (0..width * height).map(at).collect();
        let squares = vec![3; (width - 1) * (height - 1)];
        let surface = Surface { frame: Frame::Wall, width, height, origin_m: [0.0; 3], points, squares };
        let (each, all) = (Normals::new(&surface, 0), Normals::new(&surface, width * height));
        let found: Vec<_> = (0..width * height).map(|place| each.at(place)).collect();
        assert!(found.iter().any(Option::is_none) && found.iter().any(Option::is_some));
        assert_eq!(found, (0..width * height).map(|place| all.at(place)).collect::<Vec<_>>());
    }
}
