//! Two neighbouring rows of the points of an organised surface, coordinate by coordinate, for work on many squares at a time.

use rockface_core::numerics::simd::{Work, vectorised};

/// Points of one row by coordinate, metres from the origin of the surface.
type Row = [Vec<f64>; 3];

/// The rows of points above and below a row of squares.
#[derive(Debug, Default)]
pub struct PointRows {
    above: Row,
    below: Row,
    /// The row of squares that they are for.
    row: Option<usize>,
}

impl PointRows {
    /// Takes the points around a row of squares of a surface whose rows have `width` points.
    pub fn enter(&mut self, points: &[[f32; 3]], width: usize, row: usize) {
        let line = |row: usize| &points[row * width..(row + 1) * width];
        if row > 0 && self.row == Some(row - 1) {
            std::mem::swap(&mut self.above, &mut self.below);
        } else {
            read(&mut self.above, line(row));
        }
        read(&mut self.below, line(row + 1));
        self.row = Some(row);
    }

    /// X, Y and Z of the corners a, b, c and d (see [`rockface_core::artefact::Surface`]) of all squares of the row.
    #[inline(always)]
    pub fn corners(&self) -> [[&[f64]; 3]; 4] {
        [left(&self.above), right(&self.above), right(&self.below), left(&self.below)]
    }
}

fn read(row: &mut Row, points: &[[f32; 3]]) {
    row.iter_mut().for_each(|values| values.resize(points.len(), 0.0));
    vectorised(Read { row, points });
}

/// Reads the coordinates of a row of points.
struct Read<'a> {
    row: &'a mut Row,
    points: &'a [[f32; 3]],
}

impl Work for Read<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let count = self.points.len();
        let [x, y, z] = self.row;
        let (x, y, z) = (&mut x[..count], &mut y[..count], &mut z[..count]);
        for i in 0..count {
            let point = self.points[i];
            (x[i], y[i], z[i]) = (f64::from(point[0]), f64::from(point[1]), f64::from(point[2]));
        }
    }
}

#[inline(always)]
fn left([x, y, z]: &Row) -> [&[f64]; 3] {
    [&x[..x.len() - 1], &y[..y.len() - 1], &z[..z.len() - 1]]
}

#[inline(always)]
fn right([x, y, z]: &Row) -> [&[f64]; 3] {
    [&x[1..], &y[1..], &z[1..]]
}
