//! Learns a noise model from differences without change: whitening, bad acquisitions, acquisitions, strength by relief.

pub mod acquisitions;
pub mod bad;
pub mod bends;
pub mod by_place;
pub mod common_share;
pub mod contrast;
pub mod correction;
pub mod departure;
pub mod differences;
pub mod gains;
pub mod parametric;
pub mod registration;
pub mod relief_law;
pub mod repeated;
pub mod trend_weights;
pub mod whitening;
