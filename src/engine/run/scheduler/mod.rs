//! The scheduler: decides when each step instance runs, and holds the values between steps.

mod budget;
mod dispatch;
mod exchange;
mod expand;
mod memory;
mod others;
mod phase;
mod progress;
mod recompute;
mod rss;
mod schedule;
mod state;
mod timing;
mod transitions;

pub use schedule::run;
