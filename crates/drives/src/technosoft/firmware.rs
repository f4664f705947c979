//! The interface of the drive to its wires.

use super::drive::Drive;
use super::status::{cer, mer};
use polepair_core::proto::tml::device::{Firmware, LineFault};
use polepair_core::proto::tml::online::OnlineMessage;
use polepair_core::proto::tml::wire::Message;
use polepair_core::time::Instant;

impl Firmware for Drive {
    fn axis(&self) -> u8 {
        self.axis
    }

    fn groups(&self) -> u8 {
        self.groups
    }

    fn baud(&self) -> u32 {
        self.baud
    }

    fn bit_rate(&self) -> u32 {
        self.bit_rate
    }

    fn execute(&mut self, now: Instant, message: &Message) {
        self.advance(now);
        let (to, instruction) = (message.to, &message.instruction);
        let request = OnlineMessage::parse(instruction).filter(OnlineMessage::is_request);
        if let Some(request) = request {
            self.answer_request(to, &request);
        } else if self.program.must_hold(instruction.opcode) {
            self.hold_message(instruction);
        } else {
            Drive::execute(self, instruction);
            self.report_changes();
        }
    }

    fn poll_message(&mut self, now: Instant) -> Option<Message> {
        if now < self.busy_until {
            return None;
        }
        let message = self.outbox.pop()?;
        self.handle_sent(now, &message);
        Some(message)
    }

    /// CER.6 clears itself after a message (help page on CER).
    fn note_can_message(&mut self) {
        self.status.cer &= !cer::BUS_OFF;
    }

    fn note_line_fault(&mut self, trouble: LineFault) {
        let (error, summary) = match trouble {
            LineFault::SerialReceive => (cer::SERIAL_RECEIVE, mer::COMMUNICATION),
            LineFault::SerialOverrun => (cer::SERIAL_TRANSMIT, mer::COMMUNICATION),
            LineFault::CanOverrun => (cer::CAN_OVERRUN, mer::CAN),
            LineFault::BusOff => (cer::BUS_OFF, mer::CAN),
        };
        self.status.cer |= error;
        self.status.mer |= summary;
        self.mark_stale();
    }
}
