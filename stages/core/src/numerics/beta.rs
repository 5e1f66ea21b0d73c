//! The beta distribution: the regularised incomplete beta function and its inverse.

use super::portable_math;

/// Terms of the continued fraction; it converges in about the square root of the larger parameter.
const MOST_TERMS: u32 = 2000;

/// Share of a beta distribution on 0 to 1 below `x`, `I_x(a, b)`, for positive `a` and `b` (Numerical Recipes, third edition,
/// section 6.4); 0 and 1 beyond the ends.
pub fn cumulative(a: f64, b: f64, x: f64) -> f64 {
    if x <= 0.0 {
        return 0.0;
    }
    if x >= 1.0 {
        return 1.0;
    }
    let scale = portable_math::lgamma(a + b) - portable_math::lgamma(a) - portable_math::lgamma(b);
    let front = portable_math::exp(scale + a * portable_math::log(x) + b * portable_math::log(1.0 - x));
    if x < (a + 1.0) / (a + b + 2.0) {
        front * fraction(a, b, x) / a
    } else {
        1.0 - front * fraction(b, a, 1.0 - x) / b
    }
}

/// The value below which a share `u` of a beta distribution on 0 to 1 lies: bisection down to neighbouring numbers.
pub fn quantile(a: f64, b: f64, u: f64) -> f64 {
    // In log x where the density piles up at zero: small `a` puts most draws at magnitudes far apart.
    let (mut low, mut high) = (-745.0, 0.0);
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            break;
        }
        if cumulative(a, b, portable_math::exp(middle)) < u { low = middle } else { high = middle }
    }
    portable_math::exp(0.5 * (low + high)).clamp(f64::MIN_POSITIVE, 1.0)
}

/// Lentz's evaluation of the continued fraction of the incomplete beta function.
fn fraction(a: f64, b: f64, x: f64) -> f64 {
    let away = |value: f64| if value.abs() < 1e-300 { 1e-300 } else { value };
    let mut c = 1.0;
    let mut d = 1.0 / away(1.0 - (a + b) * x / (a + 1.0));
    let mut sum = d;
    for m in (1..MOST_TERMS).map(f64::from) {
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        let mut step = 1.0;
        for term in [even, odd] {
            d = 1.0 / away(1.0 + term * d);
            c = away(1.0 + term / c);
            step = d * c;
            sum *= step;
        }
        if (step - 1.0).abs() < 1e-15 {
            break;
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// a, b, x and `I_x(a, b)`, the last from mpmath 1.3 with 40 digits.
    const TABLE: [(f64, f64, f64, f64); 10] = [
        (0.5, 0.5, 0.1, 0.204_832_764_699_133_45),
        (2.5, 7.0, 0.3, 0.641_222_462_971_721_3),
        (5.0, 14.0, 0.4, 0.905_831_351_289_118_7),
        (20.0, 1.0, 0.95, 0.358_485_922_408_541_9),
        (47.0, 4.0, 0.9777, 0.974_740_038_809_787_1),
        (0.3, 40.0, 0.001, 0.419_345_000_734_980_6),
        (150.5, 200.0, 0.43, 0.511_273_923_477_485_2),
        (1000.0, 1000.0, 0.51, 0.814_447_340_568_488_6),
        (3000.0, 500.0, 0.86, 0.682_325_445_368_731_2),
        (0.01, 3.0, 1e-5, 0.904_664_085_611_669_9),
    ];

    #[test]
    fn published_values_come_out() {
        for (a, b, x, expected) in TABLE {
            let share = cumulative(a, b, x);
            assert!((share - expected).abs() < 1e-12 * expected.max(1.0), "I_{x}({a}, {b}) = {share}, not {expected}");
            let back = quantile(a, b, expected);
            assert!((back - x).abs() < 1e-12, "{back} of {a}, {b}, not {x}");
        }
        assert_eq!(
            [-1.0, 0.0, 1.0, 2.0].map(|x| cumulative(2.0, 3.0, x).to_bits()),
            [0.0, 0.0, 1.0, 1.0].map(f64::to_bits)
        );
    }

    #[test]
    fn closed_forms_come_out() {
        for u in [1e-6, 0.01, 0.3, 0.5, 0.9, 0.999] {
            // a = 2, b = 1: x^2; a = 1, b = 3: 1 - (1 - x)^3; a = b = 1/2: the arcsine law.
            assert!((quantile(2.0, 1.0, u) - u.sqrt()).abs() < 1e-13);
            assert!((quantile(1.0, 3.0, u) - (1.0 - portable_math::cbrt(1.0 - u))).abs() < 1e-13);
            let sine = portable_math::sin(0.5 * std::f64::consts::PI * u);
            assert!((quantile(0.5, 0.5, u) - sine * sine).abs() < 1e-12);
        }
        assert!((quantile(1e4, 1e4, 0.5) - 0.5).abs() < 1e-10);
    }
}
