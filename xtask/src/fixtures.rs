//! `fixtures/MANIFEST.toml`: size and SHA-256 of every fixture, and the limits on their total size.

use crate::workspace;
use anyhow::{Context, Result, bail};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

const MANIFEST: &str = "fixtures/MANIFEST.toml";
/// Source code of the capture generator: reviewed as code, not as data.
const SOURCES: &str = "fixtures/monaco/";
const SCENES: &str = "fixtures/scenes/";
/// A clone stays small: limits on what every clone downloads. One for all goldens, one for each scene.
const GOLDEN_LIMIT: u64 = 8 << 20;
const SCENE_LIMIT: u64 = 20 << 20;

/// Fixtures by path relative to the root.
type Entries = BTreeMap<String, Entry>;

#[derive(Clone, Debug, PartialEq)]
struct Entry {
    size: u64,
    sha256: String,
}

/// Compares the files with the manifest; the summary line, or an error that lists every difference.
pub(crate) fn check(root: &Path) -> Result<String> {
    let text = std::fs::read_to_string(root.join(MANIFEST))
        .with_context(|| format!("{MANIFEST}: cannot read it; `cargo xtask fixtures update` writes it"))?;
    let found = scan(root)?;
    let mut faults = differences(&parse(&text)?, &found);
    faults.extend(over_limit(&found));
    if !faults.is_empty() {
        bail!(
            "fixtures differ from {MANIFEST}:\n  {}\nif that is meant, run `cargo xtask fixtures update`",
            faults.join("\n  ")
        );
    }
    Ok(summary(&found))
}

/// Writes the manifest from the files that are there; refuses when a size limit is broken.
pub(crate) fn update(root: &Path) -> Result<String> {
    let found = scan(root)?;
    let faults = over_limit(&found);
    if !faults.is_empty() {
        bail!("{}", faults.join("\n"));
    }
    std::fs::write(root.join(MANIFEST), render(&found))
        .with_context(|| format!("cannot write {MANIFEST}"))?;
    Ok(summary(&found))
}

fn scan(root: &Path) -> Result<Entries> {
    let files = workspace::files(root)?.into_iter().filter(|file| is_fixture(file));
    files
        .map(|file| {
            let bytes = std::fs::read(root.join(&file)).with_context(|| format!("cannot read {file}"))?;
            Ok((file, entry(&bytes)))
        })
        .collect()
}

fn is_fixture(file: &str) -> bool {
    file.starts_with("fixtures/") && !file.starts_with(SOURCES) && file != MANIFEST
}

fn entry(bytes: &[u8]) -> Entry {
    let mut sha256 = String::new();
    for byte in Sha256::digest(bytes) {
        let _ = write!(sha256, "{byte:02x}"); // writing into a String cannot fail
    }
    Entry { size: bytes.len() as u64, sha256 }
}

fn differences(manifest: &Entries, found: &Entries) -> Vec<String> {
    let gone = manifest.keys().filter(|path| !found.contains_key(*path));
    let mut faults: Vec<String> = gone.map(|path| format!("missing: {path}")).collect();
    for (path, entry) in found {
        match manifest.get(path) {
            None => faults.push(format!("extra: {path}")),
            Some(listed) if listed != entry => faults.push(format!("changed: {path}")),
            Some(_) => {}
        }
    }
    faults
}

fn totals(entries: &Entries) -> (u64, u64) {
    entries.iter().fold((0, 0), |(goldens, scenes), (path, entry)| {
        if path.starts_with(SCENES) { (goldens, scenes + entry.size) } else { (goldens + entry.size, scenes) }
    })
}

/// Bytes of each scene by its folder's name.
fn scenes(entries: &Entries) -> BTreeMap<&str, u64> {
    let mut sizes = BTreeMap::new();
    for (path, entry) in entries {
        let name = path.strip_prefix(SCENES).and_then(|rest| rest.split_once('/'));
        if let Some((name, _)) = name {
            *sizes.entry(name).or_insert(0) += entry.size;
        }
    }
    sizes
}

fn over_limit(entries: &Entries) -> Vec<String> {
    let goldens = ("golden fixtures", totals(entries).0, GOLDEN_LIMIT);
    let scenes = scenes(entries).into_iter().map(|(name, size)| (name, size, SCENE_LIMIT));
    std::iter::once(goldens)
        .chain(scenes)
        .filter(|&(_, size, limit)| size >= limit)
        .map(|(what, size, limit)| format!("{what} hold {size} bytes, the limit is {limit}"))
        .collect()
}

fn summary(entries: &Entries) -> String {
    let (goldens, scenes) = totals(entries);
    let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    format!(
        "fixtures: {} files, goldens {:.2} MiB, scenes {:.2} MiB",
        entries.len(),
        mib(goldens),
        mib(scenes)
    )
}

fn render(entries: &Entries) -> String {
    let mut text =
        String::from("# Written by `cargo xtask fixtures update`; `cargo xtask fixtures check` compares.\n");
    text.push_str("[files]\n");
    for (path, Entry { size, sha256 }) in entries {
        let _ = writeln!(text, "{path:?} = {{ size = {size}, sha256 = \"{sha256}\" }}");
    }
    text
}

fn parse(text: &str) -> Result<Entries> {
    let table: toml::Table = text.parse().with_context(|| format!("{MANIFEST} is not TOML"))?;
    let files = table.get("files").and_then(toml::Value::as_table).context("the manifest has no [files]")?;
    files.iter().map(|(path, value)| Ok((path.clone(), parse_entry(path, value)?))).collect()
}

fn parse_entry(path: &str, value: &toml::Value) -> Result<Entry> {
    let size = value.get("size").and_then(toml::Value::as_integer).and_then(|size| u64::try_from(size).ok());
    let sha256 = value.get("sha256").and_then(toml::Value::as_str);
    match (size, sha256) {
        (Some(size), Some(sha256)) => Ok(Entry { size, sha256: sha256.to_owned() }),
        _ => bail!("{MANIFEST}: {path} needs a size and a sha256"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entries(items: &[(&str, &[u8])]) -> Entries {
        items.iter().map(|&(path, bytes)| (path.to_owned(), entry(bytes))).collect()
    }

    #[test]
    fn the_digest_is_sha256() {
        // FIPS 180-2, appendix B.1.
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(entry(b"abc"), Entry { size: 3, sha256: expected.to_owned() });
    }

    #[test]
    fn the_manifest_reads_back_what_was_written() {
        let written = entries(&[("fixtures/a b.npz", b"1"), ("fixtures/scenes/x/é.png", b"22")]);
        assert_eq!(parse(&render(&written)).unwrap(), written);
    }

    #[test]
    fn missing_extra_and_changed_files_are_told_apart() {
        let manifest = entries(&[("a", b"1"), ("b", b"1"), ("same", b"1")]);
        let found = entries(&[("b", b"2"), ("c", b"1"), ("same", b"1")]);
        assert_eq!(differences(&manifest, &found), ["missing: a", "changed: b", "extra: c"]);
        assert!(differences(&found, &found).is_empty());
    }

    #[test]
    fn both_size_limits_are_enforced() {
        let mut found = entries(&[("fixtures/scenes/s/a.png", b"x"), ("fixtures/voronoi/case.npz", b"x")]);
        assert!(over_limit(&found).is_empty());
        found.get_mut("fixtures/voronoi/case.npz").unwrap().size = GOLDEN_LIMIT;
        assert_eq!(over_limit(&found).len(), 1);
        found.get_mut("fixtures/scenes/s/a.png").unwrap().size = SCENE_LIMIT - 1;
        found.insert("fixtures/scenes/t/a.png".into(), Entry { size: SCENE_LIMIT - 1, ..entry(b"x") });
        assert_eq!(over_limit(&found).len(), 1, "each scene has its own limit");
        found.get_mut("fixtures/scenes/s/a.png").unwrap().size = SCENE_LIMIT;
        assert_eq!(over_limit(&found).len(), 2);
    }

    #[test]
    fn sources_and_the_manifest_itself_are_not_fixtures() {
        assert!(is_fixture("fixtures/scenes/s/train_meta.json"));
        assert!(!is_fixture("fixtures/monaco/monaco/track.py"));
        assert!(!is_fixture(MANIFEST));
        assert!(!is_fixture("crates/core/src/lib.rs"));
    }

    #[test]
    fn a_broken_manifest_is_an_error() {
        assert!(parse("[files]\n\"a\" = { size = -1, sha256 = \"\" }").is_err());
        assert!(parse("[files").is_err());
        assert!(parse("").is_err());
    }
}
