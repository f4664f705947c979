//! The motor with its load, and the zero points of its positions.

use super::options::Options;
use super::water::Water;
use polepair_core::plant::{
    Conditions, Goal, Limits, Motor, MotorParameters, Servo, TICK_S, ThermalModel,
};

/// A thruster's motor: 48 V, 3,200 rpm with its propeller in water. \[I\]
const THRUSTER: MotorParameters = MotorParameters {
    inertia: 4e-4,
    viscous: 1e-5,
    coulomb: 0.005,
    stiction: 0.008,
    torque_constant: 0.12,
    resistance: 0.5,
    inductance: 0.5e-3,
    max_current: 30.0,
};

/// A servo's motor seen from behind its gear: 48 V, 220 rpm, 16 N·m. \[I\]
const GEARED: MotorParameters = MotorParameters {
    inertia: 0.02,
    viscous: 0.02,
    coulomb: 0.3,
    stiction: 0.4,
    torque_constant: 2.0,
    resistance: 2.0,
    inductance: 2e-3,
    max_current: 8.0,
};

/// Heat of the power stage per A², Ω.
const STAGE_OHM: f64 = 0.02;
/// Tenths of a degree in a radian.
const TENTHS: f64 = 1800.0 / core::f64::consts::PI;

/// A motor on its drive.
#[derive(Clone, Debug)]
pub(super) struct Shaft {
    pub motor: Motor,
    pub servo: Servo,
    pub water: Water,
    pub winding: ThermalModel,
    pub stage: ThermalModel,
    /// Torque from outside, N·m.
    pub load: f64,
    /// Supply, V.
    pub supply: f64,
    /// Signal of TC, -1 to 1, while it sets the output.
    pub signal: Option<f64>,
    /// Share of the output that may be given.
    pub output_limit: f64,
    /// The highest speed that it is regulated to, rad/s.
    speed_limit: f64,
    /// Position at which the encoder broke, rad.
    pub encoder_broken_at: Option<f64>,
}

impl Shaft {
    /// At rest, off.
    pub fn new(options: &Options) -> Self {
        let mut motor = Motor::new(if options.encoder { GEARED } else { THRUSTER });
        motor.set_ends(options.ends.map(|(low, high)| (radians(low), radians(high))));
        let mut servo = Servo::new(motor.parameters());
        let (speed_limit, ramp) = if options.encoder { (23.0, 100.0) } else { (400.0, 400.0) };
        servo.set_limits(Limits::trapezoid(speed_limit, ramp));
        Self {
            servo,
            motor,
            water: if options.encoder { Water::NONE } else { Water::PROPELLER },
            winding: ThermalModel::new(0.6, 200.0, 16.0),
            stage: ThermalModel::new(1.5, 60.0, 16.0),
            load: 0.0,
            supply: 48.0,
            signal: None,
            output_limit: 1.0,
            speed_limit,
            encoder_broken_at: None,
        }
    }

    /// No output: the shaft turns freely.
    pub fn disable_output(&mut self) {
        self.signal = None;
        self.servo.disable();
    }

    /// A share of the supply, open loop.
    pub fn drive_signal(&mut self, share: f64) {
        self.enable();
        // First enabled, then driven: enabling sets the goal to the present position.
        self.signal = Some(share);
    }

    /// A speed, rad/s.
    pub fn set_velocity(&mut self, velocity: f64) {
        self.limit_speed(self.speed_limit);
        self.regulate(Goal::Velocity(velocity));
    }

    /// A shaft position, rad, at most so fast, rad/s.
    pub fn move_to(&mut self, position: f64, velocity: f64) {
        debug_assert!(velocity >= 0.0);
        self.limit_speed(velocity.min(self.speed_limit));
        self.regulate(Goal::Position(position));
    }

    /// Position of the encoder, rad.
    pub fn position(&self) -> f64 {
        self.encoder_broken_at.unwrap_or(self.motor.position())
    }

    /// Position in tenths of a degree from `zero`.
    pub fn position_tenths(&self, zero: f64) -> i64 {
        libm::round((self.position() - zero) * TENTHS) as i64
    }

    /// Speed as known to the drive, rad/s.
    pub fn velocity(&self) -> f64 {
        self.motor.velocity()
    }

    /// Advances by one tick.
    pub fn tick(&mut self) {
        if let Some(share) = self.signal {
            self.servo.set_goal(Goal::Voltage(share * self.supply));
        }
        // Each tick, because overheating lowers the limit while the motor runs.
        self.servo.pwm = self.output_limit;
        let load = self.load + self.water.drag_torque(self.motor.velocity());
        let conditions = Conditions { bus: self.supply, load };
        let (position, velocity) = (self.position(), self.velocity());
        self.servo.step_measured(&mut self.motor, conditions, position, velocity);
        let current = self.motor.current();
        self.stage.step(STAGE_OHM * current * current, TICK_S);
        self.winding.step(self.motor.copper_w(), TICK_S);
    }

    /// Returns whether nothing moves without an action from outside.
    pub fn is_at_rest(&self) -> bool {
        !self.servo.is_enabled()
            && self.motor.velocity() == 0.0
            && self.load.abs() <= self.motor.parameters().stiction
    }

    /// Time passes over a shaft that [is still](Self::is_at_rest).
    pub fn pass_time(&mut self, seconds: f64) {
        self.stage.step(0.0, seconds);
        self.winding.step(0.0, seconds);
    }

    fn limit_speed(&mut self, velocity: f64) {
        let limits = Limits { velocity, ..*self.servo.limits() };
        self.servo.set_limits(limits);
    }

    fn enable(&mut self) {
        if !self.servo.is_enabled() {
            self.servo.enable(&self.motor);
        }
    }

    fn regulate(&mut self, goal: Goal) {
        // Out of an open-loop signal the regulator starts from the motor's real speed, else it jerks.
        let open = self.signal.take().is_some() || !self.servo.is_enabled();
        self.enable();
        if open { self.servo.set_goal_from(&self.motor, goal) } else { self.servo.set_goal(goal) }
    }
}

/// Tenths of a degree as rad.
pub(super) fn radians(tenths: i64) -> f64 {
    tenths as f64 / TENTHS
}

/// rpm as rad/s.
pub(super) fn rad_per_s(rpm: f64) -> f64 {
    rpm * core::f64::consts::TAU / 60.0
}

/// rad/s as whole rpm.
pub(super) fn rpm(velocity: f64) -> i16 {
    libm::round(velocity * 60.0 / core::f64::consts::TAU) as i16
}
