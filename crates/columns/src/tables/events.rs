//! Table `events`: faults, changes of state, and what a healthy bus does not do.

use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_array::types::{Int32Type, Int64Type};
use arrow_schema::ArrowError;
use polepair_capture::session::{Change, Fault, Odd};

use super::{At, Origin, count, in_order, ns};
use crate::column::{Bytes, Numbers, Same, Words, micros};
use crate::schema::Table;

#[derive(Debug, Default)]
pub(super) struct Events {
    t_ns: Numbers<Int64Type>,
    source: Same,
    bus: Words,
    axis: Numbers<Int32Type>,
    event: Words,
    name: Words,
    code: Numbers<Int64Type>,
    text: Bytes,
    cause: Words,
    remedy: Words,
    frame: Numbers<Int64Type>,
}

/// What a row says beside where and when.
struct Row<'a> {
    axis: Option<u32>,
    event: &'a str,
    name: &'a str,
    code: Option<u32>,
    text: &'a str,
    cause: &'a str,
    remedy: &'a str,
}

impl Events {
    pub fn new(origin: &Origin) -> Self {
        Self { source: Same::new(&origin.source), ..Self::default() }
    }

    pub fn rows(&self) -> usize {
        self.t_ns.len()
    }

    pub fn fault(&mut self, at: At<'_>, fault: &Fault) {
        let Fault { axis, code, text, cause, remedy, gone } = *fault;
        let event = if gone { "fault-gone" } else { "fault" };
        let row =
            Row { axis: Some(axis), event, name: text, code: Some(code), text, cause, remedy };
        self.push(at, &row);
    }

    pub fn change(&mut self, at: At<'_>, change: &Change) {
        let Change { axis, what, from, to } = *change;
        let text = if from.is_empty() { to.to_owned() } else { format!("{from} -> {to}") };
        let (event, name) = ("state", what);
        let row = Row { axis, event, name, code: None, text: &text, cause: "", remedy: "" };
        self.push(at, &row);
    }

    pub fn odd(&mut self, at: At<'_>, odd: &Odd) {
        let (event, name, text) = ("odd", odd.kind.word(), odd.text.as_str());
        let row = Row { axis: odd.axis, event, name, code: None, text, cause: "", remedy: "" };
        self.push(At { time: odd.time.or(at.time), ..at }, &row);
    }

    fn push(&mut self, at: At<'_>, row: &Row<'_>) {
        self.t_ns.push_maybe(ns(at.time));
        self.bus.push(at.link);
        self.axis.push_maybe(row.axis.map(u32::cast_signed));
        self.event.push(row.event);
        self.name.push(row.name);
        self.code.push_maybe(row.code.map(i64::from));
        self.text.push(row.text.as_bytes());
        self.cause.push(row.cause);
        self.remedy.push(row.remedy);
        self.frame.push_maybe(at.seq.map(count));
    }

    pub fn batch(&mut self) -> Result<RecordBatch, ArrowError> {
        let rows = self.rows();
        let t_ns = self.t_ns.take();
        let times = t_ns.values().clone();
        let columns = vec![
            Arc::new(micros(&t_ns)) as _,
            Arc::new(t_ns) as _,
            self.source.rows(rows)?,
            self.bus.take()?,
            Arc::new(self.axis.take()),
            self.event.take()?,
            self.name.take()?,
            Arc::new(self.code.take()),
            self.text.take_text()?,
            self.cause.take()?,
            self.remedy.take()?,
            Arc::new(self.frame.take()),
        ];
        in_order(&times, RecordBatch::try_new(Table::Events.schema(), columns)?)
    }
}
