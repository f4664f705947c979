//! CSV as python-can has it: one bus, no directions.

use std::io::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;

use super::{NO_SERIAL, Sink};
use crate::record::{Data, Record};
use crate::stamp::Stamp;

/// The writer of such lines.
#[derive(Debug, Default)]
pub(super) struct Csv {
    /// The bus, once the first record has told.
    link: Option<String>,
}

impl Sink for Csv {
    fn record(&mut self, record: &Record<'_>, out: &mut Vec<u8>) -> Result<(), &'static str> {
        let (id, extended, remote, error, len, bytes): (_, _, _, _, _, &[u8]) = match &record.data {
            Data::Bytes(_) => return Err(NO_SERIAL),
            Data::Frame(frame) if frame.remote => {
                (frame.id, frame.extended, true, false, frame.len, &[])
            }
            Data::Frame(frame) => {
                (frame.id, frame.extended, false, false, frame.len, frame.bytes())
            }
            Data::Fd(fd) => (fd.id, fd.extended, false, false, fd.bytes.len() as u8, fd.bytes),
            Data::Error(error) => (error.class, true, false, true, 8, &error.data),
        };
        match &self.link {
            None => self.begin(record.link, out),
            Some(link) if link != record.link => {
                return Err("this format does not tell links apart: write log or pcapng");
            }
            Some(_) => {}
        }
        let Stamp(time) = record.time.unwrap_or(Stamp(0));
        let (seconds, ns) = (time / 1_000_000_000, time % 1_000_000_000);
        let [extended, remote, error] = [extended, remote, error].map(u8::from);
        let data = BASE64.encode(bytes);
        // Writing into a Vec cannot fail.
        let _ = writeln!(out, "{seconds}.{ns:09},{id:#x},{extended},{remote},{error},{len},{data}");
        Ok(())
    }

    fn finish(&mut self, out: &mut Vec<u8>) {
        if self.link.is_none() {
            self.begin("", out);
        }
    }
}

impl Csv {
    fn begin(&mut self, link: &str, out: &mut Vec<u8>) {
        out.extend_from_slice(b"timestamp,arbitration_id,extended,remote,error,dlc,data\n");
        self.link = Some(link.to_owned());
    }
}
