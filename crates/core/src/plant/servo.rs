//! Cascaded control: position P, speed PI, current limit, stall detection.

use super::{
    Inputs, Limits, Motor, MotorParameters, Setpoint, TICK_S, Trajectory, Winding, clamp_abs,
};

/// Rounding error of a speed that is computed from the positions of a tick, rad/s.
const ROUNDING: f64 = 1e-6;

/// Gains of the loops, SI.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Gains {
    /// Position gain: speed for a position error, 1/s.
    pub position_p: f64,
    /// Velocity gain: current for a speed error, A·s/rad.
    pub velocity_p: f64,
    /// Growth of that current while the error lasts, A/rad.
    pub velocity_i: f64,
    /// Current fed forward for an acceleration, A·s²/rad.
    pub acceleration: f64,
    /// Position error that is left alone at rest, rad: what friction would make it hunt for.
    pub deadband: f64,
}

impl Gains {
    /// Gains that close the speed loop of that motor at 120 rad/s, critically damped, and the
    /// position loop at a fifth of it.
    #[must_use]
    pub fn tuned(motor: &MotorParameters) -> Self {
        // The inner loop is five times as fast as the outer one, so that they do not excite each other.
        let (bandwidth, per_accel) = (120.0, motor.inertia / motor.torque_constant);
        Self {
            position_p: bandwidth / 5.0,
            velocity_p: 2.0 * bandwidth * per_accel,
            velocity_i: bandwidth * bandwidth * per_accel,
            acceleration: per_accel,
            deadband: 1e-3,
        }
    }
}

/// Command of an enabled drive.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Goal {
    /// Turn at this speed, rad/s, along the ramp.
    Velocity(f64),
    /// Go to this shaft position, rad, along the ramp, and hold it.
    Position(f64),
    /// This current, A, at any speed.
    Current(f64),
    /// Put this voltage on the winding, V.
    Voltage(f64),
    /// This position and speed at the end of the tick: a set-point made outside.
    Follow(Setpoint),
}

/// Load and supply of the motor during a tick.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Conditions {
    /// Bus voltage, V.
    pub bus: f64,
    /// Torque from outside, N·m; positive drives the shaft forward.
    pub load: f64,
}

/// Limits from the drive's settings and the present move. Infinite where there is no limit.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct ServoBounds {
    /// Speed at most, rad/s, for a motor that was not faster before.
    pub velocity: f64,
    /// Gain of speed at most, rad/s².
    pub acceleration: f64,
    /// Motor current at most, A.
    pub current: f64,
}

/// Least and greatest current, A.
#[derive(Clone, Copy)]
struct CurrentRange {
    least: f64,
    greatest: f64,
}

impl CurrentRange {
    #[inline]
    fn clamp(self, current: f64) -> f64 {
        // Not `f64::clamp`, which panics where a limit is below zero.
        current.max(self.least).min(self.greatest)
    }
}

impl ServoBounds {
    /// Nothing holds it.
    pub const NONE: Self =
        Self { velocity: f64::INFINITY, acceleration: f64::INFINITY, current: f64::INFINITY };
}

impl Default for ServoBounds {
    fn default() -> Self {
        Self::NONE
    }
}

/// A servo drive's control loops with their set-point. Off, it lets the motor coast. The set-point
/// of its own lies last in memory, because not every tick needs it.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct Servo {
    /// Gains of the loops.
    pub gains: Gains,
    /// Current at most, A.
    pub max_current: f64,
    /// Currents at most backward and forward, A, where these are less.
    pub current_limits: (f64, f64),
    /// Current added to that of the speed loop, A: for a load that the host knows.
    pub current_offset: f64,
    /// Share of the bus voltage that may be used, 0 to 1.
    pub pwm: f64,
    integral: f64,
    goal: Goal,
    enabled: bool,
    trajectory: Trajectory,
}

impl Servo {
    /// Loops tuned for that motor, off, with 1,000 rad/s² and as much current as it bears.
    #[must_use]
    pub fn new(motor: &MotorParameters) -> Self {
        Self {
            gains: Gains::tuned(motor),
            max_current: motor.max_current,
            current_limits: (f64::INFINITY, f64::INFINITY),
            current_offset: 0.0,
            pwm: 1.0,
            trajectory: Trajectory::new(Limits::trapezoid(1e4, 1e3), 0.0),
            goal: Goal::Position(0.0),
            enabled: false,
            integral: 0.0,
        }
    }

    /// Switches on, holding the position that the motor has. Never jumps.
    pub fn enable(&mut self, motor: &Motor) {
        self.enabled = true;
        self.hold(motor);
    }

    /// Switches off: the motor coasts.
    pub fn disable(&mut self) {
        self.enabled = false;
        self.integral = 0.0;
        self.current_offset = 0.0;
    }

    /// Returns whether the drive is enabled.
    #[must_use]
    pub const fn is_enabled(&self) -> bool {
        self.enabled
    }

    /// Makes the motor's present position the goal; a moving motor is braked along the ramp.
    pub fn hold(&mut self, motor: &Motor) {
        self.integral = 0.0;
        self.trajectory.restart_at(motor.position(), motor.velocity());
        self.goal = Goal::Position(motor.position());
        if motor.velocity() != 0.0 {
            // A turning motor brakes along its ramp; to hold a position it would have to jump back.
            self.goal = Goal::Velocity(0.0);
            self.trajectory.stop();
        }
    }

    /// Heads for a goal from where the set-point is, as fast as it is.
    pub fn set_goal(&mut self, goal: Goal) {
        if let Goal::Follow(last) = self.goal {
            // The ramp begins at the last set-point that was followed: a step would be felt as a jerk.
            self.trajectory.restart_at(last.position, last.velocity);
        }
        self.head_for(goal);
    }

    /// Heads for a goal from where the motor is: for a change from torque or voltage to speed or
    /// position, and after the motor fell behind its set-point.
    pub fn set_goal_from(&mut self, motor: &Motor, goal: Goal) {
        self.trajectory.restart_at(motor.position(), motor.velocity());
        self.head_for(goal);
    }

    /// Sets the set-point for the end of the next tick.
    pub const fn follow(&mut self, setpoint: Setpoint) {
        self.goal = Goal::Follow(setpoint);
    }

    /// The present command.
    #[must_use]
    pub const fn goal(&self) -> Goal {
        self.goal
    }

    /// Current that the speed loop has summed up, A.
    #[must_use]
    pub const fn integral(&self) -> f64 {
        self.integral
    }

    /// The present limits of the current.
    #[inline]
    fn current_range(&self) -> CurrentRange {
        let (max, (backward, forward)) = (self.max_current.abs(), self.current_limits);
        CurrentRange { least: -max.min(backward), greatest: max.min(forward) }
    }

    /// The limit for a current of that sign, A without sign.
    #[inline]
    #[must_use]
    pub fn current_limit_for(&self, current: f64) -> f64 {
        let range = self.current_range();
        if current < 0.0 { -range.least } else { range.greatest }
    }

    /// Sets the limits of the set-point.
    pub fn set_limits(&mut self, limits: Limits) {
        self.trajectory.set_limits(limits);
    }

    /// The limits of the set-point.
    #[must_use]
    pub const fn limits(&self) -> &Limits {
        self.trajectory.limits()
    }

    /// The set-point.
    #[must_use]
    #[inline]
    pub const fn setpoint(&self) -> Setpoint {
        match self.goal {
            Goal::Follow(setpoint) => setpoint,
            _ => self.trajectory.setpoint(),
        }
    }

    /// The set-point while the drive is enabled and regulates a speed or a position.
    #[must_use]
    pub const fn regulated_setpoint(&self) -> Option<Setpoint> {
        match self.goal {
            Goal::Velocity(_) | Goal::Position(_) | Goal::Follow(_) if self.enabled => {
                Some(self.setpoint())
            }
            _ => None,
        }
    }

    /// The present limits.
    #[must_use]
    pub fn bounds(&self) -> ServoBounds {
        if !self.enabled {
            return ServoBounds::NONE;
        }
        let (ramp, current) = (self.trajectory.limits(), self.max_current);
        let velocity = match self.goal {
            Goal::Velocity(requested) => ramp.velocity.min(requested.abs()),
            Goal::Position(_) => ramp.velocity,
            _ => return ServoBounds { current, ..ServoBounds::NONE },
        };
        // The S-curve still holds earlier set-points, which kept the limits of their time.
        let smoothed = self.trajectory.smoothed_velocity();
        let velocity = if smoothed > velocity + ROUNDING { smoothed } else { velocity };
        ServoBounds { velocity, acceleration: ramp.acceleration, current }
    }

    /// True when the set-point has come to its goal; the motor may still lag.
    #[must_use]
    pub fn arrived(&self) -> bool {
        self.trajectory.arrived()
    }

    fn head_for(&mut self, goal: Goal) {
        match goal {
            Goal::Velocity(v) => self.trajectory.set_velocity_goal(v),
            Goal::Position(p) => self.trajectory.set_position_goal(p),
            Goal::Current(_) | Goal::Voltage(_) | Goal::Follow(_) => {}
        }
        self.goal = goal;
    }

    /// Advances loops and motor by one tick, with the motor's true position as feedback.
    #[inline]
    pub fn step(&mut self, motor: &mut Motor, conditions: Conditions) {
        let (position, velocity) = (motor.position(), motor.velocity());
        self.step_measured(motor, conditions, position, velocity);
    }

    /// [`step`](Self::step) with the `position` (rad) and `velocity` (rad/s) of a sensor.
    #[inline]
    pub fn step_measured(
        &mut self,
        motor: &mut Motor,
        conditions: Conditions,
        position: f64,
        velocity: f64,
    ) {
        let bus = conditions.bus * self.pwm.clamp(0.0, 1.0);
        // Measured before the step: this is the voltage of the tick before.
        let short_of_voltage = motor.voltage().abs() > 0.999 * bus;
        let winding = match self.goal {
            _ if !self.enabled => Winding::Open,
            Goal::Follow(wanted) => {
                let error = self.position_control(&wanted, position) - velocity;
                Winding::Current(self.velocity_control(
                    error,
                    wanted.acceleration,
                    short_of_voltage,
                ))
            }
            Goal::Current(i) => Winding::Current(self.current_range().clamp(i)),
            Goal::Voltage(v) => Winding::Voltage(v),
            Goal::Velocity(_) | Goal::Position(_) => {
                let (speed, acceleration) = self.advance_setpoint(position);
                let error = speed - velocity;
                Winding::Current(self.velocity_control(error, acceleration, short_of_voltage))
            }
        };
        motor.step(Inputs { winding, bus, load: conditions.load });
    }

    /// One tick of the set-point's own way: speed to turn at (rad/s), and its acceleration.
    fn advance_setpoint(&mut self, position: f64) -> (f64, f64) {
        let wanted = self.trajectory.step();
        let mut speed = wanted.velocity;
        if matches!(self.goal, Goal::Position(_)) {
            // A set-point that is still braking to a lower limit is followed, or the motor would
            // fall behind it, to leap once the limit is raised.
            let top = self.trajectory.limits().velocity.max(speed.abs());
            speed = clamp_abs(self.position_control(&wanted, position), top);
        }
        (speed, wanted.acceleration)
    }

    /// Position P: the speed to turn at, rad/s.
    #[inline]
    fn position_control(&self, wanted: &Setpoint, position: f64) -> f64 {
        let error = wanted.position - position;
        // Without a dead band the integral and stiction hunt each other around the target.
        let rest = wanted.velocity == 0.0 && error.abs() <= self.gains.deadband;
        let correction = if rest { 0.0 } else { self.gains.position_p * error };
        wanted.velocity + correction
    }

    /// Speed PI. Takes the error of speed and the acceleration wanted, returns the current to
    /// drive, A.
    #[inline]
    fn velocity_control(&mut self, error: f64, acceleration: f64, short_of_voltage: bool) -> f64 {
        let gains = &self.gains;
        let direct = gains.velocity_p * error + gains.acceleration * acceleration;
        let range = self.current_range();
        let requested = direct + self.integral + self.current_offset;
        let possible = range.clamp(requested);
        // Anti-windup: what cannot be had is not summed up.
        let spent = requested != possible || short_of_voltage;
        if !(spent && requested * error > 0.0) {
            let grown = self.integral + gains.velocity_i * error * TICK_S;
            self.integral = range.clamp(grown);
        }
        possible
    }
}

/// Detects a stall: current at its limit and the shaft at rest for too long.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct StallDetector {
    /// Slower than this is at rest, rad/s.
    pub velocity: f64,
    /// Share of the limit that counts as at the limit.
    pub share: f64,
    /// Duration, ticks.
    pub ticks: u32,
    stalled_ticks: u32,
}

impl StallDetector {
    /// A watch that trips after `ticks` ticks at 95 % of the current limit below 1 rad/s.
    #[must_use]
    pub const fn after(ticks: u32) -> Self {
        Self { velocity: 1.0, share: 0.95, ticks, stalled_ticks: 0 }
    }

    /// Takes a tick's speed (rad/s), current and its limit (A). True when it has been too long.
    #[inline]
    pub fn step(&mut self, velocity: f64, current: f64, limit: f64) -> bool {
        let stalled =
            // With a limit of zero every motor would be at its limit.
            limit > 0.0 && velocity.abs() < self.velocity && current.abs() >= self.share * limit;
        self.stalled_ticks = if stalled { self.stalled_ticks.saturating_add(1) } else { 0 };
        self.stalled_ticks >= self.ticks
    }

    /// Resets the detector.
    pub const fn reset(&mut self) {
        self.stalled_ticks = 0;
    }
}
