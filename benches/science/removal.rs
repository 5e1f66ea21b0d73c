//! A hundred blocks out of faces of 1.3 and 5.2 million triangles: a block costs the same in both.

use std::convert::Infallible;

use rockface_core::artefact::{Frame, Mesh, Part};
use rockface_core::numerics::random::Key;
use rockface_rock::rockfall::block::hull::hull;
use rockface_rock::rockfall::removal::attempts::{Outcome, Plan, run};
use rockface_rock::rockfall::removal::cut::Least;
use rockface_rock::rockfall::removal::evaluate::{Direction, Rules};
use rockface_rock::rockfall::removal::face::Face;
use rockface_rock::rockfall::removal::search::NicheArea;
use rockface_rock::rockfall::removal::sites::Sites;
use rockface_rock::rockfall::removal::source::{Blocks, Source};

use crate::peer::{Answer, Peer, check};
use crate::row::Row;
use crate::{measure, relief};

/// Distance between vertices, metres.
const SPACING_M: f64 = 0.02;

/// Measures and prints both rows; the peer takes the blocks out of the large face.
pub fn measure() {
    let parts: Vec<Part> = (0..20).map(block).collect();
    for (triangles, has_peer) in [(1_300_000u32, false), (5_200_000, true)] {
        let mesh = face(f64::from(triangles / 2).sqrt() as u32);
        let (outcome, cost) = measure::measure(|| remove(&mesh, &parts));
        let removed_m3: f64 = outcome.events.iter().flat_map(|e| &e.proposal.pieces).map(|piece| piece.volume_m3).sum();
        let answer = has_peer.then(|| by_peer(&mesh, &outcome));
        let differs = |theirs_m3: f64| {
            format!(
                "{removed_m3:.4} m³ removed, peer {theirs_m3:.4} m³ by the same blocks; ours finds their places too"
            )
        };
        let check = answer.as_ref().map(|answer| check(answer, |done| differs(done.number("removed_m3"))));
        let what = format!(
            "removal of {} blocks ({} tried), {:.1} M triangles",
            outcome.events.len(),
            outcome.attempts.len(),
            mesh.triangles.len() as f64 / 1e6
        );
        Row { what: &what, cost, peer: answer.as_ref(), check: &check.unwrap_or_default() }.print();
    }
}

fn remove(mesh: &Mesh, parts: &[Part]) -> Outcome {
    let sites = Sites::on_face(mesh).expect("the face looks outward");
    let mut source = Source::new(Blocks::Given(parts), Some(sites), mesh, Key([7; 32]));
    let face = Face::new(mesh.vertices.clone(), mesh.triangles.clone());
    let plan = Plan { count: 100, most_failures: 1000, spacing_m: 0.0, buffer_m: 0.0 };
    let next = || Ok::<_, Infallible>(source.take().expect("the blocks are sound"));
    let Ok(outcome) = run(face, Vec::new(), &rules(), &plan, next, || false);
    outcome
}

fn by_peer(mesh: &Mesh, outcome: &Outcome) -> Answer {
    let peer = Peer::new();
    let blocks: Vec<_> = outcome.events.iter().map(|event| &event.proposal.block).collect();
    let counts: Vec<[u32; 2]> = blocks.iter().map(|b| [b.vertices.len() as u32, b.triangles.len() as u32]).collect();
    peer.give("vertices.f8", &mesh.vertices);
    peer.give("triangles.u4", &mesh.triangles);
    peer.give("blocks.u4", &counts);
    peer.give("block_vertices.f8", &blocks.iter().flat_map(|block| block.vertices.clone()).collect::<Vec<_>>());
    peer.give("block_triangles.u4", &blocks.iter().flat_map(|block| block.triangles.clone()).collect::<Vec<_>>());
    peer.work("removal", &[("block_cpu_s", "one after the other, CPU a block")])
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

fn face(side: u32) -> Mesh {
    let at = |n: u32| f64::from(n) * SPACING_M;
    let row = |r: u32| (0..=side).map(move |c| [at(c), at(r), relief::height(at(c), at(r))]);
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
