//! The last units of a link's wires, shown after an error.

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};

use polepair_core::medium::{Can, Frame, Stream};
use polepair_core::time::Instant;
use polepair_link::tap::TraceWriter;
use polepair_link::{Tap, TapDirection};

/// Units that are kept.
const UNITS_MAX: usize = 1 << 12;

/// The last units of every wire, each as a line of a capture.
#[derive(Clone, Debug, Default)]
pub struct WireTrace(Arc<Mutex<VecDeque<String>>>);

impl WireTrace {
    /// The tap of the wire of that number.
    pub fn tap(&self, wire: usize) -> impl Tap<Stream> + Tap<Can> + use<> {
        TraceTap(TraceWriter::new(self.clone(), &format!("wire{wire}")))
    }

    /// Traced frames, oldest first.
    pub fn lines(&self) -> Vec<String> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).iter().cloned().collect()
    }
}

/// Each write is a line, as [`TraceWriter`] does it.
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

struct TraceTap(TraceWriter<WireTrace>);

impl Tap<Stream> for TraceTap {
    fn record_unit(&mut self, at: Instant, direction: TapDirection, unit: &[u8]) {
        self.0.write_bytes(at, direction, unit);
    }
}

impl Tap<Can> for TraceTap {
    fn record_unit(&mut self, at: Instant, direction: TapDirection, unit: &Frame) {
        self.0.write_frame(at, direction, unit);
    }
}
