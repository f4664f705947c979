//! Datagrams in their conversation: who speaks, what is owed, which values are told.

use super::{Present, ascii_line, is_reply, parameter_of, unchecked_reply, unchecked_request};
use crate::explain::{
    Awaits, Context, Direction, Effect, Label, Raw, Reading, Sink, Talk, Turn, What,
};
use crate::profile::{Parameter, Profile, Signal};
use crate::proto::tmcl::ascii;
use crate::proto::tmcl::opcode::{Opcode, Status};
use crate::proto::tmcl::wire::{CAN_DATAGRAM, DATAGRAM, HOST, Reply, Request, VersionText};

/// What stands in the place of a motor and is less is one: opcodes from here on are no motors.
const MOTORS_MAX: u8 = 4;

pub(super) fn turn(frame: &Raw<'_>, talk: &Talk<'_>) -> Turn {
    let reply = match (talk.direction, frame.id) {
        (Some(direction), _) => direction == Direction::ToHost,
        (None, Some(id)) => is_can_reply(frame.bytes, id),
        (None, None) => {
            talk.open.is_some_and(|open| answers(frame, &open)) || is_serial_reply(frame.bytes)
        }
    };
    match (reply, status(frame)) {
        (true, Some(Status::Event)) => Turn::Tells,
        (true, _) => Turn::Answers,
        (false, _) => Turn::Asks(awaits(frame)),
    }
}

/// A module that resets or goes into its bootloader may have no time to say so.
fn awaits(request: &Raw<'_>) -> Awaits {
    match asked(request).map(|request| request.opcode) {
        Some(Opcode::Boot | Opcode::BootStart) => Awaits::NOTHING,
        Some(Opcode::SoftwareReset | Opcode::EnterAscii) => Awaits::PERHAPS,
        _ => Awaits::ANSWER,
    }
}

/// A reply names its module and the opcode that it answers; the version as text names neither, and
/// a line of ASCII mode no opcode.
pub(super) fn answers(frame: &Raw<'_>, request: &Raw<'_>) -> bool {
    if frame.id.is_some() != request.id.is_some() {
        return false;
    }
    if let Some(answer) = line(frame).and_then(ascii::Answer::parse) {
        let asked = line(request).and_then(ascii::Command::parse);
        return asked.is_some_and(|(address, _)| address == answer.module);
    }
    let Some(asked) = asked(request) else { return false };
    let is_text = asked.opcode == Opcode::Version && asked.kind == 0;
    if is_text && version(frame) {
        return true;
    }
    let same_id = frame.id.is_some() && frame.id == request.id;
    replied(frame).is_some_and(|reply| {
        !same_id && reply.module == asked.address && reply.opcode == asked.opcode
    })
}

/// RSAP, RSGP and FACTORY DEFAULT bring back what is kept; instructions go into permanent memory
/// while a program is loaded.
pub(super) fn effect(frame: &Raw<'_>, profile: Option<&'static Profile>) -> Effect {
    use Opcode as O;
    let Some(request) = asked(frame) else { return Effect::UNKNOWN };
    match request.opcode {
        O::Mst => Effect::NOTHING,
        O::Ror | O::Rol if request.value == 0 => Effect::NOTHING,
        O::Sap | O::Sgp => Effect::of_writing(parameter_of(&request, profile)),
        O::Sio => Effect::SETS,
        O::Stap | O::Rsap | O::Stgp | O::Rsgp | O::FactoryDefault => Effect::KEEPS,
        O::DownloadStart | O::DownloadEnd | O::Boot | O::BootErase => Effect::KEEPS,
        O::BootWriteBuffer | O::BootWritePage | O::BootWriteLength => Effect::KEEPS,
        opcode if opcode.only_reads() => Effect::NOTHING,
        opcode if opcode.is_named() => Effect::MOVES,
        _ => Effect::UNKNOWN,
    }
}

pub(super) fn refuses(answer: &Raw<'_>) -> Option<&'static str> {
    let status = status(answer)?;
    let refused = !status.is_good() && status != Status::Event && status != Status::Busy;
    (refused && status.is_named()).then(|| status.text())
}

/// On CAN nothing but their shape tells requests from replies to a host that is not at its usual
/// address: a reply has a good status where a request has its type, and an opcode for a motor.
pub(super) fn is_can_reply(data: &[u8], id: u32) -> bool {
    let shaped = |data: &[u8]| {
        let good = Status::from(data[1]).is_good();
        good && data[2] >= MOTORS_MAX && Opcode::from(data[2]).is_named()
    };
    id == u32::from(HOST)
        || (data.len() >= CAN_DATAGRAM && shaped(data) && u32::from(data[0]) != id)
}

fn is_serial_reply(bytes: &[u8]) -> bool {
    match ascii_line(bytes) {
        Some(end) => ascii::Answer::parse(&bytes[..end - 1]).is_some(),
        None => bytes
            .first_chunk::<DATAGRAM>()
            .is_some_and(|whole| is_reply(whole, &Context::default())),
    }
}

fn line<'a>(frame: &Raw<'a>) -> Option<&'a [u8]> {
    let end = ascii_line(frame.bytes).filter(|_| frame.id.is_none())?;
    frame.bytes.get(..end - 1)
}

fn asked(request: &Raw<'_>) -> Option<Request> {
    match request.id {
        Some(id) => Request::parse_can(request.bytes, id as u8).ok(),
        None => match line(request) {
            Some(line) => match ascii::Command::parse(line)? {
                (_, ascii::Command::Request(request)) => Some(request),
                _ => None,
            },
            None => Some(unchecked_request(request.bytes.first_chunk()?)),
        },
    }
}

fn replied(frame: &Raw<'_>) -> Option<Reply> {
    match frame.id {
        Some(_) => Reply::parse_can(frame.bytes, HOST).ok(),
        None => frame.bytes.first_chunk().map(unchecked_reply),
    }
}

fn status(frame: &Raw<'_>) -> Option<Status> {
    match line(frame) {
        Some(line) => ascii::Answer::parse(line).map(|answer| answer.status),
        None if version(frame) => None,
        None => replied(frame).map(|reply| reply.status),
    }
}

fn version(frame: &Raw<'_>) -> bool {
    let text = match frame.id {
        Some(_) => VersionText::parse_can(frame.bytes, HOST),
        None if Request::parse(frame.bytes).is_ok() => return false,
        None => VersionText::parse(frame.bytes),
    };
    text.is_ok_and(|version| version.text.contains(&b'V'))
}

/// Set-points and settings that a request carries.
pub(super) fn told(request: &Request, profile: Option<&'static Profile>, sink: &mut dyn Sink) {
    let Request { opcode, kind, motor, value, .. } = *request;
    let raw = i64::from(value);
    let signal = |signal| of_signal(profile, signal);
    match opcode {
        Opcode::Ror => aim(signal(Signal::TargetVelocity), "target velocity", raw, motor, sink),
        Opcode::Rol => aim(signal(Signal::TargetVelocity), "target velocity", -raw, motor, sink),
        Opcode::Mst => aim(signal(Signal::TargetVelocity), "target velocity", 0, motor, sink),
        Opcode::Mvp if kind == 0 => {
            aim(signal(Signal::TargetPosition), "target position", raw, motor, sink);
        }
        Opcode::Sap | Opcode::Sgp => value_of(request, raw, true, profile, sink),
        _ => {}
    }
}

/// What a parameter was found to be.
pub(super) fn found(
    asked: &Request,
    reply: &Reply,
    profile: Option<&'static Profile>,
    sink: &mut dyn Sink,
) {
    let reads = matches!(asked.opcode, Opcode::Gap | Opcode::Ggp);
    if reads && reply.opcode == asked.opcode && reply.status == Status::Ok {
        value_of(asked, reply.value.into(), false, profile, sink);
    }
}

fn of_signal(profile: Option<&'static Profile>, signal: Signal) -> Option<&'static Parameter> {
    let profile = profile?;
    profile.parameter(profile.signal(signal)?.parameter)
}

fn aim(parameter: Option<&'static Parameter>, name: &str, raw: i64, part: u8, sink: &mut dyn Sink) {
    let what = parameter.map_or(What::Named(name), What::Parameter);
    sink.reading(Reading { what, raw, written: true, part });
}

fn value_of(
    request: &Request,
    raw: i64,
    written: bool,
    profile: Option<&'static Profile>,
    sink: &mut dyn Sink,
) {
    let Request { opcode, kind, motor, .. } = *request;
    let of_axis = matches!(opcode, Opcode::Sap | Opcode::Gap);
    let part = if of_axis { motor } else { 0 };
    if let Some(parameter) = parameter_of(request, profile) {
        let what = What::Parameter(parameter);
        return sink.reading(Reading { what, raw, written, part });
    }
    let label = match of_axis {
        true => Label::of(format_args!("AP {kind}")),
        false => Label::of(format_args!("GP {motor}, {kind}")),
    };
    sink.reading(Reading { what: What::Named(label.as_str()), raw, written, part });
}

impl Present<'_> {
    /// Values stand at the end of a datagram: they are there when it is whole.
    pub(super) fn pass(&mut self, reading: Reading<'_>) {
        if self.text {
            self.sink.reading(reading);
        }
    }
}
