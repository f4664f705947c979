//! Frames in their conversation: sender, expected reply, values.

use super::framing::collect_ascii;
use super::number_text::write_scaled;
use super::{ModbusDissector, NAMED_MAX, is_reply};
use crate::convert::tail;
use crate::explain::{
    Context, ConversationContext, Direction, Effect, ExplainSink, FrameRole, FrameValue,
    NumberPlace, RawFrame, ReplyExpectation, ShortText, ValueSource,
};
use crate::profile::{Encoding, Parameter, Profile};
use crate::proto::modbus::encoding::{decode, number_place, register_count, words_from};
use crate::proto::modbus::wire::{
    BROADCAST, EXCEPTION_BIT, Exception, ReplyPdu, RequestPdu, Space, WireFormat, word,
};
use crate::proto::modbus::{ascii, device_id, rtu, tcp};

impl ModbusDissector {
    /// Station and PDU of a frame with a valid check sum.
    fn decode_frame<'a>(
        self,
        bytes: &'a [u8],
        store: &'a mut [u8; rtu::ADU_MAX],
    ) -> Option<(u8, &'a [u8])> {
        let (unit, pdu) = match self.0 {
            WireFormat::Rtu => rtu::decode(bytes).ok()?,
            WireFormat::Ascii => ascii::decode(collect_ascii(bytes, store).ok()?).ok()?,
            WireFormat::Tcp => tcp::decode(bytes).map(|(header, pdu)| (header.unit, pdu)).ok()?,
        };
        (!pdu.is_empty()).then_some((unit, pdu))
    }

    pub(super) fn frame_role(
        self,
        frame: &RawFrame<'_>,
        talk: &ConversationContext<'_>,
    ) -> FrameRole {
        let mut store;
        let decoded = match self.0 {
            WireFormat::Rtu => rtu::decode(frame.bytes).ok(),
            WireFormat::Ascii | WireFormat::Tcp => {
                store = [0; rtu::ADU_MAX];
                self.decode_frame(frame.bytes, &mut store)
            }
        };
        let Some((unit, pdu)) = decoded else { return FrameRole::Unrelated };
        let asks = match talk.direction {
            Some(direction) => direction == Direction::ToDrive,
            // A write's reply repeats it: which comes second is the reply.
            None => {
                let answers =
                    talk.open_request.is_some_and(|open| self.answers_request(frame, &open));
                !answers && RequestPdu::parse(pdu).is_ok()
            }
        };
        if !asks {
            FrameRole::Answer
        } else if unit == BROADCAST {
            FrameRole::Request(ReplyExpectation::NONE)
        } else {
            FrameRole::Request(ReplyExpectation::ONE_ANSWER)
        }
    }

    /// A write may reach any of its registers or coils.
    pub(super) fn frame_effect(
        self,
        frame: &RawFrame<'_>,
        profile: Option<&'static Profile>,
    ) -> Effect {
        let mut store = [0; rtu::ADU_MAX];
        let Some((_, pdu)) = self.decode_frame(frame.bytes, &mut store) else {
            return Effect::UNKNOWN;
        };
        let (space, start, count) = match RequestPdu::parse(pdu) {
            Ok(
                RequestPdu::Read { .. }
                | RequestPdu::Unknown {
                    function: device_id::FUNCTION,
                    data: [device_id::MEI_TYPE, ..],
                },
            ) => return Effect::NOTHING,
            Ok(RequestPdu::WriteRegister { address, .. }) => (Space::Holding, address, 1),
            Ok(
                RequestPdu::WriteRegisters { start, words }
                | RequestPdu::ReadWriteRegisters { start, words, .. },
            ) => (Space::Holding, start, words.len() as u16 / 2),
            Ok(RequestPdu::WriteCoil { address, .. }) => (Space::Coil, address, 1),
            Ok(RequestPdu::WriteCoils { start, count, .. }) => (Space::Coil, start, count),
            Ok(RequestPdu::Unknown { .. }) | Err(_) => return Effect::UNKNOWN,
        };
        write_effect(profile, space, start, count)
    }

    /// A reply has its request's station and function, and as much data as was asked for or the
    /// address that was written. On TCP it repeats the transaction too.
    pub(super) fn answers_request(self, frame: &RawFrame<'_>, request: &RawFrame<'_>) -> bool {
        if self.0 == WireFormat::Rtu {
            if !is_alike(frame.bytes, request.bytes) {
                return false;
            }
            // What is taken for a request was whole.
            return match (rtu::decode(frame.bytes), rtu::verified_parts(request.bytes)) {
                (Ok((_, reply)), Some((_, request_pdu))) => is_reply_to(reply, request_pdu),
                _ => false,
            };
        }
        let (mut one, mut other) = ([0; rtu::ADU_MAX], [0; rtu::ADU_MAX]);
        let (Some((from, reply)), Some((to, request_pdu))) = (
            self.decode_frame(frame.bytes, &mut one),
            self.decode_frame(request.bytes, &mut other),
        ) else {
            return false;
        };
        let same_transaction = self.0 != WireFormat::Tcp || frame.bytes[..2] == request.bytes[..2];
        from == to && same_transaction && is_reply_to(reply, request_pdu)
    }

    /// An exception that acknowledges refuses nothing. An answer of RTU has a valid check sum.
    pub(super) fn exception_text(self, answer: &RawFrame<'_>) -> Option<&'static str> {
        let mut store;
        let (_, pdu) = match self.0 {
            WireFormat::Rtu => rtu::verified_parts(answer.bytes)?,
            WireFormat::Ascii | WireFormat::Tcp => {
                store = [0; rtu::ADU_MAX];
                self.decode_frame(answer.bytes, &mut store)?
            }
        };
        match ReplyPdu::parse(pdu) {
            Ok(ReplyPdu::Exception { exception, .. }) if exception != Exception::Acknowledge => {
                Some(exception.text())
            }
            _ => None,
        }
    }
}

/// Returns whether two frames of RTU have the same station and function: most others need no check sum.
fn is_alike(reply: &[u8], request: &[u8]) -> bool {
    match (reply, request) {
        ([from, answered, ..], [to, asked, ..]) => {
            from == to && answered & !EXCEPTION_BIT == *asked
        }
        _ => false,
    }
}

/// Returns whether a reply of the station has the function of the request, and as much data as was asked for or the
/// address that was written.
fn is_reply_to(reply: &[u8], request: &[u8]) -> bool {
    if reply[0] & !EXCEPTION_BIT != request[0] {
        return false;
    }
    match (ReplyPdu::parse(reply), RequestPdu::parse(request)) {
        (Ok(ReplyPdu::Exception { .. }), _) => true,
        (Ok(ReplyPdu::Read { data, .. }), Ok(RequestPdu::Read { space, count, .. })) => {
            data.len() == space.reply_bytes(count)
        }
        (
            Ok(ReplyPdu::ReadWritten { data }),
            Ok(RequestPdu::ReadWriteRegisters { read_count, .. }),
        ) => data.len() == 2 * usize::from(read_count),
        (
            Ok(ReplyPdu::WroteCoil { .. } | ReplyPdu::WroteRegister { .. }),
            Ok(RequestPdu::WriteCoil { .. } | RequestPdu::WriteRegister { .. }),
        )
        | (Ok(ReplyPdu::Wrote { .. }), Ok(_)) => reply.get(1..3) == request.get(1..3),
        (Ok(ReplyPdu::Unknown { .. }), Ok(RequestPdu::Unknown { .. })) => true,
        _ => false,
    }
}

/// The parameter that a register or coil is of, be it the second one of two.
pub(in crate::proto::modbus) fn write_effect(
    profile: Option<&'static Profile>,
    space: Space,
    start: u16,
    count: u16,
) -> Effect {
    (0..count)
        .map(|at| address_effect(start.wrapping_add(at), profile, &space))
        .fold(Effect::NOTHING, Effect::combine)
}

fn address_effect(address: u16, profile: Option<&'static Profile>, space: &Space) -> Effect {
    Effect::from_write(parameter_covering(profile, *space, address))
}

fn parameter_covering(
    profile: Option<&'static Profile>,
    space: Space,
    address: u16,
) -> Option<&'static Parameter> {
    profile?.parameters.iter().find(|p| {
        let width = if space.is_bits() { 1 } else { register_count(p.encoding) };
        p.space == space.number() && (p.index..p.index.saturating_add(width)).contains(&address)
    })
}

/// Reports the values of a PDU. Without a stated drive, the line of text has the registers' numbers, and the names
/// of a usual drive are added behind it. `origin` is the byte of the frame at which the registers of a reply begin,
/// where they are bytes.
pub(super) fn report_values(
    pdu: &[u8],
    origin: Option<usize>,
    context: &Context<'_>,
    request_bytes: Option<&[u8]>,
    sink: &mut dyn ExplainSink,
) {
    let reply = is_reply(pdu, context.direction, request_bytes);
    let doubted = context.profile.filter(|_| context.profile_assumed);
    let mut values = ValueReporter {
        profile: context.profile,
        written: !reply,
        assumed_profile: doubted,
        names_shown: 0,
        next_parameter: 0,
        origin: origin.filter(|_| reply),
        sink,
    };
    if reply {
        let request_pdu = request_bytes.and_then(|pdu| RequestPdu::parse(pdu).ok());
        match (ReplyPdu::parse(pdu), request_pdu) {
            (Ok(ReplyPdu::Read { data, .. }), Some(RequestPdu::Read { space, start, count }))
                if pdu[0] == space.read_function().code()
                    && data.len() == space.reply_bytes(count) =>
            {
                values.report_read(space, start, count, data);
            }
            (
                Ok(ReplyPdu::ReadWritten { data }),
                Some(RequestPdu::ReadWriteRegisters { read_start, read_count, .. }),
            ) if data.len() == 2 * usize::from(read_count) => {
                values.report_read(Space::Holding, read_start, read_count, data);
            }
            _ => {}
        }
    } else if let Ok(request) = RequestPdu::parse(pdu) {
        values.report_request(&request);
    }
    values.close_remark();
}

fn is_of(parameter: &Parameter, space: Space, address: u16) -> bool {
    parameter.space == space.number() && parameter.index == address
}

/// Finds the parameter of a register or coil. The tables of most drives are in the order of their registers, but for
/// pieces: a bisection finds nearly all, and the others are looked for one by one.
pub(super) fn find_position(parameters: &[Parameter], space: Space, address: u16) -> Option<usize> {
    let key = (space.number(), address);
    let at = parameters.partition_point(|p| (p.space, p.index) < key);
    if parameters.get(at).is_some_and(|p| is_of(p, space, address)) {
        return Some(at);
    }
    parameters.iter().position(|p| is_of(p, space, address))
}

/// Reports values by their parameters.
struct ValueReporter<'a> {
    profile: Option<&'static Profile>,
    written: bool,
    /// Profile whose names have to be marked as assumed.
    assumed_profile: Option<&'static Profile>,
    /// Names in the line of text.
    names_shown: usize,
    /// Behind the parameter that was found last.
    next_parameter: usize,
    /// Byte of the frame at which the registers begin, where they are bytes of it.
    origin: Option<usize>,
    sink: &'a mut dyn ExplainSink,
}

impl ValueReporter<'_> {
    /// Reports written values, and the names of requested registers.
    fn report_request(&mut self, request: &RequestPdu<'_>) {
        match *request {
            RequestPdu::Read { space, start, count } if self.assumed_profile.is_some() => {
                for address in (0..count).map(|at| start.wrapping_add(at)) {
                    self.find_parameter(space, address)
                        .into_iter()
                        .for_each(|p| self.write_name(p, None, None));
                }
            }
            RequestPdu::WriteRegister { address, value } => {
                self.report_words(Space::Holding, address, &value.to_be_bytes());
            }
            RequestPdu::WriteRegisters { start, words }
            | RequestPdu::ReadWriteRegisters { start, words, .. } => {
                self.report_words(Space::Holding, start, words)
            }
            RequestPdu::WriteCoil { address, on } => {
                self.report_bits(Space::Coil, address, 1, &[u8::from(on)]);
            }
            RequestPdu::WriteCoils { start, count, bits } => {
                self.report_bits(Space::Coil, start, count, bits);
            }
            RequestPdu::Read { .. } | RequestPdu::Unknown { .. } => {}
        }
    }

    /// Reports the values of a read from `start` on.
    fn report_read(&mut self, space: Space, start: u16, count: u16, data: &[u8]) {
        if space.is_bits() {
            self.report_bits(space, start, count, data)
        } else {
            self.report_words(space, start, data)
        }
    }

    /// Writes a name of an assumed drive after the line.
    fn write_name(
        &mut self,
        parameter: &'static Parameter,
        raw: Option<i64>,
        place: Option<NumberPlace>,
    ) {
        let Some(profile) = self.assumed_profile.filter(|_| self.names_shown < NAMED_MAX) else {
            return;
        };
        self.sink.text(if self.names_shown == 0 { " (" } else { ", " });
        if self.names_shown == 0 {
            self.sink.text(profile.name);
            self.sink.text("? ");
        }
        self.names_shown += 1;
        self.sink.text(parameter.symbol);
        self.sink.text(" ");
        self.sink.text(parameter.name);
        if let Some(raw) = raw {
            self.sink.text(" = ");
            write_scaled(parameter, raw, place, self.sink);
        }
    }

    fn close_remark(&mut self) {
        if self.names_shown > 0 {
            self.sink.text(")");
        }
    }

    /// Finds a parameter. Neighbouring registers are usually neighbours in the table.
    fn find_parameter(&mut self, space: Space, address: u16) -> Option<&'static Parameter> {
        let parameters = self.profile?.parameters;
        let near = tail(parameters, self.next_parameter).first();
        let at = match near.filter(|p| is_of(p, space, address)) {
            Some(_) => self.next_parameter,
            None => find_position(parameters, space, address)?,
        };
        self.next_parameter = at + 1;
        parameters.get(at)
    }

    fn report_words(&mut self, space: Space, start: u16, data: &[u8]) {
        let (count, mut at) = (data.len() / 2, 0);
        while at < count {
            let address = start.wrapping_add(at as u16);
            let parameter = self.find_parameter(space, address);
            let wide = parameter.map_or(1, |p| usize::from(register_count(p.encoding)));
            let first = word(data, 2 * at);
            match parameter.filter(|_| at + wide <= count) {
                Some(parameter) => {
                    let raw = decode(parameter.encoding, words_from(data, at));
                    let place = self.place_of(parameter.encoding, at, parameter.values);
                    self.report_parameter(parameter, raw, place);
                    at += wide;
                }
                None => {
                    let label = self.value_label(space, address);
                    let place = self.place_of(Encoding::U16, at, &[]);
                    self.emit_frame_value(ValueSource::Named(label.as_str()), first.into(), place);
                    at += 1;
                }
            }
        }
    }

    fn report_bits(&mut self, space: Space, start: u16, count: u16, data: &[u8]) {
        for at in 0..count {
            let Some(byte) = data.get(usize::from(at / 8)) else { return };
            let (address, raw) = (start.wrapping_add(at), i64::from(byte >> (at % 8) & 1));
            match self.find_parameter(space, address) {
                Some(parameter) => self.report_parameter(parameter, raw, None),
                None => {
                    let label = self.value_label(space, address);
                    self.emit_frame_value(ValueSource::Named(label.as_str()), raw, None);
                }
            }
        }
    }

    fn value_label(&self, space: Space, address: u16) -> ShortText {
        let word = match space {
            Space::Holding => "register",
            Space::Input => "input register",
            Space::Coil => "coil",
            Space::Discrete => "discrete input",
        };
        ShortText::from_display(format_args!("{word} 0x{address:04X}"))
    }

    /// The place of the value whose first register is the `at`-th.
    fn place_of(
        &self,
        encoding: Encoding,
        at: usize,
        named: &'static [(i64, &'static str)],
    ) -> Option<NumberPlace> {
        number_place(encoding, self.origin? + 2 * at, named)
    }

    fn report_parameter(
        &mut self,
        parameter: &'static Parameter,
        raw: i64,
        place: Option<NumberPlace>,
    ) {
        self.emit_frame_value(ValueSource::Parameter(parameter), raw, place);
        self.write_name(parameter, Some(raw), place);
    }

    fn emit_frame_value(&mut self, source: ValueSource<'_>, raw: i64, place: Option<NumberPlace>) {
        let reading = FrameValue { source, raw, written: self.written, motor: 0 };
        match place {
            Some(place) => self.sink.number_value(reading, place),
            None => self.sink.frame_value(reading),
        }
    }
}
