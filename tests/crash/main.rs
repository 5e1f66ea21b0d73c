//! Crashes: every system call of a run fails or is its last, unsynced writes are lost, disks fill, two runs kill each other.
//!
//! A small library in C (`shim.c`) is loaded into the real program and makes the n-th of its system calls fail, or records
//! them all. Every scene ends in the same way: the next run succeeds with the same bytes, and the store is whole.
//!
//! ```text
//! cargo test --test crash                                  a sample, some seconds
//! ROCKFACE_SLOW=1 cargo test --test crash -- --nocapture   every call, some minutes, with tables of what happened
//! CRASH_ONLY='first run/kill/17' cargo test --test crash   one fault of the campaign: scene, fault (`+`: from then on), call
//! CRASH_FAULTS=1000 cargo test --test crash faults         as many, drawn from all
//! CRASH_CUT=14 cargo test --test crash                     one power cut
//! ```
//!
//! What a machine does not have is skipped with the reason: `cc` for the library, root for file systems that fill up.

mod disk;
mod faults;
mod full;
mod kills;
mod place;
mod power;
mod shim;

/// Whether the long form of a test is wanted.
fn slow() -> bool {
    std::env::var_os("ROCKFACE_SLOW").is_some()
}

/// A congruential sequence: numbers without a pattern, the same every time.
struct Draws(u64);

impl Draws {
    /// A number below `limit`.
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % limit
    }

    /// True as often as `tenths` of ten.
    fn chance(&mut self, tenths: u64) -> bool {
        self.below(10) < tenths
    }
}
