//! Charts for reports: lines with bands, points, histograms, densities, bars, radar, landscapes, ternary, as one SVG.
//!
//! A [`Sheet`] holds panels (small multiples when there are several), a panel holds a [`Plot`], and [`draw`] makes the
//! [`Figure`]. Every axis has a label with its unit. Colours are those of Okabe and Ito, told apart with any colour
//! vision, and CSS variables with the light colours to fall back on, so that a figure inside a page follows its light and
//! dark ([`theme`] names them) and a file alone is a white card. Equal sheets give equal bytes.
//!
//! ```
//! use rockface_analysis::figure::chart::{Axes, Axis, Ink, Layer, Panel, Sheet, draw};
//!
//! let lags: Vec<f64> = (1..=40).map(|i| 0.02 * f64::from(i)).collect();
//! let real = lags.iter().map(|h| [*h, 20.0 + 60.0 * h, 40.0 + 90.0 * h]).collect();
//! let simulated = lags.iter().map(|h| [*h, 30.0 + 75.0 * h]).collect();
//! let axes = Axes::new(Axis::linear("lag, m"), Axis::log("semivariance, mm²"))
//!     .with(Layer::band("39 real comparisons, 5 to 95 %", real).ink(Ink::Muted))
//!     .with(Layer::line("simulated", simulated));
//! let figure = draw(&Sheet::of([Panel::new("Variogram", axes)])).unwrap();
//! assert!(figure.svg.starts_with("<svg"));
//! ```

mod axes;
mod colour_key;
mod distribution;
mod layer;
mod legend;
mod radar;
mod scale;
mod ternary;
pub mod theme;

use plotters::coord::Shift;
use plotters::prelude::{DrawingArea, IntoDrawingArea, SVGBackend};

use rockface_core::artefact::{CodecError, Figure};

pub use axes::Axes;
pub use colour_key::ColourKey;
pub use distribution::{density, histogram};
pub use layer::{Layer, Mark};
pub use radar::Radar;
pub use scale::{Axis, AxisKind};
pub use ternary::Ternary;
pub use theme::Ink;

use theme::{Face, UNIT, words};

/// A part of the drawing.
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Pixels between panels and around them.
const GAP: i32 = 14;
/// Height of the titles of the sheet, pixels.
const TITLE: i32 = 26;
/// The most panels of a sheet; more is no figure but a mistake.
const PANELS: usize = 100;

/// One figure: panels side by side and below each other.
#[derive(Debug, Clone, PartialEq)]
pub struct Sheet {
    /// Over all panels; may be empty.
    pub title: String,
    /// Under the title; may be empty.
    pub subtitle: String,
    /// Width of the figure, pixels.
    pub width_px: u32,
    /// Height of each panel with its titles, pixels.
    pub panel_height_px: u32,
    /// Panels in a row.
    pub columns: usize,
    /// The panels, by row.
    pub panels: Vec<Panel>,
}

impl Sheet {
    /// A sheet of 720 pixels with these panels: one alone, two or four in rows of two, others in rows of three.
    pub fn of(panels: impl IntoIterator<Item = Panel>) -> Self {
        let panels: Vec<Panel> = panels.into_iter().collect();
        let columns = match panels.len() {
            0 | 1 => 1,
            2 | 4 => 2,
            _ => 3,
        };
        let panel_height_px = if columns == 1 { 380 } else { 290 };
        Self { title: String::new(), subtitle: String::new(), width_px: 720, panel_height_px, columns, panels }
    }

    /// Sets the title over the whole sheet.
    #[must_use]
    pub fn title(self, title: impl Into<String>) -> Self {
        Self { title: title.into(), ..self }
    }

    /// Sets the line under the title.
    #[must_use]
    pub fn subtitle(self, subtitle: impl Into<String>) -> Self {
        Self { subtitle: subtitle.into(), ..self }
    }

    /// Sets how many panels are in a row.
    #[must_use]
    pub fn columns(self, columns: usize) -> Self {
        Self { columns: columns.max(1), ..self }
    }

    /// Sets the width of the figure and the height of each panel, pixels.
    #[must_use]
    pub fn size(self, width_px: u32, panel_height_px: u32) -> Self {
        Self { width_px, panel_height_px, ..self }
    }
}

/// One chart of a sheet.
#[derive(Debug, Clone, PartialEq)]
pub struct Panel {
    /// Over the chart; may be empty.
    pub title: String,
    /// What is drawn in the panel.
    pub plot: Plot,
}

impl Panel {
    /// A panel with a title, which may be empty, and a chart.
    pub fn new(title: impl Into<String>, plot: impl Into<Plot>) -> Self {
        Self { title: title.into(), plot: plot.into() }
    }
}

/// The kinds of chart.
#[derive(Debug, Clone, PartialEq)]
pub enum Plot {
    /// Anything over two axes.
    Axes(Axes),
    /// Spokes from a centre.
    Radar(Radar),
    /// Shapes after Sneed and Folk.
    Ternary(Ternary),
}

impl From<Axes> for Plot {
    fn from(plot: Axes) -> Self {
        Self::Axes(plot)
    }
}

impl From<Radar> for Plot {
    fn from(plot: Radar) -> Self {
        Self::Radar(plot)
    }
}

impl From<Ternary> for Plot {
    fn from(plot: Ternary) -> Self {
        Self::Ternary(plot)
    }
}

/// An image laid under the drawing: left, top, width and height in drawing units, and the PNG.
struct Inset {
    place: [i32; 4],
    png: Vec<u8>,
}

/// Draws a sheet.
///
/// # Errors
/// No panel or too many, a size that leaves no room, or values that cannot be drawn; the message says which.
pub fn draw(sheet: &Sheet) -> Result<Figure, CodecError> {
    let rows = sheet.panels.len().div_ceil(sheet.columns.max(1));
    if sheet.panels.is_empty() || sheet.panels.len() > PANELS {
        return Err(CodecError(format!("a figure has 1 to {PANELS} panels, not {}", sheet.panels.len())));
    }
    if !(200..=8000).contains(&sheet.width_px) || !(120..=4000).contains(&sheet.panel_height_px) {
        let size = format!("{} x {}", sheet.width_px, sheet.panel_height_px);
        return Err(CodecError(format!("a figure of {size} pixels: give 200 to 8000 by 120 to 4000 a panel")));
    }
    let head = [&sheet.title, &sheet.subtitle].iter().filter(|text| !text.is_empty()).count() as i32 * TITLE;
    let height = 2 * GAP + head + rows as i32 * (sheet.panel_height_px as i32 + GAP) - GAP;
    let size = (sheet.width_px * UNIT as u32, (height * UNIT) as u32);
    let (mut text, mut insets) = (String::new(), Vec::new());
    {
        let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
        titles(&root, sheet)?;
        for (number, panel) in sheet.panels.iter().enumerate() {
            let area = place(&root, sheet, head, number);
            draw_panel(&area, panel, &mut insets)?;
        }
        root.present().map_err(failed)?;
    }
    Ok(Figure { svg: theme::finish(&text, size, &sheet.title, &insets) })
}

fn titles(root: &Area, sheet: &Sheet) -> Result<(), CodecError> {
    let mut y = GAP * UNIT;
    for (text, face) in [(&sheet.title, Face::Title), (&sheet.subtitle, Face::Label)] {
        if !text.is_empty() {
            words(root, text, face, [GAP * UNIT, y], theme::Anchor::Start)?;
            y += TITLE * UNIT;
        }
    }
    Ok(())
}

fn place<'a>(root: &Area<'a>, sheet: &Sheet, head: i32, number: usize) -> Area<'a> {
    let columns = sheet.columns.min(sheet.panels.len()).max(1) as i32;
    let width = (sheet.width_px as i32 - (columns + 1) * GAP) / columns;
    let (column, row) = (number as i32 % columns, number as i32 / columns);
    let (left, top) = (GAP + column * (width + GAP), GAP + head + row * (sheet.panel_height_px as i32 + GAP));
    let corner = (left * UNIT, top * UNIT);
    root.clone().shrink(corner, (width * UNIT, sheet.panel_height_px as i32 * UNIT))
}

fn draw_panel(area: &Area, panel: &Panel, insets: &mut Vec<Inset>) -> Result<(), CodecError> {
    let mut top = 0;
    if !panel.title.is_empty() {
        words(area, &panel.title, Face::Heading, [0, 0], theme::Anchor::Start)?;
        top = 22 * UNIT;
    }
    let (width, height) = area.dim_in_pixel();
    let below = area.clone().shrink((0, top), (width as i32, height as i32 - top));
    match &panel.plot {
        Plot::Axes(axes) => axes::draw(&below, axes, insets),
        Plot::Radar(radar) => radar::draw(&below, radar),
        Plot::Ternary(ternary) => ternary::draw(&below, ternary, insets),
    }
}

fn failed(error: impl std::fmt::Display) -> CodecError {
    CodecError(format!("cannot draw the figure: {error}"))
}

#[cfg(test)]
mod tests;
