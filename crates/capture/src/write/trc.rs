//! TRC version 2.1, the text log of PEAK's tools.

use std::io::Write as _;

use polepair_core::explain::Direction;

use super::{ChannelNumbers, FormatWriter, NO_SERIAL};
use crate::date;
use crate::record::{Record, RecordData, fd_dlc_from_len};
use crate::timestamp::Timestamp;

/// The writer of such lines.
#[derive(Debug, Default)]
pub(super) struct TrcWriter {
    start_time: Option<Timestamp>,
    channels: ChannelNumbers,
    number: u64,
}

impl FormatWriter for TrcWriter {
    fn append_record(
        &mut self,
        record: &Record<'_>,
        out: &mut Vec<u8>,
    ) -> Result<(), &'static str> {
        if matches!(record.data, RecordData::Bytes(_)) {
            return Err(NO_SERIAL);
        }
        let bus = self.channels.number_for(record.link)? + 1;
        let time = record.time.unwrap_or(Timestamp(0));
        let since = time.since(self.begin_file(time, out));
        self.number += 1;
        let (kind, id, extended, code, bytes): (_, _, _, _, &[u8]) = match &record.data {
            RecordData::Frame(frame) if frame.remote => {
                ("RR", frame.id, frame.extended, frame.len, &[])
            }
            RecordData::Frame(frame) => ("DT", frame.id, frame.extended, frame.len, frame.bytes()),
            RecordData::Fd(fd) => {
                let kind = ["FD", "FB", "FE", "BI"][usize::from(fd.flags & 3)];
                (kind, fd.id, fd.extended, fd_dlc_from_len(fd.bytes.len()), fd.bytes)
            }
            RecordData::Error(_) | RecordData::Bytes(_) => ("ER", 0, false, 0, &[]),
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

    fn append_end(&mut self, out: &mut Vec<u8>) {
        self.begin_file(Timestamp(0), out);
    }
}

impl TrcWriter {
    /// The time from which others count, as a day with a fraction holds it; the header, before the
    /// first.
    fn begin_file(&mut self, time: Timestamp, out: &mut Vec<u8>) -> Timestamp {
        *self.start_time.get_or_insert_with(|| {
            let day = format!("{:.10}", date::to_ole_days(Timestamp(time.0 - time.0 % 1_000_000)));
            let begin = day.parse().ok().and_then(date::from_ole_days).unwrap_or(Timestamp(0));
            let begin = if begin.0 > time.0 { time } else { begin };
            let _ = write!(
                out,
                ";$FILEVERSION=2.1\r\n;$STARTTIME={day}\r\n;$COLUMNS=N,O,T,B,I,d,R,L,D\r\n;\r\n"
            );
            begin
        })
    }
}
