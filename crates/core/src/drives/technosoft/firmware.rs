//! The drive as its wires see it.

use super::drive::Drive;
use super::status::{cer, mer};
use crate::proto::tml::device::{Firmware, Trouble};
use crate::proto::tml::online::Online;
use crate::proto::tml::wire::Message;
use crate::time::Instant;

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
        let request = Online::parse(instruction).filter(Online::is_request);
        if let Some(request) = request {
            self.answer(to, &request);
        } else if self.program.holds(instruction.opcode) {
            self.hold(instruction);
        } else {
            Drive::execute(self, instruction);
            self.tell();
        }
    }

    fn poll_message(&mut self, now: Instant) -> Option<Message> {
        if now < self.busy_until {
            return None;
        }
        let message = self.outbox.pop()?;
        self.sent(now, &message);
        Some(message)
    }

    /// CER.6 goes by itself once a message came (help page on CER).
    fn heard_can(&mut self) {
        self.status.cer &= !cer::BUS_OFF;
    }

    fn trouble(&mut self, trouble: Trouble) {
        let (error, summary) = match trouble {
            Trouble::SerialReceive => (cer::SERIAL_RECEIVE, mer::COMMUNICATION),
            Trouble::SerialOverrun => (cer::SERIAL_TRANSMIT, mer::COMMUNICATION),
            Trouble::CanOverrun => (cer::CAN_OVERRUN, mer::CAN),
            Trouble::BusOff => (cer::BUS_OFF, mer::CAN),
        };
        self.status.cer |= error;
        self.status.mer |= summary;
        self.stale();
    }
}
