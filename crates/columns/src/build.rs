//! Columns out of a capture's batches, built on one of several threads.

use arrow_array::RecordBatch;
use arrow_schema::ArrowError;
use polepair_capture::Batch;
use polepair_capture::parallel::Maker;

use crate::schema::Table;
use crate::tables::Tables;

/// What was built, in the order of the rows of each table.
pub type Built = Result<Vec<(Table, RecordBatch)>, ArrowError>;

/// Builds columns, for others to hand them on. Builders number words each by itself: see
/// [`Numbering`](crate::Numbering).
#[derive(Debug)]
pub struct Builder {
    /// What takes rows.
    pub tables: Tables,
    made: Vec<(Table, RecordBatch)>,
    failed: Option<ArrowError>,
}

impl Builder {
    /// A builder that has built nothing.
    #[must_use]
    pub const fn new(tables: Tables) -> Self {
        Self { tables, made: Vec::new(), failed: None }
    }

    /// Makes batches of the rows that it has.
    pub fn flush(&mut self) {
        let Self { tables, made, failed } = self;
        let flushed = tables.flush(&mut |table, batch| {
            made.push((table, batch));
            Ok(())
        });
        *failed = failed.take().or(flushed.err());
    }

    /// What was built since the last time.
    ///
    /// # Errors
    /// [`ArrowError`] when rows do not make a batch, which they do by construction.
    pub fn built(&mut self) -> Built {
        let built = core::mem::take(&mut self.made);
        self.failed.take().map_or(Ok(built), Err)
    }
}

impl Maker for Builder {
    /// Fewer and longer batches cost less to write and to read.
    const PIECE: usize = 1 << 19;

    fn make(&mut self, batch: &Batch) {
        self.tables.take_batch(batch);
        self.flush();
    }
}
