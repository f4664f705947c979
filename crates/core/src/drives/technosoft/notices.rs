//! What the drive says unasked (type C), and when it must be woken to say it.
//!
//! Source: TML communication manual, chapter 3, example 3: a mask for each register; a bit in it
//! lets a change of that bit be told to MASTERID. On RS-485 nothing is told.

use super::at;
use super::drive::Drive;
use super::status::Status;
use crate::proto::tml::online::Cell;
use crate::proto::tml::rules::Wire;
use crate::proto::tml::wire::IdCode;
use crate::time::{Instant, earliest};

/// Bits of PVTSTS whose change is told: all but the counter.
const POINTS_BITS: u16 = 0xF800;
/// How often a drive that stands still is looked at while its host wants to hear of changes, ticks.
const STILL_TICKS: u64 = 10;

/// What was told last, and what is to be told.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Notices {
    told: Status,
    told_points: u16,
    /// SRL_MASK, SRH_MASK and MER_MASK.
    masks: [u16; 3],
    points: bool,
}

impl Notices {
    /// Nothing to tell.
    pub const NONE: Self = Self { told: Status::NEW, told_points: 0, masks: [0; 3], points: false };
}

impl Drive {
    /// Reads the masks, after a setting was written.
    pub fn read_masks(&mut self) {
        let own_host = self.memory.word(at::MASTERID) == IdCode::host_at(self.axis).word();
        let allowed = match self.options.quirks.wire {
            Some(Wire::Rs485) => false,
            None => !own_host, // nobody is there
            _ => true,
        };
        let masks = [self.options.srl_mask, at::SRH_MASK, at::MER_MASK];
        let points = self.memory.word(at::PVTSENDOFF) == 0;
        self.notices.masks = masks.map(|at| if allowed { self.memory.word(at) } else { 0 });
        self.notices.points = allowed && points;
    }

    /// Tells what changed since it was last told.
    #[inline]
    pub fn tell(&mut self) {
        let [srl, srh, mer] = self.notices.masks;
        let (was, is) = (self.notices.told, self.status);
        if was != is {
            self.notices.told = is;
            if (was.srl ^ is.srl) & srl | (was.srh ^ is.srh) & srh != 0 {
                self.tell_cell(Cell::long(at::SRL));
            }
            if (was.mer ^ is.mer) & mer != 0 {
                self.tell_cell(Cell::short(at::MER));
            }
        }
        if self.points.is_used() {
            self.tell_points();
        }
    }

    /// When something may have to be told next.
    pub fn next_event(&self) -> Option<Instant> {
        let ticks = if self.must_look() {
            let idle = self.shaft.is_still() || !self.motion.moving;
            Some(if idle && !self.program.is_active() { STILL_TICKS } else { 1 })
        } else {
            None
        };
        let points = if self.notices.points { self.ticks_to_next_point() } else { None };
        let at = |ticks: Option<u64>| ticks.map(|n| self.clock.after_ticks(n));
        let held = (!self.outbox.is_empty()).then_some(self.busy_until);
        earliest(earliest(at(ticks), at(points)), earliest(at(self.sync.ticks_left()), held))
    }

    fn must_look(&self) -> bool {
        self.notices.masks != [0; 3] || self.program.is_active()
    }

    fn tell_points(&mut self) {
        let is = self.points_status() & POINTS_BITS;
        let was = core::mem::replace(&mut self.notices.told_points, is);
        if was != is {
            self.stale();
            if self.notices.points {
                self.tell_cell(Cell::short(at::PVTSTS));
            }
        }
    }

    fn tell_cell(&mut self, cell: Cell) {
        if let Some(to) = IdCode::from_word(self.memory.word(at::MASTERID)) {
            self.stale();
            self.publish();
            let told = self.take_data_2(cell).emit();
            self.send(to, told);
        }
    }
}
