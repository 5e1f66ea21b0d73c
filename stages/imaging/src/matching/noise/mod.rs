//! Matching noise: the two components of the paper, and terms that real matchers have beyond them.

pub mod changed_face;
pub mod contrast;
pub mod correlated;
pub mod ensemble;
pub mod lately;
pub mod learnt;
pub mod matcher;
pub mod model;
pub mod model_draws;
pub mod modulation;
pub mod paper;
pub mod parametric;
pub mod sharing;
pub mod skewness;
pub mod spline;
pub mod strength;
pub mod student;
pub mod terms;
pub mod window;
