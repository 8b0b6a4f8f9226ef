//! `ffgs-lab`, the program.

use std::process::ExitCode;

fn main() -> ExitCode {
    ffgs_lab::cli::main()
}
