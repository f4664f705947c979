//! ASC, the text log of Vector's tools.

use std::io::Write as _;

use polepair_core::explain::Direction;

use super::{ChannelNumbers, FormatWriter, NO_SERIAL};
use crate::date;
use crate::record::{Record, RecordData, fd_dlc_from_len};
use crate::timestamp::Timestamp;

const DAYS: [&str; 7] = ["Sun", "Mon", "Tue", "Wed", "Thu", "Fri", "Sat"];
const MONTHS: [&str; 12] =
    ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"];

/// CAN FD bit of a line's flags; bit rate switch and error state are above it.
const FDF: u32 = 0x1000;

/// The writer of such lines.
#[derive(Debug, Default)]
pub(super) struct AscWriter {
    start_time: Option<Timestamp>,
    channels: ChannelNumbers,
}

impl FormatWriter for AscWriter {
    fn append_record(
        &mut self,
        record: &Record<'_>,
        out: &mut Vec<u8>,
    ) -> Result<(), &'static str> {
        if matches!(record.data, RecordData::Bytes(_)) {
            return Err(NO_SERIAL);
        }
        let channel = self.channels.number_for(record.link)? + 1;
        let time = record.time.unwrap_or(Timestamp(0));
        let since = time.since(self.begin_file(time, out));
        let (seconds, ns) = (since / 1_000_000_000, since % 1_000_000_000);
        let way = if record.direction == Some(Direction::ToDrive) { "Tx" } else { "Rx" };
        // Writing into a Vec cannot fail.
        let _ = write!(out, "{seconds:>4}.{ns:09} ");
        match record.data {
            RecordData::Frame(frame) => {
                let id = identifier(frame.id, frame.extended);
                let _ = if frame.remote {
                    write!(out, "{channel}  {id:<15} {way:<4} r {}", frame.len)
                } else {
                    write!(out, "{channel}  {id:<15} {way:<4} d {}", frame.len)
                };
                if !frame.remote {
                    append_bytes(frame.bytes(), out);
                }
            }
            RecordData::Fd(fd) => {
                let id = identifier(fd.id, fd.extended);
                let (brs, esi, len) = (fd.flags & 1, fd.flags >> 1 & 1, fd.bytes.len());
                let code = fd_dlc_from_len(len);
                let _ = write!(
                    out,
                    "CANFD {channel:>3} {way:<4} {id:>11}  {brs} {esi} {code:x} {len:>2}"
                );
                append_bytes(fd.bytes, out);
                // Duration and length in bits, which a capture does not have, the kind of frame, check
                // and bit timing: can-utils reads no line without them.
                let flags = FDF | u32::from(brs) << 13 | u32::from(esi) << 14;
                let _ = write!(out, "        0    0 {flags:>8X}        0        0        0");
            }
            // This kind of line stays its own, with bytes or without.
            RecordData::Error(_) | RecordData::Bytes(_) => {
                let _ = write!(out, "{channel}  ErrorFrame");
            }
        }
        out.push(b'\n');
        Ok(())
    }

    fn append_end(&mut self, out: &mut Vec<u8>) {
        self.begin_file(Timestamp(0), out);
        out.extend_from_slice(b"End TriggerBlock\n");
    }
}

impl AscWriter {
    /// The whole millisecond from which times count; the header, before the first.
    fn begin_file(&mut self, time: Timestamp, out: &mut Vec<u8>) -> Timestamp {
        let begin = Timestamp(time.0 - time.0 % 1_000_000);
        *self.start_time.get_or_insert_with(|| {
            let date = date_text(begin);
            let _ = write!(
                out,
                "date {date}\nbase hex  timestamps absolute\ninternal events logged\n\
                 Begin Triggerblock {date}\n   0.000000 Start of measurement\n"
            );
            begin
        })
    }
}

fn date_text(stamp: Timestamp) -> String {
    let date::CalendarTime { date: [year, month, day], time: [hour, minute, second], ms, weekday } =
        date::to_calendar(stamp);
    let (weekday, month) = (name_at(&DAYS, weekday), name_at(&MONTHS, month - 1));
    format!("{weekday} {month} {day:02} {hour:02}:{minute:02}:{second:02}.{ms:03} {year}")
}

fn name_at(names: &[&'static str], at: u16) -> &'static str {
    names[usize::from(at)]
}

fn identifier(id: u32, extended: bool) -> String {
    if extended { format!("{id:X}x") } else { format!("{id:X}") }
}

fn append_bytes(bytes: &[u8], out: &mut Vec<u8>) {
    for byte in bytes {
        let _ = write!(out, " {byte:02X}");
    }
}
