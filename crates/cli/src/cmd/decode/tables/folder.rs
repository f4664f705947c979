//! Decodes a folder of captures to one partitioned data set.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use polepair_capture::CaptureFormat;
use polepair_capture::Remark;
use polepair_columns::{DatasetSite, DatasetWriter, DecodeRecord, TableKind, note_copy};

use super::columns::{self, ColumnsJob};
use crate::capture::{self, CaptureArgs};
use crate::problem::{self, Exit, Problem, Result};
use crate::progress::Progress;
use crate::terminal::{colour_err, print_warning};

/// Captures that are decoded at once at most: each holds row groups in memory.
const WORKERS_MAX: usize = 4;

/// Result of one capture.
pub struct CaptureReport {
    /// False where the data set had it already.
    pub is_new: bool,
    /// Frames were left out.
    pub is_partial: bool,
    /// Parts that were left out, and doubtful ones.
    pub remarks: Vec<String>,
}

/// A folder to decode.
pub struct FolderJob<'a> {
    /// Folder of the captures.
    pub captures: &'a Path,
    /// Stated properties of all captures.
    pub stated: &'a CaptureArgs,
    /// Target data set.
    pub site: DatasetSite,
    /// The machine or gateway that recorded them.
    pub recorder: &'a str,
    /// The tables.
    pub tables: &'a [TableKind],
    /// Threads that decode.
    pub jobs: usize,
}

/// Tally of the captures.
#[derive(Default)]
struct FolderTally {
    decoded: usize,
    already_decoded: usize,
    unreadable: usize,
    /// Captures that were written to while they were read.
    changing: usize,
    /// Captures of which frames were left out.
    partial: usize,
}

impl FolderJob<'_> {
    /// Decodes the new captures. One that cannot be read is reported and skipped.
    pub fn decode(&self) -> Result {
        self.stated.source()?;
        let mut captures = Vec::new();
        self.collect_captures(self.captures, &mut captures)?;
        captures.sort();
        if captures.is_empty() {
            let what = format!("there is no capture in {}.", self.captures.display());
            let endings = "Captures are recognised by the ending of their names: log, pcap, blf \
             and so on.";
            return Err(Problem::usage("E250", what).why(endings));
        }
        let (next, tally) = (AtomicUsize::new(0), Mutex::new(FolderTally::default()));
        let bar = Progress::of_count(captures.len(), "captures");
        let workers = self.jobs.min(WORKERS_MAX).min(captures.len());
        let jobs = self.jobs / workers;
        std::thread::scope(|scope| {
            for _ in 0..workers {
                scope.spawn(|| {
                    while let Some(path) = captures.get(next.fetch_add(1, Ordering::Relaxed)) {
                        let name = path.strip_prefix(self.captures).unwrap_or(path);
                        let done = self.decode_one(path, &name.display().to_string(), jobs);
                        bar.suspend(|| count_result(&tally, path, done));
                        bar.add(1);
                    }
                });
            }
        });
        drop(bar);
        let tally = tally.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
        let FolderTally { decoded, already_decoded, unreadable, changing, partial } = tally;
        let changed = match changing {
            0 => String::new(),
            count => format!(", {count} changed while they were read"),
        };
        print_warning(&format!(
            "{decoded} decoded, {already_decoded} were decoded earlier, {unreadable} could not be \
             read{changed}"
        ));
        Ok(match (unreadable, changing + partial) {
            (0, 0) => Exit::Ok,
            (0, _) => Exit::Partial,
            _ => Exit::Corrupt,
        })
    }

    /// Captures in a folder and in its folders, without hidden ones and the data set itself.
    fn collect_captures(&self, folder: &Path, captures: &mut Vec<PathBuf>) -> Result<()> {
        let failed = |error| problem::file_problem(folder, "read", &error);
        for entry in std::fs::read_dir(folder).map_err(failed)? {
            let entry = entry.map_err(failed)?;
            let (path, kind) = (entry.path(), entry.file_type().map_err(failed)?);
            let hidden = entry.file_name().as_encoded_bytes().starts_with(b".");
            if hidden || path == self.site.root {
                continue;
            }
            if kind.is_dir() {
                self.collect_captures(&path, captures)?;
            } else if CaptureFormat::from_path(&path).is_some() {
                captures.push(path);
            }
        }
        Ok(())
    }

    /// Decodes one capture, with the name `file` in its rows, on `jobs` threads.
    pub fn decode_one(&self, path: &Path, file: &str, jobs: usize) -> Result<CaptureReport> {
        let capture = columns::read_capture(path, file)?;
        let done = self.record(&capture.content().blake3);
        if done.exists(&self.site) {
            let noted = note_copy(&self.site, &capture);
            noted.map_err(|error| problem::file_problem(&self.site.root, "write", &error))?;
            return Ok(CaptureReport { is_new: false, is_partial: false, remarks: Vec::new() });
        }
        let wanted = ColumnsJob {
            tables: self.tables,
            recorder: self.recorder,
            file,
            capture: Some(&capture),
            profile: self.stated.profile_word(),
            jobs,
        };
        let parts = DatasetWriter::new(self.site.clone(), done, capture.clone(), self.jobs);
        let parts = Box::new(parts);
        let source = self.stated.source()?.quiet();
        let decoder = columns::decode_into(source, path, &self.site.root, parts, &wanted)?;
        let doubtful = decoder.detections().iter().filter(|found| capture::is_doubtful(found));
        let left_out = Remark::of_decoder(&decoder);
        let remarks = doubtful
            .map(capture::detection_text)
            .chain(left_out.iter().map(Remark::text).map(str::to_owned))
            .collect();
        Ok(CaptureReport { is_new: true, is_partial: decoder.untracked_records() > 0, remarks })
    }

    /// The note of a decoded capture, with all that its parts depend on.
    pub fn record(&self, blake3: &str) -> DecodeRecord {
        DecodeRecord::new(&self.site, blake3, &self.stated.describe(), self.tables)
    }
}

fn count_result(tally: &Mutex<FolderTally>, path: &Path, done: Result<CaptureReport>) {
    let mut tally = tally.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    match done {
        Ok(CaptureReport { is_new: true, is_partial, remarks }) => {
            tally.decoded += 1;
            tally.partial += usize::from(is_partial);
            for remark in remarks {
                print_warning(&format!("{}: {remark}", path.display()));
            }
        }
        Ok(_) => tally.already_decoded += 1,
        Err(problem) => {
            if problem.code == columns::CHANGED {
                tally.changing += 1;
            } else {
                tally.unreadable += 1;
            }
            print_warning(&format!("{}: left out", path.display()));
            print_warning(problem.render(colour_err()).trim_end());
        }
    }
}
