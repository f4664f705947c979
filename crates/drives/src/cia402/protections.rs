//! Protections: which conditions of the shaft are faults, and for how long.

use polepair_core::plant::ServoShaft;

use super::faults::FaultCode;

/// Rated current, A; three times that is its peak.
pub const RATED_CURRENT: f64 = 12.7;
/// Ticks of a stall before it trips.
pub const STALL_TICKS: u32 = 1000;
/// Supply below and above which it trips, V.
const SUPPLY_LIMITS: (f64, f64) = (20.0, 60.0);
/// Overload that trips: three times rated current for two seconds.
const OVERLOAD: f64 = 16.0;
/// Temperature of the power stage that trips, °C.
const HOT_C: f64 = 85.0;

/// Returns whether the supply suffices to drive the motor.
#[must_use]
pub fn has_voltage(shaft: &ServoShaft) -> bool {
    shaft.supply >= SUPPLY_LIMITS.0
}

/// Checks the protections after a tick. `blocked_is_fine` while homing drives against a stop.
#[inline]
pub fn check(shaft: &mut ServoShaft, blocked_is_fine: impl FnOnce() -> bool) -> Option<FaultCode> {
    if shaft.check_stall() && shaft.is_powered() && !blocked_is_fine() {
        return Some(FaultCode::BLOCKED);
    }
    if shaft.overload() > OVERLOAD {
        return Some(FaultCode::OVERLOAD);
    }
    if is_fault_free(shaft) { None } else { lasting_fault(shaft) }
}

/// Returns whether [`lasting_fault`] would return `None`; checks all signs at once, for every tick.
#[inline]
fn is_fault_free(shaft: &ServoShaft) -> bool {
    (shaft.supply >= SUPPLY_LIMITS.0)
        & (shaft.supply <= SUPPLY_LIMITS.1)
        & (shaft.temperature() <= HOT_C)
        & !shaft.has_broken_encoder()
        & !shaft.hall_broken
}

/// A fault whose cause lasts until it is repaired.
#[cold]
#[must_use]
pub fn lasting_fault(shaft: &ServoShaft) -> Option<FaultCode> {
    let signs = [
        (shaft.supply > SUPPLY_LIMITS.1, FaultCode::OVERVOLTAGE),
        (shaft.temperature() > HOT_C, FaultCode::HOT),
        (shaft.is_powered() && shaft.supply < SUPPLY_LIMITS.0, FaultCode::UNDERVOLTAGE),
        (shaft.has_broken_encoder(), FaultCode::ENCODER),
        (shaft.hall_broken, FaultCode::COMMUTATION),
    ];
    signs.into_iter().find(|(there, _)| *there).map(|(_, fault)| fault)
}
