//! Tries one candidate on a face without changing it: placement, cut, and every validity check of Algorithm 1.

use super::cut::{Cut, Failure, Least, Manner, Piece, cut};
use super::face::{Face, Rect};
use super::patch::{Patch, more};
use super::place::{Placed, place};
use super::reason::{Reason, Rejection};
use super::refine::refine;
use super::search::NicheArea;
use super::topology::Change;
use super::zone::Zone;
use crate::rockfall::ground_truth::Facets;

/// Marks a vertex that the proposal adds, by its number among those.
pub const NEW: u32 = 1 << 31;

/// Which direction a block is moved along to its place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// The normal of the face around the place.
    LocalNormal,
    /// Z of the wall frame.
    Z,
}

/// Where a candidate is to stand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Stand {
    /// Where its vertices are.
    Own,
    /// At X and Y on the face, at the depth that suits it best, turned about its direction.
    On {
        /// X and Y, metres.
        xy: [f64; 2],
        /// Turn about the direction, radians.
        spin_rad: f64,
    },
    /// With its centroid at a point, turned about its direction.
    At {
        /// Place of the centroid, metres.
        place: [f64; 3],
        /// Turn about the direction, radians.
        spin_rad: f64,
    },
}

/// A candidate ready to be tried.
#[derive(Debug, Clone)]
pub struct Trial {
    /// The block: about its centroid, or where it is if it stands on its own place.
    pub block: Facets,
    /// Whether its Z is to be turned to the local normal.
    pub align_to_normal: bool,
    /// Where on the face it is to stand.
    pub stand: Stand,
}

/// What a candidate has to fulfil.
pub struct Rules<'a> {
    /// The direction that blocks are placed along.
    pub direction: Direction,
    /// Whether the border of the mesh must stay out of reach.
    pub border: bool,
    /// Where rock face may come away.
    pub zone: Option<Zone<'a>>,
    /// Whether earlier niches must stay out of reach, and by how many rings of triangles.
    pub overlap_rings: Option<u32>,
    /// Whether non-manifold edges and vertices are refused.
    pub non_manifold: bool,
    /// Whether a changed border is refused.
    pub holes: bool,
    /// Whether removed rock that passes through itself is refused.
    pub self_intersection: bool,
    /// Whether parts of the surface that hang on nothing are refused.
    pub isolated: bool,
    /// What a piece must measure.
    pub least: Least,
    /// Which area of the niche is maximised with its volume.
    pub niche_area: NicheArea,
    /// Largest share of a placed block's volume that may be rock.
    pub most_volume: f64,
    /// Farthest push inward to reach the least depth, metres.
    pub most_shift_m: f64,
    /// Longest edge of the face under a block, metres; longer ones are cut.
    pub refine_edge_m: Option<f64>,
}

/// What a candidate would do.
#[derive(Debug, Clone)]
pub struct Proposal {
    /// Triangles of the face that go.
    pub removed: Vec<u32>,
    /// Vertices that come, metres.
    pub vertices: Vec<[f64; 3]>,
    /// Triangles that come, new vertices marked with [`NEW`], and the place of the piece whose niche they close.
    pub triangles: Vec<([u32; 3], Option<u32>)>,
    /// The pieces, greatest first.
    pub pieces: Vec<Piece>,
    /// Pieces too small or shallow, whose rock stays.
    pub spared: usize,
    /// The block as placed.
    pub block: Facets,
    /// Where its centroid is, metres.
    pub position: [f64; 3],
    /// The direction it was placed along, out of the rock.
    pub normal: [f64; 3],
    /// How far it was pushed beyond the best place, metres.
    pub shift_m: f64,
}

/// What trying a candidate came to.
#[derive(Debug, Clone)]
pub struct Evaluation {
    /// All that was looked at lies in here: what changes outside cannot change the result.
    pub read: Rect,
    /// Where it was tried, metres, as far as that is known.
    pub position: Option<[f64; 3]>,
    /// The proposal, or why there is none.
    pub result: Result<Proposal, Rejection>,
}

/// Places a candidate, cuts, and checks the outcome; the face stays as it is.
pub fn evaluate(face: &Face, trial: &Trial, rules: &Rules) -> Evaluation {
    let mut evaluation = Evaluation { read: Rect::EMPTY, position: None, result: Err(Reason::OffFace.into()) };
    evaluation.result = place(face, trial, rules, &mut evaluation.read).and_then(|placed| {
        evaluation.position = Some(placed.position);
        take(face, placed, rules, &mut evaluation.read)
    });
    evaluation
}

fn take(face: &Face, placed: Placed, rules: &Rules, read: &mut Rect) -> Result<Proposal, Rejection> {
    let rect = Rect::around(&placed.block.vertices);
    *read = read.union(&rect);
    let mut patch = Patch::around(face, &rect, placed.position);
    if patch.triangles.is_empty() {
        return Err(Reason::OffFace.into());
    }
    if let Some(edge_m) = rules.refine_edge_m
        && !refine(&mut patch, &rect, edge_m)
    {
        let detail = format!("edges of {edge_m} m would cut the face under it into more than a million triangles");
        return Err(Rejection { reason: Reason::MeshDefect, detail });
    }
    let manner = Manner { least: rules.least, look_for_crossings: rules.self_intersection };
    let cut = cut(&patch, &placed.block, &placed.frame, &manner).map_err(|failure| {
        let over_niche = rules.overlap_rings.is_some() && reaches_niche(face, &patch, &placed.block);
        match failure {
            // Floors and walls of an earlier niche are where faces of blocks lie in one plane.
            Failure::Boolean(_) if over_niche => Reason::Overlap.into(),
            other => Rejection::from(other),
        }
    })?;
    check(face, &patch, &cut, rules, read)?;
    Ok(propose(&patch, cut, placed))
}

/// Whether a triangle of an earlier niche reaches into the box around a block.
fn reaches_niche(face: &Face, patch: &Patch, block: &Facets) -> bool {
    let heights = |places: &mut dyn Iterator<Item = f64>| {
        places.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), z| (low.min(z), high.max(z)))
    };
    let (low, high) = heights(&mut block.vertices.iter().map(|v| v[2]));
    patch.sources.iter().flatten().filter(|t| face.niche(**t) != 0).any(|t| {
        let (bottom, top) = heights(&mut face.triangle(*t).iter().map(|v| face.vertex(*v)[2]));
        bottom <= high && low <= top
    })
}

fn check(face: &Face, patch: &Patch, cut: &Cut, rules: &Rules, read: &mut Rect) -> Result<(), Rejection> {
    let touched: Vec<u32> = cut.touched.iter().filter_map(|t| patch.sources[*t as usize]).collect();
    let touched: Vec<u32> = touched.into_iter().chain(patch.consumed.iter().copied()).collect();
    let border = patch.border().map_err(|fault| Failure::Defect(fault.near))?;
    let at_border = cut.over_border || reaches_border(face, patch, cut, &border);
    if rules.border && at_border {
        return Err(Reason::Border.into());
    }
    if let Some(zone) = &rules.zone
        && !cut.pieces.iter().all(|piece| zone.holds(&piece.outer))
    {
        return Err(Reason::Zone.into());
    }
    if let Some(rings) = rules.overlap_rings
        && meets_niche(face, &touched, rings, read)
    {
        return Err(Reason::Overlap.into());
    }
    if rules.self_intersection && cut.crossed {
        return Err(Reason::SelfIntersection.into());
    }
    check_topology(patch, cut, &border, at_border, rules)
}

fn check_topology(
    patch: &Patch,
    cut: &Cut,
    border: &[[u32; 2]],
    at_border: bool,
    rules: &Rules,
) -> Result<(), Rejection> {
    let mut touched = cut.touched.iter().peekable();
    let stays = |n: &usize| touched.next_if(|t| **t as usize == *n).is_none();
    let kept: Vec<[u32; 3]> = (0..patch.triangles.len()).filter(stays).map(|n| patch.triangles[n]).collect();
    let new: Vec<[u32; 3]> = cut.triangles.iter().map(|(t, _)| *t).collect();
    let change = Change { vertices: cut.places.len(), before: &patch.triangles, kept: &kept, new: &new, border };
    let faults = change.faults();
    let found = [
        (rules.non_manifold && faults.non_manifold, Reason::NonManifold),
        (rules.holes && faults.holes(at_border), Reason::Holes),
        (rules.isolated && faults.isolated, Reason::Isolated),
    ];
    found.into_iter().find(|(fault, _)| *fault).map_or(Ok(()), |(_, reason)| Err(reason.into()))
}

/// Whether a triangle that goes has an edge on the border of the mesh.
fn reaches_border(face: &Face, patch: &Patch, cut: &Cut, border: &[[u32; 2]]) -> bool {
    let edges = |t: u32| {
        let [a, b, c] = patch.triangles[t as usize];
        [[a, b], [b, c], [c, a]]
    };
    let open = |edge: &[u32; 2]| border.binary_search(edge).is_ok();
    cut.touched.iter().flat_map(|t| edges(*t)).filter(open).any(|edge| {
        match edge.map(|v| patch.vertices[v as usize]) {
            [Some(a), Some(b)] => triangles_at(face, [a, b]) < 2,
            // Both triangles at an edge that refinement made are in the patch.
            _ => true,
        }
    })
}

fn triangles_at(face: &Face, [a, b]: [u32; 2]) -> usize {
    let rect = Rect::around(&[face.vertex(a), face.vertex(b)]);
    let has_both = |t: &u32| {
        let corners = face.triangle(*t);
        corners.contains(&a) && corners.contains(&b)
    };
    face.query(&rect).iter().filter(|t| has_both(t)).count()
}

/// Whether these triangles, or those some rings around them, close an earlier niche. Triangles that share a vertex are
/// one ring apart.
fn meets_niche(face: &Face, touched: &[u32], rings: u32, read: &mut Rect) -> bool {
    let mut reached = touched.to_vec();
    for ring in 0..=rings {
        if reached.iter().any(|t| face.niche(*t) != 0) {
            return true;
        }
        if ring == rings {
            break;
        }
        let mut vertices: Vec<u32> = reached.iter().flat_map(|t| face.triangle(*t)).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let rect = vertices.iter().fold(Rect::EMPTY, |rect, v| rect.with(&face.vertex(*v)));
        *read = read.union(&rect);
        reached = face.query(&rect);
        reached.retain(|t| face.triangle(*t).iter().any(|v| vertices.binary_search(v).is_ok()));
    }
    false
}

fn propose(patch: &Patch, cut: Cut, placed: Placed) -> Proposal {
    let mut removed: Vec<u32> = cut.touched.iter().filter_map(|t| patch.sources[*t as usize]).collect();
    removed.extend(&patch.consumed);
    removed.sort_unstable();
    // What refinement cut up and the block left alone comes anew.
    let untouched = |n: &usize| patch.sources[*n].is_none() && cut.touched.binary_search(&(*n as u32)).is_err();
    let parts = (0..patch.triangles.len()).filter(untouched).map(|n| (patch.triangles[n], None));
    let local: Vec<([u32; 3], Option<u32>)> = parts.chain(cut.triangles).collect();
    let mut vertices = Vec::new();
    let mut numbers: Vec<Option<u32>> = patch.vertices.clone();
    numbers.resize(cut.places.len(), None);
    let mut number = |v: u32| {
        *numbers[v as usize].get_or_insert_with(|| {
            vertices.push(more(cut.places[v as usize], patch.origin));
            NEW | (vertices.len() as u32 - 1)
        })
    };
    let triangles = local.into_iter().map(|(t, piece)| (t.map(&mut number), piece)).collect();
    Proposal {
        removed,
        vertices,
        triangles,
        pieces: cut.pieces,
        spared: cut.spared,
        block: placed.block,
        position: placed.position,
        normal: placed.frame.column(2).into_owned().into(),
        shift_m: placed.shift_m,
    }
}
