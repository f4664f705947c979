//! The module: motors, power stage, and its requests.

use super::layout::{FACTORY, Layout, Role};
use crate::bldc::{BldcChannel, ChannelSettings, ControlMode, RPM_MAX, rpm};
use polepair_core::plant::{TICK_NS, TICK_S, ThermalModel, Ticks};
use polepair_core::profile::Profile;
use polepair_core::proto::tmcl::module::memory::{check_readable, check_writable};
use polepair_core::proto::tmcl::module::program::WaitCondition;
use polepair_core::proto::tmcl::module::{ModulePrograms, ModuleState, TmclModule};
use polepair_core::proto::tmcl::{Opcode, Request, Status};
use polepair_core::time::Instant;

/// Motors of a module at most.
pub const MOTORS_MAX: usize = 2;
/// Heat of the power stage per A², Ω.
const STAGE_OHM: f64 = 0.02;
/// Prefix of the module's number in its name.
const NAME_PREFIX: &str = "tmcm-";
/// Firmware version in the reply to 136.
const VERSION: (u8, u8) = (1, 9);

/// Status flags (PyTrinamic, TMCM1690.py; the other classes name bit 14 alone).
pub mod flags {
    /// Supply too low.
    pub const UNDERVOLTAGE: u32 = 1 << 1;
    /// Supply too high.
    pub const OVERVOLTAGE: u32 = 1 << 2;
    /// Power stage too hot.
    pub const OVERTEMPERATURE: u32 = 1 << 3;
    /// The motor turns no faster than its halted velocity.
    pub const HALTED: u32 = 1 << 4;
    /// Impossible hall pattern.
    pub const HALL_ERROR: u32 = 1 << 5;
    /// A speed is regulated.
    pub const VELOCITY_MODE: u32 = 1 << 9;
    /// A position is regulated.
    pub const POSITION_MODE: u32 = 1 << 10;
    /// A current is regulated.
    pub const TORQUE_MODE: u32 = 1 << 11;
    /// The last move has arrived.
    pub const POSITION_END: u32 = 1 << 14;
    /// The motor's sensor is initialized.
    pub const INITIALIZED: u32 = 1 << 15;
    /// Flags that switch the motor off; over-current, driver and initialization errors among them.
    pub const TRIPS: u32 = 0xEF;
}

/// Below, and above, the power stage is off, V. \[I\]
const SUPPLY_V: (f64, f64) = (8.0, 55.0);
/// The logic lives above, V. \[I\]
const LOGIC_V: f64 = 6.0;
/// The power stage is off above, °C. \[I\]
const OVERTEMPERATURE_C: f64 = 100.0;

/// A module with its motors.
#[derive(Clone, Debug)]
pub struct Module {
    pub(super) state: ModuleState,
    layout: Layout,
    pub(super) channels: [BldcChannel; MOTORS_MAX],
    pub(super) motors: usize,
    pub(super) supply: f64,
    pub(super) stage: ThermalModel,
    /// Faults that the bench has raised; they go with the power.
    pub(super) raised: u32,
    pub(super) hall_broken: bool,
    pub(super) inputs: [bool; 8],
    outputs: u8,
    pub(super) analog: [f64; 4],
    ticks: Ticks,
}

impl Module {
    /// A module as from the factory, powered with 24 V.
    #[must_use]
    pub fn new(profile: &'static Profile) -> Self {
        let layout = Layout::new(profile);
        let mut state = ModuleState::new(profile);
        let commutation = (Role::Commutation, layout.encoder_commutation());
        for (role, value) in FACTORY.iter().chain([&commutation]) {
            let number = layout.number(*role);
            if let Some(number) = number.filter(|at| state.memory.axis[0][usize::from(*at)] == 0) {
                state.memory.preset_axis(number, *value);
            }
        }
        let mut new = Self {
            state,
            layout,
            channels: core::array::from_fn(|_| BldcChannel::new(4096)),
            motors: usize::from(profile.motors).clamp(1, MOTORS_MAX),
            supply: 24.0,
            stage: ThermalModel::new(4.0, 20.0, 25.0),
            raised: 0,
            hall_broken: false,
            inputs: [false; 8],
            outputs: 0,
            analog: [0.0; 4],
            ticks: Ticks::new(Instant::ZERO),
        };
        new.power_up(Instant::ZERO);
        new
    }

    /// The settings of a motor.
    pub(super) fn settings(&self, motor: usize) -> ChannelSettings {
        let value = |role| self.layout.value(role, &self.state.memory.axis[motor]);
        let ramp = value(Role::MaxAcceleration).filter(|ramp| *ramp > 0);
        ChannelSettings {
            max_rpm: value(Role::MaxVelocity).unwrap_or(RPM_MAX).clamp(0, RPM_MAX),
            ramp: ramp.filter(|_| value(Role::EnableRamp) != Some(0)),
            max_current: f64::from(value(Role::MaxCurrent).unwrap_or_default()) / 1000.0,
            reached_distance: value(Role::ReachedDistance).unwrap_or(5).unsigned_abs(),
            reached_rpm: f64::from(value(Role::ReachedVelocity).unwrap_or(500)),
        }
    }

    fn apply_settings(&mut self, motor: usize) {
        let (layout, axis) = (&self.layout, &self.state.memory.axis[motor]);
        let counts = layout.counts(axis);
        let settings = self.settings(motor);
        self.channels[motor].set_counts(counts, false);
        self.channels[motor].apply_settings(&settings, [1.0; 3]);
    }

    /// Takes the supply's new value.
    pub(super) fn set_supply(&mut self, now: Instant, volts: f64) {
        self.supply = volts;
        if volts < LOGIC_V {
            self.switch_off();
            self.state.is_unpowered = true;
        } else if self.state.is_unpowered {
            self.power_up(now);
        }
    }

    /// Faults that hold now, as status flags.
    pub(super) fn faults(&self) -> u32 {
        let flag = |is_set: bool, flag: u32| if is_set { flag } else { 0 };
        self.raised
            | flag(self.supply < SUPPLY_V.0, flags::UNDERVOLTAGE)
            | flag(self.supply > SUPPLY_V.1, flags::OVERVOLTAGE)
            | flag(self.stage.temperature() > OVERTEMPERATURE_C, flags::OVERTEMPERATURE)
            | flag(self.hall_broken, flags::HALL_ERROR)
    }

    fn status_flags(&self, motor: usize) -> u32 {
        let channel = &self.channels[motor];
        let halted = self.layout.value(Role::HaltedVelocity, &self.state.memory.axis[motor]);
        let mode = match channel.mode {
            _ if !channel.servo.is_enabled() => 0,
            ControlMode::Velocity => flags::VELOCITY_MODE,
            ControlMode::Position => flags::POSITION_MODE,
            ControlMode::Torque => flags::TORQUE_MODE,
        };
        let is_halted = channel.actual_rpm().abs() <= halted.unwrap_or(5);
        self.faults()
            | flags::INITIALIZED
            | mode
            | if is_halted { flags::HALTED } else { 0 }
            | if channel.arrived { flags::POSITION_END } else { 0 }
    }

    fn power_on(&mut self, motor: usize) -> Result<(), Status> {
        let axis = &self.state.memory.axis[motor];
        let is_off = |role| self.layout.value(role, axis) == Some(0);
        // Mode 0 is "disabled" where there is a position scaler, and block commutation elsewhere.
        let disabled = self.layout.number(Role::Poles).is_none() && is_off(Role::Commutation);
        if is_off(Role::Driver) || disabled || self.faults() & flags::TRIPS != 0 {
            return Err(Status::NotAvailable);
        }
        let settings = self.settings(motor);
        self.channels[motor].power_on(&settings);
        Ok(())
    }

    fn rotate(&mut self, motor: usize, rpm: i32) -> Result<(), Status> {
        if !(-RPM_MAX..=RPM_MAX).contains(&rpm) {
            return Err(Status::InvalidValue);
        }
        self.power_on(motor)?;
        let settings = self.settings(motor);
        self.channels[motor].rotate(rpm, &settings);
        Ok(())
    }

    fn move_to(&mut self, motor: usize, target: i32) -> Result<(), Status> {
        self.power_on(motor)?;
        let settings = self.settings(motor);
        self.channels[motor].move_to(target, &settings);
        Ok(())
    }

    /// MVP: 0 ABS, 1 REL. \[I\] REL counts from where the motor is, and answers where it will be.
    fn execute_move(&mut self, motor: usize, kind: u8, value: i32) -> Result<i32, Status> {
        let target = match kind {
            0 => value,
            1 => {
                let counter = self.channels[motor].counter();
                counter.checked_add(value).ok_or(Status::InvalidValue)?
            }
            _ => return Err(Status::WrongType),
        };
        self.move_to(motor, target)?;
        self.state.unrepeatable += u64::from(kind == 1);
        Ok(target)
    }

    fn halt(&mut self, motor: usize) {
        let settings = self.settings(motor);
        self.channels[motor].halt(&settings);
    }

    fn set_axis(&mut self, motor: usize, number: u8, value: i32) -> Result<(), Status> {
        check_writable(self.state.memory.axis_parameter(number), value)?;
        match self.layout.role(number) {
            Some(Role::TargetPosition) => return self.move_to(motor, value),
            Some(Role::ActualPosition) => self.channels[motor].set_counter(value),
            Some(Role::TargetVelocity) => return self.rotate(motor, value),
            Some(Role::TargetTorque) => {
                self.power_on(motor)?;
                let settings = self.settings(motor);
                self.channels[motor].apply_current(f64::from(value) / 1000.0, &settings);
                self.state.memory.axis[motor][usize::from(number)] = value;
            }
            role => {
                self.state.memory.axis[motor][usize::from(number)] = value;
                if matches!(role, Some(Role::Driver | Role::Commutation)) && self.is_off(motor) {
                    self.channels[motor].servo.disable();
                    self.channels[motor].target_rpm = 0;
                }
                self.apply_settings(motor);
            }
        }
        Ok(())
    }

    /// Returns whether the settings of a motor leave it without current.
    fn is_off(&self, motor: usize) -> bool {
        let axis = &self.state.memory.axis[motor];
        let is_zero = |role| self.layout.value(role, axis) == Some(0);
        is_zero(Role::Driver)
            || self.layout.number(Role::Poles).is_none() && is_zero(Role::Commutation)
    }

    fn read_axis(&self, motor: usize, number: u8) -> Result<i32, Status> {
        check_readable(self.state.memory.axis_parameter(number))?;
        let channel = &self.channels[motor];
        let setpoint = channel.servo.setpoint();
        Ok(match self.layout.role(number) {
            Some(Role::TargetPosition) => channel.target,
            Some(Role::ActualPosition) => channel.counter(),
            Some(Role::RampPosition) => channel.counter().wrapping_add(channel.lag()),
            Some(Role::TargetVelocity) => channel.target_rpm,
            Some(Role::ActualVelocity) => channel.actual_rpm(),
            Some(Role::RampVelocity) => libm::round(rpm(setpoint.velocity)) as i32,
            Some(Role::ActualTorque) => libm::round(channel.motor.current() * 1000.0) as i32,
            Some(Role::Flags) => self.status_flags(motor) as i32,
            Some(Role::Supply) => libm::round(self.supply * 10.0) as i32,
            Some(Role::Temperature) => libm::round(self.stage.temperature()) as i32,
            Some(Role::Reached) => channel.arrived.into(),
            _ => self.state.memory.axis[motor][usize::from(number)],
        })
    }

    fn is_idle(&self) -> bool {
        !self.state.program.is_active() && self.channels.iter().all(BldcChannel::is_idle)
    }

    fn pass_time(&mut self, seconds: f64) {
        self.stage.step(0.0, seconds);
        self.channels.iter_mut().for_each(|channel| channel.winding.step(0.0, seconds));
    }

    fn tick(&mut self, now: Instant) {
        if !self.state.is_unpowered {
            if let Some(why) = self.state.check_heartbeats(now) {
                let turns = self.channels.iter().any(|channel| channel.servo.is_enabled());
                (0..self.motors).for_each(|motor| self.halt(motor));
                self.state.notice = Some(why).filter(|_| turns).or(self.state.notice);
            }
            self.run_program(now);
        }
        if self.faults() & flags::TRIPS != 0 {
            self.trip("fault: motor off");
        }
        let mut heat = 0.0;
        for motor in 0..self.motors {
            let settings = self.settings(motor);
            let channel = &mut self.channels[motor];
            let stalled = channel.tick(self.supply);
            channel.check_arrival(&settings);
            heat += STAGE_OHM * channel.motor.current() * channel.motor.current();
            if stalled {
                channel.servo.disable();
                self.state.notice = Some("stalled: motor off");
            }
        }
        self.stage.step(heat, TICK_S);
    }

    /// Switches the motors off and reports why.
    pub(super) fn trip(&mut self, why: &'static str) {
        if self.channels.iter().any(|channel| channel.servo.is_enabled()) {
            self.switch_off();
            self.state.notice = Some(why);
        }
    }
}

impl ModulePrograms for Module {
    fn has_programs(&self) -> bool {
        true
    }

    fn is_met(&self, what: WaitCondition) -> bool {
        match what {
            WaitCondition::Position(motor) => {
                self.channels.get(usize::from(motor)).is_some_and(|channel| channel.arrived)
            }
            WaitCondition::Ticks | WaitCondition::Switch(_) | WaitCondition::ReferenceSearch(_) => {
                false
            }
        }
    }

    fn arrived_motors(&self) -> i32 {
        let motors = self.channels.iter().take(self.motors).enumerate();
        motors.fold(0, |mask, (n, channel)| mask | i32::from(channel.arrived) << n)
    }
}

impl TmclModule for Module {
    fn state(&self) -> &ModuleState {
        &self.state
    }

    fn state_mut(&mut self) -> &mut ModuleState {
        &mut self.state
    }

    fn advance(&mut self, now: Instant) {
        let before = self.ticks.at();
        let count = self.ticks.advance_to(now);
        for n in 0..count {
            if self.is_idle() {
                return self.pass_time((count - n) as f64 * TICK_S);
            }
            self.tick(before.plus_ns((n + 1) * TICK_NS));
        }
    }

    fn power_up(&mut self, now: Instant) {
        self.state.power_up(now, true);
        (self.outputs, self.raised) = (0, 0);
        for motor in 0..self.motors {
            self.channels[motor].power_up();
            self.apply_settings(motor);
        }
    }

    fn switch_off(&mut self) {
        self.channels.iter_mut().for_each(|channel| channel.servo.disable());
    }

    fn execute_axis(&mut self, request: &Request) -> Result<i32, Status> {
        let motor = usize::from(request.motor);
        if motor >= self.motors {
            return Err(Status::InvalidValue);
        }
        let (kind, value) = (request.kind, request.value);
        match request.opcode {
            Opcode::Ror => self.rotate(motor, value)?,
            Opcode::Rol => self.rotate(motor, value.checked_neg().ok_or(Status::InvalidValue)?)?,
            Opcode::Mst => self.halt(motor),
            Opcode::Mvp => return self.execute_move(motor, kind, value),
            Opcode::Sap => self.set_axis(motor, kind, value)?,
            Opcode::Gap => return self.read_axis(motor, kind),
            Opcode::Stap => self.state.memory.store_axis(motor, kind)?,
            Opcode::Rsap => {
                let stored = self.state.memory.stored_axis(motor, kind)?;
                self.state.memory.axis[motor][usize::from(kind)] = stored;
                self.apply_settings(motor);
                return Ok(stored);
            }
            _ => return Err(Status::InvalidCommand),
        }
        Ok(value)
    }

    /// Inputs 0 to 7, analog inputs 0 to 3 with 12 bits for 5 V, outputs 0 to 7. \[I\]
    fn execute_ports(&mut self, request: &Request) -> Result<i32, Status> {
        let port = usize::from(request.kind);
        match (request.opcode, request.motor, port) {
            (Opcode::Sio, 2, 0..=7) => {
                let bit = 1 << port;
                match request.value {
                    0 => self.outputs &= !bit,
                    1 => self.outputs |= bit,
                    _ => return Err(Status::InvalidValue),
                }
                Ok(request.value)
            }
            (Opcode::Gio, 0, 0..=7) => Ok(self.inputs[port].into()),
            (Opcode::Gio, 1, 0..=3) => {
                let share = (self.analog[port] / 5.0).clamp(0.0, 1.0);
                Ok(libm::round(share * 4095.0) as i32)
            }
            (Opcode::Gio, 2, 0..=7) => Ok((self.outputs >> port & 1).into()),
            (Opcode::Gio, 0..=2, _) | (Opcode::Sio, 2, _) => Err(Status::WrongType),
            _ => Err(Status::InvalidValue),
        }
    }

    fn starts_motion(&self, request: &Request) -> bool {
        match (request.opcode, self.layout.role(request.kind)) {
            (Opcode::Ror | Opcode::Rol, _) => request.value != 0,
            (Opcode::Mvp, _) | (Opcode::Sap, Some(Role::TargetPosition)) => true,
            (Opcode::Sap, Some(Role::TargetVelocity | Role::TargetTorque)) => request.value != 0,
            _ => false,
        }
    }

    fn version(&self) -> (u16, u8, u8) {
        let number = self.state.profile.name.strip_prefix(NAME_PREFIX);
        let number = number.and_then(|number| number.parse().ok());
        (number.unwrap_or_default(), VERSION.0, VERSION.1)
    }

    fn next_due(&self) -> Option<Instant> {
        let motors = self.channels.iter().take(self.motors).enumerate();
        let mut waits = motors.filter(|(n, channel)| {
            self.state.armed_events >> n & 1 != 0
                && channel.mode == ControlMode::Position
                && channel.servo.is_enabled()
        });
        waits.next().map(|_| self.ticks.at().plus_ns(TICK_NS))
    }
}
