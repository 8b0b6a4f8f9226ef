//! Tables, as Markdown and as HTML.

use std::fmt::Write;

/// A table under a title.
#[derive(Clone, Debug, Default)]
pub(super) struct Table {
    pub title: String,
    /// What it shows, in a sentence or two.
    pub note: String,
    /// The first column holds names, the others numbers.
    pub head: Vec<String>,
    pub rows: Vec<Vec<String>>,
}

impl Table {
    pub(super) fn new(title: String, note: &str, head: &[&str]) -> Self {
        let head = head.iter().map(|&cell| cell.to_owned()).collect();
        Self { title, note: note.to_owned(), head, rows: Vec::new() }
    }
}

/// Each under a heading.
pub(super) fn markdown(tables: &[Table]) -> String {
    let mut out = String::new();
    let line = |cells: &[String]| {
        let cells: Vec<String> =
            cells.iter().map(|cell| cell.replace('|', "\\|").replace('\n', " ")).collect();
        format!("| {} |\n", cells.join(" | "))
    };
    for table in tables {
        // Writing to a string does not fail.
        let _ = write!(out, "## {}\n\n{}\n\n", table.title, table.note);
        out += &line(&table.head);
        out += &(String::from("|") + &"---|".repeat(table.head.len()) + "\n");
        table.rows.iter().for_each(|row| out += &line(row));
        out.push('\n');
    }
    out
}

/// The same as HTML.
pub(super) fn html(table: &Table) -> String {
    let mut out =
        format!("<h2>{}</h2><p class=\"note\">{}</p><table><tr>", escape(&table.title), escape(&table.note));
    let class = |column: usize| if column == 0 { "" } else { " class=\"n\"" };
    for (column, cell) in table.head.iter().enumerate() {
        let _ = write!(out, "<th{}>{}</th>", class(column), escape(cell));
    }
    for row in &table.rows {
        out += "</tr><tr>";
        for (column, cell) in row.iter().enumerate() {
            let _ = write!(out, "<td{}>{}</td>", class(column), escape(cell));
        }
    }
    out + "</tr></table>"
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_cannot_break_a_table() {
        let mut table = Table::new("a < b".into(), "note", &["name", "x"]);
        table.rows.push(vec!["one | two\nthree".into(), "<script>".into()]);
        let text = markdown(&[table.clone()]);
        assert!(text.contains("## a < b\n\nnote\n\n| name | x |\n|---|---|\n"), "{text}");
        assert!(text.contains("| one \\| two three | <script> |\n"), "{text}");
        let page = html(&table);
        assert!(page.contains("a &lt; b") && page.contains("<td class=\"n\">&lt;script&gt;</td>"), "{page}");
    }
}
