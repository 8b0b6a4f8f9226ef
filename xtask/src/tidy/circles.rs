//! Import circles between the files of a crate: files that import each other can only be understood together.

use super::{Finding, Source};
use std::collections::{BTreeMap, BTreeSet};

/// File -> the files of its crate that it imports.
type Imports<'a> = BTreeMap<&'a str, BTreeSet<&'a str>>;

/// Finds circles in every crate. Tests may import what they test.
pub(crate) fn check(sources: &[Source]) -> Vec<Finding> {
    let mut crates = BTreeMap::<&str, Vec<&Source>>::new();
    for source in sources.iter().filter(|source| source.is("rs")) {
        if let Some((name, _)) = source.path.split_once("/src/") {
            crates.entry(name).or_default().push(source);
        }
    }
    crates.into_iter().flat_map(|(name, files)| check_crate(name, &files)).collect()
}

fn check_crate(name: &str, files: &[&Source]) -> Vec<Finding> {
    circles(&imports(name, files))
        .iter()
        .map(|circle| format!("{name}: files import each other in a circle: {}", circle.join(", ")))
        .collect()
}

fn imports<'a>(name: &str, files: &[&'a Source]) -> Imports<'a> {
    let modules: BTreeMap<String, &Source> =
        files.iter().filter_map(|file| Some((module(name, &file.path)?, *file))).collect();
    let mut imports = Imports::new();
    for (path, file) in &modules {
        let found = paths(&file.text, path).into_iter().filter_map(|path| resolve(&modules, &path, 0));
        // A folder's own file is its face: it hands on what its files hold, and they may name what it declares.
        imports.insert(&file.path, found.filter(|to| *to != file.path && !is_face(to)).collect());
    }
    imports.retain(|file, _| !is_face(file));
    imports
}

fn is_face(path: &str) -> bool {
    ["/lib.rs", "/main.rs", "/mod.rs"].iter().any(|face| path.ends_with(face))
}

/// `a::b` of `crates/x/src/a/b.rs`; empty for the root.
fn module(name: &str, path: &str) -> Option<String> {
    let inside = path.strip_prefix(name)?.strip_prefix("/src/")?.strip_suffix(".rs")?;
    let inside = inside.strip_suffix("/mod").unwrap_or(inside);
    Some(if matches!(inside, "lib" | "main") { String::new() } else { inside.replace('/', "::") })
}

/// Paths below the crate's root that the text names, without its tests.
fn paths(text: &str, module: &str) -> Vec<String> {
    let code = text.split("#[cfg(test)]").next().unwrap_or_default();
    let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
    let code: String =
        lines.flat_map(|line| [line.split(" // ").next().unwrap_or_default().trim(), " "]).collect();
    let parent = module.rsplit_once("::").map_or("", |(parent, _)| parent);
    let mut found = Vec::new();
    for (start, base) in [("crate::", ""), ("super::", parent)] {
        for (at, _) in code.match_indices(start) {
            let whole = !code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == ':');
            if whole {
                let names = expand(&code[at + start.len()..]);
                found.extend(names.into_iter().map(|name| join(base, &name)));
            }
        }
    }
    found
}

fn join(base: &str, name: &str) -> String {
    if base.is_empty() { name.to_owned() } else { format!("{base}::{name}") }
}

/// The paths of `a::{b, c::d}`: `a::b`, `a::c::d`.
fn expand(text: &str) -> Vec<String> {
    let end = text.find(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':')).unwrap_or(text.len());
    let (path, rest) = text.split_at(end);
    let Some(inside) = rest.strip_prefix('{').filter(|_| path.is_empty() || path.ends_with("::")) else {
        return vec![path.trim_end_matches(':').to_owned()];
    };
    let parts = split_list(inside);
    parts.iter().flat_map(|part| expand(part)).map(|part| format!("{path}{part}")).collect()
}

/// The entries of a list in braces, whose opening brace is gone.
fn split_list(text: &str) -> Vec<&str> {
    let (mut depth, mut start, mut parts) = (0_usize, 0, Vec::new());
    for (at, c) in text.char_indices() {
        match c {
            '{' => depth += 1,
            ',' if depth == 0 => {
                parts.push(text[start..at].trim());
                start = at + 1;
            }
            '}' if depth == 0 => {
                parts.push(text[start..at].trim());
                break;
            }
            '}' => depth -= 1,
            _ => {}
        }
    }
    parts.retain(|part| !part.is_empty());
    parts
}

/// The file that holds `path`: its module, or where the face of that module takes it from.
fn resolve<'a>(modules: &BTreeMap<String, &'a Source>, path: &str, depth: usize) -> Option<&'a str> {
    let mut module = path;
    loop {
        if let Some(source) = modules.get(module) {
            let name = path[module.len()..].trim_start_matches("::").split("::").next().unwrap_or_default();
            return handed_on(modules, source, module, name, depth).or(Some(&source.path));
        }
        module = module.rsplit_once("::").map_or("", |(parent, _)| parent);
        if module.is_empty() {
            let (root, name) = (modules.get("")?, path.split("::").next().unwrap_or_default());
            return handed_on(modules, root, "", name, depth);
        }
    }
}

/// Where a face takes `name` from: `pub use b::{name}`.
fn handed_on<'a>(
    modules: &BTreeMap<String, &'a Source>,
    face: &Source,
    module: &str,
    name: &str,
    depth: usize,
) -> Option<&'a str> {
    /// Faces hand on through a few folders at most.
    const DEEPEST: usize = 4;
    if !is_face(&face.path) || name.is_empty() || depth > DEEPEST {
        return None;
    }
    let code = face.text.split("#[cfg(test)]").next().unwrap_or_default().replace('\n', " ");
    let uses = code.match_indices("use ").flat_map(|(at, word)| expand(code[at + word.len()..].trim_start()));
    let taken = uses.filter(|path| path.rsplit("::").next() == Some(name) && path.contains("::"));
    let inside = taken.map(|path| join(module, path.trim_start_matches("self::")));
    inside.filter(|path| path.as_str() != join(module, name)).find_map(|path| {
        let first = path.rsplit_once("::").map_or("", |(parent, _)| parent);
        modules.contains_key(first).then(|| resolve(modules, &path, depth + 1)).flatten()
    })
}

/// Groups of files that reach each other, each in alphabetical order.
fn circles<'a>(imports: &Imports<'a>) -> Vec<Vec<&'a str>> {
    let reached: BTreeMap<&str, BTreeSet<&str>> =
        imports.keys().map(|file| (*file, reached_from(imports, file))).collect();
    let mut found = BTreeSet::new();
    for (file, far) in &reached {
        let circle: Vec<&str> = far
            .iter()
            .copied()
            .filter(|other| reached.get(other).is_some_and(|r| r.contains(file)))
            .collect();
        if circle.len() > 1 {
            found.insert(circle);
        }
    }
    found.into_iter().collect()
}

fn reached_from<'a>(imports: &Imports<'a>, file: &str) -> BTreeSet<&'a str> {
    let mut reached = BTreeSet::new();
    let mut open: Vec<&'a str> = imports.get(file).into_iter().flatten().copied().collect();
    while let Some(next) = open.pop() {
        if reached.insert(next) {
            open.extend(imports.get(next).into_iter().flatten());
        }
    }
    reached
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tidy::source;

    fn findings(files: &[(&str, &str)]) -> Vec<Finding> {
        let sources: Vec<Source> =
            files.iter().map(|(path, text)| source(&format!("crates/x/src/{path}"), text)).collect();
        check(&sources)
    }

    #[test]
    fn files_in_order_are_no_circle() {
        let lib = ("lib.rs", "mod a;\nmod b;\npub use a::{One, Two};\n");
        assert!(
            findings(&[lib, ("a.rs", "use crate::b::Base;\n"), ("b.rs", "pub struct Base;\n")]).is_empty()
        );
        assert!(
            findings(&[lib, ("a.rs", "use crate::b::Base;\n"), ("b.rs", "#[cfg(test)]\nuse crate::One;\n")])
                .is_empty()
        );
        assert!(findings(&[lib, ("a.rs", "// see crate::b\n"), ("b.rs", "use crate::a::One;\n")]).is_empty());
    }

    #[test]
    fn two_files_that_import_each_other_are_found() {
        let lib = ("lib.rs", "mod a;\nmod b;\npub use a::{One, Two};\n");
        let direct = findings(&[lib, ("a.rs", "use crate::b::Base;\n"), ("b.rs", "use crate::a::One;\n")]);
        assert_eq!(
            direct,
            ["crates/x: files import each other in a circle: crates/x/src/a.rs, crates/x/src/b.rs"]
        );
        let handed_on =
            findings(&[lib, ("a.rs", "use crate::b::Base;\n"), ("b.rs", "use crate::{Other, Two};\n")]);
        assert_eq!(handed_on, direct);
        let in_code =
            findings(&[lib, ("a.rs", "fn f() { crate::b::g() }\n"), ("b.rs", "use super::a::One;\n")]);
        assert_eq!(in_code, direct);
    }

    #[test]
    fn circles_through_folders_are_found() {
        let files = [
            ("lib.rs", "mod a;\npub mod c;\n"),
            ("c/mod.rs", "mod d;\npub use d::Deep;\n"),
            ("c/d.rs", "use crate::a::One;\n"),
            ("a.rs", "use crate::{c::{Deep}};\n"),
        ];
        assert_eq!(findings(&files).len(), 1);
    }

    #[test]
    fn nested_lists_are_expanded() {
        assert_eq!(expand("a::{b, c::{d, e}, f} rest"), ["a::b", "a::c::d", "a::c::e", "a::f"]);
        assert_eq!(expand("a::b::f(x)"), ["a::b::f"]);
    }
}
