//! Explains frames: fields and meaning.
//!
//! Identifiers are interpreted by the predefined connection set. Other protocols use those of PDO2 too
//! (thrusters, Elmo drives). Without --as they count as CANopen only for a node that other frames prove to
//! be one. The content of process data depends on the node's mapping, which a frame does not contain.

mod effect;
pub(super) use effect::object_effect;
mod fields;
mod kinds;
pub mod meanings;
mod names;
mod remarks;

use super::cia402;
use super::cob::{Cob, LSS_REPLY, LSS_REQUEST, SDO_REPLY, SDO_REQUEST};
use super::lss;
use super::nmt::{NmtCommand, NmtState};
use super::sdo::{AbortCode, BLOCK_MAX, ExpeditedData, SdoReply, SdoRequest};
use super::sync;
use super::text::{self, Statement};
use super::{NODE_MAX, emcy};
use crate::error::WireError;
use crate::explain::{
    Context, DeviceFact, Direction, Dissector, DriveFacts, Effect, EncodeError, EncodeOptions,
    EncodedFrame, ExplainSink, FactQuery, Field, FieldValue, FrameBoundary, FrameConversation,
    FrameFormat, RawFrame, TextError,
};
use crate::medium::Frame;
use crate::profile::Profile;
use fields::FieldWriter;
pub use fields::default_mapping;
pub use kinds::lss_kind;
use kinds::{cob_kind, message_kind};
use meanings::SinkWriter;
use remarks::write_meaning;

/// The protocol in captures, dashboards and the encoder.
#[derive(Clone, Copy, Debug)]
pub struct CanopenDissector;

/// Node that a text is encoded for when none is named.
const DEFAULT_NODE: u32 = 1;
const DAY_MS: u32 = 86_400_000;

const DEVICE_FACTS: [DeviceFact; 7] = [
    object_fact("device name", "1008h:0:str"),
    object_fact("hardware version", "1009h:0:str"),
    object_fact("software version", "100Ah:0:str"),
    object_fact("vendor id", "1018h:1"),
    object_fact("product code", "1018h:2"),
    object_fact("revision number", "1018h:3"),
    object_fact("serial number", "1018h:4"),
];

const fn object_fact(name: &'static str, address: &'static str) -> DeviceFact {
    DeviceFact { name, query: FactQuery::Address(address) }
}

impl FrameFormat for CanopenDissector {
    fn find_frame(
        &self,
        bytes: &[u8],
        _direction: Option<Direction>,
        ended: bool,
    ) -> FrameBoundary {
        if ended || !bytes.is_empty() {
            FrameBoundary::Skip(bytes.len())
        } else {
            FrameBoundary::Incomplete
        }
    }

    fn claims_id(&self, id: u32, extended: bool) -> bool {
        !extended && cob_of_id(id).is_some()
    }

    fn claims_remote(&self, id: u32, extended: bool) -> bool {
        !extended && matches!(cob_of_id(id), Some(Cob::Tpdo(..) | Cob::Heartbeat(_)))
    }

    fn shares_id(&self, id: u32, extended: bool) -> bool {
        !extended && matches!(cob_of_id(id), Some(Cob::Tpdo(2, _) | Cob::Rpdo(2, _)))
    }

    fn content_evidence(&self, frame: &RawFrame<'_>) -> Option<bool> {
        match (frame.id.and_then(cob_of_id)?, frame.bytes) {
            (Cob::Nmt, [command, node]) => {
                Some(matches!(command, 1 | 2 | 128..=130) && *node <= NODE_MAX)
            }
            (Cob::Heartbeat(_), [state]) => Some(matches!(state & 0x7F, 0 | 4 | 5 | 127)),
            (Cob::Sync, [] | [_]) => Some(true),
            (Cob::Nmt | Cob::Heartbeat(_) | Cob::Sync, _) => Some(false),
            // Objects begin at 1000h, and the bytes without data are zero.
            (cob, &[command, _, high, _, a, b, c, d]) if high >= 0x10 => {
                let used = match (cob, command) {
                    (Cob::SdoRequest(_), 0x40) | (Cob::SdoReply(_), 0x60) => 0,
                    (Cob::SdoRequest(_), 0x2F) | (Cob::SdoReply(_), 0x4F) => 1,
                    (Cob::SdoRequest(_), 0x2B) | (Cob::SdoReply(_), 0x4B) => 2,
                    _ => return None,
                };
                [a, b, c, d][used..].iter().all(|byte| *byte == 0).then_some(true)
            }
            _ => None,
        }
    }

    fn process_data_axis(&self, frame: &RawFrame<'_>) -> Option<u32> {
        match frame.id.filter(|_| !frame.extended && frame.bytes.len() <= 8).and_then(cob_of_id) {
            Some(Cob::Tpdo(_, node) | Cob::Rpdo(_, node)) => Some(node.into()),
            _ => None,
        }
    }
}

impl FrameConversation for CanopenDissector {
    fn is_request(&self, frame: &RawFrame<'_>) -> bool {
        !frame.extended
            && frame.id.is_some_and(|id| {
                matches!(cob_of_id(id), Some(Cob::SdoRequest(_) | Cob::LssRequest))
            })
    }

    fn is_evident_answer(&self, answer: &RawFrame<'_>) -> bool {
        // A segment repeats one bit: the transport of vehicle diagnosis (ISO 15765-2) on the same identifiers does too.
        let is_sdo = answer.id.is_some_and(|id| matches!(cob_of_id(id), Some(Cob::SdoReply(_))));
        !is_sdo
            || first_eight(answer.bytes).is_some_and(|bytes| SdoReply::of(bytes).object().is_some())
    }

    fn is_answer_to(&self, frame: &RawFrame<'_>, request: &RawFrame<'_>) -> bool {
        // Most frames are process data, which these two comparisons detect.
        let (Some(id), Some(asked)) = (frame.id, request.id) else { return false };
        if matches!(id, 0x581..=0x5FF) && asked == id + u32::from(SDO_REQUEST - SDO_REPLY) {
            return service_answers(frame.bytes, request.bytes);
        }
        (id, asked) == (LSS_REPLY.into(), LSS_REQUEST.into())
            && lss_answers(frame.bytes, request.bytes)
    }

    fn direction(&self, frame: &RawFrame<'_>, _: Option<RawFrame<'_>>) -> Option<Direction> {
        effect::direction_of(frame.id.filter(|_| !frame.extended).and_then(cob_of_id)?)
    }

    fn effect(&self, frame: &RawFrame<'_>, profile: Option<&'static Profile>) -> Effect {
        match frame.id.filter(|_| !frame.extended && frame.bytes.len() <= 8).and_then(cob_of_id) {
            Some(cob) => effect::effect_of(cob, frame.bytes, profile),
            None => Effect::UNKNOWN,
        }
    }
}

impl DriveFacts for CanopenDissector {
    fn standard_profiles(&self) -> &'static [&'static str] {
        &["canopen", "cia402"]
    }

    fn device_facts(&self) -> &'static [DeviceFact] {
        &DEVICE_FACTS
    }
}

impl Dissector for CanopenDissector {
    fn name(&self) -> &'static str {
        "canopen"
    }

    fn explain(&self, bytes: &[u8], context: &Context<'_>, sink: &mut dyn ExplainSink) {
        let Some(frame) = to_frame(bytes, context) else {
            sink.kind("canopen");
            return sink.error(WireError::Identifier { found: context.id.unwrap_or(0) });
        };
        let cob = Cob::of(frame.id as u16);
        let node = match (cob, bytes) {
            (Cob::Nmt, [_, node]) => Some(*node).filter(|node| (1..=NODE_MAX).contains(node)),
            _ => cob.node(),
        };
        node.into_iter().for_each(|node| sink.axis(node.into()));
        sink.kind(cob_kind(cob));
        match Statement::of(&frame, false) {
            Ok(statement) => explain_message(&statement, &frame, node.unwrap_or(0), context, sink),
            Err(error) => {
                if sink.wants_text() {
                    let _ = text::write(&Statement::Raw(frame), &|_| false, &mut SinkWriter(sink));
                }
                sink.error(error);
            }
        }
    }

    fn encode(
        &self,
        text: &str,
        addressing: &EncodeOptions,
        out: &mut [u8],
    ) -> Result<EncodedFrame, EncodeError> {
        let statement = text::parse(text, addressing.profile)?;
        let axis = addressing.axis.unwrap_or(DEFAULT_NODE);
        let (statement, node) = match statement {
            Statement::Order(command, _) if axis == 0 => (Statement::Order(command, true), 0),
            // It has its identifier.
            Statement::Raw(frame) => (Statement::Raw(frame), 0),
            statement => {
                let expected = "a node-ID, 1 to 127, for --axis";
                let wrong = TextError { at: 0, expected };
                let node = u8::try_from(axis).ok().filter(|node| (1..=NODE_MAX).contains(node));
                (statement, node.ok_or(wrong)?)
            }
        };
        let frame = statement.frame(node);
        let error = TextError { at: 0, expected: "room for eight bytes" };
        let len = if frame.remote { 0 } else { frame.bytes().len() };
        out.get_mut(..len).ok_or(error)?.copy_from_slice(&frame.bytes()[..len]);
        Ok(EncodedFrame {
            len,
            id: Some(frame.id),
            extended: false,
            remote_len: frame.remote.then_some(frame.len),
            answer_len: answer_len(&frame),
            warning: warning_for(&statement),
        })
    }

    fn code_meaning(&self, code: u32) -> Option<&'static str> {
        if let Some(text) = AbortCode(code).text() {
            return Some(text);
        }
        let code = u16::try_from(code).ok()?;
        if code >> 8 >= 0x10 {
            return Some(emcy::class_text(code)).filter(|class| *class != "unknown class");
        }
        Some(match cia402::DriveState::of(code) {
            cia402::DriveState::Other(_) => return None,
            state => state.name(),
        })
    }

    fn explain_named_value(
        &self,
        name: &str,
        value: u32,
        profile: Option<&'static Profile>,
        sink: &mut dyn ExplainSink,
    ) -> bool {
        if is_word("statusword", name) || is_word("0x6041:0", name) || is_word("0x6041", name) {
            return explain_word_bits(value as u16, false, sink);
        }
        if is_word("controlword", name) || is_word("0x6040:0", name) || is_word("0x6040", name) {
            return explain_word_bits(value as u16, true, sink);
        }
        if is_word("emcy", name) {
            sink.kind("emcy");
            sink.text(meanings::fault_text(value as u16, profile));
            return true;
        }
        if is_word("abort", name) {
            sink.kind("abort");
            sink.text(meanings::abort_text(AbortCode(value)));
            return true;
        }
        let Some(object) = text::named_object(name, profile).filter(|_| !is_hex_byte(name)) else {
            return false;
        };
        sink.kind("object");
        let number = meanings::decode_number(object, value, 0, profile);
        let _ = meanings::write_value(object, number, profile, &mut SinkWriter(sink));
        true
    }

    fn explain_expected_reply(
        &self,
        request: &RawFrame<'_>,
        addressing: &EncodeOptions,
        sink: &mut dyn ExplainSink,
    ) {
        let Some(Cob::SdoRequest(node)) = request.id.and_then(cob_of_id) else { return };
        let requested = Frame::standard(0x600 + u16::from(node), request.bytes);
        let Ok(Statement::Request(sdo_request, _)) = Statement::of(&requested, false) else {
            return;
        };
        let reply = match sdo_request {
            SdoRequest::Write(object, _) | SdoRequest::WriteLong(object, _) => {
                SdoReply::Written(object, 0)
            }
            SdoRequest::WriteSegment(segment) => SdoReply::WrittenSegment(segment.toggle),
            _ => return,
        };
        let frame = reply.emit(node);
        let context =
            Context { profile: addressing.profile, id: Some(frame.id), ..Context::default() };
        self.explain(frame.bytes(), &context, sink);
    }
}

fn is_word(word: &str, name: &str) -> bool {
    name.eq_ignore_ascii_case(word)
}

/// Explains a segment of a block, which can be distinguished from a command only by following the transfer: `bytes` are
/// eight, and the identifier that of the node's default channel.
pub fn explain_block_segment(bytes: &[u8], context: &Context<'_>, sink: &mut dyn ExplainSink) {
    let Some(frame) = to_frame(bytes, context) else { return };
    let Some(node) = Cob::of(frame.id as u16).node() else { return };
    sink.axis(node.into());
    if let Ok(statement) = Statement::of(&frame, true) {
        explain_message(&statement, &frame, node, context, sink);
    }
}

/// The service of an identifier in the predefined connection set.
fn cob_of_id(id: u32) -> Option<Cob> {
    let id = u16::try_from(id).ok().filter(|id| *id <= 0x7FF)?;
    Some(Cob::of(id)).filter(|cob| !matches!(cob, Cob::Other(_)))
}

/// A bare hexadecimal byte, as frames have them.
fn is_hex_byte(name: &str) -> bool {
    name.len() == 2 && name.bytes().all(|byte| byte.is_ascii_hexdigit())
}

/// The frame, if it can be one of this protocol's.
fn to_frame(bytes: &[u8], context: &Context<'_>) -> Option<Frame> {
    let id = context.id.filter(|id| !context.extended && cob_of_id(*id).is_some())?;
    let fits = bytes.len() <= 8;
    let frame = fits.then(|| Frame::standard(id as u16, bytes))?;
    Some(Frame { remote: context.remote, ..frame })
}

fn explain_message(
    statement: &Statement,
    frame: &Frame,
    node: u8,
    context: &Context<'_>,
    sink: &mut dyn ExplainSink,
) {
    let profile = context.profile;
    sink.kind(message_kind(statement, frame));
    FieldWriter { frame, profile, sink }.emit_message(statement);
    if sink.wants_text() {
        write_meaning(statement, frame, node, context, sink);
    }
    if let Some(error) = frame_error(statement, frame) {
        sink.error(error);
    }
}

/// Violation of the protocol by a frame that has a meaning nevertheless.
fn frame_error(statement: &Statement, frame: &Frame) -> Option<WireError> {
    let blocks = 1..=BLOCK_MAX;
    match *statement {
        Statement::Order(NmtCommand::Other(_), _) => unexpected_at(0, &frame.data),
        Statement::State(heartbeat) if matches!(heartbeat.state, NmtState::Other(_)) => {
            unexpected_at(0, &frame.data)
        }
        Statement::Sync(sync::SyncMessage { counter: Some(counter @ (0 | 241..)) }) => {
            count_error(0, counter)
        }
        Statement::Time(time) if time.ms >= DAY_MS => unexpected_at(3, &frame.data),
        Statement::Lss(lss::LssRequest::Other(_))
        | Statement::LssReply(lss::LssReply::Other(_)) => unexpected_at(0, &frame.data),
        Statement::Request(SdoRequest::Other(_), _) | Statement::Reply(SdoReply::Other(_), _) => {
            unexpected_at(0, &frame.data)
        }
        Statement::Request(
            SdoRequest::ReadBlock { segments, .. } | SdoRequest::ReadBlockAck { segments, .. },
            _,
        )
        | Statement::Reply(
            SdoReply::WriteBlockReady { segments, .. } | SdoReply::WriteBlockAck { segments, .. },
            _,
        ) if !blocks.contains(&segments) => {
            let at = if statement.object().is_some() { 4 } else { 2 };
            count_error(at, segments)
        }
        Statement::Request(_, 7) | Statement::Reply(_, 7) if !is_complete_in_seven(statement) => {
            Some(WireError::Short { need: 8, found: 7 })
        }
        _ => None,
    }
}

fn count_error(at: u16, found: u8) -> Option<WireError> {
    Some(WireError::Count { at, found: found.into() })
}

fn unexpected_at(at: u16, frame_data: &[u8; 8]) -> Option<WireError> {
    let found = frame_data[usize::from(at)];
    Some(WireError::Unexpected { at, found })
}

/// Returns whether the byte that lacks of eight would not count anyway.
fn is_complete_in_seven(statement: &Statement) -> bool {
    matches!(
        statement,
        Statement::Request(
            SdoRequest::Write(_, ExpeditedData { len: 1..=3, .. })
                | SdoRequest::Read(_)
                | SdoRequest::ReadSegment(_),
            _
        ) | Statement::Reply(
            SdoReply::Written(..) | SdoReply::Value(_, ExpeditedData { len: 1..=3, .. }),
            _
        )
    )
}

/// Returns whether a reply of the same node can be to that request: the same object, or the next of it.
fn service_answers(reply: &[u8], request: &[u8]) -> bool {
    let (Some(reply), Some(request)) = (first_eight(reply), first_eight(request)) else {
        return false;
    };
    let (reply, request) = (SdoReply::of(reply), SdoRequest::of(request));
    if let (Some(object), Some(requested)) = (reply.object(), request.object()) {
        return object == requested;
    }
    // One with another toggle answers an older segment.
    match (reply, request) {
        (SdoReply::ValueSegment(segment), SdoRequest::ReadSegment(was_requested)) => {
            return segment.toggle == was_requested;
        }
        (SdoReply::WrittenSegment(reported), SdoRequest::WriteSegment(asked)) => {
            return reported == asked.toggle;
        }
        _ => {}
    }
    matches!(
        (reply, request),
        (SdoReply::WriteBlockDone, SdoRequest::WriteBlockEnd { .. })
            | (SdoReply::ReadBlockEnd { .. }, SdoRequest::ReadBlockAck { .. })
            | (SdoReply::Abort(..), _)
    )
}

fn first_eight(bytes: &[u8]) -> Option<[u8; 8]> {
    let mut all = [0; 8];
    all.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
    (bytes.len() >= 7).then_some(all)
}

/// Returns whether a reply of layer setting can be to that request.
#[must_use]
pub fn lss_answers(reply: &[u8], request: &[u8]) -> bool {
    let (Ok(reply), Ok(request)) = (lss::LssReply::parse(reply), lss::LssRequest::parse(request))
    else {
        return false;
    };
    use lss::{LssReply, LssRequest};
    match (reply, request) {
        (LssReply::Selected, LssRequest::SwitchSelective(..))
        | (LssReply::SetNode(..), LssRequest::SetNode(_))
        | (LssReply::SetBitTiming(..), LssRequest::SetBitTiming(..))
        | (LssReply::Store(..), LssRequest::Store)
        | (LssReply::Node(_), LssRequest::InquireNode)
        | (LssReply::Identified, LssRequest::Identify(..) | LssRequest::FastScan { .. })
        | (LssReply::Unconfigured, LssRequest::IdentifyUnconfigured) => true,
        (LssReply::Number(identity_number, _), LssRequest::Inquire(requested)) => {
            identity_number == requested
        }
        _ => false,
    }
}

/// Number of bytes the answer has, if there is one.
fn answer_len(frame: &Frame) -> Option<usize> {
    match Cob::of(frame.id as u16) {
        Cob::Heartbeat(_) if frame.remote => Some(1),
        Cob::SdoRequest(_) => Some(8),
        Cob::LssRequest => match lss::LssRequest::parse(frame.bytes()).ok()? {
            lss::LssRequest::SwitchGlobal(_)
            | lss::LssRequest::ActivateBitTiming(_)
            | lss::LssRequest::Other(_) => None,
            _ => Some(8),
        },
        _ => None,
    }
}

fn warning_for(statement: &Statement) -> &'static str {
    match *statement {
        Statement::Write(_, _, 5..) => "the first frame: eight bytes go in segments behind it",
        Statement::Order(_, true) => "to every node on the bus",
        Statement::Lss(lss::LssRequest::SwitchGlobal(true)) => {
            "to every device: where there are several, all of them take the next node-ID"
        }
        Statement::Lss(lss::LssRequest::ActivateBitTiming(_)) => {
            "every node in configuration changes its bit rate: those that do not are lost"
        }
        _ => "",
    }
}

/// Shows a controlword's or statusword's bits.
fn explain_word_bits(word: u16, orders: bool, sink: &mut dyn ExplainSink) -> bool {
    let (kind, low, bits) = if orders {
        ("controlword", &CONTROL_LOW[..], &meanings::CONTROL_BITS)
    } else {
        ("statusword", &STATUS_LOW[..], &meanings::STATUS_BITS)
    };
    sink.kind(kind);
    let mut pieces = SinkWriter(sink);
    let _ = if orders {
        meanings::write_controlword(word, &mut pieces)
    } else {
        meanings::write_statusword(word, &mut pieces)
    };
    let mut all = [(0, ""); 16];
    low.iter().chain(bits).for_each(|(bit, name)| all[usize::from(*bit)] = (*bit, name));
    for (bit, name) in all.into_iter().filter(|(_, name)| !name.is_empty()) {
        let value = FieldValue::Int((word >> bit & 1).into());
        let start = u16::from(bit);
        sink.field(Field { name: "bit", start, end: start + 1, value, meaning: name });
    }
    true
}

const CONTROL_LOW: [(u8, &str); 5] = [
    (0, "switch on"),
    (1, "enable voltage"),
    (2, "no quick stop"),
    (3, "enable operation"),
    (7, "fault reset, when it becomes 1"),
];

const STATUS_LOW: [(u8, &str); 8] = [
    (0, "ready to switch on"),
    (1, "switched on"),
    (2, "operation enabled"),
    (3, "fault"),
    (4, "voltage enabled"),
    (5, "no quick stop"),
    (6, "switch on disabled"),
    (9, "remote"),
];
