//! Distances between two clouds along local normals (M3C2), each with its limit of detection.

use nalgebra::Vector3;
use rayon::prelude::*;

use rockface_core::artefact::Grid;
use rockface_core::numerics::simd::{Work, vectorised};

use super::cloud::{Cloud, Cylinder, Stack};
use super::core_cells::CoreCells;
use rockface_core::numerics::normal::NORMAL_95;

/// The most by which an area grows on its way, in size: noise of normals and distances would give a few cells more.
pub const MOST_SHARE: f64 = 3.0;
/// Least sine of the angle at which the lines between neighbours cross in plan: a smaller one tells nothing of an area.
const LEAST_SPREAD: f64 = 0.2;
/// Core points that are one task.
const CORES_AT_A_TIME: usize = 256;

/// The scales of a comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct Scales {
    /// Radii of the spheres normals are taken from, metres; of several, the one whose points are most planar counts.
    pub normal_radii_m: Vec<f64>,
    /// Radius of the cylinders, metres.
    pub projection_radius_m: f64,
    /// Half the length of the cylinders, metres.
    pub depth_m: f64,
    /// Registration error, metres.
    pub registration_m: f64,
    /// Points a cylinder must hold of either cloud.
    pub least_points: u32,
}

/// What is known at a core point. Distances are positive along the normal; NaN where a cylinder holds too few points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Distance {
    /// The core point, metres.
    pub core: [f64; 3],
    /// The unit normal, towards positive Z.
    pub normal: [f64; 3],
    /// Comparison minus reference along the normal, metres.
    pub distance_m: f64,
    /// Limit of detection at 95 %, metres.
    pub limit_m: f64,
    /// Standard deviations along the normal of the reference and the comparison, metres.
    pub spreads_m: [f64; 2],
    /// Points of the reference and the comparison.
    pub points: [f64; 2],
}

/// One core point for each cell: the reference point nearest to its centre in plan; `None` for cells without a point. Its distances from
/// the centre along X and Y, and its Z, are rounded to 32 bits so that they can be kept exactly: map coordinates themselves are too large.
pub fn cores(reference: &Cloud, grid: &Grid) -> Vec<Option<[f64; 3]>> {
    let mut nearest: Vec<Option<(f64, Vector3<f64>)>> = vec![None; grid.cells()];
    for point in reference.points() {
        let Some(cell) = grid.cell_of([point.x, point.y]) else { continue };
        let (x, y) = grid.centre(cell / grid.columns, cell % grid.columns);
        let square = (point.x - x) * (point.x - x) + (point.y - y) * (point.y - y);
        let best = &mut nearest[cell];
        if best.is_none_or(|(least, _)| square < least) {
            *best = Some((square, point));
        }
    }
    let rounded = |value: f64| f64::from(value as f32);
    let core = |(cell, best): (usize, Option<(f64, Vector3<f64>)>)| {
        let (x, y) = grid.centre(cell / grid.columns, cell % grid.columns);
        best.map(|(_, p)| [x + rounded(p.x - x), y + rounded(p.y - y), rounded(p.z)])
    };
    nearest.into_iter().enumerate().map(core).collect()
}

/// Distances at the core points, in their order; `None` where there is no core point or no normal.
///
/// The mean of the points of each cloud within a cylinder along the normal of the reference; the limit is
/// 1.96 (sqrt(s1^2 / n1 + s2^2 / n2) + registration).
///
/// # References
/// Lague, D., Brodu, N., Leroux, J. (2013), Accurate 3D comparison of complex topography with terrestrial laser scanner,
/// ISPRS Journal of Photogrammetry and Remote Sensing 82, 10-26, equation 1.
pub fn distances(clouds: [&Cloud; 2], cores: &[Option<[f64; 3]>], scales: &Scales) -> Vec<Option<Distance>> {
    let work = |cores| vectorised(Distances { clouds, cores, scales });
    cores.par_chunks(CORES_AT_A_TIME).flat_map_iter(work).collect()
}

/// The distances at some core points.
struct Distances<'a> {
    clouds: [&'a Cloud; 2],
    cores: &'a [Option<[f64; 3]>],
    scales: &'a Scales,
}

impl Work for Distances<'_> {
    type Output = Vec<Option<Distance>>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let mut values = Vec::new();
        let mut found = Vec::with_capacity(self.cores.len());
        for core in self.cores {
            let mut best: Option<(Vector3<f64>, f64)> = None;
            if let Some(core) = core {
                for radius_m in &self.scales.normal_radii_m {
                    let next = self.clouds[0].normal(core, *radius_m);
                    best = if best.is_none_or(|best| next.is_some_and(|next| next.1 > best.1)) { next } else { best };
                }
            }
            let normal = best.map(|(normal, _)| <[f64; 3]>::from(normal));
            let Some((core, normal)) = core.zip(normal) else {
                found.push(None);
                continue;
            };
            let Scales { projection_radius_m: radius_m, depth_m: half_m, .. } = *self.scales;
            let cylinder = Cylinder { centre: core, axis: normal, radius_m, half_m };
            let reference = self.clouds[0].along(&cylinder, &mut values);
            let comparison = self.clouds[1].along(&cylinder, &mut values);
            found.push(Some(Distance::of(&cylinder, [reference, comparison], self.scales)));
        }
        found
    }
}

impl Distance {
    /// What the points in a cylinder of either cloud say.
    fn of(cylinder: &Cylinder, stacks: [Stack; 2], scales: &Scales) -> Self {
        let least = f64::from(scales.least_points);
        let enough = stacks.iter().all(|stack| stack.count >= least);
        let share = |place: usize| stacks[place].variance() / stacks[place].count;
        let known = |value: f64| if enough { value } else { f64::NAN };
        Self {
            core: cylinder.centre,
            normal: cylinder.axis,
            distance_m: known(stacks[1].mean - stacks[0].mean),
            limit_m: known(NORMAL_95 * ((share(0) + share(1)).sqrt() + scales.registration_m)),
            spreads_m: stacks.map(|stack| stack.variance().sqrt()),
            points: stacks.map(|stack| stack.count),
        }
    }
}

/// The share by which the area of a cell of the reference changes on its way along the normals, as a mean over the way: 1 where the surfaces are
/// parallel. Times the distance and the area of the cell it is the volume between the surfaces, exactly where positions and distances
/// are linear between neighbours; a flat comparison under a slanted reference has less than the product of both.
///
/// The vector area of the cell at a share `t` of the way is the cross product of differences of neighbours' `core + t distance normal`,
/// quadratic in `t`, so that Simpson's rule is exact.
pub fn area_share(distances: &[Option<Distance>], cell: usize, cells: &CoreCells) -> f64 {
    let known = |cell: usize| distances.get(cell)?.as_ref().filter(|found| !found.distance_m.is_nan());
    let Some(own) = known(cell) else { return 1.0 };
    let around = cells.around(cell).map(|beside| known(beside?));
    // With a neighbour on one side only, the place of the core point in its cell would count.
    let [Some(left), Some(right), Some(above), Some(below)] = around else { return 1.0 };
    let normal = Vector3::from(own.normal);
    let area = |share: f64| {
        let at = |found: &Distance| Vector3::from(found.core) + share * found.distance_m * Vector3::from(found.normal);
        (at(right) - at(left)).cross(&(at(above) - at(below))).dot(&normal)
    };
    let [start, middle, end] = [0.0, 0.5, 1.0].map(area);
    let mean = (start + 4.0 * middle + end) / 6.0;
    // Scattered neighbours may all be about on one line.
    let plan = |one: &Distance, other: &Distance| (Vector3::from(one.core) - Vector3::from(other.core)).xy();
    let (across, along) = (plan(right, left), plan(above, below));
    let has_area = across.perp(&along).abs() > LEAST_SPREAD * across.norm() * along.norm();
    if start > 0.0 && has_area { (mean / start).clamp(-MOST_SHARE, MOST_SHARE) } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::testing::height_mesh;
    use rockface_raster::shape::Shape;

    #[test]
    fn distances_are_the_same_in_map_coordinates() {
        let at = |origin: [f64; 3]| {
            let meshes = [0.0, -0.1].map(|rise| {
                let mut mesh = height_mesh(60, [-1.2, 1.2, -1.2, 1.2], |x, y| 0.2 * x * y + 0.1 * x + rise);
                mesh.vertices.iter_mut().for_each(|vertex| (0..3).for_each(|axis| vertex[axis] += origin[axis]));
                mesh
            });
            let clouds = meshes.each_ref().map(|mesh| Cloud::new(Shape::Mesh(mesh), None, 0.1).unwrap());
            let grid = Grid { left_m: GRID.left_m + origin[0], top_m: GRID.top_m + origin[1], ..GRID };
            let scales = Scales {
                normal_radii_m: vec![0.2],
                projection_radius_m: 0.1,
                depth_m: 0.5,
                registration_m: 0.0,
                least_points: 4,
            };
            distances([&clouds[0], &clouds[1]], &cores(&clouds[0], &grid), &scales)
        };
        let (here, there) = (at([0.0; 3]), at([451_230.0, 5_512_340.0, 700.0]));
        assert!(here.iter().flatten().count() > 90);
        for (here, there) in here.iter().zip(&there) {
            let [here, there] = [here, there].map(|found| found.as_ref().unwrap());
            assert!((here.distance_m - there.distance_m).abs() < 1e-4, "{here:?} and {there:?}");
        }
    }

    const GRID: Grid = Grid { columns: 10, rows: 10, cell_m: 0.2, left_m: -1.0, top_m: 1.0 };

    #[test]
    fn parallel_tilted_planes_are_apart_along_their_normal() {
        let before = height_mesh(80, [-1.2, 1.2, -1.2, 1.2], |x, _| 0.5 * x);
        // Shifted along the normal by 7 cm.
        let rise = 0.07 * (1.0f64 + 0.25).sqrt();
        let after = height_mesh(80, [-1.2, 1.2, -1.2, 1.2], |x, _| 0.5 * x - rise);
        let clouds = [&before, &after].map(|mesh| Cloud::new(Shape::Mesh(mesh), None, 0.1).unwrap());
        let cores = cores(&clouds[0], &GRID);
        assert!(cores.iter().all(Option::is_some));
        let mut scales = Scales {
            normal_radii_m: vec![0.1, 0.3],
            projection_radius_m: 0.1,
            depth_m: 0.5,
            registration_m: 0.002,
            least_points: 4,
        };
        for found in distances([&clouds[0], &clouds[1]], &cores, &scales).into_iter().flatten() {
            assert!((found.distance_m + 0.07).abs() < 2e-3, "{found:?}");
            assert!((found.limit_m - 1.96 * 0.002).abs() < 1e-3 && found.normal[2] > 0.89, "{found:?}");
        }
        scales.least_points = 10_000;
        let none = distances([&clouds[0], &clouds[1]], &cores, &scales);
        assert!(none.iter().flatten().all(|found| found.distance_m.is_nan() && found.points[0] > 10.0));
    }

    /// The share of the middle one of 3 x 3 core points: those to the left and right go apart by a share of their distance on
    /// the way, and the line between the two others is at an angle with this sine to theirs.
    fn middle_share(apart: f64, sine: f64) -> f64 {
        let grid = Grid { columns: 3, rows: 3, cell_m: 1.0, left_m: -1.5, top_m: 1.5 };
        let cosine = (1.0 - sine * sine).sqrt();
        let found = |core: [f64; 3], normal: [f64; 3]| {
            Some(Distance { core, normal, distance_m: apart, limit_m: 0.1, spreads_m: [0.0; 2], points: [9.0; 2] })
        };
        let mut distances = vec![None; 9];
        distances[1] = found([cosine, sine, 0.0], [0.0, 0.0, 1.0]);
        distances[3] = found([-1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]);
        distances[4] = found([0.0; 3], [0.0, 0.0, 1.0]);
        distances[5] = found([1.0, 0.0, 0.0], [1.0, 0.0, 0.0]);
        distances[7] = found([-cosine, -sine, 0.0], [0.0, 0.0, 1.0]);
        let cores: Vec<_> = distances.iter().map(|found| found.as_ref().map(|found| found.core)).collect();
        area_share(&distances, 4, &CoreCells::new(&cores, &grid, 0.5))
    }

    #[test]
    fn an_area_changes_on_its_way_by_no_more_than_three_times() {
        // The width is 1 + t apart of what it was, and the share its mean over t.
        for (apart, share) in [(0.0, 1.0), (2.0, 2.0), (3.9, 2.95), (4.1, 3.0), (-7.9, -2.95), (-8.1, -3.0)] {
            let found = middle_share(apart, 1.0);
            assert!((found - share).abs() < 1e-12, "{apart}: {found}");
        }
    }

    #[test]
    fn neighbours_about_on_one_line_tell_nothing_of_an_area() {
        for (sine, share) in [(0.21, 2.0), (0.19, 1.0)] {
            let found = middle_share(2.0, sine);
            assert!((found - share).abs() < 1e-12, "{sine}: {found}");
        }
    }
}
