//! A small drawing surface: pixels, boxes and text, written as PNG.

use ab_glyph::{Font, FontRef, PxScale, ScaleFont, point};

use rockface_core::artefact::CodecError;

/// Red, green and blue, 0 to 255 each.
pub type Colour = [u8; 3];

/// Where a text lies about its place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Align {
    /// It starts there.
    Left,
    /// Its middle lies there.
    Middle,
    /// It ends there.
    Right,
}

/// A typeface at a size.
pub struct Pen {
    font: FontRef<'static>,
    size_px: f32,
    colour: Colour,
}

impl Pen {
    /// The plain typeface at a height of `size_px` pixels from descender to ascender.
    pub fn plain(size_px: f32, colour: Colour) -> Result<Self, CodecError> {
        Self::new(dejavu::sans::regular(), size_px, colour)
    }

    /// The bold typeface at a height of `size_px` pixels from descender to ascender.
    pub fn bold(size_px: f32, colour: Colour) -> Result<Self, CodecError> {
        Self::new(dejavu::sans::bold(), size_px, colour)
    }

    fn new(font: &'static [u8], size_px: f32, colour: Colour) -> Result<Self, CodecError> {
        let font = FontRef::try_from_slice(font).map_err(|e| CodecError::new(format!("typeface: {e}")))?;
        Ok(Self { font, size_px, colour })
    }

    /// Width of a text, pixels.
    pub fn width(&self, text: &str) -> f32 {
        let font = self.font.as_scaled(PxScale::from(self.size_px));
        text.chars().fold(0.0, |sum, c| sum + font.h_advance(font.glyph_id(c)))
    }

    /// A text cut short, with an ellipsis, until it is at most `room_px` pixels wide.
    pub fn fitted(&self, text: &str, room_px: f32) -> String {
        let mut text = text.to_owned();
        while self.width(&text) > room_px && text != ELLIPSIS {
            text = text.trim_end_matches(ELLIPSIS).to_owned();
            text.pop();
            text.push_str(ELLIPSIS);
        }
        text
    }
}

/// What stands for the rest of a text.
const ELLIPSIS: &str = "\u{2026}";

/// Pixels by row from the top, white at first.
///
/// Places and sizes of boxes and texts are in units of one pixel or more, so that a picture can be made finer as it is.
#[derive(Debug, Clone, PartialEq)]
pub struct Canvas {
    width: usize,
    height: usize,
    unit_px: f64,
    pixels: Vec<Colour>,
}

impl Canvas {
    /// A white canvas of so many pixels, which are its units.
    pub fn new(width: usize, height: usize) -> Self {
        Self::in_units(width, height, 1.0)
    }

    /// A white canvas of so many units, each `unit_px` pixels long.
    pub fn in_units(width: usize, height: usize, unit_px: f64) -> Self {
        let [width, height] = [width, height].map(|side| (side as f64 * unit_px).round() as usize);
        Self { width, height, unit_px, pixels: vec![[255; 3]; width * height] }
    }

    /// Pixels of a unit.
    pub fn unit_px(&self) -> f64 {
        self.unit_px
    }

    /// Columns and rows of pixels.
    pub fn size_px(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// The colour of a pixel, where there is one.
    pub fn pixel(&mut self, x: usize, y: usize) -> Option<&mut Colour> {
        if x < self.width && y < self.height { self.pixels.get_mut(y * self.width + x) } else { None }
    }

    /// Fills a box, as far as it is on the canvas.
    pub fn fill(&mut self, x: usize, y: usize, width: usize, height: usize, colour: Colour) {
        let [left, right] = [x, x.saturating_add(width)].map(|at| self.pixels_of(at).min(self.width));
        let [top, bottom] = [y, y.saturating_add(height)].map(|at| self.pixels_of(at).min(self.height));
        for row in top..bottom {
            self.pixels[row * self.width + left..row * self.width + right].fill(colour);
        }
    }

    /// Pixels that so many units take.
    fn pixels_of(&self, units: usize) -> usize {
        (units as f64 * self.unit_px).round() as usize
    }

    /// Draws a line one unit wide around the outside of a box.
    pub fn frame(&mut self, x: usize, y: usize, width: usize, height: usize, colour: Colour) {
        let (left, top) = (x.saturating_sub(1), y.saturating_sub(1));
        self.fill(left, top, width.saturating_add(2), 1, colour);
        self.fill(left, y.saturating_add(height), width.saturating_add(2), 1, colour);
        self.fill(left, top, 1, height.saturating_add(2), colour);
        self.fill(x.saturating_add(width), top, 1, height.saturating_add(2), colour);
    }

    /// Lays another canvas over this one, pixel by pixel, its upper left corner at a place [x, y].
    pub fn lay(&mut self, other: &Self, corner: [usize; 2]) {
        let [left, top] = corner.map(|at| self.pixels_of(at));
        for (place, colour) in other.pixels.iter().enumerate() {
            if let Some(pixel) = self.pixel(left + place % other.width, top + place / other.width) {
                *pixel = *colour;
            }
        }
    }

    /// Writes a text about `x`, the middle of its lower-case letters at `y`.
    pub fn text(&mut self, pen: &Pen, x: f32, y: f32, align: Align, text: &str) {
        let share = match align {
            Align::Left => 0.0,
            Align::Middle => 0.5,
            Align::Right => 1.0,
        };
        let unit = self.unit_px as f32;
        let scale = PxScale::from(unit * pen.size_px);
        let font = pen.font.as_scaled(scale);
        let mut pen_x = (unit * (x - share * pen.width(text))).round();
        // Figures and capitals reach about 0.62 of the size above the baseline.
        let baseline = (unit * (y + 0.31 * pen.size_px)).round();
        for letter in text.chars() {
            let id = font.glyph_id(letter);
            if let Some(outline) = pen.font.outline_glyph(id.with_scale_and_position(scale, point(pen_x, baseline))) {
                let bounds = outline.px_bounds();
                outline.draw(|dx, dy, cover| {
                    self.blend(bounds.min.x + dx as f32, bounds.min.y + dy as f32, pen.colour, cover);
                });
            }
            pen_x += font.h_advance(id);
        }
    }

    /// Mixes a colour into the pixel at a place by the share of the pixel it covers, from 0 to 1.
    pub fn blend(&mut self, x: f32, y: f32, colour: Colour, cover: f32) {
        if x < 0.0 || y < 0.0 {
            return;
        }
        if let Some(pixel) = self.pixel(x as usize, y as usize) {
            for (value, ink) in pixel.iter_mut().zip(colour) {
                let mixed = f32::from(*value) + (f32::from(ink) - f32::from(*value)) * cover.clamp(0.0, 1.0);
                *value = mixed.round() as u8;
            }
        }
    }

    /// The canvas as a PNG file.
    pub fn to_png(&self) -> Result<Vec<u8>, CodecError> {
        rockface_core::format::png::write(self.width, self.height, self.pixels.as_flattened())
    }

    /// Columns, rows, and red, green and blue by row from the top.
    pub fn into_rgb(self) -> (usize, usize, Vec<u8>) {
        (self.width, self.height, self.pixels.into_flattened())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_lies_beside_the_canvas_is_not_drawn() {
        let mut canvas = Canvas::new(6, 3);
        let whole = canvas.clone();
        for [x, y] in [[usize::MAX; 2], [0, usize::MAX], [usize::MAX, 0]] {
            canvas.fill(x, y, usize::MAX, 2, [1, 2, 3]);
            canvas.frame(x, y, usize::MAX, usize::MAX, [1, 2, 3]);
            assert_eq!(canvas.pixel(x, y), None);
        }
        canvas.fill(6, 0, 1, 1, [1, 2, 3]);
        assert_eq!(canvas.pixels[..6], whole.pixels[..6]);
        canvas.fill(5, 2, usize::MAX, usize::MAX, [1, 2, 3]);
        assert_eq!(canvas.pixel(5, 2), Some(&mut [1, 2, 3]));
    }

    #[test]
    fn the_file_holds_what_was_drawn() {
        let mut canvas = Canvas::new(60, 30);
        canvas.fill(50, 20, 100, 100, [1, 2, 3]);
        canvas.text(&Pen::plain(16.0, [0; 3]).unwrap(), 5.0, 10.0, Align::Left, "Mm");
        let file = canvas.to_png().unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(file)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        assert_eq!(pixels, canvas.pixels.as_flattened());
        assert_eq!(canvas.pixel(59, 29), Some(&mut [1, 2, 3]));
        let dark = canvas.pixels.iter().filter(|p| p[0] < 64 && p[1] == p[0]).count();
        assert!((20..200).contains(&dark), "{dark} dark pixels of text");
    }

    #[test]
    fn a_finer_canvas_shows_the_same_in_more_pixels() {
        let mut canvas = Canvas::in_units(8, 4, 2.5);
        canvas.fill(2, 1, 2, 2, [1, 2, 3]);
        assert_eq!(canvas.size_px(), [20, 10]);
        let filled = |p: usize| (5..10).contains(&(p % 20)) && (3..8).contains(&(p / 20));
        assert!((0..200).all(|p| (canvas.pixels[p] == [1, 2, 3]) == filled(p)));
        let dark = |unit_px: f64| {
            let mut canvas = Canvas::in_units(40, 20, unit_px);
            canvas.text(&Pen::plain(16.0, [0; 3]).unwrap(), 5.0, 10.0, Align::Left, "Mm");
            canvas.pixels.iter().map(|p| 255.0 - f64::from(p[0])).sum::<f64>()
        };
        let ratio = dark(3.0) / dark(1.0);
        assert!((ratio - 9.0).abs() < 0.5, "{ratio}");
    }

    #[test]
    fn nothing_outside_the_canvas_is_touched() {
        let mut canvas = Canvas::new(8, 8);
        canvas.fill(20, 20, 5, 5, [0; 3]);
        canvas.text(&Pen::bold(16.0, [0; 3]).unwrap(), -9.0, -9.0, Align::Right, "x");
        assert_eq!(canvas, Canvas::new(8, 8));
    }
}
