//! Care of a store: what is in it by stage, whether it is whole, and the removal of what nobody needs.

mod collect;
mod copy;
mod gc;
mod segments;
mod stages;
mod verify;

pub use collect::Collected;
pub use copy::Handed;
pub use gc::{GcItem, GcPlan, GcPolicy};
pub use segments::{HalfWritten, SegmentFault, SegmentFaultKind};
pub use stages::StageStat;
pub use verify::{Fault, FaultKind, Verified};
