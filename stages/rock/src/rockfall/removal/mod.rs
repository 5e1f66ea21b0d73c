//! Takes blocks out of a rock face (Algorithm 1 of the paper): placement, exact Boolean, validity checks, mesh update.
//!
//! `face` is the mesh under change and `patch` what is copied from it around a block, finer after `refine`. `sites` says
//! where candidates stand and `source` makes them, `frame`, `search` and `place` how they are turned and how deep they
//! sit. `boolean` combines patch and block, `cut` makes pieces and niches of that with `weld`, `measure` and `groups`;
//! `topology` and `zone` judge it. `evaluate` does all of that for one candidate, `attempts` is the loop, `tables` lists what
//! became of them.

pub mod attempts;
pub mod boolean;
pub mod cut;
pub mod evaluate;
pub mod face;
pub mod frame;
pub mod measure;
pub mod patch;
pub mod place;
pub mod reason;
pub mod refine;
pub mod search;
pub mod sites;
pub mod source;
pub mod tables;
pub mod topology;
pub mod weld;
pub mod zone;
