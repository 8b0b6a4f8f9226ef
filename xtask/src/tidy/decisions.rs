//! The index of decisions lists every decision with its title.

use super::{Finding, Source};

const FOLDER: &str = "docs/adr/";
const INDEX: &str = "docs/adr/README.md";

/// Decisions without their line in the index, and lines without a decision.
pub(super) fn check(sources: &[Source]) -> Vec<Finding> {
    let decisions = sources.iter().filter(|s| s.path.starts_with(FOLDER) && s.path != INDEX);
    let mut wanted: Vec<String> = decisions.filter_map(line).collect();
    wanted.sort();
    let index = sources.iter().find(|s| s.path == INDEX).map_or("", |s| s.text.as_str());
    let found: Vec<&str> = index.lines().filter(|l| l.starts_with("| [")).collect();
    let missing = wanted.iter().filter(|line| !found.contains(&line.as_str()));
    let stale = found.iter().filter(|line| !wanted.iter().any(|w| w == **line));
    let missing = missing.map(|line| format!("{INDEX}: has no line `{line}`"));
    missing.chain(stale.map(|line| format!("{INDEX}: no decision has the line `{line}`"))).collect()
}

/// The line of a decision: number, link and title; `None` where the first line is no numbered title.
fn line(decision: &Source) -> Option<String> {
    let name = decision.path.strip_prefix(FOLDER)?;
    let title = decision.text.lines().next()?.strip_prefix("# ")?.split_once(". ")?.1;
    Some(format!("| [{}]({name}) | {title} |", name.get(..4)?))
}

#[cfg(test)]
mod tests {
    use super::super::source;
    use super::*;

    #[test]
    fn the_index_follows_the_decisions() {
        let decision = || source("docs/adr/0007-solve.md", "# 7. One solve per frame\n\nStatus: accepted\n");
        let index =
            |line: &str| source(INDEX, &format!("# Decisions\n\n| number | decision |\n|---|---|\n{line}\n"));
        assert!(check(&[decision(), index("| [0007](0007-solve.md) | One solve per frame |")]).is_empty());
        assert_eq!(check(&[decision(), index("")]).len(), 1);
        assert_eq!(check(&[decision()]).len(), 1);
        assert_eq!(check(&[decision(), index("| [0007](0007-solve.md) | Two solves |")]).len(), 2);
    }
}
