//! The bar beside a chart that says which colour stands for which value.

use super::theme::{Anchor, Face, Ink, UNIT, stroke, words};
use super::{Area, Inset};
use crate::figure::canvas::Canvas;
use crate::figure::colour_scale::{ColourScale, Palette, labels};
use rockface_core::artefact::CodecError;

/// Colours of values and what the values are.
#[derive(Debug, Clone, PartialEq)]
pub struct ColourKey {
    /// The palette and the values at its ends.
    pub scale: ColourScale,
    /// What they show, with its unit.
    pub label: String,
}

/// Width of the bar and the gap on its left, pixels.
const BAR: i32 = 12;
const GAP: i32 = 14;
/// Colours the bar is made of.
const STEPS: usize = 128;

impl ColourKey {
    /// A perceptually uniform key over what `values` reach.
    pub fn over(label: impl Into<String>, values: impl IntoIterator<Item = f64>) -> Self {
        let grow = |[low, high]: [f64; 2], value: f64| [value.min(low), value.max(high)];
        let finite = values.into_iter().filter(|value| value.is_finite());
        let [low, high] = finite.fold([f64::INFINITY, f64::NEG_INFINITY], grow);
        let (low, high) = match (low, high) {
            (low, high) if low < high => (low, high),
            (low, _) if low.is_finite() => (low - 0.5, low + 0.5),
            _ => (0.0, 1.0),
        };
        Self { scale: ColourScale { palette: Palette::Viridis, low, high }, label: label.into() }
    }

    /// Replaces the palette; the range of values stays.
    #[must_use]
    pub fn palette(mut self, palette: Palette) -> Self {
        self.scale.palette = palette;
        self
    }

    fn ticks(&self) -> Vec<(f64, String)> {
        let ticks = self.scale.ticks(4.0);
        let labels = labels(&ticks, 1.0);
        ticks.into_iter().zip(labels).collect()
    }

    /// Room for bar and numbers, drawing units.
    pub(super) fn width(&self) -> i32 {
        let numbers = self.ticks().iter().map(|(_, label)| Face::Tick.width(label)).max().unwrap_or(0);
        (GAP + BAR + 8) * UNIT + numbers
    }
}

/// Draws the bar right of a chart that ends at `right` and reaches from `top` to `bottom` in units of the whole drawing.
pub(super) fn draw(
    area: &Area,
    key: &ColourKey,
    [right, top, bottom]: [i32; 3],
    insets: &mut Vec<Inset>,
) -> Result<(), CodecError> {
    let ColourScale { low, high, .. } = key.scale;
    let mut canvas = Canvas::new(1, STEPS);
    for step in 0..STEPS {
        let value = high - (high - low) * (step as f64 + 0.5) / STEPS as f64;
        canvas.fill(0, step, 1, 1, key.scale.colour(value));
    }
    let left = right + GAP * UNIT;
    insets.push(Inset { place: [left, top, BAR * UNIT, bottom - top], png: canvas.to_png()? });
    let (x0, y0) = area.get_base_pixel();
    let edge = left - x0 + BAR * UNIT;
    for (value, label) in key.ticks() {
        let y = bottom - y0 - ((value - low) / (high - low) * f64::from(bottom - top)).round() as i32;
        stroke(area, vec![(edge, y), (edge + 3 * UNIT, y)], Ink::Faint.line(10))?;
        words(area, &label, Face::Tick, [edge + 6 * UNIT, y - 55], Anchor::Start)?;
    }
    let end = area.dim_in_pixel().0 as i32;
    words(area, &key.label, Face::Label, [end, top - y0 - 22 * UNIT], Anchor::End)
}
