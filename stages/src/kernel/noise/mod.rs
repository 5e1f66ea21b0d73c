//! What real matching noise has beyond the paper's two fields: correlation at short range, deviations that vary over the
//! face and between acquisitions, the matcher's window, blunders and holes; and what judges and steers such a simulation.

pub mod correlated;
pub mod matcher;
pub mod modulation;
pub mod terms;
pub mod window;
