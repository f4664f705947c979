//! Stores outcomes until their callers read them.

use std::task;
use std::thread::Thread;

use polepair_core::error::Outcome;
use polepair_core::station::Ticket;

/// Requests of one connection that are pending at once.
pub const PENDING_MAX: usize = 1024;

/// A ticket is the index of its slot and the number of its use.
const INDEX_BITS: u32 = 10;

#[derive(Default)]
pub(super) struct RequestSlots {
    slots: Vec<RequestSlot>,
    free: Vec<u32>,
}

struct RequestSlot {
    ticket: Ticket,
    phase: SlotPhase,
    parked_thread: Option<Thread>,
    waker: Option<task::Waker>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum SlotPhase {
    Free,
    Pending,
    /// Pending, and its outcome is not wanted any more.
    Abandoned,
    Ended(Outcome),
}

impl RequestSlots {
    pub(super) fn open_slot(&mut self) -> Option<Ticket> {
        let index = self.free.pop().or_else(|| self.grow())?;
        debug_assert!(
            matches!(self.slots[index as usize].phase, SlotPhase::Free),
            "a free place is free"
        );
        let slot = &mut self.slots[index as usize];
        slot.phase = SlotPhase::Pending;
        Some(slot.ticket)
    }

    /// Notes an outcome. Gives the waker to be woken once the lock is released.
    pub(super) fn set_outcome(&mut self, ticket: Ticket, outcome: Outcome) -> Option<task::Waker> {
        let slot = self.slot(ticket)?;
        match slot.phase {
            SlotPhase::Pending => {
                slot.phase = SlotPhase::Ended(outcome);
                if let Some(thread) = slot.parked_thread.take() {
                    thread.unpark();
                }
                slot.waker.take()
            }
            SlotPhase::Abandoned => {
                self.free_slot(ticket);
                None
            }
            SlotPhase::Free | SlotPhase::Ended(_) => None,
        }
    }

    /// The outcome, once; the slot is free then.
    pub(super) fn take_outcome(&mut self, ticket: Ticket) -> Option<Outcome> {
        let SlotPhase::Ended(outcome) = self.slot(ticket)?.phase else { return None };
        self.free_slot(ticket);
        Some(outcome)
    }

    pub(super) fn abandon(&mut self, ticket: Ticket) {
        let Some(slot) = self.slot(ticket) else { return };
        if slot.phase == SlotPhase::Pending {
            (slot.phase, slot.parked_thread, slot.waker) = (SlotPhase::Abandoned, None, None);
        } else {
            self.free_slot(ticket);
        }
    }

    /// Takes back a ticket that the lane refused.
    pub(super) fn free_slot(&mut self, ticket: Ticket) {
        let Some(slot) = self.slot(ticket) else { return };
        // Another number each time, so that an old ticket finds nothing of the new request.
        let reuse = Ticket(slot.ticket.0.wrapping_add(1 << INDEX_BITS));
        *slot =
            RequestSlot { ticket: reuse, phase: SlotPhase::Free, parked_thread: None, waker: None };
        debug_assert!(self.free.len() < self.slots.len(), "no place is free twice");
        self.free.push(index(ticket));
    }

    pub(super) fn set_thread(&mut self, ticket: Ticket, thread: Option<Thread>) {
        if let Some(slot) = self.slot(ticket) {
            slot.parked_thread = thread;
        }
    }

    pub(super) fn set_waker(&mut self, ticket: Ticket, waker: &task::Waker) {
        if let Some(slot) = self.slot(ticket) {
            slot.waker = Some(waker.clone());
        }
    }

    /// Wakes one waiting thread, which will then lead. False when none waits.
    pub(super) fn unpark_one(&self) -> bool {
        let next = self.slots.iter().find_map(|slot| slot.parked_thread.as_ref());
        next.map(Thread::unpark).is_some()
    }

    pub(super) fn unpark_all(&self) {
        self.slots.iter().filter_map(|slot| slot.parked_thread.as_ref()).for_each(Thread::unpark);
    }

    /// Tickets that have not ended.
    pub(super) fn pending(&self) -> impl Iterator<Item = Ticket> {
        let open =
            |slot: &&RequestSlot| matches!(slot.phase, SlotPhase::Pending | SlotPhase::Abandoned);
        self.slots.iter().filter(open).map(|slot| slot.ticket)
    }

    /// Returns true while a thread or task waits that does not read itself.
    pub(super) fn has_wakers(&self) -> bool {
        self.slots.iter().any(|slot| slot.waker.is_some())
    }

    #[cfg(test)]
    pub(crate) fn len(&self) -> usize {
        self.slots.len()
    }

    fn slot(&mut self, ticket: Ticket) -> Option<&mut RequestSlot> {
        self.slots.get_mut(index(ticket) as usize).filter(|slot| slot.ticket == ticket)
    }

    fn grow(&mut self) -> Option<u32> {
        let index = u32::try_from(self.slots.len()).ok()?;
        if self.slots.len() == PENDING_MAX {
            return None;
        }
        let ticket = Ticket(index | 1 << INDEX_BITS);
        self.slots.push(RequestSlot {
            ticket,
            phase: SlotPhase::Free,
            parked_thread: None,
            waker: None,
        });
        Some(index)
    }
}

const fn index(ticket: Ticket) -> u32 {
    ticket.0 & ((1 << INDEX_BITS) - 1)
}
