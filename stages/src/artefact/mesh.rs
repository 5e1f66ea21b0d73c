//! A triangle mesh with f64 vertices, kept as binary little-endian PLY.

use super::{Artefact, CodecError, Frame, Kind, Noun};

/// A triangle mesh.
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

impl Noun for Mesh {
    const KIND: Kind = Kind::Mesh;
    fn of(artefact: &Artefact) -> Option<&Self> {
        if let Artefact::Mesh(value) = artefact { Some(value) } else { None }
    }
    fn encode(&self) -> Result<Vec<u8>, CodecError> {
        Ok(crate::kernel::ply::write_mesh(self))
    }
    fn decode(bytes: &[u8]) -> Result<Self, CodecError> {
        crate::kernel::ply::read_mesh(bytes)
    }
    fn sketches(&self) -> Vec<super::Sketch> {
        vec![crate::kernel::sketch::of_mesh(self)]
    }
    fn memory_bytes(&self) -> usize {
        self.vertices.len() * 24 + self.triangles.len() * 12 + self.colours.len() * 3
    }
}
