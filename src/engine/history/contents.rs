//! A run as whoever reports it needs it.

use std::path::Path;

use rockface_cache::Store;
use rockface_core::Entry;

use super::Manifest;
use crate::plan::Graph;

/// A run and where its files are.
#[derive(Clone, Copy)]
pub struct RunContents<'a> {
    /// The folder of the run; the paths in the manifest are relative to it.
    pub folder: &'a Path,
    /// What is known of the run.
    pub manifest: &'a Manifest,
    /// The store, for what is not in the folder; without it such things are left out, and the page says so.
    pub store: Option<&'a Store>,
    /// Its steps and how they are connected, where that is known.
    pub graph: Option<&'a Graph>,
    /// What each step instance logged, in the order of the manifest, where that was read already; otherwise the store is asked.
    pub logs: Option<&'a [Vec<Entry>]>,
}
