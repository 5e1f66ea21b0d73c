//! Writes a raster as GeoTIFF; the same raster gives the same bytes.

use std::io::Cursor;

use rayon::prelude::*;
use tiff::encoder::compression::{CompressionAlgorithm, Deflate, DeflateLevel};
use tiff::encoder::{DirectoryEncoder, TiffEncoder, TiffKindStandard};
use tiff::tags::Tag;

use super::tags;
use crate::artefact::{CodecError, Raster, Sample};

/// Side of a tile, cells; TIFF wants a multiple of 16.
pub const TILE: usize = 256;

/// Classic TIFF addresses 4 GiB; what DEFLATE may add to data it cannot shrink stays far below the difference.
pub const LARGEST: usize = 4_000_000_000;

pub const DEFLATE: u16 = 8;
const HORIZONTAL: u16 = 2;
const FLOATING_POINT: u16 = 3;
pub const PLANAR: u16 = 2;
pub const BLACK_IS_ZERO: u16 = 1;
pub const UNSPECIFIED: u16 = 0;

/// Writes a raster.
///
/// # Errors
/// A raster without cells or bands, a band of the wrong length, a raster of whole numbers with values that are none or
/// are too large for its sample, a cell size that is not positive, or more than 4 GB of values.
pub fn write(raster: &Raster) -> Result<Vec<u8>, CodecError> {
    check(raster)?;
    let tiles = tiles(raster)?;
    let size: usize = tiles.iter().map(Vec::len).sum();
    if size > LARGEST {
        return Err(CodecError(format!("{size} bytes are too many for one GeoTIFF; split the bands over several")));
    }
    assemble(raster, &tiles).map_err(|e| CodecError(format!("cannot write GeoTIFF: {e}")))
}

/// The compressed tiles, band by band, from the upper left.
pub fn tiles(raster: &Raster) -> Result<Vec<Vec<u8>>, CodecError> {
    let (across, down) = (raster.grid.columns.div_ceil(TILE), raster.grid.rows.div_ceil(TILE));
    let count = across * down * raster.bands.len();
    let tile = |index: usize| {
        let (band, tile) = (index / (across * down), index % (across * down));
        compress(&tile_bytes(raster, band, tile / across, tile % across))
    };
    (0..count).into_par_iter().map(tile).collect()
}

/// Refuses what no GeoTIFF can hold.
pub fn check(raster: &Raster) -> Result<(), CodecError> {
    let (columns, rows) = (raster.grid.columns, raster.grid.rows);
    if columns == 0 || rows == 0 || raster.bands.is_empty() || raster.bands.len() > usize::from(u16::MAX) {
        let bands = raster.bands.len();
        return Err(CodecError(format!(
            "a GeoTIFF needs cells and bands; this raster is {columns} x {rows} x {bands}"
        )));
    }
    if u32::try_from(columns.max(rows)).is_err() || !(raster.grid.cell_m > 0.0 && raster.grid.cell_m.is_finite()) {
        return Err(CodecError(format!("impossible grid: {columns} x {rows} cells of {} m", raster.grid.cell_m)));
    }
    for band in &raster.bands {
        let found = band.values.len();
        if found != columns * rows {
            return Err(CodecError(format!("band `{}` has {found} values for {columns} x {rows} cells", band.name)));
        }
        let whole = |v: &f32, largest: u16| f32::from((*v as u16).min(largest)).to_bits() == v.to_bits();
        if let Some(largest) = raster.sample.largest()
            && let Some(bad) = band.values.iter().find(|v| !whole(v, largest))
        {
            return Err(CodecError(format!(
                "band `{}` of a raster of whole numbers holds {bad}, not a whole number from 0 to {largest}",
                band.name
            )));
        }
    }
    Ok(())
}

/// The bytes of one tile with the predictor applied; cells beyond the edge repeat nothing and are 0.
fn tile_bytes(raster: &Raster, band: usize, down: usize, across: usize) -> Vec<u8> {
    let grid = &raster.grid;
    let values = &raster.bands[band].values;
    let (left, top) = (across * TILE, down * TILE);
    let width = TILE.min(grid.columns - left);
    let bytes_each = usize::from(bits(raster.sample) / 8);
    let mut bytes = vec![0u8; TILE * TILE * bytes_each];
    for (row, out) in bytes.chunks_exact_mut(TILE * bytes_each).enumerate().take(grid.rows - top) {
        let start = (top + row) * grid.columns + left;
        match raster.sample {
            Sample::Float => float_row(&values[start..start + width], out),
            Sample::Byte => byte_row(&values[start..start + width], out),
            Sample::Word => word_row(&values[start..start + width], out),
        }
    }
    bytes
}

/// Predictor 3: the bytes of all values by significance, then differences of neighbouring bytes.
fn float_row(values: &[f32], out: &mut [u8]) {
    for (column, value) in values.iter().enumerate() {
        let value = if value.is_nan() { f32::NAN } else { *value };
        for (plane, byte) in value.to_be_bytes().into_iter().enumerate() {
            out[plane * TILE + column] = byte;
        }
    }
    differences(out);
}

/// Predictor 2 on bytes: differences of neighbours.
fn byte_row(values: &[f32], out: &mut [u8]) {
    for (byte, value) in out.iter_mut().zip(values) {
        *byte = *value as u8;
    }
    differences(out);
}

/// Predictor 2 on words: differences of neighbours, little-endian.
fn word_row(values: &[f32], out: &mut [u8]) {
    let mut last = 0u16;
    let words = values.iter().map(|value| *value as u16).chain(std::iter::repeat(0));
    for (bytes, word) in out.chunks_exact_mut(2).zip(words) {
        bytes.copy_from_slice(&word.wrapping_sub(last).to_le_bytes());
        last = word;
    }
}

fn differences(bytes: &mut [u8]) {
    for i in (1..bytes.len()).rev() {
        bytes[i] = bytes[i].wrapping_sub(bytes[i - 1]);
    }
}

fn compress(bytes: &[u8]) -> Result<Vec<u8>, CodecError> {
    let mut compressed = Vec::with_capacity(bytes.len() / 2);
    Deflate::with_level(DeflateLevel::Fast)
        .write_to(&mut compressed, bytes)
        .map_err(|e| CodecError(format!("cannot compress: {e}")))?;
    Ok(compressed)
}

/// Bits of a value.
pub fn bits(sample: Sample) -> u16 {
    match sample {
        Sample::Float => 32,
        Sample::Byte => 8,
        Sample::Word => 16,
    }
}

/// The values of the tags `SampleFormat` and `Predictor`.
pub fn coding(sample: Sample) -> (u16, u16) {
    if sample == Sample::Float { (3, FLOATING_POINT) } else { (1, HORIZONTAL) }
}

type Directory<'a, 'b> = DirectoryEncoder<'a, &'b mut Cursor<Vec<u8>>, TiffKindStandard>;

fn assemble(raster: &Raster, tiles: &[Vec<u8>]) -> tiff::TiffResult<Vec<u8>> {
    let mut file = Cursor::new(Vec::with_capacity(tiles.iter().map(Vec::len).sum::<usize>() + 4096));
    let mut encoder = TiffEncoder::new(&mut file)?;
    let mut directory = encoder.image_directory()?;
    let mut offsets = Vec::with_capacity(tiles.len());
    for tile in tiles {
        offsets.push(directory.write_data(tile.as_slice())? as u32);
    }
    let lengths: Vec<u32> = tiles.iter().map(|tile| tile.len() as u32).collect();
    directory.write_tag(Tag::TileOffsets, offsets.as_slice())?;
    directory.write_tag(Tag::TileByteCounts, lengths.as_slice())?;
    write_layout(raster, &mut directory)?;
    write_georeference(raster, &mut directory)?;
    directory.finish()?;
    Ok(file.into_inner())
}

fn write_layout(raster: &Raster, directory: &mut Directory) -> tiff::TiffResult<()> {
    let bands = raster.bands.len();
    let (format, predictor) = coding(raster.sample);
    directory.write_tag(Tag::ImageWidth, raster.grid.columns as u32)?;
    directory.write_tag(Tag::ImageLength, raster.grid.rows as u32)?;
    directory.write_tag(Tag::TileWidth, TILE as u32)?;
    directory.write_tag(Tag::TileLength, TILE as u32)?;
    directory.write_tag(Tag::BitsPerSample, vec![bits(raster.sample); bands].as_slice())?;
    directory.write_tag(Tag::SampleFormat, vec![format; bands].as_slice())?;
    directory.write_tag(Tag::SamplesPerPixel, bands as u16)?;
    directory.write_tag(Tag::PlanarConfiguration, PLANAR)?;
    directory.write_tag(Tag::PhotometricInterpretation, BLACK_IS_ZERO)?;
    directory.write_tag(Tag::Compression, DEFLATE)?;
    directory.write_tag(Tag::Predictor, predictor)?;
    if bands > 1 {
        directory.write_tag(Tag::ExtraSamples, vec![UNSPECIFIED; bands - 1].as_slice())?;
    }
    Ok(())
}

fn write_georeference(raster: &Raster, directory: &mut Directory) -> tiff::TiffResult<()> {
    let (keys, citation) = tags::geo_keys(raster.frame);
    directory.write_tag(Tag::ModelPixelScaleTag, tags::pixel_scale(&raster.grid).as_slice())?;
    directory.write_tag(Tag::ModelTiepointTag, tags::tiepoint(&raster.grid).as_slice())?;
    directory.write_tag(Tag::GeoKeyDirectoryTag, keys.as_slice())?;
    directory.write_tag(Tag::GeoAsciiParamsTag, citation.as_str())?;
    directory.write_tag(Tag::Unknown(tags::GDAL_METADATA), tags::metadata(raster).as_str())?;
    if raster.sample == Sample::Float {
        directory.write_tag(Tag::GdalNodata, "nan")?;
    }
    Ok(())
}
