//! What one pixel of disparity is worth in elevation, by place on the face: the geometry of a survey on the cells of a grid.

use crate::camera::model::Camera;
use crate::matching::rectification::Rectification;
use nalgebra::Vector3;
use rockface_core::StageError;
use rockface_core::artefact::{Cameras, Pairs, Raster};
use rockface_core::numerics::quantile::median;

/// A pair of images, ready to be asked what a pixel of its disparity is worth.
struct View {
    cameras: [Camera; 2],
    rectification: Rectification,
}

impl View {
    /// Metres of elevation for a pixel of disparity; `None` where an image does not show the point.
    fn step_m(&self, point: &Vector3<f64>) -> Option<f64> {
        let shown = |camera: &Camera| camera.project(point).is_some_and(|pixel| camera.inside(pixel, 0.0));
        if !self.cameras.iter().all(shown) {
            return None;
        }
        let ray = self.cameras[0].to_camera(point);
        let distance_m = (self.rectification.rectified_from_camera[0] * ray).z;
        let parallax_px = self.rectification.focal_px * self.rectification.baseline_m / distance_m;
        Some((point.z - self.cameras[0].centre().z).abs() / parallax_px)
    }
}

/// Metres of elevation for a pixel of disparity of the full image on each cell of a DEM: the median over the pairs that show the
/// cell; NaN where no pair does, or where the DEM has no value. Slopes are not regarded, nor what hides a point.
pub fn elevation_step_m(dem: &Raster, block: &Cameras, pairs: &Pairs) -> Result<Vec<f32>, StageError> {
    let image = |name: &str| {
        let image = block.image(name).ok_or_else(|| {
            StageError::new(format!("`cameras` has no image `{name}`, which `pairs` names"))
                .hint("select the pairs from these cameras: `select-pairs`")
        })?;
        Ok::<_, StageError>(Camera::new(block.sensor(image), image))
    };
    let view = |first: &str, second: &str| {
        let cameras = [image(first)?, image(second)?];
        let rectification = Rectification::new([&cameras[0], &cameras[1]], 1)?;
        Ok::<_, StageError>(View { cameras, rectification })
    };
    let views: Vec<View> = pairs.pairs.iter().map(|pair| view(&pair.first, &pair.second)).collect::<Result<_, _>>()?;
    let columns = dem.grid.columns;
    let step = |(cell, z): (usize, &f32)| {
        let (x, y) = dem.grid.centre(cell / columns, cell % columns);
        let point = Vector3::new(x, y, f64::from(*z));
        let mut steps: Vec<f64> =
            if z.is_nan() { Vec::new() } else { views.iter().filter_map(|view| view.step_m(&point)).collect() };
        median(&mut steps).map_or(f32::NAN, |step| step as f32)
    };
    Ok(dem.bands[0].values.iter().enumerate().map(step).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Frame, Grid, Pair};
    use rockface_core::testing::{image_at, small_sensor};

    #[test]
    fn a_pixel_is_worth_depth_squared_over_focal_length_and_base() {
        let images = vec![image_at("a", [-1.0, 0.0, 20.0], [0.0; 3]), image_at("b", [1.0, 0.0, 20.0], [0.0; 3])];
        let block = Cameras { frame: Frame::Wall, sensors: vec![small_sensor()], images };
        let pair = Pair {
            name: "a+b".into(),
            first: "a".into(),
            second: "b".into(),
            baseline_m: 2.0,
            distance_m: 20.0,
            convergence_rad: 0.0,
            overlap: 1.0,
        };
        let grid = Grid { columns: 3, rows: 1, cell_m: 1.0, left_m: -0.5, top_m: 0.5 };
        let dem = Raster::single(grid, Frame::Wall, "elevation", "", vec![0.0, 10.0, f32::NAN]);
        let steps = elevation_step_m(&dem, &block, &Pairs { pairs: vec![pair] }).unwrap();
        let expected = |z: f64| z * z / (small_sensor().f * 2.0);
        assert!((f64::from(steps[0]) - expected(20.0)).abs() < 1e-5, "{steps:?}");
        assert!((f64::from(steps[1]) - expected(10.0)).abs() < 1e-5 && steps[2].is_nan(), "{steps:?}");
    }
}
