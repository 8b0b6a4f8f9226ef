//! `cargo xtask supply`: the packages that the program is made of, known and accounted for.

use crate::workspace;
use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// The package of the program.
const PROGRAM: &str = "ffgs-pipeline";
/// Says why each direct dependency is there.
const REASONS: &str = "docs/DEPENDENCIES.md";

/// Compares the direct dependencies with their page, and writes a bill of materials (CycloneDX) when asked for one.
/// Returns what was looked at. Licences and sources are `cargo xtask ci licences`.
pub(crate) fn run(root: &Path, sbom: Option<&Path>) -> Result<String> {
    let metadata = metadata(root)?;
    let page =
        std::fs::read_to_string(root.join(REASONS)).with_context(|| format!("cannot read {REASONS}"))?;
    let differences = differences(&direct(&metadata)?, &explained(&page));
    ensure!(differences.is_empty(), "{REASONS}: {}", differences.join("; "));
    let packages = outside(&metadata).count();
    if let Some(file) = sbom {
        let lock = std::fs::read_to_string(root.join("Cargo.lock")).context("cannot read Cargo.lock")?;
        let bill = serde_json::to_string_pretty(&bill(&metadata, &checksums(&lock)?))?;
        std::fs::write(file, bill).with_context(|| format!("cannot write {}", file.display()))?;
    }
    Ok(format!("supply: {packages} packages, every direct one explained"))
}

/// What `cargo metadata` says; an error where Cargo.lock is not up to date.
fn metadata(root: &Path) -> Result<Value> {
    let output = workspace::cargo(root)
        .args(["metadata", "--locked", "--format-version", "1"])
        .output()
        .context("cannot start cargo")?;
    ensure!(output.status.success(), "cargo metadata: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).context("cargo metadata is not JSON")
}

fn packages(metadata: &Value) -> impl Iterator<Item = &Value> {
    metadata["packages"].as_array().into_iter().flatten()
}

/// Packages that are not of this workspace.
fn outside(metadata: &Value) -> impl Iterator<Item = &Value> {
    packages(metadata).filter(|package| !package["source"].is_null())
}

/// Names that a package of the workspace depends on.
fn direct(metadata: &Value) -> Result<BTreeSet<String>> {
    let own = packages(metadata).filter(|package| package["source"].is_null());
    let wanted = own.flat_map(|package| package["dependencies"].as_array().into_iter().flatten());
    let names = wanted.filter(|dependency| !dependency["source"].is_null()).map(|d| d["name"].as_str());
    names.map(|name| Ok(name.context("a dependency without a name")?.to_owned())).collect()
}

/// The names in the first column of the page's tables.
fn explained(page: &str) -> BTreeSet<String> {
    let rows = page.lines().filter_map(|line| line.strip_prefix("| `")?.split_once('`'));
    rows.map(|(name, _)| name.to_owned()).collect()
}

fn differences(direct: &BTreeSet<String>, explained: &BTreeSet<String>) -> Vec<String> {
    let missing = direct.difference(explained).map(|name| format!("`{name}` is not explained"));
    let gone = explained.difference(direct).map(|name| format!("`{name}` is no direct dependency"));
    missing.chain(gone).collect()
}

/// SHA-256 of each package's archive, by name and version.
fn checksums(lock: &str) -> Result<BTreeMap<(String, String), String>> {
    let lock: toml::Table = toml::from_str(lock).context("Cargo.lock")?;
    let packages =
        lock.get("package").and_then(toml::Value::as_array).context("Cargo.lock has no packages")?;
    let text = |package: &toml::Value, key: &str| Some(package.get(key)?.as_str()?.to_owned());
    let entry = |p: &toml::Value| Some(((text(p, "name")?, text(p, "version")?), text(p, "checksum")?));
    Ok(packages.iter().filter_map(entry).collect())
}

/// CycloneDX 1.5: name, version, licence, archive's hash and package URL of each package, and which needs which.
fn bill(metadata: &Value, checksums: &BTreeMap<(String, String), String>) -> Value {
    let text = |package: &Value, key: &str| package[key].as_str().unwrap_or_default().to_owned();
    let component = |package: &Value| {
        let (name, version) = (text(package, "name"), text(package, "version"));
        let hash = checksums.get(&(name.clone(), version.clone()));
        json!({
            "type": "library",
            "bom-ref": package["id"],
            "name": name,
            "version": version,
            "purl": format!("pkg:cargo/{name}@{version}"),
            "licenses": [{ "expression": text(package, "license").replace('/', " OR ") }],
            "hashes": hash.map(|hash| json!({ "alg": "SHA-256", "content": hash })).into_iter().collect::<Vec<_>>(),
        })
    };
    let version = packages(metadata).find(|package| package["name"] == PROGRAM).map(|p| text(p, "version"));
    json!({
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {
            "component": { "type": "application", "bom-ref": "ffgs", "name": "ffgs", "version": version.unwrap_or_default() }
        },
        "components": outside(metadata).map(component).collect::<Vec<_>>(),
        "dependencies": needs(metadata),
    })
}

/// What each package needs; the workspace is one application.
fn needs(metadata: &Value) -> Vec<Value> {
    let outside: BTreeSet<&str> = outside(metadata).filter_map(|package| package["id"].as_str()).collect();
    let mut needs: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for node in metadata["resolve"]["nodes"].as_array().into_iter().flatten() {
        let id = node["id"].as_str().filter(|id| outside.contains(id)).unwrap_or("ffgs");
        let ids = node["dependencies"].as_array().into_iter().flatten().filter_map(Value::as_str);
        needs.entry(id).or_default().extend(ids.filter(|id| outside.contains(id)));
    }
    needs.into_iter().map(|(id, on)| json!({ "ref": id, "dependsOn": on })).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dependency_without_a_reason_and_a_reason_without_a_dependency_are_found() {
        let metadata = json!({ "packages": [
            { "name": "own", "source": null, "dependencies": [
                { "name": "png", "source": "registry" }, { "name": "own-core", "source": null } ] },
            { "name": "png", "source": "registry", "version": "1.0.0", "license": "MIT/Apache-2.0", "dependencies": [] },
        ] });
        let explained = explained("| package | why |\n|---|---|\n| `zip` | npz |\n");
        let found = differences(&direct(&metadata).unwrap(), &explained);
        assert_eq!(found, ["`png` is not explained", "`zip` is no direct dependency"]);
    }

    #[test]
    fn the_bill_names_licence_hash_and_needs() {
        let metadata = json!({ "packages": [
            { "name": "ffgs-pipeline", "id": "own", "source": null, "version": "0.1.0" },
            { "name": "png", "id": "png", "source": "registry", "version": "1.0.0", "license": "MIT/Apache-2.0" } ],
            "resolve": { "nodes": [ { "id": "own", "dependencies": ["png", "own"] }, { "id": "png", "dependencies": [] } ] } });
        let lock = "[[package]]\nname = \"png\"\nversion = \"1.0.0\"\nchecksum = \"ab12\"\n";
        let bill = bill(&metadata, &checksums(lock).unwrap());
        let component = &bill["components"][0];
        assert_eq!(component["purl"], "pkg:cargo/png@1.0.0");
        assert_eq!(component["licenses"][0]["expression"], "MIT OR Apache-2.0");
        assert_eq!(component["hashes"][0]["content"], "ab12");
        assert_eq!(bill["metadata"]["component"]["version"], "0.1.0");
        assert_eq!(bill["dependencies"][0], json!({ "ref": "ffgs", "dependsOn": ["png"] }));
    }
}
