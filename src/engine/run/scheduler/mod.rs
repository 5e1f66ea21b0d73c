//! The scheduler: decides when each step instance runs, and holds the values between steps.

mod exchange;
mod expand;
mod memory;
mod progress;
mod remake;
mod rss;
mod schedule;
mod spill;
mod state;
mod transitions;

pub use schedule::run;
pub use spill::Spilled;
