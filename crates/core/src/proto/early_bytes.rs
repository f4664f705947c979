//! Detects bytes that arrive too early: a reply begins after its request was sent, and no byte is faster
//! than the baud rate.
//!
//! Adapters and drivers can only delay bytes, so this never refuses a true reply. It refuses the second
//! copy of the previous reply, unless the copy is delayed until the request was sent.
//!
//! Why: REQ-6.

use crate::medium::SerialLine;
use crate::time::Instant;

/// The least that `ns` on the wire may last: clocks of both ends may differ by a twentieth, and
/// receivers bear less.
#[must_use]
pub const fn with_clock_tolerance(ns: u64) -> u64 {
    ns - ns / 20
}

/// Counts, of the bytes that a host holds, those that began before its request had left. They are
/// the first ones.
#[derive(Clone, Copy, Debug)]
pub struct EarlyBytes {
    character_ns: u64,
    request_end: Instant,
    count: usize,
}

impl EarlyBytes {
    /// For a line; on one without a baud rate nothing is ever early.
    #[must_use]
    pub const fn new(line: &SerialLine) -> Self {
        Self {
            character_ns: with_clock_tolerance(line.characters_ns(1)),
            request_end: Instant::ZERO,
            count: 0,
        }
    }

    /// A request was sent at `now` and takes at least `ns`, [`with_clock_tolerance`]; held bytes are
    /// dropped.
    #[inline]
    pub const fn note_sent(&mut self, now: Instant, ns: u64) {
        self.request_end = now.plus_ns(ns);
        self.count = 0;
    }

    /// Bytes were received at `now`; `held` are held with them.
    #[inline]
    pub fn note_received(&mut self, now: Instant, held: usize) {
        let since = now.0.saturating_sub(self.request_end.0);
        if since < held as u64 * self.character_ns {
            self.count = self.count.max(held - (since / self.character_ns) as usize);
        }
    }

    /// Removes the first `count` bytes.
    #[inline]
    pub const fn consume(&mut self, count: usize) {
        self.count = self.count.saturating_sub(count);
    }

    /// Number of held bytes that are too early for a reply.
    #[inline]
    #[must_use]
    pub const fn count(&self) -> usize {
        self.count
    }
}

#[cfg(test)]
mod tests {
    use super::{EarlyBytes, with_clock_tolerance};
    use crate::medium::SerialLine;
    use crate::time::Instant;

    #[test]
    fn a_reply_begins_when_its_request_has_left() {
        let line = SerialLine::new_8n1(9600);
        let mut pace = EarlyBytes::new(&line);
        let at = |characters: u32| Instant(line.characters_ns(characters));
        pace.note_sent(Instant::ZERO, with_clock_tolerance(line.characters_ns(9)));
        pace.note_received(at(10), 9);
        assert_eq!(pace.count(), 8, "only the last of them can have begun behind the request");
        pace.consume(5);
        assert_eq!(pace.count(), 3);
        pace.note_sent(Instant::ZERO, with_clock_tolerance(line.characters_ns(9)));
        pace.note_received(at(18), 9);
        assert_eq!(pace.count(), 0);
        // A head that was handed over too soon makes the frame late, whenever its tail comes.
        pace.note_sent(Instant::ZERO, with_clock_tolerance(line.characters_ns(9)));
        pace.note_received(at(8), 2);
        pace.note_received(at(100), 9);
        assert_eq!(pace.count(), 2);
    }

    #[test]
    fn a_wire_without_a_baud_rate_has_no_pace() {
        let mut pace = EarlyBytes::new(&SerialLine::new_8n1(0));
        pace.note_sent(Instant(5), 0);
        pace.note_received(Instant(5), 200);
        assert_eq!(pace.count(), 0);
    }
}
