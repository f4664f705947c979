//! Table `events`: faults, state changes, anomalies.

use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_array::types::{Int32Type, Int64Type};
use arrow_schema::ArrowError;
use polepair_capture::session::{AnomalyNotice, ChangeNotice, FaultNotice};

use super::{CaptureOrigin, RowContext, sort_by_time, timestamp_ns, to_i64};
use crate::column::{BytesColumn, ConstantColumn, NumberColumn, WordColumn, to_micros};
use crate::schema::TableKind;

#[derive(Debug, Default)]
pub(super) struct EventRows {
    t_ns: NumberColumn<Int64Type>,
    source: ConstantColumn,
    bus: WordColumn,
    axis: NumberColumn<Int32Type>,
    event: WordColumn,
    name: WordColumn,
    code: NumberColumn<Int64Type>,
    text: BytesColumn,
    cause: WordColumn,
    remedy: WordColumn,
    frame: NumberColumn<Int64Type>,
}

/// Values of an event row beside place and time.
struct EventRow<'a> {
    axis: Option<u32>,
    event: &'a str,
    name: &'a str,
    code: Option<u32>,
    text: &'a str,
    cause: &'a str,
    remedy: &'a str,
}

impl EventRows {
    pub fn new(origin: &CaptureOrigin) -> Self {
        Self { source: ConstantColumn::new(&origin.source), ..Self::default() }
    }

    pub fn rows(&self) -> usize {
        self.t_ns.len()
    }

    pub fn push_fault(&mut self, at: RowContext<'_>, fault: &FaultNotice) {
        let FaultNotice { axis, code, text, cause, remedy, gone } = *fault;
        let event = if gone { "fault-gone" } else { "fault" };
        let row =
            EventRow { axis: Some(axis), event, name: text, code: Some(code), text, cause, remedy };
        self.push(at, &row);
    }

    pub fn push_change(&mut self, at: RowContext<'_>, change: &ChangeNotice) {
        let ChangeNotice { axis, what, from, to } = *change;
        let text = if from.is_empty() { to.to_owned() } else { format!("{from} -> {to}") };
        let (event, name) = ("state", what);
        let row = EventRow { axis, event, name, code: None, text: &text, cause: "", remedy: "" };
        self.push(at, &row);
    }

    pub fn push_oddity(&mut self, at: RowContext<'_>, anomaly: &AnomalyNotice) {
        let (event, name, text) = ("odd", anomaly.kind.as_str(), anomaly.text.as_str());
        let row =
            EventRow { axis: anomaly.axis, event, name, code: None, text, cause: "", remedy: "" };
        self.push(RowContext { time: anomaly.time.or(at.time), ..at }, &row);
    }

    fn push(&mut self, at: RowContext<'_>, row: &EventRow<'_>) {
        self.t_ns.push_option(timestamp_ns(at.time));
        self.bus.push(at.link);
        self.axis.push_option(row.axis.map(u32::cast_signed));
        self.event.push(row.event);
        self.name.push(row.name);
        self.code.push_option(row.code.map(i64::from));
        self.text.push(row.text.as_bytes());
        self.cause.push(row.cause);
        self.remedy.push(row.remedy);
        self.frame.push_option(at.seq.map(to_i64));
    }

    pub fn batch(&mut self) -> Result<RecordBatch, ArrowError> {
        let rows = self.rows();
        let t_ns = self.t_ns.finish();
        let times = t_ns.values().clone();
        let columns = vec![
            Arc::new(to_micros(&t_ns)) as _,
            Arc::new(t_ns) as _,
            self.source.array(rows)?,
            self.bus.finish()?,
            Arc::new(self.axis.finish()),
            self.event.finish()?,
            self.name.finish()?,
            Arc::new(self.code.finish()),
            self.text.finish_text()?,
            self.cause.finish()?,
            self.remedy.finish()?,
            Arc::new(self.frame.finish()),
        ];
        sort_by_time(&times, RecordBatch::try_new(TableKind::Events.schema(), columns)?)
    }
}
