//! BLF, the binary log of Vector's tools: objects in compressed containers.

use std::io::Write as _;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use polepair_core::explain::Direction;

use super::{ChannelNumbers, FormatWriter, NO_SERIAL};
use crate::date::{CalendarTime, to_calendar};
use crate::read::blf::{
    CONTAINER_HEAD, DEFLATE, FILE_HEAD, OBJECT_HEAD, REMOTE, SENT, SIGNATURE, TIME_HEAD, kind,
};
use crate::record::{EXTENDED_FLAG, Record, RecordData, fd_dlc_from_len};
use crate::timestamp::Timestamp;

/// Bytes of objects in a container.
const CONTAINER: usize = 1 << 17;
/// Times are in nanoseconds.
const NANOSECONDS: u32 = 2;
/// Bytes of data that an object of CAN FD has.
const FD_DATA: usize = 64;

/// The writer of such files.
#[derive(Debug, Default)]
pub(super) struct BlfWriter {
    start_time: Option<Timestamp>,
    channels: ChannelNumbers,
    objects: Vec<u8>,
}

impl FormatWriter for BlfWriter {
    fn append_record(
        &mut self,
        record: &Record<'_>,
        out: &mut Vec<u8>,
    ) -> Result<(), &'static str> {
        if matches!(record.data, RecordData::Bytes(_)) {
            return Err(NO_SERIAL);
        }
        let channel = self.channels.number_for(record.link)? as u16 + 1;
        let time = record.time.unwrap_or(Timestamp(0));
        let since = time.since(self.begin_file(time, out));
        append_object(record, channel, since, &mut self.objects);
        if self.objects.len() >= CONTAINER {
            self.flush_container(out);
        }
        Ok(())
    }

    fn append_pending(&mut self, out: &mut Vec<u8>) {
        self.flush_container(out);
    }

    fn append_end(&mut self, out: &mut Vec<u8>) {
        self.begin_file(Timestamp(0), out);
        self.flush_container(out);
    }
}

impl BlfWriter {
    /// The whole millisecond from which times count; the file's header, before the first.
    fn begin_file(&mut self, time: Timestamp, out: &mut Vec<u8>) -> Timestamp {
        let begin = Timestamp(time.0 - time.0 % 1_000_000);
        *self.start_time.get_or_insert_with(|| {
            let at = out.len();
            out.extend_from_slice(b"LOGG");
            out.extend_from_slice(&(FILE_HEAD as u32).to_le_bytes());
            // The program that wrote it, the format's version; sizes and counts are not known yet.
            out.extend_from_slice(&[5, 0, 0, 0, 2, 6, 8, 1]);
            out.resize(at + crate::read::blf::BEGIN_AT, 0);
            let CalendarTime {
                date: [year, month, day],
                time: [hour, minute, second],
                ms,
                weekday,
            } = to_calendar(begin);
            for word in [year, month, weekday, day, hour, minute, second, ms] {
                out.extend_from_slice(&word.to_le_bytes());
            }
            out.resize(at + FILE_HEAD, 0);
            begin
        })
    }

    fn flush_container(&mut self, out: &mut Vec<u8>) {
        if self.objects.is_empty() {
            return;
        }
        let mut packer = ZlibEncoder::new(Vec::new(), Compression::default());
        let packed = packer.write_all(&self.objects).and_then(|()| packer.finish());
        let packed = packed.expect("writing into a Vec cannot fail");
        let size = OBJECT_HEAD + CONTAINER_HEAD + packed.len();
        append_object_header(OBJECT_HEAD as u16, size as u32, kind::CONTAINER, out);
        out.extend_from_slice(&DEFLATE.to_le_bytes());
        out.extend_from_slice(&[0; 6]);
        out.extend_from_slice(&(self.objects.len() as u32).to_le_bytes());
        out.extend_from_slice(&[0; 4]);
        out.extend_from_slice(&packed);
        out.resize(out.len() + size % 4, 0);
        self.objects.clear();
    }
}

fn append_object_header(head: u16, size: u32, kind: u32, out: &mut Vec<u8>) {
    out.extend_from_slice(SIGNATURE);
    out.extend_from_slice(&head.to_le_bytes());
    out.extend_from_slice(&1u16.to_le_bytes());
    out.extend_from_slice(&size.to_le_bytes());
    out.extend_from_slice(&kind.to_le_bytes());
}

/// Appends an object with a time.
fn append_object(record: &Record<'_>, channel: u16, since: u64, out: &mut Vec<u8>) {
    let at = out.len();
    let kind = match record.data {
        RecordData::Frame(_) | RecordData::Bytes(_) => kind::MESSAGE,
        RecordData::Fd(_) => kind::FD,
        RecordData::Error(_) => kind::ERROR_EXT,
    };
    append_object_header((OBJECT_HEAD + TIME_HEAD) as u16, 0, kind, out);
    out.extend_from_slice(&NANOSECONDS.to_le_bytes());
    out.extend_from_slice(&[0; 4]);
    out.extend_from_slice(&since.to_le_bytes());
    out.extend_from_slice(&channel.to_le_bytes());
    append_body(record, out);
    let size = ((out.len() - at) as u32).to_le_bytes();
    out[at + 8..at + 12].copy_from_slice(&size);
    out.resize(out.len() + (out.len() - at) % 4, 0);
}

fn append_body(record: &Record<'_>, out: &mut Vec<u8>) {
    let sent = if record.direction == Some(Direction::ToDrive) { SENT } else { 0 };
    match &record.data {
        RecordData::Frame(frame) => {
            let remote = if frame.remote { REMOTE } else { 0 };
            out.extend_from_slice(&[sent | remote, frame.len]);
            out.extend_from_slice(&blf_identifier(frame.id, frame.extended).to_le_bytes());
            out.extend_from_slice(&frame.data);
        }
        RecordData::Fd(fd) => {
            let at = out.len();
            out.extend_from_slice(&[sent, fd_dlc_from_len(fd.bytes.len())]);
            out.extend_from_slice(&blf_identifier(fd.id, fd.extended).to_le_bytes());
            out.extend_from_slice(&[0; 5]);
            out.extend_from_slice(&[1 | (fd.flags & 3) << 1, fd.bytes.len() as u8]);
            out.extend_from_slice(&[0; 5]);
            out.extend_from_slice(fd.bytes);
            out.resize(at + 18 + FD_DATA, 0);
        }
        // Length, flags, code, position, length code, lengths, identifier, flags, data: not known.
        RecordData::Error(_) | RecordData::Bytes(_) => out.resize(out.len() + 30, 0),
    }
}

fn blf_identifier(id: u32, extended: bool) -> u32 {
    if extended { id | EXTENDED_FLAG } else { id }
}
