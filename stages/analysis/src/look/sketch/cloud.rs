//! Points of clouds, surfaces and depth maps, thinned to every n-th point, or column and row.

use nalgebra::Vector3;

use super::{every, stride_to};
use rockface_core::artefact::sketch::{CloudSketch, Shape, Sketch};
use rockface_core::artefact::{Cloud, Depth, Surface};
use rockface_imaging::camera::model::{Camera, full_pixel};

/// Points of a surface or cloud that are shown at most.
const SURFACE_POINTS: usize = 20_000;
/// Points of a depth map that are shown at most: its picture shows the rest.
const DEPTH_POINTS: usize = 10_000;

/// The points of a cloud.
pub fn of_cloud(cloud: &Cloud) -> Sketch {
    let stride = stride_to(cloud.points.len(), SURFACE_POINTS);
    let origin_m = cloud.points.first().map_or([0.0; 3], |first| first.map(f64::round));
    let local = |point: &[f64; 3]| [0, 1, 2].map(|axis| (point[axis] - origin_m[axis]) as f32);
    let points = cloud.points.iter().step_by(stride).map(local).collect();
    let shape = Shape::Cloud(CloudSketch { frame: cloud.frame.to_string(), origin_m, points });
    Sketch { part: String::new(), reduced: every(stride, "point"), shape }
}

/// The points of a surface.
pub fn of_surface(surface: &Surface) -> Sketch {
    let (width, height) = (surface.width, surface.height);
    let stride = stride(width, height, SURFACE_POINTS);
    let points = places(width, height, stride).map(|(row, column)| surface.points[row * width + column]);
    let cloud = CloudSketch {
        frame: surface.frame.to_string(),
        origin_m: surface.origin_m,
        points: points.filter(|point| !point[0].is_nan()).collect(),
    };
    Sketch { part: String::new(), reduced: every(stride, "column and row of points"), shape: Shape::Cloud(cloud) }
}

/// The points a depth map stands for, by its own camera.
pub fn of_depth_points(depth: &Depth) -> Sketch {
    let stride = stride(depth.width, depth.height, DEPTH_POINTS);
    let camera = Camera::of_depth(depth);
    let origin_m = depth.image.centre_m.map(f64::round);
    let point = |(row, column): (usize, usize)| {
        let z_m = f64::from(depth.z[row * depth.width + column]);
        let ray = camera.normalised(full_pixel(column, row, depth.downscale)).filter(|_| z_m.is_finite())?;
        let relative = camera.unproject(ray, z_m) - Vector3::from(origin_m);
        Some([relative.x as f32, relative.y as f32, relative.z as f32])
    };
    let cloud = CloudSketch {
        frame: depth.frame.to_string(),
        origin_m,
        points: places(depth.width, depth.height, stride).filter_map(point).collect(),
    };
    Sketch { part: "cloud".to_owned(), reduced: every(stride, "column and row of pixels"), shape: Shape::Cloud(cloud) }
}

/// The smallest stride that leaves at most `limit` places of a grid.
fn stride(width: usize, height: usize, limit: usize) -> usize {
    let left = |stride: usize| width.div_ceil(stride) * height.div_ceil(stride);
    let start = (width as f64 * height as f64 / limit as f64).sqrt().floor().max(1.0) as usize;
    let last = width.max(height).max(start);
    (start..=last).find(|stride| left(*stride) <= limit).unwrap_or(last)
}

/// Every `stride`-th row and column of a grid, beginning half a stride in.
fn places(width: usize, height: usize, stride: usize) -> impl Iterator<Item = (usize, usize)> {
    let from = stride / 2;
    (from..height).step_by(stride).flat_map(move |row| (from..width).step_by(stride).map(move |column| (row, column)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Frame, Image};
    use rockface_core::testing::small_sensor;

    #[test]
    fn a_thinned_depth_map_keeps_to_its_budget_and_its_plane() {
        let (width, height) = (300, 200);
        let sensor = rockface_core::artefact::Sensor { width_px: 300, height_px: 200, ..small_sensor() };
        let image =
            Image { name: "a".into(), sensor: 0, camera_from_object: [1.0, 0.0, 0.0, 0.0], centre_m: [1e6, 2.5, -4.0] };
        let mut z = vec![7.0; width * height];
        z[0] = f32::NAN;
        let channels = std::collections::BTreeMap::new();
        let depth = Depth { frame: Frame::Wall, sensor, image, downscale: 1, width, height, z, channels };
        let sketch = of_depth_points(&depth);
        assert_eq!(sketch.reduced, "every third column and row of pixels");
        let Shape::Cloud(cloud) = sketch.shape else { panic!("a cloud") };
        assert_eq!(cloud.points.len(), 100 * 67);
        let plane = |point: &[f32; 3]| (cloud.origin_m[2] + f64::from(point[2]) - 3.0).abs() < 1e-6;
        assert!(cloud.points.iter().all(plane));
    }

    #[test]
    fn small_grids_are_shown_whole() {
        let surface = Surface {
            frame: Frame::World,
            width: 2,
            height: 2,
            origin_m: [5.0, 6.0, 7.0],
            points: vec![[0.0; 3], [f32::NAN; 3], [1.0; 3], [2.0; 3]],
            squares: vec![0],
        };
        let sketch = of_surface(&surface);
        assert_eq!(sketch.reduced, "");
        let Shape::Cloud(cloud) = sketch.shape else { panic!("a cloud") };
        assert_eq!((cloud.points.len(), cloud.frame.as_str()), (3, "world"));
    }
}
