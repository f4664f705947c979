//! Table `signals`: every value that a frame told, a row each.

use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_array::types::{Float64Type, Int16Type, Int32Type, Int64Type};
use arrow_schema::ArrowError;
use polepair_capture::session::Signal;
use polepair_capture::session::canopen::Place;
use polepair_capture::{Plain, Voice};

use super::{At, Origin, count, in_order, ns, only};
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

/// What the values of frames have in common that change nothing: words by their numbers.
#[derive(Debug)]
pub(super) struct Spoken {
    voices: Vec<Voiced>,
    /// On which link, where it is the same for all of them.
    bus: Option<i32>,
}

/// What all values of a voice have in common.
#[derive(Debug)]
struct Voiced {
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

impl Spoken {
    #[inline]
    fn of(&self, plain: &Plain) -> &Voiced {
        &self.voices[usize::from(plain.voice)]
    }

    /// Values of frames.
    pub fn rows(&self, run: &[Plain]) -> usize {
        run.iter().map(|plain| self.of(plain).values.len()).sum()
    }

    /// Puts something down for each value of frames.
    #[inline]
    fn each<T>(&self, run: &[Plain], rows: &mut [T], one: impl Fn(&Plain, &Voiced, &Value) -> T) {
        let mut rows = rows.iter_mut();
        for plain in run {
            let voice = self.of(plain);
            // Values first: where they end, no row is taken.
            for (value, row) in voice.values.iter().zip(rows.by_ref()) {
                *row = one(plain, voice, value);
            }
        }
    }
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

    /// Makes room for so many rows.
    pub fn reserve(&mut self, rows: usize) {
        let Self { t_ns, bus, axis, signal, value, exact, unit, quality, request, frame, .. } =
            self;
        [t_ns, exact, request, frame].into_iter().for_each(|column| column.reserve(rows));
        [bus.keys(), axis, signal.keys(), unit.keys()].into_iter().for_each(|it| it.reserve(rows));
        value.reserve(rows);
        quality.reserve(rows);
    }

    /// The values of frames that change nothing, column by column.
    pub fn plain(&mut self, run: &[Plain], spoken: &Spoken) {
        let rows = spoken.rows(run);
        let time = |plain: &Plain| ns(Some(plain.time));
        if run.iter().all(|plain| time(plain).is_some()) {
            let times = self.t_ns.rows(rows);
            spoken.each(run, times, |plain, _, _| plain.time.0.cast_signed());
        } else {
            let all = run
                .iter()
                .flat_map(|plain| core::iter::repeat_n(time(plain), spoken.of(plain).values.len()));
            all.for_each(|time| self.t_ns.push_maybe(time));
        }
        match spoken.bus {
            Some(bus) => self.bus.keys().repeat(Some(bus), rows),
            None => spoken.each(run, self.bus.keys().rows(rows), |_, voice, _| voice.bus),
        }
        spoken.each(run, self.axis.rows(rows), |_, voice, _| voice.axis);
        spoken.each(run, self.signal.keys().rows(rows), |_, _, value| value.signal);
        let exact = self.exact.rows(rows);
        spoken.each(run, exact, |plain, _, value| value.place.exact(plain.data));
        spoken.each(run, self.value.rows(rows), |plain, _, Value { place, .. }| {
            place.value(place.exact(plain.data))
        });
        spoken.each(run, self.unit.keys().rows(rows), |_, _, value| value.unit);
        spoken.each(run, self.quality.rows(rows), |_, voice, _| voice.quality);
        self.request.repeat(None, rows);
        spoken.each(run, self.frame.rows(rows), |plain, _, _| count(plain.number));
    }

    /// What values of these voices have in common.
    pub fn spoken(&mut self, voices: &[Voice]) -> Spoken {
        let voices: Vec<Voiced> = voices.iter().map(|voice| self.voiced(voice)).collect();
        Spoken { bus: only(voices.iter().map(|voice| voice.bus)), voices }
    }

    fn voiced(&mut self, voice: &Voice) -> Voiced {
        let process = voice.process();
        let places = process.map_or(&[][..], |process| process.mapping().places());
        let value = |place: &Place| Value {
            place: *place,
            signal: self.signal.dictionary.number_of(place.name),
            unit: self.unit.dictionary.number_of(place.unit),
        };
        Voiced {
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
