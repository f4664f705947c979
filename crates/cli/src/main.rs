//! The `polepair` program.
#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    ExitCode::from(polepair_cli::run(std::env::args_os(), polepair_cli::VERSION))
}
