//! Explains frames: fields and meaning.
//!
//! A single frame does not show whether it belongs to a thruster or to a CANopen node: the identifiers are
//! those of PDO2, and mapped values can have any bytes. Therefore these identifiers are claimed as shared,
//! and decoded only if the user states the protocol (`--as thruster@11`).

mod conversation;

use super::fault;
use super::interpretation::Interpretation;
use super::rules::{self, range_ends};
use super::text::{self, CountUnit, Statement};
use super::wire::{
    CommandKind, CommandWord, DriveMessage, HeaderlessReport, RANGE_PARAMETER, REFUSED, Reply,
    ReportFrame, Request, TO_DRIVE, TO_HOST, node_of_id,
};
use crate::error::WireError;
use crate::explain::{
    Context, ConversationContext, Direction, Dissector, DriveFacts, Effect, EncodeError,
    EncodeOptions, EncodedFrame, ExplainSink, Field, FieldValue, FrameBoundary, FrameConversation,
    FrameFormat, FrameRole, RawFrame, TextError,
};
use crate::profile::Profile;

/// The protocol in captures, dashboards and the encoder.
#[derive(Clone, Copy, Debug)]
pub struct ThrusterDissector;

/// The id in the manual's examples.
const EXAMPLE_ID: u32 = 11;

impl FrameFormat for ThrusterDissector {
    fn find_frame(
        &self,
        bytes: &[u8],
        _direction: Option<Direction>,
        _ended: bool,
    ) -> FrameBoundary {
        if bytes.is_empty() { FrameBoundary::Incomplete } else { FrameBoundary::Skip(bytes.len()) }
    }

    fn claims_id(&self, id: u32, extended: bool) -> bool {
        !extended && node_of_id(id).is_some()
    }

    fn shares_id(&self, id: u32, extended: bool) -> bool {
        self.claims_id(id, extended)
    }

    fn content_evidence(&self, frame: &RawFrame<'_>) -> Option<bool> {
        // Elmo's drives have commands of two letters on the same identifiers.
        let [letters @ .., _, _] = frame.bytes.first_chunk::<4>()?;
        let is_word = letters.iter().all(u8::is_ascii_uppercase);
        (is_word && CommandWord::of(*letters).definition().is_none()).then_some(false)
    }
}

impl FrameConversation for ThrusterDissector {
    fn is_request(&self, frame: &RawFrame<'_>) -> bool {
        frame.id.and_then(node_of_id).is_some_and(|position| position.is_ok()) && !frame.extended
    }

    fn is_plain_request(&self, frame: &RawFrame<'_>) -> bool {
        self.is_request(frame)
    }

    fn is_answer_to(&self, frame: &RawFrame<'_>, request: &RawFrame<'_>) -> bool {
        let (Some(Err(from)), Some(Ok(to))) =
            (frame.id.and_then(node_of_id), request.id.and_then(node_of_id))
        else {
            return false;
        };
        from == to && is_answer(frame.bytes, request.bytes)
    }

    fn role(&self, frame: &RawFrame<'_>, talk: &ConversationContext<'_>) -> FrameRole {
        conversation::frame_role(frame, talk)
    }

    fn effect(&self, frame: &RawFrame<'_>, _: Option<&'static Profile>) -> Effect {
        conversation::effect_of(frame)
    }

    fn refusal_reason(
        &self,
        answer: &RawFrame<'_>,
        request: &RawFrame<'_>,
    ) -> Option<&'static str> {
        conversation::refusal_reason(answer, request)
    }

    fn sets_reply_format(&self, request: &RawFrame<'_>) -> bool {
        conversation::sets_reply_format(request)
    }

    fn shows_restart(
        &self,
        answer: &RawFrame<'_>,
        request: &RawFrame<'_>,
        talk: &ConversationContext<'_>,
    ) -> bool {
        conversation::shows_restart(answer, request, talk)
    }
}

impl DriveFacts for ThrusterDissector {}

impl Dissector for ThrusterDissector {
    fn name(&self) -> &'static str {
        "thruster"
    }

    fn explain(&self, bytes: &[u8], context: &Context<'_>, sink: &mut dyn ExplainSink) {
        let position = context.id.and_then(node_of_id).filter(|_| !context.extended);
        match position {
            Some(Ok(id) | Err(id)) => sink.axis(id.into()),
            None => {
                sink.kind("thruster");
                let found = context.id.unwrap_or(0);
                return sink.error(WireError::Identifier { found });
            }
        }
        if matches!(position, Some(Ok(_))) {
            explain_request(bytes, context.profile, sink);
        } else {
            explain_drive_message(bytes, context.request, context.profile, sink);
        }
    }

    fn encode(
        &self,
        text: &str,
        addressing: &EncodeOptions,
        out: &mut [u8],
    ) -> Result<EncodedFrame, EncodeError> {
        let expected = "an id, 1 to 127";
        let axis = addressing.axis.unwrap_or(EXAMPLE_ID);
        let id = u8::try_from(axis).ok().filter(|id| (1..=127).contains(id));
        let id = id.ok_or(TextError { at: 0, expected })?;
        let statement = text::parse(text, interpretation_of(addressing.profile))?;
        let frame = match statement {
            Statement::Request(request) => request.frame(id),
            Statement::FromDrive(DriveMessage::Reply(reply)) => reply.frame(id),
            Statement::FromDrive(DriveMessage::Report(report)) => report.frame(id),
            Statement::FromDrive(DriveMessage::Headerless(bare)) => bare.frame(id),
            Statement::Raw { reply, bytes, len } => {
                let base = if reply { TO_HOST } else { TO_DRIVE };
                let id = base + u16::from(id);
                crate::medium::Frame::standard(id, &bytes[..usize::from(len)])
            }
        };
        let error = TextError { at: 0, expected: "room for eight bytes" };
        out.get_mut(..frame.bytes().len()).ok_or(error)?.copy_from_slice(frame.bytes());
        let request = frame.id >= TO_DRIVE.into();
        Ok(EncodedFrame {
            len: frame.bytes().len(),
            id: Some(frame.id),
            extended: false,
            remote_len: None,
            answer_len: request.then_some(8),
            warning: warning_for(&statement),
        })
    }

    fn code_meaning(&self, code: u32) -> Option<&'static str> {
        (code == REFUSED).then_some("refused: a fault, an output that is forbidden, or a bad value")
    }

    fn explains_by_name(&self) -> bool {
        true
    }

    fn explain_expected_reply(
        &self,
        request: &RawFrame<'_>,
        addressing: &EncodeOptions,
        sink: &mut dyn ExplainSink,
    ) {
        let Ok(requested) = Request::parse(request.bytes) else { return };
        let data = match requested.command.definition() {
            Some((CommandKind::Query, _)) | None => return,
            _ => requested.value(),
        };
        let Some(Ok(id)) = request.id.and_then(node_of_id) else { return };
        let Request { command, sub, .. } = requested;
        sink.axis(id.into());
        let echo = Reply { command, sub, data }.frame(id);
        explain_drive_message(echo.bytes(), Some(request.bytes), addressing.profile, sink);
    }
}

fn interpretation_of(profile: Option<&'static Profile>) -> Interpretation {
    let own = profile.filter(|profile| profile.protocol == "thruster");
    own.map_or(Interpretation::default(), Interpretation::of)
}

/// Returns whether a reply belongs to a request: it repeats four bytes, or reports on TC and VC.
fn is_answer(reply: &[u8], request: &[u8]) -> bool {
    let (Ok(message), Ok(request)) = (DriveMessage::parse(reply), Request::parse(request)) else {
        return false;
    };
    match message {
        DriveMessage::Reply(reply) => reply.command == request.command && reply.sub == request.sub,
        DriveMessage::Report(report) => {
            let [letter, _] = request.command.0.to_be_bytes();
            request.command.is_output() && report.source == letter
        }
        DriveMessage::Headerless(_) => request.command.is_output(),
    }
}

fn warning_for(statement: &Statement) -> &'static str {
    match statement {
        Statement::Request(request)
            if request.command == CommandWord::SP && request.sub != RANGE_PARAMETER =>
        {
            "internal parameters are the maker's: ask him before writing one"
        }
        Statement::Request(request) if request.command == CommandWord::LR && request.sub != 0 => {
            "each one that is sent adds to the way"
        }
        _ => "",
    }
}

fn explain_request(bytes: &[u8], profile: Option<&'static Profile>, sink: &mut dyn ExplainSink) {
    let readings = interpretation_of(profile);
    let request = match Request::parse(bytes) {
        Ok(request) => request,
        Err(error) => return explain_broken(error, sink),
    };
    let Some((_, meaning)) = request.command.definition() else {
        return explain_foreign(bytes, sink);
    };
    sink.kind(request.command.letters().as_str());
    emit_head(request.command, request.sub, meaning, sink);
    conversation::report_request_values(&request, profile, sink);
    if let Some(data) = request.data {
        emit_value(request.command, request.sub, data, readings, sink);
    }
    if !sink.wants_text() {
        return;
    }
    text::write_request(&request, readings, &mut |piece| sink.text(piece));
    let remark = match rules::check(&request) {
        Err(rule) => rule,
        Ok(())
            if matches!(request.command, CommandWord::LA | CommandWord::LR) && request.sub == 0 =>
        {
            "speed 0: not started"
        }
        Ok(()) => meaning,
    };
    sink.text(" (");
    sink.text(remark);
    sink.text(")");
}

/// Explains a frame of another protocol on the same identifiers.
fn explain_foreign(bytes: &[u8], sink: &mut dyn ExplainSink) {
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

fn explain_broken(error: WireError, sink: &mut dyn ExplainSink) {
    sink.kind("thruster");
    sink.error(error);
}

fn explain_drive_message(
    bytes: &[u8],
    request: Option<&[u8]>,
    profile: Option<&'static Profile>,
    sink: &mut dyn ExplainSink,
) {
    let readings = interpretation_of(profile);
    let message = match DriveMessage::parse(bytes) {
        Ok(message) => message,
        Err(error) => return explain_broken(error, sink),
    };
    let requested =
        request.and_then(|bytes| Request::parse(bytes).ok()).and_then(|asked| asked.data);
    match &message {
        DriveMessage::Reply(reply) => {
            let Some((shape, meaning)) = reply.command.definition() else {
                return explain_foreign(bytes, sink);
            };
            sink.kind(reply.command.letters().as_str());
            emit_head(reply.command, reply.sub, meaning, sink);
            if let Some((raw, CountUnit { unit, tenths }, place)) = text::measured_number(reply) {
                let value = if tenths { tenths_value(raw) } else { FieldValue::Int(raw) };
                let field = Field { name: "value", start: 6, end: 8, value, meaning: unit };
                sink.number_field(field, place);
            } else if reply.data == REFUSED && requested != Some(reply.data) {
                emit_field(sink, "error", (4, 8), FieldValue::Hex(REFUSED.into(), 4), "refused");
            } else if matches!(shape, CommandKind::Query | CommandKind::Set) {
                emit_value(reply.command, reply.sub, reply.data, readings, sink);
            }
        }
        DriveMessage::Report(report) => explain_report(report, readings, sink),
        DriveMessage::Headerless(bare) => explain_headerless(bare, sink),
    }
    conversation::report_message_values(&message, requested, profile, sink);
    if !sink.wants_text() {
        return;
    }
    if let DriveMessage::Reply(reply) = &message
        && let Some((raw, count_unit, place)) = text::measured_number(reply)
    {
        sink.text(reply.command.letters().as_str());
        sink.text(" ");
        sink.number(raw, count_unit.style(), place);
        sink.text(if count_unit.unit.is_empty() { "" } else { " " });
        return sink.text(count_unit.unit);
    }
    text::write_drive_message(&message, requested, readings, &mut |piece| sink.text(piece));
    if let DriveMessage::Reply(reply) = message
        && let Some(remark) = reply_remark(&reply, requested)
    {
        sink.text(" (");
        sink.text(remark);
        sink.text(")");
    }
}

/// Remark on an unusual reply to a request.
fn reply_remark(reply: &Reply, requested: Option<u32>) -> Option<&'static str> {
    let set = matches!(reply.command.definition(), Some((CommandKind::Set, _)));
    let differs =
        set && reply.data != REFUSED && requested.is_some_and(|requested| requested != reply.data);
    if !differs {
        return None;
    }
    Some(match reply.command {
        CommandWord::TC | CommandWord::VC if reply.data == 0 => "not what was asked: stopped",
        CommandWord::TC | CommandWord::VC => "not what was asked: not accepted",
        _ => "not what was asked",
    })
}

fn emit_field(
    sink: &mut dyn ExplainSink,
    name: &'static str,
    range: (u16, u16),
    value: FieldValue<'_>,
    meaning: &'static str,
) {
    let (start, end) = range;

    sink.field(Field { name, start, end, value, meaning });
}

/// The command with its speed or type.
fn emit_head(command: CommandWord, sub: u16, meaning: &'static str, sink: &mut dyn ExplainSink) {
    let letters = command.letters();
    emit_field(sink, "command", (0, 2), FieldValue::Text(letters.as_str()), meaning);
    match command {
        CommandWord::LA | CommandWord::LR => {
            emit_field(sink, "rpm", (2, 4), FieldValue::Int(sub.into()), "speed")
        }
        CommandWord::SP | CommandWord::RP => {
            let meaning = if sub == RANGE_PARAMETER { "safe range" } else { "internal" };
            emit_field(sink, "type", (2, 4), FieldValue::Hex(sub.into(), 4), meaning);
        }
        _ if sub != 0 => {
            emit_field(sink, "sub_command", (2, 4), FieldValue::Hex(sub.into(), 4), "not zero")
        }
        _ => {}
    }
}

/// The four data bytes, by their command.
fn emit_value(
    command: CommandWord,
    sub: u16,
    data: u32,
    readings: Interpretation,
    sink: &mut dyn ExplainSink,
) {
    match command {
        CommandWord::SP | CommandWord::RP if sub == RANGE_PARAMETER => {
            let (reverse, forward) = range_ends(data);
            emit_field(sink, "reverse_deg", (4, 6), tenths_value(reverse.into()), "");
            emit_field(sink, "forward_deg", (6, 8), tenths_value(forward.into()), "");
        }
        CommandWord::SP | CommandWord::RP => {
            emit_field(sink, "value", (4, 8), FieldValue::Hex(data.into(), 8), "");
            emit_field(sink, "as_integer", (4, 8), FieldValue::Int(data.cast_signed().into()), "");
            emit_field(sink, "as_float", (4, 8), FieldValue::Real(f32::from_bits(data).into()), "");
        }
        CommandWord::EF | CommandWord::FR => emit_faults(data as u16, (6, 8), "value", sink),
        CommandWord::VM => {
            let value = data as u16;
            let meaning = text::format_text(readings.reply_format(value));
            emit_field(sink, "flags", (6, 7), FieldValue::Hex((value >> 8).into(), 2), meaning);
            emit_field(sink, "frames", (7, 8), FieldValue::Hex((value & 0xFF).into(), 2), "");
        }
        CommandWord::SR => {
            emit_field(sink, "frames", (5, 6), FieldValue::Hex((data >> 16 & 0xFF).into(), 2), "");
            emit_field(sink, "interval_ms", (6, 8), FieldValue::Int((data & 0xFFFF).into()), "");
        }
        CommandWord::LA | CommandWord::LR => {
            let position = command.width().decode(data);
            emit_field(sink, "deg", (4, 8), tenths_value(position), "");
        }
        _ => {
            let CountUnit { unit, tenths: by_ten } = CountUnit::of_command(command);
            let raw = command.width().decode(data);
            let shown = if by_ten { tenths_value(raw) } else { FieldValue::Int(raw) };
            let start = if data >> 16 == 0 { 6 } else { 4 };
            emit_field(sink, "value", (start, 8), shown, unit);
        }
    }
}

fn tenths_value(raw: i64) -> FieldValue<'static> {
    FieldValue::Real(raw as f64 / 10.0)
}

/// A fault word and its bits.
fn emit_faults(word: u16, range: (u16, u16), name: &'static str, sink: &mut dyn ExplainSink) {
    let meaning = if word == 0 { "no fault" } else { "" };
    emit_field(sink, name, range, FieldValue::Hex(word.into(), 4), meaning);
    for bit in fault::named_bits(word) {
        let number = bit.mask.trailing_zeros();
        emit_field(sink, bit.field, range, FieldValue::Int(number.into()), bit.name);
    }
}

fn explain_report(report: &ReportFrame, readings: Interpretation, sink: &mut dyn ExplainSink) {
    let kind = match report.source {
        b'T' => "TC report",
        b'V' => "VC report",
        _ => "SR report",
    };
    sink.kind(kind);
    emit_field(sink, "frame", (1, 2), FieldValue::Int(report.part.into()), "");
    let [a, b, c] = report.words;
    match report.part {
        1 => {
            emit_field(sink, "rpm", (2, 4), FieldValue::Int(signed_word(a)), "speed");
            emit_field(sink, "volt", (4, 6), tenths_value(b.into()), "");
            emit_field(sink, "amp", (6, 8), tenths_value(signed_word(c)), "");
        }
        2 => {
            emit_faults(a, (2, 4), "status", sink);
            emit_field(
                sink,
                "motor_c",
                (4, 6),
                FieldValue::Int(signed_word(b)),
                "motor temperature",
            );
            emit_field(
                sink,
                "driver_c",
                (6, 8),
                FieldValue::Int(signed_word(c)),
                "driver temperature",
            );
        }
        _ => {
            let (absolute, relative) = readings.positions(report);
            let cut = if readings.even_positions { 5 } else { 4 };
            emit_field(sink, "absolute_deg", (2, cut), tenths_value(absolute.into()), "");
            emit_field(sink, "relative_deg", (cut, 8), tenths_value(relative.into()), "");
        }
    }
}

fn signed_word(word: u16) -> i64 {
    i64::from(word.cast_signed())
}

fn explain_headerless(bare: &HeaderlessReport, sink: &mut dyn ExplainSink) {
    sink.kind("report");
    let HeaderlessReport { rpm, decivolt, deciamp, status } = *bare;
    emit_field(sink, "rpm", (0, 2), FieldValue::Int(rpm.into()), "speed");
    emit_field(sink, "volt", (2, 4), tenths_value(decivolt.into()), "");
    emit_field(sink, "amp", (4, 6), tenths_value(deciamp.into()), "");
    emit_faults(status, (6, 8), "status", sink);
}
