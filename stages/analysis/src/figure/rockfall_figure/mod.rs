//! The summary figure of a rockfall inventory: the face with its niches, magnitude and frequency, shapes, and what blocks lost.
//!
//! `strokes` draws lines, dots and polygons, `axes` a frame with logarithmic axes, and `face`, `frequency`, `ternary` and
//! `volumes` a panel each; `outcomes` maps what was found and what was not.

mod axes;
mod face;
mod frequency;
pub mod outcomes;
pub mod strokes;
mod ternary;
mod volumes;

use rockface_core::artefact::{CodecError, Grid, Polygon};

use super::canvas::{Align, Canvas, Colour, Pen};
use super::colour_scale::{ColourScale, Palette};
use rockface_core::numerics::portable_math;
use rockface_rock::rockfall::power_law::PowerLaw;

/// Width of a picture whose unit is a pixel; wider ones show the same, finer.
const WIDTH: usize = 1000;
const MARGIN: usize = 30;
const TITLE: usize = 78;
const GAP: usize = 40;
const PANEL_HEIGHT: usize = 400;
const INK: Colour = [32, 32, 36];
const FAINT: Colour = [96, 98, 106];
const HAIR: Colour = [226, 227, 231];
const ACCENT: Colour = [178, 34, 52];

/// A rockfall as the figure shows it.
#[derive(Debug, Clone, PartialEq)]
pub struct Rockfall<'a> {
    /// Its outline in the frame of the face.
    pub outline: &'a [Polygon],
    /// Volume removed, cubic metres.
    pub removed_m3: f64,
    /// Volume of its block, cubic metres.
    pub block_m3: Option<f64>,
    /// Its axes in any order, metres.
    pub sides_m: Option<[f64; 3]>,
}

/// What the figure shows.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure<'a> {
    /// The title over the figure.
    pub title: String,
    /// Elevation of the face by row from the top, NaN where there is none.
    pub face: &'a [f32],
    /// The grid of the face.
    pub grid: Grid,
    /// The rockfalls, each with a positive volume.
    pub rockfalls: Vec<Rockfall<'a>>,
    /// The law of their volumes, where one was found.
    pub law: Option<PowerLaw>,
    /// Volumes that were asked for, ascending, cubic metres; empty where not given.
    pub requested_m3: Vec<f64>,
}

/// A box in the picture, units.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Frame {
    left: usize,
    top: usize,
    width: usize,
    height: usize,
}

/// Draws the figure as a PNG of this width, at least 1000 pixels.
///
/// # Errors
/// A picture that cannot be written.
pub fn draw(figure: &Figure, width_px: usize) -> Result<Vec<u8>, CodecError> {
    let unit_px = (width_px as f64 / WIDTH as f64).max(1.0);
    let inside = WIDTH - 2 * MARGIN;
    let scale = colours(figure);
    let view = face::View::of(&figure.grid, inside - face::BAR, inside * 11 / 20);
    let panels_top = MARGIN + TITLE + view.height + face::FOOT + GAP;
    let mut canvas = Canvas::in_units(WIDTH, panels_top + PANEL_HEIGHT + MARGIN, unit_px);
    titles(&mut canvas, figure)?;
    face::draw(&mut canvas, figure, &view, &scale, [MARGIN, MARGIN + TITLE])?;
    let panel = (inside - 2 * GAP) / 3;
    let frame = |number: usize| Frame {
        left: MARGIN + number * (panel + GAP),
        top: panels_top,
        width: panel,
        height: PANEL_HEIGHT,
    };
    frequency::draw(&mut canvas, figure, frame(0))?;
    ternary::draw(&mut canvas, figure, &scale, frame(1))?;
    volumes::draw(&mut canvas, figure, &scale, frame(2))?;
    canvas.to_png()
}

/// Colours of volumes by their decimal logarithm.
fn colours(figure: &Figure) -> ColourScale {
    let logarithms = figure.rockfalls.iter().map(|fall| portable_math::log10(fall.removed_m3));
    let [low, high] = logarithms.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], x| [a.min(x), b.max(x)]);
    if low < high {
        return ColourScale { palette: Palette::Viridis, low, high };
    }
    let middle = if low.is_finite() { low } else { 0.0 };
    ColourScale { palette: Palette::Viridis, low: middle - 0.5, high: middle + 0.5 }
}

fn titles(canvas: &mut Canvas, figure: &Figure) -> Result<(), CodecError> {
    let (x, y) = (MARGIN as f32, MARGIN as f32);
    canvas.text(&Pen::bold(30.0, INK)?, x, y + 10.0, Align::Left, &figure.title);
    let sum = figure.rockfalls.iter().fold(0.0, |sum, fall| sum + fall.removed_m3);
    let count = figure.rockfalls.len();
    let text = format!("{}, {} of rock", pieces(count), volume(sum));
    canvas.text(&Pen::plain(20.0, FAINT)?, x, y + 44.0, Align::Left, &text);
    Ok(())
}

fn pieces(count: usize) -> String {
    if count == 1 { "1 piece".to_owned() } else { format!("{count} pieces") }
}

/// A volume with three digits in the unit people would write.
fn volume(volume_m3: f64) -> String {
    volume_beside(volume_m3, volume_m3)
}

/// A volume with three digits in the unit people would write another in.
fn volume_beside(volume_m3: f64, other_m3: f64) -> String {
    let (value, unit) = if other_m3 < 0.1 { (volume_m3 * 1e3, "dm\u{b3}") } else { (volume_m3, "m\u{b3}") };
    let digits = if value > 0.0 { (2.0 - portable_math::log10(value).floor()).clamp(0.0, 9.0) as usize } else { 0 };
    format!("{value:.digits$} {unit}")
}

/// Title of a panel.
fn heading(canvas: &mut Canvas, frame: Frame, text: &str) -> Result<(), CodecError> {
    canvas.text(&Pen::bold(18.0, INK)?, frame.left as f32, frame.top as f32 + 8.0, Align::Left, text);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(left: f64, top: f64, side: f64) -> Vec<Polygon> {
        let exterior = vec![[left, top - side], [left + side, top - side], [left + side, top], [left, top]];
        vec![Polygon { exterior, holes: Vec::new() }]
    }

    #[test]
    fn a_figure_has_the_width_asked_for_and_shows_the_niche() {
        let grid = Grid { columns: 40, rows: 20, cell_m: 0.1, left_m: 0.0, top_m: 2.0 };
        let face = vec![0.0; 800];
        let outline = square(1.0, 1.5, 1.0);
        let fall = Rockfall { outline: &outline, removed_m3: 0.2, block_m3: Some(0.3), sides_m: Some([1.0, 1.0, 0.2]) };
        let mut figure =
            Figure { title: "T".into(), face: &face, grid, rockfalls: vec![fall], law: None, requested_m3: Vec::new() };
        let with = draw(&figure, 1000).unwrap();
        let fine = draw(&figure, 2600).unwrap();
        figure.rockfalls.clear();
        let without = draw(&figure, 1000).unwrap();
        let info = |file: &[u8]| png::Decoder::new(std::io::Cursor::new(file)).read_info().unwrap().info().width;
        assert_eq!((info(&with), info(&without), info(&fine)), (1000, 1000, 2600));
        assert_ne!(with, without);
    }

    #[test]
    fn volumes_of_a_scale_have_one_unit() {
        let beside = |volume| volume_beside(volume, 0.25);
        assert_eq!([0.25, 0.0525, 0.000_001_1].map(beside), ["0.250 m\u{b3}", "0.0525 m\u{b3}", "0.00000110 m\u{b3}"]);
        assert_eq!(volume_beside(0.02, 0.09), "20.0 dm\u{b3}");
        assert_eq!([1, 2].map(pieces), ["1 piece", "2 pieces"]);
    }

    #[test]
    fn volumes_read_as_people_write_them() {
        assert_eq!(
            [0.0, 0.00234, 0.5, 14.9032, 1234.0].map(volume),
            ["0 dm\u{b3}", "2.34 dm\u{b3}", "0.500 m\u{b3}", "14.9 m\u{b3}", "1234 m\u{b3}"]
        );
    }
}
