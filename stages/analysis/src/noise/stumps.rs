//! Boosted decision stumps: a sum of steps, each of one feature (gradient boosting with Newton steps: Friedman 2001, Annals of
//! Statistics 29; the gain as in Chen and Guestrin 2016).

use rockface_core::numerics::logistic::probability;

use super::classifier::importance;

/// Steps that are added up.
const ROUNDS: usize = 60;
/// Share of each step that is taken.
const RATE: f64 = 0.2;
/// Ridge on the height of a step.
const RIDGE: f64 = 1.0;

/// One step: what is added below or at a threshold of a feature, and above it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Stump {
    feature: usize,
    threshold: f64,
    heights: [f64; 2],
}

/// A sum of steps; a positive score speaks for the second class.
#[derive(Debug, Clone, PartialEq)]
pub struct Stumps(Vec<Stump>);

impl Stumps {
    /// Fits rows of two classes, which count the same.
    pub fn fit(classes: [&[&[f64]]; 2]) -> Self {
        let rows: Vec<&[f64]> = classes.iter().flat_map(|class| class.iter().copied()).collect();
        let importance = importance(classes.map(<[_]>::len));
        let second = |i: usize| f64::from(u8::from(i >= classes[0].len()));
        let orders: Vec<Vec<usize>> = (0..rows.first().map_or(0, |row| row.len())).map(|j| order(&rows, j)).collect();
        let mut scores = vec![0.0; rows.len()];
        let mut stumps = Vec::new();
        for _ in 0..ROUNDS {
            let slope = |i: usize| {
                let p = probability(scores[i]);
                [importance[i] * (second(i) - p), importance[i] * p * (1.0 - p)]
            };
            let slopes: Vec<[f64; 2]> = (0..rows.len()).map(slope).collect();
            let Some(stump) = best(&rows, &orders, &slopes) else { break };
            scores.iter_mut().zip(&rows).for_each(|(score, row)| *score += stump.height(row));
            stumps.push(stump);
        }
        Self(stumps)
    }

    /// The score of a raster.
    pub fn score(&self, values: &[f64]) -> f64 {
        self.0.iter().map(|stump| stump.height(values)).sum()
    }
}

impl Stump {
    fn height(&self, values: &[f64]) -> f64 {
        self.heights[usize::from(values[self.feature] > self.threshold)]
    }
}

/// Rows by ascending value of a feature.
fn order(rows: &[&[f64]], feature: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..rows.len()).collect();
    order.sort_by(|a, b| rows[*a][feature].total_cmp(&rows[*b][feature]));
    order
}

/// The step that lowers the loss most; the first of equal ones, none where nothing varies.
fn best(rows: &[&[f64]], orders: &[Vec<usize>], slopes: &[[f64; 2]]) -> Option<Stump> {
    let total = slopes.iter().fold([0.0; 2], |sum, slope| [sum[0] + slope[0], sum[1] + slope[1]]);
    let gain = |sum: [f64; 2]| sum[0] * sum[0] / (sum[1] + RIDGE);
    let mut found: Option<(f64, Stump)> = None;
    for (feature, order) in orders.iter().enumerate() {
        let mut below = [0.0; 2];
        for pair in order.windows(2) {
            below = [below[0] + slopes[pair[0]][0], below[1] + slopes[pair[0]][1]];
            let (lower, upper) = (rows[pair[0]][feature], rows[pair[1]][feature]);
            if upper <= lower {
                continue;
            }
            let above = [total[0] - below[0], total[1] - below[1]];
            let gained = gain(below) + gain(above);
            if found.as_ref().is_none_or(|(most, _)| gained > *most) {
                let heights = [below, above].map(|sum| RATE * sum[0] / (sum[1] + RIDGE));
                found = Some((gained, Stump { feature, threshold: lower + 0.5 * (upper - lower), heights }));
            }
        }
    }
    found.map(|(_, stump)| stump)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_steps_make_a_band_that_no_line_can() {
        let row = |x: f64| vec![0.0, x];
        let outside: Vec<Vec<f64>> = [-3.0, -2.5, -2.0, 2.0, 2.5, 3.0].map(row).to_vec();
        let inside: Vec<Vec<f64>> = [-1.0, -0.5, -0.2, 0.3, 0.6, 1.0].map(row).to_vec();
        let slices = [&outside, &inside].map(|class| class.iter().map(Vec::as_slice).collect::<Vec<_>>());
        let stumps = Stumps::fit([&slices[0], &slices[1]]);
        assert!(outside.iter().all(|row| stumps.score(row) < 0.0) && inside.iter().all(|row| stumps.score(row) > 0.0));
        assert!(stumps.0.iter().all(|stump| stump.feature == 1));
    }

    #[test]
    fn nothing_varies_and_nothing_is_learnt() {
        let row = [1.0, 2.0];
        assert_eq!(Stumps::fit([&[&row, &row], &[&row]]), Stumps(Vec::new()));
    }
}
