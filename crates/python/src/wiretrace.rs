//! The last units that went over a link's wires, kept to be shown when something went wrong.

use std::collections::VecDeque;
use std::fmt::Write as _;
use std::sync::{Arc, Mutex, PoisonError};

use polepair_core::medium::{Can, Frame, Stream};
use polepair_core::time::Instant;
use polepair_link::{Direction, Tap};

/// Units that are kept.
const UNITS_MAX: usize = 1 << 12;

/// The last units of every wire, each as a line of a capture.
#[derive(Clone, Debug, Default)]
pub struct WireTrace(Arc<Mutex<VecDeque<String>>>);

impl WireTrace {
    /// The tap of the wire of that number.
    pub fn tap(&self, wire: usize) -> impl Tap<Stream> + Tap<Can> + use<> {
        Ear { trace: self.clone(), name: format!("wire{wire}") }
    }

    /// What was heard, oldest first.
    pub fn lines(&self) -> Vec<String> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).iter().cloned().collect()
    }

    fn keep(&self, line: String) {
        let mut lines = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if lines.len() == UNITS_MAX {
            lines.pop_front();
        }
        lines.push_back(line);
    }
}

struct Ear {
    trace: WireTrace,
    name: String,
}

impl Ear {
    fn line(&self, at: Instant) -> String {
        let ns = at.since(Instant::ZERO).as_nanos();
        format!("({}.{:09}) {} ", ns / 1_000_000_000, ns % 1_000_000_000, self.name)
    }
}

impl Tap<Stream> for Ear {
    fn unit(&mut self, at: Instant, direction: Direction, unit: &[u8]) {
        let mut line = self.line(at);
        line.push(if direction == Direction::ToDrive { '>' } else { '<' });
        unit.iter().for_each(|byte| write!(line, " {byte:02X}").unwrap_or_default());
        self.trace.keep(line);
    }
}

impl Tap<Can> for Ear {
    fn unit(&mut self, at: Instant, direction: Direction, unit: &Frame) {
        let mut line = self.line(at);
        let width = if unit.extended { 8 } else { 3 };
        write!(line, "{:0width$X}#", unit.id).unwrap_or_default();
        if unit.remote {
            line.push('R');
        }
        let bytes = if unit.remote { &[] } else { unit.bytes() };
        bytes.iter().for_each(|byte| write!(line, "{byte:02X}").unwrap_or_default());
        line.push_str(if direction == Direction::ToDrive { " T" } else { " R" });
        self.trace.keep(line);
    }
}
