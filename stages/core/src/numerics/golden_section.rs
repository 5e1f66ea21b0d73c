//! Golden-section search for the minimum of a function of one variable (Kiefer 1953).

/// Larger part of the golden section.
const RATIO: f64 = 0.618_033_988_749_894_9;

/// What becomes of the inner point that lies in the part that is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Inner {
    /// Its cost is used again: one evaluation a section. Rounding moves the points off the golden section.
    Reused,
    /// Both inner points are placed anew: two evaluations a section, and no drift.
    Renewed,
}

/// The middle of the interval that `sections` golden sections leave of `low..high`, each 62 % of the one before.
///
/// Where both inner points cost the same, the lower part is kept. Of several minima one is found. A caller that wants the
/// cheapest of all points it was asked for remembers it in `cost`, which is asked for the upper point first.
pub fn golden_section(
    mut cost: impl FnMut(f64) -> f64,
    mut low: f64,
    mut high: f64,
    sections: usize,
    inner: Inner,
) -> f64 {
    let mut known: [Option<(f64, f64)>; 2] = [None; 2];
    for _ in 0..sections {
        let (a, b) = (high - RATIO * (high - low), low + RATIO * (high - low));
        let upper = known[1].unwrap_or_else(|| (b, cost(b)));
        let lower = known[0].unwrap_or_else(|| (a, cost(a)));
        known = if lower.1 <= upper.1 {
            high = upper.0;
            [None, Some(lower)]
        } else {
            low = lower.0;
            [Some(upper), None]
        };
        if inner == Inner::Renewed {
            known = [None; 2];
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parabola_a_kink_and_an_end_are_found() {
        for inner in [Inner::Reused, Inner::Renewed] {
            let minimum = |cost: fn(f64) -> f64, low, high| golden_section(cost, low, high, 60, inner);
            assert!((minimum(|x| (x - 0.3) * (x - 0.3), -1.0, 2.0) - 0.3).abs() < 1e-7);
            assert!((minimum(|x| (x + 7.25).abs(), -10.0, 0.0) + 7.25).abs() < 1e-11);
            assert!((minimum(|x| x, 1.0, 4.0) - 1.0).abs() < 1e-11);
        }
    }

    #[test]
    fn evaluations_are_counted_and_ties_go_to_the_lower_part() {
        for (inner, expected) in [(Inner::Reused, 11), (Inner::Renewed, 20)] {
            let mut evaluations = 0;
            let flat = |_: f64| {
                evaluations += 1;
                0.0
            };
            assert!(golden_section(flat, 0.0, 1.0, 10, inner) < 0.01);
            assert_eq!(evaluations, expected);
        }
    }
}
