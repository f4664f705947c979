//! `polepair journal verify [FILE]`: checks that no record of a journal was changed.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use polepair_serve::journal::verify;

use super::serve;
use crate::data_output::DataOutput;
use crate::problem::{Exit, Problem, Result};
use crate::terminal::print_note;

/// The journal of `polepair serve`.
#[derive(Subcommand, Debug)]
pub enum JournalCommand {
    /// Check that no record was changed, removed or inserted
    Verify(JournalVerify),
}

/// Checks that no record was changed, removed or inserted, and names the first bad record.
///
/// Each record contains a hash of itself and of all records before it. Records that were cut off at the end
/// cannot be detected this way. To detect that too, compare the last hash with a copy kept elsewhere.
#[derive(Args, Debug)]
pub struct JournalVerify {
    /// Journal file [default: that of your account's server]
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
                .why("This record, or a later one, is not as the server wrote it.")
        })?;
        let mut out = DataOutput::stdout();
        let hash: String = verified.hash.iter().map(|byte| format!("{byte:02x}")).collect();
        out.write_line(&format!("{} records, complete; the last hash is {hash}", verified.records));
        out.flush()?;
        if verified.truncated_bytes > 0 {
            print_note(&format!(
                "After them {} bytes of an incomplete record: the server was killed, or is \
                 writing it.",
                verified.truncated_bytes
            ));
        }
        Ok(Exit::Ok)
    }
}
