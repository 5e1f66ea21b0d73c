//! How long the allocator keeps what was freed.

use std::ffi::{c_int, c_long};
use std::time::Duration;

use libmimalloc_sys::{mi_collect, mi_option_get, mi_option_set_default, mi_option_t};
use rockface_engine::run::MachineMemory;

/// `mi_option_purge_delay` of mimalloc 2: milliseconds before freed memory is given back to the system.
const PURGE_DELAY: mi_option_t = 15;
/// Its value where nobody has set it.
const USUAL_DELAY_MS: c_long = 10;
/// A hundred minutes for large buffers, for which mimalloc waits ten times as long: longer than most runs.
const DELAY_MS: c_long = 10 * 60 * 1000;
/// Between two looks at the memory of the machine.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// Makes mimalloc keep what was freed, so that the large buffers of successive stages reuse it: the first touch of a gigabyte that is new from the
/// system costs half a second. While less than an eighth of the machine's memory is left, it is given back at once, to programs that
/// steps start and to other processes. `MIMALLOC_PURGE_DELAY` in the environment has precedence over both.
pub fn keep_freed() {
    if option(PURGE_DELAY) != USUAL_DELAY_MS {
        return;
    }
    let watching = std::thread::Builder::new().name("memory".to_owned()).spawn(|| {
        loop {
            std::thread::sleep(LOOK_EVERY);
            if MachineMemory::now().is_some_and(|memory| memory.is_short()) {
                give_back();
            }
        }
    });
    if watching.is_ok() {
        set_default(PURGE_DELAY, DELAY_MS);
    }
}

/// Gives freed memory back to the system.
#[allow(unsafe_code)]
fn give_back() {
    // SAFETY: mimalloc allows it at any time, from any thread.
    unsafe { mi_collect(true) }
}

#[allow(unsafe_code)]
fn option(number: c_int) -> c_long {
    // SAFETY: reads a number from a table; mimalloc checks that `number` is in it.
    unsafe { mi_option_get(number) }
}

#[allow(unsafe_code)]
fn set_default(number: c_int, value: c_long) {
    // SAFETY: writes a number into a table, unless the user has set it; mimalloc checks that `number` is in it.
    unsafe { mi_option_set_default(number, value) }
}

#[cfg(test)]
mod tests {
    use std::alloc::{GlobalAlloc, Layout};

    use rockface_engine::run::process_bytes;

    use super::*;

    const SIZE: usize = 256 << 20;

    /// Takes memory, writes to it and frees it.
    #[allow(unsafe_code)]
    fn use_some() {
        let layout = Layout::from_size_align(SIZE, 4096).unwrap();
        // SAFETY: the size is not zero, and only what was allocated is written to and freed.
        unsafe {
            let memory = mimalloc::MiMalloc.alloc(layout);
            assert!(!memory.is_null());
            memory.write_bytes(1, SIZE);
            mimalloc::MiMalloc.dealloc(memory, layout);
        }
    }

    fn resident_bytes() -> Option<u64> {
        process_bytes("self", "VmRSS")
    }

    #[test]
    fn what_was_freed_is_kept_until_it_is_given_back() {
        let before = option(PURGE_DELAY);
        keep_freed();
        if std::env::var("MIMALLOC_PURGE_DELAY").is_ok() {
            assert_eq!(option(PURGE_DELAY), before);
            return;
        }
        assert_eq!((before, option(PURGE_DELAY)), (USUAL_DELAY_MS, DELAY_MS));
        use_some();
        let kept = resident_bytes();
        give_back();
        if let (Some(kept), Some(left)) = (kept, resident_bytes()) {
            assert!(kept > left + SIZE as u64 / 2, "{kept} bytes, and {left} after giving back");
        }
    }
}
