//! Takes one block out of a patch of rock face: the removed pieces and the surface that closes their niches.

use std::collections::BTreeMap;

use nalgebra::Matrix3;

use super::boolean::{BooleanError, Origin, Shell, Solid};
use super::groups::Groups;
use super::measure;
use super::patch::{Patch, less, more};
use crate::kernel::truth::Facets;

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
    /// Its depth.
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
    let volume = measure::volume_m3(&block.vertices, &block.triangles, [0.0; 3]);
    if volume.is_nan() || volume <= 0.0 {
        return Err(Failure::Block(format!("its volume is {volume} m3: it is open or inside out")));
    }
    let tool = Solid::block(&block.vertices, &block.triangles).map_err(|e| Failure::Block(e.to_string()))?;
    let (places, closing) = patch.close(bottom(patch, block)).map_err(|fault| Failure::Defect(fault.near))?;
    let centre = more(block.vertices[0], patch.origin);
    let rock = Solid::rock(&places, &patch.triangles, &closing).map_err(|e| match e {
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

/// A shell in the numbering of the patch.
struct Welded {
    triangles: Vec<[u32; 3]>,
    origins: Vec<Origin>,
}

/// Side of the cells vertices are welded in, metres: far above the rounding of an intersection, far below any feature.
const WELD_M: f64 = 1e-10;

/// Gives the vertices of shells numbers: that of the patch where one lies at the same place to the bit, else that of a
/// vertex no farther than a cell, else a new one. The two Booleans may round one intersection differently.
struct Weld<'a> {
    patch: &'a Patch,
    places: Vec<[f64; 3]>,
    numbers: BTreeMap<[u64; 3], u32>,
    /// The first vertex in each cell.
    cells: BTreeMap<[i64; 3], u32>,
    /// Places where the patch has several vertices.
    twice: Vec<[u64; 3]>,
}

fn cell(place: [f64; 3]) -> [i64; 3] {
    place.map(|x| (x / WELD_M).floor() as i64)
}

fn bits(place: [f64; 3]) -> [u64; 3] {
    place.map(|x| (x + 0.0).to_bits())
}

impl<'a> Weld<'a> {
    fn new(patch: &'a Patch) -> Self {
        let mut numbers = BTreeMap::new();
        let mut cells = BTreeMap::new();
        let mut twice = Vec::new();
        for (number, place) in patch.places.iter().enumerate() {
            cells.entry(cell(*place)).or_insert(number as u32);
            if numbers.insert(bits(*place), number as u32).is_some() {
                twice.push(bits(*place));
            }
        }
        Self { patch, places: patch.places.clone(), numbers, cells, twice }
    }

    fn shell(&mut self, shell: &Shell) -> Result<Welded, Failure> {
        let mut welded = Welded { triangles: Vec::new(), origins: Vec::new() };
        for (triangle, origin) in shell.triangles.iter().zip(&shell.origins) {
            let places = triangle.map(|v| shell.places[v as usize]);
            let [a, b, c] =
                [self.number(places[0], *origin)?, self.number(places[1], *origin)?, self.number(places[2], *origin)?];
            // An edge without length takes the two triangles beside it with it.
            if a != b && b != c && c != a {
                welded.triangles.push([a, b, c]);
                welded.origins.push(*origin);
            }
        }
        Ok(welded)
    }

    fn number(&mut self, place: [f64; 3], origin: Origin) -> Result<u32, Failure> {
        let key = bits(place);
        if self.twice.contains(&key) {
            return self.own_corner(key, origin).ok_or(Failure::Defect(more(place, self.patch.origin)));
        }
        if let Some(number) = self.numbers.get(&key).copied().or_else(|| self.near(place)) {
            return Ok(number);
        }
        let number = self.places.len() as u32;
        self.numbers.insert(key, number);
        self.cells.insert(cell(place), number);
        // Rounded as the face will hold it.
        self.places.push(less(more(place, self.patch.origin), self.patch.origin));
        Ok(number)
    }

    /// A vertex in the cell of a place or one beside it.
    fn near(&self, place: [f64; 3]) -> Option<u32> {
        let [x, y, z] = cell(place);
        let beside = (0..27i64).map(|n| [x + n % 3 - 1, y + n / 3 % 3 - 1, z + n / 9 - 1]);
        beside.filter_map(|cell| self.cells.get(&cell)).copied().next()
    }

    /// Where vertices coincide, the one that the source triangle itself has there.
    fn own_corner(&self, key: [u64; 3], origin: Origin) -> Option<u32> {
        let Origin::Rock(source) = origin else { return None };
        let corners = self.patch.triangles.get(source as usize)?;
        corners.iter().copied().find(|v| bits(self.patch.places[*v as usize]) == key)
    }
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
        let mut groups = Groups::of_triangles(places.len(), &taken.triangles);
        let mut pieces: BTreeMap<u32, Raw> = BTreeMap::new();
        for (triangle, origin) in taken.triangles.iter().zip(&taken.origins) {
            let piece = pieces.entry(groups.of(triangle[0])).or_default();
            match origin {
                Origin::Rock(_) => piece.rock.push(*triangle),
                Origin::Block(_) => piece.block.push(*triangle),
                Origin::Closing => piece.closing.push(*triangle),
            }
        }
        let mut pieces: Vec<Raw> = pieces.into_values().collect();
        for piece in &mut pieces {
            let all = [&piece.rock[..], &piece.block, &piece.closing].concat();
            piece.volume_m3 = measure::volume_m3(places, &all, places[all[0][0] as usize]);
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
        let (touched, remains) = compare(patch, left, spared)?;
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
fn compare(patch: &Patch, left: &Welded, spared: Vec<[u32; 3]>) -> Result<(Vec<u32>, Vec<[u32; 3]>), Failure> {
    let mut numbers: BTreeMap<[u32; 3], u32> =
        patch.triangles.iter().enumerate().map(|(number, t)| (turned(*t), number as u32)).collect();
    let is_rock = |(_, origin): &(&[u32; 3], &Origin)| matches!(origin, Origin::Rock(_));
    let rock = left.triangles.iter().zip(&left.origins).filter(is_rock).map(|(t, _)| *t);
    let mut remains: Vec<[u32; 3]> = rock.chain(spared).collect();
    remains.retain(|t| numbers.remove(&turned(*t)).is_none());
    let mut touched: Vec<u32> = numbers.into_values().collect();
    touched.sort_unstable();
    Ok((touched, remains))
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
    let [before, after] = [gone, come].map(|triangles| measure::volume_m3(&cut.places, &triangles, about));
    let removed = cut.pieces.iter().fold(0.0, |sum, piece| sum + piece.volume_m3);
    let rounding = 1e-15 * (before.abs() + after.abs() + 1.0);
    if (before - after - removed).abs() <= VOLUME_TOLERANCE * removed + rounding {
        return Ok(());
    }
    Err(Failure::Boolean(format!("{removed} m3 are removed, and the surfaces lie {} m3 apart", before - after)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artefact::Mesh;
    use crate::kernel::ply;
    use crate::kernel::removal::face::{Face, Rect};
    use crate::kernel::removal::patch::open_edges;
    use crate::testing::{height_mesh, shared};

    const MANNER: Manner = Manner {
        least: Least { volume_m3: 0.0, size_m: 0.0, depth_m: 0.0, whole_block: false },
        look_for_crossings: true,
    };

    fn part(mesh: Mesh) -> Facets {
        Facets { vertices: mesh.vertices, triangles: mesh.triangles }
    }

    fn take(face: &Face, block: &Facets, manner: &Manner) -> Result<(Patch, Cut), Failure> {
        let patch = Patch::around(face, &Rect::around(&block.vertices), block.vertices[0]);
        let cut = cut(&patch, block, &Matrix3::identity(), manner)?;
        Ok((patch, cut))
    }

    /// A box between two corners.
    fn cuboid(low: [f64; 3], high: [f64; 3]) -> Facets {
        let corner = |i: u32| [0, 1, 2].map(|k| if i >> k & 1 == 1 { high[k] } else { low[k] });
        let squares = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = squares.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
        Facets { vertices: (0..8).map(corner).collect(), triangles }
    }

    #[test]
    fn the_trier_block_leaves_the_volume_its_authors_cut() {
        for name in ["cliff_trier_wall_pre", "cliff_trier_pre"] {
            let (Some(face), Some(block)) =
                (shared(&format!("faces/{name}.ply")), shared("faces/cliff_trier_block.ply"))
            else {
                return;
            };
            let (face, block) = (ply::read_mesh(&face).unwrap(), part(ply::read_mesh(&block).unwrap()));
            let (patch, cut) = take(&Face::new(face.vertices, face.triangles), &block, &MANNER).unwrap();
            assert_eq!((cut.pieces.len(), cut.spared, cut.crossed, cut.over_border), (1, 0, false, false));
            assert!((cut.pieces[0].volume_m3 / 14.9032 - 1.0).abs() < 1e-4, "{}", cut.pieces[0].volume_m3);
            // The authors' own mesh after it has 168 triangles more than that before.
            assert_eq!(cut.triangles.len() - cut.touched.len(), 168, "{}", patch.triangles.len());
        }
    }

    #[test]
    fn a_box_in_a_plane_leaves_a_box() {
        let mesh = height_mesh(20, [0.0, 4.0, 0.0, 4.0], |_, _| 0.0);
        let face = Face::new(mesh.vertices, mesh.triangles);
        // Beside the grid lines, along them, and flush with the plane.
        for (low, high) in [
            ([1.03, 1.07, -0.5], [2.01, 2.11, 0.25]),
            ([1.0, 1.0, -0.5], [2.0, 2.0, 0.25]),
            ([1.0, 1.0, -0.5], [2.0, 2.0, 0.0]),
        ] {
            let (patch, cut) = take(&face, &cuboid(low, high), &MANNER).unwrap();
            let piece = &cut.pieces[0];
            let area = (high[0] - low[0]) * (high[1] - low[1]);
            assert!((piece.volume_m3 - 0.5 * area).abs() < 1e-12, "{}", piece.volume_m3);
            assert!((piece.area_m2 - area).abs() < 1e-12 && (piece.depth_m - 0.5).abs() < 1e-12, "{piece:?}");
            let sides = 2.0 * ((high[0] - low[0]) + (high[1] - low[1]));
            let niche = measure::area_m2(&piece.niche.vertices, &piece.niche.triangles);
            assert!((niche - area - 0.5 * sides).abs() < 1e-12);
            assert_eq!(open_edges(&piece.removed.triangles), Ok(vec![]));
            let gone = |n: &usize| !cut.touched.contains(&(*n as u32));
            let kept = (0..patch.triangles.len()).filter(gone).map(|n| patch.triangles[n]);
            let after: Vec<[u32; 3]> = kept.chain(cut.triangles.iter().map(|(t, _)| *t)).collect();
            assert_eq!(open_edges(&after).unwrap(), patch.border().unwrap());
        }
    }

    #[test]
    fn a_bar_through_two_ridges_takes_two_pieces_and_spares_the_smaller() {
        let ridges = |x: f64, _| if x < 2.0 { 1.0 - (x - 1.0).abs() } else { 0.8 - (x - 3.0).abs() };
        let mesh = height_mesh(80, [0.0, 4.0, 0.0, 4.0], ridges);
        let face = Face::new(mesh.vertices, mesh.triangles);
        let bar = cuboid([0.1, 1.5, 0.5], [3.9, 2.5, 3.0]);
        let (_, both) = take(&face, &bar, &MANNER).unwrap();
        let volumes: Vec<f64> = both.pieces.iter().map(|piece| piece.volume_m3).collect();
        assert_eq!(volumes.len(), 2);
        assert!((volumes[0] - 0.25).abs() < 1e-12 && (volumes[1] - 0.09).abs() < 1e-12, "{volumes:?}");
        let least = Least { volume_m3: 0.1, ..MANNER.least };
        let (patch, one) = take(&face, &bar, &Manner { least, ..MANNER }).unwrap();
        assert_eq!((one.pieces.len(), one.spared > 0), (1, true));
        let gone = |n: &usize| !one.touched.contains(&(*n as u32));
        let kept = (0..patch.triangles.len()).filter(gone).map(|n| patch.triangles[n]);
        let after: Vec<[u32; 3]> = kept.chain(one.triangles.iter().map(|(t, _)| *t)).collect();
        assert_eq!(open_edges(&after).unwrap(), patch.border().unwrap());
        let whole = Least { whole_block: true, ..least };
        let refused = take(&face, &bar, &Manner { least: whole, ..MANNER }).unwrap_err();
        assert_eq!(refused, Failure::Refused(Threshold::Size));
    }

    #[test]
    fn what_cannot_be_taken_says_why() {
        let mesh = height_mesh(20, [0.0, 4.0, 0.0, 4.0], |x, _| 0.1 * x);
        let face = Face::new(mesh.vertices, mesh.triangles);
        let failure = |low, high| take(&face, &cuboid(low, high), &MANNER).unwrap_err();
        assert_eq!(failure([1.0, 1.0, 2.0], [2.0, 2.0, 3.0]), Failure::Empty);
        assert_eq!(failure([1.0, 1.0, -3.0], [2.0, 2.0, -2.0]), Failure::Buried);
        assert!(matches!(failure([2.0, 2.0, 1.0], [1.0, 1.0, -1.0]), Failure::Block(_)));
        let open =
            Facets { triangles: cuboid([1.0; 3], [2.0; 3]).triangles[2..].to_vec(), ..cuboid([1.0; 3], [2.0; 3]) };
        assert!(matches!(take(&face, &open, &MANNER), Err(Failure::Block(_))));
        let (_, over) = take(&face, &cuboid([3.5, 1.0, -1.0], [5.0, 2.0, 1.0]), &MANNER).unwrap();
        assert!(over.over_border);
    }
}
