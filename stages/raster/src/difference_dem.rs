//! `difference-dem`: comparison minus reference, cell by cell.

use crate::grid;
use crate::strange_values::{impossible_differences, written};
use rockface_core::artefact::{Band, Kind, Raster};
use rockface_core::numerics::marginal;
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};

params! {
    /// Parameters of `difference-dem`: there are none.
    pub struct DifferenceDemParams {}
}

/// Subtracts two elevation rasters: comparison - reference.
pub struct DifferenceDem;

impl Stage for DifferenceDem {
    type Params = DifferenceDemParams;
    const NAME: &'static str = "difference-dem";
    const VERSION: u32 = 2;
    const PAGE: Page = Page::new(include_str!("difference_dem.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("reference", &[Kind::Raster], "Elevations of the earlier epoch."),
        Port::one("comparison", &[Kind::Raster], "Elevations of the later epoch, on the same grid."),
    ];
    const OUTPUTS: &'static [Port] =
        &[Port::one("raster", &[Kind::Raster], "Quantity `difference`, metres; NaN where either has no value.")];

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        // The difference, its file and its sketch.
        inputs.total() + inputs.total() * 22 / 10
    }

    fn run(_params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let (reference, comparison) = (inputs.one::<Raster>("reference")?, inputs.one::<Raster>("comparison")?);
        check(reference, comparison)?;
        for (port, raster) in [("reference", reference), ("comparison", comparison)] {
            if raster.quantity != "elevation" {
                context.warn(format!(
                    "`{port}` holds the quantity `{}`, not `elevation`: the result is no change of the surface",
                    raster.quantity
                ));
            }
        }
        let bands: Vec<Band> =
            reference.bands.iter().zip(&comparison.bands).map(|(r, c)| subtract(r, c, reference.bands.len())).collect();
        for band in &bands {
            warn_of_impossible(band, context);
        }
        let all: Vec<f32> = bands.iter().flat_map(|band| band.values.iter().copied()).collect();
        let Some(found) = marginal::marginal(&all) else {
            return Err(StageError::new("reference and comparison have fewer than two cells in common")
                .hint("look at both with `draw-picture`: do they show the same part of the face?"));
        };
        context.metric("mean_m", found.mean, "m");
        context.metric("std_m", found.deviation, "m");
        context.metric("nmad_m", found.nmad, "m");
        context.metric("valid_share", found.count as f64 / all.len() as f64, "1");
        let mut raster = Raster::single(reference.grid, reference.frame, "difference", "", Vec::new());
        raster.bands = bands;
        Ok(Outputs::of("raster", raster))
    }
}

fn check(reference: &Raster, comparison: &Raster) -> Result<(), StageError> {
    let (r, c) = (reference.bands.len(), comparison.bands.len());
    if r != c {
        fail!("the reference has {r} bands, the comparison {c}");
    }
    if grid::same(&reference.grid, &comparison.grid) && reference.frame == comparison.frame {
        return Ok(());
    }
    let (a, b) = (grid::describe(&reference.grid), grid::describe(&comparison.grid));
    let (fa, fb) = (reference.frame, comparison.frame);
    Err(StageError::new(format!("the reference has {a} ({fa} frame), the comparison {b} ({fb} frame)"))
        .hint("where both are made by `rasterise-dem`, hand the first raster to the port `grid` of the other; bring files onto one grid before, such as with `gdalwarp -te -tr`"))
}

/// Warns of differences that no change of a rock face has.
fn warn_of_impossible(band: &Band, context: &Context) {
    if let Some(found) = impossible_differences(band) {
        context.warn(format!(
            "band `{}`: {} cells differ by 100 m or more, up to {} m: one of the two may hold a no-data value as an elevation, which `nodata` of \
             `import-rasters` declares; or heights above two datums, or in two units, were compared",
            band.name,
            found.cells,
            written(found.value)
        ));
    }
}

/// NaN in either gives NaN; the subtraction is done in 64 bits.
fn subtract(reference: &Band, comparison: &Band, bands: usize) -> Band {
    let difference = |(r, c): (&f32, &f32)| (f64::from(*c) - f64::from(*r)) as f32;
    let values = reference.values.iter().zip(&comparison.values).map(difference).collect();
    let name = if bands == 1 { "difference".to_owned() } else { comparison.name.clone() };
    Band { name, values }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::{Artefact, Frame, Grid};
    use rockface_core::testing::{TestHost, run_stage};

    const GRID: Grid = Grid { columns: 2, rows: 2, cell_m: 1.0, left_m: 0.0, top_m: 0.0 };

    fn elevation(values: [f32; 4]) -> Raster {
        Raster::single(GRID, Frame::Wall, "elevation", "z", values.to_vec())
    }

    #[test]
    fn lost_material_is_negative_and_gaps_stay_gaps() {
        let (reference, comparison) = (elevation([5.0, 5.0, f32::NAN, 1.0]), elevation([4.0, 7.0, 1.0, f32::NAN]));
        let host = TestHost::default();
        let inputs: [(&str, Artefact); 2] = [("reference", reference.into()), ("comparison", comparison.into())];
        let outputs = run_stage::<DifferenceDem>(&host, &json!({}), &inputs).unwrap().into_inner();
        let expected =
            Raster::single(GRID, Frame::Wall, "difference", "difference", vec![-1.0, 2.0, f32::NAN, f32::NAN]);
        assert_eq!(outputs["raster"], Artefact::from(expected));
        assert_eq!((host.metric("mean_m"), host.metric("valid_share")), (Some(0.5), Some(0.5)));
        assert!((host.metric("std_m").unwrap() - 4.5f64.sqrt()).abs() < 1e-14);
    }

    #[test]
    fn a_difference_of_differences_is_warned_of() {
        let mut difference = elevation([1.0, 2.0, 3.0, 4.0]);
        difference.quantity = "difference".into();
        let host = TestHost::default();
        let inputs: [(&str, Artefact); 2] =
            [("reference", elevation([1.0; 4]).into()), ("comparison", difference.into())];
        run_stage::<DifferenceDem>(&host, &json!({}), &inputs).unwrap();
        let warnings = host.warnings();
        assert!(warnings.len() == 1 && warnings[0].contains("`comparison`") && warnings[0].contains("`difference`"));
    }

    #[test]
    fn differences_of_100_m_are_warned_of() {
        let warnings = |value: f32| {
            let host = TestHost::default();
            let comparison = elevation([600.0, value, value, 600.5]);
            let inputs: [(&str, Artefact); 2] =
                [("reference", elevation([600.0; 4]).into()), ("comparison", comparison.into())];
            run_stage::<DifferenceDem>(&host, &json!({}), &inputs).unwrap();
            host.warnings()
        };
        let found = warnings(-9999.0);
        assert!(found[0].contains("2 cells differ by 100 m or more, up to -10599 m") && found[0].contains("`nodata`"));
        assert!(warnings(520.0).is_empty());
    }

    #[test]
    fn other_grids_frames_and_empty_overlaps_are_refused() {
        let fails = |comparison: Raster| {
            let inputs: [(&str, Artefact); 2] =
                [("reference", elevation([1.0; 4]).into()), ("comparison", comparison.into())];
            run_stage::<DifferenceDem>(&TestHost::default(), &json!({}), &inputs).unwrap_err().message
        };
        let mut moved = elevation([1.0; 4]);
        moved.grid.top_m = 0.25;
        assert!(fails(moved).contains("top 0.25 m"));
        let mut world = elevation([1.0; 4]);
        world.frame = Frame::World;
        assert!(fails(world).contains("world frame"));
        assert!(fails(elevation([f32::NAN; 4])).contains("in common"));
    }
}
