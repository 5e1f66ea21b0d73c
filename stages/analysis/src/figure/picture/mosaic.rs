//! Grids of one size side by side: one set of colours, one colour bar, and above each its name.

use super::{Align, CodecError, FAINT, INK, Layout, Pen, Subject, cells_per_pixel, fitted, paint, pixels_of};

/// Gap between neighbours, as a share of the width of one.
const GAP: f64 = 0.03;
/// Height of the strip above each grid that its name is written in, heights of text.
const STRIP: f64 = 1.6;
const PAPER: [u8; 3] = [255; 3];

/// Grids laid out on a larger one, NaN between them.
#[derive(Debug, Clone)]
pub struct Mosaic {
    /// Columns of the whole.
    pub columns: usize,
    /// Cells of the whole by row.
    pub values: Vec<f32>,
    /// Columns and rows of one grid.
    size: [usize; 2],
    /// First column and row of each grid, in the order of the lists.
    places: Vec<[usize; 2]>,
    cells_per_pixel: f64,
    layout: Layout,
}

impl Mosaic {
    /// Lays out lists of grids of `size` columns and rows, `across` in a line and every list in lines of its own, for a picture
    /// of at most `max_width_px`.
    pub fn new(size: [usize; 2], lists: &[Vec<&[f32]>], across: usize, max_width_px: usize) -> Self {
        let across = across.max(1);
        let lines: usize = lists.iter().map(|list| list.len().div_ceil(across)).sum();
        let gap = ((size[0] as f64 * GAP) as usize).max(1);
        let columns = across * (size[0] + gap) - gap;
        let whole = |strip: usize| [columns, lines * (size[1] + strip)];
        // The strip has a height in pixels, and how many cells that is depends on the size of the whole, as the text does.
        let (mut layout, mut strip) = (fitted(whole(0), max_width_px), 0);
        for _ in 0..4 {
            layout = fitted(whole(strip), max_width_px);
            let cells = cells_per_pixel(whole(strip), layout.room(max_width_px));
            strip = (STRIP * f64::from(layout.text_px) * cells).ceil() as usize;
        }
        let cells_per_pixel = cells_per_pixel(whole(strip), layout.room(max_width_px));
        let mut values = vec![f32::NAN; columns * whole(strip)[1]];
        let (mut places, mut first) = (Vec::new(), 0);
        for list in lists {
            for (k, grid) in list.iter().enumerate() {
                let (left, line) = (k % across * (size[0] + gap), first + k / across);
                let place = [left, line * (size[1] + strip) + strip];
                for (row, cells) in grid.chunks_exact(size[0]).enumerate() {
                    let at = (place[1] + row) * columns + place[0];
                    values[at..at + size[0]].copy_from_slice(cells);
                }
                places.push(place);
            }
            first += list.len().div_ceil(across);
        }
        Self { columns, values, size, places, cells_per_pixel, layout }
    }

    /// Draws it as PNG; `subject` holds its columns and values, `names` one for each grid.
    pub fn draw(&self, subject: &Subject, names: &[String], max_width_px: usize) -> Result<Vec<u8>, CodecError> {
        let layout = &self.layout;
        let mut canvas = paint(subject, max_width_px, layout)?;
        let [left, top] = layout.corner();
        let pixels = |cells: usize| pixels_of(cells, self.cells_per_pixel);
        let (width, height) = (pixels(self.columns), pixels(self.values.len() / self.columns));
        canvas.frame(left, top, width, height, PAPER);
        let boxes: Vec<[usize; 4]> = self.places.iter().map(|place| self.box_of(*place)).collect();
        for y in 0..height {
            for x in 0..width {
                let inside = boxes.iter().any(|[l, t, r, b]| (*l..*r).contains(&x) && (*t..*b).contains(&y));
                if let Some(pixel) = canvas.pixel(left + x, top + y).filter(|_| !inside) {
                    *pixel = PAPER;
                }
            }
        }
        let pen = Pen::plain(layout.text_px, INK)?;
        for ([l, t, r, b], name) in boxes.into_iter().zip(names) {
            canvas.frame(left + l, top + t, r - l, b - t, FAINT);
            let name = pen.fitted(name, (r - l) as f32);
            canvas.text(&pen, (left + l) as f32, (top + t) as f32 - 0.75 * layout.text_px, Align::Left, &name);
        }
        canvas.to_png()
    }

    /// Left, top, right and bottom of a grid, pixels.
    fn box_of(&self, [column, row]: [usize; 2]) -> [usize; 4] {
        let edge = |cells: usize| (cells as f64 / self.cells_per_pixel).round() as usize;
        [edge(column), edge(row), edge(column + self.size[0]), edge(row + self.size[1])]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_list_has_lines_of_its_own_and_every_grid_room_for_its_name() {
        let grid = vec![1.0f32; 400];
        let lists = [vec![grid.as_slice(); 3], vec![grid.as_slice(); 2]];
        let mosaic = Mosaic::new([40, 10], &lists, 2, 600);
        let lefts: Vec<usize> = mosaic.places.iter().map(|place| place[0]).collect();
        assert_eq!((mosaic.columns, lefts), (81, vec![0, 41, 0, 0, 41]));
        let tops: Vec<usize> = mosaic.places.iter().map(|place| place[1]).collect();
        assert!(tops[0] == tops[1] && tops[3] == tops[4] && tops[2] < tops[3] && tops[0] > 0);
        assert!((tops[0] as f64 / mosaic.cells_per_pixel) >= STRIP * f64::from(mosaic.layout.text_px));
        assert_eq!(mosaic.values.iter().filter(|v| !v.is_nan()).count(), 5 * 400);
        assert_eq!(mosaic.values.len() / 81, tops[4] + 10);
        // A picture that is high and narrow has smaller text than a wide one.
        let tall = vec![1.0f32; 4000];
        let high = Mosaic::new([40, 100], &[vec![tall.as_slice(); 2]], 1, 1800);
        assert!(high.layout.text_px < Mosaic::new([40, 10], &lists, 3, 1800).layout.text_px);
    }
}
