//! All noise descriptors of one raster: marginal statistics, variogram, spectrum, roughness (paper 2.2.1 to 2.2.4).

use super::roughness::{Roughness, roughness};
use super::spectrum::{Spectrum, spectra};
use super::variogram::{Variogram, directional, variogram};
use super::variogram_model::{Model, Shape, fit};
use crate::noise::detrend::Detrend;
use crate::noise::robust_variogram::Estimator;
use rockface_core::artefact::Grid;
use rockface_core::numerics::marginal::{Marginal, marginal};
use rockface_core::numerics::portable_math;
use rockface_core::{StageError, fail};

/// Groups of the feature vector, each with its features in the order of the vector.
pub const GROUPS: [(&str, &[&str]); 4] = [
    ("marginal", &["mean_m", "std_m", "skewness"]),
    ("variogram", &["nugget_m2", "sill_m2", "range95_m"]),
    ("spectrum", &["spectral_slope", "spectral_entropy"]),
    ("roughness", &["roughness_a", "roughness_b"]),
];

/// Whether a feature, of the vector or one that may stand in for one of it, belongs to a group.
pub fn in_group(group: &str, feature: &str) -> bool {
    let listed = GROUPS.iter().any(|(name, members)| *name == group && members.contains(&feature));
    listed || STAND_INS.contains(&(group, feature))
}

/// Further columns that may take part in a feature vector, by group.
const STAND_INS: [(&str, &str); 6] = [
    ("marginal", "excess_kurtosis"),
    ("marginal", "nmad_m"),
    ("variogram", "gamma1_m2"),
    ("variogram", "range_structural_m"),
    ("spectrum", "entropy_normalised"),
    ("roughness", "roughness_a_ref"),
];

/// The feature vector: all groups in order.
pub fn feature_names() -> Vec<&'static str> {
    GROUPS.iter().flat_map(|(_, names)| names.iter().copied()).collect()
}

/// Features that say most of noise, the first ones first: how strong it is, how fast roughness grows with scale, tails and range.
const TELLING: [&str; 5] = ["std_m", "roughness_b", "skewness", "range95_m", "spectral_slope"];

/// The features that a number of references bears: all where there are two references more, otherwise one for two references, those that say most
/// first; at least one.
fn borne(features: &[String], references: usize) -> Vec<String> {
    if references >= features.len() + 2 {
        return features.to_vec();
    }
    let rank = |name: &String| TELLING.iter().position(|telling| telling == name).unwrap_or(TELLING.len());
    let mut ranked: Vec<&String> = features.iter().collect();
    ranked.sort_by_key(|name| rank(name));
    ranked.truncate((references.saturating_sub(1) / 2).max(1));
    features.iter().filter(|name| ranked.contains(name)).cloned().collect()
}

/// The features that a test of so many references takes, and a warning where these are fewer than were asked for, which is so only where it may be.
pub fn taken(features: &[String], references: usize, fewer: bool) -> (Vec<String>, Option<String>) {
    let taken = if fewer { borne(features, references) } else { features.to_vec() };
    let (asked, names) = (features.len(), taken.join(", "));
    let warning = (taken.len() < asked).then(|| {
        let needed = asked + 2;
        format!(
            "{references} references are too few for {asked} features, which need {needed}: only {names} are tested"
        )
    });
    (taken, warning)
}

/// Names of the further columns, in the order of [`Description::diagnostics`].
pub const DIAGNOSTICS: [&str; 9] = [
    "excess_kurtosis",
    "nmad_m",
    "gamma1_m2",
    "range_structural_m",
    "roughness_r2",
    "roughness_a_ref",
    "entropy_normalised",
    "valid_cells",
    "nan_share",
];

/// Longest lag that is used where none is asked for: more adds nothing on large rasters but time.
const LARGEST_LAG_CELLS: usize = 600;

/// Choices that enter the descriptors.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Longest lag of the variogram, cells; `None`: half the shorter side, at most 600.
    pub max_lag_cells: Option<usize>,
    /// Shape of the variogram model.
    pub shape: Shape,
    /// How gamma is estimated from the differences of pairs.
    pub estimator: Estimator,
    /// What is taken off before all but the marginal statistics.
    pub detrend: Detrend,
    /// Directions of further variograms and spectra, degrees counter-clockwise from X.
    pub directions_deg: Vec<f64>,
    /// Standard deviations of the roughness filters, cells.
    pub scales_cells: Vec<f64>,
}

/// The descriptors of one raster in metres.
#[derive(Debug, Clone)]
pub struct Description {
    /// Marginal statistics, m.
    pub marginal: Marginal,
    /// Empirical variogram; lags in cells, gamma in m^2.
    pub variogram: Variogram,
    /// Lags of the variogram, m.
    pub lags_m: Vec<f64>,
    /// Fitted model, m and m^2.
    pub model: Model,
    /// A variogram and a spectrum for each of the directions asked for; lags in cells, gamma in m^2, 1/m and m^2.
    pub directional: Vec<(f64, Variogram, Spectrum)>,
    /// Radial spectrum, 1/m and m^2.
    pub spectrum: Spectrum,
    /// Roughness, m.
    pub roughness: Roughness,
    /// The feature vector, as [`feature_names`].
    pub features: Vec<f64>,
    /// The further columns, as [`DIAGNOSTICS`].
    pub diagnostics: [f64; 9],
}

/// Describes the values of one band.
///
/// # Errors
/// A sentence that says which descriptor cannot be had and why: too few cells, constant values, infinite values, too
/// small a raster.
pub fn describe(values: &[f32], grid: &Grid, settings: &Settings) -> Result<Description, StageError> {
    let marginal = checked_marginal(values)?;
    let (columns, cell_m) = (grid.columns, grid.cell_m);
    let max_lag = settings.max_lag_cells.unwrap_or_else(|| (columns.min(grid.rows) / 2).min(LARGEST_LAG_CELLS));
    let longer = columns.max(grid.rows);
    if max_lag >= longer {
        fail!("a longest lag of {max_lag} cells does not fit into its {longer} cells (`max_lag_cells`)");
    }
    let detrended = settings.detrend.applied(values, columns);
    let values = detrended.as_deref().unwrap_or(values);
    let taken = if detrended.is_some() { checked_marginal(values)? } else { marginal };
    let mut variogram = variogram(values, columns, max_lag, taken.mean, taken.deviation);
    settings.estimator.refine(&mut variogram, values, columns);
    let lags_m: Vec<f64> = variogram.lag_cells.iter().map(|h| h * cell_m).collect();
    let model = fit(&lags_m, &variogram, settings.shape)
        .ok_or_else(|| format!("its variogram has only {} lags with pairs, 3 are needed", lags_m.len()))?;
    let (spectrum, sectors) =
        spectra(values, columns, cell_m, &settings.directions_deg).ok_or("its spectrum is empty")?;
    let moments = [taken.mean, taken.deviation];
    let along = |(deg, spectrum)| (deg, directional(values, columns, max_lag, moments, deg), spectrum);
    let directional = settings.directions_deg.iter().copied().zip(sectors).map(along).collect();
    let slope = spectrum.slope().ok_or_else(|| {
        format!(
            "its spectrum of {} frequencies is too short for a slope (at least 20 x 20 cells)",
            spectrum.power.len()
        )
    })?;
    let roughness = roughness(values, columns, cell_m, &settings.scales_cells, taken.mean);
    let line = roughness.power_law().ok_or("its roughness has no power law (two different scales are needed)")?;
    let mut features = vec![marginal.mean, marginal.deviation, marginal.skewness];
    features.extend([model.nugget, model.sill(), model.range95()]);
    features.extend([slope.slope, spectrum.entropy(), line.intercept, line.slope]);
    let cells = values.len() as f64;
    let diagnostics = [
        marginal.excess_kurtosis,
        marginal.nmad,
        variogram.gamma[0],
        model.range_structural(),
        line.r2,
        roughness.reference_intercept(&line),
        spectrum.entropy_normalised(),
        marginal.count as f64,
        1.0 - marginal.count as f64 / cells,
    ];
    match feature_names().iter().zip(&features).find(|(_, value)| !value.is_finite()) {
        Some((name, value)) => Err(StageError::new(format!("its {name} is {value}"))),
        None => Ok(Description {
            marginal,
            variogram,
            lags_m,
            model,
            directional,
            spectrum,
            roughness,
            features,
            diagnostics,
        }),
    }
}

fn checked_marginal(values: &[f32]) -> Result<Marginal, StageError> {
    if let Some(bad) = values.iter().find(|v| v.is_infinite()) {
        fail!("it holds the value {bad}");
    }
    let found = marginal(values).ok_or("it has fewer than two cells with a value")?;
    // What rounding makes of equal values is no spread.
    if found.deviation <= 1e-12 * found.mean.abs().max(f64::MIN_POSITIVE) {
        fail!("all its values are {}", precise_text(found.mean));
    }
    Ok(found)
}

fn precise_text(value: f64) -> String {
    if value != 0.0 && portable_math::log10(value.abs()) < -4.0 { format!("{value:e}") } else { format!("{value}") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    fn settings() -> Settings {
        Settings {
            max_lag_cells: None,
            shape: Shape::Exponential,
            estimator: Estimator::Matheron,
            detrend: Detrend::Mean,
            directions_deg: Vec::new(),
            scales_cells: vec![1.0, 2.0, 4.0],
        }
    }

    fn grid(columns: usize, rows: usize) -> Grid {
        Grid { columns, rows, cell_m: 0.02, left_m: 0.0, top_m: 0.0 }
    }

    #[test]
    fn white_noise_is_all_nugget_and_no_range() {
        let field = Key([1; 32]).field();
        let values: Vec<f32> = (0..120 * 90).map(|i| 0.01 * field.normal(i % 120, i / 120) as f32).collect();
        let found = describe(&values, &grid(120, 90), &settings()).unwrap();
        let feature = |name: &str| found.features[feature_names().iter().position(|n| *n == name).unwrap()];
        assert_eq!(found.features.len(), 10);
        assert!((feature("std_m") - 0.01).abs() < 2e-4);
        assert!((feature("sill_m2") - 1e-4).abs() < 4e-6);
        let (range95_m, slope) = (feature("range95_m"), feature("spectral_slope"));
        assert!(range95_m < 0.03 && slope.abs() < 0.25, "{range95_m} {slope}");
        assert!(feature("roughness_b") < 0.1);
    }

    #[test]
    fn few_references_bear_the_features_that_say_most() {
        let all: Vec<String> = feature_names().into_iter().map(str::to_owned).collect();
        assert_eq!(borne(&all, 12), all);
        assert_eq!(borne(&all, 11), ["std_m", "skewness", "range95_m", "spectral_slope", "roughness_b"]);
        assert_eq!(borne(&all, 7), ["std_m", "skewness", "roughness_b"]);
        assert_eq!((borne(&all, 1), borne(&all[2..3], 2)), (vec![all[1].clone()], vec![all[2].clone()]));
    }

    #[test]
    fn what_cannot_be_described_says_why() {
        let fails = |values: &[f32], columns| {
            describe(values, &grid(columns, values.len() / columns), &settings()).unwrap_err().message
        };
        assert!(fails(&[f32::NAN; 100], 10).contains("fewer than two"));
        assert!(fails(&[0.1; 400], 20).contains("all its values are 0.1"));
        assert!(fails(&[1.0, f32::INFINITY], 2).contains("inf"));
        let far = Settings { max_lag_cells: Some(1_000_000_000), ..settings() };
        assert!(describe(&[1.0, 2.0, 3.0, 5.0], &grid(2, 2), &far).unwrap_err().message.contains("longest lag"));
        let tiny: Vec<f32> = (0..16).map(|i| i as f32).collect();
        assert!(fails(&tiny, 4).contains("lags"));
        let small: Vec<f32> = (0..64).map(|i| (i * i % 7) as f32).collect();
        assert!(fails(&small, 8).contains("spectrum"), "{}", fails(&small, 8));
    }
}
