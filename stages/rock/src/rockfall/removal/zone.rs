//! The safe zone: the cells of a raster where rock face may come away.

use super::face::Rect;
use super::measure::height_in;
use crate::rockfall::ground_truth::Facets;
use rockface_core::StageError;
use rockface_core::artefact::{Band, Grid, Raster};

/// The band of a zone: the one called `zone`, or the only one.
pub fn zone_band(raster: &Raster) -> Result<&Band, StageError> {
    let named = raster.bands.iter().find(|band| band.name == "zone");
    match (named, raster.bands.as_slice()) {
        (Some(band), _) | (None, [band]) => Ok(band),
        (None, bands) => Err(StageError::new(format!("the zone has {} bands, and none is called `zone`", bands.len()))),
    }
}

/// Cells of a raster that are not 0.
#[derive(Debug, Clone, Copy)]
pub struct Zone<'a> {
    grid: Grid,
    values: &'a [f32],
}

impl<'a> Zone<'a> {
    /// The zone of a raster.
    pub fn new(raster: &'a Raster) -> Result<Self, StageError> {
        Ok(Self { grid: raster.grid, values: &zone_band(raster)?.values })
    }

    /// Whether a point lies in a cell of the zone.
    pub fn has(&self, x: f64, y: f64) -> bool {
        self.grid.cell_of([x, y]).is_some_and(|cell| self.values[cell] > 0.0)
    }

    /// Whether a surface lies in the zone: its vertices, and every cell whose centre it covers.
    pub fn holds(&self, surface: &Facets) -> bool {
        surface.vertices.iter().all(|v| self.has(v[0], v[1]))
            && surface.triangles.iter().all(|t| self.holds_triangle(t.map(|v| surface.vertices[v as usize])))
    }

    fn holds_triangle(&self, corners: [[f64; 3]; 3]) -> bool {
        let rect = Rect::around(&corners);
        let cell = |x: f64, count: usize| (x.max(0.0) as usize).min(count.saturating_sub(1));
        let [first_column, first_row] = self.grid.in_cells([rect.low[0], rect.high[1]]);
        let [last_column, last_row] = self.grid.in_cells([rect.high[0], rect.low[1]]);
        let columns = cell(first_column, self.grid.columns)..=cell(last_column, self.grid.columns);
        (cell(first_row, self.grid.rows)..=cell(last_row, self.grid.rows)).all(|r| {
            columns.clone().all(|c| {
                let (x, y) = self.grid.centre(r, c);
                self.values[r * self.grid.columns + c] > 0.0 || height_in(corners, x, y).is_none()
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Frame;
    use rockface_core::testing::height_mesh;

    #[test]
    fn a_surface_must_cover_no_cell_outside() {
        let grid = Grid { columns: 10, rows: 10, cell_m: 1.0, left_m: 0.0, top_m: 10.0 };
        let mut values = vec![1.0; 100];
        values[5 * 10 + 5] = 0.0;
        let raster = Raster::single(grid, Frame::Wall, "mask", "zone", values);
        let zone = Zone::new(&raster).unwrap();
        let surface = |rect: [f64; 4]| {
            let mesh = height_mesh(1, rect, |_, _| 0.0);
            Facets { vertices: mesh.vertices, triangles: mesh.triangles }
        };
        assert!(zone.holds(&surface([0.5, 4.5, 0.5, 9.5])));
        assert!(!zone.holds(&surface([0.5, 9.5, 0.5, 9.5])), "the hole in the middle");
        assert!(!zone.holds(&surface([-0.5, 1.5, 0.5, 1.5])), "beside the raster");
        assert!(zone.has(5.5, 5.5) && !zone.has(5.5, 4.5) && !zone.has(5.5, 10.5));
    }
}
