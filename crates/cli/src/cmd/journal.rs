//! `polepair journal verify [FILE]`: whether a journal is as it was written.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use polepair_serve::journal::verify;

use super::serve;
use crate::problem::{Exit, Problem, Result};
use crate::terminal::{DataOutput, print_note};

/// The journal of `polepair serve`.
#[derive(Subcommand, Debug)]
pub enum JournalCommand {
    /// Check that no record was changed, taken out or put in
    Verify(JournalVerify),
}

/// Checks that no record was changed, taken out or put in, and names the first that was.
///
/// Each record has a hash over itself and all before it. What was cut off at the end leaves no trace:
/// who must know that as well compares the last hash with one kept elsewhere.
#[derive(Args, Debug)]
pub struct JournalVerify {
    /// The journal; that of your account's server unless told
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,
}

impl JournalCommand {
    pub fn run(self) -> Result {
        let Self::Verify(JournalVerify { file }) = self;
        let file = match file {
            Some(file) => file,
            None => serve::state_folder()?.join("journal.jsonl"),
        };
        let verified = verify(&file).map_err(serve::refusal_problem)?.map_err(|broken| {
            Problem::new(Exit::Negative, "E114", format!("{}: {broken}.", file.display()))
                .why("It, or what stands after it, is not what the server wrote.")
        })?;
        let mut out = DataOutput::stdout();
        let hash: String = verified.hash.iter().map(|byte| format!("{byte:02x}")).collect();
        out.write_line(&format!("{} records, whole; the last hash is {hash}", verified.records));
        out.flush()?;
        if verified.truncated_bytes > 0 {
            print_note(&format!(
                "After them {} bytes of a record without end: the server was killed, or writes it.",
                verified.truncated_bytes
            ));
        }
        Ok(Exit::Ok)
    }
}
