//! An axis of any TMCL module, from its profile alone.
//!
//! Space 0 is axis parameters (GAP, SAP), space 1 + n is bank n of the global parameters (GGP,
//! SGP). A parameter number above 255 puts its upper bits into the motor byte, above the axis, as
//! the vendor's host library does.

use super::generic::GENERIC;
use super::host::{CanHost, SerialHost, sender};
use super::opcode::{Opcode, Status};
use super::session::{Answer, Ask};
use super::text;
use super::wire::Request;
use crate::axis::{Driver, TOLD_MAX, Told};
use crate::error::{Failure, Unsupported};
use crate::explain::Raw;
use crate::medium::{Can, Frame, Stream};
use crate::profile::{Parameter, Profile, Readdress, Signal};
use crate::program::Order;
use crate::proto::{HostOptions, Protocol};
use crate::station::Class;

/// Bits of the motor byte that name the axis, where parameter numbers go beyond 255. \[I\]
pub const AXIS_BITS: u8 = 4;

/// One axis of a module.
#[derive(Clone, Copy, Debug)]
pub struct Axis {
    profile: &'static Profile,
    module: u8,
    /// Numbers of the global parameters that hold the module's address and its host's.
    addresses: [u16; 2],
}

/// Serial address and serial host address (TMCL reference, global parameters of bank 0).
const SERIAL: [u16; 2] = [66, 76];
/// CAN id of requests and of replies (the same).
const CAN: [u16; 2] = [71, 70];
/// The space of bank 0.
const BANK_0: u8 = 1;

impl Axis {
    /// The first axis of the module at `address` of a serial line.
    #[must_use]
    pub fn new(profile: &'static Profile, address: u32) -> Self {
        Self { profile, module: address as u8, addresses: SERIAL }
    }

    /// The first axis of the module that has the CAN id `address`.
    #[must_use]
    pub fn on_can(profile: &'static Profile, address: u32) -> Self {
        Self { addresses: CAN, ..Self::new(profile, address) }
    }

    /// A request on a parameter, by the opcodes for axis and for global ones.
    fn on(
        &self,
        parameter: &Parameter,
        [axis, global]: [Opcode; 2],
        value: i32,
    ) -> Result<Request, Unsupported> {
        let upper = u32::from(parameter.index >> 8) << AXIS_BITS;
        let (opcode, motor) = match parameter.space {
            0 => (axis, upper),
            bank => (global, (u32::from(bank) - 1) | upper),
        };
        let motor = u8::try_from(motor)
            .map_err(|_| Unsupported::Forbidden("the parameter's number is too large for TMCL"))?;
        let kind = parameter.index as u8;
        Ok(Request { address: self.module, opcode, kind, motor, value })
    }
}

impl Driver for Axis {
    type Request = Ask;
    type Answer = Answer;

    fn profile(&self) -> &'static Profile {
        self.profile
    }

    fn address(&self) -> u32 {
        self.module.into()
    }

    fn read(&self, parameter: &Parameter) -> Result<Ask, Unsupported> {
        self.on(parameter, [Opcode::Gap, Opcode::Ggp], 0).map(Ask::of)
    }

    fn write(&self, parameter: &Parameter, raw: i64, class: Class) -> Result<Ask, Unsupported> {
        let request = self.on(parameter, [Opcode::Sap, Opcode::Sgp], wire_value(raw)?)?;
        Ok(Ask { request, class })
    }

    fn keep(&self, parameter: &Parameter) -> Result<Ask, Unsupported> {
        self.on(parameter, [Opcode::Stap, Opcode::Stgp], 0).map(Ask::of)
    }

    /// `function` is the opcode, `index` the type and, in its high byte, the motor or bank.
    fn send(&self, function: u8, index: u16, value: i64) -> Result<Ask, Unsupported> {
        let [motor, kind] = index.to_be_bytes();
        let (opcode, value) = turned(Opcode::from(function), wire_value(value)?);
        Ok(Ask::of(Request { address: self.module, opcode, kind, motor, value }))
    }

    /// MST has the motor in a byte of its own (TMCL reference).
    fn order(&self, order: Order) -> Option<Ask> {
        let Order::StopMotor(motor) = order else { return None };
        let address = self.module;
        Some(Ask::of(Request { address, opcode: Opcode::Mst, kind: 0, motor, value: 0 }))
    }

    /// A change holds from the next datagram on \[I\].
    fn readdresses(&self, parameter: &Parameter) -> Option<Readdress> {
        let [own, host] = self.addresses;
        match parameter.index {
            _ if parameter.space != BANK_0 => None,
            index if index == own => Some(Readdress::Own),
            index if index == host => Some(Readdress::Host),
            _ => None,
        }
    }

    fn parse(&self, text: &str) -> Result<Ask, Unsupported> {
        text::parse(text, self.module).map(Ask::of).map_err(|_| Unsupported::BadText)
    }

    /// Nine bytes on a serial line; on CAN seven, or eight, under the module's address.
    fn decode(&self, frame: &Raw<'_>) -> Result<Ask, Unsupported> {
        let request = match frame.id {
            None => Request::parse(frame.bytes),
            Some(id) if id == u32::from(self.module) && !frame.extended => {
                Request::parse_can(frame.bytes, self.module)
            }
            Some(_) => return Err(Unsupported::BadBytes),
        };
        let to_it = |request: &Request| request.address == self.module;
        request.ok().filter(to_it).map(Ask::of).ok_or(Unsupported::BadBytes)
    }

    fn answer(&mut self, parameter: Option<&Parameter>, answer: &Answer) -> Result<i64, Failure> {
        use crate::profile::Encoding;
        match answer {
            // Somebody has the module store instructions: this one was not carried out either.
            Answer::Reply(reply) if reply.status == Status::Loaded && parameter.is_some() => {
                Err(Failure::Refused { code: reply.status.number().into() })
            }
            Answer::Reply(reply) | Answer::Event(reply) => {
                let unsigned =
                    matches!(parameter.map(|parameter| parameter.encoding), Some(Encoding::U32));
                Ok(if unsigned { reply.value.cast_unsigned().into() } else { reply.value.into() })
            }
            // Eight characters are the eight bytes of the outcome's value.
            Answer::Text(version) => Ok(i64::from_be_bytes(version.text)),
            Answer::Instruction(instruction) => Ok(instruction.value.into()),
            Answer::NoReply => Ok(0),
        }
    }

    fn unasked(&mut self, answer: &Answer) -> [Option<Told>; TOLD_MAX] {
        let mut told = [None; TOLD_MAX];
        if let Answer::Event(reply) = answer {
            let reached = i64::from(reply.value & 1);
            told[0] = Some(Told::Signal(Signal::Reached, reached));
        }
        told
    }
}

/// Speeds go both ways: `ROR` with a negative one is `ROL` with a positive one, because the TMCL
/// manuals give both a range from 0 on.
fn turned(opcode: Opcode, value: i32) -> (Opcode, i32) {
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

/// TMCL on RS-232, RS-485, a pseudo-terminal or TCP.
#[derive(Debug)]
pub enum Tmcl {}

impl Protocol for Tmcl {
    type Medium = Stream;
    type Host = SerialHost;
    const NAME: &'static str = "tmcl";
    const PROFILE: &'static str = "tmcl";
    const ADDRESSES: core::ops::RangeInclusive<u32> = 1..=32;
    const HOST: Option<u32> = Some(super::wire::HOST as u32);
    const EVERY_ADDRESS: core::ops::RangeInclusive<u32> = 0..=255;
    const BAUD: u32 = 9600;

    fn generic() -> &'static Profile {
        &GENERIC
    }

    fn host(options: &HostOptions, _axes: &[u32]) -> SerialHost {
        SerialHost::new(options)
    }

    fn driver(
        profile: &'static Profile,
        address: u32,
    ) -> impl Driver<Request = Ask, Answer = Answer> + Send + 'static {
        Axis::new(profile, address)
    }
}

/// TMCL on CAN. A module's address is its CAN id.
#[derive(Debug)]
pub enum TmclCan {}

impl Protocol for TmclCan {
    type Medium = Can;
    type Host = CanHost;
    const NAME: &'static str = "tmcl";
    const PROFILE: &'static str = "tmcl";
    const ADDRESSES: core::ops::RangeInclusive<u32> = 1..=32;
    // Identifiers go to 0x7FF, but a request holds its address in a byte: beyond it another module
    // would be meant.
    const EVERY_ADDRESS: core::ops::RangeInclusive<u32> = 0..=255;
    const HOST: Option<u32> = Some(super::wire::HOST as u32);
    const BAUD: u32 = 250_000;

    fn generic() -> &'static Profile {
        &GENERIC
    }

    fn host(options: &HostOptions, _axes: &[u32]) -> CanHost {
        CanHost::new(options)
    }

    fn uses(address: u32, id: u32, extended: bool) -> bool {
        !extended && id == address
    }

    fn sender(options: &HostOptions, frame: &Frame) -> Option<u32> {
        sender(options, frame)
    }

    fn driver(
        profile: &'static Profile,
        address: u32,
    ) -> impl Driver<Request = Ask, Answer = Answer> + Send + 'static {
        Axis::on_can(profile, address)
    }
}
