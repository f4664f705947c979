//! Identifiers by the predefined connection set (CiA 301, 7.3.3).
//!
//! ```text
//! bit 10 … 7         6 … 0
//!     function code  node-ID
//! ```

/// Meaning of an 11-bit identifier by default, before objects 1005h to 1Axxh change it. A node is 1 to 127,
/// the number of a PDO 1 to 4.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Cob {
    /// Network management, from the one master to everybody.
    Nmt,
    /// Synchronisation.
    Sync,
    /// Time of day.
    Time,
    /// Emergency of a node.
    Emcy(u8),
    /// Process data from a node: number, node.
    Tpdo(u8, u8),
    /// Process data to a node: number, node.
    Rpdo(u8, u8),
    /// Service data from a node.
    SdoReply(u8),
    /// Service data to a node.
    SdoRequest(u8),
    /// Boot-up, heartbeat or guarding of a node.
    Heartbeat(u8),
    /// Layer setting services, from a node.
    LssReply,
    /// Layer setting services, to nodes.
    LssRequest,
    /// None of these.
    Other(u16),
}

/// Function code of SDO requests, with its place in the identifier.
pub const SDO_REQUEST: u16 = 0x600;
/// Function code of SDO replies.
pub const SDO_REPLY: u16 = 0x580;
/// Function code of emergencies.
pub const EMCY: u16 = 0x080;
/// Function code of heartbeats.
pub const HEARTBEAT: u16 = 0x700;
/// Identifier of network management.
pub const NMT: u16 = 0x000;
/// Usual identifier of SYNC.
pub const SYNC: u16 = 0x080;
/// Usual identifier of TIME.
pub const TIME: u16 = 0x100;
/// Identifier of layer setting replies (CiA 305).
pub const LSS_REPLY: u16 = 0x7E4;
/// Identifier of layer setting requests (CiA 305).
pub const LSS_REQUEST: u16 = 0x7E5;

impl Cob {
    /// The meaning of an identifier; bits above the eleventh do not count.
    #[inline]
    #[must_use]
    pub const fn of(id: u16) -> Self {
        let id = id & 0x7FF;
        let (function, node) = ((id >> 7) as u8, (id & 0x7F) as u8);
        match (function, node) {
            (0, 0) => Self::Nmt,
            (1, 0) => Self::Sync,
            (2, 0) => Self::Time,
            (0, _) | (2, _) | (_, 0) => Self::other(id),
            (1, node) => Self::Emcy(node),
            (3 | 5 | 7 | 9, node) => Self::Tpdo((function - 1) / 2, node),
            (4 | 6 | 8 | 10, node) => Self::Rpdo(function / 2 - 1, node),
            (11, node) => Self::SdoReply(node),
            (12, node) => Self::SdoRequest(node),
            (14, node) => Self::Heartbeat(node),
            _ => Self::other(id),
        }
    }

    const fn other(id: u16) -> Self {
        match id {
            LSS_REPLY => Self::LssReply,
            LSS_REQUEST => Self::LssRequest,
            id => Self::Other(id),
        }
    }

    /// The identifier.
    #[inline]
    #[must_use]
    pub const fn id(self) -> u16 {
        match self {
            Self::Nmt => NMT,
            Self::Sync => SYNC,
            Self::Time => TIME,
            Self::Emcy(node) => EMCY | node as u16,
            Self::Tpdo(number, node) => 0x080 | (number as u16) << 8 | node as u16,
            Self::Rpdo(number, node) => (number as u16 + 1) << 8 | node as u16,
            Self::SdoReply(node) => SDO_REPLY | node as u16,
            Self::SdoRequest(node) => SDO_REQUEST | node as u16,
            Self::Heartbeat(node) => HEARTBEAT | node as u16,
            Self::LssReply => LSS_REPLY,
            Self::LssRequest => LSS_REQUEST,
            Self::Other(id) => id,
        }
    }

    /// The node that it names, if it names one.
    #[inline]
    #[must_use]
    pub const fn node(self) -> Option<u8> {
        match self {
            Self::Emcy(node)
            | Self::Tpdo(_, node)
            | Self::Rpdo(_, node)
            | Self::SdoReply(node)
            | Self::SdoRequest(node)
            | Self::Heartbeat(node) => Some(node),
            _ => None,
        }
    }
}
