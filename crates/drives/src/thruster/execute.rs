//! Executes the commands (protocol manual, sections 2.1 to 4.3).

use super::drive::Drive;
use super::shaft::{rad_per_s, radians};
use polepair_core::proto::thruster::device::{Firmware, Response, TelemetryValues};
use polepair_core::proto::thruster::fault;
use polepair_core::proto::thruster::rules;
use polepair_core::proto::thruster::wire::{
    BIT_RATES, CommandWord, POSITION_MAX, RANGE_PARAMETER, RPM_MIN, Request, TIMEOUT_MS,
};
use polepair_core::time::Instant;

impl Firmware for Drive {
    fn id(&self) -> u8 {
        self.active_link.0
    }

    fn bit_rate(&self) -> u32 {
        self.active_link.1
    }

    fn report_settings(&self) -> (u8, u16) {
        (self.memory.frames, self.memory.interval_ms)
    }

    /// Any command ends a timeout stop; the one that does can still ask for it (section 2.3).
    fn note_request(&mut self, now: Instant, _request: &Request) {
        // Any command feeds the timeout, also a query (section 2.3).
        self.last_command = now;
        self.expiring_timeout_ms = self.faults & fault::TIMEOUT;
        self.faults &= !fault::TIMEOUT;
    }

    fn execute(&mut self, _now: Instant, request: &Request) -> Response {
        let Request { command, sub, data } = *request;
        if command.is_position() && !self.options.encoder && command != CommandWord::LS {
            return Response::Refused;
        }
        // A query carries no data field.
        let data = data.unwrap_or(0);
        let value = command.width().decode(data);
        match command {
            CommandWord::TC | CommandWord::VC => self.execute_output(command, value),
            CommandWord::LA => self.execute_absolute_move(sub, value),
            CommandWord::LR => self.execute_relative_move(sub, value),
            CommandWord::LS => self.execute_emergency_stop(),
            CommandWord::CF => {
                self.clear_faults();
                Response::Done
            }
            CommandWord::AZ | CommandWord::RZ | CommandWord::RC => self.set_zero(command),
            CommandWord::CI | CommandWord::CB | CommandWord::ST | CommandWord::SR => {
                self.execute_set(command, data)
            }
            CommandWord::SP if sub == RANGE_PARAMETER && self.options.encoder => {
                self.set_range(data)
            }
            CommandWord::RP if sub == RANGE_PARAMETER && self.options.encoder => {
                let (reverse, forward) = self.memory.range;
                Response::Value(rules::range_data(reverse, forward))
            }
            _ => self.execute_query(command),
        }
    }

    fn telemetry(&self) -> TelemetryValues {
        self.current_telemetry()
    }
}

impl Drive {
    fn execute_query(&self, command: CommandWord) -> Response {
        let values = self.current_telemetry();
        let value = match command {
            CommandWord::QV => values.rpm.into(),
            CommandWord::QC => values.deciamp.into(),
            CommandWord::QP => values.decivolt.into(),
            CommandWord::QT => values.motor_c.into(),
            CommandWord::EQ => values.driver_c.into(),
            CommandWord::EF => values.faults.into(),
            CommandWord::FR => self.fault_history.into(),
            CommandWord::QA => values.absolute.into(),
            CommandWord::QR => values.relative.into(),
            _ => return Response::Refused,
        };
        Response::Value(command.width().encode(value))
    }

    /// TC and VC: zero always, others while the output is neither closed nor forbidden, as it is until
    /// the signal was zero once (zero-point protection).
    fn execute_output(&mut self, command: CommandWord, value: i64) -> Response {
        if value == 0 {
            // Zero is what the start-up check waits for (zero-point protection: no output before the signal was
            // zero once).
            self.zero_seen = true;
            self.faults &= !fault::ZERO_POINT;
            self.relative_target = None;
            self.rest_output(command);
            return Response::Done;
        }
        // A closed output and a latched stop end by CF or a power-up, not by the next speed of a running host.
        if self.faults & fault::OUTPUT_CLOSED != 0 || self.stop_latched {
            return Response::Refused;
        }
        if !self.zero_seen && self.options.zero_point {
            self.trip(fault::ZERO_POINT, "the signal was not zero yet: output forbidden");
            return Response::Refused;
        }
        let slow = value.abs() < i64::from(RPM_MIN);
        match command {
            CommandWord::TC if value.abs() > 100 => return Response::Refused,
            CommandWord::TC => self.shaft.drive_signal(value as f64 / 100.0),
            _ if slow && !self.options.runs_slowly => return Response::Refused,
            _ if value.abs() > i64::from(i16::MAX) => return Response::Refused,
            _ => {
                // The manual leaves VC 1 to 29 open: one kind of device refuses it, the other runs at its lowest
                // speed.
                let size = value.abs().max(RPM_MIN.into());
                self.shaft.set_velocity(rad_per_s((size * value.signum()) as f64));
            }
        }
        self.relative_target = None;
        self.starts += 1;
        Response::Done
    }

    /// \[I\] Without an encoder, and by signal, zero is no output; a servo brakes to speed zero.
    fn rest_output(&mut self, command: CommandWord) {
        if command == CommandWord::VC && self.options.encoder && self.shaft.servo.is_enabled() {
            // A geared actuator holds its position with speed 0; a propeller runs free.
            self.shaft.set_velocity(0.0)
        } else {
            self.shaft.disable_output()
        }
    }

    fn execute_absolute_move(&mut self, rpm: u16, target: i64) -> Response {
        let (reverse, forward) = self.memory.range;
        let inside = (i64::from(reverse)..=i64::from(forward)).contains(&target);
        if !self.can_position() || target.abs() > POSITION_MAX.into() || !inside {
            return Response::Refused;
        }
        if rpm > 0 {
            // From the shown position, which wraps on some devices, to the shaft's, which does not.
            let way = radians(target - self.absolute_position());
            self.shaft.move_to(self.shaft.position() + way, rad_per_s(rpm.into()));
            self.relative_target = None;
            self.starts += 1;
        }
        Response::Done
    }

    /// Each one adds to where the last one goes. \[I\] The safe range holds for it too, and where the
    /// travel has ends LA's range.
    fn execute_relative_move(&mut self, rpm: u16, by: i64) -> Response {
        if !self.can_position() {
            return Response::Refused;
        }
        if rpm == 0 {
            return Response::Done;
        }
        let here = self.shaft.position_tenths(self.memory.relative_zero);
        // Relative to the last target, not to the shaft: otherwise repeated steps add up the rounding.
        let target = self.relative_target.unwrap_or(here) + by;
        let goal = self.absolute_position() + target - here;
        let (reverse, forward) = self.memory.range;
        // The factory range is none: a relative move may then turn on without end.
        let narrowed = self.memory.range != (-(POSITION_MAX as i16), POSITION_MAX as i16);
        let bounded = narrowed || self.options.ends.is_some();
        if bounded && !(i64::from(reverse)..=i64::from(forward)).contains(&goal) {
            return Response::Refused;
        }
        self.relative_target = Some(target);
        let position = self.memory.relative_zero + radians(target);
        self.shaft.move_to(position, rad_per_s(rpm.into()));
        // Sent twice, this would move twice: the witness of a test bench counts it apart.
        (self.starts, self.unrepeatable) = (self.starts + 1, self.unrepeatable + 1);
        Response::Done
    }

    fn can_position(&self) -> bool {
        self.faults & (fault::OUTPUT_CLOSED | fault::ENCODER) == 0 && !self.stop_latched
    }

    /// LS. \[I\] The output is off, moves are given up, the next command runs again.
    fn execute_emergency_stop(&mut self) -> Response {
        self.shaft.disable_output();
        self.relative_target = None;
        self.stop_latched = self.options.latches_stop;
        Response::Done
    }

    /// [I\] RZ makes this position the relative zero; RC clears the counter and the rest of a move. Both make QR
    /// read 0.
    fn set_zero(&mut self, command: CommandWord) -> Response {
        debug_assert!(self.shaft.position().is_finite());
        let here = self.shaft.position();
        match command {
            CommandWord::AZ => self.memory.absolute_zero = here,
            CommandWord::RC => {
                if self.relative_target.take().is_some() {
                    // Without this the axis would go on to a target that lost its meaning with the old zero.
                    self.shaft.set_velocity(0.0);
                }
                self.memory.relative_zero = here;
                return Response::Done;
            }
            _ => {
                // The target keeps its place on the shaft: only its number changes with the zero.
                self.relative_target = self
                    .relative_target
                    .map(|way| way - self.shaft.position_tenths(self.memory.relative_zero));
                self.memory.relative_zero = here;
            }
        }
        self.writes += 1;
        Response::Done
    }

    fn execute_set(&mut self, command: CommandWord, data: u32) -> Response {
        let memory = &mut self.memory;
        match (command, u16::try_from(data)) {
            (CommandWord::CI, Ok(id @ 1..=127)) => memory.id = id as u8,
            (CommandWord::CB, Ok(rate)) if BIT_RATES.contains(&rate) => memory.kbit_s = rate,
            (CommandWord::ST, Ok(ms)) if ms == 0 || TIMEOUT_MS.contains(&ms) => {
                self.timeout_ms = ms;
                return Response::Done;
            }
            (CommandWord::SR, _) if data <= 0xFF_FFFF => {
                (memory.frames, memory.interval_ms) = ((data >> 16) as u8, data as u16);
            }
            _ => return Response::Refused,
        }
        self.writes += 1;
        Response::Done
    }

    /// \[I\] Tenths of a degree; a positive reverse end is taken for its magnitude.
    fn set_range(&mut self, data: u32) -> Response {
        let (reverse, forward) = rules::range_ends(data);
        let max = POSITION_MAX as i16;
        let reverse = if reverse > 0 { -reverse } else { reverse };
        if reverse < -max || !(0..=max).contains(&forward) {
            return Response::Refused;
        }
        self.memory.range = (reverse, forward);
        self.writes += 1;
        Response::Done
    }
}
