//! A servo motor on its drive, as families of servo drives share it: control loops, encoder, temperatures, and the
//! integrators that protections look at. A family decides which of them are faults.

use core::f64::consts::TAU;

use super::{
    Conditions, Goal, Limits, Motor, MotorParameters, Servo, ServoBounds, Setpoint, StallDetector,
    TICK_S, ThermalModel,
};

/// Supply from the factory, V.
const SUPPLY_V: f64 = 48.0;
/// Temperature of the air from the factory, °C.
const AMBIENT_C: f64 = 25.0;
/// Losses of the power stage: constant, W, and with the square of the current, Ω.
const STAGE_LOSSES: (f64, f64) = (3.0, 0.02);
/// Ticks between two computations of temperatures, which change slowly.
const THERMAL_TICKS: u32 = 16;
/// Share of the current limit from which on the motor gives all the torque it may.
const LIMIT_SHARE: f64 = 0.95;

/// Motor, loops and integrators. They lie in memory in this order: what each tick needs together, the servo's
/// set-points last but for what few ticks need.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct ServoShaft {
    stage: ThermalModel,
    frozen_position: Option<f64>,
    /// The hall or U, V, W signals are impossible.
    pub hall_broken: bool,
    /// Homing ends without a ramp instead of along it.
    pub holds_at_once: bool,
    ticks: u32,
    stall: StallDetector,
    previous_position: f64,
    overload: f64,
    /// Torque from outside, N·m.
    pub load: f64,
    /// Supply, V.
    pub supply: f64,
    rated_current: f64,
    /// 1/A², of the rated current: a product is cheaper at each tick than a quotient.
    per_rated_square: f64,
    motor: Motor,
    servo: Servo,
    /// Heat in the winding when temperatures were computed last, J.
    copper_heat: f64,
    winding: ThermalModel,
}

impl ServoShaft {
    /// A shaft at rest, without power. `rated_current` in A; `stall_ticks` of a stall are reported.
    #[must_use]
    pub fn new(rated_current: f64, stall_ticks: u32) -> Self {
        debug_assert!(rated_current > 0.0);
        let motor = Motor::new(MotorParameters::SERVO_48V);
        let mut servo = Servo::new(motor.parameters());
        // Stiffer than the plant's default, and a deadband below a count, so that the motor rests within three
        // counts.
        servo.gains.position_p = 40.0;
        servo.gains.deadband = 2e-4;
        Self {
            motor,
            servo,
            load: 0.0,
            supply: SUPPLY_V,
            rated_current,
            per_rated_square: 1.0 / (rated_current * rated_current),
            previous_position: 0.0,
            overload: 0.0,
            stall: StallDetector::after(stall_ticks),
            ticks: 0,
            frozen_position: None,
            hall_broken: false,
            holds_at_once: false,
            copper_heat: 0.0,
            stage: ThermalModel::new(0.5, 150.0, AMBIENT_C),
            winding: ThermalModel::new(1.0, 300.0, AMBIENT_C),
        }
    }

    /// The motor as it truly is.
    #[must_use]
    pub const fn motor(&self) -> &Motor {
        &self.motor
    }

    /// Position as the encoder sees it, rad since power-on.
    #[inline]
    #[must_use]
    pub fn position(&self) -> f64 {
        self.frozen_position.unwrap_or(self.motor.position())
    }

    /// Position one tick before.
    #[must_use]
    pub const fn previous_position(&self) -> f64 {
        self.previous_position
    }

    /// Speed as the encoder sees it, rad/s. A broken encoder reports standstill while the motor turns: the fault that a
    /// stop must not believe.
    #[inline]
    #[must_use]
    pub fn velocity(&self) -> f64 {
        if self.frozen_position.is_some() { 0.0 } else { self.motor.velocity() }
    }

    /// Torque, share of the rated one.
    #[must_use]
    pub fn torque(&self) -> f64 {
        self.motor.current() / self.rated_current
    }

    /// Rated torque, N·m.
    #[must_use]
    pub const fn rated_torque(&self) -> f64 {
        self.motor.parameters().torque_constant * self.rated_current
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

    /// Overload so far, rated current squared times s.
    #[inline]
    #[must_use]
    pub const fn overload(&self) -> f64 {
        self.overload
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
        self.frozen_position = broken.then(|| self.motor.position());
    }

    /// Returns whether the encoder has stopped counting.
    #[inline]
    #[must_use]
    pub const fn has_broken_encoder(&self) -> bool {
        self.frozen_position.is_some()
    }

    /// Limits the current, A. No setting makes the motor stronger than it is.
    pub fn limit_current(&mut self, ampere: f64) {
        self.servo.max_current = ampere.min(self.motor.parameters().max_current);
    }

    /// Limits the torque backward and forward, in shares of the rated one.
    pub fn limit_torque(&mut self, backward: f64, forward: f64) {
        debug_assert!(backward >= 0.0 && forward >= 0.0);
        self.servo.current_limits = (backward * self.rated_current, forward * self.rated_current);
    }

    /// Adds a share of the rated torque to that of the control loops, until power is off or another one is set.
    #[inline]
    pub fn offset_torque(&mut self, share: f64) {
        self.servo.current_offset = share * self.rated_current;
    }

    /// Position of the encoder's index pulse in the last tick, if there was one: at whole turns.
    #[must_use]
    pub fn index_pulse(&self) -> Option<f64> {
        let (was, is) = (whole_turns(self.previous_position()), whole_turns(self.position()));
        (was != is).then(|| was.max(is) * TAU)
    }

    /// Returns whether the motor gives all the torque it may.
    #[inline]
    #[must_use]
    pub fn is_torque_limited(&self) -> bool {
        let current = self.motor.current();
        self.is_powered() && current.abs() >= LIMIT_SHARE * self.servo.current_limit_for(current)
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

    /// Limits of the control loops.
    #[must_use]
    pub fn bounds(&self) -> ServoBounds {
        self.servo.bounds()
    }

    /// The set-point.
    #[inline]
    #[must_use]
    pub const fn setpoint(&self) -> Setpoint {
        self.servo.setpoint()
    }

    /// The set-point while it is in use.
    #[must_use]
    pub const fn active_setpoint(&self) -> Option<Setpoint> {
        self.servo.regulated_setpoint()
    }

    /// Present goal of the loops.
    #[must_use]
    pub const fn goal(&self) -> Goal {
        self.servo.goal()
    }

    /// Returns whether the set-point has come to its goal.
    #[must_use]
    pub fn has_arrived(&self) -> bool {
        self.servo.arrived()
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
        self.servo.set_goal(Goal::Current(share * self.rated_current));
    }

    /// Sets the set-point for the end of the next tick.
    #[inline]
    pub fn follow_setpoint(&mut self, setpoint: Setpoint) {
        self.servo.follow(setpoint);
    }

    /// Comes to rest along the ramp, and holds that position.
    pub fn hold(&mut self) {
        self.servo.hold(&self.motor);
    }

    /// Comes to rest without a ramp, and holds that position.
    pub fn halt(&mut self) {
        let ramp = *self.servo.limits();
        // No ramp is the steepest one.
        self.servo.set_limits(Limits { acceleration: 0.0, deceleration: 0.0, ..ramp });
        self.servo.hold(&self.motor);
    }

    /// The end of a homing: comes to rest as this shaft does then, and holds that position.
    pub fn hold_position(&mut self) {
        if self.holds_at_once { self.halt() } else { self.hold() }
    }

    /// Once at rest after turning or braking: holds that position. Speed zero lets a load turn the shaft slowly.
    pub fn settle_position(&mut self) {
        if self.servo.goal() == Goal::Velocity(0.0) && self.servo.arrived() {
            self.servo.set_goal_from(&self.motor, Goal::Position(self.motor.position()));
        }
    }

    /// Returns whether nothing changes by itself except temperatures.
    #[inline]
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
    #[inline]
    pub fn tick(&mut self) {
        self.previous_position = self.position();
        let conditions = Conditions { bus: self.supply, load: self.load };
        self.servo.step(&mut self.motor, conditions);
        // I²t: what is above the rated current heats, what is below cools.
        let current = self.motor.current();
        let grown = self.overload + (current * current * self.per_rated_square - 1.0) * TICK_S;
        self.overload = if grown > 0.0 { grown } else { 0.0 };
        self.ticks += 1;
        if self.ticks == THERMAL_TICKS {
            self.update_temperatures();
        }
    }

    #[cold]
    fn update_temperatures(&mut self) {
        let (heat, seconds) = (self.motor.energy().copper, f64::from(self.ticks) * TICK_S);
        let current = self.motor.current();
        self.winding.step((heat - self.copper_heat) / seconds, seconds);
        self.stage.step(STAGE_LOSSES.0 + STAGE_LOSSES.1 * current * current, seconds);
        (self.copper_heat, self.ticks) = (heat, 0);
    }

    /// Takes a tick into account for the stall, and returns whether the motor has stalled for the ticks of this shaft.
    #[inline]
    pub fn check_stall(&mut self) -> bool {
        let (velocity, current) = (self.motor.velocity(), self.motor.current());
        self.stall.step(velocity, current, self.servo.current_limit_for(current))
    }

    /// Resets the integrators of the protections.
    pub fn reset_protections(&mut self) {
        self.overload = 0.0;
        self.stall.reset();
    }
}

fn whole_turns(position: f64) -> f64 {
    libm::floor(position / TAU)
}
