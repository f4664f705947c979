//! An axis of any TMCL module, driven by its profile.
//!
//! Spaces are those of [`address`](super::address::Space): axis parameters (GAP, SAP), global ones (GGP,
//! SGP), inputs and outputs (GIO, SIO). A parameter number above 255 has its upper bits in the motor byte,
//! above the axis, as in the vendor's host library.

use super::address::Space;
use super::generic::GENERIC;
use super::host::{CanHost, SerialHost, reply_sender};
use super::instructions::TmclInstructions;
use super::opcode::{Opcode, Status};
use super::session::{Answer, HostRequest, Storing};
use super::text;
use super::wire::Request;
use crate::axis::{
    AnswerDecoder, DriveReport, Driver, ProgramDriver, REPORTS_MAX, Refusal, RequestEncoder,
    WriteRules,
};
use crate::error::{Failure, Unsupported};
use crate::explain::RawFrame;
use crate::medium::{Can, Frame, Stream};
use crate::profile::{AddressRole, Parameter, Profile, Signal};
use crate::program::{InstructionLanguage as _, ProgramCommand};
use crate::proto::options::{self, OptionKey, OptionKind};
use crate::proto::{HostOptions, Protocol, drive_address, sub_axis, with_sub_axis};
use crate::station::RequestClass;

/// Bits of the motor byte that name the axis, where parameter numbers go beyond 255. \[I\]
pub const AXIS_BITS: u8 = 4;

/// The motors that a module can have: those of the maker's largest.
const MOTORS: core::ops::RangeInclusive<u8> = 0..=5;

/// One motor of a module.
#[derive(Clone, Copy, Debug)]
pub struct TmclDriver {
    profile: &'static Profile,
    /// Address of the module, or the low byte of its CAN identifier.
    module: u8,
    can_id: u16,
    motor: u8,
    /// Numbers of the global parameters that hold the module's address and its host's.
    address_parameters: [u16; 2],
}

/// Serial address and serial host address (TMCL reference, global parameters of bank 0).
const SERIAL_ADDRESS_PARAMETERS: [u16; 2] = [66, 76];
/// CAN id of requests and of replies (the same).
const CAN_ADDRESS_PARAMETERS: [u16; 2] = [71, 70];
/// The space of bank 0.
const BANK_0: u8 = 1;

impl TmclDriver {
    /// A motor of a module of a serial line, by its address.
    #[must_use]
    pub fn new(profile: &'static Profile, address: u32) -> Self {
        Self {
            profile,
            module: address as u8,
            can_id: drive_address(address) as u16,
            motor: sub_axis(address),
            address_parameters: SERIAL_ADDRESS_PARAMETERS,
        }
    }

    /// Creates the axis of a module on CAN.
    #[must_use]
    pub fn on_can(profile: &'static Profile, address: u32) -> Self {
        Self { address_parameters: CAN_ADDRESS_PARAMETERS, ..Self::new(profile, address) }
    }

    /// A request, and where it goes.
    const fn host_request(&self, request: Request) -> HostRequest {
        HostRequest { can_id: self.can_id, storing: Storing::Never, ..HostRequest::of(request) }
    }

    /// A request on a parameter, by the opcodes for axis parameters, global ones, inputs and outputs.
    fn parameter_request(
        &self,
        parameter: &Parameter,
        [axis, global, port]: [Opcode; 3],
        value: i32,
    ) -> Result<Request, Unsupported> {
        let (opcode, part) = match Space::of_number(parameter.space) {
            Space::Axis => (axis, self.motor),
            Space::Motor(motor) => (axis, motor),
            Space::Global(bank) => (global, bank),
            Space::Io(bank) => (port, bank),
            space @ (Space::OwnCoordinate | Space::Coordinate(_)) => {
                let motor = if let Space::Coordinate(motor) = space { motor } else { self.motor };
                match axis {
                    Opcode::Gap => (Opcode::Gco, motor),
                    Opcode::Sap => (Opcode::Sco, motor),
                    _ => return Err(Unsupported::NoPlan),
                }
            }
            Space::Search if axis == Opcode::Gap => (Opcode::Rfs, self.motor),
            Space::Search => return Err(Unsupported::NoPlan),
        };
        let motor = u32::from(parameter.index >> 8) << AXIS_BITS | u32::from(part);
        let motor = u8::try_from(motor)
            .map_err(|_| Unsupported::Forbidden("the parameter's number is too large for TMCL"))?;
        let kind = parameter.index as u8;
        Ok(Request { address: self.module, opcode, kind, motor, value })
    }
}

impl RequestEncoder for TmclDriver {
    type Request = HostRequest;

    fn read_request(&self, parameter: &Parameter) -> Result<HostRequest, Unsupported> {
        self.parameter_request(parameter, [Opcode::Gap, Opcode::Ggp, Opcode::Gio], 0)
            .map(|request| self.host_request(request))
    }

    fn write_request(
        &self,
        parameter: &Parameter,
        raw: i64,
        class: RequestClass,
    ) -> Result<HostRequest, Unsupported> {
        let request = self.parameter_request(
            parameter,
            [Opcode::Sap, Opcode::Sgp, Opcode::Sio],
            wire_value(raw)?,
        )?;
        Ok(HostRequest { class, ..self.host_request(request) })
    }

    /// `function` is the opcode, `index` the type and, in its high byte, the bank. Where the byte is the
    /// motor, it is the axis' own.
    fn function_request(
        &self,
        function: u8,
        index: u16,
        value: i64,
    ) -> Result<HostRequest, Unsupported> {
        let [part, kind] = index.to_be_bytes();
        let (opcode, value) = normalize_rotation(Opcode::from(function), wire_value(value)?);
        let motor = if opcode.has_motor() { self.motor } else { part };
        Ok(self.host_request(Request { address: self.module, opcode, kind, motor, value }))
    }

    fn store_request(&self, parameter: &Parameter) -> Result<HostRequest, Unsupported> {
        if let Space::Io(_) = Space::of_number(parameter.space) {
            return Err(Unsupported::NoPlan);
        }
        let opcodes = [Opcode::Stap, Opcode::Stgp, Opcode::Sio];
        self.parameter_request(parameter, opcodes, 0).map(|request| self.host_request(request))
    }

    fn parse_request(&self, text: &str) -> Result<HostRequest, Unsupported> {
        let request = text::parse(text, self.module).map_err(|_| Unsupported::BadText)?;
        Ok(HostRequest { storing: Storing::Allowed, ..self.host_request(request) })
    }

    /// Nine bytes on a serial line; on CAN seven, or eight, under the module's address.
    fn decode_request(&self, frame: &RawFrame<'_>) -> Result<HostRequest, Unsupported> {
        let request = match frame.id {
            None => Request::parse(frame.bytes),
            Some(id) if id == u32::from(self.can_id) && !frame.extended => {
                Request::parse_can(frame.bytes, self.module)
            }
            Some(_) => return Err(Unsupported::BadBytes),
        };
        let request = request
            .ok()
            .filter(|request| request.address == self.module)
            .ok_or(Unsupported::BadBytes)?;
        Ok(HostRequest { storing: Storing::Allowed, ..self.host_request(request) })
    }
}

impl AnswerDecoder for TmclDriver {
    type Answer = Answer;

    fn decode_answer(
        &mut self,
        parameter: Option<&Parameter>,
        answer: &Answer,
    ) -> Result<i64, Failure> {
        use crate::profile::Encoding;
        match answer {
            // The module stores instructions: this one was not carried out.
            Answer::Reply(reply) if reply.status == Status::Loaded => {
                Err(Failure::Refused { code: reply.status.number().into() })
            }
            Answer::Reply(reply) | Answer::Event(reply) => {
                let unsigned =
                    matches!(parameter.map(|parameter| parameter.encoding), Some(Encoding::U32));
                Ok(if unsigned { reply.value.cast_unsigned().into() } else { reply.value.into() })
            }
            // Eight characters are the eight bytes of the outcome's value.
            Answer::Text(version) => Ok(i64::from_be_bytes(version.text)),
            Answer::Instruction(instruction) => Ok(instruction.packed()),
            Answer::NoReply => Ok(0),
        }
    }

    /// A parameter that a module does not have is a wrong type (TMCL reference, status codes).
    fn refusal(&self, code: u32) -> Refusal {
        match u8::try_from(code).map(Status::from) {
            Ok(Status::WrongType) => Refusal::Missing,
            // The second where its memory is full.
            Ok(Status::Loaded | Status::DownloadNotPossible) => Refusal::Stored,
            _ => Refusal::Final,
        }
    }

    fn has_anonymous_replies(&self) -> bool {
        // A serial host is alone with the module's replies, and its line doubles none. CAN sends a frame again whose
        // last bit a node did not see (ISO 11898-1, the last bit of the end of frame).
        self.address_parameters == CAN_ADDRESS_PARAMETERS
    }

    fn decode_unsolicited(&mut self, answer: &Answer) -> [Option<DriveReport>; REPORTS_MAX] {
        let mut reports = [None; REPORTS_MAX];
        if let Answer::Event(reply) = answer {
            let reached = i64::from(reply.value >> self.motor & 1);
            reports[0] = Some(DriveReport::Signal(Signal::Reached, reached));
        }
        reports
    }
}

impl WriteRules for TmclDriver {
    /// A change holds from the next datagram on \[I\].
    fn address_role(&self, parameter: &Parameter) -> Option<AddressRole> {
        let [own, host] = self.address_parameters;
        match parameter.index {
            _ if parameter.space != BANK_0 => None,
            index if index == own => Some(AddressRole::Drive),
            index if index == host => Some(AddressRole::Host),
            _ => None,
        }
    }
}

impl ProgramDriver for TmclDriver {
    /// MST has the motor in a byte of its own; the others mean the module's program (TMCL reference, 128 to
    /// 135, global parameter 130).
    fn program_request(&self, command: ProgramCommand) -> Option<HostRequest> {
        use RequestClass::{Idempotent, NoRetry, Stop};
        let (class, [opcode, kind, motor], value) = match command {
            ProgramCommand::StopMotor(motor) => (Stop, [Opcode::Mst.number(), 0, motor], 0),
            ProgramCommand::End | ProgramCommand::Abort => (Stop, [128, 0, 0], 0),
            ProgramCommand::QueryProgram => (Idempotent, [135, 0, 0], 0),
            ProgramCommand::Goto(at) => (NoRetry, [129, 1, 0], at.into()),
            ProgramCommand::Resume => (NoRetry, [129, 0, 0], 0),
            ProgramCommand::Step => (NoRetry, [130, 0, 0], 0),
            ProgramCommand::Reset => (NoRetry, [131, 0, 0], 0),
            ProgramCommand::BeginStore(at) => (NoRetry, [132, 0, 0], at.into()),
            ProgramCommand::EndStore => (Stop, [133, 0, 0], 0),
            ProgramCommand::ReadInstruction(at) => (Idempotent, [134, 0, 0], at.into()),
            ProgramCommand::QueryCounter => (Idempotent, [Opcode::Ggp.number(), 130, 0], 0),
            ProgramCommand::QuerySpeed(motor) => (Idempotent, [Opcode::Gap.number(), 3, motor], 0),
            ProgramCommand::Store([opcode, kind, motor, a, b, c, d]) => {
                (NoRetry, [opcode, kind, motor], i32::from_be_bytes([a, b, c, d]))
            }
            ProgramCommand::Call(_) | ProgramCommand::QueryCall => return None,
        };
        let storing = match command {
            ProgramCommand::Store(_) => Storing::Required,
            _ => Storing::Never,
        };
        let opcode = Opcode::from(opcode);
        let request = Request { address: self.module, opcode, kind, motor, value };
        Some(HostRequest { class, storing, ..self.host_request(request) })
    }

    fn is_program_running(&self, raw: i64) -> bool {
        TmclInstructions.is_running(raw)
    }
}

impl Driver for TmclDriver {
    fn profile(&self) -> &'static Profile {
        self.profile
    }

    fn address(&self) -> u32 {
        with_sub_axis(self.can_id.into(), self.motor)
    }

    fn programs(&self) -> Option<&dyn ProgramDriver<Request = HostRequest>> {
        Some(self)
    }
}

/// Speeds go both ways: `ROR` with a negative one is `ROL` with a positive one, because the TMCL
/// manuals give both a range from 0 on.
fn normalize_rotation(opcode: Opcode, value: i32) -> (Opcode, i32) {
    match (opcode, value.checked_neg()) {
        (Opcode::Ror, Some(positive)) if value < 0 => (Opcode::Rol, positive),
        (Opcode::Rol, Some(positive)) if value < 0 => (Opcode::Ror, positive),
        _ => (opcode, value),
    }
}

/// Signed, or the unsigned twin of a negative one.
fn wire_value(raw: i64) -> Result<i32, Unsupported> {
    i32::try_from(raw)
        .or_else(|_| u32::try_from(raw).map(u32::cast_signed))
        .map_err(|_| Unsupported::BadArgument)
}

/// Full steps of a stepper motor.
const STEPS: OptionKey = OptionKey::for_drive(
    "steps",
    OptionKind::Number(4, 10_000),
    "full steps of a turn of a stepper motor [default: 200]; refused by a module with a setting for them",
);

/// TMCL on RS-232, RS-485, a pseudo-terminal or TCP.
#[derive(Debug)]
pub enum Tmcl {}

impl Protocol for Tmcl {
    type Medium = Stream;
    type Host = SerialHost;
    const NAME: &'static str = "tmcl";
    const PROFILE_PROTOCOL: &'static str = "tmcl";
    const SCAN_ADDRESSES: core::ops::RangeInclusive<u32> = 1..=32;
    const HOST_ADDRESS: Option<u32> = Some(super::wire::HOST as u32);
    const VALID_ADDRESSES: core::ops::RangeInclusive<u32> = 0..=255;
    const SUB_AXES: core::ops::RangeInclusive<u8> = MOTORS;
    const DEFAULT_RATE: u32 = 9600;
    const KEYS: &[OptionKey] = &[options::TIMEOUT, options::GAP, options::host_key(0, 0xFF), STEPS];

    fn generic_profile() -> &'static Profile {
        &GENERIC
    }

    fn create_host(options: &HostOptions, _axes: &[u32]) -> SerialHost {
        SerialHost::new(options)
    }

    fn create_driver(
        profile: &'static Profile,
        address: u32,
    ) -> impl Driver<Request = HostRequest, Answer = Answer> + Send + 'static {
        TmclDriver::new(profile, address)
    }
}

/// TMCL on CAN. A module's address is its CAN id.
#[derive(Debug)]
pub enum TmclCan {}

impl Protocol for TmclCan {
    type Medium = Can;
    type Host = CanHost;
    const NAME: &'static str = "tmcl";
    const PROFILE_PROTOCOL: &'static str = "tmcl";
    const SCAN_ADDRESSES: core::ops::RangeInclusive<u32> = 1..=32;
    const VALID_ADDRESSES: core::ops::RangeInclusive<u32> = 0..=0x7FF;
    const SUB_AXES: core::ops::RangeInclusive<u8> = MOTORS;
    const HOST_ADDRESS: Option<u32> = Some(super::wire::HOST as u32);
    const DEFAULT_RATE: u32 = 250_000;
    const KEYS: &[OptionKey] = &[options::TIMEOUT, options::host_key(0, 0x7FF), STEPS];

    fn generic_profile() -> &'static Profile {
        &GENERIC
    }

    fn create_host(options: &HostOptions, _axes: &[u32]) -> CanHost {
        CanHost::new(options)
    }

    fn uses_can_id(address: u32, id: u32, extended: bool) -> bool {
        !extended && id == address
    }

    fn frame_sender(options: &HostOptions, frame: &Frame) -> Option<u32> {
        reply_sender(options, frame)
    }

    fn create_driver(
        profile: &'static Profile,
        address: u32,
    ) -> impl Driver<Request = HostRequest, Answer = Answer> + Send + 'static {
        TmclDriver::on_can(profile, address)
    }
}
