//! The compact file of a surface: a line of magic, a JSON header, the points, the squares.

use crate::artefact::{CodecError, Frame, Surface};

const MAGIC: &[u8] = b"rockface surface 1\n";

#[derive(serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    frame: Frame,
    width: usize,
    height: usize,
    origin_m: [f64; 3],
    layout: String,
}

const LAYOUT: &str = "points: height x width x 3 float32 little-endian, metres from origin_m, NaN = none; \
                      squares: (height - 1) x (width - 1) uint8, bit 1 first, bit 2 second triangle, bit 4 other diagonal";

/// Writes a surface.
pub fn write(surface: &Surface) -> Result<Vec<u8>, CodecError> {
    let (width, height) = (surface.width, surface.height);
    let header = Header { frame: surface.frame, width, height, origin_m: surface.origin_m, layout: LAYOUT.to_owned() };
    let header = serde_json::to_string(&header).map_err(|e| CodecError(e.to_string()))?;
    let mut bytes =
        Vec::with_capacity(MAGIC.len() + header.len() + 1 + surface.points.len() * 12 + surface.squares.len());
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(header.as_bytes());
    bytes.push(b'\n');
    let start = bytes.len();
    bytes.resize(start + surface.points.len() * 12, 0);
    for (place, [x, y, z]) in bytes[start..].chunks_exact_mut(12).zip(&surface.points) {
        place[..4].copy_from_slice(&x.to_le_bytes());
        place[4..8].copy_from_slice(&y.to_le_bytes());
        place[8..].copy_from_slice(&z.to_le_bytes());
    }
    bytes.extend_from_slice(&surface.squares);
    Ok(bytes)
}

/// Reads a surface.
pub fn read(bytes: &[u8]) -> Result<Surface, CodecError> {
    let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| CodecError::new("not a rockface surface file (version 1)"))?;
    let end =
        rest.iter().position(|b| *b == b'\n').ok_or_else(|| CodecError::new("surface file: header without end"))?;
    let header: Header =
        serde_json::from_slice(&rest[..end]).map_err(|e| CodecError(format!("surface file: bad header: {e}")))?;
    let body = &rest[end + 1..];
    let sizes = |h: &Header| {
        let points = h.width.checked_mul(h.height)?;
        let squares = h.width.checked_sub(1)?.checked_mul(h.height.checked_sub(1)?)?;
        Some((points, squares, points.checked_mul(12)?.checked_add(squares)?))
    };
    let (points, squares, expected) = sizes(&header).ok_or_else(|| CodecError::new("surface file: impossible size"))?;
    if body.len() != expected {
        let (found, w, h) = (body.len(), header.width, header.height);
        return Err(CodecError(format!(
            "surface file: {w} x {h} points need {expected} bytes, found {found}; it is cut short or damaged"
        )));
    }
    let value = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
    let points = body[..points * 12].chunks_exact(12).map(|b| [value(b), value(&b[4..]), value(&b[8..])]).collect();
    Ok(Surface {
        frame: header.frame,
        width: header.width,
        height: header.height,
        origin_m: header.origin_m,
        points,
        squares: body[body.len() - squares..].to_vec(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Surface {
        Surface {
            frame: Frame::Wall,
            width: 2,
            height: 2,
            origin_m: [0.1, 1e6, -3.0],
            points: vec![[0.0, 1.0, 2.0], [f32::NAN; 3], [3.0, -0.0, 5.0], [6.0, 7.0, 8.5]],
            squares: vec![Surface::FIRST],
        }
    }

    #[test]
    fn comes_back_bit_for_bit() {
        assert_eq!(read(&write(&sample()).unwrap()).unwrap(), sample());
    }

    #[test]
    fn a_cut_file_is_refused_at_every_length() {
        let bytes = write(&sample()).unwrap();
        for length in 0..bytes.len() {
            assert!(read(&bytes[..length]).is_err(), "length {length}");
        }
    }
}
