//! The resident memory of this process, as Linux tells it.

/// The greatest resident memory counts from here on.
///
/// # Errors
/// Another system, or one that does not let it.
pub fn forget_peak() -> std::io::Result<()> {
    std::fs::write("/proc/self/clear_refs", "5")
}

/// What a line of the system's report says, now (`VmRSS`) or at most (`VmHWM`), bytes; `None` where there is none.
pub fn bytes(line: &str) -> Option<u64> {
    rockface_engine::run::process_bytes("self", line)
}
