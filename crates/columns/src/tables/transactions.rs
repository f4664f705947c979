//! Table `transactions`: every request and how it ended.

use std::sync::Arc;

use arrow_array::types::{Int16Type, Int32Type, Int64Type};
use arrow_array::{ArrayRef, RecordBatch};
use arrow_schema::ArrowError;
use polepair_capture::session::Exchange;

use super::{At, Origin, count, in_order, ns};
use crate::column::{Numbers, Same, Words};
use crate::schema::Table;

#[derive(Debug, Default)]
pub(super) struct Transactions {
    asked: Numbers<Int64Type>,
    answered: Numbers<Int64Type>,
    latency: Numbers<Int64Type>,
    axis: Numbers<Int32Type>,
    op: Words,
    outcome: Words,
    retries: Numbers<Int16Type>,
    source: Same,
    bus: Words,
}

impl Transactions {
    pub fn new(origin: &Origin) -> Self {
        Self { source: Same::new(&origin.source), ..Self::default() }
    }

    pub fn rows(&self) -> usize {
        self.retries.len()
    }

    pub fn push(&mut self, at: At<'_>, exchange: &Exchange) {
        self.asked.push_maybe(ns(exchange.asked.1));
        self.answered.push_maybe(exchange.answered.and_then(|(_, time)| ns(time)));
        self.latency.push_maybe(exchange.latency().map(|ns| count(ns / 1000)));
        self.axis.push_maybe(exchange.axis.map(u32::cast_signed));
        self.op.push_name(exchange.op);
        self.outcome.push_name(exchange.outcome.word());
        self.retries.push(i16::try_from(exchange.retries).unwrap_or(i16::MAX));
        self.bus.push(at.link);
    }

    pub fn batch(&mut self) -> Result<RecordBatch, ArrowError> {
        let rows = self.rows();
        let asked = self.asked.take();
        let times = asked.values().clone();
        let columns: Vec<ArrayRef> = vec![
            Arc::new(asked),
            Arc::new(self.answered.take()),
            Arc::new(self.latency.take()),
            Arc::new(self.axis.take()),
            self.op.take()?,
            self.outcome.take()?,
            Arc::new(self.retries.take()),
            self.source.rows(rows)?,
            self.bus.take()?,
        ];
        in_order(&times, RecordBatch::try_new(Table::Transactions.schema(), columns)?)
    }
}
