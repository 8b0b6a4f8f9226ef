//! Rules for crate manifests.

use super::{Finding, Source};

/// The one crate whose normal dependencies may hold a numpy parser (docs/adr/0002).
const NUMPY_OWNER: &str = "crates/arrays/Cargo.toml";
const NUMPY_PARSER: &str = "npyz";

/// Every crate says what it is and inherits the workspace's lints; only `arrays` parses numpy files.
pub(crate) fn check(source: &Source) -> Vec<Finding> {
    let Source { path, text } = source;
    let ours = path.starts_with("crates/") || path.starts_with("xtask/");
    if !ours || !path.ends_with("/Cargo.toml") {
        return Vec::new();
    }
    let Ok(manifest) = text.parse::<toml::Table>() else {
        return vec![format!("{path}: not TOML")];
    };
    let described = entry(&manifest, "package", "description").and_then(toml::Value::as_str);
    let inherits = entry(&manifest, "lints", "workspace").and_then(toml::Value::as_bool);
    let mut findings = Vec::new();
    if described.is_none_or(|d| d.trim().is_empty()) {
        findings.push(format!("{path}: the crate has no description"));
    }
    if inherits != Some(true) {
        findings.push(format!("{path}: the crate does not inherit lints ([lints] workspace = true)"));
    }
    if path != NUMPY_OWNER && entry(&manifest, "dependencies", NUMPY_PARSER).is_some() {
        findings
            .push(format!("{path}: only `arrays` reads numpy files; {NUMPY_PARSER} may be a dev-dependency"));
    }
    findings
}

fn entry<'a>(manifest: &'a toml::Table, section: &str, key: &str) -> Option<&'a toml::Value> {
    manifest.get(section)?.get(key)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tidy::source;

    #[test]
    fn a_crate_needs_a_description_and_the_lints() {
        let whole = "[package]\nname = \"a\"\ndescription = \"Does a\"\n[lints]\nworkspace = true\n";
        assert!(check(&source("crates/a/Cargo.toml", whole)).is_empty());
        assert_eq!(check(&source("crates/a/Cargo.toml", "[package]\nname = \"a\"\n")).len(), 2);
        let blank = whole.replace("Does a", " ");
        assert_eq!(check(&source("xtask/Cargo.toml", &blank)).len(), 1);
        let own = whole.replace("true", "false");
        assert_eq!(check(&source("crates/a/Cargo.toml", &own)).len(), 1);
        assert_eq!(check(&source("crates/a/Cargo.toml", "[package")).len(), 1);
        assert!(check(&source("Cargo.toml", "[workspace]\n")).is_empty());
    }
    #[test]
    fn only_arrays_parses_numpy_files() {
        let head = "[package]\ndescription = \"a\"\n[lints]\nworkspace = true\n";
        let normal = format!("{head}[dependencies]\n{NUMPY_PARSER}.workspace = true\n");
        assert_eq!(check(&source("crates/tracks/Cargo.toml", &normal)).len(), 1);
        assert!(check(&source(NUMPY_OWNER, &normal)).is_empty());
        let dev = normal.replace("[dependencies]", "[dev-dependencies]");
        assert!(check(&source("crates/tracks/Cargo.toml", &dev)).is_empty());
    }
}
