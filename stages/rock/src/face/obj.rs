//! Meshes as Wavefront OBJ files: vertices with or without colours, and polygons.
//!
//! Read here and not by a library because shared vertices must stay shared: loaders made for drawing split a mesh at
//! every group and material, which tears a surface.

use super::mesh_file::short;
use rockface_core::artefact::{CodecError, Frame, Mesh};
use rockface_core::limits::Stop;

/// Words that may begin a line; everything but vertices and faces is skipped.
const WORDS: [&str; 12] = ["v", "vn", "vt", "vp", "f", "o", "g", "s", "l", "p", "usemtl", "mtllib"];

/// Whether this looks like an OBJ file: its first line that is no comment begins with a word of the format.
pub fn is_obj(bytes: &[u8]) -> bool {
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(1 << 16)]);
    let mut words = head.lines().filter_map(|line| line.split_whitespace().next());
    words.find(|word| !word.starts_with('#')).is_some_and(|word| WORDS.contains(&word))
}

/// Reads vertices and faces; polygons are cut into fans, groups and materials ignored.
///
/// Colours after the coordinates (as MeshLab writes them, 0 to 1) are kept where every vertex has them.
///
/// # Errors
/// The line at fault: a number that is none or not finite, a corner that is not there, a face of fewer than three;
/// `cancelled` became true.
pub fn read(bytes: &[u8], cancelled: &dyn Fn() -> bool) -> Result<Mesh, CodecError> {
    let mut mesh = Mesh { frame: Frame::World, vertices: Vec::new(), triangles: Vec::new(), colours: Vec::new() };
    let mut joined = String::new();
    let mut stop = Stop::when(cancelled);
    for (number, line) in bytes.split(|byte| *byte == b'\n').enumerate() {
        stop.check()?;
        let line = std::str::from_utf8(line).or_else(|e| std::str::from_utf8(&line[..e.valid_up_to()])).unwrap_or("");
        let line = line.trim_end();
        if let Some(begun) = line.strip_suffix('\\') {
            joined.push_str(begun);
            joined.push(' ');
            continue;
        }
        joined.push_str(line);
        read_line(&joined, &mut mesh).map_err(|e| CodecError(format!("OBJ file, line {}: {e}", number + 1)))?;
        joined.clear();
    }
    if !joined.is_empty() {
        return Err(CodecError::new("OBJ file: the last line is continued by `\\`, but nothing follows"));
    }
    if mesh.colours.len() != mesh.vertices.len() {
        mesh.colours.clear();
    }
    Ok(mesh)
}

fn read_line(line: &str, mesh: &mut Mesh) -> Result<(), String> {
    let line = line.split('#').next().unwrap_or_default();
    let mut words = line.split_whitespace();
    match words.next() {
        Some("v") => read_vertex(words, mesh),
        Some("f") => read_face(words, mesh),
        Some(word) if !WORDS.contains(&word) && mesh.vertices.is_empty() => {
            Err(format!("`{}` is no word of the format", short(word)))
        }
        _ => Ok(()),
    }
}

fn read_vertex<'a>(words: impl Iterator<Item = &'a str>, mesh: &mut Mesh) -> Result<(), String> {
    let mut values = [0.0f64; 7];
    let mut count = 0;
    for (word, value) in words.zip(&mut values) {
        *value = word.parse().map_err(|_| format!("`{}` is not a number", short(word)))?;
        if !value.is_finite() {
            return Err(format!("the coordinate {value} is not finite"));
        }
        count += 1;
    }
    if count < 3 {
        return Err(format!("a vertex needs x, y and z, but here are {count} numbers"));
    }
    mesh.vertices.push([values[0], values[1], values[2]]);
    // Four numbers: the fourth is a weight. Six: a colour. Seven: weight and colour.
    if count >= 6 && mesh.colours.len() + 1 == mesh.vertices.len() {
        let byte = |share: &f64| (share.clamp(0.0, 1.0) * 255.0).round() as u8;
        let colour = &values[count - 3..count];
        mesh.colours.push([byte(&colour[0]), byte(&colour[1]), byte(&colour[2])]);
    }
    Ok(())
}

fn read_face<'a>(words: impl Iterator<Item = &'a str>, mesh: &mut Mesh) -> Result<(), String> {
    let mut corners = words.map(|word| corner(word, mesh.vertices.len())).collect::<Result<Vec<u32>, _>>()?;
    // Some writers repeat the first corner at the end.
    if corners.len() > 3 && corners.first() == corners.last() {
        corners.pop();
    }
    if corners.len() < 3 {
        return Err(format!("{} corners are too few for a face", corners.len()));
    }
    let first = corners[0];
    mesh.triangles.extend(corners[1..].windows(2).map(|pair| [first, pair[0], pair[1]]));
    Ok(())
}

/// `7`, `7/1`, `7//3` or `7/1/3`, counted from 1; negative numbers count back from the latest vertex.
fn corner(word: &str, vertices: usize) -> Result<u32, String> {
    let text = word.split('/').next().unwrap_or_default();
    let number: i64 = text.parse().map_err(|_| format!("`{}` is not a corner", short(word)))?;
    let place = if number < 0 { number.checked_add(vertices as i64) } else { number.checked_sub(1) };
    place.and_then(|place| u32::try_from(place).ok()).filter(|place| (*place as usize) < vertices).ok_or_else(|| {
        format!("corner {number} is not one of the {vertices} vertices before it (counted from 1, or back from -1)")
    })
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // to the bit
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> Result<Mesh, CodecError> {
        super::read(bytes, &|| false)
    }

    const SQUARE: &str = "# a square\nmtllib rock.mtl\no face\nv 451000.0125 5512000.0375 0.1\nv 451001 5512000 0 1.0\ng one\n\
        v 451001 5512001 0\nv 451000 5512001 0\nvn 0 0 1\nusemtl rock\nf 1/1/1 2//1 3\ng two\nf -4 -2 \\\n -1 # shared\n";

    #[test]
    fn groups_share_their_vertices_and_no_digit_is_lost() {
        assert!(is_obj(SQUARE.as_bytes()));
        let mesh = read(SQUARE.as_bytes()).unwrap();
        assert_eq!(mesh.vertices.len(), 4);
        assert_eq!(mesh.vertices[0], [451_000.012_5, 5_512_000.037_5, 0.1]);
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert!(mesh.colours.is_empty());
    }

    #[test]
    fn polygons_are_fans_and_colours_are_kept() {
        let text =
            "v 0 0 0 1 0 0.5\r\nv 1 0 0 0 0 0\r\nv 2 1 0 0 1 0\r\nv 1 2 0 0 0 0\r\nv 0 1 0 0 0 1\r\nf 1 2 3 4 5\r\n";
        let mesh = read(text.as_bytes()).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [0, 3, 4]]);
        assert_eq!(mesh.colours[0], [255, 0, 128]);
    }

    #[test]
    fn faults_name_their_line() {
        let fault = |text: &str| read(text.as_bytes()).unwrap_err().0;
        assert!(fault("v 0 0 0\nv 1 x 0\n").contains("line 2: `x` is not a number"));
        assert!(fault("v 0 0 nan\n").contains("line 1: the coordinate NaN is not finite"));
        assert!(fault("v 0 0\n").contains("needs x, y and z"));
        assert!(fault("v 0 0 0\nf 1 1 2\n").contains("corner 2 is not one of the 1 vertices"));
        assert!(fault("v 0 0 0\nf 0 1 1\n").contains("corner 0"));
        assert!(fault("v 0 0 0\nf 1 1\n").contains("2 corners are too few"));
        assert!(fault("v 0 0 0\nf 1 1 \\").contains("nothing follows"));
        assert!(!is_obj(b"once upon a time"));
    }
}
