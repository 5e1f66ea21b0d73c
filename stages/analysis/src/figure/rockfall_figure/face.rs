//! The face in grey relief with its niches coloured by volume, a scale bar and a colour bar.

use rayon::prelude::*;

use crate::figure::canvas::{Align, Canvas, Colour, Pen};
use crate::figure::colour_scale::{ColourScale, NO_DATA};
use crate::figure::picture::{brightness, draw_scale};
use rockface_core::artefact::{CodecError, Grid, Polygon};
use rockface_core::numerics::portable_math;

use super::{FAINT, Figure, INK, strokes, volume_beside};

/// Room for the colour bar to the right, units.
pub const BAR: usize = 160;
/// Room for the scale bar below, units.
pub const FOOT: usize = 40;
const BAR_WIDTH: usize = 22;
/// Grey of level rock.
const ROCK: f64 = 205.0;

/// The face at the size of the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Width, units.
    pub width: usize,
    /// Height, units.
    pub height: usize,
    /// Side of a unit, metres.
    pub unit_m: f64,
}

impl View {
    /// The largest view of a grid within so many units.
    pub fn of(grid: &Grid, width: usize, height: usize) -> Self {
        let (wide, high) = (grid.columns as f64 * grid.cell_m, grid.rows as f64 * grid.cell_m);
        let unit_m = (wide / width as f64).max(high / height as f64);
        let units = |metres: f64| ((metres / unit_m).round() as usize).max(1);
        Self { width: units(wide), height: units(high), unit_m }
    }

    /// The grey relief of elevations by row from the top, as a sheet of its own: outlines that reach beyond the face end at its frame.
    pub fn relief(&self, face: &[f32], grid: &Grid, unit_px: f64) -> Canvas {
        let mut sheet = Canvas::in_units(self.width, self.height, unit_px);
        let [width, height] = sheet.size_px();
        let pixels = Self { width, height, unit_m: self.unit_m / unit_px };
        for (place, shade) in shades(face, grid, &pixels).iter().enumerate() {
            if let Some(pixel) = sheet.pixel(place % width, place / width) {
                *pixel = *shade;
            }
        }
        sheet
    }
}

/// Draws the face with its upper left corner at a place.
pub fn draw(
    canvas: &mut Canvas,
    figure: &Figure,
    view: &View,
    scale: &ColourScale,
    [left, top]: [usize; 2],
) -> Result<(), CodecError> {
    let mut sheet = view.relief(figure.face, &figure.grid, canvas.unit_px());
    paint(&mut sheet, figure, view, scale);
    canvas.lay(&sheet, [left, top]);
    canvas.frame(left, top, view.width, view.height, FAINT);
    draw_bar(canvas, scale, [left + view.width + 30, top], view.height.min(420), figure)?;
    let pen = Pen::plain(18.0, INK)?;
    draw_scale(canvas, view.width as f64, view.unit_m, [left, top + view.height + 24], &pen)
}

/// Draws the niches, small ones over large ones.
fn paint(sheet: &mut Canvas, figure: &Figure, view: &View, scale: &ColourScale) {
    let mut order: Vec<_> = figure.rockfalls.iter().collect();
    order.sort_by(|a, b| b.removed_m3.total_cmp(&a.removed_m3));
    for fall in order {
        let colour = scale.colour(portable_math::log10(fall.removed_m3));
        for polygon in fall.outline {
            let polygon = in_units(polygon, &figure.grid, view);
            strokes::fill(sheet, &polygon, colour, 0.62);
            strokes::outline(sheet, &polygon, 1.6, darker(colour));
        }
    }
}

fn darker(colour: Colour) -> Colour {
    colour.map(|value| value / 2)
}

/// A polygon in metres as one in units of a view.
pub fn in_units(polygon: &Polygon, grid: &Grid, view: &View) -> Polygon {
    let place = |[x, y]: &[f64; 2]| [(x - grid.left_m) / view.unit_m, (grid.top_m - y) / view.unit_m];
    let ring = |ring: &Vec<[f64; 2]>| ring.iter().map(place).collect();
    Polygon { exterior: ring(&polygon.exterior), holes: polygon.holes.iter().map(ring).collect() }
}

/// Grey of elevations by row from the top, in a view whose units are pixels.
fn shades(face: &[f32], grid: &Grid, view: &View) -> Vec<Colour> {
    let heights: Vec<f64> =
        (0..view.width * view.height).into_par_iter().map(|i| height(face, grid, view, i)).collect();
    let at = |x: usize, y: usize| heights[y * view.width + x];
    let shade = |place: usize| {
        let (x, y) = (place % view.width, place / view.width);
        if at(x, y).is_nan() {
            return NO_DATA;
        }
        let (left, right) = (x.saturating_sub(1), (x + 1).min(view.width - 1));
        let (above, below) = (y.saturating_sub(1), (y + 1).min(view.height - 1));
        let slope_x = (at(right, y) - at(left, y)) / ((right - left).max(1) as f64 * view.unit_m);
        let slope_y = (at(x, above) - at(x, below)) / ((below - above).max(1) as f64 * view.unit_m);
        let light = if slope_x.is_nan() || slope_y.is_nan() { 1.0 } else { brightness(slope_x, slope_y) };
        [(ROCK * light).round().clamp(0.0, 250.0) as u8; 3]
    };
    (0..heights.len()).into_par_iter().map(shade).collect()
}

/// Elevation under a pixel: between the four cells around it, the mean of the cells it covers when they are smaller.
fn height(face: &[f32], grid: &Grid, view: &View, place: usize) -> f64 {
    let cells = view.unit_m / grid.cell_m;
    let centre = |pixel: usize| (pixel as f64 + 0.5) * cells - 0.5;
    let (column, row) = (centre(place % view.width), centre(place / view.width));
    let reach = (0.5 * cells).max(1.0);
    let range = |middle: f64, count: usize| {
        let first = (middle - reach).ceil().max(0.0) as usize;
        first..((middle + reach).floor().max(0.0) as usize + 1).min(count)
    };
    let (mut sum, mut weight) = (0.0, 0.0);
    for r in range(row, grid.rows) {
        for c in range(column, grid.columns) {
            let value = f64::from(face[r * grid.columns + c]);
            // A tent over the pixel: linear between cells, a mean over many.
            let share = (1.0 - (r as f64 - row).abs() / reach) * (1.0 - (c as f64 - column).abs() / reach) + 1e-9;
            if value.is_finite() {
                sum += share * value;
                weight += share;
            }
        }
    }
    if weight > 0.0 { sum / weight } else { f64::NAN }
}

fn draw_bar(
    canvas: &mut Canvas,
    scale: &ColourScale,
    [x, top]: [usize; 2],
    height: usize,
    figure: &Figure,
) -> Result<(), CodecError> {
    if figure.rockfalls.is_empty() {
        return Ok(());
    }
    let pen = Pen::plain(18.0, INK)?;
    canvas.text(&pen, x as f32, top as f32 + 8.0, Align::Left, "volume");
    let (top, height) = (top + 30, height.saturating_sub(30).max(60));
    for row in 0..height {
        let share = (row as f64 + 0.5) / height as f64;
        canvas.fill(x, top + row, BAR_WIDTH, 1, scale.colour(scale.high - (scale.high - scale.low) * share));
    }
    canvas.frame(x, top, BAR_WIDTH, height, FAINT);
    let largest = portable_math::pow(10.0, scale.high);
    for tick in 0..5 {
        let share = f64::from(tick) / 4.0;
        let value = portable_math::pow(10.0, scale.high - (scale.high - scale.low) * share);
        let y = top as f64 + share * height as f64;
        canvas.text(&pen, (x + BAR_WIDTH + 8) as f32, y as f32, Align::Left, &volume_beside(value, largest));
    }
    Ok(())
}
