//! What taps heard and nobody has looked at yet: they are called on whatever thread reads the link,
//! so they only keep.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use polepair_core::medium::{Can, Frame, Stream};
use polepair_core::time::Instant;
use polepair_link::tap::{Direction, Tap};

use crate::trace::Trace;

/// Units that wait to be looked at; the oldest go when there are more, and are counted.
const WAITING_MAX: usize = 1 << 16;

/// A unit that passed on a wire.
#[derive(Debug)]
pub struct Heard {
    /// The wire's number.
    pub wire: usize,
    /// When.
    pub at: Instant,
    /// Which way, by whose end of the link it passed.
    pub direction: Direction,
    /// What.
    pub unit: Unit,
}

/// Bytes of a serial line, or a CAN frame.
#[derive(Debug)]
pub enum Unit {
    /// Bytes that were read or written at once.
    Bytes(Vec<u8>),
    /// A frame.
    Frame(Frame),
}

/// Where every tap puts what it hears.
#[derive(Clone, Default)]
pub struct Ears(Arc<Mutex<Waiting>>);

#[derive(Default)]
struct Waiting {
    heard: VecDeque<Heard>,
    lost: u64,
    /// What keeps the units as a capture, if anything does.
    trace: Option<Trace>,
}

/// The tap of one wire.
pub struct Ear {
    wire: usize,
    ears: Ears,
}

impl Ears {
    /// Ears that also keep what they hear as a capture.
    pub fn keeping(trace: Option<Trace>) -> Self {
        Self(Arc::new(Mutex::new(Waiting { trace, ..Waiting::default() })))
    }

    /// The tap of a wire.
    pub fn on(&self, wire: usize) -> Ear {
        Ear { wire, ears: self.clone() }
    }

    /// What was heard since, and how much of it is lost for good.
    pub fn take(&self) -> (VecDeque<Heard>, u64) {
        let mut waiting = self.lock();
        (std::mem::take(&mut waiting.heard), std::mem::take(&mut waiting.lost))
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Waiting> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Waiting {
    fn keep(&mut self, heard: Heard) {
        if let Some(trace) = &mut self.trace {
            match &heard.unit {
                Unit::Bytes(bytes) => trace.bytes(heard.at, heard.direction, bytes),
                Unit::Frame(frame) => trace.frame(heard.at, heard.direction, frame),
            }
        }
        if self.heard.len() == WAITING_MAX {
            self.heard.pop_front();
            self.lost += 1;
        }
        self.heard.push_back(heard);
    }
}

impl Tap<Stream> for Ear {
    fn unit(&mut self, at: Instant, direction: Direction, bytes: &[u8]) {
        let unit = Unit::Bytes(bytes.to_vec());
        self.ears.lock().keep(Heard { wire: self.wire, at, direction, unit });
    }
}

impl Tap<Can> for Ear {
    fn unit(&mut self, at: Instant, direction: Direction, frame: &Frame) {
        let unit = Unit::Frame(*frame);
        self.ears.lock().keep(Heard { wire: self.wire, at, direction, unit });
    }
}

/// The last part of a link's address, as captures name links.
pub fn short(name: &str) -> String {
    let name = name.strip_prefix("sim:").unwrap_or(name);
    name.rsplit('/').find(|part| !part.is_empty()).unwrap_or(name).to_owned()
}
