//! One axis: the power state machine, and what each mode of operation makes of the objects.

mod cyclic;
mod profiled;

use super::follow::Cycle;
use super::homing::{Found, Homing};
use super::point::{Point, Points};
use super::power::{Change, Order, State, change};
use super::watch::Watch;
use super::{Braking, Settings, Shaft, modes};
use crate::plant::Limits;

/// Bits of the controlword that modes use.
const NEW_POINT: u16 = 1 << 4;
const AT_ONCE: u16 = 1 << 5;
const RELATIVE: u16 = 1 << 6;
const RESET: u16 = 1 << 7;
const HALT: u16 = 1 << 8;
const PASSING: u16 = 1 << 9;

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

/// What differs between makers where the standard leaves it open, or is not followed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Manner {
    /// Bit 9 of the statusword is set.
    pub remote: bool,
    /// A fault shows bit 7 and hides bit 4.
    pub fault_warns: bool,
    /// From ready it takes switched on before enabled.
    pub in_turn: bool,
    /// Homing goes on when bit 4 falls.
    pub homing_by_edge: bool,
}

/// What the motion has to do with at a call.
#[derive(Debug)]
pub struct Scene<'a, S, T> {
    /// The motor.
    pub shaft: &'a mut S,
    /// The objects.
    pub settings: &'a T,
    /// The home switch is closed.
    pub home: bool,
    /// Where the home switch's edge is, if its place is known better than by the tick.
    pub home_at: Option<f64>,
    /// The positive limit switch is closed.
    pub positive: bool,
    /// The negative limit switch is closed.
    pub negative: bool,
}

impl<S: Shaft, T> Scene<'_, S, T> {
    /// A limit switch is closed in that direction.
    pub(super) fn blocked(&self, toward: f64) -> bool {
        (toward > 0.0 && self.positive) || (toward < 0.0 && self.negative)
    }

    /// Where the edge of a switch is that was just crossed.
    pub(super) fn edge_at(&self, home: bool) -> f64 {
        self.home_at.filter(|_| home).unwrap_or(self.shaft.position())
    }
}

/// Something that the family may want to tell.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Event {
    /// The motor is too far behind its set-point.
    FollowingError,
    /// The target was reached.
    Arrived,
}

/// A drive's motion. `N` set-points wait for the one that runs. It lies in memory in this order.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct Axis<const N: usize> {
    state: State,
    manner: Manner,
    mode: i8,
    control: u16,
    /// Bits 10 to 13 of the statusword.
    flags: u16,
    /// It comes to rest, then leaves for that state.
    leaving: Option<State>,
    /// Something that the mode goes by has changed.
    dirty: bool,
    limited: bool,
    acknowledged: bool,
    through: bool,
    homing_failed: bool,
    homed: bool,
    /// The shaft position of coordinate 0, rad.
    origin: f64,
    cycle: Cycle,
    behind: Watch,
    window: Watch,
    slow: Watch,
    /// Torque demand, share of the rated one.
    torque: f64,
    /// End of the last command, user's coordinate.
    commanded: Option<f64>,
    homing: Homing,
    running: Option<Point>,
    points: Points<N>,
}

impl<const N: usize> Axis<N> {
    /// After power-on, with the shaft at `position` (rad), which gets coordinate 0.
    #[must_use]
    pub fn new(manner: Manner, position: f64) -> Self {
        Self {
            state: State::SwitchOnDisabled,
            manner,
            mode: 0,
            control: 0,
            flags: 0,
            leaving: None,
            dirty: false,
            limited: false,
            acknowledged: false,
            through: false,
            homing_failed: false,
            homed: false,
            origin: position,
            commanded: None,
            torque: 0.0,
            cycle: Cycle::default(),
            window: Watch::default(),
            slow: Watch::default(),
            behind: Watch::default(),
            homing: Homing::new(),
            running: None,
            points: Points::new(),
        }
    }

    /// Where it is in the power state machine.
    #[must_use]
    pub const fn state(&self) -> State {
        self.state
    }

    /// The mode in force (6061h).
    #[must_use]
    pub const fn mode(&self) -> i8 {
        self.mode
    }

    /// The controlword as last written.
    #[must_use]
    pub const fn control_word(&self) -> u16 {
        self.control
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
    pub const fn feels_for_stop(&self) -> bool {
        self.homing.feels_for_stop()
    }

    /// The statusword. `voltage`: the motor's supply is there.
    #[must_use]
    pub const fn status(&self, voltage: bool) -> u16 {
        let fault = matches!(self.state, State::Fault);
        let warned = self.manner.fault_warns & fault;
        let flags = if self.state.has_power() { self.flags } else { 0 };
        self.state.bits()
            | bit(voltage & !warned, VOLTAGE)
            | bit(warned, WARNING)
            | bit(self.manner.remote, REMOTE)
            | bit(self.limited, LIMITED)
            | flags
    }

    /// An object changed that the mode goes by: the mode itself, a target, a ramp.
    #[inline]
    pub fn changed<S: Shaft, T: Settings>(&mut self, scene: &mut Scene<'_, S, T>) {
        self.dirty = true;
        if scene.settings.mode() != self.mode {
            self.take_mode(scene);
        }
        let settings = scene.settings;
        // A new target is not reached by what was reached before.
        let left = match self.mode {
            modes::PROFILE_VELOCITY => {
                let distance = scene.shaft.velocity() - settings.target_velocity();
                distance.abs() > settings.velocity_window().width
            }
            modes::PROFILE_TORQUE => self.torque != settings.target_torque(),
            _ => false,
        };
        if left {
            self.set(REACHED, false);
        }
    }

    /// The controlword was written. `clear` says that no cause of a fault lasts. Returns whether a
    /// motion began that repeating the word would not double, but a new edge would.
    pub fn control<S: Shaft, T: Settings>(
        &mut self,
        word: u16,
        clear: bool,
        scene: &mut Scene<'_, S, T>,
    ) -> bool {
        let before = core::mem::replace(&mut self.control, word);
        if word == before {
            return false;
        }
        let rises = word & !before;
        self.dirty = true;
        if rises & RESET != 0 && self.state == State::Fault && clear {
            self.state = State::SwitchOnDisabled;
        }
        let (_, stays) = scene.settings.quick_stop_option();
        self.order(change(self.state, Order::of(word), stays, self.manner.in_turn), scene);
        if self.state == State::Enabled && Order::of(word) == Order::Enable {
            self.leaving = None;
            return self.mode_bits(rises, before & !word, scene);
        }
        false
    }

    /// A fault: power goes off, after coming to rest if 605Eh says so.
    pub fn fault<S: Shaft, T: Settings>(&mut self, scene: &mut Scene<'_, S, T>) {
        let how = scene.settings.fault_option();
        let brakes = self.state.has_power() && how != Braking::Coast;
        self.forget();
        if brakes {
            self.state = State::FaultReaction;
            self.brake(how, scene);
        } else {
            self.state = State::Fault;
            scene.shaft.release();
        }
    }

    /// Quick stop, as the controlword would order it: for a lost link.
    pub fn quick_stop<S: Shaft, T: Settings>(&mut self, scene: &mut Scene<'_, S, T>) {
        if self.state == State::Enabled {
            self.order(Change::QuickStop, scene);
        }
    }

    /// Power off, as the controlword's disable voltage orders it.
    pub fn disable<S: Shaft, T: Settings>(&mut self, scene: &mut Scene<'_, S, T>) {
        if self.state.has_power() {
            self.order(Change::To(State::SwitchOnDisabled), scene);
        }
    }

    /// A SYNC came: what the host commands each cycle counts from here on.
    #[inline]
    pub fn sync<S: Shaft, T: Settings>(&mut self, scene: &mut Scene<'_, S, T>) {
        if self.mode == modes::CYCLIC_POSITION && self.state == State::Enabled {
            self.aim(scene);
        }
    }

    /// The host makes the way, cycle by cycle: [`follow`](Self::follow) is the next tick.
    #[inline]
    #[must_use]
    pub const fn follows(&self) -> bool {
        let enabled = matches!(self.state, State::Enabled) && self.leaving.is_none();
        enabled && self.mode == modes::CYCLIC_POSITION
    }

    /// One tick of the host's way, for whoever would rather not prepare all that other modes need.
    #[inline]
    pub fn follow<S: Shaft, T: Settings>(&mut self, scene: &mut Scene<'_, S, T>) -> Option<Event> {
        self.cyclic_position(scene)
    }

    /// To be called before each tick of the shaft.
    pub fn tick<S: Shaft, T: Settings>(&mut self, scene: &mut Scene<'_, S, T>) -> Option<Event> {
        match self.state {
            State::Enabled => self.enabled(scene),
            State::QuickStop | State::FaultReaction => {
                self.come_to_rest(scene);
                None
            }
            _ => None,
        }
    }

    fn enabled<S: Shaft, T: Settings>(&mut self, scene: &mut Scene<'_, S, T>) -> Option<Event> {
        if self.leaving.is_some() {
            self.come_to_rest(scene);
            return None;
        }
        if self.is_halted() {
            return self.stand(scene);
        }
        let dirty = core::mem::take(&mut self.dirty);
        match self.mode {
            modes::PROFILE_POSITION => self.position(dirty, scene),
            modes::PROFILE_VELOCITY => self.velocity(dirty, scene),
            modes::PROFILE_TORQUE => self.drive(scene),
            modes::HOMING => self.home(scene),
            modes::CYCLIC_POSITION => self.cyclic_position(scene),
            modes::CYCLIC_VELOCITY => self.cyclic_velocity(scene),
            modes::CYCLIC_TORQUE => self.cyclic_torque(scene),
            _ => None,
        }
    }

    fn order<S: Shaft, T: Settings>(&mut self, change: Change, scene: &mut Scene<'_, S, T>) {
        match change {
            Change::None => {}
            Change::To(state) => {
                if self.state.has_power() {
                    self.forget();
                    scene.shaft.release();
                }
                self.state = state;
            }
            Change::Enable => self.enable(scene),
            Change::QuickStop => {
                self.forget();
                let (how, _) = scene.settings.quick_stop_option();
                if how == Braking::Coast {
                    return self.order(Change::To(State::SwitchOnDisabled), scene);
                }
                self.state = State::QuickStop;
                self.brake(how, scene);
            }
            Change::Leave(state) => {
                let how = match state {
                    State::Ready => scene.settings.shutdown_option(),
                    _ => scene.settings.disable_option(),
                };
                if how == Braking::Coast {
                    return self.order(Change::To(state), scene);
                }
                self.forget();
                self.leaving = Some(state);
                self.brake(how, scene);
            }
        }
    }

    fn enable<S: Shaft, T: Settings>(&mut self, scene: &mut Scene<'_, S, T>) {
        if !self.state.has_power() {
            scene.shaft.power();
        }
        self.state = State::Enabled;
        self.take_mode(scene);
    }

    /// Whatever ran has ended; what was waiting is lost.
    fn forget(&mut self) {
        self.points.clear();
        self.running = None;
        self.through = false;
        self.acknowledged = false;
        self.commanded = None;
        self.leaving = None;
        self.limited = false;
        self.flags = 0;
        self.torque = 0.0;
        self.homing.end();
        self.window.reset();
        self.slow.reset();
        self.behind.reset();
    }

    /// The mode of 6060h comes into force, with nothing commanded in it yet. A motor that turns in
    /// another mode is braked.
    fn take_mode<S: Shaft, T: Settings>(&mut self, scene: &mut Scene<'_, S, T>) {
        self.mode = scene.settings.mode();
        self.forget();
        self.homing_failed = false;
        self.dirty = true;
        if self.state == State::Enabled {
            self.cycle = Cycle::resting(scene.shaft.position() - self.origin);
            self.brake(Braking::Ramp, scene);
        }
    }

    /// What bits 4 to 9 of the controlword do in the mode. Returns whether a new edge would do it
    /// again.
    fn mode_bits<S: Shaft, T: Settings>(
        &mut self,
        rises: u16,
        falls: u16,
        scene: &mut Scene<'_, S, T>,
    ) -> bool {
        if rises & HALT != 0 {
            self.homing.end();
            self.set(REACHED, false);
            self.brake(scene.settings.halt_option(), scene);
        }
        let begins = rises & NEW_POINT != 0;
        match self.mode {
            modes::PROFILE_POSITION if begins => self.new_point(scene),
            modes::PROFILE_POSITION => self.free_acknowledge(),
            modes::HOMING if begins && !self.is_halted() => {
                self.flags = 0;
                self.homed = false;
                self.homing_failed = !self.homing.begin(scene);
            }
            modes::HOMING if falls & NEW_POINT != 0 && !self.manner.homing_by_edge => {
                self.interrupt_homing(scene);
            }
            _ => return false,
        }
        begins
    }

    fn interrupt_homing<S: Shaft, T: Settings>(&mut self, scene: &mut Scene<'_, S, T>) {
        if self.homing.runs() {
            self.homing.end();
            self.brake(Braking::Ramp, scene);
        }
    }

    const fn is_halted(&self) -> bool {
        let cyclic = matches!(self.mode, 8..=10);
        self.control & HALT != 0 && !cyclic
    }

    /// Comes to rest as `how` says.
    fn brake<S: Shaft, T: Settings>(&self, how: Braking, scene: &mut Scene<'_, S, T>) {
        let profile = scene.settings.profile();
        let deceleration = match how {
            Braking::Coast | Braking::Ramp => profile.deceleration,
            Braking::Quick => scene.settings.quick_stop(),
            Braking::Hard => 0.0,
        };
        scene.shaft.manner(Limits { velocity: f64::INFINITY, deceleration, ..profile });
        scene.shaft.turn(0.0);
    }

    /// On the way out of operation.
    fn come_to_rest<S: Shaft, T: Settings>(&mut self, scene: &mut Scene<'_, S, T>) {
        if !at_rest(scene.shaft) {
            return;
        }
        let (_, stays) = scene.settings.quick_stop_option();
        let next = match self.state {
            State::QuickStop if stays => {
                self.flags |= REACHED;
                return scene.shaft.settle();
            }
            State::QuickStop => State::SwitchOnDisabled,
            State::FaultReaction => State::Fault,
            _ => self.leaving.unwrap_or(State::SwitchedOn),
        };
        self.leaving = None;
        self.state = next;
        self.flags = 0;
        scene.shaft.release();
    }

    /// Halted: bit 10 tells that it is at rest.
    fn stand<S: Shaft, T: Settings>(&mut self, scene: &mut Scene<'_, S, T>) -> Option<Event> {
        let rest = at_rest(scene.shaft);
        self.torque = 0.0;
        self.set(REACHED, rest);
        if rest {
            scene.shaft.settle();
        }
        self.dirty = true;
        None
    }

    const fn set(&mut self, bits: u16, on: bool) {
        self.flags = if on { self.flags | bits } else { self.flags & !bits };
    }

    /// The user's coordinate of a shaft position.
    fn user(&self, position: f64) -> f64 {
        position - self.origin
    }
}

/// One bit of the statusword, or none.
const fn bit(on: bool, bit: u16) -> u16 {
    on as u16 * bit
}

/// At rest, as far as the drive can tell.
fn at_rest(shaft: &impl Shaft) -> bool {
    shaft.arrived() && shaft.velocity().abs() < AT_REST
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
