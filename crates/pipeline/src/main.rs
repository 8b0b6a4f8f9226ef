//! `ffgs`, the program.

use std::process::ExitCode;

fn main() -> ExitCode {
    ffgs_pipeline::cli::main()
}
