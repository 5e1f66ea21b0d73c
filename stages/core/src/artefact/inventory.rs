//! A rockfall inventory: outline and properties of each event or piece, kept as GeoJSON, with the properties as CSV.

use super::{Cell, Frame, Table};

/// A polygon: rings of (x, y) without the repetition of the first point that files have.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Polygon {
    /// The outer ring, metres, counter-clockwise.
    pub exterior: Vec<[f64; 2]>,
    /// Holes, metres, clockwise.
    pub holes: Vec<Vec<[f64; 2]>>,
}

/// One rockfall or piece of it, with its outline and properties.
#[derive(Debug, Clone, PartialEq)]
pub struct Feature {
    /// Its outline in the X and Y of the inventory's frame; several polygons where it has several pieces, none where it
    /// cannot be seen along Z.
    pub outline: Vec<Polygon>,
    /// One cell a column.
    pub values: Vec<Cell>,
}

/// Rockfalls with their outlines and properties.
#[derive(Debug, Clone, PartialEq)]
pub struct Inventory {
    /// The frame of the outlines. Coordinates are metres in that frame and no longitudes and latitudes.
    pub frame: Frame,
    /// Names of the properties, unit in the name where there is one.
    pub columns: Vec<String>,
    /// The rockfalls, each with as many values as there are columns.
    pub features: Vec<Feature>,
}

impl Inventory {
    /// Position of a column.
    pub fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column == name)
    }

    /// The numbers of a column, `None` where a feature has none there; `None` without the column.
    pub fn numbers(&self, name: &str) -> Option<Vec<Option<f64>>> {
        let column = self.column(name)?;
        Some(self.features.iter().map(|feature| feature.values[column].number()).collect())
    }

    /// The properties without the outlines.
    pub fn table(&self) -> Table {
        let rows = self.features.iter().map(|feature| feature.values.clone()).collect();
        Table { columns: self.columns.clone(), rows }
    }
}
