//! Homing: methods 1 to 37 of the standard, and four with a mechanical stop that several makers number -1,
//! -2, -17 and -18.
//!
//! A method is an edge of a switch, its direction, and whether zero is there or at the next index pulse.
//! One rule works from any position: after crossing the edge in the wrong direction, or fast, the drive
//! reverses and continues slowly. A limit switch reverses it too.

use super::motion_axis::{MotionContext, signum};
use super::{HomingSettings, MotionSettings};
use crate::plant::Limits;

/// Ticks of torque that count as a stop \[I\].
const TORQUE_TICKS: u16 = 50;
/// Turns at limit switches and edges after which a search gives up.
const REVERSALS_MAX: u8 = 8;

/// Returns whether a method is one of the standard's or of the four with a stop. 15, 16, 31, 32 and 36 are reserved.
#[must_use]
pub const fn is_method(method: i8) -> bool {
    matches!(method, 0..=14 | 17..=30 | 33..=35 | 37 | -1 | -2 | -17 | -18)
}

/// Target of the search.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum HomingSwitch {
    Home,
    Negative,
    Positive,
}

/// Strategy of a search for the zero.
#[derive(Clone, Copy, PartialEq, Debug)]
enum HomingStrategy {
    /// The present position.
    CurrentPosition,
    /// The first index pulse in that direction.
    Index(f64),
    /// The mechanical stop in that direction, or the index pulse before it.
    Stop { toward: f64, index: bool },
    /// An edge of a switch: `edge` -1 is the one on its negative side; crossed going `toward`; a
    /// search from outside the switch begins going `first`.
    Edge { signal: HomingSwitch, edge: f64, toward: f64, first: f64, index: bool },
}

impl HomingStrategy {
    const fn of(method: i8) -> Option<Self> {
        let (method, index) = match method {
            -1 => return Some(Self::Stop { toward: -1.0, index: true }),
            -2 => return Some(Self::Stop { toward: 1.0, index: true }),
            -17 => return Some(Self::Stop { toward: -1.0, index: false }),
            -18 => return Some(Self::Stop { toward: 1.0, index: false }),
            33 => return Some(Self::Index(-1.0)),
            34 => return Some(Self::Index(1.0)),
            35 | 37 => return Some(Self::CurrentPosition),
            1..=14 => (method, true),
            17..=30 => (method - 16, false),
            _ => return None,
        };
        let (signal, edge, toward, first) = match method {
            1 => (HomingSwitch::Negative, 1.0, 1.0, -1.0),
            2 => (HomingSwitch::Positive, -1.0, -1.0, 1.0),
            3 => (HomingSwitch::Home, -1.0, -1.0, 1.0),
            4 => (HomingSwitch::Home, -1.0, 1.0, 1.0),
            5 => (HomingSwitch::Home, 1.0, 1.0, -1.0),
            6 => (HomingSwitch::Home, 1.0, -1.0, -1.0),
            7 => (HomingSwitch::Home, -1.0, -1.0, 1.0),
            8 => (HomingSwitch::Home, -1.0, 1.0, 1.0),
            9 => (HomingSwitch::Home, 1.0, -1.0, 1.0),
            10 => (HomingSwitch::Home, 1.0, 1.0, 1.0),
            11 => (HomingSwitch::Home, 1.0, 1.0, -1.0),
            12 => (HomingSwitch::Home, 1.0, -1.0, -1.0),
            13 => (HomingSwitch::Home, -1.0, 1.0, -1.0),
            _ => (HomingSwitch::Home, -1.0, -1.0, -1.0),
        };
        Some(Self::Edge { signal, edge, toward, first, index })
    }
}

/// Phase of a search.
#[derive(Clone, Copy, PartialEq, Debug)]
enum HomingPhase {
    /// No search.
    Idle,
    /// Looking for an edge.
    Edge { was: bool, slow: bool },
    /// Pushing against the stop.
    Stop { ticks: u16 },
    /// Going slowly to the index pulse.
    Index,
    /// Coming to rest with the zero known.
    ComingToRest { zero: f64 },
}

/// Result of a search.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum HomingResult {
    /// The home position, rad of the shaft.
    HomePosition(f64),
    /// The search failed.
    NotFound,
}

/// A search for the home position.
#[derive(Clone, Debug)]
pub struct Homing {
    phase: HomingPhase,
    strategy: HomingStrategy,
    direction: f64,
    reversals: u8,
    settings: HomingSettings,
}

impl Homing {
    /// None.
    #[must_use]
    pub const fn new() -> Self {
        let settings =
            HomingSettings { method: 0, fast: 0.0, slow: 0.0, acceleration: 0.0, offset: 0.0 };
        Self {
            phase: HomingPhase::Idle,
            strategy: HomingStrategy::CurrentPosition,
            direction: 0.0,
            reversals: 0,
            settings,
        }
    }

    /// A search runs.
    #[must_use]
    pub fn is_running(&self) -> bool {
        self.phase != HomingPhase::Idle
    }

    /// Returns whether it pushes against a hard stop, so that a blocked shaft is no fault.
    #[must_use]
    pub const fn seeks_hard_stop(&self) -> bool {
        matches!(self.phase, HomingPhase::Stop { .. })
    }

    /// Ends it where it is.
    pub const fn end(&mut self) {
        self.phase = HomingPhase::Idle;
    }

    /// Begins one. False when the method is none, or would never arrive.
    pub fn begin<T: MotionSettings>(&mut self, scene: &mut MotionContext<'_, T>) -> bool {
        let settings = scene.settings.homing();
        let Some(way) = HomingStrategy::of(settings.method) else { return false };
        (self.strategy, self.settings, self.reversals) = (way, settings, 0);
        let still = settings.slow == 0.0 || settings.fast == 0.0;
        if still && way != HomingStrategy::CurrentPosition {
            return false;
        }
        match way {
            HomingStrategy::CurrentPosition => {
                self.phase = HomingPhase::ComingToRest { zero: scene.shaft.position() }
            }
            HomingStrategy::Index(toward) => self.seek_index(toward, scene),
            HomingStrategy::Stop { toward, .. } => {
                self.phase = HomingPhase::Stop { ticks: 0 };
                self.run_toward(toward, settings.fast, scene);
            }
            HomingStrategy::Edge { signal, edge, first, .. } => {
                let was = is_active(signal, scene);
                self.phase = HomingPhase::Edge { was, slow: false };
                self.run_toward(if was { edge } else { first }, settings.fast, scene);
            }
        }
        true
    }

    /// One tick; the result when it has ended.
    pub fn tick<T: MotionSettings>(
        &mut self,
        scene: &mut MotionContext<'_, T>,
    ) -> Option<HomingResult> {
        match self.phase {
            HomingPhase::Idle => {}
            HomingPhase::Edge { was, slow } => return self.tick_edge(was, slow, scene),
            HomingPhase::Stop { ticks } => self.tick_stop(ticks, scene),
            HomingPhase::Index => {
                if let Some(zero) = scene.shaft.index_pulse() {
                    self.come_to_rest(zero, scene);
                } else if scene.is_blocked(self.direction) {
                    return Some(self.abort_search(scene));
                }
            }
            HomingPhase::ComingToRest { zero } if scene.shaft.has_arrived() => {
                self.phase = HomingPhase::Idle;
                return Some(HomingResult::HomePosition(zero));
            }
            HomingPhase::ComingToRest { .. } => {}
        }
        None
    }

    fn tick_edge<T: MotionSettings>(
        &mut self,
        was: bool,
        slow: bool,
        scene: &mut MotionContext<'_, T>,
    ) -> Option<HomingResult> {
        let HomingStrategy::Edge { signal, edge, toward, index, .. } = self.strategy else {
            return None;
        };
        let is = is_active(signal, scene);
        self.phase = HomingPhase::Edge { was: is, slow };
        if was != is {
            // While it turns round it still goes the other way. Going forward a switch closes at
            // its negative side; the way back mirrors it.
            let going = signum(scene.shaft.position() - scene.shaft.previous_position());
            if edge != if is { -going } else { going } {
                return None;
            }
            if !slow || going != toward {
                self.phase = HomingPhase::Edge { was: is, slow: true };
                self.direction = going;
                return self.reverse(self.settings.slow, scene);
            }
            let zero = scene.edge_position(signal == HomingSwitch::Home);
            if index { self.seek_index(toward, scene) } else { self.come_to_rest(zero, scene) }
        } else if scene.is_blocked(self.direction) && !is_searched_limit(signal, self.direction) {
            let speed = if slow { self.settings.slow } else { self.settings.fast };
            return self.reverse(speed, scene);
        }
        None
    }

    fn tick_stop<T: MotionSettings>(&mut self, ticks: u16, scene: &mut MotionContext<'_, T>) {
        let HomingStrategy::Stop { toward, index } = self.strategy else { return };
        let ticks = if scene.shaft.is_torque_limited() { ticks + 1 } else { 0 };
        self.phase = HomingPhase::Stop { ticks };
        if ticks < TORQUE_TICKS {
            return;
        }
        scene.shaft.hold_position();
        if index {
            self.seek_index(-toward, scene)
        } else {
            self.come_to_rest(scene.shaft.position(), scene)
        }
    }

    fn seek_index<T: MotionSettings>(&mut self, toward: f64, scene: &mut MotionContext<'_, T>) {
        self.phase = HomingPhase::Index;
        self.run_toward(toward, self.settings.slow, scene);
    }

    fn come_to_rest<T: MotionSettings>(&mut self, zero: f64, scene: &mut MotionContext<'_, T>) {
        self.phase = HomingPhase::ComingToRest { zero };
        self.run_toward(0.0, self.settings.slow, scene);
    }

    /// Reverses the search, at most this many times.
    fn reverse<T: MotionSettings>(
        &mut self,
        speed: f64,
        scene: &mut MotionContext<'_, T>,
    ) -> Option<HomingResult> {
        self.reversals += 1;
        if self.reversals > REVERSALS_MAX {
            return Some(self.abort_search(scene));
        }
        self.run_toward(-self.direction, speed, scene);
        None
    }

    fn abort_search<T: MotionSettings>(
        &mut self,
        scene: &mut MotionContext<'_, T>,
    ) -> HomingResult {
        self.phase = HomingPhase::Idle;
        scene.shaft.set_velocity(0.0);
        HomingResult::NotFound
    }

    fn run_toward<T: MotionSettings>(
        &mut self,
        toward: f64,
        speed: f64,
        scene: &mut MotionContext<'_, T>,
    ) {
        self.direction = toward;
        scene.shaft.set_limits(Limits::trapezoid(speed, self.settings.acceleration));
        scene.shaft.set_velocity(toward * speed);
    }
}

fn is_active<T: MotionSettings>(signal: HomingSwitch, scene: &MotionContext<'_, T>) -> bool {
    match signal {
        HomingSwitch::Home => scene.home,
        HomingSwitch::Negative => scene.negative,
        HomingSwitch::Positive => scene.positive,
    }
}

/// Returns whether the limit switch in that direction is itself the target of the search.
fn is_searched_limit(signal: HomingSwitch, toward: f64) -> bool {
    matches!(
        (signal, toward > 0.0),
        (HomingSwitch::Negative, false) | (HomingSwitch::Positive, true)
    )
}
