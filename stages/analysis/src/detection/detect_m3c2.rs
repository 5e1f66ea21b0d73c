//! `detect-m3c2`: finds detachments by the distances of two point clouds along local normals.

use nalgebra::Vector3;

use crate::detection::change::Change;
use crate::detection::cloud::Cloud;
use crate::detection::core_cells::CoreCells;
use crate::detection::facing;
use crate::detection::found;
use crate::detection::found::{Found, Heights};
use crate::detection::limit;
use crate::detection::m3c2;
use crate::detection::m3c2::{Distance, Scales};
use crate::detection::tested::{Tested, Whole};
use crate::detection::{clusters, raster, tested};
use rockface_core::artefact::{Artefact, Band, Frame, Grid, Kind, Raster, Transform};
use rockface_core::numerics::normal::NORMAL_95;
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};
use rockface_raster::rasterise;
use rockface_raster::shape::{self, Moved, Shape};

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
    const VERSION: u32 = 9;
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
        Port::one(
            "summary",
            &[Kind::Table],
            "One row: number and volume of the changes, and how much of the face was tested.",
        ),
    ];

    fn check(params: &Self::Params) -> Vec<Fault> {
        let empty = params.normal_radii_m.is_empty();
        let fault = Fault { path: vec!["normal_radii_m".into()], ..Fault::new("at least one radius is needed") };
        if empty { vec![fault] } else { Vec::new() }
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let (before, after) = (inputs.artefact("reference")?, inputs.artefact("comparison")?);
        let vertices = [before, after].map(shape::surface_vertices);
        let (reference, comparison) = (
            points("reference", before, vertices[0].as_deref())?,
            points("comparison", after, vertices[1].as_deref())?,
        );
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
        let cells = CoreCells::new(&cores, &grid, params.projection_radius_m);
        let measured = measured(&cores, &distances, &grid, params);
        let found = detect(params, &grid, &distances, &measured);
        let tested = tested(&cells, &measured, &grid);
        let median = report(&found, &distances, &cells, params, &tested, context)?;
        let few = warn_of_few(&distances, params, context);
        let gaps = warn_of_gaps(&distances, &cells, params, context);
        if !few && !gaps {
            tested.warning().into_iter().for_each(|text| context.warn(text));
        }
        warn_of_missing(&found, &grid, &cells, &measured, params, context);
        warn_of_depth(&distances, params, &grid, context);
        warn_of_low_limit(&distances, params, context);
        let labels = found::labels(&grid, frame, &found)?;
        let detections = found::inventory(&grid, frame, "m3c2", Heights::Known, &found);
        let summary = tested::summary("m3c2", params.change, &found, Some(median), &tested);
        let distances = bands(&grid, frame, &distances);
        let outputs = Outputs::of("detections", detections).and("labels", labels).and("distances", distances);
        Ok(outputs.and("summary", summary))
    }
}

/// The points of an epoch; of a mesh, those vertices that are on its surface.
fn points<'a>(port: &str, artefact: &'a Artefact, vertices: Option<&'a [bool]>) -> Result<Shape<'a>, StageError> {
    let shape = Shape::of(artefact).map(|shape| shape.on_surface(vertices));
    shape.ok_or_else(|| StageError::new(format!("port `{port}` needs a surface, a mesh or a cloud")))
}

fn grid(params: &DetectM3c2Params, reference: Shape, inputs: &Inputs) -> Result<Grid, StageError> {
    let window = inputs.optional::<Raster>("grid")?.map(|raster| raster.grid.extent_m());
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

/// The cells by core points with a distance: one without counts to the next that has one, as a cell without a core point does.
fn measured(
    cores: &[Option<[f64; 3]>],
    distances: &[Option<Distance>],
    grid: &Grid,
    params: &DetectM3c2Params,
) -> CoreCells {
    let has_distance = |found: &Distance| !found.limit_m.is_nan();
    let known =
        cores.iter().zip(distances).map(|(core, found)| core.filter(|_| found.as_ref().is_some_and(has_distance)));
    CoreCells::new(&known.collect::<Vec<_>>(), grid, params.projection_radius_m)
}

/// How much of the face counts to a core point with a distance, of all that is between core points.
fn tested(cells: &CoreCells, measured: &CoreCells, grid: &Grid) -> Tested {
    let counted = |cells: &CoreCells| (0..grid.cells()).filter(|cell| cells.owner(*cell).is_some()).count() as f64;
    let known = counted(measured);
    let share = known / (counted(cells) + cells.gaps as f64);
    Tested { share, whole: Whole::Reference, area_m2: known * grid.cell_m * grid.cell_m }
}

fn detect(params: &DetectM3c2Params, grid: &Grid, distances: &[Option<Distance>], cells: &CoreCells) -> Vec<Found> {
    let sign = params.change.sign();
    let limit = |found: &Distance| found.limit_m.max(params.min_lod_m);
    let significant = |found: &Distance| sign * found.distance_m > limit(found);
    let of_cell = |cell: usize| distances[cells.owner(cell)?].as_ref();
    let mask: Vec<bool> = (0..distances.len()).map(|cell| of_cell(cell).is_some_and(significant)).collect();
    let groups = clusters::groups(&mask, grid.columns);
    let cores = |group: &[usize]| group.iter().filter(|cell| cells.is_core(**cell)).count();
    let large = groups.into_iter().filter(|group| cores(group) >= params.least_cores as usize);
    large.map(|group| cluster(grid, &group, distances, cells, limit)).collect()
}

fn cluster(
    grid: &Grid,
    group: &[usize],
    distances: &[Option<Distance>],
    cells: &CoreCells,
    limit: impl Fn(&Distance) -> f64,
) -> Found {
    let (mut straight, mut swept, mut deviation) = (0.0, 0.0, 0.0);
    let (mut sum, mut deepest, mut score) = (0.0, 0.0f64, 0.0f64);
    let (mut points, mut moment) = (Vec::with_capacity(8 * group.len()), Vector3::zeros());
    let known = group.iter().filter_map(|cell| {
        let owner = cells.owner(*cell)?;
        Some((*cell, owner, distances[owner].as_ref()?))
    });
    for (cell, owner, found) in known {
        let area = grid.cell_m * grid.cell_m / found.normal[2].max(STEEPEST);
        let size = found.distance_m.abs();
        straight += area * size;
        swept += area * size * m3c2::area_share(distances, owner, cells);
        let place = if cell == owner {
            found.core
        } else {
            beside(found, grid.centre(cell / grid.columns, cell % grid.columns))
        };
        moment += area * size * (Vector3::from(place) + 0.5 * found.distance_m * Vector3::from(found.normal));
        deviation += area * limit(found) / NORMAL_95;
        sum += size;
        deepest = deepest.max(size);
        score = score.max(size / limit(found));
        points.extend(raster::corners(place, found.normal, found.distance_m, 0.5 * grid.cell_m));
    }
    // Shares of single cells are uncertain, those of all together are not; of a few noisy cells they may be anything.
    let volume = swept.clamp(LEAST_SHARE * straight, m3c2::MOST_SHARE * straight);
    Found {
        cells: group.iter().map(|cell| (cell / grid.columns, cell % grid.columns)).collect(),
        area_m2: None,
        volume_m3: volume,
        volume_sd_m3: deviation,
        depth_max_m: deepest,
        depth_mean_m: sum / group.len().max(1) as f64,
        score,
        centroid_m: (moment / straight).into(),
        points,
    }
}

/// The place over or under a point in plan in the plane of a core point and its normal, metres.
fn beside(found: &Distance, (x, y): (f64, f64)) -> [f64; 3] {
    let ([cx, cy, cz], [nx, ny, nz]) = (found.core, found.normal);
    [x, y, cz - ((x - cx) * nx + (y - cy) * ny) / nz.max(STEEPEST)]
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
    cells: &CoreCells,
    params: &DetectM3c2Params,
    tested: &Tested,
    context: &Context,
) -> Result<f64, StageError> {
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
    let median = rockface_core::numerics::quantile::median(&mut limits).unwrap_or(f64::NAN);
    let volume = found.iter().fold(0.0, |sum, found| sum + found.volume_m3);
    context.metric("cores", cores as f64, "1");
    let counted = || (0..distances.len()).filter_map(|cell| distances[cells.owner(cell)?].as_ref());
    let known = counted().filter(|found| !found.limit_m.is_nan()).count();
    context.metric("measured_share", known as f64 / (counted().count() + cells.gaps) as f64, "1");
    context.metric("tested_share", tested.share, "1");
    context.metric("lod95_median", median, "m");
    context.metric("detections", found.len() as f64, "1");
    context.metric("volume", volume, "m3");
    context.headline(format!(
        "{} changes of {} m3 together at {measured} core points, median LoD95 {:.1} mm{}",
        found.len(),
        found::volume_text(volume),
        1e3 * median,
        tested.words()
    ));
    Ok(median)
}

/// Says where a fifth of the core points or more have no distance; whether it did.
fn warn_of_few(distances: &[Option<Distance>], params: &DetectM3c2Params, context: &Context) -> bool {
    let cores = distances.iter().flatten().count();
    let measured = distances.iter().flatten().filter(|found| !found.limit_m.is_nan()).count();
    let are_few = 5 * measured < 4 * cores;
    if are_few {
        context.warn(format!(
            "only {measured} of {cores} core points have {} points of both clouds within `projection_radius_m`, {} m; the others \
             count to the nearest core point that has, where gaps are narrow, and elsewhere no change is found: enlarge it, or see whether the clouds overlap",
            params.least_points, params.projection_radius_m
        ));
    }
    are_few
}

/// Says where cells without a distance touch what was found: what was lost there is in no volume, and may part one change in several.
fn warn_of_missing(
    found: &[Found],
    grid: &Grid,
    cells: &CoreCells,
    measured: &CoreCells,
    params: &DetectM3c2Params,
    context: &Context,
) {
    let is_missing = |cell: usize| cells.owner(cell).is_some() && measured.owner(cell).is_none();
    if let Some([missing, cells]) = tested::beside(found, grid, is_missing) {
        context.warn(format!(
            "{missing} cells of core points without a distance touch the {cells} cells of what was found: what changed there is in no volume and may \
             part one change in several; enlarge `projection_radius_m`, {} m, or `depth_m`, {} m",
            params.projection_radius_m, params.depth_m
        ));
    }
}

/// Share of the cells that core points stand for from which on cells between them that they do not reach are more than a few.
const MANY_GAPS: f64 = 0.1;
/// Cells as wide as so many mean distances of points hold one each, but for a few.
const CELL_PER_DISTANCE: f64 = 2.0;

/// Says where many cells between core points hold no point and are farther from one than the cylinders reach: changes there have no volume. Whether
/// it did.
fn warn_of_gaps(
    distances: &[Option<Distance>],
    cells: &CoreCells,
    params: &DetectM3c2Params,
    context: &Context,
) -> bool {
    let held = (0..distances.len()).filter(|cell| cells.is_core(*cell)).count() as f64;
    let counted = (0..distances.len()).filter(|cell| cells.owner(*cell).is_some()).count() as f64;
    let gaps = cells.gaps as f64;
    let are_many = gaps > MANY_GAPS * counted;
    if are_many {
        let spacing_m = CELL_PER_DISTANCE * params.core_spacing_m * ((counted + gaps) / held).sqrt();
        context.warn(format!(
            "{:.0} % of the cells of `core_spacing_m`, {} m, between core points hold no point of the reference and are farther from one than \
             `projection_radius_m`, {} m: no change is found in them, and volumes are too small; enlarge `core_spacing_m` to about {spacing_m:.2} m",
            100.0 * gaps / (counted + gaps),
            params.core_spacing_m,
            params.projection_radius_m
        ));
    }
    are_many
}

/// Core points of a patch without a point of the comparison that is worth a warning, at least.
const PATCH_CORES: usize = 12;

/// Says where patches of core points have no point of the comparison within reach, as under a rockfall that is deeper than the cylinders, or
/// at an edge of the face where what is left is along the normals.
fn warn_of_depth(distances: &[Option<Distance>], params: &DetectM3c2Params, grid: &Grid, context: &Context) {
    let is_empty = |found: &Distance| found.points[1] < 1.0 && found.points[0] >= f64::from(params.least_points);
    let mask: Vec<bool> = distances.iter().map(|found| found.as_ref().is_some_and(is_empty)).collect();
    // A patch at the border may be where the comparison ends.
    let is_inner = |cell: &usize| {
        let (row, column) = (cell / grid.columns, cell % grid.columns);
        (1..grid.rows.saturating_sub(1)).contains(&row) && (1..grid.columns.saturating_sub(1)).contains(&column)
    };
    let groups = clusters::groups(&mask, grid.columns).into_iter();
    let patches: Vec<usize> = groups
        .filter(|cells| cells.len() >= PATCH_CORES && cells.iter().all(is_inner))
        .map(|cells| cells.len())
        .collect();
    if patches.is_empty() {
        return;
    }
    let area_m2 = patches.iter().sum::<usize>() as f64 * grid.cell_m * grid.cell_m;
    let which = if patches.len() == 1 { "a patch".to_owned() } else { format!("{} patches", patches.len()) };
    let (together, have) = if patches.len() == 1 { ("", "has") } else { (" together", "have") };
    context.warn(format!(
        "{which} of {area_m2:.3} m2{together} {have} no point of the comparison within `depth_m`, {} m, and `projection_radius_m`, {} m, of the \
         normals: a change there is deeper or at an edge of the face, or nothing was seen; no change is found there, so enlarge either, or look at \
         the same change with `detect-raster`",
        params.depth_m, params.projection_radius_m
    ));
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
mod tests;
