//! Finds how deep a block should sit: the offset along its direction that gives the largest niche of the most rock.

use super::measure::{self, Lids};
use crate::rockfall::ground_truth::Facets;
use rockface_core::numerics::golden_section::{Inner, golden_section};

/// Columns along the longer side of a block.
const COLUMNS: f64 = 48.0;
/// Parts of an edge of a triangle of the block where its surface is summed.
const PARTS: f64 = 8.0;
/// Offsets tried before the best is refined.
const OFFSETS: usize = 64;
/// Golden sections of the best offset's surroundings, and halvings of the push.
const SECTIONS: usize = 40;

/// A block over a rock face as columns along the direction it moves in.
pub struct Columns {
    /// For each column where the block has rock under it: the height of the rock, and the block's intervals at offset 0.
    over_rock: Vec<(f64, Vec<[f64; 2]>)>,
    /// Columns of the block, with rock or without.
    count: usize,
    /// Sum of the lengths of all intervals, metres.
    length: f64,
    /// Small parts of the block's surface: height at offset 0, height of the rock there, area. Empty unless asked for.
    surface: Vec<[f64; 3]>,
    /// Area of all of the block's surface.
    surface_m2: f64,
}

/// Which area of the niche counts (Algorithm 1, line 24: the niche's area and volume are maximised).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NicheArea {
    /// That of its opening, along the direction of placement.
    Projected,
    /// That of the surface it leaves in the rock.
    True,
}

/// What a block takes at one offset.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Take {
    /// Share of the block's columns in which the rock face comes away.
    pub area: f64,
    /// Area of the block's surface inside the rock, as a share of all of it.
    pub inside: f64,
    /// Share of the block's volume that is rock.
    pub volume: f64,
    /// Greatest thickness of rock taken, metres.
    pub depth_m: f64,
}

/// Where a block is to be put.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Offset {
    /// Distance along the direction from the place where it stands to the block's centroid, metres; negative is inward.
    pub offset_m: f64,
    /// By how much it was pushed inward beyond the best offset, metres.
    pub shift_m: f64,
}

/// What a place has to fulfil.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Which area of the niche is maximised with its volume.
    pub area: NicheArea,
    /// Largest share of the block's volume that may be rock: something must stay outside, or the block's top would lie in
    /// the rock face.
    pub most_volume: f64,
    /// Least depth, metres.
    pub depth_m: f64,
    /// Farthest push beyond the best offset to reach that depth, metres.
    pub most_shift_m: f64,
}

impl Columns {
    /// Columns of a block and a rock face, both in a frame whose third axis is the direction and whose origin is the place
    /// where the block stands. Where several sheets of rock cross a column, the one nearest to the origin counts.
    pub fn new(block: &Facets, rock: &Lids) -> Self {
        let (low, high) = block.vertices.iter().fold(([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]), |(l, h), v| {
            ([l[0].min(v[0]), l[1].min(v[1])], [h[0].max(v[0]), h[1].max(v[1])])
        });
        let side = (high[0] - low[0]).max(high[1] - low[1]) / COLUMNS;
        let mut made = Self { over_rock: Vec::new(), count: 0, length: 0.0, surface: Vec::new(), surface_m2: 0.0 };
        if side.is_nan() || side <= 0.0 {
            return made;
        }
        let lids = Lids::new(&block.vertices, &block.triangles);
        let cells = [0, 1].map(|k| ((high[k] - low[k]) / side) as usize + 1);
        for row in 0..cells[1] {
            for column in 0..cells[0] {
                let (x, y) = (low[0] + (column as f64 + 0.5) * side, low[1] + (row as f64 + 0.5) * side);
                made.add(intervals(&lids, x, y), nearest(rock, x, y));
            }
        }
        made
    }

    /// The same with the parts of the block's surface, which the true area of the niche is summed over.
    #[must_use]
    pub fn with_surface(mut self, block: &Facets, rock: &Lids) -> Self {
        for triangle in &block.triangles {
            let corners = triangle.map(|v| block.vertices[v as usize]);
            let parts = parts_of(corners);
            let area = measure::area_m2(&corners, &[[0, 1, 2]]) / parts.len() as f64;
            self.surface_m2 += area * parts.len() as f64;
            let over = |[x, y, z]: [f64; 3]| nearest(rock, x, y).map(|rock| [z, rock, area]);
            self.surface.extend(parts.into_iter().filter_map(over));
        }
        self
    }

    fn add(&mut self, intervals: Vec<[f64; 2]>, rock: Option<f64>) {
        if intervals.is_empty() {
            return;
        }
        self.count += 1;
        self.length += intervals.iter().fold(0.0, |sum, [low, high]| sum + (high - low));
        if let Some(rock) = rock {
            self.over_rock.push((rock, intervals));
        }
    }

    /// What the block takes at an offset.
    pub fn take(&self, offset: f64) -> Take {
        let (mut exposed, mut length, mut depth_m) = (0usize, 0.0, 0.0f64);
        for (rock, intervals) in &self.over_rock {
            let mut thickness = 0.0;
            let mut open = false;
            for [low, high] in intervals {
                thickness += (rock.min(high + offset) - (low + offset)).max(0.0);
                open |= low + offset < *rock && *rock < high + offset;
            }
            exposed += usize::from(open);
            length += thickness;
            depth_m = depth_m.max(thickness);
        }
        let under =
            self.surface.iter().filter(|[z, rock, _]| z + offset < *rock).fold(0.0, |sum, [.., area]| sum + area);
        Take {
            area: exposed as f64 / self.count.max(1) as f64,
            inside: under / self.surface_m2.max(1e-300),
            volume: length / self.length.max(1e-300),
            depth_m,
        }
    }

    /// The offset that maximises niche area times volume, pushed inward where the block would be too shallow; `None` where
    /// the block touches no rock at any offset.
    pub fn best(&self, limits: &Limits) -> Option<Offset> {
        let (low, high) = self.range()?;
        let score = |offset: f64| {
            let take = self.take(offset);
            let area = if limits.area == NicheArea::True { take.inside } else { take.area };
            if take.volume > limits.most_volume { 0.0 } else { area * take.volume }
        };
        let step = (high - low) / OFFSETS as f64;
        let mut best = (0.0, high);
        // From the outermost inward: of equals the shallower is taken.
        for number in (0..=OFFSETS).rev() {
            let offset = low + number as f64 * step;
            if score(offset) > best.0 {
                best = (score(offset), offset);
            }
        }
        best = refined(score, best, step);
        (best.0 > 0.0).then(|| self.pushed(best.1, limits))
    }

    /// Offsets between all buried and just touching.
    fn range(&self) -> Option<(f64, f64)> {
        let start = (f64::INFINITY, f64::NEG_INFINITY);
        let (low, high) = self.over_rock.iter().fold(start, |(low, high), (rock, intervals)| {
            let bottom = intervals.iter().fold(f64::INFINITY, |z, i| z.min(i[0]));
            let top = intervals.iter().fold(f64::NEG_INFINITY, |z, i| z.max(i[1]));
            (low.min(rock - top), high.max(rock - bottom))
        });
        (low < high).then_some((low, high))
    }

    fn pushed(&self, best: f64, limits: &Limits) -> Offset {
        let deep = |shift: f64| self.take(best - shift).depth_m >= limits.depth_m;
        if deep(0.0) || !deep(limits.most_shift_m) {
            return Offset { offset_m: best, shift_m: 0.0 };
        }
        let (mut short, mut enough) = (0.0, limits.most_shift_m);
        for _ in 0..SECTIONS {
            let middle = 0.5 * (short + enough);
            if deep(middle) {
                enough = middle;
            } else {
                short = middle;
            }
        }
        Offset { offset_m: best - enough, shift_m: enough }
    }
}

/// Refines the best (score, offset) of a scan between its neighbours by golden section; returns the best of everything seen.
fn refined(score: impl Fn(f64) -> f64, scanned: (f64, f64), step: f64) -> (f64, f64) {
    let mut best = scanned;
    // Over the depth and not the offset, so that of equals the shallower is kept: deeper down the score falls to 0 at once.
    let cost = |depth: f64| {
        let found = score(-depth);
        if found > best.0 {
            best = (found, -depth);
        }
        -found
    };
    golden_section(cost, -scanned.1 - step, -scanned.1 + step, SECTIONS, Inner::Renewed);
    best
}

/// Centres of the equal parts a triangle is cut into: as many as make them small against the block.
fn parts_of(corners: [[f64; 3]; 3]) -> Vec<[f64; 3]> {
    let along = |i: f64, j: f64| {
        let (u, v) = (i / PARTS, j / PARTS);
        [0, 1, 2].map(|k| corners[0][k] + u * (corners[1][k] - corners[0][k]) + v * (corners[2][k] - corners[0][k]))
    };
    let mut parts = Vec::new();
    for i in 0..PARTS as u32 {
        for j in 0..PARTS as u32 - i {
            let (i, j) = (f64::from(i), f64::from(j));
            parts.push(along(i + 1.0 / 3.0, j + 1.0 / 3.0));
            if i + j + 1.0 < PARTS {
                parts.push(along(i + 2.0 / 3.0, j + 2.0 / 3.0));
            }
        }
    }
    parts
}

/// The parts of a line that lie inside a closed mesh.
fn intervals(lids: &Lids, x: f64, y: f64) -> Vec<[f64; 2]> {
    let mut heights: Vec<f64> = lids.heights(x, y).collect();
    heights.sort_by(f64::total_cmp);
    // A line through an edge meets it twice.
    heights.dedup();
    if heights.len() % 2 == 1 {
        return Vec::new();
    }
    heights.as_chunks().0.to_vec()
}

fn nearest(rock: &Lids, x: f64, y: f64) -> Option<f64> {
    rock.heights(x, y).min_by(|a, b| a.abs().total_cmp(&b.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rockfall::block::hull::hull;
    use rockface_core::numerics::portable_math;
    use rockface_core::testing::height_mesh;

    const LIMITS: Limits = Limits { area: NicheArea::Projected, most_volume: 0.98, depth_m: 0.0, most_shift_m: 0.0 };

    fn columns(points: &[[f64; 3]]) -> Columns {
        let mesh = height_mesh(4, [-5.0, 5.0, -5.0, 5.0], |_, _| 0.0);
        let solid = hull(points).unwrap();
        let block = Facets { vertices: solid.vertices, triangles: solid.triangles };
        let lids = Lids::new(&mesh.vertices, &mesh.triangles);
        Columns::new(&block, &lids).with_surface(&block, &lids)
    }

    #[test]
    fn a_sphere_sits_where_the_formula_says() {
        // Points of a Fibonacci sphere of radius 1.
        let point = |k: u32| {
            let z = 1.0 - (2.0 * f64::from(k) + 1.0) / 2000.0;
            let (sin, cos) = portable_math::sincos(2.399_963_229_728_653 * f64::from(k));
            let r = (1.0 - z * z).sqrt();
            [r * cos, r * sin, z]
        };
        let sphere = columns(&(0..2000).map(point).collect::<Vec<_>>());
        let found = sphere.best(&LIMITS).unwrap();
        assert!((found.offset_m + 0.3675).abs() < 0.02, "{found:?}");
        let take = sphere.take(found.offset_m);
        assert!((take.volume - 0.763).abs() < 0.01 && (take.area - 0.865).abs() < 0.01, "{take:?}");
        // The area of the niche itself, 2 pi r t of a cap of height t, grows to the last: the sphere sinks to the limit of its volume.
        let deep = sphere.best(&Limits { area: NicheArea::True, ..LIMITS }).unwrap();
        let take = sphere.take(deep.offset_m);
        assert!((take.volume - 0.98).abs() < 0.002, "{deep:?} {take:?}");
        assert!((take.inside - 0.5 * (1.0 - deep.offset_m)).abs() < 0.01, "{deep:?} {take:?}");
    }

    #[test]
    fn a_cube_stands_out_a_little_and_a_shallow_one_is_pushed() {
        let corner = |i: u32| [0, 1, 2].map(|k| f64::from(i >> k & 1) - 0.5);
        let cube = columns(&(0..8).map(corner).collect::<Vec<_>>());
        let best = cube.best(&LIMITS).unwrap();
        assert!((cube.take(best.offset_m).volume - 0.98).abs() < 1e-6, "{best:?}");
        let flat = Limits { most_volume: 0.5, ..LIMITS };
        let shallow = cube.best(&flat).unwrap();
        assert!((shallow.offset_m).abs() < 1e-6 && shallow.shift_m.abs() < 1e-12, "{shallow:?}");
        let pushed = cube.best(&Limits { depth_m: 0.7, most_shift_m: 0.3, ..flat }).unwrap();
        assert!((pushed.shift_m - 0.2).abs() < 1e-6 && (cube.take(pushed.offset_m).depth_m - 0.7).abs() < 1e-6);
        let beyond = cube.best(&Limits { depth_m: 0.9, most_shift_m: 0.3, ..flat }).unwrap();
        assert!(beyond.shift_m.abs() < 1e-12);
    }
}
