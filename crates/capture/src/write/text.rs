//! candump's log and serial logs.

use std::io::Write as _;

use polepair_core::explain::Direction;

use super::FormatWriter;
use crate::jsonl::write_hex;
use crate::record::{ERROR_FLAG, Record, RecordData};
use crate::text::append_spaced_hex;
use crate::timestamp::Timestamp;

/// The writer of such lines.
#[derive(Debug)]
pub(super) struct TextLogWriter;

impl FormatWriter for TextLogWriter {
    fn append_record(
        &mut self,
        record: &Record<'_>,
        out: &mut Vec<u8>,
    ) -> Result<(), &'static str> {
        if let Some(time) = record.time {
            append_timestamp(time, out);
        }
        out.extend_from_slice(record.link.as_bytes());
        if let RecordData::Bytes(bytes) = record.data {
            out.extend_from_slice(match record.direction {
                Some(Direction::ToDrive) => b" > ",
                Some(Direction::ToHost) => b" < ",
                None => b" ",
            });
            append_spaced_hex(out, bytes);
        } else {
            out.push(b' ');
            append_frame(&record.data, out);
            out.extend_from_slice(match record.direction {
                Some(Direction::ToDrive) => b" T",
                Some(Direction::ToHost) => b" R",
                None => b"",
            });
        }
        out.push(b'\n');
        Ok(())
    }
}

/// Appends the time with six decimals as candump has them, nine if needed.
fn append_timestamp(time: Timestamp, out: &mut Vec<u8>) {
    let (seconds, ns) = (time.0 / 1_000_000_000, time.0 % 1_000_000_000);
    // Writing into a Vec cannot fail.
    let _ = if ns.is_multiple_of(1000) {
        write!(out, "({seconds:010}.{:06}) ", ns / 1000)
    } else {
        write!(out, "({seconds:010}.{ns:09}) ")
    };
}

fn append_frame(data: &RecordData<'_>, out: &mut Vec<u8>) {
    match data {
        RecordData::Bytes(_) => {}
        RecordData::Frame(frame) => {
            write_id(out, frame.id, frame.extended);
            match (frame.remote, frame.len) {
                (true, 0) => out.push(b'R'),
                (true, length) => out.extend_from_slice(&[b'R', b'0' + length]),
                (false, _) => write_hex(out, frame.bytes()),
            }
        }
        RecordData::Fd(fd) => {
            write_id(out, fd.id, fd.extended);
            let _ = write!(out, "#{:X}", fd.flags & 0xF);
            write_hex(out, fd.bytes);
        }
        RecordData::Error(error) => {
            write_id(out, ERROR_FLAG | error.class, true);
            write_hex(out, &error.data);
        }
    }
}

fn write_id(out: &mut Vec<u8>, id: u32, extended: bool) {
    let digits = if extended { 8 } else { 3 };
    let _ = write!(out, "{id:0digits$X}#");
}
