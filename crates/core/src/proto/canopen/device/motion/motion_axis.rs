//! One axis: the power state machine, and the operation modes.

mod cyclic;
mod profiled;

use super::homing::{Homing, HomingResult};
use super::interpolator::Interpolator;
use super::point::{PointQueue, ProfilePoint};
use super::power::{PowerCommand, PowerState, StateChange, change_for};
use super::window_timer::WindowTimer;
use super::{Braking, MotionSettings, modes};
use crate::plant::{Limits, ServoShaft};

/// Bits of the controlword that modes use.
const NEW_POINT: u16 = 1 << 4;
const CHANGE_AT_ONCE: u16 = 1 << 5;
const RELATIVE: u16 = 1 << 6;
const RESET: u16 = 1 << 7;
const HALT: u16 = 1 << 8;
const CHANGE_IN_PASSING: u16 = 1 << 9;

/// Bits of the statusword.
const VOLTAGE: u16 = 1 << 4;
const WARNING: u16 = 1 << 7;
const REMOTE: u16 = 1 << 9;
const REACHED: u16 = 1 << 10;
const LIMITED: u16 = 1 << 11;
const BIT_12: u16 = 1 << 12;
const BIT_13: u16 = 1 << 13;

/// Slower than this is at rest, rad/s.
const AT_REST: f64 = 0.5;

/// Differences between makers where the standard is open or not followed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct MotionQuirks {
    /// Bit 9 of the statusword is set.
    pub sets_remote_bit: bool,
    /// A fault shows bit 7 and hides bit 4.
    pub fault_warns: bool,
    /// From ready it takes switched on before enabled.
    pub enables_stepwise: bool,
    /// Homing goes on when bit 4 falls.
    pub homing_by_edge: bool,
}

/// The state around a motion during a call.
#[derive(Debug)]
pub struct MotionContext<'a, T> {
    /// The motor.
    pub shaft: &'a mut ServoShaft,
    /// The objects.
    pub settings: &'a T,
    /// The home switch is closed.
    pub home: bool,
    /// Position of the home switch's edge, if it is known more exactly than by the tick.
    pub home_at: Option<f64>,
    /// The positive limit switch is closed.
    pub positive: bool,
    /// The negative limit switch is closed.
    pub negative: bool,
}

impl<T> MotionContext<'_, T> {
    /// A limit switch is closed in that direction.
    pub(super) fn is_blocked(&self, toward: f64) -> bool {
        (toward > 0.0 && self.positive) || (toward < 0.0 && self.negative)
    }

    /// Position of the edge of a switch that was just crossed.
    pub(super) fn edge_position(&self, home: bool) -> f64 {
        self.home_at.filter(|_| home).unwrap_or(self.shaft.position())
    }
}

/// An event that the family may report.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum MotionEvent {
    /// The motor is too far behind its set-point.
    FollowingError,
    /// The target was reached.
    Arrived,
}

/// A drive's motion. `N` set-points wait for the one that runs. It lies in memory in this order.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct MotionAxis<const N: usize> {
    state: PowerState,
    manner: MotionQuirks,
    mode: i8,
    controlword: u16,
    /// Bits 10 to 13 of the statusword.
    flags: u16,
    /// State that it enters after it has stopped.
    leaving_for: Option<PowerState>,
    /// Something that the mode goes by has changed.
    needs_update: bool,
    limited: bool,
    acknowledged: bool,
    passes_through: bool,
    homing_failed: bool,
    homed: bool,
    /// The shaft position of coordinate 0, rad.
    origin: f64,
    interpolator: Interpolator,
    following_timer: WindowTimer,
    target_timer: WindowTimer,
    standstill_timer: WindowTimer,
    /// Torque demand, share of the rated one.
    torque: f64,
    /// End of the last command, user's coordinate.
    commanded: Option<f64>,
    homing: Homing,
    current_point: Option<ProfilePoint>,
    queued_points: PointQueue<N>,
}

impl<const N: usize> MotionAxis<N> {
    /// After power-on, with the shaft at `position` (rad), which gets coordinate 0.
    #[must_use]
    pub fn new(manner: MotionQuirks, position: f64) -> Self {
        Self {
            state: PowerState::SwitchOnDisabled,
            manner,
            mode: 0,
            controlword: 0,
            flags: 0,
            leaving_for: None,
            needs_update: false,
            limited: false,
            acknowledged: false,
            passes_through: false,
            homing_failed: false,
            homed: false,
            origin: position,
            commanded: None,
            torque: 0.0,
            interpolator: Interpolator::default(),
            target_timer: WindowTimer::default(),
            standstill_timer: WindowTimer::default(),
            following_timer: WindowTimer::default(),
            homing: Homing::new(),
            current_point: None,
            queued_points: PointQueue::new(),
        }
    }

    /// State of the power state machine.
    #[must_use]
    pub const fn state(&self) -> PowerState {
        self.state
    }

    /// Returns whether interpolated position runs and its last record is used up.
    #[inline]
    #[must_use]
    pub const fn needs_record(&self) -> bool {
        self.is_interpolating() && self.interpolator.is_over()
    }

    const fn is_interpolating(&self) -> bool {
        let enabled = matches!(self.state, PowerState::Enabled) && self.leaving_for.is_none();
        let active = self.controlword & (NEW_POINT | HALT) == NEW_POINT;
        enabled && active && self.mode == modes::INTERPOLATED_POSITION
    }

    /// The mode in force (6061h).
    #[must_use]
    pub const fn mode(&self) -> i8 {
        self.mode
    }

    /// The controlword as last written.
    #[must_use]
    pub const fn control_word(&self) -> u16 {
        self.controlword
    }

    /// The shaft position of coordinate 0, rad.
    #[must_use]
    pub const fn origin(&self) -> f64 {
        self.origin
    }

    /// Torque demand, share of the rated torque.
    #[must_use]
    pub const fn torque_demand(&self) -> f64 {
        self.torque
    }

    /// Homing pushes against a stop, so that a blocked shaft is no fault.
    #[must_use]
    pub const fn seeks_hard_stop(&self) -> bool {
        self.homing.seeks_hard_stop()
    }

    /// A search for the home position runs.
    #[must_use]
    pub fn is_homing(&self) -> bool {
        self.homing.is_running()
    }

    /// The statusword. `voltage`: the motor's supply is there.
    #[must_use]
    pub const fn status(&self, voltage: bool) -> u16 {
        let fault = matches!(self.state, PowerState::Fault);
        let warned = self.manner.fault_warns & fault;
        let flags = if self.state.has_power() { self.flags } else { 0 };
        self.state.bits()
            | bit(voltage & !warned, VOLTAGE)
            | bit(warned, WARNING)
            | bit(self.manner.sets_remote_bit, REMOTE)
            | bit(self.limited, LIMITED)
            | flags
    }

    /// An object changed that the mode goes by: the mode itself, a target, a ramp.
    #[inline]
    pub fn handle_object_change<T: MotionSettings>(&mut self, scene: &mut MotionContext<'_, T>) {
        self.needs_update = true;
        if scene.settings.mode() != self.mode {
            self.enter_mode(scene);
        }
        let settings = scene.settings;
        // A new target is not reached by what was reached before.
        let left = match self.mode {
            modes::VELOCITY | modes::PROFILE_VELOCITY => {
                let distance = scene.shaft.velocity() - settings.target_velocity();
                distance.abs() > settings.velocity_window().width
            }
            modes::PROFILE_TORQUE => self.torque != settings.target_torque(),
            _ => false,
        };
        if left {
            self.set_flags(REACHED, false);
        }
    }

    /// Handles a write of the controlword. `clear` means that no cause of a fault lasts. Returns whether a
    /// motion started that a repeated word would not start again, but a new edge would.
    pub fn handle_controlword<T: MotionSettings>(
        &mut self,
        word: u16,
        clear: bool,
        scene: &mut MotionContext<'_, T>,
    ) -> bool {
        let before = core::mem::replace(&mut self.controlword, word);
        if word == before {
            return false;
        }
        let rises = word & !before;
        self.needs_update = true;
        if rises & RESET != 0 && self.state == PowerState::Fault && clear {
            self.state = PowerState::SwitchOnDisabled;
        }
        let (_, stays) = scene.settings.quick_stop_option();
        self.apply_change(
            change_for(self.state, PowerCommand::of(word), stays, self.manner.enables_stepwise),
            scene,
        );
        if self.state == PowerState::Enabled && PowerCommand::of(word) == PowerCommand::Enable {
            self.leaving_for = None;
            return self.handle_mode_bits(rises, before & !word, scene);
        }
        false
    }

    /// Handles a fault: removes power, after a deceleration if 605Eh states one.
    pub fn handle_fault<T: MotionSettings>(&mut self, scene: &mut MotionContext<'_, T>) {
        let how = scene.settings.fault_option();
        let brakes = self.state.has_power() && how != Braking::Coast;
        self.clear_commands();
        if brakes {
            self.state = PowerState::FaultReaction;
            self.brake(how, scene);
        } else {
            self.state = PowerState::Fault;
            scene.shaft.power_off();
        }
    }

    /// Quick stop, as the controlword would order it: for a lost link.
    pub fn quick_stop<T: MotionSettings>(&mut self, scene: &mut MotionContext<'_, T>) {
        if self.state == PowerState::Enabled {
            self.apply_change(StateChange::QuickStop, scene);
        }
    }

    /// Power off, as the controlword's disable voltage orders it.
    pub fn disable<T: MotionSettings>(&mut self, scene: &mut MotionContext<'_, T>) {
        if self.state.has_power() {
            self.apply_change(StateChange::To(PowerState::SwitchOnDisabled), scene);
        }
    }

    /// Handles a SYNC: cyclic commands take effect.
    #[inline]
    pub fn handle_sync<T: MotionSettings>(&mut self, scene: &mut MotionContext<'_, T>) {
        if self.mode == modes::CYCLIC_POSITION && self.state == PowerState::Enabled {
            let target = scene.settings.target_position() + scene.settings.offsets().position;
            self.aim_interpolator(target, scene);
        } else if self.is_interpolating() {
            self.aim_interpolator(scene.settings.interpolation_target(), scene);
        }
    }

    /// The host makes the way, cycle by cycle: [`tick_following`](Self::tick_following) is the next tick.
    #[inline]
    #[must_use]
    pub const fn is_following(&self) -> bool {
        let enabled = matches!(self.state, PowerState::Enabled) && self.leaving_for.is_none();
        enabled && self.mode == modes::CYCLIC_POSITION
    }

    /// One tick of following cyclic commands, without the preparation that other modes need.
    #[inline]
    pub fn tick_following<T: MotionSettings>(
        &mut self,
        scene: &mut MotionContext<'_, T>,
    ) -> Option<MotionEvent> {
        self.tick_cyclic_position(scene)
    }

    /// To be called before each tick of the shaft.
    pub fn tick<T: MotionSettings>(
        &mut self,
        scene: &mut MotionContext<'_, T>,
    ) -> Option<MotionEvent> {
        match self.state {
            PowerState::Enabled => self.tick_enabled(scene),
            PowerState::QuickStop | PowerState::FaultReaction => {
                self.come_to_rest(scene);
                None
            }
            _ => None,
        }
    }

    fn tick_enabled<T: MotionSettings>(
        &mut self,
        scene: &mut MotionContext<'_, T>,
    ) -> Option<MotionEvent> {
        if self.leaving_for.is_some() {
            self.come_to_rest(scene);
            return None;
        }
        if self.is_halted() {
            return self.tick_halted(scene);
        }
        let dirty = core::mem::take(&mut self.needs_update);
        match self.mode {
            modes::PROFILE_POSITION => self.tick_position(dirty, scene),
            modes::VELOCITY | modes::PROFILE_VELOCITY => self.tick_velocity(dirty, scene),
            modes::PROFILE_TORQUE => self.tick_torque(scene),
            modes::HOMING => self.tick_homing(scene),
            modes::INTERPOLATED_POSITION => self.tick_interpolated(scene),
            modes::CYCLIC_POSITION => self.tick_cyclic_position(scene),
            modes::CYCLIC_VELOCITY => self.tick_cyclic_velocity(scene),
            modes::CYCLIC_TORQUE => self.tick_cyclic_torque(scene),
            _ => None,
        }
    }

    fn apply_change<T: MotionSettings>(
        &mut self,
        change: StateChange,
        scene: &mut MotionContext<'_, T>,
    ) {
        match change {
            StateChange::None => {}
            StateChange::To(state) => {
                if self.state.has_power() {
                    self.clear_commands();
                    scene.shaft.power_off();
                }
                self.state = state;
            }
            StateChange::Enable => self.enable(scene),
            StateChange::QuickStop => {
                self.clear_commands();
                let (how, _) = scene.settings.quick_stop_option();
                if how == Braking::Coast {
                    return self.apply_change(StateChange::To(PowerState::SwitchOnDisabled), scene);
                }
                self.state = PowerState::QuickStop;
                self.brake(how, scene);
            }
            StateChange::LeaveOperation(state) => {
                let how = match state {
                    PowerState::Ready => scene.settings.shutdown_option(),
                    _ => scene.settings.disable_option(),
                };
                if how == Braking::Coast {
                    return self.apply_change(StateChange::To(state), scene);
                }
                self.clear_commands();
                self.leaving_for = Some(state);
                self.brake(how, scene);
            }
        }
    }

    fn enable<T: MotionSettings>(&mut self, scene: &mut MotionContext<'_, T>) {
        if !self.state.has_power() {
            scene.shaft.power_on();
        }
        self.state = PowerState::Enabled;
        self.enter_mode(scene);
    }

    /// Clears running and pending commands.
    fn clear_commands(&mut self) {
        self.queued_points.clear();
        self.current_point = None;
        self.passes_through = false;
        self.acknowledged = false;
        self.commanded = None;
        self.leaving_for = None;
        self.limited = false;
        self.flags = 0;
        self.torque = 0.0;
        self.homing.end();
        self.target_timer.reset();
        self.standstill_timer.reset();
        self.following_timer.reset();
    }

    /// The mode of 6060h comes into force, with nothing commanded in it yet. A motor that turns in
    /// another mode is braked.
    fn enter_mode<T: MotionSettings>(&mut self, scene: &mut MotionContext<'_, T>) {
        self.mode = scene.settings.mode();
        self.clear_commands();
        self.homing_failed = false;
        self.needs_update = true;
        if self.state == PowerState::Enabled {
            self.interpolator = Interpolator::at_rest(scene.shaft.position() - self.origin);
            self.brake(Braking::Ramp, scene);
        }
    }

    /// Executes bits 4 to 9 of the controlword in the mode. Returns whether a new edge would repeat it.
    fn handle_mode_bits<T: MotionSettings>(
        &mut self,
        rises: u16,
        falls: u16,
        scene: &mut MotionContext<'_, T>,
    ) -> bool {
        if rises & HALT != 0 {
            self.homing.end();
            self.set_flags(REACHED, false);
            self.brake(scene.settings.halt_option(), scene);
        }
        let begins = rises & NEW_POINT != 0;
        match self.mode {
            modes::PROFILE_POSITION if begins => self.handle_new_point(scene),
            modes::PROFILE_POSITION => self.free_acknowledge(),
            modes::HOMING if begins && !self.is_halted() => {
                self.flags = 0;
                self.homed = false;
                self.homing_failed = !self.homing.begin(scene);
            }
            modes::INTERPOLATED_POSITION => {
                if begins || falls & HALT != 0 {
                    let at = scene.shaft.setpoint().position - self.origin;
                    self.interpolator = Interpolator::at_rest(at);
                } else if falls & NEW_POINT != 0 {
                    self.brake(Braking::Ramp, scene);
                }
            }
            modes::HOMING if falls & NEW_POINT != 0 && !self.manner.homing_by_edge => {
                self.interrupt_homing(scene);
            }
            _ => return false,
        }
        begins
    }

    fn interrupt_homing<T: MotionSettings>(&mut self, scene: &mut MotionContext<'_, T>) {
        if self.homing.is_running() {
            self.homing.end();
            self.brake(Braking::Ramp, scene);
        }
    }

    const fn is_halted(&self) -> bool {
        let cyclic = matches!(self.mode, 8..=10);
        self.controlword & HALT != 0 && !cyclic
    }

    /// Decelerates to rest in this way.
    fn brake<T: MotionSettings>(&self, how: Braking, scene: &mut MotionContext<'_, T>) {
        scene.shaft.offset_torque(0.0);
        let profile = scene.settings.profile();
        let deceleration = match how {
            Braking::Coast | Braking::Ramp => profile.deceleration,
            Braking::Quick => scene.settings.quick_stop(),
            Braking::Hard => 0.0,
        };
        scene.shaft.set_limits(Limits { velocity: f64::INFINITY, deceleration, ..profile });
        scene.shaft.set_velocity(0.0);
    }

    /// On the way out of operation.
    fn come_to_rest<T: MotionSettings>(&mut self, scene: &mut MotionContext<'_, T>) {
        if !is_at_rest(scene.shaft) {
            return;
        }
        let (_, stays) = scene.settings.quick_stop_option();
        let next = match self.state {
            PowerState::QuickStop if stays => {
                self.flags |= REACHED;
                return scene.shaft.settle_position();
            }
            PowerState::QuickStop => PowerState::SwitchOnDisabled,
            PowerState::FaultReaction => PowerState::Fault,
            _ => self.leaving_for.unwrap_or(PowerState::SwitchedOn),
        };
        self.leaving_for = None;
        self.state = next;
        self.flags = 0;
        scene.shaft.power_off();
    }

    /// One tick of a halt: bit 10 reports the rest.
    fn tick_halted<T: MotionSettings>(
        &mut self,
        scene: &mut MotionContext<'_, T>,
    ) -> Option<MotionEvent> {
        let rest = is_at_rest(scene.shaft);
        self.torque = 0.0;
        self.set_flags(REACHED, rest);
        if rest {
            scene.shaft.settle_position();
        }
        self.needs_update = true;
        None
    }

    const fn set_flags(&mut self, bits: u16, on: bool) {
        self.flags = if on { self.flags | bits } else { self.flags & !bits };
    }

    /// The user's coordinate of a shaft position.
    fn user_coordinate(&self, position: f64) -> f64 {
        position - self.origin
    }
}

/// One bit of the statusword, or none.
const fn bit(on: bool, bit: u16) -> u16 {
    on as u16 * bit
}

/// At rest, as far as the drive can detect it.
fn is_at_rest(shaft: &ServoShaft) -> bool {
    shaft.has_arrived() && shaft.velocity().abs() < AT_REST
}

/// -1, 0 or 1.
pub(super) fn signum(value: f64) -> f64 {
    if value > 0.0 {
        1.0
    } else if value < 0.0 {
        -1.0
    } else {
        0.0
    }
}
