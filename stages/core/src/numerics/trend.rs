//! Trends of rasters: polynomials of the first to third degree through their known cells, by weighted least squares.

use nalgebra::{Cholesky, Const, DimMin, SMatrix, SVector, Vector3};

/// A trend of the third degree: factors on 1, x, y, x^2 - 1/3, x y, y^2 - 1/3, x^3 - 3/5 x, (x^2 - 1/3) y, x (y^2 - 1/3) and y^3 - 3/5 y, where x and y are
/// -1 and 1 at the edges of the grid, to the right and down.
pub type Trend = [f64; 10];

/// The factors of a trend that bend it.
pub const BENDS: std::ops::Range<usize> = 3..10;

/// Determinant of the normal equations, as a share of the product of their diagonal, from which on cells count as an area.
const LEAST_AREA: f64 = 1e-9;

/// The least-squares trend of the third degree through the known cells of a raster, as [`trend_at`] takes it; of a lower degree where the cells do not
/// tell its terms apart; `None` where they lie on a line. Cells have weights; none: all count alike.
pub fn trend(values: &[f32], columns: usize, weights: &[f32]) -> Option<Trend> {
    trend_of::<10>(values, columns, weights)
        .or_else(|| trend_of::<6>(values, columns, weights))
        .or_else(|| trend_of::<3>(values, columns, weights))
}

/// A trend of the first terms only.
fn trend_of<const N: usize>(values: &[f32], columns: usize, weights: &[f32]) -> Option<Trend>
where
    Const<N>: DimMin<Const<N>, Output = Const<N>>,
{
    let rows = values.len() / columns;
    let bent = |i: usize| {
        let all = bend_terms(terms(columns, rows, i % columns, i / columns).into());
        SVector::from_fn(|k, _| all[k])
    };
    let weight = |i: usize, _: &SVector<f64, N>, _: f64| weights.get(i).map_or(1.0, |weight| f64::from(*weight));
    let mut trend = Trend::default();
    trend[..N].copy_from_slice(&fitted::<N>(values, 1, bent, weight)?);
    Some(trend)
}

/// Height of a trend at a place whose coordinates are -1 and 1 at the edges of the grid, to the right and down.
pub fn trend_at(trend: &Trend, x: f64, y: f64) -> f64 {
    trend.iter().zip(bend_terms([1.0, x, y])).map(|(factor, term)| factor * term).sum()
}

/// The values without their [`trend`]; `None` where the cells lie on a line.
pub fn without_trend(values: &[f32], columns: usize, weights: &[f32]) -> Option<Vec<f32>> {
    Some(with_trend(values, columns, &trend(values, columns, weights)?.map(|factor| -factor)))
}

/// The values with a trend added.
pub fn with_trend(values: &[f32], columns: usize, trend: &Trend) -> Vec<f32> {
    bent(values, columns, trend, &[])
}

/// The values with a trend added, and what comes with its bends at each cell: a raster for each factor beyond a plane, or none.
pub fn bent(values: &[f32], columns: usize, trend: &Trend, shapes: &[Vec<f32>]) -> Vec<f32> {
    let rows = values.len() / columns;
    let with = |(i, value): (usize, &f32)| {
        let [_, x, y] = terms(columns, rows, i % columns, i / columns).into();
        (f64::from(*value) + trend_at(trend, x, y) + bends_at(trend, shapes, i)) as f32
    };
    values.iter().enumerate().map(with).collect()
}

/// What comes with the bends of a trend at a cell, beside the trend.
pub fn bends_at(trend: &Trend, shapes: &[Vec<f32>], cell: usize) -> f64 {
    shapes.iter().zip(&trend[BENDS]).map(|(shape, factor)| factor * f64::from(shape[cell])).sum()
}

/// What a trend is made of: products of Legendre polynomials, which are nearly independent on a whole grid.
fn bend_terms([one, x, y]: [f64; 3]) -> Trend {
    let [square_x, square_y] = [x, y].map(|x| x * x - 1.0 / 3.0);
    let [cube_x, cube_y] = [x, y].map(|x| x * x * x - 0.6 * x);
    [one, x, y, square_x, x * y, square_y, cube_x, square_x * y, x * square_y, cube_y]
}

/// Factors on the terms of a cell, by least squares with weights of a cell, its terms and its value, through every known cell of number 0, `step`,
/// 2 `step`, ...; `None` where the cells do not tell the terms apart.
pub fn fitted<const N: usize>(
    values: &[f32],
    step: usize,
    terms: impl Fn(usize) -> SVector<f64, N>,
    weight: impl Fn(usize, &SVector<f64, N>, f64) -> f64,
) -> Option<[f64; N]>
where
    Const<N>: DimMin<Const<N>, Output = Const<N>>,
{
    let (mut normal, mut right) = (SMatrix::<f64, N, N>::zeros(), SVector::<f64, N>::zeros());
    for (i, value) in values.iter().enumerate().step_by(step).filter(|(_, value)| !value.is_nan()) {
        let (x, value) = (terms(i), f64::from(*value));
        let weight = weight(i, &x, value);
        normal += x * x.transpose() * weight;
        right += x * (value * weight);
    }
    // Of cells that do not tell the terms apart the determinant is 0 but for rounding.
    let unclear = normal.determinant() <= LEAST_AREA * normal.diagonal().product();
    if unclear { None } else { Some(Cholesky::new(normal)?.solve(&right).into()) }
}

/// What a plane is made of at a cell: 1, and coordinates that are -1 and 1 at the edges of the grid, to the right and down.
pub fn terms(columns: usize, rows: usize, column: usize, row: usize) -> Vector3<f64> {
    let (half_x, half_y) = (0.5 * columns as f64, 0.5 * rows as f64);
    Vector3::new(1.0, (column as f64 - half_x) / half_x, (row as f64 - half_y) / half_y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trend_is_found_with_gaps_and_taken_off_whole() {
        let (columns, rows) = (40, 30);
        let truth = [0.3, 0.1, -0.2, 0.05, -0.02, 0.04, 0.01, -0.03, 0.02, 0.015];
        let value = |i: usize| {
            let [_, x, y]: [f64; 3] = terms(columns, rows, i % columns, i / columns).into();
            if i % 7 == 2 { f32::NAN } else { trend_at(&truth, x, y) as f32 }
        };
        let values: Vec<f32> = (0..columns * rows).map(value).collect();
        let found = trend(&values, columns, &[]).unwrap();
        assert!(found.iter().zip(truth).all(|(found, truth)| (found - truth).abs() < 1e-6), "{found:?}");
        let flat = without_trend(&values, columns, &[]).unwrap();
        assert!(flat.iter().zip(&values).all(|(f, v)| f.is_nan() == v.is_nan() && (f.is_nan() || f.abs() < 1e-6)));
        // Two columns bend in no known way, some more in no way of the third degree.
        let narrow = |wide: usize| {
            let values = values.iter().enumerate();
            trend(
                &values.map(|(i, v)| if i % columns < wide { *v } else { f32::NAN }).collect::<Vec<_>>(),
                columns,
                &[],
            )
        };
        let plane = narrow(2).unwrap();
        assert!(plane[3..] == [0.0; 7] && trend(&values[..1], 1, &[]).is_none(), "{plane:?}");
        let bends = |wide: usize| narrow(wide).filter(|found| found[6..] == [0.0; 4] && found[3].abs() > 0.0);
        let bend = (3..columns).find_map(bends).unwrap();
        assert!(bend.iter().all(|factor| factor.abs() < 1.0), "{bend:?}");
    }
    #[test]
    fn cells_count_by_their_weights() {
        let columns = 40;
        let values: Vec<f32> = (0..columns * 30).map(|i| if i % columns < 20 { 1.0 } else { 5.0 }).collect();
        let weights = |of_right: f32| -> Vec<f32> {
            (0..values.len()).map(|i| if i % columns < 20 { 2.0 } else { of_right }).collect()
        };
        let same = trend(&values, columns, &weights(2.0)).unwrap();
        let none = trend(&values, columns, &[]).unwrap();
        assert!(same.iter().zip(none).all(|(a, b)| (a - b).abs() < 1e-9), "{same:?} {none:?}");
        // Half of the face with no weight is as good as unknown.
        let left: Vec<f32> = (0..values.len()).map(|i| if i % columns < 20 { 1.0 } else { f32::NAN }).collect();
        let known = trend(&left, columns, &[]).unwrap();
        let weighed = trend(&values, columns, &weights(0.0)).unwrap();
        assert!(known.iter().zip(weighed).all(|(a, b)| (a - b).abs() < 1e-9), "{known:?} {weighed:?}");
    }
}
