//! A language for what goes over the bus: `write 0x6040:0 u16 0x000F`, `read 0x6041:0`, `nmt start`,
//! `rpdo1 0F 00`, `lss node 5`. Nodes have one too: `value 0x6041:0 u16 0x0037`, `written 0x6040:0`,
//! `heartbeat operational`. What stands in parentheses is a remark; what no words say is `raw`, an
//! identifier and bytes. So every text that is written here is read here.

mod parse;
mod write;

pub use parse::{named_object, parse};
pub use write::{Signs, write};

use super::ask::Ask;
use super::cob::Cob;
use super::emcy::Emergency;
use super::heartbeat::{self, Heartbeat};
use super::lss;
use super::nmt::{Command, Order};
use super::sdo::{self, BlockSegment, Object, Reply, Request, Short};
use super::sync::Sync;
use super::time::TimeOfDay;
use crate::error::{Failure, WireError};
use crate::medium::Frame;
use crate::station::Class;

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

const COMMANDS: [(&str, Command); 5] = [
    ("start", Command::Start),
    ("stop", Command::Stop),
    ("pre-operational", Command::PreOperational),
    ("reset", Command::ResetNode),
    ("reset-communication", Command::ResetCommunication),
];

const NUMBERS: [(&str, lss::Number); 4] = [
    ("vendor", lss::Number::Vendor),
    ("product", lss::Number::Product),
    ("revision", lss::Number::Revision),
    ("serial", lss::Number::Serial),
];

const BOUNDS: [(&str, lss::Bound); 6] = [
    ("vendor", lss::Bound::Vendor),
    ("product", lss::Bound::Product),
    ("revision-low", lss::Bound::RevisionLow),
    ("revision-high", lss::Bound::RevisionHigh),
    ("serial-low", lss::Bound::SerialLow),
    ("serial-high", lss::Bound::SerialHigh),
];

/// The first frame of a fast scan: is there anybody without node-ID?
const FAST_SCAN: lss::Request = lss::Request::FastScan {
    number: 0,
    bit: lss::FAST_SCAN_BEGIN,
    sub: lss::Number::Vendor,
    next: lss::Number::Vendor,
};

/// Segments of a block that [`Said::Upload`] asks for.
const SEGMENTS: u8 = sdo::BLOCK_MAX;

/// What a text or a frame says.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Said {
    /// An order; true to everybody.
    Order(Command, bool),
    /// SYNC.
    Sync(Sync),
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
        told: bool,
        /// 1 to 4.
        number: u8,
        /// The bytes.
        data: [u8; 8],
        /// How many of them.
        len: u8,
    },
    /// The remote request for process data of the node: number, bytes.
    AskProcess(u8, u8),
    /// Service data to the node, and how many bytes the frame has.
    Request(Request, u8),
    /// Service data from the node, and how many bytes the frame has.
    Reply(Reply, u8),
    /// A segment of a block; true from the node.
    Part(BlockSegment, bool),
    /// Writes an object of up to eight bytes; of more than four the first frame.
    Write(Object, u64, u8),
    /// Reads an object of any length, true in blocks; the first frame.
    Upload(Object, bool),
    /// Writes an object of any length: how many bytes, true in blocks; the first frame.
    Download(Object, u32, bool),
    /// A layer setting service.
    Lss(lss::Request),
    /// An answer to one.
    LssReply(lss::Reply),
    /// Finds one device without node-ID; the first frame.
    FastScan,
    /// A frame in bytes.
    Raw(Frame),
}

/// What a text asks of `node`, as far as a host asks such things.
#[must_use]
pub fn request(text: &str, node: u8) -> Option<Ask> {
    parse(text, None).ok()?.ask(node)
}

impl Said {
    /// What a frame says. `part` tells that it is a segment of a block, which the frame alone does
    /// not; a service of seven bytes counts as one of eight with a zero behind.
    ///
    /// # Errors
    /// What the frame breaks so that it says nothing.
    pub fn of(frame: &Frame, part: bool) -> Result<Self, WireError> {
        let (cob, bytes) = (Cob::of(frame.id as u16), frame.bytes());
        Ok(match cob {
            Cob::Tpdo(number, _) if frame.remote => Self::AskProcess(number, frame.len),
            Cob::Heartbeat(_) if frame.remote => Self::Guard,
            _ if frame.remote => return Err(WireError::Identifier { found: frame.id }),
            Cob::Nmt => {
                let Order { command, node } = Order::parse(bytes)?;
                Self::Order(command, node == 0)
            }
            Cob::Sync => Self::Sync(Sync::parse(bytes)?),
            Cob::Time => Self::Time(TimeOfDay::parse(bytes)?),
            Cob::Emcy(_) => Self::Emergency(Emergency::parse(bytes)?, bytes.len() == 2),
            Cob::Heartbeat(_) => Self::State(Heartbeat::parse(bytes)?),
            Cob::Tpdo(number, _) | Cob::Rpdo(number, _) => {
                let told = matches!(cob, Cob::Tpdo(..));
                Self::Process { told, number, data: padded(bytes), len: frame.len }
            }
            Cob::SdoRequest(_) | Cob::SdoReply(_) if part => {
                let told = matches!(cob, Cob::SdoReply(_));
                Self::Part(BlockSegment::of(sdo::whole(bytes)?), told)
            }
            Cob::SdoRequest(_) => Self::Request(Request::of(service(bytes)?), frame.len),
            Cob::SdoReply(_) => Self::Reply(Reply::of(service(bytes)?), frame.len),
            Cob::LssRequest => Self::Lss(lss::Request::parse(bytes)?),
            Cob::LssReply => Self::LssReply(lss::Reply::parse(bytes)?),
            Cob::Other(_) => return Err(WireError::Identifier { found: frame.id }),
        })
    }

    /// The frame to or from `node`.
    #[must_use]
    pub fn frame(self, node: u8) -> Frame {
        match self {
            Self::Order(command, true) => Order { command, node: 0 }.emit(),
            Self::Order(command, false) => Order { command, node }.emit(),
            Self::Sync(sync) => sync.emit(),
            Self::Time(time) => time.emit(),
            Self::Emergency(emergency, true) => emergency.emit_short(node),
            Self::Emergency(emergency, false) => emergency.emit(node),
            Self::State(heartbeat) => heartbeat.emit(node),
            Self::Guard => heartbeat::guard(node),
            Self::Process { told, number, data, len } => {
                let cob = if told { Cob::Tpdo(number, node) } else { Cob::Rpdo(number, node) };
                Frame::standard(cob.id(), &data[..usize::from(len.min(8))])
            }
            Self::AskProcess(number, len) => {
                let id = Cob::Tpdo(number, node).id().into();
                Frame { id, remote: true, len, ..Frame::default() }
            }
            Self::Request(request, len) => Frame { len, ..request.emit(node) },
            Self::Reply(reply, len) => Frame { len, ..reply.emit(node) },
            Self::Part(part, told) => {
                let cob = if told { Cob::SdoReply(node) } else { Cob::SdoRequest(node) };
                Frame::standard(cob.id(), &part.bytes())
            }
            Self::Write(object, bits, len @ 0..=4) => {
                Request::Write(object, Short { bits: bits as u32, len }).emit(node)
            }
            Self::Write(object, _, len) => Request::WriteLong(object, Some(len.into())).emit(node),
            Self::Upload(object, false) => Request::Read(object).emit(node),
            Self::Upload(object, true) => {
                let (crc, segments, threshold) = (true, SEGMENTS, 0);
                Request::ReadBlock { object, crc, segments, threshold }.emit(node)
            }
            Self::Download(object, size, false) => {
                Request::WriteLong(object, Some(size)).emit(node)
            }
            Self::Download(object, size, true) => {
                Request::WriteBlock { object, crc: true, size: Some(size) }.emit(node)
            }
            Self::Lss(request) => request.emit(),
            Self::LssReply(reply) => reply.emit(),
            Self::FastScan => FAST_SCAN.emit(),
            Self::Raw(frame) => frame,
        }
    }

    /// What it asks of `node`, if it is what a host asks. Orders to everybody and process data are
    /// not: they would move other axes too, or pass by what the lane knows of this one.
    pub(super) fn ask(self, node: u8) -> Option<Ask> {
        Some(match self {
            Self::Order(Command::Other(_), _) | Self::Order(_, true) => return None,
            Self::Order(command, false) => Ask::Order(Order { command, node }),
            Self::Sync(Sync { counter }) => Ask::Sync(counter),
            Self::Time(time) => Ask::Time(time),
            Self::Guard => Ask::Guard { node },
            Self::Request(Request::Read(object), 8) => Ask::Read { node, object },
            Self::Request(Request::Write(object, short @ Short { len: len @ 1.., .. }), 8) => {
                let bits = short.bits.into();
                Ask::Write { node, object, bits, len, class: Class::Never }
            }
            Self::Write(object, bits, len @ 1..) => {
                Ask::Write { node, object, bits, len, class: Class::Never }
            }
            Self::Upload(object, block) => Ask::Upload { node, object, block },
            Self::Download(object, size, block) => Ask::Download { node, object, block, size },
            Self::FastScan => Ask::FastScan,
            Self::Lss(
                request @ (lss::Request::SetNode(_)
                | lss::Request::SwitchGlobal(_)
                | lss::Request::Store
                | lss::Request::Inquire(_)
                | lss::Request::InquireNode),
            ) => Ask::Lss(request),
            _ => return None,
        })
    }

    /// The object that it is about, where it says.
    #[must_use]
    pub const fn object(&self) -> Option<Object> {
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
fn service(bytes: &[u8]) -> Result<[u8; 8], WireError> {
    match bytes.len() {
        7 => Ok(padded(bytes)),
        _ => sdo::whole(bytes),
    }
}

fn padded(bytes: &[u8]) -> [u8; 8] {
    let mut all = [0; 8];
    all.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
    all
}

/// What an answer to a layer setting service comes to.
///
/// # Errors
/// [`Failure::Refused`] with the service's own error.
pub fn outcome(reply: lss::Reply) -> Result<i64, Failure> {
    use lss::Reply;
    match reply {
        Reply::SetNode(error @ 1.., _)
        | Reply::SetBitTiming(error @ 1.., _)
        | Reply::Store(error @ 1.., _) => Err(Failure::Refused { code: error.into() }),
        Reply::Number(_, value) => Ok(value.into()),
        Reply::Node(node) => Ok(node.into()),
        _ => Ok(0),
    }
}
