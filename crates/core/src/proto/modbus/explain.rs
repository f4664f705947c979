//! Explains frames, and makes frames from text: the dissectors of both wire formats.
//!
//! A checksum decides the end of a frame in a capture. Without a known direction, a frame is read as a request first,
//! then as a reply.

mod conversation;
mod framing;
mod layout;
mod number_text;

pub(super) use conversation::write_effect;

use super::encoding::{decode, number_place, register_count, words_from};
use super::text;
use super::wire::{
    AnnouncedLength, Exception, Function, PDU_MAX, ReplyPdu, RequestPdu, Space, WireFormat, word,
};
use super::{ascii, device_id, rtu, tcp};
use crate::error::WireError;
use crate::explain::{
    Context, ConversationContext, DeviceFact, Direction, Dissector, DriveFacts, Effect,
    EncodeError, EncodeOptions, EncodedFrame, ExplainSink, FactQuery, Field, FieldValue,
    FrameBoundary, FrameConversation, FrameFormat, FrameRole, RawFrame, TextError,
};
use crate::profile::{Encoding, Parameter, Profile};
use layout::FrameLayout;
use number_text::{write_bits, write_decimal, write_hex, write_more, write_raw, write_scaled};

/// Station that a text is encoded for when none is named: the factory's (TS manual V2 §2.2).
const DEFAULT_UNIT: u8 = 1;
/// Registers of one reply that the line of text names; the fields have them all.
const NAMED_MAX: usize = 4;
/// Limit of active lines of a reply that are listed by number.
const BITS_MAX: usize = 16;

/// Modbus RTU, ASCII or TCP in captures, dashboards and the encoder.
#[derive(Clone, Copy, Debug)]
pub struct ModbusDissector(pub WireFormat);

impl FrameFormat for ModbusDissector {
    fn find_frame(&self, bytes: &[u8], direction: Option<Direction>, ended: bool) -> FrameBoundary {
        match self.0 {
            WireFormat::Rtu => framing::cut_rtu(bytes, direction, ended),
            WireFormat::Ascii => framing::cut_ascii(bytes, ended),
            WireFormat::Tcp => framing::cut_tcp(bytes, direction, ended),
        }
    }

    fn valid_frame_len(&self, bytes: &[u8], direction: Option<Direction>) -> Option<usize> {
        match self.0 {
            WireFormat::Rtu => framing::rtu_frame_len(bytes, direction),
            WireFormat::Ascii => match framing::cut_ascii(bytes, true) {
                FrameBoundary::Frame(len) => Some(len),
                _ => None,
            },
            WireFormat::Tcp => framing::tcp_frame_len(bytes, direction),
        }
    }
}

impl FrameConversation for ModbusDissector {
    fn is_answer_to(&self, frame: &RawFrame<'_>, request: &RawFrame<'_>) -> bool {
        self.answers_request(frame, request)
    }

    fn has_transactions(&self) -> bool {
        self.0 == WireFormat::Tcp
    }

    fn role(&self, frame: &RawFrame<'_>, talk: &ConversationContext<'_>) -> FrameRole {
        self.frame_role(frame, talk)
    }

    fn effect(&self, frame: &RawFrame<'_>, profile: Option<&'static Profile>) -> Effect {
        self.frame_effect(frame, profile)
    }

    fn refusal_reason(&self, answer: &RawFrame<'_>, _: &RawFrame<'_>) -> Option<&'static str> {
        self.exception_text(answer)
    }
}

impl DriveFacts for ModbusDissector {
    fn device_facts(&self) -> &'static [DeviceFact] {
        const fn fact(name: &'static str, request: &'static str) -> DeviceFact {
            DeviceFact { name, query: FactQuery::Characters(request) }
        }
        const FACTS: [DeviceFact; 5] = [
            fact(device_id::object_name(0), "read device id 0"),
            fact(device_id::object_name(1), "read device id 1"),
            fact(device_id::object_name(2), "read device id 2"),
            fact(device_id::object_name(4), "read device id 4"),
            fact(device_id::object_name(5), "read device id 5"),
        ];
        &FACTS
    }
}

impl Dissector for ModbusDissector {
    fn name(&self) -> &'static str {
        match self.0 {
            WireFormat::Rtu => "modbus-rtu",
            WireFormat::Ascii => "modbus-ascii",
            WireFormat::Tcp => "modbus-tcp",
        }
    }

    fn language(&self) -> &'static str {
        "modbus"
    }

    fn explain(&self, bytes: &[u8], context: &Context<'_>, sink: &mut dyn ExplainSink) {
        match self.0 {
            WireFormat::Rtu => {
                let request = context.request.and_then(|request| rtu::decode(request).ok());
                let layout = FrameLayout { format: WireFormat::Rtu, check_len: 2 };
                let error = rtu::decode(bytes).err();
                let error = error.map(|error| missing_bytes(bytes, context).unwrap_or(error));
                explain_frame(layout, bytes, error, request, context, sink);
            }
            WireFormat::Ascii => {
                let (mut store, mut request_bytes) = ([0; rtu::ADU_MAX], [0; rtu::ADU_MAX]);
                let request = context
                    .request
                    .and_then(|request| framing::collect_ascii(request, &mut request_bytes).ok());
                let request = request.and_then(|bytes| ascii::decode(bytes).ok());
                let (adu, error) = match framing::collect_ascii(bytes, &mut store) {
                    Ok(adu) => (adu, ascii::decode(adu).err()),
                    Err(error) => (&[][..], Some(error)),
                };
                let layout = FrameLayout { format: WireFormat::Ascii, check_len: 1 };
                explain_frame(layout, adu, error, request, context, sink);
            }
            WireFormat::Tcp => explain_tcp(bytes, context, sink),
        }
    }

    fn encode(
        &self,
        text: &str,
        addressing: &EncodeOptions,
        out: &mut [u8],
    ) -> Result<EncodedFrame, EncodeError> {
        // In parentheses at the end is a remark, as explaining puts it there.
        let command = text.split(" (").next().unwrap_or(text);
        let parsed = text::parse(command, addressing.profile)?;
        let last = if self.0 == WireFormat::Tcp { 255 } else { 247 };
        let expected = "a station address, 0 to 247";
        let unit = addressing.axis.unwrap_or(u32::from(DEFAULT_UNIT));
        let unit = u8::try_from(unit).ok().filter(|&unit| unit <= last);
        let unit = unit.ok_or(TextError { at: 0, expected })?;
        let mut data = [0; PDU_MAX];
        let request = request_pdu(&parsed, &mut data);
        let mut frame = [0; ascii::FRAME_MAX];
        let len = match self.0 {
            WireFormat::Rtu => rtu::emit(unit, &mut frame, |out| request.emit(out)),
            WireFormat::Ascii => ascii::emit(unit, &mut frame, |out| request.emit(out)),
            WireFormat::Tcp => {
                tcp::emit(tcp::Header { transaction: 1, unit }, &mut frame, |out| request.emit(out))
            }
        };
        let expected = "a text whose frame fits the buffer";
        let space = out.get_mut(..len).ok_or(TextError { at: text.len(), expected })?;
        space.copy_from_slice(&frame[..len]);
        let answer = request.reply_len().filter(|_| unit != 0).map(|pdu| match self.0 {
            WireFormat::Rtu => pdu + 3,
            WireFormat::Ascii => 2 * pdu + 7,
            WireFormat::Tcp => pdu + tcp::HEADER_LEN,
        });
        Ok(EncodedFrame {
            len,
            id: None,
            extended: false,
            remote_len: None,
            answer_len: answer,
            warning: "",
        })
    }

    fn code_meaning(&self, code: u32) -> Option<&'static str> {
        match Exception::of_code(u8::try_from(code).ok()?) {
            Exception::Unknown(_) => None,
            exception => Some(exception.text()),
        }
    }

    fn explains_by_name(&self) -> bool {
        true
    }
}

/// The request PDU that a text means; its data is put into `data`.
fn request_pdu<'a>(parsed: &text::ParsedRequest, data: &'a mut [u8; PDU_MAX]) -> RequestPdu<'a> {
    let (start, count) = (parsed.start, parsed.count);
    if let Some(space) = parsed.function.read_space() {
        return RequestPdu::Read { space, start, count };
    }
    let values = &parsed.words[..usize::from(count).min(parsed.words.len())];
    match parsed.function {
        Function::WriteCoil => RequestPdu::WriteCoil { address: start, on: values[0] != 0 },
        Function::WriteRegister => RequestPdu::WriteRegister { address: start, value: values[0] },
        Function::WriteCoils => {
            for (at, &value) in values.iter().enumerate() {
                data[at / 8] |= (value as u8 & 1) << (at % 8);
            }
            RequestPdu::WriteCoils { start, count, bits: &data[..values.len().div_ceil(8)] }
        }
        Function::Unknown(device_id::FUNCTION) => {
            let len = device_id::request_data(start as u8).len();
            data[..len].copy_from_slice(&device_id::request_data(start as u8));
            RequestPdu::Unknown { function: device_id::FUNCTION, data: &data[..len] }
        }
        _ => {
            for (pair, value) in data.as_chunks_mut::<2>().0.iter_mut().zip(values) {
                *pair = value.to_be_bytes();
            }
            let words = &data[..2 * values.len()];
            match parsed.read {
                None => RequestPdu::WriteRegisters { start, words },
                Some((read_start, read_count)) => {
                    RequestPdu::ReadWriteRegisters { read_start, read_count, start, words }
                }
            }
        }
    }
}

/// The objects of a device identification: `device id: vendor "Acme", revision "V2.11"`. False where
/// the data are none.
fn write_device_id(data: &[u8], sink: &mut dyn ExplainSink) -> bool {
    let Some(objects) = device_id::objects(data) else { return false };
    sink.text("device id: ");
    for (n, (object, text)) in objects.enumerate() {
        if n > 0 {
            sink.text(", ");
        }
        match device_id::object_name(object) {
            "" => {
                sink.text("object ");
                write_decimal(i64::from(object), sink);
            }
            name => sink.text(name),
        }
        sink.text(" \"");
        sink.text(core::str::from_utf8(text).unwrap_or("?"));
        sink.text("\"");
    }
    true
}

/// The error of an RTU frame that announces more bytes than there are: a byte count shows more of a cut-off answer
/// than a check sum of its last bytes.
fn missing_bytes(adu: &[u8], context: &Context<'_>) -> Option<WireError> {
    let announced = |span| match span {
        AnnouncedLength::Bytes(len) => Some(len),
        _ => None,
    };
    let (request, reply) = (announced(rtu::request_span(adu)), announced(rtu::reply_span(adu)));
    let need = match context.direction {
        Some(Direction::ToDrive) => request?,
        Some(Direction::ToHost) => reply?,
        // A reply by its count, where that is one of registers or bits at all; else a request.
        None if adu.get(2).is_some_and(|count| (1..=250).contains(count)) => reply?,
        None => request?,
    };
    (adu.len() < need).then_some(WireError::Short { need: need as u16, found: adu.len() as u16 })
}

/// Explains a frame of TCP: the fields of its header, then those that every format has.
fn explain_tcp(bytes: &[u8], context: &Context<'_>, sink: &mut dyn ExplainSink) {
    let request = context.request.and_then(|request| tcp::decode(request).ok());
    let request = request.map(|(header, pdu)| (header.unit, pdu));
    let error = tcp::decode(bytes).err();
    let layout = FrameLayout { format: WireFormat::Tcp, check_len: 0 };
    let Some((header, body)) = bytes.split_at_checked(tcp::HEADER_LEN - 1) else {
        return explain_frame(layout, &[], error, request, context, sink);
    };
    let mut emit = |name, at: usize, value, meaning| {
        sink.field(Field { name, start: at as u16, end: at as u16 + 2, value, meaning });
    };
    emit("transaction", 0, FieldValue::Int(i64::from(word(header, 0))), "");
    let protocol = word(header, 2);
    let meaning = if protocol == 0 { "modbus" } else { "not modbus" };
    emit("protocol", 2, FieldValue::Int(i64::from(protocol)), meaning);
    emit("length", 4, FieldValue::Int(i64::from(word(header, 4))), "");
    explain_frame(layout, body, error, request, context, sink);
}

/// Explains a frame; `adu` are its bytes with the check sum.
fn explain_frame(
    position: FrameLayout,
    adu: &[u8],
    error: Option<WireError>,
    request: Option<(u8, &[u8])>,
    context: &Context<'_>,
    sink: &mut dyn ExplainSink,
) {
    let mut error = error;
    let (body, check) = adu.split_at(adu.len().saturating_sub(position.check_len));
    if let [unit, pdu @ ..] = body
        && !pdu.is_empty()
    {
        sink.axis(u32::from(*unit));
        let everyone = if *unit == 0 { "broadcast" } else { "" };
        position.emit_field(sink, "address", 0..1, FieldValue::Int(i64::from(*unit)), everyone);
        let teller = PduExplainer {
            layout: position,
            profile: context.profile.filter(|_| !context.profile_assumed),
        };
        let request_bytes = request.filter(|(requested, _)| requested == unit).map(|(_, pdu)| pdu);
        let wrong = teller.explain_pdu(pdu, context.direction, request_bytes, sink);
        if sink.wants_values() {
            conversation::report_values(
                pdu,
                position.number_origin(),
                context,
                request_bytes,
                sink,
            );
        }
        error = error.or(wrong.map(shift_error_offset));
        position.emit_check(body.len(), check, error, sink);
    } else {
        sink.kind("incomplete");
        sink.text("no whole frame");
    }
    if let Some(error) = error {
        sink.error(error);
    }
}

/// An offset in the PDU as one in the bytes of the frame.
fn shift_error_offset(error: WireError) -> WireError {
    match error {
        WireError::Count { at, found } => WireError::Count { at: at + 1, found },
        WireError::Unexpected { at, found } => WireError::Unexpected { at: at + 1, found },
        other => other,
    }
}

/// Returns whether a frame is a reply. Without a direction, a refusal is one, and a frame that fits the last request.
fn is_reply(pdu: &[u8], direction: Option<Direction>, request: Option<&[u8]>) -> bool {
    match direction {
        Some(direction) => direction == Direction::ToHost,
        None => {
            let refused = pdu[0] & 0x80 != 0;
            refused || (can_be_reply(pdu) && (request.is_some() || RequestPdu::parse(pdu).is_err()))
        }
    }
}

fn can_be_reply(pdu: &[u8]) -> bool {
    ReplyPdu::parse(pdu).is_ok()
}

/// Explains a PDU in fields and words.
struct PduExplainer {
    layout: FrameLayout,
    profile: Option<&'static Profile>,
}

impl PduExplainer {
    fn explain_pdu(
        &self,
        pdu: &[u8],
        direction: Option<Direction>,
        request_bytes: Option<&[u8]>,
        sink: &mut dyn ExplainSink,
    ) -> Option<WireError> {
        let function = Function::of_code(pdu[0] & 0x7F);
        let refused = pdu[0] & 0x80 != 0;
        sink.kind(if refused { "exception" } else { function.name() });
        let code = FieldValue::Hex(u64::from(pdu[0]), 2);
        self.layout.emit_field(sink, "function", 1..2, code, function.name());
        let result = if is_reply(pdu, direction, request_bytes) {
            ReplyPdu::parse(pdu).map(|reply| self.explain_reply(&reply, request_bytes, sink))
        } else {
            RequestPdu::parse(pdu).map(|request| self.explain_request(&request, sink))
        };
        result.err()
    }

    fn explain_request(&self, request: &RequestPdu<'_>, sink: &mut dyn ExplainSink) {
        match *request {
            RequestPdu::Read { space, start, count } => {
                self.emit_start_count(start, count, sink);
                sink.text("read ");
                self.write_name(space, start, count, sink);
            }
            RequestPdu::WriteCoil { address, on } => {
                self.emit_coil(address, on, sink);
                sink.text("write ");
                self.write_coil_state(address, on, sink);
            }
            RequestPdu::WriteRegister { address, value } => {
                self.emit_register(address, value, sink);
                sink.text("write ");
                self.write_values(Space::Holding, address, &value.to_be_bytes(), None, sink);
            }
            RequestPdu::WriteCoils { start, count, bits } => {
                self.emit_start_count(start, count, sink);
                self.emit_data(6, bits, Space::Coil, sink);
                sink.text("write ");
                self.write_name(Space::Coil, start, count, sink);
                sink.text(" = ");
                write_bits(bits, count, usize::MAX, sink);
            }
            RequestPdu::WriteRegisters { start, words } => {
                self.emit_start_count(start, (words.len() / 2) as u16, sink);
                self.emit_data(6, words, Space::Holding, sink);
                // One register by the function of many must not read as by that of one.
                sink.text(if words.len() == 2 { "write multiple: " } else { "write " });
                self.write_many(start, words, sink);
            }
            RequestPdu::ReadWriteRegisters { read_start, read_count, start, words } => {
                self.emit_address("read_start", read_start, sink);
                let count = FieldValue::Int(i64::from(read_count));
                self.layout.emit_field(sink, "read_count", 4..6, count, "");
                let written = FieldValue::Hex(u64::from(start), 4);
                self.layout.emit_field(sink, "write_start", 6..8, written, "");
                let count = FieldValue::Int((words.len() / 2) as i64);
                self.layout.emit_field(sink, "write_count", 8..10, count, "");
                self.emit_data(10, words, Space::Holding, sink);
                sink.text("write ");
                self.write_many(start, words, sink);
                sink.text(", read ");
                self.write_name(Space::Holding, read_start, read_count, sink);
            }
            RequestPdu::Unknown { function, data } => self.explain_unknown(function, data, sink),
        }
    }

    /// The values of neighbouring registers, the first ones with their names.
    fn write_many(&self, start: u16, words: &[u8], sink: &mut dyn ExplainSink) {
        let (named, rest) = words.split_at(words.len().min(2 * NAMED_MAX));
        self.write_values(Space::Holding, start, named, None, sink);
        for (at, value) in rest.chunks_exact(2).enumerate() {
            sink.text(if at == 0 { ", then " } else { " " });
            write_decimal(i64::from(word(value, 0)), sink);
        }
    }

    fn explain_reply(
        &self,
        reply: &ReplyPdu<'_>,
        request: Option<&[u8]>,
        sink: &mut dyn ExplainSink,
    ) {
        match *reply {
            ReplyPdu::Read { space, data } => self.explain_read(space, data, request, sink),
            ReplyPdu::ReadWritten { data } => {
                self.explain_read(Space::Holding, data, request, sink)
            }
            ReplyPdu::WroteCoil { address, on } => {
                self.emit_coil(address, on, sink);
                sink.text("written: ");
                self.write_coil_state(address, on, sink);
            }
            ReplyPdu::WroteRegister { address, value } => {
                self.emit_register(address, value, sink);
                sink.text("written: ");
                self.write_values(Space::Holding, address, &value.to_be_bytes(), None, sink);
            }
            ReplyPdu::Wrote { coils, start, count } => {
                self.emit_start_count(start, count, sink);
                sink.text("written: ");
                self.write_name(
                    if coils { Space::Coil } else { Space::Holding },
                    start,
                    count,
                    sink,
                );
            }
            ReplyPdu::Exception { function, exception } => {
                let code = FieldValue::Int(i64::from(exception.code()));
                self.layout.emit_field(sink, "exception", 2..3, code, exception.text());
                sink.text(Function::of_code(function).name());
                sink.text(" refused: ");
                sink.text(exception.text());
            }
            ReplyPdu::Unknown { function, data } => self.explain_unknown(function, data, sink),
        }
    }

    /// Explains the values of a read, with the names of the requested registers.
    fn explain_read(
        &self,
        space: Space,
        data: &[u8],
        request: Option<&[u8]>,
        sink: &mut dyn ExplainSink,
    ) {
        self.emit_data(2, data, space, sink);
        if !sink.wants_text() {
            return;
        }
        let request_pdu = request.and_then(|pdu| RequestPdu::parse(pdu).ok());
        match request_pdu {
            Some(RequestPdu::Read { space: wanted, start, count })
                if wanted == space && data.len() == space.reply_bytes(count) =>
            {
                if space.is_bits() {
                    // A TS drive answers a read of one line with all of them (TS manual V2 §2.3).
                    let shown = if count == 1 { 8 } else { count };
                    self.write_name(space, start, count, sink);
                    sink.text(" = ");
                    write_bits(data, shown, BITS_MAX, sink);
                } else {
                    self.write_values(space, start, data, self.layout.number_origin(), sink);
                }
            }
            Some(RequestPdu::ReadWriteRegisters { read_start, read_count, .. })
                if data.len() == 2 * usize::from(read_count) =>
            {
                let origin = self.layout.number_origin();
                self.write_values(Space::Holding, read_start, data, origin, sink);
            }
            _ if space.is_bits() => write_bits(data, 8 * data.len() as u16, BITS_MAX, sink),
            _ => self.write_plain_values(data, sink),
        }
    }

    fn emit_start_count(&self, start: u16, count: u16, sink: &mut dyn ExplainSink) {
        self.emit_address("start", start, sink);
        self.layout.emit_field(sink, "count", 4..6, FieldValue::Int(i64::from(count)), "");
    }

    fn emit_address(&self, name: &'static str, address: u16, sink: &mut dyn ExplainSink) {
        let symbol = self.find_parameter(Space::Holding, address).map_or("", |p| p.symbol);
        self.layout.emit_field(sink, name, 2..4, FieldValue::Hex(u64::from(address), 4), symbol);
    }

    fn emit_register(&self, address: u16, value: u16, sink: &mut dyn ExplainSink) {
        self.emit_address("register", address, sink);
        let parameter = self.find_parameter(Space::Holding, address);
        let encoding = parameter.map_or(Encoding::U16, |p| p.encoding);
        let raw = if register_count(encoding) == 1 {
            decode(encoding, [value, 0, 0, 0])
        } else {
            i64::from(value)
        };
        let meaning = parameter.map_or("", |p| value_meaning(p, raw));
        self.layout.emit_field(sink, "value", 4..6, FieldValue::Int(raw), meaning);
    }

    fn emit_coil(&self, address: u16, on: bool, sink: &mut dyn ExplainSink) {
        let symbol = self.find_parameter(Space::Coil, address).map_or("", |p| p.symbol);
        self.layout.emit_field(sink, "coil", 2..4, FieldValue::Hex(u64::from(address), 4), symbol);
        let word = if on { "on" } else { "off" };
        self.layout.emit_field(sink, "value", 4..6, FieldValue::Int(i64::from(on)), word);
    }

    /// Byte count at `at` (in the frame's bytes) and the data behind it.
    fn emit_data(&self, at: usize, data: &[u8], space: Space, sink: &mut dyn ExplainSink) {
        let count = FieldValue::Int(data.len() as i64);
        self.layout.emit_field(sink, "byte_count", at..at + 1, count, "");
        let bytes = at + 1..at + 1 + data.len();
        match data {
            _ if !space.is_bits() => {
                self.layout.emit_field(sink, "values", bytes, FieldValue::Words(data), "");
            }
            [bits] => {
                self.layout.emit_field(
                    sink,
                    "bits",
                    bytes,
                    FieldValue::Hex(u64::from(*bits), 2),
                    "",
                );
            }
            _ => {
                for (n, bits) in data.iter().enumerate() {
                    let value = FieldValue::Hex(u64::from(*bits), 2);
                    self.layout.emit_field(sink, "bits", at + 1 + n..at + 2 + n, value, "");
                }
            }
        }
    }

    fn explain_unknown(&self, function: u8, data: &[u8], sink: &mut dyn ExplainSink) {
        for (n, byte) in data.iter().enumerate() {
            let value = FieldValue::Hex(u64::from(*byte), 2);
            self.layout.emit_field(sink, "data", 2 + n..3 + n, value, "");
        }
        match (function, data) {
            (device_id::FUNCTION, [device_id::MEI_TYPE, _, object]) => {
                sink.text("read device id ");
                return write_decimal(i64::from(*object), sink);
            }
            (device_id::FUNCTION, _) if write_device_id(data, sink) => return,
            _ => {}
        }
        sink.text("function ");
        write_hex(u64::from(function), 2, sink);
        sink.text(", ");
        write_decimal(data.len() as i64, sink);
        sink.text(" bytes of data");
    }

    fn find_parameter(&self, space: Space, address: u16) -> Option<&'static Parameter> {
        let parameters = self.profile?.parameters;
        parameters.get(conversation::find_position(parameters, space, address)?)
    }

    /// `Fn_33 internal speed` or `holding register 0x0033`, and how many more.
    fn write_name(&self, space: Space, start: u16, count: u16, sink: &mut dyn ExplainSink) {
        let mut covered = 1;
        match self.find_parameter(space, start) {
            Some(parameter) => {
                sink.text(parameter.symbol);
                sink.text(" ");
                sink.text(parameter.name);
                covered = if space.is_bits() { 1 } else { register_count(parameter.encoding) };
            }
            None => {
                sink.text(match space {
                    Space::Holding => "register ",
                    Space::Input => "input register ",
                    Space::Coil => "coil ",
                    Space::Discrete => "discrete input ",
                });
                write_hex(u64::from(start), 4, sink);
            }
        }
        if count > covered {
            sink.text(", ");
            write_decimal(i64::from(count), sink);
            sink.text(if space.is_bits() { " bits" } else { " registers" });
        }
    }

    fn write_coil_state(&self, address: u16, on: bool, sink: &mut dyn ExplainSink) {
        self.write_name(Space::Coil, address, 1, sink);
        sink.text(if on { " = on" } else { " = off" });
    }

    /// `name = value unit` of each register, as far as a line goes. `origin` is the byte of the frame at which `data`
    /// begins, where their bytes are numbers and nothing else.
    fn write_values(
        &self,
        space: Space,
        start: u16,
        data: &[u8],
        origin: Option<usize>,
        sink: &mut dyn ExplainSink,
    ) {
        let count = data.len() / 2;
        let mut at = 0;
        for shown in 0..NAMED_MAX {
            if at >= count {
                return;
            }
            sink.text(if shown > 0 { ", " } else { "" });
            let address = start.wrapping_add(at as u16);
            let first = word(data, 2 * at);
            let parameter = self.find_parameter(space, address);
            let wide = parameter.map_or(1, |p| usize::from(register_count(p.encoding)));
            self.write_name(space, address, 1, sink);
            sink.text(" = ");
            match parameter {
                Some(parameter) if at + wide <= count => {
                    let raw = decode(parameter.encoding, words_from(data, at));
                    let place = origin.and_then(|origin| {
                        number_place(parameter.encoding, origin + 2 * at, parameter.values)
                    });
                    write_scaled(parameter, raw, place, sink);
                    at += wide;
                }
                _ => {
                    let place =
                        origin.and_then(|origin| number_place(Encoding::U16, origin + 2 * at, &[]));
                    write_raw(first.into(), place, sink);
                    at += 1;
                }
            }
        }
        write_more(count - at, sink);
    }

    fn write_plain_values(&self, data: &[u8], sink: &mut dyn ExplainSink) {
        let count = data.len() / 2;
        sink.text("values ");
        for n in 0..count.min(NAMED_MAX) {
            sink.text(if n > 0 { ", " } else { "" });
            write_decimal(i64::from(word(data, 2 * n)), sink);
        }
        write_more(count.saturating_sub(NAMED_MAX), sink);
    }
}

fn value_meaning(parameter: &'static Parameter, raw: i64) -> &'static str {
    parameter.values.iter().find(|(value, _)| *value == raw).map_or("", |(_, name)| name)
}
