//! Bundle block adjustment before any image is taken: what orientation a planned block will have, and with what errors.
//!
//! | file | what |
//! |---|---|
//! | `partials.rs` | derivatives of a pixel by orientation and object point |
//! | `tie_points.rs` | object points on a face and the images that see them |
//! | `unknowns.rs` | which parameters are estimated, in canonical order |
//! | `normals.rs` | normal equations with the object points eliminated (Schur complement) |
//! | `datum.rs` | the seven ways a block moves as a whole, and inner constraints |
//! | `inverse.rs` | their inverse, or the directions that are free |
//! | `propagation.rs` | what orientation errors do to a pair: depth and y-parallax, first order |

#[cfg(test)]
mod block_tests;
pub mod datum;
pub mod inverse;
#[cfg(test)]
mod monte_carlo_tests;
pub mod normals;
pub mod partials;
pub mod propagation;
pub mod tie_points;
pub mod unknowns;
