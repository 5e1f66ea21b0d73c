//! Finds what is wrong with a mesh from elsewhere, drops what is safe to drop, and counts the rest.

use rayon::prelude::*;

use rockface_core::artefact::Mesh;

/// What [`tidy`] dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Tidied {
    /// Triangles without area: a repeated corner, or three corners on one line.
    pub degenerate_triangles: usize,
    /// Vertices no remaining triangle uses.
    pub unreferenced_vertices: usize,
}

/// Edges of a mesh by what is wrong with them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct EdgeReport {
    /// Edges of one triangle: the rim of an open surface and of its holes.
    pub boundary: usize,
    /// Edges of three or more triangles, and one of them as vertex indices.
    pub non_manifold: usize,
    /// Edges whose two triangles run through them in the same direction.
    pub inconsistent: usize,
    /// The vertices of the first faulty edge.
    pub first_fault: Option<[u32; 2]>,
}

/// Drops triangles without area, then vertices without triangle; the order of the rest is kept.
pub fn tidy(mesh: &mut Mesh) -> Tidied {
    Tidied { degenerate_triangles: drop_degenerate(mesh), unreferenced_vertices: drop_unreferenced(mesh) }
}

/// Drops triangles without area; returns how many.
pub fn drop_degenerate(mesh: &mut Mesh) -> usize {
    let before = mesh.triangles.len();
    let vertices = &mesh.vertices;
    mesh.triangles.retain(|triangle| has_area(vertices, triangle));
    before - mesh.triangles.len()
}

/// Triangles without area.
pub fn degenerate_triangles(mesh: &Mesh) -> usize {
    mesh.triangles.par_iter().filter(|triangle| !has_area(&mesh.vertices, triangle)).count()
}

fn has_area(vertices: &[[f64; 3]], [a, b, c]: &[u32; 3]) -> bool {
    let at = |index: &u32| nalgebra::Vector3::from(vertices[*index as usize]);
    (at(b) - at(a)).cross(&(at(c) - at(a))).norm_squared() > 0.0
}

/// Drops vertices no triangle uses, and renumbers the rest in order; returns how many.
pub fn drop_unreferenced(mesh: &mut Mesh) -> usize {
    let mut used = vec![false; mesh.vertices.len()];
    mesh.triangles.iter().flatten().for_each(|index| used[*index as usize] = true);
    let unreferenced = used.iter().filter(|used| !**used).count();
    if unreferenced == 0 {
        return 0;
    }
    let mut next = 0;
    let number = |used: &bool| {
        let own: u32 = next;
        next += u32::from(*used);
        own
    };
    let renumbered: Vec<u32> = used.iter().map(number).collect();
    mesh.triangles.iter_mut().flatten().for_each(|index| *index = renumbered[*index as usize]);
    retain(&mut mesh.vertices, &used);
    retain(&mut mesh.colours, &used);
    unreferenced
}

fn retain<T>(values: &mut Vec<T>, used: &[bool]) {
    let mut flags = used.iter();
    values.retain(|_| flags.next().is_some_and(|used| *used));
}

/// Number of vertices at the same place, to the bit, as an earlier one.
pub fn duplicate_vertices(mesh: &Mesh) -> usize {
    let mut keys: Vec<[u64; 3]> = mesh.vertices.par_iter().map(|v| v.map(|x| (x + 0.0).to_bits())).collect();
    keys.par_sort_unstable();
    keys.windows(2).filter(|pair| pair[0] == pair[1]).count()
}

/// Counts boundary, non-manifold and inconsistently oriented edges.
pub fn check_edges(mesh: &Mesh) -> EdgeReport {
    // Key: smaller index, larger index, then whether the triangle runs from larger to smaller.
    let edges = |t: &[u32; 3]| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])];
    let key = |(a, b): (u32, u32)| (a.min(b), a.max(b), a > b);
    let mut keys: Vec<(u32, u32, bool)> = mesh.triangles.par_iter().flat_map_iter(|t| edges(t).map(key)).collect();
    keys.par_sort_unstable();
    let mut report = EdgeReport::default();
    for edge in keys.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        let faulty = match edge {
            [_] => {
                report.boundary += 1;
                false
            }
            [one, other] => {
                report.inconsistent += usize::from(one.2 == other.2);
                one.2 == other.2
            }
            _ => {
                report.non_manifold += 1;
                true
            }
        };
        if faulty && report.first_fault.is_none() {
            report.first_fault = Some([edge[0].0, edge[0].1]);
        }
    }
    report
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Frame;

    fn mesh(vertices: &[[f64; 3]], triangles: &[[u32; 3]]) -> Mesh {
        Mesh { frame: Frame::World, vertices: vertices.to_vec(), triangles: triangles.to_vec(), colours: Vec::new() }
    }

    const SQUARE: [[f64; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];

    #[test]
    fn slivers_and_stray_vertices_go_and_the_rest_stays_in_order() {
        let mut dirty = mesh(
            &[[9.0; 3], SQUARE[0], SQUARE[1], [0.5, 0.0, 0.0], SQUARE[2], SQUARE[3]],
            &[[1, 2, 4], [1, 3, 2], [4, 4, 5], [1, 4, 5]],
        );
        dirty.colours = (0..6).map(|i| [i; 3]).collect();
        let tidied = tidy(&mut dirty);
        assert_eq!(tidied, Tidied { degenerate_triangles: 2, unreferenced_vertices: 2 });
        assert_eq!(dirty.vertices, SQUARE);
        assert_eq!(dirty.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(dirty.colours, [[1; 3], [2; 3], [4; 3], [5; 3]]);
    }

    #[test]
    fn edges_are_counted_by_fault() {
        let good = check_edges(&mesh(&SQUARE, &[[0, 1, 2], [0, 2, 3]]));
        assert_eq!(good, EdgeReport { boundary: 4, ..EdgeReport::default() });
        let flipped = check_edges(&mesh(&SQUARE, &[[0, 1, 2], [0, 3, 2]]));
        assert_eq!((flipped.inconsistent, flipped.first_fault), (1, Some([0, 2])));
        let five = [&SQUARE[..], &[[0.5, 0.5, 1.0]]].concat();
        let fin = check_edges(&mesh(&five, &[[0, 1, 2], [0, 2, 3], [2, 0, 4]]));
        assert_eq!((fin.non_manifold, fin.first_fault), (1, Some([0, 2])));
    }

    #[test]
    fn vertices_at_one_place_are_duplicates() {
        let twice = mesh(&[SQUARE[0], SQUARE[1], SQUARE[0], [-0.0, 0.0, 0.0]], &[]);
        assert_eq!(duplicate_vertices(&twice), 2);
    }
}
