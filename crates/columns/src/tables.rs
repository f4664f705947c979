//! Collects decoded frames and notices as rows in batches.

mod events;
mod frames;
mod signals;
mod transactions;

use arrow_array::types::Int64Type;
use arrow_array::{RecordBatch, UInt32Array};
use arrow_schema::ArrowError;
use polepair_capture::session::SessionNotice;
use polepair_capture::{CompactFrame, DecodedFrame, FrameBatch, FrameBuffers, FrameRun, Timestamp};
use polepair_core::convert::saturating;

use crate::column::NumberColumn;
use crate::schema::TableKind;

/// Rows of one batch. Small enough that written rows stay in the processor's cache.
pub const ROWS_MAX: usize = 1 << 16;
/// Bytes of the frames of one batch.
const BYTES_MAX: usize = 1 << 24;

/// Origin of the rows: the values of their columns `source` and `file`.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct CaptureOrigin {
    /// The machine or gateway that recorded.
    pub source: String,
    /// The capture's file.
    pub file: String,
}

/// Builds the tables' batches. Nothing here writes a file.
#[derive(Debug)]
pub struct TablesBuilder {
    wanted: [bool; 4],
    frames: frames::FrameRows,
    signals: signals::SignalRows,
    transactions: transactions::TransactionRows,
    events: events::EventRows,
}

/// Place and time of a row.
#[derive(Clone, Copy)]
pub(crate) struct RowContext<'a> {
    pub time: Option<Timestamp>,
    pub link: &'a str,
    /// Number of the frame; `None` for results at the end of the capture.
    pub seq: Option<u64>,
}

impl TablesBuilder {
    /// Builds the tables that are wanted.
    #[must_use]
    pub fn new(wanted: &[TableKind], origin: &CaptureOrigin) -> Self {
        Self {
            wanted: TableKind::ALL.map(|table| wanted.contains(&table)),
            frames: frames::FrameRows::new(origin),
            signals: signals::SignalRows::new(origin),
            transactions: transactions::TransactionRows::new(origin),
            events: events::EventRows::new(origin),
        }
    }

    /// Takes a frame.
    pub fn add_event(&mut self, event: &DecodedFrame<'_>) {
        if self.wants(TableKind::Frames) {
            self.frames.push(event);
        }
        let at = RowContext { time: event.time, link: event.link, seq: Some(event.number) };
        self.add_notices(at, event.notices);
    }

    /// Takes the frames of a batch. Those that change nothing go into one column after the other.
    pub fn add_batch(&mut self, batch: &FrameBatch) {
        let frames = self.wants(TableKind::Frames).then(|| {
            self.frames.reserve(batch.len());
            self.frames.templates(batch.templates())
        });
        let signals = self.wants(TableKind::Signals).then(|| {
            let templates = self.signals.templates(batch.templates());
            self.signals.reserve(
                batch
                    .runs()
                    .map(|it| match it {
                        FrameRun::Compact(run) => templates.row_count(run),
                        FrameRun::Answer(answer) => signal_count(batch.notices(answer)),
                        FrameRun::Stored(at) => {
                            let mut rows = 0;
                            batch.with_stored(at, |event| rows = signal_count(event.notices));
                            rows
                        }
                    })
                    .sum(),
            );
            templates
        });
        // Frames of serial lines are longer than a number, and rare where columns have to be fast.
        let has_serial = batch.templates().iter().any(|template| template.id.is_none());
        let mut buffers = FrameBuffers::default();
        for decoded in batch.runs() {
            match decoded {
                FrameRun::Answer(answer) => {
                    batch.with_answer(answer, &mut buffers, |event| self.add_event(event));
                }
                FrameRun::Compact(run) if has_serial => run.iter().for_each(|plain| {
                    let template = &batch.templates()[usize::from(plain.template)];
                    template.expand(plain, &mut |event| self.add_event(event));
                }),
                FrameRun::Compact(run) => {
                    frames.iter().for_each(|protocol| self.frames.push_plain(run, protocol));
                    signals.iter().for_each(|templates| self.signals.push_plain(run, templates));
                }
                FrameRun::Stored(at) => batch.with_stored(at, |event| self.add_event(event)),
            }
        }
    }

    /// Takes what the conversations of a link leave open at the end of the capture.
    pub fn add_final_notices(&mut self, link: &str, notices: &[SessionNotice]) {
        self.add_notices(RowContext { time: None, link, seq: None }, notices);
    }

    fn add_notices(&mut self, at: RowContext<'_>, notices: &[SessionNotice]) {
        for notice in notices {
            match notice {
                SessionNotice::Signal(signal) if self.wants(TableKind::Signals) => {
                    self.signals.push(at, signal);
                }
                SessionNotice::Exchange(exchange) if self.wants(TableKind::Transactions) => {
                    self.transactions.push(at, exchange);
                }
                SessionNotice::Change(change) if self.wants(TableKind::Events) => {
                    self.events.push_change(at, change);
                }
                SessionNotice::Fault(fault) if self.wants(TableKind::Events) => {
                    self.events.push_fault(at, fault)
                }
                SessionNotice::Anomaly(anomaly) if self.wants(TableKind::Events) => {
                    self.events.push_oddity(at, anomaly)
                }
                _ => {}
            }
        }
    }

    const fn wants(&self, table: TableKind) -> bool {
        self.wanted[table as usize]
    }

    /// Returns whether a batch has as many rows as it should: time to [flush](Self::flush).
    #[must_use]
    pub fn is_full(&self) -> bool {
        let rows = [self.frames.rows(), self.signals.rows(), self.transactions.rows()];
        let max = rows.into_iter().chain([self.events.rows()]).max();
        max.is_some_and(|rows| rows >= ROWS_MAX) || self.frames.data_len() >= BYTES_MAX
    }

    /// Gives the rows gathered so far, each table's in the order of time.
    ///
    /// # Errors
    /// [`ArrowError`] when rows do not make a batch, which they do by construction.
    pub fn flush(
        &mut self,
        each: &mut dyn FnMut(TableKind, RecordBatch) -> Result<(), ArrowError>,
    ) -> Result<(), ArrowError> {
        for table in TableKind::ALL {
            let batch = match table {
                TableKind::Frames => self.frames.batch()?,
                TableKind::Signals => self.signals.batch()?,
                TableKind::Transactions => self.transactions.batch()?,
                TableKind::Events => self.events.batch()?,
            };
            if batch.num_rows() > 0 {
                each(table, batch)?;
            }
        }
        Ok(())
    }
}

fn signal_count(notices: &[SessionNotice]) -> usize {
    notices.iter().filter(|notice| matches!(notice, SessionNotice::Signal(_))).count()
}

/// The time of a row in nanoseconds.
pub(crate) fn timestamp_ns(time: Option<Timestamp>) -> Option<i64> {
    time.and_then(|time| i64::try_from(time.0).ok())
}

/// Puts the times of frames down.
pub(crate) fn push_times(column: &mut NumberColumn<Int64Type>, run: &[CompactFrame]) {
    if run.iter().all(|plain| i64::try_from(plain.time.0).is_ok()) {
        column.extend(run.iter().map(|plain| plain.time.0.cast_signed()))
    } else {
        run.iter().for_each(|plain| column.push_option(timestamp_ns(Some(plain.time))))
    }
}

/// The one that all are; none where they differ, or there are none.
pub(crate) fn common_value<T: PartialEq>(mut all: impl Iterator<Item = T>) -> Option<T> {
    let first = all.next()?;
    all.all(|other| other == first).then_some(first)
}

/// A number of a frame as columns have it.
pub(crate) fn to_i64(number: u64) -> i64 {
    saturating(number)
}

/// The batch with its rows in the order of time: captures of several interfaces may not be.
pub(crate) fn sort_by_time(times: &[i64], batch: RecordBatch) -> Result<RecordBatch, ArrowError> {
    if times.is_sorted() {
        return Ok(batch);
    }
    let mut order: Vec<u32> = (0..times.len() as u32).collect();
    order.sort_by_key(|row| times[*row as usize]);
    arrow_select::take::take_record_batch(&batch, &UInt32Array::from(order))
}

#[cfg(test)]
mod tests;
