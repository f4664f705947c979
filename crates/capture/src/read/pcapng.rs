//! pcapng: blocks, each with its length at both ends; interfaces are described before their packets.

use pcap_parser::pcapng::{
    Block, EnhancedPacketBlock, InterfaceDescriptionBlock, OptionCode, SimplePacketBlock,
    parse_block_be, parse_block_le,
};
use polepair_core::explain::Direction;

use super::link_type::PacketContent;
use super::tcp::{self, PacketOrigin, TcpStreams};
use super::{CapturePosition, Damage, FormatReader, ReadError, RecordSink, link_type};
use crate::record::Record;
use crate::timestamp::Timestamp;

/// The least block: kind, length, length.
const BLOCK_MIN: usize = 12;
/// Bytes that a block may have.
const BLOCK_MAX: usize = 1 << 24;
/// Interfaces that a file may describe.
const INTERFACES_MAX: usize = 256;
const SECTION: [u8; 4] = [0x0A, 0x0D, 0x0D, 0x0A];
/// Byte-order magic behind a section's length, big endian.
const ORDER_BIG: [u8; 4] = [0x1A, 0x2B, 0x3C, 0x4D];

/// The reader of such files.
#[derive(Debug, Default)]
pub(super) struct PcapngReader {
    big_endian: bool,
    interfaces: Vec<PcapngInterface>,
    offset: u64,
    resyncing: bool,
    tcp: TcpStreams,
}

/// One interface of the section.
#[derive(Debug)]
struct PcapngInterface {
    link_type: u32,
    name: String,
    /// Ticks of its clock in a second.
    ticks: u64,
    /// Seconds to be added.
    offset: i64,
}

/// State of the bytes at the head.
enum BlockStatus {
    /// A block of this many bytes.
    Block(usize),
    Incomplete,
    Damaged,
}

impl FormatReader for PcapngReader {
    fn read(&mut self, bytes: &[u8], ended: bool, taker: &mut dyn RecordSink) -> usize {
        let mut used = 0;
        while used < bytes.len() {
            let rest = &bytes[used..];
            let step = match self.next_block(rest) {
                BlockStatus::Block(size) => {
                    self.read_block(&rest[..size], taker);
                    self.resyncing = false;
                    size
                }
                BlockStatus::Damaged => {
                    if !core::mem::replace(&mut self.resyncing, true) {
                        self.report_damage("the block's length is damaged", taker);
                    }
                    1
                }
                BlockStatus::Incomplete if ended => {
                    if !self.resyncing {
                        self.report_damage("the last block is cut off", taker);
                    }
                    rest.len()
                }
                BlockStatus::Incomplete => return used,
            };
            used += step;
            self.offset += step as u64;
        }
        used
    }
}

impl PcapngReader {
    fn next_block(&mut self, bytes: &[u8]) -> BlockStatus {
        let Some(head) = bytes.first_chunk::<BLOCK_MIN>() else { return BlockStatus::Incomplete };
        let [kind, length, order] =
            [0, 4, 8].map(|at| [head[at], head[at + 1], head[at + 2], head[at + 3]]);
        let section = kind == SECTION;
        let big = if section { order == ORDER_BIG } else { self.big_endian };
        let (size, kind) = (word_value(length, big) as usize, word_value(kind, big));
        let known = section || matches!(kind, 1..=0x20 | 0x80..=0x300 | 0xBAD | 0x4000_0BAD);
        if size < BLOCK_MIN
            || !size.is_multiple_of(4)
            || size > BLOCK_MAX
            || self.resyncing && !known
        {
            return BlockStatus::Damaged;
        }
        match bytes.get(size - 4..size) {
            None => BlockStatus::Incomplete,
            // The length is at both ends of a block, which shows the begin of the next one after damage.
            Some(last) if last == length => BlockStatus::Block(size),
            Some(_) => BlockStatus::Damaged,
        }
    }

    fn read_block(&mut self, bytes: &[u8], taker: &mut dyn RecordSink) {
        if let Some(order) = bytes.get(8..12).filter(|_| bytes.starts_with(&SECTION)) {
            self.big_endian = order == ORDER_BIG;
            // Interfaces are numbered anew in each section (pcapng, section header block).
            self.interfaces.clear();
            return;
        }
        let read = if self.big_endian { parse_block_be(bytes) } else { parse_block_le(bytes) };
        match read {
            Ok((_, Block::InterfaceDescription(block))) => self.add_interface(&block, taker),
            Ok((_, Block::EnhancedPacket(block))) => self.read_packet(&block, taker),
            Ok((_, Block::SimplePacket(block))) => self.read_simple_packet(&block, taker),
            // Names, statistics, comments, secrets.
            Ok(_) => {}
            Err(_) => self.report_damage("the block is damaged", taker),
        }
    }

    fn add_interface(&mut self, block: &InterfaceDescriptionBlock<'_>, taker: &mut dyn RecordSink) {
        if self.interfaces.len() >= INTERFACES_MAX {
            return self.report_damage("more interfaces than are followed at once", taker);
        }
        let number = self.interfaces.len();
        let kind = block.linktype.0.cast_unsigned();
        let named = block.options.iter().find(|option| option.code == OptionCode::IfName);
        let name = named.map(|option| {
            let text = option.value.split(|c| *c == 0).next().unwrap_or_default();
            String::from_utf8_lossy(text).replace(char::is_whitespace, "_")
        });
        let other = if kind == link_type::SERIAL { "serial" } else { "can" };
        let name = name.filter(|name| !name.is_empty()).unwrap_or(format!("{other}{number}"));
        let ticks = match block.if_tsresol {
            power @ 0..=18 => 10u64.pow(u32::from(power)),
            // The high bit makes it a power of two; an impossible one counts as the default, microseconds.
            power => 1u64.checked_shl(u32::from(power & 0x7F)).unwrap_or(1_000_000),
        };
        self.interfaces.push(PcapngInterface {
            link_type: kind,
            name,
            ticks,
            offset: block.if_tsoffset,
        });
    }

    fn read_packet(&mut self, block: &EnhancedPacketBlock<'_>, taker: &mut dyn RecordSink) {
        let Some(interface) = self.interfaces.get(block.if_id as usize) else {
            return self.report_damage("the packet's interface was not described", taker);
        };
        let ticks = u64::from(block.ts_high) << 32 | u64::from(block.ts_low);
        let flags = block.options.iter().find(|option| option.code == OptionCode(2));
        let flags = flags.and_then(|option| option.value.first_chunk::<4>());
        let flags = flags
            .map(|b| if self.big_endian { u32::from_be_bytes(*b) } else { u32::from_le_bytes(*b) });
        let direction = match flags.map(|flags| flags & 3) {
            Some(1) => Some(Direction::ToHost),
            Some(2) => Some(Direction::ToDrive),
            _ => None,
        };
        // Blocks are padded to four bytes, and the padding is no data.
        let data = block.data.get(..block.caplen as usize).unwrap_or(block.data);
        let time = interface.timestamp(ticks);
        if tcp::is_network(interface.link_type, data) {
            let origin = PacketOrigin { time, offset: self.offset };
            return self.tcp.read_packet(interface.link_type, data, origin, taker);
        }
        self.emit_packet(interface, time, direction, data, taker);
    }

    fn read_simple_packet(&mut self, block: &SimplePacketBlock<'_>, taker: &mut dyn RecordSink) {
        match self.interfaces.first() {
            Some(interface) => {
                let data = block.data.get(..block.origlen as usize).unwrap_or(block.data);
                if tcp::is_network(interface.link_type, data) {
                    let origin = PacketOrigin { time: None, offset: self.offset };
                    return self.tcp.read_packet(interface.link_type, data, origin, taker);
                }
                self.emit_packet(interface, None, None, data, taker);
            }
            None => self.report_damage("the packet's interface was not described", taker),
        }
    }

    fn emit_packet(
        &self,
        interface: &PcapngInterface,
        time: Option<Timestamp>,
        report: Option<Direction>,
        packet: &[u8],
        taker: &mut dyn RecordSink,
    ) {
        match link_type::parse_packet(interface.link_type, packet) {
            Ok(PacketContent { direction, data, note }) => {
                note.into_iter().for_each(|note| taker.handle_note(note));
                let direction = report.or(direction);
                let (link, at) = (interface.name.as_str(), self.offset);
                taker.handle_record(&Record { time, link, direction, data, offset: at });
            }
            Err(link_type::OTHER_LINK_TYPE) => taker.handle_skipped(link_type::OTHER_PACKETS),
            Err(ReadError(reason)) => self.report_damage(reason, taker),
        }
    }

    fn report_damage(&self, reason: &'static str, taker: &mut dyn RecordSink) {
        taker.handle_damage(Damage {
            position: CapturePosition::Byte(self.offset),
            reason: ReadError(reason),
        });
    }
}

fn word_value(word: [u8; 4], big: bool) -> u32 {
    if big { u32::from_be_bytes(word) } else { u32::from_le_bytes(word) }
}

impl PcapngInterface {
    fn timestamp(&self, ticks: u64) -> Option<Timestamp> {
        let ns = u128::from(ticks) * 1_000_000_000 / u128::from(self.ticks);
        let ns = i128::try_from(ns).ok()? + i128::from(self.offset) * 1_000_000_000;
        u64::try_from(ns).ok().map(Timestamp)
    }
}
