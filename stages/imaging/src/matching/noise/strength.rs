//! Strength of the noise by place, estimated from rasters without change of the same site and survey.
//!
//! Ledges, cracks and poor texture stay in place from epoch to epoch, and so does the noise they cause: divided by its
//! deviation at each place, the noise of a matcher is close to normal. The map is the root of the mean square over rasters,
//! relative to its median (heteroscedasticity; compare Hugonnet et al. 2022, IEEE JSTARS 15, who regress it on slope).

use rockface_core::artefact::{Grid, Raster};
use rockface_core::numerics::gaussian::smoothed;
use rockface_core::numerics::quantile::median;

/// Largest factor: stronger noise would be a match to a wrong place.
const LARGEST: f32 = 30.0;

/// How the map is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimation {
    /// Deviation of the Gaussian whose smooth part is subtracted from each raster first, cells; 0: none.
    pub detrend_cells: f64,
    /// Deviation of the Gaussian the mean squares are smoothed with, cells; 0: none.
    pub smoothing_cells: f64,
    /// Fewest values of a cell that has a value in the map.
    pub least: usize,
}

/// Relative deviation of the noise at every cell, median 1; NaN where too few bands have a value. `None` without any.
pub fn strength(bands: &[&[f32]], columns: usize, how: &Estimation) -> Option<Vec<f32>> {
    let cells = bands.first()?.len();
    let (mut squares, mut counts) = (vec![0.0f64; cells], vec![0usize; cells]);
    for band in bands {
        let trend = (how.detrend_cells > 0.0).then(|| smoothed(band, columns, how.detrend_cells));
        for (i, value) in band.iter().enumerate().filter(|(_, value)| !value.is_nan()) {
            let rest = f64::from(*value) - trend.as_ref().map_or(0.0, |trend| trend[i]);
            (squares[i], counts[i]) = (squares[i] + rest * rest, counts[i] + 1);
        }
    }
    let known = |i: usize| counts[i] >= how.least.max(1);
    let mean = |i: usize| if known(i) { (squares[i] / counts[i] as f64) as f32 } else { f32::NAN };
    let variance: Vec<f32> = (0..cells).map(mean).collect();
    let smooth = (how.smoothing_cells > 0.0).then(|| smoothed(&variance, columns, how.smoothing_cells));
    let deviation = |i: usize| smooth.as_ref().map_or(f64::from(variance[i]), |smooth| smooth[i]).max(0.0).sqrt();
    let all: Vec<f64> = (0..cells).filter(|i| known(*i)).map(deviation).collect();
    let middle = median(&mut all.clone()).filter(|middle| *middle > 0.0)?;
    let factor = |i: usize| if known(i) { ((deviation(i) / middle) as f32).min(LARGEST) } else { f32::NAN };
    Some((0..cells).map(factor).collect())
}

/// A map of factors by place.
#[derive(Debug, Clone)]
pub struct Strength {
    grid: Grid,
    values: Vec<f32>,
    /// The factor up to which noise counts as noise of texture; the rest is noise of ledges.
    from: f64,
}

impl Strength {
    /// The first band of a raster; factors above `from` count as noise of ledges.
    pub fn new(raster: &Raster, from: f64) -> Self {
        Self { grid: raster.grid, values: raster.bands[0].values.clone(), from }
    }

    /// The factor of the cell of a place; 1 outside of the grid; in a hole of the map, the largest factor within two cells.
    pub fn at(&self, place: [f64; 2]) -> f64 {
        let Some(cell) = self.grid.cell_of(place) else { return 1.0 };
        let value = self.values[cell];
        if value.is_nan() { self.nearby(cell % self.grid.columns, cell / self.grid.columns) } else { f64::from(value) }
    }

    /// Holes of the map lie where noise is strongest.
    fn nearby(&self, column: usize, row: usize) -> f64 {
        let reach = |at: usize, size: usize| at.saturating_sub(2)..(at + 3).min(size);
        let rows = reach(row, self.grid.rows);
        let places = rows.flat_map(|r| reach(column, self.grid.columns).map(move |c| r * self.grid.columns + c));
        places.map(|i| f64::from(self.values[i])).filter(|v| !v.is_nan()).fold(1.0, f64::max)
    }

    /// Factors of the noise of texture and of that of ledges; their squares add up to that of [`Strength::at`].
    pub fn parts(&self, place: [f64; 2]) -> [f64; 2] {
        let factor = self.at(place);
        let texture = factor.min(self.from);
        [texture, (factor * factor - texture * texture).sqrt()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Frame;
    use rockface_core::numerics::random::Key;

    #[test]
    fn deviations_that_differ_by_place_come_back_whatever_the_level() {
        let (columns, rows) = (60, 40);
        let truth = |i: usize| if i % columns < 15 { 5.0 } else { 1.0 };
        let bands: Vec<Vec<f32>> = (0..30u8)
            .map(|b| {
                let field = Key([b; 32]).field();
                let draw = |i: usize| field.normal((i % columns) as i32, (i / columns) as i32);
                (0..columns * rows).map(|i| (0.01 * truth(i) * draw(i) + 3.0) as f32).collect()
            })
            .collect();
        let bands: Vec<&[f32]> = bands.iter().map(Vec::as_slice).collect();
        let how = Estimation { detrend_cells: 8.0, smoothing_cells: 2.0, least: 5 };
        let found = strength(&bands, columns, &how).unwrap();
        let at = |row: usize, column: usize| f64::from(found[row * columns + column]);
        assert!((at(20, 40) - 1.0).abs() < 0.1, "{}", at(20, 40));
        assert!((at(20, 5) - 5.0).abs() < 0.5, "{}", at(20, 5));
    }

    #[test]
    fn the_parts_add_up_in_squares_and_holes_take_the_worst_nearby() {
        let grid = Grid { columns: 10, rows: 10, cell_m: 0.1, left_m: 2.0, top_m: 1.0 };
        let mut values = vec![1.0f32; 100];
        (values[33], values[34]) = (f32::NAN, 4.0);
        let map = Strength::new(&Raster::single(grid, Frame::Wall, "strength", "", values), 1.5);
        assert!((map.at([2.35, 0.65]) - 4.0).abs() < 1e-6 && (map.at([9.0, 0.5]) - 1.0).abs() < 1e-12);
        let [texture, ledge] = map.parts([2.45, 0.65]);
        assert!((texture - 1.5).abs() < 1e-6 && (texture * texture + ledge * ledge - 16.0).abs() < 1e-5);
        assert!(map.parts([2.05, 0.05])[1].abs() < 1e-9);
    }
}
