//! Homing: methods 1 to 37 of the standard, and the four with a mechanical stop that several makers
//! number -1, -2, -17 and -18.
//!
//! A method is which edge of which switch is crossed in which direction, and whether the zero is
//! there or at the index pulse behind it. One rule then finds it from anywhere: crossing the edge
//! the wrong way, or fast, the drive turns round and goes on slowly; a limit switch turns it round
//! too.

use core::f64::consts::TAU;

use super::axis::{Scene, signum};
use super::{HomingSettings, Settings, Shaft};
use crate::plant::Limits;

/// Torque must last so many ticks to count as a stop \[I\].
const TORQUE_TICKS: u16 = 50;
/// Turns at limit switches and edges after which a search gives up.
const TURNS_MAX: u8 = 8;

/// Whether a method is one of the standard's or of the four with a stop. 15, 16, 31, 32 and 36 are
/// reserved.
#[must_use]
pub const fn is_method(method: i8) -> bool {
    matches!(method, 0..=14 | 17..=30 | 33..=35 | 37 | -1 | -2 | -17 | -18)
}

/// What is searched.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Signal {
    Home,
    Negative,
    Positive,
}

/// How the zero is found.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Way {
    /// It is here.
    Here,
    /// The first index pulse in that direction.
    Index(f64),
    /// The mechanical stop in that direction, or the index pulse before it.
    Stop { toward: f64, index: bool },
    /// An edge of a switch: `edge` -1 is the one on its negative side; crossed going `toward`; a
    /// search from outside the switch begins going `first`.
    Edge { signal: Signal, edge: f64, toward: f64, first: f64, index: bool },
}

impl Way {
    const fn of(method: i8) -> Option<Self> {
        let (method, index) = match method {
            -1 => return Some(Self::Stop { toward: -1.0, index: true }),
            -2 => return Some(Self::Stop { toward: 1.0, index: true }),
            -17 => return Some(Self::Stop { toward: -1.0, index: false }),
            -18 => return Some(Self::Stop { toward: 1.0, index: false }),
            33 => return Some(Self::Index(-1.0)),
            34 => return Some(Self::Index(1.0)),
            35 | 37 => return Some(Self::Here),
            1..=14 => (method, true),
            17..=30 => (method - 16, false),
            _ => return None,
        };
        let (signal, edge, toward, first) = match method {
            1 => (Signal::Negative, 1.0, 1.0, -1.0),
            2 => (Signal::Positive, -1.0, -1.0, 1.0),
            3 => (Signal::Home, -1.0, -1.0, 1.0),
            4 => (Signal::Home, -1.0, 1.0, 1.0),
            5 => (Signal::Home, 1.0, 1.0, -1.0),
            6 => (Signal::Home, 1.0, -1.0, -1.0),
            7 => (Signal::Home, -1.0, -1.0, 1.0),
            8 => (Signal::Home, -1.0, 1.0, 1.0),
            9 => (Signal::Home, 1.0, -1.0, 1.0),
            10 => (Signal::Home, 1.0, 1.0, 1.0),
            11 => (Signal::Home, 1.0, 1.0, -1.0),
            12 => (Signal::Home, 1.0, -1.0, -1.0),
            13 => (Signal::Home, -1.0, 1.0, -1.0),
            _ => (Signal::Home, -1.0, -1.0, -1.0),
        };
        Some(Self::Edge { signal, edge, toward, first, index })
    }
}

/// What a search does now.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Phase {
    /// No search.
    None,
    /// Looking for an edge.
    Edge { was: bool, slow: bool },
    /// Pushing against the stop.
    Stop { ticks: u16 },
    /// Going slowly to the index pulse.
    Index,
    /// Coming to rest with the zero known.
    Rest { zero: f64 },
}

/// How a search ended.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Found {
    /// The home position, rad of the shaft.
    Zero(f64),
    /// It gave up.
    Nothing,
}

/// A search for the home position.
#[derive(Clone, Debug)]
pub struct Homing {
    phase: Phase,
    way: Way,
    toward: f64,
    turns: u8,
    settings: HomingSettings,
}

impl Homing {
    /// None.
    #[must_use]
    pub const fn new() -> Self {
        let settings =
            HomingSettings { method: 0, fast: 0.0, slow: 0.0, acceleration: 0.0, offset: 0.0 };
        Self { phase: Phase::None, way: Way::Here, toward: 0.0, turns: 0, settings }
    }

    /// A search runs.
    #[must_use]
    pub fn runs(&self) -> bool {
        self.phase != Phase::None
    }

    /// It pushes against a stop, so that a blocked shaft is no fault.
    #[must_use]
    pub const fn feels_for_stop(&self) -> bool {
        matches!(self.phase, Phase::Stop { .. })
    }

    /// Ends it where it is.
    pub const fn end(&mut self) {
        self.phase = Phase::None;
    }

    /// Begins one. False when the method is none, or would never arrive.
    pub fn begin<S: Shaft, T: Settings>(&mut self, scene: &mut Scene<'_, S, T>) -> bool {
        let settings = scene.settings.homing();
        let Some(way) = Way::of(settings.method) else { return false };
        (self.way, self.settings, self.turns) = (way, settings, 0);
        let still = settings.slow == 0.0 || settings.fast == 0.0;
        if still && way != Way::Here {
            return false;
        }
        match way {
            Way::Here => self.phase = Phase::Rest { zero: scene.shaft.position() },
            Way::Index(toward) => self.seek_index(toward, scene),
            Way::Stop { toward, .. } => {
                self.phase = Phase::Stop { ticks: 0 };
                self.turn(toward, settings.fast, scene);
            }
            Way::Edge { signal, edge, first, .. } => {
                let was = active(signal, scene);
                self.phase = Phase::Edge { was, slow: false };
                self.turn(if was { edge } else { first }, settings.fast, scene);
            }
        }
        true
    }

    /// One tick of it; what came of it when it has ended.
    pub fn tick<S: Shaft, T: Settings>(&mut self, scene: &mut Scene<'_, S, T>) -> Option<Found> {
        match self.phase {
            Phase::None => {}
            Phase::Edge { was, slow } => return self.on_edge(was, slow, scene),
            Phase::Stop { ticks } => self.on_stop(ticks, scene),
            Phase::Index => {
                if let Some(zero) = index(scene.shaft) {
                    self.rest(zero, scene);
                } else if scene.blocked(self.toward) {
                    return Some(self.give_up(scene));
                }
            }
            Phase::Rest { zero } if scene.shaft.arrived() => {
                self.phase = Phase::None;
                return Some(Found::Zero(zero));
            }
            Phase::Rest { .. } => {}
        }
        None
    }

    fn on_edge<S: Shaft, T: Settings>(
        &mut self,
        was: bool,
        slow: bool,
        scene: &mut Scene<'_, S, T>,
    ) -> Option<Found> {
        let Way::Edge { signal, edge, toward, index, .. } = self.way else { return None };
        let is = active(signal, scene);
        self.phase = Phase::Edge { was: is, slow };
        if was != is {
            // While it turns round it still goes the other way. Going forward a switch closes at
            // its negative side; the way back mirrors it.
            let going = signum(scene.shaft.position() - scene.shaft.before());
            if edge != if is { -going } else { going } {
                return None;
            }
            if !slow || going != toward {
                self.phase = Phase::Edge { was: is, slow: true };
                self.toward = going;
                return self.round(self.settings.slow, scene);
            }
            let zero = scene.edge_at(signal == Signal::Home);
            if index { self.seek_index(toward, scene) } else { self.rest(zero, scene) }
        } else if scene.blocked(self.toward) && !limits(signal, self.toward) {
            let speed = if slow { self.settings.slow } else { self.settings.fast };
            return self.round(speed, scene);
        }
        None
    }

    fn on_stop<S: Shaft, T: Settings>(&mut self, ticks: u16, scene: &mut Scene<'_, S, T>) {
        let Way::Stop { toward, index } = self.way else { return };
        let ticks = if scene.shaft.torque_reached() { ticks + 1 } else { 0 };
        self.phase = Phase::Stop { ticks };
        if ticks < TORQUE_TICKS {
            return;
        }
        scene.shaft.hold();
        if index {
            self.seek_index(-toward, scene)
        } else {
            self.rest(scene.shaft.position(), scene)
        }
    }

    fn seek_index<S: Shaft, T: Settings>(&mut self, toward: f64, scene: &mut Scene<'_, S, T>) {
        self.phase = Phase::Index;
        self.turn(toward, self.settings.slow, scene);
    }

    fn rest<S: Shaft, T: Settings>(&mut self, zero: f64, scene: &mut Scene<'_, S, T>) {
        self.phase = Phase::Rest { zero };
        self.turn(0.0, self.settings.slow, scene);
    }

    /// The other way, at most so often.
    fn round<S: Shaft, T: Settings>(
        &mut self,
        speed: f64,
        scene: &mut Scene<'_, S, T>,
    ) -> Option<Found> {
        self.turns += 1;
        if self.turns > TURNS_MAX {
            return Some(self.give_up(scene));
        }
        self.turn(-self.toward, speed, scene);
        None
    }

    fn give_up<S: Shaft, T: Settings>(&mut self, scene: &mut Scene<'_, S, T>) -> Found {
        self.phase = Phase::None;
        scene.shaft.turn(0.0);
        Found::Nothing
    }

    fn turn<S: Shaft, T: Settings>(
        &mut self,
        toward: f64,
        speed: f64,
        scene: &mut Scene<'_, S, T>,
    ) {
        self.toward = toward;
        scene.shaft.manner(Limits::trapezoid(speed, self.settings.acceleration));
        scene.shaft.turn(toward * speed);
    }
}

fn active<S: Shaft, T: Settings>(signal: Signal, scene: &Scene<'_, S, T>) -> bool {
    match signal {
        Signal::Home => scene.home,
        Signal::Negative => scene.negative,
        Signal::Positive => scene.positive,
    }
}

/// The limit switch that lies in that direction is itself what is searched.
fn limits(signal: Signal, toward: f64) -> bool {
    matches!((signal, toward > 0.0), (Signal::Negative, false) | (Signal::Positive, true))
}

/// Where the index pulse of this tick was, if there was one: it comes at whole turns.
fn index(shaft: &impl Shaft) -> Option<f64> {
    let turns = |position: f64| libm::floor(position / TAU);
    let (was, is) = (turns(shaft.before()), turns(shaft.position()));
    (was != is).then(|| was.max(is) * TAU)
}
