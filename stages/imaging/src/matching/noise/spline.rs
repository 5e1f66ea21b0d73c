//! A smooth surface through values on the cells of a grid: cubic B-splines whose coefficients are found by recursive filters
//! (Unser, Aldroubi and Eden 1993, IEEE Trans. Signal Processing 41).

use crate::matching::noise::paper::Interpolation;

/// Pole of the filter that turns values into coefficients: `sqrt(3) - 2`.
const POLE: f64 = -0.267_949_192_431_122_7;
/// Values after which a filter has forgotten where it began: `POLE^16` is below 1e-9.
const MEMORY: usize = 16;

/// A surface that passes through the value of each cell at its middle, and goes on mirrored beyond the edges.
#[derive(Debug, Clone)]
pub struct Spline {
    columns: usize,
    rows: usize,
    coefficients: Vec<f32>,
}

impl Spline {
    /// Through values row by row, at least one.
    pub fn new(mut values: Vec<f32>, columns: usize) -> Self {
        let rows = values.len() / columns;
        values.chunks_exact_mut(columns).for_each(|row| filter(row, columns, 1));
        (0..columns).for_each(|column| filter(&mut values[column..], rows, columns));
        Self { columns, rows, coefficients: values }
    }

    /// The value at a position in cells, whose middles are at halves.
    pub fn at(&self, [column, row]: [f64; 2]) -> f64 {
        let (columns, x) = around(column, self.columns);
        let (rows, y) = around(row, self.rows);
        let along = |row: usize| {
            let row = &self.coefficients[row * self.columns..(row + 1) * self.columns];
            columns.iter().zip(x).map(|(column, weight)| f64::from(row[*column]) * weight).sum::<f64>()
        };
        rows.iter().zip(y).map(|(row, weight)| along(*row) * weight).sum()
    }
}

/// The four cells around a position along a side of a grid, and their weights.
fn around(position: f64, size: usize) -> ([usize; 4], [f64; 4]) {
    let first = (position - 0.5).floor();
    let weights = Interpolation::BSpline.weights(position - 0.5 - first);
    ([-1.0, 0.0, 1.0, 2.0].map(|step| mirrored(first + step, size)), weights)
}

/// The cell of a whole number along one side of a grid of `size` cells, which is mirrored at its ends.
pub fn mirrored(cell: f64, size: usize) -> usize {
    if cell >= 0.0 && cell < size as f64 {
        return cell as usize;
    }
    let period = 2.0 * size as f64;
    let within = cell.rem_euclid(period);
    let folded = if within < size as f64 { within } else { period - 1.0 - within };
    (folded.max(0.0) as usize).min(size - 1)
}

/// Turns `count` values, `step` apart, into coefficients.
fn filter(values: &mut [f32], count: usize, step: usize) {
    let at = |i: usize| i * step;
    // What the values before the first one leave, which mirror those after it.
    let before = |i: usize| f64::from(values[at(mirrored(-1.0 - i as f64, count))]);
    let mut state = (0..MEMORY).rev().fold(0.0, |state, i| before(i) + POLE * state);
    for i in 0..count {
        state = f64::from(values[at(i)]) + POLE * state;
        values[at(i)] = state as f32;
    }
    // Beyond the last one coefficients are mirrored too.
    state *= POLE / (POLE - 1.0);
    values[at(count - 1)] = (6.0 * state) as f32;
    for i in (0..count - 1).rev() {
        state = POLE * (state - f64::from(values[at(i)]));
        values[at(i)] = (6.0 * state) as f32;
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // values that are exact
mod tests {
    use super::*;
    use rockface_core::numerics::portable_math;
    use rockface_core::numerics::random::Key;

    #[test]
    fn it_passes_through_its_values_and_goes_on_mirrored() {
        let random = Key([3; 32]).field();
        for (columns, rows) in [(1, 1), (2, 5), (23, 17)] {
            let value = |column: usize, row: usize| random.normal(column as i32, row as i32) as f32;
            let values: Vec<f32> = (0..columns * rows).map(|i| value(i % columns, i / columns)).collect();
            let spline = Spline::new(values.clone(), columns);
            for (i, value) in values.iter().enumerate() {
                let (x, y) = ((i % columns) as f64 + 0.5, (i / columns) as f64 + 0.5);
                assert!((spline.at([x, y]) - f64::from(*value)).abs() < 1e-5, "{columns} x {rows}: {i}");
                assert!((spline.at([-x, y]) - spline.at([x, y])).abs() < 1e-9);
                assert!((spline.at([x, 2.0 * rows as f64 - y]) - spline.at([x, y])).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn between_cells_it_keeps_waves_that_are_longer_than_a_few_of_them() {
        for (cells, tolerance) in [(4.0, 0.05), (8.0, 0.003)] {
            let wave = |x: f64| portable_math::sin(std::f64::consts::TAU * x / cells);
            let spline = Spline::new((0..64).map(|i| wave(f64::from(i) + 0.5) as f32).collect(), 64);
            let worst = (0..300).map(|i| 20.0 + 0.08 * f64::from(i)).map(|x| (spline.at([x, 0.5]) - wave(x)).abs());
            let worst = worst.fold(0.0, f64::max);
            assert!(worst < tolerance, "{cells} cells: {worst}");
        }
    }

    #[test]
    fn cells_are_mirrored_at_both_ends() {
        for (cell, expected) in [(0.0, 0), (2.0, 2), (3.0, 2), (5.0, 0), (-1.0, 0), (-3.0, 2), (6.0, 0), (60.0, 0)] {
            assert_eq!(mirrored(cell, 3), expected, "{cell}");
        }
    }
}
