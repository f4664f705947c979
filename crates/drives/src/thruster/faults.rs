//! Faults: their causes, effects and clearing (protocol manual, section 3).

use super::drive::Drive;
use polepair_core::proto::thruster::fault;
use polepair_core::time::Instant;

/// A motor or driver is too hot from here on, and no more from there on, °C.
const HOT_C: f64 = 120.0;
const COOL_C: f64 = 100.0;

impl Drive {
    /// Looks after everything once.
    pub(super) fn check_faults(&mut self, now: Instant) {
        if self.is_unpowered() {
            return;
        }
        let (low, high) = self.options.volts;
        let supply = self.shaft.supply;
        self.track_cause(fault::UNDER_VOLTAGE, supply < low);
        self.track_cause(fault::OVER_VOLTAGE, supply > high);
        let (motor, driver) = (self.shaft.winding.temperature(), self.shaft.stage.temperature());
        self.track_temperature(fault::MOTOR_HOT, motor);
        self.track_temperature(fault::DRIVER_HOT, driver);
        for bit in [fault::MOTOR_SENSOR, fault::DRIVER_SENSOR, fault::MOTOR_TEMPERATURE] {
            self.track_cause(bit, false);
        }
        let hot = self.faults & fault::OUTPUT_LIMITED != 0;
        self.shaft.output_limit = if hot { self.options.limit } else { 1.0 };
        self.check_command_timeout(now);
        self.check_stall();
    }

    /// A fault that is there as long as its cause.
    fn track_cause(&mut self, bit: u16, there: bool) {
        let there = there || self.injected & bit != 0;
        self.faults = if there { self.faults | bit } else { self.faults & !bit };
        self.fault_history |= self.faults;
    }

    fn track_temperature(&mut self, bit: u16, celsius: f64) {
        let limit = if self.faults & bit != 0 { COOL_C } else { HOT_C };
        self.track_cause(bit, celsius > limit);
    }

    /// ST: no command for too long (section 2.3).
    fn check_command_timeout(&mut self, now: Instant) {
        let limit = self.last_command.plus_ms(self.timeout_ms.into());
        if self.timeout_ms > 0 && now > limit && self.faults & fault::TIMEOUT == 0 {
            self.trip(fault::TIMEOUT, "no command in time: output off");
        }
    }

    fn check_stall(&mut self) {
        let on = self.shaft.servo.is_enabled();
        let limit = if on { self.shaft.motor.parameters().max_current } else { 0.0 };
        let (velocity, current) = (self.shaft.motor.velocity(), self.shaft.motor.current());
        if self.stall.step(velocity, current, limit) {
            self.stall.reset();
            self.trip(fault::STALL, "stalled: output off");
        }
    }

    /// CF: what does not recover by itself goes. \[I\] After a fault that closed the output the signal
    /// must pass zero again.
    pub(super) fn clear_faults(&mut self) {
        self.stop_latched = false;
        if self.faults & fault::OUTPUT_CLOSED != 0 {
            self.zero_seen = false;
        }
        self.faults &= !fault::LATCHED;
        if self.shaft.encoder_broken_at.is_some() {
            self.handle_encoder_loss();
        }
    }

    /// Without its encoder it holds no position: a move is given up, a speed goes on open loop.
    pub(super) fn handle_encoder_loss(&mut self) {
        self.trip(fault::ENCODER, "");
        if self.relative_target.take().is_some() || self.is_positioning() {
            self.shaft.disable_output();
            self.notice = Some("encoder fault: position commands void");
        }
    }

    /// The bench brings a fault by its bits; none takes the causes away.
    pub(super) fn inject_faults(&mut self, bits: u32) -> bool {
        let Ok(bits) = u16::try_from(bits) else { return false };
        let known: u16 = fault::BITS.iter().map(|bit| bit.mask).sum();
        if bits & !known != 0 {
            return false;
        }
        self.injected = bits & !(fault::LATCHED | fault::TIMEOUT | fault::ZERO_POINT);
        if bits & fault::ZERO_POINT != 0 {
            self.zero_seen = false;
        }
        self.trip(bits, "fault injected: output off");
        true
    }
}
