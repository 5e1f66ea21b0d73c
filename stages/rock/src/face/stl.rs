//! Meshes as STL files, text or binary; their loose triangles are joined at exactly equal places.

use super::mesh_file::short;
use super::repair::Places;
use rockface_core::artefact::{CodecError, Frame, Mesh};
use rockface_core::limits;

/// Bytes before the triangles of a binary file: a comment and the number of triangles.
const HEAD: usize = 84;
/// Bytes of a triangle in a binary file: normal, three corners, two bytes of attributes.
const RECORD: usize = 50;

/// Whether this is a text file: it begins with `solid` and comes to a `facet` or to its end.
fn is_text(bytes: &[u8]) -> bool {
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(4096)]);
    let mut words = head.split_whitespace();
    words.next() == Some("solid") && (head.contains("facet") || head.contains("endsolid")) && !is_whole_binary(bytes)
}

/// Whether the number of triangles fits the length. Some programs begin binary files with `solid` too.
fn is_whole_binary(bytes: &[u8]) -> bool {
    promised(bytes).is_some_and(|count| count * RECORD + HEAD == bytes.len())
}

fn promised(bytes: &[u8]) -> Option<usize> {
    let count = bytes.get(HEAD - 4..HEAD)?.try_into().ok()?;
    usize::try_from(u32::from_le_bytes(count)).ok()
}

/// Whether this looks like an STL file: text that begins with `solid`, or bytes that are no text and long enough.
pub fn is_stl(bytes: &[u8]) -> bool {
    is_text(bytes) || is_whole_binary(bytes) || (bytes.len() >= HEAD && bytes[..HEAD].contains(&0))
}

/// Reads the triangles; normals and attributes are ignored, the order of corners counts. A text file keeps all its digits,
/// a binary one holds single precision.
///
/// # Errors
/// The triangle or line at fault: a file that ends too early, coordinates that are not finite, words out of place.
pub fn read(bytes: &[u8]) -> Result<Mesh, CodecError> {
    let mut places = Places::default();
    let triangles = if is_text(bytes) { read_text(bytes, &mut places) } else { read_binary(bytes, &mut places) };
    let triangles = triangles.map_err(|e| CodecError(format!("STL file: {e}")))?;
    Ok(Mesh { frame: Frame::World, vertices: places.vertices, triangles, colours: Vec::new() })
}

/// What other files begin with that are taken for meshes by mistake: binary STL files begin with any 80 bytes.
const OTHERS: [(&[u8], &str); 4] = [
    (b"\x89PNG\r\n", "a PNG picture"),
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"%PDF-", "a PDF document"),
    (b"PK\x03\x04", "a ZIP archive"),
];

fn read_binary(bytes: &[u8], places: &mut Places) -> Result<Vec<[u32; 3]>, String> {
    let count = promised(bytes).ok_or_else(|| format!("{} bytes are too few for the header", bytes.len()))?;
    let held = (bytes.len() - HEAD) / RECORD;
    let other = OTHERS.iter().find(|(begin, _)| held != count && bytes.starts_with(begin));
    if let Some((_, what)) = other {
        return Err(format!("this is {what}, no mesh"));
    }
    if held < count {
        return Err(format!(
            "the header promises {count} triangles, but the file ends after {held}: it was cut short, or is no STL file"
        ));
    }
    if held > count {
        return Err(format!("the header promises {count} triangles, and {held} follow: export it again"));
    }
    let mut triangles = limits::list("triangles", count).map_err(|e| e.0)?;
    for (number, record) in bytes[HEAD..].chunks_exact(RECORD).enumerate() {
        let value =
            |at: usize| f64::from(f32::from_le_bytes([record[at], record[at + 1], record[at + 2], record[at + 3]]));
        let corner = |k: usize| [12 + 12 * k, 16 + 12 * k, 20 + 12 * k].map(value);
        let corners = [corner(0), corner(1), corner(2)];
        finite(&corners).map_err(|e| format!("triangle {number} (counted from 0): {e}"))?;
        triangles.push(corners.map(|place| places.number(place)));
    }
    Ok(triangles)
}

fn finite(corners: &[[f64; 3]]) -> Result<(), String> {
    match corners.iter().find(|corner| !corner.iter().all(|x| x.is_finite())) {
        Some([x, y, z]) => Err(format!("the coordinates ({x}, {y}, {z}) are not finite")),
        None => Ok(()),
    }
}

fn read_text(bytes: &[u8], places: &mut Places) -> Result<Vec<[u32; 3]>, String> {
    let text = std::str::from_utf8(bytes).map_err(|e| format!("byte {} is not text", e.valid_up_to()))?;
    let (mut triangles, mut corners) = (Vec::new(), Vec::new());
    let mut ended = false;
    for (number, line) in text.lines().enumerate() {
        let mut words = line.split_whitespace();
        let at = |message: String| format!("line {}: {message}", number + 1);
        match words.next() {
            Some("vertex") => corners.push(vertex(words).map_err(at)?),
            Some("endloop") => {
                let found: [[f64; 3]; 3] = std::mem::take(&mut corners)
                    .try_into()
                    .map_err(|c: Vec<_>| at(format!("a triangle has 3 corners, not {}", c.len())))?;
                triangles.push(found.map(|place| places.number(place)));
            }
            None => {}
            Some("solid" | "facet" | "outer" | "endfacet") => ended = false,
            Some("endsolid") => ended = true,
            Some(word) => {
                return Err(at(format!("`{}` is no word of the format", short(word))));
            }
        }
    }
    if ended || triangles.is_empty() {
        return Ok(triangles);
    }
    Err(format!("the file ends without `endsolid` after {} triangles: it was cut short", triangles.len()))
}

fn vertex<'a>(words: impl Iterator<Item = &'a str>) -> Result<[f64; 3], String> {
    let number = |word: &str| word.parse::<f64>().map_err(|_| format!("`{}` is not a number", short(word)));
    let values = words.map(number).collect::<Result<Vec<f64>, _>>()?;
    let count = values.len();
    let place: [f64; 3] = values.try_into().map_err(|_| format!("a vertex has 3 coordinates, not {count}"))?;
    finite(&[place])?;
    Ok(place)
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // to the bit
mod tests {
    use super::*;
    use rockface_core::testing::height_mesh;

    fn binary(mesh: &Mesh, head: &[u8]) -> Vec<u8> {
        let mut bytes = vec![b' '; 80];
        bytes[..head.len()].copy_from_slice(head);
        bytes.extend((mesh.triangles.len() as u32).to_le_bytes());
        for triangle in &mesh.triangles {
            bytes.extend([0; 12]);
            let corners = triangle.iter().flat_map(|i| mesh.vertices[*i as usize]);
            corners.for_each(|x| bytes.extend((x as f32).to_le_bytes()));
            bytes.extend([0; 2]);
        }
        bytes
    }

    fn text(mesh: &Mesh) -> String {
        let mut text = "solid rock face\n".to_owned();
        for triangle in &mesh.triangles {
            text += " facet normal 0 0 1\n  outer loop\n";
            for [x, y, z] in triangle.map(|i| mesh.vertices[i as usize]) {
                text += &format!("   vertex {x} {y} {z:e}\n");
            }
            text += "  endloop\n endfacet\n";
        }
        text + "endsolid rock face\n"
    }

    fn corners(mesh: &Mesh) -> Vec<[[f64; 3]; 3]> {
        mesh.triangles.iter().map(|t| t.map(|i| mesh.vertices[i as usize])).collect()
    }

    #[test]
    fn both_kinds_give_the_joined_mesh_back() {
        let mesh = height_mesh(4, [0.0, 8.0, 0.0, 8.0], |x, _| x / 4.0);
        for head in ["binary", "solid that is binary facet"] {
            let bytes = binary(&mesh, head.as_bytes());
            assert!(is_stl(&bytes));
            let read = read(&bytes).unwrap();
            assert_eq!((read.vertices.len(), corners(&read)), (25, corners(&mesh)));
        }
        let utm = height_mesh(4, [451_000.01, 451_008.03, 0.0, 8.0], |x, _| x / 3.0);
        assert!(is_stl(text(&utm).as_bytes()));
        let read = read(text(&utm).as_bytes()).unwrap();
        assert_eq!((read.vertices.len(), corners(&read)), (25, corners(&utm)));
    }

    #[test]
    fn what_is_cut_short_or_not_finite_is_named() {
        let mut mesh = height_mesh(2, [0.0, 8.0, 0.0, 8.0], |_, _| 0.0);
        let whole = binary(&mesh, b"\0");
        assert!(is_stl(&whole[..300]));
        assert!(read(&whole[..300]).unwrap_err().0.contains("promises 8 triangles, but the file ends after 4"));
        let mut more = whole.clone();
        more[HEAD - 4] = 7;
        assert!(read(&more).unwrap_err().0.contains("promises 7 triangles, and 8 follow"));
        let picture = [b"\x89PNG\r\n", &whole[6..]].concat();
        assert!(read(&picture[..300]).unwrap_err().0.contains("this is a PNG picture"));
        let words = text(&mesh);
        assert!(read(&words.as_bytes()[..words.len() / 2]).unwrap_err().0.contains("cut short"));
        assert!(read(words.replacen("vertex", "wertex", 1).as_bytes()).unwrap_err().0.contains("line 4: `wertex`"));
        assert!(
            read(words.replacen("   vertex 0 0 0e0\n", "", 1).as_bytes()).unwrap_err().0.contains("3 corners, not 2")
        );
        mesh.vertices[0][1] = f64::NAN;
        assert!(
            read(&binary(&mesh, b""))
                .unwrap_err()
                .0
                .contains("triangle 0 (counted from 0): the coordinates (0, NaN, 0)")
        );
        assert!(read(text(&mesh).as_bytes()).unwrap_err().0.contains("not finite"));
    }
}
