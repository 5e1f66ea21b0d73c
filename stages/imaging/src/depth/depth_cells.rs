//! The depth map of one image reduced to the cells of a grid: one elevation a cell, with its expected deviation.
//!
//! All grids of one cell size stand on whole multiples of the cell, so those of several images fit each other.

use rayon::prelude::*;

use crate::camera::model::{Camera, full_pixel, outline};
use crate::camera::ray_row::RayRow;
use rockface_core::StageError;
use rockface_core::artefact::{Depth, Grid};
use rockface_core::numerics::simd::{LANES, Lanes, Number, Work, vectorised};
use rockface_raster::rasterise::grid_around;
use rockface_raster::window::clipped;

/// Rows whose points are found in parallel before they are added in order.
const BATCH_ROWS: usize = 64;
/// Stands for the number of a cell where a pixel lies in none.
const NOWHERE: f64 = -1.0;
/// Least cosine of the angle between a view and Z by which deviations are enlarged.
const LEAST_COSINE: f64 = 0.05;

/// Where the expected deviation of a depth comes from.
#[derive(Debug, Clone, Copy)]
pub enum Sigma<'a> {
    /// One for every pixel, metres.
    Constant(f64),
    /// One for each pixel of the depth map, metres.
    Map(&'a [f32]),
}

impl Sigma<'_> {
    /// Those of the pixels from one on.
    #[inline(always)]
    fn from(self, pixel: usize) -> Lanes {
        match self {
            Self::Constant(sigma_m) => Lanes::all(sigma_m),
            Self::Map(values) => Lanes::of(|lane| values.get(pixel + lane).copied().map_or(f64::NAN, f64::from)),
        }
    }
}

/// Elevations of one image by cell.
#[derive(Debug, Clone)]
pub struct Cells {
    /// The grid, no larger than it must be.
    pub grid: Grid,
    /// Weighted mean Z of the pixels in the cell, metres; NaN where there is none.
    pub elevation_m: Vec<f32>,
    /// Expected standard deviation of one of them along Z, metres, larger by 1 / sqrt(cos) for a view at an angle to Z.
    pub sigma_m: Vec<f32>,
    /// Pixels with a depth, and those of them in the window.
    pub pixels: [usize; 2],
}

/// A pixel on its way to its cell.
#[derive(Debug, Clone, Copy, Default)]
struct Sample {
    cell: u32,
    z_m: f32,
    /// `1 / sigma^2` in its cell.
    weight: f64,
}

/// How many pixels of a row have a depth, and how many of these lie in a cell.
#[derive(Debug, Clone, Copy, Default)]
struct Counts {
    valid: usize,
    placed: usize,
}

#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    weight: f64,
    weighted_z: f64,
    count: u32,
}

/// Reduces a depth map to cells of `cell_m`, within `window_m` (left, right, bottom, top) where one is given.
///
/// Weights are `1 / sigma^2`. Points are added in their own order: the same bits at any thread count. `None` where no pixel
/// falls into the window; an error where the grid would be too large.
pub fn reduce(
    depth: &Depth,
    sigma: Sigma,
    cell_m: f64,
    window_m: Option<[f64; 4]>,
) -> Result<Option<Cells>, StageError> {
    let camera = Camera::of_depth(depth);
    let Some(reach) = reach(depth, &camera).map(|reach| clipped(reach, window_m)) else { return Ok(None) };
    if reach[0] >= reach[1] || reach[2] >= reach[3] {
        return Ok(None);
    }
    let grid = grid_around(reach, cell_m).map_err(|e| e.hint("choose a larger `cell_m` or a smaller `window_m`"))?;
    let mut sums = vec![Sums::default(); grid.cells()];
    let mut pixels = [0; 2];
    let placer = Placer { depth, camera: &camera, sigma, grid: &grid, window_m };
    let row_len = depth.width.next_multiple_of(LANES);
    let mut samples = vec![Sample::default(); BATCH_ROWS * row_len];
    for start in (0..depth.height).step_by(BATCH_ROWS) {
        let rows = depth.height.min(start + BATCH_ROWS) - start;
        let lists = samples.par_chunks_mut(row_len).take(rows).enumerate();
        let scratch = || [0; 2].map(|_| vec![f64::NAN; row_len]);
        let counts: Vec<Counts> =
            lists.map_init(scratch, |rays, (row, samples)| placer.row(start + row, rays, samples)).collect();
        for (counts, samples) in counts.iter().zip(samples.chunks(row_len)) {
            pixels[0] += counts.valid;
            for sample in &samples[..counts.placed] {
                let cell = &mut sums[sample.cell as usize];
                cell.weight += sample.weight;
                cell.weighted_z += sample.weight * f64::from(sample.z_m);
                cell.count += 1;
            }
        }
    }
    pixels[1] = sums.iter().map(|sums| sums.count as usize).sum();
    Ok(crop(&grid, &sums, pixels))
}

struct Placer<'a> {
    depth: &'a Depth,
    camera: &'a Camera,
    sigma: Sigma<'a>,
    grid: &'a Grid,
    window_m: Option<[f64; 4]>,
}

impl Placer<'_> {
    /// Writes the pixels of a row that lie in a cell to the front of `samples`; `rays` and `samples` have room for whole blocks.
    fn row(&self, row: usize, rays: &mut [Vec<f64>; 2], samples: &mut [Sample]) -> Counts {
        let first = row * self.depth.width;
        let depths_m = &self.depth.z[first..first + self.depth.width];
        if !depths_m.iter().any(|z| Depth::is_seen(*z)) {
            return Counts::default();
        }
        let [x, y] = &mut *rays;
        let width = depths_m.len();
        RayRow::new(self.camera, row, self.depth.downscale).fill(0, &mut x[..width], &mut y[..width]);
        vectorised(PlaceRow { placer: self, first, depths_m, rays, samples })
    }

    /// The numbers of the cells of points, [`NOWHERE`] where they lie in none.
    #[inline(always)]
    fn cells(&self, x: Lanes, y: Lanes) -> Lanes {
        let nowhere = Lanes::all(NOWHERE);
        let (columns, rows) = (self.grid.columns as f64, self.grid.rows as f64);
        let column = ((x - self.grid.left_m) / self.grid.cell_m).map(f64::floor);
        let row = ((-y + self.grid.top_m) / self.grid.cell_m).map(f64::floor);
        let mut cell = row * columns + column;
        // One condition after the other, each for all lanes at once.
        cell = column.choose(|column| column >= 0.0, cell, nowhere);
        cell = column.choose(|column| column < columns, cell, nowhere);
        cell = row.choose(|row| row >= 0.0, cell, nowhere);
        cell = row.choose(|row| row < rows, cell, nowhere);
        let Some([x0, x1, y0, y1]) = self.window_m else { return cell };
        cell = x.choose(|x| x >= x0, cell, nowhere);
        cell = x.choose(|x| x < x1, cell, nowhere);
        cell = y.choose(|y| y > y0, cell, nowhere);
        y.choose(|y| y <= y1, cell, nowhere)
    }
}

/// Places the pixels of a row.
struct PlaceRow<'a> {
    placer: &'a Placer<'a>,
    /// Its first pixel in the depth map.
    first: usize,
    depths_m: &'a [f32],
    /// Undistorted normalised coordinates, NaN where there is no ray.
    rays: &'a [Vec<f64>; 2],
    samples: &'a mut [Sample],
}

impl Work for PlaceRow<'_> {
    type Output = Counts;

    #[inline(always)]
    fn run(self) -> Counts {
        let (mut valid, mut placed) = (Lanes::all(0.0), 0);
        let camera = self.placer.camera;
        for (block, depths_m) in self.depths_m.chunks(LANES).enumerate() {
            let start = block * LANES;
            let ray = [0, 1].map(|axis| Lanes::first_of(&self.rays[axis][start..]));
            let direction = camera.direction_lanes(ray);
            let depth = Lanes::of(|lane| depths_m.get(lane).copied().map_or(f64::NAN, f64::from));
            let [x, y, z] = [0, 1, 2].map(|axis| direction[axis] * depth + camera.centre()[axis]);
            let across = direction[2].map(f64::abs);
            let [dx, dy, dz] = direction;
            let cosine = (across / (dx * dx + dy * dy + dz * dz).sqrt()).at_least(Lanes::all(LEAST_COSINE));
            let sigma_m = self.placer.sigma.from(self.first + start) * across / cosine.sqrt();
            // To 32 bits and back, each for all lanes at once.
            let short = sigma_m.each().map(|sigma_m| sigma_m as f32);
            let sigma_m = Lanes::from(short.map(f64::from));
            let weight = Lanes::all(1.0) / (sigma_m * sigma_m);
            let cell = self.placer.cells(x, y);
            // 1 where a pixel has a depth and a ray.
            let [one, zero] = [1.0, 0.0].map(Lanes::all);
            let is_valid = depth.choose(|depth| depth > 0.0, one, zero);
            let is_valid = depth.choose(|depth| depth < f64::INFINITY, is_valid, zero);
            let is_valid = ray[0].choose(f64::is_nan, zero, is_valid);
            valid = valid + is_valid;
            let cell = is_valid.choose(|is_valid| is_valid > 0.0, cell, Lanes::all(NOWHERE));
            // Whole numbers are the last digits of their sum with 2^52.
            let number = (cell + 4_503_599_627_370_496.0).each().map(f64::to_bits);
            for lane in 0..LANES {
                // One that lies in no cell is written over by the next.
                let (cell_number, z_m) = (number[lane] as u32, z[lane] as f32);
                self.samples[placed] = Sample { cell: cell_number, z_m, weight: weight[lane] };
                placed += usize::from(cell[lane] >= 0.0);
            }
        }
        Counts { valid: valid.each().iter().sum::<f64>() as usize, placed }
    }
}

/// A rectangle in X and Y that holds all points, from the outline of the image at the least and largest depth. Where the lens has no ray
/// for a pixel of the outline, since its distortion folds back before it, the pixels that see something are looked at themselves.
fn reach(depth: &Depth, camera: &Camera) -> Option<[f64; 4]> {
    let (mut low, mut high) = (f32::INFINITY, 0.0f32);
    for z in depth.z.iter().filter(|z| Depth::is_seen(**z)) {
        (low, high) = (low.min(*z), high.max(*z));
    }
    let mut reach = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
    let mut add = |ray: [f64; 2], z_m: f32| {
        let p = camera.unproject(ray, f64::from(z_m));
        reach = [reach[0].min(p.x), reach[1].max(p.x), reach[2].min(p.y), reach[3].max(p.y)];
    };
    let mut is_whole = true;
    for (column, row) in outline(depth.width, depth.height) {
        match camera.normalised(full_pixel(column, row, depth.downscale)) {
            Some(ray) => [low, high].into_iter().for_each(|z| add(ray, z)),
            None => is_whole = false,
        }
    }
    if !is_whole {
        for row in 0..depth.height {
            let mut rays = RayRow::new(camera, row, depth.downscale);
            let seen = (0..depth.width).filter(|column| Depth::is_seen(depth.z[row * depth.width + column]));
            for column in seen {
                if let Some(ray) = rays.ray(column) {
                    add(ray, depth.z[row * depth.width + column]);
                }
            }
        }
    }
    (low <= high && reach[0] <= reach[1]).then_some(reach)
}

/// The part of a grid that has values.
fn crop(grid: &Grid, sums: &[Sums], pixels: [usize; 2]) -> Option<Cells> {
    let (mut columns, mut rows) = ([grid.columns, 0], [grid.rows, 0]);
    for (row, cells) in sums.chunks(grid.columns).enumerate() {
        let filled = |cell: &Sums| cell.count > 0;
        if let (Some(first), Some(last)) = (cells.iter().position(filled), cells.iter().rposition(filled)) {
            columns = [columns[0].min(first), columns[1].max(last + 1)];
            rows = [rows[0].min(row), rows[1].max(row + 1)];
        }
    }
    if columns[0] >= columns[1] {
        return None;
    }
    let first = [(grid.left_m / grid.cell_m).round(), (grid.top_m / grid.cell_m).round()];
    let cropped = Grid {
        columns: columns[1] - columns[0],
        rows: rows[1] - rows[0],
        cell_m: grid.cell_m,
        left_m: (first[0] + columns[0] as f64) * grid.cell_m,
        top_m: (first[1] - rows[0] as f64) * grid.cell_m,
    };
    let (mut elevation_m, mut sigma_m) = (vec![f32::NAN; cropped.cells()], vec![f32::NAN; cropped.cells()]);
    let kept = sums.par_chunks(grid.columns).skip(rows[0]).take(cropped.rows);
    let lines = elevation_m.par_chunks_mut(cropped.columns).zip(sigma_m.par_chunks_mut(cropped.columns));
    kept.zip(lines).for_each(|(cells, (elevation_m, sigma_m))| {
        let cells = &cells[columns[0]..columns[1]];
        for ((sums, elevation_m), sigma_m) in
            cells.iter().zip(elevation_m).zip(sigma_m).filter(|((s, _), _)| s.count > 0)
        {
            *elevation_m = (sums.weighted_z / sums.weight) as f32;
            *sigma_m = (f64::from(sums.count) / sums.weight).sqrt() as f32;
        }
    });
    Some(Cells { grid: cropped, elevation_m, sigma_m, pixels })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Frame, Image, Sensor};
    use rockface_core::testing::{image_at, small_sensor};

    /// A camera 10 m before the plane z = 0, 0.1 m a pixel, and its exact depths.
    fn plane(turn: [f64; 3]) -> Depth {
        let (sensor, image): (Sensor, Image) = (small_sensor(), image_at("a", [0.0, 0.0, 10.0], turn));
        let camera = Camera::new(&sensor, &image);
        let z = |i: usize| {
            let d = camera.direction(camera.normalised(full_pixel(i % 60, i / 60, 1)).unwrap());
            (-10.0 / d.z) as f32
        };
        let z = (0..2400).map(z).collect();
        Depth { frame: Frame::Wall, sensor, image, downscale: 1, width: 60, height: 40, z, channels: [].into() }
    }

    #[test]
    fn a_plane_is_flat_and_its_cells_stand_on_multiples() {
        let cells = reduce(&plane([0.0; 3]), Sigma::Constant(0.02), 0.25, None).unwrap().unwrap();
        assert_eq!((cells.grid.columns, cells.grid.rows), (24, 16));
        assert!((cells.grid.left_m + 3.0).abs() < 1e-12 && (cells.grid.top_m - 2.0).abs() < 1e-12);
        assert!(cells.elevation_m.iter().all(|z| z.abs() < 1e-6));
        assert!(cells.sigma_m.iter().all(|s| (s - 0.02).abs() < 1e-3));
        assert_eq!(cells.pixels, [2400, 2400]);
    }

    #[test]
    fn a_window_cuts_and_one_beside_the_view_leaves_nothing() {
        let window = Some([0.5, 1.5, -0.5, 0.25]);
        let cells = reduce(&plane([0.0; 3]), Sigma::Constant(0.02), 0.25, window).unwrap().unwrap();
        assert_eq!((cells.grid.columns, cells.grid.rows, cells.grid.left_m), (4, 3, 0.5));
        assert!(cells.pixels[1] < 100);
        assert!(reduce(&plane([0.0; 3]), Sigma::Constant(0.02), 0.25, Some([5.0, 6.0, 0.0, 1.0])).unwrap().is_none());
        let mut empty = plane([0.0; 3]);
        empty.z.fill(f32::NAN);
        assert!(reduce(&empty, Sigma::Constant(0.02), 0.25, None).unwrap().is_none());
    }

    /// The sums of a depth map by cell, pixel by pixel, for grids that start at this one's corner.
    fn one_by_one(depth: &Depth, sigma_m: f64, grid: &Grid) -> Vec<[f64; 3]> {
        let camera = Camera::new(&depth.sensor, &depth.image);
        let mut sums = vec![[0.0; 3]; grid.cells()];
        for (i, z) in depth.z.iter().enumerate().filter(|(_, z)| Depth::is_seen(**z)) {
            let Some(ray) = RayRow::new(&camera, i / depth.width, 1).ray(i % depth.width) else { continue };
            let direction = camera.direction(ray);
            let point = camera.centre() + direction * f64::from(*z);
            let cosine = (direction.z.abs() / direction.norm()).max(LEAST_COSINE);
            let sigma = f64::from((sigma_m * direction.z.abs() / cosine.sqrt()) as f32);
            let cell = &mut sums[grid.cell_of([point.x, point.y]).unwrap()];
            let weight = 1.0 / (sigma * sigma);
            *cell = [cell[0] + weight, cell[1] + weight * f64::from(point.z as f32), cell[2] + 1.0];
        }
        sums
    }

    #[test]
    fn a_lens_that_folds_back_before_the_outline_loses_no_pixel() {
        // The lens has no inverse beyond a radius of 0.24, 24 pixels from the middle.
        let mut depth = plane([0.0; 3]);
        depth.sensor.k = [-2.5, 0.0, 0.0, 0.0];
        let camera = Camera::of_depth(&depth);
        for pixel in 0..depth.z.len() {
            if camera.normalised(full_pixel(pixel % depth.width, pixel / depth.width, 1)).is_none() {
                depth.z[pixel] = f32::NAN;
            }
        }
        let seen = depth.z.iter().filter(|z| z.is_finite()).count();
        let cells = reduce(&depth, Sigma::Constant(0.01), 0.2, None).unwrap().unwrap();
        assert!(seen > 1000 && cells.pixels == [seen; 2], "{seen} {:?}", cells.pixels);
    }

    #[test]
    fn several_pixels_at_once_have_the_bits_of_one_by_one() {
        let mut depth = plane([0.3, -0.2, 0.4]);
        depth.z.iter_mut().step_by(7).for_each(|z| *z = f32::NAN);
        let cells = reduce(&depth, Sigma::Constant(0.02), 0.25, None).unwrap().unwrap();
        let sums = one_by_one(&depth, 0.02, &cells.grid);
        assert!(sums.iter().any(|[_, _, count]| *count > 3.0));
        for (i, [weight, z, count]) in sums.into_iter().enumerate() {
            let expected = if count > 0.0 { [z / weight, (count / weight).sqrt()] } else { [f64::NAN; 2] }
                .map(|value| value as f32);
            let found = [cells.elevation_m[i], cells.sigma_m[i]];
            assert_eq!(found.map(f32::to_bits), expected.map(f32::to_bits), "cell {i}");
        }
    }

    #[test]
    fn too_many_cells_are_an_error_with_a_way_out() {
        let error = reduce(&plane([0.0; 3]), Sigma::Constant(0.02), 1e-9, None).unwrap_err();
        assert!(error.message.contains("a grid of") && error.hint.is_some_and(|hint| hint.contains("larger `cell_m`")));
    }

    #[test]
    fn an_oblique_view_counts_less_and_a_pixel_by_its_own_sigma() {
        let oblique = reduce(&plane([0.6, 0.0, 0.0]), Sigma::Constant(0.02), 0.5, None).unwrap().unwrap();
        let straight = 0.02;
        // Depth along an axis at 0.6 rad to Z is 0.825 of it along Z; the angle takes it up again by 1 / sqrt(0.825).
        let middle: Vec<f32> = oblique.sigma_m.iter().copied().filter(|s| s.is_finite()).collect();
        assert!(middle.iter().any(|s| (f64::from(*s) / straight - 0.908).abs() < 0.01));
        let mut map = plane([0.0; 3]);
        map.z.iter_mut().step_by(2).for_each(|z| *z += 1.0);
        let sigma: Vec<f32> = (0..2400).map(|i| if i % 2 == 0 { 1.0 } else { 0.001 }).collect();
        let cells = reduce(&map, Sigma::Map(&sigma), 0.25, None).unwrap().unwrap();
        let inner = cells.elevation_m[8 * cells.grid.columns + 12];
        assert!(inner.abs() < 1e-4, "{inner}");
    }
}
