//! Table `transactions`: every request and its result.

use polepair_core::convert::saturating;
use std::sync::Arc;

use arrow_array::types::{Int16Type, Int32Type, Int64Type};
use arrow_array::{ArrayRef, RecordBatch};
use arrow_schema::ArrowError;
use polepair_capture::session::ExchangeNotice;

use super::{CaptureOrigin, RowContext, sort_by_time, timestamp_ns, to_i64};
use crate::column::{ConstantColumn, NumberColumn, WordColumn};
use crate::schema::TableKind;

#[derive(Debug, Default)]
pub(super) struct TransactionRows {
    request_time: NumberColumn<Int64Type>,
    reply_time: NumberColumn<Int64Type>,
    latency: NumberColumn<Int64Type>,
    axis: NumberColumn<Int32Type>,
    op: WordColumn,
    outcome: WordColumn,
    retries: NumberColumn<Int16Type>,
    source: ConstantColumn,
    bus: WordColumn,
}

impl TransactionRows {
    pub fn new(origin: &CaptureOrigin) -> Self {
        Self { source: ConstantColumn::new(&origin.source), ..Self::default() }
    }

    pub fn rows(&self) -> usize {
        self.retries.len()
    }

    pub fn push(&mut self, at: RowContext<'_>, exchange: &ExchangeNotice) {
        self.request_time.push_option(timestamp_ns(exchange.requested.1));
        self.reply_time.push_option(exchange.answered.and_then(|(_, time)| timestamp_ns(time)));
        self.latency.push_option(exchange.latency().map(|ns| to_i64(ns / 1000)));
        self.axis.push_option(exchange.axis.map(u32::cast_signed));
        self.op.push_static(exchange.op);
        self.outcome.push_static(exchange.outcome.as_str());
        self.retries.push(saturating(exchange.retries));
        self.bus.push(at.link);
    }

    pub fn batch(&mut self) -> Result<RecordBatch, ArrowError> {
        let rows = self.rows();
        let request_times = self.request_time.finish();
        let times = request_times.values().clone();
        let columns: Vec<ArrayRef> = vec![
            Arc::new(request_times),
            Arc::new(self.reply_time.finish()),
            Arc::new(self.latency.finish()),
            Arc::new(self.axis.finish()),
            self.op.finish()?,
            self.outcome.finish()?,
            Arc::new(self.retries.finish()),
            self.source.array(rows)?,
            self.bus.finish()?,
        ];
        sort_by_time(&times, RecordBatch::try_new(TableKind::Transactions.schema(), columns)?)
    }
}
