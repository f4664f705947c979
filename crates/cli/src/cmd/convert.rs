//! `polepair convert FILE|- OUT|- [--from FORMAT] [--to FORMAT]`

use std::io::{self, Read};
use std::path::{Path, PathBuf};

use clap::Args;
use polepair_capture::{
    CaptureFormat, CaptureReader, CaptureWriter, Compression, ReadOptions, Record, WriteError,
};

use crate::capture::{
    TimesArg, is_stream, read_pieces, report_damage, write_problem, written_format,
};
use crate::output_file::{self, OutputFile};
use crate::problem::{self, Exit, Problem, Result};
use crate::terminal::{print_note, print_warning};
use crate::value;

const READ_SIZE: usize = 1 << 16;
/// Kinds of records that found no place and are named one by one.
const UNFIT_MAX: usize = 5;

/// Converts a capture to another file format.
///
/// Reads and writes candump and serial logs, pcap, pcapng, Vector ASC and BLF, PEAK TRC, and the CSV of
/// python-can. Also reads the JSONL of `decode`. Names that end in .gz or .zst are compressed.
#[derive(Args, Debug)]
#[command(after_help = "\
Only log, pcap and pcapng can hold serial bytes. csv and pcap hold one bus.

Examples:
  polepair convert machine.blf machine.log
  polepair convert bus.log bus.pcapng              # for Wireshark
  polepair convert bus.log.gz - --to asc | less")]
pub struct Convert {
    /// Capture to read; - for stdin
    #[arg(value_name = "FILE|-")]
    source: PathBuf,
    /// File to write; - for stdout
    #[arg(value_name = "OUT|-")]
    out: PathBuf,
    /// Format of the input [default: detected from its first bytes]
    #[arg(long, value_name = "FORMAT", value_parser = value::capture_format())]
    from: Option<CaptureFormat>,
    /// Times of a text log: absolute, or differences to the line before (`candump -td`)
    #[arg(long, value_name = "KIND", value_enum, default_value_t = TimesArg::Detect)]
    times: TimesArg,
    /// Format of the output [default: from the name of OUT]
    #[arg(long, value_name = "FORMAT", value_parser = value::capture_format())]
    to: Option<CaptureFormat>,
}

/// Records that found no place: the reason, and how many.
type UnfitCounts = Vec<(&'static str, u64)>;

impl Convert {
    pub fn run(self) -> Result {
        let to = written_format(self.to, &self.out)?;
        output_file::refuse_input(Some(&self.out), [self.source.as_path()])?;
        let compression = Compression::from_path(&self.out);
        let mut writer = CaptureWriter::new(to, compression, self.open_output()?)
            .map_err(|error| write_problem(&self.out, &error))?;
        let (mut reader, mut unfit, mut wrong) = (
            CaptureReader::new(ReadOptions { format: self.from, times: self.times.into() }),
            UnfitCounts::new(),
            None,
        );
        let mut write = |record: &Record<'_>| match writer.write(record) {
            Ok(()) => {}
            Err(WriteError::UnsupportedRecord(why)) => count_unfit(&mut unfit, why),
            Err(error) => wrong = wrong.take().or(Some(error)),
        };
        read_input(&self.source, &mut |piece| {
            reader.feed(piece, &mut write);
            Ok(())
        })?;
        reader.finish(&mut write);
        if let Some(error) = wrong {
            return Err(write_problem(&self.out, &error));
        }
        let written = reader.statistics().records - count_all(&unfit);
        let finished = writer.finish();
        let file = finished.map_err(|error| write_problem(&self.out, &error))?;
        if written > 0 {
            // A result without a record replaces no file.
            file.commit().map_err(|error| problem::file_problem(&self.out, "write", &error))?;
        }
        self.report_result(&reader, to, &unfit)
    }

    fn open_output(&self) -> Result<OutputFile> {
        if self.out.as_os_str() == "-" {
            return Ok(OutputFile::stdout());
        }
        if is_stream(&self.source) {
            return OutputFile::create_followed(&self.out);
        }
        OutputFile::create(&self.out)
    }

    fn report_result(
        &self,
        reader: &CaptureReader,
        to: CaptureFormat,
        unfit: &UnfitCounts,
    ) -> Result {
        for (why, count) in unfit {
            print_warning(&format!("{count} records are skipped: {why}"));
        }
        report_damage(reader.statistics())?;
        let (records, lost) = (reader.statistics().records, count_all(unfit));
        if records == lost {
            let why = match records {
                0 => "The input has no records.".to_owned(),
                _ => format!("{to} has no place for any of the {records} records of the input."),
            };
            return Err(Problem::new(Exit::Negative, "E115", "nothing was converted.").why(why));
        }
        let from = reader.format().map_or("nothing", CaptureFormat::name);
        print_note(&format!("{} records: {from} to {to}", records - lost));
        Ok(if lost > 0 { Exit::Partial } else { Exit::Ok })
    }
}

fn count_all(unfit: &UnfitCounts) -> u64 {
    unfit.iter().map(|(_, count)| count).sum()
}

fn count_unfit(unfit: &mut UnfitCounts, why: &'static str) {
    let known = unfit.iter().position(|(other, _)| *other == why);
    match known.or_else(|| unfit.len().checked_sub(1).filter(|last| last + 1 == UNFIT_MAX)) {
        Some(at) => unfit[at].1 += 1,
        None => unfit.push((why, 1)),
    }
}

fn read_input(path: &Path, each: &mut dyn FnMut(&[u8]) -> Result<()>) -> Result<()> {
    if path.as_os_str() != "-" {
        return read_pieces(path, true, each);
    }
    let mut buffer = vec![0; READ_SIZE];
    loop {
        match io::stdin().read(&mut buffer) {
            Ok(0) => return Ok(()),
            Ok(count) => each(&buffer[..count])?,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(problem::file_problem(path, "read", &error)),
        }
    }
}
