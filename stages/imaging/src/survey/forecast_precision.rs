//! `forecast-precision`: forecasts the precision of a survey before it is flown, and compares it with a simulation.

use nalgebra::Vector3;

use crate::camera::model::Camera;
use crate::matching::noise::paper::{Interpolation, Variance};
use crate::survey::block_adjustment::propagation::{in_all, stereo_pairs};
use crate::survey::block_adjustment::tie_points::Visibility;
use crate::survey::forecast::{Joint, Matching, at_point};
use crate::survey::overlap::sample_vertices_where;
use rockface_core::artefact::{Band, Cameras, Covariance, Frame, Kind, Mesh, Pairs, Raster, Sample, Table};
use rockface_core::numerics::marginal::marginal;
use rockface_core::numerics::normal::NORMAL_95;
use rockface_core::numerics::quantile::median;
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, fail, params, table_row};
use rockface_raster::rasterise::{extent, grid_around, tin};
use rockface_raster::shape::Shape;
use rockface_raster::window;

/// Points for the figures of a pair.
const SAMPLES: usize = 2000;
/// Fewer vertices than these do not stand for a part of the face.
const FEW: usize = 200;
/// Points for the mean effect of orientation errors.
const EFFECT_POINTS: usize = 120;

params! {
    /// Parameters of `forecast-precision`.
    pub struct ForecastPrecisionParams {
        /// Standard deviation of the white disparity noise, pixels.
        sigma_local_px: f64 = 0.7; Range::NonNegative,
        /// Standard deviation of the smooth disparity noise, pixels.
        sigma_regular_px: f64 = 0.6; Range::NonNegative,
        /// How the smooth noise is interpolated between its nodes.
        kernel: Interpolation = Interpolation::CatmullRom,
        /// What the standard deviation of the smooth noise refers to.
        variance: Variance = Variance::Nodes,
        /// Side of a DEM cell, metres: white noise averages over its pixels.
        cell_m: f64 = 0.02; Range::Positive,
        /// Side of a cell of the forecast raster, metres.
        map_cell_m: f64 = 0.25; Range::Positive,
        /// Left, right, bottom and top of the part of the face that counts, metres; left out, all of it.
        window_m: Option<[f64; 4]> = None,
        /// Pairs listed in the table at most.
        most_pairs: usize = 200; Range::AtLeast(1.0),
    }
}

/// Forecasts ground sampling distance, depth precision and level of detection of a survey.
pub struct ForecastPrecision;

impl Stage for ForecastPrecision {
    type Params = ForecastPrecisionParams;
    const NAME: &'static str = "forecast-precision";
    const VERSION: u32 = 8;
    const PAGE: Page = Page::new(include_str!("forecast_precision.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("cameras", &[Kind::Cameras], "The planned block."),
        Port::one("mesh", &[Kind::Mesh], "The face, in the same frame."),
        Port::optional(
            "covariance",
            &[Kind::Covariance],
            "Its joint covariance; without it orientation is without error.",
        ),
        Port::optional("pairs", &[Kind::Pairs], "The pairs to list; without it all that make a stereo pair."),
        Port::optional(
            "difference",
            &[Kind::Raster],
            "A simulated no-change difference; it is compared with the forecast where it has values.",
        ),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one("table", &[Kind::Table], "One row a pair, one for all images, one for the places of the difference."),
        Port::one("raster", &[Kind::Raster], "Images, GSD, precision and LoD95 over the face."),
    ];

    fn check(params: &Self::Params) -> Vec<Fault> {
        window::faults(params.window_m)
    }

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        // The mesh with a search tree over its triangles, and the raster of its cells.
        inputs.times(2.3, "mesh") + 2 * inputs.of("difference")
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let (cameras, mesh): (&Cameras, &Mesh) = (inputs.one("cameras")?, inputs.one("mesh")?);
        if mesh.frame != cameras.frame {
            fail!("the mesh is in the {} frame, the cameras in the {} frame", mesh.frame, cameras.frame);
        }
        let covariance: Option<&Covariance> = inputs.optional("covariance")?;
        if let Some(covariance) = covariance.filter(|covariance| covariance.frame != cameras.frame) {
            fail!("the covariance is in the {} frame, the cameras in the {} frame", covariance.frame, cameras.frame);
        }
        let joint = covariance.map(|covariance| Joint::new(covariance, cameras)).transpose()?;
        let difference: Option<&Raster> = inputs.optional("difference")?;
        if let Some(difference) = difference.filter(|difference| difference.frame != mesh.frame) {
            fail!("the difference is in the {} frame, the mesh in the {} frame", difference.frame, mesh.frame);
        }
        let points = places(mesh, params.window_m, &|x, y| in_window(params.window_m, x, y))?;
        if points.is_empty() {
            fail!("no part of the face lies in `window_m`");
        }
        let compared_at = difference
            .map(|difference| places(mesh, Some(difference.grid.extent_m()), &|x, y| has_value(difference, x, y)));
        let compared_at = compared_at.transpose()?;
        if compared_at.as_ref().is_some_and(Vec::is_empty) {
            fail!("no part of the face lies where the difference has values");
        }
        let survey = Survey::new(params, cameras, joint, difference.is_some());
        let visibility = Visibility::new(cameras, mesh);
        let mut pairs = chosen_pairs(params, inputs.optional("pairs")?, cameras, &points, context)?;
        pairs.retain(|pair| !pair.iter().any(|image| visibility.is_behind(*image)));
        let mut rows = Vec::new();
        for pair in &pairs {
            context.check_cancelled()?;
            let name = format!("{}+{}", cameras.images[pair[0]].name, cameras.images[pair[1]].name);
            let seen: Vec<_> = in_all(cameras, pair, &points).into_iter().map(|point| (point, pair.to_vec())).collect();
            if let Some(forecast) = survey.forecast(&seen) {
                rows.push(forecast.row(name, Some(baseline_ratio(cameras, pair, &forecast)), None));
            }
        }
        let over = |points: &[Vector3<f64>]| {
            let seen: Vec<_> = points.iter().map(|point| (*point, visibility.images(point))).collect();
            survey.forecast(&seen)
        };
        let all = over(&points).ok_or_else(|| StageError::new("no part of the face lies in two images"))?;
        rows.push(all.row("all images".to_owned(), None, None));
        let compared = difference.zip(compared_at).map(|(difference, places)| over(&places).zip(simulated(difference)));
        let compared = match compared {
            Some(None) => fail!("the difference has no values where two images see the face"),
            other => other.flatten(),
        };
        if let Some((there, simulated)) = compared {
            rows.push(there.row("all images, where the difference has values".to_owned(), None, Some(simulated)));
        }
        report(&all, compared, context);
        let table: Table = rows.into_iter().collect();
        Ok(Outputs::of("table", table).and("raster", survey.raster(params, mesh, &visibility, all.orientation_m)?))
    }
}

table_row! {
    /// The forecast of a pair, or of all images.
    struct ForecastRow {
        of: String,
        points: usize,
        images: f64,
        gsd_m: f64,
        base_to_distance: Option<f64>,
        sigma_matching_m: f64,
        sigma_orientation_m: f64,
        sigma_z_m: f64,
        lod95_m: f64,
        median_lod95_m: f64,
        simulated_std_m: Option<f64>,
        simulated_nmad_m: Option<f64>,
        simulated_to_forecast: Option<f64>,
    }
}

/// The given pairs, else all images that make a stereo pair; at most as many as requested.
fn chosen_pairs(
    params: &ForecastPrecisionParams,
    given: Option<&Pairs>,
    cameras: &Cameras,
    points: &[Vector3<f64>],
    context: &Context,
) -> Result<Vec<[usize; 2]>, StageError> {
    let place = |name: &str| {
        let index = cameras.images.iter().position(|image| image.name == name);
        index.ok_or_else(|| StageError::new(format!("pairs: the block has no image `{name}`")))
    };
    let mut pairs = match given {
        Some(given) => given
            .pairs
            .iter()
            .map(|pair| Ok([place(&pair.first)?, place(&pair.second)?]))
            .collect::<Result<Vec<_>, StageError>>()?,
        None => stereo_pairs(cameras, points),
    };
    if pairs.len() > params.most_pairs {
        context.note(format!("{} pairs, the first {} are listed", pairs.len(), params.most_pairs));
        pairs.truncate(params.most_pairs);
    }
    Ok(pairs)
}

/// A block prepared for forecasts.
struct Survey<'a> {
    cameras: &'a Cameras,
    ready: Vec<Camera>,
    direction: Vector3<f64>,
    matching: Matching,
    joint: Option<Joint>,
}

/// Mean figures over some points.
#[derive(Debug, Clone, Copy)]
struct Forecast {
    points: usize,
    images: f64,
    gsd_m: f64,
    /// Root mean square.
    matching_m: f64,
    median_matching_m: f64,
    orientation_m: f64,
}

impl<'a> Survey<'a> {
    /// Elevations of a difference are along Z in every frame.
    fn new(params: &ForecastPrecisionParams, cameras: &'a Cameras, joint: Option<Joint>, along_z: bool) -> Self {
        let ready = cameras.images.iter().map(|image| Camera::new(cameras.sensor(image), image)).collect();
        let axes = cameras.images.iter().fold(Vector3::zeros(), |sum, image| sum + image.axis());
        let direction = if along_z || cameras.frame == Frame::Wall { Vector3::z() } else { axes.normalize() };
        let along = params.kernel.mean_variance();
        let share = if params.variance == Variance::Nodes { along * along } else { 1.0 };
        let regular_px = params.sigma_regular_px * share.sqrt();
        let matching = Matching { local_px: params.sigma_local_px, regular_px, cell_m: params.cell_m };
        Self { cameras, ready, direction, matching, joint }
    }

    fn cameras_of(&self, images: &[usize]) -> Vec<&Camera> {
        images.iter().map(|image| &self.ready[*image]).collect()
    }

    /// Root mean squares over points with the images that see each; `None` where no point has two.
    fn forecast(&self, seen: &[(Vector3<f64>, Vec<usize>)]) -> Option<Forecast> {
        let (mut images, mut gsd, mut squares) = (0.0, 0.0, 0.0);
        let mut matching = Vec::new();
        for (point, by) in seen {
            if let Some(expected) = at_point(&self.cameras_of(by), point, &self.direction, &self.matching) {
                images += by.len() as f64;
                gsd += expected.gsd_m;
                squares += expected.matching_m * expected.matching_m;
                matching.push(expected.matching_m);
            }
        }
        let count = matching.len() as f64;
        let median_matching_m = median(&mut matching)?;
        let stride = (seen.len() / EFFECT_POINTS).max(1);
        let some: Vec<_> = seen.iter().filter(|(_, by)| by.len() >= 2).step_by(stride).cloned().collect();
        let left = |joint: &Joint| joint.off_plane(self.cameras, &some, &self.direction);
        let orientation_m = self.joint.as_ref().and_then(left).unwrap_or(0.0);
        let matching_m = (squares / count).sqrt();
        let (points, images, gsd_m) = (matching.len(), images / count, gsd / count);
        Some(Forecast { points, images, gsd_m, matching_m, median_matching_m, orientation_m })
    }

    fn raster(
        &self,
        params: &ForecastPrecisionParams,
        mesh: &Mesh,
        visibility: &Visibility,
        orientation_m: f64,
    ) -> Result<Raster, StageError> {
        let vertices = mesh.surface_vertices();
        let shape = Shape::Mesh(mesh).on_surface(vertices.as_deref());
        let Some(whole) = extent(shape, None) else { fail!("the mesh has no vertices") };
        let extent = window::clipped(whole, params.window_m);
        let grid = grid_around(extent, params.map_cell_m).map_err(|e| e.hint("choose a larger `map_cell_m`"))?;
        let z = tin(shape, None, &grid);
        let names = ["images", "gsd_m", "sigma_z_m", "lod95_m"];
        let mut bands = names.map(|name| Band { name: name.to_owned(), values: vec![f32::NAN; grid.cells()] });
        for (cell, z) in z.iter().enumerate().filter(|(_, z)| z.is_finite()) {
            let (x, y) = grid.centre(cell / grid.columns, cell % grid.columns);
            let point = Vector3::new(x, y, f64::from(*z));
            let by = visibility.images(&point);
            bands[0].values[cell] = by.len() as f32;
            if let Some(expected) = at_point(&self.cameras_of(&by), &point, &self.direction, &self.matching) {
                let sigma = (expected.matching_m * expected.matching_m + orientation_m * orientation_m).sqrt();
                bands[1].values[cell] = expected.gsd_m as f32;
                bands[2].values[cell] = sigma as f32;
                bands[3].values[cell] = lod95(sigma) as f32;
            }
        }
        let quantity = "precision".to_owned();
        Ok(Raster { grid, frame: mesh.frame, quantity, sample: Sample::Float, bands: bands.into() })
    }
}

/// Level of detection: the smallest change between two epochs that differs from noise at 95 %.
fn lod95(sigma_m: f64) -> f64 {
    NORMAL_95 * std::f64::consts::SQRT_2 * sigma_m
}

fn baseline_ratio(cameras: &Cameras, pair: &[usize; 2], forecast: &Forecast) -> f64 {
    let [a, b] = pair.map(|image| &cameras.images[image]);
    let baseline = (a.centre() - b.centre()).norm();
    let focal = 0.5 * (cameras.sensor(a).f + cameras.sensor(b).f);
    baseline / (forecast.gsd_m * focal)
}

impl Forecast {
    fn sigma_m(&self) -> f64 {
        self.with_orientation(self.matching_m)
    }

    /// Level of detection at the place in the middle: half of the points have a smaller one.
    fn median_lod95_m(&self) -> f64 {
        lod95(self.with_orientation(self.median_matching_m))
    }

    fn with_orientation(&self, matching_m: f64) -> f64 {
        (matching_m * matching_m + self.orientation_m * self.orientation_m).sqrt()
    }

    fn row(&self, of: String, base_to_distance: Option<f64>, simulated: Option<[f64; 2]>) -> ForecastRow {
        let sigma = self.sigma_m();
        ForecastRow {
            of,
            points: self.points,
            images: self.images,
            gsd_m: self.gsd_m,
            base_to_distance,
            sigma_matching_m: self.matching_m,
            sigma_orientation_m: self.orientation_m,
            sigma_z_m: sigma,
            lod95_m: lod95(sigma),
            median_lod95_m: self.median_lod95_m(),
            simulated_std_m: simulated.map(|[std, _]| std),
            simulated_nmad_m: simulated.map(|[_, nmad]| nmad),
            simulated_to_forecast: simulated.map(|[std, _]| std / (std::f64::consts::SQRT_2 * sigma)),
        }
    }
}

/// Places of the face that are wanted within bounds (left, right, bottom, top), metres: vertices, or, where these are few, points of the triangles
/// on a grid.
fn places(
    mesh: &Mesh,
    within: Option<[f64; 4]>,
    wanted: &dyn Fn(f64, f64) -> bool,
) -> Result<Vec<Vector3<f64>>, StageError> {
    let vertices = sample_vertices_where(mesh, SAMPLES, wanted);
    if within.is_none() || vertices.len() >= FEW {
        return Ok(vertices);
    }
    let used = mesh.surface_vertices();
    let shape = Shape::Mesh(mesh).on_surface(used.as_deref());
    let Some(whole) = extent(shape, None) else { return Ok(vertices) };
    let bounds = window::clipped(whole, within);
    let area_m2 = (bounds[1] - bounds[0]) * (bounds[3] - bounds[2]);
    if !(bounds[0] < bounds[1] && bounds[2] < bounds[3]) {
        return Ok(vertices);
    }
    let grid = grid_around(bounds, (area_m2 / SAMPLES as f64).sqrt())?;
    let z = tin(shape, None, &grid);
    let place = |(cell, z): (usize, &f32)| {
        let (x, y) = grid.centre(cell / grid.columns, cell % grid.columns);
        (z.is_finite() && wanted(x, y)).then(|| Vector3::new(x, y, f64::from(*z)))
    };
    Ok(z.iter().enumerate().filter_map(place).collect())
}

/// Whether a place is in a window (left, right, bottom, top), metres; everywhere without one.
fn in_window(window_m: Option<[f64; 4]>, x: f64, y: f64) -> bool {
    window_m.is_none_or(|[left, right, bottom, top]| left <= x && x <= right && bottom <= y && y <= top)
}

/// Whether the first band of a raster has a value at a place.
fn has_value(raster: &Raster, x: f64, y: f64) -> bool {
    let value = raster.grid.cell_of([x, y]).zip(raster.bands.first()).map(|(cell, band)| band.values[cell]);
    value.is_some_and(f32::is_finite)
}

/// Standard deviation and NMAD of the first band of a difference, metres.
fn simulated(raster: &Raster) -> Option<[f64; 2]> {
    let spread = marginal(&raster.bands.first()?.values)?;
    Some([spread.deviation, spread.nmad])
}

/// Deviations of a difference in NMADs beyond which there are changes in it: noise with heavy tails stays below.
const CHANGED: f64 = 3.0;

fn report(all: &Forecast, compared: Option<(Forecast, [f64; 2])>, context: &Context) {
    let sigma = all.sigma_m();
    context.metric("gsd", all.gsd_m, "m");
    context.metric("sigma_z", sigma, "m");
    context.metric("lod95", lod95(sigma), "m");
    context.metric("median_lod95", all.median_lod95_m(), "m");
    let compared = compared.map_or_else(String::new, |(there, [std, nmad])| {
        if nmad > 0.0 && std > CHANGED * nmad {
            context.warn(format!(
                "the simulated difference deviates by {:.2} mm, {:.1} times its NMAD: there are changes in it, such as rockfalls, or outliers; the \
                 forecast is of a face without change",
                1000.0 * std,
                std / nmad
            ));
        }
        let expected = std::f64::consts::SQRT_2 * there.sigma_m();
        context.metric("simulated_to_forecast", std / expected, "1");
        let (std, expected, ratio) = (1000.0 * std, 1000.0 * expected, std / expected);
        format!("; the simulated difference deviates by {std:.2} mm, the forecast there is {expected:.2} mm (ratio {ratio:.2})")
    });
    context.headline(format!(
        "forecast: GSD {:.2} mm, depth to {:.2} mm, LoD95 {:.1} mm (half of the face has {:.1} mm or less){compared}",
        1000.0 * all.gsd_m,
        1000.0 * sigma,
        1000.0 * lod95(sigma),
        1000.0 * all.median_lod95_m()
    ));
}

#[cfg(test)]
mod tests;
