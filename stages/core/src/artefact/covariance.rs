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

/// A file of another program may have rows that are too short.
fn check(covariance: &Covariance) -> Result<(), super::CodecError> {
    let (n, rows) = (covariance.parameters.len(), covariance.matrix.len());
    if rows != n {
        return Err(super::CodecError(format!("a covariance of {n} parameters with {rows} rows")));
    }
    let odd = covariance.matrix.iter().position(|row| row.len() != n);
    odd.map_or(Ok(()), |row| {
        let length = covariance.matrix[row].len();
        Err(super::CodecError(format!("row {row} (counted from 0) of {n} x {n} covariances has {length} numbers")))
    })
}

super::json_noun!(Covariance checked by check);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artefact::Noun;

    #[test]
    fn a_matrix_that_is_not_square_is_refused() {
        let read = |matrix: &str| {
            let text = r#"{"frame": "wall", "parameters": ["a.X", "a.Y"], "sigma0_applied": true, "full_joint": true, "matrix": "#;
            Covariance::decode(format!("{text}{matrix}}}").as_bytes()).map_err(|e| e.0)
        };
        assert!(read("[[1, 0], [0, 1]]").is_ok());
        assert_eq!(read("[[1, 0]]").unwrap_err(), "a covariance of 2 parameters with 1 rows");
        assert_eq!(read("[[1, 0], [0]]").unwrap_err(), "row 1 (counted from 0) of 2 x 2 covariances has 1 numbers");
    }
}
