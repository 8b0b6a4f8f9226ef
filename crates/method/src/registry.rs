//! One list per kind of plug-in.

use std::fmt::Write;
use thiserror::Error;

/// Something that is chosen by its name.
pub trait Plugin: Send + Sync {
    /// Name in options and files: lower case, no spaces.
    fn name(&self) -> &'static str;

    /// What it is, in one line.
    fn summary(&self) -> &'static str;

    /// How it is asked for: its name, and what is to be given with it, if anything.
    fn usage(&self) -> &'static str {
        self.name()
    }
}

/// All plug-ins of a kind, in the order in which they are tried and printed.
pub struct Registry<T: ?Sized + 'static> {
    /// What they are, in the singular: "capture format".
    pub kind: &'static str,
    /// The list; a plug-in is added here and nowhere else.
    pub items: &'static [&'static T],
}

impl<T: Plugin + ?Sized> Registry<T> {
    /// The plug-in of that name.
    ///
    /// # Errors
    /// When there is none; the message lists what there is.
    pub fn find(&self, name: &str) -> Result<&'static T, Unknown> {
        let found = self.items.iter().copied().find(|item| item.name() == name);
        found.ok_or_else(|| Unknown { kind: self.kind, name: name.to_owned(), known: self.names() })
    }

    /// Names, for messages: "a, b, c".
    pub fn names(&self) -> String {
        self.items.iter().map(|item| item.usage()).collect::<Vec<_>>().join(", ")
    }

    /// One line per plug-in: name and summary.
    pub fn table(&self) -> String {
        let width = self.items.iter().map(|item| item.usage().len()).max().unwrap_or(0);
        self.items.iter().fold(String::new(), |mut text, item| {
            // Writing to a string does not fail.
            let _ = writeln!(text, "  {:width$}  {}", item.usage(), item.summary());
            text
        })
    }
}

/// A name that no plug-in has.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("there is no {kind} '{name}'; there are: {known}")]
pub struct Unknown {
    kind: &'static str,
    name: String,
    known: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Named(&'static str);

    impl Plugin for Named {
        fn name(&self) -> &'static str {
            self.0
        }

        fn summary(&self) -> &'static str {
            "a name"
        }
    }

    const COLOURS: Registry<dyn Plugin> =
        Registry { kind: "colour", items: &[&Named("red"), &Named("green")] };

    #[test]
    fn names_are_found_and_unknown_ones_list_what_there_is() {
        assert_eq!(COLOURS.find("green").map(Plugin::name), Ok("green"));
        let refused = COLOURS.find("blue").err().map(|e| e.to_string());
        assert_eq!(refused.as_deref(), Some("there is no colour 'blue'; there are: red, green"));
        assert_eq!(COLOURS.table(), "  red    a name\n  green  a name\n");
    }
}
