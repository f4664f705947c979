//! pcap: a header, then packets with their time and length.

use pcap_parser::{PcapHeader, parse_pcap_header};
use polepair_core::convert::tail;

use super::link_type::PacketContent;
use super::tcp::{self, PacketOrigin, TcpStreams};
use super::{CapturePosition, Damage, FormatReader, ReadError, RecordSink, link_type};
use crate::record::Record;
use crate::timestamp::Timestamp;

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
pub(super) struct PcapReader {
    header: Option<PcapHeader>,
    /// Bytes taken so far.
    offset: u64,
    /// Seconds of the last packet.
    last_seconds: Option<u32>,
    /// Looking for the next packet behind damage.
    resyncing: bool,
    tcp: TcpStreams,
}

/// Header of a packet.
#[derive(Clone, Copy)]
struct PacketHeader {
    seconds: u32,
    fraction: u32,
    captured_len: u32,
    original_len: u32,
}

impl FormatReader for PcapReader {
    fn read(&mut self, bytes: &[u8], ended: bool, taker: &mut dyn RecordSink) -> usize {
        let mut used = 0;
        if self.header.is_none() {
            match self.read_file_header(bytes, ended, taker) {
                0 => return if ended { bytes.len() } else { 0 },
                count => used = count,
            }
        }
        while let Some(step) = self.read_packet(&bytes[used..], ended, taker) {
            used += step;
            self.offset += step as u64;
        }
        used
    }
}

impl PcapReader {
    fn read_file_header(&mut self, bytes: &[u8], ended: bool, taker: &mut dyn RecordSink) -> usize {
        if bytes.len() < FILE_HEAD {
            if ended && !bytes.is_empty() {
                self.report_damage("the file's header is cut off", taker);
            }
            return 0;
        }
        match parse_pcap_header(bytes) {
            Ok((_, header)) => {
                self.header = Some(header);
                self.offset = FILE_HEAD as u64;
                FILE_HEAD
            }
            Err(_) => {
                self.report_damage("the file's header is damaged", taker);
                0
            }
        }
    }

    /// Takes one packet, or a damaged part; `None` when more bytes are needed.
    fn read_packet(
        &mut self,
        bytes: &[u8],
        ended: bool,
        taker: &mut dyn RecordSink,
    ) -> Option<usize> {
        let header = self.header.as_ref()?;
        let Some(head) = self.parse_header(bytes) else {
            return self.read_end(bytes, ended, "the last packet is cut off", taker);
        };
        if !self.is_plausible(head) || self.resyncing && !self.has_next(bytes, head) {
            if !core::mem::replace(&mut self.resyncing, true) {
                self.report_damage("the packet's length or time is damaged", taker);
            }
            // Byte by byte: a record has no signature that could be searched for.
            return Some(1);
        }
        let size = HEAD + head.captured_len as usize;
        let Some(packet) = bytes.get(HEAD..size) else {
            return self.read_end(bytes, ended, "the last packet is cut off", taker);
        };
        let scale = if header.is_nanosecond_precision() { 1 } else { 1000 };
        let time = u64::from(head.seconds) * 1_000_000_000 + u64::from(head.fraction) * scale;
        // The upper bits have other meanings (length of the frame check).
        let kind = header.network.0.cast_unsigned() & 0x03FF_FFFF;
        if tcp::is_network(kind, packet) {
            let origin = PacketOrigin { time: Some(Timestamp(time)), offset: self.offset };
            self.tcp.read_packet(kind, packet, origin, taker);
            self.last_seconds = Some(head.seconds);
            self.resyncing = false;
            return Some(size);
        }
        match link_type::parse_packet(kind, packet) {
            Ok(PacketContent { direction, data, note }) => {
                note.into_iter().for_each(|note| taker.handle_note(note));
                let link = if kind == link_type::SERIAL { "serial0" } else { "can0" };
                let (time, at) = (Some(Timestamp(time)), self.offset);
                taker.handle_record(&Record { time, link, direction, data, offset: at });
            }
            Err(link_type::OTHER_LINK_TYPE) => taker.handle_skipped(link_type::OTHER_PACKETS),
            Err(ReadError(reason)) => self.report_damage(reason, taker),
        }
        self.last_seconds = Some(head.seconds);
        self.resyncing = false;
        Some(size)
    }

    fn parse_header(&self, bytes: &[u8]) -> Option<PacketHeader> {
        let words = bytes.get(..HEAD)?.as_chunks::<4>().0;
        let big = self.header.as_ref()?.is_bigendian();
        Some(PacketHeader {
            seconds: word_value(0, big, words),
            fraction: word_value(1, big, words),
            captured_len: word_value(2, big, words),
            original_len: word_value(3, big, words),
        })
    }

    fn is_plausible(&self, head: PacketHeader) -> bool {
        let nano = self.header.as_ref().is_some_and(PcapHeader::is_nanosecond_precision);
        let one = if nano { 1_000_000_000 } else { 1_000_000 };
        let sound = head.fraction < one
            && head.captured_len <= head.original_len
            && head.original_len <= PACKET_MAX;
        sound
            && (!self.resyncing
                || head.captured_len > 0
                    && self
                        .last_seconds
                        .is_none_or(|last| last.abs_diff(head.seconds) < LEAP_MAX_S))
    }

    /// Returns whether another packet follows at the end of this one, as far as can be seen.
    fn has_next(&self, bytes: &[u8], head: PacketHeader) -> bool {
        let next = tail(bytes, HEAD + head.captured_len as usize);
        self.parse_header(next).is_none_or(|next| self.is_plausible(next))
    }

    fn read_end(
        &self,
        bytes: &[u8],
        ended: bool,
        reason: &'static str,
        taker: &mut dyn RecordSink,
    ) -> Option<usize> {
        if !ended || bytes.is_empty() {
            return None;
        }
        if !self.resyncing {
            self.report_damage(reason, taker);
        }
        Some(bytes.len())
    }

    fn report_damage(&self, reason: &'static str, taker: &mut dyn RecordSink) {
        taker.handle_damage(Damage {
            position: CapturePosition::Byte(self.offset),
            reason: ReadError(reason),
        });
    }
}

fn word_value(n: usize, big: bool, words: &[[u8; 4]]) -> u32 {
    if big { u32::from_be_bytes(words[n]) } else { u32::from_le_bytes(words[n]) }
}
