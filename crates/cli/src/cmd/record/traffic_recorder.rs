//! Passes received frames to a capture file, to stdout, or to both.

use polepair_capture::{Record, RecordData, Timestamp};
use polepair_core::explain::Direction as Said;
use polepair_link::clock;
use polepair_link::tap::TapDirection;

use super::files::CaptureFiles;
use super::live_printer::LivePrinter;
use crate::problem::Result;
use crate::tap_queue::{QueuedUnit, TapQueue, UnitBuf};

/// Keeps what passes on wires.
pub struct TrafficRecorder {
    pub tap_queue: TapQueue,
    /// Name of each wire.
    pub names: Vec<String>,
    pub files: Option<CaptureFiles>,
    pub printer: Option<LivePrinter>,
    /// True if this program is the host: the direction then shows the sender, which is unknown otherwise.
    pub is_host: bool,
}

impl TrafficRecorder {
    /// Writes the units since the last call. Returns the number of lost units.
    pub fn process_received(&mut self) -> Result<u64> {
        let (received, lost) = self.tap_queue.drain();
        for QueuedUnit { wire, at, direction, unit } in &received {
            let record = Record {
                offset: 0,
                time: Some(Timestamp(clock::wall_ns(*at))),
                link: self.names.get(*wire).map_or("-", String::as_str),
                direction: self.is_host.then_some(match direction {
                    TapDirection::ToDrive => Said::ToDrive,
                    TapDirection::ToHost => Said::ToHost,
                }),
                data: match unit {
                    UnitBuf::Bytes(bytes) => RecordData::Bytes(bytes),
                    UnitBuf::Frame(frame) => RecordData::Frame(*frame),
                },
            };
            if let Some(files) = &mut self.files {
                files.write(&record)?;
            }
            if let Some(shown) = &mut self.printer {
                shown.explain(&record);
            }
        }
        self.printer.as_mut().map_or(Ok(()), LivePrinter::submit)?;
        Ok(lost)
    }

    /// Brings the file up to date.
    pub fn flush(&mut self) -> Result<()> {
        self.files.as_mut().map_or(Ok(()), CaptureFiles::flush)
    }
}
