//! Converts an instruction to text that assembles back to it.

use super::super::online::OnlineMessage;
use super::super::wire::{IdCode, Instruction, operand_address};
use super::form::{Category, Form, FormPiece};
use super::variable::{self, VariableKind, symbol};
use super::{CONDITIONS, LanguageScope, MEMORIES, RAW_DIRECTIVE, forms};
use core::fmt::{Error, Result, Write};

/// Writes an instruction as text, in pieces.
///
/// Words that the table does not have, or has only with other data, become `.word 0x1234, …`. The text assembles to the
/// same words again under the same scope.
pub fn disassemble(
    instruction: &Instruction,
    scope: &LanguageScope<'_>,
    out: &mut dyn FnMut(&str),
) {
    match form_of(instruction, scope) {
        Some(form) => drop(
            InstructionWriter { scope, instruction, variable_kind: VariableKind::Double, out }
                .write_form(form),
        ),
        None => drop(write_raw(instruction, out)),
    }
}

/// Writes a word that begins no instruction.
pub fn disassemble_word(word: u16, out: &mut dyn FnMut(&str)) {
    // The sink takes whatever it is given.
    let _ = write!(PieceWriter(out), "{RAW_DIRECTIVE} {:#06X}", HexWord(word));
}

/// The form that an instruction is written in, if the table has one for it.
#[must_use]
pub fn form_of(instruction: &Instruction, scope: &LanguageScope<'_>) -> Option<&'static Form> {
    forms().filter(|form| !form.alias).find(|form| {
        let out = &mut |_: &str| ();
        form.matches(instruction.opcode, instruction.data())
            && InstructionWriter { scope, instruction, variable_kind: VariableKind::Double, out }
                .write_form(form)
                .is_ok()
    })
}

struct PieceWriter<'o>(&'o mut dyn FnMut(&str));

impl Write for PieceWriter<'_> {
    fn write_str(&mut self, text: &str) -> Result {
        (self.0)(text);
        Ok(())
    }
}

fn write_raw(instruction: &Instruction, out: &mut dyn FnMut(&str)) -> Result {
    disassemble_word(instruction.opcode, out);
    let mut sink = PieceWriter(out);
    instruction.data().iter().try_for_each(|word| write!(sink, ", {:#06X}", HexWord(*word)))
}

/// A word as the language writes it: 0x025E, the digits upper case and the x not.
struct HexWord(u16);

impl core::fmt::UpperHex for HexWord {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> Result {
        write!(f, "0x{:04X}", self.0)
    }
}

struct InstructionWriter<'a, 'o> {
    scope: &'a LanguageScope<'a>,
    instruction: &'a Instruction,
    /// Kind of the previous variable.
    variable_kind: VariableKind,
    out: &'o mut dyn FnMut(&str),
}

impl InstructionWriter<'_, '_> {
    fn write_form(&mut self, form: &Form) -> Result {
        let mut before = None;
        for piece in form.pieces {
            if needs_space(before, *piece) {
                self.write_text(" ");
            }
            self.write_piece(*piece, form)?;
            before = Some(*piece);
        }
        Ok(())
    }

    fn write_text(&mut self, text: &str) {
        (self.out)(text);
    }

    fn write(&mut self, arguments: core::fmt::Arguments<'_>) -> Result {
        PieceWriter(self.out).write_fmt(arguments)
    }

    fn word(&self, at: u8) -> u16 {
        self.instruction.word(at.into())
    }

    fn write_piece(&mut self, piece: FormPiece, form: &Form) -> Result {
        let opcode = self.instruction.opcode;
        match piece {
            FormPiece::Word(text) | FormPiece::Sign(text) => self.write_text(text),
            FormPiece::Near16 => return self.write_variable(operand_address(opcode), false, form),
            FormPiece::Near32 => return self.write_variable(operand_address(opcode), true, form),
            FormPiece::Var16(at) | FormPiece::Pointer(at) | FormPiece::Far16(at) => {
                return self.write_variable(self.word(at), false, form);
            }
            FormPiece::Var32(at) | FormPiece::Far32(at) => {
                return self.write_variable(self.word(at), true, form);
            }
            FormPiece::Step if opcode & 0x80 == 0 => self.write_text("+"),
            FormPiece::Step => {}
            FormPiece::Memory => self.write_memory(opcode >> 2)?,
            FormPiece::MemoryHigh => self.write_memory(opcode >> 5)?,
            FormPiece::Count(bits, max) => {
                let count = opcode & ((1 << bits) - 1);
                if count > u16::from(max) {
                    return Err(Error);
                }
                return self.write(format_args!("{count}"));
            }
            FormPiece::Counter => return self.write(format_args!("{}", opcode & 0x7F)),
            FormPiece::Condition => {
                let known = CONDITIONS.iter().find(|(_, bits)| *bits == opcode & 0x7E);
                self.write_text(known.ok_or(Error)?.0);
            }
            FormPiece::Point => return self.write_point(),
            FormPiece::Lines(at) => return self.write_bit_list(self.word(at), 0, 16),
            FormPiece::Groups(at) => return self.write_bit_list(self.word(at), 1, 8),
            FormPiece::Line(at) => return self.write_port_line(self.word(at)),
            FormPiece::Axis(at) => return self.write_id_code(self.word(at)),
            FormPiece::From(at) => {
                self.write_text("FROM ");
                return self.write_id_code(self.word(at));
            }
            FormPiece::FromAxis => return self.write(format_args!("FROM {}", opcode & 0xFF)),
            FormPiece::AxisNumber => return self.write(format_args!("{}", opcode & 0xFF)),
            FormPiece::Version(at) => return self.write_version(at),
            FormPiece::Inner(at) => return self.write_inner(at),
            _ => return self.write_number(piece),
        }
        Ok(())
    }

    fn write_number(&mut self, piece: FormPiece) -> Result {
        match piece {
            FormPiece::Number(at) if self.variable_kind == VariableKind::Int => {
                self.write(format_args!("{}", self.word(at).cast_signed()))
            }
            FormPiece::Number(at)
            | FormPiece::Hex(at)
            | FormPiece::Target(at)
            | FormPiece::Narrow(at) => self.write(format_args!("{:X}", HexWord(self.word(at)))),
            FormPiece::Fixed(at) => self.write_fixed(self.long(at)),
            FormPiece::Long(at) if self.variable_kind == VariableKind::Fixed => {
                self.write_fixed(self.long(at))
            }
            FormPiece::Long(at)
                if matches!(self.variable_kind, VariableKind::Long | VariableKind::Double) =>
            {
                self.write(format_args!("{}", self.long(at).cast_signed()))
            }
            FormPiece::Long(at) | FormPiece::Wide(at) | FormPiece::High(at) => {
                self.write(format_args!("0x{:08X}", self.long(at)))
            }
            _ => Err(Error),
        }
    }

    fn long(&self, at: u8) -> u32 {
        self.instruction.long(at.into())
    }

    /// Writes a fixed-point number. Five decimals distinguish all 65536ths.
    fn write_fixed(&mut self, raw: u32) -> Result {
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

    fn write_variable(&mut self, address: u16, long: bool, form: &Form) -> Result {
        let profile = self.scope.profile;
        self.variable_kind = if long { VariableKind::Double } else { VariableKind::Word };
        if let Some(found) = variable::name_at_address(profile, address, long) {
            // `PROD <<= 3` is about the whole product, not about the variable of that name.
            let product = form.category == Category::Arithmetic && symbol(found) == "PROD";
            if !product {
                self.variable_kind = VariableKind::of(found.encoding);
                self.write_text(symbol(found));
                return Ok(());
            }
        }
        if long {
            return self.write(format_args!("@{:X}L", HexWord(address)));
        }
        let halves = [(address, "(L)"), (address.wrapping_sub(1), "(H)")];
        for (whole, half) in halves {
            if let Some(found) = variable::name_at_address(profile, whole, true) {
                self.write_text(symbol(found));
                self.write_text(half);
                return Ok(());
            }
        }
        self.write(format_args!("@{:X}", HexWord(address)))
    }

    fn write_memory(&mut self, bits: u16) -> Result {
        self.write_text(MEMORIES.get(usize::from(bits & 3)).ok_or(Error)?);
        Ok(())
    }

    fn write_point(&mut self) -> Result {
        let Some(OnlineMessage::Pvt(point)) = OnlineMessage::parse(self.instruction) else {
            return Err(Error);
        };
        if OnlineMessage::Pvt(point).emit() != *self.instruction {
            return Err(Error);
        }
        self.write(format_args!("{}, ", point.position))?;
        self.write_fixed(point.velocity.cast_unsigned())?;
        self.write(format_args!(", {}", point.time))
    }

    fn write_bit_list(&mut self, word: u16, first: u32, count: u32) -> Result {
        if u32::from(word) >> count != 0 {
            return Err(Error);
        }
        self.write_text("(");
        let mut between = "";
        for bit in (0..count).filter(|bit| word >> bit & 1 == 1) {
            self.write(format_args!("{between}{}", bit + first))?;
            between = ", ";
        }
        self.write_text(")");
        Ok(())
    }

    fn write_port_line(&mut self, word: u16) -> Result {
        if !word.is_power_of_two() {
            return Err(Error);
        }
        self.write(format_args!("{}", word.trailing_zeros()))
    }

    fn write_id_code(&mut self, word: u16) -> Result {
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

    fn write_version(&mut self, at: u8) -> Result {
        let ([a, b], [c, d]) = (self.word(at).to_be_bytes(), self.word(at + 1).to_be_bytes());
        let letters = [a, b, c, d];
        let text = core::str::from_utf8(&letters).map_err(|_| Error)?;
        if !letters.iter().all(u8::is_ascii_alphanumeric) {
            return Err(Error);
        }
        self.write_text(text);
        Ok(())
    }

    fn write_inner(&mut self, at: u8) -> Result {
        let data = self.instruction.data();
        let (opcode, rest) = data[usize::from(at)..].split_first().ok_or(Error)?;
        let inner = Instruction::new(*opcode, rest).ok_or(Error)?;
        let form = form_of(&inner, self.scope);
        if form.is_some_and(|form| matches!(form.category, Category::Axes | Category::Online)) {
            return write_raw(&inner, self.out);
        }
        disassemble(&inner, self.scope, self.out);
        Ok(())
    }
}

/// Returns whether a space belongs between two pieces: words and what follows them do not touch.
const fn needs_space(before: Option<FormPiece>, piece: FormPiece) -> bool {
    let after_word = matches!(before, Some(FormPiece::Word(_)));
    let operand = !matches!(piece, FormPiece::Sign(_) | FormPiece::Lines(_) | FormPiece::Step);
    let from = matches!(piece, FormPiece::From(_) | FormPiece::FromAxis);
    (after_word && operand) || (before.is_some() && from)
}
