//! The module: motors, ports, supply, and its requests.

use super::channel::{Channel, DIVIDED_SPEED_MAX, RampMode, STALL_ERROR, Settings};
use super::search::SwitchKind;
use super::units;
use polepair_core::plant::{TICK_NS, TICK_S, ThermalModel, Ticks};
use polepair_core::profile::Profile;
use polepair_core::proto::tmcl::module::interrupts;
use polepair_core::proto::tmcl::module::memory::{MOTORS_MAX, check_readable, check_writable};
use polepair_core::proto::tmcl::module::program::WaitCondition;
use polepair_core::proto::tmcl::module::{ModulePrograms, ModuleState, TmclModule};
use polepair_core::proto::tmcl::{Opcode, Request, Status};
use polepair_core::time::Instant;
use polepair_core::units::Unit;

/// Below this supply the drivers are off, V. \[I\]
pub const UNDERVOLTAGE_V: f64 = 8.0;
/// The logic lives above, V. \[I\]
const LOGIC_V: f64 = 6.0;
/// Heat of the driver stage per A², Ω.
const STAGE_OHM: f64 = 0.3;
/// Driver status flags (parameter 208): stall, over-temperature, its warning, standstill.
const FLAG_STALL: i32 = 1;
const FLAG_OVERTEMPERATURE: i32 = 2;
const FLAG_TEMPERATURE_WARNING: i32 = 4;
const FLAG_STANDSTILL: i32 = 128;
/// Driver flags that switch a motor off: over-temperature, shorts to ground.
pub(super) const DRIVER_FAULTS: i32 = 0x1A;
/// Off above, warning above, °C (TMC262).
const OVERTEMPERATURE_C: f64 = 150.0;
const TEMPERATURE_WARNING_C: f64 = 100.0;
/// Axis parameter that is 1 once the loop is closed (PyTrinamic, TMCM1311/TMCL/closed_loop_demo.py).
const CLOSED_LOOP_READY: u8 = 133;
/// Prefix of the module's number in its name.
const NAME_PREFIX: &str = "tmcm-";
/// Firmware version in the reply to 136.
const VERSION: (u8, u8) = (1, 48);

/// Positions of a motor that can be stored; number 0 is for programs (TMCL reference, SCO).
const COORDINATES: usize = 21;
/// Flag in the motor of MVP COORD: the lower bits are a mask of motors that start together.
const SEVERAL_MOTORS: u8 = 0x40;

/// A module with its motors.
#[derive(Clone, Debug)]
pub struct Module {
    pub(super) state: ModuleState,
    pub(super) channels: [Channel; MOTORS_MAX],
    pub(super) motors: usize,
    pub(super) supply: f64,
    pub(super) stage: ThermalModel,
    pub(super) inputs: [bool; 8],
    pub(super) outputs: u8,
    /// Faults of the driver that the bench has raised, as flags of parameter 208; they go with the power.
    pub(super) raised_faults: i32,
    /// Stored positions of each motor (SCO); lost with the power. \[I\]
    coordinates: [[i32; COORDINATES]; MOTORS_MAX],
    /// Axis parameter that closes the loop of a module with an encoder (TMCM-1311, 3351).
    closes_loop: Option<u8>,
    ticks: Ticks,
}

impl Module {
    /// A module as from the factory, powered with 24 V.
    #[must_use]
    pub fn new(profile: &'static Profile) -> Self {
        let has_divisors = profile.find_parameter("pulse divisor").is_some();
        let full = profile.find_parameter("max current").and_then(|id| profile.parameter(id));
        let full = full.filter(|current| current.unit == Unit::Ampere);
        let full_current = full.map_or(1.1, |current| current.scale.factor * 255.0);
        let mut new = Self {
            state: ModuleState::new(profile),
            channels: core::array::from_fn(|_| Channel::new(has_divisors, full_current)),
            motors: usize::from(profile.motors).clamp(1, MOTORS_MAX),
            supply: 24.0,
            stage: ThermalModel::new(8.0, 20.0, 25.0),
            inputs: [false; 8],
            outputs: 0,
            raised_faults: 0,
            coordinates: [[0; COORDINATES]; MOTORS_MAX],
            closes_loop: profile
                .find_parameter("closed loop mode")
                .and_then(|id| profile.parameter(id))
                .and_then(|mode| u8::try_from(mode.index).ok()),
            ticks: Ticks::new(Instant::ZERO),
        };
        // From the factory's EEPROM, as the first power-up of a real module.
        new.power_up(Instant::ZERO);
        new
    }

    /// Sets the full steps a turn of one motor, or of all.
    pub(super) fn set_full_steps(&mut self, motor: Option<usize>, full_steps: u32) {
        let channels = self.channels.iter_mut().zip(&self.state.memory.axis).enumerate();
        for (_, (channel, settings)) in channels.filter(|(n, _)| motor.is_none_or(|it| it == *n)) {
            channel.set_full_steps(full_steps, settings);
        }
    }

    pub(super) fn settings(&self, motor: usize) -> &Settings {
        &self.state.memory.axis[motor]
    }

    /// Takes the supply's new value.
    pub(super) fn set_supply(&mut self, now: Instant, volts: f64) {
        self.supply = volts;
        if volts < LOGIC_V {
            self.state.is_unpowered = true;
            self.halt_all();
        } else if self.state.is_unpowered {
            self.power_up(now);
        }
    }

    fn halt_all(&mut self) {
        for (channel, settings) in self.channels.iter_mut().zip(&self.state.memory.axis) {
            channel.stop(settings);
        }
    }

    fn is_idle(&self) -> bool {
        let motors = self.channels.iter().zip(&self.state.memory.axis).take(self.motors);
        let mut idle = motors.map(|(channel, settings)| channel.is_idle(settings));
        !self.state.program.is_active() && idle.all(|idle| idle)
    }

    fn pass_time(&mut self, seconds: f64) {
        let heat: f64 =
            self.channels.iter().map(|channel| channel.current() * channel.current()).sum();
        self.stage.step(STAGE_OHM * heat, seconds);
    }

    fn tick(&mut self, now: Instant) {
        if !self.state.is_unpowered {
            if let Some(why) = self.state.check_heartbeats(now) {
                self.halt_all();
                self.state.notice = Some(why);
            }
            self.run_program(now);
        }
        // A driver with a fault gives no current.
        // The ramp goes on without current: the counter runs while the motor of a shorted driver is at rest.
        let is_off = self.state.is_unpowered || self.raised_faults & DRIVER_FAULTS != 0;
        let supply = if is_off { 0.0 } else { self.supply };
        let motors = self.channels.iter_mut().zip(&mut self.state.memory.axis).take(self.motors);
        for (channel, settings) in motors {
            let notice = channel.tick(settings, supply);
            self.state.notice = notice.or(self.state.notice);
        }
        self.pass_time(TICK_S);
    }

    /// MVP COORD: a motor, or those of a mask, to their coordinates of that number.
    fn move_to_coordinate(&mut self, request: &Request) -> Result<i32, Status> {
        let number = usize::try_from(request.value).ok().filter(|number| *number < COORDINATES);
        let number = number.ok_or(Status::InvalidValue)?;
        // All targets are checked before the first motor starts, so that a wrong mask moves none of them.
        let mask = match request.motor {
            motor if usize::from(motor) < self.motors => 1 << motor,
            several if several & !0x3F == SEVERAL_MOTORS => several & 0x3F,
            _ => return Err(Status::InvalidValue),
        };
        if mask == 0 || mask >> self.motors != 0 {
            return Err(Status::InvalidValue);
        }
        for motor in (0..self.motors).filter(|motor| mask >> motor & 1 == 1) {
            let target = self.coordinates[motor][number];
            self.channels[motor].move_to(target, &self.state.memory.axis[motor]);
        }
        Ok(request.value)
    }

    /// SCO, GCO and CCO: writes, reads, or takes the present position. \[I\] Motor 255 is each of them.
    fn execute_coordinate(&mut self, request: &Request) -> Result<i32, Status> {
        let motors = match request.motor {
            u8::MAX if request.opcode != Opcode::Gco => 0..self.motors,
            _ => {
                let motor = self.motor_of(request)?;
                motor..motor + 1
            }
        };
        let number = usize::from(request.kind);
        if number >= COORDINATES {
            return Err(Status::WrongType);
        }
        for motor in motors {
            let slot = &mut self.coordinates[motor][number];
            match request.opcode {
                Opcode::Sco => *slot = request.value,
                Opcode::Gco => return Ok(*slot),
                _ => *slot = self.channels[motor].counter(),
            }
        }
        Ok(request.value)
    }

    /// MVP: 0 ABS, 1 REL. \[I\] REL counts from where the motor is.
    fn execute_move(&mut self, motor: usize, kind: u8, value: i32) -> Result<i32, Status> {
        let target = match kind {
            0 => value,
            1 => {
                let counter = self.channels[motor].counter();
                counter.checked_add(value).ok_or(Status::InvalidValue)?
            }
            _ => return Err(Status::WrongType),
        };
        self.channels[motor].move_to(target, &self.state.memory.axis[motor]);
        // A relative move that is sent twice goes twice as far; an absolute one does not.
        self.state.unrepeatable += u64::from(kind == 1);
        Ok(target)
    }

    fn rotate(&mut self, motor: usize, speed: i32) -> Result<(), Status> {
        let channel = &mut self.channels[motor];
        if channel.has_divisors && !(-DIVIDED_SPEED_MAX..=DIVIDED_SPEED_MAX).contains(&speed) {
            return Err(Status::InvalidValue);
        }
        channel.rotate(speed, &self.state.memory.axis[motor]);
        Ok(())
    }

    /// RFS: 0 START, 1 STOP, 2 STATUS.
    fn execute_search(&mut self, motor: usize, kind: u8, value: i32) -> Result<i32, Status> {
        let settings = &self.state.memory.axis[motor];
        let channel = &mut self.channels[motor];
        match kind {
            0 if channel.start_search(settings[193], settings) => Ok(value),
            0 => Err(Status::InvalidValue),
            1 => {
                channel.cancel_search();
                Ok(value)
            }
            2 => Ok(channel.search_status()),
            _ => Err(Status::WrongType),
        }
    }

    fn set_axis(&mut self, motor: usize, number: u8, value: i32) -> Result<(), Status> {
        check_writable(self.state.memory.axis_parameter(number), value)?;
        let channel = &mut self.channels[motor];
        let settings = &mut self.state.memory.axis[motor];
        match number {
            0 => channel.move_to(value, settings),
            1 => channel.set_counter(value),
            2 => return self.rotate(motor, value),
            _ => {
                settings[usize::from(number)] = value;
                if self.closes_loop == Some(number) {
                    // The initialisation of the sensor has ended. [I] It takes a real module a moment.
                    settings[usize::from(CLOSED_LOOP_READY)] = (value != 0).into();
                }
                if u16::from(number) == units::MICROSTEPS.0 {
                    channel.apply_resolution(settings);
                }
                channel.apply_settings(settings);
            }
        }
        Ok(())
    }

    fn read_axis(&mut self, motor: usize, number: u8) -> Result<i32, Status> {
        check_readable(self.state.memory.axis_parameter(number))?;
        let settings = &self.state.memory.axis[motor];
        let channel = &mut self.channels[motor];
        Ok(match number {
            0 => channel.target,
            1 => channel.counter(),
            2 => channel.target_speed,
            3 => channel.actual_speed(settings),
            8 => channel.has_arrived().into(),
            9 => channel.is_closed(SwitchKind::Home).into(),
            10 => channel.is_closed(SwitchKind::Right).into(),
            11 => channel.is_closed(SwitchKind::Left).into(),
            135 => channel.actual_acceleration(settings),
            138 if channel.mode == RampMode::Velocity => 2,
            180 => libm::round(31.0 * channel.current() / channel.full_current) as i32,
            206 => channel.load_value(settings),
            // Reading the errors clears them (TMCL reference, parameter 207).
            207 => core::mem::take(&mut channel.errors),
            208 => self.driver_flags(motor),
            209 => channel.counter(),
            _ => settings[usize::from(number)],
        })
    }

    /// The driver's faults: over-temperature and its warning.
    pub(super) fn driver_flags(&self, motor: usize) -> i32 {
        let (channel, settings) = (&self.channels[motor], self.settings(motor));
        let celsius = self.stage.temperature();
        self.raised_faults
            | flag_if(celsius > OVERTEMPERATURE_C, FLAG_OVERTEMPERATURE)
            | flag_if(celsius > TEMPERATURE_WARNING_C, FLAG_TEMPERATURE_WARNING)
            | flag_if(channel.load_value(settings) == 0, FLAG_STALL)
            | flag_if(channel.setpoint().velocity == 0.0, FLAG_STANDSTILL)
    }

    fn motor_of(&self, request: &Request) -> Result<usize, Status> {
        let motor = usize::from(request.motor);
        if motor < self.motors { Ok(motor) } else { Err(Status::InvalidValue) }
    }
}

fn flag_if(set: bool, flag: i32) -> i32 {
    if set { flag } else { 0 }
}

impl ModulePrograms for Module {
    fn has_programs(&self) -> bool {
        true
    }

    fn is_met(&self, what: WaitCondition) -> bool {
        let channel = |motor: u8| self.channels.get(usize::from(motor));
        match what {
            WaitCondition::Ticks => false,
            WaitCondition::Position(motor) => channel(motor).is_some_and(Channel::has_arrived),
            WaitCondition::Switch(motor) => channel(motor).is_some_and(|channel| {
                channel.is_closed(SwitchKind::Left) || channel.is_closed(SwitchKind::Right)
            }),
            WaitCondition::ReferenceSearch(motor) => {
                channel(motor).is_some_and(|channel| channel.search_status() == 0)
            }
        }
    }

    fn interrupt_levels(&self) -> u64 {
        let mut levels = u64::from(self.arrived_motors().unsigned_abs()) << interrupts::REACHED;
        for (n, channel) in self.channels[..self.motors].iter().enumerate() {
            levels |= u64::from(channel.errors & STALL_ERROR != 0)
                << (usize::from(interrupts::STALLED) + n);
            let stops =
                [SwitchKind::Left, SwitchKind::Right].map(|switch| channel.is_closed(switch));
            let stops = u64::from(stops[0]) | u64::from(stops[1]) << 1;
            levels |= stops << (usize::from(interrupts::STOP_SWITCHES) + 2 * n);
        }
        let inputs = self.inputs.iter().enumerate();
        inputs.fold(levels, |all, (n, high)| {
            all | u64::from(*high) << (usize::from(interrupts::INPUTS) + n)
        })
    }

    fn arrived_motors(&self) -> i32 {
        let motors = self.channels.iter().take(self.motors).enumerate();
        motors.fold(0, |mask, (n, channel)| mask | i32::from(channel.has_arrived()) << n)
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
                debug_assert!(n < count);
                return self.pass_time((count - n) as f64 * TICK_S);
            }
            self.tick(before.plus_ns((n + 1) * TICK_NS));
        }
    }

    fn power_up(&mut self, now: Instant) {
        self.state.power_up(now, true);
        (self.outputs, self.raised_faults) = (0, 0);
        for (channel, settings) in self.channels.iter_mut().zip(&self.state.memory.axis) {
            channel.power_up(settings);
        }
    }

    fn switch_off(&mut self) {
        self.halt_all();
    }

    fn execute_axis(&mut self, request: &Request) -> Result<i32, Status> {
        let (kind, value) = (request.kind, request.value);
        match request.opcode {
            Opcode::Mvp if kind == 2 => return self.move_to_coordinate(request),
            Opcode::Sco | Opcode::Gco | Opcode::Cco => return self.execute_coordinate(request),
            _ => {}
        }
        let motor = self.motor_of(request)?;
        match request.opcode {
            Opcode::Ror => self.rotate(motor, value)?,
            // The most negative number has no counterpart: it would turn in the wrong direction.
            Opcode::Rol => self.rotate(motor, value.checked_neg().ok_or(Status::InvalidValue)?)?,
            Opcode::Mst => self.channels[motor].stop(&self.state.memory.axis[motor]),
            Opcode::Mvp => return self.execute_move(motor, kind, value),
            Opcode::Rfs => return self.execute_search(motor, kind, value),
            Opcode::Sap => self.set_axis(motor, kind, value)?,
            Opcode::Gap => return self.read_axis(motor, kind),
            Opcode::Stap => self.state.memory.store_axis(motor, kind)?,
            Opcode::Rsap => {
                let stored = self.state.memory.stored_axis(motor, kind)?;
                // A restored value takes effect as a written one does.
                self.set_axis(motor, kind, stored)?;
                return Ok(stored);
            }
            _ => return Err(Status::InvalidCommand),
        }
        Ok(value)
    }

    /// Bank 0 digital inputs, bank 1 analog ones (8: supply in 0.1 V, 9: temperature in °C), bank 2 outputs.
    fn execute_ports(&mut self, request: &Request) -> Result<i32, Status> {
        let (port, value) = (request.kind, request.value);
        match (request.opcode, request.motor, port) {
            (Opcode::Sio, 2, 0..=7) => {
                if !(0..=1).contains(&value) {
                    return Err(Status::InvalidValue);
                }
                self.outputs = self.outputs & !(1 << port) | (value as u8) << port;
                Ok(value)
            }
            // Pull-ups of the reference switches (firmware manuals of the TMCM-1110 and 6110, SIO); not simulated.
            (Opcode::Sio, 0, 0) if (0..=1).contains(&value) => Ok(value),
            (Opcode::Gio, 0, 0..=7) => Ok(self.inputs[usize::from(port)].into()),
            (Opcode::Gio, 1, 0..=7) => Ok(if self.inputs[usize::from(port)] { 4095 } else { 0 }),
            (Opcode::Gio, 1, 8) => Ok(libm::round(self.supply * 10.0) as i32),
            (Opcode::Gio, 1, 9) => Ok(libm::round(self.stage.temperature()) as i32),
            (Opcode::Gio, 2, 0..=7) => Ok((self.outputs >> port & 1).into()),
            (Opcode::Gio, 0..=2, _) | (Opcode::Sio, 2, _) => Err(Status::WrongType),
            _ => Err(Status::InvalidValue),
        }
    }

    fn starts_motion(&self, request: &Request) -> bool {
        match (request.opcode, request.kind) {
            (Opcode::Ror | Opcode::Rol, _) | (Opcode::Sap, 2) => request.value != 0,
            (Opcode::Mvp, _) | (Opcode::Sap | Opcode::Rfs, 0) => true,
            _ => false,
        }
    }

    fn version(&self) -> (u16, u8, u8) {
        let number = self.state.profile.name.strip_prefix(NAME_PREFIX).unwrap_or("0");
        (number.parse().unwrap_or(0), VERSION.0, VERSION.1)
    }

    fn next_due(&self) -> Option<Instant> {
        let waits = self.state.armed_events & !self.arrived_motors() != 0 && !self.is_idle();
        let arrived = self.state.armed_events & self.arrived_motors() != 0;
        (waits || arrived).then(|| self.ticks.at().plus_ns(TICK_NS))
    }
}
