//! pcap with nanoseconds: one link type for each file, without link names.

use polepair_core::explain::Direction;

use super::FormatWriter;
use crate::read::link_type::{self, FLAG_FD};
use crate::record::{ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, Record, RecordData};
use crate::timestamp::Timestamp;

/// Limit of a packet's bytes in the file's header: tcpdump's own limit.
pub(super) const SNAPLEN: u32 = 262_144;

/// The writer of such files.
#[derive(Debug, Default)]
pub(super) struct PcapWriter {
    /// Link type and link, by the first record.
    file_link: Option<(u32, String)>,
}

impl FormatWriter for PcapWriter {
    fn append_record(
        &mut self,
        record: &Record<'_>,
        out: &mut Vec<u8>,
    ) -> Result<(), &'static str> {
        let kind = link_type(&record.data);
        match &self.file_link {
            None => {
                append_file_header(kind, out);
                self.file_link = Some((kind, record.link.to_owned()));
            }
            Some((other, _)) if *other != kind => {
                return Err("pcap holds CAN or serial bytes, not both: write pcapng");
            }
            Some((_, link)) if link != record.link => {
                return Err("pcap does not tell links apart: write pcapng");
            }
            Some(_) => {}
        }
        let Timestamp(time) = record.time.unwrap_or(Timestamp(0));
        let seconds = u32::try_from(time / 1_000_000_000);
        let seconds = seconds.map_err(|_| "the time is beyond what pcap counts")?;
        out.extend_from_slice(&seconds.to_le_bytes());
        out.extend_from_slice(&((time % 1_000_000_000) as u32).to_le_bytes());
        let at = out.len();
        out.extend_from_slice(&[0; 8]);
        append_packet(record, out);
        let size = ((out.len() - at - 8) as u32).to_le_bytes();
        out[at..at + 4].copy_from_slice(&size);
        out[at + 4..at + 8].copy_from_slice(&size);
        Ok(())
    }

    fn append_end(&mut self, out: &mut Vec<u8>) {
        if self.file_link.is_none() {
            append_file_header(link_type::CAN, out);
        }
    }
}

fn append_file_header(kind: u32, out: &mut Vec<u8>) {
    for word in [0xA1B2_3C4D_u32, 2 | 4 << 16, 0, 0, SNAPLEN, kind] {
        out.extend_from_slice(&word.to_le_bytes());
    }
}

/// The link type that holds such a record.
pub(super) fn link_type(data: &RecordData<'_>) -> u32 {
    if matches!(data, RecordData::Bytes(_)) { link_type::SERIAL } else { link_type::CAN }
}

/// Appends a packet.
pub(super) fn append_packet(record: &Record<'_>, out: &mut Vec<u8>) {
    let mut can = |word: u32, len: u8, flags: u8, bytes: &[u8]| {
        out.extend_from_slice(&word.to_be_bytes());
        out.extend_from_slice(&[len, flags, 0, 0]);
        out.extend_from_slice(bytes);
    };
    match &record.data {
        RecordData::Frame(frame) => {
            let remote = if frame.remote { REMOTE_FLAG } else { 0 };
            let bytes = if frame.remote { &[] } else { frame.bytes() };
            can(frame.id | extended_flag(frame.extended) | remote, frame.len, 0, bytes);
        }
        RecordData::Fd(fd) => {
            let flags = fd.flags & 3 | FLAG_FD;
            can(fd.id | extended_flag(fd.extended), fd.bytes.len() as u8, flags, fd.bytes);
        }
        RecordData::Error(error) => can(error.class | ERROR_FLAG, 8, 0, &error.data),
        RecordData::Bytes(bytes) => {
            out.push(match record.direction {
                None => 0,
                Some(Direction::ToDrive) => 1,
                Some(Direction::ToHost) => 2,
            });
            out.extend_from_slice(bytes);
        }
    }
}

fn extended_flag(extended: bool) -> u32 {
    if extended { EXTENDED_FLAG } else { 0 }
}
