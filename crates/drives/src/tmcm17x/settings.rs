//! Axis parameters and motion: their effects and values.

use super::flags;
use super::module::Module;
use crate::bldc::{ChannelSettings, ControlMode, RPM_MAX, rpm};
use polepair_core::proto::tmcl::Status;
use polepair_core::proto::tmcl::module::memory::{check_readable, check_writable};

impl Module {
    /// The motor's settings, by the parameters.
    pub(super) fn settings(&self) -> ChannelSettings {
        let ramp = self.axis(11);
        ChannelSettings {
            max_rpm: self.axis(4),
            ramp: (self.axis(146) != 0 && ramp != 0).then_some(ramp),
            max_current: f64::from(self.axis(6)) * 0.1,
            reached_distance: self.axis(10).unsigned_abs(),
            reached_rpm: f64::from(self.axis(7)),
        }
    }

    /// Powers the motor, holding it where it is.
    ///
    /// # Errors
    /// [`Status::NotAvailable`] while it is switched off by parameter 255 or a fault lasts. \[I\]
    pub(super) fn power_on(&mut self) -> Result<(), Status> {
        let faulty = self.flags.any(flags::PERSISTENT) || self.surroundings.hall_broken;
        if self.axis(255) == 0 || faulty {
            return Err(Status::NotAvailable);
        }
        self.channel.power_on(&self.settings());
        Ok(())
    }

    /// ROR with its speed, or parameter 2.
    pub(super) fn rotate(&mut self, rpm: i32) -> Result<(), Status> {
        if !(-RPM_MAX..=RPM_MAX).contains(&rpm) {
            return Err(Status::InvalidValue);
        }
        self.power_on()?;
        self.stopped = false;
        self.channel.rotate(rpm, &self.settings());
        Ok(())
    }

    /// MVP ABS, or parameter 0.
    pub(super) fn move_to(&mut self, target: i32) -> Result<(), Status> {
        self.power_on()?;
        self.stopped = false;
        self.channel.move_to(target, &self.settings());
        Ok(())
    }

    /// Parameter 155.
    pub(super) fn apply_current(&mut self, milliamperes: i32) -> Result<(), Status> {
        self.power_on()?;
        self.stopped = false;
        self.channel.apply_current(f64::from(milliamperes) / 1000.0, &self.settings());
        Ok(())
    }

    /// MST, the stop switch and lost heartbeats: to rest along the ramp, regulated.
    pub(super) fn halt(&mut self) {
        self.channel.halt(&self.settings());
        self.stopped = true;
    }

    /// SAP.
    pub(super) fn set_axis(&mut self, number: u8, value: i32) -> Result<(), Status> {
        check_writable(self.state.memory.axis_parameter(number), value)?;
        match number {
            0 => return self.move_to(value),
            1 => self.channel.set_counter(value),
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
            self.channel.servo.disable();
            self.channel.target_rpm = 0;
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
        let channel = &self.channel;
        let setpoint = channel.servo.setpoint();
        let slower = setpoint.velocity - channel.motor.velocity();
        Ok(match number {
            0 => channel.target,
            1 => channel.counter(),
            2 => channel.target_rpm,
            3 => channel.actual_rpm(),
            13 => libm::round(rpm(setpoint.velocity)) as i32,
            150 => libm::round(self.filtered_current * 1000.0) as i32,
            151 => libm::round(self.surroundings.supply * 10.0) as i32,
            152 => libm::round(self.stage.temperature()) as i32,
            156 => self.read_flags(),
            200 | 226 if channel.mode == ControlMode::Position => channel.lag(),
            228 => libm::round(rpm(slower)) as i32,
            229 => libm::round(channel.servo.integral() * 1000.0) as i32,
            _ => self.axis(number),
        })
    }

    /// Present flags: latched ones, and those that hold right now.
    pub(super) fn current_flags(&self) -> u32 {
        let mut shown = self.flags;
        shown.set(flags::HALTED, !self.channel.servo.is_enabled());
        shown.set(flags::POSMOD, self.channel.mode == ControlMode::Position);
        shown.set(flags::POS_END, self.channel.arrived);
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
        self.channel.set_counts(self.axis(250).unsigned_abs(), self.axis(251) != 0);
        self.channel.servo.pwm = f64::from(self.axis(5)) / 255.0;
        // The factory's numbers are taken for well tuned; others scale from there. [I]
        let share = |number, usual: f64| f64::from(self.axis(number)) / usual;
        let shares = [share(130, 500.0), share(140, 1000.0), share(141, 1000.0)];
        self.channel.apply_settings(&self.settings(), shares);
    }
}
