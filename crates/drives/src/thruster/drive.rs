//! The drive independent of its wire: settings, output, faults, time.

use super::memory::Memory;
use super::options::Options;
use super::shaft::{Shaft, rpm};
use polepair_core::plant::{Goal, StallDetector, TICK_NS, TICK_S, Ticks};
use polepair_core::proto::thruster::device::TelemetryValues;
use polepair_core::proto::thruster::fault;
use polepair_core::time::Instant;

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
    pub active_link: (u8, u32),
    /// Faults there are now.
    pub faults: u16,
    /// Faults there were since the start (FR).
    pub fault_history: u16,
    /// The timeout stop that the present request reports for the last time.
    pub expiring_timeout_ms: u16,
    /// Causes that the bench put there.
    pub injected: u16,
    /// The signal was zero.
    pub zero_seen: bool,
    /// LS was received, and nothing runs before CF.
    pub stop_latched: bool,
    /// ST, ms; 0 is never.
    pub timeout_ms: u16,
    pub last_command: Instant,
    /// Target of the last relative move, tenths of a degree from the relative zero.
    pub relative_target: Option<i64>,
    pub unrepeatable: u64,
    pub starts: u64,
    pub writes: u64,
    pub notice: Option<&'static str>,
    pub(super) stall: StallDetector,
    ticks: Ticks,
}

impl Drive {
    /// A drive as from the factory, powered.
    pub fn new(options: Options) -> Self {
        let memory = Memory::new(options.id);
        let mut stall = StallDetector::after(STALL_TICKS);
        stall.share = 0.5;
        Self {
            active_link: (memory.id, memory.bit_rate()),
            memory,
            shaft: Shaft::new(&options),
            options,
            faults: 0,
            fault_history: 0,
            expiring_timeout_ms: 0,
            injected: 0,
            zero_seen: false,
            stop_latched: false,
            timeout_ms: 0,
            last_command: Instant::ZERO,
            relative_target: None,
            unrepeatable: 0,
            starts: 0,
            writes: 0,
            notice: None,
            stall,
            ticks: Ticks::new(Instant::ZERO),
        }
    }

    /// Restarts: written ID and bit rate apply, other settings in RAM are lost.
    pub fn power_up(&mut self, now: Instant) {
        self.shaft.disable_output();
        self.active_link = (self.memory.id, self.memory.bit_rate());
        // Neither faults nor the zero check nor the timeout survive a power-up: a host that does not set the
        // timeout again has none.
        debug_assert!(self.memory.id != 0, "0 addresses every device");
        (self.faults, self.fault_history, self.expiring_timeout_ms) = (0, 0, 0);
        (self.zero_seen, self.stop_latched, self.timeout_ms) = (false, false, 0);
        (self.last_command, self.relative_target) = (now, None);
        // The time without power does not count as silence of the host.
        self.stall.reset();
    }

    /// Runs the ticks up to `now`.
    pub fn advance(&mut self, now: Instant) {
        let before = self.ticks.at();
        let count = self.ticks.advance_to(now);
        for n in 0..count {
            // The rest of the span passes at once: a motor without power cools and does nothing else.
            if self.is_idle() {
                self.shaft.pass_time((count - n) as f64 * TICK_S);
                return self.check_faults(now);
            }
            self.shaft.tick();
            // At its own instant, so that a timeout of 100 ms trips after 100 ms however long the step was.
            self.check_faults(before.plus_ns((n + 1) * TICK_NS));
        }
    }

    /// Returns whether the logic has no supply.
    pub fn is_unpowered(&self) -> bool {
        self.shaft.supply < LOGIC_V
    }

    /// The supply's new value; the logic dies below a few volts and starts anew above. Returns
    /// whether it started.
    pub fn set_supply(&mut self, now: Instant, volts: f64) -> bool {
        // Between "no supply" and "supply" lies a power-up; a dip above this voltage is an undervoltage fault.
        let was_dead = self.is_unpowered();
        self.shaft.supply = volts.clamp(0.0, 1000.0);
        if self.is_unpowered() {
            self.shaft.disable_output();
        } else if was_dead {
            self.power_up(now);
        }
        was_dead && !self.is_unpowered()
    }

    /// The absolute position, tenths of a degree; \[I\] it counts on beyond
    /// half a turn, unless it was built to go round.
    pub fn absolute_position(&self) -> i64 {
        let tenths = self.shaft.position_tenths(self.memory.absolute_zero);
        if self.options.wraps_around { (tenths + 1800).rem_euclid(3600) - 1800 } else { tenths }
    }

    /// The present report.
    pub fn current_telemetry(&self) -> TelemetryValues {
        let shaft = &self.shaft;
        // Without an encoder there is no position (section 1.2): the third report carries none.
        let (absolute, relative) = if self.options.encoder {
            (
                self.absolute_position() as i32,
                shaft.position_tenths(self.memory.relative_zero) as i32,
            )
        } else {
            (0, 0)
        };
        TelemetryValues {
            rpm: rpm(shaft.velocity()),
            decivolt: in_tenths(shaft.supply) as u16,
            deciamp: in_tenths(shaft.motor.current().abs()) as i16,
            faults: self.faults | self.expiring_timeout_ms,
            motor_c: whole_degrees(shaft.winding.temperature()),
            driver_c: whole_degrees(shaft.stage.temperature()),
            absolute,
            relative,
        }
    }

    /// Switches the output off for a fault and reports it.
    pub fn trip(&mut self, bit: u16, why: &'static str) {
        self.faults |= bit;
        self.fault_history |= bit;
        if bit & fault::OUTPUT_OFF != 0 {
            if self.shaft.servo.is_enabled() {
                // Only a fault that takes the output away is news; the same bit again is not.
                self.notice = Some(why);
            }
            self.shaft.disable_output();
            self.relative_target = None;
        }
    }

    /// A move or a held position sets the output.
    pub fn is_positioning(&self) -> bool {
        let holds = matches!(self.shaft.servo.goal(), Goal::Position(_));
        self.shaft.servo.is_enabled() && self.shaft.signal.is_none() && holds
    }

    fn is_idle(&self) -> bool {
        self.shaft.is_at_rest()
    }
}

fn in_tenths(value: f64) -> f64 {
    libm::round(value * 10.0)
}

fn whole_degrees(celsius: f64) -> i16 {
    libm::round(celsius) as i16
}
