//! Frames in their conversation: who speaks, what is owed, which values are told.

use super::say::scaled;
use super::{ModbusDissector, NAMED_MAX, gathered, is_reply};
use crate::explain::{
    Awaits, Context, Direction, Effect, Label, Raw, Reading, Sink, Talk, Turn, What,
};
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

    /// A write may reach any of its registers or coils.
    pub(super) fn does(self, frame: &Raw<'_>, profile: Option<&'static Profile>) -> Effect {
        let mut store = [0; rtu::ADU_MAX];
        let Some((_, pdu)) = self.opened(frame.bytes, &mut store) else { return Effect::UNKNOWN };
        let (space, start, count) = match RequestPdu::parse(pdu) {
            Ok(RequestPdu::Read { .. }) => return Effect::NOTHING,
            Ok(RequestPdu::WriteRegister { address, .. }) => (Space::Holding, address, 1),
            Ok(RequestPdu::WriteRegisters { start, words }) => {
                (Space::Holding, start, words.len() as u16 / 2)
            }
            Ok(RequestPdu::WriteCoil { address, .. }) => (Space::Coil, address, 1),
            Ok(RequestPdu::WriteCoils { start, count, .. }) => (Space::Coil, start, count),
            Ok(RequestPdu::Unknown { .. }) | Err(_) => return Effect::UNKNOWN,
        };
        let of = |address| Effect::of_writing(covering(profile, space, address));
        (0..count).map(|at| of(start.wrapping_add(at))).fold(Effect::NOTHING, Effect::and)
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

/// The parameter that a register or coil is of, be it the second one of two.
fn covering(
    profile: Option<&'static Profile>,
    space: Space,
    address: u16,
) -> Option<&'static Parameter> {
    profile?.parameters.iter().find(|p| {
        let width = if space.is_bits() { 1 } else { registers(p.encoding) };
        p.space == space.number() && (p.index..p.index.saturating_add(width)).contains(&address)
    })
}

/// The values that a PDU carries. Where nobody stated the drive, the line of text has the registers'
/// numbers, and here the names of a usual drive are put behind it.
pub(super) fn values(pdu: &[u8], context: &Context<'_>, asked: Option<&[u8]>, sink: &mut dyn Sink) {
    let reply = is_reply(pdu, context.direction, asked);
    let doubted = context.profile.filter(|_| context.assumed);
    let mut values =
        Values { profile: context.profile, written: !reply, doubted, shown: 0, near: 0, sink };
    if reply {
        let asked = asked.and_then(|pdu| RequestPdu::parse(pdu).ok());
        if let (Ok(ReplyPdu::Read { data, .. }), Some(RequestPdu::Read { space, start, count })) =
            (ReplyPdu::parse(pdu), asked)
            && pdu[0] == space.read().code()
            && data.len() == space.reply_bytes(count)
        {
            values.found((space, start, count), data);
        }
    } else if let Ok(request) = RequestPdu::parse(pdu) {
        values.told(&request);
    }
    values.end();
}

/// Tells values by the parameters that they are of.
struct Values<'a> {
    profile: Option<&'static Profile>,
    written: bool,
    /// Whose names have to be marked.
    doubted: Option<&'static Profile>,
    /// Names in the line of text.
    shown: usize,
    /// Behind the parameter that was found last.
    near: usize,
    sink: &'a mut dyn Sink,
}

impl Values<'_> {
    /// What is written, and the names of what is asked for.
    fn told(&mut self, request: &RequestPdu<'_>) {
        match *request {
            RequestPdu::Read { space, start, count } if self.doubted.is_some() => {
                for address in (0..count).map(|at| start.wrapping_add(at)) {
                    self.parameter(space, address).into_iter().for_each(|p| self.show(p, None));
                }
            }
            RequestPdu::WriteRegister { address, value } => {
                self.words(Space::Holding, address, &value.to_be_bytes());
            }
            RequestPdu::WriteRegisters { start, words } => self.words(Space::Holding, start, words),
            RequestPdu::WriteCoil { address, on } => {
                self.bits(Space::Coil, address, 1, &[u8::from(on)]);
            }
            RequestPdu::WriteCoils { start, count, bits } => {
                self.bits(Space::Coil, start, count, bits);
            }
            RequestPdu::Read { .. } | RequestPdu::Unknown { .. } => {}
        }
    }

    /// What was read from `start` on.
    fn found(&mut self, (space, start, count): (Space, u16, u16), data: &[u8]) {
        match space.is_bits() {
            true => self.bits(space, start, count, data),
            false => self.words(space, start, data),
        }
    }

    /// A name of a drive that nobody stated, behind the line.
    fn show(&mut self, parameter: &'static Parameter, raw: Option<i64>) {
        let Some(profile) = self.doubted.filter(|_| self.shown < NAMED_MAX) else { return };
        self.sink.text(if self.shown == 0 { " (" } else { ", " });
        if self.shown == 0 {
            self.sink.text(profile.name);
            self.sink.text("? ");
        }
        self.shown += 1;
        self.sink.text(parameter.symbol);
        self.sink.text(" ");
        self.sink.text(parameter.name);
        if let Some(raw) = raw {
            self.sink.text(" = ");
            scaled(parameter, raw, self.sink);
        }
    }

    fn end(&mut self) {
        if self.shown > 0 {
            self.sink.text(")");
        }
    }

    /// Registers that follow one another stand so in the table, as a rule.
    fn parameter(&mut self, space: Space, address: u16) -> Option<&'static Parameter> {
        let parameters = self.profile?.parameters;
        let is_it = |p: &&Parameter| p.space == space.number() && p.index == address;
        let near = parameters.get(self.near..).unwrap_or_default();
        let at = match near.first().filter(is_it) {
            Some(_) => self.near,
            None => parameters.iter().position(|p| is_it(&p))?,
        };
        self.near = at + 1;
        parameters.get(at)
    }

    fn words(&mut self, space: Space, start: u16, data: &[u8]) {
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
                    self.tell_of(parameter, raw);
                    at += wide;
                }
                None => {
                    let label = self.label(space, address);
                    self.tell(What::Named(label.as_str()), first.into());
                    at += 1;
                }
            }
        }
    }

    fn bits(&mut self, space: Space, start: u16, count: u16, data: &[u8]) {
        for at in 0..count {
            let Some(byte) = data.get(usize::from(at / 8)) else { return };
            let (address, raw) = (start.wrapping_add(at), i64::from(byte >> (at % 8) & 1));
            match self.parameter(space, address) {
                Some(parameter) => self.tell_of(parameter, raw),
                None => {
                    let label = self.label(space, address);
                    self.tell(What::Named(label.as_str()), raw);
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

    fn tell_of(&mut self, parameter: &'static Parameter, raw: i64) {
        self.tell(What::Parameter(parameter), raw);
        self.show(parameter, Some(raw));
    }

    fn tell(&mut self, what: What<'_>, raw: i64) {
        self.sink.reading(Reading { what, raw, written: self.written, part: 0 });
    }
}
