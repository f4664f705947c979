//! An axis of any TML drive, or a group of them, from a profile alone.
//!
//! Parameters are variables in the drive's memory: space 0 is data memory, 1 program memory, 2 the
//! EEPROM. Which address a name has depends on the firmware, so it is the profile's.

use super::ask::{Answer, Ask, With, assigned, assignment};
use super::generic::GENERIC;
use super::host::{CanHost, Encapsulation, Extended, HOST_ID, SerialHost, Standard};
use super::instruction::{Scope, assemble};
use super::online::{Online, PtPoint, PvtPoint};
use super::program;
use super::session::discovery;
use super::technocan::Class as Service;
use super::wire::{IdCode, Instruction, Message, low_first};
use super::{serial, technocan, tmlcan};
use crate::axis::{Driver, TOLD_MAX, Told};
use crate::error::{Failure, Unsupported};
use crate::explain::Raw;
use crate::medium::{Can, Frame, Stream};
use crate::profile::{Encoding, Parameter, ParameterId, Profile};
use crate::program::{MemoryRules, Order, TransferStep};
use crate::proto::{GROUP, HostOptions, Protocol};
use crate::station::Class;
use crate::stream::{PathKind, PathParameters, PathStatus, PathStep, RawPoint};

/// Parameters whose bits make a drive speak unasked: it is told to whom first.
const MASKS: [&str; 3] = ["SRL_MASK", "SRH_MASK", "MER_MASK"];
/// The parameter that silences reports of the PVT buffer while it is not zero.
const PVT_SILENCE: &str = "PVTSENDOFF";

/// One axis, or the axes of some groups.
#[derive(Clone, Copy, Debug)]
pub struct Axis {
    profile: &'static Profile,
    address: u32,
    to: IdCode,
}

impl Axis {
    /// The axis of that ID, or the groups that an address with [`GROUP`] names.
    #[must_use]
    pub const fn new(profile: &'static Profile, address: u32) -> Self {
        let to = match address & GROUP {
            0 => IdCode::axis(address as u8),
            _ => IdCode::groups(address as u8),
        };
        Self { profile, address, to }
    }

    /// Whether an assignment makes the drive speak unasked.
    fn is_loud(&self, address: u16, value: u32) -> bool {
        let at_address = |parameter: &&Parameter| parameter.index == address;
        let mut symbols = self.profile.parameters.iter().filter(at_address).map(|p| p.symbol);
        symbols.any(|symbol| match symbol {
            PVT_SILENCE => value == 0,
            _ => value != 0 && MASKS.contains(&symbol),
        })
    }

    /// An instruction as it is asked of this axis.
    fn said(&self, mut instruction: Instruction) -> Result<Ask, Unsupported> {
        if let (true, Some(Online::GiveMeData { sender, cell })) =
            (self.to.group, Online::parse(&instruction))
        {
            instruction = Online::GiveMeData2 { sender, cell }.emit();
        }
        let loud =
            assigned(&instruction).is_some_and(|(address, value, _)| self.is_loud(address, value));
        Ok(self.ask(instruction).with(if loud { With::Master } else { With::Proof }))
    }

    const fn ask(&self, instruction: Instruction) -> Ask {
        Ask::of(Message { to: self.to, instruction })
    }
}

/// What a plan's `send FUNCTION INDEX VALUE` says, by its function. The index is the opcode, or the
/// variable's address.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Form {
    /// 0: the opcode alone, as `AXISON`.
    Bare,
    /// 1: the value as one word, as `SETPVT` has it.
    Word,
    /// 2: the value as two words, low one first, as `SAP` has it.
    Long,
    /// 3: the value's high word, then its low one: AND and OR masks of `SRB`, as every mode is set.
    Masks,
    /// 4: the same masks for the variable at the index, by `SRBL`.
    FarMasks,
}

impl Form {
    const fn of(function: u8) -> Option<Self> {
        Some(match function {
            0 => Self::Bare,
            1 => Self::Word,
            2 => Self::Long,
            3 => Self::Masks,
            4 => Self::FarMasks,
            _ => return None,
        })
    }

    const fn instruction(self, index: u16, value: u32) -> Instruction {
        let [low, high] = low_first(value);
        match self {
            Self::Bare => Instruction::of(index, []),
            Self::Word => Instruction::of(index, [low]),
            Self::Long => Instruction::of(index, [low, high]),
            Self::Masks => Instruction::of(index, [high, low]),
            Self::FarMasks => Instruction::of(0x5C00, [index, high, low]),
        }
    }
}

impl Driver for Axis {
    type Request = Ask;
    type Answer = Answer;

    fn profile(&self) -> &'static Profile {
        self.profile
    }

    fn address(&self) -> u32 {
        self.address
    }

    fn is_group(&self) -> bool {
        self.to.group
    }

    /// GiveMeData of one axis; GiveMeData2 of a group, each of which answers (manual, chapter 4).
    fn read(&self, parameter: &Parameter) -> Result<Ask, Unsupported> {
        let memory = match parameter.space {
            0 => 0x4,
            1 => 0x0,
            2 => 0x8,
            _ => return Err(Unsupported::NoSuchParameter),
        };
        let give = if self.to.group { 0xB200 } else { 0xB000 };
        let opcode = give | memory | u16::from(is_long(parameter.encoding));
        Ok(self.ask(Instruction::of(opcode, [0, parameter.index])))
    }

    fn write(&self, parameter: &Parameter, raw: i64, class: Class) -> Result<Ask, Unsupported> {
        let long = is_long(parameter.encoding);
        if parameter.space != 0 {
            return Err(Unsupported::Forbidden(
                "program memory and EEPROM are written by downloading, not by parameters",
            ));
        }
        let value = wire_value(raw, long)?;
        let loud = self.is_loud(parameter.index, value);
        let with = if loud { With::Master } else { With::Proof };
        Ok(self.ask(assignment(parameter.index, value, long)).held_to(class).with(with))
    }

    /// `function` is a [`Form`].
    fn send(&self, function: u8, index: u16, value: i64) -> Result<Ask, Unsupported> {
        let form = Form::of(function).ok_or(Unsupported::BadArgument)?;
        Ok(self.ask(form.instruction(index, wire_value(value, true)?)))
    }

    /// A question to a group asks each of its drives.
    fn parse(&self, text: &str) -> Result<Ask, Unsupported> {
        let scope = Scope { profile: Some(self.profile), ..Scope::default() };
        self.said(assemble(text, &scope).map_err(|_| Unsupported::BadText)?)
    }

    /// A message on a serial line, or a CAN frame in either encapsulation.
    fn decode(&self, frame: &Raw<'_>) -> Result<Ask, Unsupported> {
        let bad = |_| Unsupported::BadBytes;
        let can = |id: u32| match (frame.extended, frame.bytes.len()) {
            (_, 9..) => Err(Unsupported::BadBytes),
            (true, _) => {
                let frame = Frame { id, extended: true, ..Frame::standard(0, frame.bytes) };
                tmlcan::decode(&frame).map_err(bad)
            }
            (false, _) => {
                let id = u16::try_from(id).map_err(|_| Unsupported::BadBytes)?;
                let heard = technocan::decode(&Frame::standard(id, frame.bytes)).map_err(bad)?;
                let to = heard.to.ok_or(Unsupported::BadBytes)?;
                Ok(Message { to, instruction: heard.instruction })
            }
        };
        let message = match frame.id {
            None => serial::decode(frame.bytes).map_err(bad)?,
            Some(id) => can(id)?,
        };
        if message.to != self.to {
            return Err(Unsupported::BadBytes);
        }
        self.said(message.instruction)
    }

    fn answer(&mut self, parameter: Option<&Parameter>, answer: &Answer) -> Result<i64, Failure> {
        let encoding = parameter.map(|parameter| parameter.encoding);
        match *answer {
            Answer::Taken(value) => Ok(raw(encoding, value)),
            Answer::Value { value, long, .. } => match encoding {
                Some(encoding) if is_long(encoding) != long => Err(Failure::Misbehaved),
                Some(_) => Ok(raw(encoding, value)),
                None if long => Ok(value.cast_signed().into()),
                None => Ok(value.into()),
            },
            // Four characters are the four bytes of the outcome's value.
            Answer::Version(text) => Ok(u32::from_be_bytes(text).into()),
            Answer::Gathered(count) => Ok(count.into()),
        }
    }

    fn path_parameters(&self) -> Option<PathParameters> {
        let find = |symbol| self.profile.find(symbol);
        (!self.to.group).then_some(PathParameters {
            position: find("TPOS")?,
            velocity: find("CSPD")?,
            time: find("RTIME")?,
            status: find("PVTSTS")?,
            room: find("PVTBUFLEN")?,
        })
    }

    /// MODE PVT or PT, points counted from one to the next (CPR), TUM1, SETPVT, the points, UPD.
    fn path(&self, step: PathStep) -> Option<Result<Ask, Unsupported>> {
        let instruction = match step {
            PathStep::Prepare { number, kind, few } => prepared(number, kind, few)?,
            PathStep::Point(kind, raw) => match point(kind, &raw) {
                Some(point) => {
                    return Some(Ok(self.ask(point.emit()).with(With::Nothing)));
                }
                None => return Some(Err(Unsupported::Forbidden(NO_POINT))),
            },
            PathStep::Start => Instruction::of(0x0108, []),
            PathStep::Stop => Instruction::of(0x01C4, []),
        };
        Some(Ok(self.ask(instruction)))
    }

    /// PVTSTS: bit 15 empty, 14 low, 13 full, 12 integrity counter wrong, 11 stopped because it ran
    /// empty, 6 to 0 the counter (object 2072h of the same drives with CANopen).
    fn path_status(&self, raw: i64) -> PathStatus {
        let bit = |n: u32| raw >> n & 1 != 0;
        PathStatus {
            empty: bit(15),
            few: bit(14),
            full: bit(13),
            lost: bit(12),
            ran_dry: bit(11),
            counter: raw as u32 & u32::from(PvtPoint::COUNTER_MAX),
            counters: u32::from(PvtPoint::COUNTER_MAX) + 1,
        }
    }

    /// A program is one drive's: what a group has nobody could prove.
    fn memory(&self) -> Option<&'static MemoryRules> {
        (!self.to.group).then_some(&program::RULES)
    }

    fn transfer(&self, step: TransferStep) -> Option<Result<Ask, Unsupported>> {
        let (instruction, class) = program::transfer(step);
        let ask = self.ask(instruction).held_to(class);
        // The pointer proves what was written.
        let with = if matches!(step, TransferStep::Put(..)) { With::Nothing } else { With::Proof };
        (!self.to.group).then_some(Ok(ask.with(with)))
    }

    fn order(&self, order: Order) -> Option<Ask> {
        let (instruction, class) = program::order(order)?;
        (!self.to.group).then_some(self.ask(instruction).held_to(class))
    }

    /// A value told unasked is that of the parameter at its address; of a long one the halves may be
    /// parameters too, as SRL and SRH are.
    fn unasked(&mut self, answer: &Answer) -> [Option<Told>; TOLD_MAX] {
        let mut told = [None; TOLD_MAX];
        let Answer::Value { address, value, long } = *answer else { return told };
        let high = address.wrapping_add(1);
        let found = (0..).zip(self.profile.parameters).filter_map(|(id, parameter)| {
            let (index, wide) = (parameter.index, is_long(parameter.encoding));
            let part = match (long, wide) {
                (true, true) | (false, false) if index == address => value,
                (true, false) if index == address => value & 0xFFFF,
                (true, false) if index == high => value >> 16,
                _ => return None,
            };
            let raw = raw(Some(parameter.encoding), part);
            (parameter.space == 0).then_some(Told::Parameter(ParameterId(id), raw))
        });
        for (place, told) in told.iter_mut().zip(found) {
            *place = Some(told);
        }
        told
    }
}

const fn is_long(encoding: Encoding) -> bool {
    !matches!(encoding, Encoding::Bit | Encoding::U16 | Encoding::I16)
}

/// The raw value of what is on the wire.
fn raw(encoding: Option<Encoding>, value: u32) -> i64 {
    match encoding {
        Some(Encoding::I16) => (value as u16).cast_signed().into(),
        Some(Encoding::Bit | Encoding::U16 | Encoding::U32) | None => value.into(),
        Some(_) => value.cast_signed().into(),
    }
}

/// Signed, or the unsigned twin of a negative one.
fn wire_value(raw: i64, long: bool) -> Result<u32, Unsupported> {
    let bits = if long { 32 } else { 16 };
    let (least, most) = (-(1_i64 << (bits - 1)), (1_i64 << bits) - 1);
    if raw < least || raw > most {
        return Err(Unsupported::BadArgument);
    }
    Ok(raw as u32 & (most as u32))
}

const NO_POINT: &str = "a point goes at most 8,388,607 counts beyond the one before, at less than \
                        32,768 counts a slow loop, in 1 to 511 slow loops: cut the path into more \
                        points, or fewer";

/// The preparations of a path, in order. \[I\] SETPVT takes what object 2074h takes on the same
/// drives with CANopen: bit 15 clears the buffer, 13 sets the counter to bits 6 to 0, 7 sets how
/// many points count as few to bits 11 to 8.
fn prepared(number: u8, kind: PathKind, few: u8) -> Option<Instruction> {
    let mcr = |and, or| Instruction::of(0x5909, [and, or]);
    Some(match (number, kind) {
        (0, PathKind::Pvt) => mcr(0xFFC1, 0x8709),
        (0, PathKind::Pt) => mcr(0xFFC0, 0x870A),
        (1, _) => mcr(0xDFFF, 0x0000),
        (2, _) => mcr(0xFFFF, 0x4000),
        (3, _) => Instruction::of(0x1880, [0xA080 | u16::from(few & 0xF) << 8]),
        _ => return None,
    })
}

/// A point in the drive's numbers, if they fit.
fn point(kind: PathKind, raw: &RawPoint) -> Option<Online> {
    let position = i32::try_from(raw.distance).ok()?;
    let velocity = i32::try_from(raw.velocity).ok()?;
    let time = u16::try_from(raw.time).ok()?;
    let counter = raw.number as u8 & PvtPoint::COUNTER_MAX;
    let pvt = PvtPoint { position, velocity, time, counter };
    match kind {
        _ if time == 0 => None,
        PathKind::Pvt => pvt.fits().then_some(Online::Pvt(pvt)),
        PathKind::Pt => Some(Online::Pt(PtPoint { position, time, counter })),
    }
}

macro_rules! driver {
    () => {
        const PROFILE: &'static str = "tml";
        const EVERY_ADDRESS: core::ops::RangeInclusive<u32> = 1..=255;

        fn generic() -> &'static Profile {
            &GENERIC
        }

        fn driver(
            profile: &'static Profile,
            address: u32,
        ) -> impl Driver<Request = Ask, Answer = Answer> + Send + 'static {
            Axis::new(profile, address)
        }
    };
}

/// TML on RS-232, RS-485, a pseudo-terminal or TCP.
#[derive(Debug)]
pub enum Tml {}

impl Protocol for Tml {
    type Medium = Stream;
    type Host = SerialHost;
    const NAME: &'static str = "tml";
    const STANDARDS: bool = true;
    const ADDRESSES: core::ops::RangeInclusive<u32> = 1..=255;
    const GROUPS: u8 = 8;
    const BAUD: u32 = 9600;

    fn host(options: &HostOptions, axes: &[u32]) -> SerialHost {
        SerialHost::new(options, axes)
    }

    driver!();
}

/// TML on CAN with 29-bit identifiers.
#[derive(Debug)]
pub enum TmlCan {}

impl Protocol for TmlCan {
    type Medium = Can;
    type Host = CanHost<Extended>;
    const NAME: &'static str = "tmlcan";
    const ADDRESSES: core::ops::RangeInclusive<u32> = 1..=255;
    const HOST: Option<u32> = Some(HOST_ID as u32);
    const GROUPS: u8 = 8;
    const BAUD: u32 = 500_000;

    fn host(options: &HostOptions, axes: &[u32]) -> Self::Host {
        CanHost::new(options, axes)
    }

    fn uses(_address: u32, _id: u32, extended: bool) -> bool {
        extended
    }

    fn discover(options: &HostOptions) -> Option<Frame> {
        discover::<Extended>(options)
    }

    fn sender(options: &HostOptions, frame: &Frame) -> Option<u32> {
        sender::<Extended>(options, frame)
    }

    driver!();
}

/// TML on CAN with the 11-bit identifiers that CANopen leaves free.
#[derive(Debug)]
pub enum TechnoCan {}

impl Protocol for TechnoCan {
    type Medium = Can;
    type Host = CanHost<Standard>;
    const NAME: &'static str = "technocan";
    const ADDRESSES: core::ops::RangeInclusive<u32> = 1..=31;
    const HOST: Option<u32> = Some(HOST_ID as u32);
    const GROUPS: u8 = 5;
    const BAUD: u32 = 500_000;

    fn host(options: &HostOptions, axes: &[u32]) -> Self::Host {
        CanHost::new(options, axes)
    }

    /// Messages to groups have identifiers of every class: all are taken wherever one axis is.
    fn uses(_address: u32, id: u32, extended: bool) -> bool {
        !extended && Service::of_id(id).is_some()
    }

    fn forbids(address: u32) -> Option<&'static str> {
        let free = !address.is_multiple_of(32);
        (!free).then_some(
            "TechnoCAN takes an axis ID by its last five bits, and a multiple of 32 leaves none: its \
             identifiers are others' (0x100 is CANopen's TIME)",
        )
    }

    fn discover(options: &HostOptions) -> Option<Frame> {
        discover::<Standard>(options)
    }

    fn sender(options: &HostOptions, frame: &Frame) -> Option<u32> {
        sender::<Standard>(options, frame)
    }

    driver!();
}

fn host_id(options: &HostOptions) -> IdCode {
    IdCode::axis(options.host.and_then(|id| u8::try_from(id).ok()).unwrap_or(HOST_ID))
}

/// GiveMeData2 of AAR to everybody: all answer, in the order of their IDs.
fn discover<E: Encapsulation>(options: &HostOptions) -> Option<Frame> {
    E::encode(&discovery(host_id(options))).ok()
}

/// The axis that answered [`discover`].
fn sender<E: Encapsulation>(options: &HostOptions, frame: &Frame) -> Option<u32> {
    let (to, instruction) = E::decode(frame)?.ok()?;
    let ours = to.is_none_or(|to| to.id == host_id(options).id && !to.group);
    let axis = Online::parse(&instruction)?.answered_by()?;
    ours.then_some(axis.into())
}
