//! Files between rockface and Python: those that artefacts are kept in, but for rasters, whose values lie plain so that both
//! sides read them where they are.
//!
//! A raster is a line `rockface raster 1`, a line of JSON, and the bands by row: float32, uint8 or uint16, little-endian.

use serde::{Deserialize, Serialize};

use rockface_core::artefact::{Artefact, Band, CodecError, Frame, Grid, Kind, Raster, Sample};
use rockface_core::{StageError, limits};

const MAGIC: &[u8] = b"rockface raster 1\n";

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    columns: usize,
    rows: usize,
    cell_m: f64,
    left_m: f64,
    top_m: f64,
    frame: Frame,
    quantity: String,
    /// `<f4`, `|u1` or `<u2`, as numpy calls them.
    dtype: String,
    bands: Vec<String>,
}

/// The file of an input.
pub fn write(port: &str, artefact: &Artefact) -> Result<Vec<u8>, StageError> {
    let bytes = if let Artefact::Raster(raster) = artefact { write_raster(raster) } else { artefact.encode() };
    bytes.map_err(|error| StageError::new(format!("input `{port}` cannot be written: {error}")))
}

/// The artefact of an output.
pub fn read(kind: Kind, bytes: &[u8]) -> Result<Artefact, CodecError> {
    if kind == Kind::Raster { read_raster(bytes).map(Artefact::Raster) } else { Artefact::decode(kind, bytes) }
}

fn write_raster(raster: &Raster) -> Result<Vec<u8>, CodecError> {
    let grid = &raster.grid;
    let header = Header {
        columns: grid.columns,
        rows: grid.rows,
        cell_m: grid.cell_m,
        left_m: grid.left_m,
        top_m: grid.top_m,
        frame: raster.frame,
        quantity: raster.quantity.clone(),
        dtype: dtype(raster.sample).to_owned(),
        bands: raster.bands.iter().map(|band| band.name.clone()).collect(),
    };
    let header = serde_json::to_string(&header).map_err(|error| CodecError(error.to_string()))?;
    let mut bytes = Vec::with_capacity(MAGIC.len() + header.len() + 64 + raster.bands.len() * grid.cells() * 4);
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(header.as_bytes());
    // Numbers of four bytes are read where they lie, which wants a multiple of their size.
    let padding = (64 - (bytes.len() + 1) % 64) % 64;
    bytes.resize(bytes.len() + padding, b' ');
    bytes.push(b'\n');
    for value in raster.bands.iter().flat_map(|band| &band.values) {
        match raster.sample {
            Sample::Float => bytes.extend_from_slice(&value.to_le_bytes()),
            Sample::Byte => bytes.push(*value as u8),
            Sample::Word => bytes.extend_from_slice(&(*value as u16).to_le_bytes()),
        }
    }
    Ok(bytes)
}

fn dtype(sample: Sample) -> &'static str {
    match sample {
        Sample::Float => "<f4",
        Sample::Byte => "|u1",
        Sample::Word => "<u2",
    }
}

fn read_raster(bytes: &[u8]) -> Result<Raster, CodecError> {
    let damaged = || CodecError::new("the exchanged raster has no header");
    let rest = bytes.strip_prefix(MAGIC).ok_or_else(damaged)?;
    let end = rest.iter().position(|byte| *byte == b'\n').ok_or_else(damaged)?;
    let header: Header = serde_json::from_slice(&rest[..end])
        .map_err(|error| CodecError(format!("the header of the exchanged raster: {error}")))?;
    let samples = [Sample::Float, Sample::Byte, Sample::Word];
    let sample = samples.into_iter().find(|sample| dtype(*sample) == header.dtype);
    let sample = sample.ok_or_else(|| CodecError(format!("values of type {} cannot be kept", header.dtype)))?;
    let size = [4, 1, 2][samples.iter().position(|known| *known == sample).unwrap_or(0)];
    let (body, cells) = (&rest[end + 1..], header.columns.checked_mul(header.rows));
    let wanted = cells.and_then(|cells| cells.checked_mul(header.bands.len())?.checked_mul(size));
    if wanted != Some(body.len()) || body.is_empty() {
        let (Header { columns, rows, bands, .. }, found) = (&header, body.len());
        return Err(CodecError(format!("{} bands of {rows} x {columns} cells do not fit {found} bytes", bands.len())));
    }
    limits::affordable("an exchanged raster", Some((body.len() / size * 4) as u64))?;
    let value = |bytes: &[u8]| match sample {
        Sample::Float => f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
        Sample::Byte => f32::from(bytes[0]),
        Sample::Word => f32::from(u16::from_le_bytes([bytes[0], bytes[1]])),
    };
    let planes = body.chunks_exact(body.len() / header.bands.len());
    let bands = header.bands.into_iter().zip(planes);
    let bands =
        bands.map(|(name, plane)| Band { name, values: plane.chunks_exact(size).map(value).collect() }).collect();
    let (columns, rows, cell_m) = (header.columns, header.rows, header.cell_m);
    let grid = Grid { columns, rows, cell_m, left_m: header.left_m, top_m: header.top_m };
    if !(cell_m > 0.0 && [cell_m, grid.left_m, grid.top_m].iter().all(|number| number.is_finite())) {
        return Err(CodecError(format!("its grid has cells of {cell_m} m at ({}, {})", grid.left_m, grid.top_m)));
    }
    Ok(Raster { grid, frame: header.frame, quantity: header.quantity, sample, bands })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(sample: Sample) -> Raster {
        let grid = Grid { columns: 2, rows: 1, cell_m: 0.5, left_m: -1.0, top_m: 2.0 };
        let band = |name: &str, values| Band { name: name.into(), values };
        let bands = vec![band("a", vec![1.0, 200.0]), band("b", vec![0.0, 7.0])];
        Raster { grid, frame: Frame::Wall, quantity: "mass \"m\"".into(), sample, bands }
    }

    #[test]
    fn rasters_come_back_and_lie_where_they_can_be_mapped() {
        for kind in [Sample::Float, Sample::Byte, Sample::Word] {
            let bytes = write_raster(&sample(kind)).unwrap();
            assert_eq!(read_raster(&bytes).unwrap(), sample(kind));
            assert!((0..bytes.len()).all(|length| read_raster(&bytes[..length]).is_err()));
            let header = bytes.iter().enumerate().filter(|(_, byte)| **byte == b'\n').nth(1).unwrap().0;
            assert_eq!((header + 1) % 64, 0);
        }
    }

    #[test]
    fn impossible_grids_are_refused() {
        let bytes = write_raster(&sample(Sample::Float)).unwrap();
        let bad = String::from_utf8_lossy(&bytes).replace("\"cell_m\":0.5", "\"cell_m\":0.0");
        assert!(read_raster(bad.as_bytes()).is_err());
    }
}
