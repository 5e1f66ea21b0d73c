//! Blocks of rock as closed meshes: base shapes, their size, the modifiers, and candidate number n of a specification.

mod crossing;
mod draw;
pub mod hull;
pub mod joints;
mod modifiers;
pub mod placement;
pub mod remesh;
mod shapes;
mod sizing;
pub mod smoothing;
pub mod solid;
pub mod subdivide;

pub use solid::{Flaw, Solid};

use nalgebra::Vector3;

use draw::Drawing;
use rockface_core::artefact::Candidates;
use rockface_core::artefact::candidates::{Align, Class, Modifier, Shape};
use rockface_core::distribution::{Draws, chosen};
use rockface_core::numerics::random::Key;

/// A point of a mesh: x, y, z, metres.
type V = [f64; 3];

/// The square of the distance of two points, square metres.
fn squared_distance(a: V, b: V) -> f64 {
    (Vector3::from(a) - Vector3::from(b)).norm_squared()
}

/// Moves a solid so that its volume centroid is the origin; its volume, cubic metres.
fn centre(solid: &mut Solid) -> f64 {
    let (volume_m3, centroid) = solid.volume_and_centroid();
    solid.map(|v| (Vector3::from(v) - Vector3::from(centroid)).into());
    volume_m3
}

/// One candidate block: closed, outward, centred at its volume centroid.
#[derive(Debug, Clone, PartialEq)]
pub struct Block {
    /// The class it was drawn from.
    pub class: String,
    /// Vertices in the axes of the wall frame about the block's centroid, metres.
    pub vertices: Vec<[f64; 3]>,
    /// Triangles, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// What its axes are laid along where it is placed.
    pub align: Align,
    /// The numbers that were drawn for it, by name with unit.
    pub parameters: Vec<(String, f64)>,
}

/// Why a candidate gives no block.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BlockError {
    /// The finished mesh is no solid, usually because roughness is large against the edges.
    #[error("the block is no solid: {0}")]
    Flawed(#[from] Flaw),
    /// All points of a hull lie in one plane.
    #[error("the points of the block lie in one plane")]
    Flat,
    /// A shear turned the block inside out.
    #[error("the skew turns the block inside out")]
    Inverted,
    /// The planes of a joint block enclose no finite volume.
    #[error("the planes of the joint sets enclose no block")]
    Unbounded,
    /// A joint block that cannot slide, where only sliding ones are wanted.
    #[error("the block cannot slide")]
    Stable,
    /// The mesh would have too many triangles.
    #[error("edges of {edge_m} m would cut the block into more than a million triangles")]
    TooFine {
        /// The longest edge asked for, metres.
        edge_m: f64,
    },
    /// The specification itself is at fault: no candidate of this class can be made.
    #[error("{0}")]
    Specification(String),
}

impl BlockError {
    /// One word for it, to count rejected candidates by; `None` where it is no matter of chance and the run must stop.
    pub fn reason(&self) -> Option<&'static str> {
        Some(match self {
            Self::Flawed(Flaw::Crossing(..)) => "block_self_intersects",
            Self::Flawed(_) => "block_not_solid",
            Self::Flat => "block_flat",
            Self::Inverted => "block_inverted",
            Self::Unbounded => "joints_enclose_nothing",
            Self::Stable => "kinematically_stable",
            // Joints that nearly meet in a line make blocks of any length.
            Self::TooFine { .. } => "block_too_fine",
            Self::Specification(_) => return None,
        })
    }
}

/// Candidate `number` of a sequence: a pure function of both, whatever else was asked for.
///
/// The class is drawn by the classes' probabilities, then shape, size and modifiers by theirs.
pub fn candidate(candidates: &Candidates, number: u64) -> Result<Block, BlockError> {
    let draws = Draws::new(candidates.key.0, number);
    let at = chosen_class(candidates, &draws)?;
    let class = &candidates.classes[at];
    let mut drawing = Drawing::new(draws, at);
    let mut solid = finished(class, candidates, &mut drawing)?;
    drawing.note("block_volume_m3", centre(&mut solid));
    Ok(Block {
        class: class.label().to_owned(),
        vertices: solid.vertices,
        triangles: solid.triangles,
        align: class.align,
        parameters: drawing.into_noted(),
    })
}

/// What candidate `number` was to be: its class, and its volume in cubic metres before any modifier. For candidates that give no
/// block, so that they are counted with others of their size; `None` where no shape comes about at all.
pub fn requested(candidates: &Candidates, number: u64) -> Option<(String, f64)> {
    let draws = Draws::new(candidates.key.0, number);
    let at = chosen_class(candidates, &draws).ok()?;
    let class = &candidates.classes[at];
    let (solid, target) = sized(class, candidates, &mut Drawing::new(draws, at)).ok()?;
    Some((class.label().to_owned(), target.unwrap_or_else(|| solid.volume_and_centroid().0)))
}

fn chosen_class(candidates: &Candidates, draws: &Draws) -> Result<usize, BlockError> {
    let weights: Vec<f64> = candidates.classes.iter().map(|class| class.probability).collect();
    let nothing = || BlockError::Specification("no class of blocks has a probability above zero".into());
    chosen(&weights, draws.uniform("class")).ok_or_else(nothing)
}

/// A shape of its size about its centroid, and the volume that modifiers have to leave it, where one is asked for.
fn sized(class: &Class, candidates: &Candidates, drawing: &mut Drawing) -> Result<(Solid, Option<f64>), BlockError> {
    let mut solid = shapes::base(&class.shape, candidates, drawing)?;
    centre(&mut solid);
    let target = class.size.as_ref().map(|size| sizing::apply(&mut solid, size, drawing)).transpose()?.flatten();
    Ok((solid, target))
}

fn finished(class: &Class, candidates: &Candidates, drawing: &mut Drawing) -> Result<Solid, BlockError> {
    let (mut solid, target) = sized(class, candidates, drawing)?;
    if let Some(edge_m) = class.edge_m {
        modifiers::refine(&mut solid, edge_m)?;
    }
    for (i, modifier) in class.modifiers.iter().enumerate() {
        modifiers::apply(&mut solid, modifier, &format!("modifiers.{i}"), drawing)?;
    }
    if let Some(volume_m3) = target {
        sizing::to_volume(&mut solid, volume_m3);
    }
    if may_cross(class) {
        solid.check()?;
    } else {
        solid.check_closed()?;
    }
    Ok(solid)
}

/// A block with modifiers applied about the origin, under a key of its own; and the numbers drawn for it. Whether it is a
/// solid afterwards is not looked at.
pub fn modified(mut solid: Solid, modifiers: &[Modifier], key: Key) -> Result<(Solid, Vec<(String, f64)>), BlockError> {
    let mut drawing = Drawing::new(Draws::new(key, 0), 0);
    for (i, modifier) in modifiers.iter().enumerate() {
        modifiers::apply(&mut solid, modifier, &format!("modifiers.{i}"), &mut drawing)?;
    }
    Ok((solid, drawing.into_noted()))
}

/// Convex shapes stay solid under affine maps; moved vertices and scanned blocks have to be looked at.
fn may_cross(class: &Class) -> bool {
    let moves =
        |modifier: &Modifier| matches!(modifier, Modifier::Roughness(_) | Modifier::Noise(_) | Modifier::Remesh(_));
    let after_hull = class.modifiers.iter().rev().take_while(|m| !matches!(m, Modifier::ConvexHull(_)));
    let has_hull = class.modifiers.iter().any(|m| matches!(m, Modifier::ConvexHull(_)));
    let scanned = matches!(class.shape, Shape::Library(_)) && !has_hull;
    scanned || after_hull.into_iter().any(moves)
}

#[cfg(test)]
mod tests;
