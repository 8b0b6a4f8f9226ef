//! Rules for the text of source files.

use super::{Finding, Source};

/// Longer Rust files are hard to hold in the head.
const MAX_LINES: usize = 600;

/// Names that say nothing about what a module holds.
const EMPTY_NAMES: [&str; 5] = ["utils", "util", "helpers", "helper", "misc"];

/// Marks of unfinished work; in pieces, so that this file does not find itself.
const LEFTOVERS: [&str; 4] =
    [concat!("to", "do!"), concat!("unimpl", "emented!"), concat!("TO", "DO"), concat!("FIX", "ME")];

/// A registry's host or a folder of one machine would break every other machine.
const MACHINE_WORDS: [&str; 5] = [
    concat!("artif", "actory"),
    concat!("jf", "rog"),
    concat!("/work/", "shared"),
    concat!("/work/", "main"),
    concat!("/ro", "ot/"),
];

/// Applies every rule to one file.
pub(crate) fn check(source: &Source) -> Vec<Finding> {
    let rules: [fn(&Source) -> Vec<Finding>; 8] = [
        headless,
        long_file,
        empty_names,
        leftovers,
        ignored_tests,
        machine_words,
        trailing_whitespace,
        foreign_includes,
    ];
    rules.iter().flat_map(|rule| rule(source)).collect()
}

/// The first line says what the file holds and why.
fn headless(source: &Source) -> Vec<Finding> {
    let head = source.text.lines().next().and_then(|line| line.strip_prefix("//! "));
    let missing = source.is("rs") && head.is_none_or(|text| text.split_whitespace().count() < 3);
    missing
        .then(|| format!("{}: no head; begin with //! and what the file holds", source.path))
        .into_iter()
        .collect()
}

fn long_file(source: &Source) -> Vec<Finding> {
    let lines = source.text.lines().count();
    let long = source.is("rs") && lines > MAX_LINES;
    long.then(|| format!("{}: {lines} lines, the limit is {MAX_LINES}", source.path)).into_iter().collect()
}

fn empty_names(source: &Source) -> Vec<Finding> {
    if !source.is("rs") {
        return Vec::new();
    }
    let parts = source.path.trim_end_matches(".rs").split('/');
    let mut findings: Vec<Finding> = parts
        .filter(|part| EMPTY_NAMES.contains(part))
        .map(|part| format!("{}: `{part}` does not say what the module holds", source.path))
        .collect();
    findings.extend(lines_where(source, "an empty name", declares_empty_name));
    findings
}

/// `mod utils`, `fn helper`: the word after the keyword is one of the empty names.
fn declares_empty_name(line: &str) -> bool {
    let code = line.trim_start();
    let is_comment = code.starts_with("//");
    let mut words =
        code.split(|c: char| !(c.is_alphanumeric() || c == '_')).skip_while(|w| !matches!(*w, "mod" | "fn"));
    let declared = words.nth(1);
    !is_comment && declared.is_some_and(|name| EMPTY_NAMES.contains(&name))
}

/// The only reason for which a test may be left out; `cargo xtask ci` runs these tests too.
const NEEDS_GPU: &str = concat!("#[ig", "nore = \"needs a GPU\"]");

/// A test that is left out by default passes for years without running.
fn ignored_tests(source: &Source) -> Vec<Finding> {
    let is_ignored =
        |line: &str| line.trim_start().starts_with(concat!("#[ig", "nore")) && line.trim() != NEEDS_GPU;
    if source.is("rs") { lines_where(source, "an ignored test", is_ignored) } else { Vec::new() }
}

fn leftovers(source: &Source) -> Vec<Finding> {
    let code = source.is("rs") || source.is("wgsl") || source.is("py");
    if !code {
        return Vec::new();
    }
    lines_where(source, "unfinished work", |line| LEFTOVERS.iter().any(|word| line.contains(word)))
}

fn machine_words(source: &Source) -> Vec<Finding> {
    lines_where(source, "names a registry host or a machine's folder", |line| {
        let line = line.to_ascii_lowercase();
        MACHINE_WORDS.iter().any(|word| line.contains(word))
    })
}

fn trailing_whitespace(source: &Source) -> Vec<Finding> {
    lines_where(source, "trailing whitespace", |line| line != line.trim_end())
}

/// Files of another folder than the crate's are not in its package: it would not build from the archive.
fn foreign_includes(source: &Source) -> Vec<Finding> {
    let Some((_, inside)) = source.path.strip_prefix("crates/").and_then(|path| path.split_once("/src/"))
    else {
        return Vec::new();
    };
    let far = "../".repeat(inside.matches('/').count() + 2);
    lines_where(source, "includes a file from outside its crate", |line| {
        let included = line.split_once("include_str!(\"").or_else(|| line.split_once("include_bytes!(\""));
        included.is_some_and(|(_, path)| path.starts_with(&far))
    })
}

fn lines_where(source: &Source, what: &str, rule: impl Fn(&str) -> bool) -> Vec<Finding> {
    let lines = source.text.split('\n').enumerate().filter(|(_, line)| rule(line));
    lines.map(|(index, _)| format!("{}:{}: {what}", source.path, index + 1)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tidy::source;

    #[test]
    fn a_clean_file_has_no_finding() {
        let clean = "//! Blends sorted splats.\n\n// The helper of the eye is the lens.\nfn blend() -> f32 {\n    0.5\n}\n";
        assert_eq!(check(&source("crates/a/src/blend.rs", clean)), Vec::<Finding>::new());
    }

    #[test]
    fn a_file_without_a_head_is_found() {
        let found = |text: &str| headless(&source("a.rs", text)).len();
        assert_eq!(found("//! Alpha blending of sorted splats.\n\nuse a::b;\n"), 0);
        assert_eq!(["use a::b;\n", "", "//!\n//! Late.\n", "//! Blends.\n"].map(found), [1, 1, 1, 1]);
        assert!(headless(&source("a.md", "use")).is_empty());
    }

    #[test]
    fn a_long_rust_file_is_found() {
        assert!(long_file(&source("a.rs", &"x\n".repeat(MAX_LINES))).is_empty());
        assert_eq!(long_file(&source("a.rs", &"x\n".repeat(MAX_LINES + 1))).len(), 1);
        assert!(long_file(&source("a.md", &"x\n".repeat(MAX_LINES + 1))).is_empty());
    }

    #[test]
    fn a_test_may_be_left_out_for_want_of_a_gpu_only() {
        let ignored = |line: &str| ignored_tests(&source("a.rs", line)).len();
        assert_eq!(ignored(&format!("    {NEEDS_GPU}\n")), 0);
        assert_eq!(ignored(concat!("#[ig", "nore]\n")), 1);
        assert_eq!(ignored(concat!("#[ig", "nore = \"slow\"]\n")), 1);
    }

    #[test]
    fn names_that_say_nothing_are_found() {
        assert_eq!(empty_names(&source("crates/a/src/utils.rs", "")).len(), 1);
        assert_eq!(empty_names(&source("crates/a/src/helpers/x.rs", "")).len(), 1);
        assert_eq!(empty_names(&source("a.rs", &format!("pub(crate) mod {} {{\n", EMPTY_NAMES[4]))).len(), 1);
        assert_eq!(empty_names(&source("a.rs", &format!("    fn {}(x: f32) {{\n", EMPTY_NAMES[3]))).len(), 1);
        assert!(empty_names(&source("a.rs", "fn helper_lens() { utils.go() }\n")).is_empty());
    }

    #[test]
    fn files_from_outside_a_crate_are_found() {
        let findings = |path: &str, far: &str| {
            foreign_includes(&source(path, &format!("const A: &str = include_str!(\"{far}a.md\");"))).len()
        };
        assert_eq!(findings("crates/x/src/a.rs", "../"), 0);
        assert_eq!(findings("crates/x/src/a.rs", "../../"), 1);
        assert_eq!(findings("crates/x/src/a/b.rs", "../../"), 0);
        assert_eq!(findings("crates/x/src/a/b.rs", "../../../"), 1);
    }

    #[test]
    fn every_leftover_is_found() {
        for word in LEFTOVERS {
            assert_eq!(leftovers(&source("a.rs", &format!("fine\n  {word}\n"))).len(), 1, "{word}");
        }
        assert!(leftovers(&source("a.md", LEFTOVERS[2])).is_empty());
    }

    #[test]
    fn every_machine_word_is_found_in_any_case() {
        for word in MACHINE_WORDS {
            let upper = word.to_ascii_uppercase();
            assert_eq!(machine_words(&source("docs/x.md", &format!("see {upper}x"))).len(), 1, "{word}");
        }
    }

    #[test]
    fn trailing_whitespace_is_found_with_its_line() {
        let findings = trailing_whitespace(&source("a.md", "one\ntwo \nthree\t\nfour\r\n"));
        assert_eq!(
            findings,
            ["a.md:2: trailing whitespace", "a.md:3: trailing whitespace", "a.md:4: trailing whitespace"]
        );
        assert!(trailing_whitespace(&source("a.md", "one\n\ntwo\n")).is_empty());
    }
}
