//! What one pixel of disparity is worth in elevation, by place on the face: the geometry of a survey on the cells of a grid.

use crate::camera::model::Camera;
use crate::matching::rectification::Rectification;
use crate::matching::side::Side;
use nalgebra::Vector3;
use rockface_core::StageError;
use rockface_core::artefact::{Cameras, Pair, Pairs, Raster};
use rockface_core::numerics::quantile::median;

/// A pair of images, ready to be asked what a pixel of its disparity is worth.
#[derive(Debug, Clone)]
struct View {
    pair: String,
    cameras: [Camera; 2],
    rectification: Rectification,
}

impl View {
    /// Whether both images show a point.
    fn shows(&self, point: &Vector3<f64>) -> bool {
        self.cameras.iter().all(|camera| camera.project(point).is_some_and(|pixel| camera.inside(pixel, 0.0)))
    }

    /// Metres of elevation for a pixel of disparity in the depth map of one of the images; `None` for points behind it.
    fn step_m(&self, point: &Vector3<f64>, side: Side) -> Option<f64> {
        let ray = self.cameras[side].to_camera(point);
        let distance_m = (self.rectification.rectified_from_camera[side] * ray).z;
        let parallax_px = self.rectification.focal_px * self.rectification.baseline_m / distance_m;
        (distance_m > 0.0).then(|| (point.z - self.cameras[side].centre().z).abs() / parallax_px)
    }
}

/// All pairs of a survey, ready to be asked what a pixel of disparity is worth.
#[derive(Debug, Clone)]
pub struct SurveySteps {
    views: Vec<View>,
}

impl SurveySteps {
    /// The pairs of a survey with the cameras of its block.
    ///
    /// # Errors
    /// An image that the block does not have, or two images from one place.
    pub fn new(block: &Cameras, pairs: &Pairs) -> Result<Self, StageError> {
        let image = |name: &str| {
            let image = block.image(name).ok_or_else(|| {
                StageError::new(format!("the cameras have no image `{name}`, which `pairs` names"))
                    .hint("select the pairs from these cameras: `select-pairs`")
            })?;
            Ok::<_, StageError>(Camera::new(block.sensor(image), image))
        };
        let view = |pair: &Pair| {
            let cameras = [image(&pair.first)?, image(&pair.second)?];
            let rectification = Rectification::new([&cameras[0], &cameras[1]], 1)?;
            Ok::<_, StageError>(View { pair: pair.name.clone(), cameras, rectification })
        };
        Ok(Self { views: pairs.pairs.iter().map(view).collect::<Result<_, _>>()? })
    }

    /// Metres of elevation for a pixel of disparity of the full image at a point: the median over the pairs that show it, as their first
    /// images see it; `None` where no pair does.
    pub fn at(&self, point: &Vector3<f64>) -> Option<f64> {
        let shown = self.views.iter().filter(|view| view.shows(point));
        median(&mut shown.filter_map(|view| view.step_m(point, Side::First)).collect::<Vec<_>>())
    }

    /// [`Self::at`], or where no pair shows the point, the median over all pairs.
    pub fn nearly_at(&self, point: &Vector3<f64>) -> Option<f64> {
        let all =
            || median(&mut self.views.iter().filter_map(|view| view.step_m(point, Side::First)).collect::<Vec<_>>());
        self.at(point).or_else(all)
    }

    /// What a pixel of disparity is worth in the depth map of an image of one pair, shown or not; `None` for points behind the image, and
    /// for a pair that the survey does not have.
    pub fn of_pair(&self, pair: &str, side: Side) -> impl Fn(&Vector3<f64>) -> Option<f64> {
        let view = self.views.iter().find(|view| view.pair == pair);
        move |point| view?.step_m(point, side)
    }
}

/// Metres of elevation for a pixel of disparity of the full image on each cell of a DEM: the median over the pairs that show the
/// cell; NaN where no pair does, or where the DEM has no value. Slopes are not regarded, nor what hides a point.
pub fn elevation_step_m(dem: &Raster, block: &Cameras, pairs: &Pairs) -> Result<Vec<f32>, StageError> {
    let steps = SurveySteps::new(block, pairs)?;
    let columns = dem.grid.columns;
    let step = |(cell, z): (usize, &f32)| {
        let (x, y) = dem.grid.centre(cell / columns, cell % columns);
        let point = Vector3::new(x, y, f64::from(*z));
        let step = if z.is_nan() { None } else { steps.at(&point) };
        step.map_or(f32::NAN, |step| step as f32)
    };
    Ok(dem.bands[0].values.iter().enumerate().map(step).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Frame, Grid};
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

    #[test]
    fn a_pair_says_what_its_own_pixels_are_worth_and_the_survey_the_median() {
        let image = |name: &str, x: f64, z: f64| image_at(name, [x, 0.0, z], [0.0; 3]);
        let images = vec![image("a", -1.0, 20.0), image("b", 1.0, 20.0), image("c", 3.0, 20.0)];
        let block = Cameras { frame: Frame::Wall, sensors: vec![small_sensor()], images };
        let pair = |first: &str, second: &str, baseline_m: f64| Pair {
            name: format!("{first}+{second}"),
            first: first.into(),
            second: second.into(),
            baseline_m,
            distance_m: 20.0,
            convergence_rad: 0.0,
            overlap: 1.0,
        };
        let pairs = vec![pair("a", "b", 2.0), pair("b", "c", 2.0), pair("a", "c", 4.0)];
        let steps = SurveySteps::new(&block, &Pairs { pairs }).unwrap();
        let point = Vector3::new(1.0, 0.0, 0.0);
        let of = |base: f64| 20.0 * 20.0 / (small_sensor().f * base);
        let near = |found: Option<f64>, expected: f64| (found.unwrap() - expected).abs() < 1e-9;
        assert!(near(steps.at(&point), of(2.0)) && near(steps.of_pair("a+c", Side::Second)(&point), of(4.0)));
        let outside = Vector3::new(500.0, 0.0, 0.0);
        assert!(steps.at(&outside).is_none() && near(steps.nearly_at(&outside), of(2.0)));
        let behind = Vector3::new(0.0, 0.0, 30.0);
        assert!(
            steps.of_pair("a+b", Side::First)(&behind).is_none() && steps.of_pair("x", Side::First)(&point).is_none()
        );
    }
}
