//! Feeds one fuzz target, named by `CALIBRIG_FUZZ`, from libFuzzer.

#![no_main]

// What reads keys at extremes is called by the tests of the root alone.
#[allow(dead_code)]
#[path = "../targets/mod.rs"]
mod targets;

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;

static TARGET: LazyLock<targets::Target> = LazyLock::new(|| {
    let name = std::env::var("CALIBRIG_FUZZ").unwrap_or_default();
    let found = targets::TARGETS.iter().find(|(known, _)| *known == name);
    found
        .map(|(_, target)| *target)
        .unwrap_or_else(|| panic!("CALIBRIG_FUZZ is {name:?}: it names no target"))
});

fuzz_target!(|data: &[u8]| (*TARGET)(data));
