//! Cameras from above: where they stand and which way they look.

use crate::figure::canvas::{Align, Canvas, Pen};
use crate::figure::picture::draw_scale;
use crate::figure::rockfall_figure::strokes;
use rockface_core::artefact::{Cameras, Frame, Image, Preview};

use super::{WIDTH_PX, framed};

const HEIGHT_PX: usize = 300;
const MARGIN: f64 = 46.0;
const INK: [u8; 3] = [32, 32, 36];
const FAINT: [u8; 3] = [96, 98, 104];
const CAMERA: [u8; 3] = [0, 114, 178];
/// Up to so many cameras are named.
const NAMES: usize = 8;

/// A plan: X to the right; in the wall frame Z downwards, so that the face is at the top, in the world frame Y upwards.
struct Plan {
    frame: Frame,
    left: f64,
    top: f64,
    pixel_m: f64,
}

impl Plan {
    /// X and the coordinate that goes down in the plan.
    fn flat(frame: Frame, [x, y, z]: [f64; 3]) -> [f64; 2] {
        if frame == Frame::Wall { [x, z] } else { [x, -y] }
    }

    fn around(cameras: &Cameras) -> Option<Self> {
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        let foot = (cameras.frame == Frame::Wall).then_some([f64::NAN, 0.0]);
        for place in cameras.images.iter().map(|image| Self::flat(cameras.frame, image.centre_m)).chain(foot) {
            for axis in 0..2 {
                (low[axis], high[axis]) = (low[axis].min(place[axis]), high[axis].max(place[axis]));
            }
        }
        let room = [WIDTH_PX as f64 - 2.0 * MARGIN, HEIGHT_PX as f64 - 2.0 * MARGIN];
        let fitting = [0, 1].map(|axis| (high[axis] - low[axis]) / room[axis]);
        let pixel_m = fitting[0].max(fitting[1]);
        if !pixel_m.is_finite() {
            return None;
        }
        let pixel_m = if pixel_m > 0.0 { pixel_m } else { 0.01 };
        let spare = [0, 1].map(|axis| 0.5 * (room[axis] - (high[axis] - low[axis]) / pixel_m));
        let start = [0, 1].map(|axis| low[axis] - (MARGIN + spare[axis]) * pixel_m);
        Some(Self { frame: cameras.frame, left: start[0], top: start[1], pixel_m })
    }

    fn place(&self, point: [f64; 3]) -> [f64; 2] {
        let [x, y] = Self::flat(self.frame, point);
        [(x - self.left) / self.pixel_m, (y - self.top) / self.pixel_m]
    }

    fn draw(&self, canvas: &mut Canvas, image: &Image) -> [f64; 2] {
        let place = self.place(image.centre_m);
        let [x, y] = Self::flat(self.frame, image.axis().into());
        let length = (x * x + y * y).sqrt();
        if length > 1e-6 {
            let reach = 26.0 * length;
            strokes::line(canvas, place, [place[0] + reach * x / length, place[1] + reach * y / length], 1.6, CAMERA);
        }
        strokes::dot(canvas, place, 3.6, CAMERA);
        place
    }
}

pub(super) fn draw(cameras: &Cameras) -> Option<Preview> {
    let plan = Plan::around(cameras)?;
    let mut canvas = Canvas::new(WIDTH_PX, HEIGHT_PX);
    let pen = Pen::plain(12.5, INK).ok()?;
    let faint = Pen::plain(12.5, FAINT).ok()?;
    if cameras.frame == Frame::Wall {
        let [_, y] = plan.place([0.0; 3]);
        strokes::line(&mut canvas, [8.0, y], [WIDTH_PX as f64 - 8.0, y], 1.4, FAINT);
        canvas.text(&faint, 10.0, y as f32 - 11.0, Align::Left, "face");
    }
    for image in &cameras.images {
        let [x, y] = plan.draw(&mut canvas, image);
        if cameras.images.len() <= NAMES {
            canvas.text(&pen, x as f32, y as f32 + 14.0, Align::Middle, &image.name);
        }
    }
    draw_scale(&mut canvas, WIDTH_PX as f64, plan.pixel_m, [10, HEIGHT_PX - 16], &pen).ok()?;
    let count = cameras.images.len();
    let caption = format!("{count} {} from above", if count == 1 { "camera" } else { "cameras" });
    Some(framed(caption, canvas))
}
