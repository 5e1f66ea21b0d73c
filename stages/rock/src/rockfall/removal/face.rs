//! A rock face while blocks are taken out of it: a mesh that grows and loses triangles, found by their place in X and Y.

use std::collections::BTreeMap;

use rayon::prelude::*;

/// Marks a triangle that is gone.
const GONE: u32 = u32::MAX;
/// Triangles a cell of the index holds on average when it is built.
const TRIANGLES_PER_CELL: f64 = 4.0;

/// An upright rectangle in X and Y, metres; both ends belong to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rect {
    /// Least X and Y.
    pub low: [f64; 2],
    /// Greatest X and Y.
    pub high: [f64; 2],
}

impl Rect {
    /// A rectangle without a point.
    pub const EMPTY: Self = Self { low: [f64::INFINITY; 2], high: [f64::NEG_INFINITY; 2] };

    /// The smallest rectangle around points.
    pub fn around<'a>(points: impl IntoIterator<Item = &'a [f64; 3]>) -> Self {
        points.into_iter().fold(Self::EMPTY, Self::with)
    }

    /// Grown to hold a point.
    #[must_use]
    pub fn with(self, p: &[f64; 3]) -> Self {
        Self {
            low: [self.low[0].min(p[0]), self.low[1].min(p[1])],
            high: [self.high[0].max(p[0]), self.high[1].max(p[1])],
        }
    }

    /// Grown to hold another rectangle.
    #[must_use]
    pub fn union(self, other: &Self) -> Self {
        Self {
            low: [self.low[0].min(other.low[0]), self.low[1].min(other.low[1])],
            high: [self.high[0].max(other.high[0]), self.high[1].max(other.high[1])],
        }
    }

    /// Grown by a margin on every side.
    #[must_use]
    pub fn grown(self, margin: f64) -> Self {
        Self { low: self.low.map(|x| x - margin), high: self.high.map(|x| x + margin) }
    }

    /// Whether the two have a point in common.
    pub fn overlaps(&self, other: &Self) -> bool {
        (0..2).all(|k| self.low[k] <= other.high[k] && other.low[k] <= self.high[k])
    }
}

/// A mesh under change with an index of its triangles by square cells over X and Y.
///
/// Vertices are only ever added, and so are triangles; what is removed is marked. A query costs what it finds, however
/// large the mesh.
pub struct Face {
    vertices: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    /// 0 for rock face, the number of the niche a triangle closes, or [`GONE`].
    niche: Vec<u32>,
    cells: Cells,
    /// Where the triangles of each cell start in `first`; one more than there are cells.
    starts: Vec<u32>,
    /// The triangles the face began with, by cell.
    first: Vec<u32>,
    /// Triangles added since, by cell.
    added: BTreeMap<u32, Vec<u32>>,
}

/// The cells over the extent the mesh began with.
#[derive(Clone, Copy)]
struct Cells {
    low: [f64; 2],
    side: f64,
    count: [usize; 2],
}

impl Cells {
    fn new(rect: &Rect, triangles: usize) -> Self {
        let size = [0, 1].map(|k| (rect.high[k] - rect.low[k]).max(0.0));
        let wanted = (triangles as f64 / TRIANGLES_PER_CELL).max(1.0);
        let by_area = (size[0] * size[1] / wanted).sqrt();
        let side = by_area.max(size[0].max(size[1]) / wanted);
        let side = if side > 0.0 && side.is_finite() { side } else { 1.0 };
        Self { low: rect.low, side, count: size.map(|s| (s / side) as usize + 1) }
    }

    /// Columns and rows a rectangle reaches; what lies outside falls into the cells of the rim.
    fn span(&self, rect: &Rect) -> [std::ops::RangeInclusive<usize>; 2] {
        [0, 1].map(|k| {
            let cell = |x: f64| (((x - self.low[k]) / self.side).max(0.0) as usize).min(self.count[k] - 1);
            cell(rect.low[k])..=cell(rect.high[k])
        })
    }

    fn each(&self, rect: &Rect, mut visit: impl FnMut(usize)) {
        let [columns, rows] = self.span(rect);
        for row in rows {
            for column in columns.clone() {
                visit(row * self.count[0] + column);
            }
        }
    }
}

impl Face {
    /// Indexes a mesh; every triangle must name vertices there are.
    pub fn new(vertices: Vec<[f64; 3]>, triangles: Vec<[u32; 3]>) -> Self {
        let cells = Cells::new(&Rect::around(&vertices), triangles.len());
        let rects: Vec<Rect> =
            triangles.par_iter().map(|t| Rect::around(t.iter().map(|v| &vertices[*v as usize]))).collect();
        let mut starts = vec![0u32; cells.count[0] * cells.count[1] + 1];
        for rect in &rects {
            cells.each(rect, |cell| starts[cell + 1] += 1);
        }
        for cell in 1..starts.len() {
            starts[cell] += starts[cell - 1];
        }
        let mut next = starts.clone();
        let mut first = vec![0; starts.last().map_or(0, |n| *n as usize)];
        for (triangle, rect) in rects.iter().enumerate() {
            cells.each(rect, |cell| {
                first[next[cell] as usize] = triangle as u32;
                next[cell] += 1;
            });
        }
        let niche = vec![0; triangles.len()];
        Self { vertices, triangles, niche, cells, starts, first, added: BTreeMap::new() }
    }

    /// All vertices there ever were, metres.
    pub fn vertices(&self) -> &[[f64; 3]] {
        &self.vertices
    }

    /// The place of a vertex, metres.
    pub fn vertex(&self, vertex: u32) -> [f64; 3] {
        self.vertices[vertex as usize]
    }

    /// The vertices of a triangle.
    pub fn triangle(&self, triangle: u32) -> [u32; 3] {
        self.triangles[triangle as usize]
    }

    /// The niche a triangle closes; 0 for rock face.
    pub fn niche(&self, triangle: u32) -> u32 {
        self.niche[triangle as usize]
    }

    /// The rectangle around a triangle.
    pub fn rect(&self, triangle: u32) -> Rect {
        Rect::around(self.triangle(triangle).iter().map(|v| &self.vertices[*v as usize]))
    }

    /// The triangles whose rectangle has a point in common with this one, in ascending order.
    pub fn query(&self, rect: &Rect) -> Vec<u32> {
        let mut found = Vec::new();
        self.cells.each(rect, |cell| {
            found.extend_from_slice(&self.first[self.starts[cell] as usize..self.starts[cell + 1] as usize]);
            found.extend(self.added.get(&(cell as u32)).into_iter().flatten());
        });
        found.sort_unstable();
        found.dedup();
        found.retain(|t| self.niche[*t as usize] != GONE && self.rect(*t).overlaps(rect));
        found
    }

    /// Takes triangles away and adds vertices and triangles, each with the niche it closes (0: none). Returns the number
    /// of the first vertex added; `triangles` receives it and names its vertices.
    pub fn replace(
        &mut self,
        removed: &[u32],
        vertices: &[[f64; 3]],
        triangles: impl FnOnce(u32) -> Vec<([u32; 3], u32)>,
    ) -> u32 {
        for triangle in removed {
            self.niche[*triangle as usize] = GONE;
        }
        let base = self.vertices.len() as u32;
        self.vertices.extend_from_slice(vertices);
        for (corners, niche) in triangles(base) {
            let number = self.triangles.len() as u32;
            self.triangles.push(corners);
            self.niche.push(niche);
            let rect = self.rect(number);
            let added = &mut self.added;
            self.cells.each(&rect, |cell| added.entry(cell as u32).or_default().push(number));
        }
        base
    }

    /// All vertices there ever were, and the triangles that are left, in the order they came.
    pub fn into_mesh(self) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
        let left = self.triangles.into_iter().zip(self.niche).filter(|(_, niche)| *niche != GONE);
        (self.vertices, left.map(|(triangle, _)| triangle).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::testing::height_mesh;

    fn face() -> Face {
        let mesh = height_mesh(20, [0.0, 2.0, 0.0, 2.0], |x, y| x * y);
        Face::new(mesh.vertices, mesh.triangles)
    }

    #[test]
    fn a_query_finds_what_a_search_of_all_finds() {
        let face = face();
        for (x, y, size) in [(0.3, 0.4, 0.01), (-1.0, -1.0, 0.5), (1.9, 0.2, 0.7), (0.5, 0.5, 0.0), (0.0, 0.0, 2.0)] {
            let rect = Rect { low: [x, y], high: [x + size, y + size] };
            let all: Vec<u32> = (0..face.triangles.len() as u32).filter(|t| face.rect(*t).overlaps(&rect)).collect();
            assert_eq!(face.query(&rect), all, "{rect:?}");
        }
    }

    #[test]
    fn what_is_replaced_is_found_and_what_is_gone_is_not() {
        let mut face = face();
        let rect = Rect { low: [0.95, 0.95], high: [1.05, 1.05] };
        let before = face.query(&rect);
        let base = face.replace(&before, &[[1.0, 1.0, 5.0]], |base| vec![([0, 1, base], 3)]);
        assert_eq!(base, 21 * 21);
        assert_eq!(face.query(&rect), [800]);
        assert_eq!((face.niche(800), face.triangle(800)), (3, [0, 1, 441]));
        let (vertices, triangles) = face.into_mesh();
        assert_eq!((vertices.len(), triangles.len()), (442, 801 - before.len()));
    }
}
