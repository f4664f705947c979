//! Inputs: limit switches, home, ENABLE and STO, and the actions of their edges.
//!
//! \[I\] INSTATUS has bit n for input n, like the masks of IN(…): IN0 home, IN1 free, IN2 LSP, IN3 LSN; bit
//! 14 STO, bit 15 ENABLE. The real order differs between products.

use super::addresses;
use super::drive::{Drive, TRIGGERS};
use super::status::{der, isr, mer, set_bits, srh};

/// Bits of INSTATUS.
pub(super) mod line {
    pub const HOME: u16 = 1 << 0;
    pub const LSP: u16 = 1 << 2;
    pub const LSN: u16 = 1 << 3;
    pub const STO: u16 = 1 << 14;
    pub const ENABLE: u16 = 1 << 15;
}

/// ASR.12: the software limit switches are watched.
const SOFTWARE_LIMITS: u16 = 1 << 12;
/// ACR.3: ENABLE going up switches the axis on.
const ENABLE_SWITCHES_ON: u16 = 1 << 3;

/// Surroundings of the drive: the bench's side.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Surroundings {
    /// Levels that the bench gives.
    pub levels: u16,
    /// Shaft positions of the home, LSP and LSN switches, rad; NaN where there is none.
    pub switches: [f64; 3],
    /// Voltage at the reference input, V.
    pub reference_v: f64,
    pub hall_broken: bool,
    /// Edges to look for: bits of [`line`], and for each the level to reach.
    pub awaited_edges: u16,
    pub awaited_levels: u16,
    /// The index pulse is looked for.
    pub index_awaited: bool,
    /// Lines that SetAsInput made inputs.
    pub inputs_only: u16,
    previous_levels: u16,
}

impl Surroundings {
    /// Enabled, with no switch anywhere.
    pub const NEW: Self = Self {
        levels: line::ENABLE | line::STO,
        switches: [f64::NAN; 3],
        reference_v: 0.0,
        hall_broken: false,
        awaited_edges: 0,
        awaited_levels: 0,
        index_awaited: false,
        inputs_only: 0,
        previous_levels: line::ENABLE | line::STO,
    };
}

impl Drive {
    /// Value of INSTATUS. Home and LSP are closed from their position on, LSN up to it.
    pub fn input_levels(&self) -> u16 {
        let (around, at) = (&self.surroundings, self.shaft.motor.position());
        let [home, lsp, lsn] = around.switches;
        around.levels
            | bit_if(at >= home, line::HOME)
            | bit_if(at >= lsp, line::LSP)
            | bit_if(at <= lsn, line::LSN)
    }

    /// Looks at the inputs once a tick.
    #[inline]
    pub fn check_inputs(&mut self) {
        let levels = self.input_levels();
        let changed = levels ^ self.surroundings.previous_levels;
        if changed != 0 {
            // Before the edges are handled: what they switch must not see them again.
            self.surroundings.previous_levels = levels;
            self.handle_edges(levels, changed);
        }
        if self.status.mer & (mer::LSP | mer::LSN) != 0 {
            self.stop_at_limits();
        }
        if self.limits_watched {
            self.check_software_limits();
        }
    }

    /// Returns whether a limit switch blocks this direction.
    pub fn is_direction_blocked(&self, way: f64) -> bool {
        // A motor may always leave a switch.
        let bar = if way > 0.0 { mer::LSP } else { mer::LSN };
        way != 0.0 && self.status.mer & bar != 0
    }

    /// ENCAPI and its like: looks for an edge of an input, or no more.
    pub fn await_edge(&mut self, bit: u16, level: Option<bool>) {
        set_bits(&mut self.surroundings.awaited_edges, bit, level.is_some());
        set_bits(&mut self.surroundings.awaited_levels, bit, level == Some(true));
        let shown = match bit {
            line::LSP => srh::LSP,
            line::LSN => srh::LSN,
            _ => srh::CAPTURE,
        };
        // The bit of an earlier edge would end the new wait at once.
        set_bits(&mut self.status.srh, shown, false);
    }

    /// Checks whether the index pulse was passed.
    pub fn check_index(&mut self, before: f64) {
        let crossed = self.shaft.encoder.index_between(before, self.shaft.motor.position());
        if self.surroundings.index_awaited && crossed {
            self.surroundings.index_awaited = false;
            self.capture_position(srh::CAPTURE, isr::CAPTURE);
        }
    }

    fn handle_edges(&mut self, levels: u16, changed: u16) {
        set_bits(&mut self.status.mer, mer::LSP, is_level_on(line::LSP, levels));
        set_bits(&mut self.status.mer, mer::LSN, is_level_on(line::LSN, levels));
        // Either line takes the power off, and both have to be there for it to come back.
        let enabled = is_level_on(line::ENABLE, levels) && is_level_on(line::STO, levels);
        set_bits(&mut self.status.mer, mer::DISABLED, !enabled);
        if changed & (line::ENABLE | line::STO) != 0 {
            self.handle_enable_change(enabled);
        }
        let around = &mut self.surroundings;
        // An edge counts where the line has come to the awaited level.
        let hit = changed & around.awaited_edges & !(levels ^ around.awaited_levels);
        around.awaited_edges &= !hit;
        for (bit, shown, flag) in [
            (line::LSP, srh::LSP, isr::LSP),
            (line::LSN, srh::LSN, isr::LSN),
            (line::HOME, srh::CAPTURE, isr::CAPTURE),
        ] {
            if hit & bit != 0 {
                self.capture_position(shown, flag);
            }
        }
        self.mark_stale();
    }

    fn handle_enable_change(&mut self, enabled: bool) {
        self.status.isr |= isr::ENABLE;
        if !enabled {
            if self.shaft.servo.is_enabled() {
                self.notice = Some("ENABLE or STO: motor off");
            }
            self.axis_off();
        } else if self.memory.word(addresses::ACR) & ENABLE_SWITCHES_ON != 0 {
            self.axis_on();
        }
    }

    fn capture_position(&mut self, shown: u16, flag: u16) {
        self.status.srh |= shown;
        self.status.isr |= flag;
        self.memory.set_long(addresses::CAPPOS, self.shaft.count());
        self.mark_stale();
    }

    /// An active limit switch stops what moves toward it.
    fn stop_at_limits(&mut self) {
        let speed = self.shaft.servo.setpoint().velocity;
        if self.is_direction_blocked(speed) && !self.is_stopping() {
            self.notice = Some("limit switch: motor stopped");
            self.quick_stop();
        }
    }

    /// SWPOSLS and SWNEGLS, while ASR.12 is set.
    fn check_software_limits(&mut self) {
        let count = self.shaft.count();
        let (high, low) =
            (self.memory.long(addresses::SWPOSLS), self.memory.long(addresses::SWNEGLS));
        let (above, below) = (count >= high, count <= low);
        set_bits(&mut self.status.der, der::SOFTWARE_LSP, above);
        set_bits(&mut self.status.der, der::SOFTWARE_LSN, below);
        let speed = self.shaft.servo.setpoint().velocity;
        // Beyond the limit the axis may still come back.
        let outward = above && speed > 0.0 || below && speed < 0.0;
        if outward && !self.is_stopping() {
            self.notice = Some("software limit: motor stopped");
            self.quick_stop();
        }
    }

    /// Handles a write to POSTRIGGn: from now on bit n of SRH shows whether the position has reached it.
    /// \[I\] A bit whose position was never written stays 0.
    pub fn set_trigger(&mut self, address: u16) {
        debug_assert!(address >= addresses::POSTRIGG1, "the address of a trigger");
        let n = (address - addresses::POSTRIGG1) / 2;
        self.triggers[usize::from(n)] = Some(self.memory.long(addresses::POSTRIGG1 + 2 * n));
    }

    /// Looks whether the position passed a trigger.
    #[inline]
    pub fn check_triggers(&mut self) {
        if self.triggers == [None; TRIGGERS] {
            return;
        }
        let (count, before) = (self.shaft.count(), self.status.srh);
        for (n, trigger) in (0..).zip(self.triggers) {
            let reached = trigger.is_some_and(|index| count >= index);
            set_bits(&mut self.status.srh, srh::TRIGGER_1 << n, reached);
        }
        if self.status.srh != before {
            self.status.isr |= isr::POSITION_TRIGGER;
        }
    }

    /// Reads from the settings whether the software limits are watched.
    pub fn read_limit_switches(&mut self) {
        self.limits_watched = self.memory.word(addresses::ASR) & SOFTWARE_LIMITS != 0;
        if !self.limits_watched {
            self.status.der &= !(der::SOFTWARE_LSP | der::SOFTWARE_LSN);
        }
    }
}

fn is_level_on(bit: u16, levels: u16) -> bool {
    levels & bit != 0
}

fn bit_if(on: bool, bit: u16) -> u16 {
    if on { bit } else { 0 }
}
