//! A queue of future events: a binary heap; ties are ordered by the time of insertion.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use polepair_core::time::Instant;

/// The events to come, earliest first; those of one instant in the order they were scheduled.
#[derive(Debug)]
pub(crate) struct TimedQueue<T> {
    heap: BinaryHeap<TimedEntry<T>>,
    scheduled: u64,
}

impl<T> TimedQueue<T> {
    pub(crate) fn new() -> Self {
        Self { heap: BinaryHeap::with_capacity(64), scheduled: 0 }
    }

    pub(crate) fn push(&mut self, at: Instant, what: T) {
        self.scheduled += 1;
        self.heap.push(TimedEntry { at, order: self.scheduled, item: what });
    }

    pub(crate) fn next_time(&self) -> Option<Instant> {
        self.heap.peek().map(|entry| entry.at)
    }

    pub(crate) fn pop(&mut self) -> Option<(Instant, T)> {
        self.heap.pop().map(|entry| (entry.at, entry.item))
    }
}

#[derive(Debug)]
struct TimedEntry<T> {
    at: Instant,
    order: u64,
    item: T,
}

impl<T> TimedEntry<T> {
    const fn key(&self) -> (Instant, u64) {
        (self.at, self.order)
    }
}

impl<T> PartialEq for TimedEntry<T> {
    fn eq(&self, other: &Self) -> bool {
        self.key() == other.key()
    }
}

impl<T> Eq for TimedEntry<T> {}

impl<T> PartialOrd for TimedEntry<T> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl<T> Ord for TimedEntry<T> {
    fn cmp(&self, other: &Self) -> Ordering {
        other.key().cmp(&self.key())
    }
}
