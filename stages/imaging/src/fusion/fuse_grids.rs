//! `fuse-grids`: fuses the grids of many images to one 2.5D surface.

use crate::fusion::grid_fusion::{FusedGrid, common_grid, fuse_grids, surface_of};
use rockface_core::artefact::{Band, Frame, Grid, Kind, Raster, Sample};
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Point, Port, Stage, StageError, fail, params};
use rockface_raster::rasterise::{MAXIMUM_CELLS, grid_around};
use rockface_raster::robust_mean::{Averaging, Rule};
use rockface_raster::window;

params! {
    /// Parameters of `fuse-grids`.
    pub struct FuseGridsParams {
        /// How the elevations of the images that agree become one.
        averaging: Averaging = Averaging::Median,
        /// Fewest images that must agree on a cell.
        min_images: u32 = 2; Range::AtLeast(1.0),
        /// An elevation is rejected beyond so many robust deviations from the weighted median of the images (1.4826 times the
        /// median absolute deviation), or so many of its own sigma where that is more.
        rejection: f64 = 3.0; Range::Positive,
        /// Distance from the weighted median within which nothing is rejected, metres.
        tolerance_m: f64 = 0.0; Range::NonNegative,
        /// Neighbouring cells that differ by more are not joined, metres; null: all are, as in a TIN.
        max_step_m: Option<f64> = None; Range::Positive,
        /// Window (left, right, bottom, top) in metres; null: all that the images see.
        window_m: Option<[f64; 4]> = None,
    }
}

/// Fuses the elevation grids of many images (`grid-depth`) to one 2.5D surface.
pub struct FuseGrids;

impl Stage for FuseGrids {
    type Params = FuseGridsParams;
    const NAME: &'static str = "fuse-grids";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("fuse_grids.md"));
    const INPUTS: &'static [Port] =
        &[Port::many("grids", &[Kind::Raster], "Bands `elevation` and `sigma` of each image.")];
    const OUTPUTS: &'static [Port] = &[
        Port::one("surface", &[Kind::Surface], "The fused surface."),
        Port::one("raster", &[Kind::Raster], "Bands `elevation`, `images` and `sigma`."),
    ];

    fn check(params: &Self::Params) -> Vec<Fault> {
        window::faults(params.window_m)
    }

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        // All grids at once; the fused grid, its surface and their files.
        inputs.total() + 7 * inputs.largest("grids")
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let grids = inputs.many::<Raster>("grids")?;
        for given in &grids {
            check_bands(given)?;
        }
        let grids = with_values(grids, context)?;
        let label = |index: usize| label(grids[index].0);
        let rasters: Vec<&Raster> = grids.iter().map(|(_, raster)| *raster).collect();
        if let Some(index) = rasters.iter().position(|raster| raster.frame != rasters[0].frame) {
            let frame = rasters[index].frame;
            fail!("grid `{}` is in the {frame} frame, the first one in the {} frame", label(index), rasters[0].frame);
        }
        let whole = common_grid(&rasters).map_err(|(index, what)| {
            StageError::new(format!("grid `{}` {what}", label(index)))
                .hint("make all grids by `grid-depth` with one `cell_m`")
        })?;
        let grid = part(params, whole)?;
        let rule = Rule {
            averaging: params.averaging,
            rejection: params.rejection,
            tolerance_m: params.tolerance_m,
            minimum: params.min_images as usize,
        };
        let fused = fuse_grids(&rasters, &grid, &rule);
        let filled = report(&fused, rasters.len(), context);
        if filled == 0 {
            let (n, least) = (rasters.len(), params.min_images);
            return Err(StageError::new(format!("of {n} images no {least} agree on any of {} cells", grid.cells()))
                .hint("lower `min_images`, raise `rejection` or `tolerance_m`, or check that the images overlap in the window"));
        }
        let frame = rasters[0].frame;
        let (surface, triangles) = surface_of(&grid, &fused.elevation_m, frame, params.max_step_m);
        context.metric("triangles", triangles as f64, "1");
        Ok(Outputs::of("surface", surface).and("raster", raster_of(fused, frame)))
    }
}

/// A grid and the axis items of the instance it comes from.
type Given<'a> = (&'a Point, &'a Raster);

fn label(point: &Point) -> String {
    point.values().cloned().collect::<Vec<_>>().join(", ")
}

fn check_bands((point, raster): &Given) -> Result<(), StageError> {
    let names: Vec<&str> = raster.bands.iter().map(|band| band.name.as_str()).collect();
    if names == ["elevation", "sigma"] {
        return Ok(());
    }
    let text = format!("grid `{}` has the bands {}, not elevation, sigma", label(point), names.join(", "));
    Err(StageError::new(text).hint("`grid-depth` makes such grids"))
}

/// The grids with at least one value; images that see nothing of the window have grids without values.
fn with_values<'a>(mut grids: Vec<Given<'a>>, context: &Context) -> Result<Vec<Given<'a>>, StageError> {
    let all = grids.len();
    grids.retain(|(_, raster)| raster.bands[0].values.iter().any(|z| !z.is_nan()));
    if grids.is_empty() {
        let error = StageError::new(format!("none of {all} grids has a value: no image sees anything of the window"));
        return Err(error.hint("widen the `window_m` of `grid-depth`, or look at the depth maps"));
    }
    if grids.len() < all {
        context.metric("empty_grids", (all - grids.len()) as f64, "1");
    }
    Ok(grids)
}

/// The requested part of the common grid, on the same lattice.
fn part(params: &FuseGridsParams, whole: Grid) -> Result<Grid, StageError> {
    let grid = match params.window_m {
        None => whole,
        // Shrunk by 1e-6 cells, so that a window of whole cells does not include a further row or column.
        Some([left, right, bottom, top]) => {
            let hair = 1e-6 * whole.cell_m;
            grid_around([left + hair, right - hair, bottom + hair, top - hair], whole.cell_m)
                .map_err(|e| e.hint("choose another `window_m`: left, right, bottom, top, metres"))?
        }
    };
    if grid.cells() as f64 > MAXIMUM_CELLS {
        let error =
            StageError::new(format!("the images span {} x {} cells of {} m", grid.columns, grid.rows, grid.cell_m));
        return Err(error.hint(format!("more than {MAXIMUM_CELLS:.1e} cells: choose a `window_m` or larger cells")));
    }
    Ok(grid)
}

/// Logs what was fused; returns the number of cells with a value.
fn report(fused: &FusedGrid, images: usize, context: &Context) -> usize {
    let filled = fused.images.iter().filter(|count| **count > 0.0).count();
    let (cells, some) = (fused.grid.cells() as f64, filled.max(1) as f64);
    context.metric("images", images as f64, "1");
    context.metric("coverage", filled as f64 / cells, "1");
    context.metric("images_per_cell", fused.values[1] as f64 / some, "1");
    context.metric("rejected_share", 1.0 - fused.values[1] as f64 / fused.values[0].max(1) as f64, "1");
    let sigma_m = fused.sigma_m.iter().filter(|s| s.is_finite()).map(|s| f64::from(*s)).sum::<f64>() / some;
    context.metric("expected_sigma", sigma_m, "m");
    context.headline(format!(
        "{images} images, {} x {} cells of {} m, {:.1} % with a value, {:.1} images each",
        fused.grid.columns,
        fused.grid.rows,
        fused.grid.cell_m,
        100.0 * filled as f64 / cells,
        fused.values[1] as f64 / some
    ));
    filled
}

fn raster_of(fused: FusedGrid, frame: Frame) -> Raster {
    let band = |name: &str, values| Band { name: name.to_owned(), values };
    let bands = vec![band("elevation", fused.elevation_m), band("images", fused.images), band("sigma", fused.sigma_m)];
    Raster { grid: fused.grid, frame, quantity: "elevation".to_owned(), sample: Sample::Float, bands }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Artefact, Noun, Surface};
    use rockface_core::testing::{TestHost, run_stage};
    use serde_json::{Value, json};

    /// An image that sees `columns` x 4 cells of half a metre from a column and the row 0 on, all at one elevation.
    fn image(first_column: f64, columns: usize, z: f32, sigma: f32) -> Raster {
        let grid = Grid { columns, rows: 4, cell_m: 0.5, left_m: 0.5 * first_column, top_m: 2.0 };
        let band = |name: &str, value| Band { name: name.to_owned(), values: vec![value; 4 * columns] };
        let bands = vec![band("elevation", z), band("sigma", sigma)];
        Raster { grid, frame: Frame::Wall, quantity: "elevation".into(), sample: Sample::Float, bands }
    }

    fn run(images: &[Raster], with: &Value) -> Result<(Surface, Raster), StageError> {
        let inputs: Vec<_> = images.iter().map(|raster| ("grids", Artefact::Raster(raster.clone()))).collect();
        let outputs = run_stage::<FuseGrids>(&TestHost::default(), with, &inputs)?.into_inner();
        Ok((Surface::of(&outputs["surface"]).unwrap().clone(), Raster::of(&outputs["raster"]).unwrap().clone()))
    }

    #[test]
    fn images_overlap_where_they_should_and_two_are_needed() {
        let (surface, raster) = run(&[image(-2.0, 6, 1.0, 0.01), image(1.0, 6, 1.004, 0.01)], &json!({})).unwrap();
        assert_eq!((raster.grid.columns, raster.grid.rows, raster.grid.left_m), (9, 4, -1.0));
        let counts: Vec<f32> = raster.bands[1].values[..9].to_vec();
        assert_eq!(counts, [0.0, 0.0, 0.0, 2.0, 2.0, 2.0, 0.0, 0.0, 0.0]);
        assert!((raster.bands[0].values[4] - 1.002).abs() < 1e-6);
        assert!(surface.point(0, 0).is_none());
        let point = surface.point(1, 4).unwrap();
        assert!((point[0] - 1.25).abs() < 1e-6 && (point[1] - 1.25).abs() < 1e-6 && (point[2] - 1.002).abs() < 1e-6);
        assert_eq!(surface.squares.iter().filter(|square| **square & 3 == 3).count(), 6);
    }

    #[test]
    fn an_image_that_sees_nothing_is_passed_over_unless_none_sees_anything() {
        let nothing = image(-4000.0, 1, f32::NAN, f32::NAN);
        let seen = [image(0.0, 3, 1.0, 0.01), nothing.clone(), image(0.0, 3, 1.0, 0.01)];
        let (_, raster) = run(&seen, &json!({})).unwrap();
        assert_eq!((raster.grid.columns, raster.bands[1].values[0]), (3, 2.0));
        let error = run(&[nothing.clone(), nothing], &json!({})).unwrap_err();
        assert!(error.message.contains("none of 2 grids has a value"), "{error}");
    }

    #[test]
    fn an_image_that_disagrees_is_left_out() {
        let images = [1.0, 1.01, 0.99, 5.0].map(|z| image(0.0, 3, z, 0.02));
        let (_, raster) = run(&images, &json!({})).unwrap();
        assert!((raster.bands[0].values[0] - 1.0).abs() < 1e-6);
        assert!((raster.bands[1].values[0] - 3.0).abs() < 1e-6);
        let error = run(&images[..2], &json!({"min_images": 3})).unwrap_err();
        assert!(error.message.contains("of 2 images no 3 agree"), "{error}");
    }

    #[test]
    fn a_window_keeps_the_lattice_and_steps_are_cut() {
        let images = [image(0.0, 6, 1.0, 0.01), image(3.0, 6, 2.0, 0.01)];
        let with = json!({"min_images": 1, "window_m": [0.0, 2.0, 0.5, 1.5], "max_step_m": 0.1});
        let (surface, raster) = run(&images, &with).unwrap();
        assert_eq!((raster.grid.columns, raster.grid.rows, raster.grid.top_m), (4, 2, 1.5));
        assert_eq!((surface.width, surface.height), (4, 2));
    }

    #[test]
    fn grids_that_do_not_fit_are_named() {
        let error = |other: Raster| run(&[image(0.0, 3, 1.0, 0.1), other], &json!({})).unwrap_err().message;
        assert!(error(image(0.3, 3, 1.0, 0.1)).contains("whole multiples"));
        let mut bad = image(0.0, 3, 1.0, 0.1);
        bad.grid.cell_m = 0.25;
        assert!(error(bad).contains("cells of 0.25 m"));
        bad = image(0.0, 3, 1.0, 0.1);
        bad.bands.pop();
        assert!(error(bad).contains("bands elevation, not"));
        bad = image(0.0, 3, 1.0, 0.1);
        bad.frame = Frame::World;
        assert!(error(bad).contains("world frame"));
    }

    #[test]
    fn threads_change_nothing() {
        let mut images: Vec<Raster> = (0..7u8).map(|i| image(f64::from(i), 12, 1.0, 0.1)).collect();
        for (k, image) in images.iter_mut().enumerate() {
            image.bands[0].values.iter_mut().enumerate().for_each(|(i, z)| *z += 0.03 * ((i * 7 + k * 5) % 11) as f32);
        }
        let bytes = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| run(&images, &json!({})).unwrap().0.encode().unwrap())
        };
        assert_eq!(bytes(1), bytes(3));
    }
}
