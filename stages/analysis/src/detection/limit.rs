//! Limits of detection on rasters: from the spread of the difference itself, or from registration error and roughness.

use rayon::prelude::*;
use rockface_core::numerics::normal::NORMAL_95;
use rockface_core::numerics::{marginal, quantile};

/// Cells a local plane needs: three for the plane, three for the spread about it.
const LEAST_CELLS: f64 = 6.0;
/// How registration error and roughness of both surfaces make one limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Combination {
    /// 1.96 sqrt(s1^2 + s2^2 + registration^2).
    Quadrature,
    /// 1.96 (sqrt(s1^2 + s2^2) + registration): Lague, Brodu and Leroux (2013), equation 1, for single cells.
    Lague,
}

/// Limits that are less than this share of 1.96 times the spread are low: estimates of either differ by some percent.
const LOW: f64 = 1.0 / 1.15;

/// What to say of limits that are clearly less than 1.96 times the spread (NMAD) of the changes, cell by cell: far more than 5 % of what did
/// not change lies beyond. Limits and changes in metres; cells without either do not count.
pub fn low(limits_m: &[f32], changes_m: &[f32]) -> Option<String> {
    let known = || limits_m.iter().zip(changes_m).filter(|(limit, change)| **limit > 0.0 && !change.is_nan());
    let ratios: Vec<f32> = known().map(|(limit, change)| change / limit).collect();
    let spread = marginal::nmad(&ratios);
    if spread.is_nan() || NORMAL_95 * spread * LOW <= 1.0 {
        return None;
    }
    let mut limits: Vec<f64> = known().map(|(limit, _)| f64::from(*limit)).collect();
    let median_mm = 1e3 * quantile::median(&mut limits)?;
    Some(format!(
        "the limits of detection, {median_mm:.1} mm in the median, are {:.1} times too small for the spread (NMAD) of the changes",
        NORMAL_95 * spread
    ))
}

/// The limit of a cell from the roughness of both surfaces and the registration error, all in metres.
pub fn combined(first_m: f64, second_m: f64, registration_m: f64, how: Combination) -> f64 {
    let squares = first_m * first_m + second_m * second_m;
    match how {
        Combination::Quadrature => NORMAL_95 * (squares + registration_m * registration_m).sqrt(),
        Combination::Lague => NORMAL_95 * (squares.sqrt() + registration_m),
    }
}

/// Roughness of an elevation raster: the standard deviation (n - 3) about the least-squares plane of the cells within
/// `reach` rows and columns, metres; NaN where fewer than 6 of them have a value, or the cell itself has none.
pub fn roughness(values: &[f32], columns: usize, reach: usize) -> Vec<f32> {
    let rows = values.len() / columns.max(1);
    let cell = |place: usize| {
        let (row, column) = (place / columns, place % columns);
        let centre = f64::from(values[place]);
        let mut sums = Sums::default();
        for r in row.saturating_sub(reach)..=(row + reach).min(rows - 1) {
            for c in column.saturating_sub(reach)..=(column + reach).min(columns - 1) {
                let z = f64::from(values[r * columns + c]) - centre;
                if !z.is_nan() {
                    sums.add(c as f64 - column as f64, r as f64 - row as f64, z);
                }
            }
        }
        sums.deviation() as f32
    };
    (0..values.len()).into_par_iter().with_min_len(1024).map(cell).collect()
}

/// Sums of a least-squares plane.
#[derive(Default)]
struct Sums {
    n: f64,
    x: f64,
    y: f64,
    z: f64,
    xx: f64,
    xy: f64,
    yy: f64,
    xz: f64,
    yz: f64,
    zz: f64,
}

impl Sums {
    fn add(&mut self, x: f64, y: f64, z: f64) {
        self.n += 1.0;
        self.x += x;
        self.y += y;
        self.z += z;
        self.xx += x * x;
        self.xy += x * y;
        self.yy += y * y;
        self.xz += x * z;
        self.yz += y * z;
        self.zz += z * z;
    }

    fn deviation(&self) -> f64 {
        if self.n < LEAST_CELLS {
            return f64::NAN;
        }
        let n = self.n;
        let (xx, xy, yy) =
            (self.xx - self.x * self.x / n, self.xy - self.x * self.y / n, self.yy - self.y * self.y / n);
        let (xz, yz) = (self.xz - self.x * self.z / n, self.yz - self.y * self.z / n);
        let zz = self.zz - self.z * self.z / n;
        let determinant = xx * yy - xy * xy;
        // Cells on one line leave a plane free to turn about it.
        if determinant < 1e-9 {
            return f64::NAN;
        }
        let (a, b) = ((yy * xz - xy * yz) / determinant, (xx * yz - xy * xz) / determinant);
        ((zz - a * xz - b * yz).max(0.0) / (n - 3.0)).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_below_the_noise_are_low_and_the_change_of_a_few_cells_makes_none_so() {
        // Quantiles of a normal value, without their tails.
        let mut changes: Vec<f32> = (0..2000).map(|i| 0.01 * ((i % 100) as f32 / 50.0 - 1.0)).collect();
        let spread = marginal::nmad(&changes) as f32;
        changes[..100].fill(-0.5);
        let at = |factor: f32| low(&vec![factor * spread; 2000], &changes);
        assert!(at(1.96).is_none() && at(1.8).is_none());
        assert!(at(1.0).unwrap().contains("times too small"));
        assert!(low(&[0.01], &[f32::NAN]).is_none() && low(&[], &[]).is_none());
    }

    #[test]
    fn a_tilted_plane_is_smooth_and_a_checkerboard_is_rough() {
        let tilted: Vec<f32> = (0..100u8).map(|i| f32::from(i % 10) * 0.5 - f32::from(i / 10) * 0.25).collect();
        assert!(roughness(&tilted, 10, 2).iter().all(|s| *s < 1e-6));
        let rough: Vec<f32> = (0..100u8).map(|i| if (i % 10 + i / 10) % 2 == 0 { 0.1 } else { -0.1 }).collect();
        // 13 of the 25 cells at one height and 12 at the other: by hand, sqrt((25 - 1/25) 0.01 / 22).
        let expected = ((25.0f64 - 1.0 / 25.0) * 0.01 / 22.0).sqrt();
        assert!((f64::from(roughness(&rough, 10, 2)[44]) - expected).abs() < 1e-6);
    }

    #[test]
    fn too_few_cells_have_no_roughness() {
        let mut values = vec![f32::NAN; 25];
        (0..5).for_each(|i| values[i] = 1.0);
        assert!(roughness(&values, 5, 2).iter().all(|s| s.is_nan()));
        values[7] = 2.0;
        let found = roughness(&values, 5, 2);
        assert!(found[7] < 1e-6 && found[24].is_nan(), "a plane through a line and a point is exact: {}", found[7]);
    }

    #[test]
    fn limits_by_hand() {
        let near = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-12, "{found}");
        near(combined(0.003, 0.004, 0.012, Combination::Quadrature), 1.96 * 0.013);
        near(combined(0.003, 0.004, 0.012, Combination::Lague), 1.96 * 0.017);
    }
}
