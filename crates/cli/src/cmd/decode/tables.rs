//! Output of `decode` as tables: a folder of files, or a data set of many captures.

mod columns;
pub mod dataset;
mod folder;

use std::path::Path;

use polepair_columns::{ColumnFormat, DatasetSite, TableKind};

use super::{Decode, DecodeFormat};
use crate::capture::{is_stream, job_count, report_left_out};
use crate::problem::{Problem, Result};
use columns::ColumnsJob;
use folder::FolderJob;

impl Decode {
    /// Decodes a capture into a folder of tables.
    pub(super) fn decode_columns(&self) -> Result {
        let stored = match self.output_format() {
            DecodeFormat::Arrow => ColumnFormat::Arrow,
            _ => ColumnFormat::Parquet,
        };
        let (out, source) = (self.output_folder()?, self.stated.source()?.with_progress(true));
        let tables = columns::parse_tables(self.tables.as_deref())?;
        let file = self.source.file_name().unwrap_or_default().to_string_lossy();
        let capture = if is_stream(&self.source) {
            None
        } else {
            Some(columns::read_capture(&self.source, &file)?)
        };
        let wanted = ColumnsJob {
            tables: &tables,
            recorder: &self.gateway,
            file: &file,
            capture: capture.as_ref(),
            profile: self.stated.profile_word(),
            jobs: job_count(self.jobs),
        };
        report_left_out(&columns::decode(source, &self.source, out, stored, &wanted)?)
    }

    /// Decodes a folder of captures into a data set.
    pub(super) fn decode_folder(&self) -> Result {
        if !matches!(self.format, None | Some(DecodeFormat::Parquet)) {
            let why = "A folder of captures becomes a data set of Parquet files.";
            return Err(Problem::usage(
                "E250",
                "a folder cannot be decoded to this \
             format.",
            )
            .why(why));
        }
        let site = DatasetSite { root: self.output_folder()?.to_owned(), name: self.site.clone() };
        let tables = columns::parse_tables(self.tables.as_deref())?;
        self.folder_job(site, &tables).decode()
    }

    fn folder_job<'a>(&'a self, site: DatasetSite, tables: &'a [TableKind]) -> FolderJob<'a> {
        let (captures, stated) = (self.source.as_path(), &self.stated);
        let (recorder, jobs) = (self.gateway.as_str(), job_count(self.jobs));
        FolderJob { captures, stated, site, recorder, tables, jobs }
    }

    fn output_folder(&self) -> Result<&Path> {
        self.out.as_deref().ok_or_else(|| {
            Problem::usage("E250", "the output folder is missing.")
                .why("Tables are several files, which cannot be written to stdout.")
                .hint("-o FOLDER")
        })
    }
}
