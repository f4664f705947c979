//! Table `frames`: every frame with its bytes.

use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_array::types::{Int8Type, Int32Type, Int64Type};
use arrow_schema::ArrowError;
use polepair_capture::session::{Notice, Oddity};
use polepair_capture::{CAN_FD, ERROR_FRAME, Event, Plain, Voice, Wrong};
use polepair_core::explain::Direction;

use super::{Origin, count, in_order, ns, only, times};
use crate::column::{Bytes, Numbers, Same, Words, micros};
use crate::schema::Table;

/// Bits of column `flags`.
pub mod flags {
    /// The identifier has 29 bits.
    pub const EXTENDED: i32 = 1;
    /// A remote request.
    pub const REMOTE: i32 = 1 << 1;
    /// What a controller reported of its bus.
    pub const ERROR: i32 = 1 << 2;
    /// The host's own request, heard back.
    pub const ECHO: i32 = 1 << 3;
    /// The same request again.
    pub const RETRY: i32 = 1 << 4;
    /// Its check fails.
    pub const BAD_CHECK: i32 = 1 << 5;
    /// Bytes that belong to no frame.
    pub const STRAY: i32 = 1 << 6;
    /// CAN FD.
    pub const FD: i32 = 1 << 7;
    /// It breaks its protocol.
    pub const WRONG: i32 = 1 << 8;
}

#[derive(Debug, Default)]
pub(super) struct Frames {
    t_ns: Numbers<Int64Type>,
    source: Same,
    bus: Words,
    dir: Numbers<Int8Type>,
    protocol: Words,
    can_id: Numbers<Int32Type>,
    flags: Numbers<Int32Type>,
    data: Bytes,
    file: Same,
    file_pos: Numbers<Int64Type>,
    seq: Numbers<Int64Type>,
}

/// What frames have in common that change nothing: words by their numbers.
#[derive(Debug)]
pub(super) struct Spoken {
    /// What all frames of a voice have in common.
    voices: Vec<Voiced>,
    /// On which link, which way and in which protocol, where it is the same for all of them.
    bus: Option<i32>,
    direction: Option<Option<i8>>,
    protocol: Option<i32>,
}

/// The same, of one voice.
#[derive(Debug)]
struct Voiced {
    bus: i32,
    direction: Option<i8>,
    protocol: i32,
    id: i32,
    len: u8,
}

impl Spoken {
    #[inline]
    fn of(&self, plain: &Plain) -> &Voiced {
        &self.voices[usize::from(plain.voice)]
    }
}

impl Frames {
    pub fn new(origin: &Origin) -> Self {
        let (source, file) = (Same::new(&origin.source), Same::new(&origin.file));
        Self { source, file, ..Self::default() }
    }

    pub fn rows(&self) -> usize {
        self.seq.len()
    }

    pub fn bytes(&self) -> usize {
        self.data.size()
    }

    pub fn push(&mut self, event: &Event<'_>) {
        self.t_ns.push_maybe(ns(event.time));
        self.bus.push(event.link);
        self.dir.push_maybe(event.direction.map(is_to_drive));
        self.protocol.push_maybe(event.protocol.map(word));
        self.can_id.push_maybe(event.id.map(|id| (id & 0x1FFF_FFFF).cast_signed()));
        self.flags.push(flags_of(event));
        self.data.push(event.bytes);
        self.file_pos.push(count(event.at));
        self.seq.push(count(event.number));
    }

    /// Makes room for so many rows.
    pub fn reserve(&mut self, rows: usize) {
        let Self { t_ns, bus, dir, protocol, can_id, flags, data, file_pos, seq, .. } = self;
        [t_ns, file_pos, seq].into_iter().for_each(|column| column.reserve(rows));
        [bus.keys(), protocol.keys(), can_id, flags].into_iter().for_each(|it| it.reserve(rows));
        dir.reserve(rows);
        data.reserve(rows);
    }

    /// Frames that change nothing, column by column.
    pub fn plain(&mut self, run: &[Plain], spoken: &Spoken) {
        times(&mut self.t_ns, run);
        let of = |plain| spoken.of(plain);
        match spoken.bus {
            Some(bus) => self.bus.keys().repeat(Some(bus), run.len()),
            None => self.bus.keys().extend(run.iter().map(|plain| of(plain).bus)),
        }
        match spoken.direction {
            Some(direction) => self.dir.repeat(direction, run.len()),
            None => run.iter().for_each(|plain| self.dir.push_maybe(of(plain).direction)),
        }
        match spoken.protocol {
            Some(protocol) => self.protocol.keys().repeat(Some(protocol), run.len()),
            None => self.protocol.keys().extend(run.iter().map(|plain| of(plain).protocol)),
        }
        self.can_id.extend(run.iter().map(|plain| of(plain).id));
        self.flags.repeat(Some(0), run.len());
        self.data.extend(run.iter().map(|plain| (plain.data.to_le_bytes(), of(plain).len)));
        self.file_pos.extend(run.iter().map(|plain| count(plain.at)));
        self.seq.extend(run.iter().map(|plain| count(plain.number)));
    }

    /// What frames of these voices have in common.
    pub fn spoken(&mut self, voices: &[Voice]) -> Spoken {
        let voiced = |voice: &Voice| Voiced {
            bus: self.bus.dictionary.number(&voice.link),
            direction: voice.direction.map(is_to_drive),
            protocol: self.protocol.dictionary.number_of(word(voice.protocol)),
            id: voice.id.cast_signed(),
            len: voice.len,
        };
        let voices: Vec<Voiced> = voices.iter().map(voiced).collect();
        Spoken {
            bus: only(voices.iter().map(|voice| voice.bus)),
            direction: only(voices.iter().map(|voice| voice.direction)),
            protocol: only(voices.iter().map(|voice| voice.protocol)),
            voices,
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
            Arc::new(self.dir.take()),
            self.protocol.take()?,
            Arc::new(self.can_id.take()),
            Arc::new(self.flags.take()),
            self.data.take()?,
            self.file.rows(rows)?,
            Arc::new(self.file_pos.take()),
            Arc::new(self.seq.take()),
        ];
        in_order(&times, RecordBatch::try_new(Table::Frames.schema(), columns)?)
    }
}

fn is_to_drive(way: Direction) -> i8 {
    (way == Direction::ToDrive).into()
}

/// A protocol's name as the columns have it: `modbus_rtu`.
fn word(name: &'static str) -> &'static str {
    match name {
        "modbus-rtu" => "modbus_rtu",
        "modbus-ascii" => "modbus_ascii",
        other => other,
    }
}

fn flags_of(event: &Event<'_>) -> i32 {
    let said = |kind: &str| event.protocol.is_none() && event.explained.kind == kind;
    let again = |notice: &Notice| matches!(notice, Notice::Odd(odd) if odd.kind == Oddity::Retry);
    let error = said(ERROR_FRAME);
    let bits = [
        (event.extended && !error, flags::EXTENDED),
        (event.remote, flags::REMOTE),
        (error, flags::ERROR),
        (event.echo, flags::ECHO),
        (event.notices.iter().any(again), flags::RETRY),
        (event.wrong.is_some_and(Wrong::is_check), flags::BAD_CHECK),
        (event.stray, flags::STRAY),
        (said(CAN_FD), flags::FD),
        (event.wrong.is_some(), flags::WRONG),
    ];
    bits.into_iter().filter(|(set, _)| *set).map(|(_, bit)| bit).sum()
}
