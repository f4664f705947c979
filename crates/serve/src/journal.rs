//! The journal: actions and their clients, recorded before they are executed.
//!
//! A file of JSON lines that is only appended to. Each record has the BLAKE3 hash of the previous hash and
//! its own text, so a changed, removed or inserted record is detected. Records that are cut off at the end
//! are not detected; keep the last hash elsewhere for that. A record is passed to the operating system
//! before the caller continues. It survives the process, but not a power loss.
//!
//! Why: GW-24.

mod verify;

use polepair::url::without_axes;
use polepair_core::convert::saturating;
use std::fs::{File, OpenOptions};
use std::io::{BufRead as _, BufReader, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use polepair::url::shell_word;
use polepair_link::clock;
use serde::Serialize;
use serde_json::Value;

use crate::error::SetupError;
use crate::message::{GatewayError, JournalAction, JournalRecord};

pub use verify::{BrokenRecord, VerifiedJournal, verify};

/// Every how many records a place in the file is remembered.
const STRIDE: u64 = 256;
/// Records of an answer.
pub const RECORDS_MAX: usize = 1000;
/// Bytes of a record; longer ones are refused.
pub const RECORD_MAX: usize = 64 * 1024;

/// A journal that is written.
#[derive(Debug)]
pub struct JournalFile {
    path: PathBuf,
    /// End of the file, locked by its writer while the disk takes its time.
    tail: Mutex<JournalTail>,
    index: Mutex<JournalIndex>,
}

#[derive(Debug)]
struct JournalTail {
    file: File,
    hash: [u8; 32],
}

/// Index for readers.
#[derive(Debug)]
struct JournalIndex {
    records: u64,
    length: u64,
    /// Offsets of records 0, [`STRIDE`], 2 [`STRIDE`], …
    offsets: Vec<u64>,
}

/// Fields of a record that its hash covers, in written order.
#[derive(Serialize)]
struct HashedRecord<'a> {
    n: u64,
    ms: f64,
    who: &'a str,
    deed: JournalAction,
    axis: Option<u16>,
    detail: &'a Value,
}

impl JournalFile {
    /// Opens a journal to go on with it, or begins one. Returns also how many bytes of a record were
    /// found that had no end; they are taken out.
    ///
    /// # Errors
    /// The file cannot be opened, another server has it, or its chain is broken.
    pub fn open(path: &Path) -> Result<(Self, u64), SetupError> {
        let failed = |error: std::io::Error| SetupError::file(path, "write", &error);
        let mut options = OpenOptions::new();
        // Appending, so that a second writer could never overwrite a record.
        options.read(true).append(true).create(true);
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
        let file = options.open(path).map_err(failed)?;
        // Two servers would each continue the chain of hashes, and both would break it.
        if file.try_lock().is_err() {
            let what = format!("another server writes {}", path.display());
            return Err(
                SetupError::adapter("E312", what).hint("end that server, or use another folder")
            );
        }
        let mut places = Vec::new();
        let verified = verify::read(BufReader::new(&file), &mut |n, at| {
            if n.is_multiple_of(STRIDE) {
                places.push(at);
            }
        });
        let verified = verified.map_err(failed)?.map_err(|broken| {
            let changed = "The file was changed after it was written.";
            SetupError::usage("E253", format!("{}: {broken}", path.display()))
                .why(format!("{changed}{}", pending_stops_hint(path)))
                .hint("keep the file for an investigation, and start a new one")
        })?;
        if verified.truncated_bytes > 0 {
            // Half a record at the end is a server that was cut off while it wrote. The chain before it is whole.
            file.set_len(verified.length).map_err(failed)?;
        }
        let VerifiedJournal { records, length, hash, truncated_bytes } = verified;
        let tail = Mutex::new(JournalTail { file, hash });
        let written = Mutex::new(JournalIndex { records, length, offsets: places });
        Ok((Self { path: path.to_owned(), tail, index: written }, truncated_bytes))
    }

    /// Writes a record. It is in the system's hands when this returns.
    ///
    /// # Errors
    /// `gateway.journal` when it cannot be written: the announced act must then not be done.
    pub fn write(
        &self,
        who: &str,
        action: JournalAction,
        axis: Option<u16>,
        detail: &Value,
    ) -> Result<u64, GatewayError> {
        let mut tail = self.tail.lock().unwrap_or_else(PoisonError::into_inner);
        // Records into a file that was removed would be lost, and the server would not notice.
        self.check_place(&tail.file)?;
        let (n, length) = {
            let written = self.lock_index();
            (written.records, written.length)
        };
        let ms = clock::wall_ns(clock::now()) as f64 / 1e6;
        let covered = HashedRecord { n, ms, who, deed: action, axis, detail };
        let text = serde_json::to_string(&covered).map_err(|error| journal_error(&error))?;
        let hash = chain_hash(&tail.hash, text.as_bytes());
        let line = format!("{},\"hash\":\"{}\"}}\n", &text[..text.len() - 1], hash.to_hex());
        if line.len() > RECORD_MAX {
            return Err(GatewayError::new(
                "gateway.size",
                "too much for one record of the journal",
            ));
        }
        if let Err(error) = tail.file.write_all(line.as_bytes()) {
            // Half a record would break the chain for all that come after.
            let _ = tail.file.set_len(length);
            return Err(journal_error(&error));
        }
        tail.hash = *hash.as_bytes();
        let mut written = self.lock_index();
        if n.is_multiple_of(STRIDE) {
            written.offsets.push(length);
        }
        written.length += line.len() as u64;
        debug_assert_eq!(n, written.records, "records are numbered without gaps");
        written.records += 1;
        Ok(n)
    }

    /// Number of records it has. Each lease is one, so by this its epochs are never given twice.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.lock_index().records
    }

    /// Axes with a pending stop by its records, by their link's connection string and their number.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn pending_stops(&self) -> std::io::Result<Vec<(String, u32)>> {
        read_pending_stops(&self.path)
    }

    /// Records after the one of that number, or from the first; at most `count`, and [`RECORDS_MAX`].
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn records(
        &self,
        after: Option<u64>,
        count: usize,
    ) -> Result<Vec<JournalRecord>, GatewayError> {
        let first = after.map_or(0, |n| n.saturating_add(1));
        let (index, length) = {
            let written = self.lock_index();
            let stride = saturating::<usize>(first / STRIDE);
            (written.offsets.get(stride).copied(), written.length)
        };
        let Some(index) = index else { return Ok(Vec::new()) };
        let mut file = File::open(&self.path).map_err(|error| journal_error(&error))?;
        file.seek(SeekFrom::Start(index)).map_err(|error| journal_error(&error))?;
        debug_assert!(index <= length, "an index points into the written part");
        let whole = std::io::Read::take(file, length - index);
        let mut records = Vec::new();
        for line in BufReader::new(whole).lines() {
            if records.len() >= count.min(RECORDS_MAX) {
                break;
            }
            let line = line.map_err(|error| journal_error(&error))?;
            let Ok(record) = serde_json::from_str::<JournalRecord>(&line) else { continue };
            if record.n >= first {
                records.push(record);
            }
        }
        Ok(records)
    }

    /// Checks that the file is still at its path. A removed or renamed one would keep records that no user finds, and
    /// another server may begin a journal in its place.
    fn check_place(&self, file: &File) -> Result<(), GatewayError> {
        let is_there = match (file.metadata(), std::fs::metadata(&self.path)) {
            (Ok(open), Ok(there)) => is_same_file(&open, &there),
            _ => false,
        };
        if is_there {
            return Ok(());
        }
        let what = format!("the journal {} was removed or replaced", self.path.display());
        Err(GatewayError::new("gateway.journal", what)
            .hint("stop all motors, end the server, put the file back, and start it again"))
    }

    fn lock_index(&self) -> MutexGuard<'_, JournalIndex> {
        self.index.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Axes with a pending stop by a journal with broken records.
fn read_pending_stops(path: &Path) -> std::io::Result<Vec<(String, u32)>> {
    let mut pending = Vec::new();
    for line in BufReader::new(File::open(path)?).split(b'\n') {
        let line = line?;
        let line = String::from_utf8_lossy(&line);
        // Most lines are about something else, and there may be many.
        let is_meant = ["\"stop_pending\"", "\"stop_ended\""].iter().any(|d| line.contains(d));
        let Some(record) = is_meant.then(|| serde_json::from_str::<JournalRecord>(&line).ok())
        else {
            continue;
        };
        let Some(JournalRecord { deed, detail, .. }) = record else { continue };
        let number = detail["number"].as_u64().and_then(|number| u32::try_from(number).ok());
        let (Some(link), Some(number)) = (detail["link"].as_str(), number) else { continue };
        pending.retain(|axis: &(String, u32)| (&*axis.0, axis.1) != (link, number));
        if deed == JournalAction::StopPending {
            pending.push((link.to_owned(), number));
        }
    }
    Ok(pending)
}

/// A sentence that names them, for a user whose server cannot continue that journal; empty if there are none.
fn pending_stops_hint(path: &Path) -> String {
    let Ok(pending) = read_pending_stops(path) else {
        return " Whether a stop of it was left unconfirmed cannot be read.".to_owned();
    };
    let stops: Vec<String> = pending
        .into_iter()
        .map(|(link, number)| {
            let url = without_axes(&link).to_owned();
            format!("`polepair stop {}`", shell_word(&format!("{url}#{number}")))
        })
        .collect();
    if stops.is_empty() {
        String::new()
    } else {
        format!(
            " By what can be read of it motors received a stop and their standstill was not \
             confirmed; to stop them: {}.",
            stops.join(", ")
        )
    }
}

/// The hash of a record's text without its hash, after another.
fn chain_hash(before: &[u8; 32], text: &[u8]) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    hasher.update(before).update(text);
    hasher.finalize()
}

#[cfg(unix)]
fn is_same_file(open: &std::fs::Metadata, there: &std::fs::Metadata) -> bool {
    use std::os::unix::fs::MetadataExt as _;
    (open.dev(), open.ino()) == (there.dev(), there.ino())
}

/// The file's number is not available here. Its length and creation time are those of the open file, unless it was
/// replaced.
#[cfg(not(unix))]
fn is_same_file(open: &std::fs::Metadata, there: &std::fs::Metadata) -> bool {
    open.len() == there.len() && open.created().ok() == there.created().ok()
}

fn journal_error(error: &dyn std::fmt::Display) -> GatewayError {
    GatewayError::new("gateway.journal", format!("the journal cannot be kept: {error}"))
        .hint("free space on the disk; until then motors can be stopped, but not moved")
}

#[cfg(test)]
mod tests;
