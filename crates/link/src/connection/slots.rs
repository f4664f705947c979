//! Where outcomes wait for those who asked.

use std::task;
use std::thread::Thread;

use polepair_core::error::Outcome;
use polepair_core::station::Ticket;

/// Requests of one connection that are pending at once.
pub const PENDING_MAX: usize = 1024;

/// A ticket is the index of its slot and a count that tells its uses apart.
const INDEX_BITS: u32 = 10;

#[derive(Default)]
pub(super) struct Slots {
    slots: Vec<Slot>,
    free: Vec<u32>,
}

struct Slot {
    ticket: Ticket,
    phase: Phase,
    thread: Option<Thread>,
    waker: Option<task::Waker>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Phase {
    Free,
    Pending,
    /// Pending, and nobody will ask for the outcome.
    Abandoned,
    Ended(Outcome),
}

impl Slots {
    pub(super) fn open(&mut self) -> Option<Ticket> {
        let index = self.free.pop().or_else(|| self.grow())?;
        let slot = &mut self.slots[index as usize];
        slot.phase = Phase::Pending;
        Some(slot.ticket)
    }

    /// Notes an outcome. Gives the waker to be woken once the lock is released.
    pub(super) fn end(&mut self, ticket: Ticket, outcome: Outcome) -> Option<task::Waker> {
        let slot = self.slot(ticket)?;
        match slot.phase {
            Phase::Pending => {
                slot.phase = Phase::Ended(outcome);
                if let Some(thread) = slot.thread.take() {
                    thread.unpark();
                }
                slot.waker.take()
            }
            Phase::Abandoned => {
                self.close(ticket);
                None
            }
            Phase::Free | Phase::Ended(_) => None,
        }
    }

    /// The outcome, once; the slot is free then.
    pub(super) fn take(&mut self, ticket: Ticket) -> Option<Outcome> {
        let Phase::Ended(outcome) = self.slot(ticket)?.phase else { return None };
        self.close(ticket);
        Some(outcome)
    }

    pub(super) fn abandon(&mut self, ticket: Ticket) {
        let Some(slot) = self.slot(ticket) else { return };
        if slot.phase == Phase::Pending {
            (slot.phase, slot.thread, slot.waker) = (Phase::Abandoned, None, None);
        } else {
            self.close(ticket);
        }
    }

    /// Takes back a ticket that the lane refused.
    pub(super) fn close(&mut self, ticket: Ticket) {
        let Some(slot) = self.slot(ticket) else { return };
        let reuse = Ticket(slot.ticket.0.wrapping_add(1 << INDEX_BITS));
        *slot = Slot { ticket: reuse, phase: Phase::Free, thread: None, waker: None };
        self.free.push(index(ticket));
    }

    pub(super) fn attend(&mut self, ticket: Ticket, thread: Option<Thread>) {
        if let Some(slot) = self.slot(ticket) {
            slot.thread = thread;
        }
    }

    pub(super) fn attend_with(&mut self, ticket: Ticket, waker: &task::Waker) {
        if let Some(slot) = self.slot(ticket) {
            slot.waker = Some(waker.clone());
        }
    }

    /// Wakes one waiting thread, which will then lead. False when none waits.
    pub(super) fn unpark_one(&self) -> bool {
        let next = self.slots.iter().find_map(|slot| slot.thread.as_ref());
        next.map(Thread::unpark).is_some()
    }

    pub(super) fn unpark_all(&self) {
        self.slots.iter().filter_map(|slot| slot.thread.as_ref()).for_each(Thread::unpark);
    }

    /// Tickets that have not ended.
    pub(super) fn pending(&self) -> impl Iterator<Item = Ticket> {
        let open = |slot: &&Slot| matches!(slot.phase, Phase::Pending | Phase::Abandoned);
        self.slots.iter().filter(open).map(|slot| slot.ticket)
    }

    /// True while somebody waits who does not read himself.
    pub(super) fn anybody_asleep(&self) -> bool {
        self.slots.iter().any(|slot| slot.waker.is_some())
    }

    #[cfg(test)]
    pub(crate) fn len(&self) -> usize {
        self.slots.len()
    }

    fn slot(&mut self, ticket: Ticket) -> Option<&mut Slot> {
        self.slots.get_mut(index(ticket) as usize).filter(|slot| slot.ticket == ticket)
    }

    fn grow(&mut self) -> Option<u32> {
        let index = u32::try_from(self.slots.len()).ok()?;
        if self.slots.len() == PENDING_MAX {
            return None;
        }
        let ticket = Ticket(index | 1 << INDEX_BITS);
        self.slots.push(Slot { ticket, phase: Phase::Free, thread: None, waker: None });
        Some(index)
    }
}

const fn index(ticket: Ticket) -> u32 {
    ticket.0 & ((1 << INDEX_BITS) - 1)
}
