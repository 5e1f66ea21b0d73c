//! Named meshes in one file, such as the blocks, pieces and niches of rockfalls, kept as binary little-endian PLY.

use super::{Artefact, CodecError, Export, Frame, Kind, Mesh, Noun};

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

/// One file name a part: its name where that is a file name of its own, otherwise with its number (from 0) behind it.
fn file_names(parts: &[Part]) -> Vec<String> {
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

impl Noun for Meshes {
    const KIND: Kind = Kind::Meshes;
    fn of(artefact: &Artefact) -> Option<&Self> {
        if let Artefact::Meshes(value) = artefact { Some(value) } else { None }
    }
    fn encode(&self) -> Result<Vec<u8>, CodecError> {
        crate::kernel::ply_parts::write(self)
    }
    fn decode(bytes: &[u8]) -> Result<Self, CodecError> {
        crate::kernel::ply_parts::read(bytes)
    }
    fn sketches(&self) -> Vec<super::Sketch> {
        vec![crate::kernel::sketch::of_meshes(self)]
    }
    fn memory_bytes(&self) -> usize {
        let part = |part: &Part| part.vertices.len() * 24 + part.triangles.len() * 12 + part.name.len();
        self.parts.iter().map(part).sum()
    }
    fn items(&self) -> Option<Vec<String>> {
        Some(self.parts.iter().map(|part| part.name.clone()).collect())
    }
    fn has_exports() -> bool {
        true
    }
    fn exports(&self, stem: &str) -> Result<Vec<Export>, CodecError> {
        let names = file_names(&self.parts);
        let export = |(part, name): (&Part, String)| Export {
            path: format!("{stem}/{name}.ply"),
            bytes: crate::kernel::ply::write_mesh(&self.mesh(part)),
        };
        Ok(self.parts.iter().zip(names).map(export).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(name: &str) -> Part {
        let vertices = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        Part { name: name.into(), class: "slab".into(), vertices, triangles: vec![[0, 1, 2]] }
    }

    #[test]
    fn exports_have_names_of_their_own_inside_the_folder() {
        let names = ["7", "../x", "a b", "A_b", "", "7"];
        let meshes = Meshes { frame: Frame::Wall, parts: names.into_iter().map(part).collect() };
        let exports = meshes.exports("pieces").unwrap();
        let paths: Vec<&str> = exports.iter().map(|export| export.path.as_str()).collect();
        let expected = ["7", "_.._x", "a_b", "A_b-3", "_", "7-5"].map(|name| format!("pieces/{name}.ply"));
        assert_eq!(paths, expected);
        let mesh = crate::kernel::ply::read_mesh(&exports[1].bytes).unwrap();
        assert_eq!(mesh, meshes.mesh(&meshes.parts[1]));
    }
}
