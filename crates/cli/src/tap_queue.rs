//! Queue of frames from taps. A tap runs on the thread that reads the link, so it only stores the frame.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use polepair_core::medium::{Can, Frame, Stream};
use polepair_core::time::Instant;
use polepair_link::tap::{Tap, TapDirection};

use crate::trace::FrameTrace;

/// Units that wait to be looked at; the oldest go when there are more, and are counted.
const WAITING_MAX: usize = 1 << 16;

/// A unit that passed on a wire.
#[derive(Debug)]
pub struct QueuedUnit {
    /// The wire's number.
    pub wire: usize,
    /// Time.
    pub at: Instant,
    /// Direction, seen from this end of the link.
    pub direction: TapDirection,
    /// The unit.
    pub unit: UnitBuf,
}

/// Bytes of a serial line, or a CAN frame.
#[derive(Debug)]
pub enum UnitBuf {
    /// Bytes that were read or written at once.
    Bytes(Vec<u8>),
    /// A frame.
    Frame(Frame),
}

/// Queue of the units of all taps.
#[derive(Clone, Default)]
pub struct TapQueue(Arc<Mutex<TapBuffer>>);

#[derive(Default)]
struct TapBuffer {
    units: VecDeque<QueuedUnit>,
    lost: u64,
    /// Capture file of the units, if there is one.
    trace: Option<FrameTrace>,
}

/// The tap of one wire.
pub struct QueueTap {
    wire: usize,
    queue: TapQueue,
}

impl TapQueue {
    /// A tap that also writes its frames as a capture.
    pub fn with_trace(trace: Option<FrameTrace>) -> Self {
        Self(Arc::new(Mutex::new(TapBuffer { trace, ..TapBuffer::default() })))
    }

    /// The tap of a wire.
    pub fn tap(&self, wire: usize) -> QueueTap {
        QueueTap { wire, queue: self.clone() }
    }

    /// Takes the units since the last call, and the number of lost ones.
    pub fn drain(&self) -> (VecDeque<QueuedUnit>, u64) {
        let mut waiting = self.lock();
        (std::mem::take(&mut waiting.units), std::mem::take(&mut waiting.lost))
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, TapBuffer> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl TapBuffer {
    fn push(&mut self, queued_unit: QueuedUnit) {
        if let Some(trace) = &mut self.trace {
            match &queued_unit.unit {
                UnitBuf::Bytes(bytes) => {
                    trace.write_bytes(queued_unit.at, queued_unit.direction, bytes)
                }
                UnitBuf::Frame(frame) => {
                    trace.write_frame(queued_unit.at, queued_unit.direction, frame)
                }
            }
        }
        if self.units.len() == WAITING_MAX {
            self.units.pop_front();
            self.lost += 1;
        }
        self.units.push_back(queued_unit);
    }
}

impl Tap<Stream> for QueueTap {
    fn record_unit(&mut self, at: Instant, direction: TapDirection, bytes: &[u8]) {
        let unit = UnitBuf::Bytes(bytes.to_vec());
        self.queue.lock().push(QueuedUnit { wire: self.wire, at, direction, unit });
    }
}

impl Tap<Can> for QueueTap {
    fn record_unit(&mut self, at: Instant, direction: TapDirection, frame: &Frame) {
        let unit = UnitBuf::Frame(*frame);
        self.queue.lock().push(QueuedUnit { wire: self.wire, at, direction, unit });
    }
}

/// The last part of a link's address, as captures name links.
pub fn short_name(name: &str) -> String {
    let name = name.strip_prefix("sim:").unwrap_or(name);
    name.rsplit('/').find(|part| !part.is_empty()).unwrap_or(name).to_owned()
}
