//! Smaller cases of a fault: what can be left out is left out, as long as the same thing happens.

use std::io;
use std::path::Path;

use crate::Target;
use crate::driver::befalls;

/// Tries at most, as each starts a process.
const TRIES: usize = 600;

/// The smallest case found that brings about the same as this one; `None` where nothing happens.
///
/// # Errors
/// A child that cannot be started.
pub fn shrunk(target: &Target, bytes: &[u8], scratch: &Path) -> io::Result<Option<(Vec<u8>, String)>> {
    let Some(what) = befalls(target, bytes, scratch)? else { return Ok(None) };
    let (mut small, mut chunk, mut tries) = (bytes.to_vec(), bytes.len().div_ceil(2), 0);
    while chunk > 0 && tries < TRIES {
        let (mut at, before) = (0, small.len());
        while at < small.len() && tries < TRIES {
            let less = [&small[..at], &small[(at + chunk).min(small.len())..]].concat();
            tries += 1;
            if befalls(target, &less, scratch)?.as_ref() == Some(&what) {
                small = less;
            } else {
                at += chunk;
            }
        }
        if small.len() == before || chunk > small.len() {
            chunk /= 2;
        }
    }
    Ok(Some((small, what)))
}
