//! pcapng: blocks, each with its length at both ends; interfaces are described before their packets.

use pcap_parser::pcapng::{
    Block, EnhancedPacketBlock, InterfaceDescriptionBlock, OptionCode, SimplePacketBlock,
    parse_block_be, parse_block_le,
};
use polepair_core::explain::Direction;

use super::{Bad, Damage, Place, Source, Taker, linktype};
use crate::record::Record;
use crate::stamp::Stamp;

/// The least block: kind, length, length.
const BLOCK_MIN: usize = 12;
/// Bytes that a block may have.
const BLOCK_MAX: usize = 1 << 24;
/// Interfaces that a file may describe.
const INTERFACES_MAX: usize = 256;
const SECTION: [u8; 4] = [0x0A, 0x0D, 0x0D, 0x0A];
/// What a section begins with behind its length, as the writer's machine orders bytes.
const ORDER_BIG: [u8; 4] = [0x1A, 0x2B, 0x3C, 0x4D];

/// The reader of such files.
#[derive(Debug, Default)]
pub(super) struct Pcapng {
    big: bool,
    interfaces: Vec<Interface>,
    taken: u64,
    lost: bool,
}

/// One interface of the section.
#[derive(Debug)]
struct Interface {
    kind: u32,
    name: String,
    /// Ticks of its clock in a second.
    ticks: u64,
    /// Seconds to be added.
    offset: i64,
}

/// What stands at the head of the bytes.
enum At {
    /// A block of so many bytes.
    Block(usize),
    More,
    Damage,
}

impl Source for Pcapng {
    fn read(&mut self, bytes: &[u8], ended: bool, taker: &mut dyn Taker) -> usize {
        let mut used = 0;
        while used < bytes.len() {
            let rest = &bytes[used..];
            let step = match self.at(rest) {
                At::Block(size) => {
                    self.block(&rest[..size], taker);
                    self.lost = false;
                    size
                }
                At::Damage => {
                    if !core::mem::replace(&mut self.lost, true) {
                        self.damage("the block's length is damaged", taker);
                    }
                    1
                }
                At::More if ended => {
                    if !self.lost {
                        self.damage("the last block is cut off", taker);
                    }
                    rest.len()
                }
                At::More => return used,
            };
            used += step;
            self.taken += step as u64;
        }
        used
    }
}

impl Pcapng {
    fn at(&mut self, bytes: &[u8]) -> At {
        let Some(head) = bytes.first_chunk::<BLOCK_MIN>() else { return At::More };
        let [kind, length, order] =
            [0, 4, 8].map(|at| [head[at], head[at + 1], head[at + 2], head[at + 3]]);
        let section = kind == SECTION;
        let big = if section { order == ORDER_BIG } else { self.big };
        let number = |word| if big { u32::from_be_bytes(word) } else { u32::from_le_bytes(word) };
        let (size, kind) = (number(length) as usize, number(kind));
        let known = section || matches!(kind, 1..=0x20 | 0x80..=0x300 | 0xBAD | 0x4000_0BAD);
        if size < BLOCK_MIN || !size.is_multiple_of(4) || size > BLOCK_MAX || self.lost && !known {
            return At::Damage;
        }
        match bytes.get(size - 4..size) {
            None => At::More,
            Some(last) if last == length => At::Block(size),
            Some(_) => At::Damage,
        }
    }

    fn block(&mut self, bytes: &[u8], taker: &mut dyn Taker) {
        if let Some(order) = bytes.get(8..12).filter(|_| bytes.starts_with(&SECTION)) {
            self.big = order == ORDER_BIG;
            self.interfaces.clear();
            return;
        }
        let read = if self.big { parse_block_be(bytes) } else { parse_block_le(bytes) };
        match read {
            Ok((_, Block::InterfaceDescription(block))) => self.interface(&block, taker),
            Ok((_, Block::EnhancedPacket(block))) => self.packet(&block, taker),
            Ok((_, Block::SimplePacket(block))) => self.simple(&block, taker),
            // Names, statistics, comments, secrets.
            Ok(_) => {}
            Err(_) => self.damage("the block is damaged", taker),
        }
    }

    fn interface(&mut self, block: &InterfaceDescriptionBlock<'_>, taker: &mut dyn Taker) {
        if self.interfaces.len() >= INTERFACES_MAX {
            return self.damage("more interfaces than are followed at once", taker);
        }
        let number = self.interfaces.len();
        let kind = block.linktype.0.cast_unsigned();
        let named = block.options.iter().find(|option| option.code == OptionCode::IfName);
        let name = named.map(|option| {
            let text = option.value.split(|c| *c == 0).next().unwrap_or_default();
            String::from_utf8_lossy(text).replace(char::is_whitespace, "_")
        });
        let other = if kind == linktype::SERIAL { "serial" } else { "can" };
        let name = name.filter(|name| !name.is_empty()).unwrap_or(format!("{other}{number}"));
        let ticks = match block.if_tsresol {
            power @ 0..=18 => 10u64.pow(u32::from(power)),
            power => 1u64.checked_shl(u32::from(power & 0x7F)).unwrap_or(1_000_000),
        };
        self.interfaces.push(Interface { kind, name, ticks, offset: block.if_tsoffset });
    }

    fn packet(&self, block: &EnhancedPacketBlock<'_>, taker: &mut dyn Taker) {
        let Some(interface) = self.interfaces.get(block.if_id as usize) else {
            return self.damage("the packet's interface was not described", taker);
        };
        let ticks = u64::from(block.ts_high) << 32 | u64::from(block.ts_low);
        let flags = block.options.iter().find(|option| option.code == OptionCode(2));
        let flags = flags.and_then(|option| option.value.first_chunk::<4>());
        let flags =
            flags.map(|b| if self.big { u32::from_be_bytes(*b) } else { u32::from_le_bytes(*b) });
        let told = match flags.unwrap_or(0) & 3 {
            1 => Some(Direction::ToHost),
            2 => Some(Direction::ToDrive),
            _ => None,
        };
        let data = block.data.get(..block.caplen as usize).unwrap_or(block.data);
        self.give(interface, interface.time(ticks), told, data, taker);
    }

    fn simple(&self, block: &SimplePacketBlock<'_>, taker: &mut dyn Taker) {
        match self.interfaces.first() {
            Some(interface) => {
                let data = block.data.get(..block.origlen as usize).unwrap_or(block.data);
                self.give(interface, None, None, data, taker);
            }
            None => self.damage("the packet's interface was not described", taker),
        }
    }

    fn give(
        &self,
        interface: &Interface,
        time: Option<Stamp>,
        told: Option<Direction>,
        packet: &[u8],
        taker: &mut dyn Taker,
    ) {
        match linktype::read(interface.kind, packet) {
            Ok((direction, data)) => {
                let direction = told.or(direction);
                let (link, at) = (interface.name.as_str(), self.taken);
                taker.record(&Record { time, link, direction, data, at });
            }
            Err(Bad(reason)) => self.damage(reason, taker),
        }
    }

    fn damage(&self, reason: &'static str, taker: &mut dyn Taker) {
        taker.damage(Damage { place: Place::Byte(self.taken), reason: Bad(reason) });
    }
}

impl Interface {
    fn time(&self, ticks: u64) -> Option<Stamp> {
        let ns = u128::from(ticks) * 1_000_000_000 / u128::from(self.ticks);
        let ns = i128::try_from(ns).ok()? + i128::from(self.offset) * 1_000_000_000;
        u64::try_from(ns).ok().map(Stamp)
    }
}
