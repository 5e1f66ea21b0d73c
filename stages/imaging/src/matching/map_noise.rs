//! `map-noise`: maps the strength of the noise over a site from rasters without change.

use crate::matching::noise::strength::{Estimation, strength};
use rockface_core::artefact::{Band, Kind, Raster, Sample};
use rockface_core::numerics::held_out::in_view;
use rockface_core::numerics::marginal;
use rockface_core::numerics::quantile::quantile;
use rockface_core::params::Range;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};
use rockface_raster::grid;

params! {
    /// Parameters of `map-noise`.
    pub struct MapNoiseParams {
        /// Share of the rasters, the last ones, that is left out of the map, so that they can judge it.
        held_out: f64 = 0.0; Range::Between(0.0, 0.9),
        /// What is smoother than a Gaussian of this deviation is no matching noise and taken off first, cells; 0: nothing.
        detrend_cells: f64 = 30.0; Range::Between(0.0, 1000.0),
        /// Deviation of the Gaussian that smooths the map, cells; 0: none. Few rasters want more.
        smoothing_cells: f64 = 1.0; Range::Between(0.0, 1000.0),
        /// Rasters that must have a value at a cell for the map to have one.
        least: usize = 5; Range::AtLeast(1.0),
    }
}

/// Maps how strong the noise of a site is from place to place, from rasters without change.
pub struct MapNoise;

impl Stage for MapNoise {
    type Params = MapNoiseParams;
    const NAME: &'static str = "map-noise";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("map_noise.md"));
    const INPUTS: &'static [Port] = &[Port::many(
        "raster",
        &[Kind::Raster],
        "Differences without rockfall, metres: a stack of bands, or gathered.",
    )];
    const OUTPUTS: &'static [Port] = &[Port::one("strength", &[Kind::Raster], "Factor on the noise, one band.")];

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let rasters = inputs.many::<Raster>("raster")?;
        let (_, raster) = rasters[0];
        if let Some((_, other)) = rasters.iter().find(|(_, other)| !grid::same(&other.grid, &raster.grid)) {
            let (a, b) = (grid::describe(&raster.grid), grid::describe(&other.grid));
            return Err(StageError::new(format!("one raster has {a}, another {b}"))
                .hint("rasterise all on one grid: port `grid` of `rasterise-dem`"));
        }
        let all: Vec<&Band> = rasters.iter().flat_map(|(_, raster)| &raster.bands).collect();
        let kept = in_view(all.len(), params.held_out);
        if kept < 3 {
            let text = format!("{kept} of {} rasters are left to make a map of, 3 are needed", all.len());
            return Err(StageError::new(text).hint("add rasters, or lower `held_out`"));
        }
        let how = Estimation {
            detrend_cells: params.detrend_cells,
            smoothing_cells: params.smoothing_cells,
            least: params.least,
        };
        let bands: Vec<&[f32]> = all[..kept].iter().map(|band| band.values.as_slice()).collect();
        let Some(values) = strength(&bands, raster.grid.columns, &how) else {
            fail!(
                "no cell has values in {} of {kept} rasters, or all values are equal: there is no noise to map",
                params.least
            );
        };
        report(&values, kept, context);
        let bands = vec![Band { name: "strength".to_owned(), values }];
        let map = Raster { bands, quantity: "strength".to_owned(), sample: Sample::Float, ..raster.clone() };
        Ok(Outputs::of("strength", map))
    }
}

fn report(values: &[f32], rasters: usize, context: &Context) {
    let known = marginal::known(values);
    let at = |level: f64| quantile(&known, level).unwrap_or(f64::NAN);
    context.metric("strength_q95", at(0.95), "1");
    context.metric("strength_q99", at(0.99), "1");
    context.note(format!(
        "from {rasters} rasters: the noisiest 5 % of the cells have {:.1} times the median noise, 1 % {:.1} times",
        at(0.95),
        at(0.99)
    ));
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::{Artefact, Frame, Grid};
    use rockface_core::numerics::random::Key;
    use rockface_core::testing::{TestHost, run_stage};

    fn mapped(bands: u8, with: &serde_json::Value) -> Result<Raster, StageError> {
        let grid = Grid { columns: 50, rows: 40, cell_m: 0.01, left_m: 0.0, top_m: 0.4 };
        let mut raster = Raster::single(grid, Frame::Wall, "difference", "", Vec::new());
        let band = |b: u8| {
            let field = Key([b; 32]).field();
            // Bands from the fourth on are ten times as noisy on the left.
            let factor = |i: usize| if b >= 4 && i % 50 < 25 { 10.0 } else { 1.0 };
            let value = |i: usize| (factor(i) * field.normal((i % 50) as i32, (i / 50) as i32)) as f32;
            Band { name: format!("n{b}"), values: (0..2000).map(value).collect() }
        };
        raster.bands = (0..bands).map(band).collect();
        let outputs = run_stage::<MapNoise>(&TestHost::default(), with, &[("raster", raster.into())])?.into_inner();
        let Artefact::Raster(map) = &outputs["strength"] else { panic!("a raster comes out") };
        Ok(map.clone())
    }

    #[test]
    fn rasters_held_out_have_no_say() {
        let with = json!({"held_out": 0.5, "least": 3, "smoothing_cells": 4, "detrend_cells": 0});
        let flat = mapped(8, &with).unwrap();
        assert!(flat.bands[0].values.iter().all(|v| (0.5..1.6).contains(v)));
        let with = json!({"least": 3, "smoothing_cells": 2, "detrend_cells": 0});
        let steep = mapped(8, &with).unwrap();
        assert!(steep.bands[0].values[20 * 50 + 5] > 2.5 * steep.bands[0].values[20 * 50 + 45]);
    }

    #[test]
    fn too_few_rasters_are_refused() {
        let error = mapped(4, &json!({"held_out": 0.5})).unwrap_err();
        assert!(error.message.contains("2 of 4 rasters"), "{error}");
        assert!(mapped(4, &json!({"least": 9})).unwrap_err().message.contains("9 of 4 rasters"));
    }
}
