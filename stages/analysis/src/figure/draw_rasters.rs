//! `draw-rasters`: rasters of one grid side by side in one set of colours.

use crate::figure::colour_scale::{ColourScale, Palette, length};
use crate::figure::picture::Subject;
use crate::figure::picture::look;
use crate::figure::picture::mosaic::Mosaic;
use rockface_core::artefact::{Band, Kind, Picture, Raster};
use rockface_core::numerics::quantile::nearest_rank;
use rockface_core::params::Range;
use rockface_core::{Context, Inputs, Outputs, Page, Point, Port, Stage, StageError, fail, params};
use rockface_raster::grid;

/// Share of the absolute values within the colours.
const WITHIN: f64 = 0.98;

params! {
    /// Parameters of `draw-rasters`.
    pub struct DrawRastersParams {
        /// Title; left out, how many rasters there are.
        title: Option<String> = None,
        /// What the rasters of the first and of the second input are called, written before the name of each.
        names: Vec<String> = Vec::new(),
        /// Rasters that are drawn at most of each input, the first ones.
        most: usize = 6; Range::Between(1.0, 100.0),
        /// Rasters in a row; left out, those of one input.
        columns: Option<usize> = None; Range::Between(1.0, 100.0),
        /// The colours reach from minus to plus this, metres (or the values' own unit), from 0 where nothing is negative; left out, they hold 98 %
        /// of the values.
        range_m: Option<f64> = None; Range::Positive,
        /// Width of the picture at most, pixels.
        max_width_px: u32 = 1800; Range::Between(520.0, 16_384.0),
    }
}

/// Draws rasters side by side with one colour bar.
pub struct DrawRasters;

impl Stage for DrawRasters {
    type Params = DrawRastersParams;
    const NAME: &'static str = "draw-rasters";
    const VERSION: u32 = 6;
    const PAGE: Page = Page::new(include_str!("draw_rasters.md"));
    const INPUTS: &'static [Port] = &[
        Port::many("rasters", &[Kind::Raster], "The first row: a stack of bands, or gathered."),
        Port::many("beside", &[Kind::Raster], "The second row."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("picture", &[Kind::Picture], "PNG.")];

    fn run(params: &Self::Params, inputs: &Inputs, _context: &Context) -> Result<Outputs, StageError> {
        let lists = [inputs.many::<Raster>("rasters")?, inputs.many::<Raster>("beside")?];
        let like = lists[0][0].1;
        if let Some((_, other)) = lists.iter().flatten().find(|(_, other)| !grid::same(&other.grid, &like.grid)) {
            let (a, b) = (grid::describe(&like.grid), grid::describe(&other.grid));
            return Err(StageError::new(format!("one raster has {a}, another {b}"))
                .hint("rasterise all on one grid: port `grid` of `rasterise-dem`"));
        }
        let tiles = |k: usize| tiles(&lists[k], params.names.get(k).map(String::as_str), params.most);
        Ok(Outputs::of("picture", Picture { png: draw(params, like, &[tiles(0), tiles(1)])? }))
    }
}

/// The name of a raster and its values.
type Tile<'a> = (String, &'a [f32]);

/// The first rasters of a list, named by what they are, their place on the gathered axes and their band.
fn tiles<'a>(list: &[(&Point, &'a Raster)], prefix: Option<&str>, most: usize) -> Vec<Tile<'a>> {
    let bands = list.iter().flat_map(|(point, raster)| raster.bands.iter().map(move |band| (*point, *raster, band)));
    let named = |(point, raster, band): (&Point, &Raster, &'a Band)| {
        let own = (point.is_empty() || raster.bands.len() > 1).then(|| band.name.clone());
        let parts = point.iter().map(|(axis, item)| format!("{axis} {item}")).chain(own);
        let name = prefix.map(str::to_owned).into_iter().chain(parts).collect::<Vec<_>>().join(", ");
        (name, band.values.as_slice())
    };
    bands.take(most).map(named).collect()
}

fn draw(params: &DrawRastersParams, like: &Raster, lists: &[Vec<Tile>; 2]) -> Result<Vec<u8>, StageError> {
    let across = params.columns.unwrap_or_else(|| lists[0].len().max(lists[1].len()));
    let tiles = || lists.iter().flatten();
    let Some(most) = nearest_rank(tiles().flat_map(|(_, values)| values.iter().map(|v| v.abs())), WITHIN) else {
        fail!("nothing to draw: no cell has a value")
    };
    let reach = params.range_m.unwrap_or(if most > 0.0 { most } else { 0.5 });
    // What is never negative needs one half of the colours only.
    let is_signed = like.quantity == "difference" || tiles().any(|(_, values)| values.iter().any(|v| *v < 0.0));
    let scale = if is_signed {
        ColourScale { palette: Palette::RedBlue, low: -reach, high: reach }
    } else {
        ColourScale { palette: Palette::Viridis, low: 0.0, high: reach }
    };
    let values = lists.each_ref().map(|list| list.iter().map(|(_, values)| *values).collect());
    let max_width_px = params.max_width_px as usize;
    let mosaic = Mosaic::new([like.grid.columns, like.grid.rows], &values, across, max_width_px);
    let subject = Subject {
        columns: mosaic.columns,
        values: &mosaic.values,
        cell_m: Some(like.grid.cell_m),
        shaded: false,
        unit: look::unit(&like.quantity, &scale),
        scale,
        title: params.title.clone().unwrap_or_else(|| format!("{} rasters", tiles().count())),
        subtitle: format!("each {} x {} cells of {}", like.grid.columns, like.grid.rows, length(like.grid.cell_m)),
        up: None,
    };
    let names = told_apart(&tiles().map(|(name, _)| name.as_str()).collect::<Vec<_>>());
    mosaic.draw(&subject, &names, max_width_px).map_err(|e| StageError::new(e.to_string()))
}

/// The names, those that occur more than once with a number behind them.
fn told_apart(names: &[&str]) -> Vec<String> {
    let numbered = |(place, name): (usize, &&str)| {
        let before = names[..place].iter().filter(|other| *other == name).count();
        let after = names[place + 1..].contains(name);
        if before > 0 || after { format!("{name} {}", before + 1) } else { (*name).to_owned() }
    };
    names.iter().enumerate().map(numbered).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::{Artefact, Frame, Grid};
    use rockface_core::testing::{TestHost, run_stage};

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
        let (stack, at) = (raster(40, 2), Point::from([("replicate".to_owned(), "3".to_owned())]));
        let names =
            |list: &[(&Point, &Raster)], prefix| tiles(list, prefix, 2).into_iter().map(|tile| tile.0).collect();
        let (of_stack, of_axis): (Vec<String>, Vec<String>) = (
            names(&[(&Point::new(), &stack)], None),
            names(&[(&at, &raster(40, 1)), (&at, &stack)], Some("simulated")),
        );
        assert_eq!(of_stack, ["a", "a"]);
        assert_eq!(told_apart(&["a", "b", "a"]), ["a 1", "b", "a 2"]);
        assert_eq!(of_axis, ["simulated, replicate 3", "simulated, replicate 3, a"]);
        assert!(drawn(raster(40, 5), raster(40, 2)).unwrap().png.starts_with(b"\x89PNG"));
        let strength = || Raster { quantity: "strength".into(), ..raster(40, 1) };
        assert!(drawn(strength(), strength()).unwrap() != drawn(raster(40, 1), raster(40, 1)).unwrap());
        assert!(drawn(raster(40, 5), raster(30, 2)).unwrap_err().message.contains("another"));
    }
}
