//! An axis of any TML drive, or a group of them, driven by a profile.
//!
//! Parameters are variables in the drive's memory: space 0 is data memory, 1 program memory, 2 the EEPROM.
//! The address of a name depends on the firmware, so the profile has it.

use super::generic::GENERIC;
use super::host::BAUDS;
use super::host::{CanHost, Encapsulation, ExtendedIds, HOST_ID, SerialHost, StandardIds};
use super::host_request::{
    Answer, Confirmation, HostRequest, assign_instruction, assigned_variable, masked_variable,
};
use super::instruction::{LanguageScope, assemble};
use super::online::{OnlineMessage, PtPoint, PvtPoint};
use super::program;
use super::session::discovery_message;
use super::technocan::MessageClass as Service;
use super::wire::{IdCode, Instruction, Message, low_first};
use super::{keys, serial, technocan, tmlcan};
use crate::axis::{
    AnswerDecoder, DriveReport, Driver, ExecutionProof, MemoryDriver, PathDriver, ProgramDriver,
    REPORTS_MAX, RequestEncoder, WriteRules,
};
use crate::error::{Failure, Unsupported, WireError};
use crate::explain::RawFrame;
use crate::medium::{Can, Frame, Stream};
use crate::plan::{Compare, ParameterTest};
use crate::profile::{Encoding, Parameter, ParameterAddress, ParameterId, Profile};
use crate::program::{MemoryRules, ProgramCommand, TransferStep};
use crate::proto::{GROUP, HostOptions, OptionKey, Protocol};
use crate::station::RequestClass;
use crate::stream::{PathKind, PathParameters, PathStatus, PathStep, RawPoint};

/// Parameters whose bits enable unsolicited messages of a drive, which needs the receiver's address first.
const EVENT_MASKS: [&str; 3] = ["SRL_MASK", "SRH_MASK", "MER_MASK"];
/// The parameter that silences reports of the PVT buffer while it is not zero.
const PVT_SILENCE: &str = "PVTSENDOFF";

/// Bits of the status registers, SRH in the high half (see the profiles).
const AXISON_BIT: i64 = 1 << 15;
const ENDINIT_BIT: i64 = 1 << 16;
const FAULT_BIT: i64 = 1 << 31;

/// One axis, or the axes of some groups.
#[derive(Clone, Copy, Debug)]
pub struct TmlDriver {
    profile: &'static Profile,
    address: u32,
    destination: IdCode,
}

impl TmlDriver {
    /// The axis of that ID, or the groups that an address with [`GROUP`] names.
    #[must_use]
    pub const fn new(profile: &'static Profile, address: u32) -> Self {
        let destination = match address & GROUP {
            0 => IdCode::axis(address as u8),
            _ => IdCode::groups(address as u8),
        };
        Self { profile, address, destination }
    }

    /// Returns whether an assignment makes the drive send by itself.
    fn enables_unsolicited(&self, address: u16, value: u32) -> bool {
        let mut symbols = self
            .profile
            .parameters
            .iter()
            .filter(|parameter| parameter.index == address)
            .map(|p| p.symbol);
        symbols.any(|symbol| match symbol {
            PVT_SILENCE => value == 0,
            _ => value != 0 && EVENT_MASKS.contains(&symbol),
        })
    }

    /// The request that sends an instruction to this axis.
    fn instruction_request(
        &self,
        mut instruction: Instruction,
    ) -> Result<HostRequest, Unsupported> {
        if let (true, Some(OnlineMessage::GiveMeData { sender, cell })) =
            (self.destination.group, OnlineMessage::parse(&instruction))
        {
            instruction = OnlineMessage::GiveMeData2 { sender, cell }.emit();
        }
        let loud = assigned_variable(&instruction)
            .is_some_and(|(address, value, _)| self.enables_unsolicited(address, value));
        Ok(self.new_request(instruction).with_confirmation(if loud {
            Confirmation::MasterFirst
        } else {
            Confirmation::Proof
        }))
    }

    const fn new_request(&self, instruction: Instruction) -> HostRequest {
        HostRequest::of(Message { to: self.destination, instruction })
    }
}

/// Forms of a plan's `send FUNCTION INDEX VALUE`, by its function. The index is the opcode, or the variable's
/// address.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SendForm {
    /// 0: the opcode alone, as `AXISON`.
    OpcodeOnly,
    /// 1: the value as one word, as `SETPVT` has it.
    Word,
    /// 2: the value as two words, low one first, as `SAP` has it.
    Long,
    /// 3: the value's high word, then its low one: AND and OR masks of `SRB`, as every mode is set.
    Masks,
    /// 4: the same masks for the variable at the index, by `SRBL`.
    FarMasks,
}

impl SendForm {
    const fn of(function: u8) -> Option<Self> {
        Some(match function {
            0 => Self::OpcodeOnly,
            1 => Self::Word,
            2 => Self::Long,
            3 => Self::Masks,
            4 => Self::FarMasks,
            _ => return None,
        })
    }

    const fn to_instruction(self, index: u16, value: u32) -> Instruction {
        let [low, high] = low_first(value);
        match self {
            Self::OpcodeOnly => Instruction::of(index, []),
            Self::Word => Instruction::of(index, [low]),
            Self::Long => Instruction::of(index, [low, high]),
            Self::Masks => Instruction::of(index, [high, low]),
            Self::FarMasks => Instruction::of(0x5C00, [index, high, low]),
        }
    }
}

impl RequestEncoder for TmlDriver {
    type Request = HostRequest;

    /// GiveMeData of one axis; GiveMeData2 of a group, each of which answers (manual, chapter 4).
    fn read_request(&self, parameter: &Parameter) -> Result<HostRequest, Unsupported> {
        let memory = match parameter.space {
            0 => 0x4,
            1 => 0x0,
            2 => 0x8,
            _ => return Err(Unsupported::NoSuchParameter),
        };
        let give = if self.destination.group { 0xB200 } else { 0xB000 };
        let opcode = give | memory | u16::from(is_long(parameter.encoding));
        Ok(self.new_request(Instruction::of(opcode, [0, parameter.index])))
    }

    fn write_request(
        &self,
        parameter: &Parameter,
        raw: i64,
        class: RequestClass,
    ) -> Result<HostRequest, Unsupported> {
        let long = is_long(parameter.encoding);
        if parameter.space != 0 {
            return Err(Unsupported::Forbidden(
                "program memory and EEPROM are written by downloading, not by parameters",
            ));
        }
        let value = wire_value(raw, long)?;
        let loud = self.enables_unsolicited(parameter.index, value);
        let with = if loud { Confirmation::MasterFirst } else { Confirmation::Proof };
        Ok(self
            .new_request(assign_instruction(parameter.index, value, long))
            .with_class(class)
            .with_confirmation(with))
    }

    /// `function` is a [`SendForm`].
    fn function_request(
        &self,
        function: u8,
        index: u16,
        value: i64,
    ) -> Result<HostRequest, Unsupported> {
        let form = SendForm::of(function).ok_or(Unsupported::BadArgument)?;
        Ok(self.new_request(form.to_instruction(index, wire_value(value, true)?)))
    }

    /// Parses a request. A request to a group reads from each of its drives.
    fn parse_request(&self, text: &str) -> Result<HostRequest, Unsupported> {
        let scope = LanguageScope { profile: Some(self.profile), ..LanguageScope::default() };
        self.instruction_request(assemble(text, &scope).map_err(|_| Unsupported::BadText)?)
    }

    /// A message on a serial line, or a CAN frame in either encapsulation.
    fn decode_request(&self, frame: &RawFrame<'_>) -> Result<HostRequest, Unsupported> {
        let can = |id: u32| match (frame.extended, frame.bytes.len()) {
            (_, 9..) => Err(Unsupported::BadBytes),
            (true, _) => {
                let frame = Frame { id, extended: true, ..Frame::standard(0, frame.bytes) };
                tmlcan::decode(&frame).map_err(bad_bytes)
            }
            (false, _) => {
                let id = u16::try_from(id).map_err(|_| Unsupported::BadBytes)?;
                let content =
                    technocan::decode(&Frame::standard(id, frame.bytes)).map_err(bad_bytes)?;
                let to = content.to.ok_or(Unsupported::BadBytes)?;
                Ok(Message { to, instruction: content.instruction })
            }
        };
        let message = match frame.id {
            None => serial::decode(frame.bytes).map_err(bad_bytes)?,
            Some(id) => can(id)?,
        };
        if message.to != self.destination {
            return Err(Unsupported::BadBytes);
        }
        self.instruction_request(message.instruction)
    }
}

impl AnswerDecoder for TmlDriver {
    type Answer = Answer;

    fn decode_answer(
        &mut self,
        parameter: Option<&Parameter>,
        answer: &Answer,
    ) -> Result<i64, Failure> {
        let encoding = parameter.map(|parameter| parameter.encoding);
        match *answer {
            Answer::Accepted(value) => Ok(raw_value(encoding, value)),
            Answer::Value { value, long, .. } => match encoding {
                Some(encoding) if is_long(encoding) != long => Err(Failure::Misbehaved),
                Some(_) => Ok(raw_value(encoding, value)),
                None if long => Ok(value.cast_signed().into()),
                None => Ok(value.into()),
            },
            // Four characters are the four bytes of the outcome's value.
            Answer::Version(text) => Ok(u32::from_be_bytes(text).into()),
            Answer::GroupAnswered(count) => Ok(count.into()),
        }
    }

    /// A value that the drive sent by itself belongs to the parameter at its address. The halves of a long
    /// value may be parameters too, as SRL and SRH are. A value at an address of the user's own has no name.
    fn decode_unsolicited(&mut self, answer: &Answer) -> [Option<DriveReport>; REPORTS_MAX] {
        let mut reports = [None; REPORTS_MAX];
        let Answer::Value { address, value, long } = *answer else { return reports };
        let high = address.wrapping_add(1);
        let found = (0..).zip(self.profile.parameters).filter_map(|(id, parameter)| {
            let (index, wide) = (parameter.index, is_long(parameter.encoding));
            let part = match (long, wide) {
                (true, true) | (false, false) if index == address => value,
                (true, false) if index == address => value & 0xFFFF,
                (true, false) if index == high => value >> 16,
                _ => return None,
            };
            let raw = raw_value(Some(parameter.encoding), part);
            (parameter.space == 0).then_some(DriveReport::Parameter(ParameterId(id), raw))
        });
        for (report, reported) in reports.iter_mut().zip(found) {
            *report = Some(reported);
        }
        if reports[0].is_none() {
            let encoding = if long { Encoding::I32 } else { Encoding::I16 };
            let unnamed =
                ParameterAddress { encoding: Some(encoding), ..ParameterAddress::new(address, 0) };
            reports[0] = Some(DriveReport::Address(unnamed, raw_value(Some(encoding), value)));
        }
        reports
    }
}

impl WriteRules for TmlDriver {
    /// An assignment to RAM can be repeated without an effect. Positions are preset by instructions (`SAP`,
    /// `STA`), not by parameters.
    fn may_rewrite(&self, parameter: &Parameter) -> bool {
        !parameter.moves
    }

    /// `AXISON` and `ENDINIT` show in the status register, a mode in the register that it sets. `UPD`
    /// starts a motion, and `SAP` and `STA` preset positions: they are never sent again.
    fn execution_proof(&self, function: u8, index: u16, value: i64) -> Option<ExecutionProof> {
        let instruction =
            SendForm::of(function)?.to_instruction(index, wire_value(value, true).ok()?);
        let status = self.profile.find_parameter("SR32")?;
        let (parameter, mask, expected) = match instruction.opcode {
            0x0020 => (status, ENDINIT_BIT, ENDINIT_BIT),
            0x0102 => (status, AXISON_BIT, AXISON_BIT),
            _ => {
                let (address, and, or) = masked_variable(&instruction)?;
                let parameter = self.profile.find_object((address, 0))?;
                (parameter, i64::from(!and | or), i64::from(or))
            }
        };
        let executed = ParameterTest { mask, compare: Compare::Equal, value: expected };
        Some(ExecutionProof { parameter, executed, fault_parameter: status, fault_mask: FAULT_BIT })
    }
}

impl PathDriver for TmlDriver {
    fn path_parameters(&self) -> Option<PathParameters> {
        let find = |symbol| self.profile.find_parameter(symbol);
        (!self.destination.group).then_some(PathParameters {
            position: find("TPOS")?,
            velocity: find("CSPD")?,
            time: find("RTIME")?,
            status: find("PVTSTS")?,
            capacity: find("PVTBUFLEN")?,
        })
    }

    /// MODE PVT or PT, points counted from one to the next (CPR), TUM1, SETPVT, the points, UPD.
    fn path_request(&self, step: PathStep) -> Option<Result<HostRequest, Unsupported>> {
        let instruction = match step {
            PathStep::Prepare { number, kind, low_mark } => {
                path_preparation(number, kind, low_mark)?
            }
            PathStep::Point(kind, raw) => match path_point(kind, &raw) {
                Some(point) => {
                    return Some(Ok(self
                        .new_request(point.emit())
                        .with_confirmation(Confirmation::None)));
                }
                None => return Some(Err(Unsupported::Forbidden(NO_POINT))),
            },
            PathStep::Start => Instruction::of(0x0108, []),
            PathStep::Stop => Instruction::of(0x01C4, []),
        };
        Some(Ok(self.new_request(instruction)))
    }

    /// PVTSTS: bit 15 empty, 14 low, 13 full, 12 integrity counter wrong, 11 stopped because it ran
    /// empty, 6 to 0 the counter (object 2072h of the same drives with CANopen).
    fn decode_path_status(&self, raw: i64) -> PathStatus {
        PathStatus {
            empty: is_bit_set(15, raw),
            low: is_bit_set(14, raw),
            full: is_bit_set(13, raw),
            lost: is_bit_set(12, raw),
            underrun: is_bit_set(11, raw),
            counter: raw as u32 & u32::from(PvtPoint::COUNTER_MAX),
            counter_modulus: u32::from(PvtPoint::COUNTER_MAX) + 1,
        }
    }
}

impl ProgramDriver for TmlDriver {
    fn program_request(&self, command: ProgramCommand) -> Option<HostRequest> {
        let (instruction, class) = program::order_instruction(command)?;
        let allowed = !self.destination.group || command == ProgramCommand::End;
        allowed.then_some(self.new_request(instruction).with_class(class))
    }

    fn is_program_running(&self, _raw: i64) -> bool {
        // No request of this protocol reads it: `QueryProgram` has none.
        false
    }
}

impl MemoryDriver for TmlDriver {
    /// Rules of the program memory. None for a group, whose programs cannot be verified.
    fn memory_rules(&self) -> &'static MemoryRules {
        &program::RULES
    }

    fn transfer_request(&self, step: TransferStep) -> Result<HostRequest, Unsupported> {
        let (instruction, class) = program::transfer_instruction(step);
        let request = self.new_request(instruction).with_class(class);
        // The pointer proves what was written.
        let with = if matches!(step, TransferStep::Write(..)) {
            Confirmation::None
        } else {
            Confirmation::Proof
        };
        Ok(request.with_confirmation(with))
    }
}

impl Driver for TmlDriver {
    fn profile(&self) -> &'static Profile {
        self.profile
    }

    fn address(&self) -> u32 {
        self.address
    }

    fn is_group(&self) -> bool {
        self.destination.group
    }

    fn paths(&self) -> Option<&dyn PathDriver<Request = HostRequest>> {
        Some(self)
    }

    fn programs(&self) -> Option<&dyn ProgramDriver<Request = HostRequest>> {
        Some(self)
    }

    fn memory(&self) -> Option<&dyn MemoryDriver<Request = HostRequest>> {
        // Words cannot be verified in several drives at once.
        if self.destination.group { None } else { Some(self) }
    }
}

fn is_bit_set(n: u32, raw: i64) -> bool {
    raw >> n & 1 != 0
}

fn bad_bytes(_: WireError) -> Unsupported {
    Unsupported::BadBytes
}

const fn is_long(encoding: Encoding) -> bool {
    !matches!(encoding, Encoding::Bit | Encoding::U16 | Encoding::I16)
}

/// The raw value of the bytes on the wire.
fn raw_value(encoding: Option<Encoding>, value: u32) -> i64 {
    match encoding {
        Some(Encoding::I16) => (value as u16).cast_signed().into(),
        Some(Encoding::Bit | Encoding::U16 | Encoding::U32) | None => value.into(),
        Some(_) => value.cast_signed().into(),
    }
}

/// Signed, or the unsigned twin of a negative one.
fn wire_value(raw: i64, long: bool) -> Result<u32, Unsupported> {
    let bits = if long { 32 } else { 16 };
    let (min, max) = (-(1_i64 << (bits - 1)), (1_i64 << bits) - 1);
    if raw < min || raw > max {
        return Err(Unsupported::BadArgument);
    }
    Ok(raw as u32 & (max as u32))
}

const NO_POINT: &str = "a point goes at most 8,388,607 counts beyond the one before, at less than \
                        32,768 counts a slow loop, in 1 to 511 slow loops: cut the path into more \
                        points, or fewer";

/// The preparations of a path, in order. \[I\] SETPVT takes what object 2074h takes on the same
/// drives with CANopen: bit 15 clears the buffer, 13 sets the counter to bits 6 to 0, 7 sets how
/// many points count as few to bits 11 to 8.
fn path_preparation(number: u8, kind: PathKind, few: u8) -> Option<Instruction> {
    Some(match (number, kind) {
        (0, PathKind::Pvt) => mask_mcr(0xFFC1, 0x8709),
        (0, PathKind::Pt) => mask_mcr(0xFFC0, 0x870A),
        (1, _) => mask_mcr(0xDFFF, 0x0000),
        (2, _) => mask_mcr(0xFFFF, 0x4000),
        (3, _) => Instruction::of(0x1880, [0xA080 | u16::from(few & 0xF) << 8]),
        _ => return None,
    })
}

fn mask_mcr(and: u16, or: u16) -> Instruction {
    Instruction::of(0x5909, [and, or])
}

/// A point in the drive's numbers, if they fit.
fn path_point(kind: PathKind, raw: &RawPoint) -> Option<OnlineMessage> {
    let position = i32::try_from(raw.distance).ok()?;
    let velocity = i32::try_from(raw.velocity).ok()?;
    let time = u16::try_from(raw.time).ok()?;
    let counter = raw.number as u8 & PvtPoint::COUNTER_MAX;
    let pvt = PvtPoint { position, velocity, time, counter };
    match kind {
        _ if time == 0 => None,
        PathKind::Pvt => pvt.fits().then_some(OnlineMessage::Pvt(pvt)),
        PathKind::Pt => Some(OnlineMessage::Pt(PtPoint { position, time, counter })),
    }
}

macro_rules! driver {
    () => {
        const PROFILE_PROTOCOL: &'static str = "tml";
        const VALID_ADDRESSES: core::ops::RangeInclusive<u32> = 1..=255;
        const SWITCH_ADDRESS: Option<u32> = Some(255);

        fn generic_profile() -> &'static Profile {
            &GENERIC
        }

        fn create_driver(
            profile: &'static Profile,
            address: u32,
        ) -> impl Driver<Request = HostRequest, Answer = Answer> + Send + 'static {
            TmlDriver::new(profile, address)
        }
    };
}

/// TML on RS-232, RS-485, a pseudo-terminal or TCP.
#[derive(Debug)]
pub enum Tml {}

/// Bit rates of the CAN port (TML communication manual, chapters 4 and 5).
const BIT_RATES: [u32; 5] = [125_000, 250_000, 500_000, 800_000, 1_000_000];

impl Protocol for Tml {
    type Medium = Stream;
    type Host = SerialHost;
    const NAME: &'static str = "tml";
    const HAS_SERIAL_STANDARDS: bool = true;
    const SCAN_ADDRESSES: core::ops::RangeInclusive<u32> = 1..=255;
    const GROUPS: u8 = 8;
    const DEFAULT_RATE: u32 = 9600;
    const RATES: &'static [u32] = &BAUDS;
    const KEYS: &[OptionKey] = keys::SERIAL;

    fn create_host(options: &HostOptions, axes: &[u32]) -> SerialHost {
        SerialHost::new(options, axes)
    }

    driver!();
}

/// TML on CAN with 29-bit identifiers.
#[derive(Debug)]
pub enum TmlCan {}

impl Protocol for TmlCan {
    type Medium = Can;
    type Host = CanHost<ExtendedIds>;
    const NAME: &'static str = "tmlcan";
    const SCAN_ADDRESSES: core::ops::RangeInclusive<u32> = 1..=255;
    const HOST_ADDRESS: Option<u32> = Some(HOST_ID as u32);
    const GROUPS: u8 = 8;
    const DEFAULT_RATE: u32 = 500_000;
    const RATES: &'static [u32] = &BIT_RATES;
    const KEYS: &[OptionKey] = keys::CAN;

    fn create_host(options: &HostOptions, axes: &[u32]) -> Self::Host {
        CanHost::new(options, axes)
    }

    fn uses_can_id(_address: u32, _id: u32, extended: bool) -> bool {
        extended
    }

    fn discovery_frame(options: &HostOptions) -> Option<Frame> {
        discovery_frame::<ExtendedIds>(options)
    }

    fn frame_sender(options: &HostOptions, frame: &Frame) -> Option<u32> {
        discovery_sender::<ExtendedIds>(options, frame)
    }

    driver!();
}

/// TML on CAN with the 11-bit identifiers that CANopen leaves free.
#[derive(Debug)]
pub enum TechnoCan {}

impl Protocol for TechnoCan {
    type Medium = Can;
    type Host = CanHost<StandardIds>;
    const NAME: &'static str = "technocan";
    /// Every drive with TechnoCAN has firmware F2xxY (TML communication manual, chapter 5).
    const USUAL_PROFILE: Option<&'static str> = Some("technosoft-f2xx");
    const SCAN_ADDRESSES: core::ops::RangeInclusive<u32> = 1..=31;
    const HOST_ADDRESS: Option<u32> = Some(HOST_ID as u32);
    const GROUPS: u8 = 5;
    const DEFAULT_RATE: u32 = 500_000;
    const RATES: &'static [u32] = &BIT_RATES;
    const KEYS: &[OptionKey] = keys::CAN;

    fn create_host(options: &HostOptions, axes: &[u32]) -> Self::Host {
        CanHost::new(options, axes)
    }

    /// Messages to groups have identifiers of every class: all are taken wherever one axis is.
    fn uses_can_id(_address: u32, id: u32, extended: bool) -> bool {
        !extended && Service::of_id(id).is_some()
    }

    fn forbidden_reason(address: u32) -> Option<&'static str> {
        let free = !address.is_multiple_of(32);
        (!free).then_some(
            "TechnoCAN takes an axis ID by its last five bits, and a multiple of 32 leaves none: its \
             identifiers are others' (0x100 is CANopen's TIME)",
        )
    }

    fn discovery_frame(options: &HostOptions) -> Option<Frame> {
        discovery_frame::<StandardIds>(options)
    }

    fn frame_sender(options: &HostOptions, frame: &Frame) -> Option<u32> {
        discovery_sender::<StandardIds>(options, frame)
    }

    driver!();
}

fn host_id(options: &HostOptions) -> IdCode {
    IdCode::axis(options.host_address.and_then(|id| u8::try_from(id).ok()).unwrap_or(HOST_ID))
}

/// GiveMeData2 of AAR to everybody: all answer, in the order of their IDs.
fn discovery_frame<E: Encapsulation>(options: &HostOptions) -> Option<Frame> {
    E::encode(&discovery_message(host_id(options))).ok()
}

/// The axis that answered [`discovery_frame`].
fn discovery_sender<E: Encapsulation>(options: &HostOptions, frame: &Frame) -> Option<u32> {
    let (to, instruction) = E::decode(frame)?.ok()?;
    let ours = to.is_none_or(|to| to.id == host_id(options).id && !to.group);
    let axis = OnlineMessage::parse(&instruction)?.answered_by()?;
    ours.then_some(axis.into())
}
