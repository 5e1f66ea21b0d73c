//! `rasterise-dem`: turns a surface into a grid of elevations above the wall plane.

use serde_json::Value;

use crate::shape::{self, Moved, Shape};
use crate::{frame_change, rasterise, rasterise_points, window};
use rockface_core::artefact::{Artefact, Frame, Grid, Kind, Raster, Transform};
use rockface_core::params::{Fault, Range, deciding};
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Ports, Stage, StageError, choice, fail, params};

choice! {
    /// How a cell gets its value.
    pub enum DemMethod {
        /// Mean Z of the points that fall into the cell.
        Mean = "mean",
        /// Median Z of the points that fall into the cell: blunders do not move it.
        Median = "median",
        /// Z of the point in the cell that is nearest to its centre.
        Nearest = "nearest",
        /// Z at the centre of the cell, interpolated in the triangles; the highest of several.
        Tin = "tin",
    }
}

choice! {
    /// What a cell with too few points gets.
    pub enum EmptyCells {
        /// No value.
        LeaveEmpty = "leave-empty",
        /// Z at its centre, interpolated in the triangles, where there are any: pixels nearly as large as cells leave some without a point.
        Interpolate = "interpolate",
    }
}

params! {
    /// Parameters of `rasterise-dem`.
    pub struct RasteriseDemParams {
        /// Side of a cell, metres; with a given grid the grid's own cell is taken.
        cell_m: f64 = 0.01; Range::Positive,
        /// How a cell gets its value.
        method: DemMethod = DemMethod::Mean,
        /// A cell with fewer points is an empty one (not for `tin`).
        minimum_points: u32 = 2; Range::AtLeast(1.0),
        /// What a cell with too few points gets (not for `tin`, nor for clouds, which have no triangles).
        empty_cells: EmptyCells = EmptyCells::LeaveEmpty,
        /// Window (left, right, bottom, top) in metres; left out, the extent of the surface in whole cells.
        window_m: Option<[f64; 4]> = None,
        /// Whether the number of points in each cell is put out too, at the port `coverage`.
        coverage: bool = false,
    }
}

const RASTER: Port = Port::one("raster", &[Kind::Raster], "Elevation, metres, one band.");
const COVERAGE: Port =
    Port::one("coverage", &[Kind::Raster], "Number of points in each cell; with `coverage: true` only.");

/// Turns a surface or mesh into a grid of elevations (Z) over X and Y.
pub struct RasteriseDem;

impl Stage for RasteriseDem {
    type Params = RasteriseDemParams;
    const NAME: &'static str = "rasterise-dem";
    const VERSION: u32 = 2;
    const PAGE: Page = Page::new(include_str!("rasterise_dem.md"));
    const INPUTS: &'static [Port] = &[
        Port::one(
            "surface",
            &[Kind::Surface, Kind::Mesh, Kind::Cloud],
            "What is measured or known, in the wall frame.",
        ),
        Port::optional("transform", &[Kind::Transform], "Applied to every point, such as a registration."),
        Port::optional("grid", &[Kind::Raster], "A raster whose grid is taken over exactly."),
    ];
    const OUTPUTS: &'static [Port] = &[RASTER, COVERAGE];

    fn ports(with: &Value) -> Result<Ports, Vec<Fault>> {
        const RASTER_ONLY: &[Port] = &[RASTER];
        let counted = deciding(with, "coverage")?.and_then(Value::as_bool) == Some(true);
        Ok(Ports { inputs: Self::INPUTS, outputs: if counted { Self::OUTPUTS } else { RASTER_ONLY } })
    }

    fn check(params: &Self::Params) -> Vec<Fault> {
        window::faults(params.window_m)
    }

    fn memory_bytes(params: &Self::Params, inputs: &InputSizes) -> u64 {
        // The cells, their raster and its file, and for a median the heights in them; of a surface without a window a cell a point.
        let cells_of = |window_m| window::cells(window_m, params.cell_m);
        let band = match (inputs.of("grid"), params.window_m) {
            (0, None) => inputs.times(0.33, "surface"),
            (0, Some(window_m)) => 4 * cells_of(window_m),
            (grid, _) => grid / inputs.small("grid", |grid: &Raster| grid.bands.len().max(1) as u64).unwrap_or(1),
        };
        let lists = match params.method {
            DemMethod::Median => inputs.times(2.5, "surface"),
            DemMethod::Nearest => 6 * band,
            DemMethod::Mean | DemMethod::Tin => 0,
        };
        let interpolates = params.method == DemMethod::Tin || params.empty_cells == EmptyCells::Interpolate;
        let filled = if params.empty_cells == EmptyCells::Interpolate { band } else { 0 };
        // The vertices of a mesh in cells; those of a surface are taken strip by strip.
        let of_surface = || matches!(inputs.value("surface").as_deref(), Some(Artefact::Surface(_)));
        let vertices = if interpolates && !of_surface() { inputs.times(0.5, "surface") } else { 0 };
        let coverage = if params.coverage { 2 * band } else { 0 };
        inputs.total() + lists + 23 * band / 10 + filled + vertices + coverage + (6 << 20)
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let artefact = inputs.artefact("surface")?;
        let shape =
            Shape::of(artefact).ok_or_else(|| StageError::new("port `surface` needs a surface, a mesh or a cloud"))?;
        let vertices = shape::surface_vertices(artefact);
        let shape = shape.on_surface(vertices.as_deref());
        let change = frame_change::change(shape.frame(), inputs.optional::<Transform>("transform")?)?;
        let moved = change.moved;
        if matches!(shape, Shape::Cloud(_)) {
            if params.method == DemMethod::Tin {
                return Err(StageError::new("`method: tin` interpolates in triangles, and a cloud has none")
                    .hint("take `method: mean`, `median` or `nearest`"));
            }
            if params.empty_cells == EmptyCells::Interpolate {
                return Err(StageError::new("`empty_cells: interpolate` takes triangles, and a cloud has none")
                    .hint("take `empty_cells: leave-empty`"));
            }
        }
        let grid = match inputs.optional::<Raster>("grid")? {
            Some(raster) if raster.frame != change.frame => {
                let message =
                    format!("the surface is in the {} frame, the grid in the {} frame", change.frame, raster.frame);
                return Err(
                    StageError::new(message).hint("port `transform` takes the surface to the frame of the grid; `frame` of the importers says in which frame a file is that does not say so itself")
                );
            }
            Some(raster) => usable(raster.grid)?,
            None => make_grid(params, shape, moved.as_ref())?,
        };
        let mut values = match params.method {
            DemMethod::Mean => rasterise::mean(shape, moved.as_ref(), &grid, params.minimum_points),
            DemMethod::Median => rasterise_points::median(shape, moved.as_ref(), &grid, params.minimum_points),
            DemMethod::Nearest => rasterise_points::nearest(shape, moved.as_ref(), &grid, params.minimum_points),
            DemMethod::Tin => rasterise::tin(shape, moved.as_ref(), &grid),
        };
        if params.method != DemMethod::Tin && params.empty_cells == EmptyCells::Interpolate {
            let filled = rasterise::fill_empty(&mut values, shape, moved.as_ref(), &grid);
            context.metric("interpolated", filled as f64 / values.len() as f64, "1");
        }
        report(&values, &grid, context);
        if params.method != DemMethod::Tin {
            warn_of_scattered_gaps(&values, grid.columns, params.minimum_points, context);
        }
        let frame = change.frame;
        if frame == Frame::World {
            context.warn("the surface is in the world frame: elevation is along world Z, not out of the wall");
        }
        let outputs = Outputs::of("raster", Raster::single(grid, frame, "elevation", "elevation", values));
        if !params.coverage {
            return Ok(outputs);
        }
        let counts = rasterise_points::counts(shape, moved.as_ref(), &grid);
        Ok(outputs.and("coverage", Raster::single(grid, frame, "count", "points", counts)))
    }
}

fn make_grid(params: &RasteriseDemParams, shape: Shape, moved: Option<&Moved>) -> Result<Grid, StageError> {
    let grid = if let Some(window_m) = params.window_m {
        rasterise::grid_of_window(window_m, params.cell_m)
    } else {
        let extent = rasterise::extent(shape, moved);
        let extent = extent.ok_or_else(|| StageError::new("the surface has no points, so it has no extent"))?;
        rasterise::grid_around(extent, params.cell_m)
    };
    grid.map_err(|e| e.hint("choose another `cell_m` or `window_m`"))
}

/// A given grid, if it can be filled.
fn usable(grid: Grid) -> Result<Grid, StageError> {
    let cells = grid.columns as f64 * grid.rows as f64;
    if (1.0..=rasterise::MAXIMUM_CELLS).contains(&cells) && grid.cell_m > 0.0 {
        return Ok(grid);
    }
    fail!("the given grid has {} x {} cells of {} m and cannot be filled", grid.columns, grid.rows, grid.cell_m)
}

/// Share of the cells with a value from which on gaps between such cells are more than a few.
const MANY_GAPS: f64 = 0.1;

/// Warns where many cells between others have too few points, which detectors and descriptors take for edges of the surface.
fn warn_of_scattered_gaps(values: &[f32], columns: usize, points: u32, context: &Context) {
    let known = |cell: usize| values.get(cell).is_some_and(|value| !value.is_nan());
    let between = |cell: usize, step: usize| cell >= step && known(cell - step) && known(cell + step);
    let is_gap = |cell: &usize| {
        let column = cell % columns;
        !known(*cell) && ((column > 0 && column + 1 < columns && between(*cell, 1)) || between(*cell, columns))
    };
    let gaps = (0..values.len()).filter(is_gap).count() as f64;
    let filled = values.iter().filter(|value| !value.is_nan()).count() as f64;
    if gaps > MANY_GAPS * filled {
        context.warn(format!(
            "{:.0} % of the cells between others have less than {points} points (`minimum_points`): the points lie too far apart for cells this small; \
             enlarge `cell_m`, or take `empty_cells: interpolate`",
            100.0 * gaps / (gaps + filled)
        ));
    }
}

fn report(values: &[f32], grid: &Grid, context: &Context) {
    let filled = values.iter().filter(|value| !value.is_nan()).count();
    let coverage = filled as f64 / values.len() as f64;
    context.metric("columns", grid.columns as f64, "1");
    context.metric("rows", grid.rows as f64, "1");
    context.metric("coverage", coverage, "1");
    if filled == 0 {
        context.warn("no cell has a value: the surface lies outside the grid, or no cell has enough points");
    }
    context.headline(format!(
        "{} x {} cells of {} m, {:.1} % with a value",
        grid.columns,
        grid.rows,
        grid.cell_m,
        100.0 * coverage
    ));
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::Point;
    use rockface_core::artefact::{Artefact, Mesh};
    use rockface_core::params::ParamType;
    use rockface_core::testing::TestHost;
    use serde_json::json;
    use std::sync::Arc;

    fn face() -> Mesh {
        let vertices = vec![[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [2.0, 1.0, 2.0], [0.0, 1.0, 2.0]];
        Mesh { frame: Frame::Wall, vertices, triangles: vec![[0, 1, 2], [0, 2, 3]], colours: Vec::new() }
    }

    fn run(with: &serde_json::Value, extra: Vec<(&str, Artefact)>) -> (Raster, TestHost) {
        let host = TestHost::default();
        let mut inputs = Inputs::default();
        inputs.push("surface", Point::new(), Arc::new(face().into()));
        for (port, artefact) in extra {
            inputs.push(port, Point::new(), Arc::new(artefact));
        }
        let params = RasteriseDemParams::decode(with).unwrap();
        let outputs = RasteriseDem::run(&params, &inputs, &Context::new(&host)).unwrap();
        let Some(Artefact::Raster(raster)) = outputs.into_inner().remove("raster") else { panic!("no raster") };
        (raster, host)
    }

    #[test]
    fn a_window_sets_the_grid_and_a_plane_its_values() {
        let with = json!({"cell_m": 0.5, "method": "tin", "window_m": [-1, 2, 0, 1]});
        let (raster, host) = run(&with, Vec::new());
        assert_eq!((raster.grid.columns, raster.grid.rows), (6, 2));
        assert_eq!(raster.bands[0].values[2..6], [1.75; 4]);
        assert_eq!(raster.bands[0].values[8..12], [1.25; 4]);
        assert!(raster.bands[0].values[..2].iter().all(|z| z.is_nan()));
        assert_eq!(host.metric("coverage"), Some(8.0 / 12.0));
    }

    #[test]
    fn empty_cells_under_triangles_are_interpolated_where_that_is_asked_for() {
        let of = |with: serde_json::Value| run(&with, Vec::new());
        let with = json!({"cell_m": 0.5, "minimum_points": 1, "window_m": [-0.5, 2.5, 0, 1]});
        let (left, host) = of(with.clone());
        assert_eq!(host.metric("interpolated"), None);
        let mut with = with;
        with["empty_cells"] = json!("interpolate");
        let (filled, host) = of(with);
        let (left, filled) = (&left.bands[0].values, &filled.bands[0].values);
        // The face is two metres wide, and has a point in each of its corners only. Its right and its upper edge belong to the cells beyond.
        let known = left.iter().filter(|value| !value.is_nan()).count();
        assert!((1..=4).contains(&known), "{left:?}");
        for (cell, (left, filled)) in left.iter().zip(filled).enumerate() {
            let column = cell % 6;
            let wanted = match (left.is_nan(), (1..5).contains(&column)) {
                (false, _) => *left,
                (true, true) => {
                    if cell < 6 {
                        1.75
                    } else {
                        1.25
                    }
                }
                (true, false) => f32::NAN,
            };
            assert!(
                wanted.to_bits() == filled.to_bits() || wanted.is_nan() && filled.is_nan(),
                "cell {cell}: {filled}"
            );
        }
        let changed = left.iter().zip(filled).filter(|(left, filled)| left.is_nan() && !filled.is_nan()).count();
        assert_eq!(host.metric("interpolated"), Some(changed as f64 / 12.0));
    }

    #[test]
    fn cells_too_small_for_the_points_are_warned_of() {
        let points = (0..900).map(|i| [f64::from(i % 30) * 0.1, f64::from(i / 30) * 0.1, 0.0]).collect();
        let cloud = rockface_core::artefact::Cloud::new(Frame::Wall, points);
        let warnings = |cell_m: f64| {
            let host = TestHost::default();
            let with = json!({"cell_m": cell_m, "minimum_points": 1, "window_m": [-0.05, 2.95, -0.05, 2.95]});
            rockface_core::testing::run_stage::<RasteriseDem>(&host, &with, &[("surface", cloud.clone().into())])
                .unwrap();
            host.warnings()
        };
        assert!(warnings(0.1).is_empty(), "{:?}", warnings(0.1));
        assert!(warnings(0.06)[0].contains("of the cells between others"), "{:?}", warnings(0.06));
    }

    #[test]
    fn gaps_are_warned_of_from_a_tenth_of_the_filled_cells_on() {
        // One row of cells, with gaps after its first ones.
        let warnings = |filled: usize, gaps: usize| {
            let cell = |gaps_first: usize| if gaps_first < 2 * gaps && gaps_first % 2 == 1 { f32::NAN } else { 1.0 };
            let values: Vec<f32> = (0..filled + gaps).map(cell).collect();
            let host = TestHost::default();
            warn_of_scattered_gaps(&values, values.len(), 2, &Context::new(&host));
            host.warnings()
        };
        assert_eq!(warnings(21, 2), Vec::<String>::new(), "9.5 %");
        let told = warnings(19, 2);
        assert!(
            told.len() == 1 && told[0].starts_with("10 % of the cells") && told[0].contains("less than 2 points"),
            "{told:?}"
        );
    }

    #[test]
    fn a_cloud_has_no_triangles_to_interpolate_in() {
        let cloud = rockface_core::artefact::Cloud::new(Frame::Wall, vec![[0.1, 0.1, 0.1], [0.2, 0.2, 0.2]]);
        for with in [json!({"method": "tin"}), json!({"empty_cells": "interpolate"})] {
            let made = rockface_core::testing::run_stage::<RasteriseDem>(
                &TestHost::default(),
                &with,
                &[("surface", cloud.clone().into())],
            );
            assert!(made.err().unwrap().to_string().contains("a cloud has none"));
        }
    }

    #[test]
    fn vertices_of_rock_that_fell_are_no_points() {
        // One vertex of the rock that went, 9 m over the middle of the face, and far aside.
        for beyond in [[1.0, 0.5, 9.0], [7.0, 0.5, 9.0]] {
            let mut fallen = face();
            fallen.vertices.push(beyond);
            for method in ["mean", "median", "nearest", "tin"] {
                let with = json!({"cell_m": 2.5, "method": method, "minimum_points": 1, "coverage": true});
                let of = |mesh: Mesh| {
                    let inputs = [("surface", mesh.into())];
                    let made = rockface_core::testing::run_stage::<RasteriseDem>(&TestHost::default(), &with, &inputs);
                    let made = made.unwrap().into_inner();
                    let [Artefact::Raster(values), Artefact::Raster(counts)] = [&made["raster"], &made["coverage"]]
                    else {
                        panic!("no rasters")
                    };
                    (
                        values.grid,
                        [values, counts].map(|r| r.bands[0].values.iter().map(|z| z.to_bits()).collect::<Vec<_>>()),
                    )
                };
                assert!(of(fallen.clone()) == of(face()), "{method}");
            }
        }
    }

    #[test]
    fn coverage_has_a_port_of_its_own_where_it_is_asked_for() {
        let with = json!({"cell_m": 1.0, "method": "median", "minimum_points": 1, "coverage": true});
        assert_eq!(RasteriseDem::ports(&with).unwrap().outputs.len(), 2);
        assert_eq!(RasteriseDem::ports(&json!({})).unwrap().outputs.len(), 1);
        let made = rockface_core::testing::run_stage::<RasteriseDem>(
            &TestHost::default(),
            &with,
            &[("surface", face().into())],
        );
        let made = made.unwrap().into_inner();
        let Artefact::Raster(coverage) = &made["coverage"] else { panic!("no raster") };
        assert_eq!((coverage.quantity.as_str(), coverage.bands[0].values.iter().sum::<f32>()), ("count", 4.0));
    }

    #[test]
    fn a_given_grid_is_taken_exactly_and_a_transform_applied() {
        let grid = Grid { columns: 3, rows: 2, cell_m: 0.3, left_m: 0.1, top_m: 0.77 };
        let given = Raster::single(grid, Frame::Wall, "mask", "mask", vec![0.0; 6]);
        let mut up = Transform::identity("source", "target");
        up.translation = [0.0, 0.0, 10.0];
        let (raster, _) = run(&json!({"method": "tin"}), vec![("grid", given.into()), ("transform", up.into())]);
        assert_eq!(raster.grid, grid);
        let (_, y) = grid.centre(1, 2);
        assert!((f64::from(raster.bands[0].values[5]) - (11.0 + y)).abs() < 1e-6);
        assert_eq!(raster.frame, Frame::Wall);
    }

    #[test]
    fn an_empty_window_is_a_fault_of_the_parameters() {
        let params = RasteriseDemParams::decode(&json!({"window_m": [2, 1, 0, 1]})).unwrap();
        assert_eq!(RasteriseDem::check(&params)[0].path, ["window_m"]);
    }
}
