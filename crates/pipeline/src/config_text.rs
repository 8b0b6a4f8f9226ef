//! The default configuration as commented TOML. The meaning of a key has one home, docs/CONFIGURATION.md.

use crate::config::Config;
use anyhow::Result;
use std::collections::BTreeMap;

const DOCUMENT: &str = include_str!("../../../docs/CONFIGURATION.md");
const HEAD: &str = "\
# Every key with its default. Pass a file with any of them as `ffgs run --config FILE`: keys left out keep their
# defaults, unknown keys are errors, and command-line options win over the file.
# Units: px, m, seconds; rates are Adam step sizes.
";
/// Longest line of a comment.
const WIDTH: usize = 110;

/// A row of the document's tables.
struct Row {
    default: String,
    comment: String,
}

/// Prints the default configuration.
pub fn print_default() -> Result<()> {
    print!("{HEAD}{}", commented(&Config::default().to_toml()?, &rows(DOCUMENT)));
    Ok(())
}

/// Rows by section (empty at the top) and key.
fn rows(document: &str) -> BTreeMap<(String, String), Row> {
    let mut section = String::new();
    let mut rows = BTreeMap::new();
    for line in document.lines() {
        if let Some(heading) = line.strip_prefix('#') {
            let name = heading.split('`').nth(1).unwrap_or_default();
            section = name.trim_matches(['[', ']']).to_string();
        }
        let Some(cells) = line.strip_prefix("| `").and_then(|l| l.strip_suffix(" |")) else { continue };
        let cells: Vec<&str> = cells.split(" | ").collect();
        if let [key, default, meaning, ref source @ ..] = cells[..] {
            let source = source.first().map_or(String::new(), |s| format!(" [{}]", without_links(s)));
            let comment = format!("{}{source}", without_links(meaning));
            let row = Row { default: default.to_string(), comment };
            rows.insert((section.clone(), key.trim_end_matches('`').to_string()), row);
        }
    }
    rows
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
fn commented(toml: &str, rows: &BTreeMap<(String, String), Row>) -> String {
    let mut section = String::new();
    let mut out = String::new();
    for line in toml.lines() {
        if line.starts_with('[') {
            section = line.trim_matches(['[', ']']).to_string();
        }
        let key = line.split(" = ").next().unwrap_or_default();
        if let Some(row) = rows.get(&(section.clone(), key.to_string())) {
            out.push_str(&wrapped(&row.comment));
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
    lines.iter().map(|l| format!("{l}\n")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_document_names_every_key_with_its_default_and_no_other() {
        let toml = Config::default().to_toml().unwrap();
        let mut documented = rows(DOCUMENT);
        let mut section = String::new();
        let mut wrong = Vec::new();
        for line in toml.lines() {
            if line.starts_with('[') {
                section = line.trim_matches(['[', ']']).to_string();
            } else if let Some((key, value)) = line.split_once(" = ") {
                match documented.remove(&(section.clone(), key.to_string())) {
                    Some(row) if row.default == value => {}
                    Some(row) => {
                        wrong.push(format!("[{section}] {key}: {value}, documented {}", row.default))
                    }
                    None => wrong.push(format!("[{section}] {key} = {value} is not documented")),
                }
            }
        }
        wrong.extend(documented.into_keys().map(|(s, k)| format!("[{s}] {k} does not exist")));
        assert!(wrong.is_empty(), "docs/CONFIGURATION.md:\n{}", wrong.join("\n"));
    }

    #[test]
    fn the_commented_text_is_still_the_default() {
        let text = commented(&Config::default().to_toml().unwrap(), &rows(DOCUMENT));
        assert_eq!(toml::from_str::<Config>(&text).unwrap(), Config::default());
        assert!(text.contains("# seed of every random choice"));
        assert!(text.lines().all(|l| l.chars().count() <= WIDTH + 20));
    }

    #[test]
    fn links_and_code_become_words() {
        assert_eq!(without_links("Alg. 1 is `25`; [ADR 5](adr/5.md)."), "Alg. 1 is 25; ADR 5.");
    }
}
