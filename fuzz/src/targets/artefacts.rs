//! Artefacts as the store keeps them, and their sketches.

use std::path::{Component, Path};

use rockface_core::artefact::sketch::Shape;
use rockface_core::artefact::{Artefact, Export, Kind, Shown};

use super::Verdict;

/// Reads an artefact, as it comes from the store or from a program of a pipeline, and puts it to use.
pub fn kept(kind: Kind, bytes: &[u8]) -> Verdict {
    Artefact::decode(kind, bytes).map_or(Verdict::Refused, |artefact| used(&artefact))
}

/// Does with an artefact what a run does with it: it is written, read back, exported, sketched and shown.
pub fn used(artefact: &Artefact) -> Verdict {
    let Ok(written) = artefact.encode() else { return Verdict::Refused };
    let again = Artefact::decode(artefact.kind(), &written).expect("what was written can be read");
    let twice = again.encode().expect("what was read can be written");
    assert!(twice == written, "equal values have equal bytes");
    assert_eq!(again.items(), artefact.items(), "the items come back");
    let _ = artefact.memory_bytes();
    artefact.exports("stem").into_iter().flatten().for_each(|export| check_place(&export));
    shown(artefact);
    Verdict::Accepted
}

/// An export goes below the folder of its artefact.
fn check_place(export: &Export) {
    let inside = Path::new(&export.path).components().all(|part| matches!(part, Component::Normal(_)));
    assert!(inside && !export.path.is_empty(), "`{}` leads out of the run folder", export.path);
}

fn shown(artefact: &Artefact) {
    let shown = rockface_stages::registry()
        .look()
        .sketches(artefact)
        .into_iter()
        .map(|sketch| Shown { port: "out".into(), sketch })
        .collect::<Vec<_>>();
    if let Ok(bytes) = Shown::write_all(&shown) {
        Shown::read_all(&bytes).expect("what was sketched can be read");
    }
    let _ = rockface_stages::registry().look().preview(artefact, &[]);
}

/// Reads sketches and their pictures, as logs and reports do.
pub fn sketches(bytes: &[u8]) -> Verdict {
    let Ok(shown) = Shown::read_all(bytes) else { return Verdict::Refused };
    for one in &shown {
        if let Shape::Picture(picture) = &one.sketch.shape {
            drop(picture.pixels());
        }
    }
    if let Ok(written) = Shown::write_all(&shown) {
        let again = Shown::read_all(&written).expect("what was written can be read");
        assert_eq!(again.len(), shown.len(), "every sketch comes back");
    }
    Verdict::Accepted
}
