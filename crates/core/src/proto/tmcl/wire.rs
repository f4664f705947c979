//! The datagram: nine bytes on a serial line, seven in a CAN frame (TMCM-170/171 manual §2.1, §2.2).
//!
//! ```text
//! request  address  opcode  type    motor   value (MSB first)  checksum
//! reply    host     module  status  opcode  value (MSB first)  checksum
//! ```
//! The checksum is the sum of the first eight bytes, modulo 256. On CAN the first byte and the
//! checksum are left out; some hosts and modules send eight data bytes all the same, the last one
//! being the serial checksum or padding, so it is read and ignored.

use super::opcode::{Opcode, Status};
use crate::error::WireError;
use crate::medium::Frame;

/// Bytes of a datagram on a serial line.
pub const DATAGRAM: usize = 9;
/// Bytes of a datagram in a CAN frame.
pub const CAN_DATAGRAM: usize = 7;
/// Module address, and CAN id of requests, from the factory.
pub const MODULE: u8 = 1;
/// Host address, and CAN id of replies, from the factory.
pub const HOST: u8 = 2;

/// The sum over the first eight bytes.
#[must_use]
#[inline]
pub fn checksum([body @ .., _]: &[u8; DATAGRAM]) -> u8 {
    byte_sum(u64::from_le_bytes(*body))
}

/// A request.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Request {
    /// Module address; on CAN it is in the identifier, not in the data.
    pub address: u8,
    /// Instruction.
    pub opcode: Opcode,
    /// The "type" byte: a parameter number, a kind of move.
    pub kind: u8,
    /// The "motor" or "bank" byte.
    pub motor: u8,
    /// The operand.
    pub value: i32,
}

impl Request {
    /// Reads nine bytes.
    ///
    /// # Errors
    /// [`WireError::Short`], [`WireError::Long`], [`WireError::Checksum`].
    #[inline]
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let [first, body @ .., _] = checked_datagram(bytes)?;
        Ok(Self::from_body(*first, *body))
    }

    /// Parses the data of a CAN frame; `address` is from its identifier.
    ///
    /// # Errors
    /// [`WireError::Short`], [`WireError::Long`].
    pub fn parse_can(data: &[u8], address: u8) -> Result<Self, WireError> {
        Ok(Self::from_body(address, can_body(data)?))
    }

    /// The nine bytes on a serial line.
    #[must_use]
    #[inline]
    pub fn emit(&self) -> [u8; DATAGRAM] {
        with_checksum([self.address, self.opcode.number(), self.kind, self.motor], self.value)
    }

    /// The CAN frame, of seven data bytes, or of eight with the serial checksum as the last.
    #[must_use]
    pub fn emit_can(&self, id: u16, eight: bool) -> Frame {
        Frame::standard(id, &self.emit()[1..if eight { 9 } else { 8 }])
    }

    #[inline]
    fn from_body(address: u8, [opcode, kind, motor, a, b, c, d]: [u8; CAN_DATAGRAM]) -> Self {
        let value = i32::from_be_bytes([a, b, c, d]);
        Self { address, opcode: Opcode::from(opcode), kind, motor, value }
    }
}

/// A reply.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Reply {
    /// Host address; on CAN it is not sent.
    pub host: u8,
    /// Address of the module that answers.
    pub module: u8,
    /// Status.
    pub status: Status,
    /// Opcode of the request that this answers.
    pub opcode: Opcode,
    /// The value; narrower quantities come sign-extended.
    pub value: i32,
}

impl Reply {
    /// Reads nine bytes.
    ///
    /// # Errors
    /// [`WireError::Short`], [`WireError::Long`], [`WireError::Checksum`].
    #[inline]
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let [first, body @ .., _] = checked_datagram(bytes)?;
        Ok(Self::from_body(*first, *body))
    }

    /// Reads nine bytes whose checksum is looked at elsewhere.
    #[inline]
    pub(super) fn unchecked([host, body @ .., _]: &[u8; DATAGRAM]) -> Self {
        Self::from_body(*host, *body)
    }

    /// Parses the data of a CAN frame; `host` is from its identifier.
    ///
    /// # Errors
    /// [`WireError::Short`], [`WireError::Long`].
    pub fn parse_can(data: &[u8], host: u8) -> Result<Self, WireError> {
        Ok(Self::from_body(host, can_body(data)?))
    }

    /// The nine bytes on a serial line.
    #[must_use]
    #[inline]
    pub fn emit(&self) -> [u8; DATAGRAM] {
        with_checksum(
            [self.host, self.module, self.status.number(), self.opcode.number()],
            self.value,
        )
    }

    /// The CAN frame, of seven data bytes, or of eight with a zero as the last, as the TMCM-1260
    /// sends it.
    #[must_use]
    pub fn emit_can(&self, id: u16, eight: bool) -> Frame {
        let mut frame = Frame::standard(id, &self.emit()[1..8]);
        frame.len = if eight { 8 } else { 7 };
        frame
    }

    #[inline]
    fn from_body(host: u8, [module, status, opcode, a, b, c, d]: [u8; CAN_DATAGRAM]) -> Self {
        let value = i32::from_be_bytes([a, b, c, d]);
        Self { host, module, status: Status::from(status), opcode: Opcode::from(opcode), value }
    }
}

/// The reply to opcode 136 type 0: the host's address and eight characters, like `170V1.14`. It has
/// no checksum. On CAN the eight characters fill the frame.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct VersionText {
    /// Host address; on CAN it is not sent.
    pub host: u8,
    /// The characters.
    pub text: [u8; 8],
}

impl VersionText {
    /// Reads nine bytes. The only check there is: all characters can be printed.
    ///
    /// # Errors
    /// [`WireError::Short`], [`WireError::Long`], [`WireError::Unexpected`].
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let nine = as_datagram(bytes)?;
        Self::from_printable(
            nine[0],
            [nine[1], nine[2], nine[3], nine[4], nine[5], nine[6], nine[7], nine[8]],
        )
    }

    /// Reads the data of a CAN frame.
    ///
    /// # Errors
    /// [`WireError::Short`], [`WireError::Unexpected`].
    pub fn parse_can(data: &[u8], host: u8) -> Result<Self, WireError> {
        let found = data.len().min(usize::from(u16::MAX)) as u16;
        Self::from_printable(
            host,
            data.try_into().map_err(|_| WireError::Short { need: 8, found })?,
        )
    }

    /// The nine bytes on a serial line.
    #[must_use]
    #[inline]
    pub fn emit(&self) -> [u8; DATAGRAM] {
        let mut out = [self.host; DATAGRAM];
        out[1..].copy_from_slice(&self.text);
        out
    }

    fn from_printable(host: u8, text: [u8; 8]) -> Result<Self, WireError> {
        match text.iter().position(|c| !(b' '..=b'~').contains(c)) {
            Some(at) => Err(WireError::Unexpected { at: at as u16 + 1, found: text[at] }),
            None => Ok(Self { host, text }),
        }
    }
}

/// The reply to opcode 134: it reuses all fields between host address and checksum for the
/// instruction found in program memory.
///
/// \[I\] No manual prints the layout. The instruction has seven bytes, exactly as many as there are
/// between the host address and the checksum, and the vendor's host library skips its status check
/// on this reply but not the checksum.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Instruction {
    /// Opcode of the instruction stored.
    pub opcode: u8,
    /// Type of the command.
    pub kind: u8,
    /// Motor or bank.
    pub motor: u8,
    /// Operand.
    pub value: i32,
}

impl Instruction {
    /// The instruction in the fields of a reply.
    #[must_use]
    #[inline]
    pub fn of_reply(reply: &Reply) -> Self {
        Self {
            opcode: reply.module,
            kind: reply.status.number(),
            motor: reply.opcode.number(),
            value: reply.value,
        }
    }

    /// Bytes of the datagram: opcode, type, motor, value with the high byte first.
    #[must_use]
    pub const fn bytes(self) -> [u8; CAN_DATAGRAM] {
        let [a, b, c, d] = self.value.to_be_bytes();
        [self.opcode, self.kind, self.motor, a, b, c, d]
    }

    /// The instruction of these bytes.
    #[must_use]
    pub const fn from_bytes([opcode, kind, motor, a, b, c, d]: [u8; CAN_DATAGRAM]) -> Self {
        Self { opcode, kind, motor, value: i32::from_be_bytes([a, b, c, d]) }
    }

    /// The bytes as one number, the opcode highest.
    #[must_use]
    pub const fn packed(self) -> i64 {
        let [a, b, c, d, e, f, g] = self.bytes();
        i64::from_be_bytes([0, a, b, c, d, e, f, g])
    }

    /// Lays the instruction over a reply's fields.
    #[must_use]
    pub fn into_reply(self, host: u8) -> Reply {
        Reply {
            host,
            module: self.opcode,
            status: Status::from(self.kind),
            opcode: Opcode::from(self.motor),
            value: self.value,
        }
    }
}

/// Four bytes, a value and their sum. They are put together in a register: bytes just written one
/// by one are slow to read again.
#[inline]
fn with_checksum(head: [u8; 4], value: i32) -> [u8; DATAGRAM] {
    let value = u32::from_le_bytes(value.to_be_bytes());
    let body = u64::from(u32::from_le_bytes(head)) | u64::from(value) << 32;
    let mut out = [byte_sum(body); DATAGRAM];
    out[..DATAGRAM - 1].copy_from_slice(&body.to_le_bytes());
    out
}

/// The sum of eight bytes, modulo 256: pairs are added first, then all four pairs at once.
#[inline]
const fn byte_sum(bytes: u64) -> u8 {
    const EVEN: u64 = 0x00FF_00FF_00FF_00FF;
    let pairs = (bytes & EVEN) + (bytes >> 8 & EVEN);
    (pairs.wrapping_mul(0x0001_0001_0001_0001) >> 48) as u8
}

#[inline]
fn as_datagram(bytes: &[u8]) -> Result<&[u8; DATAGRAM], WireError> {
    bytes.try_into().map_err(|_| wrong_length(bytes))
}

#[inline]
fn checked_datagram(bytes: &[u8]) -> Result<&[u8; DATAGRAM], WireError> {
    let nine = as_datagram(bytes)?;
    let (computed, found) = (checksum(nine), nine[DATAGRAM - 1]);
    if computed != found {
        return Err(WireError::Checksum { computed: computed.into(), found: found.into() });
    }
    Ok(nine)
}

#[cold]
fn wrong_length(bytes: &[u8]) -> WireError {
    let found = bytes.len().min(usize::from(u16::MAX)) as u16;
    let need = DATAGRAM as u16;
    if found < need { WireError::Short { need, found } } else { WireError::Long { need, found } }
}

fn can_body(data: &[u8]) -> Result<[u8; CAN_DATAGRAM], WireError> {
    match data {
        [a, b, c, d, e, f, g] | [a, b, c, d, e, f, g, _] => Ok([*a, *b, *c, *d, *e, *f, *g]),
        short if short.len() < CAN_DATAGRAM => {
            Err(WireError::Short { need: CAN_DATAGRAM as u16, found: short.len() as u16 })
        }
        long => {
            Err(WireError::Long { need: 8, found: long.len().min(usize::from(u16::MAX)) as u16 })
        }
    }
}
