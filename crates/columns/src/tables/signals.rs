//! Table `signals`: every value that a frame told, a row each.

use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_array::types::{Float64Type, Int16Type, Int32Type, Int64Type};
use arrow_schema::ArrowError;
use polepair_capture::session::Signal;
use polepair_capture::session::canopen::Place;
use polepair_capture::{Plain, Voice};

use super::{At, Origin, count, in_order, ns};
use crate::column::{Numbers, Same, Words, micros};
use crate::schema::Table;

#[derive(Debug, Default)]
pub(super) struct Signals {
    t_ns: Numbers<Int64Type>,
    source: Same,
    bus: Words,
    axis: Numbers<Int32Type>,
    signal: Words,
    value: Numbers<Float64Type>,
    exact: Numbers<Int64Type>,
    unit: Words,
    quality: Numbers<Int16Type>,
    request: Numbers<Int64Type>,
    frame: Numbers<Int64Type>,
}

/// What all values of a voice have in common: words by their numbers.
#[derive(Debug)]
pub(super) struct Spoken {
    values: Vec<Value>,
    bus: i32,
    axis: i32,
    quality: i16,
}

/// One value of a voice.
#[derive(Debug)]
struct Value {
    place: Place,
    signal: i32,
    unit: i32,
}

impl Signals {
    pub fn new(origin: &Origin) -> Self {
        Self { source: Same::new(&origin.source), ..Self::default() }
    }

    pub fn rows(&self) -> usize {
        self.frame.len()
    }

    pub fn push(&mut self, at: At<'_>, signal: &Signal) {
        self.t_ns.push_maybe(ns(at.time));
        self.bus.push(at.link);
        self.axis.push(signal.axis.cast_signed());
        self.signal.push_name(signal.name);
        self.value.push(signal.value);
        self.exact.push_maybe(signal.exact);
        self.unit.push_name(signal.unit);
        self.quality.push((signal.quality as u8).into());
        self.request.push_maybe(signal.request.map(count));
        self.frame.push(at.seq.map_or(0, count));
    }

    /// The values of a frame that changes nothing.
    #[inline]
    pub fn plain(&mut self, plain: &Plain, voice: &Spoken) {
        let (time, frame) = (ns(Some(plain.time)), count(plain.number));
        for value in &voice.values {
            let exact = value.place.exact(plain.data);
            self.t_ns.push_maybe(time);
            self.bus.push_number(voice.bus);
            self.axis.push(voice.axis);
            self.signal.push_number(value.signal);
            self.value.push(value.place.value(exact));
            self.exact.push(exact);
            self.unit.push_number(value.unit);
            self.quality.push(voice.quality);
            self.request.push_maybe(None);
            self.frame.push(frame);
        }
    }

    /// What all frames of a voice have in common.
    pub fn spoken(&mut self, voice: &Voice) -> Spoken {
        let process = voice.process();
        let places = process.map_or(&[][..], |process| process.mapping().places());
        let value = |place: &Place| Value {
            place: *place,
            signal: self.signal.dictionary.number_of(place.name),
            unit: self.unit.dictionary.number_of(place.unit),
        };
        Spoken {
            values: places.iter().map(value).collect(),
            bus: self.bus.dictionary.number(&voice.link),
            axis: process.map_or(0, |process| process.axis().cast_signed()),
            quality: process.map_or(0, |process| (process.quality() as u8).into()),
        }
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
            self.signal.take()?,
            Arc::new(self.value.take()),
            Arc::new(self.exact.take()),
            self.unit.take()?,
            Arc::new(self.quality.take()),
            Arc::new(self.request.take()),
            Arc::new(self.frame.take()),
        ];
        in_order(&times, RecordBatch::try_new(Table::Signals.schema(), columns)?)
    }
}
