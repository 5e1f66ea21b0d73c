//! The face in grey relief with what was found, what was missed and what is false, in colours anyone can tell apart.

use crate::figure::canvas::{Align, Canvas, Colour, Pen};
use crate::figure::picture::draw_scale;
use rockface_core::artefact::{CodecError, Grid, Polygon};

use super::face::{self, View};
use super::{FAINT, INK, MARGIN, TITLE, strokes};

/// Outlines of one outcome.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome<'a> {
    /// What it is called in the legend.
    pub name: String,
    /// Its colour.
    pub colour: Colour,
    /// Whether outlines are filled.
    pub filled: bool,
    /// The outlines in the frame of the face.
    pub outlines: Vec<&'a [Polygon]>,
}

/// A map of outcomes.
#[derive(Debug, Clone, PartialEq)]
pub struct Map<'a> {
    /// Over the map.
    pub title: String,
    /// Under the title.
    pub subtitle: String,
    /// Elevation of the face by row from the top, NaN where there is none.
    pub face: &'a [f32],
    /// The grid of the face.
    pub grid: Grid,
    /// The outcomes, from below.
    pub outcomes: Vec<Outcome<'a>>,
}

/// Height of the legend, pixels.
const LEGEND: usize = 46;

/// Draws the map as a PNG of this width, at least 600 pixels.
///
/// # Errors
/// A picture that cannot be written.
pub fn draw(map: &Map, width_px: usize) -> Result<Vec<u8>, CodecError> {
    let width = width_px.max(600);
    let inside = width - 2 * MARGIN;
    let view = View::of(&map.grid, inside, inside);
    let top = MARGIN + TITLE + LEGEND;
    let mut canvas = Canvas::new(width, top + view.height + face::FOOT + MARGIN);
    canvas.text(&Pen::bold(28.0, INK)?, MARGIN as f32, MARGIN as f32 + 10.0, Align::Left, &map.title);
    canvas.text(&Pen::plain(18.0, FAINT)?, MARGIN as f32, MARGIN as f32 + 44.0, Align::Left, &map.subtitle);
    legend(&mut canvas, map)?;
    let mut sheet = Canvas::new(view.width, view.height);
    for (place, shade) in face::shades(map.face, &map.grid, &view).iter().enumerate() {
        if let Some(pixel) = sheet.pixel(place % view.width, place / view.width) {
            *pixel = *shade;
        }
    }
    for outcome in &map.outcomes {
        for polygon in outcome.outlines.iter().copied().flatten() {
            let polygon = face::in_pixels(polygon, &map.grid, &view);
            if outcome.filled {
                strokes::fill(&mut sheet, &polygon, outcome.colour, 0.55);
            }
            strokes::outline(&mut sheet, &polygon, 2.0, outcome.colour);
        }
    }
    for place in 0..view.width * view.height {
        let (x, y) = (place % view.width, place / view.width);
        if let Some((to, from)) = canvas.pixel(MARGIN + x, top + y).zip(sheet.pixel(x, y)) {
            *to = *from;
        }
    }
    canvas.frame(MARGIN, top, view.width, view.height, FAINT);
    let pen = Pen::plain(16.0, INK)?;
    draw_scale(&mut canvas, view.width as f64, view.pixel_m, [MARGIN, top + view.height + 24], &pen)?;
    canvas.to_png()
}

fn legend(canvas: &mut Canvas, map: &Map) -> Result<(), CodecError> {
    let pen = Pen::plain(17.0, INK)?;
    let (mut x, y) = (MARGIN, MARGIN + TITLE + 4);
    for outcome in &map.outcomes {
        let text = format!("{} ({})", outcome.name, outcome.outlines.len());
        if outcome.filled {
            canvas.fill(x, y, 22, 16, outcome.colour);
        } else {
            canvas.frame(x, y, 22, 16, outcome.colour);
            canvas.frame(x + 1, y + 1, 20, 14, outcome.colour);
        }
        canvas.text(&pen, (x + 30) as f32, y as f32 + 8.0, Align::Left, &text);
        x += 30 + pen.width(&text) as usize + 34;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outcomes_show_in_their_colours() {
        let grid = Grid { columns: 60, rows: 40, cell_m: 0.1, left_m: 0.0, top_m: 4.0 };
        let face = vec![1.0; 2400];
        let exterior = vec![[2.0, 1.0], [4.0, 1.0], [4.0, 3.0], [2.0, 3.0]];
        let outline = [Polygon { exterior, holes: Vec::new() }];
        let outcome = Outcome { name: "found".into(), colour: [0, 90, 200], filled: true, outlines: vec![&outline] };
        let map = Map { title: "T".into(), subtitle: "s".into(), face: &face, grid, outcomes: vec![outcome] };
        let with = draw(&map, 600).unwrap();
        let without = draw(&Map { outcomes: Vec::new(), ..map }, 600).unwrap();
        assert!(with.starts_with(b"\x89PNG") && with != without);
    }
}
