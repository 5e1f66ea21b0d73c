//! Data sets for training: tiles cut out of comparisons, their split and balance, and the files they are handed over in.
//!
//! `tiles` cuts, `split` says which tiles are for training, validation and test, `npz` writes NumPy archives, `catalogue`
//! a STAC catalogue, `card` the data set card, `checksums` the list of SHA-256 sums, `outlines` says how finely a truth is drawn.

pub mod card;
pub mod catalogue;
pub mod checksums;
pub mod npz;
pub mod outlines;
pub mod split;
pub mod tiles;

// A new stage is its file, its `mod` here and its row below.
mod export_dataset;

use rockface_core::{AnyStage, Row};

/// The stages of this room, in the order of the catalogue.
pub static STAGES: &[&dyn AnyStage] = &[&Row::<export_dataset::ExportDataset>::new()];
