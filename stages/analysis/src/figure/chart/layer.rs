//! What is laid over two axes: lines, bands, points, columns, bars, cells, rules.

use super::theme::Ink;

/// A layer of a chart; later ones lie over earlier ones.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// Its name in the legend; without one it is not in it.
    pub name: String,
    /// What it is drawn with; `None` for the next series colour.
    pub ink: Option<Ink>,
    /// What is drawn: a line, points, bars and so on, with its data.
    pub mark: Mark,
}

/// The kinds of layer. What is not finite or beyond the axes is left out; lines end there.
#[derive(Debug, Clone, PartialEq)]
pub enum Mark {
    /// A line through points (x, y).
    Line(Vec<[f64; 2]>),
    /// An area between two lines: (x, low, high).
    Band(Vec<[f64; 3]>),
    /// Separate points (x, y).
    Points(Vec<[f64; 2]>),
    /// Points (x, y) coloured by a third value; the axes need a [`super::ColourKey`].
    Valued(Vec<[f64; 3]>),
    /// Upright intervals: (x, low, high).
    Intervals(Vec<[f64; 3]>),
    /// Columns from zero: edges, one more than heights, and heights.
    Columns {
        /// Edges of the columns, ascending.
        edges: Vec<f64>,
        /// Heights of the columns, from left to right.
        heights: Vec<f64>,
    },
    /// Lying bars from zero, one for each name of the vertical axis; negative ones in another colour.
    Bars(Vec<f64>),
    /// Cells of equal size over a part of the plane, coloured by value; the axes need a [`super::ColourKey`]. On a
    /// logarithmic axis cells are equally wide in the logarithm.
    Cells {
        /// Left and right edge.
        x: [f64; 2],
        /// Lower and upper edge.
        y: [f64; 2],
        /// Cells in a row.
        columns: usize,
        /// Values by row from the top, NaN where there is none.
        values: Vec<f64>,
    },
    /// A dashed upright line.
    AtX(f64),
    /// A dashed level line.
    AtY(f64),
    /// The dashed line where both are equal.
    Diagonal,
    /// Words (x, y, text), beginning to the right of a point.
    Words(Vec<(f64, f64, String)>),
}

impl Layer {
    /// A layer in the ink that is usual for what it draws.
    pub fn new(name: impl Into<String>, mark: Mark) -> Self {
        Self { name: name.into(), ink: None, mark }
    }

    /// A line through points (x, y).
    pub fn line(name: impl Into<String>, points: Vec<[f64; 2]>) -> Self {
        Self::new(name, Mark::Line(points))
    }

    /// An area between two lines: (x, low, high).
    pub fn band(name: impl Into<String>, points: Vec<[f64; 3]>) -> Self {
        Self::new(name, Mark::Band(points))
    }

    /// A layer of separate points (x, y).
    pub fn points(name: impl Into<String>, points: Vec<[f64; 2]>) -> Self {
        Self::new(name, Mark::Points(points))
    }

    /// Draws the layer with this ink instead of a series colour.
    #[must_use]
    pub fn ink(self, ink: Ink) -> Self {
        Self { ink: Some(ink), ..self }
    }

    /// Whether it takes a colour of its own from the series.
    pub(super) fn takes_a_series_colour(&self) -> bool {
        use Mark::{AtX, AtY, Bars, Cells, Diagonal, Valued, Words};
        let others = matches!(self.mark, AtX(_) | AtY(_) | Diagonal | Words(_) | Valued(_) | Cells { .. } | Bars(_));
        self.ink.is_none() && !others
    }

    /// The ends of its values along X and Y; `log` where only positive ones count.
    pub(super) fn extent(&self, log: [bool; 2]) -> [Option<[f64; 2]>; 2] {
        let mut ends = [None, None];
        let mut grow = |axis: usize, value: f64| {
            if value.is_finite() && (!log[axis] || value > 0.0) {
                let [low, high] = ends[axis].unwrap_or([value, value]);
                ends[axis] = Some([value.min(low), value.max(high)]);
            }
        };
        let mut point = |x: f64, y: f64| {
            grow(0, x);
            grow(1, y);
        };
        match &self.mark {
            Mark::Line(points) | Mark::Points(points) => points.iter().for_each(|[x, y]| point(*x, *y)),
            Mark::Valued(points) => points.iter().for_each(|[x, y, _]| point(*x, *y)),
            Mark::Band(points) | Mark::Intervals(points) => {
                points.iter().flat_map(|[x, low, high]| [(x, low), (x, high)]).for_each(|(x, y)| point(*x, *y));
            }
            Mark::Columns { edges, heights } => {
                edges.iter().for_each(|edge| point(*edge, 0.0));
                heights.iter().for_each(|height| grow(1, *height));
            }
            Mark::Bars(lengths) => lengths.iter().chain(&[0.0]).for_each(|length| grow(0, *length)),
            Mark::Cells { x, y, .. } => x.iter().zip(y).for_each(|(x, y)| point(*x, *y)),
            Mark::AtX(x) => grow(0, *x),
            Mark::AtY(y) => grow(1, *y),
            Mark::Words(words) => words.iter().for_each(|(x, y, _)| point(*x, *y)),
            Mark::Diagonal => {}
        }
        ends
    }
}
