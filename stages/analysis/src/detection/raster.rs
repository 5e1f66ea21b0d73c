//! Clusters of cells of a difference raster as what was found.

use nalgebra::Vector3;
use rockface_core::artefact::Grid;

use super::found::Found;

/// How many whole steps cover a length (or area), rounded up; a whole multiple is not rounded further for its last digit.
pub fn whole_cells(length: f64, step: f64) -> usize {
    (length / step - 1e-6).ceil().max(0.0) as usize
}

/// Measures a cluster. `surface` gives the elevation before and the signed change of a cell, metres; `limits_m` the limit
/// of detection of every cell of the grid, `factor` times its standard deviation.
pub fn cluster(
    grid: &Grid,
    cells: &[usize],
    surface: impl Fn(usize) -> (f64, f64),
    limits_m: &[f32],
    factor: f64,
) -> Found {
    let area_m2 = grid.cell_m * grid.cell_m;
    let (mut sum, mut deviation, mut deepest, mut score) = (0.0, 0.0, 0.0f64, 0.0f64);
    let (mut points, mut moment) = (Vec::with_capacity(8 * cells.len()), Vector3::zeros());
    for cell in cells {
        let (before, change) = surface(*cell);
        let limit = f64::from(limits_m[*cell]);
        sum += change.abs();
        deviation += limit / factor;
        deepest = deepest.max(change.abs());
        score = score.max(change.abs() / limit);
        let (x, y) = grid.centre(cell / grid.columns, cell % grid.columns);
        moment += change.abs() * Vector3::new(x, y, before + 0.5 * change);
        points.extend(corners([x, y, before], [0.0, 0.0, 1.0], change, 0.5 * grid.cell_m));
    }
    Found {
        cells: cells.iter().map(|cell| (cell / grid.columns, cell % grid.columns)).collect(),
        area_m2: None,
        volume_m3: sum * area_m2,
        volume_sd_m3: deviation * area_m2,
        depth_max_m: deepest,
        depth_mean_m: sum / cells.len().max(1) as f64,
        score,
        centroid_m: (moment / sum).into(),
        points,
    }
}

/// Corners of a square in plan around a point, and the same a distance along a normal, metres.
pub fn corners([x, y, z]: [f64; 3], normal: [f64; 3], distance_m: f64, half_m: f64) -> [[f64; 3]; 8] {
    let [dx, dy, dz] = normal.map(|n| n * distance_m);
    let corner = |(a, b): (f64, f64), far: f64| [x + a * half_m + far * dx, y + b * half_m + far * dy, z + far * dz];
    let square = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
    std::array::from_fn(|i| corner(square[i % 4], if i < 4 { 0.0 } else { 1.0 }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_rounded_up_but_not_for_a_last_digit() {
        assert_eq!([0.04, 0.05, 0.06, 0.0].map(|width| whole_cells(width, 0.02)), [2, 3, 3, 0]);
        assert_eq!(whole_cells(0.0016, 0.02 * 0.02), 4);
    }

    #[test]
    fn a_cluster_by_hand() {
        let grid = Grid { columns: 4, rows: 2, cell_m: 0.5, left_m: 0.0, top_m: 1.0 };
        let found = cluster(&grid, &[1, 2, 6], |cell| (10.0, -0.1 * cell as f64), &[0.05; 8], 1.96);
        assert!((found.volume_m3 - 0.25 * 0.9).abs() < 1e-12 && (found.depth_mean_m - 0.3).abs() < 1e-12);
        assert!((found.volume_sd_m3 - 0.25 * 0.15 / 1.96).abs() < 1e-9 && (found.score - 12.0).abs() < 1e-6);
        assert_eq!((found.cells[2], found.points.len()), ((1, 2), 24));
        assert!((found.points[4][2] - 9.9).abs() < 1e-12);
        // Weighted by the changes -0.1, -0.2 and -0.6.
        let expected =
            [(0.1 * 0.75 + 0.2 * 1.25 + 0.6 * 1.25) / 0.9, (0.3 * 0.75 + 0.6 * 0.25) / 0.9, 10.0 - 0.5 * 0.41 / 0.9];
        assert!((0..3).all(|axis| (found.centroid_m[axis] - expected[axis]).abs() < 1e-12), "{:?}", found.centroid_m);
    }
}
