//! The wait for a descriptor: how much is read at once, and time limits as the system takes them.

use std::time::Duration;

use polepair_core::convert::saturating;
use rustix::event::{Nsecs, Timespec};

/// Amount that one read takes of the received data.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum ReadMode {
    /// All bytes for which the buffer has room.
    Stream,
    /// One piece of perhaps several: a datagram, a frame.
    Messages,
}

pub(crate) fn timespec(span: Duration) -> Timespec {
    Timespec { tv_sec: saturating(span.as_secs()), tv_nsec: span.subsec_nanos() as Nsecs }
}
