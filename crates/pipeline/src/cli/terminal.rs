//! The one place that writes to the standard streams. What is written there never ends the program: a stream that is
//! closed or full loses its text, which the exit status tells in the end, and finished work stays.

use anyhow::Result;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::fmt::Display;
use std::io::{self, Write};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

static LOST: AtomicBool = AtomicBool::new(false);

/// The work is done, but some of its output could not be printed (EX_IOERR of sysexits.h).
const OUTPUT_LOST: u8 = 74;

/// The exit status of a program's work. An error is printed with its causes.
pub fn ended(work: Result<ExitCode>) -> ExitCode {
    match work {
        Ok(code) if code == ExitCode::SUCCESS && LOST.load(Ordering::Relaxed) => ExitCode::from(OUTPUT_LOST),
        Ok(code) => code,
        Err(error) => {
            note(format_args!("error: {}", told_once(&error)));
            ExitCode::FAILURE
        }
    }
}

/// Writes results, a line end behind them, to the standard output.
pub fn print(text: impl Display) {
    write_to(&mut io::stdout().lock(), &format!("{text}\n"));
}

/// Writes a line to the standard error.
pub fn note(text: impl Display) {
    write_to(&mut io::stderr().lock(), &format!("{text}\n"));
}

/// An error with its causes, each said once: many carry the text of their cause in their own.
fn told_once(error: &anyhow::Error) -> String {
    error.chain().fold(String::new(), |told, cause| match cause.to_string() {
        text if told.is_empty() => text,
        text if told.contains(&text) => told,
        text => format!("{told}: {text}"),
    })
}

fn write_to(stream: &mut impl Write, text: &str) {
    if stream.write_all(harmless(text).as_bytes()).and_then(|()| stream.flush()).is_err() {
        LOST.store(true, Ordering::Relaxed);
    }
}

/// Names come from files: a control character of one (other than line ends and tabs) would command the terminal and is
/// shown as its code.
fn harmless(text: &str) -> String {
    let commands = |c: char| c.is_control() && c != '\n' && c != '\t';
    let shown = |c: char| if commands(c) { c.escape_unicode().collect() } else { String::from(c) };
    if text.contains(commands) { text.chars().map(shown).collect() } else { text.to_owned() }
}

/// A bar on the error stream, hidden when `quiet` or when it is no terminal; its message comes last.
pub fn progress(quiet: bool, what: &'static str, count: usize) -> ProgressBar {
    let target = if quiet { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() };
    let bar = ProgressBar::with_draw_target(Some(count as u64), target).with_prefix(what);
    let style =
        ProgressStyle::with_template("{prefix} {bar:30} {pos}/{len}  {elapsed} passed, {eta} left  {msg}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar
}

/// Where log messages go: the standard error, by way of this module.
#[derive(Clone, Copy, Debug, Default)]
pub struct LogWriter;

impl Write for LogWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        write_to(&mut io::stderr().lock(), &String::from_utf8_lossy(bytes));
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::Context;

    #[test]
    fn names_cannot_command_the_terminal() {
        assert_eq!(harmless("a\x1b]0;title\x07\tb\n"), "a\\u{1b}]0;title\\u{7}\tb\n");
        assert_eq!(harmless("\u{9b}2J"), "\\u{9b}2J");
        assert_eq!(harmless("Mätze 2\n"), "Mätze 2\n");
    }

    #[test]
    fn a_cause_that_was_told_is_not_told_again() {
        let inner = io::Error::new(io::ErrorKind::NotFound, "no such file");
        let error = anyhow::Error::new(inner).context("a.json: no such file").context("cannot go on");
        assert_eq!(told_once(&error), "cannot go on: a.json: no such file");
        let plain = Err::<(), _>(anyhow::anyhow!("why")).context("what").unwrap_err();
        assert_eq!(told_once(&plain), "what: why");
    }

    #[test]
    fn a_full_stream_loses_its_text_and_nothing_else() {
        struct Full;
        impl Write for Full {
            fn write(&mut self, _: &[u8]) -> io::Result<usize> {
                Err(io::ErrorKind::StorageFull.into())
            }
            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        write_to(&mut Full, "text");
        assert!(LOST.load(Ordering::Relaxed));
    }
}
