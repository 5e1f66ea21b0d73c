//! Pictures in false colours of depth maps and rasters, and rasters as grids: every n-th column and row, nothing averaged.
//!
//! Pixels are stored as numbers of a palette of 256 colours: 0 is no value, `1 + 254 (value - low) / (high - low)` rounded
//! and kept between 1 and 255 otherwise, so that values can be had back from the picture to 1/254 of its range.

use super::{every, left_out, stride_to};
use crate::figure::colour_scale::{ColourScale, NO_DATA, Palette, class, is_confusion, round_step, rounded};
use rockface_core::artefact::sketch::{ColourKey, GridBand, GridSketch, PictureSketch, Shape, Sketch};
use rockface_core::artefact::{Depth, Picture, Raster};
use rockface_core::numerics::quantile::nearest_rank;

/// Pixels of the longer side of a picture at most.
const PICTURE_PX: usize = 512;
/// Cells of the longer side of a grid at most.
const GRID_CELLS: usize = 256;
/// Bands of a raster that are shown.
const BANDS: usize = 4;
/// Bytes of a picture made for people that is shown.
const PICTURE_BYTES: usize = 512 * 1024;
/// Share of the values beyond either end of the colours.
const TAILS: f64 = 0.01;

/// Depth and every further channel of a depth map.
pub fn of_depth_channels(depth: &Depth) -> Vec<Sketch> {
    let named = depth.channels.iter().map(|(name, values)| (name.as_str(), name.as_str(), values));
    let all = std::iter::once(("", "depth", &depth.z)).chain(named);
    let sketch = |(part, quantity, values): (&str, &str, &Vec<f32>)| {
        let image = Some(depth.image.name.clone());
        false_colours(&Field { part, quantity, unit: unit(quantity), values, columns: depth.width, image })
    };
    all.filter_map(sketch).collect()
}

/// The first bands of a raster in false colours.
pub fn of_raster_pictures(raster: &Raster) -> Vec<Sketch> {
    let several = raster.bands.len() > 1;
    let sketch = |band: &rockface_core::artefact::Band| {
        let part = if several { format!("image/{}", band.name) } else { "image".to_owned() };
        let (quantity, columns) = (raster.quantity.as_str(), raster.grid.columns);
        let field = Field { part: &part, quantity, unit: unit(quantity), values: &band.values, columns, image: None };
        false_colours(&field)
    };
    raster.bands.iter().take(BANDS).filter_map(sketch).collect()
}

/// The first bands of a raster as values.
pub fn of_raster(raster: &Raster) -> Sketch {
    let grid = &raster.grid;
    let stride = stride_to(grid.columns.max(grid.rows), GRID_CELLS);
    let sample = |values: &[f32]| sampled(values, grid.columns, stride).1;
    let shown = &raster.bands[..raster.bands.len().min(BANDS)];
    let bands: Vec<GridBand> =
        shown.iter().map(|band| GridBand { name: band.name.clone(), values: sample(&band.values) }).collect();
    let parts = [every(stride, "column and row"), left_out("bands", raster.bands.len(), BANDS)];
    let shape = GridSketch {
        frame: raster.frame.to_string(),
        quantity: raster.quantity.clone(),
        columns: grid.columns.saturating_sub(stride / 2).div_ceil(stride),
        rows: grid.rows.saturating_sub(stride / 2).div_ceil(stride),
        cell_m: grid.cell_m * stride as f64,
        left_m: grid.left_m,
        top_m: grid.top_m,
        bands,
    };
    let reduced = parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("; ");
    Sketch { part: String::new(), reduced, shape: Shape::Grid(shape) }
}

/// A picture made for people, unless it is very large.
pub fn of_picture(picture: &Picture) -> Option<Sketch> {
    let side = |from: usize| picture.png.get(from..from + 4)?.try_into().ok().map(u32::from_be_bytes);
    let (width, height) = (side(16)?, side(20)?);
    let png = (picture.png.len() <= PICTURE_BYTES).then(|| picture.png.clone())?;
    let shape = PictureSketch { width, height, colours: None, image: None, png };
    Some(Sketch::whole("", Shape::Picture(shape)))
}

/// Values of a grid and what they are.
struct Field<'a> {
    part: &'a str,
    quantity: &'a str,
    unit: &'a str,
    values: &'a [f32],
    columns: usize,
    image: Option<String>,
}

fn unit(quantity: &str) -> &'static str {
    match quantity {
        "depth" | "range" | "elevation" | "difference" => "m",
        "noise.strength" | "valid" => "1",
        "y_parallax" => "px",
        name if name.starts_with("noise.") || name.starts_with("disparity") => "px",
        _ => "",
    }
}

/// Whether zero means something in the middle of the values.
fn diverges(quantity: &str) -> bool {
    let one_sided = matches!(quantity, "noise.strength" | "noise.relief");
    matches!(quantity, "difference" | "y_parallax") || (quantity.starts_with("noise.") && !one_sided)
}

/// A field in the colours of its quantity; `None` of an empty one.
fn false_colours(field: &Field) -> Option<Sketch> {
    let rows = field.values.len().checked_div(field.columns)?;
    let stride = stride_to(field.columns.max(rows), PICTURE_PX);
    let (width, mut values) = sampled(field.values, field.columns, stride);
    if is_confusion(field.quantity) {
        values.iter_mut().for_each(|value| *value = class(*value));
    }
    let height = values.len().checked_div(width)?;
    let (word, scale) = scale(field.quantity, &values);
    let png = indexed_png(width, height, &values, &scale)?;
    let colours = ColourKey {
        quantity: field.quantity.to_owned(),
        unit: field.unit.to_owned(),
        palette: word.to_owned(),
        low: scale.low,
        high: scale.high,
    };
    let shape = PictureSketch {
        width: width as u32,
        height: height as u32,
        colours: Some(colours),
        image: field.image.clone(),
        png,
    };
    let parts = [every(stride, "column and row"), beyond(&values, &scale, field.unit)];
    let reduced = parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("; ");
    Some(Sketch { part: field.part.to_owned(), reduced, shape: Shape::Picture(shape) })
}

/// Every `stride`-th value along both directions, beginning half a stride in, and the columns that leaves.
fn sampled(values: &[f32], columns: usize, stride: usize) -> (usize, Vec<f32>) {
    let from = stride / 2;
    let rows = values.chunks_exact(columns.max(1)).skip(from).step_by(stride);
    let kept = rows.flat_map(|row| row.iter().skip(from).step_by(stride).copied()).collect();
    (columns.saturating_sub(from).div_ceil(stride), kept)
}

/// The colours of a quantity: all but the outermost values lie within.
fn scale(quantity: &str, values: &[f32]) -> (&'static str, ColourScale) {
    if is_confusion(quantity) {
        return ("confusion", ColourScale::CLASSES);
    }
    let at = |share| nearest_rank(values.iter().copied(), share).unwrap_or(0.0);
    let (word, palette, low, high) = if diverges(quantity) {
        let reach = nearest_rank(values.iter().map(|v| v.abs()), 1.0 - TAILS).unwrap_or(0.0);
        ("red_blue", Palette::RedBlue, -reach, reach)
    } else if matches!(quantity, "mask" | "valid") {
        ("grey", Palette::Grey, 0.0, 1.0)
    } else {
        // Labels and counts have no outliers: every one of them is to have its colour.
        let tails = if unit(quantity).is_empty() { 0.0 } else { TAILS };
        ("viridis", Palette::Viridis, at(tails), at(1.0 - tails))
    };
    // Constant values still get a scale.
    let (low, high) = if high > low { (low, high) } else { (low - 0.5, low + 0.5) };
    (word, ColourScale { palette, low, high })
}

/// The farthest values beyond the colours; empty where all lie within.
fn beyond(values: &[f32], scale: &ColourScale, unit: &str) -> String {
    let finite = || values.iter().copied().filter(|value| value.is_finite()).map(f64::from);
    let (low, high) = (finite().fold(f64::INFINITY, f64::min), finite().fold(f64::NEG_INFINITY, f64::max));
    let step = round_step((scale.high - scale.low) / 100.0);
    let ends = [(low < scale.low - step, low), (high > scale.high + step, high)];
    let told: Vec<String> = ends.into_iter().filter(|(is, _)| *is).map(|(_, value)| rounded(value, step)).collect();
    if told.is_empty() {
        String::new()
    } else {
        format!("values reach {} {unit}", told.join(" and ")).trim_end().to_owned()
    }
}

/// The number of a value in the palette.
fn number(value: f32, scale: &ColourScale) -> u8 {
    if value.is_nan() {
        return 0;
    }
    let share = (f64::from(value) - scale.low) / (scale.high - scale.low);
    (1.0 + 254.0 * share).round().clamp(1.0, 255.0) as u8
}

/// The value a number of the palette stands for; `None` for no value.
#[cfg(test)]
fn value_of(number: u8, scale: &ColourScale) -> Option<f64> {
    let share = (f64::from(number) - 1.0) / 254.0;
    (number > 0).then_some(scale.low + share * (scale.high - scale.low))
}

fn palette(scale: &ColourScale) -> Vec<u8> {
    let colour = |number: u32| {
        let share = (f64::from(number) - 1.0) / 254.0;
        if number == 0 { NO_DATA } else { scale.colour(scale.low + share * (scale.high - scale.low)) }
    };
    (0..256).flat_map(colour).collect()
}

fn indexed_png(width: usize, height: usize, values: &[f32], scale: &ColourScale) -> Option<Vec<u8>> {
    let numbers: Vec<u8> = values.iter().map(|value| number(*value, scale)).collect();
    let mut png = Vec::new();
    let mut encoder = png::Encoder::new(&mut png, width as u32, height as u32);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_palette(palette(scale));
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().ok()?;
    writer.write_image_data(&numbers).ok()?;
    writer.finish().ok()?;
    Some(png)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Frame, Grid};

    fn raster(columns: usize, rows: usize, quantity: &str, values: Vec<f32>) -> Raster {
        let grid = Grid { columns, rows, cell_m: 0.5, left_m: -3.0, top_m: 9.0 };
        Raster::single(grid, Frame::Wall, quantity, quantity, values)
    }

    #[test]
    fn values_come_back_from_the_picture() {
        let values: Vec<f32> = (0..600).map(|i| if i == 7 { f32::NAN } else { i as f32 * 0.01 - 2.0 }).collect();
        let sketches = of_raster_pictures(&raster(30, 20, "difference", values.clone()));
        let Shape::Picture(picture) = &sketches[0].shape else { panic!("a picture") };
        let key = picture.colours.as_ref().unwrap();
        assert_eq!((key.palette.as_str(), key.unit.as_str(), key.low), ("red_blue", "m", -key.high));
        let mut decoder = png::Decoder::new(std::io::Cursor::new(&picture.png));
        decoder.set_transformations(png::Transformations::IDENTITY);
        let mut reader = decoder.read_info().unwrap();
        let mut numbers = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut numbers).unwrap();
        let scale = ColourScale { palette: Palette::RedBlue, low: key.low, high: key.high };
        let step = (key.high - key.low) / 254.0;
        for (number, value) in numbers.iter().zip(&values) {
            match value_of(*number, &scale) {
                None => assert!(value.is_nan()),
                Some(found) => {
                    let kept = f64::from(*value).clamp(key.low, key.high);
                    assert!((found - kept).abs() <= 0.5 * step + 1e-9, "{found} {value}");
                }
            }
        }
    }

    #[test]
    fn large_rasters_are_sampled_not_averaged() {
        // White noise keeps its strength.
        let values: Vec<f32> = (0..1024 * 600_i64).map(|i| if (i * 7919) % 13 < 6 { 1.0 } else { -1.0 }).collect();
        let raster = raster(1024, 600, "difference", values);
        let Shape::Grid(grid) = of_raster(&raster).shape else { panic!("a grid") };
        assert_eq!((grid.columns, grid.rows, grid.cell_m), (256, 150, 2.0));
        assert!(grid.bands[0].values.iter().all(|v| (v.abs() - 1.0).abs() < 1e-9));
        assert_eq!(of_raster(&raster).reduced, "every 4th column and row");
        let Shape::Picture(picture) = &of_raster_pictures(&raster)[0].shape else { panic!("a picture") };
        assert_eq!((picture.width, picture.height), (512, 300));
    }

    #[test]
    fn sizes_that_do_not_divide_are_counted_right() {
        for columns in [1, 2, 255, 256, 257, 511, 513, 1023, 1025] {
            let raster = raster(columns, 3, "elevation", vec![1.0; columns * 3]);
            let Shape::Grid(grid) = of_raster(&raster).shape else { panic!("a grid") };
            assert_eq!(grid.bands[0].values.len(), grid.columns * grid.rows, "{columns}");
            assert_eq!(of_raster_pictures(&raster).len(), 1);
        }
        assert!(of_raster_pictures(&raster(0, 0, "mask", vec![])).is_empty());
    }
}
