//! The face and its rockfalls.

pub mod face;
pub mod rockfall;
