//! How long the allocator keeps what was freed.

use std::ffi::{c_int, c_long};

use libmimalloc_sys::{mi_option_get, mi_option_set_default, mi_option_t};

/// `mi_option_purge_delay` of mimalloc 2: milliseconds before freed memory is given back to the system.
const PURGE_DELAY: mi_option_t = 15;
/// Its value where nobody has set it.
const USUAL_DELAY_MS: c_long = 10;
/// For large buffers mimalloc waits ten times as long: longer than a heavy stage takes until the next one asks for the same memory.
const DELAY_MS: c_long = 3000;

/// Makes mimalloc keep freed memory for half a minute, so that the large buffers of successive stages reuse it: the first touch of a gigabyte that is
/// new from the system costs a large part of a second. `MIMALLOC_PURGE_DELAY` in the environment has precedence.
pub fn keep_freed_for_a_while() {
    if option(PURGE_DELAY) == USUAL_DELAY_MS {
        set_default(PURGE_DELAY, DELAY_MS);
    }
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
    use super::*;

    #[test]
    fn the_delay_is_the_option_of_that_number() {
        let before = option(PURGE_DELAY);
        keep_freed_for_a_while();
        let by_the_user = std::env::var("MIMALLOC_PURGE_DELAY").is_ok();
        if by_the_user {
            assert_eq!(option(PURGE_DELAY), before);
        } else {
            assert_eq!((before, option(PURGE_DELAY)), (USUAL_DELAY_MS, DELAY_MS));
        }
    }
}
