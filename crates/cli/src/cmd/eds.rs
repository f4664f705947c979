//! `polepair eds URL [-o FILE]`

use std::path::PathBuf;

use clap::Args;
use polepair::eds::{Eds, SheetValues};

use crate::data_output::DataOutput;
use crate::outcome;
use crate::output_file;
use crate::problem::{Exit, Problem, Result};
use crate::progress::Progress;
use crate::target::DriveArgs;
use crate::terminal::print_note;
use crate::value::plural;

/// Writes the data sheet of a CANopen drive: an EDS, or a DCF with the values that the drive has now.
///
/// The sheet has the objects of the drive's profile, and the identity that the drive reports. Masters and other
/// programs read it.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair eds canopen+socketcan://can0#5 -o drive.eds
  polepair eds canopen+socketcan://can0#5 -o node5.dcf
  polepair eds sim:syntron-ts-canopen -o ts.eds")]
pub struct EdsCommand {
    #[command(flatten)]
    target: DriveArgs,
    /// File to write; with the ending .dcf, it has the drive's values [default: an EDS on stdout]
    #[arg(long, short = 'o', value_name = "FILE")]
    output: Option<PathBuf>,
    /// Read the drive's values, whatever the ending of the file
    #[arg(long)]
    dcf: bool,
}

impl EdsCommand {
    pub fn run(self) -> Result {
        output_file::refuse_input(self.output.as_deref(), self.target.profiles.path())?;
        let session = self.target.open()?;
        session.listen_for_interrupts();
        let [axis] = session.axes() else {
            return Err(Problem::usage("E212", "a data sheet is of one drive.")
                .hint("name one axis in the connection string: #5"));
        };
        let ending = self.output.as_deref().and_then(|file| file.extension());
        let is_dcf = self.dcf || ending.is_some_and(|ending| ending.eq_ignore_ascii_case("dcf"));
        let values = if is_dcf { SheetValues::OfDrive } else { SheetValues::None };
        let bar = Progress::of_count(0, &format!("objects of {}", axis.label()));
        let sheet = Eds::of_drive(axis, values, &mut |done, of| bar.set_of(done, of));
        drop(bar);
        let sheet = sheet.map_err(outcome::to_problem)?;
        let mut out = DataOutput::to_path(self.output.as_deref())?;
        out.buffer().extend_from_slice(sheet.to_string().as_bytes());
        out.finish()?;
        if let Some(file) = self.output.as_deref().filter(|file| file.as_os_str() != "-") {
            let objects = plural(sheet.objects.len() as u64, "object");
            print_note(&format!("{objects} written to {}", file.display()));
        }
        Ok(Exit::Ok)
    }
}
