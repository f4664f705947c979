//! Readings of an axis as the judge of its motion takes them: units, tolerances and flags.

use super::slot::AxisSlot;
use crate::axis::Command;
use crate::judge::{Observation, STANDSTILL_LINEAR, STANDSTILL_ROTARY, Tolerance};
use crate::plan::ParameterTest;
use crate::profile::{Encoding, ParameterId, Severity, Signal};
use crate::station::Request;
use crate::units::Unit;

/// Speed that means standstill where no unit is known, raw. Positions must agree then.
const STANDSTILL_RAW: f64 = 50.0;
/// Window around the target unless the drive has its own: 0.5 deg.
const WINDOW_ROTARY: f64 = 0.5 * core::f64::consts::PI / 180.0;
/// Window of a linear axis: 0.05 mm.
const WINDOW_LINEAR: f64 = 5e-5;
/// The default window in counts, at least: a coarse encoder has no better one.
pub const WINDOW_COUNTS_MIN: f64 = 4.0;
/// The drive's own window in counts, at least.
const OWN_WINDOW_COUNTS_MIN: f64 = 2.0;
/// The default window where no unit is known, as a share of the way.
pub const WINDOW_SHARE: f64 = 1e-3;
/// Motion of a motor at standstill, in counts and as a share of the default window: a servo that holds its position is
/// never quite still.
const NOISE_COUNTS: f64 = 2.0;
const NOISE_SHARE: f64 = 0.25;

impl<R: Request, A: Copy + 'static> AxisSlot<R, A> {
    /// Tolerances of positions and speeds of this axis.
    pub fn tolerance(&self, command: Option<&Command>) -> Tolerance {
        let position = self.profile.signal(Signal::Position).map(|source| source.parameter);
        let parameter = position.and_then(|id| self.parameter(id));
        let si = position.and_then(|id| self.unit_value(id));
        let linear = parameter.is_some_and(|parameter| parameter.unit == Unit::Millimetre);
        let (window, slow) = if linear {
            (WINDOW_LINEAR, STANDSTILL_LINEAR)
        } else {
            (WINDOW_ROTARY, STANDSTILL_ROTARY)
        };
        let default_window = value_in_counts(window, si).unwrap_or(0.0);
        let speed = command.and_then(|command| command.velocity).filter(|speed| *speed != 0.0);
        Tolerance {
            encoding: parameter.map_or(Encoding::I32, |p| p.encoding),
            window: default_window.max(WINDOW_COUNTS_MIN),
            noise: (default_window * NOISE_SHARE).max(NOISE_COUNTS),
            standstill: self.standstill_speed(),
            drift: value_in_counts(slow, si).unwrap_or(0.0),
            speed: speed.and_then(|speed| value_in_counts(speed.abs(), si)),
        }
    }

    /// The greatest speed that means standstill, as the number of its raw value.
    fn standstill_speed(&self) -> Option<f64> {
        let id = self.readable_signal(Signal::Velocity)?;
        let parameter = self.parameter(id)?;
        let limit = match parameter.unit {
            Unit::MillimetrePerSecond => STANDSTILL_LINEAR,
            _ => STANDSTILL_ROTARY,
        };
        Some(self.unit_value(id).map_or(STANDSTILL_RAW, |si| limit / si.abs()))
    }

    /// A position or a distance in counts of the position.
    pub fn target_counts(&self, id: ParameterId, si: f64, raw: bool) -> Option<f64> {
        match self.si_per_raw(id) {
            Some(one) => Some(si / one),
            None if raw => Some(si),
            None => None,
        }
    }

    /// The drive's own window, in counts of the position; `None` where it is off.
    pub fn own_window(&self, id: ParameterId, raw: i64) -> Option<f64> {
        let parameter = self.parameter(id)?;
        let (_, most) = parameter.encoding.raw_range();
        // The greatest value switches the window off (CiA 402-2, 6067h), and with zero hardly a motor would
        // arrive.
        if raw <= 0 || raw == most {
            return None;
        }
        let position = self.profile.signal(Signal::Position)?.parameter;
        let counts = match (self.to_si(id, raw), self.unit_value(position)) {
            (Some(si), Some(unit)) if parameter.unit != Unit::None => (si / unit).abs(),
            _ => parameter.encoding.number(raw),
        };
        debug_assert!(counts.is_finite());
        Some(counts.max(OWN_WINDOW_COUNTS_MIN))
    }

    /// All signals in a raw value of a parameter.
    pub fn observation(
        &self,
        id: ParameterId,
        raw: i64,
        flag: Option<(ParameterId, ParameterTest)>,
    ) -> Observation {
        let rules = &self.profile.motion;
        let mut seen = Observation::default();
        for source in self.signal_sources(id) {
            let masked = raw & source.mask;
            let is_true = source.is_set(raw);
            match source.signal {
                Signal::Position => seen.position = Some(masked),
                Signal::Velocity => {
                    seen.speed = self.parameter(id).map(|p| p.encoding.number(masked));
                }
                Signal::Fault => seen.fault = Some(self.stopping_fault(masked)),
                Signal::Enabled => seen.enabled = Some(is_true),
                Signal::PositiveLimit => seen.positive_limit = Some(is_true),
                Signal::NegativeLimit => seen.negative_limit = Some(is_true),
                Signal::Mode => seen.mode = Some(masked),
                Signal::Reached if flag.is_none() => seen.flag = Some(is_true),
                Signal::Moving if flag.is_none() => seen.moving = Some(is_true),
                _ => {}
            }
        }
        if let Some((_, test)) = flag.filter(|(parameter, _)| *parameter == id) {
            seen.flag = Some(test.passes(raw));
        }
        (seen.halted, seen.stalled) =
            (passes_rule(rules.halted, id, raw), passes_rule(rules.stalled, id, raw));
        seen
    }

    /// The fault in a masked value, if it is one that stops the drive; zero for none.
    pub fn stopping_fault(&self, masked: i64) -> u32 {
        let code = self.profile.fault_word(masked);
        let mut known = self.profile.faults_for_code(code).peekable();
        // A code without a name is a fault as well; warnings and notes are none.
        let stops = known.peek().is_none() || known.any(|fault| fault.severity == Severity::Fault);
        if code != 0 && stops { code } else { 0 }
    }
}

fn passes_rule(
    rule: Option<(ParameterId, ParameterTest)>,
    id: ParameterId,
    raw: i64,
) -> Option<bool> {
    rule.filter(|(parameter, _)| *parameter == id).map(|(_, test)| test.passes(raw))
}

fn value_in_counts(value: f64, si: Option<f64>) -> Option<f64> {
    si.map(|si| value / si.abs())
}
