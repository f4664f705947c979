//! One drive as an axis, driven by its profile.
//!
//! Spaces of a profile: `command`, the letters that read or write a value; `internal`, a type of SP and RP;
//! `internal high` and `internal low`, its halves, read only. [`Send`](crate::plan::Step::Send): function 0
//! sends the command `index` with the value, function 1 without; 2 and 3 are LA and LR with the value, at
//! the caller's speed, else at `index` rpm; 4 sends the query `index`, so that a step can name and check
//! the parameters of LA and LR.

use super::generic::GENERIC;
use super::host::CanHost;
use super::interpretation::{Interpretation, is_command};
use super::rules;
use super::rules::class_of;
use super::session::{Answer, HostRequest};
use super::text::{self, Statement};
use super::wire::{
    CommandKind, CommandWord, DriveMessage, RANGE_PARAMETER, Reply, ReportFrame, Request, Width,
    node_of_id,
};
use crate::axis::{
    self, AnswerDecoder, DriveReport, Driver, REPORTS_MAX, ReportDriver, RequestEncoder, WriteRules,
};
use crate::error::{Failure, Unsupported};
use crate::explain::RawFrame;
use crate::medium::{Can, Frame};
use crate::plan::Argument;
use crate::profile::{AddressRole, Encoding, Parameter, ParameterId, Profile};
use crate::proto::options::{self, OptionKey};
use crate::proto::{HostOptions, Protocol};
use crate::station::RequestClass;

/// One drive.
#[derive(Clone, Copy, Debug)]
pub struct ThrusterDriver {
    profile: &'static Profile,
    id: u8,
    interpretation: Interpretation,
    /// SPLA as it was read last: one end is written with the other.
    range: Option<u32>,
}

impl ThrusterDriver {
    /// The drive of that id.
    #[must_use]
    pub fn new(profile: &'static Profile, address: u32) -> Self {
        Self {
            profile,
            id: address as u8,
            interpretation: Interpretation::of(profile),
            range: None,
        }
    }

    /// A request that keeps the rules.
    fn new_request(
        &self,
        request: Request,
        class: Option<RequestClass>,
    ) -> Result<HostRequest, Unsupported> {
        rules::check(&request).map_err(Unsupported::Forbidden)?;
        let class = class.unwrap_or_else(|| class_of(&request));
        Ok(HostRequest { id: self.id, request, class, interpretation: self.interpretation })
    }

    /// The parameter that a command reads or writes.
    fn find_parameter(&self, command: CommandWord) -> Option<(ParameterId, &'static Parameter)> {
        let at = self.profile.parameters.iter().position(|p| is_command(p, command))?;
        let id = ParameterId(u16::try_from(at).ok()?);
        Some((id, self.profile.parameter(id)?))
    }

    /// LA or LR: the speed is the caller's, if he names one.
    fn positioning_request(
        &self,
        command: CommandWord,
        given: Option<f64>,
        usual: u16,
        way: i64,
    ) -> Result<HostRequest, Unsupported> {
        let sub = match (given, self.find_parameter(CommandWord::VC)) {
            (None, _) | (_, None) => usual,
            (Some(si), Some((id, speed))) => {
                let raw = libm::round(si.abs() / (speed.scale.factor * speed.unit.si_factor()));
                let (max, value) = (speed.max.min(u16::MAX.into()), raw as i64);
                let wrong = Unsupported::OutOfRange { parameter: id, value, min: 1, max };
                Some(value).filter(|v| (1..=max).contains(v)).ok_or(wrong)? as u16
            }
        };
        let way = i32::try_from(way).map_err(|_| Unsupported::BadArgument)?;
        self.new_request(Request { command, sub, data: Some(way.cast_unsigned()) }, None)
    }

    /// Data of an SP write: a parameter of its own, or one end of the safe range beside the other.
    fn internal_data(&self, space: u8, raw: i64) -> Result<u32, Unsupported> {
        if space == 1 {
            return Ok(raw as u32);
        }
        let range = self.range.ok_or(Unsupported::Forbidden(RANGE_UNREAD))?;
        let (reverse, forward) = rules::range_ends(range);
        Ok(match space {
            2 => rules::range_data(raw as i16, forward),
            _ => rules::range_data(reverse, raw as i16),
        })
    }

    /// The value of a parameter in a report.
    fn parameter_report(&self, command: CommandWord, raw: i64) -> Option<DriveReport> {
        self.find_parameter(command).map(|(id, _)| DriveReport::Parameter(id, raw))
    }

    fn decode_report(&self, report: &ReportFrame) -> [Option<DriveReport>; REPORTS_MAX] {
        let [a, b, c] = report.words;
        match report.part {
            1 => [
                self.parameter_report(CommandWord::QV, signed_word(a)),
                self.parameter_report(CommandWord::QP, b.into()),
                self.parameter_report(CommandWord::QC, signed_word(c)),
                None,
            ],
            2 => [
                self.parameter_report(CommandWord::EF, a.into()),
                self.parameter_report(CommandWord::QT, signed_word(b)),
                self.parameter_report(CommandWord::EQ, signed_word(c)),
                None,
            ],
            _ => {
                let (absolute, relative) = self.interpretation.positions(report);
                let absolute = self.parameter_report(CommandWord::QA, absolute.into());
                [absolute, self.parameter_report(CommandWord::QR, relative.into()), None, None]
            }
        }
    }
}

fn signed_word(word: u16) -> i64 {
    i64::from(word.cast_signed())
}

const RANGE_UNREAD: &str =
    "one end of the safe range is written with the other, which was not read yet";

/// The request that a parameter's value means: its command with the value; a command that takes none, such
/// as `AZ`; or for the report of speed and current the one of three that the value chooses.
fn command_of_value(parameter: &Parameter, raw: i64) -> Request {
    let command = CommandWord(parameter.index);
    match command.definition() {
        Some((CommandKind::Zeros, _)) => Request { command, sub: 0, data: Some(0) },
        Some((CommandKind::Order, _)) => Request::without_value(match raw {
            1 => CommandWord::ML,
            2 => CommandWord::MM,
            _ => command,
        }),
        _ => Request { command, sub: 0, data: Some(encode_value(Some(parameter), command, raw)) },
    }
}

/// Data bytes of a value, in the width that the profile has for this drive.
fn encode_value(parameter: Option<&Parameter>, command: CommandWord, value: i64) -> u32 {
    match parameter.map(|parameter| parameter.encoding) {
        Some(Encoding::I32) => value as u32,
        Some(Encoding::I16) => Width::Signed.encode(value),
        _ => command.width().encode(value),
    }
}

fn decode_value(parameter: &Parameter, data: u32) -> i64 {
    match (parameter.space, parameter.encoding) {
        (2, _) => i64::from(((data >> 16) as u16).cast_signed()),
        (3, _) => i64::from((data as u16).cast_signed()),
        (_, Encoding::I16) => Width::Signed.decode(data),
        (_, Encoding::I32) => Width::Long.decode(data),
        _ => Width::Unsigned.decode(data),
    }
}

impl RequestEncoder for ThrusterDriver {
    type Request = HostRequest;

    fn read_request(&self, parameter: &Parameter) -> Result<HostRequest, Unsupported> {
        let request = match parameter.space {
            0 => Request::without_value(CommandWord(parameter.index)),
            _ => Request { sub: parameter.index, ..Request::without_value(CommandWord::RP) },
        };
        self.new_request(request, Some(RequestClass::Idempotent))
    }

    fn write_request(
        &self,
        parameter: &Parameter,
        raw: i64,
        class: RequestClass,
    ) -> Result<HostRequest, Unsupported> {
        let request = match parameter.space {
            0 => command_of_value(parameter, raw),
            space => {
                let data = self.internal_data(space, raw)?;
                Request { command: CommandWord::SP, sub: parameter.index, data: Some(data) }
            }
        };
        let stop = class_of(&request) == RequestClass::Stop;
        self.new_request(request, Some(if stop { RequestClass::Stop } else { class }))
    }

    fn function_request(
        &self,
        function: u8,
        index: u16,
        value: i64,
    ) -> Result<HostRequest, Unsupported> {
        let command = CommandWord(index);
        match function {
            0 => {
                let parameter = self.find_parameter(command).map(|(_, parameter)| parameter);
                let data = Some(encode_value(parameter, command, value));
                self.new_request(Request { command, sub: 0, data }, None)
            }
            1 => self.new_request(Request::without_value(command), None),
            2 => self.positioning_request(CommandWord::LA, None, index, value),
            3 => self.positioning_request(CommandWord::LR, None, index, value),
            4 => self.new_request(Request::without_value(command), Some(RequestClass::Idempotent)),
            _ => Err(Unsupported::NoPlan),
        }
    }

    fn command_request(
        &self,
        command: &axis::Command,
        function: u8,
        index: u16,
        value: i64,
    ) -> Result<HostRequest, Unsupported> {
        let velocity = command.argument(Argument::Velocity);
        match function {
            2 => self.positioning_request(CommandWord::LA, velocity, index, value),
            3 => self.positioning_request(CommandWord::LR, velocity, index, value),
            _ => self.function_request(function, index, value),
        }
    }

    fn parse_request(&self, text: &str) -> Result<HostRequest, Unsupported> {
        use crate::explain::EncodeError;
        match text::parse(text, self.interpretation) {
            Ok(Statement::Request(request)) => self.new_request(request, None),
            Err(EncodeError::Forbidden(rule)) => Err(Unsupported::Forbidden(rule)),
            _ => Err(Unsupported::BadText),
        }
    }

    fn decode_request(&self, frame: &RawFrame<'_>) -> Result<HostRequest, Unsupported> {
        let request = Request::parse(frame.bytes).map_err(|_| Unsupported::BadBytes)?;
        let its = request.frame(self.id);
        match (frame.id, frame.extended) {
            (Some(id), false) if id == its.id && frame.bytes == its.bytes() => {
                self.new_request(request, None)
            }
            _ => Err(Unsupported::BadBytes),
        }
    }
}

impl AnswerDecoder for ThrusterDriver {
    type Answer = Answer;

    /// Without a parameter, a reply is its eight bytes.
    fn decode_answer(
        &mut self,
        parameter: Option<&Parameter>,
        answer: &Answer,
    ) -> Result<i64, Failure> {
        if let (Answer::Reply(reply), Some(parameter)) = (answer, parameter)
            && parameter.space != 0
            && parameter.index == RANGE_PARAMETER
        {
            self.range = Some(reply.data);
        }
        Ok(match (answer, parameter) {
            (Answer::Reply(reply), Some(parameter)) => decode_value(parameter, reply.data),
            (Answer::Reply(reply), None) => frame_number(reply.frame(self.id)),
            (Answer::Report(report), _) => frame_number(report.frame(self.id)),
            (Answer::Headerless(bare), _) => frame_number(bare.frame(self.id)),
            (Answer::OutputOff { faults }, _) => (*faults).into(),
            (Answer::Proven, _) => 0,
        })
    }

    fn decode_unsolicited(&mut self, answer: &Answer) -> [Option<DriveReport>; REPORTS_MAX] {
        match answer {
            Answer::Reply(Reply { command, data, .. }) => {
                let reported = self.find_parameter(*command);
                let result =
                    reported.map(|(id, p)| DriveReport::Parameter(id, decode_value(p, *data)));
                [result, None, None, None]
            }
            Answer::Report(report) => self.decode_report(report),
            Answer::Headerless(bare) => [
                self.parameter_report(CommandWord::QV, bare.rpm.into()),
                self.parameter_report(CommandWord::QP, bare.decivolt.into()),
                self.parameter_report(CommandWord::QC, bare.deciamp.into()),
                self.parameter_report(CommandWord::EF, bare.status.into()),
            ],
            Answer::Proven | Answer::OutputOff { .. } => [None; REPORTS_MAX],
        }
    }
}

impl WriteRules for ThrusterDriver {
    fn reads_before_write(&self, parameter: &Parameter) -> bool {
        matches!(parameter.space, 2 | 3)
    }

    fn address_role(&self, parameter: &Parameter) -> Option<AddressRole> {
        (parameter.index == CommandWord::CI.0).then_some(AddressRole::DriveAfterRestart)
    }
}

impl ReportDriver for ThrusterDriver {
    fn report_setting(
        &self,
        parameters: &[ParameterId],
        interval_ms: u16,
    ) -> Option<(ParameterId, i64)> {
        let (setting, _) = self.find_parameter(CommandWord::SR)?;
        let frame_bit = |id: &ParameterId| {
            let parameter = self.profile.parameter(*id).filter(|p| p.space == 0)?;
            ReportFrame::part_with(CommandWord(parameter.index)).map(|part| 1_i64 << (part - 1))
        };
        let mut frames = 0;
        for id in parameters {
            frames |= frame_bit(id)?;
        }
        let interval = if frames == 0 { 0 } else { i64::from(interval_ms) };
        Some((setting, frames << 16 | interval))
    }
}

impl Driver for ThrusterDriver {
    fn profile(&self) -> &'static Profile {
        self.profile
    }

    fn address(&self) -> u32 {
        self.id.into()
    }

    fn reports(&self) -> Option<&dyn ReportDriver> {
        Some(self)
    }
}

fn frame_number(frame: Frame) -> i64 {
    u64::from_be_bytes(frame.data).cast_signed()
}

/// Thrusters, servos and actuators on CAN.
#[derive(Debug)]
pub enum Thruster {}

impl Protocol for Thruster {
    type Medium = Can;
    type Host = CanHost;
    const NAME: &'static str = "thruster";
    const PROFILE_PROTOCOL: &'static str = "thruster";
    const SCAN_ADDRESSES: core::ops::RangeInclusive<u32> = 1..=127;
    const VALID_ADDRESSES: core::ops::RangeInclusive<u32> = 1..=127;
    // The manual does not state it; public drivers use this one. [I]
    const DEFAULT_RATE: u32 = 500_000;
    const KEYS: &[OptionKey] = &[options::TIMEOUT];

    fn generic_profile() -> &'static Profile {
        &GENERIC
    }

    fn create_host(options: &HostOptions, _axes: &[u32]) -> CanHost {
        CanHost::new(options)
    }

    fn uses_can_id(address: u32, id: u32, extended: bool) -> bool {
        let named = node_of_id(id).filter(|_| !extended);
        named.is_some_and(|(Ok(node) | Err(node))| u32::from(node) == address)
    }

    /// Only what no mapped value is likely to be: a report of SR, or a value of a known command.
    fn frame_sender(_options: &HostOptions, frame: &Frame) -> Option<u32> {
        let Some(Err(id)) = node_of_id(frame.id).filter(|_| !frame.extended && !frame.remote)
        else {
            return None;
        };
        match DriveMessage::parse(frame.bytes()).ok()? {
            DriveMessage::Reply(reply) if reply.sub == 0 => {
                reply.command.definition().map(|_| id.into())
            }
            DriveMessage::Report(ReportFrame { source: ReportFrame::UNSOLICITED, .. }) => {
                Some(id.into())
            }
            _ => None,
        }
    }

    fn create_driver(
        profile: &'static Profile,
        address: u32,
    ) -> impl Driver<Request = HostRequest, Answer = Answer> + Send + 'static {
        ThrusterDriver::new(profile, address)
    }
}
