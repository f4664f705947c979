//! The drive apart from its wire: settings, output, faults, and what happens in time.

use super::memory::Memory;
use super::options::Options;
use super::shaft::{Shaft, rpm};
use crate::plant::{Goal, Stall, TICK_NS, TICK_S, Ticks};
use crate::proto::thruster::device::Telemetry;
use crate::proto::thruster::fault;
use crate::time::Instant;

/// Ticks at half the current limit without turning after which the output is closed. \[I\]
const STALL_TICKS: u32 = 1000;
/// Below this supply the logic dies, V. \[I\]
const LOGIC_V: f64 = 9.0;

/// A thruster, servo or actuator with its motor.
#[derive(Clone, Debug)]
pub(super) struct Drive {
    pub options: Options,
    pub memory: Memory,
    pub shaft: Shaft,
    /// The id and bit rate of this run.
    pub running: (u8, u32),
    /// Faults there are now.
    pub faults: u16,
    /// Faults there were since the start (FR).
    pub history: u16,
    /// The timeout stop that the request in hand tells of for the last time.
    pub told_timeout: u16,
    /// Causes that the bench put there.
    pub injected: u16,
    /// The signal was zero.
    pub armed: bool,
    /// LS came, and nothing runs before CF.
    pub latched: bool,
    /// ST, ms; 0 is never.
    pub timeout_ms: u16,
    pub last_heard: Instant,
    /// Where the last relative move goes, tenths of a degree from the relative zero.
    pub way: Option<i64>,
    pub unrepeatable: u64,
    pub starts: u64,
    pub writes: u64,
    pub notice: Option<&'static str>,
    pub(super) stall: Stall,
    ticks: Ticks,
}

impl Drive {
    /// A drive as from the factory, powered.
    pub fn new(options: Options) -> Self {
        let memory = Memory::new(options.id);
        let mut stall = Stall::after(STALL_TICKS);
        stall.share = 0.5;
        Self {
            running: (memory.id, memory.bit_rate()),
            memory,
            shaft: Shaft::new(&options),
            options,
            faults: 0,
            history: 0,
            told_timeout: 0,
            injected: 0,
            armed: false,
            latched: false,
            timeout_ms: 0,
            last_heard: Instant::ZERO,
            way: None,
            unrepeatable: 0,
            starts: 0,
            writes: 0,
            notice: None,
            stall,
            ticks: Ticks::new(Instant::ZERO),
        }
    }

    /// A restart: id and bit rate that were written hold, what was not kept is gone.
    pub fn power_up(&mut self, now: Instant) {
        self.shaft.off();
        self.running = (self.memory.id, self.memory.bit_rate());
        (self.faults, self.history, self.told_timeout) = (0, 0, 0);
        (self.armed, self.latched, self.timeout_ms) = (false, false, 0);
        (self.last_heard, self.way) = (now, None);
        self.stall.reset();
    }

    /// Runs the ticks up to `now`.
    pub fn advance(&mut self, now: Instant) {
        let before = self.ticks.at();
        let count = self.ticks.until(now);
        for n in 0..count {
            if self.is_idle() {
                self.shaft.rest((count - n) as f64 * TICK_S);
                return self.watch(now);
            }
            self.shaft.tick();
            self.watch(before.plus_ns((n + 1) * TICK_NS));
        }
    }

    /// Whether the logic has no supply.
    pub fn is_dead(&self) -> bool {
        self.shaft.supply < LOGIC_V
    }

    /// The supply's new value; the logic dies below a few volts and starts anew above. Returns
    /// whether it started.
    pub fn supply(&mut self, now: Instant, volts: f64) -> bool {
        let was_dead = self.is_dead();
        self.shaft.supply = volts.clamp(0.0, 1000.0);
        if self.is_dead() {
            self.shaft.off();
        } else if was_dead {
            self.power_up(now);
        }
        was_dead && !self.is_dead()
    }

    /// The absolute position, tenths of a degree; \[I\] it counts on beyond
    /// half a turn, unless it was built to go round.
    pub fn absolute(&self) -> i64 {
        let tenths = self.shaft.tenths(self.memory.absolute_zero);
        if self.options.round { (tenths + 1800).rem_euclid(3600) - 1800 } else { tenths }
    }

    /// What it reports now.
    pub fn told(&self) -> Telemetry {
        let shaft = &self.shaft;
        let whole = |celsius: f64| libm::round(celsius) as i16;
        let tenths = |value: f64| libm::round(value * 10.0);
        Telemetry {
            rpm: rpm(shaft.velocity()),
            decivolt: tenths(shaft.supply) as u16,
            deciamp: tenths(shaft.motor.current().abs()) as i16,
            faults: self.faults | self.told_timeout,
            motor_c: whole(shaft.winding.temperature()),
            driver_c: whole(shaft.stage.temperature()),
            absolute: self.absolute() as i32,
            relative: shaft.tenths(self.memory.relative_zero) as i32,
        }
    }

    /// Closes the output for a fault and says why.
    pub fn trip(&mut self, bit: u16, why: &'static str) {
        self.faults |= bit;
        self.history |= bit;
        if bit & fault::OUTPUT_OFF != 0 {
            if self.shaft.servo.is_enabled() {
                self.notice = Some(why);
            }
            self.shaft.off();
            self.way = None;
        }
    }

    /// A move or a held position sets the output.
    pub fn is_positioning(&self) -> bool {
        let holds = matches!(self.shaft.servo.goal(), Goal::Position(_));
        self.shaft.servo.is_enabled() && self.shaft.signal.is_none() && holds
    }

    fn is_idle(&self) -> bool {
        self.shaft.is_still()
    }
}
