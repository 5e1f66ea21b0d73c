//! What real matching noise has beyond the paper's two fields: correlation at short range, deviations that vary over the
//! face and between acquisitions, the matcher's window, blunders and holes; and what judges and steers such a simulation.

pub mod chain;
pub mod classifier;
pub mod correlated;
pub mod detrend;
pub mod envelope;
pub mod matcher;
pub mod modulation;
pub mod moments;
pub mod nested_variogram;
pub mod points;
pub mod robust_variogram;
pub mod sector;
pub mod strength;
pub mod student;
pub mod terms;
pub mod window;
