//! Axis parameters and motion: their effects and values.

use super::flags;
use super::module::{ControlMode, Module, rad_per_s, rpm};
use crate::surroundings::ServoBounds;
use polepair_core::plant::{Gains, Goal, Limits};
use polepair_core::proto::tmcl::Status;
use polepair_core::proto::tmcl::module::memory::{check_readable, check_writable};

/// Speeds beyond this are refused, rpm (hardware manual: up to 100,000 rpm electrical).
const RPM_MAX: i32 = 100_000;

impl Module {
    /// Powers the motor, holding it where it is.
    ///
    /// # Errors
    /// [`Status::NotAvailable`] while it is switched off by parameter 255 or a fault lasts. \[I\]
    pub(super) fn power_on(&mut self) -> Result<(), Status> {
        let faulty = self.flags.any(flags::PERSISTENT) || self.surroundings.hall_broken;
        if self.axis(255) == 0 || faulty {
            return Err(Status::NotAvailable);
        }
        if !self.servo.is_enabled() {
            self.mode = ControlMode::Velocity;
            self.target_rpm = 0;
            self.set_limits();
            self.reset_stall();
            self.servo.enable(&self.motor);
            // Powered at rest first: the command that powers the motor sets its goal afterwards.
            self.servo.set_goal(Goal::Velocity(0.0));
            self.target = self.counter();
        }
        Ok(())
    }

    /// ROR with its speed, or parameter 2.
    pub(super) fn rotate(&mut self, rpm: i32) -> Result<(), Status> {
        if !(-RPM_MAX..=RPM_MAX).contains(&rpm) {
            return Err(Status::InvalidValue);
        }
        self.power_on()?;
        self.target_rpm = rpm;
        self.begin_mode(ControlMode::Velocity, Goal::Velocity(rad_per_s(rpm)));
        Ok(())
    }

    /// MVP ABS, or parameter 0.
    pub(super) fn move_to(&mut self, target: i32) -> Result<(), Status> {
        self.power_on()?;
        self.target = target;
        self.begin_mode(ControlMode::Position, self.goal_of(target));
        Ok(())
    }

    /// Parameter 155.
    pub(super) fn apply_current(&mut self, milliamperes: i32) -> Result<(), Status> {
        self.power_on()?;
        self.begin_mode(ControlMode::Torque, Goal::Current(f64::from(milliamperes) / 1000.0));
        Ok(())
    }

    /// MST, the stop switch and lost heartbeats: to rest along the ramp, regulated.
    pub(super) fn halt(&mut self) {
        self.stopped = true;
        self.target_rpm = 0;
        self.flags.set(flags::POS_END, false);
        if self.servo.is_enabled() {
            // Regulated, because a motor without current would coast, and a load would fall.
            self.begin_mode(ControlMode::Velocity, Goal::Velocity(0.0));
            self.stopped = true;
        }
    }

    fn begin_mode(&mut self, mode: ControlMode, goal: Goal) {
        // Regulated speed keeps no position, and a regulated torque neither: what comes then starts
        // from the motor.
        let from_motor = match mode {
            ControlMode::Torque => false,
            ControlMode::Velocity => self.mode == ControlMode::Torque,
            ControlMode::Position => self.mode != ControlMode::Position,
        };
        self.mode = mode;
        self.stopped = false;
        self.flags.set(flags::POS_END, false);
        self.set_limits();
        if from_motor {
            self.servo.set_goal_from(&self.motor, goal);
        } else {
            self.servo.set_goal(goal);
        }
    }

    /// Makes the counter read `count` without moving the motor.
    pub(super) fn set_counter(&mut self, count: i32) {
        // Target and counter move together, so that the motor does not start.
        let shift = count.wrapping_sub(self.counter());
        self.encoder.preset(self.motor.position(), count.into());
        self.target = self.target.wrapping_add(shift);
        self.flags.set(flags::POS_END, false);
    }

    /// SAP.
    pub(super) fn set_axis(&mut self, number: u8, value: i32) -> Result<(), Status> {
        check_writable(self.state.memory.axis_parameter(number), value)?;
        match number {
            0 => return self.move_to(value),
            1 => self.set_counter(value),
            2 => return self.rotate(value),
            15 | 160 => {}
            155 => {
                self.apply_current(value)?;
                // Kept only once it is in effect: a refused current must not be read back as the present one.
                self.state.memory.axis[0][155] = value;
            }
            255 => return self.set_driver(value),
            _ => {
                self.state.memory.axis[0][usize::from(number)] = value;
                self.apply_settings();
            }
        }
        Ok(())
    }

    fn set_driver(&mut self, value: i32) -> Result<(), Status> {
        let before = core::mem::replace(&mut self.state.memory.axis[0][255], value);
        if value == 0 {
            self.servo.disable();
            self.target_rpm = 0;
            return Ok(());
        }
        let powered = self.power_on();
        if powered.is_err() {
            // A driver that cannot be switched on reads as off.
            self.state.memory.axis[0][255] = before;
        }
        powered
    }

    /// GAP.
    pub(super) fn read_axis(&mut self, number: u8) -> Result<i32, Status> {
        check_readable(self.state.memory.axis_parameter(number))?;
        let setpoint = self.servo.setpoint();
        let lag = setpoint.position - self.motor.position();
        let lag = libm::round(lag * self.encoder.counts_per_rad()) as i32;
        let slower = setpoint.velocity - self.motor.velocity();
        Ok(match number {
            0 => self.target,
            1 => self.counter(),
            2 => self.target_rpm,
            3 if self.encoder.is_broken() => 0,
            3 => libm::round(rpm(self.motor.velocity())) as i32,
            13 => libm::round(rpm(setpoint.velocity)) as i32,
            150 => libm::round(self.filtered_current * 1000.0) as i32,
            151 => libm::round(self.surroundings.supply * 10.0) as i32,
            152 => libm::round(self.stage.temperature()) as i32,
            156 => self.read_flags(),
            200 | 226 if self.mode == ControlMode::Position => lag,
            228 => libm::round(rpm(slower)) as i32,
            229 => libm::round(self.servo.integral() * 1000.0) as i32,
            _ => self.axis(number),
        })
    }

    /// Present flags: latched ones, and those that hold right now.
    pub(super) fn current_flags(&self) -> u32 {
        let mut shown = self.flags;
        shown.set(flags::HALTED, !self.servo.is_enabled());
        shown.set(flags::POSMOD, self.mode == ControlMode::Position);
        shown.set(flags::STOPSWITCH, self.stopped || self.switch_active());
        shown.0
    }

    fn read_flags(&mut self) -> i32 {
        let status = self.current_flags();
        // Latched flags are cleared by the reading (TMCL reference, parameter 156).
        self.flags.read_and_clear();
        status as i32
    }

    /// RSAP: the stored value takes effect at once.
    pub(super) fn restore_axis(&mut self, number: u8) -> Result<i32, Status> {
        let value = self.state.memory.stored_axis(0, number)?;
        self.state.memory.axis[0][usize::from(number)] = value;
        self.apply_settings();
        Ok(value)
    }

    /// Sets the loops by the parameters.
    pub(super) fn apply_settings(&mut self) {
        let (counts, inverted) = (self.axis(250).unsigned_abs(), self.axis(251) != 0);
        // Only where it changes: a new configuration makes the present position its zero.
        let turned = inverted != (self.encoder.counts_per_rad() < 0.0);
        if counts != self.encoder.counts_per_turn() || turned {
            self.encoder.reconfigure(self.motor.position(), counts, inverted);
        }
        self.servo.max_current = f64::from(self.axis(6)) * 0.1;
        self.servo.pwm = f64::from(self.axis(5)) / 255.0;
        let tuned = Gains::tuned(self.motor.parameters());
        self.servo.gains = Gains {
            position_p: tuned.position_p * self.axis_share(130, 500.0),
            // Cut, because a gain far above the tuned one makes a sampled loop oscillate.
            velocity_p: (tuned.velocity_p * self.axis_share(140, 1000.0))
                .min(4.0 * tuned.velocity_p),
            velocity_i: (tuned.velocity_i * self.axis_share(141, 1000.0))
                .min(4.0 * tuned.velocity_i),
            deadband: 0.5 / self.encoder.counts_per_rad().abs(),
            ..tuned
        };
        self.set_limits();
    }

    fn axis_share(&self, number: u8, usual: f64) -> f64 {
        // The factory's numbers are taken for well tuned; others scale from there. [I]
        f64::from(self.axis(number)) / usual
    }

    /// Limits of the motor by the parameters, read from them and not from the loops.
    pub(super) fn bounds(&self) -> ServoBounds {
        if !self.servo.is_enabled() {
            return ServoBounds::NONE;
        }
        let velocity = match self.mode {
            ControlMode::Velocity => rad_per_s(self.target_rpm).abs(),
            ControlMode::Position => rad_per_s(self.axis(4)),
            ControlMode::Torque => f64::INFINITY,
        };
        let ramped = self.mode != ControlMode::Torque && self.axis(146) != 0 && self.axis(11) != 0;
        let acceleration = if ramped { rad_per_s(self.axis(11)) } else { f64::INFINITY };
        ServoBounds { velocity, acceleration, current: f64::from(self.axis(6)) * 0.1 }
    }

    fn set_limits(&mut self) {
        // The speed limit of parameter 4 is one of positioning alone.
        let top = match self.mode {
            ControlMode::Position => self.axis(4),
            _ => RPM_MAX,
        };
        let ramp = if self.axis(146) == 0 { 0 } else { self.axis(11) };
        self.servo.set_limits(Limits::trapezoid(rad_per_s(top), rad_per_s(ramp)));
    }
}
