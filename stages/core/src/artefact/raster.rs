//! Bands on a square grid, kept as GeoTIFF: elevations, differences, masks, stacks of them.

use super::Frame;
use std::ops::Range;

/// A square grid. Row 0 is at the top; cell (row, column) covers
/// `left + column cell .. left + (column + 1) cell` by `top - (row + 1) cell .. top - row cell`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// Number of columns, along X.
    pub columns: usize,
    /// Number of rows, from the top down.
    pub rows: usize,
    /// Side of a cell, metres.
    pub cell_m: f64,
    /// X of the left edge, metres.
    pub left_m: f64,
    /// Y of the top edge, metres.
    pub top_m: f64,
}

impl Grid {
    /// Number of cells: columns times rows.
    pub fn cells(&self) -> usize {
        self.columns * self.rows
    }

    /// Centre of a cell, metres.
    pub fn centre(&self, row: usize, column: usize) -> (f64, f64) {
        (self.left_m + (column as f64 + 0.5) * self.cell_m, self.top_m - (row as f64 + 0.5) * self.cell_m)
    }

    /// Cells from the upper left corner of the grid to a place (X, Y in metres): to the right and down.
    #[inline(always)]
    pub fn in_cells(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [(x - self.left_m) / self.cell_m, (self.top_m - y) / self.cell_m]
    }

    /// The number of the cell that a place (X, Y in metres) is in, by row from the top; `None` beside the grid and where a coordinate
    /// is NaN. A cell has its left and its upper edge.
    #[inline(always)]
    pub fn cell_of(&self, place: [f64; 2]) -> Option<usize> {
        let [column, row] = self.in_cells(place);
        let inside = column >= 0.0 && row >= 0.0 && column < self.columns as f64 && row < self.rows as f64;
        inside.then(|| row as usize * self.columns + column as usize)
    }

    /// Its left, right, bottom and top edge, metres.
    pub fn extent_m(&self) -> [f64; 4] {
        let [width_m, height_m] = [self.columns, self.rows].map(|cells| cells as f64 * self.cell_m);
        [self.left_m, self.left_m + width_m, self.top_m - height_m, self.top_m]
    }

    /// The part of it that has these columns and rows.
    #[must_use]
    pub fn part(&self, columns: Range<usize>, rows: Range<usize>) -> Self {
        Self {
            columns: columns.len(),
            rows: rows.len(),
            cell_m: self.cell_m,
            left_m: self.left_m + columns.start as f64 * self.cell_m,
            top_m: self.top_m - rows.start as f64 * self.cell_m,
        }
    }
}

/// How cells are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sample {
    /// 32-bit float, NaN where there is no value.
    Float,
    /// One byte: masks; every value is a whole number from 0 to 255.
    Byte,
    /// Two bytes: labels; every value is a whole number from 0 to 65535.
    Word,
}

impl Sample {
    /// The largest whole number it holds; `None` for [`Sample::Float`].
    pub fn largest(self) -> Option<u16> {
        match self {
            Self::Float => None,
            Self::Byte => Some(u16::from(u8::MAX)),
            Self::Word => Some(u16::MAX),
        }
    }

    /// The narrower of the two that holds the values of both.
    #[must_use]
    pub fn common(self, other: Self) -> Self {
        match (self, other) {
            (Self::Float, _) | (_, Self::Float) => Self::Float,
            (Self::Word, _) | (_, Self::Word) => Self::Word,
            (Self::Byte, Self::Byte) => Self::Byte,
        }
    }
}

/// One layer of values on the grid of a raster.
#[derive(Debug, Clone, PartialEq)]
pub struct Band {
    /// Its name, such as `elevation`; stages find a band by it.
    pub name: String,
    /// Values by row from the top, `rows x columns`.
    pub values: Vec<f32>,
}

/// One or more bands on one grid.
#[derive(Debug, Clone)]
pub struct Raster {
    /// The grid, shared by all bands.
    pub grid: Grid,
    /// The frame X and Y of the grid are in.
    pub frame: Frame,
    /// What the values are: `elevation`, `difference`, `mask`, ... with `_m` units implied for the first two.
    pub quantity: String,
    /// How cells are stored.
    pub sample: Sample,
    /// The bands, at least one.
    pub bands: Vec<Band>,
}

impl Raster {
    /// A raster of one float band.
    pub fn single(grid: Grid, frame: Frame, quantity: &str, name: &str, values: Vec<f32>) -> Self {
        let bands = vec![Band { name: name.to_owned(), values }];
        Self { grid, frame, quantity: quantity.to_owned(), sample: Sample::Float, bands }
    }
}

/// Equal grids, names and bits: NaN equals NaN.
impl PartialEq for Raster {
    fn eq(&self, other: &Self) -> bool {
        let bits = |raster: &Self| -> Vec<(String, Vec<u32>)> {
            raster.bands.iter().map(|b| (b.name.clone(), b.values.iter().map(|v| v.to_bits()).collect())).collect()
        };
        self.grid == other.grid
            && self.frame == other.frame
            && self.quantity == other.quantity
            && self.sample == other.sample
            && bits(self) == bits(other)
    }
}
