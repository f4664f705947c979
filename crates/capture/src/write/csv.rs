//! The CSV of python-can: one bus, without directions.

use std::io::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;

use super::{FormatWriter, NO_SERIAL};
use crate::record::{Record, RecordData};
use crate::timestamp::Timestamp;

/// The writer of such lines.
#[derive(Debug, Default)]
pub(super) struct CsvWriter {
    /// Name of the bus, by the first record.
    link: Option<String>,
}

impl FormatWriter for CsvWriter {
    fn append_record(
        &mut self,
        record: &Record<'_>,
        out: &mut Vec<u8>,
    ) -> Result<(), &'static str> {
        let (id, extended, remote, error, len, bytes): (_, _, _, _, _, &[u8]) = match &record.data {
            RecordData::Bytes(_) => return Err(NO_SERIAL),
            RecordData::Frame(frame) if frame.remote => {
                (frame.id, frame.extended, true, false, frame.len, &[])
            }
            RecordData::Frame(frame) => {
                (frame.id, frame.extended, false, false, frame.len, frame.bytes())
            }
            RecordData::Fd(fd) => {
                (fd.id, fd.extended, false, false, fd.bytes.len() as u8, fd.bytes)
            }
            RecordData::Error(error) => (error.class, true, false, true, 8, &error.data),
        };
        match &self.link {
            None => self.begin_file(record.link, out),
            Some(link) if link != record.link => {
                return Err("this format does not tell links apart: write log or pcapng");
            }
            Some(_) => {}
        }
        let Timestamp(time) = record.time.unwrap_or(Timestamp(0));
        let (seconds, ns) = (time / 1_000_000_000, time % 1_000_000_000);
        let [extended, remote, error] = [extended, remote, error].map(u8::from);
        let data = BASE64.encode(bytes);
        // Writing into a Vec cannot fail.
        let _ = writeln!(out, "{seconds}.{ns:09},{id:#x},{extended},{remote},{error},{len},{data}");
        Ok(())
    }

    fn append_end(&mut self, out: &mut Vec<u8>) {
        if self.link.is_none() {
            self.begin_file("", out);
        }
    }
}

impl CsvWriter {
    fn begin_file(&mut self, link: &str, out: &mut Vec<u8>) {
        out.extend_from_slice(b"timestamp,arbitration_id,extended,remote,error,dlc,data\n");
        self.link = Some(link.to_owned());
    }
}
