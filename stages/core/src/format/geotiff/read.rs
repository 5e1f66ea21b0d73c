//! Reads GeoTIFF files, our own and foreign ones; damaged files are refused with a reason.

use std::io::Cursor;

use tiff::decoder::{ChunkType, Decoder, DecodingResult, Limits};
use tiff::tags::{PlanarConfiguration, Tag};

use super::tags::{GDAL_METADATA, Metadata, Placement, Scaling};
use crate::artefact::{Band, CodecError, Frame, Grid, Raster, Sample};
use crate::crs::geo_keys::GeoKeys;
use crate::crs::{Kind, Stated};
use crate::limits;

type File<'a> = Decoder<Cursor<&'a [u8]>>;

/// Neither DEFLATE (1032) nor LZW (1370) can expand further than this; a file that claims more is damaged.
const LARGEST_EXPANSION: usize = 1400;
/// Bytes of the largest value.
const LARGEST_VALUE_BYTES: usize = 8;
/// Bytes of tags and of one tile or strip that are always allowed.
const LEAST_LIMIT_BYTES: usize = 1 << 20;

/// The number of no compression.
const UNCOMPRESSED: u16 = 1;
/// Extra samples that are transparency, associated or not.
const ALPHA: [u16; 2] = [1, 2];
/// The bit of the kind of a directory that says that it is a mask.
const MASK: u32 = 4;
/// Directories that are looked at.
const MOST_DIRECTORIES: usize = 64;

/// What the refusal of a GeoTIFF begins with whose bytes are not those that were once written.
pub const DAMAGED: &str = "damaged GeoTIFF";

/// Quantity of a file that does not say what its values are.
const UNNAMED: &str = "value";

/// Reads a raster. Bands without a name are called `band 1`, `band 2`, ...; cells with the no-data value become NaN, and
/// numbers with a scale or an offset (GDAL's metadata) the values they stand for.
///
/// # Errors
/// A file that is no TIFF, is cut short or damaged, has no georeference, cells that are not square, or a scale that is no
/// number.
pub fn read(bytes: &[u8]) -> Result<Raster, CodecError> {
    let mut file = opened(bytes)?;
    let layout = Layout::of(&mut file, bytes.len())?;
    let grid = placement(&mut file).grid(layout.columns, layout.rows)?;
    let metadata = metadata(&mut file);
    let nodata = ascii(&mut file, Tag::GdalNodata).and_then(|text| text.trim().parse::<f64>().ok());
    let scalings = metadata.scalings(layout.bands)?;
    let (planes, sample) = values(&mut file, &layout, nodata, scalings.as_deref())?;
    check_masks(&mut file)?;
    Ok(named(grid, &metadata, sample, planes))
}

/// Refuses a file that says by a mask of its own, or by a band of transparency, which cells have a value: they would all count.
fn check_masks(file: &mut File) -> Result<(), CodecError> {
    let way = "write no-data instead: `gdalwarp -dstnodata nan IN OUT`";
    let extra = file.find_tag_unsigned_vec::<u16>(Tag::ExtraSamples).ok().flatten().unwrap_or_default();
    if extra.iter().any(|what| ALPHA.contains(what)) {
        return Err(CodecError(format!("a GeoTIFF with a band of transparency (alpha), which is not read; {way}")));
    }
    for _ in 0..MOST_DIRECTORIES {
        if !file.more_images() || file.next_image().is_err() {
            break;
        }
        let kind = file.find_tag_unsigned::<u32>(Tag::NewSubfileType).ok().flatten().unwrap_or(0);
        if kind & MASK != 0 {
            return Err(CodecError(format!("a GeoTIFF with a mask of its own, which is not read; {way}")));
        }
    }
    Ok(())
}

/// What a file states about its place on the Earth, without its values.
#[derive(Debug, Default)]
pub struct System {
    /// The frame that our own files state, with its georeference.
    pub frame: Option<Frame>,
    /// The system that its keys state.
    pub stated: Option<Stated>,
    /// Its upper left corner.
    pub corner: Option<[f64; 3]>,
}

/// Reads what a file states about its place on the Earth.
///
/// # Errors
/// A file that is no TIFF or is damaged.
pub fn read_system(bytes: &[u8]) -> Result<System, CodecError> {
    let mut file = opened(bytes)?;
    let placement = placement(&mut file);
    let doubles = file.get_tag_f64_vec(Tag::GeoDoubleParamsTag).unwrap_or_default();
    let texts = ascii(&mut file, Tag::GeoAsciiParamsTag).unwrap_or_default();
    let keys = GeoKeys { directory: &placement.keys, doubles: &doubles, ascii: &texts };
    let frame = metadata(&mut file).placed();
    // Of a code that is not known here, and of heights without a code, our own files have the definition too.
    let own = || frame.and_then(Frame::crs).map(Stated::of_crs);
    let is_better = |own: &Stated, stated: &Stated| {
        stated.kind == Kind::Unknown || own.states_heights() && !stated.states_heights() && own.agrees_with(stated)
    };
    let stated = keys.stated().map(|stated| own().filter(|own| is_better(own, &stated)).unwrap_or(stated));
    let corner = placement.corner().ok().map(|[_, _, left, top]| [left, top, 0.0]);
    Ok(System { frame, stated, corner })
}

fn opened(bytes: &[u8]) -> Result<File<'_>, CodecError> {
    if ![b"II", b"MM"].iter().any(|order| bytes.starts_with(*order)) {
        return Err(CodecError::new("not a GeoTIFF that can be read: it does not begin like a TIFF"));
    }
    let file = Decoder::new(Cursor::new(bytes)).map_err(|e| refused(&e))?;
    let mut limits = Limits::default();
    let possible = bytes.len().saturating_mul(LARGEST_EXPANSION).max(LEAST_LIMIT_BYTES);
    limits.decoding_buffer_size = possible.min(1 << 30);
    limits.intermediate_buffer_size = bytes.len().max(LEAST_LIMIT_BYTES);
    limits.ifd_value_size = 1 << 26;
    Ok(file.with_limits(limits))
}

fn metadata(file: &mut File) -> Metadata {
    ascii(file, Tag::Unknown(GDAL_METADATA)).map_or_else(Metadata::default, |xml| Metadata::parse(&xml))
}

fn refused(error: &tiff::TiffError) -> CodecError {
    match error {
        tiff::TiffError::UnsupportedError(what) => CodecError(format!(
            "a GeoTIFF of a kind that cannot be read ({what}); rewrite it with `gdal_translate -co COMPRESS=DEFLATE`"
        )),
        // Bytes are in memory: what fails in the stream is its end or its compression.
        tiff::TiffError::IoError(what) => damaged(&what.to_string()),
        _ => CodecError(format!("not a GeoTIFF that can be read: {error}")),
    }
}

fn damaged(what: &str) -> CodecError {
    CodecError(format!("{DAMAGED}: {what}; copy it again"))
}

fn named(grid: Grid, metadata: &Metadata, sample: Sample, planes: Vec<Vec<f32>>) -> Raster {
    let name = |index: usize| metadata.names.get(&index).cloned().unwrap_or_else(|| format!("band {}", index + 1));
    let bands = planes.into_iter().enumerate().map(|(index, values)| Band { name: name(index), values }).collect();
    let quantity = metadata.quantity.clone().unwrap_or_else(|| UNNAMED.to_owned());
    Raster { grid, frame: metadata.placed().unwrap_or(Frame::Wall), quantity, sample, bands }
}

/// How the values lie in the file.
struct Layout {
    columns: usize,
    rows: usize,
    bands: usize,
    planar: bool,
    chunk_columns: usize,
    chunk_rows: usize,
}

impl Layout {
    fn of(file: &mut File, file_length: usize) -> Result<Self, CodecError> {
        let (columns, rows) = file.dimensions().map_err(|e| refused(&e))?;
        let (columns, rows) = (columns as usize, rows as usize);
        let bands = usize::from(number(file, Tag::SamplesPerPixel)?.unwrap_or(1));
        let photometric = number(file, Tag::PhotometricInterpretation)?.unwrap_or(1);
        if photometric > 2 || (photometric == 2 && bands > 4) {
            return Err(CodecError(format!(
                "a picture (photometric interpretation {photometric}) is not a raster of values"
            )));
        }
        let planar = number(file, Tag::PlanarConfiguration)? == Some(PlanarConfiguration::Planar.to_u16());
        let (chunk_columns, chunk_rows) = chunk_size(file, columns, rows)?;
        let layout = Self { columns, rows, bands, planar, chunk_columns, chunk_rows };
        layout.check(file_length).map(|()| layout)
    }

    /// Refuses values, padding of the tiles at the edges included, that the bytes of the file or the memory cannot hold.
    fn check(&self, file_length: usize) -> Result<(), CodecError> {
        let Self { columns, rows, bands, .. } = *self;
        let padded = |length: usize, chunk: usize| length.div_ceil(chunk).checked_mul(chunk);
        let wide = padded(columns, self.chunk_columns).zip(padded(rows, self.chunk_rows));
        let values = wide.and_then(|(wide, high)| wide.checked_mul(high)).and_then(|n| n.checked_mul(bands));
        let possible = file_length.saturating_mul(LARGEST_EXPANSION);
        if !values.is_some_and(|values| values > 0 && values <= possible) {
            return Err(damaged(&format!("{columns} x {rows} x {bands} values in {file_length} bytes")));
        }
        let chunk = self.chunk_columns.saturating_mul(self.chunk_rows).saturating_mul(self.interleaved());
        let bytes = (4 * columns * rows * bands).checked_add(chunk.saturating_mul(LARGEST_VALUE_BYTES));
        let what = format!("GeoTIFF of {file_length} bytes: {columns} x {rows} x {bands} values");
        limits::affordable(&what, bytes.map(|bytes| bytes as u64))
    }

    /// Values of one cell that stand side by side.
    fn interleaved(&self) -> usize {
        if self.planar { 1 } else { self.bands }
    }

    fn across(&self) -> usize {
        self.columns.div_ceil(self.chunk_columns)
    }

    fn chunks(&self) -> usize {
        let plane = self.across() * self.rows.div_ceil(self.chunk_rows);
        if self.planar { plane * self.bands } else { plane }
    }

    /// First band, left column, top row, columns and rows of a chunk without its padding.
    fn place(&self, chunk: usize) -> [usize; 5] {
        let plane = self.across() * self.rows.div_ceil(self.chunk_rows);
        let (band, within) = (chunk / plane, chunk % plane);
        let (left, top) = (within % self.across() * self.chunk_columns, within / self.across() * self.chunk_rows);
        [band, left, top, self.chunk_columns.min(self.columns - left), self.chunk_rows.min(self.rows - top)]
    }
}

fn number(file: &mut File, tag: Tag) -> Result<Option<u16>, CodecError> {
    file.find_tag_unsigned(tag).map_err(|e| refused(&e))
}

fn chunk_size(file: &mut File, columns: usize, rows: usize) -> Result<(usize, usize), CodecError> {
    let mut side = |tag| file.find_tag_unsigned::<u32>(tag).map_err(|e| refused(&e));
    let (width, height) = (side(Tag::TileWidth)?, side(Tag::TileLength)?);
    let strip = side(Tag::RowsPerStrip)?;
    let (width, height) = match file.get_chunk_type() {
        ChunkType::Tile => (width.unwrap_or(0) as usize, height.unwrap_or(0) as usize),
        ChunkType::Strip => (columns, strip.map_or(rows, |r| (r as usize).min(rows))),
    };
    if width == 0 || height == 0 { Err(damaged("tiles or strips without size")) } else { Ok((width, height)) }
}

fn values(
    file: &mut File,
    layout: &Layout,
    nodata: Option<f64>,
    scalings: Option<&[Scaling]>,
) -> Result<(Vec<Vec<f32>>, Sample), CodecError> {
    let mut planes = Vec::with_capacity(layout.bands);
    for _ in 0..layout.bands {
        let mut plane = limits::list("values", layout.columns * layout.rows)?;
        plane.resize(layout.columns * layout.rows, f32::NAN);
        planes.push(plane);
    }
    let is_plain = nodata.is_none() && scalings.is_none();
    let mut sample = Sample::Float;
    let left_out = left_out(file, layout, nodata)?;
    for chunk in (0..layout.chunks()).filter(|chunk| !left_out.get(*chunk).is_some_and(|is_left_out| *is_left_out)) {
        let decoded = file.read_chunk(chunk as u32).map_err(|e| refused(&e))?;
        sample = match decoded {
            DecodingResult::U8(_) if is_plain => Sample::Byte,
            DecodingResult::U16(_) if is_plain => Sample::Word,
            _ => Sample::Float,
        };
        let [band, left, top, width, height] = layout.place(chunk);
        let bands = band..band + layout.interleaved();
        let scalings = scalings.map(|scalings| &scalings[bands.clone()]);
        let place = Place { layout, chunk, left, top, width, height };
        place.fill(&mut planes[bands], &decoded, nodata, scalings)?;
    }
    Ok((planes, sample))
}

/// Which tiles or strips the file leaves out since they have no value (GDAL's `SPARSE_OK`): they have no bytes.
///
/// # Errors
/// They have no bytes and no no-data value stands for that; one that is not compressed has fewer bytes than its cells take, and would go on
/// with whatever follows it in the file.
fn left_out(file: &mut File, layout: &Layout, nodata: Option<f64>) -> Result<Vec<bool>, CodecError> {
    let is_tiled = file.get_chunk_type() == ChunkType::Tile;
    let tag = if is_tiled { Tag::TileByteCounts } else { Tag::StripByteCounts };
    let counts = file.find_tag_unsigned_vec::<u64>(tag).map_err(|e| refused(&e))?.unwrap_or_default();
    let left_out: Vec<bool> = counts.iter().map(|bytes| *bytes == 0).collect();
    let bits = file.find_tag_unsigned_vec::<u16>(Tag::BitsPerSample).map_err(|e| refused(&e))?.unwrap_or_default();
    if number(file, Tag::Compression)?.is_none_or(|compression| compression == UNCOMPRESSED) {
        let value_bits = bits.first().map_or(1, |bits| usize::from(*bits));
        for (chunk, bytes) in counts.iter().enumerate().take(layout.chunks()).filter(|(_, bytes)| **bytes > 0) {
            let rows = if is_tiled { layout.chunk_rows } else { layout.place(chunk)[4] };
            let needed = (layout.chunk_columns * layout.interleaved() * value_bits).div_ceil(8) * rows;
            if *bytes < needed as u64 {
                return Err(damaged(&format!("chunk {chunk} has {bytes} bytes, {needed} are needed")));
            }
        }
    }
    if nodata.is_none() && left_out.contains(&true) {
        let way = "write them, or say what stands for no value: `gdal_translate -a_nodata VALUE IN OUT`";
        return Err(CodecError(format!(
            "a GeoTIFF that leaves tiles out and has no no-data value, which would make them 0: {way}"
        )));
    }
    Ok(left_out)
}

/// Where the values of a chunk go.
struct Place<'a> {
    layout: &'a Layout,
    chunk: usize,
    left: usize,
    top: usize,
    width: usize,
    height: usize,
}

impl Place<'_> {
    /// Puts values into their planes as 32-bit floats, NaN where the file says there are none; `scalings` are those of the bands side by side.
    fn fill(
        &self,
        planes: &mut [Vec<f32>],
        decoded: &DecodingResult,
        nodata: Option<f64>,
        scalings: Option<&[Scaling]>,
    ) -> Result<(), CodecError> {
        match decoded {
            // The text of the no-data value is often shorter than its bits.
            DecodingResult::F32(values) => self.put(planes, values, nodata.map(|n| f64::from(n as f32)), scalings),
            DecodingResult::F64(values) => self.put(planes, values, nodata, scalings),
            DecodingResult::U8(values) => self.put(planes, values, nodata, scalings),
            DecodingResult::U16(values) => self.put(planes, values, nodata, scalings),
            DecodingResult::U32(values) => self.put(planes, values, nodata, scalings),
            DecodingResult::I8(values) => self.put(planes, values, nodata, scalings),
            DecodingResult::I16(values) => self.put(planes, values, nodata, scalings),
            DecodingResult::I32(values) => self.put(planes, values, nodata, scalings),
            DecodingResult::U64(_) | DecodingResult::I64(_) | DecodingResult::F16(_) => {
                Err(CodecError::new("64-bit integers and 16-bit floats cannot be read; convert to 32-bit floats"))
            }
        }
    }

    /// No copy of the chunk is made: it may be the whole raster.
    fn put<T: Copy + Into<f64>>(
        &self,
        planes: &mut [Vec<f32>],
        values: &[T],
        nodata: Option<f64>,
        scalings: Option<&[Scaling]>,
    ) -> Result<(), CodecError> {
        let Self { chunk, left, top, width, height, .. } = *self;
        let (bands, needed) = (planes.len(), width * height);
        if values.len() < needed * bands {
            return Err(damaged(&format!("chunk {chunk} holds {} values, {needed} expected", values.len())));
        }
        let is_none = |number: f64| number.is_nan() || nodata == Some(number);
        for row in 0..height {
            for (offset, plane) in planes.iter_mut().enumerate() {
                let start = (top + row) * self.layout.columns + left;
                let source = values[row * width * bands + offset..].iter().step_by(bands);
                let scaling = scalings.map(|scalings| &scalings[offset]);
                for (to, from) in plane[start..start + width].iter_mut().zip(source) {
                    let number: f64 = (*from).into();
                    *to = match scaling {
                        _ if is_none(number) => f32::NAN,
                        None => number as f32,
                        Some(scaling) => scaling.value(number) as f32,
                    };
                }
            }
        }
        Ok(())
    }
}

fn ascii(file: &mut File, tag: Tag) -> Option<String> {
    file.get_tag_ascii_string(tag).ok().map(|text| text.trim_end_matches('\0').to_owned())
}

fn placement(file: &mut File) -> Placement {
    let mut doubles = |tag| file.get_tag_f64_vec(tag).ok();
    let scale = doubles(Tag::ModelPixelScaleTag);
    let tiepoint = doubles(Tag::ModelTiepointTag);
    let matrix = doubles(Tag::ModelTransformationTag);
    Placement { scale, tiepoint, matrix, keys: file.get_tag_u16_vec(Tag::GeoKeyDirectoryTag).unwrap_or_default() }
}
