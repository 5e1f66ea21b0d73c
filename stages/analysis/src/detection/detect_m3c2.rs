//! `detect-m3c2`: finds detachments by the distances of two point clouds along local normals.

use nalgebra::Vector3;

use crate::detection::change::Change;
use crate::detection::cloud::Cloud;
use crate::detection::facing;
use crate::detection::found;
use crate::detection::found::Found;
use crate::detection::limit::{self, NORMAL_95};
use crate::detection::m3c2;
use crate::detection::m3c2::{Distance, Scales};
use crate::detection::{clusters, raster};
use rockface_core::artefact::{Artefact, Band, Frame, Grid, Kind, Raster, Transform};
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};
use rockface_raster::rasterise;
use rockface_raster::shape::{Moved, Shape};

/// Surface under a cell is plan area over the normal's Z; below this the cell is taken as no steeper.
const STEEPEST: f64 = 0.2;
/// The least share of distance times area that a volume is taken to have.
const LEAST_SHARE: f64 = 0.2;

params! {
    /// Parameters of `detect-m3c2`.
    pub struct DetectM3c2Params {
        /// Which changes are looked for.
        change: Change = Change::Loss,
        /// Cell of the grid in plan of which each holds one core point, metres.
        core_spacing_m: f64 = 0.05; Range::Positive,
        /// Radii of the spheres normals are taken from, metres; of several, the one whose points are most planar counts.
        normal_radii_m: Vec<f64> = vec![0.25]; Range::Positive,
        /// Radius of the cylinders, metres.
        projection_radius_m: f64 = 0.05; Range::Positive,
        /// Half the length of the cylinders, metres: greatest change that is seen.
        depth_m: f64 = 1.0; Range::Positive,
        /// Registration error, metres (standard deviation).
        registration_m: f64 = 0.005; Range::NonNegative,
        /// Least limit of detection, metres: where `lod95` is smaller, this counts.
        min_lod_m: f64 = 0.0; Range::NonNegative,
        /// Points a cylinder must hold of either cloud.
        least_points: u32 = 5; Range::AtLeast(2.0),
        /// Core points a detachment must have.
        least_cores: u32 = 2; Range::AtLeast(1.0),
    }
}

/// Finds detachments by M3C2, the distance of two clouds along local normals.
pub struct DetectM3c2;

impl Stage for DetectM3c2 {
    type Params = DetectM3c2Params;
    const NAME: &'static str = "detect-m3c2";
    const VERSION: u32 = 6;
    const PAGE: Page = Page::new(include_str!("detect_m3c2.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("reference", &[Kind::Surface, Kind::Mesh, Kind::Cloud], "The earlier epoch: its points or vertices."),
        Port::one("comparison", &[Kind::Surface, Kind::Mesh, Kind::Cloud], "The later epoch."),
        Port::optional("transform", &[Kind::Transform], "Applied to the comparison, such as a registration."),
        Port::optional("grid", &[Kind::Raster], "A raster whose window is searched; its cell is not taken."),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one("detections", &[Kind::Inventory], "One feature a cluster: outline, volume, area, depth, box, score."),
        Port::one("labels", &[Kind::Raster], "Number of the cluster of each core point, 0 for none."),
        Port::one("distances", &[Kind::Raster], "What is known at each core point."),
    ];

    fn check(params: &Self::Params) -> Vec<Fault> {
        let empty = params.normal_radii_m.is_empty();
        let fault = Fault { path: vec!["normal_radii_m".into()], ..Fault::new("at least one radius is needed") };
        if empty { vec![fault] } else { Vec::new() }
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let [reference, comparison] = ["reference", "comparison"].map(|port| shape(inputs, port));
        let (reference, comparison) = (reference?, comparison?);
        let frame = reference.frame();
        if frame != comparison.frame() {
            fail!("the reference is in the {frame} frame, the comparison in the {} frame", comparison.frame());
        }
        let warning = facing::check("reference", reference, facing::POINTS_FROM_ABOVE)?;
        warning.into_iter().for_each(|text| context.warn(text));
        let grid = grid(params, reference, inputs)?;
        let moved = inputs.optional::<Transform>("transform")?.and_then(Moved::by);
        let side = params.projection_radius_m;
        let cloud = |shape, moved, name: &str| {
            Cloud::new(shape, moved, side).ok_or_else(|| StageError::new(format!("the {name} has no points")))
        };
        let clouds = [cloud(reference, None, "reference")?, cloud(comparison, moved.as_ref(), "comparison")?];
        context.check_cancelled()?;
        let cores = m3c2::cores(&clouds[0], &grid);
        let distances = m3c2::distances([&clouds[0], &clouds[1]], &cores, &scales(params));
        let found = detect(params, &grid, &distances);
        report(&found, &distances, params, context)?;
        warn_of_depth(&distances, params, &grid, context);
        warn_of_low_limit(&distances, params, context);
        let labels = found::labels(&grid, frame, &found)?;
        let detections = found::inventory(&grid, frame, "m3c2", &found);
        let distances = bands(&grid, frame, &distances);
        Ok(Outputs::of("detections", detections).and("labels", labels).and("distances", distances))
    }
}

fn shape<'a>(inputs: &'a Inputs, port: &str) -> Result<Shape<'a>, StageError> {
    let artefact: &Artefact = inputs.artefact(port)?;
    Shape::of(artefact).ok_or_else(|| StageError::new(format!("port `{port}` needs a surface, a mesh or a cloud")))
}

fn grid(params: &DetectM3c2Params, reference: Shape, inputs: &Inputs) -> Result<Grid, StageError> {
    let window = inputs.optional::<Raster>("grid")?.map(|raster| {
        let Grid { columns, rows, cell_m, left_m, top_m } = raster.grid;
        [left_m, left_m + columns as f64 * cell_m, top_m - rows as f64 * cell_m, top_m]
    });
    let grid = if let Some(window) = window {
        rasterise::grid_of_window(window, params.core_spacing_m)
    } else {
        let extent = rasterise::extent(reference, None);
        let extent = extent.ok_or_else(|| StageError::new("the reference has no points"))?;
        rasterise::grid_around(extent, params.core_spacing_m)
    };
    grid.map_err(|e| e.hint("choose another `core_spacing_m`"))
}

fn scales(params: &DetectM3c2Params) -> Scales {
    Scales {
        normal_radii_m: params.normal_radii_m.clone(),
        projection_radius_m: params.projection_radius_m,
        depth_m: params.depth_m,
        registration_m: params.registration_m,
        least_points: params.least_points,
    }
}

fn detect(params: &DetectM3c2Params, grid: &Grid, distances: &[Option<Distance>]) -> Vec<Found> {
    let sign = params.change.sign();
    let limit = |found: &Distance| found.limit_m.max(params.min_lod_m);
    let significant = |found: &Distance| sign * found.distance_m > limit(found);
    let mask: Vec<bool> = distances.iter().map(|found| found.as_ref().is_some_and(significant)).collect();
    let groups = clusters::groups(&mask, grid.columns);
    let large = groups.into_iter().filter(|cells| cells.len() >= params.least_cores as usize);
    large.map(|cells| cluster(grid, &cells, distances, limit)).collect()
}

fn cluster(grid: &Grid, cells: &[usize], distances: &[Option<Distance>], limit: impl Fn(&Distance) -> f64) -> Found {
    let (mut straight, mut swept, mut deviation) = (0.0, 0.0, 0.0);
    let (mut sum, mut deepest, mut score) = (0.0, 0.0f64, 0.0f64);
    let (mut points, mut moment) = (Vec::with_capacity(8 * cells.len()), Vector3::zeros());
    let known = cells.iter().filter_map(|cell| Some((*cell, distances[*cell].as_ref()?)));
    for (cell, found) in known {
        let area = grid.cell_m * grid.cell_m / found.normal[2].max(STEEPEST);
        let size = found.distance_m.abs();
        straight += area * size;
        swept += area * size * m3c2::area_share(distances, cell, grid.columns);
        moment += area * size * (Vector3::from(found.core) + 0.5 * found.distance_m * Vector3::from(found.normal));
        deviation += area * limit(found) / NORMAL_95;
        sum += size;
        deepest = deepest.max(size);
        score = score.max(size / limit(found));
        points.extend(raster::corners(found.core, found.normal, found.distance_m, 0.5 * grid.cell_m));
    }
    // Shares of single cells are uncertain, those of all together are not; of a few noisy cells they may be anything.
    let volume = swept.clamp(LEAST_SHARE * straight, m3c2::MOST_SHARE * straight);
    Found {
        cells: cells.iter().map(|cell| (cell / grid.columns, cell % grid.columns)).collect(),
        area_m2: None,
        volume_m3: volume,
        volume_sd_m3: deviation,
        depth_max_m: deepest,
        depth_mean_m: sum / cells.len().max(1) as f64,
        score,
        centroid_m: (moment / straight).into(),
        points,
    }
}

fn bands(grid: &Grid, frame: Frame, distances: &[Option<Distance>]) -> Raster {
    type Value = fn(&Distance, [f64; 2]) -> f64;
    let bands: [(&str, Value); 12] = [
        ("distance", |d, _| d.distance_m),
        ("lod95", |d, _| d.limit_m),
        ("spread_reference", |d, _| d.spreads_m[0]),
        ("spread_comparison", |d, _| d.spreads_m[1]),
        ("points_reference", |d, _| d.points[0]),
        ("points_comparison", |d, _| d.points[1]),
        ("normal_x", |d, _| d.normal[0]),
        ("normal_y", |d, _| d.normal[1]),
        ("normal_z", |d, _| d.normal[2]),
        ("core_dx", |d, centre| d.core[0] - centre[0]),
        ("core_dy", |d, centre| d.core[1] - centre[1]),
        ("core_z", |d, _| d.core[2]),
    ];
    let centre = |cell: usize| grid.centre(cell / grid.columns, cell % grid.columns).into();
    let band = |(name, value): (&str, Value)| {
        let known = |(cell, found): (usize, &Option<Distance>)| {
            found.as_ref().map_or(f32::NAN, |d| value(d, centre(cell)) as f32)
        };
        Band { name: name.to_owned(), values: distances.iter().enumerate().map(known).collect() }
    };
    let mut raster = Raster::single(*grid, frame, "m3c2", "", Vec::new());
    raster.bands = bands.into_iter().map(band).collect();
    raster
}

fn report(
    found: &[Found],
    distances: &[Option<Distance>],
    params: &DetectM3c2Params,
    context: &Context,
) -> Result<(), StageError> {
    let cores = distances.iter().flatten().count();
    let mut limits: Vec<f64> = distances.iter().flatten().map(|d| d.limit_m).filter(|limit| !limit.is_nan()).collect();
    if limits.is_empty() {
        return Err(StageError::new(format!(
            "none of the {cores} core points has {} points of both clouds",
            params.least_points
        ))
        .hint("enlarge `projection_radius_m` or `depth_m`, and see whether the clouds overlap"));
    }
    let measured = limits.len();
    if 5 * measured < 4 * cores {
        context.warn(format!(
            "only {measured} of {cores} core points have {} points of both clouds within `projection_radius_m`, {} m; no change is found at \
             the others: enlarge it, or see whether the clouds overlap",
            params.least_points, params.projection_radius_m
        ));
    }
    let median = rockface_core::numerics::quantile::median(&mut limits).unwrap_or(f64::NAN);
    let volume = found.iter().fold(0.0, |sum, found| sum + found.volume_m3);
    context.metric("cores", cores as f64, "1");
    context.metric("measured_share", measured as f64 / cores as f64, "1");
    context.metric("lod95_median", median, "m");
    context.metric("detections", found.len() as f64, "1");
    context.metric("volume", volume, "m3");
    context.headline(format!(
        "{} changes of {} m3 together at {measured} core points, median LoD95 {:.1} mm",
        found.len(),
        found::volume_text(volume),
        1e3 * median
    ));
    Ok(())
}

/// Core points of a patch without a point of the comparison that is worth a warning, at least.
const PATCH_CORES: usize = 30;

/// Says where a patch of core points has no point of the comparison within reach, as under a rockfall that is deeper than the cylinders.
fn warn_of_depth(distances: &[Option<Distance>], params: &DetectM3c2Params, grid: &Grid, context: &Context) {
    let is_empty = |found: &Distance| found.points[1] < 1.0 && found.points[0] >= f64::from(params.least_points);
    let mask: Vec<bool> = distances.iter().map(|found| found.as_ref().is_some_and(is_empty)).collect();
    // A patch at the border may be where the comparison ends.
    let is_inner = |cell: &usize| {
        let (row, column) = (cell / grid.columns, cell % grid.columns);
        (1..grid.rows.saturating_sub(1)).contains(&row) && (1..grid.columns.saturating_sub(1)).contains(&column)
    };
    let groups = clusters::groups(&mask, grid.columns).into_iter();
    let largest = groups.filter(|cells| cells.iter().all(is_inner)).map(|cells| cells.len()).max().unwrap_or(0);
    if largest >= PATCH_CORES {
        let area_m2 = largest as f64 * grid.cell_m * grid.cell_m;
        context.warn(format!(
            "a patch of {area_m2:.3} m2 has no point of the comparison within `depth_m`, {} m: a change there is deeper, or nothing was seen; no \
             change is found in it",
            params.depth_m
        ));
    }
}

/// Noise beyond the limits counts as change.
fn warn_of_low_limit(distances: &[Option<Distance>], params: &DetectM3c2Params, context: &Context) {
    let known = || distances.iter().flatten().filter(|found| !found.limit_m.is_nan());
    let changes: Vec<f32> = known().map(|found| found.distance_m as f32).collect();
    let limits: Vec<f32> = known().map(|found| found.limit_m.max(params.min_lod_m) as f32).collect();
    let way = "raise `registration_m` or `min_lod_m`";
    limit::low(&limits, &changes)
        .into_iter()
        .for_each(|told| context.warn(format!("{told}: noise counts as change; {way}")));
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::Inventory;
    use rockface_core::testing::{TestHost, height_mesh, run_stage};

    #[test]
    fn a_box_shaped_niche_is_found_with_its_volume() {
        let plane = height_mesh(100, [-1.0, 1.0, -1.0, 1.0], |_, _| 0.0);
        let inside = |x: f64, y: f64| x.abs() < 0.3 && y.abs() < 0.2;
        let niche = height_mesh(100, [-1.0, 1.0, -1.0, 1.0], |x, y| if inside(x, y) { -0.1 } else { 0.0 });
        let with = json!({"projection_radius_m": 0.03, "normal_radii_m": [0.1], "core_spacing_m": 0.04});
        let inputs = [("reference", plane.clone().into()), ("comparison", niche.clone().into())];
        let made = run_stage::<DetectM3c2>(&TestHost::default(), &with, &inputs).unwrap().into_inner();
        let Artefact::Inventory(found) = &made["detections"] else { panic!("no inventory") };
        let number = |found: &Inventory, name: &str| found.numbers(name).unwrap()[0].unwrap();
        assert_eq!(found.features.len(), 1);
        assert!((number(found, "volume_m3") / 0.024 - 1.0).abs() < 0.1, "{}", number(found, "volume_m3"));
        assert!((number(found, "depth_max_m") - 0.1).abs() < 1e-9 && number(found, "score") > 9.0);
        let gain =
            json!({"change": "gain", "projection_radius_m": 0.03, "normal_radii_m": [0.1], "core_spacing_m": 0.04});
        let inputs = [("reference", plane.into()), ("comparison", niche.into())];
        let made = run_stage::<DetectM3c2>(&TestHost::default(), &gain, &inputs).unwrap().into_inner();
        let Artefact::Inventory(found) = &made["detections"] else { panic!("no inventory") };
        assert!(found.features.is_empty());
    }

    #[test]
    fn a_bump_on_a_slab_and_a_slanted_step_have_their_volumes() {
        // A paraboloid of half axes 0.4 and 0.3 m falls off, down to the slab.
        let bump = |height_m: f64, tilt: f64| {
            height_mesh(160, [-0.8, 0.8, -0.8, 0.8], move |x, y| {
                let beyond = (x / 0.4) * (x / 0.4) + (y / 0.3) * (y / 0.3);
                tilt * x + height_m * (1.0 - beyond).max(0.0)
            })
        };
        let volume = |before: rockface_core::artefact::Mesh, after: rockface_core::artefact::Mesh, change: &str| {
            let with = json!({"projection_radius_m": 0.02, "normal_radii_m": [0.04], "core_spacing_m": 0.02, "registration_m": 0, "min_lod_m": 0.003,
                "change": change});
            let inputs = [("reference", before.into()), ("comparison", after.into())];
            let made = run_stage::<DetectM3c2>(&TestHost::default(), &with, &inputs).unwrap().into_inner();
            let Artefact::Inventory(found) = &made["detections"] else { panic!("no inventory") };
            found.numbers("volume_m3").unwrap().into_iter().flatten().sum::<f64>()
        };
        for (height_m, tilt) in [(0.15, 0.0), (0.3, 0.0), (0.15, 0.5)] {
            let truth = 0.5 * std::f64::consts::PI * 0.4 * 0.3 * height_m;
            let lost = volume(bump(height_m, tilt), bump(0.0, tilt), "loss");
            assert!((lost / truth - 1.0).abs() < 0.1, "{height_m} {tilt}: {lost} of {truth}");
            let gained = volume(bump(0.0, tilt), bump(height_m, tilt), "gain");
            assert!((gained / truth - 1.0).abs() < 0.1, "{height_m} {tilt}: gain of {gained} of {truth}");
        }
    }

    #[test]
    fn a_niche_that_is_deeper_than_the_cylinders_is_warned_of() {
        let inside = |x: f64, y: f64| x.abs() < 0.3 && y.abs() < 0.3;
        let plane = height_mesh(80, [-1.0, 1.0, -1.0, 1.0], |_, _| 0.0);
        let niche = height_mesh(80, [-1.0, 1.0, -1.0, 1.0], |x, y| if inside(x, y) { -0.8 } else { 0.0 });
        let warnings = |depth_m: f64| {
            let host = TestHost::default();
            let with = json!({"projection_radius_m": 0.05, "normal_radii_m": [0.1], "core_spacing_m": 0.05, "depth_m": depth_m});
            run_stage::<DetectM3c2>(
                &host,
                &with,
                &[("reference", plane.clone().into()), ("comparison", niche.clone().into())],
            )
            .unwrap();
            host.warnings()
        };
        assert_eq!(warnings(1.0), Vec::<String>::new());
        let told = warnings(0.4);
        assert!(told.len() == 1 && told[0].contains("no point of the comparison within `depth_m`, 0.4 m"), "{told:?}");
    }

    #[test]
    fn clouds_that_hardly_meet_are_warned_of() {
        let whole = height_mesh(40, [-1.0, 1.0, -1.0, 1.0], |_, _| 0.0);
        let warnings = |left: f64, right: f64| {
            let part = height_mesh(40, [left, right, -1.0, 1.0], |_, _| 0.0);
            let host = TestHost::default();
            let with = json!({"projection_radius_m": 0.15, "normal_radii_m": [0.2], "core_spacing_m": 0.1});
            let inputs = [("reference", whole.clone().into()), ("comparison", part.into())];
            run_stage::<DetectM3c2>(&host, &with, &inputs).unwrap();
            host.warnings()
        };
        assert_eq!(warnings(-1.0, 1.0), Vec::<String>::new());
        let few = warnings(-1.0, -0.6);
        assert!(few.len() == 1 && few[0].contains("core points have 5 points of both clouds"), "{few:?}");
    }

    #[test]
    fn clouds_that_do_not_meet_are_refused_with_a_way_out() {
        let low = height_mesh(20, [-1.0, 1.0, -1.0, 1.0], |_, _| 0.0);
        let far = height_mesh(20, [8.0, 9.0, -1.0, 1.0], |_, _| 0.0);
        let inputs = [("reference", low.into()), ("comparison", far.into())];
        let error = run_stage::<DetectM3c2>(&TestHost::default(), &json!({}), &inputs).unwrap_err();
        assert!(error.message.contains("core points") && error.hint.unwrap().contains("overlap"));
    }
}
