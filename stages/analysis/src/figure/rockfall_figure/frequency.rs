//! Magnitude and cumulative frequency with the fitted law, and the volumes asked for where they are given.

use crate::figure::canvas::{Canvas, Pen};
use rockface_core::artefact::CodecError;
use rockface_rock::rockfall::power_law;

use super::axes::{Decades, decades};
use super::{ACCENT, FAINT, Figure, Frame, INK, pieces, strokes};

const REQUESTED: [u8; 3] = [70, 120, 180];

/// Draws the panel of magnitude and frequency.
pub fn draw(canvas: &mut Canvas, figure: &Figure, panel: Frame) -> Result<(), CodecError> {
    let mut volumes: Vec<f64> = figure.rockfalls.iter().map(|fall| fall.removed_m3).collect();
    volumes.sort_by(f64::total_cmp);
    let count = volumes.len().max(figure.requested_m3.len()).max(1) as f64;
    let x = decades(volumes.iter().chain(&figure.requested_m3).copied());
    let labels = ["Magnitude and frequency", "volume V, m\u{b3}", "number of pieces \u{2265} V"];
    let axes = Decades::draw(canvas, panel, [x, decades([1.0, count].into_iter())], labels)?;
    let requested = power_law::curve(&figure.requested_m3);
    for pair in requested.windows(2) {
        let place = |(volume, number): (f64, usize)| axes.place(volume, number as f64);
        strokes::line(canvas, place(pair[0]), place(pair[1]), 1.8, REQUESTED);
    }
    for (volume, number) in power_law::curve(&volumes) {
        strokes::dot(canvas, axes.place(volume, number as f64), 3.2, [150, 152, 160]);
    }
    let drawn = [power_law::curve(&volumes), requested].concat();
    let lines = if figure.requested_m3.is_empty() { 2 } else { 3 };
    let corner = axes.corner(lines, drawn.iter().map(|(volume, number)| axes.place(*volume, *number as f64)));
    let plain = |colour| Pen::plain(18.0, colour);
    if let (Some(law), Some(last)) = (figure.law, volumes.last()) {
        let end = axes.place(*last, law.number_from(*last).max(1.0));
        let largest = law.minimum * rockface_core::numerics::portable_math::pow(law.count as f64, 1.0 / law.exponent);
        let end = if largest < *last { axes.place(largest, 1.0) } else { end };
        strokes::line(canvas, axes.place(law.minimum, law.count as f64), end, 2.4, ACCENT);
        let text = format!("b = {:.2} \u{b1} {:.2}", law.exponent, law.standard_error);
        axes.note(canvas, &plain(ACCENT)?, corner, 0, &text);
        let text = format!("{} of {}", law.count, pieces(volumes.len()));
        axes.note(canvas, &plain(FAINT)?, corner, 1, &text);
    } else {
        axes.note(canvas, &plain(INK)?, corner, 0, "too few for a law");
    }
    if !figure.requested_m3.is_empty() {
        axes.note(canvas, &plain(REQUESTED)?, corner, 2, &format!("{} asked for", figure.requested_m3.len()));
    }
    Ok(())
}
