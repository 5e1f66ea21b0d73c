//! Volume of each block against the rock it removed.

use crate::figure::canvas::{Canvas, Pen};
use crate::figure::colour_scale::ColourScale;
use rockface_core::artefact::CodecError;
use rockface_core::numerics::portable_math;

use super::axes::{Corner, Decades, decades};
use super::{FAINT, Figure, Frame, strokes};

/// Draws the panel; the dashed line is a block removed whole.
pub fn draw(canvas: &mut Canvas, figure: &Figure, scale: &ColourScale, panel: Frame) -> Result<(), CodecError> {
    let pairs: Vec<(f64, f64)> =
        figure.rockfalls.iter().filter_map(|fall| Some((fall.block_m3?, fall.removed_m3))).collect();
    let range = decades(pairs.iter().flat_map(|(block, removed)| [*block, *removed]));
    let labels = ["Block and rock removed", "volume of the block, m\u{b3}", "volume removed, m\u{b3}"];
    let axes = Decades::draw(canvas, panel, [range, range], labels)?;
    let ends = range.map(|power| portable_math::pow(10.0, f64::from(power)));
    strokes::dashes(canvas, axes.place(ends[0], ends[0]), axes.place(ends[1], ends[1]), 1.4, FAINT);
    for (block, removed) in pairs.iter().filter(|(block, _)| *block > 0.0) {
        strokes::dot(canvas, axes.place(*block, *removed), 4.0, scale.colour(portable_math::log10(*removed)));
    }
    if pairs.is_empty() {
        axes.note(canvas, &Pen::plain(18.0, FAINT)?, Corner::UpperRight, 0, "no blocks are known");
    }
    Ok(())
}
