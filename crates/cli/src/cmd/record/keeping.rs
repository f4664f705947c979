//! What is done with what is heard: a capture, lines on stdout, or both.

use polepair_capture::{Data, Record, Stamp};
use polepair_core::explain::Direction as Said;
use polepair_link::clock;
use polepair_link::tap::Direction;

use super::files::Files;
use super::shown::Shown;
use crate::ears::{Ears, Heard, Unit};
use crate::problem::Result;

/// Keeps what passes on wires.
pub struct Keeping {
    pub ears: Ears,
    /// Of each wire.
    pub names: Vec<String>,
    pub files: Option<Files>,
    pub show: Option<Shown>,
    /// Who spoke is told by the way it passed: we are the host. Else nobody knows.
    pub host: bool,
}

impl Keeping {
    /// Keeps what was heard since. Returns how many units are lost for good.
    pub fn take(&mut self) -> Result<u64> {
        let (heard, lost) = self.ears.take();
        for Heard { wire, at, direction, unit } in &heard {
            let record = Record {
                at: 0,
                time: Some(Stamp(clock::wall_ns(*at))),
                link: self.names.get(*wire).map_or("-", String::as_str),
                direction: self.host.then_some(match direction {
                    Direction::ToDrive => Said::ToDrive,
                    Direction::ToHost => Said::ToHost,
                }),
                data: match unit {
                    Unit::Bytes(bytes) => Data::Bytes(bytes),
                    Unit::Frame(frame) => Data::Frame(*frame),
                },
            };
            if let Some(files) = &mut self.files {
                files.write(&record)?;
            }
            if let Some(shown) = &mut self.show {
                shown.take(&record);
            }
        }
        self.show.as_mut().map_or(Ok(()), Shown::hand_over)?;
        Ok(lost)
    }

    /// Brings the file up to date.
    pub fn flush(&mut self) -> Result<()> {
        self.files.as_mut().map_or(Ok(()), Files::flush)
    }
}
