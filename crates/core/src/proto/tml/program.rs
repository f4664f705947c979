//! Programs: text of many lines to words at addresses, and back.
//!
//! A line holds instructions, parted by `;`, and a comment behind `//`. `name:` before an instruction
//! is a label; `GOTO`, `CALL` and `CALLS` take one in place of an address, as does `.word`, so that
//! tables of routines can be written. Case does not matter. What only goes on-line (requests and
//! their answers) is in no program (help page on program execution).

use super::ask::give_me_data;
use super::instruction::{Scope, assemble, disassemble, disassemble_word, named, words};
use super::wire::{IdCode, Instruction};
use crate::profile::Profile;
use crate::program::{
    Assembled, Check, Label, Language, Listing, Memory, MemoryRules, Order, SourceError,
    TransferStep,
};
use crate::station::Class;

/// TML.
#[derive(Debug)]
pub struct Tml;

/// Where the vendor's TML_LIB_light keeps the address that it writes the EEPROM at.
pub const POINTER: u16 = 0x032B;
const SRL: u16 = super::ask::SRL;
const SRH: u16 = 0x090F;
const END: u16 = 0x0001;

/// Source: help pages on the memory map (EEPROM 4000h to 7FFFh; RAM from 8000h, of which the firmware
/// with names FAxx keeps 270h words to itself) and on the status register; TML_LIB_light for END at
/// 4000h. How far RAM goes differs: the sum tells where there is none.
pub static RULES: MemoryRules = MemoryRules {
    permanent: 0x4000..=0x7FFF,
    volatile: 0x8270..=0xFFFF,
    autorun: (0x4000, END),
    idle: &[
        Check {
            address: SRL,
            mask: 0x8000,
            hint: "the motor has power, and what it does could change while its program is \
                   written: `polepair disable` first",
        },
        Check {
            address: SRL,
            mask: 0x0100,
            hint: "a routine of its program runs: `polepair program abort` first",
        },
        Check {
            address: SRH,
            mask: 0x0020,
            hint: "the program that it starts by itself runs (AUTORUN): `polepair program abort` \
                   first",
        },
    ],
    calling: (SRL, 0x0100),
};

impl Language for Tml {
    fn assemble<'t>(
        &self,
        text: &'t str,
        origin: u16,
        profile: Option<&'static Profile>,
        words: &mut [u16],
        labels: &mut [Label<'t>],
    ) -> Result<Assembled, SourceError> {
        let blank = Scope { profile, sender: IdCode::BROADCAST, labels: &[] };
        let mut count = 0;
        let mut at = origin;
        // First where everything lies: how long an instruction is does not depend on its labels.
        each(text, &mut |statement| match statement {
            Statement::Label(place, name) => {
                count += 1;
                let taken = named(profile, name).map(|_| VARIABLE);
                let declared = declare(labels, count, Label { name, address: at });
                taken.map_or(declared, Err).map_err(|expected| place.error(expected))
            }
            Statement::Code(place, text) => {
                let (size, _) = place.read(text, &Scope { labels: ANY, ..blank })?;
                at = at.checked_add(size).ok_or(place.error(TOO_LONG))?;
                Ok(())
            }
        })?;
        let scope = Scope { labels: &labels[..count], ..blank };
        let mut len = 0;
        each(text, &mut |statement| {
            let Statement::Code(place, text) = statement else { return Ok(()) };
            let (size, instruction) = place.read(text, &scope)?;
            let whole = [&[instruction.opcode], instruction.data()];
            let room = words.get_mut(len..len + usize::from(size)).ok_or(place.error(TOO_LONG))?;
            room.iter_mut().zip(whole.into_iter().flatten()).for_each(|(to, word)| *to = *word);
            len += usize::from(size);
            Ok(())
        })?;
        Ok(Assembled { words: len, labels: count })
    }

    fn disassemble(
        &self,
        origin: u16,
        image: &[u16],
        profile: Option<&'static Profile>,
        listing: &mut dyn Listing,
    ) {
        let scope = Scope { profile, ..Scope::default() };
        let mut rest = image;
        let mut address = origin;
        while let Some((opcode, behind)) = rest.split_first() {
            let whole = words(*opcode).and_then(|n| Instruction::new(*opcode, behind.get(..n)?));
            let instruction = whole.unwrap_or(Instruction::of(*opcode, []));
            let (taken, left) = rest.split_at(1 + instruction.data().len());
            listing.instruction(address, taken);
            let out = &mut |piece: &str| listing.text(piece);
            match whole {
                Some(_) => disassemble(&instruction, &scope, out),
                None => disassemble_word(*opcode, out),
            }
            (rest, address) = (left, address.wrapping_add(taken.len() as u16));
        }
    }

    fn rules(&self) -> &'static MemoryRules {
        &RULES
    }
}

const TOO_LONG: &str = "a shorter program: it runs beyond the end of memory";
const TWICE: &str = "another name: this label is there twice";
const VARIABLE: &str = "another name: a variable is called so";
const TOO_MANY: &str = "fewer labels: at most 1024";
const ON_LINE: &str = "an instruction that a program can hold: requests and answers go on-line";

/// Stands for labels that are not known yet: every name is one.
const ANY: &[Label<'static>] = &[Label { name: "", address: 0 }];

/// Where a statement stands.
#[derive(Clone, Copy)]
struct Place {
    line: u32,
    at: usize,
}

/// A piece of a line.
enum Statement<'t> {
    Label(Place, &'t str),
    Code(Place, &'t str),
}

impl Place {
    const fn error(self, expected: &'static str) -> SourceError {
        SourceError { line: self.line, at: self.at, expected }
    }

    /// The instruction, and its words.
    fn read(self, text: &str, scope: &Scope<'_>) -> Result<(u16, Instruction), SourceError> {
        let instruction = assemble(text, scope).map_err(|error| SourceError {
            line: self.line,
            at: self.at + error.at,
            expected: error.expected,
        })?;
        let size = instruction.data().len();
        let raw = text.trim_start().starts_with('.');
        if !raw && words(instruction.opcode) != Some(size) {
            return Err(self.error(ON_LINE));
        }
        Ok((1 + size as u16, instruction))
    }
}

/// Shows each label and instruction of a text.
fn each<'t>(
    text: &'t str,
    show: &mut dyn FnMut(Statement<'t>) -> Result<(), SourceError>,
) -> Result<(), SourceError> {
    for (line, text) in (1..).zip(text.lines()) {
        let code = text.split("//").next().unwrap_or("");
        let mut at = 0;
        while at < code.len() {
            let len = statement(&code[at..]);
            let mut piece = &code[at..at + len];
            let mut place = Place { line, at };
            while let Some((name, behind)) = label(piece) {
                let before = piece.len() - piece.trim_start().len();
                show(Statement::Label(Place { at: place.at + before, ..place }, name))?;
                place.at += piece.len() - behind.len();
                piece = behind;
            }
            let before = piece.len() - piece.trim_start().len();
            if !piece.trim().is_empty() {
                place.at += before;
                show(Statement::Code(place, piece.trim()))?;
            }
            at += len + 1;
        }
    }
    Ok(())
}

/// How long the first instruction of a line is: up to a `;` that stands in no braces.
fn statement(line: &str) -> usize {
    let mut depth = 0_u32;
    let end = line.bytes().position(|byte| {
        match byte {
            b'{' => depth += 1,
            b'}' => depth = depth.saturating_sub(1),
            _ => {}
        }
        byte == b';' && depth == 0
    });
    end.unwrap_or(line.len())
}

/// `name:` at the head of a piece, and what is behind it.
fn label(piece: &str) -> Option<(&str, &str)> {
    let (name, behind) = piece.split_once(':')?;
    let name = name.trim();
    let first = name.bytes().next()?;
    let good = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_';
    (!first.is_ascii_digit() && name.bytes().all(good)).then_some((name, behind))
}

/// Notes the label of that number, counted from 1.
fn declare<'t>(
    labels: &mut [Label<'t>],
    number: usize,
    label: Label<'t>,
) -> Result<(), &'static str> {
    let (before, room) = labels.split_at_mut_checked(number - 1).ok_or(TOO_MANY)?;
    if before.iter().any(|known| known.name.eq_ignore_ascii_case(label.name)) {
        return Err(TWICE);
    }
    *room.first_mut().ok_or(TOO_MANY)? = label;
    Ok(())
}

/// The instruction of a transfer's step, and what it is held to.
///
/// Source: TML_LIB_light: a variable points, `(POINTER+),spi = w` writes and moves on, the variable is
/// read until it has, for a drive answers when its EEPROM is ready. Program memory is written by
/// the same form with other memory bits. Two words at once: the 32-bit form.
pub(super) fn transfer(step: TransferStep) -> (Instruction, Class) {
    match step {
        TransferStep::Status(address) => (give_me_data(address, false), Class::Idempotent),
        TransferStep::Where => (give_me_data(POINTER, false), Class::Idempotent),
        TransferStep::Aim(address) => {
            (super::ask::assignment(POINTER, address.into(), false), Class::Confirm)
        }
        TransferStep::Put(memory, word, None) => {
            (Instruction::of(0x9020 | bits(memory) << 2, [POINTER, word]), Class::Never)
        }
        TransferStep::Put(memory, low, Some(high)) => {
            (Instruction::of(0x9021 | bits(memory) << 2, [POINTER, low, high]), Class::Never)
        }
        TransferStep::Get(memory, address) => {
            (Instruction::of(0xB001 | bits(memory) << 2, [0, address]), Class::Idempotent)
        }
        TransferStep::Sum(memory, start, end) => {
            (Instruction::of(0xDA10 | bits(memory) << 5, [0, start, end]), Class::Idempotent)
        }
    }
}

/// The instruction of an order, and what it is held to; `None` for motors, of which an axis ID is one.
pub(super) fn order(order: Order) -> Option<(Instruction, Class)> {
    Some(match order {
        Order::StopMotor(_) => return None,
        Order::Go(address) => (Instruction::of(0x7400, [address]), Class::Never),
        Order::Call(address) => (Instruction::of(0x1C01, [address]), Class::Never),
        Order::Abort => (Instruction::of(0x1C02, []), Class::Stop),
        Order::End => (Instruction::of(END, []), Class::Stop),
        Order::Calling => (give_me_data(RULES.calling.0, false), Class::Idempotent),
    })
}

/// Program memory holds RAM, SPI memory is the EEPROM.
const fn bits(memory: Memory) -> u16 {
    match memory {
        Memory::Volatile => 0,
        Memory::Permanent => 2,
    }
}
