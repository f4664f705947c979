//! The master of gears and cams: a drive that sends its position to others.
//!
//! Source: labelled frames of SGM and RGM (MCR bit 11), which take effect at UPD; TML_LIB's header (the
//! master sends its position or its target, to an axis or a group: OSR bit 15 and SLAVEID). \[I\] The message is an
//! assignment to the slaves' MREF, in each slow loop. SLAVEID has the axis ID or group mask in bits 7 to 0, and
//! bit 8 set for a group.

use super::addresses;
use super::drive::Drive;
use polepair_core::plant::TICK_NS;
use polepair_core::proto::tml::host_request::assign_instruction;
use polepair_core::proto::tml::rules::TmlWire;
use polepair_core::proto::tml::wire::IdCode;

/// MCR.11: master of gear and cam.
const MASTER: u16 = 1 << 11;
/// OSR.15: the target is sent, otherwise the position.
const SENDS_TARGET: u16 = 1 << 15;
/// SLAVEID.8: a group.
const GROUP: u16 = 1 << 8;

/// A drive's part as master of a gear.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct GearMaster {
    is_active: bool,
    /// Time since the last message, ns.
    since_sent_ns: u64,
}

impl GearMaster {
    /// No master.
    pub const OFF: Self = Self { is_active: false, since_sent_ns: 0 };

    /// Returns whether it sends its position.
    pub const fn is_active(&self) -> bool {
        self.is_active
    }

    /// Ticks until it sends again.
    pub fn ticks_left(&self, period_ns: u64) -> Option<u64> {
        let left = period_ns.saturating_sub(self.since_sent_ns).div_ceil(TICK_NS).max(1);
        self.is_active.then_some(left)
    }
}

impl Drive {
    /// UPD: SGM or RGM take effect. On RS-485 no drive sends by itself (TML communication manual, chapter 3).
    pub fn update_master(&mut self) {
        let is_silent = self.options.quirks.wire == Some(TmlWire::Rs485);
        self.master.is_active = !is_silent && self.memory.word(addresses::MCR) & MASTER != 0;
    }

    /// Sends its position when a slow loop has passed.
    #[inline]
    pub fn tick_master(&mut self) {
        if !self.master.is_active {
            return;
        }
        self.master.since_sent_ns += TICK_NS;
        if self.master.since_sent_ns < self.options.slow_ns {
            return;
        }
        self.master.since_sent_ns = 0;
        let slave = self.memory.word(addresses::SLAVEID);
        let id = slave as u8;
        let to = if slave & GROUP != 0 { IdCode::groups(id) } else { IdCode::axis(id) };
        let sends_target = self.memory.word(addresses::OSR) & SENDS_TARGET != 0;
        let position = if sends_target { self.shaft.target() } else { self.shaft.count() };
        // ID 0 is everybody, the master too. A slave of its own would follow itself.
        if id != 0 && to != self.own_id() {
            let instruction = assign_instruction(addresses::MREF, position.cast_unsigned(), true);
            self.send(to, instruction);
        }
    }
}
