//! The motor with its control loops and protections.

use core::f64::consts::TAU;

use super::faults::FaultCode;
use polepair_core::plant::{
    Conditions, Goal, Limits, Motor, MotorParameters, Servo, ServoBounds, Setpoint, StallDetector,
    TICK_S, ThermalModel,
};
use polepair_core::proto::canopen::device::motion;

/// Rated current, A; three times that is its peak.
pub const RATED_CURRENT: f64 = 12.7;
/// Supply from the factory, V.
const SUPPLY_V: f64 = 48.0;
/// Supply below and above which it trips, V.
const SUPPLY_LIMITS: (f64, f64) = (20.0, 60.0);
/// Ticks of a stall before it trips.
const STALL_TICKS: u32 = 1000;
/// 1/A², of the rated current.
const PER_RATED_SQUARE: f64 = 1.0 / (RATED_CURRENT * RATED_CURRENT);
/// Overload that trips: three times rated current for two seconds.
const OVERLOAD: f64 = 16.0;
/// Temperature of the power stage that trips, °C.
const HOT_C: f64 = 85.0;
/// Ticks between two computations of temperatures, which change slowly.
const THERMAL_TICKS: u32 = 16;

/// Motor, loops and protections. They lie in memory in this order: what each tick needs together,
/// the servo's set-points last but for what few ticks need.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct Shaft {
    stage: ThermalModel,
    frozen_position: Option<f64>,
    /// The hall or U, V, W signals are impossible.
    pub hall_broken: bool,
    ticks: u32,
    stall: StallDetector,
    previous_position: f64,
    overload: f64,
    /// Torque from outside, N·m.
    pub load: f64,
    /// Supply, V.
    pub supply: f64,
    motor: Motor,
    servo: Servo,
    /// Heat in the winding when temperatures were reckoned last, J.
    copper_heat: f64,
    winding: ThermalModel,
}

impl Default for Shaft {
    fn default() -> Self {
        let motor = Motor::new(MotorParameters::SERVO_48V);
        let mut servo = Servo::new(motor.parameters());
        servo.gains.position_p = 40.0;
        servo.gains.deadband = 2e-4;
        Self {
            motor,
            servo,
            load: 0.0,
            supply: SUPPLY_V,
            previous_position: 0.0,
            overload: 0.0,
            stall: StallDetector::after(STALL_TICKS),
            ticks: 0,
            frozen_position: None,
            hall_broken: false,
            copper_heat: 0.0,
            stage: ThermalModel::new(0.5, 150.0, 25.0),
            winding: ThermalModel::new(1.0, 300.0, 25.0),
        }
    }
}

impl Shaft {
    /// The motor as it truly is.
    #[must_use]
    pub const fn motor(&self) -> &Motor {
        &self.motor
    }

    /// Torque, share of the rated one.
    #[must_use]
    pub fn torque(&self) -> f64 {
        self.motor.current() / RATED_CURRENT
    }

    /// Rated torque, N·m.
    #[must_use]
    pub const fn rated_torque(&self) -> f64 {
        self.motor.parameters().torque_constant * RATED_CURRENT
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
        self.frozen_position = broken.then(|| self.motor.position());
    }

    /// Returns whether the power stage is on.
    #[must_use]
    pub const fn is_powered(&self) -> bool {
        self.servo.is_enabled()
    }

    /// Limits of the control loops.
    #[must_use]
    pub fn bounds(&self) -> ServoBounds {
        self.servo.bounds()
    }

    /// The set-point while it is in use.
    #[must_use]
    pub const fn active_setpoint(&self) -> Option<Setpoint> {
        self.servo.regulated_setpoint()
    }

    /// The supply suffices to drive the motor.
    #[must_use]
    pub fn has_voltage(&self) -> bool {
        self.supply >= SUPPLY_LIMITS.0
    }

    /// True when nothing changes by itself except temperatures.
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
        self.previous_position = motion::ShaftReadings::position(self);
    }

    /// One tick.
    #[inline]
    pub fn tick(&mut self) {
        self.previous_position = motion::ShaftReadings::position(self);
        let conditions = Conditions { bus: self.supply, load: self.load };
        self.servo.step(&mut self.motor, conditions);
        let current = self.motor.current();
        let grown = self.overload + (current * current * PER_RATED_SQUARE - 1.0) * TICK_S;
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
        self.stage.step(3.0 + 0.02 * current * current, seconds);
        (self.copper_heat, self.ticks) = (heat, 0);
    }

    /// Checks the protections after a tick. `blocked_is_fine` while homing drives against a stop.
    #[inline]
    pub fn check_protections(
        &mut self,
        blocked_is_fine: impl FnOnce() -> bool,
    ) -> Option<FaultCode> {
        let (velocity, current) = (self.motor.velocity(), self.motor.current());
        let stalled = self.stall.step(velocity, current, self.servo.max_current);
        if stalled && self.is_powered() && !blocked_is_fine() {
            return Some(FaultCode::BLOCKED);
        }
        if self.overload > OVERLOAD {
            return Some(FaultCode::OVERLOAD);
        }
        if self.is_fault_free() { None } else { self.lasting_fault() }
    }

    /// Returns whether [`lasting_fault`](Self::lasting_fault) would return `None`; checks all signs at once, for every
    /// tick.
    #[inline]
    fn is_fault_free(&self) -> bool {
        (self.supply >= SUPPLY_LIMITS.0)
            & (self.supply <= SUPPLY_LIMITS.1)
            & (self.temperature() <= HOT_C)
            & self.frozen_position.is_none()
            & !self.hall_broken
    }

    /// A fault whose cause lasts until it is repaired.
    #[cold]
    #[must_use]
    pub fn lasting_fault(&self) -> Option<FaultCode> {
        let on = self.is_powered();
        let signs = [
            (self.supply > SUPPLY_LIMITS.1, FaultCode::OVERVOLTAGE),
            (self.temperature() > HOT_C, FaultCode::HOT),
            (on && self.supply < SUPPLY_LIMITS.0, FaultCode::UNDERVOLTAGE),
            (self.frozen_position.is_some(), FaultCode::ENCODER),
            (self.hall_broken, FaultCode::COMMUTATION),
        ];
        signs.into_iter().find(|(there, _)| *there).map(|(_, fault)| fault)
    }

    /// Resets the integrators of the protections.
    pub fn reset_protections(&mut self) {
        self.overload = 0.0;
        self.stall.reset();
    }
}

impl motion::ShaftReadings for Shaft {
    #[inline]
    fn setpoint(&self) -> Setpoint {
        self.servo.setpoint()
    }

    fn has_arrived(&self) -> bool {
        self.servo.arrived()
    }

    #[inline]
    fn position(&self) -> f64 {
        self.frozen_position.unwrap_or(self.motor.position())
    }

    fn previous_position(&self) -> f64 {
        self.previous_position
    }

    #[inline]
    fn velocity(&self) -> f64 {
        if self.frozen_position.is_some() { 0.0 } else { self.motor.velocity() }
    }

    #[inline]
    fn is_torque_limited(&self) -> bool {
        self.is_powered() && self.motor.current().abs() >= 0.95 * self.servo.max_current
    }
}

impl motion::MotorControl for Shaft {
    fn power_on(&mut self) {
        self.stall.reset();
        self.servo.enable(&self.motor);
    }

    fn power_off(&mut self) {
        self.servo.disable();
    }

    fn set_limits(&mut self, limits: Limits) {
        self.servo.set_limits(limits);
    }

    fn set_velocity(&mut self, rad_per_s: f64) {
        let goal = Goal::Velocity(rad_per_s);
        match self.servo.goal() {
            Goal::Current(_) => self.servo.set_goal_from(&self.motor, goal),
            _ => self.servo.set_goal(goal),
        }
    }

    fn move_to(&mut self, position: f64) {
        let goal = Goal::Position(position);
        match self.servo.goal() {
            Goal::Position(_) => self.servo.set_goal(goal),
            _ => self.servo.set_goal_from(&self.motor, goal),
        }
    }

    fn apply_torque(&mut self, share: f64) {
        self.servo.set_goal(Goal::Current(share * RATED_CURRENT));
    }

    #[inline]
    fn follow_setpoint(&mut self, setpoint: Setpoint) {
        self.servo.follow(setpoint);
    }

    fn hold_position(&mut self) {
        self.servo.hold(&self.motor);
    }

    fn settle_position(&mut self) {
        if self.servo.goal() == Goal::Velocity(0.0) && self.servo.arrived() {
            self.servo.set_goal_from(&self.motor, Goal::Position(self.motor.position()));
        }
    }
}

/// rpm of a speed in rad/s.
#[must_use]
pub fn rpm(rad_per_s: f64) -> f64 {
    rad_per_s * 60.0 / TAU
}
