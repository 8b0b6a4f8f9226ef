//! The head of every compute shader names its twin on the CPU, its test and its benchmark; each of them must exist.

use super::{Finding, Source};

/// Measured times of the kernels; a head names a row by its first two parts.
const TABLE: &str = "docs/bench/gpu.csv";

/// Checks the heads of `crates/*/shaders/*.wgsl`; files of `shaders/common` are pieces without an entry point.
pub(crate) fn check(sources: &[Source]) -> Vec<Finding> {
    let kernels = sources.iter().filter(|s| s.is("wgsl") && s.text.contains("@compute"));
    kernels.flat_map(|kernel| check_head(kernel, sources)).collect()
}

fn check_head(kernel: &Source, sources: &[Source]) -> Vec<Finding> {
    type Rule = fn(&str, &[Source]) -> bool;
    let rules: [(&str, Rule); 3] = [("twin", has_item), ("test", has_test), ("bench", has_row)];
    let head: Vec<&str> = kernel.text.lines().take_while(|line| line.starts_with("//")).collect();
    let found = rules.iter().filter_map(|(key, exists)| {
        let start = format!("// {key}: ");
        let Some(named) = head.iter().find_map(|line| line.strip_prefix(&start)) else {
            return Some(format!("{}: the head names no {key}", kernel.path));
        };
        (!exists(named.trim(), sources)).then(|| format!("{}: {key} {named} does not exist", kernel.path))
    });
    found.collect()
}

/// `crate::module::item`: a file of the crate that defines the item.
fn has_item(path: &str, sources: &[Source]) -> bool {
    let Some((module, item)) = path.rsplit_once("::") else { return false };
    let (name, inside) = module.split_once("::").unwrap_or((module, "lib"));
    let inside = inside.replace("::", "/");
    let files = [format!("crates/{name}/src/{inside}.rs"), format!("crates/{name}/src/{inside}/mod.rs")];
    let file = sources.iter().find(|s| files.contains(&s.path));
    file.is_some_and(|file| ["fn ", "struct ", "enum "].iter().any(|word| defines(&file.text, word, item)))
}

/// `crate/path/file.rs::name`: a file that has a test of this name.
fn has_test(path: &str, sources: &[Source]) -> bool {
    let Some((file, test)) = path.rsplit_once("::") else { return false };
    let file = sources.iter().find(|s| s.path == format!("crates/{file}"));
    file.is_some_and(|file| file.text.contains("#[test]") && defines(&file.text, "fn ", test))
}

fn has_row(name: &str, sources: &[Source]) -> bool {
    let start = format!("{name}/");
    let table = sources.iter().find(|s| s.path == TABLE);
    table.is_some_and(|t| t.text.lines().any(|line| line.starts_with(&start)))
}

/// Whether `word` and `name` stand in the text, and the name ends there.
fn defines(text: &str, word: &str, name: &str) -> bool {
    let start = format!("{word}{name}");
    text.match_indices(&start).any(|(at, _)| {
        let next = text[at + start.len()..].chars().next();
        next.is_some_and(|c| !(c.is_alphanumeric() || c == '_'))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tidy::source;

    fn findings(head: &str) -> Vec<Finding> {
        let kernel = format!("{head}\n\n@compute @workgroup_size(1) fn f() {{}}\n");
        check(&[
            source("crates/x-gpu/shaders/f.wgsl", &kernel),
            source("crates/x-gpu/shaders/common/piece.wgsl", "// No entry point.\n"),
            source("crates/x/src/a/b.rs", "pub struct Walk<'a>(&'a u8);\nfn walk_all() {}\n"),
            source("crates/x-gpu/tests/t.rs", "#[test]\nfn they_agree() {}\n"),
            source(TABLE, "name,seconds\nkernel/f/320x180,1\n"),
        ])
    }

    #[test]
    fn a_whole_head_has_no_finding() {
        let head =
            "// F.\n//\n// twin: x::a::b::Walk\n// test: x-gpu/tests/t.rs::they_agree\n// bench: kernel/f";
        assert_eq!(findings(head), Vec::<Finding>::new());
        assert_eq!(findings(&head.replace("kernel/f", "none")).len(), 1, "every kernel is timed");
    }

    #[test]
    fn what_does_not_exist_is_found() {
        let head = "// twin: x::a::b::walk\n// test: x-gpu/tests/t.rs::agree\n// bench: kernel/g";
        assert_eq!(findings(head).len(), 3);
        assert_eq!(findings("// twin: x::a::b::Walk").len(), 2, "no test, no bench");
        assert_eq!(findings("// F.").len(), 3);
    }
}
