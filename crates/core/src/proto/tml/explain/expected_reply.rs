//! The expected reply to a message: an acknowledgement, or an answer with its known parts.

use core::fmt::{self, Write as _};

use super::layout::ParsedFrame;
use super::message::{self, BoundedText, Recipient, SinkWriter};
use crate::explain::{ExplainSink, Field, FieldValue};
use crate::medium::Frame;
use crate::profile::Profile;
use crate::proto::tml::online::OnlineMessage;
use crate::proto::tml::rules::TmlWire;
use crate::proto::tml::serial::{self, ACK, FRAME_MAX};
use crate::proto::tml::wire::{IdCode, Message};
use crate::proto::tml::{technocan, tmlcan};

/// Bytes that come back, ack included; `None` where nothing does, or from several axes.
pub(super) fn reply_len(message: &Message, wire: TmlWire) -> Option<usize> {
    let ack = usize::from(wire.acknowledges(message.to));
    let many = message.to.group || message.to.id == 0;
    match OnlineMessage::parse(&message.instruction).filter(OnlineMessage::is_request) {
        Some(_) if many => None,
        Some(request) => Some(ack + ReplyPattern::of(&request, message.to, wire)?.len),
        None => (ack > 0).then_some(ack),
    }
}

/// Explains a reply.
pub(super) fn explain_reply(
    parsed: &ParsedFrame,
    wire: TmlWire,
    profile: Option<&'static Profile>,
    sink: &mut dyn ExplainSink,
) {
    let Some(to) = parsed.to else { return };
    let ack = wire.acknowledges(to);
    let request = OnlineMessage::parse(&parsed.instruction).filter(OnlineMessage::is_request);
    let answer = request.and_then(|request| Some((request, answer_with(&request, to, 1, 0)?)));
    match &answer {
        Some((_, answer)) => sink.kind(message::message_name(answer)),
        None if ack => sink.kind("ack"),
        None => return,
    }
    let many = to.group || to.id == 0;
    if !many {
        sink.axis(to.id.into());
    }
    if ack {
        let (value, meaning) =
            (FieldValue::Hex(ACK.into(), 2), "the connected drive has understood");
        sink.field(Field { name: "ack", start: 0, end: 0, value, meaning });
        sink.text("4F");
    }
    let Some((request, answer)) = answer else { return };
    let _ = write!(
        SinkWriter(sink),
        "{}{}",
        if ack { ", then " } else { "" },
        message::message_name(&answer)
    );
    if let Some(cell) = message::requested_cell(&request) {
        let _ = write!(SinkWriter(sink), " {}", message::cell_name(cell, profile));
    }
    let from = if many { " from each of " } else { " from " };
    let _ = write!(SinkWriter(sink), "{from}{}", Recipient(Some(to)));
    if many {
        sink.text(", in the order of their IDs on CAN");
    }
    if let Some(pattern) = ReplyPattern::of(&request, to, wire) {
        pattern.emit(sink);
    }
}

/// A frame of which some bytes are known.
struct ReplyPattern {
    id: Option<(u32, bool)>,
    bytes: [Option<u8>; FRAME_MAX],
    len: usize,
}

impl ReplyPattern {
    /// The frame that answers a request. `None` when no drive can answer so on this wire.
    fn of(request: &OnlineMessage, to: IdCode, wire: TmlWire) -> Option<Self> {
        // The bytes that differ between two answers are not known beforehand.
        let many = to.group || to.id == 0;
        let back = request.reply_to()?;
        let senders = if many { (1, 30) } else { (to.id, to.id) };
        let one = encode_answer(&answer_with(request, to, senders.0, 0)?, back, wire)?;
        let other = encode_answer(&answer_with(request, to, senders.1, u32::MAX)?, back, wire)?;
        let mut bytes = [None; FRAME_MAX];
        for (index, (a, b)) in bytes.iter_mut().zip(one.bytes.iter().zip(other.bytes)) {
            *index = (*a == b).then_some(*a);
        }
        Some(Self { id: one.id.filter(|_| one.id == other.id), bytes, len: one.len })
    }

    fn emit(&self, sink: &mut dyn ExplainSink) {
        if let Some((id, extended)) = self.id {
            let value = FieldValue::Hex(id.into(), if extended { 8 } else { 3 });
            sink.field(Field { name: "id", start: 0, end: 0, value, meaning: "" });
        }
        let text = BoundedText::of(self);
        let value = FieldValue::Text(text.as_str());
        let meaning = "?? is not known beforehand";
        sink.field(Field { name: "frame", start: 0, end: 0, value, meaning });
        let _ = write!(SinkWriter(sink), ": {self}");
    }
}

impl fmt::Display for ReplyPattern {
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

struct PackedFrame {
    id: Option<(u32, bool)>,
    bytes: [u8; FRAME_MAX],
    len: usize,
}

impl From<Frame> for PackedFrame {
    fn from(frame: Frame) -> Self {
        let mut bytes = [0; FRAME_MAX];
        bytes[..8].copy_from_slice(&frame.data);
        Self { id: Some((frame.id, frame.extended)), bytes, len: frame.bytes().len() }
    }
}

fn encode_answer(answer: &OnlineMessage, to: IdCode, wire: TmlWire) -> Option<PackedFrame> {
    let message = Message { to, instruction: answer.emit() };
    match wire {
        TmlWire::Rs232 | TmlWire::Rs485 => {
            let mut bytes = [0; FRAME_MAX];
            let len = serial::encode(&message, &mut bytes);
            Some(PackedFrame { id: None, bytes, len })
        }
        TmlWire::TmlCan => Some(tmlcan::encode(&message).into()),
        TmlWire::TechnoCan => technocan::encode(&message).ok().map(PackedFrame::from),
    }
}

/// The answer of axis `from` to a request sent to `to`, every bit of its value as in `value`.
fn answer_with(request: &OnlineMessage, to: IdCode, from: u8, value: u32) -> Option<OnlineMessage> {
    let from = if to.group || to.id == 0 { from } else { to.id };
    let sender = IdCode::axis(from);
    let version = value.to_be_bytes();
    Some(match *request {
        OnlineMessage::GiveMeData { cell, .. } => OnlineMessage::TakeData { sender, cell, value },
        OnlineMessage::GiveMeData2 { cell, .. } => {
            let (address, long) = (cell.address, cell.long);
            OnlineMessage::TakeData2 { sender: from, address, long, value }
        }
        OnlineMessage::GetData { address, long, .. } => {
            OnlineMessage::GotData { sender, address, long, value }
        }
        OnlineMessage::GetVersion { .. } => OnlineMessage::TakeVersion { version },
        OnlineMessage::Ping { .. } => OnlineMessage::Pong { sender: from, version },
        OnlineMessage::GetChecksum { memory, .. } => {
            OnlineMessage::TakeChecksum { memory, sum: value as u16 }
        }
        _ => return None,
    })
}
