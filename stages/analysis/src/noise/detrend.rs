//! Takes a least-squares plane off a raster before its spatial structure is described, or a trend of the third degree before its noise is learnt.

use nalgebra::{Cholesky, Const, DimMin, SMatrix, SVector, Vector3};

use rockface_core::artefact::Trend;
use rockface_core::choice;

choice! {
    /// What is taken off a raster.
    pub enum Detrend {
        /// Its mean.
        Mean = "mean",
        /// The least-squares plane through its cells.
        Plane = "plane",
    }
}

/// Determinant of the normal equations, as a share of the product of their diagonal, from which on cells count as an area.
const LEAST_AREA: f64 = 1e-9;

impl Detrend {
    /// The values without the plane; `None` where nothing but the mean goes, which each descriptor takes off itself, or where the
    /// cells lie on a line.
    pub fn applied(self, values: &[f32], columns: usize) -> Option<Vec<f32>> {
        if self == Self::Mean {
            return None;
        }
        let (plane, rows) = (plane(values, columns)?, values.len() / columns);
        let height = |i: usize| Vector3::from(plane).dot(&terms(columns, rows, i % columns, i / columns));
        let off = |(i, value): (usize, &f32)| (f64::from(*value) - height(i)) as f32;
        Some(values.iter().enumerate().map(off).collect())
    }
}

/// The least-squares trend of the third degree through the known cells of a raster, as [`trend_at`] takes it; of a lower degree where the cells do not
/// tell its terms apart; `None` where they lie on a line.
pub fn trend(values: &[f32], columns: usize) -> Option<Trend> {
    trend_of::<10>(values, columns)
        .or_else(|| trend_of::<6>(values, columns))
        .or_else(|| trend_of::<3>(values, columns))
}

/// A trend of the first terms only.
fn trend_of<const N: usize>(values: &[f32], columns: usize) -> Option<Trend>
where
    Const<N>: DimMin<Const<N>, Output = Const<N>>,
{
    let rows = values.len() / columns;
    let bent = |i: usize| {
        let all = bend_terms(terms(columns, rows, i % columns, i / columns).into());
        SVector::from_fn(|k, _| all[k])
    };
    let mut trend = Trend::default();
    trend[..N].copy_from_slice(&fitted::<N>(values, 1, bent, |_, _| 1.0)?);
    Some(trend)
}

/// Height of a trend at a place whose coordinates are -1 and 1 at the edges of the grid, to the right and down.
pub fn trend_at(trend: &Trend, x: f64, y: f64) -> f64 {
    trend.iter().zip(bend_terms([1.0, x, y])).map(|(factor, term)| factor * term).sum()
}

/// The values without their trend; `None` where the cells lie on a line.
pub fn without_trend(values: &[f32], columns: usize) -> Option<Vec<f32>> {
    let (trend, rows) = (trend(values, columns)?, values.len() / columns);
    let off = |(i, value): (usize, &f32)| {
        let [_, x, y] = terms(columns, rows, i % columns, i / columns).into();
        (f64::from(*value) - trend_at(&trend, x, y)) as f32
    };
    Some(values.iter().enumerate().map(off).collect())
}

/// What a trend is made of: products of Legendre polynomials, which are nearly independent on a whole grid.
fn bend_terms([one, x, y]: [f64; 3]) -> Trend {
    let [square_x, square_y] = [x, y].map(|x| x * x - 1.0 / 3.0);
    let [cube_x, cube_y] = [x, y].map(|x| x * x * x - 0.6 * x);
    [one, x, y, square_x, x * y, square_y, cube_x, square_x * y, x * square_y, cube_y]
}

/// The least-squares plane through the known cells of a raster: offset in its middle, growth from there to its right edge and to its
/// lower edge; `None` where the cells lie on a line.
pub fn plane(values: &[f32], columns: usize) -> Option<[f64; 3]> {
    weighted_plane(values, columns, 1, |_, _| 1.0)
}

/// Rounds of reweighting.
const ROUNDS: usize = 30;
/// Departure, as a part of the deviation, below which all count alike.
const LEAST_DEPARTURE: f64 = 0.02;
/// Cells that a plane of least absolute deviations is fitted to, about.
const ROBUST_CELLS: usize = 30_000;

/// Asymmetry of a raster: its least-squares plane less its plane of least absolute deviations (reweighted least squares: Schlossmacher
/// 1973), which goes with what most cells agree on; in the numbers of [`plane`].
pub fn asymmetry(values: &[f32], columns: usize) -> Option<[f64; 3]> {
    let known = values.iter().filter(|value| !value.is_nan()).count();
    // A step that has no factor in common with the columns meets all of them.
    let step = (known / ROBUST_CELLS).max(1);
    let step = (step..=step + columns).find(|step| gcd(*step, columns) == 1)?;
    let least_squares = weighted_plane(values, columns, step, |_, _| 1.0)?;
    let rows = values.len() / columns;
    let squares = values.iter().enumerate().step_by(step).filter(|(_, value)| !value.is_nan()).map(|(i, value)| {
        let height = Vector3::from(least_squares).dot(&terms(columns, rows, i % columns, i / columns));
        let departure = f64::from(*value) - height;
        departure * departure
    });
    let (sum, count) = squares.fold((0.0, 0.0), |(sum, count), square| (sum + square, count + 1.0));
    let least = LEAST_DEPARTURE * (sum / count).sqrt();
    // In a plane there is nothing to weigh.
    if least <= 0.0 {
        return Some([0.0; 3]);
    }
    let mut robust = least_squares;
    for _ in 0..ROUNDS {
        let before = Vector3::from(robust);
        let weight = |x: &Vector3<f64>, value: f64| 1.0 / (value - before.dot(x)).abs().max(least);
        robust = weighted_plane(values, columns, step, weight)?;
    }
    Some(std::array::from_fn(|k| least_squares[k] - robust[k]))
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// The plane of least squares with weights of what a plane is made of at a cell and of the value there, through every known cell of number 0,
/// `step`, 2 `step`, ...
fn weighted_plane(
    values: &[f32],
    columns: usize,
    step: usize,
    weight: impl Fn(&Vector3<f64>, f64) -> f64,
) -> Option<[f64; 3]> {
    let rows = values.len() / columns;
    fitted(values, step, |i| terms(columns, rows, i % columns, i / columns), weight)
}

/// Factors on the terms of a cell, by least squares with weights, through every known cell of number 0, `step`, 2 `step`, ...; `None` where the cells do
/// not tell the terms apart.
fn fitted<const N: usize>(
    values: &[f32],
    step: usize,
    terms: impl Fn(usize) -> SVector<f64, N>,
    weight: impl Fn(&SVector<f64, N>, f64) -> f64,
) -> Option<[f64; N]>
where
    Const<N>: DimMin<Const<N>, Output = Const<N>>,
{
    let (mut normal, mut right) = (SMatrix::<f64, N, N>::zeros(), SVector::<f64, N>::zeros());
    for (i, value) in values.iter().enumerate().step_by(step).filter(|(_, value)| !value.is_nan()) {
        let (x, value) = (terms(i), f64::from(*value));
        let weight = weight(&x, value);
        normal += x * x.transpose() * weight;
        right += x * (value * weight);
    }
    // Of cells that do not tell the terms apart the determinant is 0 but for rounding.
    let unclear = normal.determinant() <= LEAST_AREA * normal.diagonal().product();
    if unclear { None } else { Some(Cholesky::new(normal)?.solve(&right).into()) }
}

/// What a plane is made of at a cell.
fn terms(columns: usize, rows: usize, column: usize, row: usize) -> Vector3<f64> {
    let (half_x, half_y) = (0.5 * columns as f64, 0.5 * rows as f64);
    Vector3::new(1.0, (column as f64 - half_x) / half_x, (row as f64 - half_y) / half_y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_with_gaps_is_taken_off_whole() {
        let sloping = |i: usize| {
            if i % 7 == 2 { f32::NAN } else { 0.25 + 0.5 * (i % 20) as f32 - 0.125 * (i / 20) as f32 }
        };
        let values: Vec<f32> = (0..300).map(sloping).collect();
        let flat = Detrend::Plane.applied(&values, 20).unwrap();
        assert!(flat.iter().zip(&values).all(|(f, v)| f.is_nan() == v.is_nan() && (f.is_nan() || f.abs() < 1e-5)));
        let tilted = |i: usize| 1.0 + 0.2 * ((i % 20) as f32 - 10.0) - 0.4 * ((i / 20) as f32 - 7.5);
        let found = plane(&(0..300).map(tilted).collect::<Vec<f32>>(), 20).unwrap();
        assert!(found.iter().zip([1.0, 2.0, -3.0]).all(|(found, truth)| (found - truth).abs() < 1e-6), "{found:?}");
        assert!(Detrend::Mean.applied(&values, 20).is_none() && Detrend::Plane.applied(&values[..20], 20).is_none());
    }

    #[test]
    fn a_trend_is_found_with_gaps_and_taken_off_whole() {
        let (columns, rows) = (40, 30);
        let truth = [0.3, 0.1, -0.2, 0.05, -0.02, 0.04, 0.01, -0.03, 0.02, 0.015];
        let value = |i: usize| {
            let [_, x, y]: [f64; 3] = terms(columns, rows, i % columns, i / columns).into();
            if i % 7 == 2 { f32::NAN } else { trend_at(&truth, x, y) as f32 }
        };
        let values: Vec<f32> = (0..columns * rows).map(value).collect();
        let found = trend(&values, columns).unwrap();
        assert!(found.iter().zip(truth).all(|(found, truth)| (found - truth).abs() < 1e-6), "{found:?}");
        let flat = without_trend(&values, columns).unwrap();
        assert!(flat.iter().zip(&values).all(|(f, v)| f.is_nan() == v.is_nan() && (f.is_nan() || f.abs() < 1e-6)));
        // Two columns bend in no known way, some more in no way of the third degree.
        let narrow = |wide: usize| {
            let values = values.iter().enumerate();
            trend(&values.map(|(i, v)| if i % columns < wide { *v } else { f32::NAN }).collect::<Vec<_>>(), columns)
        };
        let plane = narrow(2).unwrap();
        assert!(plane[3..] == [0.0; 7] && trend(&values[..1], 1).is_none(), "{plane:?}");
        let bends = |wide: usize| narrow(wide).filter(|found| found[6..] == [0.0; 4] && found[3].abs() > 0.0);
        let bend = (3..columns).find_map(bends).unwrap();
        assert!(bend.iter().all(|factor| factor.abs() < 1.0), "{bend:?}");
    }

    #[test]
    fn what_few_cells_add_is_asymmetry_and_what_all_have_is_not() {
        let columns = 40;
        let noise = rockface_core::numerics::random::Key([5; 32]).field();
        let rock = |i: usize| {
            0.3 + 0.02 * (i % columns) as f64 + 0.01 * noise.normal((i % columns) as i32, (i / columns) as i32)
        };
        // A tenth of the cells, all on the right, lie 0.2 higher.
        let high = |i: usize| if i % columns >= 36 { 0.2 } else { 0.0 };
        let of = |value: &dyn Fn(usize) -> f64| {
            let values: Vec<f32> = (0..1600).map(|i| if i % 13 == 5 { f32::NAN } else { value(i) as f32 }).collect();
            asymmetry(&values, columns).unwrap()
        };
        let even = of(&rock);
        assert!(even.iter().all(|a| a.abs() < 0.002), "{even:?}");
        let found = of(&|i| rock(i) + high(i));
        let added: Vec<f32> = (0..1600).map(|i| high(i) as f32).collect();
        let wanted = plane(&added, columns).unwrap();
        assert!(
            (0..2).all(|k| (found[k] - wanted[k]).abs() < 0.15 * wanted[k]) && found[2].abs() < 0.004,
            "{found:?} {wanted:?}"
        );
        assert!(of(&|_| 0.5).iter().all(|a| a.abs() <= 0.0));
        assert!(asymmetry(&[f32::NAN; 1600], columns).is_none());
    }
}
