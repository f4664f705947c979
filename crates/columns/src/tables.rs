//! Rows out of explained frames and what their conversations tell, gathered into batches.

mod events;
mod frames;
mod signals;
mod transactions;

use arrow_array::types::Int64Type;
use arrow_array::{RecordBatch, UInt32Array};
use arrow_schema::ArrowError;
use polepair_capture::session::Notice;
use polepair_capture::{Batch, Decoded, Event, Plain, Stamp};

use crate::column::Numbers;
use crate::schema::Table;

/// Rows of one batch. Small enough that what is written stays in the processor's cache.
pub const ROWS_MAX: usize = 1 << 16;
/// Bytes of the frames of one batch.
const BYTES_MAX: usize = 1 << 24;

/// Whence the rows are: what stands in their columns `source` and `file`.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Origin {
    /// The machine or gateway that recorded.
    pub source: String,
    /// The capture's file.
    pub file: String,
}

/// Builds the tables' batches. Nothing here writes a file.
#[derive(Debug)]
pub struct Tables {
    wanted: [bool; 4],
    frames: frames::Frames,
    signals: signals::Signals,
    transactions: transactions::Transactions,
    events: events::Events,
}

/// Where and when a row belongs.
#[derive(Clone, Copy)]
pub(crate) struct At<'a> {
    pub time: Option<Stamp>,
    pub link: &'a str,
    /// The frame; `None` for what the end of the capture tells.
    pub seq: Option<u64>,
}

impl Tables {
    /// Builds the tables that are wanted.
    #[must_use]
    pub fn new(wanted: &[Table], origin: &Origin) -> Self {
        Self {
            wanted: Table::ALL.map(|table| wanted.contains(&table)),
            frames: frames::Frames::new(origin),
            signals: signals::Signals::new(origin),
            transactions: transactions::Transactions::new(origin),
            events: events::Events::new(origin),
        }
    }

    /// Takes a frame.
    pub fn take(&mut self, event: &Event<'_>) {
        if self.wants(Table::Frames) {
            self.frames.push(event);
        }
        let at = At { time: event.time, link: event.link, seq: Some(event.number) };
        self.notices(at, event.notices);
    }

    /// Takes the frames of a batch. Those that change nothing go into one column after the other.
    pub fn take_batch(&mut self, batch: &Batch) {
        let frames = self.wants(Table::Frames).then(|| {
            self.frames.reserve(batch.len());
            self.frames.spoken(batch.voices())
        });
        let signals = self.wants(Table::Signals).then(|| {
            let spoken = self.signals.spoken(batch.voices());
            let rows = |it| match it {
                Decoded::Plain(run) => spoken.rows(run),
                Decoded::Told(_) => 1,
            };
            self.signals.reserve(batch.decoded().map(rows).sum());
            spoken
        });
        for decoded in batch.decoded() {
            match decoded {
                Decoded::Plain(run) => {
                    frames.iter().for_each(|spoken| self.frames.plain(run, spoken));
                    signals.iter().for_each(|spoken| self.signals.plain(run, spoken));
                }
                Decoded::Told(at) => batch.told(at, |event| self.take(event)),
            }
        }
    }

    /// Takes what the conversations of a link leave open at the end of the capture.
    pub fn ending(&mut self, link: &str, notices: &[Notice]) {
        self.notices(At { time: None, link, seq: None }, notices);
    }

    fn notices(&mut self, at: At<'_>, notices: &[Notice]) {
        for notice in notices {
            match notice {
                Notice::Signal(signal) if self.wants(Table::Signals) => {
                    self.signals.push(at, signal);
                }
                Notice::Exchange(exchange) if self.wants(Table::Transactions) => {
                    self.transactions.push(at, exchange);
                }
                Notice::Change(change) if self.wants(Table::Events) => {
                    self.events.change(at, change);
                }
                Notice::Fault(fault) if self.wants(Table::Events) => self.events.fault(at, fault),
                Notice::Odd(odd) if self.wants(Table::Events) => self.events.odd(at, odd),
                _ => {}
            }
        }
    }

    const fn wants(&self, table: Table) -> bool {
        self.wanted[table as usize]
    }

    /// Whether a batch has as many rows as it should: time to [flush](Self::flush).
    #[must_use]
    pub fn is_full(&self) -> bool {
        let rows = [self.frames.rows(), self.signals.rows(), self.transactions.rows()];
        let most = rows.into_iter().chain([self.events.rows()]).max();
        most.is_some_and(|rows| rows >= ROWS_MAX) || self.frames.bytes() >= BYTES_MAX
    }

    /// Gives the rows gathered so far, each table's in the order of time.
    ///
    /// # Errors
    /// [`ArrowError`] when rows do not make a batch, which they do by construction.
    pub fn flush(
        &mut self,
        each: &mut dyn FnMut(Table, RecordBatch) -> Result<(), ArrowError>,
    ) -> Result<(), ArrowError> {
        for table in Table::ALL {
            let batch = match table {
                Table::Frames => self.frames.batch()?,
                Table::Signals => self.signals.batch()?,
                Table::Transactions => self.transactions.batch()?,
                Table::Events => self.events.batch()?,
            };
            if batch.num_rows() > 0 {
                each(table, batch)?;
            }
        }
        Ok(())
    }
}

/// The time of a row in nanoseconds.
pub(crate) fn ns(time: Option<Stamp>) -> Option<i64> {
    time.and_then(|time| i64::try_from(time.0).ok())
}

/// Puts the times of frames down.
pub(crate) fn times(column: &mut Numbers<Int64Type>, run: &[Plain]) {
    match run.iter().all(|plain| i64::try_from(plain.time.0).is_ok()) {
        true => column.extend(run.iter().map(|plain| plain.time.0.cast_signed())),
        false => run.iter().for_each(|plain| column.push_maybe(ns(Some(plain.time)))),
    }
}

/// The one that all are; none where they differ, or there are none.
pub(crate) fn only<T: PartialEq>(mut all: impl Iterator<Item = T>) -> Option<T> {
    let first = all.next()?;
    all.all(|other| other == first).then_some(first)
}

/// A number of a frame as columns have it.
pub(crate) fn count(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}

/// The batch with its rows in the order of time: captures of several interfaces may not be.
pub(crate) fn in_order(times: &[i64], batch: RecordBatch) -> Result<RecordBatch, ArrowError> {
    if times.is_sorted() {
        return Ok(batch);
    }
    let mut order: Vec<u32> = (0..times.len() as u32).collect();
    order.sort_by_key(|row| times[*row as usize]);
    arrow_select::take::take_record_batch(&batch, &UInt32Array::from(order))
}

#[cfg(test)]
mod tests;
