//! Squared Mahalanobis distance to a set of reference rasters in feature space (paper 2.2.5).
//!
//! Features are standardised by mean and standard deviation (N - 1) of the reference; the covariance S of the
//! standardised features has a unit diagonal, so the ridge lambda v I of the paper has v = 1. With z the standardised
//! features of a raster and P = (S + lambda I)^-1, D2 = z' P z, and `z_j (P z)_j` is the contribution of feature j.
//!
//! A feature that is the same in all n references, or differs by less than a tenth of its resolution s (rasters whose mean was taken off differ in
//! it by rounding), has no spread to standardise by. A raster that departs from it by d is judged as if it was counted among the references: the
//! variance of the feature is then s^2 + d^2 / (n + 1), and the raster lies d n / (n + 1) from the mean. So the contribution is
//! (n / (n + 1))^2 d^2 / (s^2 + d^2 / (n + 1)): about (d / s)^2 for a small departure, and n^2 / (n + 1), above every threshold, for any large one.

use nalgebra::{Cholesky, DMatrix, DVector, SymmetricEigen};

use super::chain;

use rockface_core::artefact::GroupModel;
use rockface_core::numerics::quantile::quantile;
use rockface_core::{StageError, fail};

/// Distance of a raster whose leave-one-out reference does not vary in a direction it differs in; JSON has no infinity.
pub const UNBOUNDED_D2: f64 = f64::MAX;

/// Spread below which a feature counts as constant, relative to its size: some ten times the rounding of rasters of 32 bits.
const CONSTANT: f64 = 1e-6;

/// Spread below which a feature counts as constant, as a share of its resolution.
const BELOW_RESOLUTION: f64 = 0.1;

/// The resolution of a feature that does not vary, as a share of what it is measured by.
const RESOLUTION: f64 = 0.01;

/// Features that may be 0 but for rounding, each with those it is measured by, the first one that is there: a mean by how much heights
/// scatter, a nugget by the sill. A length in the plane of the face says nothing of a height, and what scatters itself is measured by its own size.
const MEASURED_BY: [(&str, &[&str]); 2] = [("mean_m", &["std_m", "nmad_m"]), ("nugget_m2", &["sill_m2", "gamma1_m2"])];

/// Resolution of a range that is 0 in all references, metres.
const RANGE_M: f64 = 1e-3;

/// A squared distance and what each feature adds to it.
#[derive(Debug, Clone, PartialEq)]
pub struct Distance {
    /// D2, the squared distance.
    pub d2: f64,
    /// `z_j (P z)_j` of each feature that varies over the reference, then what each constant one adds. They add up to D2; the
    /// first may be negative.
    pub contributions: Vec<f64>,
}

/// The largest D2 that one of `n` reference rasters can have: (n - 1)^2 / n.
pub fn bound(n: usize) -> f64 {
    let n = n as f64;
    (n - 1.0) * (n - 1.0) / n
}

/// Fits the reference of one group of features; `rows` has the values of each reference raster in the order of `names`.
///
/// # Errors
/// No feature varies, fewer than p + 2 rasters, or features so nearly collinear that the covariance has no inverse.
pub fn fit(names: &[String], rows: &[Vec<f64>], ridge: f64) -> Result<GroupModel, StageError> {
    if rows.is_empty() {
        fail!("the tables of the references have no rows: there is nothing to learn from");
    }
    let (mean, deviation) = moments(rows, names.len());
    let constants = constants(names, rows);
    let (varying, constant): (Vec<usize>, Vec<usize>) = (0..names.len()).partition(|j| constants[*j].is_none());
    let pick = |values: &[f64]| varying.iter().map(|j| values[*j]).collect::<Vec<f64>>();
    let (p, n) = (varying.len(), rows.len());
    if p == 0 {
        fail!("none of {} varies over the {n} reference rasters", names.join(", "));
    }
    if n < p + 2 {
        fail!("{p} features need at least {} reference rasters, found {n}", p + 2);
    }
    let (constant_value, constant_resolution) =
        constants.into_iter().flatten().map(|Constant { value, resolution }| (value, resolution)).unzip();
    let rows: Vec<Vec<f64>> = rows.iter().map(|row| pick(row)).collect();
    let (mean, deviation) = (pick(&mean), pick(&deviation));
    let covariance = covariance(&rows, &mean, &deviation);
    let inverse = inverse(&covariance, ridge).ok_or_else(|| {
        let features: Vec<&str> = varying.iter().map(|j| names[*j].as_str()).collect();
        format!("{} are collinear over the reference rasters: raise `ridge` or leave one out", features.join(", "))
    })?;
    let mut eigenvalues: Vec<f64> = SymmetricEigen::new(covariance).eigenvalues.iter().copied().collect();
    eigenvalues.sort_by(|a, b| b.total_cmp(a));
    let mut model = GroupModel {
        features: varying.iter().map(|j| names[*j].clone()).collect(),
        mean,
        deviation,
        inverse: (0..p).map(|i| inverse.row(i).iter().copied().collect()).collect(),
        eigenvalues,
        reference_d2: Vec::new(),
        leave_one_out_d2: (0..n).map(|left_out| leave_one_out(&rows, left_out, ridge)).collect(),
        constant: constant.iter().map(|j| names[*j].clone()).collect(),
        constant_value,
        constant_resolution,
        chain_correlation: Vec::new(),
    };
    model.reference_d2 = rows.iter().map(|row| varying_distance(&model, row).d2).collect();
    Ok(model)
}

/// What a feature is that does not vary.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Constant {
    /// Its value.
    pub value: f64,
    /// The departure that counts as one deviation.
    pub resolution: f64,
}

/// Of each feature what it is where it is the same in all rows, or nearly so.
pub fn constants(names: &[String], rows: &[Vec<f64>]) -> Vec<Option<Constant>> {
    let (mean, deviation) = moments(rows, names.len());
    let of = |j: usize| {
        let resolution = resolution(j, names, &mean);
        let largest = rows.iter().map(|row| row[j].abs()).fold(0.0, f64::max);
        let varies = deviation[j] > (CONSTANT * largest).max(BELOW_RESOLUTION * resolution.unwrap_or(0.0));
        (!varies).then(|| Constant {
            value: rows[0][j],
            resolution: resolution.unwrap_or_else(|| own_resolution(&names[j], mean[j])),
        })
    };
    (0..names.len()).map(of).collect()
}

/// As [`fit`], of references that may share epochs: their names are read for it.
///
/// # Errors
/// As [`fit`].
pub fn fit_labelled(
    names: &[String],
    labels: &[String],
    rows: &[Vec<f64>],
    ridge: f64,
) -> Result<GroupModel, StageError> {
    let mut model = fit(names, rows, ridge)?;
    let columns: Vec<usize> = (0..names.len()).filter(|j| model.features.contains(&names[*j])).collect();
    let varying: Vec<Vec<f64>> = rows.iter().map(|row| columns.iter().map(|j| row[*j]).collect()).collect();
    model.chain_correlation = chain::correlations(labels, &varying);
    Ok(model)
}

/// The resolution of feature `j` where it is measured by another one that is not 0, as by [`MEASURED_BY`].
fn resolution(j: usize, names: &[String], mean: &[f64]) -> Option<f64> {
    let (_, others) = MEASURED_BY.iter().find(|(name, _)| *name == names[j])?;
    let size = |other: &&str| names.iter().position(|name| name == other).map(|k| mean[k].abs());
    others.iter().filter_map(size).find(|size| *size > 0.0).map(|size| RESOLUTION * size)
}

/// The resolution of a feature that is measured by its own size. A number whose mean is 0, such as a skewness, has a resolution of 0.01.
fn own_resolution(name: &str, mean: f64) -> f64 {
    if mean.abs() > 0.0 {
        RESOLUTION * mean.abs()
    } else if name.starts_with("range") {
        RANGE_M
    } else {
        RESOLUTION
    }
}

/// The distance of a raster whose `values` are in the order of [`GroupModel::judged`].
pub fn distance(model: &GroupModel, values: &[f64]) -> Distance {
    let (varying, constant) = values.split_at(model.features.len());
    let mut found = varying_distance(model, varying);
    let n = model.reference_d2.len() as f64;
    for ((value, usual), resolution) in constant.iter().zip(&model.constant_value).zip(&model.constant_resolution) {
        let departure = value - usual;
        // Divided by the departure, whose square may underflow.
        let share = if departure.abs() > 0.0 { resolution / departure } else { f64::INFINITY };
        let adds = (n / (n + 1.0)) * (n / (n + 1.0)) / (share * share + 1.0 / (n + 1.0));
        found.contributions.push(adds);
        found.d2 += adds;
    }
    found
}

/// The distance by the features that vary over the reference alone.
pub fn varying_distance(model: &GroupModel, values: &[f64]) -> Distance {
    let z: Vec<f64> = (0..values.len()).map(|j| (values[j] - model.mean[j]) / model.deviation[j]).collect();
    let along = |row: &[f64]| row.iter().zip(&z).map(|(p, z)| p * z).sum::<f64>();
    let contributions: Vec<f64> = model.inverse.iter().zip(&z).map(|(row, z)| z * along(row)).collect();
    Distance { d2: contributions.iter().sum::<f64>().max(0.0), contributions }
}

/// The quantile of the leave-one-out distances; `None` where it lies among distances without bound.
pub fn leave_one_out_quantile(model: &GroupModel, level: f64) -> Option<f64> {
    quantile(&model.leave_one_out_d2, level).filter(|d2| *d2 < 1e-9 * UNBOUNDED_D2)
}

/// The distance of one reference raster to a model made of all others.
fn leave_one_out(rows: &[Vec<f64>], left_out: usize, ridge: f64) -> f64 {
    let others: Vec<Vec<f64>> =
        rows.iter().enumerate().filter(|(i, _)| *i != left_out).map(|(_, row)| row.clone()).collect();
    let (mean, deviation) = moments(&others, rows[left_out].len());
    if deviation.iter().any(|s| *s <= 0.0) {
        return UNBOUNDED_D2;
    }
    let Some(inverse) = inverse(&covariance(&others, &mean, &deviation), ridge) else { return UNBOUNDED_D2 };
    let z = DVector::from_iterator(mean.len(), (0..mean.len()).map(|j| (rows[left_out][j] - mean[j]) / deviation[j]));
    z.dot(&(&inverse * &z)).clamp(0.0, UNBOUNDED_D2)
}

/// Mean and standard deviation (N - 1) of each column.
fn moments(rows: &[Vec<f64>], columns: usize) -> (Vec<f64>, Vec<f64>) {
    let n = rows.len() as f64;
    let mean: Vec<f64> = (0..columns).map(|j| rows.iter().map(|row| row[j]).sum::<f64>() / n).collect();
    let squares = |j: usize| rows.iter().map(|row| (row[j] - mean[j]) * (row[j] - mean[j])).sum::<f64>();
    let deviation = (0..columns).map(|j| (squares(j) / (n - 1.0)).sqrt()).collect();
    (mean, deviation)
}

/// Summed here and not by a matrix product, whose kernels depend on the processor.
fn covariance(rows: &[Vec<f64>], mean: &[f64], deviation: &[f64]) -> DMatrix<f64> {
    let z = |row: &[f64], j: usize| (row[j] - mean[j]) / deviation[j];
    let sum = |i: usize, j: usize| rows.iter().map(|row| z(row, i) * z(row, j)).sum::<f64>();
    DMatrix::from_fn(mean.len(), mean.len(), |i, j| sum(i.min(j), i.max(j)) / (rows.len() as f64 - 1.0))
}

fn inverse(covariance: &DMatrix<f64>, ridge: f64) -> Option<DMatrix<f64>> {
    let p = covariance.nrows();
    let inverse = Cholesky::new(covariance + DMatrix::identity(p, p) * ridge)?.inverse();
    inverse.iter().all(|x| x.is_finite()).then_some(inverse)
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "what is exact must be exact")]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    const SCALES: [f64; 5] = [1.0, 10.0, 100.0, 1e3, 1e4];

    fn names(p: usize) -> Vec<String> {
        (0..p).map(|j| format!("f{j}")).collect()
    }

    fn sample(n: usize, p: usize, seed: u8) -> Vec<Vec<f64>> {
        let field = Key([seed; 32]).field();
        let value = |i: usize, j: usize| field.normal(i as i32, j as i32) + 0.5 * field.normal(i as i32, -1);
        (0..n).map(|i| (0..p).map(|j| SCALES[j] * value(i, j)).collect()).collect()
    }

    #[test]
    fn distances_add_up_to_n_minus_one_p_and_stay_below_their_bound() {
        let (n, p) = (20, 4);
        let model = fit(&names(p), &sample(n, p, 1), 0.0).unwrap();
        assert!((model.reference_d2.iter().sum::<f64>() - ((n - 1) * p) as f64).abs() < 1e-9);
        assert!(model.reference_d2.iter().all(|d2| *d2 <= bound(n) + 1e-9));
        assert!((model.eigenvalues.iter().sum::<f64>() - p as f64).abs() < 1e-12);
    }

    #[test]
    fn leave_one_out_follows_its_closed_form_without_ridge() {
        let n = 15.0;
        let model = fit(&names(3), &sample(15, 3, 2), 0.0).unwrap();
        for (d2, loo) in model.reference_d2.iter().zip(&model.leave_one_out_d2) {
            let closed = n * n * (n - 2.0) * d2 / ((n - 1.0) * ((n - 1.0) * (n - 1.0) - n * d2));
            assert!((loo - closed).abs() < 1e-9 * closed, "{loo} {closed}");
        }
    }

    #[test]
    fn contributions_add_up_and_scaling_a_feature_changes_nothing() {
        let rows = sample(25, 5, 3);
        let model = fit(&names(5), &rows, 1e-3).unwrap();
        let found = distance(&model, &[1.0, -20.0, 300.0, 0.0, 5e4]);
        assert!((found.contributions.iter().sum::<f64>() - found.d2).abs() < 1e-9);
        let scaled: Vec<Vec<f64>> = rows.iter().map(|row| row.iter().map(|v| 7.0 * v - 3.0).collect()).collect();
        let other = fit(&names(5), &scaled, 1e-3).unwrap();
        for (a, b) in model.reference_d2.iter().zip(&other.reference_d2) {
            assert!((a - b).abs() < 1e-9);
        }
    }

    #[test]
    fn constant_features_are_set_aside_and_collinear_ones_refused() {
        let mut rows = sample(12, 3, 4);
        for row in &mut rows {
            row[1] = 0.1;
        }
        let model = fit(&names(3), &rows, 0.0).unwrap();
        assert_eq!((model.features, model.constant), (vec!["f0".into(), "f2".into()], vec!["f1".to_owned()]));
        assert_eq!((model.constant_value, model.constant_resolution), (vec![0.1], vec![1e-3]));
        for row in &mut rows {
            row[1] = 2.0 * row[0];
        }
        assert!(fit(&names(3), &rows, 0.0).unwrap_err().message.contains("collinear"));
        assert!(fit(&names(3), &rows, 1e-3).is_ok());
        assert!(fit(&names(3), &rows[..4], 1e-3).unwrap_err().message.contains("at least 5"));
        for row in &mut rows {
            row.fill(1.0);
        }
        assert!(fit(&names(3), &rows, 0.0).unwrap_err().message.contains("none of f0, f1, f2"));
    }

    #[test]
    fn rounding_is_no_spread() {
        let names = ["mean_m", "std_m", "range95_m"].map(str::to_owned);
        let field = Key([7; 32]).field();
        let row = |i: i32, mean_m: f64| {
            vec![mean_m * field.normal(i, 0), 0.01 + 1e-3 * field.normal(i, 1), 2.0 + field.normal(i, 2)]
        };
        let fitted = |mean_m: f64| fit(&names, &(0..39).map(|i| row(i, mean_m)).collect::<Vec<_>>(), 1e-3).unwrap();
        // Rasters whose mean was taken off: a mean of a hundredth of their deviation counts as one deviation.
        let rounded = fitted(1e-6);
        assert_eq!(rounded.constant, ["mean_m"]);
        assert!((distance(&rounded, &[rounded.mean[0], rounded.mean[1], 1e-4]).d2 - 0.93).abs() < 0.05);
        assert!(distance(&rounded, &[rounded.mean[0], rounded.mean[1], 1e-6]).d2 < 1e-3);
        assert_eq!(fitted(1e-4).features, names);
    }

    #[test]
    fn how_strong_noise_is_does_not_count_as_rounding_beside_a_range() {
        // Four descriptors of ten rasters; the range is a length along the face, three hundred times the deviation.
        let names = ["std_m", "skewness", "range95_m", "roughness_b"].map(str::to_owned);
        let field = Key([8; 32]).field();
        let row = |i: i32| {
            let [a, b] = field.normals(i, 0);
            let [c, d] = field.normals(i, 1);
            vec![0.004 * (1.0 + 0.08 * a), 0.1 * b, 1.1 + 0.1 * c, 0.5 + 0.02 * d]
        };
        let model = fit(&names, &(0..10).map(row).collect::<Vec<_>>(), 1e-3).unwrap();
        assert_eq!(model.features, names);
        let strong = [2.0 * model.mean[0], model.mean[1], model.mean[2], model.mean[3]];
        assert!(distance(&model, &strong).d2 > bound(10));
    }

    #[test]
    fn rounding_of_what_scatters_is_measured_by_its_own_size() {
        let names = ["mean_m", "std_m", "nmad_m", "gamma1_m2", "sill_m2", "range95_m"].map(str::to_owned);
        let field = Key([9; 32]).field();
        let row = |relative: f64, range_m: f64| {
            (0..20)
                .map(|i| {
                    let size = |j: i32| 1.0 + relative * field.normal(i, j);
                    vec![field.normal(i, 9), size(0), 0.9 * size(1), 0.2 * size(2), size(3), range_m]
                })
                .collect::<Vec<_>>()
        };
        // Rasters divided by their deviation, and noise without correlation.
        let constants = |relative: f64, range_m: f64| {
            let found = constants(&names, &row(relative, range_m));
            found.iter().map(|found| found.map(|constant| constant.resolution)).collect::<Vec<_>>()
        };
        let all = constants(1e-8, 0.0);
        for (found, expected) in all[1..].iter().zip([0.01, 0.009, 0.002, 0.01, 1e-3]) {
            assert!((found.unwrap() - expected).abs() < 1e-6, "{all:?}");
        }
        assert_eq!(constants(1e-4, 0.5), [None, None, None, None, None, Some(0.005)]);
    }

    #[test]
    fn a_departure_from_a_constant_feature_is_punished_at_every_quantile() {
        let names = ["nugget_m2", "sill_m2", "skewness"].map(str::to_owned);
        let field = Key([6; 32]).field();
        let row = |i: i32| vec![0.0, 4e-5 * (1.0 + 0.1 * field.normal(i, 0)), field.normal(i, 1)];
        let rows: Vec<Vec<f64>> = (0..39).map(row).collect();
        let model = fit(&names, &rows, 1e-3).unwrap();
        assert_eq!(model.judged(), ["sill_m2", "skewness", "nugget_m2"]);
        let d2 = |nugget: f64| distance(&model, &[model.mean[0], model.mean[1], nugget]);
        assert!(d2(0.0).d2 < 1e-12 && d2(-0.0).d2 < 1e-12);
        // One resolution, a hundredth of the sill, counts as one deviation; a tenth of it is beyond every reference.
        assert!((d2(4e-7).d2 - 0.93).abs() < 0.05, "{:?}", d2(4e-7));
        assert!(d2(4e-6).d2 > 25.0 && d2(1e9).d2 < 39.0 * 39.0 / 40.0 + 1e-9 && d2(1e9).d2 > bound(39));
        assert!((d2(1e-3).contributions.iter().sum::<f64>() - d2(1e-3).d2).abs() < 1e-9);
        // Without a feature of its unit, its own size is what it is measured by.
        let alone = fit(
            &["skewness".to_owned(), "entropy".to_owned()],
            &rows.iter().map(|r| vec![r[2], 3.0]).collect::<Vec<_>>(),
            0.0,
        );
        assert!((alone.unwrap().constant_resolution[0] - 0.03).abs() < 1e-12);
    }

    #[test]
    fn a_feature_that_varies_in_one_raster_only_has_no_leave_one_out_distance() {
        let mut rows = sample(12, 2, 5);
        rows.iter_mut().enumerate().for_each(|(i, row)| row[1] = if i == 7 { 1.0 } else { 0.0 });
        let model = fit(&names(2), &rows, 1e-3).unwrap();
        assert_eq!(model.leave_one_out_d2[7], UNBOUNDED_D2);
        assert!(model.leave_one_out_d2[0] < 100.0);
        assert_eq!(leave_one_out_quantile(&model, 0.99), None);
        assert!(leave_one_out_quantile(&model, 0.5).unwrap() < 100.0);
    }

    #[test]
    fn no_rows_are_told_before_anything_is_learnt() {
        assert!(fit(&["std_m".to_owned()], &[], 1e-3).err().unwrap().message.contains("have no rows"));
    }
}
