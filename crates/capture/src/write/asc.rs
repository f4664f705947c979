//! ASC, the text log of Vector's tools.

use std::io::Write as _;

use polepair_core::explain::Direction;

use super::{Channels, NO_SERIAL, Sink};
use crate::date;
use crate::record::{Data, Record, fd_code};
use crate::stamp::Stamp;

const DAYS: [&str; 7] = ["Sun", "Mon", "Tue", "Wed", "Thu", "Fri", "Sat"];
const MONTHS: [&str; 12] =
    ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"];

/// Of a line's flags, the one of CAN FD; bit rate switch and error state stand above it.
const FDF: u32 = 0x1000;

/// The writer of such lines.
#[derive(Debug, Default)]
pub(super) struct Asc {
    begin: Option<Stamp>,
    channels: Channels,
}

impl Sink for Asc {
    fn record(&mut self, record: &Record<'_>, out: &mut Vec<u8>) -> Result<(), &'static str> {
        if matches!(record.data, Data::Bytes(_)) {
            return Err(NO_SERIAL);
        }
        let channel = self.channels.of(record.link)? + 1;
        let time = record.time.unwrap_or(Stamp(0));
        let since = time.since(self.begin(time, out));
        let (seconds, ns) = (since / 1_000_000_000, since % 1_000_000_000);
        let way = if record.direction == Some(Direction::ToDrive) { "Tx" } else { "Rx" };
        // Writing into a Vec cannot fail.
        let _ = write!(out, "{seconds:>4}.{ns:09} ");
        match record.data {
            Data::Frame(frame) => {
                let id = identifier(frame.id, frame.extended);
                let _ = match frame.remote {
                    true => write!(out, "{channel}  {id:<15} {way:<4} r {}", frame.len),
                    false => write!(out, "{channel}  {id:<15} {way:<4} d {}", frame.len),
                };
                if !frame.remote {
                    bytes(frame.bytes(), out);
                }
            }
            Data::Fd(fd) => {
                let id = identifier(fd.id, fd.extended);
                let (brs, esi, len) = (fd.flags & 1, fd.flags >> 1 & 1, fd.bytes.len());
                let code = fd_code(len);
                let _ = write!(
                    out,
                    "CANFD {channel:>3} {way:<4} {id:>11}  {brs} {esi} {code:x} {len:>2}"
                );
                bytes(fd.bytes, out);
                // Duration and length in bits, which a capture does not have, the kind of frame, check
                // and bit timing: can-utils reads no line without them.
                let flags = FDF | u32::from(brs) << 13 | u32::from(esi) << 14;
                let _ = write!(out, "        0    0 {flags:>8X}        0        0        0");
            }
            // Whether bytes there are or not, this is a line of its own kind.
            Data::Error(_) | Data::Bytes(_) => {
                let _ = write!(out, "{channel}  ErrorFrame");
            }
        }
        out.push(b'\n');
        Ok(())
    }

    fn finish(&mut self, out: &mut Vec<u8>) {
        self.begin(Stamp(0), out);
        out.extend_from_slice(b"End TriggerBlock\n");
    }
}

impl Asc {
    /// The whole millisecond from which times count; the header, before the first.
    fn begin(&mut self, time: Stamp, out: &mut Vec<u8>) -> Stamp {
        let begin = Stamp(time.0 - time.0 % 1_000_000);
        *self.begin.get_or_insert_with(|| {
            let date = words(begin);
            let _ = write!(
                out,
                "date {date}\nbase hex  timestamps absolute\ninternal events logged\n\
                 Begin Triggerblock {date}\n   0.000000 Start of measurement\n"
            );
            begin
        })
    }
}

fn words(stamp: Stamp) -> String {
    let date::Civil { date: [year, month, day], time: [hour, minute, second], ms, weekday } =
        date::civil(stamp);
    let name = |names: &[&'static str], at: u16| names.get(usize::from(at)).copied().unwrap_or("");
    let (weekday, month) = (name(&DAYS, weekday), name(&MONTHS, month - 1));
    format!("{weekday} {month} {day:02} {hour:02}:{minute:02}:{second:02}.{ms:03} {year}")
}

fn identifier(id: u32, extended: bool) -> String {
    if extended { format!("{id:X}x") } else { format!("{id:X}") }
}

fn bytes(bytes: &[u8], out: &mut Vec<u8>) {
    for byte in bytes {
        let _ = write!(out, " {byte:02X}");
    }
}
