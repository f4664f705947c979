//! Requests of a host, and messages of nodes.

use super::address;
use super::cob::Cob;
use super::emcy::Emergency;
use super::explain::object_effect;
use super::lss;
use super::nmt::{self, NmtMessage};
use super::sdo::ObjectIndex;
use super::time::TimeOfDay;
use crate::explain::Effect;
use crate::profile::Profile;
use crate::station::{Request, RequestClass};

/// A request on the bus.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum HostRequest {
    /// Reads an object of at most eight bytes; of a longer one the first eight, then it is aborted.
    Read {
        /// Node-ID.
        node: u8,
        /// Object's index and subindex.
        object: ObjectIndex,
    },
    /// Writes an object of at most eight bytes.
    Write {
        /// Node-ID.
        node: u8,
        /// Object's index and subindex.
        object: ObjectIndex,
        /// The bytes, the first one lowest.
        bits: u64,
        /// Number of bytes, 1 to 8.
        len: u8,
        /// True if it may be sent again.
        class: RequestClass,
    },
    /// Reads an object of any length. The bytes are read with
    /// [`HostData::poll_bytes`](crate::station::HostData::poll_bytes).
    Upload {
        /// Node-ID.
        node: u8,
        /// Object's index and subindex.
        object: ObjectIndex,
        /// True for a block transfer.
        block: bool,
        /// Limit of bytes after which it is aborted; 0 for none.
        max: u16,
    },
    /// Writes an object of any length. The bytes are fed with
    /// [`HostData::feed_bytes`](crate::station::HostData::feed_bytes).
    Download {
        /// Node-ID.
        node: u8,
        /// Object's index and subindex.
        object: ObjectIndex,
        /// True for a block transfer.
        block: bool,
        /// Number of bytes there will be.
        size: u32,
    },
    /// Reads a node's state (guarding).
    Guard {
        /// Node-ID.
        node: u8,
    },
    /// An NMT command. It has no reply.
    Nmt(NmtMessage),
    /// Process data. It has no reply.
    Process {
        /// Communication object.
        cob: Cob,
        /// The bytes, the first one lowest.
        data: u64,
        /// Number of bytes.
        len: u8,
    },
    /// SYNC, once, with a counter or without. It has no reply.
    Sync(Option<u8>),
    /// Sets the period of SYNC, µs; 0 ends it.
    SyncEvery(u32),
    /// Has a node watch the host's heartbeat, which is to arrive within this time, ms; 0 ends it. It is written to the
    /// first place of object 1016h.
    WatchHeartbeat {
        /// Node-ID.
        node: u8,
        /// Time limit, ms.
        ms: u16,
    },
    /// The time of day. It has no reply.
    Time(TimeOfDay),
    /// A layer setting service.
    Lss(lss::LssRequest),
    /// Finds one device without node-ID and brings it to configuration.
    FastScan,
    /// A number of the device that the last fast scan found. Nothing is sent.
    LastScanned(lss::IdentityNumber),
}

impl HostRequest {
    /// The node whose reply it waits for.
    #[must_use]
    pub const fn node(&self) -> Option<u8> {
        match *self {
            Self::Read { node, .. }
            | Self::Write { node, .. }
            | Self::Upload { node, .. }
            | Self::Download { node, .. }
            | Self::WatchHeartbeat { node, .. }
            | Self::Guard { node } => Some(node),
            _ => None,
        }
    }

    /// The object that it is about.
    #[must_use]
    pub const fn object(&self) -> Option<ObjectIndex> {
        match *self {
            Self::Read { object, .. }
            | Self::Write { object, .. }
            | Self::Upload { object, .. }
            | Self::Download { object, .. } => Some(object),
            _ => None,
        }
    }
}

impl HostRequest {
    /// Returns whether two expedited requests concern objects of different axes of a node: a stop of one axis waits for
    /// the reply to the other's.
    #[must_use]
    pub fn is_of_other_axis(&self, other: &Self) -> bool {
        let axes = request_axis(self).zip(request_axis(other));
        !self.moves_bytes() && axes.is_some_and(|(one, other)| one != other)
    }
}

fn request_axis(request: &HostRequest) -> Option<u16> {
    address::axis_number(request.object()?.index)
}

impl Request for HostRequest {
    fn effect(&self, profile: &'static Profile) -> Effect {
        match self {
            Self::Write { object, class, .. } if *class != RequestClass::Stop => {
                object_effect(*object, Some(profile))
            }
            Self::Download { object, .. } => object_effect(*object, Some(profile)),
            _ => Effect::from_class(self.class()),
        }
    }

    fn moves_bytes(&self) -> bool {
        matches!(self, Self::Upload { .. } | Self::Download { .. })
    }

    /// To stop a node takes its process data away, so it counts as a stop; process data and SYNC may
    /// start motion.
    fn class(&self) -> RequestClass {
        match *self {
            Self::Write { class, .. } => class,
            Self::Nmt(NmtMessage { command: nmt::NmtCommand::Stop, .. }) => RequestClass::Stop,
            Self::Process { .. } | Self::Sync(_) | Self::SyncEvery(1..) => RequestClass::NoRetry,
            Self::Read { .. } | Self::Upload { .. } | Self::Guard { .. } | Self::LastScanned(_) => {
                RequestClass::Idempotent
            }
            Self::Lss(
                lss::LssRequest::Inquire(_)
                | lss::LssRequest::InquireNode
                | lss::LssRequest::Identify(..)
                | lss::LssRequest::IdentifyUnconfigured,
            ) => RequestClass::Idempotent,
            _ => RequestClass::ReadBack,
        }
    }
}

/// A reply, or a message that a node sent by itself.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Answer {
    /// A value that was read.
    Value {
        /// Object's index and subindex.
        object: ObjectIndex,
        /// First eight bytes, the first one lowest.
        bits: u64,
        /// Length in bytes, as far as is known; 0 if the node does not state it.
        len: u32,
    },
    /// The object was written.
    Written {
        /// Object's index and subindex.
        object: ObjectIndex,
        /// First eight bytes of the written value.
        bits: u64,
    },
    /// Number of transferred bytes.
    Transferred(u32),
    /// A frame without a reply was sent.
    Sent,
    /// State of a node: a reply to guarding, a boot-up, or a change reported by its heartbeat.
    State(nmt::NmtState),
    /// A node's heartbeat has failed to come.
    HeartbeatLost,
    /// A fault, or its end.
    Emergency(Emergency),
    /// Process data of a node: number, bytes, how many.
    Process(u8, u64, u8),
    /// An answer to a layer setting service.
    Lss(lss::LssReply),
    /// The four numbers of a device that a fast scan found.
    Identity([u32; 4]),
}
