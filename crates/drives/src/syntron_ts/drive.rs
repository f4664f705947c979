//! The TS independent of its line: registers, modes, power, alarms, time.
//!
//! This module does not know Modbus. The part on CANopen contains what the bus needs.

mod canopen;
mod view;
mod write_checks;

use core::f64::consts::TAU;

use super::alarm::Alarm;
use super::external::ExternalSignals;
use super::io::{InputLines, InputPurpose, has_duplicates};
use super::motion::{Motion, TickContext, default_ramp};
use super::options::{Options, Variant};
use super::panel::{DriveView, FrontPanel, PanelAction, PanelKey, RegisterCode};
use super::registers::{DN_COUNT, FN_COUNT, Registers, dn_registers, fn_registers, write_limits};
use super::shaft::{self, Protections};
use crate::stored_paths::s_time_fits;
use polepair_core::plant::{ServoShaft, Ticks};
use polepair_core::profile::Profile;
use polepair_core::time::Instant;
use polepair_core::units::nearest;

/// Speed by the analog input.
pub const MODE_ANALOG: u16 = 0;
/// Internal speed mode.
pub const MODE_SPEED: u16 = 1;
/// Position by pulses, the factory's mode.
pub const MODE_PULSES: u16 = 2;
/// Jog from the panel.
pub const MODE_JOG: u16 = 3;
/// Torque by the analog input.
pub const MODE_TORQUE: u16 = 4;
/// Internal position mode.
pub const MODE_POSITION: u16 = 14;
/// CANopen mode.
pub const MODE_CANOPEN: u16 = 20;
/// Password of the locked registers (TS manual V2 §1.4.1).
const PASSWORD: u16 = 9876;
/// Speed of jogging, rpm `[I]`.
const JOG_RPM: f64 = 200.0;
/// Top speed of the set-point where no path gives one, rpm.
const TOP_RPM: f64 = 6000.0;
/// Version in Dn_08 (DS102).
const VERSION: u16 = 0x0102;

/// Reason why a register access is refused.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum RegisterError {
    /// There is no such register, or it cannot be written.
    Address,
    /// The value is not allowed.
    Value,
    /// Not now: locked by the password or open on the panel.
    Failure,
}

/// A powered drive with its motor and panel.
#[derive(Debug)]
pub struct Drive {
    core: DriveCore,
    panel: FrontPanel,
}

/// Everything but the panel, which looks at it.
#[derive(Debug)]
struct DriveCore {
    profile: &'static Profile,
    options: Options,
    registers: Registers,
    shaft: ServoShaft,
    protections: Protections,
    motion: Motion,
    lines: InputLines,
    alarm: Alarm,
    ticks: Ticks,
    now: Instant,
    /// Something outside has changed something since time last passed.
    disturbed: bool,
    jogging: bool,
    jog: f64,
    external: ExternalSignals,
    /// Set-point that the pulses have reached, rad.
    pulse_target: f64,
    previous_inputs: [bool; 4],
    unrepeatable: u64,
    starts: u64,
    notice: Option<&'static str>,
    canopen: canopen::CanopenNode,
}

impl Drive {
    /// A drive that just got power for the first time.
    #[must_use]
    pub fn new(profile: &'static Profile, options: Options) -> Self {
        let mut registers = Registers::factory(profile);
        registers.preset(fn_registers::ADDRESS, u16::from(options.address));
        // One number for both ends: a drive is found at the same address on Modbus and on CANopen.
        registers.preset(fn_registers::NODE, u16::from(options.address));
        registers.preset(fn_registers::MODE, options.mode);
        registers.preset(fn_registers::FORMAT, if options.ascii { 2 } else { 1 });
        if options.ds102 {
            registers.preset(fn_registers::RATED_CURRENT, (shaft::RATED_CURRENT * 100.0) as u16);
        }
        let mut core = DriveCore {
            profile,
            options,
            registers,
            shaft: shaft::new_shaft(),
            protections: Protections::default(),
            motion: Motion::new(0.0),
            lines: options.lines,
            alarm: Alarm::NONE,
            ticks: Ticks::new(Instant::ZERO),
            now: Instant::ZERO,
            disturbed: true,
            jogging: false,
            jog: 0.0,
            external: options.external,
            pulse_target: 0.0,
            previous_inputs: [false; 4],
            unrepeatable: 0,
            starts: 0,
            notice: None,
            canopen: canopen::CanopenNode::new(0.0),
        };
        core.boot();
        Self { core, panel: FrontPanel::default() }
    }

    /// Lets time pass up to `now`.
    pub fn advance(&mut self, now: Instant) {
        self.core.advance(now);
        if let Some(action) = self.panel.tick(now, &self.core) {
            self.execute_panel_action(action);
        }
    }

    /// Time of the next call to [`advance`](Self::advance), without a request.
    #[must_use]
    pub fn next_due(&self) -> Option<Instant> {
        // A resting drive wakes up for requests alone, so that a rack of them costs nothing.
        let moving = (!self.core.shaft.is_resting()).then(|| self.core.now.plus_ms(WAKE_MS));
        polepair_core::time::earliest(self.panel.next_due(), moving)
    }

    /// The end of the tick that runs.
    #[must_use]
    pub fn next_tick(&self) -> Instant {
        self.core.ticks.at().plus_ns(polepair_core::plant::TICK_NS)
    }

    /// The registers as they now are.
    #[must_use]
    pub const fn registers(&self) -> &Registers {
        &self.core.registers
    }

    /// The motor.
    #[must_use]
    pub const fn shaft(&self) -> &ServoShaft {
        &self.core.shaft
    }

    /// The motor, for what acts on it from outside.
    pub const fn shaft_mut(&mut self) -> &mut ServoShaft {
        self.core.disturbed = true;
        &mut self.core.shaft
    }

    /// The input lines and switches, for what acts on them from outside.
    pub const fn lines_mut(&mut self) -> &mut InputLines {
        self.core.disturbed = true;
        &mut self.core.lines
    }

    /// Options of the drive.
    #[must_use]
    pub const fn options(&self) -> &Options {
        &self.core.options
    }

    /// The alarm.
    #[must_use]
    pub const fn alarm(&self) -> Alarm {
        self.core.alarm
    }

    /// Path starts and homings that were triggered so far.
    #[must_use]
    pub fn unrepeatable(&self) -> u64 {
        self.core.unrepeatable + self.core.motion.unrepeatable()
    }

    /// Writes over the line that powered the motor or gave it somewhere to go.
    #[must_use]
    pub const fn starts(&self) -> u64 {
        self.core.starts
    }

    /// The shaft position of coordinate 0, rad.
    #[must_use]
    pub const fn origin(&self) -> f64 {
        self.core.motion.origin()
    }

    /// Takes the event since the last call.
    pub const fn take_notice(&mut self) -> Option<&'static str> {
        self.core.notice.take()
    }

    /// Reads Fn_nnn.
    #[must_use]
    pub fn fn_value(&self, number: u16) -> Option<u16> {
        let there =
            usize::from(number) < FN_COUNT && self.core.options.variant.has_register(number);
        there.then(|| self.core.registers.value(number))
    }

    /// Reads Dn_nn.
    #[must_use]
    pub fn dn_value(&self, number: u16) -> Option<u16> {
        (number < DN_COUNT).then(|| self.core.dn_reading(number))
    }

    /// The inputs, the first in bit 0.
    #[must_use]
    pub fn inputs(&self) -> u8 {
        self.core.lines.bits(self.core.shaft.motor().position())
    }

    /// The outputs, the first in bit 0 `[I]`: ready, alarm, path done, powered.
    #[must_use]
    pub fn outputs(&self) -> u8 {
        let core = &self.core;
        let lines = [
            !core.alarm.is_some(),
            core.alarm.is_some(),
            !core.motion.is_busy(),
            core.shaft.is_powered(),
        ];
        lines.iter().enumerate().fold(0, |bits, (at, on)| bits | u8::from(*on) << at)
    }

    /// Writes Fn registers over the line, all or none.
    ///
    /// # Errors
    /// Why nothing was written.
    pub fn write(&mut self, start: u16, values: &[u16]) -> Result<(), RegisterError> {
        self.core.disturbed = true;
        for (number, value) in register_numbers(start).zip(values) {
            self.check_write(number, *value)?;
        }
        // Every check comes before the first write: a frame is executed as a whole or not at all.
        self.core.check_s_times(start, values)?;
        for (number, value) in register_numbers(start).zip(values) {
            let before = self.core.registers.value(number);
            self.core.registers.write(number, *value);
            self.core.handle_written(number, before, *value);
            self.core.starts += u64::from(starts_motion(number, before, *value));
        }
        Ok(())
    }

    /// Raises an alarm from outside.
    pub fn raise_alarm(&mut self, alarm: Alarm) {
        self.core.raise_alarm(alarm);
    }

    /// An analog input in volts.
    pub fn set_analog(&mut self, volts: f64) {
        self.core.external.set_volts(volts);
    }

    /// Pulses on the pulse input; negative ones by the other level of the direction.
    pub fn add_pulses(&mut self, count: i32) {
        self.core.external.add_pulses(count);
    }

    /// A key of the panel goes down or up.
    pub fn handle_key(&mut self, now: Instant, key: PanelKey, down: bool) {
        if let Some(action) = self.panel.handle_key(now, key, down, &self.core) {
            self.execute_panel_action(action);
        }
        self.core.jog = self.panel.jog_direction();
        self.core.update_jog();
    }

    /// Writes the text of the panel. Returns the number of characters.
    pub fn write_display(&self, now: Instant, out: &mut [u8]) -> usize {
        self.panel.write_display(now, &self.core, out)
    }

    /// Power off and on.
    pub fn power_cycle(&mut self) {
        self.panel = FrontPanel::default();
        self.core.disturbed = true;
        self.core.registers.power_cycle();
        self.core.boot();
    }

    fn execute_panel_action(&mut self, action: PanelAction) {
        self.core.disturbed = true;
        match action {
            PanelAction::Save(number, value) => self.save_from_panel(number, value as u16),
            PanelAction::ToggleJog => self.core.toggle_jog(),
            PanelAction::ClearAlarm => self.core.clear_alarm(),
        }
    }

    /// Saves a value at the panel: to flash, whatever Fn_99 has, which applies to the line only `[I]`.
    fn save_from_panel(&mut self, number: u16, value: u16) {
        let allowed = self.core.check_value(number, value).is_ok()
            && self.core.check_s_times(number, &[value]).is_ok();
        if allowed {
            let before = self.core.registers.value(number);
            self.core.registers.store(number, value);
            self.core.handle_written(number, before, value);
        }
    }

    fn check_write(&self, number: u16, value: u16) -> Result<(), RegisterError> {
        self.core.check_value(number, value)?;
        let unlocked = self.core.registers.value(fn_registers::PASSWORD) == PASSWORD;
        if self.core.options.is_locked(number) && !unlocked {
            return Err(RegisterError::Failure);
        }
        // The panel goes first (§1.4.2), but never keeps the line from stopping the motor.
        let stops = matches!(
            (number, value),
            (fn_registers::SPEED | fn_registers::ENABLE, 0) | (fn_registers::PATH_STOP, 1)
        );
        let open = self.panel.edited_parameter() == Some(number);
        if open && !stops { Err(RegisterError::Failure) } else { Ok(()) }
    }
}

/// Register numbers from `start` on; past the last one they begin anew, where nothing is written.
pub fn register_numbers(start: u16) -> impl Iterator<Item = u16> {
    (0..=u16::MAX).map(move |offset| start.wrapping_add(offset))
}

/// Returns whether such a write sets something going, in the modes where its register counts.
const fn starts_motion(number: u16, before: u16, value: u16) -> bool {
    match number {
        fn_registers::SPEED => value != 0,
        fn_registers::ENABLE => value == 1,
        fn_registers::PATH_TRIGGER | fn_registers::HOMING_TRIGGER => before == 0 && value == 1,
        _ => false,
    }
}

/// Interval of updates of a drive that is not at rest, ms, so that no request waits for a long past.
const WAKE_MS: u32 = 50;

impl DriveCore {
    fn boot(&mut self) {
        self.shaft.power_off();
        self.protections.reset(&mut self.shaft);
        // The count of the motion that ends here, before a new one starts at zero.
        self.unrepeatable += self.motion.unrepeatable();
        self.motion = Motion::new(self.shaft.position());
        self.alarm = Alarm::NONE;
        self.canopen = canopen::CanopenNode::new(self.shaft.position());
        self.jogging = false;
        self.previous_inputs = [false; 4];
        if has_duplicates(self.lines.purposes()) {
            self.raise_alarm(Alarm::ID);
        }
        // Fn_38 in flash powers the motor when the supply comes (§2.5): the most dangerous setting of this
        // drive.
        if self.registers.value(fn_registers::ENABLE) == 1 {
            self.power_on();
        }
    }

    fn mode(&self) -> u16 {
        self.registers.value(fn_registers::MODE)
    }

    #[inline]
    fn advance(&mut self, now: Instant) {
        let from = self.ticks.at();
        let ticks = self.ticks.advance_to(now);
        self.now = now.max(self.now);
        if ticks > 0 || self.disturbed {
            self.run_ticks(from, ticks);
        }
    }

    fn run_ticks(&mut self, from: Instant, ticks: u64) {
        self.disturbed = false;
        // Hours of rest take one step.
        if self.shaft.is_resting() && !self.have_inputs_changed() {
            self.shaft.pass_rest(ticks);
            self.check_protections();
            return;
        }
        for tick in 1..=ticks {
            self.tick(from.plus_ns(tick * polepair_core::plant::TICK_NS));
        }
    }

    fn tick(&mut self, now: Instant) {
        // Inputs first: what they switch off does not run for another tick.
        self.handle_inputs(now);
        match self.mode() {
            _ if !self.shaft.is_powered() => {}
            MODE_POSITION => self.with_motion(now, Motion::tick),
            MODE_CANOPEN => self.tick_canopen(),
            _ => {
                self.update_external();
                self.hold_at_limits();
            }
        }
        self.protections.tick(&mut self.shaft);
        self.check_protections();
    }

    fn check_protections(&mut self) {
        if let Some(alarm) = self.motion.take_alarm() {
            self.raise_alarm(alarm);
        }
        let feels = self.motion.seeks_hard_stop() || self.canopen.seeks_hard_stop();
        if let Some(alarm) = self.protections.check(&mut self.shaft, feels) {
            self.raise_alarm(alarm);
        }
    }

    fn with_motion(&mut self, now: Instant, act: impl FnOnce(&mut Motion, &mut TickContext<'_>)) {
        let position = self.shaft.motor().position();
        let seeks = self.motion.seeks_home_switch();
        let is_end = |toward| seeks && self.lines.is_search_end(toward, position);
        let mut scene = TickContext {
            now,
            zero_in_turns: self.options.zero_in_turns,
            home: self.is_input_closed(InputPurpose::Home, position),
            home_at: self.lines.home_at,
            forward_limit: self.is_input_closed(InputPurpose::ForwardLimit, position)
                || is_end(1.0),
            reverse_limit: self.is_input_closed(InputPurpose::ReverseLimit, position)
                || is_end(-1.0),
            shaft: &mut self.shaft,
            registers: &self.registers,
        };
        act(&mut self.motion, &mut scene);
    }

    pub(super) fn is_input_closed(&self, purpose: InputPurpose, position: f64) -> bool {
        self.lines.is_closed(purpose, position)
    }

    /// Outside internal position mode a limit switch only keeps the motor from going on `[I]`.
    fn hold_at_limits(&mut self) {
        let position = self.shaft.motor().position();
        let speed = self.shaft.setpoint().velocity;
        let forward = speed > 0.0 && self.lines.is_closed(InputPurpose::ForwardLimit, position);
        let reverse = speed < 0.0 && self.lines.is_closed(InputPurpose::ReverseLimit, position);
        if forward || reverse {
            self.shaft.halt();
            self.shaft.set_limits(default_ramp(TOP_RPM * TAU / 60.0));
        } else {
            self.shaft.settle_position();
        }
    }

    /// Inputs with an effect of their own, by the purposes of `was`.
    fn wired_inputs(&self) -> [bool; 4] {
        const ACTING: [InputPurpose; 4] = [
            InputPurpose::ServoOn,
            InputPurpose::AlarmClear,
            InputPurpose::PathTrigger,
            InputPurpose::HomingTrigger,
        ];
        ACTING.map(|purpose| self.lines.is_closed(purpose, 0.0))
    }

    fn have_inputs_changed(&self) -> bool {
        self.wired_inputs() != self.previous_inputs
    }

    fn handle_inputs(&mut self, now: Instant) {
        let wired = self.wired_inputs();
        let was = core::mem::replace(&mut self.previous_inputs, wired);
        // Cleared before the motor is powered, so that both inputs together start the drive.
        if rises_at(1, &wired, &was) {
            self.clear_alarm();
        }
        if rises_at(0, &wired, &was) {
            self.power_on();
        } else if was[0] && !wired[0] && !self.is_enabled_without_input() {
            self.power_off();
        }
        let by_inputs = self.registers.value(fn_registers::TRIGGER_SOURCE) == 0;
        if by_inputs && self.runs_paths() {
            if rises_at(2, &wired, &was) {
                self.with_motion(now, Motion::trigger_path);
            }
            if rises_at(3, &wired, &was) {
                self.with_motion(now, Motion::trigger_homing);
            }
        }
    }

    fn runs_paths(&self) -> bool {
        self.mode() == MODE_POSITION && self.shaft.is_powered()
    }

    /// Fn_38 powers the motor in the two internal modes, the controlword in CANopen mode.
    fn is_enabled_without_input(&self) -> bool {
        let internal = matches!(self.mode(), MODE_SPEED | MODE_POSITION);
        self.mode() == MODE_CANOPEN || (internal && self.registers.value(fn_registers::ENABLE) == 1)
    }

    /// Powers the motor if the mode, the alarm and the bus permit it. It holds its position, then follows the
    /// mode.
    fn power_on(&mut self) {
        let by_register = self.registers.value(fn_registers::ENABLE) == 1;
        let internal = matches!(self.mode(), MODE_SPEED | MODE_POSITION);
        let wired = self.lines.is_closed(InputPurpose::ServoOn, 0.0);
        let wanted = (by_register && internal) || wired || self.jogging;
        if self.shaft.is_powered() || !wanted || self.mode() == MODE_CANOPEN {
            return;
        }
        if self.alarm.is_some() {
            self.registers.set(fn_registers::ENABLE, 0);
            return;
        }
        if !shaft::is_bus_ready(&self.shaft) {
            return self.raise_alarm(Alarm::DE);
        }
        self.shaft.power_on();
        self.shaft.set_limits(default_ramp(TOP_RPM * TAU / 60.0));
        match self.mode() {
            MODE_SPEED => self.update_speed(),
            MODE_POSITION => self.with_motion(self.now, Motion::handle_powered),
            _ => self.external.drop_pulses(),
        }
        // Pulses that came without power must not make it jump.
        self.pulse_target = self.shaft.position();
    }

    fn power_off(&mut self) {
        self.shaft.power_off();
        self.motion.handle_released();
    }

    /// An alarm takes the power off, and Fn_38 with it, so that clearing it starts nothing `[I]`.
    fn raise_alarm(&mut self, alarm: Alarm) {
        // The first alarm stays: the others follow from it.
        if self.alarm.is_some() || !alarm.is_some() {
            return;
        }
        self.alarm = alarm;
        self.power_off();
        self.jogging = false;
        self.registers.set(fn_registers::ENABLE, 0);
        let known = self.profile.faults.iter().find(|f| f.code == u32::from(alarm.0));
        self.notice = Some(known.map_or("alarm", |fault| fault.name));
        self.fault_canopen();
    }

    fn clear_alarm(&mut self) {
        self.alarm = Alarm::NONE;
        self.reset_canopen();
        self.protections.reset(&mut self.shaft);
        if has_duplicates(self.lines.purposes()) {
            self.raise_alarm(Alarm::ID);
        }
    }

    fn toggle_jog(&mut self) {
        self.jogging = !self.jogging;
        if self.jogging {
            self.power_on()
        } else {
            self.power_off()
        }
        self.jogging &= self.shaft.is_powered();
    }

    fn update_speed(&mut self) {
        let rpm = f64::from(self.registers.signed(fn_registers::SPEED));
        self.shaft.set_velocity(rpm * TAU / 60.0);
    }

    fn update_jog(&mut self) {
        if self.jogging && self.mode() == MODE_JOG {
            self.shaft.set_velocity(self.jog * JOG_RPM * TAU / 60.0);
        }
    }

    /// Modes 0, 2 and 4 follow inputs other than the line. The manual does not document which two of them a
    /// mixed mode has, and which input selects: those hold.
    fn update_external(&mut self) {
        match self.mode() {
            MODE_ANALOG => self.shaft.set_velocity(self.limit_direction(self.external.speed())),
            MODE_TORQUE => {
                let limit = f64::from(self.registers.value(fn_registers::TORQUE_SPEED));
                let share = self.external.torque(shaft::rpm(&self.shaft), limit);
                self.shaft.apply_torque(self.limit_direction(share));
            }
            MODE_PULSES => {
                let step = self.external.take_rotation();
                if self.limit_direction(step) != 0.0 {
                    self.pulse_target += step;
                    self.shaft.move_to(self.pulse_target);
                }
            }
            _ => {}
        }
    }

    /// The speed limited by limit switches: zero toward a closed switch `[I]`.
    fn limit_direction(&self, wanted: f64) -> f64 {
        let position = self.shaft.motor().position();
        let limit =
            if wanted > 0.0 { InputPurpose::ForwardLimit } else { InputPurpose::ReverseLimit };
        if self.lines.is_closed(limit, position) { 0.0 } else { wanted }
    }

    fn dn_reading(&self, number: u16) -> u16 {
        let ds102 = self.options.ds102;
        match number {
            dn_registers::SPEED => rounded_word(shaft::rpm(&self.shaft)),
            dn_registers::ALARM => self.alarm.0,
            dn_registers::PATH_STATE => u16::from(self.motion.is_busy()),
            dn_registers::POSITION_LOW => self.position_counts() as u16,
            dn_registers::POSITION_HIGH => (self.position_counts() >> 16) as u16,
            dn_registers::LOAD if ds102 => rounded_word(self.shaft.torque() * 1000.0),
            dn_registers::VERSION if ds102 => VERSION,
            dn_registers::TEMPERATURE if ds102 => rounded_word(self.shaft.temperature()),
            _ => 0,
        }
    }

    fn position_counts(&self) -> i32 {
        shaft::counts(&self.shaft, self.motion.origin())
    }

    /// Reacts to a write.
    fn handle_written(&mut self, number: u16, before: u16, value: u16) {
        let rises = before == 0 && value == 1;
        let by_registers = self.registers.value(fn_registers::TRIGGER_SOURCE) == 1;
        match number {
            fn_registers::MODE if before != value => self.change_mode(),
            fn_registers::ENABLE if value == 1 => self.power_on(),
            fn_registers::ENABLE if self.mode() == MODE_CANOPEN => {}
            fn_registers::ENABLE if !self.lines.is_closed(InputPurpose::ServoOn, 0.0) => {
                self.power_off()
            }
            fn_registers::SPEED if self.mode() == MODE_SPEED && self.shaft.is_powered() => {
                self.update_speed()
            }
            fn_registers::PATH_TRIGGER if rises && by_registers && self.runs_paths() => {
                self.with_motion(self.now, Motion::trigger_path);
            }
            fn_registers::HOMING_TRIGGER if rises && by_registers && self.runs_paths() => {
                self.with_motion(self.now, Motion::trigger_homing);
            }
            fn_registers::PATH_STOP if value == 1 && self.runs_paths() => {
                self.with_motion(self.now, Motion::stop_path);
            }
            fn_registers::CLEAR if value == 1 && self.options.ds102 => self.clear_alarm(),
            0x2A..=0x2C if self.options.ds102 => self.update_current_limit(),
            _ => {}
        }
        self.check_protections();
    }

    /// A new mode starts unpowered `[I]`.
    fn change_mode(&mut self) {
        self.power_off();
        self.reset_canopen();
        self.jogging = false;
        self.registers.set(fn_registers::ENABLE, 0);
    }

    /// Fn_2A = 1 limits the current to a share of the rated peak value (DS102).
    fn update_current_limit(&mut self) {
        let peak = shaft::RATED_CURRENT * core::f64::consts::SQRT_2;
        let share = f64::from(self.registers.signed(0x2B).unsigned_abs()) / 100.0;
        let limited = self.registers.value(0x2A) == 1;
        self.shaft.limit_current(if limited { share * peak } else { f64::INFINITY });
    }
}

fn rounded_word(value: f64) -> u16 {
    // A register that ran over would show a high speed as one in reverse.
    nearest(value).clamp(-0x8000, 0x7FFF) as u16
}

fn rises_at(at: usize, wired: &[bool; 4], was: &[bool; 4]) -> bool {
    wired[at] && !was[at]
}
