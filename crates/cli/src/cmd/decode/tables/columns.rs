//! Output of `decode` as tables: four Parquet or Arrow files.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use polepair_capture::{CaptureDecoder, DecodedFrame};
use polepair_columns::{
    ArrowError, BatchBuilder, BatchSink, BuiltBatches, CaptureFile, CaptureOrigin, ColumnFormat,
    DictionaryMerger, Provenance, RecordBatch, TableFileError, TableFiles, TableKind,
    TablesBuilder,
};

use crate::capture::{CaptureSource, EventSink, check_readable, is_stream};
use crate::interrupt;
use crate::problem::{self, Exit, Problem, Result};

/// The code of a capture that changed while it was read.
pub const CHANGED: &str = "E307";
/// Batches that wait to be written.
const WAITING_MAX: usize = 2;

/// A capture to decode to columns.
pub struct ColumnsJob<'a> {
    /// The tables.
    pub tables: &'a [TableKind],
    /// The machine or gateway that recorded it.
    pub recorder: &'a str,
    /// Name of the capture in its rows.
    pub file: &'a str,
    /// Content of the capture; `None` for a stream, which is read once only.
    pub capture: Option<&'a CaptureFile>,
    /// The drive whose names were stated.
    pub profile: &'a str,
    /// Threads that decode.
    pub jobs: usize,
}

impl ColumnsJob<'_> {
    fn tables_builder(&self) -> TablesBuilder {
        let origin = CaptureOrigin { source: self.recorder.to_owned(), file: self.file.to_owned() };
        TablesBuilder::new(self.tables, &origin)
    }
}

/// Decodes a capture into a folder with a file for each table.
pub fn decode(
    source: CaptureSource,
    path: &Path,
    out: &Path,
    stored: ColumnFormat,
    wanted: &ColumnsJob<'_>,
) -> Result<CaptureDecoder> {
    let files = TableFiles::create(out, wanted.tables, stored, wanted.jobs);
    let files = files.map_err(|error| write_problem(out, error))?;
    decode_into(source, path, out, Box::new(files), wanted)
}

/// Decodes a capture into what keeps its batches.
pub fn decode_into(
    source: CaptureSource,
    path: &Path,
    out: &Path,
    keep: Box<dyn BatchSink>,
    wanted: &ColumnsJob<'_>,
) -> Result<CaptureDecoder> {
    interrupt::remove_files_at_end();
    let mut columns = ColumnSink::new(keep, out, wanted);
    let source = source.without_words();
    let decoder = if is_stream(path) {
        source.decode(path, &mut columns)?
    } else {
        let mut builders: Vec<_> =
            (0..wanted.jobs).map(|_| BatchBuilder::new(wanted.tables_builder())).collect();
        let put = &mut |builder: &mut BatchBuilder| columns.send_built(builder.take_built());
        let mut decoder = source.decode_parallel(path, &mut builders, put)?;
        decoder.finish_sessions(&mut |event| columns.handle_final(event));
        columns.finish()?;
        decoder
    };
    // A file that is no capture must not be reported as decoded.
    check_readable(decoder.statistics())?;
    if wanted.capture.is_some_and(|capture| !capture.is_unchanged()) {
        return Err(write_problem(out, TableFileError::Changed));
    }
    let provenance = Provenance {
        file: wanted.file.to_owned(),
        blake3: wanted.capture.map(|it| it.content().blake3.clone()).unwrap_or_default(),
        rules: decoder.rules().to_string(),
        profile: wanted.profile.to_owned(),
    };
    columns.close(&provenance)?;
    Ok(decoder)
}

/// The tables that `--tables` names.
pub fn parse_tables(words: Option<&str>) -> Result<Vec<TableKind>> {
    let Some(words) = words else { return Ok(TableKind::ALL.to_vec()) };
    words
        .split(',')
        .map(|word| {
            TableKind::from_name(word.trim()).ok_or_else(|| {
                let known = TableKind::ALL.map(TableKind::name);
                Problem::usage("E250", format!("{word:?} is not a table.")).why(format!(
                    "A decoded capture has the tables {}.",
                    problem::join_list(&known)
                ))
            })
        })
        .collect()
}

/// The content of a capture, whose rows are called by `name`.
pub fn read_capture(path: &Path, name: &str) -> Result<CaptureFile> {
    CaptureFile::read(path, name).map_err(|error| problem::file_problem(path, "read", &error))
}

fn write_problem(out: &Path, error: TableFileError) -> Problem {
    match error {
        TableFileError::Io(error) => problem::file_problem(out, "write", &error),
        TableFileError::Columns(error) => {
            Problem::new(Exit::Adapter, "E303", format!("cannot write {}.", out.display()))
                .why(error.to_string())
        }
        TableFileError::Changed => {
            Problem::new(Exit::Adapter, CHANGED, "the capture changed while it was read.")
                .why("Nothing of it was stored.")
                .hint("decode it again when nothing writes to it")
        }
        TableFileError::TooManyParts => {
            Problem::new(Exit::Corrupt, "E510", "the capture has too many days or buses.")
                .why("Its times are probably not times. Nothing of it was stored.")
                .hint("--times delta reads differences; --from FORMAT states the format")
        }
    }
}

/// Takes columns in order; they are compressed and written on a thread beside.
struct ColumnSink {
    builder: BatchBuilder,
    numbering: DictionaryMerger,
    batches: Option<SyncSender<TableBatch>>,
    writer: Option<JoinHandle<WriterResult>>,
    out: PathBuf,
}

type TableBatch = (TableKind, RecordBatch);
type WriterResult = std::result::Result<Box<dyn BatchSink>, TableFileError>;

impl ColumnSink {
    fn new(keep: Box<dyn BatchSink>, out: &Path, wanted: &ColumnsJob<'_>) -> Self {
        let (batches, waiting) = sync_channel(WAITING_MAX);
        let writer = std::thread::spawn(move || write_batches(keep, &waiting));
        Self {
            builder: BatchBuilder::new(wanted.tables_builder()),
            numbering: DictionaryMerger::default(),
            batches: Some(batches),
            writer: Some(writer),
            out: out.to_owned(),
        }
    }

    /// Sends the built batches.
    fn send_built(&mut self, built: BuiltBatches) -> Result<()> {
        let refused = |error: ArrowError| write_problem(&self.out, error.into());
        let Some(batches) = &self.batches else { return Ok(()) };
        let mut open = true;
        for (table, batch) in built.map_err(refused)? {
            let batch = self.numbering.renumber(table, batch).map_err(refused)?;
            open &= batches.send((table, batch)).is_ok();
        }
        // The writer goes away only when it failed.
        if open { Ok(()) } else { self.join_writer().map(|_| ()) }
    }

    fn join_writer(&mut self) -> Result<Option<Box<dyn BatchSink>>> {
        self.batches = None;
        let Some(writer) = self.writer.take() else { return Ok(None) };
        match writer.join() {
            Ok(written) => written.map(Some).map_err(|error| write_problem(&self.out, error)),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    }

    fn close(mut self, provenance: &Provenance) -> Result<()> {
        let Some(keep) = self.join_writer()? else { return Ok(()) };
        keep.close(provenance).map_err(|error| write_problem(&self.out, error))
    }
}

fn write_batches(mut keep: Box<dyn BatchSink>, waiting: &Receiver<TableBatch>) -> WriterResult {
    for (table, batch) in waiting {
        keep.write_batch(table, &batch)?;
    }
    Ok(keep)
}

impl EventSink for ColumnSink {
    fn handle_event(&mut self, event: &DecodedFrame<'_>) {
        self.builder.tables.add_event(event);
    }

    fn flush(&mut self, now: bool) -> Result<()> {
        if !now && !self.builder.tables.is_full() {
            return Ok(());
        }
        self.builder.flush();
        let built = self.builder.take_built();
        self.send_built(built)
    }

    fn handle_final(&mut self, event: &DecodedFrame<'_>) {
        self.builder.tables.add_final_notices(event.link, event.notices);
    }
}
