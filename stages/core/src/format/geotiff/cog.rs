//! Writes a raster as a Cloud Optimised GeoTIFF: directories first, the full raster's before those of its overviews, then the tiles of the smallest
//! overview up to those of the raster, so that a map on the other side of a network reads what it shows and no more.

use rayon::prelude::*;

use super::{tags, write};
use crate::artefact::{Band, CodecError, Grid, Raster, Sample};

const SHORT: u16 = 3;
const LONG: u16 = 4;
const ASCII: u16 = 2;
const DOUBLE: u16 = 12;

/// Bytes before the first directory.
const HEADER: usize = 8;

/// One field of a directory.
struct Field {
    tag: u16,
    kind: u16,
    count: u32,
    /// Little-endian.
    bytes: Vec<u8>,
}

impl Field {
    fn shorts(tag: u16, values: &[u16]) -> Self {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        Self { tag, kind: SHORT, count: values.len() as u32, bytes }
    }

    fn longs(tag: u16, values: &[u32]) -> Self {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        Self { tag, kind: LONG, count: values.len() as u32, bytes }
    }

    fn doubles(tag: u16, values: &[f64]) -> Self {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        Self { tag, kind: DOUBLE, count: values.len() as u32, bytes }
    }

    fn text(tag: u16, text: &str) -> Self {
        let bytes: Vec<u8> = text.bytes().chain([0]).collect();
        Self { tag, kind: ASCII, count: bytes.len() as u32, bytes }
    }

    /// Bytes it takes outside of its entry.
    fn outside(&self) -> usize {
        if self.bytes.len() <= 4 { 0 } else { self.bytes.len().next_multiple_of(2) }
    }
}

/// Writes a raster with overviews; `items` are added to GDAL's metadata.
///
/// # Errors
/// As [`super::write()`].
pub fn write_optimised(raster: &Raster, items: &[(&str, &str)]) -> Result<Vec<u8>, CodecError> {
    write::check(raster)?;
    let overviews = overviews(raster);
    let levels: Vec<&Raster> = std::iter::once(raster).chain(&overviews).collect();
    let tiles = levels.iter().map(|level| write::tiles(level)).collect::<Result<Vec<_>, _>>()?;
    let mut directories: Vec<Vec<Field>> = levels.iter().map(|level| layout(level)).collect();
    directories[0].extend(about(raster, items));
    directories[1..].iter_mut().for_each(|fields| fields.push(Field::longs(254, &[1])));
    for (fields, tiles) in directories.iter_mut().zip(&tiles) {
        if raster.sample == Sample::Float {
            fields.push(Field::text(42113, "nan"));
        }
        let lengths: Vec<u32> = tiles.iter().map(|tile| tile.len() as u32).collect();
        // Filled in once all directories have their place.
        fields.extend([Field::longs(324, &vec![0; tiles.len()]), Field::longs(325, &lengths)]);
        fields.sort_by_key(|field| field.tag);
    }
    let size = |fields: &Vec<Field>| 6 + 12 * fields.len() + fields.iter().map(Field::outside).sum::<usize>();
    let mut at = HEADER + directories.iter().map(size).sum::<usize>();
    for (fields, tiles) in directories.iter_mut().zip(&tiles).rev() {
        let mut place = |tile: &Vec<u8>| {
            let own = at as u32;
            at += tile.len();
            own
        };
        let offsets: Vec<u32> = tiles.iter().map(&mut place).collect();
        if let Some(field) = fields.iter_mut().find(|field| field.tag == 324) {
            *field = Field::longs(324, &offsets);
        }
    }
    if at > write::LARGEST {
        return Err(CodecError(format!("{at} bytes are too many for one GeoTIFF; split the bands over several")));
    }
    let mut file = Vec::with_capacity(at);
    file.extend_from_slice(b"II*\0");
    file.extend_from_slice(&(HEADER as u32).to_le_bytes());
    for (index, fields) in directories.iter().enumerate() {
        let next = file.len() + size(fields);
        put(&mut file, fields, if index + 1 < directories.len() { next as u32 } else { 0 });
    }
    tiles.iter().rev().flatten().for_each(|tile| file.extend_from_slice(tile));
    Ok(file)
}

/// Appends a directory, its long values behind it.
fn put(file: &mut Vec<u8>, fields: &[Field], next: u32) {
    let mut outside = file.len() + 6 + 12 * fields.len();
    let mut long = Vec::new();
    file.extend_from_slice(&(fields.len() as u16).to_le_bytes());
    for field in fields {
        file.extend_from_slice(&field.tag.to_le_bytes());
        file.extend_from_slice(&field.kind.to_le_bytes());
        file.extend_from_slice(&field.count.to_le_bytes());
        if field.outside() == 0 {
            let mut value = field.bytes.clone();
            value.resize(4, 0);
            file.extend_from_slice(&value);
        } else {
            file.extend_from_slice(&(outside as u32).to_le_bytes());
            long.extend_from_slice(&field.bytes);
            long.resize(long.len().next_multiple_of(2), 0);
            outside += field.outside();
        }
    }
    file.extend_from_slice(&next.to_le_bytes());
    file.extend_from_slice(&long);
}

fn layout(raster: &Raster) -> Vec<Field> {
    let bands = raster.bands.len();
    let (format, predictor) = write::coding(raster.sample);
    let mut fields = vec![
        Field::longs(256, &[raster.grid.columns as u32]),
        Field::longs(257, &[raster.grid.rows as u32]),
        Field::shorts(258, &vec![write::bits(raster.sample); bands]),
        Field::shorts(259, &[write::DEFLATE]),
        Field::shorts(262, &[write::BLACK_IS_ZERO]),
        Field::shorts(277, &[bands as u16]),
        Field::shorts(284, &[write::PLANAR]),
        Field::shorts(317, &[predictor]),
        Field::longs(322, &[write::TILE as u32]),
        Field::longs(323, &[write::TILE as u32]),
        Field::shorts(339, &vec![format; bands]),
    ];
    if bands > 1 {
        fields.push(Field::shorts(338, &vec![write::UNSPECIFIED; bands - 1]));
    }
    fields
}

/// What the file says of the whole raster: where it lies, and GDAL's metadata.
fn about(raster: &Raster, items: &[(&str, &str)]) -> Vec<Field> {
    let (keys, citation) = tags::geo_keys(raster.frame);
    vec![
        Field::doubles(33550, &tags::pixel_scale(&raster.grid)),
        Field::doubles(33922, &tags::tiepoint(&raster.grid)),
        Field::shorts(34735, &keys),
        Field::text(34737, &citation),
        Field::text(tags::GDAL_METADATA, &tags::metadata_with(raster, items)),
    ]
}

/// Each half as large as the one before, until one fits into a tile.
fn overviews(raster: &Raster) -> Vec<Raster> {
    let mut found: Vec<Raster> = Vec::new();
    loop {
        let last = found.last().unwrap_or(raster);
        if last.grid.columns.max(last.grid.rows) <= write::TILE {
            return found;
        }
        let next = half(last);
        found.push(next);
    }
}

/// Half the resolution: the mean of the cells that have a value, or one of them where they are numbers of things.
fn half(raster: &Raster) -> Raster {
    let grid = &raster.grid;
    let (columns, rows) = (grid.columns.div_ceil(2), grid.rows.div_ceil(2));
    let cell = |values: &[f32], index: usize| {
        let (row, column) = (index / columns * 2, index % columns * 2);
        if raster.sample != Sample::Float {
            return values[row * grid.columns + column];
        }
        let (mut sum, mut count) = (0.0f64, 0u32);
        for row in row..(row + 2).min(grid.rows) {
            for column in column..(column + 2).min(grid.columns) {
                let value = values[row * grid.columns + column];
                if !value.is_nan() {
                    (sum, count) = (sum + f64::from(value), count + 1);
                }
            }
        }
        if count == 0 { f32::NAN } else { (sum / f64::from(count)) as f32 }
    };
    let band = |band: &Band| Band {
        name: band.name.clone(),
        values: (0..columns * rows).into_par_iter().map(|index| cell(&band.values, index)).collect(),
    };
    let bands = raster.bands.iter().map(band).collect();
    let grid = Grid { columns, rows, cell_m: grid.cell_m * 2.0, ..*grid };
    Raster { grid, bands, quantity: raster.quantity.clone(), ..*raster }
}

#[cfg(test)]
mod tests {
    use super::super::{item, read};
    use super::*;
    use crate::artefact::Frame;

    fn raster(columns: usize, rows: usize, bands: usize) -> Raster {
        let grid = Grid { columns, rows, cell_m: 0.01, left_m: -2.4, top_m: 3.5 };
        let value = |i: usize| if i.is_multiple_of(7) { f32::NAN } else { (i as f32 * 0.37).sqrt() - 3.0 };
        let band =
            |b: usize| Band { name: format!("b{b}"), values: (0..columns * rows).map(|i| value(i + b)).collect() };
        let bands = (0..bands).map(band).collect();
        Raster { grid, frame: Frame::Wall, quantity: "difference".into(), sample: Sample::Float, bands }
    }

    #[test]
    fn the_raster_comes_back_and_so_does_what_was_added() {
        for (columns, rows, bands) in [(1, 1, 1), (256, 256, 1), (257, 300, 3), (1030, 20, 2)] {
            let raster = raster(columns, rows, bands);
            let bytes = write_optimised(&raster, &[("PROVENANCE", "{\"a\": \"<&>\u{e9}\"}")]).unwrap();
            assert_eq!(read(&bytes).unwrap(), raster, "{columns} x {rows} x {bands}");
            assert_eq!(item(&bytes, "PROVENANCE").unwrap(), "{\"a\": \"<&>\u{e9}\"}");
        }
    }

    #[test]
    fn overviews_end_where_one_fits_into_a_tile_and_pass_over_what_has_no_value() {
        let sizes = |columns, rows| {
            let levels = overviews(&raster(columns, rows, 1));
            levels.iter().map(|level| (level.grid.columns, level.grid.rows)).collect::<Vec<_>>()
        };
        assert_eq!(sizes(256, 100), []);
        assert_eq!(sizes(1030, 20), [(515, 10), (258, 5), (129, 3)]);
        let mut small = raster(2, 2, 1);
        small.bands[0].values = vec![1.0, f32::NAN, 4.0, 4.0];
        assert_eq!(half(&small).bands[0].values, [3.0]);
    }
}
