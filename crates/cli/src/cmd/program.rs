//! `polepair program assemble|load|verify|save|run|call|abort`

mod files;
mod run;

use clap::{Args, Subcommand};

use crate::problem::{Problem, Result};
use crate::session::Session;
use polepair::Axis;

/// Makes programs, puts them into a drive's memory, and runs them.
#[derive(Args, Debug)]
pub struct ProgramArgs {
    #[command(subcommand)]
    verb: ProgramVerb,
}

#[derive(Subcommand, Debug)]
enum ProgramVerb {
    /// Turn a program's text into a software file (.sw), or the reverse
    Assemble(files::Assemble),
    /// Write a program into a drive's memory, proven by the drive's own sum
    Load(files::ProgramLoad),
    /// Compare a drive's memory with a program, by sums
    Verify(files::ProgramVerify),
    /// Keep what is in a drive's memory as a file
    Save(files::ProgramSave),
    /// Have a drive go on at an address of its program, until Ctrl-C
    Run(run::ProgramRun),
    /// Have a drive call a routine, and wait for its end
    Call(run::ProgramCall),
    /// End whatever program a drive runs, and its motion
    Abort(run::Abort),
}

impl ProgramArgs {
    pub fn run(self) -> Result {
        match self.verb {
            ProgramVerb::Assemble(verb) => verb.run(),
            ProgramVerb::Load(verb) => verb.run(),
            ProgramVerb::Verify(verb) => verb.run(),
            ProgramVerb::Save(verb) => verb.run(),
            ProgramVerb::Run(verb) => verb.run(),
            ProgramVerb::Call(verb) => verb.run(),
            ProgramVerb::Abort(verb) => verb.run(),
        }
    }
}

/// The axis, where a program is one drive's.
fn single_axis(session: &Session) -> Result<&Axis> {
    match session.axes() {
        [axis] => Ok(axis),
        _ => Err(Problem::usage("E210", "A program is for one axis.")
            .why("Name it in the connection string: URL#1.")),
    }
}

/// `0x4000`, or decimal.
fn parse_address(text: &str) -> std::result::Result<u16, String> {
    let digits = text.strip_prefix("0x").or_else(|| text.strip_prefix("0X"));
    let number = match digits {
        Some(digits) => u16::from_str_radix(digits, 16),
        None => text.parse(),
    };
    number.map_err(|_| "expected an address such as 0x4000".to_owned())
}
