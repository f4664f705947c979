//! From an instruction to text that assembles back to it.

use super::super::online::Online;
use super::super::wire::{IdCode, Instruction, operand_address};
use super::form::{Category, Form, Piece};
use super::variable::{self, Kind, symbol};
use super::{CONDITIONS, MEMORIES, RAW, Scope, forms};
use core::fmt::{Error, Result, Write};

/// Writes an instruction as text, in pieces.
///
/// What the table does not know, or knows only with other data, becomes `.word 0x1234, …`. Whatever
/// is written assembles back to the same words under the same scope.
pub fn disassemble(instruction: &Instruction, scope: &Scope<'_>, out: &mut dyn FnMut(&str)) {
    match form_of(instruction, scope) {
        Some(form) => drop(Writer { scope, instruction, kind: Kind::Double, out }.form(form)),
        None => drop(raw(instruction, out)),
    }
}

/// Writes a word that begins no instruction.
pub fn disassemble_word(word: u16, out: &mut dyn FnMut(&str)) {
    // The sink takes whatever it is given.
    let _ = write!(Sink(out), "{RAW} {:#06X}", Hex(word));
}

/// The form that an instruction is written in, if the table has one for it.
#[must_use]
pub fn form_of(instruction: &Instruction, scope: &Scope<'_>) -> Option<&'static Form> {
    let fits = |form: &&Form| {
        let out = &mut |_: &str| ();
        form.holds(instruction.opcode, instruction.data())
            && Writer { scope, instruction, kind: Kind::Double, out }.form(form).is_ok()
    };
    forms().filter(|form| !form.alias).find(fits)
}

struct Sink<'o>(&'o mut dyn FnMut(&str));

impl Write for Sink<'_> {
    fn write_str(&mut self, text: &str) -> Result {
        (self.0)(text);
        Ok(())
    }
}

fn raw(instruction: &Instruction, out: &mut dyn FnMut(&str)) -> Result {
    disassemble_word(instruction.opcode, out);
    let mut sink = Sink(out);
    instruction.data().iter().try_for_each(|word| write!(sink, ", {:#06X}", Hex(*word)))
}

/// A word as the language writes it: 0x025E, the digits upper case and the x not.
struct Hex(u16);

impl core::fmt::UpperHex for Hex {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> Result {
        write!(f, "0x{:04X}", self.0)
    }
}

struct Writer<'a, 'o> {
    scope: &'a Scope<'a>,
    instruction: &'a Instruction,
    /// What the variable before holds.
    kind: Kind,
    out: &'o mut dyn FnMut(&str),
}

impl Writer<'_, '_> {
    fn form(&mut self, form: &Form) -> Result {
        let mut before = None;
        for piece in form.pieces {
            if apart(before, *piece) {
                self.text(" ");
            }
            self.piece(*piece, form)?;
            before = Some(*piece);
        }
        Ok(())
    }

    fn text(&mut self, text: &str) {
        (self.out)(text);
    }

    fn write(&mut self, arguments: core::fmt::Arguments<'_>) -> Result {
        Sink(self.out).write_fmt(arguments)
    }

    fn word(&self, at: u8) -> u16 {
        self.instruction.word(at.into())
    }

    fn piece(&mut self, piece: Piece, form: &Form) -> Result {
        let opcode = self.instruction.opcode;
        match piece {
            Piece::Word(text) | Piece::Sign(text) => self.text(text),
            Piece::Near16 => return self.variable(operand_address(opcode), false, form),
            Piece::Near32 => return self.variable(operand_address(opcode), true, form),
            Piece::Var16(at) | Piece::Pointer(at) | Piece::Far16(at) => {
                return self.variable(self.word(at), false, form);
            }
            Piece::Var32(at) | Piece::Far32(at) => {
                return self.variable(self.word(at), true, form);
            }
            Piece::Step if opcode & 0x80 == 0 => self.text("+"),
            Piece::Step => {}
            Piece::Memory => self.memory(opcode >> 2)?,
            Piece::MemoryHigh => self.memory(opcode >> 5)?,
            Piece::Count(bits, most) => {
                let count = opcode & ((1 << bits) - 1);
                if count > u16::from(most) {
                    return Err(Error);
                }
                return self.write(format_args!("{count}"));
            }
            Piece::Counter => return self.write(format_args!("{}", opcode & 0x7F)),
            Piece::Condition => {
                let known = CONDITIONS.iter().find(|(_, bits)| *bits == opcode & 0x7E);
                self.text(known.ok_or(Error)?.0);
            }
            Piece::Point => return self.point(),
            Piece::Lines(at) => return self.bits(self.word(at), 0, 16),
            Piece::Groups(at) => return self.bits(self.word(at), 1, 8),
            Piece::Line(at) => return self.line(self.word(at)),
            Piece::Axis(at) => return self.id_code(self.word(at)),
            Piece::From(at) => {
                self.text("FROM ");
                return self.id_code(self.word(at));
            }
            Piece::FromAxis => return self.write(format_args!("FROM {}", opcode & 0xFF)),
            Piece::AxisNumber => return self.write(format_args!("{}", opcode & 0xFF)),
            Piece::Version(at) => return self.version(at),
            Piece::Inner(at) => return self.inner(at),
            _ => return self.number(piece),
        }
        Ok(())
    }

    fn number(&mut self, piece: Piece) -> Result {
        match piece {
            Piece::Number(at) if self.kind == Kind::Int => {
                self.write(format_args!("{}", self.word(at).cast_signed()))
            }
            Piece::Number(at) | Piece::Hex(at) | Piece::Target(at) | Piece::Narrow(at) => {
                self.write(format_args!("{:X}", Hex(self.word(at))))
            }
            Piece::Fixed(at) => self.fixed(self.long(at)),
            Piece::Long(at) if self.kind == Kind::Fixed => self.fixed(self.long(at)),
            Piece::Long(at) if matches!(self.kind, Kind::Long | Kind::Double) => {
                self.write(format_args!("{}", self.long(at).cast_signed()))
            }
            Piece::Long(at) | Piece::Wide(at) | Piece::High(at) => {
                self.write(format_args!("0x{:08X}", self.long(at)))
            }
            _ => Err(Error),
        }
    }

    fn long(&self, at: u8) -> u32 {
        self.instruction.long(at.into())
    }

    /// Five decimals tell every 65536th from its neighbours.
    fn fixed(&mut self, raw: u32) -> Result {
        let signed = raw.cast_signed();
        let size = signed.unsigned_abs();
        let sign = if signed < 0 { "-" } else { "" };
        let mut part = (u64::from(size & 0xFFFF) * 100_000 + 0x8000) >> 16;
        let mut places = 5;
        while places > 1 && part % 10 == 0 {
            (part, places) = (part / 10, places - 1);
        }
        self.write(format_args!("{sign}{}.{part:0places$}", size >> 16))
    }

    fn variable(&mut self, address: u16, long: bool, form: &Form) -> Result {
        let profile = self.scope.profile;
        self.kind = if long { Kind::Double } else { Kind::Word };
        if let Some(found) = variable::name_at(profile, address, long) {
            // `PROD <<= 3` is about the whole product, not about the variable of that name.
            let product = form.category == Category::Arithmetic && symbol(found) == "PROD";
            if !product {
                self.kind = Kind::of(found.encoding);
                self.text(symbol(found));
                return Ok(());
            }
        }
        if long {
            return self.write(format_args!("@{:X}L", Hex(address)));
        }
        let halves = [(address, "(L)"), (address.wrapping_sub(1), "(H)")];
        for (whole, half) in halves {
            if let Some(found) = variable::name_at(profile, whole, true) {
                self.text(symbol(found));
                self.text(half);
                return Ok(());
            }
        }
        self.write(format_args!("@{:X}", Hex(address)))
    }

    fn memory(&mut self, bits: u16) -> Result {
        self.text(MEMORIES.get(usize::from(bits & 3)).ok_or(Error)?);
        Ok(())
    }

    fn point(&mut self) -> Result {
        let Some(Online::Pvt(point)) = Online::parse(self.instruction) else { return Err(Error) };
        if Online::Pvt(point).emit() != *self.instruction {
            return Err(Error);
        }
        self.write(format_args!("{}, ", point.position))?;
        self.fixed(point.velocity.cast_unsigned())?;
        self.write(format_args!(", {}", point.time))
    }

    fn bits(&mut self, word: u16, first: u32, count: u32) -> Result {
        if u32::from(word) >> count != 0 {
            return Err(Error);
        }
        self.text("(");
        let mut between = "";
        for bit in (0..count).filter(|bit| word >> bit & 1 == 1) {
            self.write(format_args!("{between}{}", bit + first))?;
            between = ", ";
        }
        self.text(")");
        Ok(())
    }

    fn line(&mut self, word: u16) -> Result {
        if !word.is_power_of_two() {
            return Err(Error);
        }
        self.write(format_args!("{}", word.trailing_zeros()))
    }

    fn id_code(&mut self, word: u16) -> Result {
        let code = IdCode::from_word(word).ok_or(Error)?;
        match code {
            IdCode { group: false, id, host: false } => self.write(format_args!("{id}")),
            IdCode { group: false, id, host: true } => self.write(format_args!("H{id}")),
            IdCode { group: true, id: 0, host: false } => self.write(format_args!("G*")),
            IdCode { group: true, id, host: false } => {
                let mut before = "G";
                for bit in (0..8).filter(|bit| id >> bit & 1 == 1) {
                    self.write(format_args!("{before}{}", bit + 1))?;
                    before = "+";
                }
                Ok(())
            }
            _ => Err(Error),
        }
    }

    fn version(&mut self, at: u8) -> Result {
        let ([a, b], [c, d]) = (self.word(at).to_be_bytes(), self.word(at + 1).to_be_bytes());
        let letters = [a, b, c, d];
        let text = core::str::from_utf8(&letters).map_err(|_| Error)?;
        if !letters.iter().all(u8::is_ascii_alphanumeric) {
            return Err(Error);
        }
        self.text(text);
        Ok(())
    }

    fn inner(&mut self, at: u8) -> Result {
        let data = self.instruction.data();
        let (opcode, rest) = data[usize::from(at)..].split_first().ok_or(Error)?;
        let inner = Instruction::new(*opcode, rest).ok_or(Error)?;
        let form = form_of(&inner, self.scope);
        if form.is_some_and(|form| matches!(form.category, Category::Axes | Category::Online)) {
            return raw(&inner, self.out);
        }
        disassemble(&inner, self.scope, self.out);
        Ok(())
    }
}

/// Whether a space belongs between two pieces: words and what follows them do not touch.
const fn apart(before: Option<Piece>, piece: Piece) -> bool {
    let after_word = matches!(before, Some(Piece::Word(_)));
    let operand = !matches!(piece, Piece::Sign(_) | Piece::Lines(_) | Piece::Step);
    let from = matches!(piece, Piece::From(_) | Piece::FromAxis);
    (after_word && operand) || (before.is_some() && from)
}
