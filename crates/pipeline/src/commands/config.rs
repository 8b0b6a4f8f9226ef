//! The default configuration as commented TOML. The meaning of a key has one home, CONFIGURATION.md of this crate.

use crate::settings::config::Config;
use anyhow::Result;
use clap::{Args, ValueEnum};

const DOCUMENT: &str = include_str!("../../CONFIGURATION.md");
const HEAD: &str = "\
# Every key. Pass a file with any of them as `ffgs run --config FILE`: keys left out keep their
# defaults, unknown keys are errors, and command-line options win over the file.
# Units: px, m, seconds; rates are Adam step sizes.
";
/// Longest line of a comment.
const WIDTH: usize = 110;

/// `ffgs config`.
#[derive(Clone, Debug, Args)]
#[command(
    after_help = "Examples:\n  ffgs config > settings.toml\n  ffgs config --preset literal > literal.toml"
)]
pub struct ConfigArgs {
    /// Which settings
    #[arg(long, value_enum, default_value_t)]
    preset: Preset,
}

/// Whole sets of settings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum Preset {
    /// What every option defaults to
    #[default]
    Default,
    /// The defaults with our most literal reading of the paper
    Literal,
    /// The same, also where the paper's words leave no method: V counts all views, flow is summed
    WordForWord,
}

/// Prints a configuration.
pub(crate) fn print(args: &ConfigArgs) -> Result<()> {
    let config = match args.preset {
        Preset::Default => Config::default(),
        Preset::Literal => Config::literal(),
        Preset::WordForWord => Config::word_for_word(),
    };
    crate::cli::terminal::print(format_args!("{HEAD}{}", commented(&config.to_toml()?).trim_end()));
    Ok(())
}

/// Section (empty at the top), key and further cells of every row of the document's tables.
fn rows(document: &str) -> Vec<(String, &str, Vec<&str>)> {
    let mut section = String::new();
    let mut rows = Vec::new();
    for line in document.lines() {
        if let Some(heading) = line.strip_prefix('#') {
            let name = heading.split('`').nth(1).unwrap_or_default();
            section = name.trim_matches(['[', ']']).to_string();
        }
        let row =
            line.strip_prefix("| `").and_then(|l| l.strip_suffix(" |")).and_then(|l| l.split_once("` | "));
        if let Some((key, cells)) = row {
            rows.push((section.clone(), key, cells.split(" | ").collect()));
        }
    }
    rows
}

/// The meaning, then its source in brackets.
fn comment(cells: &[&str]) -> String {
    let meaning = cells.get(1).map_or(String::new(), |m| without_links(m));
    cells.get(2).map_or(meaning.clone(), |source| format!("{meaning} [{}]", without_links(source)))
}

/// `[text](target)` becomes `text`, code loses its backquotes.
fn without_links(cell: &str) -> String {
    let mut out = String::new();
    let mut rest = cell;
    while let Some((before, link)) = rest.split_once("](") {
        out.push_str(&before.replace('[', ""));
        rest = link.split_once(')').map_or("", |(_, after)| after);
    }
    out.push_str(rest);
    out.replace('`', "")
}

/// Puts each key's comment above it.
fn commented(toml: &str) -> String {
    let rows = rows(DOCUMENT);
    let mut section = String::new();
    let mut out = String::new();
    for line in toml.lines() {
        if line.starts_with('[') {
            section = line.trim_matches(['[', ']']).to_string();
        }
        let key = line.split(" = ").next().unwrap_or_default();
        if let Some((_, _, cells)) = rows.iter().find(|(s, k, _)| *s == section && *k == key) {
            out.push_str(&wrapped(&comment(cells)));
        }
        out.push_str(line);
        out.push('\n');
    }
    out
}

fn wrapped(comment: &str) -> String {
    let mut lines = vec![String::from("#")];
    for word in comment.split_whitespace() {
        if lines.last().is_some_and(|l| l.len() + 1 + word.len() > WIDTH) {
            lines.push(String::from("#"));
        }
        if let Some(line) = lines.last_mut() {
            line.push(' ');
            line.push_str(word);
        }
    }
    lines.join("\n") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn the_document_names_every_key_with_its_default_and_no_other() {
        let toml = Config::default().to_toml().unwrap();
        let mut section = String::new();
        let mut keys = BTreeSet::new();
        for line in toml.lines() {
            if line.starts_with('[') {
                section = line.trim_matches(['[', ']']).to_string();
            } else if let Some((key, value)) = line.split_once(" = ") {
                keys.insert(format!("[{section}] {key} = {value}"));
            }
        }
        let row =
            |(section, key, cells): &(String, &str, Vec<&str>)| format!("[{section}] {key} = {}", cells[0]);
        let documented: BTreeSet<String> = rows(DOCUMENT).iter().map(row).collect();
        let missing: Vec<_> = keys.difference(&documented).collect();
        let wrong: Vec<_> = documented.difference(&keys).collect();
        assert!(
            missing.is_empty() && wrong.is_empty(),
            "CONFIGURATION.md lacks {missing:#?} and has {wrong:#?}"
        );
    }

    #[test]
    fn the_commented_text_is_still_the_default() {
        let text = commented(&Config::default().to_toml().unwrap());
        assert_eq!(toml::from_str::<Config>(&text).unwrap(), Config::default());
        assert!(text.contains("# seed of every random choice"));
        assert!(text.lines().all(|l| l.chars().count() <= WIDTH + 20));
    }

    #[test]
    fn links_and_code_become_words() {
        assert_eq!(without_links("Alg. 1 is `25`; [ADR 5](adr/5.md)."), "Alg. 1 is 25; ADR 5.");
    }
}
