//! The baud rate of a serial line, and how it is had back: a drive speaks at 9600 again after RESET
//! and power-up ("the default after reset", TML communication manual, chapter 3).

use crate::proto::tml::wire::{IdCode, Instruction, Message};
use crate::time::Instant;

/// What every drive speaks from power-up on.
pub const FIRST: u32 = 9600;
/// Rates that SCIBR sets, by its number. The manual prints 56600 for what ports call 57600.
const RATES: [u32; 5] = [FIRST, 19_200, 38_400, 57_600, 115_200];
/// RESET.
const RESET: u16 = 0x0402;
/// How long a drive takes to be there again after RESET \[I\], ms.
const BOOT_MS: u32 = 500;
/// Between a change of the line's rate and the next byte, ms.
const SETTLE_MS: u32 = 5;
/// Times SCIBR is sent after RESET at most; after silence, which has many causes, once.
const ATTEMPTS_MAX: u8 = 3;

/// The rate that is wanted, and how far it is.
#[derive(Debug)]
pub struct Rate {
    wanted: u32,
    /// The drive on the line, where there is one alone that could be told.
    drive: Option<u8>,
    stage: Stage,
    left: u8,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Stage {
    /// As it should be.
    Right,
    /// RESET is out.
    Resetting,
    /// At 9600; SCIBR goes out then.
    Tell(Instant),
    /// SCIBR is out; its acknowledgement is waited for until then.
    Told(Instant),
    /// At the rate that is wanted; nothing goes out before then.
    Settle(Instant),
}

impl Rate {
    /// The rate of a line on which that drive is alone.
    pub fn new(wanted: u32, drive: Option<u8>) -> Self {
        let drive = drive.filter(|_| wanted != FIRST && RATES.contains(&wanted));
        Self { wanted, drive, stage: Stage::Right, left: 0 }
    }

    /// Whether there is a way back to it.
    pub const fn is_restored(&self) -> bool {
        self.drive.is_some()
    }

    /// Whether messages may go out: the line is at the rate that it should have.
    pub const fn is_right(&self) -> bool {
        matches!(self.stage, Stage::Right | Stage::Resetting)
    }

    /// Whether it is as it should be, and nothing is under way to have it so.
    pub const fn is_still(&self) -> bool {
        matches!(self.stage, Stage::Right)
    }

    /// What the line is to be driven at.
    pub const fn baud(&self) -> u32 {
        match self.stage {
            Stage::Tell(_) | Stage::Told(_) => FIRST,
            _ => self.wanted,
        }
    }

    /// A message goes out.
    pub fn sends(&mut self, message: &Message) {
        let to = IdCode::axis(self.drive.unwrap_or(0));
        if self.drive.is_some() && message.instruction.opcode == RESET && message.to == to {
            self.stage = Stage::Resetting;
        }
    }

    /// RESET was taken, if one was out.
    pub fn is_reset(&mut self, now: Instant) {
        if self.stage == Stage::Resetting {
            (self.stage, self.left) = (Stage::Tell(now.plus_ms(BOOT_MS)), ATTEMPTS_MAX);
        }
    }

    /// The drive is silent: it may have been switched off and on.
    pub fn fall_back(&mut self, now: Instant) {
        (self.stage, self.left) = (Stage::Tell(now.plus_ms(SETTLE_MS)), 1);
    }

    /// What the drive is to be told now; `left` is when it will have left.
    pub fn tell(&mut self, now: Instant, left: Instant) -> Option<Message> {
        let Stage::Tell(at) = self.stage else { return None };
        let code = RATES.iter().position(|rate| *rate == self.wanted)?;
        if now < at {
            return None;
        }
        self.stage = Stage::Told(left);
        self.left -= 1;
        let instruction = Instruction::of(0x0820, [code as u16]);
        Some(Message { to: IdCode::axis(self.drive?), instruction })
    }

    /// An acknowledgement came. True if it was for this.
    pub fn acknowledged(&mut self, now: Instant) -> bool {
        let told = matches!(self.stage, Stage::Told(_));
        if told {
            self.stage = Stage::Settle(now.plus_ms(SETTLE_MS));
        }
        told
    }

    /// When something is to be done.
    pub const fn due(&self) -> Option<Instant> {
        match self.stage {
            Stage::Right | Stage::Resetting => None,
            Stage::Tell(at) | Stage::Told(at) | Stage::Settle(at) => Some(at),
        }
    }

    /// Goes on when its time has come. True when the line is right again.
    pub fn advance(&mut self, now: Instant) -> bool {
        match self.stage {
            Stage::Told(at) if now >= at && self.left > 0 => self.stage = Stage::Tell(now),
            Stage::Told(at) if now >= at => self.stage = Stage::Settle(now.plus_ms(SETTLE_MS)),
            Stage::Settle(at) if now >= at => {
                self.stage = Stage::Right;
                return true;
            }
            _ => {}
        }
        false
    }
}
