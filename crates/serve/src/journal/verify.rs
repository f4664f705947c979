//! Verifies the hashes of a journal.

use std::fmt;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read as _};
use std::path::Path;

use super::{RECORD_MAX, chain_hash};
use crate::error::SetupError;
use crate::message::JournalRecord;

/// Between a record's text and its hash.
const BEFORE_HASH: &str = ",\"hash\":\"";

/// A journal whose chain holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VerifiedJournal {
    /// Number of records it has.
    pub records: u64,
    /// Bytes of them.
    pub length: u64,
    /// The last one's hash.
    pub hash: [u8; 32],
    /// Bytes after them that are no whole record: the writer was killed.
    pub truncated_bytes: u64,
}

/// The first record of which something is not as it was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BrokenRecord {
    /// Number of the record, from 0.
    pub record: u64,
    /// Reason that it is broken.
    pub why: &'static str,
}

impl fmt::Display for BrokenRecord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "record {} {}", self.record, self.why)
    }
}

/// Reads a journal through.
///
/// # Errors
/// The file cannot be read. The inner error is a fault in its content.
pub fn verify(path: &Path) -> Result<Result<VerifiedJournal, BrokenRecord>, SetupError> {
    let file = File::open(path).map_err(|error| SetupError::file(path, "read", &error))?;
    read(BufReader::new(file), &mut |_, _| {})
        .map_err(|error| SetupError::file(path, "read", &error))
}

/// Reads any journal; calls back with the number and the offset of each record.
pub(super) fn read(
    mut from: impl BufRead,
    each: &mut dyn FnMut(u64, u64),
) -> io::Result<Result<VerifiedJournal, BrokenRecord>> {
    let mut so_far = VerifiedJournal { records: 0, length: 0, hash: [0; 32], truncated_bytes: 0 };
    let mut line = Vec::new();
    loop {
        line.clear();
        let max = RECORD_MAX as u64 + 1;
        from.by_ref().take(max).read_until(b'\n', &mut line)?;
        if line.is_empty() {
            return Ok(Ok(so_far));
        }
        let Some(text) = line.strip_suffix(b"\n") else {
            if line.len() > RECORD_MAX {
                let why = "is longer than any valid record";
                return Ok(Err(BrokenRecord { record: so_far.records, why }));
            }
            so_far.truncated_bytes = line.len() as u64;
            return Ok(Ok(so_far));
        };
        match verify_record(&so_far, text) {
            Ok(hash) => so_far.hash = hash,
            Err(why) => return Ok(Err(BrokenRecord { record: so_far.records, why })),
        }
        each(so_far.records, so_far.length);
        so_far.records += 1;
        so_far.length += line.len() as u64;
    }
}

/// The hash of the next record, if it is the one that was written.
fn verify_record(so_far: &VerifiedJournal, text: &[u8]) -> Result<[u8; 32], &'static str> {
    let text = std::str::from_utf8(text).map_err(|_| "is no text")?;
    let record: JournalRecord = serde_json::from_str(text).map_err(|_| "is no record")?;
    let (covered, _) = text.rsplit_once(BEFORE_HASH).ok_or("has no hash at its end")?;
    if record.n != so_far.records {
        return Err("has a wrong number: a record was removed or inserted before it");
    }
    let hash = chain_hash(&so_far.hash, format!("{covered}}}").as_bytes());
    if text != format!("{covered}{BEFORE_HASH}{}\"}}", hash.to_hex()) {
        return Err("was changed after it was written");
    }
    Ok(*hash.as_bytes())
}
