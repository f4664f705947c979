//! Explains messages: their ends in a stream, fields, meaning, and the expected reply.

mod conversation;
mod expected_reply;
mod layout;
mod message;
pub(super) mod names;
mod register;

use super::online::OnlineMessage;
use super::rules::{self, TmlWire, WireRule};
use super::serial::{self, ACK, FRAME_MAX, SYNC};
use super::wire::{IdCode, Message};
use super::{technocan, tmlcan};
use crate::error::WireError;
use crate::explain::{
    Context, ConversationContext, DeviceFact, Direction, Dissector, DriveFacts, Effect,
    EncodeError, EncodeOptions, EncodedFrame, ExplainSink, FactQuery, FrameBoundary,
    FrameConversation, FrameFormat, FrameRole, RawFrame, SequencePosition, TextError, WireKind,
};
use crate::medium::Frame;
use crate::profile::Profile;
use crate::program::ProgramLanguage;
use layout::ParsedFrame;

/// The axis ID that drives have from the factory, and hosts by default.
const DEFAULT_AXIS: u8 = 255;
/// Another byte that hosts were seen to send for synchronisation, beside [`SYNC`].
const SYNC_ALTERNATE: u8 = 0xFF;

/// TML in captures, dashboards and the encoder, on one of its wires.
#[derive(Clone, Copy, Debug)]
pub struct TmlDissector(EncapsulationKind);

/// Encapsulation of messages.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum EncapsulationKind {
    Serial,
    TmlCan,
    TechnoCan,
}

/// On RS-232, RS-485 and Ethernet.
pub const SERIAL: TmlDissector = TmlDissector(EncapsulationKind::Serial);
/// On CAN with 29-bit identifiers.
pub const TMLCAN: TmlDissector = TmlDissector(EncapsulationKind::TmlCan);
/// On CAN with 11-bit identifiers.
pub const TECHNOCAN: TmlDissector = TmlDissector(EncapsulationKind::TechnoCan);

impl FrameFormat for TmlDissector {
    fn find_frame(&self, bytes: &[u8], direction: Option<Direction>, ended: bool) -> FrameBoundary {
        match self.0 {
            EncapsulationKind::Serial => cut_serial(bytes, direction, ended),
            // CAN frames need no cutting, and bytes without an identifier are none of theirs.
            _ => FrameBoundary::Skip(bytes.len()),
        }
    }

    fn claims_id(&self, id: u32, extended: bool) -> bool {
        let frame = Frame { id, extended, ..Frame::default() };
        match self.0 {
            EncapsulationKind::Serial => false,
            EncapsulationKind::TmlCan => tmlcan::decode(&frame)
                .is_ok_and(|message| names::is_opcode(message.instruction.opcode)),
            EncapsulationKind::TechnoCan => {
                !extended && technocan::MessageClass::of_id(id).is_some()
            }
        }
    }

    fn content_evidence(&self, frame: &RawFrame<'_>) -> Option<bool> {
        let instruction = self.decode(frame).ok()?.instruction;
        match OnlineMessage::parse(&instruction) {
            // A point of a path is the whole data of its frame: any content is one.
            Some(OnlineMessage::Pvt(_) | OnlineMessage::Pt(_)) => None,
            Some(_) => Some(true),
            None => Some(names::is_known(&instruction)),
        }
    }
}

impl FrameConversation for TmlDissector {
    fn is_request(&self, frame: &RawFrame<'_>) -> bool {
        match self.0 {
            // Every frame is acknowledged; single bytes are no frames.
            EncapsulationKind::Serial => frame.bytes.len() > 1,
            _ => {
                self.decode(frame).is_ok_and(|parsed| rules::is_request(parsed.instruction.opcode))
            }
        }
    }

    fn is_answer_to(&self, frame: &RawFrame<'_>, request: &RawFrame<'_>) -> bool {
        let (Ok(parsed), Ok(parsed_frame)) = (self.decode(frame), self.decode(request)) else {
            return false;
        };
        is_answer(&parsed, &parsed_frame)
    }

    fn role(&self, frame: &RawFrame<'_>, talk: &ConversationContext<'_>) -> FrameRole {
        let serial = self.0 == EncapsulationKind::Serial;
        if let (true, &[byte]) = (serial, frame.bytes) {
            let acks = byte == ACK && talk.direction != Some(Direction::ToDrive);
            return if acks { FrameRole::Acknowledgement } else { FrameRole::Unrelated };
        }
        self.decode(frame).map_or(FrameRole::Unrelated, |parsed| {
            conversation::frame_role(&parsed, serial, talk.direction)
        })
    }

    fn effect(&self, frame: &RawFrame<'_>, _: Option<&'static Profile>) -> Effect {
        match frame.bytes {
            // An acknowledgement, or bytes that synchronise.
            [_] if self.0 == EncapsulationKind::Serial => Effect::NOTHING,
            _ => self
                .decode(frame)
                .map_or(Effect::UNKNOWN, |parsed| conversation::effect_of(&parsed)),
        }
    }

    fn sequence_position(&self, request: &RawFrame<'_>) -> Option<SequencePosition> {
        conversation::sequence_position(&self.decode(request).ok()?)
    }
}

impl DriveFacts for TmlDissector {
    fn device_facts(&self) -> &'static [DeviceFact] {
        &[DeviceFact { name: "firmware", query: FactQuery::Text("GETVERSION") }]
    }

    fn data_logger(&self) -> Option<&'static crate::data_logger::DataLogger> {
        Some(&super::logger::LOGGER)
    }

    /// Four characters (TML communication manual, GETVERSION).
    fn write_fact(&self, _name: &str, raw: i64, out: &mut dyn core::fmt::Write) {
        let [_, _, _, _, text @ ..] = raw.to_be_bytes();
        for byte in text.iter().filter(|byte| byte.is_ascii_graphic()) {
            let _ = out.write_char(char::from(*byte));
        }
    }
}

impl Dissector for TmlDissector {
    fn name(&self) -> &'static str {
        match self.0 {
            EncapsulationKind::Serial => "tml",
            EncapsulationKind::TmlCan => "tmlcan",
            EncapsulationKind::TechnoCan => "technocan",
        }
    }

    fn language(&self) -> &'static str {
        "tml"
    }

    fn encodes_by_name(&self) -> bool {
        true
    }

    fn program_language(&self) -> Option<&'static dyn ProgramLanguage> {
        Some(&super::program::TmlLanguage)
    }

    fn has_groups(&self) -> bool {
        true
    }

    fn explain(&self, bytes: &[u8], context: &Context<'_>, sink: &mut dyn ExplainSink) {
        let raw = RawFrame { bytes, id: context.id, extended: context.extended };
        if let (EncapsulationKind::Serial, &[byte]) = (self.0, bytes) {
            return self.explain_single_byte(byte, context, sink);
        }
        let request = self.context_request(context);
        match self.decode(&raw) {
            Ok(parsed) => {
                message::explain_message(&parsed, request.as_ref(), context.profile, sink);
                conversation::report_value(&parsed, context.profile, sink);
            }
            Err((error, parsed)) => {
                match parsed {
                    Some(parsed) => message::explain_message(&parsed, None, context.profile, sink),
                    None => sink.kind("TML"),
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
        let wire = self.wire_for(addressing.wire)?;
        let to = destination(addressing)?;
        let host = host_id(wire, to, addressing)?;
        let sender = match wire {
            TmlWire::Rs232 => IdCode::host_at(host),
            _ => IdCode::axis(host),
        };
        let instruction = names::assemble(text, addressing.profile, sender)?;
        let message = Message { to, instruction };
        wire.check(&message).map_err(forbidden)?;
        let answered = rules::is_request(instruction.opcode);
        if answered && !to.group && !to.host && wire != TmlWire::Rs232 {
            wire.check_host_id(host, to.id).map_err(forbidden)?;
        }
        let (bytes, len, id) = self.encode_message(&message).map_err(forbidden)?;
        let error = TextError { at: 0, expected: "room for 14 bytes" };
        out.get_mut(..len).ok_or(error)?.copy_from_slice(&bytes[..len]);
        let extended = self.0 == EncapsulationKind::TmlCan;
        let answer = expected_reply::reply_len(&message, wire);
        Ok(EncodedFrame {
            len,
            id,
            extended,
            remote_len: None,
            answer_len: answer,
            warning: warning(wire, to),
        })
    }

    fn explain_named_value(
        &self,
        name: &str,
        value: u32,
        profile: Option<&'static Profile>,
        sink: &mut dyn ExplainSink,
    ) -> bool {
        register::explain_register(name, value, profile, sink)
    }

    fn code_meaning(&self, _: u32) -> Option<&'static str> {
        None
    }

    fn explain_expected_reply(
        &self,
        request: &RawFrame<'_>,
        addressing: &EncodeOptions,
        sink: &mut dyn ExplainSink,
    ) {
        let Ok(wire) = self.wire_for(addressing.wire) else { return };
        if let Ok(parsed) = self.decode(request) {
            expected_reply::explain_reply(&parsed, wire, addressing.profile, sink);
        }
    }
}

impl TmlDissector {
    /// Decodes a frame; an error may come with the part that is readable.
    fn decode(&self, raw: &RawFrame<'_>) -> Result<ParsedFrame, (WireError, Option<ParsedFrame>)> {
        match (self.0, raw.id) {
            (EncapsulationKind::Serial, _) => layout::parse_serial(raw.bytes),
            (_, None) => Err((WireError::Identifier { found: 0 }, None)),
            (EncapsulationKind::TmlCan, Some(id)) => layout::parse_tmlcan(&to_frame(id, raw)),
            (EncapsulationKind::TechnoCan, Some(id)) => layout::parse_technocan(&to_frame(id, raw)),
        }
    }

    /// The request that a frame is known to belong to.
    fn context_request(&self, context: &Context<'_>) -> Option<ParsedFrame> {
        let bytes = context.request?;
        self.decode(&RawFrame { bytes, id: context.request_id, extended: context.extended }).ok()
    }

    /// A byte between frames.
    fn explain_single_byte(&self, byte: u8, context: &Context<'_>, sink: &mut dyn ExplainSink) {
        let (to_drive, to_host) = match context.direction {
            Some(direction) => (direction == Direction::ToDrive, direction == Direction::ToHost),
            None => (false, false),
        };
        match byte {
            ACK if !to_drive => {
                message::explain_ack(self.context_request(context).as_ref(), context.profile, sink)
            }
            SYNC => message::explain_sync(byte, context.direction, sink),
            SYNC.. if !to_host => message::explain_sync(byte, context.direction, sink),
            found => {
                sink.kind("TML");
                sink.error(match serial::frame_len(found) {
                    Some(need) => WireError::Short { need: need as u16, found: 1 },
                    None => WireError::Count { at: 0, found: found.into() },
                });
            }
        }
    }

    /// The wire whose rules apply.
    fn wire_for(&self, via: WireKind) -> Result<TmlWire, EncodeError> {
        let both = "CAN carries TML in two ways; say tmlcan or technocan";
        let other = "this wire has no serial form; say tml";
        match (self.0, via) {
            (EncapsulationKind::Serial, WireKind::Default | WireKind::Serial) => Ok(TmlWire::Rs232),
            (EncapsulationKind::Serial, WireKind::Rs485) => Ok(TmlWire::Rs485),
            (EncapsulationKind::TmlCan, WireKind::Default | WireKind::Can) => Ok(TmlWire::TmlCan),
            (EncapsulationKind::TechnoCan, WireKind::Default | WireKind::Can) => {
                Ok(TmlWire::TechnoCan)
            }
            (EncapsulationKind::Serial, WireKind::Can) => Err(EncodeError::Forbidden(both)),
            _ => Err(EncodeError::Forbidden(other)),
        }
    }

    fn encode_message(
        &self,
        message: &Message,
    ) -> Result<([u8; FRAME_MAX], usize, Option<u32>), WireRule> {
        let mut out = [0; FRAME_MAX];
        let frame = match self.0 {
            EncapsulationKind::Serial => {
                let len = serial::encode(message, &mut out);
                return Ok((out, len, None));
            }
            EncapsulationKind::TmlCan => tmlcan::encode(message),
            EncapsulationKind::TechnoCan => technocan::encode(message)?,
        };
        let data = frame.bytes();
        out[..data.len()].copy_from_slice(data);
        Ok((out, data.len(), Some(frame.id)))
    }
}

/// Warning about axis IDs above 31 on TechnoCAN.
const fn warning(wire: TmlWire, to: IdCode) -> &'static str {
    if matches!(wire, TmlWire::TechnoCan) && !to.group && technocan::is_ambiguous(to.id) {
        "TechnoCAN takes axis IDs modulo 32, so another axis may obey too; give drives IDs from 1 to \
         31"
    } else {
        ""
    }
}

const fn forbidden(rule: WireRule) -> EncodeError {
    EncodeError::Forbidden(rule.sentence())
}

fn to_frame(id: u32, raw: &RawFrame<'_>) -> Frame {
    let mut frame = Frame::standard(0, raw.bytes);
    (frame.id, frame.extended) = (id, raw.extended);
    frame
}

/// Returns whether a message replies to another: by the content of both, and by the addressee where a request names its
/// sender.
fn is_answer(parsed: &ParsedFrame, parsed_frame: &ParsedFrame) -> bool {
    let (Some(answer), Some(request)) = (
        OnlineMessage::parse(&parsed.instruction),
        OnlineMessage::parse(&parsed_frame.instruction),
    ) else {
        return false;
    };
    let back = match (parsed.to, request.reply_to()) {
        // TechnoCAN has numbers for axis IDs: the host 255 is answered as 31.
        (Some(to), Some(sender)) if parsed.class.is_some() => to.id % 32 == sender.id % 32,
        (Some(to), Some(sender)) => to.id == sender.id,
        _ => true,
    };
    back && answer.answers(&request, parsed_frame.to.unwrap_or(IdCode::BROADCAST))
}

/// Receiver of a text; by default the axis with the factory ID.
fn destination(addressing: &EncodeOptions) -> Result<IdCode, TextError> {
    let expected = "an axis ID, 0 to 255";
    let id = addressing.axis.unwrap_or(DEFAULT_AXIS.into());
    let id = u8::try_from(id).map_err(|_| TextError { at: 0, expected })?;
    Ok(match (addressing.groups, addressing.to_host) {
        (true, _) => IdCode::groups(id),
        (false, true) => IdCode::host_at(id),
        (false, false) => IdCode::axis(id),
    })
}

/// The host's ID. By default that of the drive on RS-232, and elsewhere the factory's or the one
/// below it, so that it is not the drive's.
fn host_id(wire: TmlWire, to: IdCode, addressing: &EncodeOptions) -> Result<u8, TextError> {
    let expected = "a host ID, 1 to 255";
    let usual = match wire {
        TmlWire::Rs232 if !to.group && to.id != 0 => to.id,
        TmlWire::Rs232 => DEFAULT_AXIS,
        _ if wire.check_host_id(DEFAULT_AXIS, to.id).is_err() && !to.group => DEFAULT_AXIS - 1,
        _ => DEFAULT_AXIS,
    };
    let host = addressing.host.unwrap_or(usual.into());
    u8::try_from(host).ok().filter(|host| *host != 0).ok_or(TextError { at: 0, expected })
}

/// Finds the end of a piece of a serial stream.
fn cut_serial(bytes: &[u8], direction: Option<Direction>, ended: bool) -> FrameBoundary {
    let Some(&first) = bytes.first() else { return FrameBoundary::Incomplete };
    let Some(whole) = serial::frame_len(first) else {
        return if is_single_byte(first, direction) {
            FrameBoundary::Frame(1)
        } else {
            FrameBoundary::Skip(1)
        };
    };
    match bytes.get(..whole) {
        Some(frame) if serial::decode(frame).is_ok() => FrameBoundary::Frame(whole),
        Some(_) => resynchronise(bytes, whole, ended),
        None if !ended => FrameBoundary::Incomplete,
        None => match find_inner_frame(bytes, bytes.len()) {
            Some(at) => FrameBoundary::Skip(at),
            None if has_id_code(bytes) => FrameBoundary::Corrupt(bytes.len()),
            None => FrameBoundary::Skip(1),
        },
    }
}

/// Returns whether a byte between frames is a known one: acknowledgements of drives, synchronisation both ways.
fn is_single_byte(byte: u8, direction: Option<Direction>) -> bool {
    match direction {
        Some(Direction::ToDrive) => matches!(byte, SYNC | SYNC_ALTERNATE),
        Some(Direction::ToHost) => matches!(byte, ACK | SYNC),
        None => matches!(byte, ACK | SYNC | SYNC_ALTERNATE),
    }
}

/// Handles bytes of a frame's length that are no frame. If a valid frame begins among them, the bytes before
/// it lost one, or belong to none; otherwise they are a broken frame.
fn resynchronise(bytes: &[u8], whole: usize, ended: bool) -> FrameBoundary {
    let follows = bytes.get(whole..).is_some_and(is_frame);
    let shaped = has_id_code(bytes);
    match find_inner_frame(bytes, whole) {
        Some(at) if !follows => {
            if shaped && at >= serial::FRAME_MIN - 1 {
                FrameBoundary::Corrupt(at)
            } else {
                FrameBoundary::Skip(at)
            }
        }
        None if !ended && !follows && bytes.len() < whole + FRAME_MAX => FrameBoundary::Incomplete,
        _ if shaped => FrameBoundary::Corrupt(whole),
        _ => FrameBoundary::Skip(1),
    }
}

/// Position before `end` at which a valid frame begins.
fn find_inner_frame(bytes: &[u8], end: usize) -> Option<usize> {
    (1..end).find(|at| is_frame(&bytes[*at..]))
}

fn is_frame(bytes: &[u8]) -> bool {
    let whole = bytes.first().and_then(|length| serial::frame_len(*length));
    whole.and_then(|whole| bytes.get(..whole)).is_some_and(|frame| serial::decode(frame).is_ok())
}

/// Returns whether an ID code follows the length byte, as far as received.
fn has_id_code(bytes: &[u8]) -> bool {
    IdCode::from_word(u16::from_be_bytes([byte_at(1, bytes), byte_at(2, bytes)])).is_some()
}

fn byte_at(at: usize, bytes: &[u8]) -> u8 {
    bytes.get(at).copied().unwrap_or(0)
}
