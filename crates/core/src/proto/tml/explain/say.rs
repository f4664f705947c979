//! A message as kind, fields and a line of text.

use core::fmt::{self, Write as _};

use super::layout::{Range, Said};
use super::{names, register};
use crate::explain::{Direction, Field, Sink, Value};
use crate::profile::{Encoding, Parameter, Profile};
use crate::proto::tml::online::{Cell, Memory, Online, PvtPoint};
use crate::proto::tml::wire::IdCode;

/// Explains a message, and what it answers.
pub(super) fn message(
    said: &Said,
    request: Option<&Said>,
    profile: Option<&'static Profile>,
    sink: &mut dyn Sink,
) {
    let online = Online::parse(&said.instruction);
    let request = request.filter(|asked| super::answers(said, asked));
    sink.kind(online.as_ref().map_or_else(|| names::category(&said.instruction), word));
    if let Some(axis) = axis(said, online.as_ref(), request) {
        sink.axis(axis.into());
    }
    let mut say = Say { said, profile, sink };
    say.head();
    match &online {
        Some(online) => say.online(online),
        None => say.data(),
    }
    if let Some((at, sum)) = say.said.sum {
        say.field("checksum", (at, at + 1), Value::Int(sum.into()));
    }
    say.line(online.as_ref(), request);
}

/// Explains an ack, and of what.
pub(super) fn ack(request: Option<&Said>, profile: Option<&'static Profile>, sink: &mut dyn Sink) {
    sink.kind("ack");
    let meaning = "the connected drive has understood the frame";
    sink.field(Field { name: "ack", start: 0, end: 1, value: Value::Hex(0x4F, 2), meaning });
    let Some(asked) = request else { return sink.text("ack") };
    if let Some(to) = asked.to.filter(|to| !to.group) {
        sink.axis(to.id.into());
    }
    sink.text("ack of ");
    let mut say = Say { said: asked, profile, sink };
    say.what(Online::parse(&asked.instruction).as_ref());
    let _ = write!(Text(sink), ", to {}", Whom(asked.to));
}

/// Explains a byte that synchronises.
pub(super) fn sync(byte: u8, direction: Option<Direction>, sink: &mut dyn Sink) {
    sink.kind("synchronisation byte");
    let (value, meaning) = (Value::Hex(byte.into(), 2), "restores the boundary between frames");
    sink.field(Field { name: "sync", start: 0, end: 1, value, meaning });
    sink.text(match direction {
        Some(Direction::ToHost) => "synchronised: the drive waits for a frame",
        _ => "synchronise: forget what was begun",
    });
}

/// The manual's word for what is exchanged.
pub(super) const fn word(online: &Online) -> &'static str {
    match online {
        Online::GiveMeData { .. } => "GiveMeData",
        Online::GiveMeData2 { .. } => "GiveMeData2",
        Online::TakeData { .. } => "TakeData",
        Online::TakeData2 { .. } => "TakeData2",
        Online::GetData { .. } => "GetTMLData",
        Online::GotData { .. } => "TakeTMLData",
        Online::GetVersion { .. } => "GETVERSION",
        Online::TakeVersion { .. } => "TakeVersion",
        Online::Ping { .. } => "PING",
        Online::Pong { .. } => "PONG",
        Online::GetChecksum { .. } => "checksum request",
        Online::TakeChecksum { .. } => "checksum",
        Online::Synchronisation => "Synchronisation",
        Online::MasterTime(_) => "Set Master Time",
        Online::SetSync(_) => "SETSYNC",
        Online::Pvt(_) => "PVTP",
        Online::Pt(_) => "PTP",
    }
}

/// The axis that a message concerns: who answers, or who is told.
fn axis(said: &Said, online: Option<&Online>, request: Option<&Said>) -> Option<u8> {
    let answers = online.and_then(Online::answered_by).or(said.sender);
    let is_answer =
        matches!(online, Some(Online::TakeVersion { .. } | Online::TakeChecksum { .. }));
    let told = if is_answer { request.and_then(|asked| asked.to) } else { said.to };
    answers.or_else(|| told.filter(|to| !to.group && !to.host).map(|to| to.id))
}

/// Text of bounded length, for a field.
pub(super) struct Short {
    bytes: [u8; TEXT_MAX],
    len: usize,
}

/// Longer than any instruction's text.
const TEXT_MAX: usize = 120;

impl Default for Short {
    fn default() -> Self {
        Self { bytes: [0; TEXT_MAX], len: 0 }
    }
}

impl Short {
    pub fn of(text: impl fmt::Display) -> Self {
        let mut short = Self::default();
        // What does not fit is cut.
        let _ = write!(short, "{text}");
        short
    }

    pub fn as_str(&self) -> &str {
        core::str::from_utf8(&self.bytes[..self.len]).unwrap_or("")
    }
}

impl fmt::Write for Short {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for character in text.chars() {
            let width = character.len_utf8();
            let room = self.bytes.get_mut(self.len..self.len + width).ok_or(fmt::Error)?;
            character.encode_utf8(room);
            self.len += width;
        }
        Ok(())
    }
}

/// Writes into a sink's line.
pub(super) struct Text<'a>(pub &'a mut dyn Sink);

impl fmt::Write for Text<'_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.0.text(text);
        Ok(())
    }
}

/// Whom a message is for, in words.
pub(super) struct Whom(pub Option<IdCode>);

impl fmt::Display for Whom {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            None => f.write_str("whoever listens"),
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

/// What a request asks for.
pub(super) const fn cell_of(online: &Online) -> Option<Cell> {
    match *online {
        Online::GiveMeData { cell, .. } | Online::GiveMeData2 { cell, .. } => Some(cell),
        Online::GetData { address, long, .. } => Some(Cell { memory: Memory::Data, address, long }),
        _ => None,
    }
}

/// A place by name, or by address where it has none.
pub(super) fn place(cell: Cell, profile: Option<&'static Profile>) -> Place {
    Place(names::variable(cell, profile), cell)
}

/// A place with the variable that it is.
pub(super) struct Place(Option<&'static Parameter>, Cell);

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Cell { memory, address, .. } = self.1;
        match (self.0, memory) {
            (Some(variable), _) => f.write_str(variable.symbol),
            (None, Memory::Data) => write!(f, "0x{address:04X}"),
            (None, memory) => write!(f, "0x{address:04X},{}", memory.word()),
        }
    }
}

struct Say<'a> {
    said: &'a Said,
    profile: Option<&'static Profile>,
    sink: &'a mut dyn Sink,
}

impl Say<'_> {
    fn field(&mut self, name: &'static str, (start, end): Range, value: Value<'_>) {
        self.sink.field(Field { name, start, end, value, meaning: "" });
    }

    fn named(&mut self, name: &'static str, place: Range, value: Value<'_>, meaning: &'static str) {
        let (start, end) = place;
        self.sink.field(Field { name, start, end, value, meaning });
    }

    /// What every frame has.
    fn head(&mut self) {
        let said = *self.said;
        if let Some(length) = said.length {
            self.field("length", (0, 1), Value::Int(length.into()));
        }
        if let Some(class) = said.class {
            self.field("class", (0, 0), Value::Text(class.name()));
        }
        let whom = Short::of(Whom(said.to));
        let known = if said.to.is_some() { "" } else { "the identifier does not say" };
        self.named("to", said.code, Value::Text(whom.as_str()), known);
        self.field("opcode", said.opcode, Value::Hex(said.instruction.opcode.into(), 4));
        let mut text = Short::default();
        names::disassemble(&said.instruction, self.profile, &mut |piece| {
            // What does not fit is cut.
            let _ = text.write_str(piece);
        });
        self.field("tml", (0, 0), Value::Text(text.as_str()));
    }

    /// Data words as they are.
    fn data(&mut self) {
        let words = self.said.instruction.data();
        if words.is_empty() {
            return;
        }
        let mut bytes = [0; 8];
        for (pair, word) in bytes.chunks_exact_mut(2).zip(words) {
            pair.copy_from_slice(&word.to_be_bytes());
        }
        let place = self.said.span(0, words.len());
        self.field("data", place, Value::Words(&bytes[..2 * words.len()]));
    }

    fn online(&mut self, online: &Online) {
        let said = *self.said;
        match *online {
            Online::GiveMeData { sender, cell } | Online::GiveMeData2 { sender, cell } => {
                self.sender(sender);
                self.cell(cell, said.words[1]);
            }
            Online::TakeData { sender, cell, value } => {
                self.sender(sender);
                self.cell(cell, said.words[1]);
                self.value(cell, value, 2);
            }
            Online::TakeData2 { sender, address, long, value } => {
                let cell = Cell { memory: Memory::Data, address, long };
                let place = if said.class.is_some() { (0, 0) } else { said.opcode };
                let text = Short::of(Whom(Some(IdCode::axis(sender))));
                self.field("sender", place, Value::Text(text.as_str()));
                self.cell(cell, said.words[0]);
                self.value(cell, value, 1);
            }
            Online::GetData { sender, address, long } => {
                self.sender(sender);
                self.cell(Cell { memory: Memory::Data, address, long }, said.opcode);
            }
            Online::GotData { sender, address, long, value } => {
                let cell = Cell { memory: Memory::Data, address, long };
                self.sender(sender);
                self.cell(cell, said.opcode);
                self.value(cell, value, 1);
            }
            Online::GetVersion { sender } => self.sender(sender),
            Online::Ping { sender, word } => {
                self.sender(sender);
                self.field("word", said.words[1], Value::Hex(word.into(), 4));
            }
            Online::TakeVersion { version } | Online::Pong { version, .. } => {
                let text = Short::of(Firmware(version));
                self.field("firmware", said.span(0, 2), Value::Text(text.as_str()));
            }
            Online::GetChecksum { sender, memory, start, end } => {
                self.sender(sender);
                self.field("memory", said.opcode, Value::Text(memory.word()));
                self.field("start", said.words[1], Value::Hex(start.into(), 4));
                self.field("end", said.words[2], Value::Hex(end.into(), 4));
            }
            Online::TakeChecksum { memory, sum } => {
                self.field("memory", said.opcode, Value::Text(memory.word()));
                self.field("sum", said.words[0], Value::Hex(sum.into(), 4));
            }
            Online::Synchronisation => {}
            Online::MasterTime(time) => {
                let value = Value::Int(time.into());
                self.named("time", said.span(0, 2), value, "slow-loop periods");
            }
            Online::SetSync(period) => {
                let value = Value::Int(period.into());
                self.named("period", said.span(0, 2), value, "slow-loop periods");
            }
            Online::Pvt(point) => self.point(&point),
            Online::Pt(point) => {
                let position = Value::Int(point.position.into());
                self.named("position", said.span(0, 2), position, "counts");
                let time = Value::Int(point.time.into());
                self.named("time", said.words[2], time, "slow-loop periods");
                self.field("counter", said.opcode, Value::Int(point.counter.into()));
            }
        }
    }

    /// Position and velocity share the second word.
    fn point(&mut self, point: &PvtPoint) {
        let said = *self.said;
        let position = Value::Int(point.position.into());
        self.named("position", said.span(0, 2), position, "counts");
        let velocity = Value::Real(f64::from(point.velocity) / 65536.0);
        self.named("velocity", said.span(1, 2), velocity, "counts per slow-loop period");
        let time = Value::Int(point.time.into());
        self.named("time", said.words[3], time, "slow-loop periods");
        self.field("counter", said.opcode, Value::Int(point.counter.into()));
    }

    fn sender(&mut self, sender: IdCode) {
        let text = Short::of(Whom(Some(sender)));
        self.field("sender", self.said.words[0], Value::Text(text.as_str()));
    }

    fn cell(&mut self, cell: Cell, place: Range) {
        if cell.memory != Memory::Data {
            self.field("memory", self.said.opcode, Value::Text(cell.memory.word()));
        }
        self.field("address", place, Value::Hex(cell.address.into(), 4));
        if let Some(variable) = names::variable(cell, self.profile) {
            self.field("variable", place, Value::Text(variable.symbol));
        }
    }

    fn value(&mut self, cell: Cell, value: u32, word: usize) {
        let place = self.said.span(word, 1 + usize::from(cell.long));
        let typed = typed(names::variable(cell, self.profile), cell.long, value);
        self.field("value", place, typed);
    }

    /// The whole of it in a line.
    fn line(&mut self, online: Option<&Online>, request: Option<&Said>) {
        self.what(online);
        self.route(online, request);
    }

    /// What is said, without from whom to whom.
    fn what(&mut self, online: Option<&Online>) {
        match online {
            Some(Online::TakeData { cell, value, .. }) => self.taken(*cell, *value),
            Some(
                Online::TakeData2 { address, long, value, .. }
                | Online::GotData { address, long, value, .. },
            ) => {
                let cell = Cell { memory: Memory::Data, address: *address, long: *long };
                self.taken(cell, *value);
            }
            Some(Online::TakeVersion { version } | Online::Pong { version, .. }) => {
                let _ = write!(Text(self.sink), "firmware {}", Firmware(*version));
            }
            Some(Online::TakeChecksum { memory, sum }) => {
                let _ = write!(Text(self.sink), "checksum of {} = 0x{sum:04X}", memory.word());
            }
            Some(online) if cell_of(online).is_some() => {
                let asked = cell_of(online).unwrap_or_default();
                let _ = write!(Text(self.sink), "{} {}", word(online), place(asked, self.profile));
            }
            _ => {
                let sink = &mut *self.sink;
                let profile = self.profile;
                names::disassemble(&self.said.instruction, profile, &mut |piece| sink.text(piece));
            }
        }
    }

    /// A value, and what its bits say.
    fn taken(&mut self, cell: Cell, value: u32) {
        let variable = names::variable(cell, self.profile);
        let place = Place(variable, cell);
        let mut out = Text(self.sink);
        let _ = match typed(variable, cell.long, value) {
            Value::Real(number) => write!(out, "{place} = {number}"),
            Value::Int(number) => write!(out, "{place} = {number}"),
            _ => Ok(()),
        };
        self.bits(variable, value);
    }

    /// What the bits of a register say, in words.
    fn bits(&mut self, variable: Option<&Parameter>, value: u32) {
        let mut before = " (";
        register::words(variable.map_or("", |variable| variable.symbol), value, |meaning| {
            self.sink.text(before);
            self.sink.text(meaning);
            before = ", ";
        });
        if before == ", " {
            self.sink.text(")");
        }
    }

    /// From whom to whom, and on which way.
    fn route(&mut self, online: Option<&Online>, request: Option<&Said>) {
        let said = *self.said;
        let from = online.and_then(Online::answered_by).or(said.sender);
        let from = from.or_else(|| request.and_then(|asked| asked.to).map(|to| to.id));
        let mut out = Text(self.sink);
        let unasked = matches!(online, Some(Online::TakeData2 { .. }));
        let _ = match (from, said.to) {
            (Some(from), Some(_)) => write!(out, ", from axis {from} to {}", Whom(said.to)),
            (Some(from), None) => write!(out, ", from axis {from}"),
            (None, _) => write!(out, ", to {}", Whom(said.to)),
        };
        // MASTERID has the host bit even where the host is on CAN, so unasked messages do not tell.
        let relay = said.to.filter(|to| to.host && from.is_none_or(|from| from != to.id));
        if let Some(relay) = relay.filter(|_| !unasked) {
            let _ = write!(out, ", by relay axis {}", relay.id);
        }
        if let Some(sender) = online.and_then(Online::reply_to) {
            let _ = write!(out, "; the answer goes to {}", Whom(Some(sender)));
        }
        if said.misprinted {
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

/// A version as firmware is named.
struct Firmware([u8; 4]);

impl fmt::Display for Firmware {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("F")?;
        self.0.iter().try_for_each(|letter| {
            let printed = letter.is_ascii_graphic();
            f.write_char(if printed { char::from(*letter) } else { '?' })
        })
    }
}

/// A value as its variable's type has it; without a name as a signed number.
fn typed(variable: Option<&Parameter>, long: bool, value: u32) -> Value<'static> {
    match (variable.map(|variable| variable.encoding), long) {
        (Some(Encoding::Fixed), true) => Value::Real(f64::from(value.cast_signed()) / 65536.0),
        (Some(Encoding::U16 | Encoding::U32), _) => Value::Int(value.into()),
        (_, true) => Value::Int(value.cast_signed().into()),
        (_, false) => Value::Int((value as u16).cast_signed().into()),
    }
}
