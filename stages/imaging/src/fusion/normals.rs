//! Normals of an organised surface from neighbourhoods so wide that noise does not tilt them.

use std::ops::Range;
use std::sync::OnceLock;

use nalgebra::Vector3;
use rayon::prelude::*;

use rockface_core::artefact::Surface;

/// Which points a normal is computed from, and which share it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Neighbourhood {
    /// Half width, in points, of the square about the centre of a block that its normal is computed from.
    reach: usize,
    /// Side, in points, of the blocks that share a normal: odd, so that the centre of each is one of its points. A normal that is
    /// computed beside the middle of its block makes a registration place edges beside where they are.
    block: usize,
}

impl Neighbourhood {
    /// 17 x 17 points, one normal for 5 x 5: where matching noise is two point spacings, normals from 5 x 5 points would be
    /// off by 16 degrees, from these they are off by 1.4. Relief shorter than these points is smoothed away.
    pub const WIDEST: Self = Self { reach: 8, block: 5 };
    /// Reach where there is no noise, and what each spacing of noise adds to it.
    const LEAST_REACH: f64 = 2.0;
    const REACH_PER_SPACING: f64 = 3.0;

    /// The neighbourhood for noise of so many point spacings, in whole steps from 5 x 5 points without noise to the widest
    /// at two spacings.
    pub fn for_noise(spacings: f64) -> Self {
        let reach = (Self::LEAST_REACH + Self::REACH_PER_SPACING * spacings).round() as usize;
        if reach < Self::WIDEST.reach { Self { reach, block: 3 } } else { Self::WIDEST }
    }

    /// The row or column about which the normal of a block is computed.
    fn centre(self, block: usize) -> usize {
        block * self.block + self.block / 2
    }

    /// Rows or columns of the neighbourhood of a centre.
    fn span(self, centre: usize, size: usize) -> Range<usize> {
        centre.saturating_sub(self.reach)..(centre + self.reach + 1).min(size)
    }

    /// The normal about a row by the rows of its neighbourhood; `None` for too few points.
    fn normal(self, centre: usize, rows: impl Iterator<Item = (usize, RowSums)>) -> Option<Vector3<f64>> {
        let mut lines = Regression::default();
        rows.for_each(|(row, sums)| lines.add(row as f64 - centre as f64, &sums));
        let side = 2 * self.reach + 1;
        if lines.count >= (side * side) as f64 * LEAST_FILLED { lines.normal() } else { None }
    }
}

/// Least share of the neighbourhood that has points.
const LEAST_FILLED: f64 = 0.5;

/// Rows of blocks whose normals are computed together: the rows of points they share are summed up once.
const BAND: usize = 8;

/// One normal for every block of points, by regression over the points about it.
pub struct Normals<'a> {
    surface: &'a Surface,
    about: Neighbourhood,
    blocks_wide: usize,
    /// Those of a registration by a subset of points are computed on first use.
    blocks: Vec<OnceLock<Option<Vector3<f64>>>>,
}

impl<'a> Normals<'a> {
    /// The normals of a surface, of which about so many will be asked for.
    pub fn new(surface: &'a Surface, about: Neighbourhood, wanted: usize) -> Self {
        let (blocks_wide, blocks_high) = (surface.width.div_ceil(about.block), surface.height.div_ceil(about.block));
        let blocks = (0..blocks_wide * blocks_high).map(|_| OnceLock::new()).collect();
        let mut normals = Self { surface, about, blocks_wide, blocks };
        if wanted >= normals.blocks.len() / 2 {
            normals.compute_all();
        }
        normals
    }

    fn compute_all(&mut self) {
        let (surface, about, wide) = (self.surface, self.about, self.blocks_wide);
        self.blocks.par_chunks_mut(BAND * wide).enumerate().for_each(|(band, blocks)| {
            let first = band * BAND;
            let last = first + blocks.len() / wide - 1;
            let span = |centre: usize| about.span(centre, surface.height);
            let rows = span(about.centre(first)).start..span(about.centre(last)).end;
            let of_row = |row: usize| (0..wide).map(move |block| RowSums::of(surface, about, row, about.centre(block)));
            let sums: Vec<RowSums> = rows.clone().flat_map(of_row).collect();
            for (place, block) in blocks.iter_mut().enumerate() {
                let (row, column) = (about.centre(first + place / wide), place % wide);
                let sums = span(row).map(|r| (r, sums[(r - rows.start) * wide + column]));
                *block = OnceLock::from(about.normal(row, sums));
            }
        });
    }

    /// Unit normal at a place of the surface, of either sign; `None` where too few points are near.
    pub fn at(&self, place: usize) -> Option<Vector3<f64>> {
        let Self { surface, about, .. } = *self;
        let (row, column) = (place / surface.width / about.block, place % surface.width / about.block);
        *self.blocks[row * self.blocks_wide + column].get_or_init(|| {
            let (row, column) = (about.centre(row), about.centre(column));
            let rows = about.span(row, surface.height);
            about.normal(row, rows.map(|r| (r, RowSums::of(surface, about, r, column))))
        })
    }
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
    fn of(surface: &Surface, about: Neighbourhood, row: usize, centre: usize) -> Self {
        let columns = about.span(centre, surface.width);
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
        let (normals, truth) =
            (Normals::new(&surface, Neighbourhood::WIDEST, 0), Vector3::new(-0.3, 0.0, 1.0).normalize());
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
        for about in [Neighbourhood::WIDEST, Neighbourhood::for_noise(0.0), Neighbourhood::for_noise(1.0)] {
            let (each, all) = (Normals::new(&surface, about, 0), Normals::new(&surface, about, width * height));
            let found: Vec<_> = (0..width * height).map(|place| each.at(place)).collect();
            assert!(found.iter().any(Option::is_none) && found.iter().any(Option::is_some));
            assert_eq!(found, (0..width * height).map(|place| all.at(place)).collect::<Vec<_>>());
        }
    }

    #[test]
    fn neighbourhoods_grow_with_noise() {
        let reach = |spacings: f64| Neighbourhood::for_noise(spacings).reach;
        assert_eq!([0.0, 0.1, 0.2, 0.5, 1.0, 1.5, 2.0, 50.0].map(reach), [2, 2, 3, 4, 5, 7, 8, 8]);
        assert_eq!(Neighbourhood::for_noise(2.0), Neighbourhood::WIDEST);
    }
}
