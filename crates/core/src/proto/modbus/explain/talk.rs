//! Frames in their conversation: who speaks, what is owed, which values are told.

use super::{ModbusDissector, gathered};
use crate::explain::{Awaits, Direction, Label, Raw, Reading, Sink, Talk, Turn, What};
use crate::profile::{Parameter, Profile};
use crate::proto::modbus::encoding::{decode, registers};
use crate::proto::modbus::wire::{
    BROADCAST, EXCEPTION_BIT, Exception, Format, ReplyPdu, RequestPdu, Space, word,
};
use crate::proto::modbus::{ascii, rtu};

impl ModbusDissector {
    /// Station and PDU of a frame whose check agrees.
    fn opened<'a>(
        self,
        bytes: &'a [u8],
        store: &'a mut [u8; rtu::ADU_MAX],
    ) -> Option<(u8, &'a [u8])> {
        let (unit, pdu) = match self.0 {
            Format::Rtu => rtu::open(bytes).ok()?,
            Format::Ascii => ascii::open(gathered(bytes, store).ok()?).ok()?,
        };
        (!pdu.is_empty()).then_some((unit, pdu))
    }

    pub(super) fn taken(self, frame: &Raw<'_>, talk: &Talk<'_>) -> Turn {
        let mut store = [0; rtu::ADU_MAX];
        let Some((unit, pdu)) = self.opened(frame.bytes, &mut store) else { return Turn::Aside };
        let asks = match talk.direction {
            Some(direction) => direction == Direction::ToDrive,
            // A write's reply repeats it: which comes second is the reply.
            None => {
                let answers = talk.open.is_some_and(|open| self.replies(frame, &open));
                !answers && RequestPdu::parse(pdu).is_ok()
            }
        };
        match asks {
            true if unit == BROADCAST => Turn::Asks(Awaits::NOTHING),
            true => Turn::Asks(Awaits::ANSWER),
            false => Turn::Answers,
        }
    }

    /// A reply has its request's station and function, and as much data as was asked for or the
    /// address that was written.
    pub(super) fn replies(self, frame: &Raw<'_>, request: &Raw<'_>) -> bool {
        let (mut one, mut other) = ([0; rtu::ADU_MAX], [0; rtu::ADU_MAX]);
        let (Some((from, reply)), Some((to, asked))) =
            (self.opened(frame.bytes, &mut one), self.opened(request.bytes, &mut other))
        else {
            return false;
        };
        if from != to || reply[0] & !EXCEPTION_BIT != asked[0] {
            return false;
        }
        match (ReplyPdu::parse(reply), RequestPdu::parse(asked)) {
            (Ok(ReplyPdu::Exception { .. }), _) => true,
            (Ok(ReplyPdu::Read { data, .. }), Ok(RequestPdu::Read { space, count, .. })) => {
                data.len() == space.reply_bytes(count)
            }
            (
                Ok(ReplyPdu::WroteCoil { .. } | ReplyPdu::WroteRegister { .. }),
                Ok(RequestPdu::WriteCoil { .. } | RequestPdu::WriteRegister { .. }),
            )
            | (Ok(ReplyPdu::Wrote { .. }), Ok(_)) => reply.get(1..3) == asked.get(1..3),
            (Ok(ReplyPdu::Unknown { .. }), Ok(RequestPdu::Unknown { .. })) => true,
            _ => false,
        }
    }

    /// An exception that acknowledges refuses nothing.
    pub(super) fn refused(self, answer: &Raw<'_>) -> Option<&'static str> {
        let mut store = [0; rtu::ADU_MAX];
        let (_, pdu) = self.opened(answer.bytes, &mut store)?;
        match ReplyPdu::parse(pdu) {
            Ok(ReplyPdu::Exception { exception, .. }) if exception != Exception::Acknowledge => {
                Some(exception.text())
            }
            _ => None,
        }
    }
}

/// What is written.
pub(super) fn told(
    request: &RequestPdu<'_>,
    profile: Option<&'static Profile>,
    sink: &mut dyn Sink,
) {
    let values = Values { profile, written: true };
    match *request {
        RequestPdu::WriteRegister { address, value } => {
            values.words(Space::Holding, address, &value.to_be_bytes(), sink);
        }
        RequestPdu::WriteRegisters { start, words } => {
            values.words(Space::Holding, start, words, sink);
        }
        RequestPdu::WriteCoil { address, on } => {
            values.bits(Space::Coil, address, 1, &[u8::from(on)], sink);
        }
        RequestPdu::WriteCoils { start, count, bits } => {
            values.bits(Space::Coil, start, count, bits, sink);
        }
        _ => {}
    }
}

/// What was read from `start` on.
pub(super) fn found(
    (space, start, count): (Space, u16, u16),
    data: &[u8],
    profile: Option<&'static Profile>,
    sink: &mut dyn Sink,
) {
    let values = Values { profile, written: false };
    match space.is_bits() {
        true => values.bits(space, start, count, data, sink),
        false => values.words(space, start, data, sink),
    }
}

/// Tells values by the parameters that they are of.
struct Values {
    profile: Option<&'static Profile>,
    written: bool,
}

impl Values {
    fn parameter(&self, space: Space, address: u16) -> Option<&'static Parameter> {
        let is_it = |p: &&Parameter| p.space == space.number() && p.index == address;
        self.profile?.parameters.iter().find(is_it)
    }

    fn words(&self, space: Space, start: u16, data: &[u8], sink: &mut dyn Sink) {
        let (count, mut at) = (data.len() / 2, 0);
        while at < count {
            let address = start.wrapping_add(at as u16);
            let parameter = self.parameter(space, address);
            let wide = parameter.map_or(1, |p| usize::from(registers(p.encoding)));
            let first = word(data, 2 * at);
            let second = if wide == 2 && at + 1 < count { word(data, 2 * at + 2) } else { 0 };
            match parameter.filter(|_| at + wide <= count) {
                Some(parameter) => {
                    let raw = decode(parameter.encoding, [first, second]);
                    self.tell(What::Parameter(parameter), raw, sink);
                    at += wide;
                }
                None => {
                    let label = self.label(space, address);
                    self.tell(What::Named(label.as_str()), first.into(), sink);
                    at += 1;
                }
            }
        }
    }

    fn bits(&self, space: Space, start: u16, count: u16, data: &[u8], sink: &mut dyn Sink) {
        for at in 0..count {
            let Some(byte) = data.get(usize::from(at / 8)) else { return };
            let (address, raw) = (start.wrapping_add(at), i64::from(byte >> (at % 8) & 1));
            match self.parameter(space, address) {
                Some(parameter) => self.tell(What::Parameter(parameter), raw, sink),
                None => {
                    let label = self.label(space, address);
                    self.tell(What::Named(label.as_str()), raw, sink);
                }
            }
        }
    }

    fn label(&self, space: Space, address: u16) -> Label {
        let word = match space {
            Space::Holding => "register",
            Space::Input => "input register",
            Space::Coil => "coil",
            Space::Discrete => "discrete input",
        };
        Label::of(format_args!("{word} 0x{address:04X}"))
    }

    fn tell(&self, what: What<'_>, raw: i64, sink: &mut dyn Sink) {
        sink.reading(Reading { what, raw, written: self.written, part: 0 });
    }
}
