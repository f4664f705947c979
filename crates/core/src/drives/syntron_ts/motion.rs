//! Internal position mode: runs paths, chains them, homes and stops (TS manual V2 §2.6).
//!
//! Positions are those of the shaft as the encoder sees it, rad; the user's coordinate is the
//! distance to `origin`, which homing sets.

use core::f64::consts::TAU;

use super::alarm::Alarm;
use super::homing::{After, Mark, Start, Way};
use super::paths::{End, Kind, PATH_MAX, Path};
use super::registers::{Registers, fns};
use super::shaft::Shaft;
use crate::plant::Limits;
use crate::time::Instant;

/// The torque signal must last so many ticks to count as a stop `[I]`.
const TORQUE_TICKS: u16 = 50;
/// Ramp of homing, of jogging and of internal speed mode: from rest to 3000 rpm in 200 ms `[I]`.
pub const RAMP: f64 = 3000.0 / 60.0 * TAU / 0.2;

/// What the motion has to do with at a tick.
#[derive(Debug)]
pub struct Scene<'a> {
    /// The tick's end.
    pub now: Instant,
    /// The motor.
    pub shaft: &'a mut Shaft,
    /// The registers.
    pub registers: &'a Registers,
    /// The home switch is closed.
    pub home: bool,
    /// Where the home switch is, if its place is known better than by the tick.
    pub home_at: Option<f64>,
    /// The positive limit switch (CCWL) is closed.
    pub forward_limit: bool,
    /// The negative limit switch (CWL) is closed.
    pub reverse_limit: bool,
}

impl Scene<'_> {
    fn register(&self, number: u16) -> u16 {
        self.registers.value(number)
    }

    /// Where the Z pulse of this tick was, if there was one: it comes at whole turns.
    fn index(&self) -> Option<f64> {
        let turns = |position: f64| libm::floor(position / TAU);
        let (was, is) = (turns(self.shaft.before()), turns(self.shaft.position()));
        (was != is).then(|| was.max(is) * TAU)
    }
}

/// What the motor is doing.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Task {
    /// Holding.
    Idle,
    /// On a path. A SPEED path with a delay ends at `until`.
    Path { path: Path, until: Option<Instant> },
    /// Waiting to go on with a path, or for nothing.
    Pause { until: Instant, next: Option<u8> },
    /// Looking for the mark of a way of homing.
    Search { way: Way, home: Option<bool>, toward: f64, turned: bool, torque: u16 },
    /// Turning slowly to the Z pulse.
    SlowZ { way: Way },
    /// Coming to rest after the zero.
    Settle { way: Way, zero: f64 },
    /// Going back to the zero.
    Align { way: Way, zero: f64 },
    /// Coming to rest because it was told to stop.
    Stopping,
}

/// The engine of internal position mode.
#[derive(Clone, Debug)]
pub struct Motion {
    task: Task,
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
            task: Task::Idle,
            origin: position,
            commanded: position,
            homed: false,
            unrepeatable: 0,
            alarm: None,
        }
    }

    /// True while a path or homing runs: Dn_1C.
    #[must_use]
    pub fn busy(&self) -> bool {
        self.task != Task::Idle
    }

    /// True while homing searches, so that a blocked shaft is no fault.
    #[must_use]
    pub fn feels_for_stop(&self) -> bool {
        matches!(self.task, Task::Search { way, .. } if way.mark == Mark::Torque)
    }

    /// True once homing has found the zero.
    #[must_use]
    pub const fn homed(&self) -> bool {
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

    /// The motor was just powered: it holds, and homes where Fn_200 says so.
    pub fn powered(&mut self, scene: &mut Scene<'_>) {
        self.task = Task::Idle;
        self.commanded = scene.shaft.position();
        let way = Way::decode(scene.register(fns::HOMING_WAY));
        if let Some(way) = way.filter(|way| way.start == Start::AtEnable && !self.homed) {
            self.search(way, scene);
        }
    }

    /// Power was taken off the motor: whatever ran has ended.
    pub fn released(&mut self) {
        self.task = Task::Idle;
    }

    /// The path trigger, with the path of Fn_20B.
    pub fn trigger(&mut self, scene: &mut Scene<'_>) {
        let Ok(number) = u8::try_from(scene.register(fns::PATH_NUMBER)) else { return };
        if blocked(scene) || !(1..=PATH_MAX).contains(&number) {
            return;
        }
        if !self.busy() || path(scene.registers, number).interrupts {
            self.unrepeatable += 1;
            self.start(number, scene);
        }
    }

    /// The homing trigger. A running path is not interrupted `[I]`.
    pub fn trigger_homing(&mut self, scene: &mut Scene<'_>) {
        let Some(way) = Way::decode(scene.register(fns::HOMING_WAY)) else {
            self.alarm = Some(Alarm::PA);
            return;
        };
        let wanted = matches!(way.start, Start::AtEnable | Start::ByTrigger);
        if wanted && !self.busy() && !blocked(scene) {
            self.unrepeatable += 1;
            self.search(way, scene);
        }
    }

    /// Fn_20E = 1: stops along the path's deceleration, or at once (Fn_209).
    pub fn stop(&mut self, scene: &mut Scene<'_>) {
        if scene.register(fns::STOP_SETTING) == 1 {
            scene.shaft.halt();
        } else if self.busy() {
            scene.shaft.brake();
        }
        if self.busy() {
            self.task = Task::Stopping;
        }
    }

    /// What runs goes on: to be called before each tick of the shaft.
    pub fn tick(&mut self, scene: &mut Scene<'_>) {
        let speed = scene.shaft.setpoint().velocity;
        if (speed > 0.0 && scene.forward_limit) || (speed < 0.0 && scene.reverse_limit) {
            self.at_limit(scene);
        }
        match self.task {
            Task::Idle => scene.shaft.settle(),
            Task::Path { path, until } => self.on_path(path, until, scene),
            Task::Pause { until, next } if scene.now >= until => {
                self.task = Task::Idle;
                if let Some(number) = next {
                    self.start(number, scene);
                }
            }
            Task::Pause { .. } => scene.shaft.settle(),
            Task::Stopping if scene.shaft.arrived() => {
                self.commanded = scene.shaft.setpoint().position;
                self.task = Task::Idle;
            }
            Task::Stopping => {}
            _ => self.homing(scene),
        }
    }

    /// Starts a path from whatever the set-point does now.
    fn start(&mut self, number: u8, scene: &mut Scene<'_>) {
        let path = path(scene.registers, number);
        let turns = path.turns(scene.register(fns::MOTOR_TURNS), scene.register(fns::TRAVEL));
        let positioning = matches!(path.kind, Kind::Single | Kind::Auto);
        let turns = match turns {
            // A path without a type, or one that would never arrive `[I]`.
            _ if matches!(path.kind, Kind::Unknown(_)) => return self.refuse(Alarm::PA),
            _ if positioning && path.rpm == 0 => return self.refuse(Alarm::SL),
            Some(turns) => turns,
            None => return self.refuse(Alarm::PA),
        };
        scene.shaft.manner(limits(&path));
        if positioning {
            self.commanded = turns * TAU + self.base(path.end, scene);
            scene.shaft.go(self.commanded);
        } else {
            scene.shaft.turn(rad_per_s(path.rpm) * sign(turns));
        }
        // A SPEED path's delay counts from its trigger (§2.6.1); 0 is for ever.
        let timed = path.kind == Kind::Speed && path.delay_ms > 0;
        let until = timed.then(|| scene.now.plus_ms(u32::from(path.delay_ms)));
        self.task = Task::Path { path, until };
    }

    fn refuse(&mut self, alarm: Alarm) {
        self.alarm = Some(alarm);
    }

    /// What a coordinate counts from.
    fn base(&self, end: End, scene: &Scene<'_>) -> f64 {
        match end {
            End::Coordinate => self.origin,
            End::LastCommand => self.commanded,
            End::Feedback => scene.shaft.position(),
        }
    }

    fn on_path(&mut self, path: Path, until: Option<Instant>, scene: &mut Scene<'_>) {
        if path.kind == Kind::Speed {
            self.commanded = scene.shaft.position();
            match path.next {
                _ if until.is_none_or(|until| scene.now < until) => {}
                Some(next) => self.start(next, scene),
                // Nothing to load: it comes to rest `[I]`.
                None => self.stop(scene),
            }
        } else if scene.shaft.in_position() {
            let next = path.next.filter(|_| path.kind == Kind::Auto);
            let until = scene.now.plus_ms(u32::from(path.delay_ms));
            self.task = Task::Pause { until, next };
        }
    }

    fn search(&mut self, way: Way, scene: &mut Scene<'_>) {
        let slow = way.z_search || matches!(way.after, After::Align | After::Unknown(_));
        let still = |number| scene.register(number) == 0;
        if still(fns::HOMING_SPEED) || (slow && still(fns::HOMING_SLOW)) {
            // It would never arrive `[I]`.
            return self.refuse(Alarm::SL);
        }
        self.homed = false;
        let toward = way.direction;
        self.task = Task::Search { way, home: None, toward, turned: false, torque: 0 };
        homing_speed(scene, fns::HOMING_SPEED, toward);
    }

    fn homing(&mut self, scene: &mut Scene<'_>) {
        match self.task {
            Task::Search { way, .. } => {
                if let Some(zero) = self.mark(scene) {
                    self.marked(way, zero, scene);
                }
            }
            Task::SlowZ { way } => {
                if let Some(zero) = scene.index() {
                    self.zeroed(way, zero, scene);
                }
            }
            Task::Settle { way, zero } if scene.shaft.arrived() => match way.after {
                After::Align | After::Unknown(_) => {
                    let slow = rad_per_s(scene.register(fns::HOMING_SLOW));
                    scene.shaft.manner(ramp(slow));
                    scene.shaft.go(zero);
                    self.task = Task::Align { way, zero };
                }
                After::Path(_) | After::Stop => self.finish(way, zero, scene),
            },
            Task::Align { way, zero } if scene.shaft.in_position() => self.finish(way, zero, scene),
            _ => {}
        }
    }

    /// Where the mark that is searched is, if it came in this tick.
    fn mark(&mut self, scene: &Scene<'_>) -> Option<f64> {
        let Task::Search { way, home, torque, .. } = &mut self.task else { return None };
        let here = scene.shaft.position();
        match way.mark {
            Mark::HomeSwitch => {
                let was = home.replace(scene.home)?;
                (was != scene.home).then(|| scene.home_at.unwrap_or(here))
            }
            Mark::LimitSwitch if way.direction > 0.0 => scene.forward_limit.then_some(here),
            Mark::LimitSwitch => scene.reverse_limit.then_some(here),
            Mark::ZPulse => scene.index(),
            Mark::Torque => {
                *torque = if scene.shaft.torque_reached() { *torque + 1 } else { 0 };
                (*torque >= TORQUE_TICKS).then_some(here)
            }
        }
    }

    /// The mark came: it is the zero, or the Z pulse after it is. Away from a limit switch the
    /// pulse is searched backwards `[I]`.
    fn marked(&mut self, way: Way, zero: f64, scene: &mut Scene<'_>) {
        if way.z_search {
            let back = way.mark == Mark::LimitSwitch;
            let toward = if back { -way.direction } else { way.direction };
            self.task = Task::SlowZ { way };
            homing_speed(scene, fns::HOMING_SLOW, toward);
        } else {
            self.zeroed(way, zero, scene);
        }
    }

    fn zeroed(&mut self, way: Way, zero: f64, scene: &mut Scene<'_>) {
        if way.after == After::Stop || way.mark == Mark::Torque {
            scene.shaft.halt();
        } else {
            scene.shaft.brake();
        }
        self.task = Task::Settle { way, zero };
    }

    fn finish(&mut self, way: Way, zero: f64, scene: &mut Scene<'_>) {
        self.homed = true;
        self.origin = zero - zero_coordinate(scene.registers);
        self.commanded = scene.shaft.setpoint().position;
        let after = u8::try_from(scene.register(fns::HOMING_PATH)).unwrap_or(0);
        let next = match way.after {
            After::Path(number) => Some(number),
            _ => (1..=PATH_MAX).contains(&after).then_some(after),
        };
        let until = scene.now.plus_ms(u32::from(scene.register(fns::HOMING_DELAY)));
        self.task = Task::Pause { until, next };
    }

    /// A limit switch ends a path. Homing that searches another mark turns round once; a limit that
    /// is itself the mark is left to the search `[I]`.
    fn at_limit(&mut self, scene: &mut Scene<'_>) {
        match &mut self.task {
            Task::Search { way, .. } | Task::Settle { way, .. } | Task::SlowZ { way }
                if way.mark == Mark::LimitSwitch => {}
            Task::Search { toward, turned, .. } if !*turned => {
                *turned = true;
                *toward = -*toward;
                let back = *toward * scene.shaft.top_speed();
                scene.shaft.turn(back);
            }
            // On the way round it still rolls a little further into the switch.
            Task::Search { toward, .. } if *toward * scene.shaft.setpoint().velocity < 0.0 => {}
            Task::Stopping => {}
            _ => {
                scene.shaft.halt();
                self.task = Task::Stopping;
            }
        }
    }
}

fn blocked(scene: &Scene<'_>) -> bool {
    scene.register(fns::PATH_STOP) == 1
}

fn homing_speed(scene: &mut Scene<'_>, register: u16, toward: f64) {
    let speed = rad_per_s(scene.register(register));
    scene.shaft.manner(ramp(speed));
    scene.shaft.turn(speed * toward);
}

/// The path of that number as its registers now are.
fn path(registers: &Registers, number: u8) -> Path {
    let nth = u16::from(number) - 1;
    let word = |offset| registers.value(fns::PATHS + 8 * nth + offset);
    Path::decode([0, 1, 2, 3, 4, 5, 6, 7].map(word), registers.value(fns::S_TIMES + nth))
}

/// Times of a path as slopes. Rounding both ends of a ramp of Ta by Ts, within Ta, takes a steeper
/// middle: speed ÷ (Ta - Ts).
fn limits(path: &Path) -> Limits {
    let speed = rad_per_s(path.rpm);
    let slope = |ms: u16| {
        let rounded = path.s_ms.min(ms / 2);
        let seconds = f64::from(ms - rounded) / 1000.0;
        if seconds > 0.0 { speed / seconds } else { 0.0 }
    };
    Limits {
        velocity: speed,
        acceleration: slope(path.acceleration_ms),
        deceleration: slope(path.deceleration_ms),
        smoothing_s: f64::from(path.s_ms) / 1000.0,
    }
}

/// The ramp where no path gives one.
#[must_use]
pub fn ramp(velocity: f64) -> Limits {
    Limits::trapezoid(velocity, RAMP)
}

fn rad_per_s(rpm: u16) -> f64 {
    f64::from(rpm) * TAU / 60.0
}

/// A positive coordinate, and none, turn forward (§2.6.1).
fn sign(turns: f64) -> f64 {
    if turns < 0.0 { -1.0 } else { 1.0 }
}

/// The coordinate that the zero gets, rad: Fn_203 and Fn_204 as one signed number of thousandths of
/// the mechanics' unit `[I]`. The manual's table calls them high and low word, its text turns and
/// pulses.
fn zero_coordinate(registers: &Registers) -> f64 {
    let high = i32::from(registers.signed(fns::ZERO_HIGH)) << 16;
    let units = f64::from(high | i32::from(registers.value(fns::ZERO_LOW))) / 1000.0;
    let ratio = f64::from(registers.value(fns::MOTOR_TURNS));
    units * ratio / f64::from(registers.value(fns::TRAVEL).max(1)) * TAU
}
