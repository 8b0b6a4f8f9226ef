//! Damaged bytes through every parser: the same functions that `fuzz/` drives for hours, for seconds and on stable Rust.
//!
//! `FFGS_FUZZ_SEED=7 FFGS_FUZZ_COPIES=20000 cargo test --release --workspace --test parsers -- --nocapture` is a campaign.

#[path = "../../../fuzz/damage.rs"]
mod damage;
#[path = "../../../fuzz/entries.rs"]
mod entries;

use damage::{Random, damage};
use std::fs;
use std::path::{Path, PathBuf};

/// Damaged copies of each file of the corpus.
const COPIES: u64 = 100;

fn number(variable: &str) -> Option<u64> {
    std::env::var(variable)
        .ok()
        .map(|text| text.parse().unwrap_or_else(|_| panic!("{variable} is no number")))
}

/// The small files of a parser: sound ones, and those that libFuzzer found to reach other code, with whether they are sound.
fn corpus(name: &str) -> Vec<(Vec<u8>, bool)> {
    let fuzz = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz");
    let files = |kind: &str| {
        let found = fs::read_dir(fuzz.join(kind).join(name)).into_iter().flatten();
        let mut files: Vec<PathBuf> = found.map(|entry| entry.unwrap().path()).collect();
        files.sort();
        files.into_iter().map(|file| fs::read(file).unwrap())
    };
    let sound: Vec<_> = files("corpus").map(|bytes| (bytes, true)).collect();
    assert!(!sound.is_empty(), "{name} has no corpus");
    sound.into_iter().chain(files("reached").map(|bytes| (bytes, false))).collect()
}

#[test]
fn no_parser_gives_up_on_damaged_bytes() {
    let seed = number("FFGS_FUZZ_SEED").unwrap_or(0);
    let copies = number("FFGS_FUZZ_COPIES").unwrap_or(COPIES);
    let mut failed = Vec::new();
    for (name, parse) in entries::ENTRIES {
        let (mut given, mut accepted) = (1, 0_u64);
        parse(&[]);
        for (file, is_sound) in corpus(name) {
            assert!(parse(&file) || !is_sound, "{name}: a sound file is refused");
            let mut random =
                Random(seed ^ name.bytes().fold(0, |sum, byte| 31_u64.wrapping_mul(sum) + u64::from(byte)));
            // The reached ones are many, and damaged themselves.
            let copies = if is_sound { copies } else { copies / 20 };
            for copy in 0..copies {
                let mut bytes = file.clone();
                damage(&mut random, &mut bytes);
                let ended = std::panic::catch_unwind(|| parse(&bytes));
                accepted += u64::from(*ended.as_ref().unwrap_or(&false));
                failed.extend(ended.is_err().then(|| format!("{name}, seed {seed}, copy {copy}: {bytes:?}")));
            }
            given += copies + 1;
        }
        println!("{name:<16} {given:>9} inputs, {accepted:>7} damaged ones accepted");
    }
    assert!(failed.is_empty(), "a panic in\n{}", failed.join("\n"));
}

#[test]
fn every_parser_is_a_target_of_its_name() {
    let manifest = include_str!("../../../fuzz/Cargo.toml");
    for (name, _) in entries::ENTRIES {
        assert!(manifest.contains(&format!("name = \"{name}\"")), "fuzz/Cargo.toml has no target {name}");
    }
}
