//! Datagrams in their conversation: sender, expected reply, values.

use super::{
    MOTORS_MAX, PartialFrameSink, ascii_line_len, is_reply, parameter_of, unchecked_reply,
    unchecked_request,
};
use crate::explain::{
    Context, ConversationContext, Direction, Effect, ExplainSink, FrameRole, FrameValue,
    NumberPlace, RawFrame, ReplyExpectation, ShortText, ValueSource,
};
use crate::profile::{Parameter, Profile, Signal};
use crate::proto::tmcl::ascii;
use crate::proto::tmcl::opcode::{Opcode, SEARCH_STATUS, Status};
use crate::proto::tmcl::wire::{CAN_DATAGRAM, DATAGRAM, HOST, Reply, Request, VersionText};

pub(super) fn frame_role(frame: &RawFrame<'_>, talk: &ConversationContext<'_>) -> FrameRole {
    let reply = match (talk.direction, frame.id) {
        (Some(direction), _) => direction == Direction::ToHost,
        (None, Some(id)) => is_can_reply(frame.bytes, id),
        (None, None) => {
            talk.open_request.is_some_and(|open| is_answer_to(frame, &open))
                || is_serial_reply(frame.bytes)
        }
    };
    match (reply, reply_status(frame)) {
        (true, Some(Status::Event)) => FrameRole::Report,
        (true, _) => FrameRole::Answer,
        (false, _) => FrameRole::Request(expected_replies(frame)),
    }
}

/// A module that resets or enters its bootloader may send no reply.
fn expected_replies(request: &RawFrame<'_>) -> ReplyExpectation {
    match parse_request(request).map(|request| request.opcode) {
        Some(Opcode::Boot | Opcode::BootStart) => ReplyExpectation::NONE,
        Some(Opcode::SoftwareReset | Opcode::EnterAscii) => ReplyExpectation::UNKNOWN,
        _ => ReplyExpectation::ONE_ANSWER,
    }
}

/// A reply names its module and the opcode that it answers; the version as text names neither, and
/// a line of ASCII mode no opcode.
pub(super) fn is_answer_to(frame: &RawFrame<'_>, request: &RawFrame<'_>) -> bool {
    if frame.id.is_some() != request.id.is_some() {
        return false;
    }
    if let Some(answer) = ascii_line_of(frame).and_then(ascii::AsciiReply::parse) {
        let requested = ascii_line_of(request).and_then(ascii::AsciiCommand::parse);
        return requested.is_some_and(|(address, _)| address == answer.module);
    }
    let Some(asked) = parse_request(request) else { return false };
    let is_text = asked.opcode == Opcode::Version && asked.kind == 0;
    if is_text && is_version_reply(frame) {
        return true;
    }
    let same_id = frame.id.is_some() && frame.id == request.id;
    parse_reply(frame).is_some_and(|reply| {
        !same_id && reply.module == asked.address && reply.opcode == asked.opcode
    })
}

/// RSAP, RSGP and FACTORY DEFAULT restore stored values; instructions go into permanent memory
/// while a program is loaded.
pub(super) fn effect_of(frame: &RawFrame<'_>, profile: Option<&'static Profile>) -> Effect {
    use Opcode as O;
    let Some(request) = parse_request(frame) else { return Effect::UNKNOWN };
    match request.opcode {
        O::Mst => Effect::NOTHING,
        O::Ror | O::Rol if request.value == 0 => Effect::NOTHING,
        O::Rfs if request.kind == SEARCH_STATUS => Effect::NOTHING,
        O::PositionReached => Effect::NOTHING,
        O::Sap | O::Sgp => Effect::from_write(parameter_of(&request, profile)),
        O::Sio | O::Sco => Effect::SETTINGS,
        O::Stap | O::Rsap | O::Stgp | O::Rsgp | O::FactoryDefault => Effect::PERSISTENT,
        O::DownloadStart | O::DownloadEnd | O::Boot | O::BootErase => Effect::PERSISTENT,
        O::BootWriteBuffer | O::BootWritePage | O::BootWriteLength => Effect::PERSISTENT,
        opcode if opcode.only_reads() => Effect::NOTHING,
        opcode if opcode.is_named() => Effect::MOTION,
        _ => Effect::UNKNOWN,
    }
}

pub(super) fn refusal_reason(answer: &RawFrame<'_>) -> Option<&'static str> {
    let status = reply_status(answer)?;
    let refused = !status.is_good() && status != Status::Event && status != Status::Busy;
    (refused && status.is_named()).then(|| status.text())
}

/// Distinguishes requests on CAN from replies by shape alone: a reply has a status where a request has its type, and an
/// opcode for a motor. At the identifier of hosts a frame is a reply unless it cannot be one: a module may have that
/// identifier too. At others it has to have a good status.
pub(super) fn is_can_reply(data: &[u8], id: u32) -> bool {
    if data.len() < CAN_DATAGRAM {
        return id == u32::from(HOST);
    }
    if id == u32::from(HOST) {
        let is_version = data.len() == 8 && data.contains(&b'V') && data.is_ascii();
        // There is no checksum on CAN that could be wrong.
        let status = Status::from(data[1]);
        let has_status = status.is_named() && status != Status::WrongChecksum;
        return is_version
            || has_status && Opcode::from(data[2]).is_named()
            || !Opcode::from(data[0]).is_named();
    }
    is_reply_shaped(data) && u32::from(data[0]) != id
}

fn is_reply_shaped(data: &[u8]) -> bool {
    let good = Status::from(data[1]).is_good();
    good && data[2] >= MOTORS_MAX && Opcode::from(data[2]).is_named()
}

fn is_serial_reply(bytes: &[u8]) -> bool {
    match ascii_line_len(bytes) {
        Some(end) => ascii::AsciiReply::parse(&bytes[..end - 1]).is_some(),
        None => bytes
            .first_chunk::<DATAGRAM>()
            .is_some_and(|whole| is_reply(whole, &Context::default())),
    }
}

fn ascii_line_of<'a>(frame: &RawFrame<'a>) -> Option<&'a [u8]> {
    let end = ascii_line_len(frame.bytes).filter(|_| frame.id.is_none())?;
    frame.bytes.get(..end - 1)
}

fn parse_request(request: &RawFrame<'_>) -> Option<Request> {
    match request.id {
        Some(id) => Request::parse_can(request.bytes, id as u8).ok(),
        None => match ascii_line_of(request) {
            Some(line) => match ascii::AsciiCommand::parse(line)? {
                (_, ascii::AsciiCommand::Request(request)) => Some(request),
                _ => None,
            },
            None => Some(unchecked_request(request.bytes.first_chunk()?)),
        },
    }
}

fn parse_reply(frame: &RawFrame<'_>) -> Option<Reply> {
    match frame.id {
        Some(_) => Reply::parse_can(frame.bytes, HOST).ok(),
        None => frame.bytes.first_chunk().map(unchecked_reply),
    }
}

fn reply_status(frame: &RawFrame<'_>) -> Option<Status> {
    match ascii_line_of(frame) {
        Some(line) => ascii::AsciiReply::parse(line).map(|answer| answer.status),
        None if is_version_reply(frame) => None,
        None => parse_reply(frame).map(|reply| reply.status),
    }
}

fn is_version_reply(frame: &RawFrame<'_>) -> bool {
    let text = match frame.id {
        Some(_) => VersionText::parse_can(frame.bytes, HOST),
        None if Request::parse(frame.bytes).is_ok() => return false,
        None => VersionText::parse(frame.bytes),
    };
    text.is_ok_and(|version| version.text.contains(&b'V'))
}

/// Set-points and settings that a request carries.
pub(super) fn report_request_values(
    request: &Request,
    profile: Option<&'static Profile>,
    sink: &mut dyn ExplainSink,
) {
    let Request { opcode, kind, motor, value, .. } = *request;
    let raw = i64::from(value);
    match opcode {
        Opcode::Ror => report_setpoint(
            parameter_of_signal(Signal::TargetVelocity, profile),
            "target velocity",
            raw,
            motor,
            sink,
        ),
        Opcode::Rol => report_setpoint(
            parameter_of_signal(Signal::TargetVelocity, profile),
            "target velocity",
            -raw,
            motor,
            sink,
        ),
        Opcode::Mst => report_setpoint(
            parameter_of_signal(Signal::TargetVelocity, profile),
            "target velocity",
            0,
            motor,
            sink,
        ),
        Opcode::Mvp if kind == 0 => {
            report_setpoint(
                parameter_of_signal(Signal::TargetPosition, profile),
                "target position",
                raw,
                motor,
                sink,
            );
        }
        Opcode::Sap | Opcode::Sgp => report_parameter(request, raw, None, profile, sink),
        _ => {}
    }
}

fn parameter_of_signal(
    signal: Signal,
    profile: Option<&'static Profile>,
) -> Option<&'static Parameter> {
    signal_parameter(profile, signal)
}

/// Reports the value of a parameter in a reply, which is at `place`.
pub(super) fn report_reply_values(
    request: &Request,
    reply: &Reply,
    place: NumberPlace,
    profile: Option<&'static Profile>,
    sink: &mut dyn ExplainSink,
) {
    let reads = matches!(request.opcode, Opcode::Gap | Opcode::Ggp);
    if reads && reply.opcode == request.opcode && reply.status == Status::Ok {
        report_parameter(request, reply.value.into(), Some(place), profile, sink);
    }
}

fn signal_parameter(
    profile: Option<&'static Profile>,
    signal: Signal,
) -> Option<&'static Parameter> {
    let profile = profile?;
    profile.parameter(profile.signal(signal)?.parameter)
}

fn report_setpoint(
    parameter: Option<&'static Parameter>,
    name: &str,
    raw: i64,
    part: u8,
    sink: &mut dyn ExplainSink,
) {
    let what = parameter.map_or(ValueSource::Named(name), ValueSource::Parameter);
    sink.frame_value(FrameValue { source: what, raw, written: true, motor: part });
}

/// Reports the value of a parameter: a drive's at `place`, or without one a value that the host writes.
fn report_parameter(
    request: &Request,
    raw: i64,
    place: Option<NumberPlace>,
    profile: Option<&'static Profile>,
    sink: &mut dyn ExplainSink,
) {
    let Request { opcode, kind, motor, .. } = *request;
    let of_axis = matches!(opcode, Opcode::Sap | Opcode::Gap);
    let motor_part = if of_axis { motor } else { 0 };
    let label;
    let source = match parameter_of(request, profile) {
        Some(parameter) => ValueSource::Parameter(parameter),
        None => {
            label = match (of_axis, motor) {
                (true, _) => ShortText::from_display(format_args!("AP {kind}")),
                (false, 0) => ShortText::from_display(format_args!("GP {kind}")),
                (false, bank) => ShortText::from_display(format_args!("GP {kind}.{bank}")),
            };
            ValueSource::Named(label.as_str())
        }
    };
    let reading = FrameValue { source, raw, written: place.is_none(), motor: motor_part };
    match place {
        Some(place) => sink.number_value(reading, place),
        None => sink.frame_value(reading),
    }
}

impl PartialFrameSink<'_> {
    /// Values stand at the end of a datagram: they are there when it is whole.
    pub(super) fn forward_value(&mut self, reading: FrameValue<'_>) {
        if self.enough_for_text {
            self.sink.frame_value(reading);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::is_can_reply;

    /// Module 2 has the identifier that hosts have: shape decides.
    #[test]
    fn requests_to_module_2_are_no_replies_to_host_2() {
        for request in [
            [6, 1, 0, 0, 0, 0, 0],   // GAP 1, 0
            [5, 4, 0, 0, 0, 0, 100], // SAP 4, 0, 100
            [1, 0, 0, 0, 0, 1, 44],  // ROR 0, 300
            [4, 1, 2, 0, 0, 0, 9],   // MVP REL, 2, 9
            [136, 1, 0, 0, 0, 0, 0], // GET VERSION 1
            [9, 77, 0, 0, 0, 0, 1],  // SGP 77
        ] {
            assert!(!is_can_reply(&request, 2), "{request:?}");
        }
        for reply in [
            [1, 100, 6, 0, 0, 0, 7],
            [3, 100, 136, 4, 0xEC, 1, 9],
            [1, 3, 6, 0, 0, 0, 0],
            [5, 4, 5, 0, 0, 0, 100],
            [200, 128, 138, 0, 0, 0, 1],
        ] {
            assert!(is_can_reply(&reply, 2), "{reply:?}");
        }
        assert!(is_can_reply(b"1140V148", 2));
        // Elsewhere a good status is needed.
        assert!(
            is_can_reply(&[1, 100, 6, 0, 0, 0, 7], 3) && !is_can_reply(&[1, 3, 6, 0, 0, 0, 0], 3)
        );
    }
}
