//! The last units that went over a link's wires, kept to be shown when something went wrong.

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};

use polepair_core::medium::{Can, Frame, Stream};
use polepair_core::time::Instant;
use polepair_link::tap::Log;
use polepair_link::{Direction, Tap};

/// Units that are kept.
const UNITS_MAX: usize = 1 << 12;

/// The last units of every wire, each as a line of a capture.
#[derive(Clone, Debug, Default)]
pub struct WireTrace(Arc<Mutex<VecDeque<String>>>);

impl WireTrace {
    /// The tap of the wire of that number.
    pub fn tap(&self, wire: usize) -> impl Tap<Stream> + Tap<Can> + use<> {
        Ear(Log::new(self.clone(), &format!("wire{wire}")))
    }

    /// What was heard, oldest first.
    pub fn lines(&self) -> Vec<String> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).iter().cloned().collect()
    }
}

/// Each write is a line, as [`Log`] does it.
impl io::Write for WireTrace {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        let mut lines = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if lines.len() == UNITS_MAX {
            lines.pop_front();
        }
        lines.push_back(String::from_utf8_lossy(line.trim_ascii_end()).into_owned());
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

struct Ear(Log<WireTrace>);

impl Tap<Stream> for Ear {
    fn unit(&mut self, at: Instant, direction: Direction, unit: &[u8]) {
        self.0.bytes(at, direction, unit);
    }
}

impl Tap<Can> for Ear {
    fn unit(&mut self, at: Instant, direction: Direction, unit: &Frame) {
        self.0.frame(at, direction, unit);
    }
}
