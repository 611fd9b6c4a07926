//! The `calibrig` command: only the exit code is made here.

use std::process::ExitCode;

fn main() -> ExitCode {
    calibrig::cli::main()
}
