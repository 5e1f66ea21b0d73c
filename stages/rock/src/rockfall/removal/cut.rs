//! Takes one block out of a patch of rock face: the removed pieces and the surface that closes their niches.

use rockface_core::numerics::union_find::UnionFind;
use std::collections::BTreeMap;

use nalgebra::Matrix3;

use super::boolean::{BooleanError, Origin, Shell, Solid};
use super::measure;
use super::patch::{Patch, less, more};
use super::weld::{Weld, Welded};
use crate::face::tetrahedra::volume_m3;
use crate::rockfall::ground_truth::Facets;

/// The removed volume and that between the surfaces before and after may differ by this share.
pub const VOLUME_TOLERANCE: f64 = 1e-9;

/// One connected piece of removed rock, in the frame of the face.
#[derive(Debug, Clone)]
pub struct Piece {
    /// The rock removed: closed, outward.
    pub removed: Facets,
    /// The rock face that goes with it (Hi of Algorithm 1), facing out of the rock.
    pub outer: Facets,
    /// The surface that closes the niche (Ci), facing out of the rock: triangles of the mesh after.
    pub niche: Facets,
    /// Volume removed, cubic metres.
    pub volume_m3: f64,
    /// Area of `outer`, square metres.
    pub area_m2: f64,
    /// Greatest distance from the niche to the rock face over it along the direction of placement, metres.
    pub depth_m: f64,
}

/// What a removal makes of a patch. Vertices are numbered as in the patch, new ones after them.
#[derive(Debug, Clone)]
pub struct Cut {
    /// Places of all vertices, metres, less the origin of the patch.
    pub places: Vec<[f64; 3]>,
    /// Positions, among the triangles of the patch, of those that go.
    pub touched: Vec<u32>,
    /// Triangles that come, each with the place of its piece in `pieces` where it belongs to a niche.
    pub triangles: Vec<([u32; 3], Option<u32>)>,
    /// The pieces, greatest volume first.
    pub pieces: Vec<Piece>,
    /// Pieces whose rock stays because they are too small or shallow.
    pub spared: usize,
    /// Whether the block reaches over the border of the mesh.
    pub over_border: bool,
    /// Whether the surface of the removed rock crosses itself; only looked for on demand.
    pub crossed: bool,
}

/// Why nothing can be taken.
#[derive(Debug, Clone, PartialEq)]
pub enum Failure {
    /// The mesh around the block is not an oriented manifold near this place.
    Defect([f64; 3]),
    /// The block is not a closed, outward mesh with a volume.
    Block(String),
    /// The Boolean failed or contradicts itself.
    Boolean(String),
    /// No rock inside the block.
    Empty,
    /// The block is all inside the rock: what it leaves would be a sealed void.
    Buried,
    /// Every piece is below a threshold; the greatest piece failed this one.
    Refused(Threshold),
}

/// The thresholds of one piece.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Threshold {
    /// Its depth along the direction of placement.
    Depth,
    /// Its volume or size.
    Size,
}

/// What a piece must measure. Zero asks for nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Least {
    /// Volume, cubic metres.
    pub volume_m3: f64,
    /// Square root of the rock-face area that goes with it, metres.
    pub size_m: f64,
    /// Depth along the direction of placement, metres.
    pub depth_m: f64,
    /// Whether one piece that falls short refuses the whole block; otherwise its rock stays.
    pub whole_block: bool,
}

/// How to take a block out.
#[derive(Debug, Clone, Copy)]
pub struct Manner {
    /// What a piece must measure.
    pub least: Least,
    /// Whether to look for removed rock whose surface crosses itself.
    pub look_for_crossings: bool,
}

/// Takes a block (in the frame of the face) out of a patch; `frame` has the direction of placement as its third column.
pub fn cut(patch: &Patch, block: &Facets, frame: &Matrix3<f64>, manner: &Manner) -> Result<Cut, Failure> {
    let local = Facets {
        vertices: block.vertices.iter().map(|v| less(*v, patch.origin)).collect(),
        triangles: block.triangles.clone(),
    };
    let (taken, left, crossed) = combine(patch, &local, manner)?;
    if taken.triangles.is_empty() {
        return Err(Failure::Empty);
    }
    let mut weld = Weld::new(patch);
    let taken = weld.shell(&taken)?;
    let left = weld.shell(&left)?;
    let mut split = Split::new(&taken, &weld.places);
    if split.pieces.iter().all(|piece| piece.rock.is_empty()) {
        return Err(Failure::Buried);
    }
    split.close(&left)?;
    let cut = split.assemble(patch, weld.places, &left, frame, manner.least)?;
    let cut = Cut { crossed, ..cut };
    check_volume(patch, &cut)?;
    Ok(cut)
}

/// The rock inside the block and the rock without it.
fn combine(patch: &Patch, block: &Facets, manner: &Manner) -> Result<(Shell, Shell, bool), Failure> {
    let volume = volume_m3(&block.vertices, &block.triangles, [0.0; 3]);
    if volume.is_nan() || volume <= 0.0 {
        return Err(Failure::Block(format!("its volume is {volume} m3: it is open or inside out")));
    }
    let tool = Solid::block(&block.vertices, &block.triangles).map_err(|e| Failure::Block(e.to_string()))?;
    let closed = patch.close(bottom(patch, block)).map_err(|fault| Failure::Defect(fault.near))?;
    let centre = more(block.vertices[0], patch.origin);
    let rock = Solid::rock(&closed.places, &patch.triangles, &closed.triangles).map_err(|e| match e {
        BooleanError::NotSolid(_) => Failure::Defect(centre),
        BooleanError::GaveUp(_) => Failure::Boolean(e.to_string()),
    })?;
    let failed = |e: BooleanError| Failure::Boolean(e.to_string());
    let taken = rock.intersection(&tool).map_err(failed)?;
    let crossed = manner.look_for_crossings && taken.crosses_itself().map_err(failed)?;
    let left = rock.difference(&tool).map_err(failed)?;
    Ok((taken.shell(), left.shell(), crossed))
}

/// Below everything, by as much as everything is high.
fn bottom(patch: &Patch, block: &Facets) -> f64 {
    let heights = patch.places.iter().chain(&block.vertices).map(|p| p[2]);
    let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), z| (l.min(z), h.max(z)));
    low - (high - low) - 1.0
}

/// The triangles of one connected piece.
#[derive(Default, Clone)]
struct Raw {
    rock: Vec<[u32; 3]>,
    block: Vec<[u32; 3]>,
    closing: Vec<[u32; 3]>,
    /// What closes the niche in the mesh after.
    niche: Vec<[u32; 3]>,
    volume_m3: f64,
}

/// Removed rock by connected piece, greatest first.
struct Split {
    pieces: Vec<Raw>,
    /// The piece each vertex of a block's triangle belongs to.
    owners: BTreeMap<u32, u32>,
}

impl Split {
    fn new(taken: &Welded, places: &[[f64; 3]]) -> Self {
        let mut groups = UnionFind::of_triangles(places.len(), &taken.triangles);
        let mut pieces: BTreeMap<usize, Raw> = BTreeMap::new();
        for (triangle, origin) in taken.triangles.iter().zip(&taken.origins) {
            let piece = pieces.entry(groups.root(triangle[0] as usize)).or_default();
            match origin {
                Origin::Rock(_) => piece.rock.push(*triangle),
                Origin::Block(_) => piece.block.push(*triangle),
                Origin::Closing => piece.closing.push(*triangle),
            }
        }
        let mut pieces: Vec<Raw> = pieces.into_values().collect();
        for piece in &mut pieces {
            let all = [&piece.rock[..], &piece.block, &piece.closing].concat();
            piece.volume_m3 = volume_m3(places, &all, places[all[0][0] as usize]);
        }
        pieces.sort_by(|a, b| b.volume_m3.total_cmp(&a.volume_m3));
        let owner = |(number, piece): (usize, &Raw)| {
            piece.block.iter().flatten().map(|v| (*v, number as u32)).collect::<Vec<_>>()
        };
        let owners = pieces.iter().enumerate().flat_map(owner).collect();
        Self { pieces, owners }
    }

    /// Hands the new surface of the mesh after to the pieces whose niches it closes.
    fn close(&mut self, left: &Welded) -> Result<(), Failure> {
        let is_block = |(_, origin): &(&[u32; 3], &Origin)| matches!(origin, Origin::Block(_));
        for (triangle, _) in left.triangles.iter().zip(&left.origins).filter(is_block) {
            let owner = triangle.iter().find_map(|v| self.owners.get(v));
            let owner = owner.ok_or_else(|| Failure::Boolean("a niche without its piece".into()))?;
            self.pieces[*owner as usize].niche.push(*triangle);
        }
        Ok(())
    }

    fn assemble(
        self,
        patch: &Patch,
        places: Vec<[f64; 3]>,
        left: &Welded,
        frame: &Matrix3<f64>,
        least: Least,
    ) -> Result<Cut, Failure> {
        let over_border = self.pieces.iter().any(|piece| !piece.closing.is_empty());
        let mut pieces = Vec::new();
        let mut spared = Vec::new();
        let mut refused = None;
        for raw in self.pieces {
            let piece = finish(&raw, &places, patch.origin, frame);
            match falls_short(&piece, least) {
                None => pieces.push((piece, raw.niche)),
                Some(threshold) => {
                    refused = refused.or(Some(threshold));
                    spared.extend(raw.rock);
                }
            }
        }
        let count = spared.len();
        match refused {
            Some(threshold) if pieces.is_empty() || least.whole_block => return Err(Failure::Refused(threshold)),
            _ => {}
        }
        let (touched, remains) = compare(patch, left, spared);
        let mut triangles: Vec<([u32; 3], Option<u32>)> = remains.into_iter().map(|t| (t, None)).collect();
        for (number, (_, niche)) in pieces.iter().enumerate() {
            triangles.extend(niche.iter().map(|t| (*t, Some(number as u32))));
        }
        let pieces = pieces.into_iter().map(|(piece, _)| piece).collect();
        Ok(Cut { places, touched, triangles, pieces, spared: count, over_border, crossed: false })
    }
}

fn falls_short(piece: &Piece, least: Least) -> Option<Threshold> {
    if piece.volume_m3 < least.volume_m3 || piece.area_m2 < least.size_m * least.size_m || piece.volume_m3 <= 0.0 {
        Some(Threshold::Size)
    } else if piece.depth_m < least.depth_m {
        Some(Threshold::Depth)
    } else {
        None
    }
}

/// Triangles of the patch that are no more, and parts of rock face that come in their stead.
fn compare(patch: &Patch, left: &Welded, spared: Vec<[u32; 3]>) -> (Vec<u32>, Vec<[u32; 3]>) {
    let mut numbers: BTreeMap<[u32; 3], u32> =
        patch.triangles.iter().enumerate().map(|(number, t)| (turned(*t), number as u32)).collect();
    let is_rock = |(_, origin): &(&[u32; 3], &Origin)| matches!(origin, Origin::Rock(_));
    let rock = left.triangles.iter().zip(&left.origins).filter(is_rock).map(|(t, _)| *t);
    let mut remains: Vec<[u32; 3]> = rock.chain(spared).collect();
    remains.retain(|t| numbers.remove(&turned(*t)).is_none());
    let mut touched: Vec<u32> = numbers.into_values().collect();
    touched.sort_unstable();
    (touched, remains)
}

/// A triangle that begins with its least vertex.
fn turned(t: [u32; 3]) -> [u32; 3] {
    let first = (0..3).min_by_key(|k| t[*k]).unwrap_or(0);
    [t[first], t[(first + 1) % 3], t[(first + 2) % 3]]
}

fn finish(raw: &Raw, places: &[[f64; 3]], origin: [f64; 3], frame: &Matrix3<f64>) -> Piece {
    let part = |triangles: &[[u32; 3]]| part(triangles, places, origin);
    let outer = part(&raw.rock);
    Piece {
        removed: part(&[&raw.rock[..], &raw.block, &raw.closing].concat()),
        niche: part(&raw.niche),
        volume_m3: raw.volume_m3,
        area_m2: measure::area_m2(&outer.vertices, &outer.triangles),
        depth_m: measure::depth_m(places, &raw.block, &raw.rock, frame),
        outer,
    }
}

/// The vertices some triangles use, in ascending order, and the triangles by them; in the frame of the face.
fn part(triangles: &[[u32; 3]], places: &[[f64; 3]], origin: [f64; 3]) -> Facets {
    let mut used: Vec<u32> = triangles.iter().flatten().copied().collect();
    used.sort_unstable();
    used.dedup();
    let number = |v: u32| used.partition_point(|known| *known < v) as u32;
    Facets {
        vertices: used.iter().map(|v| more(places[*v as usize], origin)).collect(),
        triangles: triangles.iter().map(|t| t.map(number)).collect(),
    }
}

/// The volume between the surfaces before and after must be that of the removed pieces, two Booleans apart.
fn check_volume(patch: &Patch, cut: &Cut) -> Result<(), Failure> {
    if cut.over_border {
        return Ok(());
    }
    let gone: Vec<[u32; 3]> = cut.touched.iter().map(|t| patch.triangles[*t as usize]).collect();
    let come: Vec<[u32; 3]> = cut.triangles.iter().map(|(t, _)| *t).collect();
    let Some(about) = gone.first().map(|t| cut.places[t[0] as usize]) else {
        return Err(Failure::Boolean("rock is removed and no triangle of the face with it".into()));
    };
    let [before, after] = [gone, come].map(|triangles| volume_m3(&cut.places, &triangles, about));
    let removed = cut.pieces.iter().fold(0.0, |sum, piece| sum + piece.volume_m3);
    let rounding = 1e-15 * (before.abs() + after.abs() + 1.0);
    if (before - after - removed).abs() <= VOLUME_TOLERANCE * removed + rounding {
        return Ok(());
    }
    Err(Failure::Boolean(format!("{removed} m3 are removed, and the surfaces lie {} m3 apart", before - after)))
}

#[cfg(test)]
mod tests;
