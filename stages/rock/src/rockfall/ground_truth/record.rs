//! The columns of an inventory of removed pieces, and how each is filled.

use nalgebra::{Point3, Vector3};

use rockface_core::StageError;
use rockface_core::artefact::{Cell, Feature, Frame, Inventory, Transform};

use super::bounding_box::oriented_box;
use super::rasters::{Seen, Trace};
use super::{RemovedPiece, outline, sneed_folk, thickness};

/// Names and cells in the order of the columns.
type Row = Vec<(String, Cell)>;

/// The inventory of pieces, one feature each; drawn parameters become columns `p_NAME`, empty where a piece has none.
///
/// # Errors
/// The piece that is no closed body, or whose depth or box cannot be taken.
pub fn inventory(pieces: &[RemovedPiece], seen: &Seen, world: Option<&Transform>) -> Result<Inventory, StageError> {
    let rows = pieces.iter().zip(&seen.pieces).map(|(piece, trace)| {
        row(piece, trace, world).map_err(|e| e.within(format!("piece {} of event {}", piece.id, piece.event)))
    });
    let rows = rows.collect::<Result<Vec<Row>, _>>()?;
    let mut columns: Vec<String> = Vec::new();
    let mut places = std::collections::BTreeMap::new();
    for (name, _) in rows.iter().flatten() {
        if !places.contains_key(name) {
            places.insert(name.clone(), columns.len());
            columns.push(name.clone());
        }
    }
    let feature = |(row, trace): (Row, &Trace)| {
        let mut values = vec![Cell::Empty(()); columns.len()];
        row.into_iter().for_each(|(name, cell)| values[places[&name]] = cell);
        Feature { outline: outline::polygons(&seen.labels.grid, &trace.cells), values }
    };
    let features = rows.into_iter().zip(&seen.pieces).map(feature).collect();
    Ok(Inventory { frame: Frame::Wall, columns, features })
}

/// The way from wall to world that a transform between the two gives.
///
/// # Errors
/// A transform between other frames.
pub fn world_from_wall(transform: &Transform) -> Result<Transform, StageError> {
    match (transform.from.as_str(), transform.to.as_str()) {
        ("world", "wall") => Ok(transform.inverse()),
        ("wall", "world") => Ok(transform.clone()),
        (from, to) => {
            Err(StageError::new(format!("the transform leads from {from} to {to}, not between world and wall")))
        }
    }
}

fn row(piece: &RemovedPiece, trace: &Trace, world: Option<&Transform>) -> Result<Row, StageError> {
    let mut row = Row::new();
    identity(piece, &mut row);
    let body = piece.removed.body().ok_or("its rock has no positive volume; is it closed and outward?")?;
    let block_m3 = piece.block.volume_m3();
    push(&mut row, "removed_m3", body.volume_m3);
    push(&mut row, "block_m3", block_m3);
    push(&mut row, "removed_share", body.volume_m3 / block_m3);
    push(&mut row, "raster_m3", trace.volume_m3);
    let [low, high] = piece.removed.bounds().ok_or("its rock has no vertices")?;
    vector(&mut row, "box_min_", "_m", low.into());
    vector(&mut row, "box_max_", "_m", high.into());
    let axes = body.principal_axes();
    let found = oriented_box(&piece.removed, axes).ok_or("its rock has no vertices")?;
    for (name, side) in ["long_m", "intermediate_m", "short_m"].into_iter().zip(found.sides_m) {
        push(&mut row, name, side);
    }
    vector(&mut row, "long_axis_", "", found.axes[0]);
    vector(&mut row, "short_axis_", "", found.axes[2]);
    vector(&mut row, "major_axis_", "", axes[0]);
    vector(&mut row, "minor_axis_", "", axes[2]);
    shape(found.sides_m, &mut row);
    surfaces(piece, trace, &mut row)?;
    place("centroid", body.centroid, world, &mut row);
    place("position", piece.position.into(), world, &mut row);
    vector(&mut row, "normal_", "", piece.normal.into());
    push(&mut row, "placement_shift_m", piece.shift_m);
    row.extend(piece.parameters.iter().map(|(name, value)| (format!("p_{name}"), Cell::from(*value))));
    Ok(row)
}

fn identity(piece: &RemovedPiece, row: &mut Row) {
    push(row, "id", f64::from(piece.id));
    push(row, "event", f64::from(piece.event));
    push(row, "class", piece.class.as_str());
    push(row, "candidate", piece.candidate as f64);
    push(row, "seed", piece.seed.as_str());
}

fn shape(sides_m: [f64; 3], row: &mut Row) {
    let form = sneed_folk::form(sides_m);
    row.push(("shape_class".to_owned(), form.map_or(Cell::Empty(()), |form| form.class.into())));
    let ratio = |of: fn(&sneed_folk::Form) -> f64| form.as_ref().map_or(f64::NAN, of);
    push(row, "flatness", ratio(|form| form.flatness));
    push(row, "elongation", ratio(|form| form.elongation));
    push(row, "sphericity", ratio(|form| form.sphericity));
}

fn surfaces(piece: &RemovedPiece, trace: &Trace, row: &mut Row) -> Result<(), StageError> {
    let depth = thickness::along(&piece.removed, piece.normal.into())?;
    push(row, "depth_max_m", depth.greatest_m);
    push(row, "depth_mean_m", depth.mean_m);
    push(row, "niche_area_m2", piece.niche.area_m2());
    push(row, "face_area_m2", piece.outer.area_m2());
    push(row, "plan_area_m2", piece.outer.vector_area_m2().z.abs());
    push(row, "cells", trace.cells.len() as f64);
    push(row, "visible_fraction", trace.visible_fraction());
    Ok(())
}

fn push(row: &mut Row, name: &str, cell: impl Into<Cell>) {
    row.push((name.to_owned(), cell.into()));
}

fn vector(row: &mut Row, before: &str, after: &str, vector: Vector3<f64>) {
    for (name, value) in ["x", "y", "z"].into_iter().zip(vector.iter()) {
        row.push((format!("{before}{name}{after}"), Cell::from(*value)));
    }
}

/// A point in wall and world coordinates; empty cells without a transform.
fn place(name: &str, wall: Vector3<f64>, world: Option<&Transform>, row: &mut Row) {
    vector(row, &format!("{name}_"), "_m", wall);
    let moved = world.map_or(Vector3::repeat(f64::NAN), |transform| transform.apply(&Point3::from(wall)).coords);
    vector(row, &format!("{name}_world_"), "_m", moved);
}
