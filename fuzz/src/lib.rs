//! Fuzzing of everything rockface reads: one target for each format, and a driver that gives them damaged files.
//!
//! A target is a plain function of bytes. It may refuse them; it must not panic, abort, hang or take more memory than
//! [`guard::MEMORY_BYTES`]. What it accepts it also puts to use, as a run would, and what it can write must come back
//! equal. `README.md` says how to run it all.

pub mod corpus;
pub mod driver;
pub mod guard;
pub mod mutate;
pub mod parts;
pub mod seeds;
pub mod shrink;
pub mod targets;
pub mod words;

pub use targets::{ALL, Target, Verdict, find};
