//! A smooth surface through values on the cells of a grid: cubic B-splines whose coefficients are found by recursive filters
//! (Unser, Aldroubi and Eden 1993, IEEE Trans. Signal Processing 41).

use crate::matching::noise::paper::Interpolation;
use rockface_core::numerics::fast_round::{floor, whole};
use rockface_core::numerics::simd::{LANES, Lanes, Number, both};

/// Pole of the filter that turns values into coefficients: `sqrt(3) - 2`.
const POLE: f64 = -0.267_949_192_431_122_7;
/// Values after which a filter has forgotten where it began: `POLE^16` is below 1e-9.
const MEMORY: usize = 16;

/// A surface that passes through the value of each cell at its middle, and goes on mirrored beyond the edges.
#[derive(Debug, Clone)]
pub struct Spline {
    columns: usize,
    rows: usize,
    /// Row by row with [`MARGIN`] mirrored cells around the grid, where few positions lie, so that they are no special case.
    coefficients: Vec<f32>,
}

/// Cells beyond each edge of the grid.
const MARGIN: usize = 20;

impl Spline {
    /// Through values row by row, at least one.
    pub fn new(mut values: Vec<f32>, columns: usize) -> Self {
        let rows = values.len() / columns;
        values.chunks_exact_mut(columns).for_each(|row| filter(row, 1));
        filter(&mut values, columns);
        let around = |size: usize| (0..size + 2 * MARGIN).map(move |at| mirrored(at as f64 - MARGIN as f64, size));
        let left: Vec<usize> = around(columns).take(MARGIN).collect();
        let right: Vec<usize> = around(columns).skip(MARGIN + columns).collect();
        let mut coefficients = Vec::with_capacity((columns + 2 * MARGIN) * (rows + 2 * MARGIN));
        for row in around(rows) {
            let row = &values[row * columns..(row + 1) * columns];
            coefficients.extend(left.iter().map(|column| row[*column]));
            coefficients.extend_from_slice(row);
            coefficients.extend(right.iter().map(|column| row[*column]));
        }
        Self { columns, rows, coefficients }
    }

    fn stride(&self) -> usize {
        self.columns + 2 * MARGIN
    }

    /// The value at a position in cells, whose middles are at halves.
    #[inline]
    pub fn at(&self, [column, row]: [f64; 2]) -> f64 {
        let inside = self.is_inside([column, row]);
        if inside { self.at_inside([column, row]) } else { self.at_any([column, row]) }
    }

    /// The values at several positions; NaN at a position that is NaN.
    #[inline(always)]
    pub fn at_lanes(&self, [columns, rows]: [Lanes; 2]) -> Lanes {
        let mut all_inside = true;
        for lane in 0..LANES {
            all_inside &= self.is_inside([columns[lane], rows[lane]]);
        }
        if !all_inside {
            return self.at_each([columns, rows]);
        }
        let ([left, top], [x, y]) = split([columns, rows]);
        let mut values = Lanes::NONE;
        // No closure: it would be compiled by itself, without wide registers.
        for lane in 0..LANES {
            let x = [x[0][lane], x[1][lane], x[2][lane], x[3][lane]];
            let y = [y[0][lane], y[1][lane], y[2][lane], y[3][lane]];
            values.set(lane, self.weighted([left[lane], top[lane]], [x, y]));
        }
        values
    }

    /// As [`at_lanes`](Self::at_lanes), one by one.
    #[inline(never)]
    fn at_each(&self, [columns, rows]: [Lanes; 2]) -> Lanes {
        columns.with(
            rows,
            |column, row| {
                if column.is_nan() || row.is_nan() { f64::NAN } else { self.at([column, row]) }
            },
        )
    }

    /// Whether the four by four cells around a position lie in the grid or its margin.
    #[inline(always)]
    #[allow(clippy::needless_bitwise_bool)] // branches would keep the lanes apart
    fn is_inside(&self, [column, row]: [f64; 2]) -> bool {
        let within = |at: f64, size: usize| (at >= 2.0 - MARGIN as f64) & (at < (size + MARGIN) as f64 - 2.0);
        within(column, self.columns) & within(row, self.rows)
    }

    fn at_inside(&self, position: [f64; 2]) -> f64 {
        let (first, weights) = split(position);
        self.weighted(first, weights)
    }

    /// The sum of the four values in each of four rows, whose first is in this column and row, by their weights along x and y.
    #[inline(always)]
    fn weighted(&self, first: [f64; 2], [x, y]: [[f64; 4]; 2]) -> f64 {
        let [left, top] = both(first, |cell| whole(cell + MARGIN as f64));
        let mut sums = [0.0; 4];
        for (row, weight) in y.iter().enumerate() {
            let first = (top + row) * self.stride() + left;
            let values: &[f32; 4] =
                self.coefficients.get(first..).and_then(|rest| rest.first_chunk()).unwrap_or(&[f32::NAN; 4]);
            for (sum, value) in sums.iter_mut().zip(values) {
                *sum += f64::from(*value) * weight;
            }
        }
        sum_of(sums, x)
    }

    fn at_any(&self, [column, row]: [f64; 2]) -> f64 {
        let (columns, x) = around(column, self.columns);
        let (rows, y) = around(row, self.rows);
        let mut sums = [0.0; 4];
        for (row, weight) in rows.iter().zip(y) {
            let row = &self.coefficients[(row + MARGIN) * self.stride() + MARGIN..][..self.columns];
            sums.iter_mut().zip(columns).for_each(|(sum, column)| *sum += f64::from(row[column]) * weight);
        }
        sum_of(sums, x)
    }
}

#[inline(always)]
fn sum_of([a, b, c, d]: [f64; 4], x: [f64; 4]) -> f64 {
    (a * x[0] + b * x[1]) + (c * x[2] + d * x[3])
}

/// The first of the four cells around a position along each axis, and their weights.
#[inline(always)]
fn split<T: Number + Whole>(position: [T; 2]) -> ([T; 2], [[T; 4]; 2]) {
    let [across, down] = position;
    let (left, top) = ((across - 0.5).whole(), (down - 0.5).whole());
    let kernel = Interpolation::BSpline;
    ([left - 1.0, top - 1.0], [kernel.weights(across - 0.5 - left), kernel.weights(down - 0.5 - top)])
}

/// The largest whole number not above.
trait Whole {
    fn whole(self) -> Self;
}

impl Whole for f64 {
    #[inline(always)]
    fn whole(self) -> Self {
        f64::from(floor(self))
    }
}

impl Whole for Lanes {
    #[inline(always)]
    fn whole(self) -> Self {
        self.map(f64::floor)
    }
}

/// The four cells around a position along a side of a grid, and their weights.
fn around(position: f64, size: usize) -> ([usize; 4], [f64; 4]) {
    let first = (position - 0.5).floor();
    let weights = Interpolation::BSpline.weights(position - 0.5 - first);
    let cell = |step: f64| mirrored(first + step, size);
    ([cell(-1.0), cell(0.0), cell(1.0), cell(2.0)], weights)
}

/// The cell at a position along one side of a grid of `size` cells, which is mirrored at its ends.
#[inline(always)]
pub fn mirrored(at: f64, size: usize) -> usize {
    if at >= 0.0 && at < size as f64 { at as usize } else { mirrored_beyond(at, size) }
}

/// The same for a position beyond an end.
fn mirrored_beyond(at: f64, size: usize) -> usize {
    let cell = at.floor();
    // Once beyond an end, which is most often, without a division.
    if cell < 0.0 && cell >= -(size as f64) {
        return (-1.0 - cell) as usize;
    }
    if cell >= size as f64 && cell < 2.0 * size as f64 {
        return (2.0 * size as f64 - 1.0 - cell) as usize;
    }
    let period = 2.0 * size as f64;
    let within = cell.rem_euclid(period);
    let folded = if within < size as f64 { within } else { period - 1.0 - within };
    (folded.max(0.0) as usize).min(size - 1)
}

/// Turns the values of each column into coefficients, row by row: columns do not wait for each other.
fn filter(values: &mut [f32], columns: usize) {
    let rows = values.len() / columns;
    let mut states = vec![0.0; columns];
    // What the values before the first one leave, which mirror those after it.
    for i in (0..MEMORY).rev() {
        let before = &values[mirrored(-1.0 - i as f64, rows) * columns..][..columns];
        states.iter_mut().zip(before).for_each(|(state, value)| *state = f64::from(*value) + POLE * *state);
    }
    for row in values.chunks_exact_mut(columns) {
        for (value, state) in row.iter_mut().zip(&mut states) {
            *state = f64::from(*value) + POLE * *state;
            *value = *state as f32;
        }
    }
    let (others, last) = values.split_at_mut((rows - 1) * columns);
    // Beyond the last one coefficients are mirrored too.
    for (value, state) in last.iter_mut().zip(&mut states) {
        *state *= POLE / (POLE - 1.0);
        *value = (6.0 * *state) as f32;
    }
    for row in others.chunks_exact_mut(columns).rev() {
        for (value, state) in row.iter_mut().zip(&mut states) {
            *state = POLE * (*state - f64::from(*value));
            *value = (6.0 * *state) as f32;
        }
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
    fn inside_and_near_the_edges_the_formula_is_the_same() {
        let random = Key([4; 32]).field();
        let spline = Spline::new((0..9 * 7).map(|i| random.normal(i, 0) as f32).collect(), 9);
        for i in 0..900 {
            // Also in the margin, and beyond it.
            let [column, row] = [0.07 * f64::from(i) - 30.0, 0.05 * f64::from((i * 37) % 1000) - 25.0];
            assert_eq!(spline.at([column, row]).to_bits(), spline.at_any([column, row]).to_bits(), "{column} {row}");
            let places =
                [column, row].map(|at| Lanes::of(|lane| if lane == 3 { f64::NAN } else { at + 0.001 * lane as f64 }));
            let (inside, found) =
                (places.map(|at| at.map(|at| if at.is_nan() { 3.0 } else { at })), spline.at_lanes(places));
            let all = spline.at_lanes(inside);
            for lane in 0..LANES {
                let expected = spline.at(inside.map(|at| at[lane]));
                assert_eq!(all[lane].to_bits(), expected.to_bits());
                assert!(if lane == 3 { found[lane].is_nan() } else { found[lane].to_bits() == expected.to_bits() });
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
        for (cell, expected) in [
            (0.0, 0),
            (2.0, 2),
            (3.0, 2),
            (5.0, 0),
            (-1.0, 0),
            (-3.0, 2),
            (6.0, 0),
            (60.0, 0),
            (1.7, 1),
            (-0.3, 0),
            (3.2, 2),
        ] {
            assert_eq!(mirrored(cell, 3), expected, "{cell}");
        }
    }
}
