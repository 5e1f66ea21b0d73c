//! How the mean figures of rasters (strength by class of place, amplitude by band of frequency) depart from what they should be, and which part of
//! that is not chance.

use crate::noise::learning::whitening::Whitened;

/// The figures of a raster whose mean should be right: logarithms of its strengths by class of place, then of its amplitudes by band, as it
/// is: where noise is strong it may be finer or coarser than elsewhere, and what comes out is judged with strong places in it.
pub fn figures(whitened: &Whitened) -> Vec<f64> {
    whitened.log_strength.iter().chain(&whitened.raster_log_amplitude).copied().collect()
}

/// Mean of one figure over some rasters.
#[derive(Debug, Clone, Copy)]
pub struct Mean {
    /// The mean, in the unit of the figure.
    pub value: f64,
    /// Its squared standard error.
    pub squared_error: f64,
}

impl Mean {
    /// Mean of figure `k` over rows, of which there are at least two.
    pub fn of(rows: &[impl AsRef<[f64]>], k: usize) -> Self {
        let n = rows.len() as f64;
        let column = || rows.iter().map(|row| row.as_ref()[k]);
        let value = column().sum::<f64>() / n;
        let squares = column().map(|figure| (figure - value) * (figure - value)).sum::<f64>();
        Self { value, squared_error: squares / (n - 1.0) / n }
    }

    /// Mean of figure `k` over rows, had what each of them follows from in part the mean `usual`: the least-squares
    /// line over `known` takes off what it explains, of the mean and of its error (control variate: Lavenberg and Welch 1981, Manage. Sci. 27).
    pub fn given(rows: &[impl AsRef<[f64]>], k: usize, known: &[f64], usual: f64) -> Self {
        let n = rows.len() as f64;
        let mean = Self::of(rows, k).value;
        let mean_known = known.iter().sum::<f64>() / n;
        let pairs = || rows.iter().zip(known).map(|(row, known)| (row.as_ref()[k] - mean, known - mean_known));
        let squares = pairs().map(|(_, x)| x * x).sum::<f64>();
        if squares <= 0.0 || n <= 2.0 {
            return Self::of(rows, k);
        }
        let slope = pairs().map(|(y, x)| x * y).sum::<f64>() / squares;
        let rest = pairs().map(|(y, x)| (y - slope * x) * (y - slope * x)).sum::<f64>() / (n - 2.0);
        let off = mean_known - usual;
        Self { value: mean - slope * off, squared_error: rest * (1.0 / n + off * off / squares) }
    }

    /// The same mean as a number that is known.
    #[must_use]
    pub fn exact(self) -> Self {
        Self { squared_error: 0.0, ..self }
    }
}

/// Rasters up to which Student's t has no variance.
const NO_VARIANCE: usize = 3;
/// Most by which the variance of a figure of one more raster exceeds that of the known ones.
const MOST_WIDER: f64 = 2.0;

/// By how much the variance of a figure of one more raster, about the mean of those that are known, exceeds their own variance, since mean and
/// variance of few are uncertain: the predictive distribution is Student's t.
pub fn of_another(rasters: usize) -> f64 {
    if rasters <= NO_VARIANCE {
        return MOST_WIDER;
    }
    let n = rasters as f64;
    ((n + 1.0) / n * (n - 1.0) / (n - 3.0)).min(MOST_WIDER)
}

/// Departure of one mean from another.
#[derive(Debug, Clone, Copy)]
pub struct Departure {
    /// How much the first mean lies above the second.
    pub difference: f64,
    /// The standard error of the difference.
    pub error: f64,
}

impl Departure {
    /// How much `mean` lies above `wanted`.
    pub fn of(mean: Mean, wanted: Mean) -> Self {
        let error = (mean.squared_error + wanted.squared_error).sqrt();
        Self { difference: mean.value - wanted.value, error }
    }

    /// The part of the difference that is not chance: it is shrunk by the square of `errors` standard errors (James and Stein 1961), and
    /// is 0 within them.
    pub fn certain(self, errors: f64) -> f64 {
        let (squared, chance) = (self.difference * self.difference, errors * self.error);
        if squared > 0.0 { self.difference * (1.0 - chance * chance / squared).max(0.0) } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_figure_follows_from_is_no_chance_of_its_mean() {
        let known = [0.0, 1.0, 2.0, 5.0];
        let rows = [0.01, -0.01, -0.01, 0.01].iter().zip(known).map(|(rest, x)| vec![3.0 + 0.5 * x + rest]);
        let rows: Vec<Vec<f64>> = rows.collect();
        let (plain, given) = (Mean::of(&rows, 0), Mean::given(&rows, 0, &known, 1.0));
        assert!((plain.value - 4.0).abs() < 1e-12 && plain.squared_error.sqrt() > 0.5);
        assert!((given.value - 3.5).abs() < 0.01 && given.squared_error.sqrt() < 0.01, "{given:?}");
        let same = Mean::given(&rows, 0, &[2.0; 4], 2.0);
        assert!(same.value.to_bits() == plain.value.to_bits() && same.squared_error > 0.2);
    }

    #[test]
    fn one_more_raster_differs_more_from_few_than_from_many() {
        // Student's t with eleven degrees of freedom about a mean of twelve.
        assert!((of_another(12) - 13.0 / 12.0 * 11.0 / 9.0).abs() < 1e-12);
        assert!((of_another(10_000) - 1.0).abs() < 1e-3);
        assert!([2, 3, 4].iter().all(|rasters| (of_another(*rasters) - MOST_WIDER).abs() < 1e-12));
    }

    #[test]
    fn what_lies_within_its_error_is_chance() {
        let rows = [vec![0.1], vec![0.3], vec![0.2], vec![0.4]];
        let mean = Mean::of(&rows, 0);
        let error = (0.05f64 / 3.0 / 4.0).sqrt();
        assert!((mean.value - 0.25).abs() < 1e-12 && (mean.squared_error.sqrt() - error).abs() < 1e-12);
        let departure = Departure::of(mean, Mean { value: 0.15, squared_error: 0.0 });
        assert!((departure.certain(1.0) - 0.1 * (1.0 - error * error / 0.01)).abs() < 1e-12);
        assert!(departure.certain(2.0) == 0.0 && Departure::of(mean, mean.exact()).certain(1.0) == 0.0);
    }
}
