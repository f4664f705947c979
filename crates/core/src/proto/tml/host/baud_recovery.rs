//! Follows the baud rate of a drive that is alone on a serial line.
//!
//! A drive takes the rate of SCIBR behind its acknowledgement, and uses 9600 again after RESET and power-up ("the
//! default after reset", TML communication manual, chapter 3). The first is followed. After the second, the rate is set
//! again that the line was opened at.

use crate::proto::tml::wire::{IdCode, Instruction, Message};
use crate::time::Instant;

/// Baud rate of every drive after power-up.
pub const RESET_BAUD: u32 = 9600;
/// Rates that SCIBR sets, by its number. The manual prints 56600 for what ports call 57600.
pub const BAUDS: [u32; 5] = [RESET_BAUD, 19_200, 38_400, 57_600, 115_200];
/// RESET.
const RESET_OPCODE: u16 = 0x0402;
/// SCIBR with a number.
pub const SCIBR_OPCODE: u16 = 0x0820;
/// Time of a drive's restart after RESET \[I\], ms.
const BOOT_MS: u32 = 500;
/// Between a change of the line's rate and the next byte, ms.
const SETTLE_MS: u32 = 5;
/// Times SCIBR is sent after RESET at most; after silence, which has many causes, once.
const ATTEMPTS_MAX: u8 = 3;

/// Baud rate that SCIBR sets with this number.
pub const fn baud_of_code(code: u16) -> Option<u32> {
    if (code as usize) < BAUDS.len() { Some(BAUDS[code as usize]) } else { None }
}

/// The rate that is wanted, and how far it is.
#[derive(Debug)]
pub struct BaudRecovery {
    /// Rate that the line was opened at.
    opened: u32,
    wanted: u32,
    /// Rate at which the drive may have stayed, when SCIBR was not acknowledged.
    before: Option<u32>,
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
    /// SCIBR is out, for this rate.
    Changing(u32),
    /// SCIBR for this rate was not acknowledged, and the drive was not received since.
    Unsure(u32),
    /// At another rate; SCIBR is sent then.
    SendBaud(Instant),
    /// SCIBR is out; its acknowledgement is waited for until then.
    AwaitAck(Instant),
    /// At the wanted rate; nothing is sent before then.
    Settle(Instant),
}

impl BaudRecovery {
    /// The rate of a line on which that drive is alone.
    pub fn new(wanted: u32, drive: Option<u8>) -> Self {
        let drive = drive.filter(|_| BAUDS.contains(&wanted));
        let stage = RecoveryStage::AtWanted;
        Self { opened: wanted, wanted, before: None, drive, stage, attempts_left: 0 }
    }

    /// Returns whether silence may be another rate's, which can be restored.
    pub const fn can_restore(&self) -> bool {
        self.drive.is_some()
            && (self.wanted != RESET_BAUD
                || self.before.is_some()
                || matches!(self.stage, RecoveryStage::Changing(_) | RecoveryStage::Unsure(_)))
    }

    /// Returns whether messages may be sent: the line is at the wanted rate.
    pub const fn is_at_wanted(&self) -> bool {
        use RecoveryStage as S;
        matches!(self.stage, S::AtWanted | S::Resetting | S::Changing(_) | S::Unsure(_))
    }

    /// Returns whether the rate is the wanted one, and no recovery is running.
    pub const fn is_settled(&self) -> bool {
        matches!(self.stage, RecoveryStage::AtWanted)
    }

    /// Present baud rate of the line.
    pub fn baud(&self) -> u32 {
        match self.stage {
            RecoveryStage::SendBaud(_) | RecoveryStage::AwaitAck(_) => self.other_rate(),
            _ => self.wanted,
        }
    }

    /// The rate at which SCIBR is sent: the one that the drive may have kept first, that of a reset last.
    fn other_rate(&self) -> u32 {
        self.before.unwrap_or(RESET_BAUD)
    }

    /// Notes a sent message.
    pub fn note_sent(&mut self, message: &Message) {
        let addressed = self.drive.is_some_and(|drive| message.to == IdCode::axis(drive));
        let instruction = &message.instruction;
        self.stage = match (self.stage, instruction.opcode) {
            (_, RESET_OPCODE) if addressed => RecoveryStage::Resetting,
            (_, SCIBR_OPCODE) if addressed => match baud_of_code(instruction.word(0)) {
                Some(rate) => RecoveryStage::Changing(rate),
                None => self.stage,
            },
            (RecoveryStage::Changing(rate), _) => RecoveryStage::Unsure(rate),
            (stage, _) => stage,
        };
    }

    /// The last sent message was acknowledged.
    pub fn note_accepted(&mut self, now: Instant) {
        match self.stage {
            RecoveryStage::Changing(rate) => {
                (self.wanted, self.before) = (rate, None);
                self.stage = RecoveryStage::Settle(now.plus_ms(SETTLE_MS));
            }
            // It is received at the rate before.
            RecoveryStage::Unsure(_) => self.stage = RecoveryStage::AtWanted,
            RecoveryStage::AtWanted => self.before = None,
            _ => {}
        }
    }

    /// RESET was taken, if one was out.
    pub fn note_reset(&mut self, now: Instant) {
        if self.stage == RecoveryStage::Resetting {
            (self.wanted, self.before) = (self.opened, None);
            let restarted = now.plus_ms(BOOT_MS);
            (self.stage, self.attempts_left) = match self.opened {
                RESET_BAUD => (RecoveryStage::Settle(restarted), 0),
                _ => (RecoveryStage::SendBaud(restarted), ATTEMPTS_MAX),
            };
        }
    }

    /// The drive is silent: it may have been switched off and on, or have taken a rate without an acknowledgement.
    pub fn fall_back(&mut self, now: Instant) {
        let at = now.plus_ms(SETTLE_MS);
        if let RecoveryStage::Unsure(rate) = self.stage {
            (self.before, self.wanted) = (Some(self.wanted), rate);
            self.stage = RecoveryStage::Settle(at);
            return;
        }
        // Once at each rate: a drive that is at none of them is not there.
        let attempts = if self.before.is_some_and(|rate| rate != RESET_BAUD) { 2 } else { 1 };
        (self.stage, self.attempts_left) = (RecoveryStage::SendBaud(at), attempts);
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
        let instruction = Instruction::of(SCIBR_OPCODE, [code as u16]);
        Some(Message { to: IdCode::axis(self.drive?), instruction })
    }

    /// Handles an acknowledgement. True if it belongs to the recovery.
    pub fn handle_ack(&mut self, now: Instant) -> bool {
        let reported = matches!(self.stage, RecoveryStage::AwaitAck(_));
        if reported {
            self.before = None;
            self.stage = RecoveryStage::Settle(now.plus_ms(SETTLE_MS));
        }
        reported
    }

    /// Time of the next action.
    pub const fn deadline(&self) -> Option<Instant> {
        match self.stage {
            RecoveryStage::SendBaud(at)
            | RecoveryStage::AwaitAck(at)
            | RecoveryStage::Settle(at) => Some(at),
            _ => None,
        }
    }

    /// Goes on when its time has come. True when the line is right again.
    pub fn advance(&mut self, now: Instant) -> bool {
        match self.stage {
            RecoveryStage::AwaitAck(at) if now >= at && self.attempts_left > 0 => {
                self.before = None;
                self.stage = RecoveryStage::SendBaud(now.plus_ms(SETTLE_MS))
            }
            // Without an acknowledgement the line goes back all the same: the drive may have been at its rate
            // before.
            RecoveryStage::AwaitAck(at) if now >= at => {
                self.before = None;
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
