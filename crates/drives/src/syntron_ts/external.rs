//! Set-points of modes 0, 2 and 4: an analogue input of ±10 V, and pulses with a direction.
//!
//! The manual has the numbers of the modes (§2.2), but not their wiring and scales, so these are `[I]`.

use core::f64::consts::TAU;

use super::shaft::COUNTS_PER_TURN;
use polepair_core::plant::TICK_S;

/// The analog input takes no more, V.
const VOLTS_MAX: f64 = 10.0;
/// Speed in mode 0, rpm/V `[I]`.
const RPM_PER_VOLT: f64 = 300.0;
/// Torque in mode 4, share of the rated one per V `[I]`.
const TORQUE_PER_VOLT: f64 = 0.1;
/// Share of Fn_95 over which the torque fades as the speed comes near to it `[I]`.
const TORQUE_FADE_SHARE: f64 = 0.05;
/// Pulses of a second at most `[I]`: what line drivers are built for.
pub const PULSES_MAX: f64 = 500_000.0;

/// The signals as something outside drives them.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct ExternalSignals {
    analog_volts: f64,
    /// A generator's pulses a second; negative ones turn in reverse.
    pulse_rate: f64,
    /// Pulses that no tick has taken yet.
    pending_pulses: f64,
}

impl ExternalSignals {
    /// The analog input; beyond ±10 V it clips.
    pub const fn set_volts(&mut self, volts: f64) {
        self.analog_volts = volts.clamp(-VOLTS_MAX, VOLTS_MAX);
    }

    /// A steady train of pulses.
    pub const fn set_rate(&mut self, hertz: f64) {
        self.pulse_rate = hertz.clamp(-PULSES_MAX, PULSES_MAX);
    }

    /// Adds `count` pulses at once.
    pub fn add_pulses(&mut self, count: i32) {
        self.pending_pulses += f64::from(count);
    }

    /// Speed that mode 0 wants, rad/s.
    #[must_use]
    pub fn speed(&self) -> f64 {
        self.analog_volts * RPM_PER_VOLT * TAU / 60.0
    }

    /// Share of the rated torque that mode 4 wants at `rpm`. None drives the motor beyond `limit_rpm`
    /// (Fn_95, §3.6.3); 0 is no limit `[I]`.
    #[must_use]
    pub fn torque(&self, rpm: f64, limit_rpm: f64) -> f64 {
        let wanted = self.analog_volts * TORQUE_PER_VOLT;
        if limit_rpm <= 0.0 {
            return wanted;
        }
        let along = if wanted < 0.0 { -rpm } else { rpm };
        wanted * ((limit_rpm - along) / (TORQUE_FADE_SHARE * limit_rpm)).clamp(0.0, 1.0)
    }

    /// Rotation by the pulses of one tick, rad: one pulse is one encoder count `[I]`.
    pub fn take_rotation(&mut self) -> f64 {
        let pulses = core::mem::take(&mut self.pending_pulses) + self.pulse_rate * TICK_S;
        pulses / COUNTS_PER_TURN * TAU
    }

    /// Discards pulses that arrived while no mode followed them.
    pub const fn drop_pulses(&mut self) {
        self.pending_pulses = 0.0;
    }
}
