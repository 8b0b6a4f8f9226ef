//! A run that is stopped by a signal says what becomes of its frames.

/// Signals that end a run; each that the caller has not told this process to ignore gets a sentence, then its usual effect,
/// so that the caller sees what ended the program.
#[cfg(unix)]
pub(crate) fn explain_signals() {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    let ignored = ignored_signals();
    let heard = [SIGHUP, SIGINT, SIGTERM].into_iter().filter(|&signal| (ignored >> (signal - 1)) & 1 == 0);
    // Without a handler the signal still ends the program, only without the sentence.
    let Ok(mut signals) = signal_hook::iterator::Signals::new(heard) else { return };
    std::thread::spawn(move || {
        if let Some(signal) = signals.forever().next() {
            let name = signal_hook::low_level::signal_name(signal).unwrap_or("a signal");
            crate::cli::terminal::note(format_args!(
                "stopped by {name}: finished frames are kept, and the same command with --resume goes on"
            ));
            let _ = signal_hook::low_level::emulate_default_handler(signal);
        }
    });
}

/// Signals that end a run: elsewhere the system ends it without a sentence.
#[cfg(not(unix))]
pub fn explain_signals() {}

/// The mask of ignored signals (as `nohup` and a shell's background jobs have them); none where the system does not say.
#[cfg(unix)]
fn ignored_signals() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0)
}
