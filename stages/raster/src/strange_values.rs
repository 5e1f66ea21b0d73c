//! Values that elevations and differences of a rock face can hardly have: no-data values that a file does not declare.

use rockface_core::artefact::Band;
use rockface_core::numerics::{marginal, quantile};

/// A difference as large as this is no change of a rock face, metres.
const LEAST_IMPOSSIBLE_M: f32 = 100.0;
/// What programs write where there is no value, besides the largest numbers.
const USUAL: [f32; 3] = [-9999.0, -32767.0, -32768.0];
/// Numbers as large as this are the largest of 32 bits, rounded or not, or infinite.
const LARGEST: f32 = 3.4e38;
/// The most cells that a value is compared with to see whether it is isolated.
const SAMPLE: usize = 100_000;
/// A value is isolated where it is so many robust standard deviations from the median of all other values, ...
const ISOLATED_SPREADS: f64 = 20.0;
/// ... and at least so far, metres.
const ISOLATED_M: f64 = 10.0;
/// The least and the greatest value are no outliers but one value that is written where there is none where so many cells hold them.
const SEVERAL: usize = 3;

/// Values that look like a no-data value that is not declared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Undeclared {
    /// The value.
    pub value: f32,
    /// Cells that hold it.
    pub cells: usize,
}

/// Values of elevations that programs write where there is none, and zeros, or a least or greatest value of several
/// cells, far from all the rest.
pub fn undeclared_elevations(values: &[f32]) -> Vec<Undeclared> {
    let mut found: Vec<Undeclared> = Vec::new();
    let mut zeros = 0;
    for value in values.iter().copied().filter(|value| !value.is_nan()) {
        if is_usual(value) {
            match found.iter_mut().find(|known| is_same(known.value, value)) {
                Some(known) => known.cells += 1,
                None => found.push(Undeclared { value, cells: 1 }),
            }
        }
        zeros += usize::from(is_same(value, 0.0));
    }
    if zeros > 0 && is_isolated(0.0, values) {
        found.push(Undeclared { value: 0.0, cells: zeros });
    }
    let others =
        || values.iter().copied().filter(|value| !value.is_nan() && !is_usual(*value) && !is_same(*value, 0.0));
    let extremes = [others().reduce(f32::min), others().reduce(f32::max)];
    for value in extremes.into_iter().flatten() {
        let cells = others().filter(|other| is_same(*other, value)).count();
        if cells >= SEVERAL && is_isolated(value, values) {
            found.push(Undeclared { value, cells });
        }
    }
    found
}

/// Whether two values are one, to the bit or both zero.
pub fn is_same(one: f32, other: f32) -> bool {
    one.to_bits() == other.to_bits() || one.abs() + other.abs() <= 0.0
}

fn is_usual(value: f32) -> bool {
    value.abs() >= LARGEST || USUAL.iter().any(|usual| is_same(*usual, value))
}

fn is_isolated(suspect: f32, values: &[f32]) -> bool {
    let is_other = |value: &f32| !value.is_nan() && !is_usual(*value) && !is_same(*value, suspect);
    let sample = values.iter().copied().step_by(values.len().div_ceil(SAMPLE).max(1));
    let others: Vec<f32> = sample.filter(is_other).collect();
    let Some(median) = quantile::median(&mut marginal::known(&others)) else { return false };
    (f64::from(suspect) - median).abs() > ISOLATED_M.max(ISOLATED_SPREADS * marginal::nmad(&others))
}

/// A value as it is written in a pipeline.
pub fn written(value: f32) -> String {
    if value.is_infinite() {
        format!("{:e}", f64::MAX.copysign(f64::from(value)))
    } else if value.abs() >= 1e9 {
        format!("{value:e}")
    } else {
        value.to_string()
    }
}

/// Cells of a band of differences in metres that hold 100 m or more, and the greatest of them.
pub fn impossible_differences(band: &Band) -> Option<Undeclared> {
    let impossible = || band.values.iter().copied().filter(|value| value.abs() >= LEAST_IMPOSSIBLE_M);
    let value = impossible().reduce(|a, b| if b.abs() > a.abs() { b } else { a })?;
    Some(Undeclared { value, cells: impossible().count() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(values: &[f32]) -> Vec<(f32, usize)> {
        undeclared_elevations(values).into_iter().map(|found| (found.value, found.cells)).collect()
    }

    #[test]
    fn usual_no_data_values_and_isolated_zeros_are_found() {
        let face = |i: usize| 600.0 + (i % 10) as f32;
        let mut values: Vec<f32> = (0..100).map(face).collect();
        assert_eq!(found(&values), []);
        values[3..5].fill(-9999.0);
        values[7] = 3.4e38;
        values[8] = f32::NAN;
        values[9] = -f32::MAX;
        assert_eq!(found(&values), [(-9999.0, 2), (3.4e38, 1), (-f32::MAX, 1)]);
        values[50..60].fill(0.0);
        assert_eq!(found(&values)[3], (0.0, 10));
        let below: Vec<f32> = (0..50).map(|i| face(i) - 1200.0).chain([0.0]).collect();
        assert_eq!(found(&below), [(0.0, 1)]);
        let texts = [-9999.0, 3.4e38, f32::MAX, f32::NEG_INFINITY].map(written);
        assert_eq!(texts, ["-9999", "3.4e38", "3.4028235e38", "-1.7976931348623157e308"]);
    }

    #[test]
    fn a_value_of_several_cells_far_from_all_others_is_found() {
        let face = |i: usize| 600.0 + (i % 10) as f32;
        for value in [-99_999.0, 1e30, -327.68] {
            let mut values: Vec<f32> = (0..100).map(face).collect();
            values[3..5].fill(value);
            assert_eq!(found(&values), [], "two outliers");
            values[5] = value;
            assert_eq!(found(&values), [(value, 3)]);
        }
        assert_eq!([1e30, -327.68].map(written), ["1e30", "-327.68"]);
        let mut both: Vec<f32> = (0..100).map(face).collect();
        both[..5].fill(-99_999.0);
        both[5..10].fill(-9999.0);
        both[10..14].fill(1e30);
        assert_eq!(found(&both), [(-9999.0, 5), (-99_999.0, 5), (1e30, 4)]);
        // A floor and a roof of the face itself.
        let mut steps: Vec<f32> = (0..100).map(face).collect();
        steps[..20].fill(595.0);
        steps[20..40].fill(618.0);
        assert_eq!(found(&steps), []);
    }

    #[test]
    fn zeros_of_walls_flats_and_slopes_are_elevations() {
        let wall: Vec<f32> = (0..100).map(|i| 0.1 * (i % 7) as f32).collect();
        let flat: Vec<f32> = (0..100).map(|i| if i > 50 { 5.0 } else { 0.0 }).collect();
        let slope: Vec<f32> = (0..100).map(|i| 2.0 * i as f32).collect();
        for values in [wall, flat, slope, vec![0.0; 9], Vec::new()] {
            assert_eq!(found(&values), []);
        }
    }
}
