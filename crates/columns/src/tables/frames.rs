//! Table `frames`: every frame with its bytes.

use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_array::types::{Int8Type, Int32Type, Int64Type};
use arrow_schema::ArrowError;
use polepair_capture::session::{AnomalyKind, SessionNotice};
use polepair_capture::{
    CAN_FD, CompactFrame, DecodedFrame, ERROR_FRAME, FrameDefect, FrameTemplate,
};
use polepair_core::explain::Direction;

use super::{CaptureOrigin, common_value, push_times, sort_by_time, timestamp_ns, to_i64};
use crate::column::{BytesColumn, ConstantColumn, NumberColumn, WordColumn, to_micros};
use crate::schema::TableKind;

/// Bits of column `flags`.
pub mod flags {
    /// The identifier has 29 bits.
    pub const EXTENDED: i32 = 1;
    /// A remote request.
    pub const REMOTE: i32 = 1 << 1;
    /// A report of a controller about its bus.
    pub const ERROR: i32 = 1 << 2;
    /// The host's own request, received as an echo.
    pub const ECHO: i32 = 1 << 3;
    /// A repetition of the same request.
    pub const RETRY: i32 = 1 << 4;
    /// A failed check (CRC, LRC or checksum).
    pub const BAD_CHECK: i32 = 1 << 5;
    /// Bytes that belong to no frame.
    pub const STRAY: i32 = 1 << 6;
    /// CAN FD.
    pub const FD: i32 = 1 << 7;
    /// A violation of the protocol.
    pub const WRONG: i32 = 1 << 8;
}

#[derive(Debug, Default)]
pub(super) struct FrameRows {
    t_ns: NumberColumn<Int64Type>,
    source: ConstantColumn,
    bus: WordColumn,
    dir: NumberColumn<Int8Type>,
    protocol: WordColumn,
    can_id: NumberColumn<Int32Type>,
    flags: NumberColumn<Int32Type>,
    data: BytesColumn,
    file: ConstantColumn,
    file_pos: NumberColumn<Int64Type>,
    seq: NumberColumn<Int64Type>,
}

/// Constant columns of frames by template: words by their numbers.
#[derive(Debug)]
pub(super) struct EncodedTemplates {
    /// Constant columns of each template.
    templates: Vec<EncodedTemplate>,
    /// On which link, which way and in which protocol, where it is the same for all of them.
    bus: Option<i32>,
    direction: Option<Option<i8>>,
    protocol: Option<i32>,
}

/// Constant columns of one template.
#[derive(Debug)]
struct EncodedTemplate {
    bus: i32,
    direction: Option<i8>,
    protocol: i32,
    id: i32,
    len: u8,
}

impl EncodedTemplates {
    #[inline]
    fn get(&self, plain: &CompactFrame) -> &EncodedTemplate {
        &self.templates[usize::from(plain.template)]
    }
}

impl FrameRows {
    pub fn new(origin: &CaptureOrigin) -> Self {
        let (source, file) =
            (ConstantColumn::new(&origin.source), ConstantColumn::new(&origin.file));
        Self { source, file, ..Self::default() }
    }

    pub fn rows(&self) -> usize {
        self.seq.len()
    }

    pub fn data_len(&self) -> usize {
        self.data.size()
    }

    pub fn push(&mut self, event: &DecodedFrame<'_>) {
        self.t_ns.push_option(timestamp_ns(event.time));
        self.bus.push(event.link);
        self.dir.push_option(event.direction.map(direction_code));
        self.protocol.push_option(event.protocol.map(protocol_word));
        self.can_id.push_option(event.id.map(|id| (id & 0x1FFF_FFFF).cast_signed()));
        self.flags.push(flags_of(event));
        self.data.push(event.bytes);
        self.file_pos.push(to_i64(event.offset));
        self.seq.push(to_i64(event.number));
    }

    /// Reserves memory for `rows` rows.
    pub fn reserve(&mut self, rows: usize) {
        let Self { t_ns, bus, dir, protocol, can_id, flags, data, file_pos, seq, .. } = self;
        [t_ns, file_pos, seq].into_iter().for_each(|column| column.reserve(rows));
        [bus.keys(), protocol.keys(), can_id, flags].into_iter().for_each(|it| it.reserve(rows));
        dir.reserve(rows);
        data.reserve(rows);
    }

    /// Frames that change nothing, column by column.
    pub fn push_plain(&mut self, run: &[CompactFrame], templates: &EncodedTemplates) {
        push_times(&mut self.t_ns, run);
        match templates.bus {
            Some(bus) => self.bus.keys().repeat(Some(bus), run.len()),
            None => {
                self.bus.keys().extend(run.iter().map(|plain| template_of(plain, templates).bus))
            }
        }
        match templates.direction {
            Some(direction) => self.dir.repeat(direction, run.len()),
            None => run
                .iter()
                .for_each(|plain| self.dir.push_option(template_of(plain, templates).direction)),
        }
        match templates.protocol {
            Some(protocol) => self.protocol.keys().repeat(Some(protocol), run.len()),
            None => self
                .protocol
                .keys()
                .extend(run.iter().map(|plain| template_of(plain, templates).protocol)),
        }
        self.can_id.extend(run.iter().map(|plain| template_of(plain, templates).id));
        self.flags.repeat(Some(0), run.len());
        self.data.extend(
            run.iter().map(|plain| (plain.data.to_le_bytes(), template_of(plain, templates).len)),
        );
        self.file_pos.extend(run.iter().map(|plain| to_i64(plain.offset)));
        self.seq.extend(run.iter().map(|plain| to_i64(plain.number)));
    }

    /// Encodes the constant columns of these templates.
    pub fn templates(&mut self, voices: &[FrameTemplate]) -> EncodedTemplates {
        let voices: Vec<EncodedTemplate> = voices
            .iter()
            .map(|voice| EncodedTemplate {
                bus: self.bus.dictionary.number(&voice.link),
                direction: voice.direction.map(direction_code),
                protocol: self.protocol.dictionary.number_of_static(protocol_word(voice.protocol)),
                id: voice.id.unwrap_or(0).cast_signed(),
                len: voice.len,
            })
            .collect();
        EncodedTemplates {
            bus: common_value(voices.iter().map(|voice| voice.bus)),
            direction: common_value(voices.iter().map(|voice| voice.direction)),
            protocol: common_value(voices.iter().map(|voice| voice.protocol)),
            templates: voices,
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
            Arc::new(self.dir.finish()),
            self.protocol.finish()?,
            Arc::new(self.can_id.finish()),
            Arc::new(self.flags.finish()),
            self.data.finish()?,
            self.file.array(rows)?,
            Arc::new(self.file_pos.finish()),
            Arc::new(self.seq.finish()),
        ];
        sort_by_time(&times, RecordBatch::try_new(TableKind::Frames.schema(), columns)?)
    }
}

fn template_of<'t>(plain: &CompactFrame, templates: &'t EncodedTemplates) -> &'t EncodedTemplate {
    templates.get(plain)
}

fn direction_code(way: Direction) -> i8 {
    (way == Direction::ToDrive).into()
}

/// A protocol's name as the columns have it: `modbus_rtu`.
fn protocol_word(name: &'static str) -> &'static str {
    match name {
        "modbus-rtu" => "modbus_rtu",
        "modbus-ascii" => "modbus_ascii",
        "modbus-tcp" => "modbus_tcp",
        other => other,
    }
}

fn flags_of(event: &DecodedFrame<'_>) -> i32 {
    let error = is_plain_event_kind(ERROR_FRAME, event.protocol, &event.explanation.kind);
    let bits = [
        (event.extended && !error, flags::EXTENDED),
        (event.remote, flags::REMOTE),
        (error, flags::ERROR),
        (event.echo, flags::ECHO),
        (
            event.notices.iter().any(|notice| match notice {
                SessionNotice::Anomaly(anomaly) => anomaly.kind == AnomalyKind::Retry,
                _ => false,
            }),
            flags::RETRY,
        ),
        (event.defect.is_some_and(FrameDefect::is_bad_check), flags::BAD_CHECK),
        (event.stray, flags::STRAY),
        (is_plain_event_kind(CAN_FD, event.protocol, &event.explanation.kind), flags::FD),
        (event.defect.is_some(), flags::WRONG),
    ];
    bits.into_iter().filter(|(set, _)| *set).map(|(_, bit)| bit).sum()
}

fn is_plain_event_kind(
    kind: &str,
    event_protocol: Option<&'static str>,
    event_explanation_kind: &str,
) -> bool {
    event_protocol.is_none() && event_explanation_kind == kind
}
