//! Takes a least-squares plane off a raster before its spatial structure is described, and says how asymmetric the raster is about it.

use nalgebra::Vector3;

use rockface_core::choice;
use rockface_core::numerics::trend::{Trend, fitted, terms};

choice! {
    /// What is taken off a raster.
    pub enum Detrend {
        /// Its mean.
        Mean = "mean",
        /// The least-squares plane through its cells.
        Plane = "plane",
    }
}

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

/// Asymmetry of a raster: offset and tilts of its trend less its plane of least absolute deviations, which goes with what most cells agree on; in the
/// numbers of [`plane`].
pub fn asymmetry(values: &[f32], columns: usize, trend: &Trend) -> Option<[f64; 3]> {
    let robust = robust_plane(values, columns)?;
    Some(std::array::from_fn(|k| trend[k] - robust[k]))
}

/// The plane of least absolute deviations (reweighted least squares: Schlossmacher 1973), in the numbers of [`plane`].
pub fn robust_plane(values: &[f32], columns: usize) -> Option<[f64; 3]> {
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
        return Some(least_squares);
    }
    let mut robust = least_squares;
    for _ in 0..ROUNDS {
        let before = Vector3::from(robust);
        let weight = |x: &Vector3<f64>, value: f64| 1.0 / (value - before.dot(x)).abs().max(least);
        robust = weighted_plane(values, columns, step, weight)?;
    }
    Some(robust)
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
    fitted(values, step, |i| terms(columns, rows, i % columns, i / columns), |_, x, value| weight(x, value))
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
            let mut trend = Trend::default();
            trend[..3].copy_from_slice(&plane(&values, columns).unwrap());
            asymmetry(&values, columns, &trend).unwrap()
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
        assert!(robust_plane(&[f32::NAN; 1600], columns).is_none());
    }
}
