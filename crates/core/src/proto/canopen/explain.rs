//! Frames for people: what the fields are, and what a frame means.
//!
//! Identifiers are read by the predefined connection set. PDO2's are other protocols' too (thrusters,
//! Elmo drives), so in a capture that nobody explains they count only for a node that something
//! else proves to be CANopen's. What process data hold is the node's mapping, which the frame does
//! not tell.

mod effect;
mod fields;
mod names;
pub mod say;

use core::fmt::Write as _;

use super::cia402;
use super::cob::Cob;
use super::lss;
use super::nmt::{Command, State};
use super::sdo::{Abort, BLOCK_MAX, Reply, Request, Short};
use super::sync;
use super::text::{self, Said};
use super::{NODE_MAX, emcy};
use crate::error::WireError;
use crate::explain::{
    Addressing, Context, Cut, Direction, Dissector, Effect, EncodeError, Encoded, Field, Raw, Sink,
    TextError, Value,
};
use crate::medium::Frame;
use crate::profile::Profile;
use fields::Fields;
pub use fields::usual_mapping;
use say::Pieces;

/// The protocol in captures, dashboards and the encoder.
#[derive(Clone, Copy, Debug)]
pub struct CanopenDissector;

/// Node that a text is encoded for when none is named.
const NODE: u32 = 1;
const DAY_MS: u32 = 86_400_000;

impl Dissector for CanopenDissector {
    fn name(&self) -> &'static str {
        "canopen"
    }

    fn cut(&self, bytes: &[u8], _direction: Option<Direction>, ended: bool) -> Cut {
        if ended || !bytes.is_empty() { Cut::Skip(bytes.len()) } else { Cut::More }
    }

    fn claims(&self, id: u32, extended: bool) -> bool {
        !extended && cob(id).is_some()
    }

    fn claims_remote(&self, id: u32, extended: bool) -> bool {
        !extended && matches!(cob(id), Some(Cob::Tpdo(..) | Cob::Heartbeat(_)))
    }

    fn shares(&self, id: u32, extended: bool) -> bool {
        !extended && matches!(cob(id), Some(Cob::Tpdo(2, _) | Cob::Rpdo(2, _)))
    }

    fn explain(&self, bytes: &[u8], context: &Context<'_>, sink: &mut dyn Sink) {
        let Some(frame) = frame(bytes, context) else {
            sink.kind("canopen");
            return sink.error(WireError::Identifier { found: context.id.unwrap_or(0) });
        };
        let cob = Cob::of(frame.id as u16);
        let node = match (cob, bytes) {
            (Cob::Nmt, [_, node]) => Some(*node).filter(|node| (1..=NODE_MAX).contains(node)),
            _ => cob.node(),
        };
        node.into_iter().for_each(|node| sink.axis(node.into()));
        sink.kind(kind_of(cob));
        match Said::of(&frame, false) {
            Ok(said) => explain(&said, &frame, node.unwrap_or(0), context, sink),
            Err(error) => {
                let _ = text::write(&Said::Raw(frame), &|_| false, &mut Pieces(sink));
                sink.error(error);
            }
        }
    }

    fn plain(&self, frame: &Raw<'_>) -> Option<u32> {
        match frame.id.filter(|_| !frame.extended && frame.bytes.len() <= 8).and_then(cob) {
            Some(Cob::Tpdo(_, node) | Cob::Rpdo(_, node)) => Some(node.into()),
            _ => None,
        }
    }

    fn encode(
        &self,
        text: &str,
        addressing: &Addressing,
        out: &mut [u8],
    ) -> Result<Encoded, EncodeError> {
        let said = text::parse(text, addressing.profile)?;
        let axis = addressing.axis.unwrap_or(NODE);
        let (said, node) = match said {
            Said::Order(command, _) if axis == 0 => (Said::Order(command, true), 0),
            // It has its identifier.
            Said::Raw(frame) => (Said::Raw(frame), 0),
            said => {
                let expected = "a node-ID, 1 to 127, for --axis";
                let wrong = TextError { at: 0, expected };
                let node = u8::try_from(axis).ok().filter(|node| (1..=NODE_MAX).contains(node));
                (said, node.ok_or(wrong)?)
            }
        };
        let frame = said.frame(node);
        let room = TextError { at: 0, expected: "room for eight bytes" };
        let len = if frame.remote { 0 } else { frame.bytes().len() };
        out.get_mut(..len).ok_or(room)?.copy_from_slice(&frame.bytes()[..len]);
        Ok(Encoded {
            len,
            id: Some(frame.id),
            extended: false,
            remote: frame.remote.then_some(frame.len),
            answer: answer(&frame),
            warning: warning(&said),
        })
    }

    fn code(&self, code: u32) -> Option<&'static str> {
        if let Some(text) = Abort(code).text() {
            return Some(text);
        }
        let code = u16::try_from(code).ok()?;
        if code >> 8 >= 0x10 {
            return Some(emcy::class(code)).filter(|class| *class != "unknown class");
        }
        Some(match cia402::State::of(code) {
            cia402::State::Other(_) => return None,
            state => state.name(),
        })
    }

    fn named(
        &self,
        name: &str,
        value: u32,
        profile: Option<&'static Profile>,
        sink: &mut dyn Sink,
    ) -> bool {
        let is = |word: &str| name.eq_ignore_ascii_case(word);
        if is("statusword") || is("0x6041:0") || is("0x6041") {
            return word(value as u16, false, sink);
        }
        if is("controlword") || is("0x6040:0") || is("0x6040") {
            return word(value as u16, true, sink);
        }
        if is("emcy") {
            sink.kind("emcy");
            sink.text(say::fault(value as u16, profile));
            return true;
        }
        if is("abort") {
            sink.kind("abort");
            sink.text(say::abort(Abort(value)));
            return true;
        }
        let Some(object) = text::named_object(name, profile).filter(|_| !is_hex(name)) else {
            return false;
        };
        sink.kind("object");
        let number = say::number(object, value, 0, profile);
        let _ = say::value(object, number, profile, &mut Pieces(sink));
        true
    }

    fn asks(&self, frame: &Raw<'_>) -> bool {
        let asks = |id| matches!(cob(id), Some(Cob::SdoRequest(_) | Cob::LssRequest));
        !frame.extended && frame.id.is_some_and(asks)
    }

    fn answers(&self, frame: &Raw<'_>, request: &Raw<'_>) -> bool {
        match (frame.id.and_then(cob), request.id.and_then(cob)) {
            (Some(Cob::SdoReply(from)), Some(Cob::SdoRequest(to))) if from == to => {
                service_answers(frame.bytes, request.bytes)
            }
            (Some(Cob::LssReply), Some(Cob::LssRequest)) => lss_answers(frame.bytes, request.bytes),
            _ => false,
        }
    }

    fn speaker(&self, frame: &Raw<'_>, _: Option<Raw<'_>>) -> Option<Direction> {
        effect::speaker(frame.id.filter(|_| !frame.extended).and_then(cob)?)
    }

    fn effect(&self, frame: &Raw<'_>, profile: Option<&'static Profile>) -> Effect {
        match frame.id.filter(|_| !frame.extended && frame.bytes.len() <= 8).and_then(cob) {
            Some(cob) => effect::of(cob, frame.bytes, profile),
            None => Effect::UNKNOWN,
        }
    }

    fn expect(&self, request: &Raw<'_>, addressing: &Addressing, sink: &mut dyn Sink) {
        let Some(Cob::SdoRequest(node)) = request.id.and_then(cob) else { return };
        let asked = Frame::standard(0x600 + u16::from(node), request.bytes);
        let Ok(Said::Request(asked, _)) = Said::of(&asked, false) else { return };
        let reply = match asked {
            Request::Write(object, _) | Request::WriteLong(object, _) => Reply::Written(object, 0),
            Request::WriteSegment(segment) => Reply::WrittenSegment(segment.toggle),
            _ => return,
        };
        let frame = reply.emit(node);
        let context =
            Context { profile: addressing.profile, id: Some(frame.id), ..Context::default() };
        self.explain(frame.bytes(), &context, sink);
    }
}

/// Explains a segment of a block, which nobody but who follows the transfer can tell from a command:
/// `bytes` are eight, and the identifier that of the node's default channel.
pub fn explain_part(bytes: &[u8], context: &Context<'_>, sink: &mut dyn Sink) {
    let Some(frame) = frame(bytes, context) else { return };
    let node = Cob::of(frame.id as u16).node().unwrap_or(0);
    sink.axis(node.into());
    if let Ok(said) = Said::of(&frame, true) {
        explain(&said, &frame, node, context, sink);
    }
}

/// What an identifier of the predefined connection set is for.
fn cob(id: u32) -> Option<Cob> {
    let id = u16::try_from(id).ok().filter(|id| *id <= 0x7FF)?;
    Some(Cob::of(id)).filter(|cob| !matches!(cob, Cob::Other(_)))
}

/// A bare hexadecimal byte, as frames have them.
fn is_hex(name: &str) -> bool {
    name.len() == 2 && name.bytes().all(|byte| byte.is_ascii_hexdigit())
}

/// The frame, if it can be one of this protocol's.
fn frame(bytes: &[u8], context: &Context<'_>) -> Option<Frame> {
    let id = context.id.filter(|id| !context.extended && cob(*id).is_some())?;
    let fits = bytes.len() <= 8;
    let frame = fits.then(|| Frame::standard(id as u16, bytes))?;
    Some(Frame { remote: context.remote, ..frame })
}

fn explain(said: &Said, frame: &Frame, node: u8, context: &Context<'_>, sink: &mut dyn Sink) {
    let profile = context.profile;
    sink.kind(kind(said, frame));
    Fields { frame, profile, sink }.of(said);
    let signs = |object| say::signed(object, profile);
    let again = said.frame(node);
    // Who asks for a state asks for whatever length.
    let same = frame.remote || again.bytes() == frame.bytes();
    let mut pieces = Pieces(sink);
    let written = same && text::write(said, &signs, &mut pieces).unwrap_or(false);
    if !written {
        let _ = text::write(&Said::Raw(*frame), &signs, &mut pieces);
    }
    remark(said, frame, context, sink);
    if let Some(error) = broken(said, frame) {
        sink.error(error);
    }
}

/// What a frame breaks that says something all the same.
fn broken(said: &Said, frame: &Frame) -> Option<WireError> {
    let unexpected = |at: u16| {
        let found = frame.data[usize::from(at)];
        Some(WireError::Unexpected { at, found })
    };
    let count = |at: u16, found: u8| Some(WireError::Count { at, found: found.into() });
    let blocks = 1..=BLOCK_MAX;
    match *said {
        Said::Order(Command::Other(_), _) => unexpected(0),
        Said::State(heartbeat) if matches!(heartbeat.state, State::Other(_)) => unexpected(0),
        Said::Sync(sync::Sync { counter: Some(counter @ (0 | 241..)) }) => count(0, counter),
        Said::Time(time) if time.ms >= DAY_MS => unexpected(3),
        Said::Lss(lss::Request::Other(_)) | Said::LssReply(lss::Reply::Other(_)) => unexpected(0),
        Said::Request(Request::Other(_), _) | Said::Reply(Reply::Other(_), _) => unexpected(0),
        Said::Request(
            Request::ReadBlock { segments, .. } | Request::ReadBlockAck { segments, .. },
            _,
        )
        | Said::Reply(
            Reply::WriteBlockReady { segments, .. } | Reply::WriteBlockAck { segments, .. },
            _,
        ) if !blocks.contains(&segments) => {
            let at = if said.object().is_some() { 4 } else { 2 };
            count(at, segments)
        }
        Said::Request(_, 7) | Said::Reply(_, 7) if !is_whole_in_seven(said) => {
            Some(WireError::Short { need: 8, found: 7 })
        }
        _ => None,
    }
}

/// Whether the byte that lacks of eight would not count anyway.
fn is_whole_in_seven(said: &Said) -> bool {
    matches!(
        said,
        Said::Request(
            Request::Write(_, Short { len: 1..=3, .. })
                | Request::Read(_)
                | Request::ReadSegment(_),
            _
        ) | Said::Reply(Reply::Written(..) | Reply::Value(_, Short { len: 1..=3, .. }), _)
    )
}

/// Whether a reply of the same node can be to that request: the same object, or the next of it.
fn service_answers(reply: &[u8], request: &[u8]) -> bool {
    let eight = |bytes: &[u8]| {
        let mut all = [0; 8];
        all.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
        (bytes.len() >= 7).then_some(all)
    };
    let (Some(reply), Some(request)) = (eight(reply), eight(request)) else { return false };
    let (reply, request) = (Reply::of(reply), Request::of(request));
    if let (Some(told), Some(asked)) = (reply.object(), request.object()) {
        return told == asked;
    }
    // One with another toggle answers an older segment.
    match (reply, request) {
        (Reply::ValueSegment(told), Request::ReadSegment(asked)) => return told.toggle == asked,
        (Reply::WrittenSegment(told), Request::WriteSegment(asked)) => return told == asked.toggle,
        _ => {}
    }
    matches!(
        (reply, request),
        (Reply::WriteBlockDone, Request::WriteBlockEnd { .. })
            | (Reply::ReadBlockEnd { .. }, Request::ReadBlockAck { .. })
            | (Reply::Abort(..), _)
    )
}

/// Whether a reply of layer setting can be to that request.
#[must_use]
pub fn lss_answers(reply: &[u8], request: &[u8]) -> bool {
    let (Ok(reply), Ok(request)) = (lss::Reply::parse(reply), lss::Request::parse(request)) else {
        return false;
    };
    use lss::{Reply, Request};
    match (reply, request) {
        (Reply::Selected, Request::SwitchSelective(..))
        | (Reply::SetNode(..), Request::SetNode(_))
        | (Reply::SetBitTiming(..), Request::SetBitTiming(..))
        | (Reply::Store(..), Request::Store)
        | (Reply::Node(_), Request::InquireNode)
        | (Reply::Identified, Request::Identify(..) | Request::FastScan { .. })
        | (Reply::Unconfigured, Request::IdentifyUnconfigured) => true,
        (Reply::Number(told, _), Request::Inquire(asked)) => told == asked,
        _ => false,
    }
}

/// How many bytes the answer has, if there is one.
fn answer(frame: &Frame) -> Option<usize> {
    match Cob::of(frame.id as u16) {
        Cob::Heartbeat(_) if frame.remote => Some(1),
        Cob::SdoRequest(_) => Some(8),
        Cob::LssRequest => match lss::Request::parse(frame.bytes()).ok()? {
            lss::Request::SwitchGlobal(_)
            | lss::Request::ActivateBitTiming(_)
            | lss::Request::Other(_) => None,
            _ => Some(8),
        },
        _ => None,
    }
}

fn warning(said: &Said) -> &'static str {
    match *said {
        Said::Write(_, _, 5..) => "the first frame: eight bytes go in segments behind it",
        Said::Order(_, true) => "to every node on the bus",
        Said::Lss(lss::Request::SwitchGlobal(true)) => {
            "to every device: where there are several, all of them take the next node-ID"
        }
        Said::Lss(lss::Request::ActivateBitTiming(_)) => {
            "every node in configuration changes its bit rate: those that do not are lost"
        }
        _ => "",
    }
}

/// What the language does not say, in parentheses.
fn remark(said: &Said, frame: &Frame, context: &Context<'_>, sink: &mut dyn Sink) {
    let mut out = Remark { sink, open: false };
    let _ = remarks(said, frame, context, &mut out);
    if out.open {
        sink.text(")");
    }
}

/// Parentheses that open with the first piece.
struct Remark<'a> {
    sink: &'a mut dyn Sink,
    open: bool,
}

impl core::fmt::Write for Remark<'_> {
    fn write_str(&mut self, piece: &str) -> core::fmt::Result {
        if !self.open && !piece.is_empty() {
            self.sink.text(" (");
            self.open = true;
        }
        // A parenthesis would end the remark, a semicolon the instruction.
        for (at, part) in piece.split(';').enumerate() {
            self.sink.text(if at > 0 { "," } else { "" });
            part.split(['(', ')']).for_each(|part| self.sink.text(part));
        }
        Ok(())
    }
}

fn remarks(
    said: &Said,
    frame: &Frame,
    context: &Context<'_>,
    out: &mut Remark<'_>,
) -> core::fmt::Result {
    let profile = context.profile;
    match *said {
        Said::Request(Request::Write(object, short), _)
        | Said::Reply(Reply::Value(object, short), _) => {
            say::value(object, say::number(object, short.bits, short.len, profile), profile, out)?;
            if matches!(short.len, 1..=3) && short.bits >> (8 * short.len) != 0 {
                out.write_str("; the command's size is too small for it")?;
            }
        }
        Said::Reply(Reply::Written(object, echo), _) => {
            out.write_str(say::name(object, profile))?;
            if echo != 0 {
                out.write_str(if out.open { "; " } else { "" })?;
                out.write_str("repeats the data, which the standard leaves zero")?;
            }
        }
        Said::Request(Request::Abort(_, abort), _) | Said::Reply(Reply::Abort(_, abort), _) => {
            out.write_str(say::abort(abort))?;
            let object = said.object().unwrap_or_default();
            let name = say::name(object, profile);
            if !name.is_empty() {
                write!(out, ": {name}")?;
            }
        }
        Said::Emergency(emergency, short) => emergency_remark(emergency.code, short, profile, out)?,
        Said::Process { len, .. } => process_remark(frame, len, profile, out)?,
        Said::LssReply(
            lss::Reply::SetNode(error @ 1.., _)
            | lss::Reply::SetBitTiming(error @ 1.., _)
            | lss::Reply::Store(error @ 1.., _),
        ) => write!(out, "refused, error {error}")?,
        Said::Lss(lss::Request::SetBitTiming(0, index)) => {
            match lss::KBIT_PER_S.get(usize::from(index)) {
                Some(rate @ 1..) => write!(out, "{rate} kbit/s")?,
                _ => out.write_str("no bit rate of the standard's table")?,
            }
        }
        Said::State(heartbeat) if heartbeat.toggle => out.write_str("answer to guarding")?,
        Said::Guard => out.write_str("asks for the state")?,
        _ => {
            let object = said.object().map_or("", |object| say::name(object, profile));
            out.write_str(object)?;
        }
    }
    if matches!(said, Said::Request(_, 7) | Said::Reply(_, 7)) {
        let join = if out.open { "; " } else { "" };
        write!(out, "{join}7 of 8 bytes, which the standard ignores and the TS drive takes")?;
    }
    Ok(())
}

fn emergency_remark(
    code: u16,
    short: bool,
    profile: Option<&'static Profile>,
    out: &mut Remark<'_>,
) -> core::fmt::Result {
    let known = say::own(profile).and_then(|p| p.faults.iter().find(|f| f.code == u32::from(code)));
    match (known, say::shown(code).filter(|_| short)) {
        (Some(fault), _) => write!(out, "{}: {}", fault.name, fault.text.trim_end_matches('.')),
        (None, Some([a, b])) => write!(out, "two bytes, as a TS drive that shows {a}{b}"),
        (None, None) => out.write_str(emcy::class(code)),
    }
}

/// Process data by the mapping that drives have from the factory, if their length is its.
fn process_remark(
    frame: &Frame,
    len: u8,
    profile: Option<&'static Profile>,
    out: &mut Remark<'_>,
) -> core::fmt::Result {
    let cob = Cob::of(frame.id as u16);
    let Some(map) = fields::usual_mapping(cob, len) else {
        let (object, number) = match cob {
            Cob::Rpdo(number, _) => (0x1600, number),
            Cob::Tpdo(number, _) => (0x1A00, number),
            _ => return Ok(()),
        };
        return write!(out, "by its mapping, 0x{:04X}", object + u16::from(number) - 1);
    };
    out.write_str("if mapped as usual:")?;
    let data = u64::from_le_bytes(frame.data);
    let mut join = " ";
    for (entry, field) in map.fields() {
        let raw = match say::signed(entry.object, profile) {
            true => field.signed(data),
            false => field.unsigned(data).cast_signed(),
        };
        out.write_str(join)?;
        say::value(entry.object, raw, profile, out)?;
        join = "; ";
    }
    Ok(())
}

/// Shows a controlword's or statusword's bits.
fn word(word: u16, orders: bool, sink: &mut dyn Sink) -> bool {
    let (kind, low, bits) = match orders {
        true => ("controlword", &CONTROL_LOW[..], &say::CONTROL_BITS),
        false => ("statusword", &STATUS_LOW[..], &say::STATUS_BITS),
    };
    sink.kind(kind);
    let mut pieces = Pieces(sink);
    let _ = match orders {
        true => say::controlword(word, &mut pieces),
        false => say::statusword(word, &mut pieces),
    };
    let mut all = [(0, ""); 16];
    low.iter().chain(bits).for_each(|(bit, name)| all[usize::from(*bit)] = (*bit, name));
    for (bit, name) in all.into_iter().filter(|(_, name)| !name.is_empty()) {
        let value = Value::Int((word >> bit & 1).into());
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

/// What a frame of that identifier is called before its bytes are read.
const fn kind_of(cob: Cob) -> &'static str {
    match cob {
        Cob::Nmt => "NMT",
        Cob::Sync => "SYNC",
        Cob::Time => "TIME",
        Cob::Emcy(_) => "EMCY",
        Cob::Rpdo(1, _) => "RPDO1",
        Cob::Rpdo(2, _) => "RPDO2",
        Cob::Rpdo(3, _) => "RPDO3",
        Cob::Rpdo(..) => "RPDO4",
        Cob::Tpdo(1, _) => "TPDO1",
        Cob::Tpdo(2, _) => "TPDO2",
        Cob::Tpdo(3, _) => "TPDO3",
        Cob::Tpdo(..) => "TPDO4",
        Cob::SdoReply(_) | Cob::SdoRequest(_) => "SDO",
        Cob::Heartbeat(_) => "heartbeat",
        Cob::LssReply | Cob::LssRequest => "LSS",
        Cob::Other(_) => "canopen",
    }
}

fn kind(said: &Said, frame: &Frame) -> &'static str {
    match *said {
        Said::State(heartbeat) if heartbeat.state == State::BootUp => "boot-up",
        Said::Guard => "guarding",
        Said::Request(request, _) => request_kind(request),
        Said::Reply(reply, _) => reply_kind(reply),
        Said::Part(_, false) => "SDO block write segment",
        Said::Part(_, true) => "SDO block read segment",
        Said::Lss(request) => lss_kind(request),
        Said::LssReply(reply) => lss_reply_kind(reply),
        _ => kind_of(Cob::of(frame.id as u16)),
    }
}

const fn request_kind(request: Request) -> &'static str {
    match request {
        Request::Write(..) => "SDO write",
        Request::WriteLong(..) => "SDO segmented write",
        Request::WriteSegment(_) => "SDO write segment",
        Request::Read(_) => "SDO read",
        Request::ReadSegment(_) => "SDO read segment",
        Request::WriteBlock { .. } => "SDO block write",
        Request::WriteBlockEnd { .. } => "SDO block write end",
        Request::ReadBlock { .. } => "SDO block read",
        Request::ReadBlockStart => "SDO block read start",
        Request::ReadBlockAck { .. } => "SDO block read acknowledge",
        Request::ReadBlockEnd => "SDO block read done",
        Request::Abort(..) => "SDO abort",
        Request::Other(_) => "SDO unknown request",
    }
}

const fn reply_kind(reply: Reply) -> &'static str {
    match reply {
        Reply::Written(..) => "SDO written",
        Reply::WrittenSegment(_) => "SDO written segment",
        Reply::Value(..) => "SDO value",
        Reply::ValueLong(..) => "SDO segmented value",
        Reply::ValueSegment(_) => "SDO value segment",
        Reply::WriteBlockReady { .. } => "SDO block write ready",
        Reply::WriteBlockAck { .. } => "SDO block write acknowledge",
        Reply::WriteBlockDone => "SDO block write done",
        Reply::ReadBlockReady { .. } => "SDO block read ready",
        Reply::ReadBlockEnd { .. } => "SDO block read end",
        Reply::Abort(..) => "SDO abort",
        Reply::Other(_) => "SDO unknown reply",
    }
}

/// The word for a request of layer setting.
#[must_use]
pub const fn lss_kind(request: lss::Request) -> &'static str {
    use lss::Request;
    match request {
        Request::SwitchGlobal(_) => "LSS switch all",
        Request::SwitchSelective(..) => "LSS select",
        Request::SetNode(_) => "LSS set node-ID",
        Request::SetBitTiming(..) => "LSS set bit timing",
        Request::ActivateBitTiming(_) => "LSS activate bit timing",
        Request::Store => "LSS store",
        Request::Inquire(_) | Request::InquireNode => "LSS inquire",
        Request::Identify(..) => "LSS identify",
        Request::IdentifyUnconfigured => "LSS identify unconfigured",
        Request::FastScan { .. } => "LSS fast scan",
        Request::Other(_) => "LSS unknown request",
    }
}

const fn lss_reply_kind(reply: lss::Reply) -> &'static str {
    use lss::Reply;
    match reply {
        Reply::Selected => "LSS selected",
        Reply::SetNode(..) => "LSS node-ID set",
        Reply::SetBitTiming(..) => "LSS bit timing set",
        Reply::Store(..) => "LSS stored",
        Reply::Number(..) | Reply::Node(_) => "LSS answer",
        Reply::Identified => "LSS identified",
        Reply::Unconfigured => "LSS unconfigured",
        Reply::Other(_) => "LSS unknown reply",
    }
}
