//! The part of a rock face above and below a block, in coordinates about a near origin, and its closing to a solid.

use super::face::{Face, Rect};

/// Why a patch cannot be closed to a solid: an edge of three triangles or of two that are oriented against each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Faulty {
    /// A vertex of the edge, metres.
    pub near: [f64; 3],
}

/// A copy of the triangles whose rectangle in X and Y meets that of a block.
///
/// All of the column belongs to it, whatever its Z: then the winding number of a point of the block, counted along Z,
/// is that of the whole mesh, open or closed, with or without overhangs.
#[derive(Debug, Clone)]
pub struct Patch {
    /// Subtracted from the coordinates of the face, whole metres, so that nothing is lost.
    pub origin: [f64; 3],
    /// Places of the vertices less `origin`, metres.
    pub places: Vec<[f64; 3]>,
    /// The vertex of the face each of them is; none for those that refinement added.
    pub vertices: Vec<Option<u32>>,
    /// Triangles by index into `places`.
    pub triangles: Vec<[u32; 3]>,
    /// The triangle of the face each of them is; none for parts of one.
    pub sources: Vec<Option<u32>>,
    /// Triangles of the face that were cut up by refinement.
    pub consumed: Vec<u32>,
}

/// What closes a patch to a solid.
pub struct Closed {
    /// The places of the patch, then those added.
    pub places: Vec<[f64; 3]>,
    /// The triangles that were added, by index into `places`.
    pub triangles: Vec<[u32; 3]>,
}

impl Patch {
    /// Copies the triangles around `rect` (that of the block), about the whole metre nearest to `centre`.
    pub fn around(face: &Face, rect: &Rect, centre: [f64; 3]) -> Self {
        let origin = centre.map(f64::round);
        let found = face.query(rect);
        let mut vertices: Vec<u32> = found.iter().flat_map(|t| face.triangle(*t)).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let number = |v: u32| vertices.partition_point(|known| *known < v) as u32;
        Self {
            origin,
            places: vertices.iter().map(|v| less(face.vertex(*v), origin)).collect(),
            triangles: found.iter().map(|t| face.triangle(*t).map(number)).collect(),
            sources: found.iter().copied().map(Some).collect(),
            vertices: vertices.iter().copied().map(Some).collect(),
            consumed: Vec::new(),
        }
    }

    /// Edges that one triangle alone has, in its direction, ascending.
    pub fn border(&self) -> Result<Vec<[u32; 2]>, Faulty> {
        open_edges(&self.triangles).map_err(|edge| Faulty { near: more(self.places[edge[0] as usize], self.origin) })
    }

    /// The triangles that close the patch to a solid: walls straight down from its border to `bottom` (Z less origin), and
    /// a cone below them to one point a loop.
    pub fn close(&self, bottom: f64) -> Result<Closed, Faulty> {
        let mut places = self.places.clone();
        let mut closing = Vec::new();
        for ring in loops(&self.triangles, &self.border()?) {
            close_loop(&ring, bottom, &mut places, &mut closing);
        }
        Ok(Closed { places, triangles: closing })
    }
}

/// Walls and cone under one loop of border vertices, which runs with the rock to its left seen from above.
fn close_loop(ring: &[u32], bottom: f64, places: &mut Vec<[f64; 3]>, closing: &mut Vec<[u32; 3]>) {
    let base = places.len() as u32;
    let count = ring.len() as u32;
    let below: Vec<[f64; 3]> = ring.iter().map(|v| places[*v as usize]).map(|[x, y, _]| [x, y, bottom]).collect();
    let sum = below.iter().fold([0.0; 2], |sum, p| [sum[0] + p[0], sum[1] + p[1]]);
    let rect = Rect::around(&below);
    let reach = (rect.high[0] - rect.low[0]) + (rect.high[1] - rect.low[1]);
    places.extend(below);
    let n = f64::from(count);
    places.push([sum[0] / n, sum[1] / n, bottom - reach.max(1e-3)]);
    for k in 0..count {
        let next = (k + 1) % count;
        let (a, b) = (ring[k as usize], ring[next as usize]);
        let (low_a, low_b) = (base + k, base + next);
        closing.extend([[b, a, low_a], [b, low_a, low_b], [low_b, low_a, base + count]]);
    }
}

/// Directed edges whose reverse no triangle has, ascending; an edge that cannot be paired is the error.
pub fn open_edges(triangles: &[[u32; 3]]) -> Result<Vec<[u32; 2]>, [u32; 2]> {
    let mut edges: Vec<(u32, u32, bool)> = triangles
        .iter()
        .flat_map(|t| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]])
        .map(|[a, b]| (a.min(b), a.max(b), a > b))
        .collect();
    edges.sort_unstable();
    let mut open = Vec::new();
    for edge in edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        match edge {
            [(low, high, false)] => open.push([*low, *high]),
            [(low, high, true)] => open.push([*high, *low]),
            [one, other] if one.2 != other.2 => {}
            _ => return Err([edge[0].0, edge[0].1]),
        }
    }
    open.sort_unstable();
    Ok(open)
}

/// Chains border edges to closed loops. Where two parts of a patch touch in one vertex, a loop stays with its own part:
/// it goes on with the edge that ends the fan of triangles it came in on.
fn loops(triangles: &[[u32; 3]], border: &[[u32; 2]]) -> Vec<Vec<u32>> {
    let fans = Fans::new(triangles, border);
    let mut used = vec![false; border.len()];
    let mut found = Vec::new();
    for start in 0..border.len() {
        let mut ring = Vec::new();
        let mut edge = start;
        while !used[edge] {
            used[edge] = true;
            ring.push(border[edge][0]);
            match fans.next(border[edge]) {
                Some(next) => edge = next,
                None => break,
            }
        }
        if !ring.is_empty() {
            found.push(ring);
        }
    }
    found
}

/// Triangles by directed edge, to turn about the vertices of a border.
struct Fans<'a> {
    border: &'a [[u32; 2]],
    /// Directed edge and the third vertex of its triangle, ascending; only of triangles at border vertices.
    corners: Vec<([u32; 2], u32)>,
}

impl<'a> Fans<'a> {
    fn new(triangles: &[[u32; 3]], border: &'a [[u32; 2]]) -> Self {
        let mut rim: Vec<u32> = border.iter().map(|edge| edge[0]).collect();
        rim.dedup();
        let at_rim = |t: &&[u32; 3]| t.iter().any(|v| rim.binary_search(v).is_ok());
        let mut corners: Vec<([u32; 2], u32)> = triangles
            .iter()
            .filter(at_rim)
            .flat_map(|t| [([t[0], t[1]], t[2]), ([t[1], t[2]], t[0]), ([t[2], t[0]], t[1])])
            .collect();
        corners.sort_unstable();
        Self { border, corners }
    }

    /// The border edge that follows on `[a, b]`: turning about b through the triangles between the two.
    fn next(&self, [a, b]: [u32; 2]) -> Option<usize> {
        let mut spoke = a;
        loop {
            // The triangle that runs spoke -> b has its third vertex next around b.
            let place = self.corners.binary_search_by(|(edge, _)| edge.cmp(&[spoke, b])).ok()?;
            let far = self.corners[place].1;
            if let Ok(found) = self.border.binary_search(&[b, far]) {
                return Some(found);
            }
            spoke = far;
        }
    }
}

/// `a - b`.
pub fn less(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `a + b`.
pub fn more(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::face::tetrahedra::volume_m3;
    use rockface_core::testing::height_mesh;

    fn patch(keep: impl Fn(f64, f64) -> bool) -> Patch {
        let mesh = height_mesh(4, [0.0, 4.0, 0.0, 4.0], |x, y| 0.1 * x * y);
        let inside = |t: &&[u32; 3]| {
            let centre = t.iter().fold([0.0; 2], |s, v| {
                let p = mesh.vertices[*v as usize];
                [s[0] + p[0] / 3.0, s[1] + p[1] / 3.0]
            });
            keep(centre[0], centre[1])
        };
        let triangles: Vec<[u32; 3]> = mesh.triangles.iter().filter(inside).copied().collect();
        let face = Face::new(mesh.vertices, triangles);
        Patch::around(&face, &Rect { low: [-9.0; 2], high: [9.0; 2] }, [2.2, 1.7, 0.0])
    }

    fn volume(places: &[[f64; 3]], triangles: &[[u32; 3]]) -> f64 {
        volume_m3(places, triangles, [0.0; 3])
    }

    #[test]
    fn a_patch_with_a_hole_and_one_that_touches_itself_become_closed() {
        type Keep = fn(f64, f64) -> bool;
        let whole: Keep = |_, _| true;
        let ring: Keep = |x, y| !((1.0..2.0).contains(&x) && (1.0..2.0).contains(&y));
        let corners: Keep = |x, y| (x < 2.0) == (y < 2.0);
        for (keep, area) in [(whole, 16.0), (ring, 15.0), (corners, 8.0)] {
            let patch = patch(keep);
            let Closed { places, triangles } = patch.close(-10.0).unwrap();
            let all = [&patch.triangles[..], &triangles].concat();
            assert_eq!(open_edges(&all), Ok(vec![]));
            let deeper = patch.close(-11.0).unwrap();
            let deeper = volume(&deeper.places, &[&patch.triangles[..], &deeper.triangles].concat());
            assert!((deeper - volume(&places, &all) - area).abs() < 1e-9, "{deeper} {area}");
        }
    }

    #[test]
    #[allow(clippy::float_cmp)] // to the bit
    fn an_edge_of_three_triangles_is_a_fault() {
        let mut patch = patch(|_, _| true);
        patch.triangles.push([0, 1, 20]);
        let fault = patch.close(-10.0).err().unwrap();
        assert_eq!(fault.near, [0.0, 0.0, 0.0]);
        assert_eq!(patch.origin, [2.0, 2.0, 0.0]);
    }
}
