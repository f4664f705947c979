//! A message as kind, fields and a line of text.

use core::fmt::{self, Write as _};

use super::layout::{ByteRange, ParsedFrame};
use super::{names, register};
use crate::convert::ascii_text;
use crate::explain::{Direction, ExplainSink, Field, FieldValue};
use crate::profile::{Encoding, Parameter, Profile};
use crate::proto::tml::online::{Cell, MemorySpace, OnlineMessage, PvtPoint};
use crate::proto::tml::rules::WireRule;
use crate::proto::tml::wire::IdCode;

/// Explains a message, and the request that it answers.
pub(super) fn explain_message(
    parsed: &ParsedFrame,
    request: Option<&ParsedFrame>,
    profile: Option<&'static Profile>,
    sink: &mut dyn ExplainSink,
) {
    let online = OnlineMessage::parse(&parsed.instruction);
    let request = request.filter(|parsed_frame| super::is_answer(parsed, parsed_frame));
    sink.kind(online.as_ref().map_or_else(|| names::category(&parsed.instruction), message_name));
    if let Some(axis) = concerned_axis(parsed, online.as_ref(), request) {
        sink.axis(axis.into());
    }
    let mut say = MessageExplainer { frame: parsed, profile, sink };
    say.emit_head();
    match &online {
        Some(online) => say.emit_online(online),
        None => say.emit_data(),
    }
    if let Some((at, sum)) = say.frame.checksum {
        say.emit_field("checksum", (at, at + 1), FieldValue::Int(sum.into()));
    }
    if say.sink.wants_text() {
        say.write_line(online.as_ref(), request);
    }
}

/// Explains an ack, and the acknowledged message.
pub(super) fn explain_ack(
    request: Option<&ParsedFrame>,
    profile: Option<&'static Profile>,
    sink: &mut dyn ExplainSink,
) {
    sink.kind("ack");
    let meaning = "the connected drive has understood the frame";
    sink.field(Field { name: "ack", start: 0, end: 1, value: FieldValue::Hex(0x4F, 2), meaning });
    let Some(parsed) = request else { return sink.text("ack") };
    if let Some(to) = parsed.to.filter(|to| !to.group) {
        sink.axis(to.id.into());
    }
    if !sink.wants_text() {
        return;
    }
    sink.text("ack of ");
    let mut say = MessageExplainer { frame: parsed, profile, sink };
    say.write_content(OnlineMessage::parse(&parsed.instruction).as_ref());
    let _ = write!(SinkWriter(sink), ", to {}", Recipient(parsed.to));
}

/// Explains a byte that synchronises.
pub(super) fn explain_sync(byte: u8, direction: Option<Direction>, sink: &mut dyn ExplainSink) {
    sink.kind("synchronisation byte");
    let (value, meaning) =
        (FieldValue::Hex(byte.into(), 2), "restores the boundary between frames");
    sink.field(Field { name: "sync", start: 0, end: 1, value, meaning });
    sink.text(match direction {
        Some(Direction::ToHost) => "synchronised: the drive waits for a frame",
        _ => "synchronise: forget what was begun",
    });
}

/// The manual's word for an exchanged message.
pub(super) const fn message_name(online: &OnlineMessage) -> &'static str {
    match online {
        OnlineMessage::GiveMeData { .. } => "GiveMeData",
        OnlineMessage::GiveMeData2 { .. } => "GiveMeData2",
        OnlineMessage::TakeData { .. } => "TakeData",
        OnlineMessage::TakeData2 { .. } => "TakeData2",
        OnlineMessage::GetData { .. } => "GetTMLData",
        OnlineMessage::GotData { .. } => "TakeTMLData",
        OnlineMessage::GetVersion { .. } => "GETVERSION",
        OnlineMessage::TakeVersion { .. } => "TakeVersion",
        OnlineMessage::Ping { .. } => "PING",
        OnlineMessage::Pong { .. } => "PONG",
        OnlineMessage::GetChecksum { .. } => "checksum request",
        OnlineMessage::TakeChecksum { .. } => "checksum",
        OnlineMessage::Synchronisation => "Synchronisation",
        OnlineMessage::MasterTime(_) => "Set Master Time",
        OnlineMessage::SetSync(_) => "SETSYNC",
        OnlineMessage::Pvt(_) => "PVTP",
        OnlineMessage::Pt(_) => "PTP",
    }
}

/// The axis that a message concerns: the one that replies, or the addressee.
fn concerned_axis(
    parsed: &ParsedFrame,
    online: Option<&OnlineMessage>,
    request: Option<&ParsedFrame>,
) -> Option<u8> {
    let answers = online.and_then(OnlineMessage::answered_by).or(parsed.sender);
    let is_answer = matches!(
        online,
        Some(OnlineMessage::TakeVersion { .. } | OnlineMessage::TakeChecksum { .. })
    );
    let id_code =
        if is_answer { request.and_then(|parsed_frame| parsed_frame.to) } else { parsed.to };
    answers.or_else(|| id_code.filter(|to| !to.group && !to.host).map(|to| to.id))
}

/// Text of bounded length, for a field.
pub(super) struct BoundedText {
    bytes: [u8; TEXT_MAX],
    len: usize,
}

/// Longer than any instruction's text.
const TEXT_MAX: usize = 120;

impl Default for BoundedText {
    fn default() -> Self {
        Self { bytes: [0; TEXT_MAX], len: 0 }
    }
}

impl BoundedText {
    pub fn of(text: impl fmt::Display) -> Self {
        let mut short = Self::default();
        // Text that does not fit is cut.
        let _ = write!(short, "{text}");
        short
    }

    pub fn as_str(&self) -> &str {
        ascii_text(&self.bytes[..self.len])
    }
}

impl fmt::Write for BoundedText {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for character in text.chars() {
            let width = character.len_utf8();
            let buffer = self.bytes.get_mut(self.len..self.len + width).ok_or(fmt::Error)?;
            character.encode_utf8(buffer);
            self.len += width;
        }
        Ok(())
    }
}

/// Writes into a sink's line.
pub(super) struct SinkWriter<'a>(pub &'a mut dyn ExplainSink);

impl fmt::Write for SinkWriter<'_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.0.text(text);
        Ok(())
    }
}

/// Receiver of a message, in words.
pub(super) struct Recipient(pub Option<IdCode>);

impl fmt::Display for Recipient {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            None => f.write_str("any receiver"),
            Some(to) if to.is_broadcast() => f.write_str("everybody"),
            Some(IdCode { group: true, id, .. }) => {
                let many = if id.is_power_of_two() { "group" } else { "groups" };
                f.write_str(many)?;
                let groups = (1..=8).filter(|number| id >> (number - 1) & 1 != 0);
                let mut sign = ' ';
                for group in groups {
                    write!(f, "{sign}{group}")?;
                    sign = '+';
                }
                Ok(())
            }
            Some(IdCode { host: true, id, .. }) => write!(f, "the host at axis {id}"),
            Some(IdCode { id: 0, .. }) => f.write_str("every axis"),
            Some(IdCode { id, .. }) => write!(f, "axis {id}"),
        }
    }
}

/// Memory cell that a request reads.
pub(super) const fn requested_cell(online: &OnlineMessage) -> Option<Cell> {
    match *online {
        OnlineMessage::GiveMeData { cell, .. } | OnlineMessage::GiveMeData2 { cell, .. } => {
            Some(cell)
        }
        OnlineMessage::GetData { address, long, .. } => {
            Some(Cell { memory: MemorySpace::Data, address, long })
        }
        _ => None,
    }
}

/// A place by name, or by address where it has none.
pub(super) fn cell_name(cell: Cell, profile: Option<&'static Profile>) -> CellName {
    CellName(names::find_variable(cell, profile), cell)
}

/// A place with the variable that it is.
pub(super) struct CellName(Option<&'static Parameter>, Cell);

impl fmt::Display for CellName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Cell { memory, address, .. } = self.1;
        match (self.0, memory) {
            (Some(variable), _) => f.write_str(variable.symbol),
            (None, MemorySpace::Data) => write!(f, "0x{address:04X}"),
            (None, memory) => write!(f, "0x{address:04X},{}", memory.word()),
        }
    }
}

struct MessageExplainer<'a> {
    frame: &'a ParsedFrame,
    profile: Option<&'static Profile>,
    sink: &'a mut dyn ExplainSink,
}

impl MessageExplainer<'_> {
    fn emit_field(&mut self, name: &'static str, (start, end): ByteRange, value: FieldValue<'_>) {
        self.sink.field(Field { name, start, end, value, meaning: "" });
    }

    fn emit_named_field(
        &mut self,
        name: &'static str,
        position: ByteRange,
        value: FieldValue<'_>,
        meaning: &'static str,
    ) {
        let (start, end) = position;
        self.sink.field(Field { name, start, end, value, meaning });
    }

    /// Emits the fields of every frame.
    fn emit_head(&mut self) {
        let parsed = *self.frame;
        if let Some(length) = parsed.length {
            self.emit_field("length", (0, 1), FieldValue::Int(length.into()));
        }
        if let Some(class) = parsed.class {
            self.emit_field("class", (0, 0), FieldValue::Text(class.name()));
        }
        let whom = BoundedText::of(Recipient(parsed.to));
        let known = if parsed.to.is_some() { "" } else { "the identifier does not say" };
        self.emit_named_field("to", parsed.id_code_range, FieldValue::Text(whom.as_str()), known);
        self.emit_field(
            "opcode",
            parsed.opcode_range,
            FieldValue::Hex(parsed.instruction.opcode.into(), 4),
        );
        let mut text = BoundedText::default();
        names::disassemble(&parsed.instruction, self.profile, &mut |piece| {
            // Text that does not fit is cut.
            let _ = text.write_str(piece);
        });
        self.emit_field("tml", (0, 0), FieldValue::Text(text.as_str()));
    }

    /// Data words as they are.
    fn emit_data(&mut self) {
        let words = self.frame.instruction.data();
        if words.is_empty() {
            return;
        }
        let mut bytes = [0; 8];
        for (pair, word) in bytes.chunks_exact_mut(2).zip(words) {
            pair.copy_from_slice(&word.to_be_bytes());
        }
        let position = self.frame.words_range(0, words.len());
        self.emit_field("data", position, FieldValue::Words(&bytes[..2 * words.len()]));
    }

    fn emit_online(&mut self, online: &OnlineMessage) {
        let parsed = *self.frame;
        match *online {
            OnlineMessage::GiveMeData { sender, cell }
            | OnlineMessage::GiveMeData2 { sender, cell } => {
                self.emit_sender(sender);
                self.emit_cell(cell, parsed.word_ranges[1]);
            }
            OnlineMessage::TakeData { sender, cell, value } => {
                self.emit_sender(sender);
                self.emit_cell(cell, parsed.word_ranges[1]);
                self.emit_value(cell, value, 2);
            }
            OnlineMessage::TakeData2 { sender, address, long, value } => {
                let cell = Cell { memory: MemorySpace::Data, address, long };
                let location = if parsed.class.is_some() { (0, 0) } else { parsed.opcode_range };
                let text = BoundedText::of(Recipient(Some(IdCode::axis(sender))));
                self.emit_field("sender", location, FieldValue::Text(text.as_str()));
                self.emit_cell(cell, parsed.word_ranges[0]);
                self.emit_value(cell, value, 1);
            }
            OnlineMessage::GetData { sender, address, long } => {
                self.emit_sender(sender);
                self.emit_cell(
                    Cell { memory: MemorySpace::Data, address, long },
                    parsed.opcode_range,
                );
            }
            OnlineMessage::GotData { sender, address, long, value } => {
                let cell = Cell { memory: MemorySpace::Data, address, long };
                self.emit_sender(sender);
                self.emit_cell(cell, parsed.opcode_range);
                self.emit_value(cell, value, 1);
            }
            OnlineMessage::GetVersion { sender } => self.emit_sender(sender),
            OnlineMessage::Ping { sender, word } => {
                self.emit_sender(sender);
                self.emit_field("word", parsed.word_ranges[1], FieldValue::Hex(word.into(), 4));
            }
            OnlineMessage::TakeVersion { version } | OnlineMessage::Pong { version, .. } => {
                let text = BoundedText::of(FirmwareName(version));
                self.emit_field(
                    "firmware",
                    parsed.words_range(0, 2),
                    FieldValue::Text(text.as_str()),
                );
            }
            OnlineMessage::GetChecksum { sender, memory, start, end } => {
                self.emit_sender(sender);
                self.emit_field("memory", parsed.opcode_range, FieldValue::Text(memory.word()));
                self.emit_field("start", parsed.word_ranges[1], FieldValue::Hex(start.into(), 4));
                self.emit_field("end", parsed.word_ranges[2], FieldValue::Hex(end.into(), 4));
            }
            OnlineMessage::TakeChecksum { memory, sum } => {
                self.emit_field("memory", parsed.opcode_range, FieldValue::Text(memory.word()));
                self.emit_field("sum", parsed.word_ranges[0], FieldValue::Hex(sum.into(), 4));
            }
            OnlineMessage::Synchronisation => {}
            OnlineMessage::MasterTime(time) => {
                let value = FieldValue::Int(time.into());
                self.emit_named_field("time", parsed.words_range(0, 2), value, "slow-loop periods");
            }
            OnlineMessage::SetSync(period) => {
                let value = FieldValue::Int(period.into());
                self.emit_named_field(
                    "period",
                    parsed.words_range(0, 2),
                    value,
                    "slow-loop periods",
                );
            }
            OnlineMessage::Pvt(point) => self.emit_point(&point),
            OnlineMessage::Pt(point) => {
                let position = FieldValue::Int(point.position.into());
                self.emit_named_field("position", parsed.words_range(0, 2), position, "counts");
                let time = FieldValue::Int(point.time.into());
                self.emit_named_field("time", parsed.word_ranges[2], time, "slow-loop periods");
                self.emit_field(
                    "counter",
                    parsed.opcode_range,
                    FieldValue::Int(point.counter.into()),
                );
            }
        }
    }

    /// Position and velocity share the second word.
    fn emit_point(&mut self, point: &PvtPoint) {
        let parsed = *self.frame;
        let position = FieldValue::Int(point.position.into());
        self.emit_named_field("position", parsed.words_range(0, 2), position, "counts");
        let velocity = FieldValue::Real(f64::from(point.velocity) / 65536.0);
        self.emit_named_field(
            "velocity",
            parsed.words_range(1, 2),
            velocity,
            "counts per slow-loop period",
        );
        let time = FieldValue::Int(point.time.into());
        self.emit_named_field("time", parsed.word_ranges[3], time, "slow-loop periods");
        self.emit_field("counter", parsed.opcode_range, FieldValue::Int(point.counter.into()));
    }

    fn emit_sender(&mut self, sender: IdCode) {
        let text = BoundedText::of(Recipient(Some(sender)));
        self.emit_field("sender", self.frame.word_ranges[0], FieldValue::Text(text.as_str()));
    }

    fn emit_cell(&mut self, cell: Cell, position: ByteRange) {
        if cell.memory != MemorySpace::Data {
            self.emit_field(
                "memory",
                self.frame.opcode_range,
                FieldValue::Text(cell.memory.word()),
            );
        }
        self.emit_field("address", position, FieldValue::Hex(cell.address.into(), 4));
        if let Some(variable) = names::find_variable(cell, self.profile) {
            self.emit_field("variable", position, FieldValue::Text(variable.symbol));
        }
    }

    fn emit_value(&mut self, cell: Cell, value: u32, word: usize) {
        let position = self.frame.words_range(word, 1 + usize::from(cell.long));
        let typed = typed_value(names::find_variable(cell, self.profile), cell.long, value);
        self.emit_field("value", position, typed);
    }

    /// The whole of it in a line.
    fn write_line(&mut self, online: Option<&OnlineMessage>, request: Option<&ParsedFrame>) {
        self.write_content(online);
        self.write_route(online, request);
    }

    /// Writes the content, without sender and addressee.
    fn write_content(&mut self, online: Option<&OnlineMessage>) {
        match online {
            Some(OnlineMessage::TakeData { cell, value, .. }) => self.write_value(*cell, *value),
            Some(
                OnlineMessage::TakeData2 { address, long, value, .. }
                | OnlineMessage::GotData { address, long, value, .. },
            ) => {
                let cell = Cell { memory: MemorySpace::Data, address: *address, long: *long };
                self.write_value(cell, *value);
            }
            Some(OnlineMessage::TakeVersion { version } | OnlineMessage::Pong { version, .. }) => {
                let _ = write!(SinkWriter(self.sink), "firmware {}", FirmwareName(*version));
            }
            Some(OnlineMessage::TakeChecksum { memory, sum }) => {
                let _ =
                    write!(SinkWriter(self.sink), "checksum of {} = 0x{sum:04X}", memory.word());
            }
            Some(online) => match requested_cell(online) {
                Some(cell) => {
                    let (name, cell) = (message_name(online), cell_name(cell, self.profile));
                    let _ = write!(SinkWriter(self.sink), "{name} {cell}");
                }
                None => self.write_instruction(),
            },
            None => self.write_instruction(),
        }
    }

    /// Writes the instruction as source text.
    fn write_instruction(&mut self) {
        let (sink, profile) = (&mut *self.sink, self.profile);
        names::disassemble(&self.frame.instruction, profile, &mut |piece| sink.text(piece));
    }

    /// Writes a value, and the meaning of its bits.
    fn write_value(&mut self, cell: Cell, value: u32) {
        let variable = names::find_variable(cell, self.profile);
        let cell_name = CellName(variable, cell);
        let mut out = SinkWriter(self.sink);
        let _ = match typed_value(variable, cell.long, value) {
            FieldValue::Real(number) => write!(out, "{cell_name} = {number}"),
            FieldValue::Int(number) => write!(out, "{cell_name} = {number}"),
            _ => Ok(()),
        };
        self.write_bits(variable, value);
    }

    /// Writes the meaning of a register's bits.
    fn write_bits(&mut self, variable: Option<&Parameter>, value: u32) {
        let mut before = " (";
        register::write_register_text(
            variable.map_or("", |variable| variable.symbol),
            value,
            |meaning| {
                self.sink.text(before);
                self.sink.text(meaning);
                before = ", ";
            },
        );
        if before == ", " {
            self.sink.text(")");
        }
    }

    /// From whom to whom, and on which way.
    fn write_route(&mut self, online: Option<&OnlineMessage>, request: Option<&ParsedFrame>) {
        let parsed = *self.frame;
        let from = online.and_then(OnlineMessage::answered_by).or(parsed.sender);
        let from =
            from.or_else(|| request.and_then(|parsed_frame| parsed_frame.to).map(|to| to.id));
        let mut out = SinkWriter(self.sink);
        let unasked = matches!(online, Some(OnlineMessage::TakeData2 { .. }));
        let _ = match (from, parsed.to) {
            (Some(from), Some(_)) => write!(out, ", from axis {from} to {}", Recipient(parsed.to)),
            (Some(from), None) => write!(out, ", from axis {from}"),
            (None, _) => write!(out, ", to {}", Recipient(parsed.to)),
        };
        // MASTERID has the host bit even if the host is on CAN, so unsolicited messages do not show it.
        let relay = parsed.to.filter(|to| to.host && from.is_none_or(|from| from != to.id));
        if let Some(relay) = relay.filter(|_| !unasked) {
            let _ = write!(out, ", by relay axis {}", relay.id);
        }
        if let Some(sender) = online.and_then(OnlineMessage::reply_to) {
            let _ = write!(out, "; the answer goes to {}", Recipient(Some(sender)));
        }
        if let Some(rule) = broken_rule(&parsed, online) {
            let _ = write!(out, "; not allowed: {}", rule.sentence());
        }
        if parsed.misprinted {
            let _ = out.write_str(
                "; the identifier is the sender's, as the manual prints it: drives send their \
                 host's",
            );
        }
        if unasked && request.is_none() {
            let _ = out.write_str("; unasked, or of a request not seen here");
        }
    }
}

/// The rule that a request to a group breaks. On a serial line a sender without host bit is a host on
/// RS-485: on RS-232 the host has the bit (TML communication manual, chapters 2 and 3).
fn broken_rule(parsed: &ParsedFrame, online: Option<&OnlineMessage>) -> Option<WireRule> {
    let sender = online?.reply_to()?;
    let to_group = parsed.to.is_some_and(|to| to.group);
    match online? {
        _ if !to_group => None,
        OnlineMessage::GiveMeData { .. } => Some(WireRule::GiveMeDataToGroup),
        _ if parsed.length.is_some() && !sender.host => Some(WireRule::Rs485AnswersFromGroup),
        _ => None,
    }
}

/// A version as firmware is named.
struct FirmwareName([u8; 4]);

impl fmt::Display for FirmwareName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("F")?;
        self.0.iter().try_for_each(|letter| {
            let printed = letter.is_ascii_graphic();
            f.write_char(if printed { char::from(*letter) } else { '?' })
        })
    }
}

/// A value as its variable's type has it; without a name as a signed number.
fn typed_value(variable: Option<&Parameter>, long: bool, value: u32) -> FieldValue<'static> {
    match (variable.map(|variable| variable.encoding), long) {
        (Some(Encoding::Fixed), true) => FieldValue::Real(f64::from(value.cast_signed()) / 65536.0),
        (Some(Encoding::U16 | Encoding::U32), _) => FieldValue::Int(value.into()),
        (_, true) => FieldValue::Int(value.cast_signed().into()),
        (_, false) => FieldValue::Int((value as u16).cast_signed().into()),
    }
}
