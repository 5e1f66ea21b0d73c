//! A frame with two logarithmic axes: decades, grid lines and labels.

use crate::figure::canvas::{Align, Canvas, Pen};
use crate::figure::colour_scale::decade_label;
use rockface_core::artefact::CodecError;
use rockface_core::numerics::portable_math;

use super::strokes::{self, Place};
use super::{FAINT, Frame, HAIR, INK, heading};

/// Room for labels left of, below and above the axes, units.
const LEFT: usize = 66;
const BELOW: usize = 56;
const ABOVE: usize = 34;

/// Distance of the lines of a note, units, and the share of the width from which notes on the right may stand.
const NOTE_LINE: usize = 24;
const NOTE_FROM: f64 = 0.35;

/// Where the notes of a plot stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Corner {
    /// From the top downwards, flush right.
    UpperRight,
    /// So many lines above the horizontal axis, flush left.
    LowerLeft {
        /// Lines of the notes.
        lines: usize,
    },
}

/// A plot whose axes hold whole decades.
#[derive(Debug, Clone, Copy)]
pub struct Decades {
    frame: Frame,
    x: [i32; 2],
    y: [i32; 2],
}

/// The whole decades around positive values; at least one.
pub fn decades(values: impl Iterator<Item = f64>) -> [i32; 2] {
    let grow = |[low, high]: [f64; 2], value: f64| [low.min(value), high.max(value)];
    let [low, high] = values.filter(|value| *value > 0.0).fold([f64::INFINITY, f64::NEG_INFINITY], grow);
    if low > high {
        return [0, 1];
    }
    let first = (portable_math::log10(low) + 1e-9).floor() as i32;
    [first, ((portable_math::log10(high) - 1e-9).ceil() as i32).max(first + 1)]
}

impl Decades {
    /// Draws heading, grid and labels in a panel; the axes reach over these decades.
    pub fn draw(
        canvas: &mut Canvas,
        panel: Frame,
        [x, y]: [[i32; 2]; 2],
        [title, x_label, y_label]: [&str; 3],
    ) -> Result<Self, CodecError> {
        heading(canvas, panel, title)?;
        let frame = Frame {
            left: panel.left + LEFT,
            top: panel.top + ABOVE + 22,
            width: panel.width - LEFT,
            height: panel.height - ABOVE - 22 - BELOW,
        };
        let axes = Self { frame, x, y };
        axes.grid(canvas)?;
        let pen = Pen::plain(18.0, INK)?;
        let middle = (frame.left + frame.width / 2) as f32;
        canvas.text(&pen, middle, (panel.top + panel.height - 10) as f32, Align::Middle, x_label);
        canvas.text(&pen, panel.left as f32, (panel.top + ABOVE + 4) as f32, Align::Left, y_label);
        canvas.frame(frame.left, frame.top, frame.width, frame.height, FAINT);
        Ok(axes)
    }

    fn grid(&self, canvas: &mut Canvas) -> Result<(), CodecError> {
        let pen = Pen::plain(17.0, INK)?;
        let (left, top) = (self.frame.left as f64, self.frame.top as f64);
        let (right, bottom) = (left + self.frame.width as f64, top + self.frame.height as f64);
        for power in self.x[0]..=self.x[1] {
            let x = self.place(power_of_ten(power), 1.0)[0];
            strokes::line(canvas, [x, top], [x, bottom], 1.0, HAIR);
            if labelled(power, self.x) {
                canvas.text(&pen, x as f32, bottom as f32 + 16.0, Align::Middle, &decade_label(power));
            }
        }
        for power in self.y[0]..=self.y[1] {
            let y = self.place(1.0, power_of_ten(power))[1];
            strokes::line(canvas, [left, y], [right, y], 1.0, HAIR);
            if labelled(power, self.y) {
                canvas.text(&pen, left as f32 - 9.0, y as f32, Align::Right, &decade_label(power));
            }
        }
        Ok(())
    }

    /// Where positive values lie, units.
    pub fn place(&self, x: f64, y: f64) -> Place {
        let share = |value: f64, [first, last]: [i32; 2]| {
            (portable_math::log10(value) - f64::from(first)) / f64::from(last - first)
        };
        let Frame { left, top, width, height } = self.frame;
        [left as f64 + share(x, self.x) * width as f64, top as f64 + (1.0 - share(y, self.y)) * height as f64]
    }

    /// Where notes of so many lines cover none of these places: the upper right corner if it is free, else the lower left one,
    /// which falling curves leave free.
    pub fn corner(&self, lines: usize, places: impl IntoIterator<Item = Place>) -> Corner {
        let left = self.frame.left as f64 + NOTE_FROM * self.frame.width as f64;
        let bottom = (self.frame.top + 14 + NOTE_LINE * lines) as f64;
        if places.into_iter().any(|[x, y]| x > left && y < bottom) {
            Corner::LowerLeft { lines }
        } else {
            Corner::UpperRight
        }
    }

    /// A text in a corner, so many lines down from the first.
    pub fn note(&self, canvas: &mut Canvas, pen: &Pen, corner: Corner, line: usize, text: &str) {
        let Frame { left, top, width, height } = self.frame;
        let (x, first, align) = match corner {
            Corner::UpperRight => (left + width - 12, top + 20, Align::Right),
            Corner::LowerLeft { lines } => {
                (left + 12, (top + height + 4).saturating_sub(NOTE_LINE * lines), Align::Left)
            }
        };
        canvas.text(pen, x as f32, (first + NOTE_LINE * line) as f32, align, text);
    }
}

/// Every decade has a label up to seven of them, then every second or third.
fn labelled(power: i32, [first, last]: [i32; 2]) -> bool {
    (power - first) % ((last - first) / 7 + 1) == 0
}

fn power_of_ten(power: i32) -> f64 {
    portable_math::pow(10.0, f64::from(power))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decades_hold_their_values() {
        assert_eq!(decades([0.003, 0.2, -1.0].into_iter()), [-3, 0]);
        assert_eq!(decades([0.01, 0.01].into_iter()), [-2, -1]);
        assert_eq!(decades(std::iter::empty()), [0, 1]);
    }

    #[test]
    fn values_lie_between_their_decades() {
        let frame = Frame { left: 100, top: 50, width: 300, height: 200 };
        let axes = Decades { frame, x: [-2, 1], y: [0, 2] };
        let [x, y] = axes.place(0.1, 10.0);
        assert!((x - 200.0).abs() < 1e-9 && (y - 150.0).abs() < 1e-9);
    }
}
