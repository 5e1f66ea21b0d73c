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

/// Gives the whole file of a surface at once.
pub fn write(surface: &Surface) -> Result<Vec<u8>, CodecError> {
    let mut bytes = Vec::with_capacity(surface.points.len() * 12 + surface.squares.len() + 1024);
    stream(surface, &mut |piece| bytes.extend_from_slice(piece))?;
    Ok(bytes)
}

/// Hands over the file of a surface piece by piece, without a copy of its points.
pub fn stream(surface: &Surface, take: &mut dyn FnMut(&[u8])) -> Result<(), CodecError> {
    let (width, height) = (surface.width, surface.height);
    let header = Header { frame: surface.frame, width, height, origin_m: surface.origin_m, layout: LAYOUT.to_owned() };
    let header = serde_json::to_string(&header).map_err(|e| CodecError(e.to_string()))?;
    take(MAGIC);
    take(header.as_bytes());
    take(b"\n");
    if cfg!(target_endian = "little") {
        take(bytemuck::cast_slice(&surface.points));
    } else {
        surface.points.as_flattened().iter().for_each(|value| take(&value.to_le_bytes()));
    }
    take(&surface.squares);
    Ok(())
}

/// Reads the file of a surface; its length must be what its header says.
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
    let mut points = vec![[0.0f32; 3]; points];
    bytemuck::cast_slice_mut(&mut points).copy_from_slice(&body[..body.len() - squares]);
    if cfg!(target_endian = "big") {
        points.as_flattened_mut().iter_mut().for_each(|value| *value = f32::from_bits(value.to_bits().swap_bytes()));
    }
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
        crate::testing::refuses_every_beginning(&write(&sample()).unwrap(), read);
    }
}
