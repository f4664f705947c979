//! Requests and their answers: what a drive says when it is asked.
//!
//! Sources: TML communication manual, chapters 3 to 5 (GiveMeData, TakeData and their short
//! forms); for the others captures of real drives.

use super::drive::Drive;
use crate::proto::tml::online::{Cell, Memory, Online};
use crate::proto::tml::wire::IdCode;

impl Drive {
    /// Answers a request that was sent to `to`.
    pub fn answer(&mut self, to: IdCode, request: &Online) {
        let Some(asker) = request.reply_to() else { return };
        // GiveMeData is not for groups (manual, chapter 5), and [I] not for axis ID 0: all would
        // answer at once, on CAN with the same identifier.
        let several = to.group || to.id == 0;
        let refused = several && matches!(request, Online::GiveMeData { .. });
        if asker.group || refused {
            return;
        }
        self.publish();
        if let Some(answer) = self.answer_to(request) {
            self.send(asker, answer.emit());
        }
    }

    fn answer_to(&self, request: &Online) -> Option<Online> {
        let (sender, version) = (self.own(), self.options.version);
        Some(match *request {
            Online::GiveMeData { cell, .. } => {
                Online::TakeData { sender, cell, value: self.cell(cell) }
            }
            Online::GiveMeData2 { cell, .. } => self.take_data_2(cell),
            Online::GetData { address, long, .. } => {
                let cell = Cell { memory: Memory::Data, address, long };
                Online::GotData { sender, address, long, value: self.cell(cell) }
            }
            Online::GetVersion { .. } => Online::TakeVersion { version },
            Online::Ping { .. } => Online::Pong { sender: self.axis, version },
            Online::GetChecksum { memory, start, end, .. } => {
                Online::TakeChecksum { memory, sum: self.memory.checksum(memory, start, end) }
            }
            _ => return None,
        })
    }

    /// TakeData2 of a value: an answer, or unasked.
    pub fn take_data_2(&self, cell: Cell) -> Online {
        let Cell { address, long, .. } = cell;
        Online::TakeData2 { sender: self.axis, address, long, value: self.cell(cell) }
    }

    fn cell(&self, cell: Cell) -> u32 {
        self.fetch(cell.memory, cell.address, cell.long)
    }
}
