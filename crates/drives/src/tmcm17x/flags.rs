//! Status flags of GAP 156 with their clearing rules (programming manual, parameter 156), and the trip
//! points of the hardware manual §"operational ratings".

/// Supply below 10 V.
pub const UNDERVOLT: u32 = 1 << 0;
/// Power stage above 115 °C, until below 105 °C.
pub const OVERTEMP: u32 = 1 << 1;
/// Power stage above 85 °C.
pub const TEMPWARN: u32 = 1 << 2;
/// Stop switch active, or stopped by command.
pub const STOPSWITCH: u32 = 1 << 3;
/// Drivers off, shaft free.
pub const HALTED: u32 = 1 << 4;
/// Impossible hall pattern. Cleared by reading.
pub const HALLERR: u32 = 1 << 5;
/// Positioning mode.
pub const POSMOD: u32 = 1 << 6;
/// The last move arrived.
pub const POS_END: u32 = 1 << 7;
/// Supply above 55 V.
pub const OVERVOLT: u32 = 1 << 8;
/// Encoder and index pulse disagree. Cleared by reading.
pub const ENCERR: u32 = 1 << 9;

/// Flags that switch the motor off.
pub const TRIPS: u32 = UNDERVOLT | OVERTEMP | HALLERR | OVERVOLT | ENCERR;
/// Flags that last as long as their cause.
pub const PERSISTENT: u32 = UNDERVOLT | OVERTEMP | OVERVOLT;
/// Flags that reading clears.
pub const CLEARED_BY_READ: u32 = HALLERR | ENCERR;

/// Motor off below, on again above, V.
pub const UNDERVOLT_V: (f64, f64) = (10.0, 12.0);
/// Motor off above, V; \[I\] on again below.
pub const OVERVOLT_V: (f64, f64) = (55.0, 54.0);
/// The logic lives above, V (hardware manual: alive from 7 to 9.5 V).
pub const LOGIC_V: f64 = 7.0;
/// Off above, on again below, °C.
pub const OVERTEMP_C: (f64, f64) = (115.0, 105.0);
/// Warning above, °C.
pub const TEMPWARN_C: f64 = 85.0;

/// The latched flags.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Flags(pub u32);

impl Flags {
    /// Returns whether any of these is set.
    #[must_use]
    pub const fn any(self, mask: u32) -> bool {
        self.0 & mask != 0
    }

    /// Sets or clears.
    pub const fn set(&mut self, mask: u32, on: bool) {
        self.0 = if on { self.0 | mask } else { self.0 & !mask };
    }

    /// Updates from supply and temperature; returns new trips.
    pub fn update(&mut self, supply: f64, protected: bool, celsius: f64) -> u32 {
        let before = self.0;
        self.apply_hysteresis(UNDERVOLT, supply < UNDERVOLT_V.0, supply >= UNDERVOLT_V.1);
        let over = protected && supply > OVERVOLT_V.0;
        self.apply_hysteresis(OVERVOLT, over, !protected || supply < OVERVOLT_V.1);
        self.apply_hysteresis(OVERTEMP, celsius > OVERTEMP_C.0, celsius < OVERTEMP_C.1);
        self.set(TEMPWARN, celsius > TEMPWARN_C);
        self.0 & !before & TRIPS
    }

    /// Reply to GAP 156; clears the flags that reading clears.
    pub fn read_and_clear(&mut self) -> u32 {
        let read = self.0;
        self.0 &= !CLEARED_BY_READ;
        read
    }

    fn apply_hysteresis(&mut self, mask: u32, on: bool, off: bool) {
        if on {
            self.set(mask, true);
        } else if off {
            self.set(mask, false);
        }
    }
}
