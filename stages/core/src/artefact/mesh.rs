//! A triangle mesh with f64 vertices, kept as binary little-endian PLY.

use super::Frame;

/// Vertices and the triangles between them, which may be open or closed.
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    /// The frame of the vertices.
    pub frame: Frame,
    /// Vertices, metres.
    pub vertices: Vec<[f64; 3]>,
    /// Vertex indices of each triangle, counter-clockwise seen from outside the rock.
    pub triangles: Vec<[u32; 3]>,
    /// Red, green and blue of each vertex; empty where the source has none.
    pub colours: Vec<[u8; 3]>,
}

impl Mesh {
    /// Which vertices a triangle uses: those of rock that has fallen may stay in the list without one, and are no part of the surface. `None`
    /// where all are part of it, and where there is no triangle at all: such a mesh is a cloud.
    pub fn surface_vertices(&self) -> Option<Vec<bool>> {
        let mut used = vec![false; self.vertices.len()];
        self.triangles.iter().flatten().for_each(|vertex| used[*vertex as usize] = true);
        (!self.triangles.is_empty() && used.contains(&false)).then_some(used)
    }

    /// The vertices that are part of the surface, in their order, metres; see [`Self::surface_vertices`].
    pub fn surface_points(&self) -> impl Iterator<Item = [f64; 3]> {
        let used = self.surface_vertices();
        let is_part = move |place: usize| used.as_ref().is_none_or(|used| used[place]);
        self.vertices.iter().enumerate().filter(move |(place, _)| is_part(*place)).map(|(_, vertex)| *vertex)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vertices_without_a_triangle_are_no_surface_but_where_there_is_none() {
        let mesh = |triangles: &[[u32; 3]]| Mesh {
            frame: Frame::Wall,
            vertices: vec![[0.0; 3]; 4],
            triangles: triangles.to_vec(),
            colours: Vec::new(),
        };
        assert_eq!(mesh(&[[0, 3, 1]]).surface_vertices(), Some(vec![true, true, false, true]));
        assert_eq!(mesh(&[[0, 3, 1], [3, 2, 1]]).surface_vertices(), None);
        assert_eq!(mesh(&[]).surface_vertices(), None);
        let counts =
            [&[[0, 3, 1]][..], &[[0, 3, 1], [3, 2, 1]], &[]].map(|triangles| mesh(triangles).surface_points().count());
        assert_eq!(counts, [3, 4, 4]);
    }
}
