//! What is expected after a message: an ack, an answer, of which parts are known beforehand.

use core::fmt::{self, Write as _};

use super::layout::Said;
use super::say::{self, Short, Text, Whom};
use crate::explain::{Field, Sink, Value};
use crate::medium::Frame;
use crate::profile::Profile;
use crate::proto::tml::online::Online;
use crate::proto::tml::rules::Wire;
use crate::proto::tml::serial::{self, ACK, FRAME_MAX};
use crate::proto::tml::wire::{IdCode, Message};
use crate::proto::tml::{technocan, tmlcan};

/// Bytes that come back, ack included; `None` where nothing does, or from several axes.
pub(super) fn length(message: &Message, wire: Wire) -> Option<usize> {
    let ack = usize::from(wire.acknowledges(message.to));
    let many = message.to.group || message.to.id == 0;
    match Online::parse(&message.instruction).filter(Online::is_request) {
        Some(_) if many => None,
        Some(request) => Some(ack + Pattern::of(&request, message.to, wire)?.len),
        None => (ack > 0).then_some(ack),
    }
}

/// Explains what comes back.
pub(super) fn explain(
    said: &Said,
    wire: Wire,
    profile: Option<&'static Profile>,
    sink: &mut dyn Sink,
) {
    let Some(to) = said.to else { return };
    let ack = wire.acknowledges(to);
    let request = Online::parse(&said.instruction).filter(Online::is_request);
    let answer = request.and_then(|request| Some((request, answer(&request, to, 1, 0)?)));
    match &answer {
        Some((_, answer)) => sink.kind(say::word(answer)),
        None if ack => sink.kind("ack"),
        None => return,
    }
    let many = to.group || to.id == 0;
    if !many {
        sink.axis(to.id.into());
    }
    if ack {
        let (value, meaning) = (Value::Hex(ACK.into(), 2), "the connected drive has understood");
        sink.field(Field { name: "ack", start: 0, end: 0, value, meaning });
        sink.text("4F");
    }
    let Some((request, answer)) = answer else { return };
    let _ = write!(Text(sink), "{}{}", if ack { ", then " } else { "" }, say::word(&answer));
    if let Some(cell) = say::cell_of(&request) {
        let _ = write!(Text(sink), " {}", say::place(cell, profile));
    }
    let from = if many { " from each of " } else { " from " };
    let _ = write!(Text(sink), "{from}{}", Whom(Some(to)));
    if many {
        sink.text(", in the order of their IDs on CAN");
    }
    if let Some(pattern) = Pattern::of(&request, to, wire) {
        pattern.show(sink);
    }
}

/// A frame of which some bytes are known.
struct Pattern {
    id: Option<(u32, bool)>,
    bytes: [Option<u8>; FRAME_MAX],
    len: usize,
}

impl Pattern {
    /// The frame that answers a request. `None` when no drive can answer so on this wire.
    fn of(request: &Online, to: IdCode, wire: Wire) -> Option<Self> {
        // What differs between two answers is not known beforehand.
        let many = to.group || to.id == 0;
        let back = request.reply_to()?;
        let senders = if many { (1, 30) } else { (to.id, to.id) };
        let one = frame(&answer(request, to, senders.0, 0)?, back, wire)?;
        let other = frame(&answer(request, to, senders.1, u32::MAX)?, back, wire)?;
        let mut bytes = [None; FRAME_MAX];
        for (place, (a, b)) in bytes.iter_mut().zip(one.bytes.iter().zip(other.bytes)) {
            *place = (*a == b).then_some(*a);
        }
        Some(Self { id: one.id.filter(|_| one.id == other.id), bytes, len: one.len })
    }

    fn show(&self, sink: &mut dyn Sink) {
        if let Some((id, extended)) = self.id {
            let value = Value::Hex(id.into(), if extended { 8 } else { 3 });
            sink.field(Field { name: "id", start: 0, end: 0, value, meaning: "" });
        }
        let text = Short::of(self);
        let value = Value::Text(text.as_str());
        let meaning = "?? is not known beforehand";
        sink.field(Field { name: "frame", start: 0, end: 0, value, meaning });
        let _ = write!(Text(sink), ": {self}");
    }
}

impl fmt::Display for Pattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.id {
            Some((id, true)) => write!(f, "{id:08X}#")?,
            Some((id, false)) => write!(f, "{id:03X}#")?,
            None => {}
        }
        for (at, byte) in self.bytes[..self.len].iter().enumerate() {
            f.write_str(if at > 0 && self.id.is_none() { " " } else { "" })?;
            match byte {
                Some(byte) => write!(f, "{byte:02X}")?,
                None => f.write_str("??")?,
            }
        }
        Ok(())
    }
}

struct Packed {
    id: Option<(u32, bool)>,
    bytes: [u8; FRAME_MAX],
    len: usize,
}

impl From<Frame> for Packed {
    fn from(frame: Frame) -> Self {
        let mut bytes = [0; FRAME_MAX];
        bytes[..8].copy_from_slice(&frame.data);
        Self { id: Some((frame.id, frame.extended)), bytes, len: frame.bytes().len() }
    }
}

fn frame(answer: &Online, to: IdCode, wire: Wire) -> Option<Packed> {
    let message = Message { to, instruction: answer.emit() };
    match wire {
        Wire::Rs232 | Wire::Rs485 => {
            let mut bytes = [0; FRAME_MAX];
            let len = serial::encode(&message, &mut bytes);
            Some(Packed { id: None, bytes, len })
        }
        Wire::TmlCan => Some(tmlcan::encode(&message).into()),
        Wire::TechnoCan => technocan::encode(&message).ok().map(Packed::from),
    }
}

/// The answer of axis `from` to a request sent to `to`, every bit of its value as in `value`.
fn answer(request: &Online, to: IdCode, from: u8, value: u32) -> Option<Online> {
    let from = if to.group || to.id == 0 { from } else { to.id };
    let sender = IdCode::axis(from);
    let version = value.to_be_bytes();
    Some(match *request {
        Online::GiveMeData { cell, .. } => Online::TakeData { sender, cell, value },
        Online::GiveMeData2 { cell, .. } => {
            let (address, long) = (cell.address, cell.long);
            Online::TakeData2 { sender: from, address, long, value }
        }
        Online::GetData { address, long, .. } => Online::GotData { sender, address, long, value },
        Online::GetVersion { .. } => Online::TakeVersion { version },
        Online::Ping { .. } => Online::Pong { sender: from, version },
        Online::GetChecksum { memory, .. } => Online::TakeChecksum { memory, sum: value as u16 },
        _ => return None,
    })
}
