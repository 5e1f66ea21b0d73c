//! The reference model of noise descriptors that simulated rasters are tested against (paper 2.2.5).

use std::collections::BTreeMap;

/// Mean, spread, inverse and distances of one set of features over the reference rasters.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GroupModel {
    /// Feature names, p of them.
    pub features: Vec<String>,
    /// Mean of each feature over the reference.
    pub mean: Vec<f64>,
    /// Standard deviation (N - 1) of each feature over the reference.
    pub deviation: Vec<f64>,
    /// Inverse of the regularised covariance of the standardised features, p x p.
    pub inverse: Vec<Vec<f64>>,
    /// Eigenvalues of the unregularised covariance, descending.
    pub eigenvalues: Vec<f64>,
    /// In-sample squared Mahalanobis distance of each reference raster.
    pub reference_d2: Vec<f64>,
    /// Leave-one-out squared distance of each reference raster.
    pub leave_one_out_d2: Vec<f64>,
    /// Features that do not vary over the reference; a raster that departs from their value is punished.
    pub constant: Vec<String>,
    /// The value of each of these.
    pub constant_value: Vec<f64>,
    /// The departure from it that counts as one standard deviation.
    pub constant_resolution: Vec<f64>,
    /// Correlation of each of `features` between references that share an epoch by their names; empty where none do.
    pub chain_correlation: Vec<f64>,
}

impl GroupModel {
    /// The features that a raster is judged by: those that vary over the reference, then those that do not.
    pub fn judged(&self) -> Vec<String> {
        self.features.iter().chain(&self.constant).cloned().collect()
    }
}

/// The acceptance model: all features together, and each descriptor group by itself.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Acceptance {
    /// Number of reference rasters n.
    pub references: usize,
    /// Ridge factor lambda.
    pub ridge: f64,
    /// Names of the reference rasters.
    pub labels: Vec<String>,
    /// Features by group name; `all` is the joint model.
    pub groups: BTreeMap<String, GroupModel>,
}

super::json_noun!(Acceptance);
