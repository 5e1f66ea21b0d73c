//! Triangles without area, vertices that no triangle uses, vertices at one place: dropped or counted.

use rayon::prelude::*;

use rockface_core::artefact::Mesh;

/// Drops triangles without area; returns how many.
pub fn drop_degenerate(mesh: &mut Mesh) -> usize {
    let before = mesh.triangles.len();
    let vertices = &mesh.vertices;
    mesh.triangles.retain(|triangle| has_area(vertices, triangle));
    before - mesh.triangles.len()
}

/// How many triangles of a mesh have no area.
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
        assert_eq!((drop_degenerate(&mut dirty), drop_unreferenced(&mut dirty)), (2, 2));
        assert_eq!(dirty.vertices, SQUARE);
        assert_eq!(dirty.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(dirty.colours, [[1; 3], [2; 3], [4; 3], [5; 3]]);
    }

    #[test]
    fn vertices_at_one_place_are_duplicates() {
        let twice = mesh(&[SQUARE[0], SQUARE[1], SQUARE[0], [-0.0, 0.0, 0.0]], &[]);
        assert_eq!(duplicate_vertices(&twice), 2);
    }
}
