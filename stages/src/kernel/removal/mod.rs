//! Takes blocks out of a rock face (Algorithm 1 of the paper): placement, exact Boolean, validity checks, mesh update.
//!
//! `face` is the mesh under change, `patch` what is copied from it around a block, `boolean` the Boolean of that with the
//! block, `cut` what it removes and leaves.

pub mod boolean;
pub mod cut;
pub mod face;
pub mod groups;
pub mod measure;
pub mod patch;
pub mod topology;
