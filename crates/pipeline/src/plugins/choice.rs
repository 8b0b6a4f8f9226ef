//! The choice of a method: `--method NAME` or `--method NAME:ARGUMENT`.

use crate::plugins::method::{Method, MethodContext};
use crate::plugins::registry::METHODS;
use anyhow::{Context, Result};
use clap::builder::{PossibleValue, TypedValueParser};
use clap::{Arg, Command, Error, error::ErrorKind};
use ffgs_method::{MotionMethod, Plugin};
use serde::{Deserialize, Serialize};
use std::ffi::OsStr;
use std::fmt;
use std::str::FromStr;

/// A method by name, and its argument.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct MethodChoice {
    name: String,
    argument: String,
}

impl MethodChoice {
    /// Makes the method.
    ///
    /// # Errors
    /// When the argument is not one of it.
    pub fn build<'a>(&self, context: &MethodContext<'a>) -> Result<Box<dyn MotionMethod + 'a>> {
        (METHODS.find(&self.name)?.build)(context, &self.argument).with_context(|| format!("--method {self}"))
    }

    /// For a single frame, in which nothing moves, when none is named: the first method of the registry that has all that
    /// it needs.
    ///
    /// # Errors
    /// When there is no such method.
    pub(crate) fn suitable(context: &MethodContext) -> Result<Self> {
        let plain = METHODS.items.iter().filter(|method| !method.usage.contains(':'));
        let named = |method: &Method| Self { name: method.name().to_owned(), argument: String::new() };
        let found = plain.map(|method| named(method)).find(|choice| choice.build(context).is_ok());
        found.context("no method can be made for this capture")
    }
}

impl Default for MethodChoice {
    /// The first of the registry.
    fn default() -> Self {
        Self { name: METHODS.items[0].name().to_owned(), argument: String::new() }
    }
}

impl FromStr for MethodChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, argument) = text.split_once(':').unwrap_or((text, ""));
        let former = METHODS.items.iter().find(|method| method.former == Some(name));
        let name = former.map_or(name, |method| method.name());
        let method = METHODS.find(name).map_err(|error| error.to_string())?;
        if argument.is_empty() == method.usage.contains(':') {
            return Err(format!("'{text}' is not of the form {}", method.usage));
        }
        Ok(Self { name: method.name().to_owned(), argument: argument.to_owned() })
    }
}

impl fmt::Display for MethodChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)?;
        if self.argument.is_empty() { Ok(()) } else { write!(f, ":{}", self.argument) }
    }
}

impl TryFrom<String> for MethodChoice {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<MethodChoice> for String {
    fn from(choice: MethodChoice) -> Self {
        choice.to_string()
    }
}

/// Reads the option; `--help` lists every method.
#[derive(Clone)]
pub(crate) struct MethodParser;

impl TypedValueParser for MethodParser {
    type Value = MethodChoice;

    fn parse_ref(&self, command: &Command, arg: Option<&Arg>, value: &OsStr) -> Result<MethodChoice, Error> {
        let parsed = value.to_str().ok_or_else(|| "not UTF-8".to_owned()).and_then(str::parse);
        let option = arg.map(ToString::to_string).unwrap_or_default();
        parsed.map_err(|e: String| {
            Error::raw(ErrorKind::InvalidValue, format!("{option}: {e}\n")).with_cmd(command)
        })
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(METHODS.items.iter().map(|m| PossibleValue::new(m.usage).help(m.summary))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::config::Config;

    #[test]
    fn without_trackers_the_method_that_needs_none_is_taken() {
        let config = Config::default();
        let context = MethodContext { config: &config, tracks: &[], gpu: None };
        assert_eq!(MethodChoice::suitable(&context).unwrap().to_string(), "none");
        assert!(
            MethodChoice::default().build(&context).is_err(),
            "who asks for trackers is told that there are none"
        );
    }

    #[test]
    fn choices_are_read_and_written_alike() {
        for text in ["trackers", "none", "tracker:dot"] {
            assert_eq!(text.parse::<MethodChoice>().map(String::from).as_deref(), Ok(text));
        }
        assert_eq!("fused".parse(), Ok(MethodChoice::default()), "the former name");
    }

    #[test]
    fn what_is_not_registered_is_refused_with_what_is() {
        let refused = |text: &str| text.parse::<MethodChoice>().unwrap_err();
        let listed = "there is no method 'trackr'; there are: trackers, tracker:NAME, none, ";
        assert!(refused("trackr").starts_with(listed), "{}", refused("trackr"));
        assert!(refused("tracker").contains("tracker:NAME") && refused("tracker:").contains("tracker:NAME"));
        assert!(refused("none:x").contains("of the form none"));
    }
}
