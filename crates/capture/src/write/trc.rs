//! TRC version 2.1, the text log of PEAK's tools.

use std::io::Write as _;

use polepair_core::explain::Direction;

use super::{Channels, NO_SERIAL, Sink};
use crate::date;
use crate::record::{Data, Record, fd_code};
use crate::stamp::Stamp;

/// The writer of such lines.
#[derive(Debug, Default)]
pub(super) struct Trc {
    begin: Option<Stamp>,
    channels: Channels,
    number: u64,
}

impl Sink for Trc {
    fn record(&mut self, record: &Record<'_>, out: &mut Vec<u8>) -> Result<(), &'static str> {
        if matches!(record.data, Data::Bytes(_)) {
            return Err(NO_SERIAL);
        }
        let bus = self.channels.of(record.link)? + 1;
        let time = record.time.unwrap_or(Stamp(0));
        let since = time.since(self.begin(time, out));
        self.number += 1;
        let (kind, id, extended, code, bytes): (_, _, _, _, &[u8]) = match &record.data {
            Data::Frame(frame) if frame.remote => ("RR", frame.id, frame.extended, frame.len, &[]),
            Data::Frame(frame) => ("DT", frame.id, frame.extended, frame.len, frame.bytes()),
            Data::Fd(fd) => {
                let kind = ["FD", "FB", "FE", "BI"][usize::from(fd.flags & 3)];
                (kind, fd.id, fd.extended, fd_code(fd.bytes.len()), fd.bytes)
            }
            Data::Error(_) | Data::Bytes(_) => ("ER", 0, false, 0, &[]),
        };
        let id = match (kind, extended) {
            ("ER", _) => "-".to_owned(),
            (_, true) => format!("{id:08X}"),
            (_, false) => format!("{id:04X}"),
        };
        let way = if record.direction == Some(Direction::ToDrive) { "Tx" } else { "Rx" };
        let (ms, us) = (since / 1_000_000, since / 1000 % 1000);
        // Writing into a Vec cannot fail.
        let number = self.number;
        let _ =
            write!(out, "{number:>7} {ms:>9}.{us:03} {kind} {bus:>2} {id:>8} {way} -  {code:<2}  ");
        bytes.iter().for_each(|byte| {
            let _ = write!(out, " {byte:02X}");
        });
        out.extend_from_slice(b"\r\n");
        Ok(())
    }

    fn finish(&mut self, out: &mut Vec<u8>) {
        self.begin(Stamp(0), out);
    }
}

impl Trc {
    /// The time from which others count, as a day with a fraction holds it; the header, before the
    /// first.
    fn begin(&mut self, time: Stamp, out: &mut Vec<u8>) -> Stamp {
        *self.begin.get_or_insert_with(|| {
            let day = format!("{:.10}", date::to_days(Stamp(time.0 - time.0 % 1_000_000)));
            let begin = day.parse().ok().and_then(date::from_days).unwrap_or(Stamp(0));
            let begin = if begin.0 > time.0 { time } else { begin };
            let _ = write!(
                out,
                ";$FILEVERSION=2.1\r\n;$STARTTIME={day}\r\n;$COLUMNS=N,O,T,B,I,d,R,L,D\r\n;\r\n"
            );
            begin
        })
    }
}
