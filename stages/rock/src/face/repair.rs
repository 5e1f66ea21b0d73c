//! Repairs of a mesh that change no surface: coincident vertices become one, what covers nothing goes.

use std::collections::HashMap;

use rayon::prelude::*;

use super::half_edges::HalfEdges;
use rockface_core::artefact::Mesh;
use rockface_core::numerics::union_find::UnionFind;
use rockface_raster::mesh_check;

/// How often each repair was done.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Repaired {
    /// Vertices merged with an earlier one at exactly the same place.
    pub merged_vertices: usize,
    /// Triangles without area that were dropped.
    pub degenerate_triangles: usize,
    /// Triangles with the corners of an earlier one that were dropped.
    pub duplicate_triangles: usize,
    /// Triangles of too small pieces that were dropped.
    pub small_piece_triangles: usize,
    /// Vertices without triangle that were dropped.
    pub unreferenced_vertices: usize,
}

/// Merges coincident vertices and drops triangles without area, repeated ones, pieces of fewer triangles than asked, and
/// vertices without triangle, in this order; the order of the rest is kept.
pub fn repair(mesh: &mut Mesh, min_piece_triangles: usize) -> Repaired {
    let merged_vertices = merge_vertices(mesh);
    let degenerate_triangles = mesh_check::drop_degenerate(mesh);
    let duplicate_triangles = drop_duplicate_triangles(mesh);
    let small_piece_triangles = drop_small_pieces(mesh, min_piece_triangles);
    // Merged vertices have no triangle any more and are counted as merged.
    let unreferenced_vertices = mesh_check::drop_unreferenced(mesh) - merged_vertices;
    Repaired {
        merged_vertices,
        degenerate_triangles,
        duplicate_triangles,
        small_piece_triangles,
        unreferenced_vertices,
    }
}

/// Cuts the surface open along edges of three or more triangles: each side gets vertices of its own there, and so do surfaces that meet in a
/// point. Returns how many edges were cut; a mesh without such edges stays as it is.
pub fn cut_open(mesh: &mut Mesh) -> usize {
    let mut edges: Vec<([u32; 2], [u32; 2])> = Vec::with_capacity(3 * mesh.triangles.len());
    for (triangle, corners) in mesh.triangles.iter().enumerate() {
        for side in 0..3 {
            let next = (side + 1) % 3;
            let (a, b) = (corners[side], corners[next]);
            let (at_a, at_b) = ((3 * triangle + side) as u32, (3 * triangle + next) as u32);
            edges.push(if a < b { ([a, b], [at_a, at_b]) } else { ([b, a], [at_b, at_a]) });
        }
    }
    edges.par_sort_unstable();
    // Corners of triangles that meet along an edge of two belong to one vertex.
    let mut sets = UnionFind::new(3 * mesh.triangles.len());
    let mut crowded = 0;
    for group in edges.chunk_by(|one, other| one.0 == other.0) {
        match group {
            [(_, one), (_, other)] => (0..2).for_each(|end| {
                sets.join(one[end] as usize, other[end] as usize);
            }),
            [_] => {}
            _ => crowded += 1,
        }
    }
    if crowded > 0 {
        give_vertices(mesh, &sets.into_roots());
    }
    crowded
}

/// Gives each set of corners a vertex: the first set of a vertex keeps it, the others get copies.
fn give_vertices(mesh: &mut Mesh, roots: &[u32]) {
    let mut own: Vec<Option<u32>> = vec![None; roots.len()];
    let mut is_taken = vec![false; mesh.vertices.len()];
    for (corner, root) in roots.iter().enumerate() {
        let (root, old) = (*root as usize, mesh.triangles[corner / 3][corner % 3] as usize);
        let vertex = own[root].unwrap_or_else(|| {
            if !std::mem::replace(&mut is_taken[old], true) {
                return old as u32;
            }
            mesh.vertices.push(mesh.vertices[old]);
            if !mesh.colours.is_empty() {
                mesh.colours.push(mesh.colours[old]);
            }
            (mesh.vertices.len() - 1) as u32
        });
        own[root] = Some(vertex);
        mesh.triangles[corner / 3][corner % 3] = vertex;
    }
}

/// Leads triangles from vertices at the place of an earlier one, to the bit (-0 is 0), to that one; returns how many of
/// the vertices that triangles used lost them all.
fn merge_vertices(mesh: &mut Mesh) -> usize {
    let first = first_at_place(&mesh.vertices);
    let mut merged = vec![false; mesh.vertices.len()];
    for index in mesh.triangles.iter_mut().flatten() {
        let own = first[*index as usize];
        merged[*index as usize] |= own != *index;
        *index = own;
    }
    merged.iter().filter(|merged| **merged).count()
}

/// Of each vertex the first one at its place.
fn first_at_place(vertices: &[[f64; 3]]) -> Vec<u32> {
    let key = |number: usize| (vertices[number].map(|x| (x + 0.0).to_bits()), number as u32);
    let mut keys: Vec<([u64; 3], u32)> = (0..vertices.len()).into_par_iter().map(key).collect();
    keys.par_sort_unstable();
    let mut first: Vec<u32> = (0..vertices.len() as u32).collect();
    for group in keys.chunk_by(|a, b| a.0 == b.0) {
        group.iter().for_each(|(_, number)| first[*number as usize] = group[0].1);
    }
    first
}

/// Numbers of triangles that have the corners of an earlier triangle, in either orientation.
pub fn duplicate_triangles(mesh: &Mesh) -> Vec<u32> {
    let key = |(number, triangle): (usize, &[u32; 3])| {
        let mut corners = *triangle;
        corners.sort_unstable();
        (corners, number as u32)
    };
    let mut keys: Vec<([u32; 3], u32)> = mesh.triangles.par_iter().enumerate().map(key).collect();
    keys.par_sort_unstable();
    let mut repeated: Vec<u32> = keys.windows(2).filter(|pair| pair[0].0 == pair[1].0).map(|pair| pair[1].1).collect();
    repeated.sort_unstable();
    repeated
}

fn drop_duplicate_triangles(mesh: &mut Mesh) -> usize {
    let repeated = duplicate_triangles(mesh);
    let (mut number, mut upcoming) = (0, repeated.iter().peekable());
    mesh.triangles.retain(|_| {
        number += 1;
        upcoming.next_if(|next| **next == number - 1).is_none()
    });
    repeated.len()
}

/// Drops pieces, connected through edges, of fewer triangles; returns how many triangles went.
pub fn drop_small_pieces(mesh: &mut Mesh, min_triangles: usize) -> usize {
    if min_triangles <= 1 {
        return 0;
    }
    let (piece_of, count) = HalfEdges::new(mesh).pieces();
    let mut sizes = vec![0usize; count];
    piece_of.iter().for_each(|piece| sizes[*piece as usize] += 1);
    let before = mesh.triangles.len();
    let mut pieces = piece_of.iter();
    mesh.triangles.retain(|_| pieces.next().is_some_and(|piece| sizes[*piece as usize] >= min_triangles));
    before - mesh.triangles.len()
}

/// Numbers the places of a triangle soup, in the order they first occur.
#[derive(Debug, Default)]
pub struct Places {
    numbers: HashMap<[u64; 3], u32>,
    /// The places in the order of their numbers, metres.
    pub vertices: Vec<[f64; 3]>,
}

impl Places {
    /// The number of a place, to the bit (-0 is 0).
    pub fn number(&mut self, place: [f64; 3]) -> u32 {
        let next = self.vertices.len() as u32;
        let number = *self.numbers.entry(place.map(|x| (x + 0.0).to_bits())).or_insert(next);
        if number == next {
            self.vertices.push(place);
        }
        number
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::testing::height_mesh;

    #[test]
    fn a_soup_of_triangles_becomes_the_mesh_again() {
        let whole = height_mesh(5, [451_000.1, 451_001.1, 0.0, 1.0], |x, y| x * y);
        let mut soup = whole.clone();
        soup.vertices = whole.triangles.iter().flatten().map(|i| whole.vertices[*i as usize]).collect();
        soup.triangles = (0..whole.triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        soup.vertices.push([9.0; 3]);
        soup.triangles.push([4, 3, 5]);
        soup.triangles.push([4, 4, 5]);
        let done = repair(&mut soup, 1);
        assert_eq!((done.merged_vertices, done.unreferenced_vertices), (150 - 36, 1));
        assert_eq!((done.degenerate_triangles, done.duplicate_triangles), (1, 1));
        let corners =
            |mesh: &Mesh| mesh.triangles.iter().map(|t| t.map(|i| mesh.vertices[i as usize])).collect::<Vec<_>>();
        assert_eq!(corners(&soup), corners(&whole));
        assert_eq!(soup.vertices.len(), 36);
        assert_eq!(repair(&mut soup, 1), Repaired::default());
    }

    #[test]
    fn small_pieces_go() {
        let mut mesh = height_mesh(4, [0.0, 1.0, 0.0, 1.0], |_, _| 0.0);
        mesh.triangles.drain(2..16);
        assert_eq!(drop_small_pieces(&mut mesh, 5), 2);
        assert_eq!(mesh.triangles.len(), 16);
    }
}
