//! Datagrams for people: where one ends in a stream, what its fields are, what it means.

mod talk;

use super::ascii;
use super::opcode::{Opcode, Status};
use super::text::{self, Decimal};
use super::wire::{CAN_DATAGRAM, DATAGRAM, HOST, MODULE, Reply, Request, VersionText, checksum};
use crate::error::WireError;
use crate::explain::{
    Addressing, Context, Cut, Direction, Dissector, Effect, EncodeError, Encoded, Field, Raw,
    Reading, Sink, Talk, TextError, Turn, Value, Via,
};
use crate::profile::{Parameter, Profile};

/// TMCL in captures, dashboards and the encoder.
#[derive(Clone, Copy, Debug)]
pub struct TmclDissector;

/// CAN identifiers that are taken for TMCL unasked: modules keep small ones …
const CAN_ID_MAX: u32 = 0x20;
/// … and beside other protocols those that neither CANopen nor TechnoCAN uses. Others must be named.
const CAN_IDS_FREE: core::ops::RangeInclusive<u32> = 0x61..=0x7F;

impl Dissector for TmclDissector {
    fn name(&self) -> &'static str {
        "tmcl"
    }

    fn cut(&self, bytes: &[u8], direction: Option<Direction>, ended: bool) -> Cut {
        if let Some(len) = ascii_line(bytes) {
            return Cut::Frame(len);
        }
        let Some(first) = bytes.first_chunk::<DATAGRAM>() else {
            return match bytes.len() {
                0 => Cut::More,
                _ if !ended => Cut::More,
                short if short >= 4 => Cut::Broken(short),
                short => Cut::Skip(short),
            };
        };
        if is_summed(first) || is_version(first, direction) {
            return Cut::Frame(DATAGRAM);
        }
        resynchronise(bytes, direction, ended)
    }

    fn claims(&self, id: u32, extended: bool) -> bool {
        !extended && ((1..=CAN_ID_MAX).contains(&id) || CAN_IDS_FREE.contains(&id))
    }

    fn explain(&self, bytes: &[u8], context: &Context<'_>, sink: &mut dyn Sink) {
        if let Some(id) = context.id {
            return can(bytes, id, context, sink);
        }
        if ascii_line(bytes) == Some(bytes.len()) {
            return line(bytes, sink);
        }
        serial(bytes, context, sink);
    }

    fn encode(
        &self,
        text: &str,
        addressing: &Addressing,
        out: &mut [u8],
    ) -> Result<Encoded, EncodeError> {
        let expected = "a module address, 0 to 255";
        let address = addressing.axis.unwrap_or(MODULE.into());
        let address = u8::try_from(address).map_err(|_| TextError { at: 0, expected })?;
        // Behind a colon is prose, as explaining puts it there.
        let command = text.split(':').next().unwrap_or(text);
        let request = text::parse(command, address)?;
        let bytes = request.emit();
        let (part, id) = match addressing.via {
            Via::Can => (&bytes[1..=CAN_DATAGRAM], Some(address.into())),
            _ => (&bytes[..], None),
        };
        let room = TextError { at: 0, expected: "room for nine bytes" };
        out.get_mut(..part.len()).ok_or(room)?.copy_from_slice(part);
        let silent = matches!(request.opcode, Opcode::Boot | Opcode::BootStart);
        Ok(Encoded {
            len: part.len(),
            id,
            extended: false,
            remote: None,
            answer: (!silent).then_some(part.len()),
            warning: "",
        })
    }

    fn code(&self, code: u32) -> Option<&'static str> {
        let status = Status::from(u8::try_from(code).ok()?);
        (!status.text().is_empty()).then(|| status.text())
    }

    fn assumes_names(&self) -> bool {
        true
    }

    fn asks(&self, frame: &Raw<'_>) -> bool {
        frame.id.is_none_or(|id| !talk::is_can_reply(frame.bytes, id))
    }

    fn answers(&self, frame: &Raw<'_>, request: &Raw<'_>) -> bool {
        talk::answers(frame, request)
    }

    fn turn(&self, frame: &Raw<'_>, talk: &Talk<'_>) -> Turn {
        talk::turn(frame, talk)
    }

    fn effect(&self, frame: &Raw<'_>, profile: Option<&'static Profile>) -> Effect {
        talk::effect(frame, profile)
    }

    fn refuses(&self, answer: &Raw<'_>, _: &Raw<'_>) -> Option<&'static str> {
        talk::refuses(answer)
    }
}

/// The length of a line of ASCII mode at the head of `bytes`.
fn ascii_line(bytes: &[u8]) -> Option<usize> {
    if !bytes.first()?.is_ascii_alphabetic() {
        return None;
    }
    let end = bytes.iter().take(ascii::LINE_MAX).position(|byte| *byte == b'\r')?;
    let line = &bytes[..end];
    let command = ascii::Command::parse(line);
    let readable = !matches!(command, None | Some((_, ascii::Command::Unreadable)));
    (readable || ascii::Answer::parse(line).is_some()).then_some(end + 1)
}

fn is_summed(bytes: &[u8; DATAGRAM]) -> bool {
    checksum(bytes) == bytes[DATAGRAM - 1]
}

/// The version as text has no checksum: eight characters that can be printed, a V among them.
fn is_version(bytes: &[u8; DATAGRAM], direction: Option<Direction>) -> bool {
    direction != Some(Direction::ToDrive)
        && VersionText::parse(bytes).is_ok_and(|version| version.text.contains(&b'V'))
}

fn is_shaped(bytes: &[u8; DATAGRAM], direction: Option<Direction>) -> bool {
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
fn resynchronise(bytes: &[u8], direction: Option<Direction>, ended: bool) -> Cut {
    let good = |at: usize| {
        bytes.get(at..).and_then(<[u8]>::first_chunk::<DATAGRAM>).is_some_and(|window| {
            is_summed(window) && is_shaped(window, direction) && !window.iter().all(|b| *b == 0)
        })
    };
    if good(DATAGRAM) {
        return Cut::Broken(DATAGRAM);
    }
    match (1..DATAGRAM).find(|at| good(*at)) {
        Some(at) => Cut::Skip(at),
        None if ended || bytes.len() >= 2 * DATAGRAM => Cut::Broken(DATAGRAM),
        None => Cut::More,
    }
}

fn serial(bytes: &[u8], context: &Context<'_>, sink: &mut dyn Sink) {
    let mut padded = [0; DATAGRAM];
    let have = bytes.len().min(DATAGRAM);
    padded[..have].copy_from_slice(&bytes[..have]);
    let asked_text = context.request.is_some_and(|r| r.len() == DATAGRAM && r[1..3] == [136, 0]);
    let version = VersionText::parse(bytes);
    if let Ok(version) = version
        && (is_version(&padded, context.direction) && !is_summed(&padded) || asked_text)
    {
        sink.kind(Opcode::Version.word());
        byte(sink, "host", 0, version.host, "");
        return show_version(&version, 1, sink);
    }
    let whole = padded;
    // What did not come is not told as if it were zero.
    let sink = &mut Present { sink, have: have as u16, text: have >= DATAGRAM - 1 };
    if is_reply(&whole, context) {
        let reply = unchecked_reply(&whole);
        byte(sink, "host", 0, reply.host, "");
        show_reply(&reply, 1, context, sink);
    } else {
        let request = unchecked_request(&whole);
        byte(sink, "address", 0, request.address, "");
        show_request(&request, 1, context, sink);
    }
    if have == DATAGRAM {
        byte(sink, "checksum", 8, whole[8], "");
    }
    if let Err(error) = Request::parse(bytes) {
        sink.error(error);
    }
}

fn can(data: &[u8], id: u32, context: &Context<'_>, sink: &mut dyn Sink) {
    let reply = match context.direction {
        Some(direction) => direction == Direction::ToHost,
        None => context.request.is_some() || talk::is_can_reply(data, id),
    };
    let text = VersionText::parse_can(data, HOST);
    if let Ok(version) = text
        && reply
        && version.text.contains(&b'V')
    {
        sink.kind(Opcode::Version.word());
        return show_version(&version, 0, sink);
    }
    if reply {
        match Reply::parse_can(data, HOST) {
            Ok(reply) => show_reply(&reply, 0, context, sink),
            Err(error) => broken(error, sink),
        }
    } else {
        match Request::parse_can(data, id as u8) {
            Ok(request) => show_request(&request, 0, context, sink),
            Err(error) => broken(error, sink),
        }
    }
}

fn line(bytes: &[u8], sink: &mut dyn Sink) {
    let line = bytes.strip_suffix(b"\r").unwrap_or(bytes);
    let end = line.len() as u16;
    if let Some(answer) = ascii::Answer::parse(line) {
        sink.kind("ASCII reply");
        sink.axis(answer.module.into());
        byte(sink, "host", 0, answer.host, "");
        byte(sink, "address", 1, answer.module, "");
        let status = Value::Int(answer.status.number().into());
        let meaning = answer.status.text();
        sink.field(Field { name: "status", start: 2, end, value: status, meaning });
        let value = Value::Int(answer.value.into());
        return sink.field(Field { name: "value", start: 2, end, value, meaning: "" });
    }
    match ascii::Command::parse(line) {
        Some((address, ascii::Command::Request(request))) => {
            byte(sink, "address", 0, address, "");
            let sink = &mut Present { sink, have: end, text: true };
            show_request(&request, 1, &Context::default(), sink);
        }
        Some((address, ascii::Command::Binary)) => {
            sink.kind("BIN");
            sink.axis(address.into());
            sink.text("leave ASCII mode");
        }
        _ => broken(WireError::Unexpected { at: 0, found: bytes[0] }, sink),
    }
}

/// Passes on what lies within the bytes that are there.
struct Present<'a> {
    sink: &'a mut dyn Sink,
    have: u16,
    /// Enough is there to say it in words.
    text: bool,
}

impl Sink for Present<'_> {
    fn kind(&mut self, kind: &str) {
        self.sink.kind(kind);
    }
    fn axis(&mut self, axis: u32) {
        self.sink.axis(axis);
    }
    fn field(&mut self, field: Field<'_>) {
        if field.end <= self.have {
            self.sink.field(field);
        }
    }
    fn text(&mut self, piece: &str) {
        if self.text {
            self.sink.text(piece);
        }
    }
    fn error(&mut self, error: WireError) {
        self.sink.error(error);
    }
    fn reading(&mut self, reading: Reading<'_>) {
        self.pass(reading);
    }
}

fn broken(error: WireError, sink: &mut dyn Sink) {
    sink.kind("TMCL");
    sink.error(error);
}

/// Reply or request? The direction says, or that there is a request, or what is likelier: a reply
/// goes to host address 2 as from the factory and has a status that has a name.
fn is_reply(bytes: &[u8; DATAGRAM], context: &Context<'_>) -> bool {
    let status = Status::from(bytes[2]);
    match context.direction {
        Some(direction) => direction == Direction::ToHost,
        None if context.request.is_some() => true,
        None => {
            let named = status.is_named();
            named && (bytes[0] == HOST || (status.is_good() && bytes[0] != MODULE))
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

fn byte(sink: &mut dyn Sink, name: &'static str, at: u16, value: u8, meaning: &'static str) {
    let value = Value::Int(value.into());
    sink.field(Field { name, start: at, end: at + 1, value, meaning });
}

fn number(sink: &mut dyn Sink, value: i64) {
    sink.text(Decimal::of(value).as_str());
}

fn kind(sink: &mut dyn Sink, opcode: Opcode) {
    sink.kind(if opcode.is_named() { opcode.word() } else { "unknown opcode" });
}

fn show_request(request: &Request, at: u16, context: &Context<'_>, sink: &mut dyn Sink) {
    let opcode = request.opcode;
    kind(sink, opcode);
    sink.axis(request.address.into());
    byte(sink, "opcode", at, opcode.number(), opcode.text());
    let name = parameter_of(request, context.profile).map_or("", |parameter| parameter.name);
    let word = text::Shape::of(opcode).word(request.kind).unwrap_or(name);
    byte(sink, "type", at + 1, request.kind, word);
    byte(sink, "motor", at + 2, request.motor, "");
    let value = Value::Int(request.value.into());
    sink.field(Field { name: "value", start: at + 3, end: at + 7, value, meaning: "" });
    text::write(request, &mut |piece| sink.text(piece));
    if !opcode.text().is_empty() {
        sink.text(": ");
        sink.text(opcode.text());
    }
    if !name.is_empty() {
        sink.text(" \"");
        sink.text(name);
        sink.text("\"");
        doubt(context, sink);
    }
    talk::told(request, context.profile, sink);
}

/// Names of a drive that nobody stated are marked with whose they are.
fn doubt(context: &Context<'_>, sink: &mut dyn Sink) {
    if let Some(profile) = context.profile.filter(|_| context.assumed) {
        sink.text(" (");
        sink.text(profile.name);
        sink.text("?)");
    }
}

fn show_reply(reply: &Reply, at: u16, context: &Context<'_>, sink: &mut dyn Sink) {
    let asked = context.request.and_then(|bytes| {
        let body = if bytes.len() == DATAGRAM { &bytes[1..] } else { bytes };
        Request::parse_can(body, reply.module).ok()
    });
    kind(sink, reply.opcode);
    sink.axis(reply.module.into());
    byte(sink, "address", at, reply.module, "");
    byte(sink, "status", at + 1, reply.status.number(), reply.status.text());
    byte(sink, "opcode", at + 2, reply.opcode.number(), reply.opcode.text());
    let value = Value::Int(reply.value.into());
    sink.field(Field { name: "value", start: at + 3, end: at + 7, value, meaning: "" });
    let named = asked.filter(|asked| asked.opcode == reply.opcode);
    let name = named.and_then(|asked| parameter_of(&asked, context.profile)).map(|p| p.name);
    if let Some(asked) = named {
        talk::found(&asked, reply, context.profile, sink);
    }
    match (reply.status, name) {
        (Status::Ok, Some(name)) => {
            sink.text(name);
            sink.text(" = ");
            number(sink, reply.value.into());
            doubt(context, sink);
        }
        (status, _) if !status.is_named() => {
            sink.text("unknown status ");
            number(sink, status.number().into());
        }
        (status, _) if status.is_good() => {
            sink.text(status.text());
            sink.text(", value ");
            number(sink, reply.value.into());
            version(reply, asked.as_ref(), sink);
        }
        (status, _) => {
            sink.text("refused: ");
            sink.text(status.text());
        }
    }
}

/// 136 type 1: type number in the upper half, version in the lower.
fn version(reply: &Reply, asked: Option<&Request>, sink: &mut dyn Sink) {
    if reply.opcode != Opcode::Version || asked.is_some_and(|asked| asked.kind != 1) {
        return;
    }
    let [a, b, major, minor] = reply.value.to_be_bytes();
    sink.text(" (module ");
    number(sink, u16::from_be_bytes([a, b]).into());
    sink.text(", version ");
    number(sink, major.into());
    sink.text(if minor < 10 { ".0" } else { "." });
    number(sink, minor.into());
    sink.text(")");
}

fn show_version(version: &VersionText, at: u16, sink: &mut dyn Sink) {
    let text = core::str::from_utf8(&version.text).unwrap_or("");
    let value = Value::Text(text);
    let meaning = "module and version; no checksum";
    sink.field(Field { name: "version", start: at, end: at + 8, value, meaning });
    sink.text("firmware version ");
    sink.text(text);
}

/// The parameter that a request is about, where the profile has it.
fn parameter_of(
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
