//! A capture as columns: four tables as Parquet or Arrow files.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use polepair_capture::{Decoder, Event};
use polepair_columns::{
    ArrowError, Builder, Built, Files, Keep, Numbering, Origin, Provenance, RecordBatch,
    StoreError, Stored, Table, Tables,
};

use crate::capture::{Sink, Source};
use crate::problem::{self, Exit, Problem, Result};

/// Batches that wait to be written.
const WAITING_MAX: usize = 2;

/// What becomes of a capture.
pub struct Wanted<'a> {
    /// The tables.
    pub tables: &'a [Table],
    /// The machine or gateway that recorded it.
    pub recorder: &'a str,
    /// What its rows are called by.
    pub file: &'a str,
    /// Its fingerprint.
    pub blake3: String,
    /// The drive whose names were stated.
    pub profile: &'a str,
    /// Threads that decode.
    pub jobs: usize,
}

impl Wanted<'_> {
    fn tables(&self) -> Tables {
        let origin = Origin { source: self.recorder.to_owned(), file: self.file.to_owned() };
        Tables::new(self.tables, &origin)
    }
}

/// Decodes a capture into a folder with a file for each table.
pub fn decode(
    source: Source,
    path: &Path,
    out: &Path,
    stored: Stored,
    wanted: &Wanted<'_>,
) -> Result<Decoder> {
    let files = Files::create(out, wanted.tables, stored, wanted.jobs);
    let files = files.map_err(|error| refused(out, error))?;
    into(source, path, out, Box::new(files), wanted)
}

/// Decodes a capture into what keeps its batches.
pub fn into(
    source: Source,
    path: &Path,
    out: &Path,
    keep: Box<dyn Keep>,
    wanted: &Wanted<'_>,
) -> Result<Decoder> {
    let mut columns = Columns::new(keep, out, wanted);
    let source = source.without_words();
    let decoder = match path.as_os_str() == "-" {
        true => source.read(path, &mut columns)?,
        false => {
            let mut builders: Vec<_> =
                (0..wanted.jobs).map(|_| Builder::new(wanted.tables())).collect();
            let put = &mut |builder: &mut Builder| columns.send(builder.built());
            let mut decoder = source.read_by(path, &mut builders, put)?;
            decoder.ending(&mut |event| columns.ending(event));
            columns.finish()?;
            decoder
        }
    };
    let provenance = Provenance {
        file: wanted.file.to_owned(),
        blake3: wanted.blake3.clone(),
        rules: decoder.rules().to_string(),
        profile: wanted.profile.to_owned(),
    };
    columns.close(&provenance)?;
    Ok(decoder)
}

/// The tables that `--tables` names.
pub fn tables(words: Option<&str>) -> Result<Vec<Table>> {
    let Some(words) = words else { return Ok(Table::ALL.to_vec()) };
    let named = |word: &str| {
        Table::named(word.trim()).ok_or_else(|| {
            let known = Table::ALL.map(Table::name);
            Problem::usage("E250", format!("{word:?} is no table."))
                .why(format!("A decoded capture has the tables {}.", problem::list(&known)))
        })
    };
    words.split(',').map(named).collect()
}

/// The fingerprint of a capture; empty for stdin, which passes but once.
pub fn fingerprint(path: &Path) -> Result<String> {
    if path.as_os_str() == "-" {
        return Ok(String::new());
    }
    polepair_columns::fingerprint(path).map_err(|error| problem::file(path, "read", &error))
}

fn refused(out: &Path, error: StoreError) -> Problem {
    match error {
        StoreError::Io(error) => problem::file(out, "write", &error),
        StoreError::Columns(error) => {
            Problem::new(Exit::Adapter, "E303", format!("cannot write {}.", out.display()))
                .why(error.to_string())
        }
    }
}

/// Takes columns in order; they are compressed and written on a thread beside.
struct Columns {
    own: Builder,
    numbering: Numbering,
    batches: Option<SyncSender<Batch>>,
    writer: Option<JoinHandle<Written>>,
    out: PathBuf,
}

type Batch = (Table, RecordBatch);
type Written = std::result::Result<Box<dyn Keep>, StoreError>;

impl Columns {
    fn new(keep: Box<dyn Keep>, out: &Path, wanted: &Wanted<'_>) -> Self {
        let (batches, waiting) = sync_channel(WAITING_MAX);
        let writer = std::thread::spawn(move || write(keep, &waiting));
        Self {
            own: Builder::new(wanted.tables()),
            numbering: Numbering::default(),
            batches: Some(batches),
            writer: Some(writer),
            out: out.to_owned(),
        }
    }

    /// Sends what was built.
    fn send(&mut self, built: Built) -> Result<()> {
        let refused = |error: ArrowError| refused(&self.out, error.into());
        let Some(batches) = &self.batches else { return Ok(()) };
        let mut open = true;
        for (table, batch) in built.map_err(refused)? {
            let batch = self.numbering.number(table, batch).map_err(refused)?;
            open &= batches.send((table, batch)).is_ok();
        }
        // The writer goes away only when it failed.
        if open { Ok(()) } else { self.written().map(|_| ()) }
    }

    fn written(&mut self) -> Result<Option<Box<dyn Keep>>> {
        self.batches = None;
        let Some(writer) = self.writer.take() else { return Ok(None) };
        match writer.join() {
            Ok(written) => written.map(Some).map_err(|error| refused(&self.out, error)),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    }

    fn close(mut self, provenance: &Provenance) -> Result<()> {
        let Some(keep) = self.written()? else { return Ok(()) };
        keep.close(provenance).map_err(|error| refused(&self.out, error))
    }
}

fn write(mut keep: Box<dyn Keep>, waiting: &Receiver<Batch>) -> Written {
    for (table, batch) in waiting {
        keep.batch(table, &batch)?;
    }
    Ok(keep)
}

impl Sink for Columns {
    fn take(&mut self, event: &Event<'_>) {
        self.own.tables.take(event);
    }

    fn settle(&mut self, now: bool) -> Result<()> {
        if !now && !self.own.tables.is_full() {
            return Ok(());
        }
        self.own.flush();
        let built = self.own.built();
        self.send(built)
    }

    fn ending(&mut self, event: &Event<'_>) {
        self.own.tables.ending(event.link, event.notices);
    }
}
