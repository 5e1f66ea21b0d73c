//! The triangle of shapes of Sneed and Folk: compact at the top, platy to the left, elongate to the right.

use crate::figure::canvas::{Align, Canvas, Pen};
use crate::figure::colour_scale::ColourScale;
use crate::figure::shape_triangle::{HEIGHT, ShapeTriangle};
use rockface_core::artefact::CodecError;
use rockface_core::numerics::portable_math;
use rockface_rock::rockfall::ground_truth::sneed_folk;
use rockface_rock::rockfall::ground_truth::sneed_folk::{CLASSES, FLATNESS_LIMITS};

use super::strokes::{self, Place};
use super::{FAINT, Figure, Frame, HAIR, INK, heading};

fn grid(canvas: &mut Canvas, triangle: &ShapeTriangle) {
    for [from, to] in triangle.flatness_lines().into_iter().chain(triangle.elongation_lines()) {
        strokes::line(canvas, from, to, 1.2, HAIR);
    }
    let corners = triangle.corners();
    for (from, to) in corners.iter().zip(corners.iter().cycle().skip(1)) {
        strokes::line(canvas, *from, *to, 1.4, FAINT);
    }
}

/// Draws the panel; dots are coloured by volume.
pub fn draw(canvas: &mut Canvas, figure: &Figure, scale: &ColourScale, panel: Frame) -> Result<(), CodecError> {
    heading(canvas, panel, "Shape (Sneed and Folk)")?;
    let room = (panel.height as f64 - 132.0) / HEIGHT;
    let side = room.min(panel.width as f64 - 40.0);
    let left = panel.left as f64 + 0.5 * (panel.width as f64 - side);
    let triangle = ShapeTriangle { left: [left, (panel.top + panel.height - 56) as f64], side };
    grid(canvas, &triangle);
    names(canvas, &triangle)?;
    for fall in &figure.rockfalls {
        if let Some(form) = fall.sides_m.and_then(sneed_folk::form) {
            let colour = scale.colour(portable_math::log10(fall.removed_m3));
            strokes::dot(canvas, triangle.place(form.flatness, form.elongation), 4.2, colour);
        }
    }
    Ok(())
}

fn names(canvas: &mut Canvas, triangle: &ShapeTriangle) -> Result<(), CodecError> {
    let pen = Pen::plain(18.0, INK)?;
    let mut write = |[x, y]: Place, align, text: &str| canvas.text(&pen, x as f32, y as f32, align, text);
    let [x, y] = triangle.place(1.0, 0.5);
    write([x, y - 16.0], Align::Middle, "compact, S/L = 1");
    let [x, y] = triangle.place(0.0, 0.0);
    write([x - 12.0, y + 22.0], Align::Left, "platy");
    let [x, y] = triangle.place(0.0, 0.5);
    write([x, y + 22.0], Align::Middle, "bladed");
    write([x, y + 46.0], Align::Middle, "(L \u{2212} I)/(L \u{2212} S) \u{2192}");
    let [x, y] = triangle.place(0.0, 1.0);
    write([x + 12.0, y + 22.0], Align::Right, "elongate");
    let faint = Pen::plain(15.0, FAINT)?;
    for (row, flatness) in [0.85, 0.6, 0.4, 0.15].into_iter().enumerate() {
        let columns: &[f64] = if row == 0 { &[0.5] } else { &[0.165, 0.5, 0.835] };
        for (column, elongation) in columns.iter().enumerate() {
            let [x, y] = triangle.place(flatness, *elongation);
            let class = if row == 0 { CLASSES[0] } else { CLASSES[3 * row - 2 + column] };
            canvas.text(&faint, x as f32, y as f32, Align::Middle, class);
        }
    }
    for flatness in FLATNESS_LIMITS {
        let [x, y] = triangle.place(flatness, 0.0);
        canvas.text(&faint, x as f32 - 8.0, y as f32, Align::Right, &flatness.to_string());
    }
    Ok(())
}
