//! Points that no triangles connect, with what is known of each, kept as binary little-endian PLY.

use std::collections::BTreeMap;

use super::Frame;

/// Points without triangles, with normals, colours, numbers and values where they are known.
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
    /// Further measured values of each point by name, NaN where there is none: `difference`.
    pub values: BTreeMap<String, Vec<f32>>,
}

impl Cloud {
    /// Points of which nothing else is known.
    pub fn new(frame: Frame, points: Vec<[f64; 3]>) -> Self {
        Self {
            frame,
            points,
            normals: Vec::new(),
            colours: Vec::new(),
            numbers: BTreeMap::new(),
            values: BTreeMap::new(),
        }
    }
}
