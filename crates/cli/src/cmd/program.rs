//! `polepair program assemble|load|verify|save|run|step|break|call|stop`

mod ending;
mod files;
mod instructions;
mod run;

use clap::{Args, Subcommand};

use crate::problem::{Problem, Result};
use crate::session::LocalSession;
use polepair::LocalAxis;

/// Assembles, loads and runs programs in the memory of a drive.
#[derive(Args, Debug)]
pub struct ProgramArgs {
    #[command(subcommand)]
    verb: ProgramVerb,
}

#[derive(Subcommand, Debug)]
enum ProgramVerb {
    /// Convert program text to a file for the drive (.sw, .bin), or back
    Assemble(files::Assemble),
    /// Write a program to the drive's memory, and verify it
    Load(files::ProgramLoad),
    /// Compare the drive's memory with a program
    Verify(files::ProgramVerify),
    /// Save the drive's memory to a file
    Save(files::ProgramSave),
    /// Run a program from an address, until it ends or until Ctrl-C
    Run(run::ProgramRun),
    /// Execute a TMCL program one instruction at a time
    Step(instructions::ProgramStep),
    /// Execute a TMCL program up to a breakpoint
    Break(instructions::ProgramBreak),
    /// Call a routine of the program, and wait until it returns
    Call(run::ProgramCall),
    /// End the running program and its motion
    #[command(alias = "abort")]
    Stop(run::ProgramStop),
}

impl ProgramArgs {
    pub fn run(self) -> Result {
        match self.verb {
            ProgramVerb::Assemble(verb) => verb.run(),
            ProgramVerb::Load(verb) => verb.run(),
            ProgramVerb::Verify(verb) => verb.run(),
            ProgramVerb::Save(verb) => verb.run(),
            ProgramVerb::Run(verb) => verb.run(),
            ProgramVerb::Step(verb) => verb.run(),
            ProgramVerb::Break(verb) => verb.run(),
            ProgramVerb::Call(verb) => verb.run(),
            ProgramVerb::Stop(verb) => verb.run(),
        }
    }
}

/// The axis, where a program is one drive's.
fn single_axis(session: &LocalSession) -> Result<&LocalAxis> {
    match session.axes() {
        [axis] => Ok(axis),
        _ => Err(Problem::usage("E210", "A program is for one axis.")
            .why("Name it in the connection string: URL#1.")),
    }
}

/// Axis of a module's program: the first of its motors.
fn module_axis(session: &LocalSession) -> Result<&LocalAxis> {
    use polepair_core::proto::drive_address;
    let mut modules = session.axes().iter().map(|axis| drive_address(axis.number()));
    match (modules.next(), session.axes()) {
        (Some(first), [axis, _, ..])
            if instructions::is_module(axis) && modules.all(|it| it == first) =>
        {
            Ok(axis)
        }
        _ => single_axis(session),
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
