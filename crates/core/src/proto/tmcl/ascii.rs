//! ASCII mode: opcode 139 enters it, the line `BIN` leaves it (TMCL manuals, chapter "ASCII interface"). The vendor
//! keeps it for old applications only.
//!
//! A line is the module's letter (A is address 1), the command, and carriage return:
//! `AMVP ABS, 1, 50000`. The answer is the host's and the module's letter, the status and the value:
//! `BA 100 -5000`.

use super::opcode::{Opcode, Status};
use super::text;
use super::wire::Request;
use crate::explain::Decimal;

/// Characters of a line at most, carriage return counted.
pub const LINE_MAX: usize = 40;

/// A line as it grows. One that grows too long is remembered as unreadable.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct AsciiLine {
    bytes: [u8; LINE_MAX],
    len: usize,
}

impl AsciiLine {
    /// Nothing yet.
    pub const EMPTY: Self = Self { bytes: [0; LINE_MAX], len: 0 };

    /// Appends a character; one too many is dropped.
    pub fn push(&mut self, byte: u8) {
        if let Some(slot) = self.bytes.get_mut(self.len) {
            *slot = byte;
            self.len += 1;
        }
    }

    /// Appends text.
    pub fn push_str(&mut self, text: &str) {
        text.bytes().for_each(|byte| self.push(byte));
    }

    /// Bytes of the line.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..self.len]
    }
}

/// Command of a line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum AsciiCommand {
    /// A request.
    Request(Request),
    /// `BIN`: back to datagrams.
    Binary,
    /// Addressed well, but no command that this mode has.
    Unreadable,
}

impl AsciiCommand {
    /// Parses a line without its carriage return: the address and the command. `None` when it does not begin
    /// with a letter.
    #[must_use]
    pub fn parse(line: &[u8]) -> Option<(u8, Self)> {
        let line = core::str::from_utf8(line).ok()?.trim();
        let address = address_of_letter(line.bytes().next()?)?;
        let command = line[1..].trim();
        let request = |opcode| Request { address, opcode, kind: 0, motor: 0, value: 0 };
        let parsed = if command.eq_ignore_ascii_case("BIN") {
            Self::Binary
        } else if command.eq_ignore_ascii_case("RUN") {
            Self::Request(request(Opcode::ProgramRun))
        } else if command.eq_ignore_ascii_case("STOP") {
            Self::Request(request(Opcode::ProgramStop))
        } else {
            match text::parse(command, address) {
                Ok(request) if has_ascii_form(request.opcode) => Self::Request(request),
                _ => Self::Unreadable,
            }
        };
        Some((address, parsed))
    }
}

/// Writes a request as a line with its carriage return. `false` when this mode has no such command
/// or no letter for the address.
pub fn write_request(line: &mut AsciiLine, request: &Request) -> bool {
    let Some(letter) = letter_of_address(request.address) else { return false };
    line.push(letter);
    match request.opcode {
        Opcode::ProgramRun if request.kind == 0 => line.push_str("RUN"),
        Opcode::ProgramStop => line.push_str("STOP"),
        opcode if has_ascii_form(opcode) => text::write(request, &mut |piece| line.push_str(piece)),
        _ => return false,
    }
    line.push(b'\r');
    true
}

/// Writes a reply with its carriage return.
pub fn write_reply(line: &mut AsciiLine, host: u8, module: u8, status: Status, value: i32) {
    line.push(letter_of_address(host).unwrap_or(b'?'));
    line.push(letter_of_address(module).unwrap_or(b'?'));
    line.push(b' ');
    line.push_str(Decimal::of(status.number().into()).as_str());
    line.push(b' ');
    line.push_str(Decimal::of(value.into()).as_str());
    line.push(b'\r');
}

/// A reply in ASCII. It does not repeat the opcode.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct AsciiReply {
    /// Host address.
    pub host: u8,
    /// Module address.
    pub module: u8,
    /// Status.
    pub status: Status,
    /// The value.
    pub value: i32,
}

impl AsciiReply {
    /// Reads a line without its carriage return.
    #[must_use]
    pub fn parse(line: &[u8]) -> Option<Self> {
        let line = core::str::from_utf8(line).ok()?.trim();
        let (letters, rest) = line.split_at_checked(2)?;
        let &[host, module] = letters.as_bytes() else { return None };
        let (host, module) = (address_of_letter(host)?, address_of_letter(module)?);
        let mut numbers = rest.split_ascii_whitespace();
        let status = text::parse_number(numbers.next()?).and_then(|n| u8::try_from(n).ok())?;
        let value = text::parse_number(numbers.next()?).and_then(|n| i32::try_from(n).ok())?;
        let whole = numbers.next().is_none();
        whole.then_some(Self { host, module, status: Status::from(status), value })
    }
}

/// Commands that the manuals list for this mode.
const fn has_ascii_form(opcode: Opcode) -> bool {
    matches!(opcode.number(), 1..=15 | 30..=32 | 64..=71)
}

/// A for 1 to Z for 26.
fn letter_of_address(address: u8) -> Option<u8> {
    (1..=26).contains(&address).then(|| b'A' + address - 1)
}

fn address_of_letter(letter: u8) -> Option<u8> {
    letter.is_ascii_alphabetic().then(|| letter.to_ascii_uppercase() - b'A' + 1)
}
