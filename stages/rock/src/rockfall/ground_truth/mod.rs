//! Ground truth of removed rock: what each piece measures, where it lies, and what a raster of the face can see of it.
//!
//! `facets` holds volumes, areas and moments of triangles, `bounding_box` the oriented box, `thickness` the depth along a
//! normal, `sneed_folk` the classes of shape, `rasters` labels and depths on a grid, `outline` the polygons around labels,
//! `record` the columns of the inventory.

pub mod bounding_box;
pub mod facets;
pub mod outline;
pub mod rasters;
mod record;
pub mod sneed_folk;
pub mod thickness;

use rockface_core::artefact::{Frame, Inventory, Mesh, Meshes, Part, Raster, Transform};
use rockface_core::{StageError, fail};

pub use facets::Facets;
pub use record::world_from_wall;

/// One piece of rock that was removed, in the wall frame, as whoever removed it knows it.
#[derive(Debug, Clone, PartialEq)]
pub struct RemovedPiece {
    /// Its number, from 1 to 65535, of its own.
    pub id: u32,
    /// Number shared by the pieces one block took.
    pub event: u32,
    /// Number of the block in its sequence.
    pub candidate: u64,
    /// Class of the block.
    pub class: String,
    /// Key of the random stream the block was drawn from, hexadecimal; empty for a block that was not drawn.
    pub seed: String,
    /// The block as placed, closed and outward.
    pub block: Facets,
    /// The rock removed, closed and outward.
    pub removed: Facets,
    /// The surface left behind, open, facing out of the remaining rock.
    pub niche: Facets,
    /// The part of the rock face that went away, open, facing out of the rock.
    pub outer: Facets,
    /// What was drawn for the block, by name.
    pub parameters: Vec<(String, f64)>,
    /// How far the block was pushed beyond its best place, metres along the normal.
    pub shift_m: f64,
    /// Where the block's origin was placed, metres.
    pub position: [f64; 3],
    /// Unit normal the block was placed along, out of the rock.
    pub normal: [f64; 3],
}

/// Everything that is known of the removed rock.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// One feature a piece.
    pub inventory: Inventory,
    /// Number of the piece each cell lost, 0 for none.
    pub labels: Raster,
    /// Metres each cell lost along Z; 0 where nothing was lost, NaN where the face has no value.
    pub depth: Raster,
    /// The block of each event as placed, named by the event.
    pub blocks: Meshes,
    /// The closed rock removed, named by piece.
    pub pieces: Meshes,
    /// The surface left behind, named by piece.
    pub niches: Meshes,
}

/// Puts the ground truth together from the face before and after, in the wall frame, and the pieces between them.
///
/// `cell_m` is the cell of the rasters, metres. `transform` leads between world and wall, either way; without it the
/// world coordinates of the inventory are empty.
///
/// # Errors
/// The piece at fault: a number that is 0, too large or given twice, or a body without volume. A face that is not in the
/// wall frame, a cell that makes no grid, a transform between other frames.
pub fn assemble(
    pre: &Mesh,
    post: &Mesh,
    pieces: &[RemovedPiece],
    cell_m: f64,
    transform: Option<&Transform>,
) -> Result<Truth, StageError> {
    for (mesh, name) in [(pre, "before"), (post, "after")] {
        if mesh.frame != Frame::Wall {
            fail!("the face {name} is in the {} frame; ground truth needs the wall frame", mesh.frame);
        }
    }
    check_numbers(pieces)?;
    let world_from_wall = transform.map(record::world_from_wall).transpose()?;
    let solids: Vec<(u32, &Facets)> = pieces.iter().map(|piece| (piece.id, &piece.removed)).collect();
    let seen = rasters::compare(pre, post, &solids, cell_m)?;
    let inventory = record::inventory(pieces, &seen, world_from_wall.as_ref())?;
    let named = |facets: fn(&RemovedPiece) -> &Facets| pieces.iter().map(move |p| part(p, p.id, facets(p))).collect();
    let mut events = std::collections::BTreeSet::new();
    let first_of_event = pieces.iter().filter(|piece| events.insert(piece.event));
    Ok(Truth {
        inventory,
        blocks: meshes(first_of_event.map(|piece| part(piece, piece.event, &piece.block)).collect()),
        pieces: meshes(named(|piece| &piece.removed)),
        niches: meshes(named(|piece| &piece.niche)),
        labels: seen.labels,
        depth: seen.depth,
    })
}

fn check_numbers(pieces: &[RemovedPiece]) -> Result<(), StageError> {
    let mut taken = std::collections::BTreeSet::new();
    for piece in pieces {
        if piece.id == 0 || piece.id > u32::from(u16::MAX) {
            fail!("piece {} has a number that is not from 1 to {}", piece.id, u16::MAX);
        }
        if !taken.insert(piece.id) {
            fail!("two pieces have the number {}", piece.id);
        }
    }
    Ok(())
}

fn meshes(parts: Vec<Part>) -> Meshes {
    Meshes { frame: Frame::Wall, parts }
}

fn part(piece: &RemovedPiece, name: u32, facets: &Facets) -> Part {
    let Facets { vertices, triangles } = facets.clone();
    Part { name: name.to_string(), class: piece.class.clone(), vertices, triangles }
}

#[cfg(test)]
pub(super) mod scene;
#[cfg(test)]
mod tests;
