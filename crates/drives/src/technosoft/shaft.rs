//! The motor with its encoder and loops, and the conversion of counts to its shaft.

use super::options::Options;
use super::units::{CountScale, PEAK_A};
use polepair_core::plant::{
    Conditions, Encoder, Goal, Motor, MotorParameters, Servo, TICK_S, ThermalModel,
};

/// Heat of the power stage per A², Ω.
const STAGE_OHM: f64 = 0.02;
/// Proportional gain KPP with which the model's loop is as tuned.
const KPP_TUNED: f64 = 288.0;
/// Position error that is left alone at rest, counts: less than from the middle of one to its edge.
const DEADBAND: f64 = 0.35;
/// Breaks away as softly as it turns: one that sticks leaps over a count or two, back and forth,
/// where a drive that counts finely is to rest on the very count.
const MOTOR: MotorParameters =
    MotorParameters { stiction: MotorParameters::SERVO_48V.coulomb, ..MotorParameters::SERVO_48V };

/// A motor on its drive.
#[derive(Clone, Debug)]
pub(super) struct Shaft {
    pub motor: Motor,
    pub servo: Servo,
    pub encoder: Encoder,
    pub scale: CountScale,
    pub winding: ThermalModel,
    pub stage: ThermalModel,
    /// Torque from outside, N·m.
    pub load: f64,
    /// DC supply, V.
    pub supply: f64,
    /// Count of targets at shaft position 0.
    zero_count: i64,
    tuned_gain: f64,
    encoder_broke_at: f64,
}

impl Shaft {
    /// At rest at count 0, off.
    pub fn new(options: &Options) -> Self {
        let motor = Motor::new(MOTOR);
        let encoder = Encoder::new(options.counts);
        let mut servo = Servo::new(motor.parameters());
        servo.max_current = PEAK_A;
        servo.gains.deadband = servo.gains.deadband.min(DEADBAND / encoder.counts_per_rad());
        let slow_s = options.slow_ns as f64 * 1e-9;
        Self {
            scale: CountScale { per_rad: encoder.counts_per_rad(), slow_s },
            tuned_gain: servo.gains.position_p,
            servo,
            motor,
            encoder,
            winding: ThermalModel::new(1.0, 120.0, 25.0),
            stage: ThermalModel::new(2.0, 40.0, 25.0),
            load: 0.0,
            supply: 48.0,
            zero_count: 0,
            encoder_broke_at: 0.0,
        }
    }

    /// Encoder count (APOS).
    pub fn count(&self) -> i32 {
        self.encoder.count(self.motor.position()) as i32
    }

    /// Set-point (TPOS), counts.
    pub fn target(&self) -> i32 {
        self.count_of(self.whole_counts(self.servo.setpoint().position))
    }

    /// Target minus actual, counts, not cut to whole ones.
    pub fn position_error(&self) -> f64 {
        self.loop_errors().0 * self.scale.per_rad
    }

    /// Target minus actual of the loop that is closed: position, rad, and speed, rad/s. Zero where
    /// there is no such loop.
    pub fn loop_errors(&self) -> (f64, f64) {
        let actual =
            if self.encoder.is_broken() { self.encoder_broke_at } else { self.motor.position() };
        let setpoint = self.servo.setpoint();
        match self.servo.goal() {
            Goal::Position(_) | Goal::Follow(_) => (setpoint.position - actual, 0.0),
            Goal::Velocity(_) => (0.0, setpoint.velocity - self.velocity()),
            Goal::Current(_) | Goal::Voltage(_) => (0.0, 0.0),
        }
    }

    /// Rotation since the encoder broke, rad.
    pub fn turn_since_break(&self) -> f64 {
        self.motor.position() - self.encoder_broke_at
    }

    /// The shaft position, rad, in the middle of a count: the one nearest to the set-point, since
    /// counts wrap.
    pub fn position_of_count(&self, count: i32) -> f64 {
        let way = i64::from(count.wrapping_sub(self.target()));
        let whole = self.whole_counts(self.servo.setpoint().position);
        ((whole + way) as f64 + 0.5) / self.scale.per_rad
    }

    /// Speed that the drive measures, rad/s.
    pub fn velocity(&self) -> f64 {
        if self.encoder.is_broken() { 0.0 } else { self.motor.velocity() }
    }

    /// SAP: the actual position becomes `count`; the target moves with it.
    pub fn set_count(&mut self, count: i32) {
        let by = count.wrapping_sub(self.count());
        self.encoder.preset(self.motor.position(), count.into());
        self.zero_count = self.zero_count.wrapping_add(by.into());
    }

    /// After power-up both start at zero where the shaft is.
    pub fn restart(&mut self) {
        self.servo.disable();
        self.servo.hold(&self.motor);
        self.set_count(0);
        self.zero_count = self.zero_count.wrapping_sub(self.target().into());
    }

    /// Breaks the encoder, or mends it.
    pub fn set_encoder_broken(&mut self, broken: bool) {
        self.encoder_broke_at = self.motor.position();
        self.encoder.set_broken(self.motor.position(), broken);
    }

    /// Sets the position loop's gain from KPP with its shift. \[I\] Limited to half to three times the
    /// model's tuned value: beyond it the model's shaft would creep or oscillate.
    pub fn set_gain(&mut self, kpp: f64) {
        self.servo.gains.position_p = self.tuned_gain * (kpp / KPP_TUNED).clamp(0.5, 3.0);
    }

    /// Advances by one tick.
    pub fn tick(&mut self) {
        let conditions = Conditions { bus: self.supply, load: self.load };
        let (mut position, mut velocity) = (self.motor.position(), self.motor.velocity());
        if self.encoder.is_broken() {
            (position, velocity) = (self.encoder_broke_at, 0.0);
        }
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

    /// Whole counts of the shaft at a position, rad, as the encoder would have counted from the
    /// start.
    pub fn whole_counts(&self, position: f64) -> i64 {
        libm::floor(position * self.scale.per_rad + 1e-6) as i64
    }

    /// The present count for [`whole`](Self::whole) counts.
    pub const fn count_of(&self, whole: i64) -> i32 {
        whole.wrapping_add(self.zero_count) as i32
    }
}
