//! Converts text to an instruction: every form of the table is tried, part by part.

use super::super::online::{OnlineMessage, PvtPoint};
use super::super::wire::{IdCode, Instruction, low_first, short_operand};
use super::form::{Category, CodingCertainty, Form, FormPiece};
use super::reader::{ParseFailure, ParsedNumber, Result, SourceReader};
use super::variable::{self, Variable, VariableKind};
use super::{CONDITIONS, LanguageScope, MEMORIES, RAW_DIRECTIVE, forms};
use crate::explain::TextError;
use crate::program::ProgramLabel;

/// Instructions within an instruction.
const NESTING_MAX: u8 = 1;

pub(super) const EXPECTED_INSTRUCTION: &str =
    "an instruction, or a variable that the profile names";
const EXPECTED_END: &str = "the end of the instruction";

/// Makes an instruction of its text.
///
/// Case and spaces do not matter; `;` and a comment behind `//` may end it. Numbers are decimal or
/// hexadecimal (`0x`), may be negative and end in `L` or `U`. A fixed variable takes a decimal number
/// as units (`CSPD = 16.5`, `CSPD = 16`) and a hexadecimal one as its raw 32 bits. Variables stand by
/// name, or by address as `@0x0228L` (32 bits) and `@0x025E` (16 bits); `NAME(H)` and `NAME(L)` are
/// the halves of a 32-bit one. `q` before a number and `SGN` for `SGM`, as some people write, are
/// taken too.
///
/// # Errors
/// Where the text stops to make sense, and what should be there.
pub fn assemble(
    text: &str,
    scope: &LanguageScope<'_>,
) -> core::result::Result<Instruction, TextError> {
    let mut reader = SourceReader { text, at: 0 };
    parse_statement(&mut reader, scope, 0).map_err(TextError::from)
}

fn parse_statement(
    reader: &mut SourceReader<'_>,
    scope: &LanguageScope<'_>,
    depth: u8,
) -> Result<Instruction> {
    reader.skip_spaces();
    let begin = *reader;
    if reader.expect_sign(RAW_DIRECTIVE).is_ok() {
        return parse_raw_words(reader, scope, depth);
    }
    let first = read_first_variable(begin, scope);
    let mut worst = begin.failure_here(EXPECTED_INSTRUCTION);
    for form in forms() {
        let mut draft = InstructionParser {
            depth,
            first_variable: first,
            ..InstructionParser::for_form(form, begin, scope)
        };
        match draft.parse_form(form) {
            Ok(instruction) => {
                *reader = draft.reader;
                return Ok(instruction);
            }
            Err(failure) if failure.furthest > worst.furthest => worst = failure,
            Err(_) => {}
        }
    }
    Err(worst)
}

/// The variable at the start of an instruction: most forms need it.
fn read_first_variable(
    mut begin: SourceReader<'_>,
    scope: &LanguageScope<'_>,
) -> (usize, Option<Variable>) {
    (begin.at, variable::find_by_name(scope.profile, begin.read_name()))
}

/// `.word 0x1234, …`: an opcode and its data words as they are.
fn parse_raw_words(
    reader: &mut SourceReader<'_>,
    scope: &LanguageScope<'_>,
    depth: u8,
) -> Result<Instruction> {
    let (mut words, mut count) = ([0; 5], 0);
    loop {
        let begin = *reader;
        let word = parse_word(reader, scope, "a word: 0x0000 to 0xFFFF")?;
        let reach = reader.at;
        let full = ParseFailure { furthest: reach, ..begin.failure_here("at most five words") };
        *words.get_mut(count).ok_or(full)? = word;
        count += 1;
        if !reader.accept_sign(",") {
            break;
        }
    }
    expect_end(reader, depth)?;
    Instruction::new(words[0], &words[1..count]).ok_or(reader.failure_here(EXPECTED_END))
}

/// A number of 16 bits without sign, or a label.
fn parse_word(
    reader: &mut SourceReader<'_>,
    scope: &LanguageScope<'_>,
    expected: &'static str,
) -> Result<u16> {
    if let Some(address) = parse_label(reader, scope) {
        return Ok(address);
    }
    Ok(reader.read_number(expected)?.within(0, 0xFFFF, expected)? as u16)
}

/// The value of a label, if the next name is one.
fn parse_label(reader: &mut SourceReader<'_>, scope: &LanguageScope<'_>) -> Option<u16> {
    let mut ahead = *reader;
    let name = ahead.read_name();
    let is =
        |known: &&ProgramLabel<'_>| known.name.is_empty() || known.name.eq_ignore_ascii_case(name);
    let found = scope.labels.iter().find(is).filter(|_| !name.is_empty())?;
    *reader = ahead;
    Some(found.address)
}

/// Expects the end of a statement: of the text, or of its braces.
fn expect_end(reader: &mut SourceReader<'_>, depth: u8) -> Result<()> {
    let _ = reader.accept_sign(";");
    reader.skip_spaces();
    let good = match depth {
        0 => reader.is_at_end(),
        _ => reader.remaining().starts_with('}'),
    };
    if good {
        Ok(())
    } else {
        Err(reader.failure_here(if depth == 0 { EXPECTED_END } else { "}" }))
    }
}

/// An instruction that is being read.
struct InstructionParser<'a, 's> {
    reader: SourceReader<'a>,
    scope: &'s LanguageScope<'s>,
    depth: u8,
    opcode: u16,
    words: [u16; 4],
    count: u8,
    /// The variable at a position, looked up once for all forms.
    first_variable: (usize, Option<Variable>),
    /// Kind of the previous variable, by which numbers are read.
    variable_kind: VariableKind,
}

impl<'a, 's> InstructionParser<'a, 's> {
    fn for_form(form: &Form, reader: SourceReader<'a>, scope: &'s LanguageScope<'s>) -> Self {
        let mut words = [0; 4];
        words[..form.fixed_words.len()].copy_from_slice(form.fixed_words);
        let (opcode, count) = (form.opcode, form.word_count);
        let (depth, first_variable, variable_kind) = (0, (usize::MAX, None), VariableKind::Double);
        Self { reader, scope, depth, opcode, words, count, first_variable, variable_kind }
    }

    fn parse_form(&mut self, form: &Form) -> Result<Instruction> {
        let begin = self.reader;
        form.pieces.iter().try_for_each(|piece| self.parse_piece(*piece))?;
        let whole = self.reader.at + 1;
        expect_end(&mut self.reader, self.depth)?;
        if form.certainty == CodingCertainty::Unknown {
            let expected = "an instruction whose opcode is known: no source gives this one's";
            return Err(ParseFailure { at: begin.at, furthest: whole, expected });
        }
        if self.depth > 0 && matches!(form.category, Category::Axes | Category::Online) {
            let expected = "an instruction that a drive carries out itself";
            return Err(ParseFailure { at: begin.at, furthest: whole, expected });
        }
        let words = &self.words[..usize::from(self.count)];
        Instruction::new(self.opcode, words).ok_or(begin.failure_here(EXPECTED_INSTRUCTION))
    }

    fn parse_piece(&mut self, piece: FormPiece) -> Result<()> {
        match piece {
            FormPiece::Word(word) => self.reader.expect_word(word),
            FormPiece::Sign(sign) => self.reader.expect_sign(sign),
            FormPiece::Target(at) => self.parse_target(at),
            FormPiece::Near16 => self.parse_near_variable(false),
            FormPiece::Near32 => self.parse_near_variable(true),
            FormPiece::Var16(at) | FormPiece::Pointer(at) => {
                self.parse_variable(at, false).map(drop)
            }
            FormPiece::Var32(at) => self.parse_variable(at, true).map(drop),
            FormPiece::Far16(at) => self.parse_far_variable(at, false),
            FormPiece::Far32(at) => self.parse_far_variable(at, true),
            FormPiece::Step => {
                self.opcode |= if self.reader.accept_sign("+") { 0 } else { 0x80 };
                Ok(())
            }
            FormPiece::Memory => self.parse_memory(2),
            FormPiece::MemoryHigh => self.parse_memory(5),
            FormPiece::Counter => self.parse_counter(),
            FormPiece::Count(bits, max) => self.parse_count(bits, max),
            FormPiece::Condition => self.parse_condition(),
            FormPiece::Point => self.parse_point(),
            FormPiece::Lines(at) => self.parse_lines(at),
            FormPiece::Line(at) => {
                let line = self.parse_integer(0, 15, "a line: 0 to 15")?;
                self.set_word(at, 1 << line);
                Ok(())
            }
            FormPiece::Groups(at) => self.parse_groups(at),
            FormPiece::Axis(at) => {
                let code = self.parse_id_code()?;
                self.set_word(at, code.word());
                Ok(())
            }
            FormPiece::From(at) => {
                let code = self.parse_sender()?;
                self.set_word(at, code.word());
                Ok(())
            }
            FormPiece::FromAxis => {
                self.opcode |= u16::from(self.parse_sender()?.id);
                Ok(())
            }
            FormPiece::AxisNumber => {
                self.opcode |= self.parse_integer(0, 255, "an axis ID: 0 to 255")? as u16;
                Ok(())
            }
            FormPiece::Version(at) => self.parse_version(at),
            FormPiece::Inner(at) => self.parse_inner(at),
            _ => self.parse_number(piece),
        }
    }

    fn set_word(&mut self, at: u8, word: u16) {
        self.words[usize::from(at)] = word;
    }

    fn set_long(&mut self, at: u8, value: u32) {
        let [low, high] = low_first(value);
        self.set_word(at, low);
        self.set_word(at + 1, high);
    }

    fn parse_integer(&mut self, min: i64, max: i64, expected: &'static str) -> Result<i64> {
        self.reader.read_number(expected)?.within(min, max, expected)
    }

    /// A variable by name or address, or half of one.
    fn parse_variable_name(&mut self) -> Result<Variable> {
        const EXPECTED: &str = "a variable that the profile names, or an address: @0x0228L";
        self.reader.skip_spaces();
        let begin = self.reader;
        if self.reader.accept_sign("@") {
            let number = self.reader.read_number(EXPECTED)?;
            let address = number.within(0, 0xFFFF, "an address: @0x0000 to @0xFFFF")? as u16;
            let kind = if number.long { VariableKind::Double } else { VariableKind::Word };
            return Ok(Variable { address, kind });
        }
        let name = self.reader.read_name();
        let found = match self.first_variable {
            (at, known) if at == begin.at => known,
            _ => variable::find_by_name(self.scope.profile, name),
        };
        Ok(self.parse_half(found.ok_or(begin.failure_here(EXPECTED))?))
    }

    /// `(H)` or `(L)` behind a 32-bit variable.
    fn parse_half(&mut self, whole: Variable) -> Variable {
        let mut ahead = self.reader;
        if whole.kind.is_long() && ahead.accept_sign("(") {
            let name = ahead.read_name();
            let offset = match name.as_bytes() {
                [b'H' | b'h'] => 1,
                [b'L' | b'l'] => 0,
                _ => return whole,
            };
            if ahead.accept_sign(")") {
                self.reader = ahead;
                let address = whole.address.wrapping_add(offset);
                return Variable { address, kind: VariableKind::Word };
            }
        }
        whole
    }

    fn parse_variable_of_width(&mut self, long: bool) -> Result<Variable> {
        let mut begin = self.reader;
        begin.skip_spaces();
        let variable = self.parse_variable_name()?;
        if variable.kind.is_long() != long {
            let expected = if long { "a variable of 32 bits" } else { "a variable of 16 bits" };
            return Err(ParseFailure { at: begin.at, furthest: self.reader.at, expected });
        }
        self.variable_kind = variable.kind;
        Ok(variable)
    }

    fn parse_variable(&mut self, at: u8, long: bool) -> Result<Variable> {
        let variable = self.parse_variable_of_width(long)?;
        self.set_word(at, variable.address);
        Ok(variable)
    }

    fn parse_near_variable(&mut self, long: bool) -> Result<()> {
        let mut begin = self.reader;
        begin.skip_spaces();
        let variable = self.parse_variable_of_width(long)?;
        let expected = "a variable within 0x0200 to 0x03FF or 0x0800 to 0x09FF; \
                        write NAME,dm = … to one elsewhere";
        let mut behind = self.reader;
        behind.skip_spaces();
        let failure = ParseFailure { at: begin.at, furthest: behind.at + 1, expected };
        self.opcode |= short_operand(variable.address).ok_or(failure)?;
        Ok(())
    }

    fn parse_far_variable(&mut self, at: u8, long: bool) -> Result<()> {
        let begin = self.reader;
        let variable = self.parse_variable(at, long)?;
        match short_operand(variable.address) {
            Some(_) => Err(begin.failure_here("a variable beyond the short pages")),
            None => Ok(()),
        }
    }

    fn parse_memory(&mut self, shift: u8) -> Result<()> {
        let begin = self.reader;
        let name = self.reader.read_name();
        let known = MEMORIES.iter().position(|word| word.eq_ignore_ascii_case(name));
        self.opcode |= (known.ok_or(begin.failure_here("pm, dm or spi"))? as u16) << shift;
        Ok(())
    }

    fn parse_number(&mut self, piece: FormPiece) -> Result<()> {
        const FIXED: &str = "a number from -32768.0 to 32767.99998";
        let expected = if matches!(piece, FormPiece::Long(_)) { LONG } else { SHORT };
        let number = self.reader.read_number(expected)?;
        let fixed = || {
            match number.fixed {
                Some(raw) => Ok(raw),
                None if number.hex.is_some() || number.long => fits_long(&number),
                None => Ok(number.integer << 16),
            }
            .and_then(|raw| {
                let good = (-0x8000_0000..=0xFFFF_FFFF).contains(&raw);
                if good && (number.hex.is_some() || raw <= 0x7FFF_FFFF) {
                    Ok(raw)
                } else {
                    Err(number.failure(FIXED))
                }
            })
        };
        let wide = number.long
            || number.hex.is_some_and(|digits| digits > 4)
            || number.fixed.is_some()
            || fits_short(&number).is_err();
        match piece {
            FormPiece::Number(at) | FormPiece::Hex(at) => {
                self.set_word(at, fits_short(&number)? as u16)
            }
            FormPiece::Narrow(at) if !wide => self.set_word(at, fits_short(&number)? as u16),
            FormPiece::Narrow(_) => return Err(self.reader.failure_here(SHORT)),
            FormPiece::Wide(at) if number.fixed.is_some() => self.set_long(at, fixed()? as u32),
            FormPiece::Wide(at) if wide => self.set_long(at, fits_long(&number)? as u32),
            FormPiece::High(at) if !wide => self.set_long(at, (fits_short(&number)? as u32) << 16),
            FormPiece::High(at) if number.fixed.is_none() => {
                self.set_long(at, fits_long(&number)? as u32)
            }
            FormPiece::Fixed(at) | FormPiece::High(at) => self.set_long(at, fixed()? as u32),
            FormPiece::Long(at) if self.variable_kind == VariableKind::Fixed => {
                self.set_long(at, fixed()? as u32)
            }
            FormPiece::Long(at)
                if self.variable_kind == VariableKind::Double && number.fixed.is_some() =>
            {
                self.set_long(at, fixed()? as u32);
            }
            FormPiece::Long(at) => self.set_long(at, fits_long(&number)? as u32),
            _ => return Err(number.failure(SHORT)),
        }
        Ok(())
    }

    fn parse_target(&mut self, at: u8) -> Result<()> {
        const EXPECTED: &str =
            "an address: 0x0000 to 0xFFFF, a label of the program, or a variable";
        let address = parse_word(&mut self.reader, self.scope, EXPECTED)?;
        self.set_word(at, address);
        Ok(())
    }

    fn parse_count(&mut self, bits: u8, max: u8) -> Result<()> {
        let expected = match (bits, max) {
            (4, 15) => "a number from 0 to 15",
            (5, _) => "a number from 0 to 16",
            (2, _) => "a number from 0 to 3",
            _ => "a number from 0 to 63",
        };
        self.opcode |= self.parse_integer(0, max.into(), expected)? as u16;
        Ok(())
    }

    /// The vendor's tool drops the sign: frames labelled -99 carry 99.
    fn parse_counter(&mut self) -> Result<()> {
        let counter = self.parse_integer(-127, 127, "a counter: 0 to 127")?;
        self.opcode |= counter.unsigned_abs() as u16;
        Ok(())
    }

    fn parse_condition(&mut self) -> Result<()> {
        let mut begin = self.reader;
        begin.skip_spaces();
        let name = self.reader.read_name();
        let known = CONDITIONS.iter().find(|(word, _)| word.eq_ignore_ascii_case(name));
        let (_, bits) = known.ok_or(begin.failure_here("LT, LEQ, EQ, NEQ, GT or GEQ"))?;
        self.opcode |= bits;
        Ok(())
    }

    fn parse_point(&mut self) -> Result<()> {
        const POSITION: &str = "a position of 24 bits: -8388608 to 8388607";
        const VELOCITY: &str = "a velocity from -32768.0 to 32767.996";
        let position = self.reader.read_number(POSITION)?;
        let max = if position.hex.is_some() { 0xFF_FFFF } else { 0x7F_FFFF };
        let position = position.within(-0x80_0000, max, POSITION)? as i32;
        self.reader.expect_sign(",")?;
        let velocity = self.reader.read_number(VELOCITY)?;
        let raw = match (velocity.fixed, velocity.hex) {
            (Some(raw), _) => raw,
            (None, Some(digits)) if digits > 4 => velocity.integer,
            _ => velocity.integer << 16,
        };
        let max = if velocity.hex.is_some() { 0xFFFF_FFFF } else { 0x7FFF_FFFF };
        if !(-0x8000_0000..=max).contains(&raw) {
            return Err(velocity.failure(VELOCITY));
        }
        self.reader.expect_sign(",")?;
        let time = self.parse_integer(0, PvtPoint::TIME_MAX.into(), "a time: 0 to 511")? as u16;
        let position = position << 8 >> 8;
        let velocity = (raw as u32).cast_signed();
        let point = OnlineMessage::Pvt(PvtPoint { position, velocity, time, counter: 0 }).emit();
        self.words = point.padded();
        Ok(())
    }

    fn parse_lines(&mut self, at: u8) -> Result<()> {
        self.parse_bit_list(at, 0, 15, "a line: 0 to 15")
    }

    fn parse_groups(&mut self, at: u8) -> Result<()> {
        self.parse_bit_list(at, 1, 8, "a group: 1 to 8")
    }

    /// `(1, 3)`: numbers as bits of a word.
    fn parse_bit_list(&mut self, at: u8, min: i64, max: i64, expected: &'static str) -> Result<()> {
        self.reader.expect_sign("(")?;
        let mut word = 0;
        while !self.reader.accept_sign(")") {
            word |= 1 << (self.parse_integer(min, max, expected)? - min);
            if !self.reader.accept_sign(",") {
                self.reader.expect_sign(")")?;
                break;
            }
        }
        self.set_word(at, word);
        Ok(())
    }

    fn parse_sender(&mut self) -> Result<IdCode> {
        match self.reader.expect_word("FROM") {
            Ok(()) => self.parse_id_code(),
            Err(_) => Ok(self.scope.sender),
        }
    }

    /// `5`, `A5`; `G2`, `G1+3`, `G*`; `H5` for the host at axis 5.
    fn parse_id_code(&mut self) -> Result<IdCode> {
        const EXPECTED: &str = "an axis (5), groups (G2, G1+3, G*) or a host (H5)";
        self.reader.skip_spaces();
        let begin = self.reader;
        let letter = begin.remaining().bytes().next().unwrap_or(0).to_ascii_uppercase();
        if b"AGHB*".contains(&letter) {
            self.reader.at += 1;
        }
        let missing = begin.failure_here(EXPECTED);
        match letter {
            b'G' => self.parse_group_code(),
            b'B' | b'*' => Ok(IdCode::BROADCAST),
            _ => {
                let id = self.parse_integer(0, 255, EXPECTED).map_err(|_| missing)? as u8;
                Ok(if letter == b'H' { IdCode::host_at(id) } else { IdCode::axis(id) })
            }
        }
    }

    fn parse_group_code(&mut self) -> Result<IdCode> {
        if self.reader.accept_sign("*") {
            return Ok(IdCode::BROADCAST);
        }
        let mut mask = 0;
        loop {
            let group = self.parse_integer(0, 8, "a group: 1 to 8, or * for everybody")?;
            mask |= if group == 0 { 0 } else { 1 << (group - 1) };
            if !self.reader.accept_sign("+") && !self.reader.accept_sign(",") {
                return Ok(IdCode::groups(mask));
            }
            let _ = self.reader.accept_sign("G") || self.reader.accept_sign("g");
        }
    }

    fn parse_version(&mut self, at: u8) -> Result<()> {
        self.reader.skip_spaces();
        let letters = self.reader.remaining().as_bytes().first_chunk::<4>();
        let good = letters.filter(|letters| letters.iter().all(u8::is_ascii_alphanumeric));
        let expected = "four characters of a version: 514L";
        let [a, b, c, d] = *good.ok_or(self.reader.failure_here(expected))?;
        self.reader.at += 4;
        self.set_word(at, u16::from_be_bytes([a, b]));
        self.set_word(at + 1, u16::from_be_bytes([c, d]));
        Ok(())
    }

    fn parse_inner(&mut self, at: u8) -> Result<()> {
        let begin = self.reader;
        if self.depth >= NESTING_MAX {
            return Err(begin.failure_here("an instruction that a drive carries out itself"));
        }
        let inner = parse_statement(&mut self.reader, self.scope, self.depth + 1)?;
        let data = inner.data();
        let capacity = usize::from(at) + 1;
        let expected = "an instruction of at most two data words";
        let reach = self.reader.at;
        let failure = ParseFailure { furthest: reach, ..begin.failure_here(expected) };
        self.words.get_mut(capacity..capacity + data.len()).ok_or(failure)?.copy_from_slice(data);
        self.set_word(at, inner.opcode);
        self.opcode |= data.len() as u16;
        self.count += data.len() as u8;
        Ok(())
    }
}

const SHORT: &str = "a number of 16 bits: -32768 to 65535";
const LONG: &str = "a number of 32 bits: -2147483648 to 4294967295";

fn fits_long(number: &ParsedNumber) -> Result<i64> {
    number.within(-0x8000_0000, 0xFFFF_FFFF, LONG)
}

fn fits_short(number: &ParsedNumber) -> Result<i64> {
    number.within(-0x8000, 0xFFFF, SHORT)
}
