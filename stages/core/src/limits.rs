//! What the readers of all formats share: counts in a file are checked against its bytes, and against a limit of memory.

use std::io::Read;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::artefact::CodecError;

/// Memory that the values of one file may take unless [`raise_memory_limit`] allows more: 8 GiB.
pub const MEMORY_LIMIT_BYTES: u64 = 8 << 30;

static LIMIT_BYTES: AtomicU64 = AtomicU64::new(MEMORY_LIMIT_BYTES);

/// Allows the values of one file to take this much memory, in the whole process; a lower limit than before is ignored.
///
/// The limit decides whether a file is read, never what is read from it.
pub fn raise_memory_limit(bytes: u64) {
    LIMIT_BYTES.fetch_max(bytes, Ordering::Relaxed);
}

/// The memory that the values of one file may take, bytes.
pub fn memory_limit() -> u64 {
    LIMIT_BYTES.load(Ordering::Relaxed)
}

/// Asks now and then whether a reader is to stop.
pub struct Stop<'a> {
    cancelled: &'a dyn Fn() -> bool,
    items: u32,
}

impl<'a> Stop<'a> {
    /// Items read between two questions.
    const EVERY: u32 = 1 << 12;

    /// Stops when this is true.
    pub fn when(cancelled: &'a dyn Fn() -> bool) -> Self {
        Self { cancelled, items: 0 }
    }

    /// Call it once for every line, row or batch that is read.
    ///
    /// # Errors
    /// The reader is to stop.
    #[inline]
    pub fn check(&mut self) -> Result<(), CodecError> {
        self.items = self.items.wrapping_add(1);
        if self.items % Self::EVERY == 1 && (self.cancelled)() { Err(CodecError::new("interrupted")) } else { Ok(()) }
    }
}

/// Bytes of a file that are read between two looks at the stop flag.
const READ_AT_ONCE: u64 = 1 << 26;

/// Reads a whole file.
///
/// # Errors
/// Those of the reader; `cancelled` became true.
pub fn read_whole(reader: &mut dyn Read, cancelled: &dyn Fn() -> bool) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    while Read::take(&mut *reader, READ_AT_ONCE).read_to_end(&mut bytes)? > 0 {
        if cancelled() {
            return Err(std::io::Error::other("interrupted"));
        }
    }
    Ok(bytes)
}

/// Most bytes of a file beside another one that says which coordinate reference system that is in (`.prj`).
pub const SYSTEM_FILE_BYTES: u64 = 1 << 16;

/// The fault of a file that has more bytes than such a file may have; `what` says which one, and what it is.
pub fn too_long(what: &str, most: u64) -> String {
    format!("{what} has more than {} KiB, and is not read: is it another file by that name?", most >> 10)
}

/// Refuses values that would take more memory than the limit; `what` says what the file claims to hold.
///
/// # Errors
/// What is claimed, the memory it takes, the limit, and how to raise it.
pub fn affordable(what: &str, bytes: Option<u64>) -> Result<(), CodecError> {
    within(what, bytes, memory_limit())
}

fn within(what: &str, bytes: Option<u64>, limit: u64) -> Result<(), CodecError> {
    if bytes.is_some_and(|bytes| bytes <= limit) {
        return Ok(());
    }
    let taken = bytes.map_or_else(|| "more memory than any machine has".to_owned(), gib);
    Err(CodecError(format!(
        "{what} would take {taken} in memory, the limit for one file is {}; if the file is not damaged, raise the limit with \
         `--memory`",
        gib(limit)
    )))
}

fn gib(bytes: u64) -> String {
    format!("{:.1} GiB", bytes as f64 / f64::from(1 << 30))
}

/// Whether so many items of at least so many bytes each fit into the bytes that are left of the file.
pub fn fits(count: u64, least_bytes: u64, left: usize) -> bool {
    count.checked_mul(least_bytes).is_some_and(|bytes| bytes <= left as u64)
}

/// An empty list with room for so many items, whose count a file claims and [`fits`] has accepted.
///
/// # Errors
/// A list beyond the limit of memory, or one that the system has no memory for.
pub fn list<T>(what: &str, count: usize) -> Result<Vec<T>, CodecError> {
    let bytes = (count as u64).checked_mul(size_of::<T>() as u64);
    affordable(&format!("{count} {what}"), bytes)?;
    let mut list = Vec::new();
    list.try_reserve_exact(count).map_err(|_| {
        CodecError(format!("{count} {what} need {}, which the system does not give", gib(bytes.unwrap_or(u64::MAX))))
    })?;
    Ok(list)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_refusal_says_what_is_claimed_the_limit_and_how_to_raise_it() {
        assert_eq!(within("3 cells", Some(5), 5), Ok(()));
        let message = within("3 cells", Some(12 << 30), 8 << 30).unwrap_err().0;
        assert!(message.contains("3 cells would take 12.0 GiB") && message.contains("is 8.0 GiB"), "{message}");
        assert!(message.contains("`--memory`"), "{message}");
        assert!(within("cells", None, u64::MAX).is_err());
    }

    #[test]
    fn a_list_beyond_all_memory_is_an_error_and_no_abort() {
        assert!(list::<[f64; 3]>("points", usize::MAX / 8).unwrap_err().0.contains("points"));
        assert!(list::<u8>("bytes", 7).unwrap().capacity() >= 7);
        assert!(fits(3, 4, 12) && !fits(3, 4, 11) && !fits(u64::MAX, 2, usize::MAX));
    }
}
