//! Bytes that came too soon: a reply begins when its request has left, and no byte travels faster
//! than the baud rate allows.
//!
//! Whoever hands bytes over (an adapter, a driver) only makes them later, so that the rule never
//! refuses a true reply; it does refuse the second copy of the reply before, as long as that copy
//! is not kept back until the request has left.
//!
//! Why: REQ-6.

use crate::medium::SerialLine;
use crate::time::Instant;

/// The least that `ns` on the wire may last: clocks of both ends may differ by a twentieth, and
/// receivers bear less.
#[must_use]
pub const fn tolerated(ns: u64) -> u64 {
    ns - ns / 20
}

/// Counts, of the bytes that a host holds, those that began before its request had left. They are
/// the first ones.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    character_ns: u64,
    left: Instant,
    early: usize,
}

impl Pace {
    /// For a line; on one without a baud rate nothing is ever early.
    #[must_use]
    pub const fn new(line: &SerialLine) -> Self {
        Self { character_ns: tolerated(line.characters_ns(1)), left: Instant::ZERO, early: 0 }
    }

    /// A request was put on the line at `now` and takes `ns` at least, [`tolerated`]; what was held
    /// is dropped.
    #[inline]
    pub const fn sent(&mut self, now: Instant, ns: u64) {
        self.left = now.plus_ns(ns);
        self.early = 0;
    }

    /// Bytes were handed over at `now`; `held` are held with them.
    #[inline]
    pub fn heard(&mut self, now: Instant, held: usize) {
        let since = now.0.saturating_sub(self.left.0);
        if since < held as u64 * self.character_ns {
            self.early = self.early.max(held - (since / self.character_ns) as usize);
        }
    }

    /// So many of the first bytes are done with.
    #[inline]
    pub const fn took(&mut self, count: usize) {
        self.early = self.early.saturating_sub(count);
    }

    /// How many bytes, of those held, are too early for a reply.
    #[inline]
    #[must_use]
    pub const fn early(&self) -> usize {
        self.early
    }
}

#[cfg(test)]
mod tests {
    use super::{Pace, tolerated};
    use crate::medium::SerialLine;
    use crate::time::Instant;

    #[test]
    fn a_reply_begins_when_its_request_has_left() {
        let line = SerialLine::n81(9600);
        let mut pace = Pace::new(&line);
        let at = |characters: u32| Instant(line.characters_ns(characters));
        pace.sent(Instant::ZERO, tolerated(line.characters_ns(9)));
        pace.heard(at(10), 9);
        assert_eq!(pace.early(), 8, "only the last of them can have begun behind the request");
        pace.took(5);
        assert_eq!(pace.early(), 3);
        pace.sent(Instant::ZERO, tolerated(line.characters_ns(9)));
        pace.heard(at(18), 9);
        assert_eq!(pace.early(), 0);
        // A head that was handed over too soon makes the frame late, whenever its tail comes.
        pace.sent(Instant::ZERO, tolerated(line.characters_ns(9)));
        pace.heard(at(8), 2);
        pace.heard(at(100), 9);
        assert_eq!(pace.early(), 2);
    }

    #[test]
    fn a_wire_without_a_baud_rate_has_no_pace() {
        let mut pace = Pace::new(&SerialLine::n81(0));
        pace.sent(Instant(5), 0);
        pace.heard(Instant(5), 200);
        assert_eq!(pace.early(), 0);
    }
}
