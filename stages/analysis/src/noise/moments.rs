//! Which parameters would give the features wanted, from simulations at other parameters (simulated method of moments,
//! Econometrica 57, 995, 1989).
//!
//! Around the simulations features are taken as linear in the parameters (on their scale): z = A + B (x - m), by weighted least
//! squares with a small ridge. The point sought makes the squared Mahalanobis distance of z to the reference smallest
//! within a box; it is a convex quadratic, so going from coordinate to coordinate finds it.

use nalgebra::{Cholesky, DMatrix, DVector};

/// Features as a linear function of parameters.
#[derive(Debug, Clone)]
pub struct Surrogate {
    /// Weighted mean of the parameters.
    centre: DVector<f64>,
    /// Features there.
    level: DVector<f64>,
    /// Change of each feature (row) with each parameter (column).
    pub slopes: DMatrix<f64>,
    /// Standard errors of the slopes.
    pub errors: DMatrix<f64>,
}

/// Ridge on the slopes as a share of the spread of the parameters.
const RIDGE: f64 = 1e-6;

impl Surrogate {
    /// Fits rows of parameters and features with their weights; `None` where some direction of the parameters was not varied.
    pub fn fit(parameters: &[Vec<f64>], features: &[Vec<f64>], weights: &[f64]) -> Option<Self> {
        let (q, p) = (parameters.first()?.len(), features.first()?.len());
        let total: f64 = weights.iter().sum();
        let mean =
            |rows: &[Vec<f64>], j: usize| rows.iter().zip(weights).map(|(row, w)| w * row[j]).sum::<f64>() / total;
        let centre = DVector::from_fn(q, |j, _| mean(parameters, j));
        let level = DVector::from_fn(p, |j, _| mean(features, j));
        let moment = |f: &dyn Fn(usize) -> f64| (0..weights.len()).map(|i| weights[i] * f(i)).sum::<f64>();
        let spread =
            DMatrix::from_fn(q, q, |a, b| moment(&|i| (parameters[i][a] - centre[a]) * (parameters[i][b] - centre[b])));
        let cross =
            DMatrix::from_fn(p, q, |j, a| moment(&|i| (features[i][j] - level[j]) * (parameters[i][a] - centre[a])));
        if (0..q).any(|a| spread[(a, a)] <= 0.0) {
            return None;
        }
        let ridge = DMatrix::from_diagonal(&spread.diagonal()) * RIDGE;
        let inverse = Cholesky::new(&spread + ridge)?.inverse();
        let slopes = &cross * &inverse;
        let residual = |i: usize, j: usize| {
            let along: f64 = (0..q).map(|a| slopes[(j, a)] * (parameters[i][a] - centre[a])).sum();
            features[i][j] - level[j] - along
        };
        let freedom = (weights.len() as f64 - q as f64 - 1.0).max(1.0) * total / weights.len() as f64;
        let variance: Vec<f64> = (0..p).map(|j| moment(&|i| residual(i, j) * residual(i, j)) / freedom).collect();
        let errors = DMatrix::from_fn(p, q, |j, a| (variance[j] * inverse[(a, a)]).sqrt());
        Some(Self { centre, level, slopes, errors })
    }

    /// The features at parameters.
    pub fn features(&self, parameters: &[f64]) -> Vec<f64> {
        let at = DVector::from_column_slice(parameters) - &self.centre;
        (&self.level + &self.slopes * at).iter().copied().collect()
    }

    /// The parameters within `low..high` whose features z make z' P z smallest.
    pub fn nearest(&self, inverse: &[Vec<f64>], low: &[f64], high: &[f64]) -> Vec<f64> {
        let p = DMatrix::from_fn(inverse.len(), inverse.len(), |i, j| inverse[i][j]);
        let hessian = self.slopes.transpose() * &p * &self.slopes;
        let mut at: Vec<f64> =
            self.centre.iter().zip(low.iter().zip(high)).map(|(c, (l, h))| c.clamp(*l, *h)).collect();
        for _ in 0..SWEEPS {
            let mut moved = 0.0f64;
            for a in 0..at.len() {
                let z = DVector::from_vec(self.features(&at));
                let gradient = (self.slopes.column(a).transpose() * &p * z)[(0, 0)];
                if hessian[(a, a)] > 0.0 {
                    let next = (at[a] - gradient / hessian[(a, a)]).clamp(low[a], high[a]);
                    moved = moved.max((next - at[a]).abs());
                    at[a] = next;
                }
            }
            if moved < 1e-10 {
                break;
            }
        }
        at
    }
}

/// Rounds over all coordinates at most.
const SWEEPS: usize = 2000;

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    #[test]
    fn a_linear_world_is_solved_in_one_step() {
        let field = Key([3; 32]).field();
        let parameters: Vec<Vec<f64>> = (0..12).map(|i| (0..2).map(|j| field.normal(i, j)).collect()).collect();
        let truth = |x: &[f64]| vec![1.0 + 2.0 * x[0], -3.0 + x[0] - x[1], 0.5 * x[1]];
        let features: Vec<Vec<f64>> = parameters.iter().map(|x| truth(x)).collect();
        let surrogate = Surrogate::fit(&parameters, &features, &[1.0; 12]).unwrap();
        assert!((surrogate.slopes[(0, 0)] - 2.0).abs() < 1e-4 && surrogate.slopes[(0, 1)].abs() < 1e-4);
        let wanted = truth(&[0.3, -0.7]);
        let moved: Vec<Vec<f64>> =
            features.iter().map(|z| z.iter().zip(&wanted).map(|(z, w)| z - w).collect()).collect();
        let surrogate = Surrogate::fit(&parameters, &moved, &[1.0; 12]).unwrap();
        let identity: Vec<Vec<f64>> = (0..3).map(|i| (0..3).map(|j| f64::from(u8::from(i == j))).collect()).collect();
        let found = surrogate.nearest(&identity, &[-5.0; 2], &[5.0; 2]);
        assert!((found[0] - 0.3).abs() < 1e-4 && (found[1] + 0.7).abs() < 1e-4, "{found:?}");
        let boxed = surrogate.nearest(&identity, &[0.5, -5.0], &[5.0; 2]);
        assert!((boxed[0] - 0.5).abs() < 1e-12);
    }

    #[test]
    fn a_parameter_that_was_not_varied_is_no_surrogate() {
        let parameters = vec![vec![1.0, 2.0], vec![2.0, 2.0], vec![3.0, 2.0]];
        assert!(Surrogate::fit(&parameters, &[vec![0.0], vec![1.0], vec![2.0]], &[1.0; 3]).is_none());
    }
}
