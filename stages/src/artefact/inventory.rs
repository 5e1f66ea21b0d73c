//! A rockfall inventory: outline and properties of each event or piece, kept as GeoJSON, with the properties as CSV.

use super::{Artefact, Cell, CodecError, Export, Frame, Kind, Noun, Table};

/// A polygon: rings of (x, y) without the repetition of the first point that files have.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Polygon {
    /// The outer ring, metres, counter-clockwise.
    pub exterior: Vec<[f64; 2]>,
    /// Holes, metres, clockwise.
    pub holes: Vec<Vec<[f64; 2]>>,
}

/// One rockfall.
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
    /// The rockfalls.
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

impl Noun for Inventory {
    const KIND: Kind = Kind::Inventory;
    fn of(artefact: &Artefact) -> Option<&Self> {
        if let Artefact::Inventory(value) = artefact { Some(value) } else { None }
    }
    fn encode(&self) -> Result<Vec<u8>, CodecError> {
        crate::kernel::inventory_file::write(self)
    }
    fn decode(bytes: &[u8]) -> Result<Self, CodecError> {
        crate::kernel::inventory_file::read(bytes)
    }
    fn sketches(&self) -> Vec<super::Sketch> {
        vec![crate::kernel::sketch::of_table(&self.table())]
    }
    fn memory_bytes(&self) -> usize {
        let ring = |ring: &Vec<[f64; 2]>| ring.len() * 16;
        let polygon = |polygon: &Polygon| ring(&polygon.exterior) + polygon.holes.iter().map(ring).sum::<usize>();
        let outlines: usize = self.features.iter().flat_map(|feature| &feature.outline).map(polygon).sum();
        outlines + self.features.len() * self.columns.len() * size_of::<Cell>()
    }
    fn has_exports() -> bool {
        true
    }
    fn exports(&self, stem: &str) -> Result<Vec<Export>, CodecError> {
        let table = self.table();
        let csv = Export { path: format!("{stem}.csv"), bytes: table.to_csv()? };
        #[cfg(feature = "parquet")]
        let parquet = [Export { path: format!("{stem}.parquet"), bytes: crate::kernel::parquet_file::write(&table)? }];
        #[cfg(not(feature = "parquet"))]
        let parquet = [];
        Ok([csv].into_iter().chain(parquet).collect())
    }
}
