//! The joint covariance of orientation parameters, as a bundle block adjustment yields it.

use nalgebra::DMatrix;

use super::Frame;

/// Joint covariance of orientation parameters.
///
/// Names are `<image>.rx|ry|rz` (rad, left perturbation in the camera frame: `R' = Exp([rx, ry, rz]) R`),
/// `<image>.X|Y|Z` (m, `C' = C + [X, Y, Z]` in `frame`), `<sensor>.f|cx|cy|b1|b2` (px) and `<sensor>.k1..k4|p1|p2` (1).
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Covariance {
    /// The frame of the projection centres.
    pub frame: Frame,
    /// Parameter names, in the order of the matrix.
    pub parameters: Vec<String>,
    /// Rows of the symmetric matrix.
    pub matrix: Vec<Vec<f64>>,
    /// Whether the matrix was multiplied by the variance of unit weight.
    pub sigma0_applied: bool,
    /// Whether covariances between images and between interior and exterior orientation are in it.
    pub full_joint: bool,
}

impl Covariance {
    /// The matrix, n x n.
    pub fn dense(&self) -> DMatrix<f64> {
        let n = self.parameters.len();
        DMatrix::from_fn(n, n, |i, j| self.matrix[i][j])
    }
}

super::json_noun!(Covariance);
