//! One program for every target: `ROCKFACE_FUZZ` names the one that libFuzzer calls.

#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::{Corpus, fuzz_target};
use rockface_fuzz::{Target, Verdict, find};

static TARGET: LazyLock<&Target> = LazyLock::new(|| {
    let name = std::env::var("ROCKFACE_FUZZ").unwrap_or_default();
    find(&name).unwrap_or_else(|| panic!("ROCKFACE_FUZZ=`{name}` is no target; `rockface-fuzz list` names those there are"))
});

fuzz_target!(|bytes: &[u8]| -> Corpus {
    match (TARGET.run)(bytes) {
        // What is refused is kept too: it may be a step on the way to what is accepted.
        Verdict::Accepted | Verdict::Refused => Corpus::Keep,
    }
});
