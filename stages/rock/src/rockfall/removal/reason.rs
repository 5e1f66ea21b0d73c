//! Why a candidate is rejected, in words that metrics and tables count by.

use super::cut::{Failure, Threshold};

/// Why a candidate is rejected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reason {
    /// No rock face where it should stand.
    OffFace,
    /// It reaches over the border of the mesh.
    Border,
    /// The rock face it takes reaches out of the safe zone.
    Zone,
    /// It meets an earlier niche or comes too near to it.
    Overlap,
    /// It stands too near to an earlier one.
    Spacing,
    /// There is no rock inside it.
    Empty,
    /// It is all inside the rock.
    Buried,
    /// Not deep enough.
    Depth,
    /// Too little rock.
    Size,
    /// The mesh would get a non-manifold edge or vertex.
    NonManifold,
    /// The mesh would get a hole or another border.
    Holes,
    /// The surface would pass through itself.
    SelfIntersection,
    /// A part of the surface would hang on nothing.
    Isolated,
    /// The mesh is no oriented manifold there.
    MeshDefect,
    /// The block is no closed mesh.
    BlockDefect,
    /// The Boolean failed or contradicted itself.
    Boolean,
    /// The candidate gives no block.
    NoBlock,
}

impl Reason {
    /// One word for it.
    pub fn word(self) -> &'static str {
        match self {
            Self::OffFace => "off_face",
            Self::Border => "border",
            Self::Zone => "zone",
            Self::Overlap => "overlap",
            Self::Spacing => "spacing",
            Self::Empty => "empty",
            Self::Buried => "buried",
            Self::Depth => "depth",
            Self::Size => "size",
            Self::NonManifold => "non_manifold",
            Self::Holes => "holes",
            Self::SelfIntersection => "self_intersection",
            Self::Isolated => "isolated",
            Self::MeshDefect => "mesh_defect",
            Self::BlockDefect => "block_defect",
            Self::Boolean => "boolean",
            Self::NoBlock => "no_block",
        }
    }
}

/// A rejection with what there is to say about it.
#[derive(Debug, Clone, PartialEq)]
pub struct Rejection {
    /// The check that was not passed.
    pub reason: Reason,
    /// Particulars; may be empty.
    pub detail: String,
}

impl From<Reason> for Rejection {
    fn from(reason: Reason) -> Self {
        Self { reason, detail: String::new() }
    }
}

impl From<Failure> for Rejection {
    fn from(failure: Failure) -> Self {
        let (reason, detail) = match failure {
            Failure::Defect([x, y, z]) => (Reason::MeshDefect, format!("near ({x}, {y}, {z})")),
            Failure::Block(text) => (Reason::BlockDefect, text),
            Failure::Boolean(text) => (Reason::Boolean, text),
            Failure::Empty => (Reason::Empty, String::new()),
            Failure::Buried => (Reason::Buried, String::new()),
            Failure::Refused(Threshold::Depth) => (Reason::Depth, String::new()),
            Failure::Refused(Threshold::Size) => (Reason::Size, String::new()),
        };
        Self { reason, detail }
    }
}
