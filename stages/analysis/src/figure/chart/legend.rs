//! The names of the layers over a chart, each beside a swatch of what it is drawn with.

use plotters::element::{Circle, Rectangle};

use super::layer::{Layer, Mark};
use super::theme::{Anchor, Face, Ink, UNIT, stroke, words};
use super::{Area, failed};
use rockface_core::artefact::CodecError;

/// Height of a line, width of a swatch and gaps, drawing units.
const LINE: i32 = 18 * UNIT;
const SWATCH: i32 = 18 * UNIT;
const GAP: i32 = 14 * UNIT;

/// Draws the legend at the top of an area; returns the height it takes, drawing units.
pub(super) fn draw<'l>(area: &Area, entries: impl Iterator<Item = (&'l Layer, &'l Ink)>) -> Result<i32, CodecError> {
    let entries: Vec<(&str, &Mark, Ink)> =
        entries.map(|(layer, ink)| (layer.name.as_str(), &layer.mark, *ink)).collect();
    let names = entries.iter().map(|entry| entry.0);
    let places = places(names, area.dim_in_pixel().0 as i32);
    for ((name, mark, ink), [x, y]) in entries.iter().zip(&places) {
        swatch(area, mark, *ink, [*x, y + 6 * UNIT])?;
        words(area, name, Face::Label, [x + SWATCH + 5 * UNIT, *y], Anchor::Start)?;
    }
    Ok(places.last().map_or(0, |[_, y]| y + LINE + 4 * UNIT))
}

/// Where each entry begins: side by side as long as there is room, then on the next line.
pub(super) fn places<'n>(names: impl Iterator<Item = &'n str>, width: i32) -> Vec<[i32; 2]> {
    let (mut x, mut y) = (0, 0);
    let mut place = |name: &str| {
        let wide = SWATCH + 5 * UNIT + Face::Label.width(name);
        if x > 0 && x + wide > width {
            (x, y) = (0, y + LINE);
        }
        let found = [x, y];
        x += wide + GAP;
        found
    };
    names.map(&mut place).collect()
}

fn swatch(area: &Area, mark: &Mark, ink: Ink, [x, y]: [i32; 2]) -> Result<(), CodecError> {
    match mark {
        Mark::Points(_) | Mark::Valued(_) => {
            area.draw(&Circle::new((x + SWATCH / 2, y), 3 * UNIT, ink.area(0.85))).map_err(failed)
        }
        Mark::Band(_) | Mark::Columns { .. } | Mark::Cells { .. } | Mark::Bars(_) => {
            let opacity = if matches!(mark, Mark::Band(_)) { 0.25 } else { 0.55 };
            let corners = [(x, y - 5 * UNIT), (x + SWATCH, y + 5 * UNIT)];
            area.draw(&Rectangle::new(corners, ink.area(opacity))).map_err(failed)
        }
        Mark::Intervals(_) => {
            let middle = x + SWATCH / 2;
            stroke(area, vec![(middle, y - 6 * UNIT), (middle, y + 6 * UNIT)], ink.line(14))
        }
        Mark::AtX(_) | Mark::AtY(_) | Mark::Diagonal | Mark::Words(_) => {
            stroke(area, vec![(x, y), (x + SWATCH, y)], ink.line(12))
        }
        Mark::Line(_) => stroke(area, vec![(x, y), (x + SWATCH, y)], ink.line(18)),
    }
}
