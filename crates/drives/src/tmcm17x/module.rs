//! The module independent of its wires: power stage, motor, switches, time.

use super::flags::{self, Flags};
use crate::bldc::{BldcChannel, ControlMode};
use polepair_core::plant::{TICK_NS, TICK_S, ThermalModel, Ticks};
use polepair_core::profile::Profile;
use polepair_core::proto::tmcl::module::{ModulePrograms, ModuleState, TmclModule as _};
use polepair_core::time::Instant;

/// Heat of the power stage per A², Ω.
const STAGE_OHM: f64 = 0.02;

/// A TMCM-170 or 171 with its motor.
#[derive(Clone, Debug)]
pub struct Module {
    pub(super) state: ModuleState,
    pub(super) channel: BldcChannel,
    pub(super) flags: Flags,
    pub(super) outputs: u8,
    pub(super) analog: [f64; 4],
    /// Current as the module shows it, filtered (parameter 134), A.
    pub(super) filtered_current: f64,
    pub(super) stopped: bool,
    pub(super) surroundings: ModuleSurroundings,
    pub(super) stage: ThermalModel,
    pub(super) hallerr_at_power_on: bool,
    ticks: Ticks,
    switch_was_active: bool,
}

/// Surroundings of the module: the bench's side.
#[derive(Clone, Copy, Debug)]
pub(super) struct ModuleSurroundings {
    pub supply: f64,
    /// Level of the /STOP input.
    pub stop_high: bool,
    /// Shaft position from which on a switch pulls /STOP low, rad.
    pub switch_at: Option<f64>,
    pub hall_broken: bool,
    pub step_high: bool,
    pub backward: bool,
}

/// Default position at which the bench's stop switch closes, rad: two and a half turns to the right. It is not watched
/// from the factory (parameter 164), so that it stops no motor by default.
const SWITCH_AT: f64 = 5.0 * core::f64::consts::PI;

impl Module {
    /// A module as from the factory, powered with 24 V.
    #[must_use]
    pub fn new(profile: &'static Profile) -> Self {
        let around = ModuleSurroundings {
            supply: 24.0,
            stop_high: true,
            switch_at: Some(SWITCH_AT),
            hall_broken: false,
            step_high: false,
            backward: false,
        };
        let mut new = Self {
            state: ModuleState::new(profile),
            channel: BldcChannel::new(4096),
            flags: Flags(0),
            outputs: 0,
            analog: [0.0; 4],
            filtered_current: 0.0,
            stopped: false,
            surroundings: around,
            stage: ThermalModel::new(4.0, 20.0, 25.0),
            hallerr_at_power_on: false,
            ticks: Ticks::new(Instant::ZERO),
            switch_was_active: false,
        };
        new.power_up(Instant::ZERO);
        new
    }

    /// RAM is lost, settings come from the EEPROM. The motor goes on as it was, unpowered.
    pub fn power_up(&mut self, now: Instant) {
        let has_programs = self.has_programs();
        self.state.power_up(now, has_programs);
        self.flags = Flags(if self.hallerr_at_power_on { flags::HALLERR } else { 0 });
        self.outputs = 0;
        self.stopped = false;
        self.channel.power_up();
        self.apply_settings();
        if self.axis(128) == 2 {
            self.flags.update(
                self.surroundings.supply,
                self.axis(245) != 0,
                self.stage.temperature(),
            );
            // A module that may not start now (a fault lasts) simply stays at rest.
            let _ = self.rotate(self.axis(157));
        }
    }

    /// Runs the ticks up to `now`.
    pub fn advance(&mut self, now: Instant) {
        let before = self.ticks.at();
        let count = self.ticks.advance_to(now);
        for n in 0..count {
            if self.is_idle() {
                return self.pass_time((count - n) as f64 * TICK_S);
            }
            self.tick(before.plus_ns((n + 1) * TICK_NS));
        }
    }

    /// An axis parameter in RAM.
    #[must_use]
    pub const fn axis(&self, number: u8) -> i32 {
        self.state.memory.axis[0][number as usize]
    }

    /// Returns whether the stop switch is active and watched (parameters 164 and 166).
    #[must_use]
    pub fn switch_active(&self) -> bool {
        let closed =
            self.surroundings.switch_at.is_some_and(|at| self.channel.motor.position() >= at);
        let low = closed || !self.surroundings.stop_high;
        let active_high = self.axis(166) & 1 != 0;
        self.axis(164) & 1 != 0 && low != active_high
    }

    /// Takes the supply's new value; the logic dies below 7 V and starts anew above.
    pub fn set_supply(&mut self, now: Instant, volts: f64) {
        self.surroundings.supply = volts;
        if volts < flags::LOGIC_V {
            self.channel.servo.disable();
            self.state.is_unpowered = true;
        } else if self.state.is_unpowered {
            self.power_up(now);
        }
    }

    /// Switches the motor off and reports why.
    pub fn trip(&mut self, why: &'static str) {
        if self.channel.servo.is_enabled() {
            self.channel.servo.disable();
            self.state.notice = Some(why);
        }
    }

    fn is_idle(&self) -> bool {
        self.channel.is_idle()
            && !self.state.program.is_active()
            && self.axis(128) != 1
            && self.switch_was_active == self.switch_active()
    }

    /// Time passes over a module that does nothing.
    fn pass_time(&mut self, seconds: f64) {
        self.stage.step(0.0, seconds);
        self.channel.winding.step(0.0, seconds);
        self.filtered_current = 0.0;
        if !self.state.is_unpowered {
            self.check_protections();
        }
    }

    fn tick(&mut self, now: Instant) {
        if !self.state.is_unpowered {
            self.check_protections();
            self.check_switch();
            self.check_heartbeats(now);
            self.run_stand_alone();
            self.run_program(now);
        }
        // Protections, switches and programs act on the state before the tick, the motor moves in it.
        let before = self.channel.motor.position();
        self.tick_motor();
        self.clear_at_index(before);
        self.update_temperatures();
        self.channel.check_arrival(&self.settings());
    }

    fn check_protections(&mut self) {
        let celsius = self.stage.temperature();
        match self.flags.update(self.surroundings.supply, self.axis(245) != 0, celsius) {
            0 => {}
            new if new & flags::UNDERVOLT != 0 => self.trip("under-voltage: motor off"),
            new if new & flags::OVERVOLT != 0 => self.trip("over-voltage: motor off"),
            _ => self.trip("over-temperature: motor off"),
        }
        if self.surroundings.hall_broken {
            self.flags.set(flags::HALLERR, true);
            self.trip("hall sensor error: motor off");
        }
        // Modes 3 and 4 compare the counter with the index pulse, so a turn must pass.
        let turned = (self.channel.motor.position() - self.channel.encoder_broke_at).abs();
        let compares = matches!(self.axis(249), 3 | 4);
        if self.channel.encoder.is_broken() && compares && turned > core::f64::consts::TAU {
            self.flags.set(flags::ENCERR, true);
            self.trip("encoder error: motor off");
        }
    }

    /// Handles an edge of the stop switch: stops the motor, and may clear the counter. \[I\] A later command
    /// is executed; otherwise the motor could not leave the switch.
    fn check_switch(&mut self) {
        let active = self.switch_active();
        let came = active && !self.switch_was_active;
        self.switch_was_active = active;
        if !came {
            return;
        }
        self.halt();
        if self.axis(162) != 0 {
            self.channel.set_counter(0);
            if self.axis(163) != 0 {
                self.state.memory.axis[0][162] = 0;
            }
        }
    }

    fn clear_at_index(&mut self, before: f64) {
        let crossed = self.channel.encoder.index_between(before, self.channel.motor.position());
        if self.axis(161) != 0 && crossed {
            self.channel.set_counter(0);
            if self.axis(163) != 0 {
                self.state.memory.axis[0][161] = 0;
            }
        }
    }

    /// The heartbeat of a wire is missing.
    fn check_heartbeats(&mut self, now: Instant) {
        if let Some(why) = self.state.check_heartbeats(now)
            && self.channel.servo.is_enabled()
        {
            self.halt();
            self.state.notice = Some(why);
        }
    }

    /// Mode 1: speed by analog input 1, 0 to 10 V (parameters 128 and 157).
    fn run_stand_alone(&mut self) {
        if self.axis(128) == 1 {
            let share = (self.analog[1] / 10.0).clamp(0.0, 1.0);
            let rpm = libm::round(f64::from(self.axis(157)) * share) as i32;
            if rpm != self.channel.target_rpm || !self.channel.servo.is_enabled() {
                let _ = self.rotate(rpm);
            }
        }
    }

    /// A level at the step input: in mode 3 each rising edge adds parameter 157 to the target.
    pub fn step_input(&mut self, high: bool) {
        let rising = high && !self.surroundings.step_high;
        self.surroundings.step_high = high;
        if rising && self.axis(128) == 3 && !self.state.is_unpowered {
            let by = self.axis(157);
            let by = if self.surroundings.backward { by.wrapping_neg() } else { by };
            // While it positions, pulses add up on the target and not on where the motor happens to be.
            let positions = self.channel.mode == ControlMode::Position;
            let from = if positions { self.channel.target } else { self.channel.counter() };
            let _ = self.move_to(from.wrapping_add(by));
        }
    }

    fn tick_motor(&mut self) {
        // Parameter 9: the ramp waits for a motor that is too far behind.
        let distance = self.axis(9);
        if distance != 0 {
            self.channel.wait_for_motor(f64::from(distance) * 256.0);
        }
        if self.channel.tick(self.surroundings.supply) {
            self.trip("stalled: motor off");
        }
    }

    fn update_temperatures(&mut self) {
        let current = self.channel.motor.current();
        self.stage.step(STAGE_OHM * current * current, TICK_S);
        let share = 1.0 / (1.0 + f64::from(self.axis(134)));
        self.filtered_current += share * (current - self.filtered_current);
    }

    /// Instant of the last tick.
    pub(super) const fn ticked_to(&self) -> Instant {
        self.ticks.at()
    }
}
