//! Restores the baud rate of a serial line: a drive uses 9600 again after RESET and power-up ("the default
//! after reset", TML communication manual, chapter 3).

use crate::proto::tml::wire::{IdCode, Instruction, Message};
use crate::time::Instant;

/// Baud rate of every drive after power-up.
pub const RESET_BAUD: u32 = 9600;
/// Rates that SCIBR sets, by its number. The manual prints 56600 for what ports call 57600.
const BAUDS: [u32; 5] = [RESET_BAUD, 19_200, 38_400, 57_600, 115_200];
/// RESET.
const RESET_OPCODE: u16 = 0x0402;
/// Time of a drive's restart after RESET \[I\], ms.
const BOOT_MS: u32 = 500;
/// Between a change of the line's rate and the next byte, ms.
const SETTLE_MS: u32 = 5;
/// Times SCIBR is sent after RESET at most; after silence, which has many causes, once.
const ATTEMPTS_MAX: u8 = 3;

/// The rate that is wanted, and how far it is.
#[derive(Debug)]
pub struct BaudRecovery {
    wanted: u32,
    /// The drive on the line, if it is the only one that could be set.
    drive: Option<u8>,
    stage: RecoveryStage,
    attempts_left: u8,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum RecoveryStage {
    /// The rate is the wanted one.
    AtWanted,
    /// RESET is out.
    Resetting,
    /// At 9600; SCIBR is sent then.
    SendBaud(Instant),
    /// SCIBR is out; its acknowledgement is waited for until then.
    AwaitAck(Instant),
    /// At the wanted rate; nothing is sent before then.
    Settle(Instant),
}

impl BaudRecovery {
    /// The rate of a line on which that drive is alone.
    pub fn new(wanted: u32, drive: Option<u8>) -> Self {
        let drive = drive.filter(|_| wanted != RESET_BAUD && BAUDS.contains(&wanted));
        Self { wanted, drive, stage: RecoveryStage::AtWanted, attempts_left: 0 }
    }

    /// Returns whether the wanted rate can be restored.
    pub const fn can_restore(&self) -> bool {
        self.drive.is_some()
    }

    /// Returns whether messages may be sent: the line is at the wanted rate.
    pub const fn is_at_wanted(&self) -> bool {
        matches!(self.stage, RecoveryStage::AtWanted | RecoveryStage::Resetting)
    }

    /// Returns whether the rate is the wanted one, and no recovery is running.
    pub const fn is_settled(&self) -> bool {
        matches!(self.stage, RecoveryStage::AtWanted)
    }

    /// Present baud rate of the line.
    pub const fn baud(&self) -> u32 {
        match self.stage {
            RecoveryStage::SendBaud(_) | RecoveryStage::AwaitAck(_) => RESET_BAUD,
            _ => self.wanted,
        }
    }

    /// Notes a sent message.
    pub fn note_sent(&mut self, message: &Message) {
        let reset = message.instruction.opcode == RESET_OPCODE;
        if reset && self.drive.is_some_and(|drive| message.to == IdCode::axis(drive)) {
            self.stage = RecoveryStage::Resetting;
        }
    }

    /// RESET was taken, if one was out.
    pub fn note_reset(&mut self, now: Instant) {
        if self.stage == RecoveryStage::Resetting {
            (self.stage, self.attempts_left) =
                (RecoveryStage::SendBaud(now.plus_ms(BOOT_MS)), ATTEMPTS_MAX);
        }
    }

    /// The drive is silent: it may have been switched off and on.
    pub fn fall_back(&mut self, now: Instant) {
        // Once: a drive that is not there at 9600 baud either is not there.
        (self.stage, self.attempts_left) = (RecoveryStage::SendBaud(now.plus_ms(SETTLE_MS)), 1);
    }

    /// The next message of the recovery; `left` is the time at which it will have been sent.
    pub fn next_message(&mut self, now: Instant, left: Instant) -> Option<Message> {
        let RecoveryStage::SendBaud(at) = self.stage else { return None };
        let code = BAUDS.iter().position(|rate| *rate == self.wanted)?;
        if now < at {
            return None;
        }
        self.stage = RecoveryStage::AwaitAck(left);
        debug_assert!(self.attempts_left > 0, "a rate is set as often as it may");
        self.attempts_left -= 1;
        let instruction = Instruction::of(0x0820, [code as u16]);
        Some(Message { to: IdCode::axis(self.drive?), instruction })
    }

    /// Handles an acknowledgement. True if it belongs to the recovery.
    pub fn handle_ack(&mut self, now: Instant) -> bool {
        let reported = matches!(self.stage, RecoveryStage::AwaitAck(_));
        if reported {
            self.stage = RecoveryStage::Settle(now.plus_ms(SETTLE_MS));
        }
        reported
    }

    /// Time of the next action.
    pub const fn deadline(&self) -> Option<Instant> {
        match self.stage {
            RecoveryStage::AtWanted | RecoveryStage::Resetting => None,
            RecoveryStage::SendBaud(at)
            | RecoveryStage::AwaitAck(at)
            | RecoveryStage::Settle(at) => Some(at),
        }
    }

    /// Goes on when its time has come. True when the line is right again.
    pub fn advance(&mut self, now: Instant) -> bool {
        match self.stage {
            RecoveryStage::AwaitAck(at) if now >= at && self.attempts_left > 0 => {
                self.stage = RecoveryStage::SendBaud(now)
            }
            // Without an acknowledgement the line goes back all the same: the drive may have been at its rate
            // before.
            RecoveryStage::AwaitAck(at) if now >= at => {
                self.stage = RecoveryStage::Settle(now.plus_ms(SETTLE_MS))
            }
            RecoveryStage::Settle(at) if now >= at => {
                self.stage = RecoveryStage::AtWanted;
                return true;
            }
            _ => {}
        }
        false
    }
}
