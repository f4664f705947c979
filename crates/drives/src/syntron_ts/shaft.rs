//! The motor of the drive in its own units, and its protections.

use core::f64::consts::TAU;

use polepair_core::plant::{Goal, ServoShaft, TICK_S};
use polepair_core::units::nearest;

use super::alarm::Alarm;

/// Encoder counts of a turn `[I]`: 2500 lines, four edges.
pub const COUNTS_PER_TURN: f64 = 10_000.0;
/// Rated current of the simulated drive, A; three times that is its peak.
pub const RATED_CURRENT: f64 = 12.7;
/// Supply below and above which it trips, V `[I]`.
const SUPPLY_LIMITS: (f64, f64) = (20.0, 60.0);
/// Following error that trips, rad `[I]`.
const FOLLOWING_ERROR: f64 = TAU;
/// Nearer than this the motor is in position, rad `[I]`: three counts.
const IN_POSITION: f64 = 3.0 * TAU / COUNTS_PER_TURN;
/// Ticks of a stall before it trips `[I]`.
const STALL_TICKS: u32 = 1000;
/// Overload that trips: three times rated current for two seconds `[I]`.
const OVERLOAD: f64 = 16.0;
/// Braking power that trips at once, and on a mean over ten seconds, W `[I]`.
const BRAKING: (f64, f64) = (2000.0, 200.0);
/// Temperature of the power stage that trips, °C `[I]`.
const HOT_C: f64 = 85.0;

/// The motor at rest, without power. Homing ends without a ramp: the drive has none for it.
pub fn new_shaft() -> ServoShaft {
    let mut shaft = ServoShaft::new(RATED_CURRENT, STALL_TICKS);
    shaft.holds_at_once = true;
    shaft
}

/// Encoder counts at `origin` 0.
pub fn counts(shaft: &ServoShaft, origin: f64) -> i32 {
    nearest((shaft.position() - origin) / TAU * COUNTS_PER_TURN) as i32
}

/// Speed, rpm.
pub fn rpm(shaft: &ServoShaft) -> f64 {
    shaft.velocity() * 60.0 / TAU
}

/// Returns whether the set-point has come to its goal, and the motor is there too `[I]`.
pub fn is_in_position(shaft: &ServoShaft) -> bool {
    shaft.has_arrived() && (shaft.setpoint().position - shaft.position()).abs() < IN_POSITION
}

/// Returns whether the power bus can feed the motor.
pub fn is_bus_ready(shaft: &ServoShaft) -> bool {
    shaft.supply >= SUPPLY_LIMITS.0
}

/// Integrator of the braking power, W.
#[derive(Clone, Debug, Default)]
pub struct Protections {
    braking: f64,
}

impl Protections {
    /// Advances the shaft by one tick.
    pub fn tick(&mut self, shaft: &mut ServoShaft) {
        let given = shaft.motor().energy().electrical;
        shaft.tick();
        let braking = (given - shaft.motor().energy().electrical).max(0.0) / TICK_S;
        self.braking += (braking - self.braking) * TICK_S / 10.0;
    }

    /// Checks the protections after a tick. `blocked_is_fine` while homing drives against a stop.
    pub fn check(&self, shaft: &mut ServoShaft, blocked_is_fine: bool) -> Option<Alarm> {
        if shaft.supply > SUPPLY_LIMITS.1 {
            return Some(Alarm::OU);
        }
        if shaft.temperature() > HOT_C {
            return Some(Alarm::OT);
        }
        // The others are about current and motion, which a motor without power has none of.
        if !shaft.is_powered() {
            return None;
        }
        let stalled = shaft.check_stall();
        let motor = shaft.motor();
        let lag = (shaft.setpoint().position - motor.position()).abs();
        let follows = matches!(shaft.goal(), Goal::Position(_));
        // In the order in which they are reported where several are true: sensors first, because the others
        // follow from them.
        let signs = [
            (shaft.has_broken_encoder(), Alarm::EC),
            (shaft.hall_broken, Alarm::EH),
            (shaft.supply < SUPPLY_LIMITS.0, Alarm::LU),
            (motor.current().abs() > 1.2 * motor.parameters().max_current, Alarm::OC),
            (self.braking > BRAKING.1, Alarm::OH),
            (-motor.voltage() * motor.current() > BRAKING.0, Alarm::LH),
            (follows && lag > FOLLOWING_ERROR && !blocked_is_fine, Alarm::PE),
            (stalled && !blocked_is_fine, Alarm::ST),
            (shaft.overload() > OVERLOAD, Alarm::OL),
        ];
        signs.into_iter().find(|(there, _)| *there).map(|(_, alarm)| alarm)
    }

    /// Resets the integrators, as a power-off does.
    pub fn reset(&mut self, shaft: &mut ServoShaft) {
        self.braking = 0.0;
        shaft.reset_protections();
    }
}
