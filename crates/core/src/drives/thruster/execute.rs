//! What each command does (protocol manual, sections 2.1 to 4.3).

use super::drive::Drive;
use super::shaft::{rad_per_s, radians};
use crate::proto::thruster::device::{Firmware, Response, Telemetry};
use crate::proto::thruster::fault;
use crate::proto::thruster::rules;
use crate::proto::thruster::wire::{
    BIT_RATES, Command, POSITION_MAX, RANGE, RPM_MIN, Request, TIMEOUT_MS,
};
use crate::time::Instant;

impl Firmware for Drive {
    fn id(&self) -> u8 {
        self.running.0
    }

    fn bit_rate(&self) -> u32 {
        self.running.1
    }

    fn reports(&self) -> (u8, u16) {
        (self.memory.frames, self.memory.interval_ms)
    }

    /// Any command ends a timeout stop; the one that does can still ask for it (section 2.3).
    fn heard(&mut self, now: Instant, _request: &Request) {
        self.last_heard = now;
        self.told_timeout = self.faults & fault::TIMEOUT;
        self.faults &= !fault::TIMEOUT;
    }

    fn execute(&mut self, _now: Instant, request: &Request) -> Response {
        let Request { command, sub, data } = *request;
        if command.is_position() && !self.options.encoder && command != Command::LS {
            return Response::Refused;
        }
        let data = data.unwrap_or(0);
        let value = command.width().read(data);
        match command {
            Command::TC | Command::VC => self.output(command, value),
            Command::LA => self.absolute_move(sub, value),
            Command::LR => self.relative_move(sub, value),
            Command::LS => self.emergency_stop(),
            Command::CF => {
                self.clear_faults();
                Response::Done
            }
            Command::AZ | Command::RZ | Command::RC => self.set_zero(command),
            Command::CI | Command::CB | Command::ST | Command::SR => self.set(command, data),
            Command::SP if sub == RANGE && self.options.encoder => self.set_range(data),
            Command::RP if sub == RANGE && self.options.encoder => {
                let (reverse, forward) = self.memory.range;
                Response::Value(rules::range_of(reverse, forward))
            }
            _ => self.query(command),
        }
    }

    fn telemetry(&self) -> Telemetry {
        self.told()
    }
}

impl Drive {
    fn query(&self, command: Command) -> Response {
        let told = self.told();
        let value = match command {
            Command::QV => told.rpm.into(),
            Command::QC => told.deciamp.into(),
            Command::QP => told.decivolt.into(),
            Command::QT => told.motor_c.into(),
            Command::EQ => told.driver_c.into(),
            Command::EF => told.faults.into(),
            Command::FR => self.history.into(),
            Command::QA => told.absolute.into(),
            Command::QR => told.relative.into(),
            _ => return Response::Refused,
        };
        Response::Value(command.width().write(value))
    }

    /// TC and VC: zero always, others while the output is neither closed nor forbidden, as it is until
    /// the signal was zero once (zero-point protection).
    fn output(&mut self, command: Command, value: i64) -> Response {
        if value == 0 {
            self.armed = true;
            self.faults &= !fault::ZERO_POINT;
            self.way = None;
            self.rest(command);
            return Response::Done;
        }
        if self.faults & fault::CLOSED != 0 || self.latched {
            return Response::Refused;
        }
        if !self.armed && self.options.zero_point {
            self.trip(fault::ZERO_POINT, "the signal was not zero yet: output forbidden");
            return Response::Refused;
        }
        let slow = value.abs() < i64::from(RPM_MIN);
        match command {
            Command::TC if value.abs() > 100 => return Response::Refused,
            Command::TC => self.shaft.signal(value as f64 / 100.0),
            _ if slow && !self.options.runs_slowly => return Response::Refused,
            _ if value.abs() > i64::from(i16::MAX) => return Response::Refused,
            _ => {
                let size = value.abs().max(RPM_MIN.into());
                self.shaft.turn(rad_per_s((size * value.signum()) as f64));
            }
        }
        self.way = None;
        self.starts += 1;
        Response::Done
    }

    /// \[I\] Without an encoder, and by signal, zero is no output; a servo brakes to speed zero.
    fn rest(&mut self, command: Command) {
        match command == Command::VC && self.options.encoder && self.shaft.servo.is_enabled() {
            true => self.shaft.turn(0.0),
            false => self.shaft.off(),
        }
    }

    fn absolute_move(&mut self, rpm: u16, target: i64) -> Response {
        let (reverse, forward) = self.memory.range;
        let inside = (i64::from(reverse)..=i64::from(forward)).contains(&target);
        if !self.may_position() || target.abs() > POSITION_MAX.into() || !inside {
            return Response::Refused;
        }
        if rpm > 0 {
            let way = radians(target - self.absolute());
            self.shaft.go(self.shaft.position() + way, rad_per_s(rpm.into()));
            self.way = None;
            self.starts += 1;
        }
        Response::Done
    }

    /// Each one adds to where the last one goes. \[I\] The safe range holds for it too.
    fn relative_move(&mut self, rpm: u16, by: i64) -> Response {
        if !self.may_position() {
            return Response::Refused;
        }
        if rpm == 0 {
            return Response::Done;
        }
        let here = self.shaft.tenths(self.memory.relative_zero);
        let target = self.way.unwrap_or(here) + by;
        let goal = self.absolute() + target - here;
        let (reverse, forward) = self.memory.range;
        let narrowed = self.memory.range != (-(POSITION_MAX as i16), POSITION_MAX as i16);
        if narrowed && !(i64::from(reverse)..=i64::from(forward)).contains(&goal) {
            return Response::Refused;
        }
        self.way = Some(target);
        let position = self.memory.relative_zero + radians(target);
        self.shaft.go(position, rad_per_s(rpm.into()));
        (self.starts, self.unrepeatable) = (self.starts + 1, self.unrepeatable + 1);
        Response::Done
    }

    fn may_position(&self) -> bool {
        self.faults & (fault::CLOSED | fault::ENCODER) == 0 && !self.latched
    }

    /// LS. \[I\] The output is off, moves are given up, the next command runs again.
    fn emergency_stop(&mut self) -> Response {
        self.shaft.off();
        self.way = None;
        self.latched = self.options.latches_stop;
        Response::Done
    }

    /// \[I\] RZ makes this place the relative zero; RC clears the counter and what is left of a move.
    /// Both make QR read 0.
    fn set_zero(&mut self, command: Command) -> Response {
        let here = self.shaft.position();
        match command {
            Command::AZ => self.memory.absolute_zero = here,
            Command::RC => {
                if self.way.take().is_some() {
                    self.shaft.turn(0.0);
                }
                self.memory.relative_zero = here;
                return Response::Done;
            }
            _ => {
                self.way = self.way.map(|way| way - self.shaft.tenths(self.memory.relative_zero));
                self.memory.relative_zero = here;
            }
        }
        self.writes += 1;
        Response::Done
    }

    fn set(&mut self, command: Command, data: u32) -> Response {
        let memory = &mut self.memory;
        match (command, u16::try_from(data)) {
            (Command::CI, Ok(id @ 1..=127)) => memory.id = id as u8,
            (Command::CB, Ok(rate)) if BIT_RATES.contains(&rate) => memory.kbit_s = rate,
            (Command::ST, Ok(ms)) if ms == 0 || TIMEOUT_MS.contains(&ms) => {
                self.timeout_ms = ms;
                return Response::Done;
            }
            (Command::SR, _) if data <= 0xFF_FFFF => {
                (memory.frames, memory.interval_ms) = ((data >> 16) as u8, data as u16);
            }
            _ => return Response::Refused,
        }
        self.writes += 1;
        Response::Done
    }

    /// \[I\] Tenths of a degree; a positive reverse end is taken for its magnitude.
    fn set_range(&mut self, data: u32) -> Response {
        let (reverse, forward) = rules::ends(data);
        let most = POSITION_MAX as i16;
        let reverse = if reverse > 0 { -reverse } else { reverse };
        if reverse < -most || !(0..=most).contains(&forward) {
            return Response::Refused;
        }
        self.memory.range = (reverse, forward);
        self.writes += 1;
        Response::Done
    }
}
