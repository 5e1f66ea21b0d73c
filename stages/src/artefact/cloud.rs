//! Points that no triangles connect, with what is known of each, kept as binary little-endian PLY.

use std::collections::BTreeMap;

use super::{Artefact, CodecError, Export, Frame, Kind, Noun};
use crate::kernel::{cloud_laz, cloud_ply, sketch};

/// A point cloud.
#[derive(Debug, Clone, PartialEq)]
pub struct Cloud {
    /// The frame of points and normals.
    pub frame: Frame,
    /// Points, metres.
    pub points: Vec<[f64; 3]>,
    /// Unit normal of each point, out of the rock, zero where it is not known; empty where none is.
    pub normals: Vec<[f32; 3]>,
    /// Red, green and blue of each point; empty where the source has none.
    pub colours: Vec<[u8; 3]>,
    /// Further whole numbers of each point by name: `id`, `label`, `views`.
    pub numbers: BTreeMap<String, Vec<u32>>,
}

impl Cloud {
    /// Points of which nothing else is known.
    pub fn new(frame: Frame, points: Vec<[f64; 3]>) -> Self {
        Self { frame, points, normals: Vec::new(), colours: Vec::new(), numbers: BTreeMap::new() }
    }
}

impl Noun for Cloud {
    const KIND: Kind = Kind::Cloud;
    fn of(artefact: &Artefact) -> Option<&Self> {
        if let Artefact::Cloud(value) = artefact { Some(value) } else { None }
    }
    fn encode(&self) -> Result<Vec<u8>, CodecError> {
        cloud_ply::write(self)
    }
    fn decode(bytes: &[u8]) -> Result<Self, CodecError> {
        cloud_ply::read(bytes)
    }
    fn memory_bytes(&self) -> usize {
        let point = 24 + 12 * usize::from(!self.normals.is_empty()) + 3 * usize::from(!self.colours.is_empty());
        self.points.len() * (point + 4 * self.numbers.len())
    }
    fn has_exports() -> bool {
        true
    }
    fn exports(&self, stem: &str) -> Result<Vec<Export>, CodecError> {
        if self.points.is_empty() {
            return Ok(Vec::new());
        }
        Ok(vec![Export { path: format!("{stem}.laz"), bytes: cloud_laz::write(self)? }])
    }
    fn sketches(&self) -> Vec<super::Sketch> {
        vec![sketch::of_cloud(self)]
    }
}
