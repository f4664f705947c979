//! The interface of a wire for the connection.

use polepair_core::medium::Medium;
use polepair_core::station::LineEvent;
use polepair_core::time::Instant;

use crate::error::LinkError;
use crate::waker::LinkWaker;

/// An opened resource of the operating system, or its simulated twin.
///
/// Every method takes `&self`: one thread waits in [`receive`](Self::receive) while others
/// [`send`](Self::send). Senders take turns by their own lock, and only one thread receives.
pub trait LinkIo<M: Medium>: Send + Sync {
    /// The present time of this link.
    fn now(&self) -> Instant;

    /// Puts one unit on the wire, all of it.
    ///
    /// # Errors
    /// [`LinkError`]; [`LinkError::is_gone`] is true if the link is lost.
    fn send(&self, unit: &M::Unit) -> Result<(), LinkError>;

    /// Waits until a unit can be sent without blocking, as far as the system reports it. `false` when
    /// `until` passed first. For senders of more than the wire's rate: [`send`](Self::send) itself waits
    /// only for a moment.
    ///
    /// # Errors
    /// [`LinkError`]; [`LinkError::is_gone`] is true if the link is lost.
    fn wait_writable(&self, until: Instant) -> Result<bool, LinkError> {
        let _ = until;
        Ok(true)
    }

    /// Waits for data until `until`, or until the waker is used. With an `until` in the past it takes the
    /// received data without waiting.
    ///
    /// # Errors
    /// [`LinkError`]; [`LinkError::is_gone`] is true if the link is lost.
    fn receive(&self, buffer: &mut M::Out, until: Instant) -> Result<Received, LinkError>;

    /// Sets baud and parity, or bit rate, at once. Does nothing on a wire without timing.
    ///
    /// # Errors
    /// [`LinkError`] when the adapter cannot.
    fn set_line(&self, line: M::Line) -> Result<(), LinkError>;

    /// A handle that ends a blocked [`receive`](Self::receive).
    fn waker(&self) -> LinkWaker;

    /// Returns whether time passes and data arrives outside of waits: true everywhere but in a simulation in virtual
    /// time.
    fn is_real_time(&self) -> bool {
        true
    }

    /// For people: `/dev/ttyUSB0`, `10.0.0.5:4001`.
    fn describe(&self) -> String;

    /// Losses since the link was opened.
    fn losses(&self) -> Losses {
        Losses::default()
    }

    /// Opens the same thing again, by its stable name, after it was lost.
    ///
    /// # Errors
    /// [`LinkError`] while it is not there, or always when it cannot come back.
    fn reopen(&self) -> Result<Box<dyn LinkIo<M>>, LinkError> {
        Err(LinkError::gone(&self.describe()))
    }
}

/// Result of a wait.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Received {
    /// Bytes (or one frame) are in the buffer.
    Bytes {
        /// Number of bytes; 1 for a frame.
        len: usize,
        /// Arrival of the last of them.
        at: Instant,
    },
    /// Something happened to the wire itself, such as bus-off.
    Line {
        /// The event.
        event: LineEvent,
        /// Time.
        at: Instant,
    },
    /// The time passed without data.
    TimedOut,
    /// A [`LinkWaker`] was used.
    Woken,
}

/// Data that a link lost. Losses are counted, never silent.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Losses {
    /// Units that the system or the adapter dropped because they were not read in time.
    pub overrun: u64,
    /// Received data that is not a unit of this medium: damaged, or of an unsupported kind.
    pub malformed: u64,
    /// Errors on the wire that the CAN controller reported.
    pub errors: u64,
    /// Units that the adapter would not send.
    pub refused: u64,
}
