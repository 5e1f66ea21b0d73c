//! What a GeoTIFF says besides its values: grid, coordinate system, names of bands, value for "no data".

use std::fmt::Write as _;

use crate::artefact::{CodecError, Frame, Georeference, Grid, Raster};
use crate::crs::geo_keys;

/// Tag that holds GDAL's metadata as XML.
pub const GDAL_METADATA: u16 = 42112;

/// Keys of the `GeoKeyDirectory` that are read or written.
const MODEL_TYPE: u16 = 1024;
const RASTER_TYPE: u16 = 1025;
const CITATION: u16 = 1026;
const LINEAR_UNITS: u16 = 3076;
const PIXEL_IS_AREA: u16 = 1;
const PIXEL_IS_POINT: u16 = 2;
const USER_DEFINED: u16 = 32767;
const METRE: u16 = 9001;
const ASCII_PARAMS: u16 = 34737;

/// `ModelPixelScale` of a grid, metres.
pub fn pixel_scale(grid: &Grid) -> [f64; 3] {
    [grid.cell_m, grid.cell_m, 0.0]
}

/// `ModelTiepoint` of a grid: the outer corner of the first cell, metres.
pub fn tiepoint(grid: &Grid) -> [f64; 6] {
    [0.0, 0.0, 0.0, grid.left_m, grid.top_m, 0.0]
}

/// `GeoKeyDirectory` and `GeoAsciiParams` of a frame: its coordinate reference system, or a local engineering system in metres.
pub fn geo_keys(frame: Frame) -> (Vec<u16>, String) {
    let name = frame.crs().map_or_else(|| format!("rockface {frame} frame"), |crs| ascii(&crs.name()));
    let mut texts = format!("{name}|");
    let model = frame.crs().map_or(USER_DEFINED, geo_keys::model);
    let mut keys = vec![
        [MODEL_TYPE, 0, 1, model],
        [RASTER_TYPE, 0, 1, PIXEL_IS_AREA],
        [CITATION, ASCII_PARAMS, texts.len() as u16, 0],
    ];
    if let Some(crs) = frame.crs() {
        let (of_system, text) = geo_keys::written(crs, texts.len());
        keys.extend(of_system);
        texts += &ascii(&text);
    } else {
        keys.push([LINEAR_UNITS, 0, 1, METRE]);
    }
    let mut directory = vec![1, 1, geo_keys::minor_revision(&keys), keys.len() as u16];
    directory.extend(keys.as_flattened());
    (directory, texts)
}

/// What a TIFF text may hold.
fn ascii(text: &str) -> String {
    text.chars().map(|c| if (' '..='~').contains(&c) { c } else { '?' }).collect()
}

/// Georeference tags as found in a file.
#[derive(Debug, Default)]
pub struct Placement {
    /// Tag `ModelPixelScale`: side of a cell along each axis.
    pub scale: Option<Vec<f64>>,
    /// Tag `ModelTiepoint`: column, row and level of a place, then X, Y and Z of it.
    pub tiepoint: Option<Vec<f64>>,
    /// `ModelTransformation`, 4 x 4 by row.
    pub matrix: Option<Vec<f64>>,
    /// Tag `GeoKeyDirectory`: the keys of the coordinate reference system; empty where there is none.
    pub keys: Vec<u16>,
}

impl Placement {
    /// The grid of a file of this many columns and rows.
    pub fn grid(&self, columns: usize, rows: usize) -> Result<Grid, CodecError> {
        let [cell_x, cell_y, left, top] = self.corner()?;
        let square = (cell_x - cell_y).abs() <= 1e-9 * cell_x.abs();
        if !(cell_x > 0.0 && square && [cell_x, left, top].iter().all(|x| x.is_finite())) {
            let found = format!("GeoTIFF cells must be square and north up; this file has {cell_x} by {cell_y}");
            return Err(CodecError(format!("{found}; {}", resampled([cell_x, cell_y]))));
        }
        // Files that give the centre of the first cell instead of its corner are moved by half a cell.
        let half = if self.pixel_is_point() { 0.5 * cell_x } else { 0.0 };
        Ok(Grid { columns, rows, cell_m: cell_x, left_m: left - half, top_m: top + half })
    }

    /// Cell size along x and y, left and top.
    pub fn corner(&self) -> Result<[f64; 4], CodecError> {
        match (self.scale.as_deref(), self.tiepoint.as_deref(), self.matrix.as_deref()) {
            (Some([sx, sy, ..]), Some([column, row, _, x, y, ..]), _) => Ok([*sx, *sy, x - column * sx, y + row * sy]),
            (_, _, Some([a, b, _, x, d, e, _, y, ..])) if *b == 0.0 && *d == 0.0 => Ok([*a, -e, *x, *y]),
            (_, _, Some([a, b, _, _, d, e, ..])) => {
                let sides = [[a, d], [b, e]].map(|[x, y]| (x * x + y * y).sqrt());
                Err(CodecError(format!(
                    "a rotated GeoTIFF cannot be used, cells must be north up; {}",
                    resampled(sides)
                )))
            }
            _ => Err(CodecError::new(
                "the TIFF has no georeference (ModelPixelScale and ModelTiepoint); write it as a GeoTIFF, \
                 for instance with `gdal_translate -a_ullr`",
            )),
        }
    }

    fn pixel_is_point(&self) -> bool {
        let mut entries = self.keys.chunks_exact(4).skip(1);
        entries.any(|entry| entry[0] == RASTER_TYPE && entry[1] == 0 && entry[3] == PIXEL_IS_POINT)
    }
}

/// The way to square cells that are north up, as small as the smaller side of those there are.
fn resampled([x, y]: [f64; 2]) -> String {
    let side = (x.abs().min(y.abs()) * 1e9).round() / 1e9;
    if !(side.is_finite() && side > 0.0) {
        return "write it with the true size of its cells: `gdal_edit.py -tr X Y FILE`".to_owned();
    }
    let command = |method: &str| format!("`gdalwarp -tr {side} {side} -r {method} IN OUT`");
    if x > 0.0 && (x + y).abs() <= 1e-9 * x {
        return format!("turn it without a change of its values: {}", command("near"));
    }
    format!(
        "resample it to its finer cell first: {} (`-r bilinear` smooths noise, `-r near` keeps the values)",
        command("cubic")
    )
}

/// GDAL's metadata of a raster: frame, quantity and the name of each band.
pub fn metadata(raster: &Raster) -> String {
    metadata_with(raster, &[])
}

/// The same with further items.
pub fn metadata_with(raster: &Raster, items: &[(&str, &str)]) -> String {
    let mut xml = format!(
        "<GDALMetadata>\n  <Item name=\"FRAME\">{}</Item>\n  <Item name=\"QUANTITY\">{}</Item>\n",
        raster.frame,
        escape(&raster.quantity)
    );
    if let Some(georeference) = raster.frame.georeference() {
        let _ = writeln!(xml, "  <Item name=\"GEOREFERENCE\">{}</Item>", escape(&georeference.to_text()));
    }
    for (index, band) in raster.bands.iter().enumerate() {
        let name = escape(&band.name);
        let _ = writeln!(xml, "  <Item name=\"DESCRIPTION\" sample=\"{index}\" role=\"description\">{name}</Item>");
    }
    for (name, text) in items {
        let _ = writeln!(xml, "  <Item name=\"{name}\">{}</Item>", escape(text));
    }
    xml + "</GDALMetadata>\n"
}

/// An item of GDAL's metadata in the bytes of a file, without reading the rest of it.
pub fn item(file: &[u8], name: &str) -> Option<String> {
    let start = format!("<Item name=\"{name}\">");
    let at = file.windows(start.len()).position(|window| window == start.as_bytes())? + start.len();
    let length = file[at..].windows(7).position(|window| window == b"</Item>")?;
    Some(unescape(std::str::from_utf8(&file[at..at + length]).ok()?))
}

/// The items of GDAL's metadata that are understood here.
#[derive(Debug, Default, PartialEq)]
pub struct Metadata {
    /// Frame of the grid.
    pub frame: Option<Frame>,
    /// Where it lies on the Earth.
    pub georeference: Option<Georeference>,
    /// What the values are.
    pub quantity: Option<String>,
    /// Names of bands by number.
    pub names: std::collections::BTreeMap<usize, String>,
    /// Factors of bands by number, as they are written.
    scales: std::collections::BTreeMap<usize, String>,
    /// What is added to bands by number, as it is written.
    offsets: std::collections::BTreeMap<usize, String>,
}

/// What makes values of the numbers that a file holds for a band.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scaling {
    /// What a number is multiplied by.
    pub scale: f64,
    /// What is added then.
    pub offset: f64,
}

impl Scaling {
    /// Numbers are the values.
    const NONE: Self = Self { scale: 1.0, offset: 0.0 };

    /// The value of a number.
    pub fn value(&self, number: f64) -> f64 {
        number * self.scale + self.offset
    }
}

impl Metadata {
    /// The frame with its place on the Earth.
    pub fn placed(&self) -> Option<Frame> {
        self.frame.map(|frame| frame.at(self.georeference.clone()))
    }

    /// The scalings of this many bands; `None` where the numbers of all of them are the values.
    pub fn scalings(&self, bands: usize) -> Result<Option<Vec<Scaling>>, CodecError> {
        let number = |texts: &std::collections::BTreeMap<usize, String>, band: usize, what: &str, none: f64| {
            let Some(text) = texts.get(&band) else { return Ok(none) };
            text.trim().parse::<f64>().ok().filter(|number| number.is_finite()).ok_or_else(|| {
                let band = band + 1;
                CodecError(format!(
                    "band {band} states `{text}` as its {what}, which is no number; state it with `gdal_edit.py -{what} NUMBER FILE`"
                ))
            })
        };
        let scaling = |band: usize| {
            let (scale, offset) =
                (number(&self.scales, band, "scale", 1.0)?, number(&self.offsets, band, "offset", 0.0)?);
            if scale == 0.0 {
                let band = band + 1;
                return Err(CodecError(format!(
                    "band {band} states a scale of 0, which makes all values one; state it with `gdal_edit.py -scale NUMBER FILE`"
                )));
            }
            Ok(Scaling { scale, offset })
        };
        let scalings = (0..bands).map(scaling).collect::<Result<Vec<_>, CodecError>>()?;
        Ok(scalings.iter().any(|scaling| *scaling != Scaling::NONE).then_some(scalings))
    }

    /// Reads the XML; items that are not understood are passed over, as GDAL does.
    pub fn parse(xml: &str) -> Self {
        let mut found = Self::default();
        for item in xml.split("<Item").skip(1) {
            let Some((attributes, rest)) = item.split_once('>') else { continue };
            let Some((text, _)) = rest.split_once("</Item>") else { continue };
            found.take(attributes, unescape(text));
        }
        found
    }

    fn take(&mut self, attributes: &str, text: String) {
        let sample = attribute(attributes, "sample").and_then(|index| index.parse().ok());
        match (attribute(attributes, "name"), attribute(attributes, "role"), sample) {
            (_, Some("description"), Some(index)) => {
                self.names.insert(index, text);
            }
            (_, Some("scale"), Some(index)) => {
                self.scales.insert(index, text);
            }
            (_, Some("offset"), Some(index)) => {
                self.offsets.insert(index, text);
            }
            (Some("FRAME"), ..) => self.frame = Frame::named(&text),
            (Some("GEOREFERENCE"), ..) => {
                // GDAL, when it copies a file, escapes what is escaped already.
                let read = Georeference::from_text(&text).or_else(|_| Georeference::from_text(&unescape(&text)));
                self.georeference = read.ok();
            }
            (Some("QUANTITY"), ..) => self.quantity = Some(text),
            _ => {}
        }
    }
}

fn attribute<'a>(attributes: &'a str, name: &str) -> Option<&'a str> {
    let start = attributes.find(&format!(" {name}=\""))? + name.len() + 3;
    attributes[start..].split('"').next()
}

/// Escapes what XML reserves, and everything outside printable ASCII, which is all a TIFF text may hold.
fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            ' '..='~' if !"&<>\"'".contains(c) => escaped.push(c),
            _ => {
                let _ = write!(escaped, "&#{};", u32::from(c));
            }
        }
    }
    escaped
}

fn unescape(text: &str) -> String {
    let mut parts = text.split('&');
    let mut plain = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        if let Some((c, rest)) = part.split_once(';').and_then(|(entity, rest)| Some((character(entity)?, rest))) {
            plain.push(c);
            plain.push_str(rest);
        } else {
            plain.push('&');
            plain.push_str(part);
        }
    }
    plain
}

fn character(entity: &str) -> Option<char> {
    if let Some(number) = entity.strip_prefix('#') {
        let hexadecimal = number.strip_prefix('x').map(|digits| u32::from_str_radix(digits, 16));
        return char::from_u32(hexadecimal.unwrap_or_else(|| number.parse()).ok()?);
    }
    let named = [("amp", '&'), ("lt", '<'), ("gt", '>'), ("quot", '"'), ("apos", '\'')];
    named.iter().find(|(name, _)| *name == entity).map(|(_, c)| *c)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_comes_back_through_xml() {
        for text in ["", "a & b <c>", "\u{e9}\n\u{1f5ff}", "&amp;", "x;y&#9;"] {
            assert_eq!(unescape(&escape(text)), text);
        }
        assert_eq!(unescape("a &lt;&#x41;&unknown; & b"), "a <A&unknown; & b");
    }

    #[test]
    fn the_corner_follows_the_tags() {
        let mut tags = Placement {
            scale: Some(vec![0.5, 0.5, 0.0]),
            tiepoint: Some(vec![2.0, 4.0, 0.0, 100.0, 200.0, 0.0]),
            ..Placement::default()
        };
        let grid = tags.grid(10, 20).unwrap();
        assert_eq!((grid.left_m, grid.top_m, grid.cell_m), (99.0, 202.0, 0.5));
        tags.keys = vec![1, 1, 0, 1, RASTER_TYPE, 0, 1, PIXEL_IS_POINT];
        let point = tags.grid(10, 20).unwrap();
        assert_eq!((point.left_m, point.top_m), (98.75, 202.25));
        tags.scale = Some(vec![0.5, 0.4, 0.0]);
        let finer = tags.grid(10, 20).unwrap_err().0;
        assert!(finer.contains("square") && finer.contains("gdalwarp -tr 0.4 0.4 -r cubic IN OUT"), "{finer}");
        tags.scale = Some(vec![0.5, -0.5, 0.0]);
        assert!(tags.grid(10, 20).unwrap_err().0.contains("gdalwarp -tr 0.5 0.5 -r near IN OUT"));
        tags.scale = Some(vec![0.5, 0.0, 0.0]);
        assert!(tags.grid(10, 20).unwrap_err().0.contains("gdal_edit.py -tr"));
        assert!(Placement::default().grid(1, 1).unwrap_err().0.contains("georeference"));
    }

    #[test]
    fn a_matrix_without_rotation_will_do() {
        let matrix = |b: f64| {
            let mut m = vec![2.0, b, 0.0, 10.0, 0.0, -2.0, 0.0, 30.0];
            m.extend([0.0; 8]);
            Placement { matrix: Some(m), ..Placement::default() }
        };
        let grid = matrix(0.0).grid(1, 1).unwrap();
        assert_eq!((grid.left_m, grid.top_m, grid.cell_m), (10.0, 30.0, 2.0));
        let rotated = matrix(0.1).grid(1, 1).unwrap_err().0;
        assert!(rotated.contains("rotated") && rotated.contains("-tr 2 2 -r cubic"), "{rotated}");
    }
}
