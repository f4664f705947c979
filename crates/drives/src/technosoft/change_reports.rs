//! Messages that the drive sends by itself (type C), and the time of its next check.
//!
//! Source: TML communication manual, chapter 3, example 3: a mask for each register enables messages to
//! MASTERID about changes of its bits. On RS-485 nothing is sent.

use super::addresses;
use super::drive::Drive;
use super::execute::ExecuteError;
use super::status::Status;
use polepair_core::proto::tml::online::Cell;
use polepair_core::proto::tml::rules::TmlWire;
use polepair_core::proto::tml::wire::{IdCode, Instruction, operand_address};
use polepair_core::time::{Instant, earliest};

/// Bits of PVTSTS whose change is reported: all but the counter.
const POINTS_BITS: u16 = 0xF800;
/// Interval of checks of a drive at standstill while its host wants reports of changes, ticks.
const STANDSTILL_POLL_TICKS: u64 = 10;

/// Last reported values, and reports that wait.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct ChangeReports {
    reported: Status,
    reported_points: u16,
    /// SRL_MASK, SRH_MASK and MER_MASK.
    masks: [u16; 3],
    points: bool,
}

impl ChangeReports {
    /// Nothing to report.
    pub const NONE: Self =
        Self { reported: Status::NEW, reported_points: 0, masks: [0; 3], points: false };
}

impl Drive {
    /// Reads the masks, after a setting was written.
    pub fn read_masks(&mut self) {
        let own_host = self.memory.word(addresses::MASTERID) == IdCode::host_at(self.axis).word();
        let allowed = match self.options.quirks.wire {
            Some(TmlWire::Rs485) => false,
            None => !own_host, // nobody is there
            _ => true,
        };
        let masks = [self.options.srl_mask, addresses::SRH_MASK, addresses::MER_MASK];
        let points = self.memory.word(addresses::PVTSENDOFF) == 0;
        self.change_reports.masks = masks.map(|at| if allowed { self.memory.word(at) } else { 0 });
        self.change_reports.points = allowed && points;
    }

    /// Sends what has changed since the last report.
    #[inline]
    pub fn report_changes(&mut self) {
        let [srl, srh, mer] = self.change_reports.masks;
        let (was, is) = (self.change_reports.reported, self.status);
        if was != is {
            self.change_reports.reported = is;
            if (was.srl ^ is.srl) & srl | (was.srh ^ is.srh) & srh != 0 {
                self.report_cell(Cell::long(addresses::SRL));
            }
            if (was.mer ^ is.mer) & mer != 0 {
                self.report_cell(Cell::short(addresses::MER));
            }
        }
        if self.points.is_used() {
            self.report_points();
        }
    }

    /// Time of the next possible report.
    pub fn next_report_due(&self) -> Option<Instant> {
        let ticks = if self.needs_polling() {
            let idle = self.shaft.is_at_rest() || !self.motion.moving;
            Some(if idle && !self.program.is_active() { STANDSTILL_POLL_TICKS } else { 1 })
        } else {
            None
        };
        let points = if self.change_reports.points { self.ticks_to_next_point() } else { None };
        let held = (!self.outbox.is_empty()).then_some(self.busy_until);
        let sent = earliest(
            self.report_at(self.sync.ticks_left()),
            self.report_at(self.master.ticks_left(self.options.slow_ns)),
        );
        earliest(earliest(self.report_at(ticks), self.report_at(points)), earliest(sent, held))
    }

    fn report_at(&self, ticks: Option<u64>) -> Option<Instant> {
        ticks.map(|n| self.clock.after_ticks(n))
    }

    fn needs_polling(&self) -> bool {
        self.change_reports.masks != [0; 3] || self.program.is_active()
    }

    /// SEND: sends the value of a variable to MASTERID. On RS-485 no drive sends by itself (TML communication
    /// manual, chapter 3).
    pub fn send_variable(&mut self, i: &Instruction) -> Result<(), ExecuteError> {
        if self.options.quirks.wire == Some(TmlWire::Rs485) {
            return Err(ExecuteError::NotPossible);
        }
        let address = operand_address(i.opcode);
        let long = i.opcode & 0x0400 != 0;
        self.report_cell(if long { Cell::long(address) } else { Cell::short(address) });
        Ok(())
    }

    fn report_points(&mut self) {
        let is = self.points_status() & POINTS_BITS;
        let was = core::mem::replace(&mut self.change_reports.reported_points, is);
        if was != is {
            self.mark_stale();
            if self.change_reports.points {
                self.report_cell(Cell::short(addresses::PVTSTS));
            }
        }
    }

    fn report_cell(&mut self, cell: Cell) {
        if let Some(to) = IdCode::from_word(self.memory.word(addresses::MASTERID)) {
            self.mark_stale();
            self.publish();
            let instruction = self.take_data_2(cell).emit();
            self.send(to, instruction);
        }
    }
}
