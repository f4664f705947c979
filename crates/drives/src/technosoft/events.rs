//! Events: one condition at a time, and the action when it becomes true.
//!
//! Source: the help pages on events; the first data word of the instruction is the monitored variable.

use super::addresses;
use super::drive::Drive;
use super::execute::ExecuteError;
use super::program::ProgramWait;
use super::status::{isr, set_bits, srh, srl};
use polepair_core::plant::TICK_S;
use polepair_core::proto::tml::wire::Instruction;

/// Condition of an event.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum EventCondition {
    /// !MC.
    MotionComplete,
    /// !LSP, !LSN, !CAP: a bit of SRH.
    Edge(u16),
    /// !IN#n: lines of INSTATUS, all at one level.
    Inputs { mask: u16, high: bool },
    /// A 32-bit variable over or under a value.
    Variable { address: u16, over: bool, value: i32 },
}

/// Action of UPD! and STOP! at the event.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum EventAction {
    Update,
    Stop,
}

/// The event that is watched.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct EventMonitor {
    condition: Option<EventCondition>,
    action: Option<EventAction>,
}

impl EventMonitor {
    /// None.
    pub const NONE: Self = Self { condition: None, action: None };

    /// Returns whether an event is set that has not occurred.
    pub const fn is_pending(&self) -> bool {
        self.condition.is_some()
    }
}

impl Drive {
    /// 70xx and 71xx: sets the event. One that was watched is forgotten.
    pub fn set_event(&mut self, i: &Instruction) -> Result<(), ExecuteError> {
        let condition = match i.opcode {
            0x700C => EventCondition::Edge(srh::LSN),
            0x700D => EventCondition::Edge(srh::LSP),
            0x700E => EventCondition::Edge(srh::CAPTURE),
            0x700F => EventCondition::MotionComplete,
            0x70DA | 0x70DB => EventCondition::Inputs { mask: i.word(0), high: i.opcode == 0x70DA },
            _ => self.read_comparison(i),
        };
        self.events = EventMonitor { condition: Some(condition), action: None };
        set_bits(&mut self.status.srl, srl::EVENT, false);
        // A host that reads SRL at once must not see the event before this one.
        self.mark_stale();
        Ok(())
    }

    /// WAIT!, for at most `periods` slow loop periods.
    pub fn wait_for_event(&mut self, periods: Option<u32>) {
        self.program.wait = Some(ProgramWait::Event(
            periods.map(|n| (f64::from(n) * self.shaft.scale.slow_s / TICK_S) as u64),
        ));
    }

    /// UPD! and STOP!: when the event comes. \[I\] Without one they are refused.
    pub fn set_event_action(&mut self, then: EventAction) -> Result<(), ExecuteError> {
        if !self.events.is_pending() {
            return Err(ExecuteError::NotPossible);
        }
        self.events.action = Some(then);
        Ok(())
    }

    /// Looks whether the event has come.
    #[inline]
    pub fn check_event(&mut self) {
        let Some(condition) = self.events.condition else { return };
        if !self.is_condition_met(condition) {
            return;
        }
        self.events.condition = None;
        self.status.srl |= srl::EVENT;
        self.status.isr |= isr::EVENT;
        let done = match self.events.action.take() {
            Some(EventAction::Update) => self.update(),
            Some(EventAction::Stop) => self.stop(),
            None => Ok(()),
        };
        self.record_error(done);
    }

    fn is_condition_met(&mut self, condition: EventCondition) -> bool {
        match condition {
            EventCondition::MotionComplete => !self.motion.moving,
            EventCondition::Edge(bit) => self.status.srh & bit != 0,
            EventCondition::Inputs { mask, high } => {
                self.input_levels() & mask == if high { mask } else { 0 }
            }
            EventCondition::Variable { address, over, value } => {
                self.publish();
                let now = self.memory.long(address);
                if over { now >= value } else { now <= value }
            }
        }
    }

    /// Over or under: bit 4 of the opcode, or bits 5 and 4 of !RT. \[I\] Relative time counts from here.
    fn read_comparison(&mut self, i: &Instruction) -> EventCondition {
        let address = i.word(0);
        let value = match i.opcode & 0x100 {
            0 => i.long(1).cast_signed(),
            _ => self.memory.long(i.word(1)),
        };
        if address == addresses::RTIME {
            self.clock.set_relative(self.clock.now(), 0);
            self.mark_stale();
        }
        EventCondition::Variable { address, over: i.opcode & 0x10 != 0, value }
    }
}
