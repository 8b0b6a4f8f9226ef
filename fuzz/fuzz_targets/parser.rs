//! Feeds bytes to the parser that this target is named after (an entry of `entries.rs`).
#![no_main]

#[path = "../entries.rs"]
mod entries;

use libfuzzer_sys::fuzz_target;
use std::sync::LazyLock;

static PARSER: LazyLock<entries::Entry> = LazyLock::new(|| {
    let program = std::env::current_exe().expect("the program's path");
    let name = program.file_stem().expect("a name").to_string_lossy().into_owned();
    let found = entries::ENTRIES.iter().find(|entry| entry.0 == name);
    found.unwrap_or_else(|| panic!("entries.rs has no parser {name}")).1
});

fuzz_target!(|bytes: &[u8]| {
    PARSER(bytes);
});
