//! Previews and sketches of artefacts, for logs and reports.

pub mod preview;
pub mod sketch;

use rockface_core::Look;
use rockface_core::artefact::{Artefact, Preview, Sketch};

/// Draws every kind of artefact that can be seen.
#[derive(Debug)]
pub struct Drawn;

impl Look for Drawn {
    fn sketches(&self, artefact: &Artefact) -> Vec<Sketch> {
        sketch::of(artefact)
    }

    fn preview(&self, artefact: &Artefact, beside: &[&Artefact]) -> Option<Preview> {
        preview::of(artefact, beside)
    }
}
