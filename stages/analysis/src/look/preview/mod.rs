//! Small pictures of artefacts for logs and reports: relief, depth, differences, rockfalls, cameras.
//!
//! A preview costs milliseconds whatever the size of the artefact: grids are thinned and meshes sampled before they are
//! drawn. It shows what [`crate::figure::picture`] would, with colour bar, scale bar, the direction that is up, and grey where
//! there is no value.

mod cameras;
mod relief;
mod rockfalls;
mod shrink;

use std::borrow::Cow;

use rockface_core::artefact::{Artefact, Frame, Preview};

use crate::figure::canvas::Canvas;
use crate::figure::picture;
use crate::figure::picture::SMALL;
use crate::figure::picture::look::Look;
use rockface_raster::shape::Shape;

/// Width of a preview at most, pixels.
pub const WIDTH_PX: usize = 512;
/// Values kept for a pixel along each side; they are averaged when the picture is drawn.
const SAMPLES: usize = 2;

/// A small picture of an artefact; `None` where there is nothing to be seen.
pub fn of(artefact: &Artefact, beside: &[&Artefact]) -> Option<Preview> {
    match artefact {
        Artefact::Mesh(_) | Artefact::Surface(_) | Artefact::Cloud(_) => {
            let shape = Shape::of(artefact)?;
            looked_at(&relief::look(shape, artefact.kind().word())?, Some(up(shape.frame())))
        }
        Artefact::Meshes(meshes) => {
            let all = relief::together(meshes);
            let mut look = relief::look(Shape::Mesh(&all), "meshes")?;
            look.title = format!("{} meshes in the {} frame", meshes.parts.len(), meshes.frame);
            looked_at(&look, Some(up(meshes.frame)))
        }
        Artefact::Raster(raster) => looked_at(&thinned(Look::of_raster(raster, None).ok()?), Some(up(raster.frame))),
        Artefact::Depth(depth) => looked_at(&thinned(Look::of_depth(depth, None).ok()?), None),
        Artefact::Inventory(inventory) => rockfalls::draw(inventory, beside),
        Artefact::Cameras(cameras) => cameras::draw(cameras),
        Artefact::Picture(picture) => shrink::png(&picture.png),
        _ => None,
    }
}

/// What is up in a picture with Y upwards.
fn up(frame: Frame) -> &'static str {
    if frame == Frame::Wall { "up the face" } else { "Y" }
}

fn looked_at(look: &Look, up: Option<&'static str>) -> Option<Preview> {
    let scale = look.scale(None, None)?;
    let mut subject = look.subject(scale, String::new(), true);
    subject.up = up;
    let canvas = picture::paint(&subject, WIDTH_PX, &SMALL).ok()?;
    Some(framed(look.title.clone(), canvas))
}

fn framed(caption: String, canvas: Canvas) -> Preview {
    let (width, height, rgb) = canvas.into_rgb();
    Preview { caption, width, height, rgb }
}

/// Every so many rows and columns of a large grid.
fn thinned(look: Look) -> Look {
    let (columns, rows) = (look.columns, look.values.len() / look.columns.max(1));
    let step = columns.max(rows) / (SAMPLES * SMALL.room(WIDTH_PX)).max(1);
    if step < 2 {
        return look;
    }
    let kept = |count: usize| (step / 2..count).step_by(step);
    let values: Vec<f32> = kept(rows)
        .flat_map(|row| kept(columns).map(move |column| (row, column)))
        .map(|(r, c)| look.values[r * columns + c])
        .collect();
    Look {
        columns: kept(columns).count(),
        values: Cow::Owned(values),
        cell_m: look.cell_m.map(|cell_m| cell_m * step as f64),
        ..look
    }
}

#[cfg(test)]
mod tests;
