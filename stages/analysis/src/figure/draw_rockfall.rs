//! `draw-rockfall`: draws the summary figure of a rockfall inventory.

use crate::figure::rockfall_figure;
use crate::figure::rockfall_figure::{Figure, Rockfall};
use rockface_core::artefact::{Artefact, Frame, Grid, Inventory, Kind, Picture};
use rockface_core::params::Range;
use rockface_core::{Context, Element, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};
use rockface_raster::shape::Shape;
use rockface_raster::{columns, rasterise};
use rockface_rock::rockfall::power_law;

/// Cells along the longer side of a face that comes as a mesh.
const CELLS: f64 = 1500.0;

params! {
    /// Parameters of `draw-rockfall`.
    pub struct DrawRockfallParams {
        /// Title.
        title: String = "Rockfall".to_owned(),
        /// Column with the volume removed, cubic metres.
        column: String = "removed_m3".to_owned(),
        /// Column of `requested` with the volumes that were asked for, cubic metres.
        requested_column: String = "block_m3".to_owned(),
        /// Volumes the power law needs at least.
        least_count: u32 = 10; Range::AtLeast(2.0),
        /// Width of the picture, pixels; text and lines grow with it.
        width_px: u32 = 1000; Range::Between(1000.0, 8000.0),
    }
}

/// Draws a rockfall inventory in one picture.
pub struct DrawRockfall;

impl Stage for DrawRockfall {
    type Params = DrawRockfallParams;
    const NAME: &'static str = "draw-rockfall";
    const VERSION: u32 = 4;
    const PAGE: Page = Page::new(include_str!("draw_rockfall.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("face", &[Kind::Mesh, Kind::Surface, Kind::Raster], "The face, or its elevation."),
        Port::one("truth", &[Kind::Inventory], "The rockfalls."),
        Port::optional("requested", &[Kind::Table, Kind::Inventory], "Volumes that were asked for, one a row."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("picture", &[Kind::Picture], "PNG.")];

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        // The picture, and the triangles as they are drawn.
        inputs.total() + inputs.total() / 2 + (10 << 20)
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let inventory = inputs.one::<Inventory>("truth")?;
        let (frame, grid, face) = elevations(inputs.artefact("face")?)?;
        if frame != inventory.frame {
            fail!("the face is in the {frame} frame, the inventory in the {} frame", inventory.frame);
        }
        if face.iter().all(|z| z.is_nan()) {
            fail!("no cell of the face has a value");
        }
        let rockfalls = rockfalls(inventory, &params.column)?;
        if rockfalls.len() < inventory.features.len() {
            let without = inventory.features.len() - rockfalls.len();
            context.warn(format!("{without} rockfalls have no positive `{}` and are left out", params.column));
        }
        let mut volumes: Vec<f64> = rockfalls.iter().map(|fall| fall.removed_m3).collect();
        volumes.sort_by(f64::total_cmp);
        let requested = inputs.elements("requested").first().map(Element::artefact).transpose()?;
        let requested = requested.map(|rows| columns::magnitudes(rows, &params.requested_column));
        let requested_m3 = requested.transpose()?.map_or_else(Vec::new, |found| found.0);
        let law = power_law::fit(&volumes, None, None, params.least_count as usize);
        let title = params.title.clone();
        let figure = Figure { title, face: &face, grid, rockfalls, law, requested_m3 };
        let png = rockfall_figure::draw(&figure, params.width_px as usize);
        Ok(Outputs::of("picture", Picture { png: png.map_err(|e| StageError::new(e.to_string()))? }))
    }
}

/// Frame, grid and values of the face's elevation.
fn elevations(face: &Artefact) -> Result<(Frame, Grid, Vec<f32>), StageError> {
    if let Artefact::Raster(raster) = face {
        let [band, ..] = raster.bands.as_slice() else { fail!("the raster of the face has no band") };
        return Ok((raster.frame, raster.grid, band.values.clone()));
    }
    let shape = Shape::of(face).ok_or_else(|| StageError::new("port `face` needs a mesh, a surface or a raster"))?;
    let extent = rasterise::extent(shape, None).ok_or_else(|| StageError::new("the face has no points"))?;
    let cell_m = (extent[1] - extent[0]).max(extent[3] - extent[2]) / CELLS;
    let grid = rasterise::grid_around(extent, cell_m)?;
    Ok((shape.frame(), grid, rasterise::tin(shape, None, &grid)))
}

fn rockfalls<'a>(inventory: &'a Inventory, column: &str) -> Result<Vec<Rockfall<'a>>, StageError> {
    let removed = columns::numbers_of(inventory, column)?;
    let numbers = |name| inventory.numbers(name).unwrap_or_else(|| vec![None; removed.len()]);
    let (blocks, [long, intermediate, short]) =
        (numbers("block_m3"), ["long_m", "intermediate_m", "short_m"].map(numbers));
    let fall = |place: usize| {
        Some(Rockfall {
            outline: &inventory.features[place].outline,
            removed_m3: removed[place].filter(|volume| *volume > 0.0)?,
            block_m3: blocks[place],
            sides_m: long[place].zip(intermediate[place]).zip(short[place]).map(|((l, i), s)| [l, i, s]),
        })
    };
    Ok((0..removed.len()).filter_map(fall).collect())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::{Cell, Feature, Mesh, Polygon, Table};
    use rockface_core::numerics::portable_math;
    use rockface_core::testing::{TestHost, run_stage};

    fn hilly() -> Mesh {
        let vertex = |i: u32| {
            let (x, y) = (f64::from(i % 121) * 0.1, f64::from(i / 121) * 0.1);
            [x, y, 0.4 * portable_math::sin(1.7 * x + 0.6 * y) + 0.15 * portable_math::sin(5.1 * y - x)]
        };
        let square = |i: u32| {
            let a = i / 120 * 121 + i % 120;
            [[a, a + 1, a + 122], [a, a + 122, a + 121]]
        };
        let vertices = (0..121 * 61).map(vertex).collect();
        let triangles = (0..120 * 60).flat_map(square).collect();
        Mesh { frame: Frame::Wall, vertices, triangles, colours: Vec::new() }
    }

    /// Rockfalls in rows across the face, their volumes a power law.
    fn inventory(count: usize) -> Inventory {
        let columns = ["removed_m3", "block_m3", "long_m", "intermediate_m", "short_m"].map(str::to_owned).to_vec();
        let feature = |i: usize| {
            let removed = 2.0 / (i + 1) as f64;
            let side = 0.9 * portable_math::cbrt(removed);
            let (x, y) = (0.5 + (i * 37 % 100) as f64 * 0.105, 0.4 + (i * 61 % 100) as f64 * 0.045);
            let exterior =
                (0..8).map(|k| portable_math::sincos(f64::from(k) * 0.785)).map(|(s, c)| [x + side * c, y + side * s]);
            let outline = vec![Polygon { exterior: exterior.collect(), holes: Vec::new() }];
            let (flat, long) = (0.2 + 0.08 * (i % 10) as f64, 1.0 + 0.1 * (i % 7) as f64);
            let values = [removed, removed * (1.1 + 0.2 * (i % 5) as f64), side * long, side, side * flat];
            Feature { outline, values: values.map(Cell::from).to_vec() }
        };
        Inventory { frame: Frame::Wall, columns, features: (0..count).map(feature).collect() }
    }

    #[test]
    fn a_figure_is_drawn_with_and_without_all_its_columns() {
        let mut requested = Table::new(["block_m3"]);
        (1..80).for_each(|i| requested.push(vec![(2.5 / f64::from(i)).into()]));
        let host = TestHost::default();
        let inputs = [("face", hilly().into()), ("truth", inventory(60).into()), ("requested", requested.into())];
        let made = run_stage::<DrawRockfall>(&host, &json!({"title": "Test"}), &inputs).unwrap();
        let Some(Artefact::Picture(full)) = made.into_inner().remove("picture") else { panic!("no picture") };
        assert!(full.png.len() > 50_000, "{} bytes", full.png.len());
        let mut bare = inventory(4);
        bare.columns.truncate(1);
        bare.features.iter_mut().for_each(|feature| feature.values.truncate(1));
        bare.features[2].values[0] = Cell::from(0.0);
        let inputs = [("face", hilly().into()), ("truth", bare.into())];
        assert!(run_stage::<DrawRockfall>(&host, &json!({}), &inputs).is_ok());
        assert!(host.warnings()[0].contains("1 rockfalls have no positive"));
    }

    #[test]
    fn another_frame_or_no_column_is_refused() {
        let refused = |truth: Inventory, with: serde_json::Value| {
            let inputs = [("face", hilly().into()), ("truth", truth.into())];
            run_stage::<DrawRockfall>(&TestHost::default(), &with, &inputs).unwrap_err().message
        };
        let world = Inventory { frame: Frame::World, ..inventory(1) };
        assert!(refused(world, json!({})).contains("inventory in the world frame"));
        assert!(refused(inventory(1), json!({"column": "v"})).contains("no column `v`; there are removed_m3"));
    }
}
