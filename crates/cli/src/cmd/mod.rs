//! The verbs, one file each.

mod completions;
mod decode;
mod encode;
mod explain;

use clap::{Parser, Subcommand};

use crate::problem::Result;

/// Talk to motor drives, simulate them, and read what others said to them.
///
/// Drives are named by connection strings:
///   tmcl+serial:///dev/ttyUSB0:9600#1     modbus-rtu+tcp://10.0.0.5:4001#1,2     sim:tmcl
#[derive(Parser, Debug)]
#[command(name = "polepair", version, verbatim_doc_comment, max_term_width = 100)]
#[command(disable_help_subcommand = true, after_help = AFTER)]
pub struct Arguments {
    /// What to do.
    #[command(subcommand)]
    pub verb: Verb,
}

const AFTER: &str = "\
Exit codes: 0 ok, 1 negative result, 2 usage, 3 no adapter or permission, 4 no reply,
5 corrupt or foreign reply, 6 the drive refused, 7 partial, 8 drive fault, 130 interrupted.
Data goes to stdout, prose to stderr. NO_COLOR is honoured.";

/// The verbs.
#[derive(Subcommand, Debug)]
pub enum Verb {
    /// Explain the frames of a capture
    Decode(decode::Decode),
    /// Turn text into the bytes of a frame
    Encode(encode::Encode),
    /// Say what a fault, a status, an exception or a frame means
    Explain(explain::Explain),
    /// Print a completion script for a shell
    Completions(completions::Completions),
}

/// Carries a verb out.
pub fn run(verb: Verb) -> Result {
    match verb {
        Verb::Decode(verb) => verb.run(),
        Verb::Encode(verb) => verb.run(),
        Verb::Explain(verb) => verb.run(),
        Verb::Completions(verb) => verb.run(),
    }
}
