//! How long functions are, from the line of their name to their closing brace; tests are not counted.

use super::{Finding, Source};
use syn::visit::{self, Visit};

/// Most lines of a function.
const LONGEST: usize = 80;
/// Most lines of the function in the middle, and of that which nine tenths do not exceed.
const MEDIAN: usize = 9;
const NINE_TENTHS: usize = 25;

/// Lines of the functions of the workspace, ascending.
pub(crate) struct Lengths(Vec<usize>);

impl Lengths {
    fn at(&self, share: f64) -> usize {
        let last = self.0.len().saturating_sub(1);
        self.0.get((share * last as f64) as usize).copied().unwrap_or(0)
    }

    /// One line for people.
    pub(crate) fn summary(&self) -> String {
        let [median, most, longest] = [0.5, 0.9, 1.0].map(|share| self.at(share));
        format!("{} functions: median {median}, 90 % {most}, longest {longest} lines", self.0.len())
    }
}

/// Measures all functions, and finds those that are too long.
pub(crate) fn check(sources: &[Source]) -> (Lengths, Vec<Finding>) {
    let mut all = Vec::new();
    let mut findings = Vec::new();
    for source in sources.iter().filter(|source| source.is("rs") && is_program(&source.path)) {
        match syn::parse_file(&source.text) {
            Ok(file) => {
                let mut functions = Functions::default();
                functions.visit_file(&file);
                let long = functions.0.iter().filter(|(_, lines)| *lines > LONGEST);
                findings.extend(long.map(|(name, lines)| {
                    format!("{}: `{name}` has {lines} lines, the limit is {LONGEST}", source.path)
                }));
                all.extend(functions.0.into_iter().map(|(_, lines)| lines));
            }
            Err(error) => findings.push(format!("{}: {error}", source.path)),
        }
    }
    all.sort_unstable();
    let lengths = Lengths(all);
    if lengths.at(0.5) > MEDIAN || lengths.at(0.9) > NINE_TENTHS {
        findings.push(format!("{}; the limits are {MEDIAN} and {NINE_TENTHS}", lengths.summary()));
    }
    (lengths, findings)
}

/// Files whose functions are the program's or a developer command's.
fn is_program(path: &str) -> bool {
    (path.starts_with("crates/") || path.starts_with("xtask/"))
        && path.contains("/src/")
        && !path.ends_with("/tests.rs")
        && !path.contains("/tests/")
}

/// Names and lines.
#[derive(Default)]
struct Functions(Vec<(String, usize)>);

impl Functions {
    fn add(&mut self, name: &syn::Ident, block: &syn::Block) {
        let lines = block.brace_token.span.close().end().line + 1 - name.span().start().line;
        self.0.push((name.to_string(), lines));
    }
}

impl<'ast> Visit<'ast> for Functions {
    fn visit_item_fn(&mut self, item: &'ast syn::ItemFn) {
        self.add(&item.sig.ident, &item.block);
        visit::visit_item_fn(self, item);
    }

    fn visit_impl_item_fn(&mut self, item: &'ast syn::ImplItemFn) {
        self.add(&item.sig.ident, &item.block);
        visit::visit_impl_item_fn(self, item);
    }

    fn visit_trait_item_fn(&mut self, item: &'ast syn::TraitItemFn) {
        if let Some(block) = &item.default {
            self.add(&item.sig.ident, block);
        }
        visit::visit_trait_item_fn(self, item);
    }

    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        let tests = |attribute: &syn::Attribute| {
            attribute.path().is_ident("cfg")
                && attribute.meta.require_list().is_ok_and(|list| list.tokens.to_string() == "test")
        };
        if !item.attrs.iter().any(tests) {
            visit::visit_item_mod(self, item);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tidy::source;

    #[test]
    fn functions_are_measured_and_tests_are_not() {
        let text = "fn a() {\n}\nimpl X {\n    fn b(\n        &self,\n    ) {\n        go()\n    }\n}\n\
            #[cfg(test)]\nmod tests {\n    fn c() {\n\n\n\n\n\n    }\n}\n";
        let (lengths, findings) = check(&[source("crates/x/src/lib.rs", text)]);
        assert_eq!((lengths.0, findings), (vec![2, 5], Vec::new()));
    }

    #[test]
    fn long_functions_are_found() {
        let long = format!("fn a() {{\n{}}}\n", "go();\n".repeat(LONGEST - 1));
        let (lengths, findings) = check(&[source("crates/x/src/lib.rs", &long)]);
        assert_eq!(findings.len(), 2, "too long, and so is the median: {}", lengths.summary());
        let outside = check(&[source("crates/x/tests/a.rs", &long)]).1;
        assert_eq!(outside, Vec::<Finding>::new());
    }

    #[test]
    fn the_median_and_nine_tenths_have_limits() {
        let of = |lines: usize| format!("fn a() {{\n{}}}\n", "go();\n".repeat(lines - 2));
        let with = |short: usize, long: usize| [of(MEDIAN).repeat(short), of(LONGEST).repeat(long)].concat();
        let findings = |text: &str| check(&[source("crates/x/src/lib.rs", text)]).1.len();
        assert_eq!(findings(&with(19, 1)), 0);
        assert_eq!(findings(&with(8, 2)), 1);
        assert_eq!(findings(&of(MEDIAN + 1)), 1);
    }
}
