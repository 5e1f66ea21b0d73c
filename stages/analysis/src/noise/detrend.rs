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

impl Detrend {
    /// The values without the plane; `None` where nothing but the mean goes, which each descriptor takes off itself, or where the
    /// cells lie on a line.
    pub fn applied(self, values: &[f32], columns: usize) -> Option<Vec<f32>> {
        if self == Self::Mean {
            return None;
        }
        let rows = values.len() / columns;
        let (half_x, half_y) = (0.5 * columns as f64, 0.5 * rows as f64);
        let at = |i: usize| {
            Vector3::new(1.0, ((i % columns) as f64 - half_x) / half_x, ((i / columns) as f64 - half_y) / half_y)
        };
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for (i, value) in values.iter().enumerate().filter(|(_, value)| !value.is_nan()) {
            let x = at(i);
            normal += x * x.transpose();
            right += x * f64::from(*value);
        }
        let plane = Cholesky::new(normal)?.solve(&right);
        let off = |(i, value): (usize, &f32)| (f64::from(*value) - plane.dot(&at(i))) as f32;
        Some(values.iter().enumerate().map(off).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_with_gaps_is_taken_off_whole() {
        let plane = |i: usize| {
            if i % 7 == 2 { f32::NAN } else { 0.25 + 0.5 * (i % 20) as f32 - 0.125 * (i / 20) as f32 }
        };
        let values: Vec<f32> = (0..300).map(plane).collect();
        let flat = Detrend::Plane.applied(&values, 20).unwrap();
        assert!(flat.iter().zip(&values).all(|(f, v)| f.is_nan() == v.is_nan() && (f.is_nan() || f.abs() < 1e-5)));
        assert!(Detrend::Mean.applied(&values, 20).is_none() && Detrend::Plane.applied(&values[..20], 20).is_none());
    }
}
