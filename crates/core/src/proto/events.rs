//! What a host has to tell, in the order in which it happened.

use crate::error::Failure;
use crate::station::{Event, To};

/// A ring of `N` events, a power of two. An event is written where it will be read and lent from
/// there: it is larger than what most of it says, and copying it costs more than all else about it.
#[derive(Clone, Debug)]
pub struct Events<A, const N: usize> {
    ring: [Event<A>; N],
    taken: u32,
    pushed: u32,
}

impl<A: Copy, const N: usize> Events<A, N> {
    /// Nothing to tell.
    #[must_use]
    pub const fn new() -> Self {
        const { assert!(N.is_power_of_two()) };
        Self { ring: [(To::Address(0), Err(Failure::Silent)); N], taken: 0, pushed: 0 }
    }

    /// How many more it has room for.
    #[inline]
    #[must_use]
    pub const fn room(&self) -> usize {
        N - self.pushed.wrapping_sub(self.taken) as usize
    }

    /// Notes one more and lends it, so that a large answer can be completed where it lies. Whoever
    /// submits requests leaves room for the end of each.
    #[inline]
    pub fn push(&mut self, to: To, result: Result<A, Failure>) -> &mut Result<A, Failure> {
        debug_assert!(self.room() > 0, "submit leaves room for every end");
        // A large ring that is empty begins anew, so that what is written stays in the cache.
        if N > 16 && self.taken == self.pushed {
            (self.taken, self.pushed) = (0, 0);
        }
        let place = &mut self.ring[self.pushed as usize % N];
        *place = (to, result);
        self.pushed = self.pushed.wrapping_add(1);
        &mut place.1
    }

    /// The oldest that was not taken yet.
    #[inline]
    pub const fn next(&mut self) -> Option<&Event<A>> {
        if self.taken == self.pushed {
            return None;
        }
        let event = &self.ring[self.taken as usize % N];
        self.taken = self.taken.wrapping_add(1);
        Some(event)
    }
}

impl<A: Copy, const N: usize> Default for Events<A, N> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::Events;
    use crate::station::{Ticket, To};

    #[test]
    fn events_come_out_in_the_order_in_which_they_went_in() {
        let mut events = Events::<u32, 4>::new();
        assert_eq!((events.room(), events.next()), (4, None));
        for n in 0..100 {
            events.push(To::Ticket(Ticket(n)), Ok(n));
            events.push(To::Address(n), Ok(n + 1));
            assert_eq!(events.room(), 2);
            assert_eq!(events.next(), Some(&(To::Ticket(Ticket(n)), Ok(n))));
            assert_eq!(events.next(), Some(&(To::Address(n), Ok(n + 1))));
            assert_eq!(events.next(), None);
        }
    }
}
