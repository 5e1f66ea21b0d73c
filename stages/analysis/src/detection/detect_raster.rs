//! `detect-raster`: finds detachments in a difference of elevations, by thresholds, opening and size.

use crate::detection::change::Change;
use crate::detection::found;
use crate::detection::found::{Found, Heights};
use crate::detection::limit;
use crate::detection::limit::Combination;
use crate::detection::tested::{Tested, Whole};
use crate::detection::{clusters, raster, tested};
use rockface_core::artefact::{Frame, Kind, Raster};
use rockface_core::numerics::normal::NORMAL_95;
use rockface_core::numerics::{marginal, portable_math, quantile};
use rockface_core::params::Range;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, choice, fail, params, union};
use rockface_raster::grid;

choice! {
    /// What is left of a cluster by the filter of width.
    pub enum Opening {
        /// The parts that are wide enough; thin parts at the margins are lost.
        Plain = "plain",
        /// The whole cluster where some part of it is wide enough (opening by reconstruction).
        Reconstruction = "reconstruction",
    }
}

params! {
    /// One limit for all cells.
    pub struct FixedLimit {
        /// The limit, metres.
        lod_m: f64 = 0.03; Range::Positive,
    }
}

params! {
    /// One limit for all cells, from the spread of the difference itself.
    pub struct EmpiricalLimit {
        /// Multiple of the spread, NMAD = 1.4826 median |d - median d|.
        factor: f64 = NORMAL_95; Range::Positive,
    }
}

params! {
    /// A limit for each cell, from the roughness of both surfaces and the registration error.
    pub struct RoughnessLimit {
        /// Registration error, metres (standard deviation).
        registration_m: f64; Range::NonNegative,
        /// Cells in every direction over which roughness is taken.
        reach_cells: u32 = 2; Range::Between(1.0, 50.0),
    }
}

union! {
    /// The limit of detection at 95 %.
    pub enum Limit {
        /// The same for all cells, given.
        Fixed(FixedLimit) = "fixed",
        /// The same for all cells, from the spread of the difference.
        Empirical(EmpiricalLimit) = "empirical",
        /// 1.96 sqrt(s1^2 + s2^2 + registration^2) of each cell.
        Quadrature(RoughnessLimit) = "quadrature",
        /// 1.96 (sqrt(s1^2 + s2^2) + registration) of each cell.
        Lague(RoughnessLimit) = "lague",
    }
}

params! {
    /// Parameters of `detect-raster`.
    pub struct DetectRasterParams {
        /// Which changes are looked for.
        change: Change = Change::Loss,
        /// The limit of detection: changes below it do not count.
        lod: Limit = Limit::Fixed(FixedLimit::default()),
        /// Least width of a change, metres, in whole cells rounded up: side of the square of the opening; 0 leaves it out.
        min_width_m: f64 = 0.04; Range::NonNegative,
        /// Iterations of the opening: n erosions, then n dilations.
        iterations: u32 = 1; Range::Between(0.0, 1000.0),
        /// What is left of a cluster by the filter of width.
        opening: Opening = Opening::Plain,
        /// Least width over length of a cluster, by its principal axes; 0 lets all pass.
        min_axis_ratio: f64 = 0.0; Range::Between(0.0, 1.0),
        /// Least area of a cluster, square metres.
        min_area_m2: f64 = 0.0016; Range::NonNegative,
    }
}

/// Finds detachments in a difference of elevations.
pub struct DetectRaster;

impl Stage for DetectRaster {
    type Params = DetectRasterParams;
    const NAME: &'static str = "detect-raster";
    const VERSION: u32 = 6;
    const PAGE: Page = Page::new(include_str!("detect_raster.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("difference", &[Kind::Raster], "Comparison minus reference, one band."),
        Port::optional(
            "reference",
            &[Kind::Raster],
            "Elevations before: for boxes, places in the world and roughness.",
        ),
        Port::optional("comparison", &[Kind::Raster], "Elevations after: for roughness."),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one("detections", &[Kind::Inventory], "One feature a cluster: outline, volume, area, depth, box, score."),
        Port::one("labels", &[Kind::Raster], "Number of the cluster of each cell, 0 for none."),
        Port::one(
            "summary",
            &[Kind::Table],
            "One row: number and volume of the changes, and how much of the face was tested.",
        ),
    ];

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let difference = inputs.one::<Raster>("difference")?;
        let [band] = difference.bands.as_slice() else {
            fail!("the difference has {} bands, one is needed", difference.bands.len())
        };
        if difference.quantity != "difference" {
            context.warn(format!("the raster holds the quantity `{}`, not `difference`", difference.quantity));
        }
        let reference = on_grid("reference", inputs, difference)?;
        let comparison = on_grid("comparison", inputs, difference)?;
        let sign = params.change.sign();
        let lost: Vec<f64> = band.values.iter().map(|d| sign * f64::from(*d)).collect();
        let limits = limits(&params.lod, &band.values, [reference, comparison], difference.grid.columns)?;
        let limit = quantile::median(&mut marginal::known(&limits)).unwrap_or(f64::NAN);
        let explained = warn_of_low_limit(&params.lod, &limits, &band.values, context)
            | warn_of_offset(limit, &band.values, context)
            | warn_of_uneven_noise(&params.lod, difference, context);
        if !explained {
            warn_of_heavy_tails(&lost, &limits, params, context);
        }
        warn_of_single_cells(params, difference.grid.cell_m, context);
        let found = detect(params, difference, &lost, &limits, reference);
        let tested = tested(&limits, &lost, reference, difference.grid.cell_m)?;
        report(&found, limit, &tested, context);
        tested.warning().into_iter().for_each(|text| context.warn(text));
        warn_of_missing(&found, difference, context);
        let labels = found::labels(&difference.grid, difference.frame, &found)?;
        let heights = if reference.is_some() { Heights::Known } else { Heights::Unknown };
        if heights == Heights::Unknown && !found.is_empty() {
            tell_of_heights(difference.frame, context);
        }
        let detections = found::inventory(&difference.grid, difference.frame, "raster", heights, &found);
        let summary = tested::summary("raster", params.change, &found, Some(limit), &tested);
        Ok(Outputs::of("detections", detections).and("labels", labels).and("summary", summary))
    }
}

/// The values of an optional raster that must lie on the grid of the difference.
fn on_grid<'a>(port: &str, inputs: &'a Inputs, difference: &Raster) -> Result<Option<&'a [f32]>, StageError> {
    let Some(raster) = inputs.optional::<Raster>(port)? else { return Ok(None) };
    if !grid::same(&raster.grid, &difference.grid) || raster.frame != difference.frame {
        let (a, b) = (grid::describe(&raster.grid), grid::describe(&difference.grid));
        fail!("`{port}` has {a} ({} frame), the difference {b} ({} frame)", raster.frame, difference.frame);
    }
    let [band] = raster.bands.as_slice() else { fail!("`{port}` has {} bands, one is needed", raster.bands.len()) };
    Ok(Some(&band.values))
}

/// The limit of each cell, metres; NaN where there is none.
fn limits(
    limit: &Limit,
    difference: &[f32],
    elevations: [Option<&[f32]>; 2],
    columns: usize,
) -> Result<Vec<f32>, StageError> {
    match limit {
        Limit::Fixed(FixedLimit { lod_m }) => Ok(vec![*lod_m as f32; difference.len()]),
        Limit::Empirical(EmpiricalLimit { factor }) => {
            let spread = marginal::nmad(difference);
            if spread.is_nan() || spread <= 0.0 {
                return Err(StageError::new("the difference has no spread (NMAD 0): no empirical limit of detection")
                    .hint("a noise-free difference needs `lod: {fixed: {lod_m: ...}}`"));
            }
            Ok(vec![(factor * spread) as f32; difference.len()])
        }
        Limit::Quadrature(rough) => by_roughness(rough, Combination::Quadrature, elevations, columns),
        Limit::Lague(rough) => by_roughness(rough, Combination::Lague, elevations, columns),
    }
}

/// Noise beyond a limit that does not come from the difference itself counts as change. Returns whether it warned.
fn warn_of_low_limit(limit: &Limit, limits: &[f32], difference: &[f32], context: &Context) -> bool {
    let lod_m = match limit {
        Limit::Fixed(FixedLimit { lod_m }) => lod_m,
        Limit::Empirical(_) => return false,
        Limit::Quadrature(_) | Limit::Lague(_) => {
            let way = "raise `registration_m`, or take `lod: {empirical: {}}`";
            let told = limit::low(limits, difference);
            told.iter().for_each(|told| context.warn(format!("{told}: noise counts as change; {way}")));
            return told.is_some();
        }
    };
    let least_m = NORMAL_95 * marginal::nmad(difference);
    let is_low = *lod_m < least_m;
    if is_low {
        context.warn(format!(
            "the limit of detection, {lod_m} m, is less than 1.96 times the spread (NMAD) of the difference, {least_m:.3} m: noise counts \
             as change; raise `lod_m`, or take `lod: {{empirical: {{}}}}`"
        ));
    }
    is_low
}

/// The part of the limit by which a difference may lie off zero: with more, the cells without change beyond a limit of 1.96 times the
/// spread are more than twice as many on one side.
const OFFSET_SHARE: f64 = 0.15;

/// A limit says how far differences without change lie from zero, not from their middle. Returns whether it warned.
fn warn_of_offset(limit: f64, difference: &[f32], context: &Context) -> bool {
    let Some(offset) = quantile::median(&mut marginal::known(difference)) else { return false };
    let is_off = offset.abs() > OFFSET_SHARE * limit;
    if is_off {
        context.warn(format!(
            "half of the differences lie above {:.1} mm, where without change it is 0, and the limit of detection is {:.1} mm: the offset \
             counts as change and in its volumes; register the epochs on what is stable (`register-icp`)",
            1e3 * offset,
            1e3 * limit
        ));
    }
    is_off
}

/// How many times the share of cells that noise of a normal distribution has beyond the limit on one side a warning is due.
const HEAVY: f64 = 1.6;

/// Where nothing else explains it, more cells beyond the limit on both sides than normally distributed noise has there are noise with heavier tails. Changes
/// are on one side, and noise that is alike over many cells is by chance on one side too.
fn warn_of_heavy_tails(lost: &[f64], limits: &[f32], params: &DetectRasterParams, context: &Context) {
    let factor = if let Limit::Empirical(EmpiricalLimit { factor }) = params.lod { factor } else { NORMAL_95 };
    let expected = 0.5 * portable_math::erfc(factor / std::f64::consts::SQRT_2);
    let known = || lost.iter().zip(limits).filter(|(lost, limit)| !lost.is_nan() && !limit.is_nan());
    let share = |sign: f64| {
        let beyond = known().filter(|(lost, limit)| sign * **lost > f64::from(**limit)).count();
        beyond as f64 / known().count().max(1) as f64
    };
    let [wanted, other] = [share(1.0), share(-1.0)];
    if wanted.min(other) > HEAVY * expected {
        let change = params.change;
        let word = if change == Change::Loss { Change::Gain } else { Change::Loss }.word();
        context.warn(format!(
            "{:.1} % of the cells are beyond the limit of detection as a {word}, where normally distributed noise has {:.1} %: noise with heavier tails is as often \
             beyond it as a {}; raise the limit (`factor` or `lod_m`) or `min_area_m2`, unless there are changes of both kinds",
            100.0 * other,
            100.0 * expected,
            change.word()
        ));
    }
}

/// Windows along each side in which the spread is looked at, the fewest cells of a window and the fewest windows.
const WINDOWS: usize = 8;
const WINDOW_CELLS: usize = 100;
const FEWEST_WINDOWS: usize = 16;
/// From how many times the spread of a quiet window (10 %) that of a noisy one (90 %) is called uneven.
const UNEVEN: f64 = 3.0;

/// One limit for all cells is too large in one place and too small in another where the noise is not the same everywhere. Returns whether it
/// warned.
fn warn_of_uneven_noise(limit: &Limit, difference: &Raster, context: &Context) -> bool {
    if !matches!(limit, Limit::Fixed(_) | Limit::Empirical(_)) {
        return false;
    }
    let (grid, values) = (&difference.grid, &difference.bands[0].values);
    let mut windows: Vec<Vec<f32>> = vec![Vec::new(); WINDOWS * WINDOWS];
    for (row, cells) in values.chunks(grid.columns.max(1)).enumerate() {
        for (column, value) in cells.iter().enumerate().filter(|(_, value)| !value.is_nan()) {
            windows[row * WINDOWS / grid.rows * WINDOWS + column * WINDOWS / grid.columns].push(*value);
        }
    }
    let spreads: Vec<f64> = windows.iter().filter(|w| w.len() >= WINDOW_CELLS).map(|w| marginal::nmad(w)).collect();
    let quiet_and_noisy = [0.1, 0.9].map(|share| quantile::quantile(&spreads, share).unwrap_or(0.0));
    let is_uneven = spreads.len() >= FEWEST_WINDOWS && quiet_and_noisy[1] > UNEVEN * quiet_and_noisy[0];
    if is_uneven {
        let [quiet, noisy] = quiet_and_noisy.map(|spread| 1e3 * spread);
        context.warn(format!(
            "the noise is uneven: its spread (NMAD) is {quiet:.1} mm in quiet places and {noisy:.1} mm in noisy ones; with one limit for all \
             cells noise counts as change there, and deviations of volumes are too small there and too large elsewhere: take `lod: {{lague: ...}}`, \
             or crop to places that are alike"
        ));
    }
    is_uneven
}

/// Says what is not known of changes without elevations. It is worth a warning where the places in the world could be known.
fn tell_of_heights(frame: Frame, context: &Context) {
    let lying = "without `reference` centroids and boxes lie between 0 and the difference";
    if frame.wall_from_world().is_some() {
        context.warn(format!(
            "{lying}, so `centroid_world_x_m`, `_y_m` and `_z_m` stay empty: connect the elevations before to `reference`"
        ));
    } else {
        context.note(format!("{lying}: connect the elevations before to `reference` where places matter"));
    }
}

fn by_roughness(
    rough: &RoughnessLimit,
    how: Combination,
    elevations: [Option<&[f32]>; 2],
    columns: usize,
) -> Result<Vec<f32>, StageError> {
    let [Some(reference), Some(comparison)] = elevations else {
        return Err(StageError::new("a limit from roughness needs both elevations")
            .hint("connect `reference` and `comparison`, or take `lod: empirical`"));
    };
    let reach = rough.reach_cells as usize;
    let [first, second] = [reference, comparison].map(|values| limit::roughness(values, columns, reach));
    let limit = |(a, b): (&f32, &f32)| limit::combined(f64::from(*a), f64::from(*b), rough.registration_m, how) as f32;
    Ok(first.iter().zip(&second).map(limit).collect())
}

fn detect(
    params: &DetectRasterParams,
    difference: &Raster,
    lost: &[f64],
    limits: &[f32],
    reference: Option<&[f32]>,
) -> Vec<Found> {
    let (grid, columns) = (&difference.grid, difference.grid.columns);
    let beyond: Vec<bool> = lost.iter().zip(limits).map(|(d, limit)| *d > f64::from(*limit)).collect();
    let side = raster::whole_cells(params.min_width_m, grid.cell_m);
    let side = if side < 2 { 1 } else { params.iterations as usize * (side - 1) + 1 };
    let opened = clusters::opened(&beyond, columns, side);
    let kept = match params.opening {
        Opening::Plain => opened,
        Opening::Reconstruction => clusters::reconstructed(&beyond, &opened, columns),
    };
    let least_cells = raster::whole_cells(params.min_area_m2, grid.cell_m * grid.cell_m);
    let mut groups = clusters::groups(&kept, columns);
    groups.retain(|cells| cells.len() >= least_cells && clusters::axis_ratio(cells, columns) >= params.min_axis_ratio);
    let factor = if let Limit::Empirical(EmpiricalLimit { factor }) = params.lod { factor } else { NORMAL_95 };
    let surface = |cell: usize| reference.map_or(0.0, |z| f64::from(z[cell]));
    let sign = params.change.sign();
    groups.iter().map(|cells| raster::cluster(grid, cells, |c| (surface(c), sign * lost[c]), limits, factor)).collect()
}

/// Says where the filters of width and area let single cells pass, as their defaults do in coarse rasters.
fn warn_of_single_cells(params: &DetectRasterParams, cell_m: f64, context: &Context) {
    let (width_m, area_m2) = (params.min_width_m, params.min_area_m2);
    let is_filtered = raster::whole_cells(width_m, cell_m) > 1 || raster::whole_cells(area_m2, cell_m * cell_m) > 1;
    if !is_filtered && (width_m > 0.0 || area_m2 > 0.0) {
        context.warn(format!(
            "`min_width_m` {width_m} and `min_area_m2` {area_m2} are no more than a cell of {cell_m} m: single cells count as changes; give a \
             width of two cells and an area of four, or more"
        ));
    }
}

/// Says where cells without a value touch what was found: what was lost there is in no volume, and may part one change in several.
fn warn_of_missing(found: &[Found], difference: &Raster, context: &Context) {
    let values = &difference.bands[0].values;
    if let Some([missing, cells]) = tested::beside(found, &difference.grid, |cell| values[cell].is_nan()) {
        context.warn(format!(
            "{missing} cells without a value touch the {cells} cells of what was found: what changed there is in no volume and may part one change in \
             several; see the pictures of both surveys"
        ));
    }
}

/// How much of the face of the reference, or of the grid where that is not given, has a difference and a limit of detection.
fn tested(limits: &[f32], lost: &[f64], reference: Option<&[f32]>, cell_m: f64) -> Result<Tested, StageError> {
    let is_tested = |cell: &usize| !lost[*cell].is_nan() && !limits[*cell].is_nan();
    let cells = (0..lost.len()).filter(is_tested).count();
    if cells == 0 {
        fail!("no cell has a difference and a limit of detection");
    }
    let area_m2 = cells as f64 * cell_m * cell_m;
    let face = reference.map(|z| (0..z.len()).filter(|cell| !z[*cell].is_nan()).collect::<Vec<usize>>());
    Ok(match face.filter(|face| !face.is_empty()) {
        Some(face) => {
            let share = face.iter().filter(|cell| is_tested(cell)).count() as f64 / face.len() as f64;
            Tested { share, whole: Whole::Reference, area_m2 }
        }
        None => Tested { share: cells as f64 / lost.len() as f64, whole: Whole::Grid, area_m2 },
    })
}

fn report(found: &[Found], median: f64, tested: &Tested, context: &Context) {
    let volume = found.iter().fold(0.0, |sum, found| sum + found.volume_m3);
    context.metric("tested_share", tested.share, "1");
    context.metric("lod95_median", median, "m");
    context.metric("detections", found.len() as f64, "1");
    context.metric("volume", volume, "m3");
    context.headline(format!(
        "{} changes of {} m3 together beyond {:.1} mm{}",
        found.len(),
        found::volume_text(volume),
        1e3 * median,
        tested.words()
    ));
}

#[cfg(test)]
mod tests;
