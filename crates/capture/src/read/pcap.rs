//! pcap: a header, then packets with their time and length.

use pcap_parser::{PcapHeader, parse_pcap_header};

use super::{Bad, Damage, Place, Source, Taker, linktype};
use crate::record::Record;
use crate::stamp::Stamp;

/// Bytes before a packet: seconds, fraction, bytes kept, bytes sent.
const HEAD: usize = 16;
/// Bytes of the file's header.
const FILE_HEAD: usize = 24;
/// Bytes that a packet may have: tcpdump's own limit.
const PACKET_MAX: u32 = 262_144;
/// Seconds by which neighbours may differ where the place of a packet had to be guessed.
const LEAP_MAX_S: u32 = 86_400;

/// The reader of such files.
#[derive(Debug, Default)]
pub(super) struct Pcap {
    header: Option<PcapHeader>,
    /// Bytes taken so far.
    taken: u64,
    /// Seconds of the last packet.
    last: Option<u32>,
    /// Looking for the next packet behind damage.
    lost: bool,
}

/// What stands before a packet.
#[derive(Clone, Copy)]
struct Head {
    seconds: u32,
    fraction: u32,
    kept: u32,
    sent: u32,
}

impl Source for Pcap {
    fn read(&mut self, bytes: &[u8], ended: bool, taker: &mut dyn Taker) -> usize {
        let mut used = 0;
        if self.header.is_none() {
            match self.open(bytes, ended, taker) {
                0 => return if ended { bytes.len() } else { 0 },
                count => used = count,
            }
        }
        while let Some(step) = self.step(&bytes[used..], ended, taker) {
            used += step;
            self.taken += step as u64;
        }
        used
    }
}

impl Pcap {
    fn open(&mut self, bytes: &[u8], ended: bool, taker: &mut dyn Taker) -> usize {
        if bytes.len() < FILE_HEAD {
            if ended && !bytes.is_empty() {
                self.damage("the file's header is cut off", taker);
            }
            return 0;
        }
        match parse_pcap_header(bytes) {
            Ok((_, header)) => {
                self.header = Some(header);
                self.taken = FILE_HEAD as u64;
                FILE_HEAD
            }
            Err(_) => {
                self.damage("the file's header is damaged", taker);
                0
            }
        }
    }

    /// Takes one packet, or what is lost; `None` when more bytes are needed.
    fn step(&mut self, bytes: &[u8], ended: bool, taker: &mut dyn Taker) -> Option<usize> {
        let header = self.header.as_ref()?;
        let Some(head) = self.head(bytes) else {
            return self.end(bytes, ended, "the last packet is cut off", taker);
        };
        if !self.is_sound(head) || self.lost && !self.is_followed(bytes, head) {
            if !core::mem::replace(&mut self.lost, true) {
                self.damage("the packet's length or time is damaged", taker);
            }
            return Some(1);
        }
        let size = HEAD + head.kept as usize;
        let Some(packet) = bytes.get(HEAD..size) else {
            return self.end(bytes, ended, "the last packet is cut off", taker);
        };
        let scale = if header.is_nanosecond_precision() { 1 } else { 1000 };
        let time = u64::from(head.seconds) * 1_000_000_000 + u64::from(head.fraction) * scale;
        let kind = header.network.0.cast_unsigned() & 0x03FF_FFFF;
        match linktype::read(kind, packet) {
            Ok((direction, data)) => {
                let link = if kind == linktype::SERIAL { "serial0" } else { "can0" };
                let (time, at) = (Some(Stamp(time)), self.taken);
                taker.record(&Record { time, link, direction, data, at });
            }
            Err(Bad(reason)) => self.damage(reason, taker),
        }
        self.last = Some(head.seconds);
        self.lost = false;
        Some(size)
    }

    fn head(&self, bytes: &[u8]) -> Option<Head> {
        let words = bytes.get(..HEAD)?.as_chunks::<4>().0;
        let big = self.header.as_ref()?.is_bigendian();
        let word = |n: usize| match big {
            true => u32::from_be_bytes(words[n]),
            false => u32::from_le_bytes(words[n]),
        };
        Some(Head { seconds: word(0), fraction: word(1), kept: word(2), sent: word(3) })
    }

    fn is_sound(&self, head: Head) -> bool {
        let nano = self.header.as_ref().is_some_and(PcapHeader::is_nanosecond_precision);
        let one = if nano { 1_000_000_000 } else { 1_000_000 };
        let near = |last: u32| last.abs_diff(head.seconds) < LEAP_MAX_S;
        let sound = head.fraction < one && head.kept <= head.sent && head.sent <= PACKET_MAX;
        sound && (!self.lost || head.kept > 0 && self.last.is_none_or(near))
    }

    /// Whether another packet stands where this one would end, as far as can be seen.
    fn is_followed(&self, bytes: &[u8], head: Head) -> bool {
        let next = bytes.get(HEAD + head.kept as usize..).unwrap_or_default();
        self.head(next).is_none_or(|next| self.is_sound(next))
    }

    fn end(
        &self,
        bytes: &[u8],
        ended: bool,
        reason: &'static str,
        taker: &mut dyn Taker,
    ) -> Option<usize> {
        if !ended || bytes.is_empty() {
            return None;
        }
        if !self.lost {
            self.damage(reason, taker);
        }
        Some(bytes.len())
    }

    fn damage(&self, reason: &'static str, taker: &mut dyn Taker) {
        taker.damage(Damage { place: Place::Byte(self.taken), reason: Bad(reason) });
    }
}
