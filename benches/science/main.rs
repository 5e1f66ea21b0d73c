//! What the works of the program cost, one row each, beside other programs that do the same where they are installed.
//!
//! `cargo bench --bench science [-- WORK]`; the rows are those of the table in `docs/speed.md`. `benches/peers/requirements.txt` lists
//! the other programs; the variable `ROCKFACE_PEERS_PYTHON` names the Python that has them. Each work runs in a process of its own,
//! so that its memory is its own. A work takes the median of three runs, or one run where that takes ten seconds. Where other
//! programs took much of the processors meanwhile, a line says so: seconds of wall are then too many, those of the processor a little.

mod busy;
mod depth;
mod descriptors;
mod files;
mod icp;
mod m3c2;
mod measure;
mod peer;
mod pipelines;
mod relief;
mod removal;
#[path = "../resident/mod.rs"]
mod resident;
mod row;
mod stages;

use std::process::Command;

use wait4::Wait4;

use busy::Busy;

/// The allocator of the program.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Set in the process that measures a work: its name.
const WORK: &str = "ROCKFACE_BENCH_WORK";

/// Every work by name, and what measures it and prints its rows.
const WORKS: [(&str, fn()); 10] = [
    ("depth map", depth::measure),
    ("removal", removal::measure),
    ("descriptors", descriptors::measure),
    ("variogram", descriptors::measure_variogram),
    ("M3C2", m3c2::measure),
    ("ICP", icp::measure),
    ("export", files::measure_export),
    ("read and write", files::measure),
    ("quickstart", pipelines::measure_quickstart),
    ("hunter-valley", pipelines::measure_hunter_valley),
];

fn main() {
    rockface::memory::keep_freed();
    if let Ok(work) = std::env::var(WORK) {
        let (_, measure) = WORKS.iter().find(|(name, _)| *name == work).expect("a work of the list");
        return measure();
    }
    let wanted = std::env::args().skip(1).find(|word| !word.starts_with('-')).unwrap_or_default().to_lowercase();
    row::print_head();
    for (name, _) in WORKS.iter().filter(|(name, _)| name.to_lowercase().contains(&wanted)) {
        let program = std::env::current_exe().expect("this program");
        let busy = Busy::now();
        let mut child = Command::new(program).env(WORK, name).spawn().expect("a process");
        let ended = child.wait4().expect("the end of the process");
        assert!(ended.status.success(), "`{name}` ended with {}", ended.status);
        busy.warn(name, ended.rusage.utime + ended.rusage.stime);
    }
}
