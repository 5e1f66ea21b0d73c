//! Noise with a Matern correlation of a few pixels, addressed by position: the same values for any tile or order of work.
//!
//! A Matern covariance is a mixture of Gaussian ones: with smoothness nu and length L,
//! `c(r) = E exp(-r^2 / (2 s^2))` where `y = s^2 / (2 L^2)` follows a Gamma distribution of shape nu; nu = 1/2 is the
//! exponential `exp(-r / L)`. The mixture is taken at scales s an octave apart, `s = 2 L, L, L / 2, ...`, with weights
//! `y^nu exp(-y)`. Each scale is a grid of independent normal nodes under cubic B-splines, whose correlation is a Gaussian
//! of deviation `sqrt(2/3)` node distances to within 0.02, divided by its own deviation at each place. What is
//! left for scales below a node distance of one pixel is white, addressed by the nearest pixel.

use rayon::prelude::*;

use crate::matching::noise::paper::Interpolation;
use rockface_core::numerics::portable_math;
use rockface_core::numerics::random::{Field, Key};

/// Node distance of a B-spline field over the deviation of its (nearly) Gaussian correlation.
pub const SPACING_OF_SCALE: f64 = 1.224_744_871_391_589;

/// Octaves summed for the weights; the share of further ones is negligible.
const OCTAVES: usize = 60;

/// A scale of the mixture, and its share of the variance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale {
    /// Distance of the nodes, pixels, at least 1.
    pub spacing_px: f64,
    /// Share of the variance.
    pub share: f64,
}

/// The scales of a Matern correlation of this length and smoothness, coarsest first, and the white share: all add up to 1.
pub fn scales(length_px: f64, smoothness: f64) -> (Vec<Scale>, f64) {
    let weight = |octave: usize| {
        let s = 2.0 * portable_math::pow(0.5, octave as f64);
        let y = 0.5 * s * s;
        portable_math::pow(y, smoothness) * portable_math::exp(-y)
    };
    let total: f64 = (0..OCTAVES).map(weight).sum();
    let spacing = |octave: usize| SPACING_OF_SCALE * 2.0 * length_px * portable_math::pow(0.5, octave as f64);
    let resolved = (0..OCTAVES).take_while(|octave| spacing(*octave) >= 1.0).count();
    let scale = |octave: usize| Scale { spacing_px: spacing(octave), share: weight(octave) / total };
    let white = (resolved..OCTAVES).map(weight).sum::<f64>() / total;
    ((0..resolved).map(scale).collect(), white)
}

/// A field of unit deviation with a Matern correlation.
#[derive(Debug, Clone)]
pub struct CorrelatedNoise {
    levels: Vec<Level>,
    white_weight: f64,
    white: Field,
}

impl CorrelatedNoise {
    /// The field whose scale k draws from `key(k)`; the nodes for positions within `low..high` pixels are drawn at once.
    pub fn new(length_px: f64, smoothness: f64, key: impl Fn(usize) -> Key, low: [f64; 2], high: [f64; 2]) -> Self {
        let (scales, white) = scales(length_px, smoothness);
        let level = |(k, scale): (usize, Scale)| Level::new(&key(k), scale, low, high);
        let field = key(scales.len()).field();
        let levels = scales.into_iter().enumerate().map(level).collect();
        Self { levels, white_weight: white.sqrt(), white: field }
    }

    /// The field at a position, pixels.
    pub fn at(&self, position_px: [f64; 2]) -> f64 {
        let [column, row] = position_px.map(|p| p.round() as i32);
        let smooth = self.levels.iter().map(|level| level.at(position_px)).sum::<f64>();
        smooth + self.white_weight * self.white.normal(column, row)
    }
}

/// Normal nodes on a grid through the origin, in single precision; those within a rectangle are drawn at once.
#[derive(Debug, Clone)]
struct Level {
    scale: Scale,
    field: Field,
    first: [i32; 2],
    columns: usize,
    nodes: Vec<f32>,
}

impl Level {
    fn new(key: &Key, scale: Scale, low: [f64; 2], high: [f64; 2]) -> Self {
        let cell = |position: f64| (position / scale.spacing_px).floor() as i32;
        let first = low.map(|p| cell(p) - 1);
        let [columns, rows] = [0, 1].map(|i| (cell(high[i]) + 3 - first[i]).max(0) as usize);
        let field = key.field();
        let mut nodes = vec![0.0; columns * rows];
        nodes
            .par_chunks_mut(columns.max(1))
            .enumerate()
            .for_each(|(row, line)| field.fill_row(first[0], first[1] + row as i32, line));
        Self { scale, field, first, columns, nodes }
    }

    fn at(&self, position_px: [f64; 2]) -> f64 {
        let [x, y] = position_px.map(|p| p / self.scale.spacing_px);
        let (column, row) = (x.floor(), y.floor());
        let wx = Interpolation::BSpline.weights(x - column);
        let wy = Interpolation::BSpline.weights(y - row);
        let mut sum = 0.0;
        for (j, weight) in (-1..3).zip(wy) {
            let nodes = self.four_nodes(column as i32 - 1, row as i32 + j);
            sum += weight * wx.iter().zip(nodes).map(|(w, node)| w * f64::from(node)).sum::<f64>();
        }
        let squares = |weights: [f64; 4]| weights.iter().map(|w| w * w).sum::<f64>();
        sum * (self.scale.share / (squares(wx) * squares(wy))).sqrt()
    }

    fn four_nodes(&self, column: i32, row: i32) -> [f32; 4] {
        let [x, y] = [column.wrapping_sub(self.first[0]), row.wrapping_sub(self.first[1])];
        if x >= 0 && y >= 0 && x as usize + 4 <= self.columns {
            let start = y as usize * self.columns + x as usize;
            if let Some(&[a, b, c, d]) = self.nodes.get(start..start + 4) {
                return [a, b, c, d];
            }
        }
        [0, 1, 2, 3].map(|i| self.field.normal(column + i, row) as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(level: usize) -> Key {
        Key([40 + level as u8; 32])
    }

    /// Correlation of a 700 x 700 pixel field at lags along the rows and along the columns.
    fn correlations(length_px: f64, smoothness: f64, lags: &[usize]) -> Vec<f64> {
        let n = 700usize;
        let field = CorrelatedNoise::new(length_px, smoothness, key, [0.0; 2], [n as f64; 2]);
        let value = |i: usize| field.at([(i % n) as f64, (i / n) as f64]);
        let values: Vec<f64> = (0..n * n).into_par_iter().map(value).collect();
        let mean = |lag: usize| {
            let pairs = (0..(n - lag) * (n - lag)).map(|i| {
                let at = i / (n - lag) * n + i % (n - lag);
                values[at] * (values[at + lag] + values[at + lag * n]) * 0.5
            });
            pairs.sum::<f64>() / ((n - lag) * (n - lag)) as f64
        };
        lags.iter().map(|lag| mean(*lag)).collect()
    }

    #[test]
    fn the_shares_add_up_and_no_scale_is_below_a_pixel() {
        for (length_px, smoothness) in [(0.1, 0.5), (1.0, 0.5), (4.0, 0.5), (4.0, 1.5), (30.0, 2.5)] {
            let (scales, white) = scales(length_px, smoothness);
            assert!((scales.iter().map(|s| s.share).sum::<f64>() + white - 1.0).abs() < 1e-12);
            assert!(scales.iter().all(|s| s.spacing_px >= 1.0 && s.share > 0.0), "{scales:?}");
        }
    }

    #[test]
    fn half_smoothness_is_the_exponential_and_three_halves_the_known_matern() {
        let lags = [0usize, 1, 2, 4, 8, 16];
        let exponential = |r: f64| portable_math::exp(-r / 4.0);
        // With nu = 3/2 and c = E exp(-r^2 / (2 s^2)): (1 + r / L) exp(-r / L).
        let matern = |r: f64| (1.0 + r / 4.0) * portable_math::exp(-r / 4.0);
        let cases: [(f64, &dyn Fn(f64) -> f64); 2] = [(0.5, &exponential), (1.5, &matern)];
        for (smoothness, expected) in cases {
            let found = correlations(4.0, smoothness, &lags);
            for (lag, found) in lags.iter().zip(found) {
                let expected = expected(*lag as f64);
                assert!((found - expected).abs() < 0.045, "nu {smoothness}, lag {lag}: {found} instead of {expected}");
            }
        }
    }

    #[test]
    fn nodes_drawn_ahead_change_nothing() {
        let ahead = CorrelatedNoise::new(3.0, 0.5, key, [-50.0, -30.0], [40.0, 60.0]);
        let none = CorrelatedNoise::new(3.0, 0.5, key, [0.0; 2], [0.0; 2]);
        for i in 0..500 {
            let position = [f64::from(i) * 0.37 - 70.0, 65.0 - f64::from(i) * 0.29];
            assert_eq!(ahead.at(position).to_bits(), none.at(position).to_bits());
        }
    }
}
