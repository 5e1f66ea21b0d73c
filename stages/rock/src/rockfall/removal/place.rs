//! Puts a block on the face: turned to its direction, and as deep as suits it best.

use nalgebra::{Matrix3, Vector3};

use super::evaluate::{Direction, Rules, Stand, Trial};
use super::face::{Face, Rect};
use super::frame::{local_normal, turn_to};
use super::measure::{self, Lids};
use super::reason::{Reason, Rejection};
use super::search::{Columns, Limits, NicheArea, Offset};
use crate::rockfall::ground_truth::Facets;
use rockface_core::numerics::portable_math;

/// A block where it is to be taken out.
pub struct Placed {
    /// The block where it is to be taken out, metres in the frame of the face.
    pub block: Facets,
    /// Where its centroid is, metres.
    pub position: [f64; 3],
    /// A rotation whose third column is the direction it was placed along.
    pub frame: Matrix3<f64>,
    /// How far it was pushed beyond the best place, metres.
    pub shift_m: f64,
}

/// Puts a candidate where it is to stand; `read` grows by what of the face was looked at.
pub fn place(face: &Face, trial: &Trial, rules: &Rules, read: &mut Rect) -> Result<Placed, Rejection> {
    let radius = |about: [f64; 3]| {
        let distance = |v: &[f64; 3]| (Vector3::from(*v) - Vector3::from(about)).norm();
        trial.block.vertices.iter().map(distance).fold(0.0, f64::max)
    };
    let (foot, spin_rad, reach) = match trial.stand {
        Stand::Own => {
            let centre = measure::centroid(&trial.block.vertices, &trial.block.triangles);
            (centre, 0.0, radius(centre))
        }
        Stand::At { place, spin_rad } => (place, spin_rad, radius([0.0; 3])),
        Stand::On { xy, spin_rad } => {
            *read = read.with(&[xy[0], xy[1], 0.0]);
            let top = surface_z(face, xy).ok_or(Reason::OffFace)?;
            ([xy[0], xy[1], top], spin_rad, radius([0.0; 3]))
        }
    };
    *read = read.union(&Rect::around(&[foot]).grown(reach));
    let needs_normal = trial.align_to_normal || rules.direction == Direction::LocalNormal;
    let normal = if needs_normal { local_normal(face, foot, reach) } else { Vector3::z() };
    let along = if rules.direction == Direction::Z { Vector3::z() } else { normal };
    let frame = turn_to(&along);
    let placed = |block, position, shift_m| Placed { block, position, frame, shift_m };
    if trial.stand == Stand::Own {
        return Ok(placed(trial.block.clone(), foot, 0.0));
    }
    let axes = if trial.align_to_normal { turn_to(&normal) } else { Matrix3::identity() };
    let turn = frame * spin(spin_rad) * frame.transpose() * axes;
    let block = moved(&trial.block, |v| turn * v);
    if matches!(trial.stand, Stand::At { .. }) {
        let block = moved(&block, |v| v + Vector3::from(foot));
        return Ok(placed(block, foot, 0.0));
    }
    let offset = offset(face, &block, foot, &frame, rules, read).ok_or(Reason::Empty)?;
    let position: Vector3<f64> = Vector3::from(foot) + along * offset.offset_m;
    Ok(placed(moved(&block, |v| v + position), position.into(), offset.shift_m))
}

fn moved(part: &Facets, to: impl Fn(Vector3<f64>) -> Vector3<f64>) -> Facets {
    let vertices = part.vertices.iter().map(|v| to(Vector3::from(*v)).into()).collect();
    Facets { vertices, triangles: part.triangles.clone() }
}

/// A turn about Z.
fn spin(angle_rad: f64) -> Matrix3<f64> {
    let (sin, cos) = portable_math::sincos(angle_rad);
    Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0)
}

/// The outermost place of the face over a point.
pub fn surface_z(face: &Face, [x, y]: [f64; 2]) -> Option<f64> {
    let places = face.query(&Rect { low: [x, y], high: [x, y] }).into_iter();
    let heights = places.filter_map(|t| measure::height_in(face.triangle(t).map(|v| face.vertex(v)), x, y));
    heights.reduce(f64::max)
}

/// The best offset of a block (turned, about its centroid) over the place `foot`.
fn offset(
    face: &Face,
    block: &Facets,
    foot: [f64; 3],
    frame: &Matrix3<f64>,
    rules: &Rules,
    read: &mut Rect,
) -> Option<Offset> {
    let into = frame.transpose();
    let local = moved(block, |v| into * v);
    let reach = block.vertices.iter().map(|v| Vector3::from(*v).norm()).fold(0.0, f64::max);
    let slant = (frame[(0, 2)] * frame[(0, 2)] + frame[(1, 2)] * frame[(1, 2)]).sqrt();
    let rect = Rect::around(&[foot]).grown(reach * (1.0 + 2.0 * slant));
    *read = read.union(&rect);
    let found = face.query(&rect);
    let corner = |v: u32| (into * (Vector3::from(face.vertex(v)) - Vector3::from(foot))).into();
    let places: Vec<[f64; 3]> = found.iter().flat_map(|t| face.triangle(*t).map(corner)).collect();
    let outline = Rect::around(&local.vertices);
    let over = |t: &[u32; 3]| Rect::around(t.iter().map(|v| &places[*v as usize])).overlaps(&outline);
    let triangles: Vec<[u32; 3]> =
        (0..found.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).filter(over).collect();
    let limits = Limits {
        area: rules.niche_area,
        most_volume: rules.most_volume,
        depth_m: rules.least.depth_m,
        most_shift_m: rules.most_shift_m,
    };
    let rock = Lids::new(&places, &triangles);
    let columns = Columns::new(&local, &rock);
    let columns = if rules.niche_area == NicheArea::True { columns.with_surface(&local, &rock) } else { columns };
    columns.best(&limits)
}
