//! The face in grey relief with what was found, what was missed and what is false, in colours anyone can tell apart.

use crate::figure::canvas::{Align, Canvas, Colour, Pen};
use crate::figure::colour_scale::NO_DATA;
use crate::figure::picture::draw_scale;
use rockface_core::artefact::{CodecError, Grid, Polygon};

use super::face::{self, View};
use super::{FAINT, INK, MARGIN, TITLE, WIDTH, strokes};

/// Outlines of one outcome.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome<'a> {
    /// What it is called in the legend.
    pub name: String,
    /// The colour of its outlines and marks.
    pub colour: Colour,
    /// Whether outlines are filled.
    pub filled: bool,
    /// What is drawn over each outline, so that outcomes are told apart without their colours, and small ones are found.
    pub mark: Mark,
    /// The outlines in the frame of the face.
    pub outlines: Vec<&'a [Polygon]>,
}

/// A mark over an outline.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mark {
    /// No mark: the outline is enough.
    None,
    /// A cross over the outline.
    Cross,
    /// A ring around the outline.
    Ring,
}

/// A map of outcomes.
#[derive(Debug, Clone, PartialEq)]
pub struct Map<'a> {
    /// The title over the map.
    pub title: String,
    /// A line under the title.
    pub subtitle: String,
    /// Elevation of the face by row from the top, NaN where there is none.
    pub face: &'a [f32],
    /// The grid of the face.
    pub grid: Grid,
    /// The outcomes, from below.
    pub outcomes: Vec<Outcome<'a>>,
}

/// Height of a line of the legend, units.
const LEGEND: usize = 34;
/// Distance from the middle to the end of a mark over a small outline, units.
const MARK: f64 = 11.0;

/// Draws the map as a PNG of this width, at least 600 pixels.
///
/// # Errors
/// A picture that cannot be written.
pub fn draw(map: &Map, width_px: usize) -> Result<Vec<u8>, CodecError> {
    // Text and lines grow with the picture where it is wider than this.
    let unit_px = (width_px as f64 / WIDTH as f64).max(1.0);
    let width = ((width_px as f64 / unit_px).round() as usize).max(600);
    let inside = width - 2 * MARGIN;
    let view = View::of(&map.grid, inside, inside);
    let legend = Legend::of(map, inside)?;
    let top = MARGIN + TITLE + LEGEND * legend.lines + 8;
    let mut canvas = Canvas::in_units(width, top + view.height + face::FOOT + MARGIN, unit_px);
    canvas.text(&Pen::bold(30.0, INK)?, MARGIN as f32, MARGIN as f32 + 10.0, Align::Left, &map.title);
    canvas.text(&Pen::plain(20.0, FAINT)?, MARGIN as f32, MARGIN as f32 + 44.0, Align::Left, &map.subtitle);
    legend.draw(&mut canvas, map);
    let mut sheet = view.relief(map.face, &map.grid, unit_px);
    for outcome in &map.outcomes {
        for polygon in outcome.outlines.iter().copied().flatten() {
            let polygon = face::in_units(polygon, &map.grid, &view);
            if outcome.filled {
                strokes::fill(&mut sheet, &polygon, outcome.colour, 0.55);
            }
            strokes::outline(&mut sheet, &polygon, 2.0, outcome.colour);
        }
    }
    // Over all outlines, so that none hides a mark; one for all parts of an outline, as they are counted.
    for outcome in &map.outcomes {
        for outline in outcome.outlines.iter().filter(|outline| !outline.is_empty()) {
            let parts: Vec<_> = outline.iter().map(|polygon| face::in_units(polygon, &map.grid, &view)).collect();
            draw_mark(&mut sheet, outcome.mark, reach(&parts), outcome.colour);
        }
    }
    canvas.lay(&sheet, [MARGIN, top]);
    canvas.frame(MARGIN, top, view.width, view.height, FAINT);
    let pen = Pen::plain(20.0, INK)?;
    draw_scale(&mut canvas, view.width as f64, view.unit_m, [MARGIN, top + view.height + 24], &pen)?;
    canvas.to_png()
}

/// The middle of the parts of an outline, and how far a mark over them reaches, units.
fn reach(parts: &[Polygon]) -> ([f64; 2], f64) {
    let ends = |axis: usize| {
        let places = parts.iter().flat_map(|polygon| &polygon.exterior).map(|place| place[axis]);
        places.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], at| [low.min(at), high.max(at)])
    };
    let [[left, right], [top, bottom]] = [ends(0), ends(1)];
    let half = 0.5 * (right - left).max(bottom - top);
    ([0.5 * (left + right), 0.5 * (top + bottom)], (half + 4.0).max(MARK))
}

/// Draws a mark with a light rim, which shows on any ground.
fn draw_mark(sheet: &mut Canvas, mark: Mark, ([x, y], reach): ([f64; 2], f64), colour: Colour) {
    let lines: Vec<[[f64; 2]; 2]> = match mark {
        Mark::None => Vec::new(),
        Mark::Cross => [-1.0, 1.0].map(|s| [[x - reach, y - s * reach], [x + reach, y + s * reach]]).to_vec(),
        Mark::Ring => {
            let round = |step: usize| {
                // A sixteenth of a turn at a time, by the half-angle values of a regular polygon of 16 corners.
                let (cosine, sine) = SIXTEENTHS[step % 4];
                let [u, v] = [[cosine, sine], [-sine, cosine], [-cosine, -sine], [sine, -cosine]][step / 4 % 4];
                [x + reach * u, y + reach * v]
            };
            (0..16).map(|step| [round(step), round(step + 1)]).collect()
        }
    };
    for (width, ink) in [(6.0, [255; 3]), (3.0, colour)] {
        lines.iter().for_each(|[from, to]| strokes::line(sheet, *from, *to, width, ink));
    }
}

/// Cosine and sine of the first four sixteenths of a turn.
const SIXTEENTHS: [(f64, f64); 4] = [
    (1.0, 0.0),
    (0.923_879_532_511_286_7, 0.382_683_432_365_089_8),
    (std::f64::consts::FRAC_1_SQRT_2, std::f64::consts::FRAC_1_SQRT_2),
    (0.382_683_432_365_089_8, 0.923_879_532_511_286_7),
];

/// What the colours and marks stand for, in as many lines as it takes.
struct Legend {
    pen: Pen,
    /// By outcome, and last for cells without a value where there are some: its text, and where it begins.
    entries: Vec<(String, [usize; 2])>,
    lines: usize,
}

impl Legend {
    fn of(map: &Map, width: usize) -> Result<Self, CodecError> {
        let pen = Pen::plain(20.0, INK)?;
        let (mut x, mut line, mut entries) = (0, 0, Vec::new());
        let counts = map.outcomes.iter().map(|outcome| format!("{} ({})", outcome.name, outcome.outlines.len()));
        let gaps = map.face.iter().any(|z| z.is_nan()).then(|| "no value".to_owned());
        for text in counts.chain(gaps) {
            let room = 36 + pen.width(&text) as usize;
            if x > 0 && x + room > width {
                (x, line) = (0, line + 1);
            }
            entries.push((text, [MARGIN + x, MARGIN + TITLE + LEGEND * line]));
            x += room + 30;
        }
        Ok(Self { pen, lines: if entries.is_empty() { 0 } else { line + 1 }, entries })
    }

    fn draw(&self, canvas: &mut Canvas, map: &Map) {
        for (outcome, (_, [x, y])) in map.outcomes.iter().zip(&self.entries) {
            let (x, y) = (*x, *y);
            if outcome.filled && outcome.mark != Mark::None {
                canvas.fill(x + 8, y + 5, 10, 10, outcome.colour);
            } else if outcome.filled {
                canvas.fill(x, y, 26, 20, outcome.colour);
            } else {
                canvas.frame(x, y, 26, 20, outcome.colour);
                canvas.frame(x + 1, y + 1, 24, 18, outcome.colour);
            }
            draw_mark(canvas, outcome.mark, ([x as f64 + 13.0, y as f64 + 10.0], MARK), outcome.colour);
        }
        for (index, (text, [x, y])) in self.entries.iter().enumerate() {
            if index == map.outcomes.len() {
                canvas.fill(*x, *y, 26, 20, NO_DATA);
            }
            canvas.text(&self.pen, (x + 36) as f32, *y as f32 + 10.0, Align::Left, text);
        }
    }
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
        let outcome = Outcome {
            name: "found".into(),
            colour: [0, 90, 200],
            filled: true,
            mark: Mark::None,
            outlines: vec![&outline],
        };
        let map = Map { title: "T".into(), subtitle: "s".into(), face: &face, grid, outcomes: vec![outcome.clone()] };
        let with = draw(&map, 600).unwrap();
        let without = draw(&Map { outcomes: Vec::new(), ..map.clone() }, 600).unwrap();
        assert!(with.starts_with(b"\x89PNG") && with != without);
        let marked = |mark: Mark| {
            draw(&Map { outcomes: vec![Outcome { mark, ..outcome.clone() }], ..map.clone() }, 600).unwrap()
        };
        let marks = [Mark::None, Mark::Cross, Mark::Ring].map(marked);
        assert!(marks[0] == with && marks[1] != with && marks[2] != with && marks[1] != marks[2]);
        let gaps: Vec<f32> = (0..2400).map(|cell| if cell < 60 { f32::NAN } else { 1.0 }).collect();
        let holed = Map { face: &gaps, ..map.clone() };
        let legend = |map: &Map| Legend::of(map, 480).unwrap().entries.last().unwrap().0.clone();
        assert!(legend(&map) == "found (1)" && legend(&holed) == "no value");
    }

    #[test]
    fn a_mark_spans_all_parts_of_an_outline() {
        let square = |at: f64| {
            let exterior = vec![[at, 0.0], [at + 10.0, 0.0], [at + 10.0, 10.0], [at, 10.0]];
            Polygon { exterior, holes: Vec::new() }
        };
        assert_eq!(reach(&[square(0.0), square(40.0)]), ([25.0, 5.0], 29.0));
    }
}
