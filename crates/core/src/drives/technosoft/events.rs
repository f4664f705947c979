//! Events: one condition at a time, and what is done when it comes true.
//!
//! Source: the help pages on events; the opcodes' first word is the variable that is watched.

use super::at;
use super::drive::Drive;
use super::execute::Refused;
use super::program::Wait;
use super::status::{isr, put, srh, srl};
use crate::plant::TICK_S;
use crate::proto::tml::wire::Instruction;

/// What is watched.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Condition {
    /// !MC.
    MotionComplete,
    /// !LSP, !LSN, !CAP: a bit of SRH.
    Edge(u16),
    /// !IN#n: lines of INSTATUS, all at one level.
    Inputs { mask: u16, high: bool },
    /// A 32-bit variable over or under a value.
    Variable { address: u16, over: bool, value: i32 },
}

/// What UPD! and STOP! ordered for the moment of the event.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Then {
    Update,
    Stop,
}

/// The event that is watched.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Events {
    watched: Option<Condition>,
    then: Option<Then>,
}

impl Events {
    /// None.
    pub const NONE: Self = Self { watched: None, then: None };

    /// Whether there is one that has not come true.
    pub const fn is_watched(&self) -> bool {
        self.watched.is_some()
    }
}

impl Drive {
    /// 70xx and 71xx: sets the event. One that was watched is forgotten.
    pub fn set_event(&mut self, i: &Instruction) -> Result<(), Refused> {
        let condition = match i.opcode {
            0x700C => Condition::Edge(srh::LSN),
            0x700D => Condition::Edge(srh::LSP),
            0x700E => Condition::Edge(srh::CAPTURE),
            0x700F => Condition::MotionComplete,
            0x70DA | 0x70DB => Condition::Inputs { mask: i.word(0), high: i.opcode == 0x70DA },
            _ => self.comparison(i),
        };
        self.events = Events { watched: Some(condition), then: None };
        put(&mut self.status.srl, srl::EVENT, false);
        Ok(())
    }

    /// WAIT!, for so many slow loop periods at most.
    pub fn wait_for_event(&mut self, periods: Option<u32>) {
        let ticks = |n: u32| (f64::from(n) * self.shaft.scale.slow_s / TICK_S) as u64;
        self.program.wait = Some(Wait::Event(periods.map(ticks)));
    }

    /// UPD! and STOP!: when the event comes. \[I\] Without one they are refused.
    pub fn on_event(&mut self, then: Then) -> Result<(), Refused> {
        if !self.events.is_watched() {
            return Err(Refused::NotNow);
        }
        self.events.then = Some(then);
        Ok(())
    }

    /// Looks whether the event has come.
    #[inline]
    pub fn watch_event(&mut self) {
        let Some(condition) = self.events.watched else { return };
        if !self.has_come(condition) {
            return;
        }
        self.events.watched = None;
        self.status.srl |= srl::EVENT;
        self.status.isr |= isr::EVENT;
        let done = match self.events.then.take() {
            Some(Then::Update) => self.update(),
            Some(Then::Stop) => self.stop(),
            None => Ok(()),
        };
        self.note(done);
    }

    fn has_come(&mut self, condition: Condition) -> bool {
        match condition {
            Condition::MotionComplete => !self.motion.moving,
            Condition::Edge(bit) => self.status.srh & bit != 0,
            Condition::Inputs { mask, high } => self.levels() & mask == if high { mask } else { 0 },
            Condition::Variable { address, over, value } => {
                self.publish();
                let now = self.memory.long(address);
                if over { now >= value } else { now <= value }
            }
        }
    }

    /// Over or under: bit 4 of the opcode tells, or bits 5 and 4 of !RT. \[I\] Relative time counts
    /// from here on.
    fn comparison(&mut self, i: &Instruction) -> Condition {
        let address = i.word(0);
        let value = match i.opcode & 0x100 {
            0 => i.long(1).cast_signed(),
            _ => self.memory.long(i.word(1)),
        };
        if address == at::RTIME {
            self.clock.set_relative(self.clock.now(), 0);
            self.stale();
        }
        Condition::Variable { address, over: i.opcode & 0x10 != 0, value }
    }
}
