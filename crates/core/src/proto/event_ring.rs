//! Events of a host, in their order.

use crate::error::Failure;
use crate::station::{EventSubject, HostEvent};

/// A ring of `N` events, a power of two. An event is written and read in place, because a copy would cost
/// more than the rest.
#[derive(Clone, Debug)]
pub struct EventRing<A, const N: usize> {
    ring: [HostEvent<A>; N],
    popped: u32,
    pushed: u32,
}

impl<A: Copy, const N: usize> EventRing<A, N> {
    /// An empty ring.
    #[must_use]
    pub const fn new() -> Self {
        const { assert!(N.is_power_of_two()) };
        Self {
            ring: [(EventSubject::Unsolicited(0), Err(Failure::Silent)); N],
            popped: 0,
            pushed: 0,
        }
    }

    /// Free space.
    #[inline]
    #[must_use]
    pub const fn room(&self) -> usize {
        N - self.pushed.wrapping_sub(self.popped) as usize
    }

    /// Adds an event and lends it, so that a large reply can be completed in place. Callers that submit
    /// requests leave room for the end of each.
    #[inline]
    pub fn push(
        &mut self,
        to: EventSubject,
        result: Result<A, Failure>,
    ) -> &mut Result<A, Failure> {
        debug_assert!(self.room() > 0, "submit leaves room for every end");
        // A large ring that is empty begins anew, so that what is written stays in the cache.
        if N > 16 && self.popped == self.pushed {
            (self.popped, self.pushed) = (0, 0);
        }
        let position = &mut self.ring[self.pushed as usize % N];
        *position = (to, result);
        self.pushed = self.pushed.wrapping_add(1);
        &mut position.1
    }

    /// The oldest that was not taken yet.
    #[inline]
    pub const fn next(&mut self) -> Option<&HostEvent<A>> {
        if self.popped == self.pushed {
            return None;
        }
        let event = &self.ring[self.popped as usize % N];
        self.popped = self.popped.wrapping_add(1);
        Some(event)
    }
}

impl<A: Copy, const N: usize> Default for EventRing<A, N> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::EventRing;
    use crate::station::{EventSubject, Ticket};

    #[test]
    fn events_come_out_in_the_order_in_which_they_went_in() {
        let mut events = EventRing::<u32, 4>::new();
        assert_eq!((events.room(), events.next()), (4, None));
        for n in 0..100 {
            events.push(EventSubject::Request(Ticket(n)), Ok(n));
            events.push(EventSubject::Unsolicited(n), Ok(n + 1));
            assert_eq!(events.room(), 2);
            assert_eq!(events.next(), Some(&(EventSubject::Request(Ticket(n)), Ok(n))));
            assert_eq!(events.next(), Some(&(EventSubject::Unsolicited(n), Ok(n + 1))));
            assert_eq!(events.next(), None);
        }
    }
}
