//! Numbers: random fields, transforms, quantiles, distributions, fits, and arithmetic with the same bits on every machine.

pub mod bands;
pub mod beta;
pub mod fast_round;
pub mod fft;
pub mod gaussian;
pub mod golden_section;
pub mod held_out;
pub mod linear_fit;
pub mod logistic;
pub mod marginal;
pub mod normal;
pub mod portable_math;
pub mod proportion;
pub mod quantile;
pub mod random;
pub mod simd;
pub mod trend;
pub mod union_find;
