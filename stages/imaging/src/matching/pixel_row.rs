//! The pixels of one row of an image, prepared once for all pairs of the image: true points and noisy rays.

use nalgebra::Vector3;

use crate::camera::model::Camera;
use crate::camera::ray_row::RayRow;
use rockface_core::artefact::Depth;
use rockface_core::numerics::simd::{LANES, Lanes, Work, vectorised};

/// The pixels of a row that have a depth, from left to right.
#[derive(Debug, Clone, PartialEq)]
pub struct PixelRow {
    /// The row in the depth map.
    pub row: usize,
    /// The column of each pixel in the depth map.
    pub columns: Vec<usize>,
    /// X, Y and Z of the true points, in the frame of the cameras, metres.
    points_m: [Vec<f64>; 3],
    /// Undistorted normalised coordinates of the pixels in the noisy camera.
    noisy_rays: [Vec<f64>; 2],
}

/// Up to [`LANES`] pixels of a row; lanes beyond the last pixel are NaN.
#[derive(Debug, Clone, Copy)]
pub struct Block<'a> {
    /// Columns of the pixels in the depth map.
    pub columns: &'a [usize],
    /// X, Y and Z of their true points in the frame of the cameras, metres.
    pub points_m: [Lanes; 3],
    /// Undistorted normalised coordinates of the pixels in the noisy camera.
    pub noisy_rays: [Lanes; 2],
}

impl Block<'_> {
    /// The first column where the block is full and its columns follow each other.
    #[inline(always)]
    pub fn first_of_neighbours(&self) -> Option<usize> {
        let columns: &[usize; LANES] = self.columns.try_into().ok()?;
        (columns[LANES - 1] == columns[0] + LANES - 1).then_some(columns[0])
    }
}

impl PixelRow {
    /// A row of an ideal depth map: points by its true camera, rays by its noisy one.
    pub fn new(depth: &Depth, camera: &Camera, noisy: &Camera, row: usize) -> Self {
        let values = &depth.z[row * depth.width..(row + 1) * depth.width];
        let mut pixels = Self::empty(row, values.len());
        if !values.iter().any(|z| z.is_finite()) {
            return pixels;
        }
        let rays = |camera| RayRow::new(camera, row, depth.downscale);
        let (true_rays, noisy_rays) = (rays(camera), (!noisy.has_interior_of(camera)).then(|| rays(noisy)));
        vectorised(ReadRow { values, true_rays, noisy_rays, pixels: &mut pixels });
        pixels
    }

    /// A row without pixels, with memory for `capacity` of them.
    pub fn empty(row: usize, capacity: usize) -> Self {
        let list = || Vec::with_capacity(capacity);
        Self {
            row,
            columns: Vec::with_capacity(capacity),
            points_m: [(); 3].map(|()| list()),
            noisy_rays: [(); 2].map(|()| list()),
        }
    }

    /// Adds a pixel to the right of the others.
    pub fn push(&mut self, column: usize, point_m: &Vector3<f64>, noisy_ray: [f64; 2]) {
        self.columns.push(column);
        self.points_m.iter_mut().zip(point_m).for_each(|(list, value)| list.push(*value));
        self.noisy_rays.iter_mut().zip(noisy_ray).for_each(|(list, value)| list.push(value));
    }

    /// Adds the pixels of [`LANES`] columns, where they have a finite point and a ray.
    #[inline(always)]
    fn extend(&mut self, column: usize, point_m: [Lanes; 3], noisy_ray: [Lanes; 2]) {
        // What is no number or not finite is none in the sum either.
        let sum = point_m[0] + point_m[1] + point_m[2] + noisy_ray[0] + noisy_ray[1];
        if sum.every(f64::is_finite) {
            self.columns.extend(column..column + LANES);
            let ([x, y, z], [ray_x, ray_y]) = (&mut self.points_m, &mut self.noisy_rays);
            let lists =
                [(x, point_m[0]), (y, point_m[1]), (z, point_m[2]), (ray_x, noisy_ray[0]), (ray_y, noisy_ray[1])];
            for (list, lanes) in lists {
                list.extend_from_slice(&lanes.each());
            }
            return;
        }
        for lane in (0..LANES).filter(|lane| sum[*lane].is_finite()) {
            let [x, y, z] = point_m.map(|lanes| lanes[lane]);
            self.push(column + lane, &Vector3::new(x, y, z), noisy_ray.map(|lanes| lanes[lane]));
        }
    }

    /// X, Y and Z of the true points, in the frame of the cameras, metres.
    pub fn points_m(&self) -> impl Iterator<Item = [f64; 3]> {
        let [x, y, z] = &self.points_m;
        x.iter().zip(y).zip(z).map(|((x, y), z)| [*x, *y, *z])
    }

    /// The first pixel of each block of [`LANES`] of them.
    pub fn starts(&self) -> impl Iterator<Item = usize> {
        (0..self.columns.len()).step_by(LANES)
    }

    /// The pixels of the block from `start` on.
    #[inline(always)]
    pub fn block(&self, start: usize) -> Block<'_> {
        let end = self.columns.len().min(start + LANES);
        let ([x, y, z], [ray_x, ray_y]) = (&self.points_m, &self.noisy_rays);
        // One by one: what the `map` of arrays is given is not inlined, and wide registers would be filled by narrow ones.
        Block {
            columns: &self.columns[start..end],
            points_m: [Lanes::first_of(&x[start..]), Lanes::first_of(&y[start..]), Lanes::first_of(&z[start..])],
            noisy_rays: [Lanes::first_of(&ray_x[start..]), Lanes::first_of(&ray_y[start..])],
        }
    }
}

/// Adds the pixels of a row with the depths `values`.
struct ReadRow<'a, 'c> {
    values: &'a [f32],
    true_rays: RayRow<'c>,
    /// Where the noisy camera has another interior orientation.
    noisy_rays: Option<RayRow<'c>>,
    pixels: &'a mut PixelRow,
}

impl Work for ReadRow<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run(mut self) {
        for (values, column) in self.values.chunks(LANES).zip((0..).step_by(LANES)) {
            let (true_ray, point_m) = self.true_rays.points(column, values);
            let noisy_ray = match &mut self.noisy_rays {
                Some(rays) => rays.block(column),
                None => true_ray,
            };
            self.pixels.extend(column, point_m, noisy_ray);
        }
    }
}
