//! The triangles where the signed distances of a volume vanish; vertices are shared, so surfaces close.

use std::collections::HashMap;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::blocks::{Key, SIDE, VOXELS, Volume};
use super::cubes::{Edge, triangles};
use rockface_core::artefact::{Frame, Mesh};
use rockface_core::numerics::union_find::UnionFind;

/// Samples along a side of a block with those of the blocks beyond it.
const WITH_NEXT: usize = 9;

/// The vertices on the edges that begin in one block: edge (3 voxel + axis), ascending, and place.
type BlockVertices = Vec<(u16, [f64; 3])>;

/// The surface of a volume, from voxels that at least `min_maps` depth maps saw; pieces of fewer than `min_triangles` are left out.
///
/// Vertices and triangles come in the order of the blocks: the bits do not depend on the number of threads.
pub fn extract(volume: &Volume, frame: Frame, min_maps: u8, min_triangles: usize) -> Mesh {
    let blocks = || (0..volume.keys.len()).into_par_iter().with_min_len(64);
    let vertices: Vec<BlockVertices> = blocks().map(|block| block_vertices(volume, block, min_maps)).collect();
    let mut first = Vec::with_capacity(vertices.len());
    let mut count = 0u32;
    for block in &vertices {
        first.push(count);
        count += block.len() as u32;
    }
    let index = Index { volume, vertices: &vertices, first: &first };
    let triangles: Vec<Vec<[u32; 3]>> = blocks().map(|block| block_triangles(&index, block, min_maps)).collect();
    let places: Vec<[f64; 3]> = vertices.iter().flatten().map(|(_, place)| *place).collect();
    let all: Vec<[u32; 3]> = triangles.into_iter().flatten().filter(|t| !is_degenerate(&places, t)).collect();
    compact(frame, &places, keep_large(places.len(), all, min_triangles))
}

fn is_degenerate(places: &[[f64; 3]], [a, b, c]: &[u32; 3]) -> bool {
    let at = |i: &u32| Vector3::from(places[*i as usize]);
    (at(b) - at(a)).cross(&(at(c) - at(a))).norm_squared() == 0.0
}

/// Signed distances of the 9 x 9 x 9 voxels from the first of a block on; NaN where too few maps saw them.
fn samples(volume: &Volume, block: usize, min_maps: u8) -> Vec<f32> {
    let mut values = vec![f32::NAN; WITH_NEXT * WITH_NEXT * WITH_NEXT];
    for next in 0..8 {
        let shift = [next & 1, next >> 1 & 1, next >> 2];
        let Some(number) = neighbour(volume, &volume.keys[block], shift) else { continue };
        let range = |axis: usize| if shift[axis] == 1 { 8..9 } else { 0..8 };
        for k in range(2) {
            for j in range(1) {
                for i in range(0) {
                    let voxel = number * VOXELS + ((k & 7) << 6 | (j & 7) << 3 | (i & 7));
                    if volume.maps[voxel] >= min_maps && volume.weight[voxel] > 0.0 {
                        let at = (k * WITH_NEXT + j) * WITH_NEXT + i;
                        values[at] = volume.distance[voxel] / volume.weight[voxel];
                    }
                }
            }
        }
    }
    values
}

fn neighbour(volume: &Volume, key: &Key, shift: [usize; 3]) -> Option<usize> {
    let place = [0, 1, 2].map(|axis| key[axis] + shift[axis] as i32);
    volume.numbers.get(&place).map(|number| *number as usize)
}

const STEP: [usize; 3] = [1, WITH_NEXT, WITH_NEXT * WITH_NEXT];

fn sample_of(voxel: usize) -> usize {
    ((voxel >> 6) * WITH_NEXT + (voxel >> 3 & 7)) * WITH_NEXT + (voxel & 7)
}

fn block_vertices(volume: &Volume, block: usize, min_maps: u8) -> BlockVertices {
    let values = samples(volume, block, min_maps);
    let mut vertices = Vec::new();
    for voxel in 0..VOXELS {
        let at = sample_of(voxel);
        for (axis, step) in STEP.into_iter().enumerate() {
            let (a, b) = (values[at], values[at + step]);
            if a.is_nan() || b.is_nan() || (a < 0.0) == (b < 0.0) {
                continue;
            }
            let share = f64::from(a) / (f64::from(a) - f64::from(b));
            let mut place = [0, 1, 2].map(|n| f64::from(volume.keys[block][n] * SIDE) + (voxel >> (3 * n) & 7) as f64);
            place[axis] += share;
            vertices.push(((3 * voxel + axis) as u16, place.map(|x| x * volume.layout.voxel_m)));
        }
    }
    vertices
}

/// Index of the vertex of an edge in the mesh.
struct Index<'a> {
    volume: &'a Volume,
    vertices: &'a [BlockVertices],
    first: &'a [u32],
}

impl Index<'_> {
    fn vertex(&self, block: usize, voxel: usize, edge: Edge) -> Option<u32> {
        let place = [0, 1, 2].map(|axis| (voxel >> (3 * axis) & 7) + (edge.corner >> axis & 1));
        let shift = place.map(|p| p >> 3);
        let block = if shift == [0; 3] { block } else { neighbour(self.volume, &self.volume.keys[block], shift)? };
        let voxel = (place[2] & 7) << 6 | (place[1] & 7) << 3 | (place[0] & 7);
        let wanted = (3 * voxel + edge.axis) as u16;
        let place = self.vertices[block].binary_search_by_key(&wanted, |(edge, _)| *edge).ok()?;
        Some(self.first[block] + place as u32)
    }
}

fn block_triangles(index: &Index, block: usize, min_maps: u8) -> Vec<[u32; 3]> {
    let values = samples(index.volume, block, min_maps);
    let mut all = Vec::new();
    for voxel in 0..VOXELS {
        let at = sample_of(voxel);
        let corner = |c: usize| values[at + (0..3).map(|axis| (c >> axis & 1) * STEP[axis]).sum::<usize>()];
        if (0..8).any(|c| corner(c).is_nan()) {
            continue;
        }
        let inside = (0..8).fold(0u8, |bits, c| bits | u8::from(corner(c) < 0.0) << c);
        for edges in triangles(inside) {
            let [a, b, c] = edges.map(|edge| index.vertex(block, voxel, edge));
            // Every corner of a whole cube has a value, so every edge that crosses has its vertex.
            if let (Some(a), Some(b), Some(c)) = (a, b, c) {
                all.push([a, b, c]);
            }
        }
    }
    all
}

/// The triangles of pieces with at least so many; pieces connect through vertices.
fn keep_large(vertices: usize, triangles: Vec<[u32; 3]>, min_triangles: usize) -> Vec<[u32; 3]> {
    if min_triangles <= 1 {
        return triangles;
    }
    let mut pieces = UnionFind::new(vertices);
    for [a, b, c] in &triangles {
        let root = pieces.join(*a as usize, *b as usize);
        pieces.join(root, *c as usize);
    }
    let roots = pieces.into_roots();
    let mut sizes: HashMap<u32, usize> = HashMap::new();
    triangles.iter().for_each(|[a, ..]| *sizes.entry(roots[*a as usize]).or_default() += 1);
    triangles.into_iter().filter(|[a, ..]| sizes[&roots[*a as usize]] >= min_triangles).collect()
}

/// A mesh without the vertices that no triangle uses.
fn compact(frame: Frame, places: &[[f64; 3]], mut triangles: Vec<[u32; 3]>) -> Mesh {
    let mut number = vec![u32::MAX; places.len()];
    triangles.iter().flatten().for_each(|i| number[*i as usize] = 0);
    let mut vertices = Vec::new();
    for (place, number) in places.iter().zip(&mut number).filter(|(_, number)| **number == 0) {
        *number = vertices.len() as u32;
        vertices.push(*place);
    }
    triangles.iter_mut().for_each(|t| *t = t.map(|i| number[i as usize]));
    Mesh { frame, vertices, triangles, colours: Vec::new() }
}
