//! Named meshes in one file, such as the blocks, pieces and niches of rockfalls, kept as binary little-endian PLY.

use super::{Frame, Mesh};

/// One named mesh. Where it is closed its triangles are counter-clockwise seen from outside.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Part {
    /// Its name, such as the number of a piece.
    pub name: String,
    /// What sort of thing it is, such as the class of the block; may be empty.
    pub class: String,
    /// Vertices, metres.
    pub vertices: Vec<[f64; 3]>,
    /// Vertex indices of each triangle, from 0 within the part.
    pub triangles: Vec<[u32; 3]>,
}

/// Named meshes in one frame.
///
/// The file is one PLY: the rows of the parts follow each other, an int property `part` of vertices and faces tells them
/// apart (programs show it as a scalar field), and a comment line a part states its size, name and class.
#[derive(Debug, Clone, PartialEq)]
pub struct Meshes {
    /// The frame of all vertices.
    pub frame: Frame,
    /// The parts, in an order that means something to who made them.
    pub parts: Vec<Part>,
}

impl Meshes {
    /// A part as a mesh of its own.
    pub fn mesh(&self, part: &Part) -> Mesh {
        Mesh {
            frame: self.frame,
            vertices: part.vertices.clone(),
            triangles: part.triangles.clone(),
            colours: Vec::new(),
        }
    }
}

/// The longest stem of an export, bytes; file systems take 255 with the number and the extension.
const STEM_BYTES: usize = 100;

/// What every file system takes of a name: letters, digits, `.`, `_` and `-`, everything else `_`, no dot in front.
fn file_stem(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || "._-".contains(c) { c } else { '_' };
    let stem: String = name.chars().take(STEM_BYTES).map(plain).collect();
    if stem.starts_with('.') || stem.is_empty() { format!("_{stem}") } else { stem }
}

/// A file name for each part: its own name where that is one and nobody else has it, otherwise with its number (from 0) behind it.
pub fn file_names(parts: &[Part]) -> Vec<String> {
    let mut taken = std::collections::BTreeSet::new();
    let unique = |(number, part): (usize, &Part)| {
        let mut name = file_stem(&part.name);
        // Some file systems take upper and lower case for one.
        while !taken.insert(name.to_ascii_lowercase()) {
            name = format!("{name}-{number}");
        }
        name
    };
    parts.iter().enumerate().map(unique).collect()
}
