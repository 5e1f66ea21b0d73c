//! Takes a least-squares plane off a raster before its spatial structure is described.

use nalgebra::{Cholesky, Matrix3, Vector3};

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

/// The least-squares plane through the known cells of a raster: offset in its middle, growth from there to its right edge and to its
/// lower edge; `None` where the cells lie on a line.
pub fn plane(values: &[f32], columns: usize) -> Option<[f64; 3]> {
    let rows = values.len() / columns;
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (i, value) in values.iter().enumerate().filter(|(_, value)| !value.is_nan()) {
        let x = terms(columns, rows, i % columns, i / columns);
        normal += x * x.transpose();
        right += x * f64::from(*value);
    }
    // On a line the determinant is 0 but for rounding.
    let on_line = normal.determinant() <= LEAST_AREA * normal.diagonal().product();
    if on_line { None } else { Some(Cholesky::new(normal)?.solve(&right).into()) }
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
}
