//! The polepair command line. It names no protocol: the library knows the protocol of each drive.
#![forbid(unsafe_code)]
// A terminal that went away must not end a program whose motor is turning: `terminal`.
#![deny(clippy::print_stderr)]

mod broadcast;
mod capture;
mod cmd;
mod consent;
mod control;
mod data_output;
#[cfg(test)]
mod every_frame;
mod interrupt;
mod local_wire;
mod motion;
mod outcome;
mod output_file;
mod problem;
mod profile_args;
mod progress;
mod remote;
mod session;
mod tap_queue;
mod target;
mod terminal;
mod trace;
mod value;

use std::ffi::OsString;

#[cfg(feature = "tables")]
pub use cmd::decode::tables::dataset;
pub use cmd::groups::{VERB_GROUPS, VerbGroup};

/// The program's version.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// All verbs and options. Documentation and completion scripts are made from it.
#[must_use]
pub fn command() -> clap::Command {
    cmd::CommandLine::grammar()
}

/// Runs the program with its command line, of which the first word is its own name, and gives its exit
/// code. `version` is what `--version` shows.
pub fn run(command_line: impl IntoIterator<Item = OsString>, version: &str) -> u8 {
    interrupt::outlive_file_limit();
    let words: Vec<OsString> = command_line.into_iter().collect();
    match cmd::completions::answer_shell(&words) {
        Ok(true) => return problem::Exit::Ok as u8,
        Ok(false) => {}
        Err(error) => return print_usage(&error),
    }
    let words = remote::rewrite_gateway_url(words);
    let arguments = match cmd::CommandLine::parse(words, version) {
        Ok(arguments) => arguments,
        Err(error) => return print_usage(&error),
    };
    match cmd::run(arguments) {
        Ok(exit) => exit as u8,
        Err(problem) => {
            if !problem.what.is_empty() {
                terminal::draw(&problem.render(terminal::colour_err()));
            }
            problem.exit as u8
        }
    }
}

/// Help and version go to stdout and are no error; everything else is.
fn print_usage(error: &clap::Error) -> u8 {
    // A reader that went away is nothing to report.
    let _ = error.print();
    (if error.use_stderr() { problem::Exit::Usage } else { problem::Exit::Ok }) as u8
}
