//! Internal position mode: runs and chains paths, homes and stops (TS manual V2 §2.6).
//!
//! Positions are those of the shaft by the encoder, in rad. The user's coordinate is the distance to
//! `origin`, which homing sets.

use core::f64::consts::TAU;

use super::alarm::Alarm;
use super::homing::{AfterHoming, HomingMark, HomingMethod, HomingStart};
use super::registers::{Registers, fn_registers};
use super::shaft;
use crate::stored_paths::{PATH_MAX, PathDefinition, PathEnd, PathType};
use polepair_core::plant::{Limits, ServoShaft};
use polepair_core::time::Instant;

/// Ticks of the torque signal that count as a stop `[I]`.
// Longer than the peak of current at a start, which must not be taken for the stop.
const TORQUE_TICKS: u16 = 50;
/// Ramp of homing, of jogging and of internal speed mode: from rest to 3000 rpm in 200 ms `[I]`.
pub const RAMP: f64 = 3000.0 / 60.0 * TAU / 0.2;

/// The state around a motion during a tick.
#[derive(Debug)]
pub struct TickContext<'a> {
    /// The tick's end.
    pub now: Instant,
    /// The motor.
    pub shaft: &'a mut ServoShaft,
    /// The registers.
    pub registers: &'a Registers,
    /// Fn_203 and Fn_204 are turns and pulses.
    pub zero_in_turns: bool,
    /// The home switch is closed.
    pub home: bool,
    /// Position of the home switch, if it is known more exactly than by the tick.
    pub home_at: Option<f64>,
    /// The positive limit switch (CCWL) is closed.
    pub forward_limit: bool,
    /// The negative limit switch (CWL) is closed.
    pub reverse_limit: bool,
}

impl TickContext<'_> {
    fn register(&self, number: u16) -> u16 {
        self.registers.value(number)
    }

    /// Position of the Z pulse in this tick, if there was one: at whole turns.
    fn index_pulse(&self) -> Option<f64> {
        let (was, is) =
            (whole_turns(self.shaft.previous_position()), whole_turns(self.shaft.position()));
        // The turn that was entered last, whichever way the shaft turns.
        (was != is).then(|| was.max(is) * TAU)
    }
}

fn whole_turns(position: f64) -> f64 {
    libm::floor(position / TAU)
}

/// Task of the motor.
#[derive(Clone, Copy, PartialEq, Debug)]
enum MotionTask {
    /// Holding.
    Idle,
    /// On a path. A SPEED path with a delay ends at `until`.
    Path { path: PathDefinition, until: Option<Instant> },
    /// Waiting to go on with a path, or for nothing.
    Pause { until: Instant, next: Option<u8> },
    /// Looking for the mark of a way of homing.
    Search { way: HomingMethod, home: Option<bool>, toward: f64, turned: bool, torque: u16 },
    /// Turning slowly to the Z pulse.
    SearchZPulse { way: HomingMethod },
    /// Coming to rest after the zero.
    Settle { way: HomingMethod, zero: f64 },
    /// Going back to the zero.
    Align { way: HomingMethod, zero: f64 },
    /// Decelerates to rest after a stop.
    Stopping,
}

/// The engine of internal position mode.
#[derive(Clone, Debug)]
pub struct Motion {
    task: MotionTask,
    origin: f64,
    /// End of the last command, rad of the shaft.
    commanded: f64,
    homed: bool,
    unrepeatable: u64,
    alarm: Option<Alarm>,
}

impl Motion {
    /// At rest at shaft position `position`, which gets coordinate 0.
    #[must_use]
    pub fn new(position: f64) -> Self {
        Self {
            task: MotionTask::Idle,
            origin: position,
            commanded: position,
            homed: false,
            unrepeatable: 0,
            alarm: None,
        }
    }

    /// True while a path or homing runs: Dn_1C.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        self.task != MotionTask::Idle
    }

    /// True while homing searches, so that a blocked shaft is no fault.
    #[must_use]
    pub fn seeks_hard_stop(&self) -> bool {
        matches!(self.task, MotionTask::Search { way, .. } if way.mark == HomingMark::Torque)
    }

    /// True while homing searches the home switch.
    #[must_use]
    pub fn seeks_home_switch(&self) -> bool {
        matches!(self.task, MotionTask::Search { way, .. } if way.mark == HomingMark::HomeSwitch)
    }

    /// True once homing has found the zero.
    #[must_use]
    pub const fn is_homed(&self) -> bool {
        self.homed
    }

    /// The shaft position that has coordinate 0, rad.
    #[must_use]
    pub const fn origin(&self) -> f64 {
        self.origin
    }

    /// Gives that shaft position (rad) coordinate 0.
    pub const fn set_origin(&mut self, position: f64) {
        self.origin = position;
    }

    /// Triggers that started something which a repetition would have started again.
    #[must_use]
    pub const fn unrepeatable(&self) -> u64 {
        self.unrepeatable
    }

    /// An alarm that a path raised, once.
    pub const fn take_alarm(&mut self) -> Option<Alarm> {
        self.alarm.take()
    }

    /// The motor was powered: holds its position, and homes if Fn_200 requests it.
    pub fn handle_powered(&mut self, scene: &mut TickContext<'_>) {
        self.task = MotionTask::Idle;
        self.commanded = scene.shaft.position();
        let way = HomingMethod::decode(scene.register(fn_registers::HOMING_WAY));
        // Once: a zero that was found stays valid until the supply is gone.
        if let Some(way) = way.filter(|way| way.start == HomingStart::AtEnable && !self.homed) {
            self.start_search(way, scene);
        }
    }

    /// Power was removed: ends any motion.
    pub fn handle_released(&mut self) {
        self.task = MotionTask::Idle;
    }

    /// The path trigger, with the path of Fn_20B.
    pub fn trigger_path(&mut self, scene: &mut TickContext<'_>) {
        let Ok(number) = u8::try_from(scene.register(fn_registers::PATH_NUMBER)) else { return };
        if is_blocked(scene) || !(1..=PATH_MAX).contains(&number) {
            return;
        }
        if !self.is_busy() || read_path(scene.registers, number).interrupts {
            self.unrepeatable += 1;
            self.start_path(number, scene);
        }
    }

    /// The homing trigger. A running path is not interrupted `[I]`.
    pub fn trigger_homing(&mut self, scene: &mut TickContext<'_>) {
        let Some(way) = HomingMethod::decode(scene.register(fn_registers::HOMING_WAY)) else {
            self.alarm = Some(Alarm::PA);
            return;
        };
        let wanted = matches!(way.start, HomingStart::AtEnable | HomingStart::ByTrigger);
        if wanted && !self.is_busy() && !is_blocked(scene) {
            self.unrepeatable += 1;
            self.start_search(way, scene);
        }
    }

    /// Fn_20E = 1: stops along the path's deceleration, or at once (Fn_209).
    pub fn stop_path(&mut self, scene: &mut TickContext<'_>) {
        if scene.register(fn_registers::STOP_SETTING) == 1 {
            scene.shaft.halt();
        } else if self.is_busy() {
            scene.shaft.set_velocity(0.0);
        }
        if self.is_busy() {
            self.task = MotionTask::Stopping;
        }
    }

    /// Advances the motion. Called before each tick of the shaft.
    pub fn tick(&mut self, scene: &mut TickContext<'_>) {
        // By the set-point: a shaft that rolls back into a switch by its load must not be stopped from leaving
        // it.
        let speed = scene.shaft.setpoint().velocity;
        if (speed > 0.0 && scene.forward_limit) || (speed < 0.0 && scene.reverse_limit) {
            self.handle_limit(scene);
        }
        match self.task {
            MotionTask::Idle => scene.shaft.settle_position(),
            MotionTask::Path { path, until } => self.tick_path(path, until, scene),
            MotionTask::Pause { until, next } if scene.now >= until => {
                self.task = MotionTask::Idle;
                if let Some(number) = next {
                    self.start_path(number, scene);
                }
            }
            MotionTask::Pause { .. } => scene.shaft.settle_position(),
            MotionTask::Stopping if scene.shaft.has_arrived() => {
                self.commanded = scene.shaft.setpoint().position;
                self.task = MotionTask::Idle;
            }
            MotionTask::Stopping => {}
            _ => self.tick_homing(scene),
        }
    }

    /// Starts a path from the present set-point.
    fn start_path(&mut self, number: u8, scene: &mut TickContext<'_>) {
        let path = read_path(scene.registers, number);
        let turns = path
            .turns(scene.register(fn_registers::MOTOR_TURNS), scene.register(fn_registers::TRAVEL));
        let positioning = matches!(path.kind, PathType::Single | PathType::Auto);
        let turns = match turns {
            // A path without a type, or one that would never arrive `[I]`.
            _ if matches!(path.kind, PathType::Unknown(_)) => return self.refuse_path(Alarm::PA),
            _ if positioning && path.rpm == 0 => return self.refuse_path(Alarm::SL),
            Some(turns) => turns,
            None => return self.refuse_path(Alarm::PA),
        };
        // Before the goal is set, so that not a tick of it runs with the limits of the path before.
        scene.shaft.set_limits(path_limits(&path));
        if positioning {
            // Relative paths count from here on, even if this one is interrupted (§2.6.1).
            self.commanded = turns * TAU + self.coordinate_base(path.end, scene);
            scene.shaft.move_to(self.commanded);
        } else {
            scene.shaft.set_velocity(rad_per_s(path.rpm) * direction_of(turns));
        }
        // A SPEED path's delay counts from its trigger (§2.6.1); 0 is for ever.
        let timed = path.kind == PathType::Speed && path.delay_ms > 0;
        let until = timed.then(|| scene.now.plus_ms(u32::from(path.delay_ms)));
        self.task = MotionTask::Path { path, until };
    }

    fn refuse_path(&mut self, alarm: Alarm) {
        self.alarm = Some(alarm);
    }

    /// The base of a coordinate.
    fn coordinate_base(&self, end: PathEnd, scene: &TickContext<'_>) -> f64 {
        match end {
            PathEnd::Coordinate => self.origin,
            PathEnd::LastCommand => self.commanded,
            PathEnd::Feedback => scene.shaft.position(),
        }
    }

    fn tick_path(
        &mut self,
        path: PathDefinition,
        until: Option<Instant>,
        scene: &mut TickContext<'_>,
    ) {
        if path.kind == PathType::Speed {
            self.commanded = scene.shaft.position();
            match path.next {
                _ if until.is_none_or(|until| scene.now < until) => {}
                Some(next) => self.start_path(next, scene),
                // Nothing to load: it comes to rest `[I]`.
                None => self.stop_path(scene),
            }
        } else if shaft::is_in_position(scene.shaft) {
            let next = path.next.filter(|_| path.kind == PathType::Auto);
            let until = scene.now.plus_ms(u32::from(path.delay_ms));
            self.task = MotionTask::Pause { until, next };
        }
    }

    fn start_search(&mut self, way: HomingMethod, scene: &mut TickContext<'_>) {
        let slow =
            way.z_search || matches!(way.after, AfterHoming::Align | AfterHoming::Unknown(_));
        if is_register_zero(fn_registers::HOMING_SPEED, scene)
            || (slow && is_register_zero(fn_registers::HOMING_SLOW, scene))
        {
            // It would never arrive `[I]`.
            return self.refuse_path(Alarm::SL);
        }
        // While it searches, the old zero is no reference any more.
        self.homed = false;
        let toward = way.direction;
        self.task = MotionTask::Search { way, home: None, toward, turned: false, torque: 0 };
        set_homing_speed(scene, fn_registers::HOMING_SPEED, toward);
    }

    fn tick_homing(&mut self, scene: &mut TickContext<'_>) {
        match self.task {
            MotionTask::Search { way, .. } => {
                if let Some(zero) = self.find_mark(scene) {
                    self.handle_mark(way, zero, scene);
                }
            }
            MotionTask::SearchZPulse { way } => {
                if let Some(zero) = scene.index_pulse() {
                    self.handle_zero(way, zero, scene);
                }
            }
            MotionTask::Settle { way, zero } if scene.shaft.has_arrived() => match way.after {
                AfterHoming::Align | AfterHoming::Unknown(_) => {
                    let slow = rad_per_s(scene.register(fn_registers::HOMING_SLOW));
                    scene.shaft.set_limits(default_ramp(slow));
                    scene.shaft.move_to(zero);
                    self.task = MotionTask::Align { way, zero };
                }
                AfterHoming::Path(_) | AfterHoming::Stop => self.finish_homing(way, zero, scene),
            },
            MotionTask::Align { way, zero } if shaft::is_in_position(scene.shaft) => {
                self.finish_homing(way, zero, scene)
            }
            _ => {}
        }
    }

    /// Position of the mark, if it was found in this tick.
    fn find_mark(&mut self, scene: &TickContext<'_>) -> Option<f64> {
        let MotionTask::Search { way, home, torque, .. } = &mut self.task else { return None };
        let here = scene.shaft.position();
        match way.mark {
            HomingMark::HomeSwitch => {
                // An edge needs two looks: a switch that is closed from the start is no edge.
                let was = home.replace(scene.home)?;
                (was != scene.home).then(|| scene.home_at.unwrap_or(here))
            }
            HomingMark::LimitSwitch if way.direction > 0.0 => scene.forward_limit.then_some(here),
            HomingMark::LimitSwitch => scene.reverse_limit.then_some(here),
            HomingMark::ZPulse => scene.index_pulse(),
            HomingMark::Torque => {
                *torque = if scene.shaft.is_torque_limited() { *torque + 1 } else { 0 };
                (*torque >= TORQUE_TICKS).then_some(here)
            }
        }
    }

    /// Handles the mark: it is the zero, or the Z pulse after it is. Away from a limit switch the pulse is
    /// searched backwards `[I]`.
    fn handle_mark(&mut self, way: HomingMethod, zero: f64, scene: &mut TickContext<'_>) {
        if way.z_search {
            let back = way.mark == HomingMark::LimitSwitch;
            let toward = if back { -way.direction } else { way.direction };
            self.task = MotionTask::SearchZPulse { way };
            set_homing_speed(scene, fn_registers::HOMING_SLOW, toward);
        } else {
            self.handle_zero(way, zero, scene);
        }
    }

    fn handle_zero(&mut self, way: HomingMethod, zero: f64, scene: &mut TickContext<'_>) {
        if way.after == AfterHoming::Stop || way.mark == HomingMark::Torque {
            scene.shaft.halt();
        } else {
            scene.shaft.set_velocity(0.0);
        }
        self.task = MotionTask::Settle { way, zero };
    }

    fn finish_homing(&mut self, way: HomingMethod, zero: f64, scene: &mut TickContext<'_>) {
        self.homed = true;
        self.origin = zero - zero_coordinate(scene.registers, scene.zero_in_turns);
        self.commanded = scene.shaft.setpoint().position;
        let after = u8::try_from(scene.register(fn_registers::HOMING_PATH)).unwrap_or(0);
        let next = match way.after {
            AfterHoming::Path(number) => Some(number),
            _ => (1..=PATH_MAX).contains(&after).then_some(after),
        };
        let until = scene.now.plus_ms(u32::from(scene.register(fn_registers::HOMING_DELAY)));
        self.task = MotionTask::Pause { until, next };
    }

    /// A limit switch ends a path. Homing that searches another mark turns round once; a limit that
    /// is itself the mark is left to the search `[I]`.
    fn handle_limit(&mut self, scene: &mut TickContext<'_>) {
        match &mut self.task {
            MotionTask::Search { way, .. }
            | MotionTask::Settle { way, .. }
            | MotionTask::SearchZPulse { way }
                if way.mark == HomingMark::LimitSwitch => {}
            MotionTask::Search { toward, turned, .. } if !*turned => {
                *turned = true;
                *toward = -*toward;
                debug_assert!(*toward == 1.0 || *toward == -1.0, "a direction is a sign");
                let back = *toward * scene.shaft.top_speed();
                scene.shaft.set_velocity(back);
            }
            // On the way round it still rolls a little further into the switch.
            MotionTask::Search { toward, .. }
                if *toward * scene.shaft.setpoint().velocity < 0.0 => {}
            MotionTask::Stopping => {}
            _ => {
                scene.shaft.halt();
                self.task = MotionTask::Stopping;
            }
        }
    }
}

fn is_register_zero(number: u16, scene: &TickContext<'_>) -> bool {
    scene.register(number) == 0
}

fn is_blocked(scene: &TickContext<'_>) -> bool {
    scene.register(fn_registers::PATH_STOP) == 1
}

fn set_homing_speed(scene: &mut TickContext<'_>, register: u16, toward: f64) {
    let speed = rad_per_s(scene.register(register));
    scene.shaft.set_limits(default_ramp(speed));
    scene.shaft.set_velocity(speed * toward);
}

/// The path of that number as its registers now are.
fn read_path(registers: &Registers, number: u8) -> PathDefinition {
    let nth = u16::from(number) - 1;
    PathDefinition::decode(
        [0, 1, 2, 3, 4, 5, 6, 7]
            .map(|offset| registers.value(fn_registers::PATHS + 8 * nth + offset)),
        registers.value(fn_registers::S_TIMES + nth),
    )
}

/// Times of a path as slopes. Rounding both ends of a ramp of Ta by Ts, within Ta, takes a steeper
/// middle: speed ÷ (Ta - Ts).
fn path_limits(path: &PathDefinition) -> Limits {
    let speed = rad_per_s(path.rpm);
    Limits {
        velocity: speed,
        acceleration: ramp_slope(path.acceleration_ms, speed, path.s_ms),
        deceleration: ramp_slope(path.deceleration_ms, speed, path.s_ms),
        smoothing_s: f64::from(path.s_ms) / 1000.0,
    }
}

fn ramp_slope(ms: u16, speed: f64, path_s_ms: u16) -> f64 {
    // Ta/2 must be greater than Ts (§2.6.1); what was written before a limit existed is cut here.
    let rounded = path_s_ms.min(ms / 2);
    let seconds = f64::from(ms - rounded) / 1000.0;
    if seconds > 0.0 { speed / seconds } else { 0.0 }
}

/// The ramp where no path gives one.
#[must_use]
pub fn default_ramp(velocity: f64) -> Limits {
    Limits::trapezoid(velocity, RAMP)
}

fn rad_per_s(rpm: u16) -> f64 {
    f64::from(rpm) * TAU / 60.0
}

/// A positive coordinate, and none, turn forward (§2.6.1).
fn direction_of(turns: f64) -> f64 {
    if turns < 0.0 { -1.0 } else { 1.0 }
}

/// The coordinate that the zero gets, rad. The manual's table calls Fn_203 and Fn_204 high and low word, its text
/// "number of turns" and "pulses of a turn", both in mm: one signed number of thousandths of the mechanics' unit, or
/// turns and encoder counts of the motor `[I]`.
fn zero_coordinate(registers: &Registers, in_turns: bool) -> f64 {
    let high = i32::from(registers.signed(fn_registers::ZERO_HIGH));
    let low = registers.value(fn_registers::ZERO_LOW);
    if in_turns {
        return (f64::from(high) + f64::from(low) / shaft::COUNTS_PER_TURN) * TAU;
    }
    let units = f64::from(high << 16 | i32::from(low)) / 1000.0;
    let ratio = f64::from(registers.value(fn_registers::MOTOR_TURNS));
    // A travel of zero would divide by zero; the drive has no such value from the factory.
    units * ratio / f64::from(registers.value(fn_registers::TRAVEL).max(1)) * TAU
}
