//! The triangle of shapes of Sneed and Folk: compact at the top, platy to the left, elongate to the right.

use plotters::element::Circle;

use super::colour_key::{self, ColourKey};
use super::theme::{Anchor, Face, Ink, UNIT, stroke, words};
use super::{Area, Inset, failed};
use crate::figure::shape_triangle::{HEIGHT, ShapeTriangle};
use rockface_core::artefact::CodecError;
use rockface_rock::rockfall::ground_truth::sneed_folk::{ELONGATION_LIMITS, FLATNESS_LIMITS, form};

/// Shapes in the triangle of Sneed and Folk (1958).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Ternary {
    /// The three axes of each body in any order, metres; one that has no form is left out.
    pub sides_m: Vec<[f64; 3]>,
    /// The ink of all, where they have no values.
    pub ink: Option<Ink>,
    /// A value of each body and the colours of these values.
    pub values: Option<(Vec<f64>, ColourKey)>,
}

fn pixel([x, y]: [f64; 2]) -> (i32, i32) {
    (x.round() as i32, y.round() as i32)
}

pub(super) fn draw(area: &Area, ternary: &Ternary, insets: &mut Vec<Inset>) -> Result<(), CodecError> {
    let key = ternary.values.as_ref().map(|(_, key)| key);
    let (full, height) = area.dim_in_pixel();
    let width = f64::from(full) - f64::from(key.map_or(0, ColourKey::width));
    let head = 24.0 * f64::from(UNIT);
    let side = ((f64::from(height) - 2.8 * head) / HEIGHT).min(width - 40.0 * f64::from(UNIT));
    let left = 0.5 * (width - side);
    let triangle = ShapeTriangle { left: [left, head + side * HEIGHT], side };
    grid(area, &triangle)?;
    if let Some(key) = key {
        let (x0, y0) = area.get_base_pixel();
        let (top, bottom) = (y0 + head as i32, y0 + (head + side * HEIGHT) as i32);
        colour_key::draw(area, key, [x0 + width as i32 - 8 * UNIT, top, bottom], insets)?;
    }
    for (body, sides) in ternary.sides_m.iter().enumerate() {
        let Some(form) = form(*sides) else { continue };
        let value = ternary.values.as_ref().and_then(|(values, key)| Some(key.scale.colour(*values.get(body)?)));
        let ink = value.map_or(ternary.ink.unwrap_or(Ink::Series(0)), Ink::Fixed);
        let place = pixel(triangle.place(form.flatness, form.elongation));
        area.draw(&Circle::new(place, 3 * UNIT, ink.area(0.85))).map_err(failed)?;
    }
    Ok(())
}

fn grid(area: &Area, triangle: &ShapeTriangle) -> Result<(), CodecError> {
    for (flatness, ends) in FLATNESS_LIMITS.iter().zip(triangle.flatness_lines()) {
        let ends = ends.map(pixel);
        stroke(area, ends.to_vec(), Ink::Hair.line(10))?;
        let (x, y) = ends[0];
        words(area, &flatness.to_string(), Face::Tick, [x - 5 * UNIT, y - 55], Anchor::End)?;
    }
    for (elongation, ends) in ELONGATION_LIMITS.iter().zip(triangle.elongation_lines()) {
        let ends = ends.map(pixel);
        stroke(area, ends.to_vec(), Ink::Hair.line(10))?;
        let (x, y) = ends[0];
        words(area, &elongation.to_string(), Face::Tick, [x, y + 4 * UNIT], Anchor::Middle)?;
    }
    let corners = triangle.corners().map(pixel);
    stroke(area, [corners[0], corners[1], corners[2], corners[0]].to_vec(), Ink::Faint.line(10))?;
    let [(left, base), (right, _), (top, peak)] = corners;
    words(area, "compact, S/L = 1", Face::Label, [top, peak - 16 * UNIT], Anchor::Middle)?;
    words(area, "platy", Face::Label, [left, base + 18 * UNIT], Anchor::Start)?;
    words(area, "elongate", Face::Label, [right, base + 18 * UNIT], Anchor::End)?;
    words(area, "(L \u{2212} I)/(L \u{2212} S) \u{2192}", Face::Label, [top, base + 18 * UNIT], Anchor::Middle)
}
