//! Frames for people: what the fields are, and what a frame means.
//!
//! Nothing in one frame tells a thruster from a CANopen node: its identifiers are PDO2's, and
//! mapped values can have any bytes. So these identifiers are claimed as shared: a capture is
//! explained so where somebody says whose they are (`--as thruster@11`).

mod talk;

use super::fault;
use super::readings::Readings;
use super::rules::{self, ends};
use super::text::{self, Measure, Said};
use super::wire::{
    Bare, Command, Heard, RANGE, REFUSED, Reply, Report, Request, Shape, TO_DRIVE, TO_HOST, node,
};
use crate::error::WireError;
use crate::explain::{
    Addressing, Context, Cut, Direction, Dissector, Effect, EncodeError, Encoded, Field, Raw, Sink,
    Talk, TextError, Turn, Value,
};
use crate::profile::Profile;

/// The protocol in captures, dashboards and the encoder.
#[derive(Clone, Copy, Debug)]
pub struct ThrusterDissector;

/// The id in the manual's examples.
const EXAMPLE_ID: u32 = 11;

impl Dissector for ThrusterDissector {
    fn name(&self) -> &'static str {
        "thruster"
    }

    fn cut(&self, bytes: &[u8], _direction: Option<Direction>, _ended: bool) -> Cut {
        if bytes.is_empty() { Cut::More } else { Cut::Skip(bytes.len()) }
    }

    fn claims(&self, id: u32, extended: bool) -> bool {
        !extended && node(id).is_some()
    }

    fn shares(&self, id: u32, extended: bool) -> bool {
        self.claims(id, extended)
    }

    fn explain(&self, bytes: &[u8], context: &Context<'_>, sink: &mut dyn Sink) {
        let place = context.id.and_then(node).filter(|_| !context.extended);
        match place {
            Some(Ok(id) | Err(id)) => sink.axis(id.into()),
            None => {
                sink.kind("thruster");
                let found = context.id.unwrap_or(0);
                return sink.error(WireError::Identifier { found });
            }
        }
        if matches!(place, Some(Ok(_))) {
            request(bytes, context.profile, sink);
        } else {
            heard(bytes, context.request, context.profile, sink);
        }
    }

    fn encode(
        &self,
        text: &str,
        addressing: &Addressing,
        out: &mut [u8],
    ) -> Result<Encoded, EncodeError> {
        let expected = "an id, 1 to 127";
        let axis = addressing.axis.unwrap_or(EXAMPLE_ID);
        let id = u8::try_from(axis).ok().filter(|id| (1..=127).contains(id));
        let id = id.ok_or(TextError { at: 0, expected })?;
        let said = text::parse(text, readings(addressing.profile))?;
        let frame = match said {
            Said::Request(request) => request.frame(id),
            Said::Heard(Heard::Reply(reply)) => reply.frame(id),
            Said::Heard(Heard::Report(report)) => report.frame(id),
            Said::Heard(Heard::Bare(bare)) => bare.frame(id),
            Said::Raw { reply, bytes, len } => {
                let base = if reply { TO_HOST } else { TO_DRIVE };
                let id = base + u16::from(id);
                crate::medium::Frame::standard(id, &bytes[..usize::from(len)])
            }
        };
        let room = TextError { at: 0, expected: "room for eight bytes" };
        out.get_mut(..frame.bytes().len()).ok_or(room)?.copy_from_slice(frame.bytes());
        let request = frame.id >= TO_DRIVE.into();
        Ok(Encoded {
            len: frame.bytes().len(),
            id: Some(frame.id),
            extended: false,
            remote: None,
            answer: request.then_some(8),
            warning: warning(&said),
        })
    }

    fn code(&self, code: u32) -> Option<&'static str> {
        (code == REFUSED).then_some("refused: a fault, an output that is forbidden, or a bad value")
    }

    fn assumes_names(&self) -> bool {
        true
    }

    fn asks(&self, frame: &Raw<'_>) -> bool {
        frame.id.and_then(node).is_some_and(|place| place.is_ok()) && !frame.extended
    }

    fn answers(&self, frame: &Raw<'_>, request: &Raw<'_>) -> bool {
        let (Some(Err(from)), Some(Ok(to))) = (frame.id.and_then(node), request.id.and_then(node))
        else {
            return false;
        };
        from == to && is_answer(frame.bytes, request.bytes)
    }

    fn expect(&self, request: &Raw<'_>, addressing: &Addressing, sink: &mut dyn Sink) {
        let Ok(asked) = Request::parse(request.bytes) else { return };
        let data = match asked.command.known() {
            Some((Shape::Query, _)) | None => return,
            _ => asked.data.unwrap_or(0),
        };
        let Some(Ok(id)) = request.id.and_then(node) else { return };
        let Request { command, sub, .. } = asked;
        sink.axis(id.into());
        let echo = Reply { command, sub, data }.frame(id);
        heard(echo.bytes(), Some(request.bytes), addressing.profile, sink);
    }

    fn turn(&self, frame: &Raw<'_>, talk: &Talk<'_>) -> Turn {
        talk::turn(frame, talk)
    }

    fn effect(&self, frame: &Raw<'_>, _: Option<&'static Profile>) -> Effect {
        talk::effect(frame)
    }

    fn refuses(&self, answer: &Raw<'_>, request: &Raw<'_>) -> Option<&'static str> {
        talk::refuses(answer, request)
    }

    fn forms(&self, request: &Raw<'_>) -> bool {
        talk::forms(request)
    }

    fn restarted(&self, answer: &Raw<'_>, request: &Raw<'_>, talk: &Talk<'_>) -> bool {
        talk::restarted(answer, request, talk)
    }
}

fn readings(profile: Option<&'static Profile>) -> Readings {
    let own = profile.filter(|profile| profile.protocol == "thruster");
    own.map_or(Readings::default(), Readings::of)
}

/// Whether the reply is one to that request: it repeats four bytes, or reports on TC and VC.
fn is_answer(reply: &[u8], request: &[u8]) -> bool {
    let (Ok(heard), Ok(request)) = (Heard::parse(reply), Request::parse(request)) else {
        return false;
    };
    match heard {
        Heard::Reply(reply) => reply.command == request.command && reply.sub == request.sub,
        Heard::Report(report) => {
            let [letter, _] = request.command.0.to_be_bytes();
            request.command.is_output() && report.of == letter
        }
        Heard::Bare(_) => request.command.is_output(),
    }
}

fn warning(said: &Said) -> &'static str {
    match said {
        Said::Request(request) if request.command == Command::SP && request.sub != RANGE => {
            "internal parameters are the maker's: ask him before writing one"
        }
        Said::Request(request) if request.command == Command::LR && request.sub != 0 => {
            "each one that is sent adds to the way"
        }
        _ => "",
    }
}

fn request(bytes: &[u8], profile: Option<&'static Profile>, sink: &mut dyn Sink) {
    let readings = readings(profile);
    let request = match Request::parse(bytes) {
        Ok(request) => request,
        Err(error) => return broken(error, sink),
    };
    let Some((_, meaning)) = request.command.known() else { return foreign(bytes, sink) };
    sink.kind(request.command.letters().as_str());
    head(request.command, request.sub, meaning, sink);
    talk::told(&request, profile, sink);
    if let Some(data) = request.data {
        value(request.command, request.sub, data, readings, sink);
    }
    text::write_request(&request, readings, &mut |piece| sink.text(piece));
    let remark = match rules::check(&request) {
        Err(rule) => rule,
        Ok(()) if matches!(request.command, Command::LA | Command::LR) && request.sub == 0 => {
            "speed 0: not started"
        }
        Ok(()) => meaning,
    };
    sink.text(" (");
    sink.text(remark);
    sink.text(")");
}

/// What is no command of this protocol: another one uses the same identifiers.
fn foreign(bytes: &[u8], sink: &mut dyn Sink) {
    sink.kind("PDO2");
    let at = u16::from(bytes.first().is_some_and(u8::is_ascii_uppercase));
    let found = bytes.get(usize::from(at)).copied().unwrap_or(0);
    sink.text(match bytes {
        [_, _, _, flags, ..] if flags & 0xC0 != 0 => {
            "not a thruster's command; a drive with another two-letter language (Elmo)?"
        }
        _ => "not a thruster's command; a CANopen node's PDO2?",
    });
    sink.error(WireError::Unexpected { at, found });
}

fn broken(error: WireError, sink: &mut dyn Sink) {
    sink.kind("thruster");
    sink.error(error);
}

fn heard(
    bytes: &[u8],
    request: Option<&[u8]>,
    profile: Option<&'static Profile>,
    sink: &mut dyn Sink,
) {
    let readings = readings(profile);
    let heard = match Heard::parse(bytes) {
        Ok(heard) => heard,
        Err(error) => return broken(error, sink),
    };
    let asked = request.and_then(|bytes| Request::parse(bytes).ok()).and_then(|asked| asked.data);
    match &heard {
        Heard::Reply(reply) => {
            let Some((shape, meaning)) = reply.command.known() else {
                return foreign(bytes, sink);
            };
            sink.kind(reply.command.letters().as_str());
            head(reply.command, reply.sub, meaning, sink);
            if reply.data == REFUSED && asked != Some(reply.data) {
                field(sink, "error", (4, 8), Value::Hex(REFUSED.into(), 4), "refused");
            } else if matches!(shape, Shape::Query | Shape::Set) {
                value(reply.command, reply.sub, reply.data, readings, sink);
            }
        }
        Heard::Report(report) => show_report(report, readings, sink),
        Heard::Bare(bare) => show_bare(bare, sink),
    }
    talk::found(&heard, asked, profile, sink);
    text::write_heard(&heard, asked, readings, &mut |piece| sink.text(piece));
    if let Heard::Reply(reply) = heard
        && let Some(remark) = remark(&reply, asked)
    {
        sink.text(" (");
        sink.text(remark);
        sink.text(")");
    }
}

/// What is odd about a reply to that request.
fn remark(reply: &Reply, asked: Option<u32>) -> Option<&'static str> {
    let set = matches!(reply.command.known(), Some((Shape::Set, _)));
    let odd = set && reply.data != REFUSED && asked.is_some_and(|asked| asked != reply.data);
    if !odd {
        return None;
    }
    Some(match reply.command {
        Command::TC | Command::VC if reply.data == 0 => "not what was asked: stopped",
        Command::TC | Command::VC => "not what was asked: not accepted",
        _ => "not what was asked",
    })
}

fn field(
    sink: &mut dyn Sink,
    name: &'static str,
    (start, end): (u16, u16),
    value: Value<'_>,
    meaning: &'static str,
) {
    sink.field(Field { name, start, end, value, meaning });
}

/// The command with its speed or type.
fn head(command: Command, sub: u16, meaning: &'static str, sink: &mut dyn Sink) {
    let letters = command.letters();
    field(sink, "command", (0, 2), Value::Text(letters.as_str()), meaning);
    match command {
        Command::LA | Command::LR => field(sink, "rpm", (2, 4), Value::Int(sub.into()), "speed"),
        Command::SP | Command::RP => {
            let meaning = if sub == RANGE { "safe range" } else { "internal" };
            field(sink, "type", (2, 4), Value::Hex(sub.into(), 4), meaning);
        }
        _ if sub != 0 => field(sink, "sub_command", (2, 4), Value::Hex(sub.into(), 4), "not zero"),
        _ => {}
    }
}

/// The four data bytes by what the command makes of them.
fn value(command: Command, sub: u16, data: u32, readings: Readings, sink: &mut dyn Sink) {
    let tenths = |raw: i64| Value::Real(raw as f64 / 10.0);
    match command {
        Command::SP | Command::RP if sub == RANGE => {
            let (reverse, forward) = ends(data);
            field(sink, "reverse_deg", (4, 6), tenths(reverse.into()), "");
            field(sink, "forward_deg", (6, 8), tenths(forward.into()), "");
        }
        Command::SP | Command::RP => {
            field(sink, "value", (4, 8), Value::Hex(data.into(), 8), "");
            field(sink, "as_integer", (4, 8), Value::Int(data.cast_signed().into()), "");
            field(sink, "as_float", (4, 8), Value::Real(f32::from_bits(data).into()), "");
        }
        Command::EF | Command::FR => faults(data as u16, (6, 8), "value", sink),
        Command::VM => {
            let value = data as u16;
            let meaning = text::form_text(readings.form(value));
            field(sink, "flags", (6, 7), Value::Hex((value >> 8).into(), 2), meaning);
            field(sink, "frames", (7, 8), Value::Hex((value & 0xFF).into(), 2), "");
        }
        Command::SR => {
            field(sink, "frames", (5, 6), Value::Hex((data >> 16 & 0xFF).into(), 2), "");
            field(sink, "interval_ms", (6, 8), Value::Int((data & 0xFFFF).into()), "");
        }
        Command::LA | Command::LR => {
            let position = command.width().read(data);
            field(sink, "deg", (4, 8), tenths(position), "");
        }
        _ => {
            let Measure { unit, tenths: by_ten } = Measure::of_command(command);
            let raw = command.width().read(data);
            let shown = if by_ten { tenths(raw) } else { Value::Int(raw) };
            let start = if data >> 16 == 0 { 6 } else { 4 };
            field(sink, "value", (start, 8), shown, unit);
        }
    }
}

/// A fault word and its bits.
fn faults(word: u16, range: (u16, u16), name: &'static str, sink: &mut dyn Sink) {
    let meaning = if word == 0 { "no fault" } else { "" };
    field(sink, name, range, Value::Hex(word.into(), 4), meaning);
    for bit in fault::named(word) {
        let number = bit.mask.trailing_zeros();
        field(sink, bit.field, range, Value::Int(number.into()), bit.name);
    }
}

fn show_report(report: &Report, readings: Readings, sink: &mut dyn Sink) {
    let kind = match report.of {
        b'T' => "TC report",
        b'V' => "VC report",
        _ => "SR report",
    };
    sink.kind(kind);
    field(sink, "frame", (1, 2), Value::Int(report.part.into()), "");
    let [a, b, c] = report.words;
    let signed = |word: u16| i64::from(word.cast_signed());
    let tenths = |raw: i64| Value::Real(raw as f64 / 10.0);
    match report.part {
        1 => {
            field(sink, "rpm", (2, 4), Value::Int(signed(a)), "speed");
            field(sink, "volt", (4, 6), tenths(b.into()), "");
            field(sink, "amp", (6, 8), tenths(signed(c)), "");
        }
        2 => {
            faults(a, (2, 4), "status", sink);
            field(sink, "motor_c", (4, 6), Value::Int(signed(b)), "motor temperature");
            field(sink, "driver_c", (6, 8), Value::Int(signed(c)), "driver temperature");
        }
        _ => {
            let (absolute, relative) = readings.positions(report);
            let cut = if readings.even_positions { 5 } else { 4 };
            field(sink, "absolute_deg", (2, cut), tenths(absolute.into()), "");
            field(sink, "relative_deg", (cut, 8), tenths(relative.into()), "");
        }
    }
}

fn show_bare(bare: &Bare, sink: &mut dyn Sink) {
    sink.kind("report");
    let Bare { rpm, decivolt, deciamp, status } = *bare;
    let tenths = |raw: i64| Value::Real(raw as f64 / 10.0);
    field(sink, "rpm", (0, 2), Value::Int(rpm.into()), "speed");
    field(sink, "volt", (2, 4), tenths(decivolt.into()), "");
    field(sink, "amp", (4, 6), tenths(deciamp.into()), "");
    faults(status, (6, 8), "status", sink);
}
