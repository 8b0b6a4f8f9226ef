//! The project's own lints. Each rule is a pure function with a test that makes it fail.

mod circles;
mod decisions;
mod edges;
mod functions;
mod kernels;
mod manifests;
mod sources;

use crate::workspace;
use anyhow::{Context, Result, bail};
use std::path::Path;

/// One text file of the repository.
pub(crate) struct Source {
    /// Path relative to the root.
    path: String,
    text: String,
}

impl Source {
    fn is(&self, extension: &str) -> bool {
        has_extension(&self.path, &[extension])
    }
}

/// What a rule found, as a line a person can act on.
type Finding = String;

/// Files whose text the rules read; images and arrays are not text.
const TEXT: [&str; 13] =
    ["rs", "toml", "md", "py", "json", "html", "css", "js", "wgsl", "sh", "yml", "lock", "csv"];
/// Text files without an extension.
const BARE_TEXT: [&str; 3] = [".ci/run", ".gitignore", "LICENSE"];

/// Runs every rule and says how long functions are; an error lists all findings.
pub(crate) fn run(root: &Path) -> Result<String> {
    let sources = read(root)?;
    let mut findings: Vec<Finding> = sources.iter().flat_map(sources::check).collect();
    findings.extend(sources.iter().flat_map(manifests::check));
    findings.extend(circles::check(&sources));
    findings.extend(kernels::check(&sources));
    findings.extend(decisions::check(&sources));
    let (lengths, long) = functions::check(&sources);
    findings.extend(long);
    findings.extend(edges::check(root, &sources)?);
    if !findings.is_empty() {
        bail!("tidy has {} findings:\n  {}", findings.len(), findings.join("\n  "));
    }
    Ok(lengths.summary())
}

fn read(root: &Path) -> Result<Vec<Source>> {
    let files = workspace::files(root)?.into_iter();
    files
        .filter(|path| has_extension(path, &TEXT) || BARE_TEXT.contains(&path.as_str()))
        .map(|path| {
            let text =
                std::fs::read_to_string(root.join(&path)).with_context(|| format!("cannot read {path}"))?;
            Ok(Source { path, text })
        })
        .collect()
}

fn has_extension(path: &str, extensions: &[&str]) -> bool {
    Path::new(path).extension().and_then(|e| e.to_str()).is_some_and(|e| extensions.contains(&e))
}

#[cfg(test)]
fn source(path: &str, text: &str) -> Source {
    Source { path: path.to_owned(), text: text.to_owned() }
}
