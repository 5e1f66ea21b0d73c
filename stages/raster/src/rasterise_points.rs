//! Elevation grids by the points in each cell: their median, the one nearest to its centre, and how many there are.

use rayon::prelude::*;

use super::rasterise::place;
use super::shape::{Moved, Shape};
use rockface_core::artefact::Grid;

/// Median Z of the points in each cell, metres, by row from the top; the mean of the two middle ones of an even number; NaN
/// where a cell has fewer than `minimum_points`. Same bits at any thread count.
pub fn median(shape: Shape, moved: Option<&Moved>, grid: &Grid, minimum_points: u32) -> Vec<f32> {
    let places = (0..shape.places()).into_par_iter();
    let found = places.map(|i| place(grid, shape.point(i, moved))).filter(|(cell, _)| (*cell as usize) < grid.cells());
    let mut points: Vec<(u32, f64)> = found.collect();
    points.par_sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let mut values = vec![f32::NAN; grid.cells()];
    for group in points.chunk_by(|a, b| a.0 == b.0) {
        let count = group.len();
        if count >= minimum_points as usize {
            values[group[0].0 as usize] = (0.5 * (group[(count - 1) / 2].1 + group[count / 2].1)) as f32;
        }
    }
    values
}

/// Z of the point in each cell that is nearest to its centre in X and Y, metres, by row from the top, the first of several;
/// NaN where a cell has fewer than `minimum_points`.
pub fn nearest(shape: Shape, moved: Option<&Moved>, grid: &Grid, minimum_points: u32) -> Vec<f32> {
    let mut cells = vec![(f64::INFINITY, f64::NAN, 0u32); grid.cells()];
    for i in 0..shape.places() {
        let point = shape.point(i, moved);
        let (cell, z) = place(grid, point);
        if let Some((nearest, value, count)) = cells.get_mut(cell as usize) {
            let (x, y) = grid.centre(cell as usize / grid.columns, cell as usize % grid.columns);
            let distance2 = (point[0] - x) * (point[0] - x) + (point[1] - y) * (point[1] - y);
            if distance2 < *nearest {
                (*nearest, *value) = (distance2, z);
            }
            *count += 1;
        }
    }
    cells.iter().map(|(_, z, count)| if *count >= minimum_points { *z as f32 } else { f32::NAN }).collect()
}

/// How many points each cell has, by row from the top.
pub fn counts(shape: Shape, moved: Option<&Moved>, grid: &Grid) -> Vec<f32> {
    let mut counts = vec![0u32; grid.cells()];
    for i in 0..shape.places() {
        if let Some(count) = counts.get_mut(place(grid, shape.point(i, moved)).0 as usize) {
            *count += 1;
        }
    }
    counts.into_iter().map(|count| count as f32).collect()
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // to the bit
mod tests {
    use super::*;
    use rockface_core::artefact::{Cloud, Frame};

    fn cloud() -> Cloud {
        // One cell with four points, one with three, one with one, one with none.
        let points = vec![
            [0.1, 1.1, 5.0],
            [0.4, 1.6, 1.0],
            [0.9, 1.9, 2.0],
            [0.5, 1.4, 9.0],
            [1.2, 1.2, -1.0],
            [1.9, 1.9, 7.0],
            [1.5, 1.5, 3.0],
            [0.5, 0.5, 4.0],
            [5.0, 5.0, 8.0],
        ];
        Cloud::new(Frame::Wall, points)
    }

    fn same(values: &[f32], expected: &[f32]) -> bool {
        values.len() == expected.len() && values.iter().zip(expected).all(|(a, b)| a == b || a.is_nan() && b.is_nan())
    }

    #[test]
    fn cells_have_the_median_the_nearest_and_the_number_of_their_points() {
        let (cloud, nan) = (cloud(), f32::NAN);
        let (shape, grid) = (Shape::Cloud(&cloud), Grid { columns: 2, rows: 2, cell_m: 1.0, left_m: 0.0, top_m: 2.0 });
        assert!(same(&median(shape, None, &grid, 1), &[3.5, 3.0, 4.0, nan]));
        assert!(same(&median(shape, None, &grid, 4), &[3.5, nan, nan, nan]));
        assert!(same(&nearest(shape, None, &grid, 1), &[9.0, 3.0, 4.0, nan]));
        assert!(same(&nearest(shape, None, &grid, 2), &[9.0, 3.0, nan, nan]));
        assert!(same(&counts(shape, None, &grid), &[4.0, 3.0, 1.0, 0.0]));
    }

    #[test]
    fn of_points_equally_near_to_the_centre_the_first_counts() {
        let grid = Grid { columns: 1, rows: 1, cell_m: 1.0, left_m: 0.0, top_m: 1.0 };
        let of = |points: Vec<[f64; 3]>| nearest(Shape::Cloud(&Cloud::new(Frame::Wall, points)), None, &grid, 1);
        let (left, right) = ([0.25, 0.5, 1.0], [0.75, 0.5, 2.0]);
        assert_eq!(of(vec![left, right]), [1.0]);
        assert_eq!(of(vec![right, left]), [2.0]);
    }
}
