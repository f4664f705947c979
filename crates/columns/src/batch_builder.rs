//! Builds columns from batches of a capture, on one of several threads.

use arrow_array::RecordBatch;
use arrow_schema::ArrowError;
use polepair_capture::FrameBatch;
use polepair_capture::parallel::BatchConsumer;

use crate::schema::TableKind;
use crate::tables::TablesBuilder;

/// Completed record batches, with the rows of each table in order.
pub type BuiltBatches = Result<Vec<(TableKind, RecordBatch)>, ArrowError>;

/// Builds columns, for others to hand them on. Builders number words each by itself: see
/// [`DictionaryMerger`](crate::DictionaryMerger).
#[derive(Debug)]
pub struct BatchBuilder {
    /// Builder of the tables.
    pub tables: TablesBuilder,
    batches: Vec<(TableKind, RecordBatch)>,
    error: Option<ArrowError>,
}

impl BatchBuilder {
    /// A builder that has built nothing.
    #[must_use]
    pub const fn new(tables: TablesBuilder) -> Self {
        Self { tables, batches: Vec::new(), error: None }
    }

    /// Makes batches of the rows that it has.
    pub fn flush(&mut self) {
        let Self { tables, batches, error } = self;
        let flushed = tables.flush(&mut |table, batch| {
            batches.push((table, batch));
            Ok(())
        });
        // The first error: later ones follow from it.
        *error = error.take().or(flushed.err());
    }

    /// Takes the batches that were completed since the last call.
    ///
    /// # Errors
    /// [`ArrowError`] when rows do not make a batch, which they do by construction.
    pub fn take_built(&mut self) -> BuiltBatches {
        let built = core::mem::take(&mut self.batches);
        self.error.take().map_or(Ok(built), Err)
    }
}

impl BatchConsumer for BatchBuilder {
    /// Fewer and longer batches cost less to write and to read.
    const CHUNK_BYTES: usize = 1 << 19;

    fn consume(&mut self, batch: &FrameBatch) {
        self.tables.add_batch(batch);
        self.flush();
    }
}
