//! Cost of taking blocks out of faces of 0.3, 1.5 and 5 million triangles: `cargo bench -p rockface-stages --bench removal`.
//!
//! A block should cost the same in all three, and a hundred out of the largest less than 20 s with two threads.

use std::convert::Infallible;
use std::time::Instant;

use rockface_core::artefact::{Frame, Mesh, Part};
use rockface_core::numerics::random::Key;
use rockface_rock::rockfall::block::hull::hull;
use rockface_rock::rockfall::removal::attempts::{Plan, run};
use rockface_rock::rockfall::removal::cut::Least;
use rockface_rock::rockfall::removal::evaluate::{Direction, Rules};
use rockface_rock::rockfall::removal::face::Face;
use rockface_rock::rockfall::removal::search::NicheArea;
use rockface_rock::rockfall::removal::sites::Sites;
use rockface_rock::rockfall::removal::source::{Blocks, Source};

/// Distance between vertices, metres.
const SPACING_M: f64 = 0.02;

fn main() {
    for triangles in [300_000u32, 1_500_000, 5_000_000] {
        let side = f64::from(triangles / 2).sqrt() as u32;
        measure(&face(side));
    }
}

fn measure(mesh: &Mesh) {
    let parts: Vec<Part> = (0..20).map(block).collect();
    let sites = Sites::on_face(mesh).expect("the face looks outward");
    let mut source = Source::new(Blocks::Given(&parts), Some(sites), mesh, Key([7; 32]));
    let clock = Instant::now();
    let face = Face::new(mesh.vertices.clone(), mesh.triangles.clone());
    let indexed = clock.elapsed();
    let plan = Plan { count: 100, most_failures: 1000, spacing_m: 0.0, buffer_m: 0.0 };
    let next = || Ok::<_, Infallible>(source.take().expect("the blocks are sound"));
    let Ok(outcome) = run(face, Vec::new(), &rules(), &plan, next, || false);
    let removing = clock.elapsed().saturating_sub(indexed);
    let (tried, events) = (outcome.attempts.len(), outcome.events.len());
    println!(
        "{} triangles: index {indexed:.2?}, {events} blocks of {tried} candidates in {removing:.2?}, {:.1} ms a candidate",
        mesh.triangles.len(),
        removing.as_secs_f64() * 1e3 / tried as f64
    );
}

fn rules() -> Rules<'static> {
    Rules {
        direction: Direction::LocalNormal,
        border: true,
        zone: None,
        overlap_rings: Some(1),
        non_manifold: true,
        holes: true,
        self_intersection: true,
        isolated: true,
        least: Least { volume_m3: 1e-3, size_m: 0.0, depth_m: 0.02, whole_block: false },
        most_volume: 0.98,
        most_shift_m: 0.02,
        refine_edge_m: None,
        niche_area: NicheArea::Projected,
    }
}

/// A wall of ridges, ledges and bumps, all of straight pieces.
fn face(side: u32) -> Mesh {
    let tooth = |t: f64| 1.0 - 2.0 * ((t - t.floor()) - 0.5).abs();
    let z = |x: f64, y: f64| {
        0.5 * tooth(0.31 * x + 0.2 * y) + 0.15 * tooth(1.3 * y - 0.7 * x) + 0.02 * tooth(7.1 * x + 5.3 * y)
    };
    let at = |n: u32| f64::from(n) * SPACING_M;
    let row = |r: u32| (0..=side).map(move |c| [at(c), at(r), z(at(c), at(r))]);
    let square = |r: u32, c: u32| {
        let a = r * (side + 1) + c;
        [[a, a + 1, a + side + 2], [a, a + side + 2, a + side + 1]]
    };
    Mesh {
        frame: Frame::Wall,
        vertices: (0..=side).flat_map(row).collect(),
        triangles: (0..side).flat_map(|r| (0..side).flat_map(move |c| square(r, c))).collect(),
        colours: Vec::new(),
    }
}

/// The hull of 40 points in an ellipsoid of about half a metre.
fn block(number: u32) -> Part {
    let field = Key([number as u8; 32]).field();
    let point = |n: i32| {
        let ([x, y], [z, _]) = (field.normals(n, 0), field.normals(n, 1));
        let scale = 0.25 / (x * x + y * y + z * z).sqrt();
        [1.4 * scale * x, scale * y, 0.8 * scale * z]
    };
    let solid = hull(&(0..40).map(point).collect::<Vec<_>>()).expect("points in space have a hull");
    let class = "hull".to_owned();
    Part { name: number.to_string(), class, vertices: solid.vertices, triangles: solid.triangles }
}
