//! Inks, faces and the last hand on the SVG: fixed colours become CSS variables that have them to fall back on.
//!
//! | variable | what | alone |
//! |---|---|---|
//! | `--paper` | behind everything | `#ffffff` |
//! | `--ink` | titles and numbers | `#1f2328` |
//! | `--ink-faint` | labels and axes | `#59636e` |
//! | `--ink-hair` | grid lines | `#dde2e8` |
//! | `--ink-muted` | what others are compared with | `#8b949e` |
//! | `--series-1` to `--series-6` | lines, points, bars | blue, vermilion, green, purple, sky, orange |

use base64::Engine;
use plotters::element::PathElement;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{Color, FontStyle, IntoFont, RGBColor, ShapeStyle, TextStyle};

use super::{Area, Inset, failed};
use crate::figure::canvas::{Colour, Pen};
use rockface_core::artefact::{CodecError, Figure};

/// Drawing units a pixel: the backend knows whole numbers only.
pub(super) const UNIT: i32 = 10;

const PAPER: Colour = [0xff, 0xff, 0xff];
const TEXT: Colour = [0x1f, 0x23, 0x28];
const FAINT: Colour = [0x59, 0x63, 0x6e];
const HAIR: Colour = [0xdd, 0xe2, 0xe8];
const MUTED: Colour = [0x8b, 0x94, 0x9e];
/// Drawn dashed; it has a colour of its own so that it is told from solid faint lines.
const RULE: Colour = [0x5a, 0x64, 0x6f];
/// Okabe and Ito (2008), without black and yellow, the darker first.
const SERIES: [Colour; 6] = [
    [0x00, 0x72, 0xb2],
    [0xd5, 0x5e, 0x00],
    [0x00, 0x9e, 0x73],
    [0xcc, 0x79, 0xa7],
    [0x56, 0xb4, 0xe9],
    [0xe6, 0x9f, 0x00],
];

/// Every colour that follows the page: class, variable, colour.
const VARIABLES: [(&str, &str, Colour); 12] = [
    ("p", "paper", PAPER),
    ("t", "ink", TEXT),
    ("f", "ink-faint", FAINT),
    ("h", "ink-hair", HAIR),
    ("m", "ink-muted", MUTED),
    ("r", "ink-faint", RULE),
    ("s1", "series-1", SERIES[0]),
    ("s2", "series-2", SERIES[1]),
    ("s3", "series-3", SERIES[2]),
    ("s4", "series-4", SERIES[3]),
    ("s5", "series-5", SERIES[4]),
    ("s6", "series-6", SERIES[5]),
];

/// What something is drawn with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ink {
    /// The colour of a series, from 0; after six they begin again.
    Series(usize),
    /// What others are compared with.
    Muted,
    /// The colour of text.
    Text,
    /// The paler colour of axes and their labels.
    Faint,
    /// The palest colour, of grid lines.
    Hair,
    /// A dashed line: thresholds, means, lines of equality.
    Rule,
    /// This colour in light and dark.
    Fixed(Colour),
}

impl Ink {
    fn colour(self) -> RGBColor {
        let [r, g, b] = match self {
            Self::Series(number) => SERIES[number % SERIES.len()],
            Self::Muted => MUTED,
            Self::Text => TEXT,
            Self::Faint => FAINT,
            Self::Hair => HAIR,
            Self::Rule => RULE,
            Self::Fixed(colour) => colour,
        };
        RGBColor(r, g, b)
    }

    /// A line this wide, tenths of a pixel.
    pub(super) fn line(self, width: i32) -> ShapeStyle {
        self.colour().stroke_width(width.unsigned_abs())
    }

    /// An area this opaque, from 0 to 1.
    pub(super) fn area(self, opacity: f64) -> ShapeStyle {
        self.colour().mix(opacity).filled()
    }
}

/// The sizes and weights of text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Face {
    /// The title of the sheet.
    Title,
    /// The title of a panel.
    Heading,
    /// Of axes, series, rows.
    Label,
    /// Numbers at ticks.
    Tick,
}

impl Face {
    const fn pixels(self) -> i32 {
        match self {
            Self::Title => 16,
            Self::Heading => 13,
            Self::Label => 12,
            Self::Tick => 11,
        }
    }

    fn ink(self) -> Ink {
        if matches!(self, Self::Label) { Ink::Faint } else { Ink::Text }
    }

    /// The style for the backend, which divides sizes by 1.24.
    pub(super) fn style(self) -> TextStyle<'static> {
        let weight = if matches!(self, Self::Title | Self::Heading) { FontStyle::Bold } else { FontStyle::Normal };
        let font = ("sans-serif", 1.24 * f64::from(self.pixels() * UNIT)).into_font().style(weight);
        let mut style = TextStyle::from(font);
        style.color = self.ink().colour().to_backend_color();
        style
    }

    /// Width of a text in drawing units at most: few typefaces are wider than the one it is measured in.
    pub(super) fn width(self, text: &str) -> i32 {
        let pen = Pen::plain(1.16 * self.pixels() as f32, TEXT);
        pen.map_or(0, |pen| (pen.width(text) * UNIT as f32).ceil() as i32)
    }
}

/// Where a text lies about its place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// Writes a text, its top at a place in drawing units.
pub(super) fn words(area: &Area, text: &str, face: Face, [x, y]: [i32; 2], anchor: Anchor) -> Result<(), CodecError> {
    let across = match anchor {
        Anchor::Start => HPos::Left,
        Anchor::Middle => HPos::Center,
        Anchor::End => HPos::Right,
    };
    let style = face.style().pos(Pos::new(across, VPos::Top));
    area.draw_text(text, &style, (x, y)).map_err(failed)
}

/// Draws a line through places in drawing units.
pub(super) fn stroke(area: &Area, places: Vec<(i32, i32)>, style: ShapeStyle) -> Result<(), CodecError> {
    area.draw(&PathElement::new(places, style)).map_err(failed)
}

fn hex([r, g, b]: Colour) -> String {
    format!("#{r:02X}{g:02X}{b:02X}")
}

/// Typefaces of the reader's system.
const FONTS: &str = "system-ui,-apple-system,'Segoe UI',Roboto,'Helvetica Neue',Arial,sans-serif";

/// Finishes what the backend wrote: size in pixels, title, style sheet, paper, insets, classes for colours.
pub(super) fn finish(text: &str, size: (u32, u32), title: &str, insets: &[Inset]) -> String {
    let (width, height) = size;
    let unit = UNIT as u32;
    let body = text.split_once(">\n").map_or("", |(_, body)| body);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{}\" height=\"{}\" role=\"img\" \
         font-family=\"{FONTS}\">\n",
        width / unit,
        height / unit
    );
    if !title.is_empty() {
        svg.push_str(&format!("<title>{}</title>\n", escaped(title)));
    }
    svg.push_str(&format!("<style>{}</style>\n", Figure::STYLE_SHEET));
    svg.push_str(&format!("<rect width=\"{width}\" height=\"{height}\" fill=\"#FFFFFF\" class=\"rf-p\"/>\n"));
    for Inset { place: [x, y, width, height], png } in insets {
        let data = base64::engine::general_purpose::STANDARD.encode(png);
        svg.push_str(&format!(
            "<image x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" preserveAspectRatio=\"none\" \
             style=\"image-rendering:pixelated\" href=\"data:image/png;base64,{data}\"/>\n"
        ));
    }
    svg.push_str(&with_classes(body));
    svg
}

/// Gives elements of a known colour its class; one without classes still has its colour.
fn with_classes(body: &str) -> String {
    let mut text = body.replace(" opacity=\"1\"", "").replace(" font-family=\"sans-serif\"", "");
    // Paper is behind everything and has its class; what is white elsewhere stays white.
    for (class, _, colour) in VARIABLES.into_iter().filter(|(class, _, _)| *class != "p") {
        for (attribute, kind) in [("fill", "rf"), ("stroke", "rl")] {
            let plain = format!(" {attribute}=\"{}\"", hex(colour));
            text = text.replace(&plain, &format!("{plain} class=\"{kind}-{class}\""));
        }
    }
    for face in [Face::Title, Face::Heading, Face::Label, Face::Tick] {
        // The backend's division leaves a last digit.
        let pixels = f64::from(face.pixels() * UNIT);
        text = text.replace(&format!("font-size=\"{}\"", 1.24 * pixels / 1.24), &format!("font-size=\"{pixels}\""));
    }
    text
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_style_sheet_has_every_colour() {
        let rule = |(class, variable, colour): &(&str, &str, Colour)| {
            let value = format!("var(--{variable},{})", hex(*colour).to_lowercase());
            let dashes = if *class == "r" { ";stroke-dasharray:50 40" } else { "" };
            format!(".rf-{class}{{fill:{value}}}.rl-{class}{{stroke:{value};stroke-linejoin:round{dashes}}}")
        };
        assert_eq!(Figure::STYLE_SHEET, VARIABLES.iter().map(rule).collect::<String>());
    }
}
