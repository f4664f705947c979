//! On-line requests and their replies.
//!
//! Sources: TML communication manual, chapters 3 to 5 (GiveMeData, TakeData and their short forms); for the
//! others captures of real drives.

use super::drive::Drive;
use polepair_core::proto::tml::online::{Cell, MemorySpace, OnlineMessage};
use polepair_core::proto::tml::wire::IdCode;

impl Drive {
    /// Answers a request that was sent to `to`.
    pub fn answer_request(&mut self, to: IdCode, request: &OnlineMessage) {
        let Some(asker) = request.reply_to() else { return };
        // GiveMeData is not for groups (manual, chapter 5), and [I] not for axis ID 0: all would
        // answer at once, on CAN with the same identifier.
        let several = to.group || to.id == 0;
        let refused = several && matches!(request, OnlineMessage::GiveMeData { .. });
        if asker.group || refused {
            return;
        }
        self.publish();
        if let Some(answer) = self.answer_for(request) {
            self.send(asker, answer.emit());
        }
    }

    fn answer_for(&self, request: &OnlineMessage) -> Option<OnlineMessage> {
        let (sender, version) = (self.own_id(), self.options.version);
        Some(match *request {
            OnlineMessage::GiveMeData { cell, .. } => {
                OnlineMessage::TakeData { sender, cell, value: self.cell_value(cell) }
            }
            OnlineMessage::GiveMeData2 { cell, .. } => self.take_data_2(cell),
            OnlineMessage::GetData { address, long, .. } => {
                let cell = Cell { memory: MemorySpace::Data, address, long };
                OnlineMessage::GotData { sender, address, long, value: self.cell_value(cell) }
            }
            OnlineMessage::GetVersion { .. } => OnlineMessage::TakeVersion { version },
            OnlineMessage::Ping { .. } => OnlineMessage::Pong { sender: self.axis, version },
            OnlineMessage::GetChecksum { memory, start, end, .. } => OnlineMessage::TakeChecksum {
                memory,
                sum: self.memory.checksum(memory, start, end),
            },
            _ => return None,
        })
    }

    /// TakeData2 of a value: an answer, or unasked.
    pub fn take_data_2(&self, cell: Cell) -> OnlineMessage {
        let Cell { address, long, .. } = cell;
        OnlineMessage::TakeData2 { sender: self.axis, address, long, value: self.cell_value(cell) }
    }

    fn cell_value(&self, cell: Cell) -> u32 {
        self.read_memory(cell.memory, cell.address, cell.long)
    }
}
