//! Text form of the messages: `write 0x6040:0 u16 0x000F`, `read 0x6041:0`, `nmt start`, `rpdo1 0F 00`,
//! `lss node 5`; for nodes `value 0x6041:0 u16 0x0037`, `written 0x6040:0`, `heartbeat operational`. Text
//! in parentheses is a comment. Other frames are `raw`, an identifier and bytes. Every text that is written
//! here can be read here.

mod parse;
mod write;

pub use parse::{named_object, parse};
pub use write::{SignLookup, write};

use super::cob::Cob;
use super::emcy::Emergency;
use super::heartbeat::{self, Heartbeat};
use super::host_request::HostRequest;
use super::lss;
use super::nmt::{NmtCommand, NmtMessage};
use super::sdo::{self, BlockSegment, ExpeditedData, ObjectIndex, SdoReply, SdoRequest};
use super::sync::SyncMessage;
use super::time::TimeOfDay;
use crate::error::{Failure, WireError};
use crate::medium::Frame;
use crate::station::RequestClass;

/// Types of values, with their bytes.
const TYPES: [(&str, u8); 10] = [
    ("u8", 1),
    ("i8", 1),
    ("u16", 2),
    ("i16", 2),
    ("u24", 3),
    ("i24", 3),
    ("u32", 4),
    ("i32", 4),
    ("u64", 8),
    ("i64", 8),
];

const COMMANDS: [(&str, NmtCommand); 5] = [
    ("start", NmtCommand::Start),
    ("stop", NmtCommand::Stop),
    ("pre-operational", NmtCommand::PreOperational),
    ("reset", NmtCommand::ResetNode),
    ("reset-communication", NmtCommand::ResetCommunication),
];

const NUMBERS: [(&str, lss::IdentityNumber); 4] = [
    ("vendor", lss::IdentityNumber::Vendor),
    ("product", lss::IdentityNumber::Product),
    ("revision", lss::IdentityNumber::Revision),
    ("serial", lss::IdentityNumber::Serial),
];

const BOUNDS: [(&str, lss::IdentifyBound); 6] = [
    ("vendor", lss::IdentifyBound::Vendor),
    ("product", lss::IdentifyBound::Product),
    ("revision-low", lss::IdentifyBound::RevisionLow),
    ("revision-high", lss::IdentifyBound::RevisionHigh),
    ("serial-low", lss::IdentifyBound::SerialLow),
    ("serial-high", lss::IdentifyBound::SerialHigh),
];

/// The first frame of a fast scan: is there anybody without node-ID?
const FAST_SCAN: lss::LssRequest = lss::LssRequest::FastScan {
    number: 0,
    bit: lss::FAST_SCAN_BEGIN,
    sub: lss::IdentityNumber::Vendor,
    next: lss::IdentityNumber::Vendor,
};

/// Segments of a block that [`Statement::Upload`] asks for.
const SEGMENTS: u8 = sdo::BLOCK_MAX;

/// Content of a text or a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Statement {
    /// An order; true to everybody.
    Order(NmtCommand, bool),
    /// SYNC.
    Sync(SyncMessage),
    /// The time of day.
    Time(TimeOfDay),
    /// An emergency; true in the short form, the code alone.
    Emergency(Emergency, bool),
    /// Boot-up, heartbeat, or the answer to guarding.
    State(Heartbeat),
    /// The remote request that guards.
    Guard,
    /// Process data.
    Process {
        /// From the node.
        from_node: bool,
        /// 1 to 4.
        number: u8,
        /// The bytes.
        data: [u8; 8],
        /// Number of bytes.
        len: u8,
    },
    /// The remote request for process data of the node: number, bytes.
    RequestProcess(u8, u8),
    /// Service data to the node, and how many bytes the frame has.
    Request(SdoRequest, u8),
    /// Service data from the node, and how many bytes the frame has.
    Reply(SdoReply, u8),
    /// A segment of a block; true from the node.
    BlockSegment(BlockSegment, bool),
    /// Writes an object of up to eight bytes; of more than four the first frame.
    Write(ObjectIndex, u64, u8),
    /// Reads an object of any length, true in blocks; the first frame.
    Upload(ObjectIndex, bool),
    /// Writes an object of any length: how many bytes, true in blocks; the first frame.
    Download(ObjectIndex, u32, bool),
    /// A layer setting service.
    Lss(lss::LssRequest),
    /// An answer to one.
    LssReply(lss::LssReply),
    /// Finds one device without node-ID; the first frame.
    FastScan,
    /// A frame in bytes.
    Raw(Frame),
}

/// Parses a text as a request to `node`, as far as hosts send such requests.
#[must_use]
pub fn parse_request(text: &str, node: u8) -> Option<HostRequest> {
    if let Some(name) = text.strip_prefix("lss scanned ") {
        let known = NUMBERS.iter().find(|(word, _)| *word == name.trim());
        return known.map(|(_, number)| HostRequest::LastScanned(*number));
    }
    parse(text, None).ok()?.to_host_request(node)
}

impl Statement {
    /// Parses a frame. `part` means that it is a segment of a block, which the frame alone does not show; a
    /// service of seven bytes counts as one of eight with a zero appended.
    ///
    /// # Errors
    /// The error that leaves the frame without a meaning.
    pub fn of(frame: &Frame, part: bool) -> Result<Self, WireError> {
        let (cob, bytes) = (Cob::of(frame.id as u16), frame.bytes());
        Ok(match cob {
            Cob::Tpdo(number, _) if frame.remote => Self::RequestProcess(number, frame.len),
            Cob::Heartbeat(_) if frame.remote => Self::Guard,
            _ if frame.remote => return Err(WireError::Identifier { found: frame.id }),
            Cob::Nmt => {
                let NmtMessage { command, node } = NmtMessage::parse(bytes)?;
                Self::Order(command, node == 0)
            }
            Cob::Sync => Self::Sync(SyncMessage::parse(bytes)?),
            Cob::Time => Self::Time(TimeOfDay::parse(bytes)?),
            Cob::Emcy(_) => Self::Emergency(Emergency::parse(bytes)?, bytes.len() == 2),
            Cob::Heartbeat(_) => Self::State(Heartbeat::parse(bytes)?),
            Cob::Tpdo(number, _) | Cob::Rpdo(number, _) => {
                let reported = matches!(cob, Cob::Tpdo(..));
                Self::Process { from_node: reported, number, data: padded(bytes), len: frame.len }
            }
            Cob::SdoRequest(_) | Cob::SdoReply(_) if part => {
                let reported = matches!(cob, Cob::SdoReply(_));
                Self::BlockSegment(BlockSegment::of(sdo::as_eight_bytes(bytes)?), reported)
            }
            Cob::SdoRequest(_) => Self::Request(SdoRequest::of(service_bytes(bytes)?), frame.len),
            Cob::SdoReply(_) => Self::Reply(SdoReply::of(service_bytes(bytes)?), frame.len),
            Cob::LssRequest => Self::Lss(lss::LssRequest::parse(bytes)?),
            Cob::LssReply => Self::LssReply(lss::LssReply::parse(bytes)?),
            Cob::Other(_) => return Err(WireError::Identifier { found: frame.id }),
        })
    }

    /// The frame to or from `node`.
    #[must_use]
    pub fn frame(self, node: u8) -> Frame {
        match self {
            Self::Order(command, true) => NmtMessage { command, node: 0 }.emit(),
            Self::Order(command, false) => NmtMessage { command, node }.emit(),
            Self::Sync(sync) => sync.emit(),
            Self::Time(time) => time.emit(),
            Self::Emergency(emergency, true) => emergency.emit_short(node),
            Self::Emergency(emergency, false) => emergency.emit(node),
            Self::State(heartbeat) => heartbeat.emit(node),
            Self::Guard => heartbeat::guarding_request(node),
            Self::Process { from_node, number, data, len } => {
                let cob = if from_node { Cob::Tpdo(number, node) } else { Cob::Rpdo(number, node) };
                Frame::standard(cob.id(), &data[..usize::from(len.min(8))])
            }
            Self::RequestProcess(number, len) => {
                let id = Cob::Tpdo(number, node).id().into();
                Frame { id, remote: true, len, ..Frame::default() }
            }
            Self::Request(request, len) => Frame { len, ..request.emit(node) },
            Self::Reply(reply, len) => Frame { len, ..reply.emit(node) },
            Self::BlockSegment(part, reported) => {
                let cob = if reported { Cob::SdoReply(node) } else { Cob::SdoRequest(node) };
                Frame::standard(cob.id(), &part.bytes())
            }
            Self::Write(object, bits, len @ 0..=4) => {
                SdoRequest::Write(object, ExpeditedData { bits: bits as u32, len }).emit(node)
            }
            Self::Write(object, _, len) => {
                SdoRequest::WriteLong(object, Some(len.into())).emit(node)
            }
            Self::Upload(object, false) => SdoRequest::Read(object).emit(node),
            Self::Upload(object, true) => {
                let (crc, segments, threshold) = (true, SEGMENTS, 0);
                SdoRequest::ReadBlock { object, crc, segments, threshold }.emit(node)
            }
            Self::Download(object, size, false) => {
                SdoRequest::WriteLong(object, Some(size)).emit(node)
            }
            Self::Download(object, size, true) => {
                SdoRequest::WriteBlock { object, crc: true, size: Some(size) }.emit(node)
            }
            Self::Lss(request) => request.emit(),
            Self::LssReply(reply) => reply.emit(),
            Self::FastScan => FAST_SCAN.emit(),
            Self::Raw(frame) => frame,
        }
    }

    /// Request to `node`, for frames that a host sends. Broadcasts and process data give none: they would move other
    /// axes too, or bypass the lane's knowledge of this one.
    pub(super) fn to_host_request(self, node: u8) -> Option<HostRequest> {
        Some(match self {
            Self::Order(NmtCommand::Other(_), _) | Self::Order(_, true) => return None,
            Self::Order(command, false) => HostRequest::Nmt(NmtMessage { command, node }),
            Self::Sync(SyncMessage { counter }) => HostRequest::Sync(counter),
            Self::Time(time) => HostRequest::Time(time),
            Self::Guard => HostRequest::Guard { node },
            Self::Request(SdoRequest::Read(object), 8) => HostRequest::Read { node, object },
            Self::Request(
                SdoRequest::Write(object, short @ ExpeditedData { len: len @ 1.., .. }),
                8,
            ) => {
                let bits = short.bits.into();
                HostRequest::Write { node, object, bits, len, class: RequestClass::NoRetry }
            }
            Self::Write(object, bits, len @ 1..) => {
                HostRequest::Write { node, object, bits, len, class: RequestClass::NoRetry }
            }
            Self::Upload(object, block) => HostRequest::Upload { node, object, block, max: 0 },
            Self::Download(object, size, block) => {
                HostRequest::Download { node, object, block, size }
            }
            Self::FastScan => HostRequest::FastScan,
            Self::Lss(
                request @ (lss::LssRequest::SetNode(_)
                | lss::LssRequest::SetBitTiming(..)
                | lss::LssRequest::SwitchGlobal(_)
                | lss::LssRequest::SwitchSelective(..)
                | lss::LssRequest::Store
                | lss::LssRequest::Inquire(_)
                | lss::LssRequest::InquireNode
                | lss::LssRequest::Identify(..)
                | lss::LssRequest::IdentifyUnconfigured),
            ) => HostRequest::Lss(request),
            _ => return None,
        })
    }

    /// The object that it concerns, if it names one.
    #[must_use]
    pub const fn object(&self) -> Option<ObjectIndex> {
        match *self {
            Self::Request(request, _) => request.object(),
            Self::Reply(reply, _) => reply.object(),
            Self::Write(object, ..) | Self::Upload(object, _) | Self::Download(object, ..) => {
                Some(object)
            }
            _ => None,
        }
    }
}

/// Service data of eight bytes, or of seven: nine requests of the TS manual are printed so.
fn service_bytes(bytes: &[u8]) -> Result<[u8; 8], WireError> {
    match bytes.len() {
        7 => Ok(padded(bytes)),
        _ => sdo::as_eight_bytes(bytes),
    }
}

fn padded(bytes: &[u8]) -> [u8; 8] {
    let mut all = [0; 8];
    all.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
    all
}

/// Result of a layer setting service.
///
/// # Errors
/// [`Failure::Refused`] with the service's own error.
pub fn lss_outcome(reply: lss::LssReply) -> Result<i64, Failure> {
    use lss::LssReply;
    match reply {
        LssReply::SetNode(error @ 1.., _)
        | LssReply::SetBitTiming(error @ 1.., _)
        | LssReply::Store(error @ 1.., _) => Err(Failure::Refused { code: error.into() }),
        LssReply::Number(_, value) => Ok(value.into()),
        LssReply::Node(node) => Ok(node.into()),
        _ => Ok(0),
    }
}
