//! Named meshes as one PLY file whose vertices and faces say which part they belong to; written and read to the bit.
//!
//! Layout: binary little-endian, double `x y z` and int `part` a vertex, `list uchar uint vertex_indices` and int `part`
//! a face. The header states the frame and, a line a part, the numbers of vertices and triangles and the JSON list
//! `[name, class]` in ASCII.

use std::fmt::Write as _;

use crate::artefact::{CodecError, Frame, Georeference, Meshes, Part};
use crate::format::ply::header::{GEOREFERENCE_COMMENT, georeference_line};

/// Bytes of a vertex: three doubles and an int.
const VERTEX_BYTES: usize = 28;
/// Bytes of a face: the count 3, three corners and an int.
const FACE_BYTES: usize = 17;

/// Size, name and class of a part, as its comment line states them.
struct Label {
    vertices: usize,
    triangles: usize,
    name: String,
    class: String,
}

/// Writes named meshes; equal values give equal bytes.
///
/// # Errors
/// The part at fault: a coordinate that is not finite, a corner that does not exist, more than 2^32 vertices in all.
pub fn write(meshes: &Meshes) -> Result<Vec<u8>, CodecError> {
    meshes.parts.iter().try_for_each(check)?;
    let labels: Vec<Label> = meshes.parts.iter().map(Label::of).collect();
    let (vertices, triangles) = totals(&labels);
    if u32::try_from(vertices).is_err() || i32::try_from(labels.len()).is_err() {
        return Err(fault(&format!("{vertices} vertices in {} parts are too many for one file", labels.len())));
    }
    let header = header(meshes.frame, &labels);
    let mut bytes = Vec::with_capacity(header.len() + vertices * VERTEX_BYTES + triangles * FACE_BYTES);
    bytes.extend_from_slice(header.as_bytes());
    for (number, part) in meshes.parts.iter().enumerate() {
        write_vertices(&mut bytes, number, &part.vertices);
    }
    let mut first = 0;
    for (number, part) in meshes.parts.iter().enumerate() {
        write_faces(&mut bytes, number, first, &part.triangles);
        first += part.vertices.len() as u32;
    }
    Ok(bytes)
}

fn check(part: &Part) -> Result<(), CodecError> {
    let name = &part.name;
    if let Some(at) = part.vertices.iter().position(|vertex| !vertex.iter().all(|value| value.is_finite())) {
        let found = part.vertices[at];
        return Err(fault(&format!("part `{name}`: vertex {at} (counted from 0) is {found:?}, which is not finite")));
    }
    let count = part.vertices.len();
    if let Some(at) = part.triangles.iter().position(|triangle| triangle.iter().any(|corner| *corner as usize >= count))
    {
        let found = part.triangles[at];
        return Err(fault(&format!("part `{name}`: triangle {at} is {found:?}, but there are {count} vertices")));
    }
    Ok(())
}

fn write_vertices(bytes: &mut Vec<u8>, number: usize, vertices: &[[f64; 3]]) {
    for vertex in vertices {
        for value in vertex {
            bytes.extend_from_slice(&value.to_le_bytes());
        }
        bytes.extend_from_slice(&(number as i32).to_le_bytes());
    }
}

fn write_faces(bytes: &mut Vec<u8>, number: usize, first: u32, triangles: &[[u32; 3]]) {
    for triangle in triangles {
        bytes.push(3);
        for corner in triangle {
            bytes.extend_from_slice(&(first + corner).to_le_bytes());
        }
        bytes.extend_from_slice(&(number as i32).to_le_bytes());
    }
}

fn header(frame: Frame, labels: &[Label]) -> String {
    let (vertices, triangles) = totals(labels);
    let mut text = format!("ply\nformat binary_little_endian 1.0\n{FRAME_LINE}{frame}{UNITS}\n");
    text += &georeference_line(frame);
    for (number, label) in labels.iter().enumerate() {
        let Label { vertices, triangles, name, class } = label;
        let words = ascii(&serde_json::json!([name, class]).to_string());
        let _ = writeln!(text, "{PART_LINE}{number} vertices {vertices} faces {triangles} {words}");
    }
    let _ = write!(
        text,
        "element vertex {vertices}\nproperty double x\nproperty double y\nproperty double z\nproperty int part\n\
         element face {triangles}\nproperty list uchar uint vertex_indices\nproperty int part\nend_header\n"
    );
    text
}

const FRAME_LINE: &str = "comment rockface meshes, frame ";
const UNITS: &str = ", units metres";
const PART_LINE: &str = "comment part ";

fn totals(labels: &[Label]) -> (usize, usize) {
    let sum = |count: fn(&Label) -> usize| labels.iter().fold(0usize, |sum, label| sum.saturating_add(count(label)));
    (sum(|label| label.vertices), sum(|label| label.triangles))
}

/// JSON text with everything outside printable ASCII as `\u` escapes: a PLY header is ASCII.
fn ascii(json: &str) -> String {
    let mut text = String::with_capacity(json.len());
    for c in json.chars() {
        if (' '..='~').contains(&c) {
            text.push(c);
        } else {
            for unit in c.encode_utf16(&mut [0; 2]) {
                let _ = write!(text, "\\u{unit:04x}");
            }
        }
    }
    text
}

impl Label {
    fn of(part: &Part) -> Self {
        let (vertices, triangles) = (part.vertices.len(), part.triangles.len());
        Self { vertices, triangles, name: part.name.clone(), class: part.class.clone() }
    }

    fn parse(line: &str) -> Option<Self> {
        let mut words = line.strip_prefix(PART_LINE)?.splitn(6, ' ').skip(2);
        let vertices = words.next()?.parse().ok()?;
        let triangles = words.nth(1)?.parse().ok()?;
        let (name, class) = serde_json::from_str(words.next()?).ok()?;
        Some(Self { vertices, triangles, name, class })
    }
}

/// Reads the file that [`write()`] wrote; other PLY files are read by [`crate::format::ply::read_mesh`].
///
/// # Errors
/// A header or a length [`write()`] would not have written, corners of another part, coordinates that are not finite.
pub fn read(bytes: &[u8]) -> Result<Meshes, CodecError> {
    let (frame, labels, mut body) = read_header(bytes)?;
    let (vertices, triangles) = totals(&labels);
    let expected = vertices.checked_mul(VERTEX_BYTES).zip(triangles.checked_mul(FACE_BYTES));
    if expected.and_then(|(v, f)| v.checked_add(f)) != Some(body.len()) {
        let found = body.len();
        return Err(fault(&format!(
            "{found} bytes after the header do not hold {vertices} vertices, {triangles} faces"
        )));
    }
    let mut parts = Vec::with_capacity(labels.len());
    for (number, label) in labels.into_iter().enumerate() {
        let (rows, rest) = body.split_at(label.vertices * VERTEX_BYTES);
        body = rest;
        let vertices = rows.chunks_exact(VERTEX_BYTES).map(|row| read_vertex(row, number)).collect::<Option<_>>();
        let vertices = vertices.ok_or_else(|| misplaced("vertex", number))?;
        parts.push((Part { name: label.name, class: label.class, vertices, triangles: Vec::new() }, label.triangles));
    }
    let mut first = 0;
    for (number, (part, triangles)) in parts.iter_mut().enumerate() {
        let (rows, rest) = body.split_at(*triangles * FACE_BYTES);
        body = rest;
        let faces = rows.chunks_exact(FACE_BYTES).map(|row| read_face(row, number, first)).collect::<Option<_>>();
        part.triangles = faces.ok_or_else(|| misplaced("face", number))?;
        first += part.vertices.len() as u32;
        check(part)?;
    }
    Ok(Meshes { frame, parts: parts.into_iter().map(|(part, _)| part).collect() })
}

/// Frame, labels and what follows the header, which must be the one that [`header`] makes of them.
fn read_header(bytes: &[u8]) -> Result<(Frame, Vec<Label>, &[u8]), CodecError> {
    const END: &[u8] = b"\nend_header\n";
    let refused = || fault("this is not a file of named meshes that rockface wrote; import it as a mesh");
    let end = bytes.windows(END.len()).position(|window| window == END).ok_or_else(refused)? + END.len();
    let (text, body) = bytes.split_at(end);
    let text = std::str::from_utf8(text).map_err(|_| refused())?;
    let stated = |frame: &Frame| text.lines().any(|line| line == format!("{FRAME_LINE}{frame}{UNITS}"));
    let frame = [Frame::World, Frame::Wall].into_iter().find(stated).ok_or_else(refused)?;
    let line = text.lines().find_map(|line| line.strip_prefix(GEOREFERENCE_COMMENT));
    let frame = frame.at(line.map(Georeference::from_text).transpose()?);
    let lines = text.lines().filter(|line| line.starts_with(PART_LINE));
    let labels: Vec<Label> = lines.map(Label::parse).collect::<Option<_>>().ok_or_else(refused)?;
    if header(frame, &labels) == text { Ok((frame, labels, body)) } else { Err(refused()) }
}

fn read_vertex(row: &[u8], number: usize) -> Option<[f64; 3]> {
    let (coordinates, part) = row.split_at(24);
    let double = |at: usize| coordinates[8 * at..].first_chunk().map(|bytes| f64::from_le_bytes(*bytes));
    (part == (number as i32).to_le_bytes()).then_some([double(0)?, double(1)?, double(2)?])
}

fn read_face(row: &[u8], number: usize, first: u32) -> Option<[u32; 3]> {
    let corner = |at: usize| u32::from_le_bytes(*row[1 + 4 * at..].first_chunk()?).checked_sub(first);
    (row[0] == 3 && row[13..] == (number as i32).to_le_bytes()).then_some([corner(0)?, corner(1)?, corner(2)?])
}

fn misplaced(element: &str, number: usize) -> CodecError {
    fault(&format!("a {element} among those of part {number} is of another part; the file is damaged"))
}

fn fault(message: &str) -> CodecError {
    CodecError(format!("PLY file of meshes: {message}"))
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // to the bit
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn meshes() -> Meshes {
        let part = |name: &str, count: u32| Part {
            name: name.into(),
            class: "cube \"\u{e9}\"\n".into(),
            vertices: (0..count + 3).map(|i| [f64::from(i) * 0.1, 5_512_345.123_456_789, -0.0]).collect(),
            triangles: (0..count).map(|i| [i, i + 1, i + 2]).collect(),
        };
        Meshes { frame: Frame::World, parts: vec![part("1", 4), part("", 0), part("\u{1f5ff} end_header", 2)] }
    }

    #[test]
    fn parts_come_back_bit_for_bit() {
        let meshes = meshes();
        let bytes = write(&meshes).unwrap();
        let read_back = read(&bytes).unwrap();
        assert_eq!(read_back, meshes);
        assert!(read_back.parts[0].vertices[0][2].is_sign_negative());
        assert_eq!(write(&read_back).unwrap(), bytes);
        let none = Meshes { frame: Frame::Wall, parts: Vec::new() };
        assert_eq!(read(&write(&none).unwrap()).unwrap(), none);
    }

    #[test]
    fn it_is_a_ply_like_any_other() {
        let meshes = meshes();
        let mesh = crate::format::ply::read_mesh(&write(&meshes).unwrap()).unwrap();
        assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (7 + 3 + 5, 6));
        assert_eq!(mesh.vertices[13], meshes.parts[2].vertices[3]);
        assert_eq!(mesh.triangles[4], [10, 11, 12]);
    }

    #[test]
    fn what_is_not_finite_or_not_there_is_refused_by_name() {
        let mut bad = meshes();
        bad.parts[0].vertices[2][1] = f64::NAN;
        assert!(write(&bad).unwrap_err().0.contains("part `1`: vertex 2"));
        let mut bad = meshes();
        bad.parts[2].triangles[1] = [0, 1, 5];
        assert!(write(&bad).unwrap_err().0.contains("triangle 1 is [0, 1, 5], but there are 5 vertices"));
    }

    #[test]
    fn a_cut_or_damaged_file_is_refused_or_read_but_never_panics() {
        let bytes = write(&meshes()).unwrap();
        for length in 0..bytes.len() {
            assert!(read(&bytes[..length]).is_err(), "length {length}");
        }
        for at in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[at] ^= 0x15;
            if let Ok(found) = read(&damaged) {
                assert_eq!(write(&found).unwrap(), damaged, "byte {at}");
            }
        }
    }

    proptest! {
        #[test]
        fn any_names_come_back(name in any::<String>(), class in any::<String>(), x in -1e300f64..1e300) {
            let part = Part { name, class, vertices: vec![[x, 0.0, x]; 3], triangles: vec![[0, 1, 2]] };
            let meshes = Meshes { frame: Frame::Wall, parts: vec![part] };
            prop_assert_eq!(read(&write(&meshes).unwrap()).unwrap(), meshes);
        }
    }
}
