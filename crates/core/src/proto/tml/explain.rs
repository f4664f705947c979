//! Messages for people: where one ends in a stream, what its fields are, what it means, and what is
//! expected as its answer.

mod expect;
mod layout;
mod names;
mod register;
mod say;
mod talk;

use super::online::Online;
use super::rules::{self, Rule, Wire};
use super::serial::{self, ACK, FRAME_MAX, SYNC};
use super::wire::{IdCode, Message};
use super::{technocan, tmlcan};
use crate::error::WireError;
use crate::explain::{
    Addressing, Context, Cut, Direction, Dissector, Effect, EncodeError, Encoded, Place, Raw, Sink,
    Talk, TextError, Turn, Via,
};
use crate::medium::Frame;
use crate::profile::{Parameter, Profile};
use crate::program::Language;
use layout::Said;

/// The axis ID that drives have from the factory, and hosts by default.
const AXIS: u8 = 255;
/// What was seen to be sent to synchronise, beside [`SYNC`].
const SYNC_TOO: u8 = 0xFF;

/// TML in captures, dashboards and the encoder, on one of its wires.
#[derive(Clone, Copy, Debug)]
pub struct TmlDissector(Encapsulation);

/// How messages are packed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Encapsulation {
    Serial,
    TmlCan,
    TechnoCan,
}

/// On RS-232, RS-485 and Ethernet.
pub const SERIAL: TmlDissector = TmlDissector(Encapsulation::Serial);
/// On CAN with 29-bit identifiers.
pub const TMLCAN: TmlDissector = TmlDissector(Encapsulation::TmlCan);
/// On CAN with 11-bit identifiers.
pub const TECHNOCAN: TmlDissector = TmlDissector(Encapsulation::TechnoCan);

impl Dissector for TmlDissector {
    fn name(&self) -> &'static str {
        match self.0 {
            Encapsulation::Serial => "tml",
            Encapsulation::TmlCan => "tmlcan",
            Encapsulation::TechnoCan => "technocan",
        }
    }

    fn language(&self) -> &'static str {
        "tml"
    }

    fn speaks_in_names(&self) -> bool {
        true
    }

    fn programs(&self) -> Option<&'static dyn Language> {
        Some(&super::program::Tml)
    }

    fn has_groups(&self) -> bool {
        true
    }

    fn cut(&self, bytes: &[u8], direction: Option<Direction>, ended: bool) -> Cut {
        match self.0 {
            Encapsulation::Serial => cut(bytes, direction, ended),
            // CAN frames need no cutting, and bytes without an identifier are none of theirs.
            _ => Cut::Skip(bytes.len()),
        }
    }

    fn claims(&self, id: u32, extended: bool) -> bool {
        let frame = Frame { id, extended, ..Frame::default() };
        match self.0 {
            Encapsulation::Serial => false,
            Encapsulation::TmlCan => tmlcan::decode(&frame)
                .is_ok_and(|message| names::is_opcode(message.instruction.opcode)),
            Encapsulation::TechnoCan => !extended && technocan::Class::of_id(id).is_some(),
        }
    }

    fn explain(&self, bytes: &[u8], context: &Context<'_>, sink: &mut dyn Sink) {
        let raw = Raw { bytes, id: context.id, extended: context.extended };
        if let (Encapsulation::Serial, &[byte]) = (self.0, bytes) {
            return self.single(byte, context, sink);
        }
        let request = self.request(context);
        match self.open(&raw) {
            Ok(said) => {
                say::message(&said, request.as_ref(), context.profile, sink);
                talk::value(&said, context.profile, sink);
            }
            Err((error, said)) => {
                match said {
                    Some(said) => say::message(&said, None, context.profile, sink),
                    None => sink.kind("TML"),
                }
                sink.error(error);
            }
        }
    }

    fn encode(
        &self,
        text: &str,
        addressing: &Addressing,
        out: &mut [u8],
    ) -> Result<Encoded, EncodeError> {
        let wire = self.wire(addressing.via)?;
        let to = destination(addressing)?;
        let host = host(wire, to, addressing)?;
        let sender = match wire {
            Wire::Rs232 => IdCode::host_at(host),
            _ => IdCode::axis(host),
        };
        let instruction = names::assemble(text, addressing.profile, sender)?;
        let message = Message { to, instruction };
        wire.check(&message).map_err(forbidden)?;
        let answered = rules::is_request(instruction.opcode);
        if answered && !to.group && wire != Wire::Rs232 {
            wire.host_id(host, to.id).map_err(forbidden)?;
        }
        let (bytes, len, id) = self.pack(&message).map_err(forbidden)?;
        let room = TextError { at: 0, expected: "room for 14 bytes" };
        out.get_mut(..len).ok_or(room)?.copy_from_slice(&bytes[..len]);
        let extended = self.0 == Encapsulation::TmlCan;
        let answer = expect::length(&message, wire);
        Ok(Encoded { len, id, extended, remote: None, answer, warning: warning(wire, to) })
    }

    fn named(
        &self,
        name: &str,
        value: u32,
        profile: Option<&'static Profile>,
        sink: &mut dyn Sink,
    ) -> bool {
        register::explain(name, value, profile, sink)
    }

    fn reach(&self, parameter: &Parameter, sink: &mut dyn Sink) {
        names::reach(parameter, sink);
    }

    fn code(&self, _: u32) -> Option<&'static str> {
        None
    }

    fn expect(&self, request: &Raw<'_>, addressing: &Addressing, sink: &mut dyn Sink) {
        let Ok(wire) = self.wire(addressing.via) else { return };
        if let Ok(said) = self.open(request) {
            expect::explain(&said, wire, addressing.profile, sink);
        }
    }

    fn asks(&self, frame: &Raw<'_>) -> bool {
        match self.0 {
            // Every frame is acknowledged; single bytes are no frames.
            Encapsulation::Serial => frame.bytes.len() > 1,
            _ => self.open(frame).is_ok_and(|said| rules::is_request(said.instruction.opcode)),
        }
    }

    fn answers(&self, frame: &Raw<'_>, request: &Raw<'_>) -> bool {
        let (Ok(said), Ok(asked)) = (self.open(frame), self.open(request)) else { return false };
        answers(&said, &asked)
    }

    fn turn(&self, frame: &Raw<'_>, talk: &Talk<'_>) -> Turn {
        let serial = self.0 == Encapsulation::Serial;
        if let (true, &[byte]) = (serial, frame.bytes) {
            let acks = byte == ACK && talk.direction != Some(Direction::ToDrive);
            return if acks { Turn::Acknowledges } else { Turn::Aside };
        }
        self.open(frame).map_or(Turn::Aside, |said| talk::turn(&said, serial, talk.direction))
    }

    fn effect(&self, frame: &Raw<'_>, _: Option<&'static Profile>) -> Effect {
        match frame.bytes {
            // An acknowledgement, or bytes that synchronise.
            [_] if self.0 == Encapsulation::Serial => Effect::NOTHING,
            _ => self.open(frame).map_or(Effect::UNKNOWN, |said| talk::effect(&said)),
        }
    }

    fn place(&self, request: &Raw<'_>) -> Option<Place> {
        talk::place(&self.open(request).ok()?)
    }
}

impl TmlDissector {
    /// What a frame says, or what is wrong with it and what it says all the same.
    fn open(&self, raw: &Raw<'_>) -> Result<Said, (WireError, Option<Said>)> {
        match (self.0, raw.id) {
            (Encapsulation::Serial, _) => layout::serial(raw.bytes),
            (_, None) => Err((WireError::Identifier { found: 0 }, None)),
            (Encapsulation::TmlCan, Some(id)) => layout::tmlcan(&frame(id, raw)),
            (Encapsulation::TechnoCan, Some(id)) => layout::technocan(&frame(id, raw)),
        }
    }

    /// The request that a frame is known to belong to.
    fn request(&self, context: &Context<'_>) -> Option<Said> {
        let bytes = context.request?;
        self.open(&Raw { bytes, id: context.request_id, extended: context.extended }).ok()
    }

    /// A byte between frames.
    fn single(&self, byte: u8, context: &Context<'_>, sink: &mut dyn Sink) {
        let (to_drive, to_host) = match context.direction {
            Some(direction) => (direction == Direction::ToDrive, direction == Direction::ToHost),
            None => (false, false),
        };
        match byte {
            ACK if !to_drive => say::ack(self.request(context).as_ref(), context.profile, sink),
            SYNC => say::sync(byte, context.direction, sink),
            SYNC.. if !to_host => say::sync(byte, context.direction, sink),
            found => {
                sink.kind("TML");
                sink.error(match serial::span(found) {
                    Some(need) => WireError::Short { need: need as u16, found: 1 },
                    None => WireError::Count { at: 0, found: found.into() },
                });
            }
        }
    }

    /// The wire whose rules hold.
    fn wire(&self, via: Via) -> Result<Wire, EncodeError> {
        let both = "CAN carries TML in two ways; say tmlcan or technocan";
        let other = "this wire has no serial form; say tml";
        match (self.0, via) {
            (Encapsulation::Serial, Via::Usual | Via::Serial) => Ok(Wire::Rs232),
            (Encapsulation::Serial, Via::Rs485) => Ok(Wire::Rs485),
            (Encapsulation::TmlCan, Via::Usual | Via::Can) => Ok(Wire::TmlCan),
            (Encapsulation::TechnoCan, Via::Usual | Via::Can) => Ok(Wire::TechnoCan),
            (Encapsulation::Serial, Via::Can) => Err(EncodeError::Forbidden(both)),
            _ => Err(EncodeError::Forbidden(other)),
        }
    }

    fn pack(&self, message: &Message) -> Result<([u8; FRAME_MAX], usize, Option<u32>), Rule> {
        let mut out = [0; FRAME_MAX];
        let frame = match self.0 {
            Encapsulation::Serial => {
                let len = serial::encode(message, &mut out);
                return Ok((out, len, None));
            }
            Encapsulation::TmlCan => tmlcan::encode(message),
            Encapsulation::TechnoCan => technocan::encode(message)?,
        };
        let data = frame.bytes();
        out[..data.len()].copy_from_slice(data);
        Ok((out, data.len(), Some(frame.id)))
    }
}

/// What TechnoCAN does to axis IDs above 31.
const fn warning(wire: Wire, to: IdCode) -> &'static str {
    if matches!(wire, Wire::TechnoCan) && !to.group && technocan::is_ambiguous(to.id) {
        "TechnoCAN takes axis IDs modulo 32, so another axis may obey too; give drives IDs from 1 to \
         31"
    } else {
        ""
    }
}

const fn forbidden(rule: Rule) -> EncodeError {
    EncodeError::Forbidden(rule.sentence())
}

fn frame(id: u32, raw: &Raw<'_>) -> Frame {
    let mut frame = Frame::standard(0, raw.bytes);
    (frame.id, frame.extended) = (id, raw.extended);
    frame
}

/// Whether `said` is an answer to `asked`: by what both say, and by whom it is for where a request
/// names its sender.
fn answers(said: &Said, asked: &Said) -> bool {
    let (Some(answer), Some(request)) =
        (Online::parse(&said.instruction), Online::parse(&asked.instruction))
    else {
        return false;
    };
    let back = match (said.to, request.reply_to()) {
        // TechnoCAN has numbers for axis IDs: the host 255 is answered as 31.
        (Some(to), Some(sender)) if said.class.is_some() => to.id % 32 == sender.id % 32,
        (Some(to), Some(sender)) => to.id == sender.id,
        _ => true,
    };
    back && answer.answers(&request, asked.to.unwrap_or(IdCode::BROADCAST))
}

/// Whom a text is for; by default the axis with the ID from the factory.
fn destination(addressing: &Addressing) -> Result<IdCode, TextError> {
    let expected = "an axis ID, 0 to 255";
    let id = addressing.axis.unwrap_or(AXIS.into());
    let id = u8::try_from(id).map_err(|_| TextError { at: 0, expected })?;
    Ok(if addressing.groups { IdCode::groups(id) } else { IdCode::axis(id) })
}

/// The host's ID. By default that of the drive on RS-232, and elsewhere the factory's or the one
/// below it, so that it is not the drive's.
fn host(wire: Wire, to: IdCode, addressing: &Addressing) -> Result<u8, TextError> {
    let expected = "a host ID, 1 to 255";
    let usual = match wire {
        Wire::Rs232 if !to.group && to.id != 0 => to.id,
        Wire::Rs232 => AXIS,
        _ if wire.host_id(AXIS, to.id).is_err() && !to.group => AXIS - 1,
        _ => AXIS,
    };
    let host = addressing.host.unwrap_or(usual.into());
    u8::try_from(host).ok().filter(|host| *host != 0).ok_or(TextError { at: 0, expected })
}

/// Where a piece of a serial stream ends.
fn cut(bytes: &[u8], direction: Option<Direction>, ended: bool) -> Cut {
    let Some(&first) = bytes.first() else { return Cut::More };
    let Some(whole) = serial::span(first) else {
        return if is_single(first, direction) { Cut::Frame(1) } else { Cut::Skip(1) };
    };
    match bytes.get(..whole) {
        Some(frame) if serial::decode(frame).is_ok() => Cut::Frame(whole),
        Some(_) => resynchronise(bytes, whole, ended),
        None if !ended => Cut::More,
        None => match inside(bytes, bytes.len()) {
            Some(at) => Cut::Skip(at),
            None if has_id_code(bytes) => Cut::Broken(bytes.len()),
            None => Cut::Skip(1),
        },
    }
}

/// Whether a byte between frames is known to stand there: acks from drives, synchronisation both
/// ways.
fn is_single(byte: u8, direction: Option<Direction>) -> bool {
    match direction {
        Some(Direction::ToDrive) => matches!(byte, SYNC | SYNC_TOO),
        Some(Direction::ToHost) => matches!(byte, ACK | SYNC),
        None => matches!(byte, ACK | SYNC | SYNC_TOO),
    }
}

/// The bytes have a frame's length and are none. If a good frame begins among them, what is before
/// it lost a byte, or belongs to none; else they are a broken one.
fn resynchronise(bytes: &[u8], whole: usize, ended: bool) -> Cut {
    let follows = bytes.get(whole..).is_some_and(is_frame);
    let shaped = has_id_code(bytes);
    match inside(bytes, whole) {
        Some(at) if !follows => {
            if shaped && at >= serial::FRAME_MIN - 1 {
                Cut::Broken(at)
            } else {
                Cut::Skip(at)
            }
        }
        None if !ended && !follows && bytes.len() < whole + FRAME_MAX => Cut::More,
        _ if shaped => Cut::Broken(whole),
        _ => Cut::Skip(1),
    }
}

/// Where, before `end`, a good frame begins.
fn inside(bytes: &[u8], end: usize) -> Option<usize> {
    (1..end).find(|at| is_frame(&bytes[*at..]))
}

fn is_frame(bytes: &[u8]) -> bool {
    let whole = bytes.first().and_then(|length| serial::span(*length));
    whole.and_then(|whole| bytes.get(..whole)).is_some_and(|frame| serial::decode(frame).is_ok())
}

/// Whether an ID code stands behind the length byte, as far as it is there.
fn has_id_code(bytes: &[u8]) -> bool {
    let byte = |at: usize| bytes.get(at).copied().unwrap_or(0);
    IdCode::from_word(u16::from_be_bytes([byte(1), byte(2)])).is_some()
}
