//! One drive as an axis, from its profile alone.
//!
//! A profile's spaces: `command`, the letters of what reads or writes a value; `internal`, a type of
//! SP and RP; `internal high` and `internal low`, its halves, to be read.
//! [`Send`](crate::plan::Step::Send): function 0 sends the command `index` with the value, function 1
//! without; 2 and 3 are LA and LR to or by the value, as fast as the caller says, else with `index`
//! rpm; 4 asks the query `index`, so that a step can name, and have checked, what LA and LR carry.

use super::generic::GENERIC;
use super::host::CanHost;
use super::readings::{Readings, is_command};
use super::rules;
use super::rules::class_of;
use super::session::{Answer, Ask};
use super::text::{self, Said};
use super::wire::{Command, Heard, Reply, Report, Request, Width, node};
use crate::axis::{self, Driver, TOLD_MAX, Told};
use crate::error::{Failure, Unsupported};
use crate::explain::Raw;
use crate::medium::{Can, Frame};
use crate::plan::Argument;
use crate::profile::{Encoding, Parameter, ParameterId, Profile};
use crate::proto::{HostOptions, Protocol};
use crate::station::Class;

/// One drive.
#[derive(Clone, Copy, Debug)]
pub struct Axis {
    profile: &'static Profile,
    id: u8,
    readings: Readings,
}

impl Axis {
    /// The drive of that id.
    #[must_use]
    pub fn new(profile: &'static Profile, address: u32) -> Self {
        Self { profile, id: address as u8, readings: Readings::of(profile) }
    }

    /// A request that keeps the rules.
    fn ask(&self, request: Request, class: Option<Class>) -> Result<Ask, Unsupported> {
        rules::check(&request).map_err(Unsupported::Forbidden)?;
        let class = class.unwrap_or_else(|| class_of(&request));
        Ok(Ask { id: self.id, request, class, readings: self.readings })
    }

    /// What a command reads or writes.
    fn parameter(&self, command: Command) -> Option<(ParameterId, &'static Parameter)> {
        let of_command = |p: &Parameter| is_command(p, command);
        let at = self.profile.parameters.iter().position(of_command)?;
        let id = ParameterId(u16::try_from(at).ok()?);
        Some((id, self.profile.parameter(id)?))
    }

    /// LA or LR: the speed is the caller's, if he names one.
    fn positioning(
        &self,
        command: Command,
        given: Option<f64>,
        usual: u16,
        way: i64,
    ) -> Result<Ask, Unsupported> {
        let sub = match (given, self.parameter(Command::VC)) {
            (None, _) | (_, None) => usual,
            (Some(si), Some((id, speed))) => {
                let raw = libm::round(si.abs() / (speed.scale.factor * speed.unit.si()));
                let (max, value) = (speed.max.min(u16::MAX.into()), raw as i64);
                let wrong = Unsupported::OutOfRange { parameter: id, value, min: 1, max };
                Some(value).filter(|v| (1..=max).contains(v)).ok_or(wrong)? as u16
            }
        };
        let way = i32::try_from(way).map_err(|_| Unsupported::BadArgument)?;
        self.ask(Request { command, sub, data: Some(way.cast_unsigned()) }, None)
    }

    /// A value of a parameter, told by a report.
    fn told(&self, command: Command, raw: i64) -> Option<Told> {
        self.parameter(command).map(|(id, _)| Told::Parameter(id, raw))
    }

    fn report(&self, report: &Report) -> [Option<Told>; TOLD_MAX] {
        let [a, b, c] = report.words;
        let signed = |word: u16| i64::from(word.cast_signed());
        match report.part {
            1 => [
                self.told(Command::QV, signed(a)),
                self.told(Command::QP, b.into()),
                self.told(Command::QC, signed(c)),
                None,
            ],
            2 => [
                self.told(Command::EF, a.into()),
                self.told(Command::QT, signed(b)),
                self.told(Command::EQ, signed(c)),
                None,
            ],
            _ => {
                let (absolute, relative) = self.readings.positions(report);
                let absolute = self.told(Command::QA, absolute.into());
                [absolute, self.told(Command::QR, relative.into()), None, None]
            }
        }
    }
}

/// The data of a value: as wide as the profile says that this drive wants it.
fn data_of(parameter: Option<&Parameter>, command: Command, value: i64) -> u32 {
    match parameter.map(|parameter| parameter.encoding) {
        Some(Encoding::I32) => value as u32,
        Some(Encoding::I16) => Width::Signed.write(value),
        _ => command.width().write(value),
    }
}

fn value_of(parameter: &Parameter, data: u32) -> i64 {
    match (parameter.space, parameter.encoding) {
        (2, _) => i64::from(((data >> 16) as u16).cast_signed()),
        (3, _) => i64::from((data as u16).cast_signed()),
        (_, Encoding::I16) => Width::Signed.read(data),
        (_, Encoding::I32) => Width::Long.read(data),
        _ => Width::Unsigned.read(data),
    }
}

impl Driver for Axis {
    type Request = Ask;
    type Answer = Answer;

    fn profile(&self) -> &'static Profile {
        self.profile
    }

    fn address(&self) -> u32 {
        self.id.into()
    }

    fn read(&self, parameter: &Parameter) -> Result<Ask, Unsupported> {
        let request = match parameter.space {
            0 => Request::plain(Command(parameter.index)),
            _ => Request { sub: parameter.index, ..Request::plain(Command::RP) },
        };
        self.ask(request, Some(Class::Idempotent))
    }

    fn write(&self, parameter: &Parameter, raw: i64, class: Class) -> Result<Ask, Unsupported> {
        let request = match parameter.space {
            0 => {
                let command = Command(parameter.index);
                let data = data_of(Some(parameter), command, raw);
                Request { command, sub: 0, data: Some(data) }
            }
            _ => Request { command: Command::SP, sub: parameter.index, data: Some(raw as u32) },
        };
        let stop = class_of(&request) == Class::Stop;
        self.ask(request, Some(if stop { Class::Stop } else { class }))
    }

    fn send(&self, function: u8, index: u16, value: i64) -> Result<Ask, Unsupported> {
        let command = Command(index);
        match function {
            0 => {
                let parameter = self.parameter(command).map(|(_, parameter)| parameter);
                let data = Some(data_of(parameter, command, value));
                self.ask(Request { command, sub: 0, data }, None)
            }
            1 => self.ask(Request::plain(command), None),
            2 => self.positioning(Command::LA, None, index, value),
            3 => self.positioning(Command::LR, None, index, value),
            4 => self.ask(Request::plain(command), Some(Class::Idempotent)),
            _ => Err(Unsupported::NoPlan),
        }
    }

    fn send_for(
        &self,
        command: &axis::Command,
        function: u8,
        index: u16,
        value: i64,
    ) -> Result<Ask, Unsupported> {
        let velocity = command.argument(Argument::Velocity);
        match function {
            2 => self.positioning(Command::LA, velocity, index, value),
            3 => self.positioning(Command::LR, velocity, index, value),
            _ => self.send(function, index, value),
        }
    }

    fn parse(&self, text: &str) -> Result<Ask, Unsupported> {
        use crate::explain::EncodeError;
        match text::parse(text, self.readings) {
            Ok(Said::Request(request)) => self.ask(request, None),
            Err(EncodeError::Forbidden(rule)) => Err(Unsupported::Forbidden(rule)),
            _ => Err(Unsupported::BadText),
        }
    }

    fn decode(&self, frame: &Raw<'_>) -> Result<Ask, Unsupported> {
        let request = Request::parse(frame.bytes).map_err(|_| Unsupported::BadBytes)?;
        let its = request.frame(self.id);
        match (frame.id, frame.extended) {
            (Some(id), false) if id == its.id && frame.bytes == its.bytes() => {
                self.ask(request, None)
            }
            _ => Err(Unsupported::BadBytes),
        }
    }

    /// Without a parameter, a reply is its eight bytes.
    fn answer(&mut self, parameter: Option<&Parameter>, answer: &Answer) -> Result<i64, Failure> {
        let bytes = |frame: Frame| u64::from_be_bytes(frame.data).cast_signed();
        Ok(match (answer, parameter) {
            (Answer::Reply(reply), Some(parameter)) => value_of(parameter, reply.data),
            (Answer::Reply(reply), None) => bytes(reply.frame(self.id)),
            (Answer::Report(report), _) => bytes(report.frame(self.id)),
            (Answer::Bare(bare), _) => bytes(bare.frame(self.id)),
            (Answer::Off { faults }, _) => (*faults).into(),
            (Answer::Proven, _) => 0,
        })
    }

    fn unasked(&mut self, answer: &Answer) -> [Option<Told>; TOLD_MAX] {
        match answer {
            Answer::Reply(Reply { command, data, .. }) => {
                let told = self.parameter(*command);
                let told = told.map(|(id, p)| Told::Parameter(id, value_of(p, *data)));
                [told, None, None, None]
            }
            Answer::Report(report) => self.report(report),
            Answer::Bare(bare) => [
                self.told(Command::QV, bare.rpm.into()),
                self.told(Command::QP, bare.decivolt.into()),
                self.told(Command::QC, bare.deciamp.into()),
                self.told(Command::EF, bare.status.into()),
            ],
            Answer::Proven | Answer::Off { .. } => [None; TOLD_MAX],
        }
    }
}

/// Thrusters, servos and actuators on CAN.
#[derive(Debug)]
pub enum Thruster {}

impl Protocol for Thruster {
    type Medium = Can;
    type Host = CanHost;
    const NAME: &'static str = "thruster";
    const PROFILE: &'static str = "thruster";
    const ADDRESSES: core::ops::RangeInclusive<u32> = 1..=127;
    const EVERY_ADDRESS: core::ops::RangeInclusive<u32> = 1..=127;
    // The manual does not state it; public drivers use this one. [I]
    const BAUD: u32 = 500_000;

    fn generic() -> &'static Profile {
        &GENERIC
    }

    fn host(options: &HostOptions, _axes: &[u32]) -> CanHost {
        CanHost::new(options)
    }

    fn uses(address: u32, id: u32, extended: bool) -> bool {
        let named = node(id).filter(|_| !extended);
        named.is_some_and(|(Ok(node) | Err(node))| u32::from(node) == address)
    }

    /// Only what no mapped value is likely to be: a report of SR, or a value of a known command.
    fn sender(_options: &HostOptions, frame: &Frame) -> Option<u32> {
        let Some(Err(id)) = node(frame.id).filter(|_| !frame.extended && !frame.remote) else {
            return None;
        };
        match Heard::parse(frame.bytes()).ok()? {
            Heard::Reply(reply) if reply.sub == 0 => reply.command.known().map(|_| id.into()),
            Heard::Report(Report { of: Report::BY_ITSELF, .. }) => Some(id.into()),
            _ => None,
        }
    }

    fn driver(
        profile: &'static Profile,
        address: u32,
    ) -> impl Driver<Request = Ask, Answer = Answer> + Send + 'static {
        Axis::new(profile, address)
    }
}
