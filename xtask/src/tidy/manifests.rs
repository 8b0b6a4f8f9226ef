//! Rules for crate manifests.

use super::{Finding, Source};

/// Every crate says what it is and inherits the workspace's lints.
pub fn check(source: &Source) -> Vec<Finding> {
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
}
