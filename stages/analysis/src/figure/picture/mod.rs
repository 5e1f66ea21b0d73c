//! A picture of a grid of values: false colours with optional shading, title, colour bar and scale bar.

use rayon::prelude::*;

use rockface_core::artefact::CodecError;

use super::canvas::{Align, Canvas, Colour, Pen};
use super::colour_scale::{CONFUSION, ColourScale, NO_DATA, Palette, labels, length, round_step, rounded};

pub mod look;
pub mod mosaic;

const INK: Colour = [32, 32, 36];
const FAINT: Colour = [96, 98, 104];
/// Pixels a cell becomes at most when a small grid is enlarged.
const MAXIMUM_ENLARGEMENT: usize = 40;

/// Room and sizes of text around the values, pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layout {
    margin: usize,
    /// Room over the values.
    head: usize,
    /// Room under the values.
    foot: usize,
    bar_gap: usize,
    bar_width: usize,
    /// Right of the bar.
    labels: usize,
    /// Smallest width of the values in the picture, so that text and scale fit.
    least_width: usize,
    least_bar: usize,
    /// Height of the title; without one there is none.
    title_px: Option<f32>,
    subtitle_px: f32,
    text_px: f32,
    /// Pixels that one of the small distances between text and lines takes.
    unit: f32,
    /// Pixels there are for the values at most.
    most: usize,
}

/// Width of a picture whose text has the sizes of `FULL`, pixels; that of wider ones grows with them, so that it can be read when a picture
/// is shown on half a page.
const FULL_WIDTH: f32 = 700.0;

const FULL: Layout = Layout {
    margin: 20,
    head: 56,
    foot: 44,
    bar_gap: 18,
    bar_width: 16,
    labels: 74,
    least_width: 320,
    least_bar: 160,
    title_px: Some(21.0),
    subtitle_px: 14.0,
    text_px: 14.0,
    unit: 1.0,
    most: usize::MAX,
};

/// The layout of a picture to be looked at by itself, at most this wide, pixels.
pub fn full(max_width_px: usize) -> Layout {
    let unit = (max_width_px as f32 / FULL_WIDTH).max(1.0);
    let whole = |pixels: usize| (pixels as f32 * unit).round() as usize;
    Layout {
        margin: whole(FULL.margin),
        head: whole(FULL.head),
        foot: whole(FULL.foot),
        bar_gap: whole(FULL.bar_gap),
        bar_width: whole(FULL.bar_width),
        labels: whole(FULL.labels),
        least_bar: whole(FULL.least_bar),
        title_px: FULL.title_px.map(|size| size * unit),
        subtitle_px: FULL.subtitle_px * unit,
        text_px: FULL.text_px * unit,
        unit,
        ..FULL
    }
}

/// The same for values of so many columns and rows, which may not need all of that width.
fn fitted([columns, rows]: [usize; 2], max_width_px: usize) -> Layout {
    let widest = full(max_width_px);
    let most = widest.room(max_width_px);
    let width = pixels_of(columns, cells_per_pixel([columns, rows], most)).max(widest.least_width);
    Layout { most, ..full(width + max_width_px.saturating_sub(most)) }
}

/// A small picture beside others, whose title stands elsewhere.
pub const SMALL: Layout = Layout {
    margin: 8,
    head: 24,
    foot: 24,
    bar_gap: 12,
    bar_width: 12,
    labels: 64,
    least_width: 200,
    least_bar: 110,
    title_px: None,
    subtitle_px: 12.5,
    text_px: 12.5,
    unit: 1.0,
    most: usize::MAX,
};

impl Layout {
    /// Pixels there are for the values along their longer side.
    pub fn room(&self, max_width_px: usize) -> usize {
        let around = 2 * self.margin + self.bar_gap + self.bar_width + self.labels;
        max_width_px.saturating_sub(around).max(self.least_width).min(self.most)
    }

    /// The upper left corner of the values [x, y], pixels.
    pub fn corner(&self) -> [usize; 2] {
        [self.margin, self.margin + self.head]
    }
}

/// A grid of values to be drawn, and how.
pub struct Subject<'a> {
    /// Number of columns of `values`.
    pub columns: usize,
    /// Values by row from the top, NaN where there is none.
    pub values: &'a [f32],
    /// Side of a cell, metres; without it there is neither scale bar nor shading.
    pub cell_m: Option<f64>,
    /// Whether values are heights in metres to be shaded by a light from the upper left.
    pub shaded: bool,
    /// The palette and the values at its ends.
    pub scale: ColourScale,
    /// The title over the picture.
    pub title: String,
    /// Under the title; the share of the values beyond the colours is added.
    pub subtitle: String,
    /// Unit of the colour bar and how many of it make one of the values' own units.
    pub unit: (&'static str, f64),
    /// What is up in the picture, where that is to be said.
    pub up: Option<&'static str>,
}

/// Draws a grid as PNG; the whole picture is at most `max_width_px` wide (at least about 500) and its values as high.
pub fn draw(subject: &Subject, max_width_px: usize) -> Result<Vec<u8>, CodecError> {
    let columns = subject.columns.max(1);
    let layout = fitted([columns, (subject.values.len() / columns).max(1)], max_width_px);
    paint(subject, max_width_px, &layout)?.to_png()
}

/// Draws a grid in a layout; the whole picture is at most `max_width_px` wide, where the layout lets it, and its values as high.
pub fn paint(subject: &Subject, max_width_px: usize, layout: &Layout) -> Result<Canvas, CodecError> {
    let view = View::of(subject, layout.room(max_width_px));
    let [left, top] = layout.corner();
    let box_width = view.width.max(layout.least_width);
    let bar_left = left + box_width + layout.bar_gap;
    let bar_height = view.height.max(layout.least_bar);
    let mut canvas =
        Canvas::new(bar_left + layout.bar_width + layout.labels + left, top + bar_height + layout.foot + left / 2);
    write_titles(&mut canvas, subject, layout, box_width)?;
    view.paint(&mut canvas, left, top, subject);
    canvas.frame(left, top, view.width, view.height, FAINT);
    draw_bar(&mut canvas, subject, layout, [bar_left, top, bar_height])?;
    let foot = top + bar_height + layout.foot / 2;
    let pen = Pen::plain(layout.text_px, INK)?;
    if let Some(cell_m) = subject.cell_m {
        draw_scale(&mut canvas, view.width as f64, cell_m * view.cells_per_pixel, [left, foot], &pen)?;
    }
    if let Some(up) = subject.up {
        let text = format!("\u{2191} {up}");
        canvas.text(&pen, (left + box_width) as f32, foot as f32, Align::Right, &text);
    }
    if subject.values.iter().any(|v| v.is_nan()) {
        let side = layout.text_px as usize + 1;
        canvas.fill(bar_left, foot - side / 2, layout.bar_width, side, NO_DATA);
        canvas.frame(bar_left, foot - side / 2, layout.bar_width, side, FAINT);
        let text_left = (bar_left + layout.bar_width) as f32 + 0.65 * layout.text_px;
        canvas.text(&pen, text_left, foot as f32, Align::Left, "no value");
    }
    Ok(canvas)
}

fn write_titles(canvas: &mut Canvas, subject: &Subject, layout: &Layout, box_width: usize) -> Result<(), CodecError> {
    let x = layout.margin as f32;
    let below: Vec<String> = [Some(subject.subtitle.clone()).filter(|text| !text.is_empty()), beyond(subject)]
        .into_iter()
        .flatten()
        .collect();
    let beside = layout.bar_gap + layout.bar_width + layout.labels;
    let (mut lines, mut room, mut y) = (Vec::new(), box_width, x + 4.0 * layout.unit);
    if let Some(title_px) = layout.title_px {
        lines.push((Pen::bold(title_px, INK)?, x + 6.0 * layout.unit, subject.title.clone()));
        (room, y) = (box_width + beside, x + 31.0 * layout.unit);
    }
    lines.push((Pen::plain(layout.subtitle_px, FAINT)?, y, below.join(", ")));
    for (pen, y, text) in lines {
        canvas.text(&pen, x, y, Align::Left, &pen.fitted(&text, room as f32));
    }
    Ok(())
}

/// How many of the values lie beyond the colours, and the farthest of them; `None` when all lie within.
fn beyond(subject: &Subject) -> Option<String> {
    let (scale, (unit, per_one)) = (&subject.scale, subject.unit);
    let excess = |value: f64| (scale.low - value).max(value - scale.high);
    // Cells keep 32 bits, and so may the ends of the colours: a rounding is no excess.
    let least = 1e-6 * scale.low.abs().max(scale.high.abs());
    let (mut with_value, mut outside, mut farthest) = (0usize, 0usize, None::<f64>);
    for value in subject.values.iter().filter(|v| v.is_finite()).map(|v| f64::from(*v)) {
        with_value += 1;
        if excess(value) > least {
            outside += 1;
            farthest = farthest.filter(|known| excess(*known) >= excess(value)).or(Some(value));
        }
    }
    let value = rounded(farthest? * per_one, round_step((scale.high - scale.low) * per_one / 100.0));
    let percent = 100.0 * outside as f64 / with_value as f64;
    let share = if percent < 0.05 { "below 0.1".to_owned() } else { format!("{percent:.1}") };
    Some(format!("{share} % beyond the colours, to {value} {unit}").trim_end().to_owned())
}

/// Draws the colour bar, its left edge, top and height given, pixels.
fn draw_bar(
    canvas: &mut Canvas,
    subject: &Subject,
    layout: &Layout,
    [x, top, height]: [usize; 3],
) -> Result<(), CodecError> {
    if subject.scale.palette == Palette::Confusion {
        return draw_classes(canvas, layout, [x, top]);
    }
    let (scale, (unit, per_one), bar_width) = (&subject.scale, subject.unit, layout.bar_width);
    let span = scale.high - scale.low;
    for row in 0..height {
        let value = scale.high - span * (row as f64 + 0.5) / height as f64;
        canvas.fill(x, top + row, bar_width, 1, scale.colour(value));
    }
    canvas.frame(x, top, bar_width, height, FAINT);
    let pen = Pen::plain(layout.text_px, INK)?;
    // Ticks round in the unit that is shown, and the ends of the colours as they are.
    let shown = ColourScale { low: scale.low * per_one, high: scale.high * per_one, ..*scale };
    let ticks = shown.ticks((height as f64 / (4.6 * f64::from(layout.text_px))).clamp(3.0, 9.0));
    let step = ticks.windows(2).map(|pair| pair[1] - pair[0]).next().unwrap_or(1.0);
    let down = |value: f64| top as f64 + (shown.high - value) / (shown.high - shown.low) * height as f64;
    let is_clear = |tick: f64| {
        [shown.low, shown.high].iter().all(|end| (down(tick) - down(*end)).abs() >= 1.3 * f64::from(layout.text_px))
    };
    let between = ticks.iter().copied().zip(labels(&ticks, 1.0)).filter(|(tick, _)| is_clear(*tick));
    let ends = [shown.low, shown.high].map(|end| (end, rounded(end, round_step(0.1 * step))));
    for (tick, label) in between.chain(ends) {
        let y = down(tick);
        canvas.fill(x + bar_width + 1, y.round() as usize, (5.0 * layout.unit) as usize, 1, FAINT);
        let left = (x + bar_width) as f32 + 9.0 * layout.unit;
        canvas.text(&pen, left, y as f32, Align::Left, &label);
    }
    let middle = (x + bar_width / 2) as f32;
    canvas.text(&pen, middle, top as f32 - 11.0 * layout.unit, Align::Middle, unit);
    Ok(())
}

/// Draws what the colours of a confusion mean, in place of a colour bar.
fn draw_classes(canvas: &mut Canvas, layout: &Layout, [x, top]: [usize; 2]) -> Result<(), CodecError> {
    let pen = Pen::plain(layout.text_px, INK)?;
    let side = layout.text_px as usize + 1;
    for (row, (name, colour)) in CONFUSION.into_iter().enumerate() {
        let y = top + row * 3 * side / 2;
        canvas.fill(x, y, layout.bar_width, side, colour);
        canvas.frame(x, y, layout.bar_width, side, FAINT);
        let left = (x + layout.bar_width) as f32 + 0.65 * layout.text_px;
        canvas.text(&pen, left, (y + side / 2) as f32, Align::Left, name);
    }
    Ok(())
}

/// Draws a bar of a round length, about an eighth of a width in pixels, from a point [x, y] to the right, its length written
/// with `pen`; `pixel_m` is the side of a pixel, metres.
pub fn draw_scale(
    canvas: &mut Canvas,
    width_px: f64,
    pixel_m: f64,
    [x, y]: [usize; 2],
    pen: &Pen,
) -> Result<(), CodecError> {
    let length_m = round_step(width_px * pixel_m / 8.0);
    // Where a pixel is so large that a length of it is none, the quotient is no number or without bounds.
    let long = (length_m / pixel_m).round().clamp(0.0, width_px) as usize;
    canvas.fill(x, y - 3, long, 6, INK);
    canvas.fill(x + long / 2, y - 2, long / 2, 4, [255; 3]);
    canvas.fill(x + long.saturating_sub(1), y - 3, 1, 6, INK);
    canvas.text(pen, (x + long + 10) as f32, y as f32, Align::Left, &length(length_m));
    Ok(())
}

/// Cells of a grid (columns, rows) that a pixel of its picture covers along a side, where there are `room` pixels.
fn cells_per_pixel([columns, rows]: [usize; 2], room: usize) -> f64 {
    let longest = columns.max(rows);
    if longest > room { longest as f64 / room as f64 } else { 1.0 / (room / longest).min(MAXIMUM_ENLARGEMENT) as f64 }
}

/// Pixels that so many cells take.
fn pixels_of(cells: usize, cells_per_pixel: f64) -> usize {
    ((cells as f64 / cells_per_pixel).round() as usize).max(1)
}

/// The values at the size of the picture.
struct View {
    width: usize,
    height: usize,
    cells_per_pixel: f64,
    values: Vec<f32>,
}

impl View {
    fn of(subject: &Subject, room: usize) -> Self {
        let columns = subject.columns.max(1);
        let rows = (subject.values.len() / columns).max(1);
        let cells_per_pixel = cells_per_pixel([columns, rows], room);
        let [width, height] = [columns, rows].map(|cells| pixels_of(cells, cells_per_pixel));
        let mut values = vec![f32::NAN; width * height];
        let across: Vec<_> = (0..width).map(|x| cells(x, cells_per_pixel, columns)).collect();
        values.par_chunks_mut(width).enumerate().for_each(|(y, line)| {
            let rows = cells(y, cells_per_pixel, rows);
            for (value, across) in line.iter_mut().zip(&across) {
                *value = mean(subject.values, columns, &rows, across);
            }
        });
        Self { width, height, cells_per_pixel, values }
    }

    fn paint(&self, canvas: &mut Canvas, left: usize, top: usize, subject: &Subject) {
        let pixel_m = subject.cell_m.map(|cell_m| cell_m * self.cells_per_pixel).filter(|_| subject.shaded);
        for y in 0..self.height {
            for x in 0..self.width {
                let colour = subject.scale.colour(f64::from(self.values[y * self.width + x]));
                let light = pixel_m.map_or(1.0, |pixel_m| self.light(x, y, pixel_m));
                if let Some(pixel) = canvas.pixel(left + x, top + y) {
                    *pixel = colour.map(|c| (f64::from(c) * light).round().clamp(0.0, 255.0) as u8);
                }
            }
        }
    }

    /// Brightness under a light from the upper left, 45 degrees high; 1 on level ground.
    fn light(&self, x: usize, y: usize, pixel_m: f64) -> f64 {
        let at = |x: usize, y: usize| f64::from(self.values[y * self.width + x]);
        // An enlarged cell is level inside: slopes are taken from one cell to the next.
        let reach = (1.0 / self.cells_per_pixel).round().max(1.0) as usize;
        let (left, right) = (x.saturating_sub(reach), (x + reach).min(self.width - 1));
        let (above, below) = (y.saturating_sub(reach), (y + reach).min(self.height - 1));
        let slope_x = (at(right, y) - at(left, y)) / ((right - left).max(1) as f64 * pixel_m);
        let slope_y = (at(x, above) - at(x, below)) / ((below - above).max(1) as f64 * pixel_m);
        if slope_x.is_nan() || slope_y.is_nan() {
            return 1.0;
        }
        brightness(slope_x, slope_y)
    }
}

/// Brightness of a slope, metres a metre to the right and up, under a light from the upper left, 45 degrees high; 1 on
/// level ground.
pub fn brightness(slope_x: f64, slope_y: f64) -> f64 {
    let lambert = (1.0 + (slope_x - slope_y) * std::f64::consts::FRAC_1_SQRT_2)
        / (1.0 + slope_x * slope_x + slope_y * slope_y).sqrt();
    (0.35 + 0.65 * lambert.max(0.0)).min(1.35)
}

/// The cells under a pixel, each with the share of the pixel's side it fills.
fn cells(pixel: usize, cells_per_pixel: f64, count: usize) -> Vec<(usize, f64)> {
    let (start, end) = (pixel as f64 * cells_per_pixel, (pixel + 1) as f64 * cells_per_pixel);
    let first = (start as usize).min(count - 1);
    let last = (end.ceil() as usize).clamp(first + 1, count);
    let share = |cell: usize| end.min((cell + 1) as f64) - start.max(cell as f64);
    (first..last).map(|cell| (cell, share(cell))).filter(|(cell, share)| *share > 1e-6 || *cell == first).collect()
}

/// Mean of the finite cells, weighted by the area each has in the pixel.
fn mean(values: &[f32], columns: usize, rows: &[(usize, f64)], across: &[(usize, f64)]) -> f32 {
    let (mut sum, mut area) = (0.0, 0.0);
    for (row, high) in rows {
        for (column, wide) in across {
            let value = values.get(row * columns + column).copied().unwrap_or(f32::NAN);
            if value.is_finite() {
                sum += high * wide * f64::from(value);
                area += high * wide;
            }
        }
    }
    if area > 0.0 { (sum / area) as f32 } else { f32::NAN }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::colour_scale::Palette;

    fn decoded(file: Vec<u8>) -> (usize, usize, Vec<u8>) {
        let mut reader = png::Decoder::new(std::io::Cursor::new(file)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        (info.width as usize, info.height as usize, pixels)
    }

    fn subject(values: &[f32], columns: usize) -> Subject<'_> {
        let scale = ColourScale { palette: Palette::RedBlue, low: -1.0, high: 1.0 };
        let (title, subtitle) = ("T".to_owned(), String::new());
        Subject {
            columns,
            values,
            cell_m: Some(0.1),
            shaded: false,
            scale,
            title,
            subtitle,
            unit: ("m", 1.0),
            up: None,
        }
    }

    #[test]
    fn cells_have_their_colours_at_their_places() {
        let values = [-0.9, 0.0, 0.9, f32::NAN];
        let subject = subject(&values, 2);
        let (width, _, pixels) = decoded(draw(&subject, 600).unwrap());
        let side = MAXIMUM_ENLARGEMENT;
        for (cell, value) in values.iter().enumerate() {
            let (x, y) =
                (FULL.margin + side / 2 + cell % 2 * side, FULL.margin + FULL.head + side / 2 + cell / 2 * side);
            let at = 3 * (y * width + x);
            assert_eq!(pixels[at..at + 3], subject.scale.colour(f64::from(*value)), "cell {cell}");
        }
    }

    #[test]
    fn values_beyond_the_colours_are_told() {
        let mut values = vec![0.02; 99];
        values.extend([-0.2, f32::NAN]);
        let mut subject = subject(&values, 101);
        assert_eq!(beyond(&subject), None);
        (subject.scale.low, subject.scale.high, subject.unit) = (-0.048, 0.048, ("mm", 1e3));
        assert_eq!(beyond(&subject).unwrap(), "1.0 % beyond the colours, to \u{2212}200 mm");
    }

    #[test]
    fn large_grids_are_averaged_into_the_width() {
        let values: Vec<f32> = (0..2500 * 500).map(|i| (i % 2500) as f32).collect();
        let view = View::of(&subject(&values, 2500), 1000);
        assert_eq!((view.width, view.height), (1000, 200));
        // Pixel 501 lies over half of cell 1252 and all of cells 1253 and 1254.
        assert!((view.values[501] - (0.5 * 1252.0 + 1253.0 + 1254.0) / 2.5).abs() < 1e-3);
        let (width, _, _) = decoded(draw(&subject(&values, 2500), 1000).unwrap());
        assert!(width <= 1000);
    }

    #[test]
    fn the_light_comes_from_the_upper_left() {
        let ramp: Vec<f32> = (0..400).map(|i| (i % 20) as f32 * 0.05).collect();
        let view = View::of(&subject(&ramp, 20), 20);
        assert!(view.light(10, 10, 0.1) > 1.0);
        let falling: Vec<f32> = ramp.iter().map(|z| -z).collect();
        assert!(View::of(&subject(&falling, 20), 20).light(10, 10, 0.1) < 0.9);
    }
}
