//! Explains datagrams: their ends in a stream, fields, meaning.

mod conversation;

use super::ascii;
use super::instructions::TmclInstructions;
use super::opcode::{Opcode, Status};
use super::text;
use super::wire::{CAN_DATAGRAM, DATAGRAM, HOST, MODULE, Reply, Request, VersionText, checksum};
use crate::convert::ascii_text;
use crate::error::WireError;
use crate::explain::{
    Context, ConversationContext, Decimal, DeviceFact, Direction, Dissector, DriveFacts, Effect,
    EncodeError, EncodeOptions, EncodedFrame, ExplainSink, FactQuery, Field, FieldValue,
    FrameBoundary, FrameConversation, FrameFormat, FrameRole, FrameValue, NumberPlace, NumberStyle,
    RawFrame, TextError, WireKind,
};
use crate::profile::{Parameter, Profile};
use crate::program::InstructionLanguage;
use crate::verb::Verb;

/// TMCL in captures, dashboards and the encoder.
#[derive(Clone, Copy, Debug)]
pub struct TmclDissector;

/// CAN identifiers that are taken for TMCL unasked: modules keep small ones …
const CAN_ID_MAX: u32 = 0x20;
/// … and beside other protocols those that neither CANopen nor TechnoCAN uses. Others must be named.
const CAN_IDS_FREE: core::ops::RangeInclusive<u32> = 0x61..=0x7F;

impl FrameFormat for TmclDissector {
    fn find_frame(&self, bytes: &[u8], direction: Option<Direction>, ended: bool) -> FrameBoundary {
        if let Some(len) = ascii_line_len(bytes) {
            return FrameBoundary::Frame(len);
        }
        let Some(first) = bytes.first_chunk::<DATAGRAM>() else {
            return match bytes.len() {
                0 => FrameBoundary::Incomplete,
                _ if !ended => FrameBoundary::Incomplete,
                short if short >= 4 => FrameBoundary::Corrupt(short),
                short => FrameBoundary::Skip(short),
            };
        };
        if has_valid_checksum(first) || is_version_text(first, direction) {
            return FrameBoundary::Frame(DATAGRAM);
        }
        resynchronise(bytes, direction, ended)
    }

    fn claims_id(&self, id: u32, extended: bool) -> bool {
        !extended && ((1..=CAN_ID_MAX).contains(&id) || CAN_IDS_FREE.contains(&id))
    }

    fn content_evidence(&self, frame: &RawFrame<'_>) -> Option<bool> {
        let (id, request) = (frame.id?, self.is_request(frame));
        // Some hosts send the check sum of the serial form as an eighth byte.
        if let ([body @ .., sum], true) = (frame.bytes, request && frame.bytes.len() == 8) {
            let total = body.iter().fold(id as u8, |total, byte| total.wrapping_add(*byte));
            if total == *sum {
                return Some(true);
            }
        }
        (!is_known_opcode(if request { 0 } else { 2 }, frame.bytes)).then_some(false)
    }
}

impl FrameConversation for TmclDissector {
    fn is_request(&self, frame: &RawFrame<'_>) -> bool {
        frame.id.is_none_or(|id| !conversation::is_can_reply(frame.bytes, id))
    }

    fn is_answer_to(&self, frame: &RawFrame<'_>, request: &RawFrame<'_>) -> bool {
        conversation::is_answer_to(frame, request)
    }

    fn role(&self, frame: &RawFrame<'_>, talk: &ConversationContext<'_>) -> FrameRole {
        conversation::frame_role(frame, talk)
    }

    fn effect(&self, frame: &RawFrame<'_>, profile: Option<&'static Profile>) -> Effect {
        conversation::effect_of(frame, profile)
    }

    fn refusal_reason(&self, answer: &RawFrame<'_>, _: &RawFrame<'_>) -> Option<&'static str> {
        conversation::refusal_reason(answer)
    }
}

impl DriveFacts for TmclDissector {
    fn verb_example(&self, verb: Verb) -> Option<&'static str> {
        Some(match verb {
            Verb::Velocity => "ROR 0, 500",
            Verb::MoveTo => "MVP ABS, 0, 1000",
            Verb::MoveBy => "MVP REL, 0, 1000",
            Verb::Home => "RFS START, 0",
            _ => return None,
        })
    }

    fn device_facts(&self) -> &'static [DeviceFact] {
        const VERSION: FactQuery = FactQuery::Text("GET VERSION 1, 0, 0");
        const MOTORS: FactQuery = FactQuery::Count(
            "AP 1.0",
            &["AP 1.1", "AP 1.2", "AP 1.3", "AP 1.4", "AP 1.5", "AP 1.6"],
        );
        &[
            DeviceFact { name: "module", query: VERSION },
            DeviceFact { name: "firmware", query: VERSION },
            DeviceFact { name: "motors", query: MOTORS },
        ]
    }

    /// The upper half is the module's number, the lower one the version (TMCL reference, 136).
    fn write_fact(&self, name: &str, raw: i64, out: &mut dyn core::fmt::Write) {
        let (module, [major, minor]) = (raw >> 16 & 0xFFFF, [raw >> 8 & 0xFF, raw & 0xFF]);
        // Without room for the text there is no reader of it.
        let _ = match name {
            "module" => write!(out, "TMCM-{module}"),
            _ => write!(out, "{major}.{minor:02}"),
        };
    }

    /// `AGAP 1, 0` reads a position; `ABIN` ends the mode (TMCL reference, "ASCII interface").
    fn write_text_mode(
        &self,
        address: u32,
        query: &mut dyn FnMut(&str),
        exit: &mut dyn FnMut(&str),
    ) -> bool {
        let Ok(address) = u8::try_from(address) else { return false };
        let mut line = ascii::AsciiLine::EMPTY;
        let request = Request { address, opcode: Opcode::Gap, kind: 1, motor: 0, value: 0 };
        if !ascii::write_request(&mut line, &request) {
            return false;
        }
        let text = ascii_text(line.bytes()).trim_end();
        query(text);
        exit(text.get(..1).unwrap_or(""));
        exit("BIN");
        true
    }

    fn is_text_answer(&self, line: &[u8]) -> bool {
        ascii::AsciiReply::parse(line).is_some()
    }
}

impl Dissector for TmclDissector {
    fn name(&self) -> &'static str {
        "tmcl"
    }

    fn explain(&self, bytes: &[u8], context: &Context<'_>, sink: &mut dyn ExplainSink) {
        if let Some(id) = context.id {
            return explain_can(bytes, id, context, sink);
        }
        if ascii_line_len(bytes) == Some(bytes.len()) {
            return explain_ascii_line(bytes, sink);
        }
        explain_serial(bytes, context, sink);
    }

    fn encode(
        &self,
        text: &str,
        addressing: &EncodeOptions,
        out: &mut [u8],
    ) -> Result<EncodedFrame, EncodeError> {
        let on_can = addressing.wire == WireKind::Can;
        let (last, expected) = if on_can {
            (0x7FF, "a module's CAN id, 0 to 2047")
        } else {
            (0xFF, "a module address, 0 to 255")
        };
        let number = addressing.axis.unwrap_or(MODULE.into());
        if number > last {
            return Err(TextError { at: 0, expected }.into());
        }
        let address = number as u8;
        // Behind a colon is prose, as explaining puts it there.
        let command = text.split(':').next().unwrap_or(text);
        let request = text::parse(command, address)?;
        let bytes = request.emit();
        let (part, id) = match addressing.wire {
            WireKind::Can => (&bytes[1..=CAN_DATAGRAM], Some(number)),
            _ => (&bytes[..], None),
        };
        let error = TextError { at: 0, expected: "room for nine bytes" };
        out.get_mut(..part.len()).ok_or(error)?.copy_from_slice(part);
        let silent = matches!(request.opcode, Opcode::Boot | Opcode::BootStart);
        Ok(EncodedFrame {
            len: part.len(),
            id,
            extended: false,
            remote_len: None,
            answer_len: (!silent).then_some(part.len()),
            warning: "",
        })
    }

    fn instruction_language(&self) -> Option<&'static dyn InstructionLanguage> {
        Some(&TmclInstructions)
    }

    fn code_meaning(&self, code: u32) -> Option<&'static str> {
        let status = Status::from(u8::try_from(code).ok()?);
        (!status.text().is_empty()).then(|| status.text())
    }

    fn explains_by_name(&self) -> bool {
        true
    }
}

fn is_known_opcode(at: usize, frame_bytes: &[u8]) -> bool {
    frame_bytes.get(at).is_some_and(|b| Opcode::from(*b).is_named())
}

/// The length of a line of ASCII mode at the head of `bytes`.
fn ascii_line_len(bytes: &[u8]) -> Option<usize> {
    if !bytes.first()?.is_ascii_alphabetic() {
        return None;
    }
    let end = bytes.iter().take(ascii::LINE_MAX).position(|byte| *byte == b'\r')?;
    let line = &bytes[..end];
    let command = ascii::AsciiCommand::parse(line);
    let readable = !matches!(command, None | Some((_, ascii::AsciiCommand::Unreadable)));
    (readable || ascii::AsciiReply::parse(line).is_some()).then_some(end + 1)
}

fn has_valid_checksum(bytes: &[u8; DATAGRAM]) -> bool {
    checksum(bytes) == bytes[DATAGRAM - 1]
}

/// The version as text has no checksum: eight characters that can be printed, a V among them.
fn is_version_text(bytes: &[u8; DATAGRAM], direction: Option<Direction>) -> bool {
    direction != Some(Direction::ToDrive)
        && VersionText::parse(bytes).is_ok_and(|version| version.text.contains(&b'V'))
}

fn is_plausible(bytes: &[u8; DATAGRAM], direction: Option<Direction>) -> bool {
    let request = Opcode::from(bytes[1]).is_named();
    let reply = Status::from(bytes[2]).is_named();
    match direction {
        Some(Direction::ToDrive) => request,
        Some(Direction::ToHost) => reply,
        None => request || reply,
    }
}

/// The first nine bytes do not agree with their sum. If a good datagram follows right behind them,
/// or nothing good follows at all, they are a broken one; if one begins among them, what is before
/// it belongs to none.
fn resynchronise(bytes: &[u8], direction: Option<Direction>, ended: bool) -> FrameBoundary {
    if is_good_datagram(DATAGRAM, &direction, bytes) {
        return FrameBoundary::Corrupt(DATAGRAM);
    }
    match (1..DATAGRAM).find(|at| is_good_datagram(*at, &direction, bytes)) {
        Some(at) => FrameBoundary::Skip(at),
        None if ended || bytes.len() >= 2 * DATAGRAM => FrameBoundary::Corrupt(DATAGRAM),
        None => FrameBoundary::Incomplete,
    }
}

fn is_good_datagram(at: usize, direction: &Option<Direction>, bytes: &[u8]) -> bool {
    bytes.get(at..).and_then(<[u8]>::first_chunk::<DATAGRAM>).is_some_and(|window| {
        has_valid_checksum(window)
            && is_plausible(window, *direction)
            && !window.iter().all(|b| *b == 0)
    })
}

fn explain_serial(bytes: &[u8], context: &Context<'_>, sink: &mut dyn ExplainSink) {
    let mut padded = [0; DATAGRAM];
    let have = bytes.len().min(DATAGRAM);
    padded[..have].copy_from_slice(&bytes[..have]);
    let asked_text = context.request.is_some_and(|r| r.len() == DATAGRAM && r[1..3] == [136, 0]);
    let version = VersionText::parse(bytes);
    if let Ok(version) = version
        && (is_version_text(&padded, context.direction) && !has_valid_checksum(&padded)
            || asked_text)
    {
        sink.kind(Opcode::Version.word());
        emit_byte(sink, "host", 0, version.host, "");
        return explain_version(&version, 1, sink);
    }
    let whole = padded;
    // A missing value is not shown as zero.
    let sink = &mut PartialFrameSink {
        sink,
        available: have as u16,
        enough_for_text: have >= DATAGRAM - 1,
    };
    if is_reply(&whole, context) {
        let reply = unchecked_reply(&whole);
        emit_byte(sink, "host", 0, reply.host, "");
        explain_reply(&reply, 1, context, sink);
    } else {
        let request = unchecked_request(&whole);
        emit_byte(sink, "address", 0, request.address, "");
        explain_request(&request, 1, context, sink);
    }
    if have == DATAGRAM {
        let value = FieldValue::Int(whole[8].into());
        let field = Field { name: "checksum", start: 8, end: 9, value, meaning: "" };
        sink.number_field(field, NumberPlace::unsigned(8, 1));
    }
    if let Err(error) = Request::parse(bytes) {
        sink.error(error);
    }
}

fn explain_can(data: &[u8], id: u32, context: &Context<'_>, sink: &mut dyn ExplainSink) {
    let reply = match context.direction {
        Some(direction) => direction == Direction::ToHost,
        None => context.request.is_some() || conversation::is_can_reply(data, id),
    };
    let text = VersionText::parse_can(data, HOST);
    if let Ok(version) = text
        && reply
        && version.text.contains(&b'V')
    {
        sink.kind(Opcode::Version.word());
        return explain_version(&version, 0, sink);
    }
    if reply {
        match Reply::parse_can(data, HOST) {
            Ok(reply) => explain_reply(&reply, 0, context, sink),
            Err(error) => explain_broken(error, sink),
        }
    } else {
        match Request::parse_can(data, id as u8) {
            Ok(request) => explain_request(&request, 0, context, sink),
            Err(error) => explain_broken(error, sink),
        }
    }
}

fn explain_ascii_line(bytes: &[u8], sink: &mut dyn ExplainSink) {
    let line = bytes.strip_suffix(b"\r").unwrap_or(bytes);
    let end = line.len() as u16;
    if let Some(answer) = ascii::AsciiReply::parse(line) {
        sink.kind("ASCII reply");
        sink.axis(answer.module.into());
        emit_byte(sink, "host", 0, answer.host, "");
        emit_byte(sink, "address", 1, answer.module, "");
        let status = FieldValue::Int(answer.status.number().into());
        let meaning = answer.status.text();
        sink.field(Field { name: "status", start: 2, end, value: status, meaning });
        let value = FieldValue::Int(answer.value.into());
        return sink.field(Field { name: "value", start: 2, end, value, meaning: "" });
    }
    match ascii::AsciiCommand::parse(line) {
        Some((address, ascii::AsciiCommand::Request(request))) => {
            emit_byte(sink, "address", 0, address, "");
            let sink = &mut PartialFrameSink { sink, available: end, enough_for_text: true };
            explain_request(&request, 1, &Context::default(), sink);
        }
        Some((address, ascii::AsciiCommand::Binary)) => {
            sink.kind("BIN");
            sink.axis(address.into());
            sink.text("leave ASCII mode");
        }
        _ => explain_broken(WireError::Unexpected { at: 0, found: bytes[0] }, sink),
    }
}

/// Passes on what lies within the bytes that are there.
struct PartialFrameSink<'a> {
    sink: &'a mut dyn ExplainSink,
    available: u16,
    /// True if enough bytes are there for a text.
    enough_for_text: bool,
}

impl ExplainSink for PartialFrameSink<'_> {
    fn kind(&mut self, kind: &str) {
        self.sink.kind(kind);
    }
    fn axis(&mut self, axis: u32) {
        self.sink.axis(axis);
    }
    fn field(&mut self, field: Field<'_>) {
        if field.end <= self.available {
            self.sink.field(field);
        }
    }
    fn text(&mut self, piece: &str) {
        if self.enough_for_text {
            self.sink.text(piece);
        }
    }
    fn error(&mut self, error: WireError) {
        self.sink.error(error);
    }
    fn frame_value(&mut self, reading: FrameValue<'_>) {
        self.forward_value(reading);
    }
    fn number(&mut self, number: i64, style: NumberStyle, place: NumberPlace) {
        if self.enough_for_text {
            self.sink.number(number, style, place);
        }
    }
    fn number_field(&mut self, field: Field<'_>, place: NumberPlace) {
        if field.end <= self.available {
            self.sink.number_field(field, place);
        }
    }
    fn number_value(&mut self, reading: FrameValue<'_>, place: NumberPlace) {
        if self.enough_for_text {
            self.sink.number_value(reading, place);
        }
    }
}

fn explain_broken(error: WireError, sink: &mut dyn ExplainSink) {
    sink.kind("TMCL");
    sink.error(error);
}

/// First byte in the place of a motor that is no motor but an opcode.
const MOTORS_MAX: u8 = 4;

/// Distinguishes replies from requests: by the direction, by an open request, or by the likelier case. A reply goes to
/// host address 2, the factory setting, has a known status, and repeats an opcode where a request has a motor. A module
/// may have address 2 as well: its requests have a small number there.
fn is_reply(bytes: &[u8; DATAGRAM], context: &Context<'_>) -> bool {
    let status = Status::from(bytes[2]);
    match context.direction {
        Some(direction) => direction == Direction::ToHost,
        None if context.request.is_some() => true,
        None => {
            let named = status.is_named() && Opcode::from(bytes[3]).is_named();
            let is_request = Opcode::from(bytes[1]).is_named() && bytes[3] < MOTORS_MAX;
            let to_host = bytes[0] == HOST && (status.is_good() || !is_request);
            named && (to_host || (status.is_good() && bytes[0] != MODULE))
        }
    }
}

fn unchecked_request(bytes: &[u8; DATAGRAM]) -> Request {
    let [address, opcode, kind, motor, a, b, c, d, _] = *bytes;
    let value = i32::from_be_bytes([a, b, c, d]);
    Request { address, opcode: Opcode::from(opcode), kind, motor, value }
}

fn unchecked_reply(bytes: &[u8; DATAGRAM]) -> Reply {
    let [host, module, status, opcode, a, b, c, d, _] = *bytes;
    let value = i32::from_be_bytes([a, b, c, d]);
    Reply { host, module, status: Status::from(status), opcode: Opcode::from(opcode), value }
}

fn emit_byte(
    sink: &mut dyn ExplainSink,
    name: &'static str,
    at: u16,
    value: u8,
    meaning: &'static str,
) {
    let value = FieldValue::Int(value.into());
    sink.field(Field { name, start: at, end: at + 1, value, meaning });
}

fn write_number(sink: &mut dyn ExplainSink, value: i64) {
    sink.text(Decimal::of(value).as_str());
}

fn emit_kind(sink: &mut dyn ExplainSink, opcode: Opcode) {
    sink.kind(if opcode.is_named() { opcode.word() } else { "unknown opcode" });
}

fn explain_request(request: &Request, at: u16, context: &Context<'_>, sink: &mut dyn ExplainSink) {
    let opcode = request.opcode;
    emit_kind(sink, opcode);
    sink.axis(request.address.into());
    emit_byte(sink, "opcode", at, opcode.number(), opcode.text());
    let name = parameter_of(request, context.profile).map_or("", |parameter| parameter.name);
    let word = text::CommandFields::of(opcode).type_word(request.kind).unwrap_or(name);
    emit_byte(sink, "type", at + 1, request.kind, word);
    emit_byte(sink, "motor", at + 2, request.motor, "");
    let value = FieldValue::Int(request.value.into());
    sink.field(Field { name: "value", start: at + 3, end: at + 7, value, meaning: "" });
    if sink.wants_text() {
        text::write(request, &mut |piece| sink.text(piece));
        if !opcode.text().is_empty() {
            sink.text(": ");
            sink.text(opcode.text());
        }
        if !name.is_empty() {
            sink.text(" \"");
            sink.text(name);
            sink.text("\"");
            mark_assumed_profile(context, sink);
        }
    }
    conversation::report_request_values(request, context.profile, sink);
}

/// Marks names of a drive that was assumed, not stated.
fn mark_assumed_profile(context: &Context<'_>, sink: &mut dyn ExplainSink) {
    if let Some(profile) = context.profile.filter(|_| context.profile_assumed) {
        sink.text(" (");
        sink.text(profile.name);
        sink.text("?)");
    }
}

fn explain_reply(reply: &Reply, at: u16, context: &Context<'_>, sink: &mut dyn ExplainSink) {
    let request = context.request.and_then(|bytes| {
        let body = if bytes.len() == DATAGRAM { &bytes[1..] } else { bytes };
        Request::parse_can(body, reply.module).ok()
    });
    emit_kind(sink, reply.opcode);
    sink.axis(reply.module.into());
    emit_byte(sink, "address", at, reply.module, "");
    emit_byte(sink, "status", at + 1, reply.status.number(), reply.status.text());
    emit_byte(sink, "opcode", at + 2, reply.opcode.number(), reply.opcode.text());
    let named = request.filter(|request| request.opcode == reply.opcode);
    let name = named.and_then(|request| parameter_of(&request, context.profile)).map(|p| p.name);
    let value = FieldValue::Int(reply.value.into());
    let field = Field { name: "value", start: at + 3, end: at + 7, value, meaning: "" };
    let place = NumberPlace::signed(at as u8 + 3, 4);
    // Elsewhere the value may be a version.
    match name.filter(|_| reply.status == Status::Ok) {
        Some(_) => sink.number_field(field, place),
        None => sink.field(field),
    }
    if let Some(request) = named {
        conversation::report_reply_values(&request, reply, place, context.profile, sink);
    }
    if !sink.wants_text() {
        return;
    }
    match (reply.status, name) {
        (Status::Ok, Some(name)) => {
            sink.text(name);
            sink.text(" = ");
            sink.number(reply.value.into(), NumberStyle::Whole, place);
            mark_assumed_profile(context, sink);
        }
        (status, _) if !status.is_named() => {
            sink.text("unknown status ");
            write_number(sink, status.number().into());
        }
        (status, _) if status.is_good() => {
            sink.text(status.text());
            sink.text(", value ");
            write_number(sink, reply.value.into());
            write_version(reply, request.as_ref(), sink);
        }
        (status, _) => {
            sink.text("refused: ");
            sink.text(status.text());
        }
    }
}

/// 136 type 1: type number in the upper half, version in the lower.
fn write_version(reply: &Reply, request: Option<&Request>, sink: &mut dyn ExplainSink) {
    if reply.opcode != Opcode::Version || request.is_some_and(|request| request.kind != 1) {
        return;
    }
    let [a, b, major, minor] = reply.value.to_be_bytes();
    sink.text(" (module ");
    write_number(sink, u16::from_be_bytes([a, b]).into());
    sink.text(", version ");
    write_number(sink, major.into());
    sink.text(if minor < 10 { ".0" } else { "." });
    write_number(sink, minor.into());
    sink.text(")");
}

fn explain_version(version: &VersionText, at: u16, sink: &mut dyn ExplainSink) {
    let text = ascii_text(&version.text);
    let value = FieldValue::Text(text);
    let meaning = "module and version; no checksum";
    sink.field(Field { name: "version", start: at, end: at + 8, value, meaning });
    sink.text("firmware version ");
    sink.text(text);
}

/// The parameter that a request is about, where the profile has it.
pub(super) fn parameter_of(
    request: &Request,
    profile: Option<&'static Profile>,
) -> Option<&'static Parameter> {
    use Opcode as O;
    let space = match request.opcode {
        O::Sap | O::Gap | O::Stap | O::Rsap | O::Aap => 0,
        O::Sgp | O::Ggp | O::Stgp | O::Rsgp | O::Agp => request.motor.checked_add(1)?,
        _ => return None,
    };
    let index = u16::from(request.kind);
    profile?.parameters.iter().find(|p| p.space == space && p.index == index)
}
