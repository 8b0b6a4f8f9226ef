//! Dependency edges between the project's crates, against the table in docs/ARCHITECTURE.md.

use super::{Finding, Source};
use crate::workspace;
use anyhow::{Context, Result, ensure};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

const DOCUMENT: &str = "docs/ARCHITECTURE.md";
const FENCE: &str = "```edges";
const PREFIX: &str = "ffgs-";

/// Crate name without the prefix -> the project's crates it depends on.
type Edges = BTreeMap<String, BTreeSet<String>>;

/// Compares the table with `cargo metadata`; a mismatch in either direction is a finding.
pub(crate) fn check(root: &Path, sources: &[Source]) -> Result<Vec<Finding>> {
    let Some(document) = sources.iter().find(|s| s.path == DOCUMENT) else {
        return Ok(vec![format!("{DOCUMENT}: missing")]);
    };
    let stated = match parse_table(&document.text) {
        Ok(stated) => stated,
        Err(finding) => return Ok(vec![finding]),
    };
    Ok(compare(&stated, &from_metadata(&metadata(root)?)?))
}

fn metadata(root: &Path) -> Result<Value> {
    let mut command = workspace::cargo(root);
    let output = command.args(["metadata", "--no-deps", "--format-version", "1"]).output()?;
    ensure!(output.status.success(), "cargo metadata: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).context("cargo metadata printed no JSON")
}

fn from_metadata(metadata: &Value) -> Result<Edges> {
    let packages = metadata["packages"].as_array().context("cargo metadata lists no packages")?;
    let ours = packages.iter().filter_map(|package| Some((short(&package["name"])?, package)));
    Ok(ours.map(|(name, package)| (name, normal_dependencies(package))).collect())
}

/// Normal dependencies only: tests may use more.
fn normal_dependencies(package: &Value) -> BTreeSet<String> {
    let dependencies = package["dependencies"].as_array().map_or(&[][..], Vec::as_slice);
    dependencies.iter().filter(|d| d["kind"].is_null()).filter_map(|d| short(&d["name"])).collect()
}

fn short(name: &Value) -> Option<String> {
    name.as_str()?.strip_prefix(PREFIX).map(str::to_owned)
}

/// Reads the fenced block: one `crate -> crate, crate` per line.
fn parse_table(document: &str) -> Result<Edges, Finding> {
    let mut lines = document.lines().skip_while(|line| line.trim() != FENCE);
    if lines.next().is_none() {
        return Err(format!("{DOCUMENT}: no {FENCE} block"));
    }
    lines
        .take_while(|line| !line.starts_with("```"))
        .filter(|line| !line.trim().is_empty())
        .map(parse_line)
        .collect()
}

fn parse_line(line: &str) -> Result<(String, BTreeSet<String>), Finding> {
    let (name, list) = line
        .split_once("->")
        .ok_or_else(|| format!("{DOCUMENT}: `{line}` is not `crate -> crate, crate`"))?;
    let list = list.split(',').map(str::trim).filter(|name| !name.is_empty()).map(str::to_owned);
    Ok((name.trim().to_owned(), list.collect()))
}

fn compare(stated: &Edges, found: &Edges) -> Vec<Finding> {
    let names: BTreeSet<&String> = stated.keys().chain(found.keys()).collect();
    names.into_iter().flat_map(|name| compare_crate(name, stated.get(name), found.get(name))).collect()
}

fn compare_crate(
    name: &str,
    stated: Option<&BTreeSet<String>>,
    found: Option<&BTreeSet<String>>,
) -> Vec<Finding> {
    let (Some(stated), Some(found)) = (stated, found) else {
        let holder = if stated.is_some() {
            "the edge table, not in the workspace"
        } else {
            "the workspace, not in the edge table"
        };
        return vec![format!("{DOCUMENT}: crate {name} is in {holder}")];
    };
    let unstated = found.difference(stated).map(|to| format!("edge {name} -> {to} is not in {DOCUMENT}"));
    let unreal =
        stated.difference(found).map(|to| format!("edge {name} -> {to} of {DOCUMENT} does not exist"));
    unstated.chain(unreal).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    const TABLE: &str = "text\n```edges\ncore ->\nb -> core\n\nc -> core, b\n```\nx -> y\n";

    fn workspace() -> Value {
        let dependency = |name: &str, kind: Value| json!({ "name": name, "kind": kind });
        json!({ "packages": [
            { "name": "ffgs-core", "dependencies": [dependency("glam", Value::Null)] },
            { "name": "ffgs-b", "dependencies": [dependency("ffgs-core", Value::Null), dependency("ffgs-c", json!("dev"))] },
            { "name": "ffgs-c", "dependencies": [dependency("ffgs-core", Value::Null), dependency("ffgs-b", Value::Null)] },
            { "name": "xtask", "dependencies": [] },
        ]})
    }

    #[test]
    fn the_table_and_the_workspace_agree() {
        let found = from_metadata(&workspace()).unwrap();
        assert_eq!(compare(&parse_table(TABLE).unwrap(), &found), Vec::<Finding>::new());
    }

    #[test]
    fn an_edge_missing_on_either_side_is_found() {
        let found = from_metadata(&workspace()).unwrap();
        let fewer = parse_table(&TABLE.replace("core, b", "core")).unwrap();
        assert_eq!(compare(&fewer, &found), [format!("edge c -> b is not in {DOCUMENT}")]);
        let more = parse_table(&TABLE.replace("b -> core", "b -> core, c")).unwrap();
        assert_eq!(compare(&more, &found), [format!("edge b -> c of {DOCUMENT} does not exist")]);
    }

    #[test]
    fn a_crate_missing_on_either_side_is_found() {
        let found = from_metadata(&workspace()).unwrap();
        let fewer = parse_table(&TABLE.replace("core ->\n", "")).unwrap();
        assert_eq!(compare(&fewer, &found).len(), 1);
        let more = parse_table(&TABLE.replace("core ->\n", "core ->\nd ->\n")).unwrap();
        assert_eq!(compare(&more, &found).len(), 1);
    }

    #[test]
    fn a_document_without_a_readable_table_is_found() {
        assert!(parse_table("no table").is_err());
        assert!(parse_table("```edges\ncore\n```").is_err());
    }
}
