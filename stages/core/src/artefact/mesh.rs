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
