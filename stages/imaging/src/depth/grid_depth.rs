//! `grid-depth`: reduces the depth map of one image to one elevation a cell of the wall.

use crate::depth::depth_cells::{Cells, Sigma, reduce};
use rockface_core::artefact::{Band, Depth, Frame, Grid, Kind, Raster, Sample};
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, params};
use rockface_raster::window;

params! {
    /// Parameters of `grid-depth`.
    pub struct GridDepthParams {
        /// Side of a cell, metres.
        cell_m: f64 = 0.01; Range::Positive,
        /// Window (left, right, bottom, top) in metres; null: all the image sees.
        window_m: Option<[f64; 4]> = None,
        /// Expected standard deviation of a depth, metres; null: the channel `sigma` of the depth map.
        sigma_m: Option<f64> = None; Range::Positive,
    }
}

/// Reduces the depth map of one image to a grid of elevations over the wall.
pub struct GridDepth;

impl Stage for GridDepth {
    type Params = GridDepthParams;
    const NAME: &'static str = "grid-depth";
    const VERSION: u32 = 4;
    const PAGE: Page = Page::new(include_str!("grid_depth.md"));
    const INPUTS: &'static [Port] = &[Port::one("depth", &[Kind::Depth], "The depth map.")];
    const OUTPUTS: &'static [Port] = &[Port::one("grid", &[Kind::Raster], "Bands `elevation` and `sigma`, metres.")];

    fn check(params: &Self::Params) -> Vec<Fault> {
        window::faults(params.window_m)
    }

    fn memory_bytes(params: &Self::Params, inputs: &InputSizes) -> u64 {
        // Sums of the cells, both bands and their file; a cell a pixel, or those of the window.
        let pixels = inputs.of("depth") / 8;
        let cells = params.window_m.map_or(pixels, |window_m| window::cells(window_m, params.cell_m).min(pixels));
        inputs.total() + 48 * cells
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let depth = inputs.one::<Depth>("depth")?;
        let name = &depth.image.name;
        if depth.frame != Frame::Wall {
            let text = format!(
                "the depth map of image `{name}` is in the {} frame: elevations are along Z of the wall",
                depth.frame
            );
            return Err(StageError::new(text).hint("bring mesh and cameras into the wall frame with `transform-crs`"));
        }
        let sigma = match (params.sigma_m, depth.channels.get("sigma")) {
            (Some(sigma_m), _) => Sigma::Constant(sigma_m),
            (None, Some(map)) => Sigma::Map(map),
            (None, None) => {
                let error = StageError::new(format!("the depth map of image `{name}` has no channel `sigma`"));
                return Err(error.hint("give `sigma_m`, or let `match-image` keep its channels"));
            }
        };
        let cells = reduce(depth, sigma, params.cell_m, params.window_m)?.unwrap_or_else(|| {
            context.warn(format!("image `{name}` has no depth inside the window: its grid is one empty cell"));
            empty(depth, params.cell_m)
        });
        let filled = cells.elevation_m.iter().filter(|z| !z.is_nan()).count();
        context.metric("cells", filled as f64, "1");
        if filled > 0 {
            context.metric("pixels_per_cell", cells.pixels[1] as f64 / filled as f64, "1");
            context.metric("share_in_window", cells.pixels[1] as f64 / cells.pixels[0] as f64, "1");
        }
        let band = |name: &str, values| Band { name: name.to_owned(), values };
        let bands = vec![band("elevation", cells.elevation_m), band("sigma", cells.sigma_m)];
        let quantity = "elevation".to_owned();
        let raster = Raster { grid: cells.grid, frame: depth.frame, quantity, sample: Sample::Float, bands };
        Ok(Outputs::of("grid", raster))
    }
}

/// One cell without a value under the camera, for an image that sees nothing of the window.
fn empty(depth: &Depth, cell_m: f64) -> Cells {
    let [x, y, _] = depth.image.centre_m;
    let edge = |position: f64| (position / cell_m).floor() * cell_m;
    let grid = Grid { columns: 1, rows: 1, cell_m, left_m: edge(x), top_m: edge(y) };
    Cells { grid, elevation_m: vec![f32::NAN], sigma_m: vec![f32::NAN], pixels: [0; 2] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Artefact;
    use rockface_core::testing::{TestHost, image_at, run_stage, small_sensor};
    use serde_json::{Value, json};

    fn depth(z: f32) -> Depth {
        let (sensor, image) = (small_sensor(), image_at("a", [0.0, 0.0, 10.0], [0.0; 3]));
        let (z, channels) = (vec![z; 2400], [].into());
        Depth { frame: Frame::Wall, sensor, image, downscale: 1, width: 60, height: 40, z, channels }
    }

    fn error(depth: Depth, with: &Value) -> String {
        run_stage::<GridDepth>(&TestHost::default(), with, &[("depth", Artefact::Depth(depth))]).unwrap_err().message
    }

    #[test]
    fn it_says_what_it_cannot_use() {
        let with = json!({"cell_m": 0.2, "sigma_m": 0.01});
        assert!(error(Depth { frame: Frame::World, ..depth(10.0) }, &with).contains("world frame"));
        assert!(error(depth(10.0), &json!({"cell_m": 0.2})).contains("no channel `sigma`"));
        assert!(error(depth(10.0), &json!({"cell_m": 1e-5, "sigma_m": 0.01})).contains("cells"));
    }

    #[test]
    fn an_image_that_sees_nothing_leaves_one_empty_cell_and_a_warning() {
        let with = json!({"cell_m": 0.2, "sigma_m": 0.01, "window_m": [50, 60, 0, 10]});
        for map in [depth(f32::NAN), depth(10.0)] {
            let host = TestHost::default();
            let outputs = run_stage::<GridDepth>(&host, &with, &[("depth", Artefact::Depth(map))]);
            let Some(Artefact::Raster(raster)) = outputs.unwrap().into_inner().remove("grid") else { panic!("none") };
            assert_eq!((raster.grid.cells(), host.metric("cells")), (1, Some(0.0)));
            assert!(raster.bands.iter().all(|band| band.values[0].is_nan()));
            assert!(host.warnings()[0].contains("image `a` has no depth inside the window"));
        }
    }

    #[test]
    fn the_channel_is_taken_where_there_is_one() {
        let mut depth = depth(10.0);
        depth.channels.insert("sigma".into(), vec![0.5; 2400]);
        let host = TestHost::default();
        let outputs = run_stage::<GridDepth>(&host, &json!({"cell_m": 0.2}), &[("depth", Artefact::Depth(depth))]);
        let Some(Artefact::Raster(raster)) = outputs.unwrap().into_inner().remove("grid") else { panic!("no raster") };
        assert!(raster.bands[1].values.iter().all(|s| (s - 0.5).abs() < 0.02));
        assert_eq!(host.metric("share_in_window"), Some(1.0));
    }
}
