//! Space between two surfaces as voxels: those that triangles occupy, those enclosed between, and clusters of these.

use std::sync::atomic::{AtomicU8, Ordering};

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::detection::clusters;
use rockface_core::artefact::Artefact;
use rockface_core::{StageError, fail};
use rockface_raster::shape::{Moved, Shape};

/// Voxels a grid may have; their places fit into 32 bits.
pub const MAXIMUM: f64 = 6e8;
/// Most voxels between a surface and the origin: farther away a double does not count them one by one.
const FARTHEST: f64 = 1e15;
/// Voxels between surfaces that are apart.
const APART: usize = 4;
/// The reference occupies a voxel.
const REFERENCE: u8 = 1;
/// The comparison occupies a voxel.
const COMPARISON: u8 = 2;
/// A voxel is reached from outside, or was taken.
const DONE: u8 = 4;

/// The sides of the box around a surface, metres; `None` without points.
pub fn size_m(artefact: &Artefact) -> Option<[f64; 3]> {
    let [low, high] = match artefact {
        Artefact::Raster(raster) => {
            let (grid, heights) = (raster.grid, &raster.bands.first()?.values);
            let [width_m, height_m] = [grid.columns, grid.rows].map(|count| count as f64 * grid.cell_m);
            let corners = |z: &f32| [[0.0, 0.0, f64::from(*z)], [width_m, height_m, f64::from(*z)]];
            bounds(heights.iter().filter(|z| !z.is_nan()).flat_map(corners))
        }
        other => {
            let shape = Shape::of(other)?;
            bounds((0..shape.places()).map(|place| shape.point(place, None)))
        }
    };
    (low[0] <= high[0]).then(|| std::array::from_fn(|axis| high[axis] - low[axis]))
}

/// The least and the greatest coordinates of points; those without a value (NaN) do not count.
fn bounds(points: impl Iterator<Item = [f64; 3]>) -> [[f64; 3]; 2] {
    let wider = |[low, high]: [[f64; 3]; 2], point: [f64; 3]| {
        [std::array::from_fn(|i| low[i].min(point[i])), std::array::from_fn(|i| high[i].max(point[i]))]
    };
    points.filter(|point| !point[0].is_nan()).fold([[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]], wider)
}

/// A cubic lattice around two surfaces, with a layer of empty voxels on every side.
pub struct Voxels {
    /// Edge, metres.
    pub edge_m: f64,
    /// Lower corner, metres: whole multiples of the edge.
    pub low: [f64; 3],
    /// Voxels along X, Y and Z.
    pub count: [usize; 3],
    flags: Vec<u8>,
    /// By column, of the reference and of the comparison, how many points lie there and how many of them were gaps; empty without gaps.
    seen: [Vec<[u32; 2]>; 2],
}

/// Enclosed voxels that touch.
#[derive(Debug, Clone, PartialEq)]
pub struct Cluster {
    /// Enclosed voxels as (x, y, z), in the order they were met from the first.
    pub inside: Vec<[usize; 3]>,
    /// Voxels around them, over edges and corners too.
    pub shell: usize,
    /// Columns of voxels around its own ones, over edges and corners in plan.
    pub rim: usize,
    /// The share of the points of the reference or of the comparison over its columns, whichever is more, that were gaps.
    pub bridged: f64,
    /// Enclosed voxels in the rock of the reference only, and in that of the comparison only.
    pub under: [usize; 2],
}

impl Voxels {
    /// Occupies the voxels that the triangles of both surfaces meet; `bridged` says which places of each were gaps.
    ///
    /// # Errors
    /// Surfaces without points, or too many voxels.
    pub fn new(
        shapes: [Shape; 2],
        bridged: [&[bool]; 2],
        moved: Option<&Moved>,
        edge_m: f64,
    ) -> Result<Self, StageError> {
        let motions = [None, moved];
        let points = shapes
            .into_iter()
            .zip(motions)
            .flat_map(|(shape, motion)| (0..shape.places()).map(move |place| shape.point(place, motion)));
        let [low_m, high_m] = bounds(points);
        if low_m[0] > high_m[0] {
            return Err(StageError::new("neither surface has points"));
        }
        let farthest = low_m.iter().chain(&high_m).fold(0.0f64, |most, x| most.max(x.abs()));
        if farthest / edge_m > FARTHEST {
            return Err(StageError::new(format!(
                "a coordinate of {farthest:e} m is no place for voxels of {edge_m} m"
            ))
            .hint("is it a no-data value that the file does not declare?"));
        }
        let first = low_m.map(|low| (low / edge_m).floor() - 1.0);
        let size: [f64; 3] = std::array::from_fn(|axis| (high_m[axis] / edge_m).floor() + 2.0 - first[axis]);
        let total = size.iter().product::<f64>();
        if total > MAXIMUM {
            fail!("{total:.2e} voxels of {edge_m} m are more than {MAXIMUM:.0e}");
        }
        let count = size.map(|length| length as usize);
        let low = first.map(|index| index * edge_m);
        let mut voxels = Self { edge_m, low, count, flags: Vec::new(), seen: Default::default() };
        let flags: Vec<AtomicU8> = (0..total as usize).map(|_| AtomicU8::new(0)).collect();
        for ((shape, motion), bit) in shapes.into_iter().zip(motions).zip([REFERENCE, COMPARISON]) {
            (0..shape.strips()).into_par_iter().for_each(|strip| {
                shape.for_each_triangle(strip, |t| voxels.occupy(t.map(|p| shape.point(p, motion)), bit, &flags));
            });
        }
        voxels.flags = flags.into_iter().map(AtomicU8::into_inner).collect();
        voxels.seen = [0, 1].map(|side| voxels.seen_of(shapes[side], motions[side], bridged[side]));
        Ok(voxels)
    }

    /// By column, how many points of a surface lie there and how many of them were gaps; nothing where it had none.
    fn seen_of(&self, shape: Shape, motion: Option<&Moved>, gaps: &[bool]) -> Vec<[u32; 2]> {
        if !gaps.contains(&true) {
            return Vec::new();
        }
        let mut seen = vec![[0; 2]; self.count[0] * self.count[1]];
        for (place, is_gap) in gaps.iter().enumerate() {
            let point = shape.point(place, motion);
            if !point[0].is_nan() {
                let at: [usize; 2] = std::array::from_fn(|k| ((point[k] - self.low[k]) / self.edge_m) as usize);
                let [points, missing] = &mut seen[at[1] * self.count[0] + at[0]];
                (*points, *missing) = (*points + 1, *missing + u32::from(*is_gap));
            }
        }
        seen
    }

    /// The voxel at a place.
    fn position(&self, place: usize) -> [usize; 3] {
        let cells = self.count[0] * self.count[1];
        [place % self.count[0], place % cells / self.count[0], place / cells]
    }

    fn place(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.count[1] + y) * self.count[0] + x
    }

    /// The order in which bits are set does not change what is set.
    fn occupy(&self, triangle: [[f64; 3]; 3], bit: u8, flags: &[AtomicU8]) {
        // In voxels from the lower corner.
        let local = triangle.map(|p| -> [f64; 3] { std::array::from_fn(|k| (p[k] - self.low[k]) / self.edge_m) });
        if local.iter().flatten().any(|value| value.is_nan()) {
            return;
        }
        let end = |axis: usize, pick: fn(f64, f64) -> f64| pick(pick(local[0][axis], local[1][axis]), local[2][axis]);
        let range =
            |axis: usize| end(axis, f64::min) as usize..=(end(axis, f64::max) as usize).min(self.count[axis] - 1);
        for z in range(2) {
            for y in range(1) {
                for x in range(0) {
                    let centre = [x, y, z].map(|index| index as f64 + 0.5);
                    if meets(&local, centre) {
                        flags[self.place([x, y, z])].fetch_or(bit, Ordering::Relaxed);
                    }
                }
            }
        }
    }

    /// Voxels that a surface occupies, and both do.
    pub fn occupied(&self) -> [usize; 3] {
        let count = |bits: u8| self.flags.iter().filter(|flags| **flags & bits == bits).count();
        [REFERENCE, COMPARISON, REFERENCE | COMPARISON].map(count)
    }

    /// Columns of voxels with the reference in them, and with both surfaces.
    pub fn columns(&self) -> [usize; 2] {
        let columns = self.count[0] * self.count[1];
        let mut seen = vec![0u8; columns];
        for layer in self.flags.chunks(columns) {
            seen.iter_mut().zip(layer).for_each(|(seen, flags)| *seen |= flags);
        }
        [REFERENCE, REFERENCE | COMPARISON].map(|bits| seen.iter().filter(|seen| **seen & bits == bits).count())
    }

    /// The empty voxels that cannot be reached from outside over faces, in clusters over edges and corners, by first voxel; and at each place
    /// where the surfaces are apart and the outside reaches between them, how many voxels lie there.
    ///
    /// `outward` is the way out of the rock: the voxels along it decide whose rock a voxel is in.
    pub fn enclosed(mut self, outward: &Vector3<f64>) -> (Vec<Cluster>, Vec<usize>) {
        let step = nearest_step(outward);
        self.flood();
        let open = self.open();
        let mut clusters = Vec::new();
        for first in 0..self.flags.len() {
            if self.flags[first] == 0 {
                self.flags[first] = DONE;
                clusters.push(self.cluster(self.position(first), step));
            }
        }
        (clusters, open)
    }

    /// Columns that touch in plan in which all between the uppermost voxels of both surfaces, four or more, is outside: over a gap of one of
    /// the surfaces, or at its border.
    fn open(&self) -> Vec<usize> {
        let [columns, rows, _] = self.count;
        let between: Vec<usize> = (0..rows * columns)
            .into_par_iter()
            .map(|column| {
                let [x, y] = [column % columns, column / columns];
                let flags = |z: usize| self.flags[self.place([x, y, z])];
                let top = |bit: u8| (0..self.count[2]).rev().find(|z| flags(*z) & bit != 0);
                let (Some(one), Some(other)) = (top(REFERENCE), top(COMPARISON)) else { return 0 };
                let inner = one.min(other) + 1..one.max(other);
                let is_open = inner.len() >= APART && inner.clone().all(|z| flags(z) & DONE != 0);
                if is_open { inner.len() } else { 0 }
            })
            .collect();
        let mask: Vec<bool> = between.iter().map(|count| *count > 0).collect();
        let groups = clusters::groups(&mask, columns).into_iter();
        groups.map(|group| group.iter().map(|column| between[*column]).sum()).collect()
    }

    /// Marks what is reached from the lower corner, which is outside as every border voxel is.
    fn flood(&mut self) {
        // Places instead of positions: in a large box a quarter of all voxels can be open at a time.
        let mut open = vec![0u32];
        self.flags[0] |= DONE;
        while let Some(place) = open.pop() {
            let at = self.position(place as usize);
            for axis in 0..3 {
                for step in [-1, 1] {
                    let moved = at[axis] as i64 + step;
                    if !(0..self.count[axis] as i64).contains(&moved) {
                        continue;
                    }
                    let mut next = at;
                    next[axis] = moved as usize;
                    let place = self.place(next);
                    if self.flags[place] == 0 {
                        self.flags[place] = DONE;
                        open.push(place as u32);
                    }
                }
            }
        }
    }

    fn cluster(&mut self, start: [usize; 3], step: [isize; 3]) -> Cluster {
        let mut inside = vec![start];
        let mut next = 0;
        while let Some(at) = inside.get(next).copied() {
            next += 1;
            for near in around(at) {
                let place = self.place(near);
                if self.flags[place] == 0 {
                    self.flags[place] = DONE;
                    inside.push(near);
                }
            }
        }
        let own: std::collections::BTreeSet<[usize; 3]> = inside.iter().copied().collect();
        let shell: std::collections::BTreeSet<[usize; 3]> =
            inside.iter().flat_map(|at| around(*at)).filter(|near| !own.contains(near)).collect();
        let mut under = [0; 2];
        for at in &inside {
            // Inside the rock a line outwards passes its surface an odd number of times: also under an overhang.
            match self.passed(*at, step).map(|runs| runs % 2) {
                [1, 0] => under[0] += 1,
                [0, 1] => under[1] += 1,
                _ => {}
            }
        }
        let columns = |places: &std::collections::BTreeSet<[usize; 3]>| -> std::collections::BTreeSet<[usize; 2]> {
            places.iter().map(|[x, y, _]| [*x, *y]).collect()
        };
        let (within, all) = (columns(&own), columns(&shell));
        let bridged = self.seen.iter().map(|seen| {
            let places = within.iter().filter_map(|[x, y]| seen.get(y * self.count[0] + x));
            let [points, gaps] = places.fold([0; 2], |[points, gaps], [more, missing]| [points + more, gaps + missing]);
            if points > 0 { f64::from(gaps) / f64::from(points) } else { 0.0 }
        });
        let bridged = bridged.fold(0.0, f64::max);
        Cluster { inside, shell: shell.len(), rim: all.difference(&within).count(), bridged, under }
    }

    /// How often a line outwards from a voxel passes the reference and the comparison: runs of voxels that they occupy.
    fn passed(&self, from: [usize; 3], step: [isize; 3]) -> [usize; 2] {
        let (mut runs, mut last) = ([0; 2], 0);
        let next = |at: &[usize; 3]| {
            let moved: [usize; 3] = std::array::from_fn(|axis| at[axis].wrapping_add_signed(step[axis]));
            (0..3).all(|axis| moved[axis] < self.count[axis]).then_some(moved)
        };
        for flags in std::iter::successors(next(&from), next).map(|at| self.flags[self.place(at)]) {
            for (run, bit) in runs.iter_mut().zip([REFERENCE, COMPARISON]) {
                *run += usize::from(flags & bit != 0 && last & bit == 0);
            }
            last = flags;
        }
        runs
    }
}

/// The step to one of the 26 voxels around that is nearest to a direction. Also a step over an edge or a corner meets a voxel of each surface that
/// it passes, since voxels that a triangle touches are occupied.
fn nearest_step(direction: &Vector3<f64>) -> [isize; 3] {
    let steps = (0..27).filter(|i| *i != 13).map(|i| [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1]);
    let along = |step: &[isize; 3]| {
        let step = Vector3::from(step.map(|s| s as f64));
        step.dot(direction) / step.norm()
    };
    steps.max_by(|a, b| along(a).total_cmp(&along(b))).unwrap_or([0, 0, 1])
}

/// The 26 voxels around one that is not at the border.
fn around([x, y, z]: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    let offsets = (0..27).filter(|i| *i != 13);
    offsets.map(move |i| [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1])
}

/// Whether a triangle meets the unit cube around a centre, touching included: separating axes of triangle and cube.
///
/// # References
/// Akenine-Moeller, T. (2001), Fast 3D triangle-box overlap testing, Journal of Graphics Tools 6, 29-33.
fn meets(triangle: &[[f64; 3]; 3], centre: [f64; 3]) -> bool {
    let v = triangle.map(|p| Vector3::from(p) - Vector3::from(centre));
    let apart = |axis: Vector3<f64>| {
        let reach = 0.5 * (axis.x.abs() + axis.y.abs() + axis.z.abs());
        let [a, b, c] = [0, 1, 2].map(|corner| v[corner].dot(&axis));
        a.min(b).min(c) > reach || a.max(b).max(c) < -reach
    };
    let units = [Vector3::x(), Vector3::y(), Vector3::z()];
    let edges = [v[1] - v[0], v[2] - v[1], v[0] - v[2]];
    let crossed = |edge: &Vector3<f64>| units.iter().any(|unit| apart(unit.cross(edge)));
    !units.iter().any(|unit| apart(*unit)) && !apart(edges[0].cross(&edges[1])) && !edges.iter().any(crossed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Mesh;
    use rockface_core::numerics::portable_math;
    use rockface_core::testing::height_mesh;

    /// A plane with a box-shaped niche of cells [-0.3, 0.3] x [-0.2, 0.2] down to `-depth`, its walls between two vertices.
    fn niche(depth: f64) -> Mesh {
        let inside = |x: f64, y: f64| x.abs() < 0.3 && y.abs() < 0.2;
        height_mesh(200, [-1.003, 1.003, -1.003, 1.003], |x, y| if inside(x, y) { -depth } else { 0.013 })
    }

    fn clusters(before: &Mesh, after: &Mesh) -> Vec<Cluster> {
        Voxels::new([Shape::Mesh(before), Shape::Mesh(after)], [&[], &[]], None, 0.05)
            .unwrap()
            .enclosed(&Vector3::z())
            .0
    }

    #[test]
    fn a_niche_is_one_cluster_with_its_volume_and_side() {
        let (before, after) = (niche(-0.013), niche(0.29));
        let found = clusters(&before, &after);
        assert_eq!(found.len(), 1);
        let cluster = &found[0];
        // By hand: 10 x 6 voxels in plan lie wholly inside the walls, and 5 layers between those of top and floor.
        assert_eq!((cluster.inside.len(), cluster.shell), (10 * 6 * 5, 12 * 8 * 7 - 10 * 6 * 5));
        let volume = 1.25e-4 * (cluster.inside.len() as f64 + 0.5 * cluster.shell as f64);
        assert!((volume / (0.6 * 0.4 * 0.303) - 1.0).abs() < 0.25, "{volume}");
        assert_eq!(cluster.under, [cluster.inside.len(), 0]);
        let back = clusters(&after, &before);
        assert_eq!((back[0].inside.len(), back[0].under), (cluster.inside.len(), [0, cluster.inside.len()]));
        assert!(clusters(&before, &before).is_empty());
    }

    /// A rough face with a niche of 0.9 x 0.7 m of this depth, or a bump where it is negative, that dips by an angle and looks to another, degrees; and
    /// its unit normal.
    fn dipping(depth: f64, dip_deg: f64, azimuth_deg: f64) -> (Mesh, Vector3<f64>) {
        let inside = |x: f64, y: f64| x.abs() < 0.45 && y.abs() < 0.35;
        let rough =
            |x: f64, y: f64| 0.04 * portable_math::sin(7.0 * x + 3.0 * y) * portable_math::cos(5.0 * y - 2.0 * x);
        let noise = |x: f64, y: f64| 0.02 * portable_math::sin(913.0 * x + 1237.0 * y + 50.0 * depth);
        let surface = |x, y| rough(x, y) + noise(x, y) - if inside(x, y) { depth } else { 0.0 };
        let mut mesh = height_mesh(120, [-1.503, 1.503, -1.503, 1.503], surface);
        let turned = |angle_deg: f64, [a, b]: [f64; 2]| {
            let (sine, cosine) =
                (portable_math::sin(angle_deg.to_radians()), portable_math::cos(angle_deg.to_radians()));
            [cosine * a - sine * b, sine * a + cosine * b]
        };
        let turn = |[x, y, z]: [f64; 3]| {
            let [z, x] = turned(dip_deg, [z, x]);
            let [x, y] = turned(azimuth_deg, [x, y]);
            [x + 0.011, y + 0.017, z + 0.013]
        };
        mesh.vertices.iter_mut().for_each(|vertex| *vertex = turn(*vertex));
        (mesh, turn([0.0, 0.0, 1.0]).into())
    }

    #[test]
    fn losses_of_faces_of_any_dip_are_losses() {
        let voxels = |before: &Mesh, after: &Mesh| {
            Voxels::new([Shape::Mesh(before), Shape::Mesh(after)], [&[], &[]], None, 0.08).unwrap()
        };
        for dip_deg in (0..=180).step_by(12).map(f64::from) {
            for azimuth_deg in [25.0, 200.0] {
                for depth in [0.4, -0.4] {
                    let (before, normal) = dipping(0.0, dip_deg, azimuth_deg);
                    let found = voxels(&before, &dipping(depth, dip_deg, azimuth_deg).0).enclosed(&normal).0;
                    let under = found.iter().fold([0; 2], |[a, b], c| [a + c.under[0], b + c.under[1]]);
                    let [right, wrong] = if depth > 0.0 { under } else { [under[1], under[0]] };
                    assert!(right > 100 && wrong * 50 < right, "{dip_deg} {azimuth_deg} {depth}: {under:?}");
                }
            }
        }
    }

    /// A ledge with a roof 0.2 m thick that juts out over its floor, which is lowered by `depth` over [0, 0.3] x [-0.2, 0.2].
    fn overhang(depth: f64) -> Mesh {
        let corners = [[-1.0, 1.0], [0.5, 1.0], [0.5, 0.8], [-0.3, 0.8], [-0.3, 0.0], [1.0, 0.0]];
        let steps = 60;
        let profile: Vec<[f64; 2]> = corners
            .windows(2)
            .flat_map(|ends| {
                (0..steps).map(|step| {
                    [0, 1].map(|k| ends[0][k] + (ends[1][k] - ends[0][k]) * f64::from(step) / f64::from(steps))
                })
            })
            .collect();
        let rows = 81;
        let vertex = |(row, [x, z]): (usize, [f64; 2])| {
            let y = -1.0 + 0.025 * row as f64;
            let lowered = z < 0.01 && (0.0..0.3).contains(&x) && y.abs() < 0.2;
            [x + 0.003, y + 0.007, z + 0.013 - if lowered { depth } else { 0.0 }]
        };
        let vertices = (0..rows).flat_map(|row| profile.iter().map(move |point| (row, *point))).map(vertex).collect();
        let across = profile.len() as u32;
        let quad = |at: u32| [[at, at + 1, at + across + 1], [at, at + across + 1, at + across]];
        let cells = (0..rows as u32 - 1).flat_map(|row| (0..across - 1).map(move |column| row * across + column));
        let frame = rockface_core::artefact::Frame::Wall;
        Mesh { frame, vertices, triangles: cells.flat_map(quad).collect(), colours: Vec::new() }
    }

    #[test]
    fn what_falls_from_under_an_overhang_is_a_loss() {
        let (before, after) = (overhang(0.0), overhang(0.3));
        let found = clusters(&before, &after);
        assert_eq!(found.len(), 1);
        let cluster = &found[0];
        let volume = 1.25e-4 * (cluster.inside.len() as f64 + 0.5 * cluster.shell as f64);
        assert!((volume / (0.3 * 0.4 * 0.3) - 1.0).abs() < 0.25, "{volume}");
        assert_eq!(cluster.under, [cluster.inside.len(), 0]);
        assert_eq!(clusters(&after, &before)[0].under, [0, cluster.inside.len()]);
    }

    #[test]
    fn a_box_is_counted_voxel_by_voxel() {
        let cuboid = rockface_rock::rockfall::ground_truth::Facets::cuboid(0.92, 0.72, 0.52);
        let moved = cuboid.moved(|p| p + Vector3::repeat(0.04));
        let mesh = Mesh {
            frame: rockface_core::artefact::Frame::Wall,
            vertices: moved.vertices,
            triangles: moved.triangles,
            colours: Vec::new(),
        };
        let voxels = Voxels::new([Shape::Mesh(&mesh), Shape::Mesh(&mesh)], [&[], &[]], None, 0.1).unwrap();
        // 10 x 8 x 6 voxels meet the box; all but the outer layer are inside it.
        let shell = 10 * 8 * 6 - 8 * 6 * 4;
        assert_eq!(voxels.occupied(), [shell; 3]);
        let found = voxels.enclosed(&Vector3::z()).0;
        assert_eq!((found.len(), found[0].inside.len(), found[0].shell), (1, 8 * 6 * 4, shell));
        assert_eq!(found[0].under, [0, 0]);
    }

    #[test]
    fn a_triangle_meets_the_cubes_it_passes_and_no_other() {
        let slanted = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]];
        assert!(meets(&slanted, [0.5, 0.5, 0.4]) && meets(&slanted, [1.4, 1.4, 0.0]));
        assert!(!meets(&slanted, [1.6, 1.6, 0.0]) && !meets(&slanted, [0.5, 0.5, 0.6]));
        assert!(meets(&slanted, [2.5, 0.0, 0.0]) && !meets(&slanted, [2.6, 0.0, 0.0]));
    }

    #[test]
    fn too_many_voxels_and_no_points_are_refused() {
        let plane = niche(0.0);
        let shape = Shape::Mesh(&plane);
        assert!(
            Voxels::new([shape, shape], [&[], &[]], None, 1e-5).err().unwrap().message.contains("voxels of 0.00001 m")
        );
        let empty = Mesh { vertices: Vec::new(), triangles: Vec::new(), ..plane.clone() };
        assert!(Voxels::new([Shape::Mesh(&empty), Shape::Mesh(&empty)], [&[], &[]], None, 0.1).is_err());
    }

    #[test]
    fn a_value_that_is_no_height_is_refused() {
        let (near, mut far) = (niche(0.2), niche(0.2));
        far.vertices.iter_mut().for_each(|vertex| vertex[2] = -3.4e38);
        let error = Voxels::new([Shape::Mesh(&near), Shape::Mesh(&far)], [&[], &[]], None, 0.05).err().unwrap();
        assert!(error.message.contains("3.4e38") && error.hint.unwrap().contains("no-data"), "{}", error.message);
        let error = Voxels::new([Shape::Mesh(&far), Shape::Mesh(&far)], [&[], &[]], None, 0.05).err().unwrap();
        assert!(error.message.contains("3.4e38"));
    }
}
