//! Files of 2 million points: clouds as PLY and LAZ with normals and numbers, surfaces, and the export of a surface as a cloud.

use std::sync::Arc;

use rockface_core::artefact::{Artefact, Cloud, Noun, Surface};
use rockface_core::format::{cloud_las, cloud_laz, ply};
use serde_json::json;

use crate::peer::{Answer, Peer, check};
use crate::row::Row;
use crate::{measure, relief, stages};

/// Points along each side of a surface: 2 million in all.
const SIDE: usize = 1414;

/// Measures and prints the export: points, normals and numbers of a surface, as PLY and as LAZ.
pub fn measure_export() {
    let surface = Arc::new(Artefact::Surface(surface()));
    let peer = Peer::new();
    let ((), cost) = measure::measure(|| {
        let cloud = stages::run("export-cloud", &json!({}), &[("points", &surface)]);
        let Artefact::Cloud(cloud) = &*cloud else { panic!("a cloud") };
        std::fs::write(peer.path("cloud.ply"), cloud.encode().expect("a sound cloud")).expect("a file");
        for export in cloud.exports("cloud").expect("a sound cloud") {
            std::fs::write(peer.path(&export.path), export.bytes).expect("a file");
        }
    });
    Row { what: "surface of 2.0 M points to a cloud with normals, as PLY and LAZ", cost, peer: None, check: "" }
        .print();
}

/// Measures and prints what reading and writing each format costs.
pub fn measure() {
    let surface = surface();
    let artefact = Arc::new(Artefact::Surface(surface.clone()));
    let cloud = stages::run("export-cloud", &json!({}), &[("points", &artefact)]);
    let Artefact::Cloud(cloud) = &*cloud else { panic!("a cloud") };
    let peer = Peer::new();
    peer.give("points.f8", &cloud.points);
    peer.give("normals.f4", &cloud.normals);
    peer.give("ids.u4", &cloud.numbers["id"]);
    for format in [PLY, LAZ] {
        format.measure(cloud, &peer);
    }

    let path = peer.path("ours.surface");
    let write = || std::fs::write(&path, surface.encode().expect("a sound surface")).expect("a file");
    let ((), cost) = measure::measure(write);
    Row { what: "surface of 2.0 M points written", cost, peer: None, check: "" }.print();
    let read = || Surface::decode(&std::fs::read(&path).expect("our file")).expect("our file");
    let (found, cost) = measure::measure(read);
    let check = if found == surface { "read as written, to the bit" } else { "DIFFERS from what was written" };
    Row { what: "surface of 2.0 M points read", cost, peer: None, check }.print();
}

/// A format of clouds.
struct Format {
    extension: &'static str,
    write: fn(&Cloud) -> Vec<u8>,
    read: fn(Vec<u8>) -> Vec<[f64; 3]>,
    /// Works of the peer: writing, reading.
    works: [&'static str; 2],
}

const PLY: Format = Format {
    extension: "ply",
    write: |cloud| ply::cloud::write(cloud).expect("a sound cloud"),
    read: |bytes| ply::cloud::read(&bytes).expect("a sound file").points,
    works: ["ply_write", "ply_read"],
};

const LAZ: Format = Format {
    extension: "laz",
    write: |cloud| cloud_laz::write(cloud).expect("a sound cloud"),
    read: |bytes| cloud_las::read(bytes, &|| false).expect("a sound file").points,
    works: ["las_write", "las_read"],
};

impl Format {
    /// Each side reads what the other wrote.
    fn measure(&self, cloud: &Cloud, peer: &Peer) {
        let [writes, reads] = self.works;
        let name = self.extension.to_uppercase();
        let [ours, theirs] = ["ours", "theirs"].map(|stem| peer.path(&format!("{stem}.{}", self.extension)));
        let write = || std::fs::write(&ours, (self.write)(cloud)).expect("a file");
        let ((), cost) = measure::measure(write);
        let answer = peer.work(writes, &[]);
        let read_theirs = || (self.read)(std::fs::read(&theirs).expect("the file of the peer"));
        let apart = checked(&answer, || greatest_m(&cloud.points, &read_theirs()));
        row(&format!("{name} of 2.0 M points written"), cost, &answer, &apart);
        let read = || (self.read)(std::fs::read(&ours).expect("our file"));
        let (found, cost) = measure::measure(read);
        let answer = peer.work(reads, &[]);
        let apart = checked(&answer, || greatest_m(&found, &peer.take::<[f64; 3]>("read.f8")));
        row(&format!("{name} of 2.0 M points read"), cost, &answer, &apart);
    }
}

fn row(what: &str, cost: measure::Cost, answer: &Answer, check: &str) {
    Row { what, cost, peer: Some(answer), check }.print();
}

fn checked(answer: &Answer, greatest_m: impl FnOnce() -> f64) -> String {
    check(answer, |_| format!("greatest difference {:.0e} m", greatest_m()))
}

/// The greatest difference of two lists of points along an axis, metres.
fn greatest_m(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    assert_eq!(a.len(), b.len(), "numbers of points");
    a.as_flattened().iter().zip(b.as_flattened()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

fn surface() -> Surface {
    relief::surface(&relief::scattered(SIDE, 0.01, 0.002, 5), SIDE, [451_000.0, 5_512_000.0, 300.0])
}
