//! The graph of a run, each step with what became of it.

use crate::history::Manifest;

/// The picture, where it can be drawn.
pub fn svg(_manifest: &Manifest) -> Option<String> {
    None
}
