//! From text to an instruction: every form of the table is tried, piece by piece.

use super::super::online::{Online, PvtPoint};
use super::super::wire::{IdCode, Instruction, low_first, short_operand};
use super::form::{Category, Certainty, Form, Piece};
use super::reader::{Failure, Reader, Result};
use super::variable::{self, Kind, Variable};
use super::{CONDITIONS, MEMORIES, RAW, Scope, forms};
use crate::explain::TextError;
use crate::program::Label;

/// Instructions within an instruction.
const DEPTH_MAX: u8 = 1;

pub(super) const NOTHING: &str = "an instruction, or a variable that the profile names";
const END: &str = "the end of the instruction";

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
pub fn assemble(text: &str, scope: &Scope<'_>) -> core::result::Result<Instruction, TextError> {
    let mut reader = Reader { text, at: 0 };
    statement(&mut reader, scope, 0).map_err(TextError::from)
}

fn statement(reader: &mut Reader<'_>, scope: &Scope<'_>, depth: u8) -> Result<Instruction> {
    reader.skip_spaces();
    let begin = *reader;
    if reader.sign(RAW).is_ok() {
        return raw(reader, scope, depth);
    }
    let first = first_name(begin, scope);
    let mut worst = begin.missing(NOTHING);
    for form in forms() {
        let mut draft = Draft { depth, first, ..Draft::of(form, begin, scope) };
        match draft.attempt(form) {
            Ok(instruction) => {
                *reader = draft.reader;
                return Ok(instruction);
            }
            Err(failure) if failure.reach > worst.reach => worst = failure,
            Err(_) => {}
        }
    }
    Err(worst)
}

/// The variable whose name an instruction begins with: most forms ask for it.
fn first_name(mut begin: Reader<'_>, scope: &Scope<'_>) -> (usize, Option<Variable>) {
    (begin.at, variable::named(scope.profile, begin.name()))
}

/// `.word 0x1234, …`: an opcode and its data words as they are.
fn raw(reader: &mut Reader<'_>, scope: &Scope<'_>, depth: u8) -> Result<Instruction> {
    let (mut words, mut count) = ([0; 5], 0);
    loop {
        let begin = *reader;
        let word = word(reader, scope, "a word: 0x0000 to 0xFFFF")?;
        let reach = reader.at;
        let full = Failure { reach, ..begin.missing("at most five words") };
        *words.get_mut(count).ok_or(full)? = word;
        count += 1;
        if !reader.has_sign(",") {
            break;
        }
    }
    end(reader, depth)?;
    Instruction::new(words[0], &words[1..count]).ok_or(reader.missing(END))
}

/// A number of 16 bits without sign, or a label.
fn word(reader: &mut Reader<'_>, scope: &Scope<'_>, expected: &'static str) -> Result<u16> {
    if let Some(address) = label(reader, scope) {
        return Ok(address);
    }
    Ok(reader.number(expected)?.within(0, 0xFFFF, expected)? as u16)
}

/// What a label stands for, if the next name is one.
fn label(reader: &mut Reader<'_>, scope: &Scope<'_>) -> Option<u16> {
    let mut ahead = *reader;
    let name = ahead.name();
    let is = |known: &&Label<'_>| known.name.is_empty() || known.name.eq_ignore_ascii_case(name);
    let found = scope.labels.iter().find(is).filter(|_| !name.is_empty())?;
    *reader = ahead;
    Some(found.address)
}

/// The end of a statement: of the text, or of the braces that it stands in.
fn end(reader: &mut Reader<'_>, depth: u8) -> Result<()> {
    let _ = reader.has_sign(";");
    reader.skip_spaces();
    let good = match depth {
        0 => reader.ended(),
        _ => reader.rest().starts_with('}'),
    };
    if good { Ok(()) } else { Err(reader.missing(if depth == 0 { END } else { "}" })) }
}

/// An instruction that is being read.
struct Draft<'a, 's> {
    reader: Reader<'a>,
    scope: &'s Scope<'s>,
    depth: u8,
    opcode: u16,
    words: [u16; 4],
    count: u8,
    /// The variable that stands at a place, looked up once for all forms.
    first: (usize, Option<Variable>),
    /// What the variable before holds: numbers are read as it needs them.
    kind: Kind,
}

impl<'a, 's> Draft<'a, 's> {
    fn of(form: &Form, reader: Reader<'a>, scope: &'s Scope<'s>) -> Self {
        let mut words = [0; 4];
        words[..form.fixed.len()].copy_from_slice(form.fixed);
        let (opcode, count) = (form.opcode, form.words);
        let (depth, first, kind) = (0, (usize::MAX, None), Kind::Double);
        Self { reader, scope, depth, opcode, words, count, first, kind }
    }

    fn attempt(&mut self, form: &Form) -> Result<Instruction> {
        let begin = self.reader;
        form.pieces.iter().try_for_each(|piece| self.piece(*piece))?;
        let whole = self.reader.at + 1;
        end(&mut self.reader, self.depth)?;
        if form.certainty == Certainty::Unknown {
            let expected = "an instruction whose opcode is known: no source gives this one's";
            return Err(Failure { at: begin.at, reach: whole, expected });
        }
        if self.depth > 0 && matches!(form.category, Category::Axes | Category::Online) {
            let expected = "an instruction that a drive carries out itself";
            return Err(Failure { at: begin.at, reach: whole, expected });
        }
        let words = &self.words[..usize::from(self.count)];
        Instruction::new(self.opcode, words).ok_or(begin.missing(NOTHING))
    }

    fn piece(&mut self, piece: Piece) -> Result<()> {
        match piece {
            Piece::Word(word) => self.reader.word(word),
            Piece::Sign(sign) => self.reader.sign(sign),
            Piece::Target(at) => self.target(at),
            Piece::Near16 => self.near(false),
            Piece::Near32 => self.near(true),
            Piece::Var16(at) | Piece::Pointer(at) => self.variable(at, false).map(drop),
            Piece::Var32(at) => self.variable(at, true).map(drop),
            Piece::Far16(at) => self.far(at, false),
            Piece::Far32(at) => self.far(at, true),
            Piece::Step => {
                self.opcode |= if self.reader.has_sign("+") { 0 } else { 0x80 };
                Ok(())
            }
            Piece::Memory => self.memory(2),
            Piece::MemoryHigh => self.memory(5),
            Piece::Counter => self.counter(),
            Piece::Count(bits, most) => self.count(bits, most),
            Piece::Condition => self.condition(),
            Piece::Point => self.point(),
            Piece::Lines(at) => self.lines(at),
            Piece::Line(at) => {
                let line = self.whole(0, 15, "a line: 0 to 15")?;
                self.set(at, 1 << line);
                Ok(())
            }
            Piece::Groups(at) => self.groups(at),
            Piece::Axis(at) => {
                let code = self.id_code()?;
                self.set(at, code.word());
                Ok(())
            }
            Piece::From(at) => {
                let code = self.from()?;
                self.set(at, code.word());
                Ok(())
            }
            Piece::FromAxis => {
                self.opcode |= u16::from(self.from()?.id);
                Ok(())
            }
            Piece::AxisNumber => {
                self.opcode |= self.whole(0, 255, "an axis ID: 0 to 255")? as u16;
                Ok(())
            }
            Piece::Version(at) => self.version(at),
            Piece::Inner(at) => self.inner(at),
            _ => self.number(piece),
        }
    }

    fn set(&mut self, at: u8, word: u16) {
        self.words[usize::from(at)] = word;
    }

    fn set_long(&mut self, at: u8, value: u32) {
        let [low, high] = low_first(value);
        self.set(at, low);
        self.set(at + 1, high);
    }

    fn whole(&mut self, least: i64, most: i64, expected: &'static str) -> Result<i64> {
        self.reader.number(expected)?.within(least, most, expected)
    }

    /// A variable by name or address, or half of one.
    fn named(&mut self) -> Result<Variable> {
        const EXPECTED: &str = "a variable that the profile names, or an address: @0x0228L";
        self.reader.skip_spaces();
        let begin = self.reader;
        if self.reader.has_sign("@") {
            let number = self.reader.number(EXPECTED)?;
            let address = number.within(0, 0xFFFF, "an address: @0x0000 to @0xFFFF")? as u16;
            let kind = if number.long { Kind::Double } else { Kind::Word };
            return Ok(Variable { address, kind });
        }
        let name = self.reader.name();
        let found = match self.first {
            (at, known) if at == begin.at => known,
            _ => variable::named(self.scope.profile, name),
        };
        Ok(self.half(found.ok_or(begin.missing(EXPECTED))?))
    }

    /// `(H)` or `(L)` behind a 32-bit variable.
    fn half(&mut self, whole: Variable) -> Variable {
        let mut ahead = self.reader;
        if whole.kind.is_long() && ahead.has_sign("(") {
            let name = ahead.name();
            let offset = match name.as_bytes() {
                [b'H' | b'h'] => 1,
                [b'L' | b'l'] => 0,
                _ => return whole,
            };
            if ahead.has_sign(")") {
                self.reader = ahead;
                let address = whole.address.wrapping_add(offset);
                return Variable { address, kind: Kind::Word };
            }
        }
        whole
    }

    fn of_width(&mut self, long: bool) -> Result<Variable> {
        let mut begin = self.reader;
        begin.skip_spaces();
        let variable = self.named()?;
        if variable.kind.is_long() != long {
            let expected = if long { "a variable of 32 bits" } else { "a variable of 16 bits" };
            return Err(Failure { at: begin.at, reach: self.reader.at, expected });
        }
        self.kind = variable.kind;
        Ok(variable)
    }

    fn variable(&mut self, at: u8, long: bool) -> Result<Variable> {
        let variable = self.of_width(long)?;
        self.set(at, variable.address);
        Ok(variable)
    }

    fn near(&mut self, long: bool) -> Result<()> {
        let mut begin = self.reader;
        begin.skip_spaces();
        let variable = self.of_width(long)?;
        let expected = "a variable within 0x0200 to 0x03FF or 0x0800 to 0x09FF; \
                        write NAME,dm = … to one elsewhere";
        let mut behind = self.reader;
        behind.skip_spaces();
        let failure = Failure { at: begin.at, reach: behind.at + 1, expected };
        self.opcode |= short_operand(variable.address).ok_or(failure)?;
        Ok(())
    }

    fn far(&mut self, at: u8, long: bool) -> Result<()> {
        let begin = self.reader;
        let variable = self.variable(at, long)?;
        match short_operand(variable.address) {
            Some(_) => Err(begin.missing("a variable beyond the short pages")),
            None => Ok(()),
        }
    }

    fn memory(&mut self, shift: u8) -> Result<()> {
        let begin = self.reader;
        let name = self.reader.name();
        let known = MEMORIES.iter().position(|word| word.eq_ignore_ascii_case(name));
        self.opcode |= (known.ok_or(begin.missing("pm, dm or spi"))? as u16) << shift;
        Ok(())
    }

    fn number(&mut self, piece: Piece) -> Result<()> {
        const SHORT: &str = "a number of 16 bits: -32768 to 65535";
        const LONG: &str = "a number of 32 bits: -2147483648 to 4294967295";
        const FIXED: &str = "a number from -32768.0 to 32767.99998";
        let expected = if matches!(piece, Piece::Long(_)) { LONG } else { SHORT };
        let number = self.reader.number(expected)?;
        let short = || number.within(-0x8000, 0xFFFF, SHORT);
        let long = || number.within(-0x8000_0000, 0xFFFF_FFFF, LONG);
        let fixed = || {
            match number.fixed {
                Some(raw) => Ok(raw),
                None if number.hex.is_some() || number.long => long(),
                None => Ok(number.whole << 16),
            }
            .and_then(|raw| {
                let good = (-0x8000_0000..=0xFFFF_FFFF).contains(&raw);
                if good && (number.hex.is_some() || raw <= 0x7FFF_FFFF) {
                    Ok(raw)
                } else {
                    Err(number.refused(FIXED))
                }
            })
        };
        let wide = number.long
            || number.hex.is_some_and(|digits| digits > 4)
            || number.fixed.is_some()
            || short().is_err();
        match piece {
            Piece::Number(at) | Piece::Hex(at) => self.set(at, short()? as u16),
            Piece::Narrow(at) if !wide => self.set(at, short()? as u16),
            Piece::Narrow(_) => return Err(self.reader.missing(SHORT)),
            Piece::Wide(at) if number.fixed.is_some() => self.set_long(at, fixed()? as u32),
            Piece::Wide(at) if wide => self.set_long(at, long()? as u32),
            Piece::High(at) if !wide => self.set_long(at, (short()? as u32) << 16),
            Piece::High(at) if number.fixed.is_none() => self.set_long(at, long()? as u32),
            Piece::Fixed(at) | Piece::High(at) => self.set_long(at, fixed()? as u32),
            Piece::Long(at) if self.kind == Kind::Fixed => self.set_long(at, fixed()? as u32),
            Piece::Long(at) if self.kind == Kind::Double && number.fixed.is_some() => {
                self.set_long(at, fixed()? as u32);
            }
            Piece::Long(at) => self.set_long(at, long()? as u32),
            _ => return Err(number.refused(SHORT)),
        }
        Ok(())
    }

    fn target(&mut self, at: u8) -> Result<()> {
        const EXPECTED: &str =
            "an address: 0x0000 to 0xFFFF, a label of the program, or a variable";
        let address = word(&mut self.reader, self.scope, EXPECTED)?;
        self.set(at, address);
        Ok(())
    }

    fn count(&mut self, bits: u8, most: u8) -> Result<()> {
        let expected = match (bits, most) {
            (4, 15) => "a number from 0 to 15",
            (5, _) => "a number from 0 to 16",
            (2, _) => "a number from 0 to 3",
            _ => "a number from 0 to 63",
        };
        self.opcode |= self.whole(0, most.into(), expected)? as u16;
        Ok(())
    }

    /// The vendor's tool drops the sign: frames labelled -99 carry 99.
    fn counter(&mut self) -> Result<()> {
        let counter = self.whole(-127, 127, "a counter: 0 to 127")?;
        self.opcode |= counter.unsigned_abs() as u16;
        Ok(())
    }

    fn condition(&mut self) -> Result<()> {
        let mut begin = self.reader;
        begin.skip_spaces();
        let name = self.reader.name();
        let known = CONDITIONS.iter().find(|(word, _)| word.eq_ignore_ascii_case(name));
        let (_, bits) = known.ok_or(begin.missing("LT, LEQ, EQ, NEQ, GT or GEQ"))?;
        self.opcode |= bits;
        Ok(())
    }

    fn point(&mut self) -> Result<()> {
        const POSITION: &str = "a position of 24 bits: -8388608 to 8388607";
        const VELOCITY: &str = "a velocity from -32768.0 to 32767.996";
        let position = self.reader.number(POSITION)?;
        let most = if position.hex.is_some() { 0xFF_FFFF } else { 0x7F_FFFF };
        let position = position.within(-0x80_0000, most, POSITION)? as i32;
        self.reader.sign(",")?;
        let velocity = self.reader.number(VELOCITY)?;
        let raw = match (velocity.fixed, velocity.hex) {
            (Some(raw), _) => raw,
            (None, Some(digits)) if digits > 4 => velocity.whole,
            _ => velocity.whole << 16,
        };
        let most = if velocity.hex.is_some() { 0xFFFF_FFFF } else { 0x7FFF_FFFF };
        if !(-0x8000_0000..=most).contains(&raw) {
            return Err(velocity.refused(VELOCITY));
        }
        self.reader.sign(",")?;
        let time = self.whole(0, PvtPoint::TIME_MAX.into(), "a time: 0 to 511")? as u16;
        let position = position << 8 >> 8;
        let velocity = (raw as u32).cast_signed();
        let point = Online::Pvt(PvtPoint { position, velocity, time, counter: 0 }).emit();
        self.words = point.padded();
        Ok(())
    }

    fn lines(&mut self, at: u8) -> Result<()> {
        self.bits(at, 0, 15, "a line: 0 to 15")
    }

    fn groups(&mut self, at: u8) -> Result<()> {
        self.bits(at, 1, 8, "a group: 1 to 8")
    }

    /// `(1, 3)`: numbers as bits of a word.
    fn bits(&mut self, at: u8, least: i64, most: i64, expected: &'static str) -> Result<()> {
        self.reader.sign("(")?;
        let mut word = 0;
        while !self.reader.has_sign(")") {
            word |= 1 << (self.whole(least, most, expected)? - least);
            if !self.reader.has_sign(",") {
                self.reader.sign(")")?;
                break;
            }
        }
        self.set(at, word);
        Ok(())
    }

    fn from(&mut self) -> Result<IdCode> {
        match self.reader.word("FROM") {
            Ok(()) => self.id_code(),
            Err(_) => Ok(self.scope.sender),
        }
    }

    /// `5`, `A5`; `G2`, `G1+3`, `G*`; `H5` for the host at axis 5.
    fn id_code(&mut self) -> Result<IdCode> {
        const EXPECTED: &str = "an axis (5), groups (G2, G1+3, G*) or a host (H5)";
        self.reader.skip_spaces();
        let begin = self.reader;
        let letter = begin.rest().bytes().next().unwrap_or(0).to_ascii_uppercase();
        if b"AGHB*".contains(&letter) {
            self.reader.at += 1;
        }
        let missing = begin.missing(EXPECTED);
        match letter {
            b'G' => self.group_code(),
            b'B' | b'*' => Ok(IdCode::BROADCAST),
            _ => {
                let id = self.whole(0, 255, EXPECTED).map_err(|_| missing)? as u8;
                Ok(if letter == b'H' { IdCode::host_at(id) } else { IdCode::axis(id) })
            }
        }
    }

    fn group_code(&mut self) -> Result<IdCode> {
        if self.reader.has_sign("*") {
            return Ok(IdCode::BROADCAST);
        }
        let mut mask = 0;
        loop {
            let group = self.whole(0, 8, "a group: 1 to 8, or * for everybody")?;
            mask |= if group == 0 { 0 } else { 1 << (group - 1) };
            if !self.reader.has_sign("+") && !self.reader.has_sign(",") {
                return Ok(IdCode::groups(mask));
            }
            let _ = self.reader.has_sign("G") || self.reader.has_sign("g");
        }
    }

    fn version(&mut self, at: u8) -> Result<()> {
        self.reader.skip_spaces();
        let letters = self.reader.rest().as_bytes().first_chunk::<4>();
        let good = letters.filter(|letters| letters.iter().all(u8::is_ascii_alphanumeric));
        let expected = "four characters of a version: 514L";
        let [a, b, c, d] = *good.ok_or(self.reader.missing(expected))?;
        self.reader.at += 4;
        self.set(at, u16::from_be_bytes([a, b]));
        self.set(at + 1, u16::from_be_bytes([c, d]));
        Ok(())
    }

    fn inner(&mut self, at: u8) -> Result<()> {
        let begin = self.reader;
        if self.depth >= DEPTH_MAX {
            return Err(begin.missing("an instruction that a drive carries out itself"));
        }
        let inner = statement(&mut self.reader, self.scope, self.depth + 1)?;
        let data = inner.data();
        let room = usize::from(at) + 1;
        let expected = "an instruction of at most two data words";
        let reach = self.reader.at;
        let failure = Failure { reach, ..begin.missing(expected) };
        self.words.get_mut(room..room + data.len()).ok_or(failure)?.copy_from_slice(data);
        self.set(at, inner.opcode);
        self.opcode |= data.len() as u16;
        self.count += data.len() as u8;
        Ok(())
    }
}
