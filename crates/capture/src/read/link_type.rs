//! Packets of pcap and pcapng files with CAN frames or serial bytes, by link type.

use polepair_core::explain::Direction;
use polepair_core::proto::modbus::rtu;

use super::ReadError;
use crate::record::{
    CanErrorFrame, ERROR_FLAG, EXTENDED_FLAG, FdFrame, ID_MASK, REMOTE_FLAG, RecordData,
    STANDARD_MAX, classic_frame,
};

/// LINKTYPE_CAN_SOCKETCAN.
pub(crate) const CAN: u32 = 227;
/// LINKTYPE_USER0: serial bytes behind a byte of direction, 0 unknown, 1 to the drive, 2 to the host.
pub(crate) const SERIAL: u32 = 147;
/// LINKTYPE_LINUX_SLL, by `tcpdump -i any`.
const COOKED: u32 = 113;
/// LINKTYPE_LINUX_SLL2, the same with the interface's number.
const COOKED_2: u32 = 276;
/// Cooked headers call a frame that this machine sent so.
const OUTGOING: u8 = 4;
/// Protocols of cooked headers.
const PROTOCOL_CAN: u16 = 0x000C;
const PROTOCOL_CAN_FD: u16 = 0x000D;
/// Bytes before the data of a CAN frame.
const CAN_HEADER: usize = 8;
/// The length of a CAN FD frame whose sender did not set its flag.
const FD_PACKET: usize = 72;
/// Flag of byte 5: a CAN FD frame.
pub(crate) const FLAG_FD: u8 = 4;

/// Content of a packet.
#[derive(Debug)]
pub(super) struct PacketContent<'a> {
    /// The sender, if the link type has it.
    pub direction: Option<Direction>,
    pub data: RecordData<'a>,
    /// Remark on how it was read.
    pub note: Option<&'static str>,
}

impl<'a> PacketContent<'a> {
    fn new(direction: Option<Direction>, data: RecordData<'a>) -> Self {
        Self { direction, data, note: None }
    }
}

/// Reason of a packet of a link type that is not read.
pub(super) const OTHER_LINK_TYPE: ReadError = ReadError("the packet is of another link type");
/// Name of such packets.
pub(super) const OTHER_PACKETS: &str =
    "packets of another link type than CAN (227), serial bytes (147) or a network with TCP";
/// Remark on packets of link type 147 that other programs write.
const BARE: &str = "serial packets have no byte of direction: read as frames of Modbus RTU or TMCL, whose check sums \
                    hold";

/// Reads a packet of that link type.
pub(super) fn parse_packet(kind: u32, packet: &[u8]) -> Result<PacketContent<'_>, ReadError> {
    match kind {
        CAN => Ok(PacketContent::new(None, parse_can(packet)?)),
        SERIAL => parse_serial(packet),
        COOKED => {
            let (header, rest) = packet.split_first_chunk::<16>().ok_or(SHORT)?;
            parse_cooked([header[14], header[15]], header[1], rest)
        }
        COOKED_2 => {
            let (header, rest) = packet.split_first_chunk::<20>().ok_or(SHORT)?;
            parse_cooked([header[0], header[1]], header[10], rest)
        }
        _ => Err(OTHER_LINK_TYPE),
    }
}

const SHORT: ReadError = ReadError("the packet is too short");

fn parse_cooked(
    protocol: [u8; 2],
    kind: u8,
    packet: &[u8],
) -> Result<PacketContent<'_>, ReadError> {
    let direction = if kind == OUTGOING { Direction::ToDrive } else { Direction::ToHost };
    match u16::from_be_bytes(protocol) {
        PROTOCOL_CAN | PROTOCOL_CAN_FD => {
            Ok(PacketContent::new(Some(direction), parse_can(packet)?))
        }
        _ => Err(ReadError("the packet is not a CAN frame")),
    }
}

fn parse_serial(packet: &[u8]) -> Result<PacketContent<'_>, ReadError> {
    let (way, bytes) = packet.split_first().ok_or(SHORT)?;
    // The link type is free for private use: sniffers of Modbus write the frame alone.
    if is_bare_frame(packet) && !is_bare_frame(bytes) {
        let data = RecordData::Bytes(packet);
        return Ok(PacketContent { direction: None, data, note: Some(BARE) });
    }
    let direction = match way {
        0 => None,
        1 => Some(Direction::ToDrive),
        2 => Some(Direction::ToHost),
        _ => return Err(ReadError("the packet does not begin with a direction of 0, 1 or 2")),
    };
    if bytes.is_empty() {
        return Err(ReadError("the packet has no bytes"));
    }
    Ok(PacketContent::new(direction, RecordData::Bytes(bytes)))
}

/// Returns whether bytes are one whole frame by their check sum.
fn is_bare_frame(packet: &[u8]) -> bool {
    let is_rtu = packet.len() >= 4 && rtu::crc_matches(packet);
    is_rtu || tmcl_sum_matches(packet)
}

fn tmcl_sum_matches(packet: &[u8]) -> bool {
    match packet {
        [body @ .., sum] if body.len() == 8 => {
            body.iter().fold(0_u8, |all, byte| all.wrapping_add(*byte)) == *sum
        }
        _ => false,
    }
}

fn parse_can(packet: &[u8]) -> Result<RecordData<'_>, ReadError> {
    let ([a, b, c, d, len, flags, ..], rest) =
        packet.split_first_chunk::<CAN_HEADER>().ok_or(SHORT)?;
    let word = u32::from_be_bytes([*a, *b, *c, *d]);
    let fd = flags & FLAG_FD != 0 || packet.len() == FD_PACKET && *len > 8;
    let max = if fd { 64 } else { 8 };
    if *len > max {
        return Err(ReadError("the frame is longer than a CAN frame can be"));
    }
    let remote = word & REMOTE_FLAG != 0;
    let have = rest.get(..usize::from(*len));
    let bytes = if remote { &[][..] } else { have.ok_or(SHORT)? };
    let extended = word & EXTENDED_FLAG != 0;
    if !extended && word & ERROR_FLAG == 0 && word & ID_MASK > STANDARD_MAX {
        return Err(ReadError("the identifier is too great"));
    }
    let id = word & ID_MASK;
    Ok(if word & ERROR_FLAG != 0 {
        let data = classic_frame(0, false, false, *len, bytes).data;
        RecordData::Error(CanErrorFrame { class: id, data })
    } else if fd {
        RecordData::Fd(FdFrame { id, extended, flags: flags & 3, bytes })
    } else {
        RecordData::Frame(classic_frame(id, extended, remote, *len, bytes))
    })
}
