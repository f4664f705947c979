//! Table `signals`: a row for each value of a frame.

use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_array::types::{Float64Type, Int16Type, Int32Type, Int64Type};
use arrow_schema::ArrowError;
use polepair_capture::session::SignalNotice;
use polepair_capture::session::canopen::MappedValue;
use polepair_capture::{CompactFrame, FrameTemplate};

use super::{CaptureOrigin, RowContext, sort_by_time, timestamp_ns, to_i64};
use crate::column::{ConstantColumn, NumberColumn, WordColumn, to_micros};
use crate::schema::TableKind;

#[derive(Debug, Default)]
pub(super) struct SignalRows {
    t_ns: NumberColumn<Int64Type>,
    source: ConstantColumn,
    bus: WordColumn,
    axis: NumberColumn<Int32Type>,
    signal: WordColumn,
    value: NumberColumn<Float64Type>,
    exact: NumberColumn<Int64Type>,
    unit: WordColumn,
    quality: NumberColumn<Int16Type>,
    request: NumberColumn<Int64Type>,
    frame: NumberColumn<Int64Type>,
}

/// Constant columns of values by template: words by their numbers.
#[derive(Debug)]
pub(super) struct SignalTemplates(Vec<SignalTemplate>);

/// Constant columns of all values of a template.
#[derive(Debug)]
struct SignalTemplate {
    values: Vec<ValueTemplate>,
    bus: i32,
    axis: i32,
    quality: i16,
}

/// One value of a template.
#[derive(Debug)]
struct ValueTemplate {
    position: MappedValue,
    signal: i32,
    unit: i32,
}

impl SignalTemplates {
    #[inline]
    fn get(&self, plain: &CompactFrame) -> &SignalTemplate {
        &self.0[usize::from(plain.template)]
    }

    /// Values of frames.
    pub fn row_count(&self, run: &[CompactFrame]) -> usize {
        run.iter().map(|plain| self.get(plain).values.len()).sum()
    }
}

impl SignalRows {
    pub fn new(origin: &CaptureOrigin) -> Self {
        Self { source: ConstantColumn::new(&origin.source), ..Self::default() }
    }

    pub fn rows(&self) -> usize {
        self.frame.len()
    }

    pub fn push(&mut self, at: RowContext<'_>, signal: &SignalNotice) {
        self.t_ns.push_option(timestamp_ns(at.time));
        self.bus.push(at.link);
        self.axis.push(signal.axis.cast_signed());
        self.signal.push_static(signal.name);
        self.value.push(signal.value);
        self.exact.push_option(signal.exact);
        self.unit.push_static(signal.unit);
        self.quality.push((signal.quality as u8).into());
        self.request.push_option(signal.request.map(to_i64));
        self.frame.push(at.seq.map_or(0, to_i64));
    }

    /// Reserves memory for `rows` rows.
    pub fn reserve(&mut self, rows: usize) {
        let Self { t_ns, bus, axis, signal, value, exact, unit, quality, request, frame, .. } =
            self;
        [t_ns, exact, request, frame].into_iter().for_each(|column| column.reserve(rows));
        [bus.keys(), axis, signal.keys(), unit.keys()].into_iter().for_each(|it| it.reserve(rows));
        value.reserve(rows);
        quality.reserve(rows);
    }

    /// The values of frames that change nothing.
    pub fn push_plain(&mut self, run: &[CompactFrame], templates: &SignalTemplates) {
        let rows = templates.row_count(run);
        if run.iter().all(|plain| frame_time_ns(plain).is_some()) {
            self.t_ns.extend_default(rows);
        } else {
            let all = run.iter().flat_map(|plain| {
                core::iter::repeat_n(frame_time_ns(plain), templates.get(plain).values.len())
            });
            all.for_each(|frame_time_ns| self.t_ns.push_option(frame_time_ns));
        }
        let words = self.bus.keys().extend_default(rows).iter_mut();
        let words = words.zip(self.signal.keys().extend_default(rows));
        let words = words.zip(self.unit.keys().extend_default(rows));
        let numbers = self.exact.extend_default(rows).iter_mut();
        let numbers = numbers.zip(self.value.extend_default(rows));
        let origins = self.t_ns.last_mut(rows).iter_mut();
        let origins = origins.zip(self.axis.extend_default(rows));
        let origins = origins.zip(self.quality.extend_default(rows));
        let origins = origins.zip(self.frame.extend_default(rows));
        let mut rows_left = words.zip(numbers).zip(origins);
        for plain in run {
            let template = templates.get(plain);
            let (frame_time_ns, number) =
                (frame_time_ns(plain).unwrap_or_default(), to_i64(plain.number));
            // Values first: where they end, no row is taken.
            for (ValueTemplate { position, signal, unit }, row) in
                template.values.iter().zip(rows_left.by_ref())
            {
                let ((words, numbers), origins) = row;
                let whole = position.exact(plain.data);
                let ((bus, signal_key), unit_key) = words;
                (*bus, *signal_key, *unit_key) = (template.bus, *signal, *unit);
                let (exact, value) = numbers;
                (*exact, *value) = (whole, position.value(whole));
                let (((t_ns, axis), quality), frame) = origins;
                (*t_ns, *axis, *quality) = (frame_time_ns, template.axis, template.quality);
                *frame = number;
            }
        }
        self.request.repeat(None, rows);
    }

    /// Encodes the constant columns of values of these templates.
    pub fn templates(&mut self, voices: &[FrameTemplate]) -> SignalTemplates {
        SignalTemplates(voices.iter().map(|voice| self.template(voice)).collect())
    }

    fn template(&mut self, voice: &FrameTemplate) -> SignalTemplate {
        let process = voice.process_data();
        let places = process.map_or(&[][..], |process| process.mapping().mapped_values());
        SignalTemplate {
            values: places
                .iter()
                .map(|mapped| ValueTemplate {
                    position: *mapped,
                    signal: self.signal.dictionary.number_of_static(mapped.name),
                    unit: self.unit.dictionary.number_of_static(mapped.unit),
                })
                .collect(),
            bus: self.bus.dictionary.number(&voice.link),
            axis: process.map_or(0, |process| process.axis().cast_signed()),
            quality: process.map_or(0, |process| (process.quality() as u8).into()),
        }
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
            self.signal.finish()?,
            Arc::new(self.value.finish()),
            Arc::new(self.exact.finish()),
            self.unit.finish()?,
            Arc::new(self.quality.finish()),
            Arc::new(self.request.finish()),
            Arc::new(self.frame.finish()),
        ];
        sort_by_time(&times, RecordBatch::try_new(TableKind::Signals.schema(), columns)?)
    }
}

fn frame_time_ns(plain: &CompactFrame) -> Option<i64> {
    timestamp_ns(Some(plain.time))
}
