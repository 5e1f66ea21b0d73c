//! What was built, by which compiler, from which dependencies: for the manifests of runs.

use std::os::unix::fs::MetadataExt;

use rockface_cache::Digest;
use serde_json::{Value, json};

/// The lock file this program was built with.
const LOCK: &str = include_str!("../../Cargo.lock");

/// The version, with the commit of the sources where the build knew it.
pub const TEXT: &str = env!("ROCKFACE_VERSION");

/// Version, compiler, target and lock file of this program, and the features of the processor it runs on.
pub fn program() -> Value {
    json!({
        "rockface": env!("CARGO_PKG_VERSION"),
        "source": TEXT,
        "compiler": env!("ROCKFACE_COMPILER"),
        "target": env!("ROCKFACE_TARGET"),
        "cargo_lock_blake3": Digest::of(LOCK.as_bytes()),
        "cpu_features": cpu_features(),
        "os": std::env::consts::OS,
    })
}

/// What tells this very program file from any other build, without reading it; `None` where that cannot be found out.
pub fn state_of_program() -> Option<String> {
    let path = std::env::current_exe().ok()?;
    let meta = std::fs::metadata(&path).ok()?;
    let times = [meta.mtime(), meta.mtime_nsec(), meta.ctime(), meta.ctime_nsec()];
    let path = path.as_os_str().as_encoded_bytes();
    Some(format!("{path:?} {} {} {} {times:?}", meta.len(), meta.dev(), meta.ino()))
}

#[cfg(target_arch = "x86_64")]
fn cpu_features() -> Vec<&'static str> {
    let known = [
        ("sse4.2", is_x86_feature_detected!("sse4.2")),
        ("avx", is_x86_feature_detected!("avx")),
        ("avx2", is_x86_feature_detected!("avx2")),
        ("fma", is_x86_feature_detected!("fma")),
        ("avx512f", is_x86_feature_detected!("avx512f")),
    ];
    known.into_iter().filter(|(_, there)| *there).map(|(name, _)| name).collect()
}

#[cfg(not(target_arch = "x86_64"))]
fn cpu_features() -> Vec<&'static str> {
    Vec::new()
}
