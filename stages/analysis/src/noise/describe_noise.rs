//! `describe-noise`: turns difference rasters without rockfall into the features and curves that noise is compared by.

use rayon::prelude::*;

use crate::noise::descriptors::{DIAGNOSTICS, Description, Settings, describe, feature_names};
use crate::noise::detrend::Detrend;
use crate::noise::doubtful::doubts;
use crate::noise::robust_variogram::Estimator;
use crate::noise::variogram_model::Shape;
use rockface_core::artefact::{Band, Cell, Kind, Raster, Table};
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, params};

params! {
    /// Parameters of `describe-noise`.
    pub struct DescribeNoiseParams {
        /// Longest lag of the variogram, cells; left out: half the shorter side of the raster, at most 600.
        max_lag_cells: Option<usize> = None; Range::AtLeast(3.0),
        /// Shape of the variogram model.
        model: Shape = Shape::Exponential,
        /// How the variogram is estimated from the differences of pairs.
        estimator: Estimator = Estimator::Matheron,
        /// What is taken off before variogram, spectrum and roughness.
        detrend: Detrend = Detrend::Mean,
        /// Directions of further variograms and spectra, degrees counter-clockwise from X; each takes what lies within 22.5 degrees.
        directions_deg: Vec<f64> = Vec::new(); Range::Between(-360.0, 360.0),
        /// Standard deviations of the roughness filters, cells. Left out: those of 1, 2, 4, 8, 16 and 32 that are at most half the
        /// shorter side of the raster.
        scales_cells: Option<Vec<f64>> = None; Range::Between(0.25, 1000.0),
    }
}

/// Describes the noise of each band by ten features, by further figures, and by the curves they are taken from.
pub struct DescribeNoise;

impl Stage for DescribeNoise {
    type Params = DescribeNoiseParams;
    const NAME: &'static str = "describe-noise";
    const VERSION: u32 = 3;
    const PAGE: Page = Page::new(include_str!("describe_noise.md"));
    const INPUTS: &'static [Port] =
        &[Port::one("raster", &[Kind::Raster], "Differences without rockfall, metres, any number of bands.")];
    const OUTPUTS: &'static [Port] = &[
        Port::one("features", &[Kind::Table], "One row a band: `raster`, the ten features, further figures."),
        Port::one("curves", &[Kind::Table], "Long table: raster, curve, x, y, n."),
    ];

    fn check(params: &Self::Params) -> Vec<Fault> {
        let mut fault = Fault::new("two different scales are needed to fit an exponent");
        fault.path = vec!["scales_cells".to_owned()];
        let first = params.scales_cells.as_ref().and_then(|scales| scales.first());
        let varied = params.scales_cells.as_ref().is_none_or(|scales| scales.iter().any(|scale| Some(scale) != first));
        if varied { Vec::new() } else { vec![fault] }
    }

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        // Complex spectra beyond the sides for the exact variogram, of as many bands at a time as there are threads.
        let bands = inputs.small("raster", |raster: &Raster| raster.bands.len() as u64).unwrap_or(1).max(1);
        inputs.total() + 13 * inputs.at_once(bands) * (inputs.of("raster") / bands)
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let raster = inputs.one::<Raster>("raster")?;
        let scales_cells = params.scales_cells.clone().unwrap_or_else(|| usual_scales_cells(raster));
        check_scales(&scales_cells, raster)?;
        let settings = Settings {
            max_lag_cells: params.max_lag_cells,
            shape: params.model,
            estimator: params.estimator,
            detrend: params.detrend,
            directions_deg: params.directions_deg.clone(),
            scales_cells,
        };
        let one = |band: &Band| -> Result<Description, StageError> {
            context.check_cancelled()?;
            describe(&band.values, &raster.grid, &settings).map_err(|e| refused(&band.name, e))
        };
        let found: Vec<Result<Description, StageError>> = raster.bands.par_iter().map(one).collect();
        let found: Vec<Description> = found.into_iter().collect::<Result<_, _>>()?;
        let named: Vec<(&str, &Description)> = raster.bands.iter().map(|b| b.name.as_str()).zip(&found).collect();
        let values: Vec<(&str, &[f32])> =
            raster.bands.iter().map(|band| (band.name.as_str(), band.values.as_slice())).collect();
        doubts(&values).into_iter().for_each(|text| context.warn(text));
        log(&named, context);
        Ok(Outputs::of("features", features_table(&named)).and("curves", curves_table(&named, raster.grid.cell_m)))
    }
}

/// A filter wider than the raster leaves no roughness of its own scale.
/// Deviations of the filters for rasters that are large enough.
const USUAL_SCALES_CELLS: [f64; 6] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0];

/// The usual deviations of the filters that suit the raster; the first two in any case.
fn usual_scales_cells(raster: &Raster) -> Vec<f64> {
    let fits = |scale: &f64| *scale <= largest_cells(raster) || *scale <= USUAL_SCALES_CELLS[1];
    USUAL_SCALES_CELLS.into_iter().filter(fits).collect()
}

/// The largest deviation of a filter: half the shorter side of the raster, cells.
fn largest_cells(raster: &Raster) -> f64 {
    raster.grid.columns.min(raster.grid.rows) as f64 / 2.0
}

fn check_scales(scales_cells: &[f64], raster: &Raster) -> Result<(), StageError> {
    let largest_cells = largest_cells(raster);
    let Some(scale_cells) = scales_cells.iter().find(|scale| **scale > largest_cells) else { return Ok(()) };
    let (columns, rows) = (raster.grid.columns, raster.grid.rows);
    Err(StageError::new(format!(
        "a roughness scale of {scale_cells} cells is above half the shorter side of the raster of {columns} x {rows} cells"
    ))
    .hint(format!("list only `scales_cells` up to {largest_cells}, the same for all rasters that are compared")))
}

fn refused(band: &str, why: StageError) -> StageError {
    why.within(format!("band `{band}` cannot be described"))
        .hint("look at it with `draw-picture`; leave it out, or widen filters and masks before this step")
}

fn log(named: &[(&str, &Description)], context: &Context) {
    for (name, found) in named {
        if found.model.range95() > found.lags_m[found.lags_m.len() - 1] {
            context.warn(format!(
                "`{name}`: the fitted range of {:.3} m lies beyond the longest lag of the variogram; its sill is an \
                 extrapolation",
                found.model.range95()
            ));
        }
    }
    let n = named.len() as f64;
    for (index, feature) in feature_names().into_iter().enumerate() {
        let mean = named.iter().map(|(_, found)| found.features[index]).sum::<f64>() / n;
        context.metric(&format!("mean_of_{feature}"), mean, unit(feature));
    }
}

fn unit(feature: &str) -> &'static str {
    match feature.rsplit_once('_') {
        Some((_, "m")) => "m",
        Some((_, "m2")) => "m2",
        _ => "1",
    }
}

fn features_table(named: &[(&str, &Description)]) -> Table {
    let columns = std::iter::once("raster").chain(feature_names()).chain(DIAGNOSTICS);
    let mut table = Table::new(columns);
    for (name, found) in named {
        let numbers = found.features.iter().chain(&found.diagnostics).map(|x| Cell::from(*x));
        table.push(std::iter::once(Cell::from(*name)).chain(numbers).collect());
    }
    table
}

fn curves_table(named: &[(&str, &Description)], cell_m: f64) -> Table {
    let mut table = Table::new(["raster", "curve", "x", "y", "n"]);
    for (name, found) in named {
        let mut add = |curve: &str, x: f64, y: f64, n: f64| {
            table.push(vec![(*name).into(), curve.into(), x.into(), y.into(), n.into()]);
        };
        let empirical = &found.variogram;
        for (i, h) in found.lags_m.iter().enumerate() {
            add("variogram", *h, empirical.gamma[i], empirical.pairs[i]);
        }
        for (i, h) in found.lags_m.iter().enumerate() {
            add("variogram_model", *h, found.model.gamma(*h), empirical.pairs[i]);
        }
        for (deg, along, _) in &found.directional {
            let curve = format!("variogram_{}", deg.rem_euclid(180.0));
            for (i, cells) in along.lag_cells.iter().enumerate() {
                add(&curve, cells * cell_m, along.gamma[i], along.pairs[i]);
            }
        }
        let sectors =
            found.directional.iter().map(|(deg, _, along)| (format!("spectrum_{}", deg.rem_euclid(180.0)), along));
        for (curve, spectrum) in std::iter::once(("spectrum".to_owned(), &found.spectrum)).chain(sectors) {
            // The lowest frequencies of a sector may have no sample.
            for (i, f) in spectrum.frequency.iter().enumerate().filter(|(i, _)| spectrum.samples[*i] > 0.0) {
                add(&curve, *f, spectrum.power[i], spectrum.samples[i]);
            }
        }
        for (sigma, rms) in found.roughness.sigma.iter().zip(&found.roughness.rms) {
            add("roughness", *sigma, *rms, found.marginal.count as f64);
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::{Artefact, Frame, Grid, Noun};
    use rockface_core::numerics::random::Key;
    use rockface_core::testing::{TestHost, run_stage};

    const GRID: Grid = Grid { columns: 60, rows: 50, cell_m: 0.01, left_m: 0.0, top_m: 0.0 };

    fn noise(bands: u8) -> Raster {
        let mut raster = Raster::single(GRID, Frame::Wall, "difference", "", Vec::new());
        let band = |b: u8| {
            let field = Key([b; 32]).field();
            let value =
                |i: usize| if i % 17 == 3 { f32::NAN } else { field.normal((i % 60) as i32, (i / 60) as i32) as f32 };
            Band { name: format!("n{b}"), values: (0..3000).map(value).collect() }
        };
        raster.bands = (0..bands).map(band).collect();
        raster
    }

    fn tables(raster: Raster) -> Result<(Table, Table), StageError> {
        let with = json!({"scales_cells": [1, 2, 4]});
        let outputs =
            run_stage::<DescribeNoise>(&TestHost::default(), &with, &[("raster", raster.into())])?.into_inner();
        let [Artefact::Table(features), Artefact::Table(curves)] = [&outputs["features"], &outputs["curves"]] else {
            panic!("two tables come out");
        };
        Ok((features.clone(), curves.clone()))
    }

    #[test]
    fn one_row_a_band_and_long_curves() {
        let (features, curves) = tables(noise(3)).unwrap();
        assert_eq!(features.rows.len(), 3);
        assert_eq!(features.columns[..4], ["raster", "mean_m", "std_m", "skewness"]);
        let valid = features.column("valid_cells").unwrap();
        assert_eq!(features.rows[2][valid].number(), Some(2823.0));
        let of = |curve: &str| curves.rows.iter().filter(|row| row[1].text() == Some(curve)).count();
        assert_eq!(["variogram", "variogram_model", "spectrum", "roughness"].map(of), [75, 75, 75, 9]);
    }

    #[test]
    fn the_thread_count_does_not_change_a_bit() {
        let bytes = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| tables(noise(4)).map(|(f, c)| (f.encode().unwrap(), c.encode().unwrap()))).unwrap()
        };
        assert_eq!(bytes(1), bytes(3));
    }

    #[test]
    fn a_band_that_cannot_be_described_is_named() {
        let mut raster = noise(2);
        raster.bands[1].values.fill(0.25);
        let error = tables(raster).unwrap_err();
        assert!(error.message.contains("`n1`") && error.message.contains("0.25"), "{error}");
    }

    #[test]
    fn a_scale_beyond_half_the_raster_is_refused() {
        let inputs = [("raster", noise(1).into())];
        assert_eq!(usual_scales_cells(&noise(1)), [1.0, 2.0, 4.0, 8.0, 16.0]);
        let with = json!({"scales_cells": [1, 25, 25.5]});
        let error = run_stage::<DescribeNoise>(&TestHost::default(), &with, &inputs).err().unwrap();
        assert!(error.message.contains("25.5 cells") && error.message.contains("60 x 50"), "{error}");
    }

    #[test]
    fn equal_scales_are_refused_before_anything_runs() {
        use rockface_core::AnyStage;
        let row = rockface_core::Row::<DescribeNoise>::new();
        assert_eq!(row.check(&json!({"scales_cells": [2, 2]})).unwrap_err()[0].path, ["scales_cells"]);
        assert!(row.check(&json!({})).is_ok());
    }

    /// Columns of the independent implementation beside ours.
    const SAME: [(&str, &str); 16] = [
        ("mean", "mean_m"),
        ("std", "std_m"),
        ("skew", "skewness"),
        ("nugget", "nugget_m2"),
        ("sill", "sill_m2"),
        ("range95", "range95_m"),
        ("spec_slope", "spectral_slope"),
        ("entropy", "spectral_entropy"),
        ("rough_a", "roughness_a"),
        ("rough_b", "roughness_b"),
        ("exkurt", "excess_kurtosis"),
        ("nan_share", "nan_share"),
        ("nmad", "nmad_m"),
        ("gamma1", "gamma1_m2"),
        ("rough_r2", "roughness_r2"),
        ("range_struct", "range_structural_m"),
    ];

    /// Compares real rasters with an independent implementation; `step` takes every so manieth of the 39.
    fn compare_with_reference(step: usize) {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data/outcrop-survey");
        let Ok(csv) = std::fs::read(format!("{folder}/features.csv")) else {
            eprintln!("skipped: {folder} is not there");
            return;
        };
        let mut reader = csv::Reader::from_reader(csv.as_slice());
        let header = reader.headers().unwrap().clone();
        let expected: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).step_by(step).collect();
        let mut stack: Option<Raster> = None;
        for row in &expected {
            let mut raster = Raster::decode(&std::fs::read(format!("{folder}/real/{}", &row[0])).unwrap()).unwrap();
            match &mut stack {
                None => stack = Some(raster),
                Some(stack) => stack.bands.append(&mut raster.bands),
            }
        }
        let with = json!({});
        let start = std::time::Instant::now();
        let outputs =
            run_stage::<DescribeNoise>(&TestHost::default(), &with, &[("raster", stack.unwrap().into())]).unwrap();
        println!("{} rasters in {:?}", expected.len(), start.elapsed());
        let Artefact::Table(features) = &outputs.into_inner()["features"] else { panic!("a table comes out") };
        let mut worst = (0.0f64, String::new());
        for (row, found) in expected.iter().zip(&features.rows) {
            for (theirs, ours) in SAME {
                let column = header.iter().position(|name| name == theirs).unwrap();
                let theirs: f64 = row[column].parse().unwrap();
                let value = found[features.column(ours).unwrap()].number().unwrap();
                let error = (value - theirs).abs() / theirs.abs().max(1e-12);
                if error > worst.0 {
                    worst = (error, format!("{ours} of {}", &row[0]));
                }
                assert!(error < 5e-5, "{} {ours}: {value}, expected {theirs}", &row[0]);
            }
        }
        println!("largest relative difference {worst:?}");
    }

    #[test]
    fn agrees_with_an_independent_implementation_on_some_real_rasters() {
        compare_with_reference(13);
    }

    #[test]
    fn agrees_with_an_independent_implementation_on_all_real_rasters() {
        if std::env::var_os("ROCKFACE_SLOW").is_none() {
            println!("skipped: set ROCKFACE_SLOW=1 for all 39 rasters");
            return;
        }
        compare_with_reference(1);
    }
}
