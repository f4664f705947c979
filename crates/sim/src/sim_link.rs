//! The host's end of one wire together with its world: the base of a simulated link.
//!
//! The crate that owns links adds a clock and a thread; this is a plain object. In virtual time, the owner
//! calls [`SimLink::advance_to`] with the end of its wait, and the result is available at once. In real
//! time, it first sleeps until [`SimLink::next_event`].

use polepair_core::medium::SerialLine;
use polepair_core::time::Instant;

use crate::world::{EndId, WireId, World};

/// A world and one outside end of it.
#[derive(Debug)]
pub struct SimLink {
    world: World,
    wire: WireId,
    end: EndId,
}

impl SimLink {
    /// Opens the host's end of `wire`.
    #[must_use]
    pub fn new(mut world: World, wire: WireId) -> Self {
        let end = world.open_end(wire);
        Self { world, wire, end }
    }

    /// The wire that this is an end of.
    #[must_use]
    pub const fn wire(&self) -> WireId {
        self.wire
    }

    /// The world's time.
    #[must_use]
    pub const fn now(&self) -> Instant {
        self.world.now()
    }

    /// Sets the host's line from now on.
    pub fn set_line(&mut self, line: SerialLine) {
        self.world.set_line(self.end, line);
    }

    /// Sends bytes at `now`, or at the world's time if that is later.
    pub fn send(&mut self, now: Instant, bytes: &[u8]) {
        self.world.send(self.end, now, bytes);
    }

    /// Takes what has arrived: when, and how many bytes of `buffer` it filled.
    pub fn receive(&mut self, buffer: &mut [u8]) -> Option<(Instant, usize)> {
        self.world.receive(self.end, buffer)
    }

    /// Time of the next event in the world.
    #[must_use]
    pub fn next_event(&self) -> Option<Instant> {
        self.world.next_event()
    }

    /// Lets time pass until something arrives here, or until `until`. Returns the time it is then.
    pub fn advance_to(&mut self, until: Instant) -> Instant {
        while !self.world.has_pending(self.end) {
            if self.world.next_event().is_none_or(|at| at > until) {
                self.world.run_until(until);
                break;
            }
            self.world.step();
        }
        self.world.now()
    }

    /// The world, for acts upon its drives.
    pub const fn world(&mut self) -> &mut World {
        &mut self.world
    }
}
