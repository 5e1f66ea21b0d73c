//! Skewness of a field of noise, which a mixture of fields with both signs loses.
//!
//! Values above zero are stretched and those below shortened, or the other way round: `y = x + a x^2 / sqrt(x^2 + r^2)` with the root mean square r,
//! which bends the field near zero and gives its tails two slopes, `1 + a` and `1 - a` (a smooth two-piece distribution, Fernandez and Steel 1998).

use rayon::prelude::*;

/// Largest stretching of one side; y grows with x below 0.9.
const MOST_STRETCHING: f64 = 0.6;
/// Halvings of the interval in which the stretching lies.
const HALVINGS: usize = 40;

/// A field with this skewness, or the nearest that stretching reaches, and without its mean.
pub fn with_skewness(mut field: Vec<f64>, columns: usize, wanted: f64) -> Vec<f64> {
    let square = field.iter().map(|x| x * x).sum::<f64>() / field.len() as f64;
    if square.is_nan() || square <= 0.0 {
        return field;
    }
    let bent = |x: f64| x * x / (x * x + square).sqrt();
    let moments = Moments::of(&field, columns, &bent);
    let (mut low, mut high) = (-MOST_STRETCHING, MOST_STRETCHING);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        *(if moments.skewness(middle) < wanted { &mut low } else { &mut high }) = middle;
    }
    let stretching = 0.5 * (low + high);
    let mean = moments.mean(stretching);
    field.par_iter_mut().for_each(|x| *x += stretching * bent(*x) - mean);
    field
}

/// Mean products of values x and of what is added to them for a stretching of 1, h: x, h; xx, xh, hh; xxx, xxh, xhh, hhh.
struct Moments([f64; 9]);

impl Moments {
    fn of(field: &[f64], columns: usize, bent: &(impl Fn(f64) -> f64 + Sync)) -> Self {
        let of_row = |row: &[f64]| {
            let mut sums = [0.0; 9];
            for x in row.iter().copied() {
                let h = bent(x);
                let products = [x, h, x * x, x * h, h * h, x * x * x, x * x * h, x * h * h, h * h * h];
                sums.iter_mut().zip(products).for_each(|(sum, product)| *sum += product);
            }
            sums
        };
        // Rows are added in their order, whatever the number of threads.
        let rows: Vec<[f64; 9]> = field.par_chunks(columns).map(of_row).collect();
        Self(std::array::from_fn(|k| rows.iter().map(|row| row[k]).sum::<f64>() / field.len() as f64))
    }

    fn mean(&self, a: f64) -> f64 {
        self.0[0] + a * self.0[1]
    }

    fn skewness(&self, a: f64) -> f64 {
        let [_, _, xx, xh, hh, xxx, xxh, xhh, hhh] = self.0;
        let (mean, square) = (self.mean(a), xx + a * (2.0 * xh + a * hh));
        let cube = xxx + a * (3.0 * xxh + a * (3.0 * xhh + a * hhh));
        let variance = square - mean * mean;
        (cube - 3.0 * mean * square + 2.0 * mean * mean * mean) / (variance * variance.sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    fn skewness(field: &[f64]) -> f64 {
        let mean_of = |of: &dyn Fn(f64) -> f64| field.iter().map(|x| of(*x)).sum::<f64>() / field.len() as f64;
        let mean = mean_of(&|x| x);
        let variance = mean_of(&|x| (x - mean) * (x - mean));
        mean_of(&|x| (x - mean) * (x - mean) * (x - mean)) / (variance * variance.sqrt())
    }

    #[test]
    fn a_field_gets_the_skewness_asked_for_and_keeps_its_order() {
        let random = Key([5; 32]).field();
        let field: Vec<f64> = (0..60 * 50).map(|i| 0.3 * random.normal(i % 60, i / 60)).collect();
        for wanted in [-0.8, -0.1, 0.0, 0.5] {
            let skewed = with_skewness(field.clone(), 60, wanted);
            assert!((skewness(&skewed) - wanted).abs() < 1e-9, "{wanted}: {}", skewness(&skewed));
            assert!(skewed.iter().sum::<f64>().abs() < 1e-9);
            let mut order: Vec<usize> = (0..field.len()).collect();
            order.sort_by(|a, b| field[*a].total_cmp(&field[*b]));
            assert!(order.windows(2).all(|pair| skewed[pair[0]] <= skewed[pair[1]]));
        }
        // What cannot be reached is approached, and a field without values other than 0 stays.
        let far = skewness(&with_skewness(field, 60, 9.0));
        assert!((1.0..3.0).contains(&far), "{far}");
        assert_eq!(with_skewness(vec![0.0; 4], 2, 0.5), vec![0.0; 4]);
    }
}
