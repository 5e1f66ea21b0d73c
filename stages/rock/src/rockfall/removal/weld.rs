//! Gives the vertices of Boolean results one numbering with the patch they come from.

use std::collections::BTreeMap;

use super::boolean::{Origin, Shell};
use super::cut::Failure;
use super::patch::{Patch, less, more};

/// A shell in the numbering of the patch.
pub struct Welded {
    /// Numbers of the corners of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Where each comes from.
    pub origins: Vec<Origin>,
}

/// Side of the cells vertices are welded in, metres: far above the rounding of an intersection, far below any feature.
const WELD_M: f64 = 1e-10;

/// Gives the vertices of shells numbers: that of the patch where one lies at the same place to the bit, else that of a
/// vertex no farther than a cell, else a new one. The two Booleans may round one intersection differently.
pub struct Weld<'a> {
    patch: &'a Patch,
    /// Places of the vertices of the patch, then of the new ones, metres less the origin of the patch.
    pub places: Vec<[f64; 3]>,
    numbers: BTreeMap<[u64; 3], u32>,
    /// The first vertex in each cell.
    cells: BTreeMap<[i64; 3], u32>,
    /// Places where the patch has several vertices.
    twice: Vec<[u64; 3]>,
}

fn cell(place: [f64; 3]) -> [i64; 3] {
    place.map(|x| (x / WELD_M).floor() as i64)
}

fn bits(place: [f64; 3]) -> [u64; 3] {
    place.map(|x| (x + 0.0).to_bits())
}

impl<'a> Weld<'a> {
    /// Starts with the vertices of a patch.
    pub fn new(patch: &'a Patch) -> Self {
        let mut numbers = BTreeMap::new();
        let mut cells = BTreeMap::new();
        let mut twice = Vec::new();
        for (number, place) in patch.places.iter().enumerate() {
            cells.entry(cell(*place)).or_insert(number as u32);
            if numbers.insert(bits(*place), number as u32).is_some() {
                twice.push(bits(*place));
            }
        }
        Self { patch, places: patch.places.clone(), numbers, cells, twice }
    }

    /// Numbers the vertices of a shell; triangles that collapse are left out.
    pub fn shell(&mut self, shell: &Shell) -> Result<Welded, Failure> {
        let mut welded = Welded { triangles: Vec::new(), origins: Vec::new() };
        for (triangle, origin) in shell.triangles.iter().zip(&shell.origins) {
            let places = triangle.map(|v| shell.places[v as usize]);
            let [a, b, c] =
                [self.number(places[0], *origin)?, self.number(places[1], *origin)?, self.number(places[2], *origin)?];
            // An edge without length takes the two triangles beside it with it.
            if a != b && b != c && c != a {
                welded.triangles.push([a, b, c]);
                welded.origins.push(*origin);
            }
        }
        Ok(welded)
    }

    fn number(&mut self, place: [f64; 3], origin: Origin) -> Result<u32, Failure> {
        let key = bits(place);
        if self.twice.contains(&key) {
            return self.own_corner(key, origin).ok_or(Failure::Defect(more(place, self.patch.origin)));
        }
        if let Some(number) = self.numbers.get(&key).copied().or_else(|| self.near(place)) {
            return Ok(number);
        }
        let number = self.places.len() as u32;
        self.numbers.insert(key, number);
        self.cells.insert(cell(place), number);
        // Rounded as the face will hold it.
        self.places.push(less(more(place, self.patch.origin), self.patch.origin));
        Ok(number)
    }

    /// A vertex in the cell of a place or one beside it.
    fn near(&self, place: [f64; 3]) -> Option<u32> {
        let [x, y, z] = cell(place);
        let beside = (0..27i64).map(|n| [x + n % 3 - 1, y + n / 3 % 3 - 1, z + n / 9 - 1]);
        beside.filter_map(|cell| self.cells.get(&cell)).copied().next()
    }

    /// Where vertices coincide, the one that the source triangle itself has there.
    fn own_corner(&self, key: [u64; 3], origin: Origin) -> Option<u32> {
        let Origin::Rock(source) = origin else { return None };
        let corners = self.patch.triangles.get(source as usize)?;
        corners.iter().copied().find(|v| bits(self.patch.places[*v as usize]) == key)
    }
}
