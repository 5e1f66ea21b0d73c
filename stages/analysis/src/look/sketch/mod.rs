//! Sketches of artefacts: what they show is taken from them as it is, never averaged, so that noise keeps its strength.
//!
//! Every sketch has a budget; what lies beyond it is left out by a fixed rule, and the sketch says which.

mod bodies;
mod cloud;
mod picture;

pub use bodies::{of_mesh, of_meshes};
pub use cloud::{of_cloud, of_depth_points, of_surface};
pub use picture::{of_depth_channels, of_picture, of_raster, of_raster_pictures};

use rockface_core::artefact::sketch::{PictureSketch, Shape, Sketch};
use rockface_core::artefact::{Artefact, Cameras, Depth, Image, Kind, Table};

/// Rows of a table that are shown.
const ROWS: usize = 1000;
/// Bytes of JSON that are shown.
const VALUES_BYTES: usize = 64 * 1024;

/// All sketches of an artefact, for logs and reports; none of what has no look.
pub fn of(artefact: &Artefact) -> Vec<Sketch> {
    let mut sketches = match artefact {
        Artefact::Cloud(cloud) => vec![of_cloud(cloud)],
        Artefact::Mesh(mesh) => vec![of_mesh(mesh)],
        Artefact::Meshes(meshes) => vec![of_meshes(meshes)],
        Artefact::Surface(surface) => vec![of_surface(surface)],
        Artefact::Raster(raster) => std::iter::once(of_raster(raster)).chain(of_raster_pictures(raster)).collect(),
        Artefact::Depth(depth) => of_depth(depth),
        Artefact::Cameras(cameras) => vec![of_cameras("", cameras.clone())],
        Artefact::Table(table) => vec![of_table(table)],
        Artefact::Inventory(inventory) => vec![of_table(&inventory.table())],
        Artefact::Transform(transform) => vec![Sketch::whole("", Shape::Transform(transform.clone()))],
        Artefact::Picture(picture) => of_picture(picture).into_iter().collect(),
        Artefact::Covariance(covariance) => of_values(covariance).into_iter().collect(),
        Artefact::Pairs(pairs) => of_values(pairs).into_iter().collect(),
        Artefact::Acceptance(acceptance) => of_values(acceptance).into_iter().collect(),
        Artefact::Candidates(candidates) => of_values(candidates).into_iter().collect(),
        Artefact::Figure(_) | Artefact::File(_) | Artefact::Files(_) | Artefact::Noise(_) => Vec::new(),
    };
    sketches.extend(of_look(artefact));
    sketches
}

/// Channels in false colours, the camera, and the points of a depth map.
fn of_depth(depth: &Depth) -> Vec<Sketch> {
    let image = Image { sensor: 0, ..depth.image.clone() };
    let cameras = Cameras { frame: depth.frame, sensors: vec![depth.sensor.clone()], images: vec![image] };
    let mut sketches = of_depth_channels(depth);
    sketches.push(of_cameras("camera", cameras));
    sketches.push(of_depth_points(depth));
    sketches
}

/// The look of what has no pixels of its own: shapes, cameras, rockfalls.
pub fn of_look(artefact: &Artefact) -> Option<Sketch> {
    let kinds = [Kind::Cloud, Kind::Mesh, Kind::Meshes, Kind::Surface, Kind::Cameras, Kind::Inventory];
    let preview = kinds.contains(&artefact.kind()).then(|| crate::look::preview::of(artefact, &[])).flatten()?;
    let (width, height) = (preview.width as u32, preview.height as u32);
    let png = preview.to_png().ok()?;
    Some(Sketch::whole("look", Shape::Picture(PictureSketch { width, height, colours: None, image: None, png })))
}

/// Orientations; says which lenses the usual model of five coefficients cannot hold, and which therefore are logged without distortion.
pub fn of_cameras(part: &str, cameras: Cameras) -> Sketch {
    let beyond = |sensor: &&rockface_core::artefact::Sensor| sensor.k[3] != 0.0;
    let names: Vec<&str> = cameras.sensors.iter().filter(beyond).map(|sensor| sensor.name.as_str()).collect();
    let reduced = if names.is_empty() {
        String::new()
    } else {
        format!("the distortion of {}: camera messages have no place for k4", names.join(", "))
    };
    Sketch { part: part.to_owned(), reduced, shape: Shape::Cameras(cameras) }
}

/// The first rows of a table.
pub fn of_table(table: &Table) -> Sketch {
    let rows = table.rows.iter().take(ROWS).cloned().collect();
    let reduced = left_out("rows", table.rows.len(), ROWS);
    Sketch { part: String::new(), reduced, shape: Shape::Table(Table { columns: table.columns.clone(), rows }) }
}

/// A small value as JSON; nothing of a large one.
pub fn of_values(value: &impl serde::Serialize) -> Option<Sketch> {
    let value = serde_json::to_value(value).ok()?;
    (value.to_string().len() <= VALUES_BYTES).then(|| Sketch::whole("", Shape::Values(value)))
}

/// Says that only the first of many are shown; empty where all are.
fn left_out(what: &str, total: usize, shown: usize) -> String {
    if total > shown { format!("the first {shown} of {total} {what}") } else { String::new() }
}

/// Says that one in `stride` is shown along both directions of a grid; empty where all are.
fn every(stride: usize, what: &str) -> String {
    match stride {
        0 | 1 => String::new(),
        2 => format!("every second {what}"),
        3 => format!("every third {what}"),
        stride => format!("every {stride}th {what}"),
    }
}

/// The smallest stride that leaves at most `limit` of `length`.
fn stride_to(length: usize, limit: usize) -> usize {
    length.div_ceil(limit).max(1)
}
