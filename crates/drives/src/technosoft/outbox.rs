//! Messages to be sent, in their order.

use polepair_core::proto::tml::wire::Message;

/// Messages that wait at most.
const OUTBOX_MAX: usize = 16;

/// A bounded queue of messages.
#[derive(Clone, Debug)]
pub(super) struct Outbox {
    messages: [Option<Message>; OUTBOX_MAX],
    first: usize,
    len: usize,
}

impl Outbox {
    /// Nothing to send.
    pub const EMPTY: Self = Self { messages: [None; OUTBOX_MAX], first: 0, len: 0 };

    /// False if there is no room.
    #[must_use]
    pub fn push(&mut self, message: Message) -> bool {
        if self.len == OUTBOX_MAX {
            return false;
        }
        self.messages[(self.first + self.len) % OUTBOX_MAX] = Some(message);
        self.len += 1;
        true
    }

    /// Returns whether messages are pending.
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The oldest.
    pub fn pop(&mut self) -> Option<Message> {
        let message = self.messages[self.first].take()?;
        self.first = (self.first + 1) % OUTBOX_MAX;
        self.len -= 1;
        Some(message)
    }
}
