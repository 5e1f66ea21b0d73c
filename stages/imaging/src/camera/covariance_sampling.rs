//! Checks of a joint covariance, and correlated draws from it by its symmetric root.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use crate::camera::orientation::check_size;
use rockface_core::artefact::Covariance;
use rockface_core::{StageError, fail};

/// Largest relative difference of two mirrored elements.
const SYMMETRY: f64 = 1e-9;
/// A correlation matrix may have eigenvalues down to minus this share of its largest.
const NEGATIVE: f64 = 1e-10;

/// A covariance prepared for drawing: standard deviations, and eigenvectors and roots of eigenvalues of the correlation matrix.
#[derive(Debug, Clone)]
pub struct JointRoot {
    deviations: Vec<f64>,
    vectors: DMatrix<f64>,
    roots: DVector<f64>,
}

impl JointRoot {
    /// Checks a covariance and takes its root.
    ///
    /// # Errors
    ///
    /// When it is not square, finite, symmetric (to 1e-9 of the standard deviations) and positive semi-definite
    /// (smallest eigenvalue of the correlation matrix at least -1e-10 of the largest).
    pub fn new(covariance: &Covariance) -> Result<Self, StageError> {
        check_size(covariance)?;
        let deviations = deviations(covariance)?;
        check_symmetry(covariance, &deviations)?;
        let eigen = SymmetricEigen::new(correlation(covariance, &deviations));
        let largest = eigen.eigenvalues.iter().copied().fold(0.0, f64::max);
        let smallest = eigen.eigenvalues.iter().copied().fold(f64::INFINITY, f64::min);
        if smallest < -NEGATIVE * largest {
            let message =
                format!("covariance: not positive semi-definite, its correlation has the eigenvalue {smallest}");
            return Err(
                StageError::new(message).hint("export all digits of the whole matrix, in one order of parameters")
            );
        }
        let roots = eigen.eigenvalues.map(|value| value.max(0.0).sqrt());
        Ok(Self { deviations, vectors: eigen.eigenvectors, roots })
    }

    /// `D V sqrt(L) V^T z`: corrections with the given covariance from independent standard normal draws.
    ///
    /// The symmetric root does not depend on sign or order of the eigenvectors. Sums run in a fixed order.
    pub fn correlate(&self, z: &[f64]) -> Vec<f64> {
        let n = self.deviations.len();
        let along = |k: usize| (0..n).map(|i| self.vectors[(i, k)] * z[i]).sum::<f64>();
        let stretched: Vec<f64> = (0..n).map(|k| self.roots[k] * along(k)).collect();
        let back = |i: usize| (0..n).map(|k| self.vectors[(i, k)] * stretched[k]).sum::<f64>();
        (0..n).map(|i| self.deviations[i] * back(i)).collect()
    }
}

fn deviations(covariance: &Covariance) -> Result<Vec<f64>, StageError> {
    let n = covariance.parameters.len();
    let (matrix, names) = (&covariance.matrix, &covariance.parameters);
    for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
        if !matrix[i][j].is_finite() {
            fail!("covariance of `{}` and `{}`: {} is not a finite number", names[i], names[j], matrix[i][j]);
        }
    }
    if let Some(i) = (0..n).find(|i| matrix[*i][*i] < 0.0) {
        fail!("covariance: the variance of `{}` is negative ({})", names[i], matrix[i][i]);
    }
    Ok((0..n).map(|i| matrix[i][i].sqrt()).collect())
}

fn check_symmetry(covariance: &Covariance, deviations: &[f64]) -> Result<(), StageError> {
    let (matrix, names) = (&covariance.matrix, &covariance.parameters);
    for (i, j) in (0..names.len()).flat_map(|i| (0..i).map(move |j| (i, j))) {
        let (a, b) = (matrix[i][j], matrix[j][i]);
        let unit = deviations[i] * deviations[j];
        if unit == 0.0 && (a != 0.0 || b != 0.0) {
            fail!("covariance: `{}` or `{}` has no variance, yet they have the covariance {a}", names[i], names[j]);
        }
        if (a - b).abs() > SYMMETRY * unit {
            fail!("covariance: not symmetric at `{}`, `{}`: {a} and {b}", names[i], names[j]);
        }
    }
    Ok(())
}

fn correlation(covariance: &Covariance, deviations: &[f64]) -> DMatrix<f64> {
    let m = &covariance.matrix;
    DMatrix::from_fn(deviations.len(), deviations.len(), |i, j| {
        let unit = deviations[i] * deviations[j];
        if unit > 0.0 { 0.5 * (m[i][j] + m[j][i]) / unit } else { 0.0 }
    })
}

/// A warning about a covariance without the correlations that keep images consistent; `None` where it has them.
///
/// Drawing blocks alone on a stereo pair gives some 200 times the y-parallax of the joint matrix.
pub fn block_only(covariance: &Covariance) -> Option<String> {
    let why = if covariance.parameters.is_empty() {
        return None;
    } else if !covariance.full_joint {
        "the covariance is not a full joint one"
    } else if lacks_cross_blocks(covariance) {
        "all covariances between different images are zero"
    } else {
        return None;
    };
    Some(format!(
        "{why}: draws from blocks alone tear the images apart (tens of pixels of y-parallax where the joint matrix gives \
         hundredths); obtain the joint covariance of all exterior and interior parameters"
    ))
}

/// Whether several images have parameters and none is correlated with one of another image.
pub fn lacks_cross_blocks(covariance: &Covariance) -> bool {
    let owner = |name: &str| match name.rsplit_once('.') {
        Some((image, "rx" | "ry" | "rz" | "X" | "Y" | "Z")) => Some(image.to_owned()),
        _ => None,
    };
    let owners: Vec<Option<String>> = covariance.parameters.iter().map(|name| owner(name)).collect();
    let n = owners.len();
    let between = |i: usize, j: usize| owners[i].is_some() && owners[j].is_some() && owners[i] != owners[j];
    let mut crossing = (0..n).flat_map(|i| (0..i).map(move |j| (i, j))).filter(|(i, j)| between(*i, *j)).peekable();
    crossing.peek().is_some() && crossing.all(|(i, j)| covariance.matrix[i][j] == 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Frame;
    use rockface_core::numerics::random::Key;

    fn covariance(matrix: [[f64; 3]; 3]) -> Covariance {
        Covariance {
            frame: Frame::Wall,
            parameters: ["a.rx", "b.X", "s.f"].map(str::to_owned).to_vec(),
            matrix: matrix.iter().map(|row| row.to_vec()).collect(),
            sigma0_applied: true,
            full_joint: true,
        }
    }

    const CORRELATED: [[f64; 3]; 3] = [[4e-6, 1.8e-5, -2e-3], [1.8e-5, 1e-4, -5e-3], [-2e-3, -5e-3, 4.0]];

    #[test]
    fn draws_have_the_given_covariance() {
        let root = JointRoot::new(&covariance(CORRELATED)).unwrap();
        let (n, field) = (4000, Key([3; 32]).field());
        let draws: Vec<Vec<f64>> = (0..n).map(|i| root.correlate(&[0, 1, 2].map(|j| field.normal(2 * j, i)))).collect();
        for i in 0..3 {
            for j in 0..3 {
                let sampled = draws.iter().map(|d| d[i] * d[j]).sum::<f64>() / f64::from(n);
                let (vi, vj, cij) = (CORRELATED[i][i], CORRELATED[j][j], CORRELATED[i][j]);
                // Standard error of a sampled covariance of normal variables.
                let error = ((vi * vj + cij * cij) / f64::from(n)).sqrt();
                assert!((sampled - cij).abs() < 3.5 * error, "{i} {j}: {sampled} for {cij}");
            }
        }
    }

    #[test]
    fn the_root_squared_is_the_covariance() {
        let root = JointRoot::new(&covariance(CORRELATED)).unwrap();
        let sd: Vec<f64> = (0..3).map(|i| CORRELATED[i][i].sqrt()).collect();
        let columns: Vec<Vec<f64>> =
            (0..3).map(|j| root.correlate(&[0, 1, 2].map(|i| f64::from(u8::from(i == j))))).collect();
        for i in 0..3 {
            for j in 0..3 {
                let product: f64 = columns.iter().map(|c| c[i] * c[j]).sum();
                assert!((product - CORRELATED[i][j]).abs() < 1e-13 * sd[i] * sd[j]);
            }
        }
    }

    #[test]
    fn what_is_no_covariance_is_refused() {
        let says = |edit: fn(&mut Covariance), text: &str| {
            let mut bad = covariance(CORRELATED);
            edit(&mut bad);
            let message = JointRoot::new(&bad).unwrap_err().message;
            assert!(message.contains(text), "{message}");
        };
        says(|c| c.matrix[0][1] *= 1.0 + 1e-6, "not symmetric at `b.X`, `a.rx`");
        says(|c| c.matrix[1][1] = -1.0, "`b.X` is negative");
        says(|c| c.matrix[1][1] = 0.0, "no variance");
        says(|c| c.matrix[2][1] = f64::NAN, "NaN");
        says(|c| (c.matrix[0][1], c.matrix[1][0]) = (3e-5, 3e-5), "positive semi-definite");
        says(|c| c.matrix[2].truncate(2), "the row of `s.f` has 2 values");
    }

    #[test]
    fn blocks_alone_are_told() {
        let mut blocks = covariance(CORRELATED);
        assert_eq!(block_only(&blocks), None);
        (blocks.matrix[0][1], blocks.matrix[1][0]) = (0.0, 0.0);
        assert!(block_only(&blocks).unwrap().contains("between different images are zero"));
        blocks.full_joint = false;
        assert!(block_only(&blocks).unwrap().contains("not a full joint"));
    }
}
