//! A radar: one spoke a quantity, one outline a thing that is compared.

use plotters::element::Polygon;

use super::theme::{Anchor, Face, Ink, UNIT, stroke, words};
use super::{Area, Layer, Mark, failed, legend};
use crate::figure::colour_scale::{ColourScale, Palette, labels};
use rockface_core::artefact::CodecError;
use rockface_core::numerics::portable_math;

/// Values of several quantities for each thing that is compared, as outlines over spokes.
#[derive(Debug, Clone, PartialEq)]
pub struct Radar {
    /// Names of the spokes, at least three, the first upwards and the others clockwise.
    pub spokes: Vec<String>,
    /// Value in the centre and at the ends of the spokes.
    pub range: [f64; 2],
    /// Name, colour and values of each outline, one value a spoke; values beyond the range are drawn at its ends, NaN in
    /// the centre.
    pub outlines: Vec<(String, Ink, Vec<f64>)>,
    /// Name, colour, opacity and ends of each band under the outlines, one pair of ends a spoke.
    pub bands: Vec<(String, Ink, f64, Vec<[f64; 2]>)>,
}

struct Wheel {
    centre: [f64; 2],
    radius: f64,
    count: usize,
}

impl Wheel {
    /// Where a share of a spoke lies.
    fn place(&self, spoke: usize, share: f64) -> (i32, i32) {
        let (sine, cosine) = portable_math::sincos(std::f64::consts::TAU * spoke as f64 / self.count as f64);
        let reach = share * self.radius;
        ((self.centre[0] + reach * sine).round() as i32, (self.centre[1] - reach * cosine).round() as i32)
    }

    fn ring(&self, share: f64) -> Vec<(i32, i32)> {
        (0..=self.count).map(|spoke| self.place(spoke % self.count, share)).collect()
    }
}

pub(super) fn draw(area: &Area, radar: &Radar) -> Result<(), CodecError> {
    let [low, high] = radar.range;
    let count = radar.spokes.len();
    let uneven = radar.outlines.iter().find(|outline| outline.2.len() != count);
    let uneven_band = radar.bands.iter().find(|band| band.3.len() != count);
    if count < 3 || uneven.is_some() || uneven_band.is_some() || !low.is_finite() || !high.is_finite() || low >= high {
        let why = "a radar has at least three spokes, one value of each outline on each, and an ascending range";
        return Err(CodecError::new(why));
    }
    let bands = radar.bands.iter().map(|(name, ink, ..)| (Layer::new(name.as_str(), Mark::Band(Vec::new())), *ink));
    let lines = radar.outlines.iter().map(|(name, ink, _)| (Layer::new(name.as_str(), Mark::Line(Vec::new())), *ink));
    let layers: Vec<(Layer, Ink)> = bands.chain(lines).collect();
    let top = legend::draw(area, layers.iter().map(|(layer, ink)| (layer, ink)))?;
    let (width, height) = area.dim_in_pixel();
    let widest = radar.spokes.iter().map(|name| Face::Tick.width(name)).max().unwrap_or(0);
    let radius =
        (f64::from(width) / 2.0 - f64::from(widest) - 80.0).min((f64::from(height) - f64::from(top)) / 2.0 - 240.0);
    let middle = f64::from(top) + (f64::from(height) - f64::from(top)) / 2.0;
    let wheel = Wheel { centre: [f64::from(width) / 2.0, middle], radius: radius.max(200.0), count };
    grid(area, radar, &wheel)?;
    let share = |value: f64| if value.is_nan() { 0.0 } else { ((value - low) / (high - low)).clamp(0.0, 1.0) };
    for (_, ink, opacity, ends) in &radar.bands {
        // One part a sector: a band round the whole wheel would have a hole, which a polygon has not.
        for spoke in 0..count {
            let next = (spoke + 1) % count;
            let corner = |spoke: usize, end: usize| wheel.place(spoke, share(ends[spoke][end]));
            let part = vec![corner(spoke, 0), corner(spoke, 1), corner(next, 1), corner(next, 0)];
            area.draw(&Polygon::new(part, ink.area(*opacity))).map_err(failed)?;
        }
    }
    for (_, ink, values) in &radar.outlines {
        let outline = |spoke: usize| wheel.place(spoke % count, share(values[spoke % count]));
        let places: Vec<(i32, i32)> = (0..=count).map(outline).collect();
        stroke(area, places, ink.line(18))?;
    }
    Ok(())
}

fn grid(area: &Area, radar: &Radar, wheel: &Wheel) -> Result<(), CodecError> {
    let [low, high] = radar.range;
    let ticks = ColourScale { palette: Palette::Viridis, low, high }.ticks(4.0);
    let share = |tick: f64| (tick - low) / (high - low);
    for tick in &ticks {
        stroke(area, wheel.ring(share(*tick)), Ink::Hair.line(10))?;
    }
    for (spoke, name) in radar.spokes.iter().enumerate() {
        stroke(area, vec![wheel.place(spoke, 0.0), wheel.place(spoke, 1.0)], Ink::Hair.line(10))?;
        let (x, y) = wheel.place(spoke, 1.0 + 90.0 / wheel.radius);
        let side = f64::from(x) - wheel.centre[0];
        let anchor = match side {
            side if side > 0.2 * wheel.radius => Anchor::Start,
            side if side < -0.2 * wheel.radius => Anchor::End,
            _ => Anchor::Middle,
        };
        let lift = if f64::from(y) < wheel.centre[1] - 0.8 * wheel.radius { 11 * UNIT } else { 55 };
        words(area, name, Face::Tick, [x, y - lift], anchor)?;
    }
    for (tick, label) in ticks.iter().zip(labels(&ticks, 1.0)) {
        let (x, y) = wheel.place(0, share(*tick));
        words(area, &label, Face::Tick, [x + 3 * UNIT, y - 55], Anchor::Start)?;
    }
    Ok(())
}
