//! The polepair command line. No protocol is named here: what a drive speaks is known by the library.
#![forbid(unsafe_code)]
// A terminal that went away must not end who has a motor turning: `terminal::draw` and `say`.
#![deny(clippy::print_stderr)]

mod capture;
mod cmd;
#[cfg(test)]
mod every_frame;
mod interrupt;
mod motion;
mod outcome;
mod problem;
mod progress;
mod remote;
mod session;
mod tap_queue;
mod target;
mod terminal;
mod trace;
mod value;

use std::process::ExitCode;

fn main() -> ExitCode {
    interrupt::outlive_file_limit();
    let arguments = match cmd::CommandLine::parse_args() {
        Ok(arguments) => arguments,
        Err(error) => return print_usage(&error),
    };
    match cmd::run(arguments) {
        Ok(exit) => ExitCode::from(exit as u8),
        Err(problem) => {
            if !problem.what.is_empty() {
                terminal::draw(&problem.render(terminal::colour_err()));
            }
            ExitCode::from(problem.exit as u8)
        }
    }
}

/// Help and version go to stdout and are no error; everything else is.
fn print_usage(error: &clap::Error) -> ExitCode {
    // A reader that went away is nothing to report.
    let _ = error.print();
    ExitCode::from(if error.use_stderr() { problem::Exit::Usage } else { problem::Exit::Ok } as u8)
}
