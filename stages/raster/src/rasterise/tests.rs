//! Tests of the elevation grids: planes, counts, seams, thread counts.

use nalgebra::Vector3;
use proptest::prelude::*;

use super::*;
use crate::plane_fit;
use rockface_core::artefact::{Frame, Mesh, Surface, Transform};
use rockface_core::format::ply;
use rockface_core::numerics::portable_math;

fn mesh(vertices: Vec<[f64; 3]>, triangles: Vec<[u32; 3]>) -> Mesh {
    Mesh { frame: Frame::Wall, vertices, triangles, colours: Vec::new() }
}

/// Irregular triangles over 0..n by 0..n with Z from a function.
fn patch(n: u32, z: impl Fn(f64, f64) -> f64) -> Mesh {
    let wobble = |i: u32, j: u32| if (1..n).contains(&i) { f64::from((i * 7 + j * 13) % 5) * 0.08 } else { 0.0 };
    let place = |i: u32, j: u32| (f64::from(i) + wobble(i, j), f64::from(j) + wobble(j, i));
    let vertex = |k: u32| place(k % (n + 1), k / (n + 1));
    let vertices = (0..(n + 1) * (n + 1)).map(vertex).map(|(x, y)| [x, y, z(x, y)]).collect();
    let corner = |k: u32| k / n * (n + 1) + k % n;
    let cut = |a: u32| [[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]];
    mesh(vertices, (0..n * n).map(corner).flat_map(cut).collect())
}

#[test]
fn a_plane_is_exact_to_single_precision_without_seams() {
    let plane = |x: f64, y: f64| 100.0 + 0.31 * x - 0.17 * y;
    let face = patch(9, plane);
    let grid = grid_of_window([0.0, 9.0, 0.0, 9.0], 0.05).unwrap();
    let values = tin(Shape::Mesh(&face), None, &grid);
    for (cell, value) in values.iter().enumerate() {
        let (x, y) = grid.centre(cell / grid.columns, cell % grid.columns);
        assert!((f64::from(*value) - plane(x, y)).abs() <= 8e-6, "({x}, {y}): {value}");
    }
}

/// The middle of a cell on the edge of two triangles, at any angle: rounding puts it outside of both here and there.
#[test]
fn a_cell_centre_on_the_seam_of_two_triangles_has_a_value_and_one_beside_them_has_none() {
    let grid = grid_of_window([0.3, 0.4, 0.7, 0.8], 0.1).unwrap();
    let (x, y) = grid.centre(0, 0);
    let seam = |step: u32, aside_m: f64| {
        let (sine, cosine) = portable_math::sincos(f64::from(step) * 0.01);
        let at = |along_m: f64, across_m: f64| {
            [x + along_m * cosine - across_m * sine, y + along_m * sine + across_m * cosine, 5.0]
        };
        let vertices = vec![at(-0.3, aside_m), at(0.7, aside_m), at(0.1, 0.9), at(-0.1, -0.9)];
        // Every corner comes first in turn: rounding differs by what the others are measured from.
        let turned = |mut triangle: [u32; 3], by: u32| {
            triangle.rotate_left(by as usize % 3);
            triangle
        };
        let [one, other] = [turned([0, 1, 2], step), turned([1, 0, 3], step / 3)];
        [vec![one, other], vec![one]].map(|triangles| {
            let face = mesh(vertices.clone(), triangles);
            tin(Shape::Mesh(&face), None, &grid)[0]
        })
    };
    for step in 0..600 {
        assert_eq!(seam(step, 0.0)[0], 5.0, "a seam at {step} hundredths of a radian");
        assert!(seam(step, 5e-9)[1].is_nan(), "a few nanometres beside the edge, at {step}");
    }
}

#[test]
fn a_grid_of_too_many_cells_is_refused_with_its_size_and_ways_out() {
    let told = grid_of_window([0.0, 20.0, 0.0, 10.0], 0.001).unwrap_err().message;
    assert!(told.contains("2.000e4 columns and 1.000e4 rows of 1.000e-3 m"), "{told}");
    assert!(told.contains("more than 1.5e8 cells"), "{told}");
    assert!(told.contains("`unit_m`") && told.contains("`min_piece_triangles`"), "{told}");
    assert!(grid_of_window([0.0, 15.0, 0.0, 10.0], 0.001).is_ok(), "as many as it may have");
    assert!(grid_of_window([0.0, 0.0, 0.0, 10.0], 1.0).unwrap_err().message.contains("has none"));
}

#[test]
fn the_highest_of_several_layers_wins_and_walls_cover_nothing() {
    let square = |z: f64| [[0.0, 0.0, z], [1.0, 0.0, z], [1.0, 1.0, z], [0.0, 1.0, z]];
    let vertices: Vec<_> = [square(1.0), square(3.0), square(2.0)].concat();
    let layer = |k: u32| [[k, k + 1, k + 2], [k, k + 3, k + 2]];
    let mut triangles: Vec<_> = [layer(0), layer(4), layer(8)].concat();
    triangles.push([0, 1, 5]);
    let face = mesh(vertices, triangles);
    let grid = grid_of_window([0.0, 2.0, 0.0, 1.0], 0.25).unwrap();
    let values = tin(Shape::Mesh(&face), None, &grid);
    assert!(values.chunks(8).all(|row| row[..4].iter().all(|z| *z == 3.0) && row[4..].iter().all(|z| z.is_nan())));
}

#[test]
fn cells_with_too_few_points_have_no_mean() {
    let vertices = vec![[0.1, 0.1, 1.0], [0.2, 0.3, 2.0], [0.4, 0.9, 6.0], [1.5, 0.5, 4.0], [9.0, 9.0, 9.0]];
    let face = mesh(vertices, Vec::new());
    let grid = grid_of_window([0.0, 2.0, 0.0, 1.0], 1.0).unwrap();
    let values = mean(Shape::Mesh(&face), None, &grid, 2);
    assert_eq!(values[0], 3.0);
    assert!(values[1].is_nan());
    assert_eq!(mean(Shape::Mesh(&face), None, &grid, 1), [3.0, 4.0]);
}

#[test]
fn empty_places_of_a_surface_count_nothing() {
    let points = vec![[0.5, 0.5, 1.0], [f32::NAN; 3], [0.6, 0.5, 3.0], [f32::NAN; 3]];
    let squares = vec![0];
    let surface = Surface { frame: Frame::Wall, width: 2, height: 2, origin_m: [10.0, 0.0, 0.0], points, squares };
    let extent = extent(Shape::Surface(&surface), None).unwrap();
    let grid = grid_around(extent, 1.0).unwrap();
    assert_eq!((grid.left_m, grid.top_m, grid.columns, grid.rows), (10.0, 1.0, 1, 1));
    assert_eq!(mean(Shape::Surface(&surface), None, &grid, 2), [2.0]);
}

#[test]
fn the_bytes_do_not_depend_on_the_number_of_threads() {
    let face = patch(150, |x, y| (x * 0.37).fract() * 2.0 + (y * 0.11).fract());
    let grid = grid_of_window([0.0, 150.0, 0.0, 150.0], 0.7).unwrap();
    let at = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let bits = |values: Vec<f32>| values.into_iter().map(f32::to_bits).collect::<Vec<_>>();
        let shape = Shape::Mesh(&face);
        pool.install(|| (bits(tin(shape, None, &grid)), bits(mean(shape, None, &grid, 1))))
    };
    assert_eq!(at(1), at(3));
}

/// A real cliff before and after the removal of a closed block, all seen along the normal of the wall.
///
/// The source's own volume of the block, 14.903 m3, is the oracle. Where a roof of rock hides the niche from above, the
/// highest layer does not change: there the thickness of the block itself stands in for the difference.
#[test]
fn the_difference_of_two_epochs_holds_the_volume_of_the_block() {
    let read = |name: &str| {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data/faces/");
        std::fs::read(format!("{folder}cliff_trier_{name}.ply")).map(|bytes| ply::read_mesh(&bytes).unwrap())
    };
    let (Ok(mut before), Ok(mut after), Ok(mut block)) = (read("wall_pre"), read("wall_post"), read("block")) else {
        println!("skipped: the cliff is absent");
        return;
    };
    let plane = plane_fit::fit_plane(&before).unwrap();
    let outward = plane.normal * plane.normal.dot(&plane.mean_normal).signum();
    let (axes, _) = plane_fit::wall_axes(&outward, &Vector3::z(), &Vector3::y()).unwrap();
    let moved = Moved::by(&Transform::new("world", "wall", &axes, plane.centroid, Vector3::zeros())).unwrap();
    for mesh in [&mut before, &mut after, &mut block] {
        mesh.vertices.iter_mut().for_each(|v| *v = moved.apply(*v));
    }
    let grid = grid_around(extent(Shape::Mesh(&block), None).unwrap(), 0.02).unwrap();
    let elevations = |mesh: &Mesh| tin(Shape::Mesh(mesh), None, &grid);
    let mirrored = Mesh { vertices: block.vertices.iter().map(|v| [v[0], v[1], -v[2]]).collect(), ..block.clone() };
    let thickness: Vec<f32> = elevations(&block).into_iter().zip(elevations(&mirrored)).map(|(t, b)| t + b).collect();
    let lost: Vec<f32> = elevations(&before).into_iter().zip(elevations(&after)).map(|(a, b)| a - b).collect();
    let volume = |cells: &mut dyn Iterator<Item = f32>| {
        cells.filter(|d| !d.is_nan()).map(f64::from).sum::<f64>() * grid.cell_m * grid.cell_m
    };
    let whole = volume(&mut thickness.iter().copied());
    let seen = volume(&mut lost.iter().copied());
    let hidden = volume(&mut thickness.iter().zip(&lost).filter(|(_, d)| d.abs() < 0.01).map(|(t, _)| *t));
    assert!((whole - 14.903).abs() < 0.1, "{whole} m3");
    assert!((seen + hidden - 14.903).abs() < 0.1, "{seen} + {hidden} m3");
}

proptest! {
    #[test]
    fn every_point_has_a_cell_in_the_grid_around_them(
        points in prop::collection::vec([-50.0f64..50.0, -50.0f64..50.0, -1.0f64..1.0], 1..30), cell_m in 0.01f64..3.0) {
        let cloud = mesh(points.clone(), Vec::new());
        let grid = grid_around(extent(Shape::Mesh(&cloud), None).unwrap(), cell_m).unwrap();
        prop_assert!(points.iter().all(|p| (place(&grid, *p).0 as usize) < grid.cells()));
    }

    #[test]
    fn cells_of_many_points_are_those_of_each(
        points in prop::collection::vec([-3.0f32..9.0, -3.0f32..9.0, -1.0f32..1.0], 1..600), holes in any::<u64>(),
        turn in prop::option::of(-1.0..1.0f64), first in 0usize..20) {
        // Some on the very edges of cells, some places without a point.
        let round = |(i, [x, y, z]): (usize, [f32; 3])| if i.is_multiple_of(3) { [x.round(), y.round(), z] } else { [x, y, z] };
        let empty = |i: usize| i.is_multiple_of(5) && holes >> (i % 64) & 1 == 1;
        let points: Vec<[f32; 3]> = points.into_iter().enumerate().map(round).collect();
        let points: Vec<_> = points.into_iter().enumerate().map(|(i, p)| if empty(i) { [f32::NAN; 3] } else { p }).collect();
        let surface =
            Surface { frame: Frame::Wall, width: points.len(), height: 1, origin_m: [1.0, 0.0, 2.0], points, squares: vec![] };
        let rotation = nalgebra::Rotation3::from_euler_angles(0.1, 0.0, turn.unwrap_or(0.0)).into_inner();
        let transform = Transform::new("wall", "wall", &rotation, Vector3::zeros(), Vector3::new(0.1, 0.2, 0.3));
        let moved = turn.and_then(|_| Moved::by(&transform));
        let grid = grid_of_window([0.0, 6.0, 0.0, 5.0], 0.5).unwrap();
        let mut found = cells::Cells::default();
        let first = first.min(surface.points.len());
        found.find(Shape::Surface(&surface), moved.as_ref(), &grid, [first, surface.points.len()]);
        for (i, found) in (first..).zip(found.cell.iter().zip(&found.z_m)) {
            let (cell, z_m) = place(&grid, Shape::Surface(&surface).point(i, moved.as_ref()));
            prop_assert_eq!((*found.0, found.1.to_bits()), (cell, z_m.to_bits()), "{}", i);
        }
        prop_assert_eq!(found.cell.len(), surface.points.len() - first);
    }
}
