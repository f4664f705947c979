//! Messages in their conversation: sender, expected reply, values.

use super::layout::ParsedFrame;
use super::{message, names};
use crate::explain::{
    Direction, Effect, ExplainSink, FrameRole, FrameValue, ReplyCount, ReplyExpectation,
    SequencePosition, ShortText, ValueSource,
};
use crate::profile::{Encoding, Profile};
use crate::proto::tml::host_request::{assigned_variable, class_of};
use crate::proto::tml::online::{Cell, MemorySpace, OnlineMessage, PvtPoint};
use crate::proto::tml::rules;

pub(super) fn frame_role(
    parsed: &ParsedFrame,
    serial: bool,
    direction: Option<Direction>,
) -> FrameRole {
    let online = OnlineMessage::parse(&parsed.instruction);
    let answer = online.as_ref().is_some_and(is_answer);
    match (direction, answer) {
        (Some(Direction::ToDrive), _) | (None, false) => {
            FrameRole::Request(expected_replies(parsed, serial))
        }
        (_, true) if matches!(online, Some(OnlineMessage::TakeData2 { .. })) => FrameRole::Report,
        (_, true) => FrameRole::Answer,
        (Some(Direction::ToHost), false) => FrameRole::Unrelated,
    }
}

/// On RS-232 the connected drive acknowledges every message, on RS-485 only messages to it alone; a frame
/// does not show which of the two it is.
fn expected_replies(parsed: &ParsedFrame, serial: bool) -> ReplyExpectation {
    let many = parsed.to.is_none_or(|to| to.group || to.id == 0);
    let opcode = parsed.instruction.opcode;
    let one = if many { ReplyCount::Unknown } else { ReplyCount::Exactly(1) };
    ReplyExpectation {
        acks: if !serial {
            ReplyCount::Zero
        } else if rules::breaks_contact(opcode) {
            ReplyCount::Unknown
        } else {
            one
        },
        answers: if rules::is_request(opcode) { one } else { ReplyCount::Zero },
    }
}

/// SAVE, and whatever writes to the EEPROM (memory 2 in the bits of an instruction that writes).
pub(super) fn effect_of(parsed: &ParsedFrame) -> Effect {
    const SAVE: u16 = 0x1C08;
    let opcode = parsed.instruction.opcode;
    let writes = opcode & 0xFC00 == 0x9000 && opcode >> 2 & 3 == 2;
    match OnlineMessage::parse(&parsed.instruction) {
        Some(online) if is_answer(&online) => Effect::NOTHING,
        _ if opcode == SAVE || writes => Effect::PERSISTENT,
        _ => Effect::from_class(class_of(&parsed.instruction)),
    }
}

const fn is_answer(online: &OnlineMessage) -> bool {
    online.answered_by().is_some()
        || matches!(online, OnlineMessage::TakeVersion { .. } | OnlineMessage::TakeChecksum { .. })
}

/// Number of a point of a path; a mode command begins another path.
pub(super) fn sequence_position(parsed: &ParsedFrame) -> Option<SequencePosition> {
    let after = u32::from(PvtPoint::COUNTER_MAX) + 1;
    match OnlineMessage::parse(&parsed.instruction) {
        Some(OnlineMessage::Pvt(point)) => {
            Some(SequencePosition::Number(point.counter.into(), after))
        }
        Some(OnlineMessage::Pt(point)) => {
            Some(SequencePosition::Number(point.counter.into(), after))
        }
        Some(_) => None,
        None if rules::sets_mode(parsed.instruction.opcode) => Some(SequencePosition::Restart),
        None => None,
    }
}

/// The value that a message carries.
pub(super) fn report_value(
    parsed: &ParsedFrame,
    profile: Option<&'static Profile>,
    sink: &mut dyn ExplainSink,
) {
    match OnlineMessage::parse(&parsed.instruction) {
        Some(OnlineMessage::TakeData { cell, value, .. }) => {
            emit_frame_value(cell, value, false, profile, sink)
        }
        Some(
            OnlineMessage::TakeData2 { address, long, value, .. }
            | OnlineMessage::GotData { address, long, value, .. },
        ) => emit_frame_value(data_cell(address, long), value, false, profile, sink),
        Some(OnlineMessage::Pvt(PvtPoint { position, .. })) => {
            report_point("path position", position.into(), sink);
        }
        Some(OnlineMessage::Pt(online)) => {
            report_point("path position", online.position.into(), sink)
        }
        Some(_) => {}
        None => {
            if let Some((address, value, long)) = assigned_variable(&parsed.instruction) {
                emit_frame_value(data_cell(address, long), value, true, profile, sink);
            }
        }
    }
}

fn data_cell(address: u16, long: bool) -> Cell {
    Cell { memory: MemorySpace::Data, address, long }
}

fn report_point(name: &str, raw: i64, sink: &mut dyn ExplainSink) {
    sink.frame_value(FrameValue { source: ValueSource::Named(name), raw, written: true, motor: 0 });
}

fn emit_frame_value(
    cell: Cell,
    value: u32,
    written: bool,
    profile: Option<&'static Profile>,
    sink: &mut dyn ExplainSink,
) {
    let variable = names::find_variable(cell, profile);
    let raw = match (variable.map(|variable| variable.encoding), cell.long) {
        (Some(Encoding::U16), false) => i64::from(value as u16),
        (Some(Encoding::U32), true) => i64::from(value),
        (_, true) => i64::from(value.cast_signed()),
        (_, false) => i64::from((value as u16).cast_signed()),
    };
    let label = ShortText::from_display(message::cell_name(cell, None));
    let what = variable.map_or(ValueSource::Named(label.as_str()), ValueSource::Parameter);
    sink.frame_value(FrameValue { source: what, raw, written, motor: 0 });
}
