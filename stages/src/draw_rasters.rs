//! `draw-rasters`: rasters of one grid side by side in one set of colours.

use crate::artefact::{Band, Kind, Picture, Raster};
use crate::kernel::colour_scale::{ColourScale, Palette, length, quantile};
use crate::kernel::grid;
use crate::kernel::picture::{self, Subject};
use crate::params::Range;
use crate::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};

/// Share of the absolute values within the colours.
const WITHIN: f64 = 0.98;
/// Gap between two rasters, as a share of their width.
const GAP: f64 = 0.03;

params! {
    /// Parameters of `draw-rasters`.
    pub struct DrawRastersParams {
        /// Title; left out, how many rasters there are.
        title: Option<String> = None,
        /// Rasters that are drawn at most of each input, the first ones.
        most: usize = 6; Range::Between(1.0, 100.0),
        /// Rasters in a row; left out, those of one input.
        columns: Option<usize> = None; Range::Between(1.0, 100.0),
        /// The colours reach from minus to plus this, metres (or the values' own unit); left out, they hold 98 % of the values.
        range_m: Option<f64> = None; Range::Positive,
        /// Width of the picture at most, pixels.
        max_width_px: u32 = 1800; Range::Between(520.0, 16_384.0),
    }
}

/// The stage.
pub struct DrawRasters;

impl Stage for DrawRasters {
    type Params = DrawRastersParams;
    const NAME: &'static str = "draw-rasters";
    const VERSION: u32 = 1;
    const PAGE: Page = Page {
        what: "Draws rasters side by side with one colour bar, those of `rasters` in the first row and those of `beside` below: real \
               differences over simulated ones, say. Whoever cannot tell the rows apart has a good simulation.",
        method: "Every raster has the same colours, which diverge from zero; red is material lost. Larger mosaics are averaged to the \
                 picture's size.",
        frames: "Differences in metres; the bar in millimetres where the range is below half a metre. X to the right, Y up.",
        fails: "Rasters of different grids; nothing has a value.",
        example: "rockface: 1\nname: side-by-side\nsteps:\n  real: {stage: import-rasters, with: {path: real}}\n  \
                  simulated: {stage: import-rasters, with: {path: simulated}}\n  \
                  picture: {stage: draw-rasters, in: {rasters: real.raster, beside: simulated.raster}}\n",
    };
    const INPUTS: &'static [Port] = &[
        Port::many("rasters", &[Kind::Raster], "The first row: a stack of bands, or gathered."),
        Port::many("beside", &[Kind::Raster], "The second row."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("picture", &[Kind::Picture], "PNG.")];

    fn run(params: &Self::Params, inputs: &Inputs, _context: &Context) -> Result<Outputs, StageError> {
        let first: Vec<&Raster> = inputs.many::<Raster>("rasters")?.into_iter().map(|(_, raster)| raster).collect();
        let second: Vec<&Raster> = inputs.many::<Raster>("beside")?.into_iter().map(|(_, raster)| raster).collect();
        let like = first[0];
        if let Some(other) = first.iter().chain(&second).find(|other| !grid::same(&other.grid, &like.grid)) {
            let (a, b) = (grid::describe(&like.grid), grid::describe(&other.grid));
            return Err(StageError::new(format!("one raster has {a}, another {b}"))
                .hint("rasterise all on one grid: port `grid` of `rasterise-dem`"));
        }
        let bands = |rasters: &[&'_ Raster]| -> Vec<Band> {
            rasters.iter().flat_map(|raster| raster.bands.iter().cloned()).take(params.most).collect()
        };
        let rows = [bands(&first), bands(&second)];
        let png = draw(params, like, &rows)?;
        Ok(Outputs::of("picture", Picture { png }))
    }
}

fn draw(params: &DrawRastersParams, like: &Raster, rows: &[Vec<Band>; 2]) -> Result<Vec<u8>, StageError> {
    let columns = params.columns.unwrap_or_else(|| rows[0].len().max(rows[1].len()));
    let values = rows.iter().flatten().flat_map(|band| band.values.iter().map(|v| v.abs()));
    let Some(most) = quantile(values, WITHIN) else { fail!("nothing to draw: no cell has a value") };
    let reach = params.range_m.unwrap_or(if most > 0.0 { most } else { 0.5 });
    let (width, mosaic) = mosaic(&like.grid, rows, columns);
    let subject = Subject {
        columns: width,
        values: &mosaic,
        cell_m: Some(like.grid.cell_m),
        shaded: false,
        scale: ColourScale { palette: Palette::RedBlue, low: -reach, high: reach },
        title: params.title.clone().unwrap_or_else(|| format!("{} rasters", rows.iter().map(Vec::len).sum::<usize>())),
        subtitle: format!("each {} x {} cells of {}", like.grid.columns, like.grid.rows, length(like.grid.cell_m)),
        unit: if reach < 0.25 { ("mm", 1e3) } else { ("m", 1.0) },
        up: None,
    };
    picture::draw(&subject, params.max_width_px as usize).map_err(|e| StageError::new(e.to_string()))
}

/// All rasters on one grid with gaps between them, those of the second list in rows of their own; its width and cells.
fn mosaic(grid: &crate::artefact::Grid, lists: &[Vec<Band>; 2], columns: usize) -> (usize, Vec<f32>) {
    let gap = ((grid.columns as f64 * GAP) as usize).max(1);
    let lines = lists.each_ref().map(|list| list.len().div_ceil(columns));
    let rows = lines[0] + lines[1];
    let (width, height) = (columns * (grid.columns + gap) - gap, rows * (grid.rows + gap) - gap);
    let mut cells = vec![f32::NAN; width * height];
    for (list, first) in lists.iter().zip([0, lines[0]]) {
        for (k, band) in list.iter().enumerate() {
            let (left, top) = (k % columns * (grid.columns + gap), (first + k / columns) * (grid.rows + gap));
            for (row, line) in band.values.chunks_exact(grid.columns).enumerate() {
                let at = (top + row) * width + left;
                cells[at..at + grid.columns].copy_from_slice(line);
            }
        }
    }
    (width, cells)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::artefact::{Artefact, Frame, Grid};
    use crate::testing::{TestHost, run_stage};

    fn raster(columns: usize, bands: usize) -> Raster {
        let grid = Grid { columns, rows: 10, cell_m: 0.1, left_m: 0.0, top_m: 1.0 };
        let values = (0..columns * 10).map(|i| 0.001 * i as f32).collect();
        let mut raster = Raster::single(grid, Frame::Wall, "difference", "a", values);
        raster.bands = vec![raster.bands[0].clone(); bands];
        raster
    }

    fn drawn(first: Raster, second: Raster) -> Result<Picture, StageError> {
        let inputs: [(&str, Artefact); 2] = [("rasters", first.into()), ("beside", second.into())];
        let outputs = run_stage::<DrawRasters>(&TestHost::default(), &json!({"most": 3}), &inputs)?.into_inner();
        let Artefact::Picture(picture) = &outputs["picture"] else { panic!("a picture comes out") };
        Ok(picture.clone())
    }

    #[test]
    fn rasters_of_both_inputs_lie_in_rows_of_their_own() {
        let bands = |n: usize| raster(40, n).bands;
        let (width, cells) = mosaic(&raster(40, 1).grid, &[bands(3), bands(2)], 3);
        assert_eq!((width, cells.len()), (3 * 40 + 2, (3 * 40 + 2) * 21));
        assert!(cells[40].is_nan() && !cells[41].is_nan() && !cells[11 * width].is_nan());
        assert!(cells[20 * width + 82].is_nan(), "the second row has two");
        assert!(drawn(raster(40, 5), raster(40, 2)).unwrap().png.starts_with(b"\x89PNG"));
        assert!(drawn(raster(40, 5), raster(30, 2)).unwrap_err().message.contains("another"));
    }
}
