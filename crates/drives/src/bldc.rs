//! A brushless motor as Trinamic's modules regulate it: speed, position or current, with a ramp and arrival.

use crate::surroundings::ServoBounds;
use polepair_core::plant::{
    Conditions, Encoder, Gains, Goal, Limits, Motor, MotorParameters, Servo, StallDetector, TICK_S,
    ThermalModel,
};

/// Ticks at the current limit without turning after which the motor is switched off. \[I\]
// A second at the limit: a motor that starts against a load may need several tenths of it.
const STALL_TICKS: u32 = 1000;
/// Speeds beyond this are refused, rpm (TMCM-171 hardware manual: up to 100,000 rpm electrical).
pub const RPM_MAX: i32 = 100_000;

/// Regulated quantity.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ControlMode {
    /// A speed.
    Velocity,
    /// A position.
    Position,
    /// A current.
    Torque,
}

/// The settings of a motor, from the parameters of its module.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct ChannelSettings {
    /// Limit of the speed while positioning, rpm.
    pub max_rpm: i32,
    /// Slope of the ramp, rpm/s; `None` without a ramp.
    pub ramp: Option<i32>,
    /// Limit of the current, A.
    pub max_current: f64,
    /// Greatest distance from the target at which the motor has arrived, counts.
    pub reached_distance: u32,
    /// Greatest speed at which it has arrived, rpm.
    pub reached_rpm: f64,
}

/// A motor with its loops.
#[derive(Clone, Debug)]
pub struct BldcChannel {
    /// The motor.
    pub motor: Motor,
    /// The loops.
    pub servo: Servo,
    /// The position as the module counts it.
    pub encoder: Encoder,
    /// Regulated quantity.
    pub mode: ControlMode,
    /// Target of the last move, counts.
    pub target: i32,
    /// Speed last asked for, rpm.
    pub target_rpm: i32,
    /// The last move has arrived.
    pub arrived: bool,
    /// Temperature of the winding.
    pub winding: ThermalModel,
    /// Torque on the shaft, N·m.
    pub load: f64,
    /// Shaft position at which the encoder broke, rad.
    pub encoder_broke_at: f64,
    stall: StallDetector,
}

impl BldcChannel {
    /// A motor at rest with an encoder.
    #[must_use]
    pub fn new(counts_per_turn: u32) -> Self {
        let motor = Motor::new(MotorParameters::BLDC_24V);
        Self {
            servo: Servo::new(motor.parameters()),
            motor,
            encoder: Encoder::new(counts_per_turn),
            mode: ControlMode::Velocity,
            target: 0,
            target_rpm: 0,
            arrived: false,
            winding: ThermalModel::new(1.5, 60.0, 25.0),
            load: 0.0,
            encoder_broke_at: 0.0,
            stall: StallDetector::after(STALL_TICKS),
        }
    }

    /// The module starts: its counter is in RAM, so any place is zero. The motor goes on as it was, unpowered.
    pub fn power_up(&mut self) {
        self.servo.disable();
        self.mode = ControlMode::Velocity;
        self.arrived = false;
        self.encoder.preset(self.motor.position(), 0);
        (self.target, self.target_rpm) = (0, 0);
    }

    /// Encoder counter as the module shows it.
    #[must_use]
    pub fn counter(&self) -> i32 {
        self.encoder.count(self.motor.position()) as i32
    }

    /// Makes the counter read `count` without moving the motor.
    pub fn set_counter(&mut self, count: i32) {
        // Target and counter move together, so that the motor does not start.
        let shift = count.wrapping_sub(self.counter());
        self.encoder.preset(self.motor.position(), count.into());
        self.target = self.target.wrapping_add(shift);
        self.arrived = false;
    }

    /// Sets the counts of a turn and their direction. The present count stays.
    pub fn set_counts(&mut self, counts_per_turn: u32, inverted: bool) {
        // Only where it changes: a new configuration makes the present position its zero.
        let turned = inverted != (self.encoder.counts_per_rad() < 0.0);
        if counts_per_turn != self.encoder.counts_per_turn() || turned {
            self.encoder.reconfigure(self.motor.position(), counts_per_turn, inverted);
        }
    }

    /// Powers the motor, which holds at rest.
    pub fn power_on(&mut self, settings: &ChannelSettings) {
        if self.servo.is_enabled() {
            return;
        }
        self.mode = ControlMode::Velocity;
        self.target_rpm = 0;
        self.set_limits(settings);
        self.stall.reset();
        self.servo.enable(&self.motor);
        // Powered at rest first: the command that powers the motor sets its goal afterwards.
        self.servo.set_goal(Goal::Velocity(0.0));
        self.target = self.counter();
    }

    /// Regulates a speed, rpm.
    pub fn rotate(&mut self, rpm: i32, settings: &ChannelSettings) {
        self.target_rpm = rpm;
        self.begin_mode(ControlMode::Velocity, Goal::Velocity(rad_per_s(rpm)), settings);
    }

    /// Regulates a position, counts.
    pub fn move_to(&mut self, target: i32, settings: &ChannelSettings) {
        self.target = target;
        self.begin_mode(ControlMode::Position, self.goal_of(target), settings);
    }

    /// Regulates a current, A.
    pub fn apply_current(&mut self, current: f64, settings: &ChannelSettings) {
        self.begin_mode(ControlMode::Torque, Goal::Current(current), settings);
    }

    /// To rest along the ramp, regulated.
    pub fn halt(&mut self, settings: &ChannelSettings) {
        self.target_rpm = 0;
        self.arrived = false;
        if self.servo.is_enabled() {
            // Regulated, because a motor without current would coast, and a load would fall.
            self.begin_mode(ControlMode::Velocity, Goal::Velocity(0.0), settings);
        }
    }

    fn begin_mode(&mut self, mode: ControlMode, goal: Goal, settings: &ChannelSettings) {
        // Regulated speed keeps no position, and a regulated torque neither: what comes then starts
        // from the motor.
        let from_motor = match mode {
            ControlMode::Torque => false,
            ControlMode::Velocity => self.mode == ControlMode::Torque,
            ControlMode::Position => self.mode != ControlMode::Position,
        };
        self.mode = mode;
        self.arrived = false;
        self.set_limits(settings);
        if from_motor {
            self.servo.set_goal_from(&self.motor, goal);
        } else {
            self.servo.set_goal(goal);
        }
    }

    /// Takes changed settings into the loops. `shares` scale the tuned gains: position, velocity, its integral.
    pub fn apply_settings(&mut self, settings: &ChannelSettings, shares: [f64; 3]) {
        self.servo.max_current = settings.max_current;
        let tuned = Gains::tuned(self.motor.parameters());
        let [position, velocity, integral] = shares;
        self.servo.gains = Gains {
            position_p: tuned.position_p * position,
            // Cut, because a gain far above the tuned one makes a sampled loop oscillate.
            velocity_p: (tuned.velocity_p * velocity).min(4.0 * tuned.velocity_p),
            velocity_i: (tuned.velocity_i * integral).min(4.0 * tuned.velocity_i),
            deadband: 0.5 / self.encoder.counts_per_rad().abs(),
            ..tuned
        };
        self.set_limits(settings);
    }

    fn set_limits(&mut self, settings: &ChannelSettings) {
        // The limit of the speed is one of positioning alone.
        let top = match self.mode {
            ControlMode::Position => settings.max_rpm,
            _ => RPM_MAX,
        };
        let ramp = settings.ramp.unwrap_or_default();
        self.servo.set_limits(Limits::trapezoid(rad_per_s(top), rad_per_s(ramp)));
    }

    /// Limits of the motor by the settings, read from them and not from the loops.
    #[must_use]
    pub fn bounds(&self, settings: &ChannelSettings) -> ServoBounds {
        if !self.servo.is_enabled() {
            return ServoBounds::NONE;
        }
        let velocity = match self.mode {
            ControlMode::Velocity => rad_per_s(self.target_rpm).abs(),
            ControlMode::Position => rad_per_s(settings.max_rpm),
            ControlMode::Torque => f64::INFINITY,
        };
        let ramp = settings.ramp.filter(|_| self.mode != ControlMode::Torque);
        let acceleration = ramp.map_or(f64::INFINITY, rad_per_s);
        ServoBounds { velocity, acceleration, current: settings.max_current }
    }

    /// One tick of the motor; returns whether it stalled.
    pub fn tick(&mut self, bus: f64) -> bool {
        let (mut position, mut velocity) = (self.motor.position(), self.motor.velocity());
        // The loops see what the encoder reports, and the motor runs away from it, as a real one does.
        if self.encoder.is_broken() {
            (position, velocity) = (self.encoder_broke_at, 0.0);
        }
        let conditions = Conditions { bus, load: self.load };
        self.servo.step_measured(&mut self.motor, conditions, position, velocity);
        self.winding.step(self.motor.copper_w(), TICK_S);
        let regulated = self.servo.is_enabled() && self.mode != ControlMode::Torque;
        // A motor that drives a torque against a stop does what it was asked for.
        let limit = if regulated { self.servo.max_current } else { 0.0 };
        let stalled = self.stall.step(velocity, self.motor.current(), limit);
        if stalled {
            self.stall.reset();
        }
        stalled
    }

    /// The ramp starts again from the motor where it is further ahead than that, counts.
    pub fn wait_for_motor(&mut self, distance: f64) {
        if self.mode == ControlMode::Torque || !self.servo.is_enabled() {
            return;
        }
        let ahead = (self.servo.setpoint().position - self.motor.position()).abs();
        if ahead * self.encoder.counts_per_rad().abs() > distance {
            // The target stays; only the ramp towards it starts again.
            let goal = self.servo.goal();
            self.servo.set_goal_from(&self.motor, goal);
        }
    }

    /// Arrived: near enough and slow enough.
    pub fn check_arrival(&mut self, settings: &ChannelSettings) {
        if self.mode != ControlMode::Position || !self.servo.is_enabled() {
            return;
        }
        let left = self.target.wrapping_sub(self.counter()).unsigned_abs();
        let ramp = rpm(self.servo.setpoint().velocity).abs();
        let speed = rpm(self.motor.velocity()).abs();
        if left <= settings.reached_distance && ramp + speed <= settings.reached_rpm {
            self.arrived = true;
        }
    }

    /// Distance of the ramp to the motor, counts.
    #[must_use]
    pub fn lag(&self) -> i32 {
        let lag = self.servo.setpoint().position - self.motor.position();
        libm::round(lag * self.encoder.counts_per_rad()) as i32
    }

    /// Speed as the module measures it, rpm.
    #[must_use]
    pub fn actual_rpm(&self) -> i32 {
        if self.encoder.is_broken() { 0 } else { libm::round(rpm(self.motor.velocity())) as i32 }
    }

    /// Returns whether nothing but temperatures changes without an action.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        !self.servo.is_enabled()
            && self.motor.velocity() == 0.0
            && self.load.abs() <= self.motor.parameters().stiction
    }

    /// Sets whether the encoder is broken.
    pub fn break_encoder(&mut self, broken: bool) {
        self.encoder_broke_at = self.motor.position();
        self.encoder.set_broken(self.motor.position(), broken);
    }

    /// Goal of the servo for an encoder count.
    fn goal_of(&self, count: i32) -> Goal {
        let now = self.encoder.count(self.motor.position());
        let way = i64::from(count.wrapping_sub(now as i32));
        // The middle of the count: at its edge the reading would flicker between two counts.
        let half = 0.5 / self.encoder.counts_per_rad();
        Goal::Position(self.encoder.position_of(now.wrapping_add(way)) + half)
    }
}

/// rad/s as rpm.
#[must_use]
pub fn rpm(velocity: f64) -> f64 {
    velocity * 60.0 / core::f64::consts::TAU
}

/// rpm as rad/s.
#[must_use]
pub fn rad_per_s(rpm: i32) -> f64 {
    f64::from(rpm) * core::f64::consts::TAU / 60.0
}
