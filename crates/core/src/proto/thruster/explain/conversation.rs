//! Frames in their conversation: sender, expected reply by the active VM, values.

use super::interpretation_of;
use crate::explain::{
    ConversationContext, Effect, ExplainSink, FrameRole, FrameValue, Impact, NumberPlace, RawFrame,
    ReplyCount, ReplyExpectation, ValueSource,
};
use crate::profile::Profile;
use crate::proto::thruster::interpretation::{Interpretation, ReplyFormat, is_command};
use crate::proto::thruster::rules::{self, class_of};
use crate::proto::thruster::text::measured_number;
use crate::proto::thruster::wire::{
    CommandKind, CommandWord, DriveMessage, HeaderlessReport, REFUSED, Reply, ReportFrame, Request,
    node_of_id,
};

pub(super) fn frame_role(frame: &RawFrame<'_>, talk: &ConversationContext<'_>) -> FrameRole {
    match frame.id.filter(|_| !frame.extended).and_then(node_of_id) {
        Some(Ok(_)) => FrameRole::Request(expected_replies(frame, talk)),
        Some(Err(_)) => match DriveMessage::parse(frame.bytes) {
            Ok(DriveMessage::Report(ReportFrame { source: ReportFrame::UNSOLICITED, .. })) => {
                FrameRole::Report
            }
            // ML and MM start unsolicited reports of these.
            Ok(DriveMessage::Reply(Reply {
                command: CommandWord::QC | CommandWord::QV, ..
            })) => FrameRole::Report,
            Ok(DriveMessage::Reply(reply)) if reply.command.definition().is_none() => {
                FrameRole::Unrelated
            }
            Ok(_) => FrameRole::Answer,
            Err(_) => FrameRole::Unrelated,
        },
        None => FrameRole::Unrelated,
    }
}

/// An unknown command of this protocol may belong to another one on the same identifiers.
pub(super) fn effect_of(frame: &RawFrame<'_>) -> Effect {
    match (frame.id.filter(|_| !frame.extended).and_then(node_of_id), Request::parse(frame.bytes)) {
        (Some(Err(_)), _) => Effect::NOTHING,
        (Some(Ok(_)), Ok(request)) if request.command.definition().is_some() => {
            let stores = rules::is_stored(&request);
            let act = if stores {
                Impact::Settings
            } else {
                Effect::from_class(class_of(&request)).impact
            };
            Effect { impact: act, persistent: stores }
        }
        _ => Effect::UNKNOWN,
    }
}

fn expected_replies(request: &RawFrame<'_>, talk: &ConversationContext<'_>) -> ReplyExpectation {
    match Request::parse(request.bytes) {
        Ok(request) if request.command.is_output() => expected_output_replies(reply_format(talk)),
        Ok(request) if request.command.definition().is_some() => ReplyExpectation::ONE_ANSWER,
        _ => ReplyExpectation::NONE,
    }
}

/// Expected replies to TC and VC, by VM; not known before a VM was seen.
fn expected_output_replies(form: Option<ReplyFormat>) -> ReplyExpectation {
    match form {
        None => ReplyExpectation::UNKNOWN,
        Some(ReplyFormat::Silent) => ReplyExpectation::NONE,
        Some(ReplyFormat::Echo | ReplyFormat::Headerless) => ReplyExpectation::ONE_ANSWER,
        Some(ReplyFormat::Frames(frames)) => ReplyExpectation {
            acks: ReplyCount::Zero,
            answers: ReplyCount::Exactly(frames.count_ones() as u8),
        },
    }
}

fn reply_format(talk: &ConversationContext<'_>) -> Option<ReplyFormat> {
    let request = Request::parse(talk.format_request?.bytes).ok()?;
    Some(interpretation_of(talk.profile).reply_format(request.data? as u16))
}

pub(super) fn sets_reply_format(request: &RawFrame<'_>) -> bool {
    Request::parse(request.bytes).is_ok_and(|r| r.command == CommandWord::VM && r.data.is_some())
}

/// The value that means refusal, or a setting that comes back as another than was sent.
pub(super) fn refusal_reason(
    answer: &RawFrame<'_>,
    request: &RawFrame<'_>,
) -> Option<&'static str> {
    let Ok(DriveMessage::Reply(reply)) = DriveMessage::parse(answer.bytes) else { return None };
    let requested = Request::parse(request.bytes).ok()?.data;
    if reply.data == REFUSED && requested != Some(REFUSED) {
        return Some("refused: a fault, an output that is forbidden, or a bad value");
    }
    let set = matches!(reply.command.definition(), Some((CommandKind::Set, _)));
    let other = requested.is_some_and(|requested| {
        decode_value(requested, &reply.command) != decode_value(reply.data, &reply.command)
    });
    (set && other).then_some("not what was asked: not accepted, or stopped")
}

fn decode_value(data: u32, reply_command: &CommandWord) -> i64 {
    reply_command.width().decode(data)
}

/// From power-up a drive repeats TC and VC; one that VM had set to something else and that repeats them has restarted.
pub(super) fn shows_restart(
    answer: &RawFrame<'_>,
    request: &RawFrame<'_>,
    talk: &ConversationContext<'_>,
) -> bool {
    let output = Request::parse(request.bytes).is_ok_and(|requested| requested.command.is_output());
    let reported = reply_format(talk).is_some_and(|form| form != ReplyFormat::Echo);
    let repeats = matches!(
        DriveMessage::parse(answer.bytes),
        Ok(DriveMessage::Reply(Reply { command, data, .. })) if command.is_output() && data != REFUSED
    );
    output && reported && repeats
}

/// Reports the values that a request sets.
pub(super) fn report_request_values(
    request: &Request,
    profile: Option<&'static Profile>,
    sink: &mut dyn ExplainSink,
) {
    let set = matches!(request.command.definition(), Some((CommandKind::Set, _)));
    if let (true, Some(data)) = (set && request.command != CommandWord::SP, request.data) {
        emit_frame_value(
            request.command,
            request.command.width().decode(data),
            true,
            None,
            profile,
            sink,
        );
    }
}

/// Reports the values in a message of a drive.
pub(super) fn report_message_values(
    message: &DriveMessage,
    requested: Option<u32>,
    profile: Option<&'static Profile>,
    sink: &mut dyn ExplainSink,
) {
    let mut say =
        |command: CommandWord, raw: i64| emit_frame_value(command, raw, false, None, profile, sink);
    match message {
        DriveMessage::Reply(reply) => {
            let Reply { command, data, .. } = reply;
            if let Some((raw, _, place)) = measured_number(reply) {
                return emit_frame_value(*command, raw, false, Some(place), profile, sink);
            }
            let query = matches!(command.definition(), Some((CommandKind::Query, _)));
            let refused = *data == REFUSED && requested != Some(REFUSED);
            if query && !refused && *command != CommandWord::RP {
                say(*command, command.width().decode(*data));
            }
        }
        DriveMessage::Report(report) => {
            visit_report_values(report, interpretation_of(profile), &mut say)
        }
        DriveMessage::Headerless(HeaderlessReport { rpm, decivolt, deciamp, status }) => {
            say(CommandWord::QV, (*rpm).into());
            say(CommandWord::QP, (*decivolt).into());
            say(CommandWord::QC, (*deciamp).into());
            say(CommandWord::EF, (*status).into());
        }
    }
}

fn visit_report_values(
    report: &ReportFrame,
    readings: Interpretation,
    say: &mut dyn FnMut(CommandWord, i64),
) {
    let [a, b, c] = report.words;
    match report.part {
        1 => {
            say(CommandWord::QV, signed_word(a));
            say(CommandWord::QP, b.into());
            say(CommandWord::QC, signed_word(c));
        }
        2 => {
            say(CommandWord::EF, a.into());
            say(CommandWord::QT, signed_word(b));
            say(CommandWord::EQ, signed_word(c));
        }
        _ => {
            let (absolute, relative) = readings.positions(report);
            say(CommandWord::QA, absolute.into());
            say(CommandWord::QR, relative.into());
        }
    }
}

fn signed_word(word: u16) -> i64 {
    i64::from(word.cast_signed())
}

fn emit_frame_value(
    command: CommandWord,
    raw: i64,
    written: bool,
    place: Option<NumberPlace>,
    profile: Option<&'static Profile>,
    sink: &mut dyn ExplainSink,
) {
    let mut parameters = profile.into_iter().flat_map(|profile| profile.parameters);
    let parameter = parameters.find(|parameter| is_command(parameter, command));
    let letters = command.letters();
    let what = parameter.map_or(ValueSource::Named(letters.as_str()), ValueSource::Parameter);
    let reading = FrameValue { source: what, raw, written, motor: 0 };
    match place {
        Some(place) => sink.number_value(reading, place),
        None => sink.frame_value(reading),
    }
}
