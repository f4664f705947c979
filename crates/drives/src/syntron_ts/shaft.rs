//! The motor with its control loops and protections.

use core::f64::consts::TAU;

use super::alarm::Alarm;
use polepair_core::plant::{
    Conditions, Goal, Limits, Motor, MotorParameters, Servo, ServoBounds, Setpoint, StallDetector,
    TICK_S, ThermalModel,
};
use polepair_core::units::nearest;

/// Encoder counts of a turn `[I]`: 2500 lines, four edges.
pub const COUNTS_PER_TURN: f64 = 10_000.0;
/// Rated current of the simulated drive, A; three times that is its peak.
pub const RATED_CURRENT: f64 = 12.7;
/// Supply of the simulated drive, V.
const SUPPLY_V: f64 = 48.0;
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

/// Motor, loops and protections.
#[derive(Clone, Debug)]
pub struct Shaft {
    motor: Motor,
    servo: Servo,
    stage: ThermalModel,
    winding: ThermalModel,
    stall: StallDetector,
    /// Torque from outside, N·m.
    pub load: f64,
    /// Supply, V.
    pub supply: f64,
    /// The hall or U, V, W signals are impossible.
    pub hall_broken: bool,
    frozen_position: Option<f64>,
    previous_position: f64,
    overload: f64,
    braking: f64,
}

impl Default for Shaft {
    fn default() -> Self {
        let motor = Motor::new(MotorParameters::SERVO_48V);
        let mut servo = Servo::new(motor.parameters());
        // Stiffer than the plant's default, and a deadband below a count, so that the motor rests within three
        // counts.
        servo.gains.position_p = 40.0;
        servo.gains.deadband = 2e-4;
        Self {
            motor,
            servo,
            stage: ThermalModel::new(0.5, 150.0, 25.0),
            winding: ThermalModel::new(1.0, 300.0, 25.0),
            stall: StallDetector::after(STALL_TICKS),
            load: 0.0,
            supply: SUPPLY_V,
            hall_broken: false,
            frozen_position: None,
            previous_position: 0.0,
            overload: 0.0,
            braking: 0.0,
        }
    }
}

impl Shaft {
    /// The motor as it truly is.
    #[must_use]
    pub const fn motor(&self) -> &Motor {
        &self.motor
    }

    /// Position as the encoder sees it, rad since it was made.
    #[must_use]
    pub fn position(&self) -> f64 {
        self.frozen_position.unwrap_or(self.motor.position())
    }

    /// Position one tick before.
    #[must_use]
    pub const fn previous_position(&self) -> f64 {
        self.previous_position
    }

    /// Encoder counts at `origin` 0.
    #[must_use]
    pub fn counts(&self, origin: f64) -> i32 {
        nearest((self.position() - origin) / TAU * COUNTS_PER_TURN) as i32
    }

    /// Speed, rpm.
    #[must_use]
    pub fn rpm(&self) -> f64 {
        // A dead encoder reports standstill while the motor turns: the fault that a stop must not believe.
        if self.frozen_position.is_some() { 0.0 } else { self.motor.velocity() * 60.0 / TAU }
    }

    /// Share of the rated current, 1 for all of it.
    #[must_use]
    pub fn load_share(&self) -> f64 {
        self.motor.current() / RATED_CURRENT
    }

    /// Temperature of the power stage, °C.
    #[must_use]
    pub const fn temperature(&self) -> f64 {
        self.stage.temperature()
    }

    /// Temperature of the winding, °C.
    #[must_use]
    pub const fn winding(&self) -> f64 {
        self.winding.temperature()
    }

    /// Changes the temperature of the air, °C.
    pub fn set_ambient(&mut self, celsius: f64) {
        self.stage.ambient = celsius;
        self.winding.ambient = celsius;
    }

    /// Makes motor and power stage so warm at once, °C.
    pub fn set_temperature(&mut self, celsius: f64) {
        self.stage.set_temperature(celsius);
        self.winding.set_temperature(celsius);
    }

    /// Holds the shaft, or lets it go.
    pub fn jam(&mut self, jammed: bool) {
        self.motor.set_jammed(jammed);
    }

    /// The encoder stops counting, or counts again.
    pub fn break_encoder(&mut self, broken: bool) {
        self.frozen_position = broken.then(|| self.position());
    }

    /// Current at most, A.
    pub fn limit_current(&mut self, ampere: f64) {
        // No setting makes the motor stronger than it is.
        self.servo.max_current = ampere.min(self.motor.parameters().max_current);
    }

    /// True while the motor gives all the torque it may.
    #[must_use]
    pub fn is_torque_limited(&self) -> bool {
        self.is_powered() && self.motor.current().abs() >= 0.95 * self.servo.max_current
    }

    /// Switches the power stage on, holding where the shaft is.
    pub fn power_on(&mut self) {
        self.stall.reset();
        self.servo.enable(&self.motor);
    }

    /// Switches it off: the motor coasts.
    pub fn power_off(&mut self) {
        self.servo.disable();
    }

    /// Returns whether the power stage is on.
    #[must_use]
    pub const fn is_powered(&self) -> bool {
        self.servo.is_enabled()
    }

    /// Sets the limits of the set-point.
    pub fn set_limits(&mut self, limits: Limits) {
        self.servo.set_limits(limits);
    }

    /// Top speed of the set-point, rad/s.
    #[must_use]
    pub const fn top_speed(&self) -> f64 {
        self.servo.limits().velocity
    }

    /// Limits of the control loops: a path's speed and ramp, the current limit.
    #[must_use]
    pub fn bounds(&self) -> ServoBounds {
        self.servo.bounds()
    }

    /// The set-point while it is in use.
    #[must_use]
    pub const fn active_setpoint(&self) -> Option<Setpoint> {
        self.servo.regulated_setpoint()
    }

    /// Heads for a speed, rad/s. After driving a torque the set-point starts from the motor.
    pub fn set_velocity(&mut self, rad_per_s: f64) {
        let goal = Goal::Velocity(rad_per_s);
        match self.servo.goal() {
            Goal::Current(_) => self.servo.set_goal_from(&self.motor, goal),
            _ => self.servo.set_goal(goal),
        }
    }

    /// Heads for a position, rad. After turning at a speed the set-point starts from the motor.
    pub fn move_to(&mut self, position: f64) {
        let goal = Goal::Position(position);
        match self.servo.goal() {
            Goal::Position(_) => self.servo.set_goal(goal),
            _ => self.servo.set_goal_from(&self.motor, goal),
        }
    }

    /// Drives a share of the rated torque.
    pub fn apply_torque(&mut self, share: f64) {
        self.servo.set_goal(Goal::Current(share * RATED_CURRENT));
    }

    /// Comes to rest along the ramp.
    pub fn brake(&mut self) {
        self.set_velocity(0.0);
    }

    /// Comes to rest without a ramp.
    pub fn halt(&mut self) {
        let ramp = *self.servo.limits();
        // No ramp is the steepest one.
        self.servo.set_limits(Limits { acceleration: 0.0, deceleration: 0.0, ..ramp });
        self.servo.hold(&self.motor);
    }

    /// Once at rest after turning or braking: holds that position rather than speed zero.
    pub fn settle_position(&mut self) {
        if self.servo.goal() == Goal::Velocity(0.0) && self.servo.arrived() {
            // Speed zero lets a load turn the shaft slowly; a position holds it.
            self.servo.set_goal_from(&self.motor, Goal::Position(self.motor.position()));
        }
    }

    /// The set-point.
    #[must_use]
    pub const fn setpoint(&self) -> Setpoint {
        self.servo.setpoint()
    }

    /// True when the set-point has come to its goal.
    #[must_use]
    pub fn has_arrived(&self) -> bool {
        self.servo.arrived()
    }

    /// True when it has, and the motor is there too `[I]`.
    #[must_use]
    pub fn is_in_position(&self) -> bool {
        self.has_arrived() && (self.setpoint().position - self.position()).abs() < IN_POSITION
    }

    /// True when nothing changes by itself except temperatures.
    #[must_use]
    pub fn is_resting(&self) -> bool {
        !self.is_powered() && self.motor.velocity() == 0.0 && self.load == 0.0
    }

    /// Passes `ticks` ticks of rest at once.
    pub fn pass_rest(&mut self, ticks: u64) {
        let seconds = ticks as f64 * TICK_S;
        self.stage.step(0.0, seconds);
        self.winding.step(0.0, seconds);
        self.overload = (self.overload - seconds).max(0.0);
        self.previous_position = self.position();
    }

    /// One tick.
    pub fn tick(&mut self) {
        self.previous_position = self.position();
        let given = self.motor.energy().electrical;
        let conditions = Conditions { bus: self.supply, load: self.load };
        self.servo.step(&mut self.motor, conditions);
        let current = self.motor.current();
        let braking = (given - self.motor.energy().electrical).max(0.0) / TICK_S;
        self.braking += (braking - self.braking) * TICK_S / 10.0;
        self.winding.step(self.motor.copper_w(), TICK_S);
        self.stage.step(3.0 + 0.02 * current * current, TICK_S);
        let share = self.load_share();
        // I²t: what is above the rated current heats, what is below cools.
        self.overload = (self.overload + (share * share - 1.0) * TICK_S).max(0.0);
    }

    /// Checks the protections after a tick. `blocked_is_fine` while homing drives against a stop.
    pub fn check_protections(&mut self, blocked_is_fine: bool) -> Option<Alarm> {
        if self.supply > SUPPLY_LIMITS.1 {
            return Some(Alarm::OU);
        }
        if self.temperature() > HOT_C {
            return Some(Alarm::OT);
        }
        // The others are about current and motion, which a motor without power has none of.
        if !self.is_powered() {
            return None;
        }
        let limit = self.servo.max_current;
        let (velocity, current) = (self.motor.velocity(), self.motor.current());
        let stalled = self.stall.step(velocity, current, limit);
        let lag = (self.setpoint().position - self.motor.position()).abs();
        let follows = matches!(self.servo.goal(), Goal::Position(_));
        // In the order in which they are reported where several are true: sensors first, because the others
        // follow from them.
        let signs = [
            (self.frozen_position.is_some(), Alarm::EC),
            (self.hall_broken, Alarm::EH),
            (self.supply < SUPPLY_LIMITS.0, Alarm::LU),
            (current.abs() > 1.2 * self.motor.parameters().max_current, Alarm::OC),
            (self.braking > BRAKING.1, Alarm::OH),
            (-self.motor.voltage() * current > BRAKING.0, Alarm::LH),
            (follows && lag > FOLLOWING_ERROR && !blocked_is_fine, Alarm::PE),
            (stalled && !blocked_is_fine, Alarm::ST),
            (self.overload > OVERLOAD, Alarm::OL),
        ];
        signs.into_iter().find(|(there, _)| *there).map(|(_, alarm)| alarm)
    }

    /// True when the power bus can feed the motor.
    #[must_use]
    pub fn is_bus_ready(&self) -> bool {
        self.supply >= SUPPLY_LIMITS.0
    }

    /// Resets the integrators of the protections, as a power-off does.
    pub fn reset_protections(&mut self) {
        self.overload = 0.0;
        self.braking = 0.0;
        self.stall.reset();
    }
}
