//! `filter-outliers`: turns cells whose value is larger than a limit into cells without a value.

use rockface_core::artefact::{Kind, Raster, Sample};
use rockface_core::params::Range;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, params};

params! {
    /// Parameters of `filter-outliers`.
    pub struct FilterOutliersParams {
        /// Largest absolute value that is kept, metres.
        max_abs_m: f64 = 0.10; Range::Positive,
    }
}

/// Sets every cell with |value| > `max_abs_m` to NaN, in each band.
pub struct FilterOutliers;

impl Stage for FilterOutliers {
    type Params = FilterOutliersParams;
    const NAME: &'static str = "filter-outliers";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("filter_outliers.md"));
    const INPUTS: &'static [Port] =
        &[Port::one("raster", &[Kind::Raster], "Differences, any number of bands.").changed()];
    const OUTPUTS: &'static [Port] = &[Port::one("raster", &[Kind::Raster], "The same without the outliers.")];

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let mut raster = inputs.owned::<Raster>("raster")?;
        let (mut removed, mut valid) = (0usize, 0usize);
        for band in &mut raster.bands {
            let before = valid_cells(&band.values);
            for value in band.values.iter_mut().filter(|v| f64::from(v.abs()) > params.max_abs_m) {
                *value = f32::NAN;
            }
            let after = valid_cells(&band.values);
            if before > 0 && after == 0 {
                let text = format!("every value of band `{}` is beyond {} m", band.name, params.max_abs_m);
                return Err(StageError::new(text).hint("raise `max_abs_m`; values must be in metres"));
            }
            valid += before;
            removed += before - after;
        }
        if removed > 0 {
            raster.sample = Sample::Float;
        }
        context.metric("outliers", removed as f64, "cells");
        context.metric("outlier_share", removed as f64 / valid.max(1) as f64, "1");
        let outputs = Outputs::of("raster", raster);
        Ok(if removed == 0 { outputs.unchanged("raster", "raster") } else { outputs })
    }
}

fn valid_cells(values: &[f32]) -> usize {
    values.iter().filter(|v| !v.is_nan()).count()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::{Artefact, Frame, Grid};
    use rockface_core::testing::{TestHost, run_stage};

    #[test]
    fn only_what_is_beyond_the_limit_goes() {
        let grid = Grid { columns: 5, rows: 1, cell_m: 1.0, left_m: 0.0, top_m: 0.0 };
        let values = vec![0.125, -0.126, f32::INFINITY, f32::NAN, -0.0];
        let raster = Raster::single(grid, Frame::Wall, "difference", "d", values);
        let host = TestHost::default();
        let with = json!({"max_abs_m": 0.125});
        let outputs = run_stage::<FilterOutliers>(&host, &with, &[("raster", raster.clone().into())]).unwrap();
        let expected = vec![0.125, f32::NAN, f32::NAN, f32::NAN, -0.0];
        let expected = Raster::single(grid, Frame::Wall, "difference", "d", expected);
        assert_eq!(outputs.unchanged_from("raster"), None);
        assert_eq!(outputs.into_inner()["raster"], Artefact::from(expected));
        assert_eq!(host.metric("outlier_share"), Some(0.5));
        let quiet = Raster::single(grid, Frame::Wall, "difference", "d", vec![0.1; 5]);
        let outputs = run_stage::<FilterOutliers>(&host, &with, &[("raster", quiet.into())]).unwrap();
        assert_eq!(outputs.unchanged_from("raster"), Some("raster"), "nothing was removed");
        let mut large = raster;
        large.bands[0].values = vec![1.0; 5];
        let error = run_stage::<FilterOutliers>(&host, &with, &[("raster", large.into())]).unwrap_err();
        assert!(error.message.contains("`d`"));
    }

    /// A byte or a word has no way to say that there is no value.
    #[test]
    fn a_raster_of_bytes_or_words_that_gets_gaps_becomes_one_of_floats() {
        let grid = Grid { columns: 2, rows: 1, cell_m: 1.0, left_m: 0.0, top_m: 0.0 };
        let sample_within = |sample: Sample, max_abs_m: f64| {
            let raster = Raster { sample, ..Raster::single(grid, Frame::Wall, "difference", "d", vec![1.0, 200.0]) };
            let with = json!({"max_abs_m": max_abs_m});
            let outputs = run_stage::<FilterOutliers>(&TestHost::default(), &with, &[("raster", raster.into())]);
            let outputs = outputs.unwrap().into_inner();
            let Artefact::Raster(filtered) = &outputs["raster"] else { panic!("a raster comes out") };
            filtered.sample
        };
        for sample in [Sample::Byte, Sample::Word] {
            assert_eq!(sample_within(sample, 100.0), Sample::Float);
            assert_eq!(sample_within(sample, 300.0), sample, "without an outlier it stays");
        }
    }
}
