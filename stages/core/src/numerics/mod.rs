//! Numbers: random fields, transforms, quantiles, and arithmetic with the same bits on every machine.

pub mod fast_round;
pub mod fft;
pub mod gaussian;
pub mod linear_fit;
pub mod marginal;
pub mod portable_math;
pub mod quantile;
pub mod random;
pub mod simd;
pub mod union_find;
